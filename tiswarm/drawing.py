"""What is drawn of a run folder, and noted in its manifest."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from tiswarm.report.folder import Tell
    from tiswarm.study import RunResult


def draw_all(
    result: "RunResult",
    tell: "Tell",
    *,
    pictures: bool = True,
    pdf: bool = False,
    movie: Literal["gif", "mp4"] | None = None,
) -> None:
    """Draw what a run came to, unless nothing is new and it was drawn before."""
    some_done = len(result.failed) < result.computed + result.found
    there = (result.folder / "report.html").exists()
    drawn = pictures and (pdf or result.computed > 0 or not there)
    if drawn:
        draw_figures_of(result.folder, tell, pdf=pdf)
        if some_done:
            draw_renders_of(result.folder, tell)
    if movie and some_done:
        animate_first(result.folder, tell, movie)
    if drawn or movie:
        write_page_of(result.folder, tell)


def draw_figures_of(folder: Path, tell: "Tell", *, pdf: bool) -> None:
    """Draw the figures of a run from its stored data."""
    from tiswarm.report.figures import draw_figures

    draw_figures(folder, tell, vector=pdf)


def write_page_of(folder: Path, tell: "Tell") -> None:
    """Write report.html of a run from its stored data."""
    from tiswarm.report.page import write_page

    write_page(folder, tell)


def draw_renders_of(
    folder: Path, tell: "Tell", *, renderer: str | None = None, case: str | None = None
) -> None:
    """Draw the 3D pictures of a run, and note in its manifest what drew them."""
    from tiswarm.report.render import render_run
    from tiswarm.study.manifest import write_manifest

    drawn = render_run(folder, tell=tell, renderer=renderer, case=case)
    write_manifest(
        folder,
        {
            "renders": {
                picture.path.name: {"renderer": picture.renderer, "reason": picture.reason}
                for picture in drawn
            }
        },
    )


def animate_first(
    folder: Path,
    tell: "Tell",
    movie: Literal["gif", "mp4"],
    *,
    renderer: str | None = None,
    case: str | None = None,
) -> None:
    """Draw how a structure of a run grew; the first one, unless `case` names another."""
    from tiswarm.report.render.animation import animate_run

    animate_run(folder, movie, tell=tell, renderer=renderer, case=case)
