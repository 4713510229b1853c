"""Draws the figures, pictures and page of a run folder, and the page of a log."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiswarm.base.aliases import Reals
from tiswarm.base.params import AnyMovie
from tiswarm.base.progress import Progress
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import digest
from tiswarm.records.outputs import NEW, Outputs
from tiswarm.records.run_folder import Manifest, Origin, read_manifest, write_manifest
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figures import draw_figures
from tiswarm.report.log_page import gather_log_page
from tiswarm.report.page import write_page
from tiswarm.report.run_data import RunData, load_run
from tiswarm.report.swarm_view import view_log

if TYPE_CHECKING:
    from tiswarm.study.run import RunResult

PAGE = "report.html"


def draw_all(
    result: "RunResult",
    progress: Progress,
    *,
    pictures: bool = True,
    pdf: bool = False,
    movie: AnyMovie | None = None,
) -> None:
    """Draw the results of a run, unless the drawings are whole and show its tables."""
    some_done = len(result.failed) < result.computed + result.found
    manifest = read_manifest(result.folder)
    needed = {PAGE, "figures", "renders"} if some_done else {PAGE}
    present = {Path(name).parts[0] for name in manifest.drawn}
    whole = needed <= present and all(
        digest(result.folder / name) == sha for name, sha in manifest.drawn.items()
    )
    drawn = pictures and (pdf or not whole)
    if drawn:  # what another command drew is not drawn again, and no longer checked
        write_manifest(result.folder, replace(manifest, drawn={}, outdated=manifest.ever_drawn))
    renders = drawn and some_done
    if drawn or movie:
        draw(
            load_run(result.folder),
            progress,
            figures=drawn,
            renders=renders,
            pdf=pdf,
            movie=movie if some_done else None,
        )


def draw(
    run: RunData,
    progress: Progress,
    *,
    figures: bool = False,
    renders: bool = False,
    pdf: bool = False,
    movie: AnyMovie | None = None,
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
    from tiswarm.report.pictures.pictures import animate_run, render_run  # noqa: PLC0415
    from tiswarm.report.pictures.raycast import check_renderer  # noqa: PLC0415 - slow to import

    manifest = read_manifest(run.folder)
    if renders or movie:  # mistakes are found before anything is drawn
        check_renderer(renderer)
        run.choose(case)
    with ThreadPoolExecutor(1) as pool:  # renders leave the interpreter to figures for long
        rendering = None
        if renders:
            rendering = pool.submit(
                render_run, run, progress=progress, renderer=renderer, case=case
            )
        written = draw_figures(run, progress, vector=pdf) if figures else []
    if figures:
        manifest = _without_old_figures(run.folder, written, manifest)
    if rendering:
        pictures = rendering.result()
        written += [picture.path for picture in pictures]
        origins = {p.path.name: Origin(renderer=p.renderer, reason=p.reason) for p in pictures}
        manifest = replace(manifest, renders=origins)
        write_manifest(run.folder, manifest)  # for the page
    if movie:
        animated = animate_run(run, movie, progress=progress, renderer=renderer, case=case)
        written.append(animated.path)
    written += [write_page(run, progress), *run.folder.glob("*.csv"), run.folder / "scenario.yaml"]
    digests = {path.relative_to(run.folder).as_posix(): digest(path) for path in written}
    write_manifest(run.folder, replace(manifest, drawn={**manifest.drawn, **digests}))


def _without_old_figures(run: Path, written: Sequence[Path], manifest: Manifest) -> Manifest:
    """Remove figures of an earlier call that the run no longer has, but no other file.

    Args:
        run: Folder of the run.
        written: Figures that were drawn now.
        manifest: Manifest of the run, with the digests of earlier figures.

    Returns:
        The manifest without earlier figures.
    """
    for path in {*run.glob("figures/*")} - {*written}:
        drawn = manifest.ever_drawn.get(f"figures/{path.name}")
        if drawn and drawn == digest(path):  # a figure that a user has changed is the user's
            path.unlink(missing_ok=True)
    kept = {name: sha for name, sha in manifest.drawn.items() if not name.startswith("figures/")}
    return replace(manifest, drawn=kept, outdated={})


def draw_log(
    path: Path,
    log: SensingLog,
    estimate: Estimate,
    *,
    name: str,
    true: Reals | None = None,
    warnings: Sequence[str] = (),
    notes: Sequence[str] = (),
    advice: Sequence[Mapping[str, str]] = (),
    figures: Sequence[Any] = (),
    user_colorings: Sequence[Any] = (),
    outputs: Outputs = NEW,
) -> None:
    """Write the page of a log and its estimate.

    Args:
        path: File to write.
        log: The sensing log.
        estimate: Estimate of its robots.
        name: Heading of the page.
        true: True centers [log unit], shape (N, 3); None where unknown.
        warnings: What makes the estimate doubtful.
        notes: What the log leaves open, and what the method found, in lines.
        advice: Further measurements that would help, as rows of cells by heading.
        figures: Figures, as `explanation.show` returns them.
        user_colorings: Values of the user that color robots, each a `Coloring`.
        outputs: What may be written.

    Raises:
        InputError: there is such a file, and it is not to be replaced.
        EnvironmentTroubleError: the file cannot be written.
    """
    scores: Mapping[str, float] = {}
    if true is not None:
        from tiswarm.evaluation.tables import Scores  # noqa: PLC0415 - slow to import

        scores = Scores(true, estimate.position, log.is_gone, log.length_unit)
    view = view_log(log, estimate, true, user_colorings=user_colorings)
    page = gather_log_page(
        view,
        estimate,
        name=name,
        scores=scores,
        warnings=warnings,
        notes=notes,
        advice=advice,
        figures=figures,
    )
    outputs.write(path, page.html().encode())
