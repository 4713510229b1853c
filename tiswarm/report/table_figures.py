"""Draws the figures of `table.csv` and `summary.csv`.

They have a row or a marker for each condition: accuracy, structures and shapes.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.records.measures import (
    BROKEN,
    BUILT_FOR,
    CONTACTS,
    FEWEST,
    FLOPPY_MODES,
    HEIGHT,
    MAIN,
    RMSE,
    STANDING,
    Measure,
)
from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, joined_words, with_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
        "Procrustes disparity over the structures.",
        intervals="Bars are 95 % CI.",
        reading=(
            "Hollow markers, where there are any, are published numbers. Farther left is better."
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


def painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figures that a run has, by file name."""
    if not (run.folder / "table.csv").is_file():
        return {}
    if run.is_of_engine:
        return {}
    if run.has_structures_alone:
        return {"structures": draw_structures} if _of_structures(run) else {}
    shape = {"shape": draw_shape} if run.sweeps_robot else {}
    return {"accuracy": draw_accuracy, **shape}


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


def draw_structures(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw what structures were built for, who stands and what broke, as `draw_accuracy` does."""
    return _draw_means(run, _of_structures(run), max_width)


def draw_accuracy(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw accuracy as `_draw_means` does; open markers are the paper's numbers."""
    return _draw_means(run, MAIN, max_width)


def _draw_means(run: RunData, measures: Sequence[Measure], max_width: float) -> "Figure":
    """Draw means over structures with 95 % confidence intervals; of few structures, each one.

    Without a sweep, conditions have a row each. With one, rows are points, and conditions differ in
    color and marker; of many conditions, they have the rows. Open markers are published numbers,
    whose unit of length is not defined.
    """
    published = [measure.published for measure in measures if measure.published]
    drawn = [column for measure in measures for column in (measure.mean, measure.ci95)]
    table = run.table("table.csv", ["condition"], ["cases", *published, *drawn], after="cases")
    table = with_points(table)
    keys = _rows_and_series(table)
    row_names, series_names = (joined_words(table, columns) for columns in keys)
    table = table.assign(row=row_names, of=series_names)
    series = list(dict.fromkeys(series_names))
    names = list(dict.fromkeys(row_names))
    shown = names[: max(1, MOST_ROWS // len(series))]
    few = table["cases"].max() < FEWEST
    room = _ROOM if len(shown) * len(series) < _MANY else 0.7 * _ROOM
    height = 0.9 + room * len(shown) * (1 + len(series))
    count = len(measures)
    panels = figure_style.Panels(height, count, count, share="y", max_width=max_width)
    for axes, measure in panels.paired_with(measures):
        for index, name in enumerate(series):
            rows = table[table["of"] == name].set_index("row").reindex(shown)
            y = np.arange(len(shown)) + (index - 0.5 * (len(series) - 1)) / (1 + len(series))
            look = figure_style.dot_style(index)
            error = None if few else rows[measure.ci95].fillna(0.0)
            axes.errorbar(rows[measure.mean], y, xerr=error, label=name or "mean", **look)
            if measure.published:
                axes.plot(rows[measure.published], y, markerfacecolor="white", **look)
            if few:
                values = _structure_values(run, measure.column, keys, name)
                values = values[values.index.isin(shown)]
                value_y = y[[shown.index(row) for row in values.index]]
                axes.plot(values, value_y, **{**look, "markersize": 1.8, "alpha": 0.6})
    finish_rows(panels, shown, measures)
    if table[published].notna().any(axis=None):
        panels.first.plot(
            [],
            [],
            "o",
            color="0.35",
            markerfacecolor="white",
            markersize=3.5,
            label=_PUBLISHED,
        )
    entries = figure_style.entries_of(panels.first)
    if _PUBLISHED in entries:  # matplotlib lists lines before error bars
        entries[_PUBLISHED] = entries.pop(_PUBLISHED)
    number = counted(int(table["cases"].max()), "structure")
    title = f"mean, and each of {number} (small)" if few else f"mean and 95 % CI, {number}"
    panels.legend(title, entries, loc="outside upper right")
    more = figure_style.omission_note(len(names) - len(shown), "row", "in table.csv")
    return panels.finish(more, run.note)


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


def draw_shape(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw accuracy and structure by the robots' shape: a row for each point of the sweep.

    Conditions differ in color and marker; where all are equal, gray stands for all.
    """
    numbers = [column for measure in _OF_SHAPES for column in (measure.mean, measure.ci95)]
    table = run.table("table.csv", ["condition"], ["cases", *numbers], after="cases")
    table = with_points(table)
    points = list(dict.fromkeys(table["point"]))
    shown = points[:MOST_ROWS]
    series = dict(list(table.groupby("condition", sort=False))[: figure_style.MOST_SERIES])
    panels = figure_style.Panels(
        0.9 + 0.17 * len(shown), len(_OF_SHAPES), 4, share="y", max_width=max_width
    )
    for axes, measure in panels.paired_with(_OF_SHAPES):
        is_shared = table.groupby("point")[measure.mean].nunique().max() <= 1
        for index, (condition, rows) in enumerate(series.items()):
            look = {**figure_style.dot_style(index, 3.0), "linewidth": 0.8}
            if is_shared:
                look |= {"color": "0.4", "marker": "o"}
            shown_rows = rows.set_index("point").reindex(shown)
            axes.errorbar(
                shown_rows[measure.mean],
                np.arange(len(shown)),
                label=condition,
                xerr=shown_rows[measure.ci95].fillna(0.0),
                **look,
            )
    finish_rows(panels, shown, _OF_SHAPES)
    for axes, measure in [*panels.paired_with(_OF_SHAPES)][1:]:
        end = (table[measure.mean] + table[measure.ci95].fillna(0.0)).max()
        top = float(np.nan_to_num(end)) or 1.0
        axes.set(xscale="linear", xlim=(-0.04 * top, 1.08 * top))  # there may be no floppy mode
    for axes in panels.axes:
        axes.tick_params(axis="x", labelsize=6.0)
    words = figure_style.mean_words(table["cases"])
    panels.legend(words, structures=int(table["cases"].max()), loc="outside upper right")
    return panels.finish(
        figure_style.omission_note(len(points) - len(shown), "sweep point", "in table.csv"),
        run.note,
    )


def finish_rows(
    panels: figure_style.Panels, names: Sequence[str], measures: Sequence[Measure]
) -> None:
    """Label rows, from the top, and axes."""
    for axes, measure in panels.paired_with(measures):
        axes.set_xlabel(measure.axis)
        means = np.concatenate([np.asarray(line.get_xdata(), float) for line in axes.lines])
        axes.locator_params(axis="x", nbins=6)
        figure_style.fit_axis(axes, "x", means, nonpositive="clip")
        axes.grid(axis="y", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
    figure_style.label_rows(panels.first, names)
    panels.first.set_ylim(len(names) - 0.5, -0.5)
