"""Draws the figure of sensor suites: price against error."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.records.measures import RMSE
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, with_points
from tiswarm.report.series import suite_words, way_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PRICE = "usd_100"
_ERROR = RMSE.mean
_HALF = RMSE.ci95
_CHEAPEST = 200.0  # price up to which the axis is linear: some sensors cost nothing [USD]
_MOST_PANELS = 4
_LINE = 0.031  # height of a letter of a label [share of the panel]
_LETTER = 0.0185  # width of a letter of a label [share of the panel]
_MARKER = 0.014  # half the width of a marker [share of the panel]


CAPTIONS = {
    "price-and-error": figure_style.Caption(
        "Mean RMSE of all robots against the price of the sensors of 100 robots and "
        "of what they need around them, if the paper's Table I states it; below 200 "
        "USD the axis is linear. Each marker is a suite, its color and shape the way "
        "in which robots localize.",
        intervals="Bars are 95 % CI.",
        reading="Farther left and lower is better.",
    ),
}
"""What the figures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figure of suites by file name, if a run has some."""
    return {"price-and-error": suites_drawing(run)} if (run.folder / "suites.csv").is_file() else {}


def suites_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of RMSE of all robots against the price of 100 robots.

    Each point of a sweep has a panel.
    """
    gaps = ["cases", _PRICE, _ERROR, _HALF]
    table = run.table("suites.csv", ["condition", "suite", "way"], gaps, after="cases")
    table = table[table["cases"] > 0]
    table[_HALF] = table[_HALF].fillna(0.0)
    table = table.assign(suite=table["suite"].map(suite_words), way=table["way"].map(way_words))
    pointed = with_points(table)
    points = list(dict.fromkeys(pointed["point"]))
    shown = points[:_MOST_PANELS]
    ways = list(dict.fromkeys(table["way"]))

    def paint(axes: "Axes", point: str, series: Sequence[str]) -> None:
        figure_style.fit_axis(axes, "y", table[_ERROR].to_numpy(float))
        axes.set_xscale("symlog", linthresh=_CHEAPEST, linscale=0.4)
        figure_style.label_plainly(axes.xaxis)
        axes.set_xlim(-0.3 * _CHEAPEST, 4.0 * table[_PRICE].max())
        axes.set_ylim(0.5 * table[_ERROR].min(), 1.6 * (table[_ERROR] + table[_HALF]).max())
        rows = pointed[(pointed["point"] == point) & pointed["way"].isin(series)]
        draw_suites(axes, rows, ways)
        figure_style.set_title(axes, point)
        axes.set_xlabel("Price of 100 robots [USD]")

    def complete(panels: figure_style.Panels) -> list[str]:
        panels.label_left("RMSE of all robots [R]")
        words = figure_style.mean_words(table["cases"])
        panels.legend(words, panels.entries())
        omitted = len(points) - len(shown)
        return [figure_style.omission_note(omitted, "sweep point", "in suites.csv"), run.note]

    return figure_style.Drawing(
        panels=shown, series=ways, paint=paint, complete=complete, columns=min(2, len(shown)),
        row_height=4.4, head_height=0.6, share="xy", alone=figure_style.PAGE_WIDTH,
    )  # fmt: skip


def draw_suites(axes: "Axes", rows: pd.DataFrame, ways: list[str]) -> None:
    """Draw a marker for each suite and way, and the name of the suite beside it."""
    price = rows[_PRICE].to_numpy(float)
    error = rows[_ERROR].to_numpy(float)
    for index, way in enumerate(ways):
        is_way = (rows["way"] == way).to_numpy()
        if not is_way.any():
            continue
        axes.errorbar(
            price[is_way],
            error[is_way],
            yerr=rows.loc[is_way, _HALF],
            label=way,
            elinewidth=0.6,
            **figure_style.dot_style(index, 4.0),
        )
    anchors = (axes.transScale + axes.transLimits).transform(np.column_stack([price, error]))
    names = rows["suite"].tolist()
    colors = [figure_style.marker_style(ways.index(way))["color"] for way in rows["way"]]
    for name, color, anchor, y in zip(
        names, colors, anchors, _heights(names, anchors), strict=True
    ):
        axes.annotate(
            name,
            anchor,
            (anchor[0] + _MARKER, y),
            xycoords="axes fraction",
            textcoords="axes fraction",
            va="center",
            color=color,
            arrowprops={"arrowstyle": "-", "linewidth": 0.3, "color": color, "shrinkA": 0.0},
        )


def _heights(names: list[str], anchors: Reals) -> list[float]:
    """Choose the height of each label: the one nearest to its marker where it hides nothing.

    Lengths are shares of the panel; `anchors` are the markers' places, shape (n, 2).
    """
    taken = [(x - _MARKER, x + _MARKER, y) for x, y in anchors.tolist()]
    heights = dict.fromkeys(range(len(names)), 0.0)
    for index in np.argsort(anchors[:, 1], kind="stable").tolist():
        x, y = anchors[index].tolist()
        start = x + _MARKER
        end = start + _LETTER * len(names[index])
        steps = sorted(range(-len(taken), len(taken) + 1), key=abs)
        free = (
            height
            for height in (y + _LINE * step for step in steps)
            if height > 0.5 * _LINE
            and not any(
                start < taken_end and taken_start < end and abs(height - taken_height) < _LINE
                for taken_start, taken_end, taken_height in taken
            )
        )
        heights[index] = next(free, y)
        taken.append((start, end, heights[index]))
    return [*heights.values()]
