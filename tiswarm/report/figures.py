"""Draws the figures of a run; each kind is a module of its own."""

from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.base.errors import InputError
from tiswarm.base.parts import load
from tiswarm.base.progress import Progress
from tiswarm.records import outputs
from tiswarm.records.messages import did_you_mean
from tiswarm.report import figure_style
from tiswarm.report.figure_style import (
    COLUMN_WIDTH,
    NARROW,
    Painter,
    is_narrow,
    pdf,
    png,
    svg,
)
from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FORMS = ("png", "pdf", "svg")

FIGURES = (
    "tiswarm.report.error_figures:error_painters",
    "tiswarm.report.building_figure:building_painters",
    "tiswarm.report.joining_figure:joining_painters",
    "tiswarm.report.traffic_figure:traffic_painters",
    "tiswarm.report.curve_figures:scaling_painters",
    "tiswarm.report.grade_figure:grade_painters",
    "tiswarm.report.table_figures:table_painters",
    "tiswarm.report.suite_figure:suite_painters",
    "tiswarm.report.curve_figures:round_painters",
    "tiswarm.report.curve_figures:profile_painters",
)
"""Functions of a run that return, by file name, the functions that draw figures which it has."""


def draw_figures(run: RunData, progress: Progress, *, vector: bool = False) -> list[Path]:
    """Draw every figure of a run into `figures/`, as PNG, as SVG and, if wanted, as PDF too.

    A second SVG of a wide figure is drawn as wide as a column, for narrow screens.
    Cases that failed are left out, and a note on each figure states their number. A figure of an
    earlier call that the run no longer has is removed, but no other file; an existing PDF is
    redrawn.

    Returns:
        The files written; empty where no case is done.
    """
    from matplotlib import style

    written = []
    painters = painters_of(run) if run.series else {}
    if not painters:
        progress.info("no figures: no case is done")
    with style.context(["default", figure_style.STYLE]):
        for name, draw in painters.items():
            figure = draw(run)
            for suffix, encode in (("png", png), ("pdf", pdf), ("svg", svg)):
                path = run.subfolder("figures") / f"{name}.{suffix}"
                if suffix != "pdf" or vector or path.exists():
                    outputs.write_own(path, encode(figure))
                    progress.info(f"figures/{path.name}")
                    written.append(path)
            if not is_narrow(figure):
                path = run.subfolder("figures") / f"{name}{NARROW}.svg"
                outputs.write_own(path, svg(draw(run, COLUMN_WIDTH)))
                written.append(path)
    folder = run.folder / "figures"
    for path in {path for form in _FORMS for path in folder.glob(f"*.{form}")} - {*written}:
        if outputs.is_own(path):
            path.unlink(missing_ok=True)
    return written


def draw_figure(run: RunData, name: str) -> "Figure":
    """Draw one figure of a run, to be changed and saved by the caller.

    Raises:
        InputError: the run has no figure of that name; lists those that it has.
    """
    from matplotlib import style

    painters = painters_of(run) if run.series else {}
    if name not in painters:
        some = f"; choose one of {', '.join(painters)}" if painters else ""
        problem = f"there is no figure {name!r}{some}{did_you_mean(name, [*painters])}"
        raise InputError(problem, argument="name")
    with style.context(["default", figure_style.STYLE]):
        return painters[name](run)


def painters_of(run: RunData) -> dict[str, Painter]:
    """List the figures that a run has, by file name."""
    painters: dict[str, Painter] = {}
    for place in FIGURES:
        painters |= load(place, "a figure")(run)
    return painters
