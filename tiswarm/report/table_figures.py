"""Draws the figures with a row for each of a table: accuracy, shapes and the comparison of runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.base.progress import Progress
from tiswarm.records import outputs
from tiswarm.records.frames import read_frame
from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.comparison import FEWEST
from tiswarm.report.figure_style import (
    PAGE_WIDTH,
    Painter,
    add_legend,
    entries_of,
    fit_axis,
    label_rows,
    marker_style,
    new_panels,
    shortened,
)
from tiswarm.report.run_data import RunData, swept_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MEASURES = {
    "rmse_R": ("RMSE [R]", "paper_rmse_radii"),
    "procrustes_disparity": ("Procrustes disparity", "paper_procrustes_disparity"),
}
"""Axis label and published counterpart of each measure."""

_LABELS = [label for label, _ in _MEASURES.values()]
_DRAWN = [f"{measure}_{statistic}" for measure in _MEASURES for statistic in ("mean", "ci95")]

_PUBLISHED = "published (robot radii)"

_MOST_ROWS = 60

_SHAPE_PANELS = {
    "rmse_R": "RMSE [R]",
    "floppy_modes": "Floppy modes",
    "contacts_per_robot": "Contacts per robot",
    "height_R": "Height [R]",
}


def table_painters(run: RunData) -> dict[str, Painter]:
    """List the figures of `table.csv` that a run has, by file name."""
    if not (run.folder / "table.csv").is_file():
        return {}
    shape = {"shape": draw_shape} if run.sweeps_robot else {}
    return {"accuracy": draw_accuracy, **shape}


def draw_accuracy(run: RunData, most: float = np.inf) -> "Figure":
    """Draw means over structures, a row a condition, with 95 % confidence intervals.

    Of few structures, each is drawn instead of the interval. Points of the sweep share a row and
    differ in color and marker. Open markers are published numbers, whose unit of length is not
    defined.
    """
    published = [column for _, column in _MEASURES.values()]
    table = run.table("table.csv", ["condition"], ["cases", *published, *_DRAWN], after="cases")
    swept = swept_words(table).drop(columns="condition")
    values = [zip(swept.columns, row, strict=True) for row in swept.to_numpy().tolist()]
    table["point"] = [", ".join(f"{key}={value}" for key, value in row) for row in values]
    names = list(dict.fromkeys(table["condition"]))
    points = list(dict.fromkeys(table["point"]))
    shown = points[: max(1, _MOST_ROWS // len(names))]
    few = table["cases"].max() < FEWEST
    height = 0.9 + 0.12 * len(names) * (1 + len(shown))
    figure, panels = new_panels(
        PAGE_WIDTH, height, len(_MEASURES), len(_MEASURES), share="y", most=most
    )
    for axes, (measure, (_, counterpart)) in zip(panels, _MEASURES.items(), strict=True):
        for index, point in enumerate(shown):
            rows = table[table["point"] == point].set_index("condition").reindex(names)
            place = np.arange(len(names)) + (index - 0.5 * (len(shown) - 1)) / (1 + len(shown))
            look = {**marker_style(index), "linestyle": "", "markersize": 3.5}
            mean, ci95 = rows[f"{measure}_mean"], rows[f"{measure}_ci95"].fillna(0.0)
            error = None if few else ci95
            axes.errorbar(mean, place, xerr=error, label=shortened(point) or "mean", **look)
            axes.plot(rows[counterpart], place, markerfacecolor="white", **look)
            if few:
                each = _each_structure(run, measure, point)
                rows_of = [names.index(condition) for condition in each.index]
                axes.plot(each, place[rows_of], **{**look, "markersize": 1.8, "alpha": 0.6})
    _finish_rows(panels, names, _LABELS)
    if table[published].notna().any(axis=None):
        panels[0].plot(
            [], [], "o", color="0.35", markerfacecolor="white", markersize=3.5,
            label=_PUBLISHED,
        )  # fmt: skip
    entries = entries_of(panels[:1])
    if _PUBLISHED in entries:  # matplotlib lists lines before error bars
        entries[_PUBLISHED] = entries.pop(_PUBLISHED)
    number = counted(int(table["cases"].max()), "structure")
    title = f"mean, and each of {number} (small)" if few else f"mean and 95 % CI, {number}"
    add_legend(figure, entries, title, loc="outside upper right")
    more = figure_style.left_out(len(points) - len(shown), "table.csv")
    figure_style.add_note(figure, more, run.note)
    return figure


def _each_structure(run: RunData, measure: str, point: str) -> "pd.Series[float]":
    """Take a measure of each case of a sweep point that is done, by condition."""
    cases = run.summary.reindex(columns=["condition", "point", "status", measure])
    points = cases["point"].fillna("").replace(r"[{}]", "", regex=True)
    done = (cases["status"] == "done") & (points == point)
    return cases[done].set_index("condition")[measure]


def draw_comparison(folder: Path, progress: Progress, *, overwrite: bool = False) -> None:
    """Draw `comparison.png` beside the table that it shows: a row for each of its first rows."""
    from matplotlib import style

    table = read_frame(folder / "comparison.csv", ["run", "condition"], gaps=["cases", *_DRAWN])
    with style.context(["default", figure_style.STYLE]):
        data = figure_style.png(draw_rows(table))
    outputs.write(folder / "comparison.png", data, overwrite=overwrite)
    progress.info("comparison.png")


def draw_rows(table: pd.DataFrame) -> "Figure":
    """Draw the mean of each row with its confidence interval, one color a run."""
    shown = table.head(_MOST_ROWS)
    words = swept_words(shown).iloc[:, ::-1].iloc[:, :-1]
    words = words.where(shown[words.columns].notna(), "")
    labels = [", ".join(filter(None, row)) for row in words.to_numpy()]
    height = 0.9 + 0.17 * len(shown)
    figure, panels = new_panels(PAGE_WIDTH, height, len(_MEASURES), len(_MEASURES), share="y")
    for axes, name in zip(panels, _MEASURES, strict=True):
        for index, run in enumerate(shown["run"].unique()):
            rows = (shown["run"] == run).to_numpy()
            axes.errorbar(
                shown.loc[rows, f"{name}_mean"], np.flatnonzero(rows),
                xerr=shown.loc[rows, f"{name}_ci95"].fillna(0.0), fmt="o", markersize=3.5,
                color=marker_style(index)["color"], label=run, linewidth=1.0,
            )  # fmt: skip
    _finish_rows(panels, labels, _LABELS)
    add_legend(figure, entries_of(panels[:1]), "mean and 95 % CI", loc="outside upper right")
    left = len(table) - len(shown)
    figure_style.add_note(figure, f"{left} more rows are in comparison.csv" if left else "")
    return figure


def draw_shape(run: RunData, most: float = np.inf) -> "Figure":
    """Draw accuracy and structure by the robots' shape: a row for each point of the sweep.

    Conditions differ in color and marker; where all are equal, gray stands for all.
    """
    numbers = [f"{name}_{statistic}" for name in _SHAPE_PANELS for statistic in ("mean", "ci95")]
    table = run.table("table.csv", ["condition"], ["cases", *numbers], after="cases")
    words = swept_words(table).drop(columns="condition")
    table["point"] = words.agg(", ".join, axis=1)
    points = list(dict.fromkeys(table["point"]))
    shown = points[:_MOST_ROWS]
    series = dict(list(table.groupby("condition", sort=False)))
    figure, panels = new_panels(
        PAGE_WIDTH, 0.9 + 0.17 * len(shown), len(_SHAPE_PANELS), 4, share="y", most=most
    )
    for axes, name in zip(panels, _SHAPE_PANELS, strict=True):
        alike = table.groupby("point")[f"{name}_mean"].nunique().max() <= 1
        for index, (condition, rows) in enumerate(series.items()):
            look = {**marker_style(index), "linestyle": "", "markersize": 3.0, "linewidth": 0.8}
            look |= {"color": "0.4", "marker": "o"} if alike else {}
            part = rows.set_index("point").reindex(shown)
            axes.errorbar(
                part[f"{name}_mean"], np.arange(len(shown)), label=condition,
                xerr=part[f"{name}_ci95"].fillna(0.0), **look,
            )  # fmt: skip
    _finish_rows(panels, shown, [*_SHAPE_PANELS.values()])
    for axes, name in list(zip(panels, _SHAPE_PANELS, strict=True))[1:]:
        end = (table[f"{name}_mean"] + table[f"{name}_ci95"].fillna(0.0)).max()
        top = float(np.nan_to_num(end)) or 1.0
        axes.set(xscale="linear", xlim=(-0.04 * top, 1.08 * top))  # there may be no floppy mode
    for axes in panels:
        axes.tick_params(axis="x", labelsize=6.0)
    meaning = f"{', '.join(map(str, words))}; mean and 95 % CI"
    structures = int(table["cases"].max())
    figure_style.add_key(figure, panels[0], meaning, structures, loc="outside upper right")
    more = figure_style.left_out(len(points) - len(shown), "table.csv")
    figure_style.add_note(figure, more, run.note)
    return figure


def _finish_rows(panels: "list[Axes]", names: Sequence[str], labels: Sequence[str]) -> None:
    """Label rows, from the top, and axes."""
    for axes, label in zip(panels, labels, strict=True):
        axes.set_xlabel(label)
        means = np.concatenate([np.asarray(line.get_xdata(), float) for line in axes.lines])
        axes.locator_params(axis="x", nbins=6)
        fit_axis(axes, "x", means, nonpositive="clip")
        axes.grid(axis="y", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
    label_rows(panels[0], names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
