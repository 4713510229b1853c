"""Draws an estimate beside the truth: the error of each robot, and where both are."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.records import outputs
from tiswarm.report import figure_style
from tiswarm.report.figure_style import ESTIMATE_ORANGE, PAGE_WIDTH, TRUE_BLUE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHT = 5.2
"""Height of the figure [inch]."""

_MOST_MARKS = 300
"""Robots up to which each error has a mark, and positions have large ones."""

_VIEWS = {"from the side": (0, 2), "from above": (0, 1)}
"""Axes of each view, across and upward."""


def write_score(
    path: Path,
    true: Reals,
    estimated: Reals,
    errors: Mapping[str, Reals],
    unit: str,
    *,
    overwrite: bool = False,
) -> None:
    """Write the figure of a score, as vectors if the name ends in .pdf; arguments of `draw_score`.

    Raises:
        InputError: the name ends in neither .png nor .pdf, or another file has it.
    """
    from matplotlib import style

    if path.suffix not in {".png", ".pdf"}:
        raise InputError(f"{path.name!r} should end in .png or .pdf; rename it", argument="out")
    encode = figure_style.pdf if path.suffix == ".pdf" else figure_style.png
    with style.context(["default", figure_style.STYLE]):
        data = encode(draw_score(true, estimated, errors, unit))
    outputs.write(path, data, overwrite=overwrite)


def draw_score(true: Reals, estimated: Reals, errors: Mapping[str, Reals], unit: str) -> "Figure":
    """Draw errors along the join order, and truth and estimate seen from two sides.

    Args:
        true: True centers in join order [unit], shape (N, 3).
        estimated: Estimated centers [unit], shape (N, 3).
        errors: Errors of the robots [unit] by the way of alignment, each of shape (N,).
        unit: Unit of lengths.
    """
    figure = new_figure(PAGE_WIDTH, _HEIGHT)
    grid = figure.add_gridspec(2, len(_VIEWS), height_ratios=[1, 2])
    _draw_errors(figure.add_subplot(grid[0, :]), errors, unit)
    for column, (title, view) in enumerate(_VIEWS.items()):
        axes = figure.add_subplot(grid[1, column])
        _draw_view(axes, true[:, view], estimated[:, view])
        across, upward = (f"{'xyz'[axis]} [{unit}]" for axis in view)
        axes.set(xlabel=across, ylabel=upward, title=title)
    return figure


def _draw_errors(axes: "Axes", errors: Mapping[str, Reals], unit: str) -> None:
    """Draw the error of each robot, with the RMSE."""
    for color, (name, error) in zip((ESTIMATE_ORANGE, TRUE_BLUE), errors.items(), strict=True):
        mark = "." if len(error) <= _MOST_MARKS else ""
        label = f"{name}: RMSE {np.sqrt((error**2).mean()):.3g} {unit}"
        axes.plot(error, marker=mark, color=color, linewidth=0.8, label=label)
    axes.set(xlabel="robot, in join order", ylabel=f"error [{unit}]")
    axes.set_ylim(0.0, None)
    axes.margins(x=0.01)
    axes.legend(loc="upper left")


def _draw_view(axes: "Axes", true: Reals, estimated: Reals) -> None:
    """Draw true positions with lines to the estimated ones, both of shape (N, 2)."""
    size = 3.0 if len(true) <= _MOST_MARKS else 1.0
    ends = np.stack([true, estimated, np.full_like(true, np.nan)], axis=1).reshape(-1, 2)
    axes.plot(*ends.T, color="0.55", linewidth=0.6, label="error")
    for position, color, name in (
        (true, TRUE_BLUE, "truth"),
        (estimated, ESTIMATE_ORANGE, "estimate"),
    ):
        axes.plot(*position.T, "o", color=color, markersize=size, linestyle="", label=name)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best")
