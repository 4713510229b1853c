"""Draws the figures of a run; their kinds have modules of their own, with captions of pictures."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from tiswarm.base.errors import InputError, did_you_mean
from tiswarm.base.plugins import call_plugin
from tiswarm.base.progress import Progress
from tiswarm.base.registry import get, names, register
from tiswarm.records.io import write_bytes
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_Draw = TypeVar("_Draw", bound=Callable[[RunData], "Figure"])


class PluginFigure(NamedTuple):
    """A figure that a plug-in registered, with the names of a module of figures."""

    name: str
    caption: str
    draw: Callable[[RunData], "Figure"]

    @property
    def CAPTIONS(self) -> dict[str, figure_style.Caption]:  # noqa: N802 - as a module has it
        """What the figure shows, by its name."""
        return {self.name: figure_style.Caption(self.caption)}

    def painters(self, run: RunData) -> dict[str, figure_style.Drawable]:
        """Return what draws the figure, by its name."""
        return {self.name: _PluginDrawing(self, run)}


class _PluginDrawing(NamedTuple):
    """The figure of a plug-in for a run; it has no panels to choose from."""

    figure: PluginFigure
    run: RunData

    def draw(
        self, width: float | None = None, panels: Sequence[str] = (), series: Sequence[str] = ()
    ) -> "Figure":
        """Draw the figure, no wider than `width` [inch].

        Raises:
            InputError: a panel or series is chosen.
        """
        for argument, chosen in (("panels", panels), ("series", series)):
            if chosen:
                problem = f"the figure {self.figure.name} of a plug-in has none to choose from"
                raise InputError(problem, argument=argument)
        drawn: Figure = call_plugin("figure", self.figure.name, lambda: self.figure.draw(self.run))
        if width is not None:
            drawn.set_figwidth(min(width, drawn.get_figwidth()))
        if drawn.get_layout_engine() is None:
            drawn.set_layout_engine("constrained")
        return drawn


def figure(name: str, caption: str) -> Callable[[_Draw], _Draw]:
    """Register a function as a figure, which each run then has.

    The function takes a `tiswarm.report.run_data.RunData`, whose `summary` has a row for each
    sweep point and condition, and returns a figure of matplotlib.

    Args:
        name: Name of the figure and of its file.
        caption: What it shows, in sentences.

    Raises:
        InputError: the name is taken.
    """

    def add(draw: _Draw) -> _Draw:
        register("figure", name, PluginFigure(name, caption, draw), draw)
        return draw

    return add


def draw_figures(run: RunData, progress: Progress, *, vector: bool = False) -> list[Path]:
    """Draw every figure of a run into `figures/`, as PNG, as SVG and, if wanted, as PDF too.

    Cases that failed are left out, and a note on each figure states their number. An existing PDF
    is redrawn.

    Returns:
        The files written; empty where no case is done.
    """
    written = []
    drawings = drawings_of(run)
    if not drawings:
        progress.info("no figures: no case is done")
    for name, drawing in drawings.items():
        figure = drawing.draw()
        for suffix, encode in (
            ("png", figure_style.png),
            ("pdf", figure_style.pdf),
            ("svg", figure_style.svg),
        ):
            path = run.subfolder("figures") / f"{name}.{suffix}"
            if suffix != "pdf" or vector or path.exists():
                write_bytes(path, encode(figure))
                progress.info(f"figures/{path.name}")
                written.append(path)
    return written


def find_drawing(run: RunData, name: str) -> figure_style.Drawable:
    """Return what draws a figure of a run.

    Raises:
        InputError: the run has no figure of that name; lists those that it has.
    """
    drawings = drawings_of(run)
    if name not in drawings:
        choice = f"; choose one of {', '.join(drawings)}" if drawings else ""
        problem = f"there is no figure {name!r}{choice}{did_you_mean(name, [*drawings])}"
        raise InputError(problem, argument="name")
    return drawings[name]


def drawings_of(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figures that a run has, by file name; none if no case is done."""
    drawings: dict[str, figure_style.Drawable] = {}
    for module in _modules() if run.series else ():
        drawings |= module.painters(run)
    return drawings


def _modules() -> Iterator[Any]:
    """Import what draws figures."""
    return (get("figure", name) for name in names("figure"))


def caption_of(name: str, case: str = "", *, few: bool = False) -> str:
    """Describe a picture by the longest part of its name that has a caption.

    The rest of the name is a sweep point or a case; without a rest, the picture shows `case`. Few
    structures have no intervals, so that the caption names none.
    """
    captions: dict[str, figure_style.Caption] = {}
    for module in _modules():
        captions |= module.CAPTIONS
    keys = [key for key in captions if f"{name}-".startswith(f"{key}-")]
    figure_name = max(keys, key=len, default="")
    rest = name.removeprefix(figure_name).strip("-")
    if case and not rest:
        shown = f"Case {case}."
    elif figure_name and rest:
        shown = f"Shown: {rest}."
    else:
        shown = rest
    text = captions[figure_name].words(few=few) if figure_name else ""
    return " ".join(filter(None, [text, shown]))
