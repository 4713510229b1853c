"""Draws the figures, pictures and page of a run folder."""

from dataclasses import replace
from pathlib import Path

from tiswarm.progress import Progress
from tiswarm.records.io import digest
from tiswarm.records.run_folder import Origin, read_manifest, write_manifest
from tiswarm.report.figures import draw_figures
from tiswarm.report.page import write_page
from tiswarm.report.render.animation import Movie, animate_run
from tiswarm.report.render.pictures import render_run
from tiswarm.report.run_data import RunData, load_run
from tiswarm.study.run import RunResult

_PAGE = "report.html"


def draw_all(
    result: RunResult,
    progress: Progress,
    *,
    pictures: bool = True,
    pdf: bool = False,
    movie: Movie | None = None,
) -> None:
    """Draw the results of a run, unless the drawings are whole and show its tables."""
    some_done = len(result.failed) < result.computed + result.found
    manifest = read_manifest(result.folder)
    whole = {_PAGE, *(["figures", "renders"] if some_done else [])} <= {
        Path(name).parts[0] for name in manifest.drawn
    } and all(digest(result.folder / name) == sha for name, sha in manifest.drawn.items())
    drawn = pictures and (pdf or not whole)
    if drawn:  # what another command drew is not drawn again, and no longer checked
        write_manifest(result.folder, replace(manifest, drawn={}))
    if drawn or movie:
        draw(
            load_run(result.folder), progress, figures=drawn, renders=drawn and some_done, pdf=pdf,
            movie=movie if some_done else None,
        )  # fmt: skip


def draw(
    run: RunData,
    progress: Progress,
    *,
    figures: bool = False,
    renders: bool = False,
    pdf: bool = False,
    movie: Movie | None = None,
    renderer: str | None = None,
    case: str | None = None,
) -> None:
    """Draw parts of a run and its page, and note renderers and digests in the manifest.

    Args:
        run: The run.
        progress: Receives progress reports.
        figures: Whether to draw figures.
        renders: Whether to draw 3D pictures.
        pdf: Whether figures are drawn as vector PDF too.
        movie: File format of an animation; none if None.
        renderer: Renderer of pictures and animation; the first that works if None.
        case: Case of pictures and animation; the first of the largest if None.

    Raises:
        InputError: the run is damaged, or there is no such renderer or case.
        EnvironmentTroubleError: the folder is not writable, or the renderer does not work.
    """
    manifest = read_manifest(run.folder)
    written = draw_figures(run, progress, vector=pdf) if figures else []
    if renders:
        pictures = render_run(run, progress=progress, renderer=renderer, case=case)
        written += [picture.path for picture in pictures]
        origins = {p.path.name: Origin(renderer=p.renderer, reason=p.reason) for p in pictures}
        manifest = replace(manifest, renders=origins)
        write_manifest(run.folder, manifest)  # for the page
    if movie:
        animated = animate_run(run, movie, progress=progress, renderer=renderer, case=case)
        written.append(animated.path)
    written += [write_page(run, progress), *run.folder.glob("*.csv")]
    digests = {path.relative_to(run.folder).as_posix(): digest(path) for path in written}
    write_manifest(run.folder, replace(manifest, drawn={**manifest.drawn, **digests}))
