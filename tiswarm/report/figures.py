"""Draws the figures of a run; each kind is a module of its own."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.base.parts import load
from tiswarm.base.progress import Progress
from tiswarm.records.io import write_bytes
from tiswarm.report import figure_style
from tiswarm.report.figure_style import pdf, png
from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = (
    "tiswarm.report.error_figures:error_painters",
    "tiswarm.report.curve_figures:scaling_painters",
    "tiswarm.report.table_figures:table_painters",
    "tiswarm.report.suite_figure:suite_painters",
    "tiswarm.report.curve_figures:round_painters",
    "tiswarm.report.curve_figures:profile_painters",
)
"""Functions of a run that return, by file name, the functions that draw figures which it has."""


def draw_figures(run: RunData, progress: Progress, *, vector: bool = False) -> list[Path]:
    """Draw every figure of a run into `figures/`, as PNG and, if wanted, as vector PDF too.

    Cases that failed are left out, and a note on each figure states their number. A figure of an
    earlier call that the run no longer has is removed; an existing PDF is redrawn.

    Returns:
        The files written; empty where no case is done.
    """
    from matplotlib import style

    written = []
    painters = _painters(run) if run.series else {}
    if not painters:
        progress.info("no figures: no case is done")
    for name, draw in painters.items():
        with style.context(["default", figure_style.STYLE]):
            figure = draw(run)
            for suffix, encode in (("png", png), ("pdf", pdf)):
                path = run.subfolder("figures") / f"{name}.{suffix}"
                if suffix == "png" or vector or path.exists():
                    write_bytes(path, encode(figure))
                    progress.info(f"figures/{path.name}")
                    written.append(path)
    folder = run.folder / "figures"
    for path in {*folder.glob("*.png"), *folder.glob("*.pdf")} - {*written}:
        if not path.is_dir():
            path.unlink()
    return written


def _painters(run: RunData) -> dict[str, Callable[[RunData], "Figure"]]:
    """List the figures that a run has, by file name."""
    painters: dict[str, Callable[[RunData], Figure]] = {}
    for place in FIGURES:
        painters |= load(place, "a figure")(run)
    return painters
