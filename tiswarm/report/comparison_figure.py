"""The figure of runs side by side, drawn from `comparison.csv`."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.records.atomic import write_bytes
from tiswarm.report.canvas import PAGE_WIDTH, PALETTE, STYLE, add_note, new_figure, png
from tiswarm.report.folder import Tell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ROWS = 60
PANELS = {"rmse_R": "RMSE [R]", "procrustes_disparity": "Procrustes disparity"}


def draw_comparison(folder: Path, tell: Tell) -> Path:
    """Draw `comparison.png` beside the table that it shows."""
    from matplotlib import style

    path = folder / "comparison.png"
    with style.context(["default", STYLE]):
        write_bytes(path, png(comparison_figure(pd.read_csv(folder / "comparison.csv"))))
    tell(path.name)
    return path


def comparison_figure(table: pd.DataFrame) -> "Figure":
    """Draw the mean of each row with its confidence interval, one color a run."""
    shown = table.head(MOST_ROWS)
    swept = list(table.columns[1 : table.columns.get_loc("cases")])
    labels = [
        ", ".join(str(row[name]) for name in reversed(swept) if not pd.isna(row[name]))
        for row in shown.to_dict("records")
    ]
    figure = new_figure(PAGE_WIDTH, 0.9 + 0.17 * len(shown))
    panels = figure.subplots(1, len(PANELS), sharey=True)
    place = np.arange(len(shown))
    for axes, (name, label) in zip(panels, PANELS.items(), strict=True):
        for index, run in enumerate(shown["run"].unique()):
            rows = (shown["run"] == run).to_numpy()
            axes.errorbar(
                shown.loc[rows, f"{name}_mean"], place[rows],
                xerr=shown.loc[rows, f"{name}_ci95"].fillna(0.0), fmt="o", markersize=3.5,
                color=PALETTE[index % len(PALETTE)], label=run, linewidth=1.0,
            )  # fmt: skip
        axes.set_xlim(left=0.0)
        axes.set(xlabel=label)
        axes.grid(axis="y", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
    panels[0].set_yticks(place, labels)
    panels[0].set_ylim(len(shown) - 0.5, -0.5)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    note = "mean and 95 % confidence interval"
    if len(shown) < len(table):
        note += f"; {len(table) - len(shown)} more rows are in comparison.csv"
    add_note(figure, note)
    return figure
