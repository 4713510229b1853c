"""The figure of `table.csv`: accuracy under each condition, beside published numbers."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.report.canvas import PAGE_WIDTH, PALETTE, add_note, new_figure, shortened
from tiswarm.report.folder import read_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE = "table.csv"
MAX_ROWS = 60
MARKERS = "osD^vPX"
PANELS = (
    ("rmse_R", "paper_rmse_radii", "RMSE [R]"),
    ("procrustes_disparity", "paper_procrustes_disparity", "Procrustes disparity"),
)
"""Measure, its published counterpart, and what stands below the axis."""


def has_table(folder: Path) -> bool:
    """Whether a run has means by condition."""
    return (folder / FILE).is_file()


def draw_accuracy(folder: Path, note: str) -> "Figure":
    """Draw means over structures with 95 % confidence intervals, a row a condition.

    Points of the sweep share a row and differ in color and marker. Open markers are published
    numbers, whose unit of length is not defined.

    Raises:
        InputError: where the table is damaged.
    """
    table = read_table(
        folder / FILE, ["condition", "cases", *(published for _, published, _ in PANELS)]
    )
    swept = list(table.columns[1 : table.columns.get_loc("cases")])
    told = [f"{name}=" + table[name].astype(str) for name in swept]
    points = pd.Series([shortened(", ".join(point)) for point in zip(*told, strict=True)])
    points = points if swept else pd.Series("", table.index)
    names = list(dict.fromkeys(table["condition"]))
    shown = list(dict.fromkeys(points))[: max(1, MAX_ROWS // len(names))]
    figure = new_figure(PAGE_WIDTH, 0.9 + 0.12 * len(names) * (1 + len(shown)))
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for axes, (measure, published, label) in zip(panels, PANELS, strict=True):
        for index, point in enumerate(shown):
            rows = table[points == point].set_index("condition").reindex(names)
            place = np.arange(len(names)) + (index - 0.5 * (len(shown) - 1)) / (1 + len(shown))
            look = {
                "color": PALETTE[index % len(PALETTE)],
                "marker": MARKERS[index % len(MARKERS)],
                "linestyle": "",
                "markersize": 3.5,
            }
            spread = rows[f"{measure}_ci95"].fillna(0.0)
            axes.errorbar(
                rows[f"{measure}_mean"], place, xerr=spread, label=point or "mean", **look
            )
            axes.plot(rows[published], place, markerfacecolor="white", **look)
        axes.set_xlabel(label)
        axes.set_xlim(left=0.0)
        axes.grid(axis="y", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
    panels[0].set_yticks(np.arange(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    if table[[published for _, published, _ in PANELS]].notna().any(axis=None):
        panels[0].plot(
            [],
            [],
            "o",
            color="0.35",
            markerfacecolor="white",
            markersize=3.5,
            label="published (robot radii)",
        )
    if len(shown) > 1:
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=4)
    left = len(set(points)) - len(shown)
    notes = [f"{left} more points are in {FILE}" if left else "", note]
    add_note(figure, "; ".join(text for text in notes if text))
    return figure
