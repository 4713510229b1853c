"""Draws the figures of `table.csv` and `summary.csv`.

They have a row or a marker for each condition: accuracy, structures and shapes.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.records.measures import (
    BROKEN,
    BUILT_FOR,
    CONTACTS,
    FEWEST,
    FLOPPY_MODES,
    HEIGHT,
    MAIN,
    OF_LOCATED,
    RMSE,
    STANDING,
    Measure,
)
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, joined_words, with_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_PUBLISHED = "published (robot radii)"

MOST_ROWS = 60
"""Rows that a figure shows at most."""

_ROOM = 0.12  # height of a marker [inch]
_MANY = 24  # markers beyond which they have less

_OF_SHAPES = (RMSE, FLOPPY_MODES, CONTACTS, HEIGHT)

_MOST_PANELS = 3

CAPTIONS = {
    "accuracy": figure_style.Caption(
        "Errors of each condition, and point of the sweep: mean RMSE and mean "
        "Procrustes disparity over the structures, or, where not all robots are located, the RMSE "
        "of all robots, the share of those that are located, and their RMSE.",
        intervals="Bars are 95 % CI.",
        reading=(
            "Hollow markers, where there are any, are published numbers. Errors farther left are "
            "better."
        ),
    ),
    "structures": figure_style.Caption(
        "Structures of each condition, and point of the sweep: what they were built for, robots "
        "that stand and contacts that broke, in the mean over the structures.",
        intervals="Bars are 95 % CI.",
    ),
    "shape": figure_style.Caption(
        "Accuracy and structure by the robots: mean RMSE, floppy modes (motions that "
        "change no measurement in use), contacts with earlier robots, and height of "
        "the structure.",
        intervals="Bars are 95 % CI.",
        reading="Gray stands for all conditions.",
    ),
}
"""What the figures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figures that a run has, by file name."""
    if not (run.folder / "table.csv").is_file():
        return {}
    if run.is_of_engine:
        return {}
    if run.has_structures_alone:
        return {"structures": structures_drawing(run)} if _of_structures(run) else {}
    shape = {"shape": shape_drawing(run)} if run.sweeps_robot else {}
    return {"accuracy": accuracy_drawing(run), **shape}


def _of_structures(run: RunData) -> list[Measure]:
    """Choose the measures of structures that differ, or what they are built for alone."""
    kinds = {case.kind for case in run.cases if case.done}
    aims = [measure for kind, measure in BUILT_FOR.items() if kind in kinds] or [HEIGHT]
    done = run.summary[run.summary["status"] == "done"]
    others = [
        measure
        for measure in (STANDING, BROKEN, CONTACTS)
        if measure.column in done and len({*done[measure.column]}) > 1
    ]
    return [*aims, *others][:_MOST_PANELS] if len(done) else []


def structures_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of what structures were built for, who stands and what broke."""
    return _means_drawing(run, _of_structures(run))


def accuracy_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of accuracy; open markers are the paper's numbers.

    Where not all robots are located, it has RMSE of all robots, and share and RMSE of the located
    ones, as the first table has.
    """
    return _means_drawing(run, OF_LOCATED if run.has_guesses else MAIN)


def _means_drawing(run: RunData, measures: Sequence[Measure]) -> figure_style.Drawing:
    """Compose panels of means over structures with their intervals; of few structures, each one.

    Without a sweep, conditions have a row each. With one, rows are points, and conditions differ in
    color and marker; of many conditions, they have the rows. Open markers are published numbers,
    whose unit of length is not defined.
    """
    published = [measure.published for measure in measures if measure.published]
    intervals = [name for m in measures for name in (m.bounds if m.is_share else (m.ci95,))]
    numbers = ["cases", *published, *(measure.mean for measure in measures), *intervals]
    table = with_points(run.table("table.csv", ["condition"], numbers, after="cases"))
    keys = _rows_and_series(table)
    row_names, series_names = (joined_words(table, columns) for columns in keys)
    table = table.assign(row=row_names, of=series_names)
    series = list(dict.fromkeys(series_names))
    names = list(dict.fromkeys(row_names))
    shown = names[: max(1, MOST_ROWS // len(series))]
    few = table["cases"].max() < FEWEST
    by_column = {measure.column: measure for measure in measures}

    def paint(axes: "Axes", column: str, chosen: Sequence[str]) -> None:
        draw_means(axes, table, by_column[column], shown, chosen)
        if few:
            _draw_structures(axes, run, column, keys, shown, series)
        finish_row_axis(axes, by_column[column], shown)

    def complete(panels: figure_style.Panels) -> list[str]:
        figure_style.label_rows(panels.first, shown)
        entries = panels.entries()
        if table[published].notna().any(axis=None):
            (entries[_PUBLISHED],) = panels.first.plot([], [], "o", color="0.35", mfc="white")
        words = figure_style.mean_words(table["cases"])
        if few and table["cases"].max() > 1:
            words += "; small: each of them"
        panels.legend(words, entries, loc="outside upper right")
        return [
            figure_style.omission_note(len(names) - len(shown), "row", "in table.csv"),
            run.note,
        ]

    room = _ROOM if len(shown) * len(series) < _MANY else 0.7 * _ROOM
    return figure_style.Drawing(
        panels=list(by_column), series=series, paint=paint, complete=complete,
        columns=len(by_column), row_height=0.5 + room * len(shown) * (1 + len(series)),
        head_height=0.4, share="y",
    )  # fmt: skip


def draw_means(
    axes: "Axes", table: pd.DataFrame, measure: Measure, rows: Sequence[str], series: Sequence[str]
) -> None:
    """Draw the mean of a measure with its 95 % confidence interval, and the paper's number.

    Args:
        axes: Panel.
        table: `table.csv` with the columns `row` and `of`, the row and series of a mean.
        measure: Measure.
        rows: Names of the rows, from the top.
        series: Names of the series to draw.
    """
    looks = list(dict.fromkeys(table["of"]))
    is_shared = table.groupby("row")["of"].nunique().max() > 1
    for name in series:
        shown = table[table["of"] == name].set_index("row").reindex(list(rows))
        index = looks.index(name)
        y = _heights(len(rows), index, len(looks)) if is_shared else _heights(len(rows), 0, 1)
        look = figure_style.dot_style(index)
        axes.errorbar(
            shown[measure.mean],
            y,
            xerr=_bars(shown, measure),
            label=name or figure_style.ONLY_SERIES,
            **look,
        )
        if measure.published in shown:
            axes.plot(shown[measure.published], y, markerfacecolor="white", **look)


def _heights(rows: int, index: int, series: int) -> Reals:
    """Place the markers of a series in all rows, shape (rows,)."""
    return np.arange(rows, dtype=np.float64) + (index - 0.5 * (series - 1)) / (1 + series)


def _bars(rows: pd.DataFrame, measure: Measure) -> Reals | None:
    """Return how far intervals extend below and above means, shape (2, n); None of few cases."""
    if rows["cases"].max() < FEWEST:
        return None
    mean = rows[measure.mean]
    if measure.is_share:
        low, high = measure.bounds
        bars = np.array([mean - rows[low], rows[high] - mean])
    else:
        bars = np.array([rows[measure.ci95], rows[measure.ci95]])
    return np.nan_to_num(bars.astype(float))


def _draw_structures(
    axes: "Axes",
    run: RunData,
    column: str,
    keys: Sequence[Sequence[str]],
    rows: Sequence[str],
    series: Sequence[str],
) -> None:
    """Draw a small dot for each of few structures."""
    for index, name in enumerate(series):
        values = _structure_values(run, column, keys, name)
        values = values[values.index.isin(rows)]
        y = _heights(len(rows), index, len(series))[[rows.index(row) for row in values.index]]
        axes.plot(values, y, **figure_style.dot_style(index, 1.8), alpha=0.6)


def _rows_and_series(table: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Choose what has a row each, and what a color: at most `MOST_SERIES` of these."""
    conditions, points = (len({*table[key]}) for key in ("condition", "point"))
    if points == 1:
        return ["condition"], []
    if conditions <= figure_style.MOST_SERIES:
        return ["point"], ["condition"] if conditions > 1 else []
    if points <= figure_style.MOST_SERIES:
        return ["condition"], ["point"]
    return ["point", "condition"], []


def _structure_values(
    run: RunData, measure: str, keys: Sequence[Sequence[str]], name: str
) -> "pd.Series[float]":
    """Take a measure of each case of a series that is done, by row."""
    cases = run.summary.reindex(columns=["condition", "point", "status", measure])
    cases = cases[cases["status"] == "done"].fillna({"point": "", "condition": ""})
    row_names, series_names = (joined_words(cases, columns) for columns in keys)
    cases.index = pd.Index(row_names)
    values: pd.Series[float] = cases.loc[np.array(series_names, dtype=object) == name, measure]
    return values


def shape_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of accuracy and structure by the robots' shape, a row for each point.

    Conditions differ in color and marker; where all are equal, gray stands for all.
    """
    numbers = [column for measure in _OF_SHAPES for column in (measure.mean, measure.ci95)]
    table = run.table("table.csv", ["condition"], ["cases", *numbers], after="cases")
    table = with_points(table).rename(columns={"point": "row"}).assign(of=table["condition"])
    points = list(dict.fromkeys(table["row"]))
    shown = points[:MOST_ROWS]
    series = list(dict.fromkeys(table["of"]))[: figure_style.MOST_SERIES]
    by_column = {measure.column: measure for measure in _OF_SHAPES}

    def paint(axes: "Axes", column: str, chosen: Sequence[str]) -> None:
        measure = by_column[column]
        draw_means(axes, table, measure, shown, chosen)
        if table.groupby("row")[measure.mean].nunique().max() <= 1:
            for bars in axes.collections:
                bars.set_color("0.4")
            for line in axes.lines:
                line.set(color="0.4", marker="o")
        finish_row_axis(axes, measure, shown)
        if measure is not RMSE:
            end = (table[measure.mean] + table[measure.ci95].fillna(0.0)).max()
            top = float(np.nan_to_num(end)) or 1.0
            axes.set(xscale="linear", xlim=(-0.04 * top, 1.08 * top))  # there may be no mode

    def complete(panels: figure_style.Panels) -> list[str]:
        figure_style.label_rows(panels.first, shown)
        words = figure_style.mean_words(table["cases"])
        panels.legend(words, loc="outside upper right")
        omitted = len(points) - len(shown)
        return [figure_style.omission_note(omitted, "sweep point", "in table.csv"), run.note]

    return figure_style.Drawing(
        panels=list(by_column), series=series, paint=paint, complete=complete, columns=4,
        row_height=0.5 + 0.17 * len(shown), head_height=0.4, share="y",
    )  # fmt: skip


def finish_row_axis(axes: "Axes", measure: Measure, names: Sequence[str]) -> None:
    """Label the horizontal axis of a panel with rows, the first at the top."""
    axes.set_xlabel(measure.axis)
    means = np.concatenate([np.asarray(line.get_xdata(), float) for line in axes.lines])
    axes.locator_params(axis="x", nbins=5)
    figure_style.fit_axis(axes, "x", means, nonpositive="clip")
    axes.grid(axis="y", color="0.92", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.set_yticks(np.arange(len(names)), [*names])
    axes.set_ylim(len(names) - 0.5, -0.5)
