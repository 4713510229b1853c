"""What is drawn of a run folder, and noted in its manifest."""

from pathlib import Path

from tiswarm.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.page import write_page
from tiswarm.report.render.animation import Movie, animate_run
from tiswarm.report.render.pictures import render_run
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
    if drawn:
        draw_figures(result.folder, progress, vector=pdf)
        if some_done:
            draw_renders(result.folder, progress)
    if movie and some_done:
        animate_run(result.folder, movie, progress=progress)
    if drawn or movie:
        write_page(result.folder, progress)


def draw_renders(
    folder: Path, progress: Progress, *, renderer: str | None = None, case: str | None = None
) -> None:
    """Draw the 3D pictures of a run, and note in its manifest what drew them."""
    drawn = render_run(folder, progress=progress, renderer=renderer, case=case)
    notes = {p.path.name: {"renderer": p.renderer, "reason": p.reason} for p in drawn}
    write_manifest(folder, {"renders": notes})
