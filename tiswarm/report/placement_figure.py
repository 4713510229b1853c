"""Draws how measurements narrow the places that one robot may have: a column for each."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.records.io import write_bytes
from tiswarm.report import figure_style
from tiswarm.report.figure_style import ESTIMATE_ORANGE, PAGE_WIDTH, TRUE_BLUE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_POINTS = 3_000
_VIEWS = {"from the side": (0, 2), "from above": (0, 1)}
_MARGIN = 1.0
_MOST_COLUMNS = 8


class Panel(NamedTuple):
    """A column of the figure."""

    title: str
    places: Reals
    """Places that remain [R], shape (n, 3)."""


def write_placement(path: Path, panels: Sequence[Panel], center: Reals, docks: Reals) -> None:
    """Write the figure, as vectors if the name ends in .pdf; arguments of `draw_placement`.

    Raises:
        InputError: the name ends in neither .png nor .pdf.
    """
    from matplotlib import style

    if path.suffix not in {".png", ".pdf"}:
        raise InputError(f"{path.name!r} should end in .png or .pdf; rename it", argument="out")
    encode = figure_style.pdf if path.suffix == ".pdf" else figure_style.png
    with style.context(["default", figure_style.STYLE]):
        write_bytes(path, encode(draw_placement(panels, center, docks)))


def draw_placement(panels: Sequence[Panel], center: Reals, docks: Reals) -> "Figure":
    """Draw the places that remain after each measurement, seen from two sides.

    Args:
        panels: One for each measurement.
        center: Where the robot was estimated to be [R], shape (3,).
        docks: Centers of the docks of robots that joined earlier [R], shape (n, 3).
    """
    panels = panels[:_MOST_COLUMNS]
    height = 0.6 + len(_VIEWS) * PAGE_WIDTH / max(len(panels), 4)
    figure = new_figure(PAGE_WIDTH, height)
    middle = panels[0].places.mean(axis=0)
    half = abs(panels[0].places - middle).max() + _MARGIN
    near = docks[(abs(docks - middle) <= half + 1.0).all(axis=1)]
    limits = np.column_stack([middle - half, middle + half])
    axes = figure.subplots(len(_VIEWS), len(panels), squeeze=False)
    for row, (title, view) in zip(axes, _VIEWS.items(), strict=True):
        for column, panel in zip(row, panels, strict=True):
            _draw(column, panel.places[:, view], center[[*view]], near[:, view])
            column.set(xlim=limits[view[0]], ylim=limits[view[1]], aspect="equal")
            column.set_xticks([])
            column.set_yticks([])
        row[0].set_ylabel(title)
    for column, panel in zip(axes[0], panels, strict=True):
        column.set_title(panel.title.replace(" of ", "\nof "), fontsize=7.0)
    return figure


def _draw(axes: "Axes", places: Reals, center: Reals, docks: Reals) -> None:
    """Draw docks as circles, remaining places as points, and the estimate, all in one plane."""
    from matplotlib.collections import EllipseCollection

    size = np.full(len(docks), 2.0)
    circles = EllipseCollection(
        size, size, np.zeros(len(docks)), units="xy", offsets=docks,
        offset_transform=axes.transData, facecolor="0.93", edgecolor="0.75", linewidth=0.3,
    )  # fmt: skip
    axes.add_collection(circles)
    some = np.random.default_rng(0).permutation(places)[:_MOST_POINTS]
    area = float(np.clip(2000.0 / max(len(some), 1), 0.5, 6.0))
    x, y = some.T
    axes.scatter(x, y, s=area, color=TRUE_BLUE, linewidths=0.0, rasterized=True)
    axes.plot(*center, "+", color=ESTIMATE_ORANGE, markersize=6.0)
