"""Draws the figures, pictures and page of a run folder."""

from tiswarm.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.page import write_page
from tiswarm.report.render.animation import Movie, animate_run
from tiswarm.report.render.pictures import render_run
from tiswarm.report.run_data import RunData, load_run
from tiswarm.study.provenance import write_manifest
from tiswarm.study.run import RunResult


def draw_all(
    result: RunResult,
    progress: Progress,
    *,
    pictures: bool = True,
    pdf: bool = False,
    movie: Movie | None = None,
) -> None:
    """Draw the results of a run, unless the drawings are current."""
    some_done = len(result.failed) < result.computed + result.found
    there = (result.folder / "report.html").exists()
    drawn = pictures and (pdf or result.computed > 0 or not there)
    if not (drawn or movie):
        return
    run = load_run(result.folder)
    if drawn:
        draw_figures(run, progress, vector=pdf)
        if some_done:
            draw_renders(run, progress)
    if movie and some_done:
        animate_run(run, movie, progress=progress)
    write_page(run, progress)


def draw_renders(
    run: RunData, progress: Progress, *, renderer: str | None = None, case: str | None = None
) -> None:
    """Draw the 3D pictures of a run, and record their renderer in the manifest."""
    drawn = render_run(run, progress=progress, renderer=renderer, case=case)
    notes = {p.path.name: {"renderer": p.renderer, "reason": p.reason} for p in drawn}
    write_manifest(run.folder, {"renders": notes})
