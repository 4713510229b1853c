"""What commands draw of a run folder."""

from pathlib import Path
from typing import Literal

from tiswarm.console import ConsoleWatcher


def draw_figures_of(folder: Path, watcher: ConsoleWatcher, *, pdf: bool) -> None:
    """Draw the figures of a run from its stored data."""
    from tiswarm.report.figures import draw_figures

    draw_figures(folder, watcher.say, vector=pdf)


def write_page_of(folder: Path, watcher: ConsoleWatcher) -> None:
    """Write report.html of a run from its stored data."""
    from tiswarm.report.page import write_page

    write_page(folder, watcher.say)


def draw_renders_of(
    folder: Path, watcher: ConsoleWatcher, *, renderer: str | None = None, case: str | None = None
) -> None:
    """Draw the 3D pictures of a run, and note in its manifest what drew them."""
    from tiswarm.report.render import render_run
    from tiswarm.study.manifest import write_manifest

    drawn = render_run(folder, tell=watcher.say, renderer=renderer, case=case)
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
    watcher: ConsoleWatcher,
    movie: Literal["gif", "mp4"],
    *,
    renderer: str | None = None,
    case: str | None = None,
) -> None:
    """Draw how a structure of a run grew; the first one, unless `case` names another."""
    from tiswarm.report.render.animation import animate_run

    animate_run(folder, movie, tell=watcher.say, renderer=renderer, case=case)
