"""What is drawn of a run folder, and noted in its manifest."""

from tiswarm.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.page import write_page
from tiswarm.report.render.animation import Movie, animate_run
from tiswarm.report.render.pictures import render_run
from tiswarm.report.run_data import RunData, load_run
from tiswarm.study import RunResult
from tiswarm.study.manifest import write_manifest


def draw_all(
    result: RunResult,
    progress: Progress,
    *,
    pictures: bool = True,
    pdf: bool = False,
    movie: Movie | None = None,
) -> None:
    """Draw what a run came to, unless nothing is new and it was drawn before."""
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
    """Draw the 3D pictures of a run, and note in its manifest what drew them."""
    drawn = render_run(run, progress=progress, renderer=renderer, case=case)
    notes = {p.path.name: {"renderer": p.renderer, "reason": p.reason} for p in drawn}
    write_manifest(run.folder, {"renders": notes})
