"""Draws the figures of `table.csv` and `summary.csv`.

They have a row or a marker for each condition: accuracy, shapes, grades and what robots build.
"""

from collections.abc import Mapping, Sequence
from os.path import commonprefix
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.records.measures import (
    CONTACTS,
    CROSSED,
    FEWEST,
    FLIPS_AS_PLANNED,
    FLOPPY_MODES,
    HEIGHT,
    MAIN,
    REACH,
    RMSE,
    Measure,
)
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import LABEL
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, stated_conditions, with_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


DRAWN = [column for measure in MAIN for column in (measure.mean, measure.ci95)]
"""Columns of `table.csv` that a figure of its rows shows."""

_PUBLISHED = "published (robot radii)"

MOST_ROWS = 60
"""Rows that a figure shows at most."""

_ROOM = 0.12  # height of a marker [inch]
_MANY = 24  # markers beyond which they have less

_OF_SHAPES = (RMSE, FLOPPY_MODES, CONTACTS, HEIGHT)

CAPTIONS = {
    "accuracy": "Errors of each condition, and point of the sweep: mean RMSE and mean Procrustes "
    "disparity over the structures. Bars are 95 % CI; of few structures, each has a small dot. "
    "Hollow markers, where there are any, are published numbers. Farther left is better.",
    "building": "What robots build that navigate by the truth, or by what each condition estimates "
    "as they join. A flip is as planned if the robot then touches the one that it meant to reach. "
    "Bars are 95 % CI.",
    "grades": "RMSE by grade: conditions that differ in one number share a panel, and each point "
    "of the sweep has a line. The dashed line is the first condition without a grade. Bars are "
    "95 % CI.",
    "shape": "Accuracy and structure by the robots: mean RMSE, floppy modes (motions that change "
    "no measurement in use), contacts with earlier robots, and height of the structure. Bars are "
    "95 % CI; gray stands for all conditions.",
}
"""What the figures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figures that a run has, by file name."""
    return {**_table_painters(run), **_grade_painters(run), **_building_painters(run)}


def _table_painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figures of `table.csv` that a run has, by file name."""
    if not (run.folder / "table.csv").is_file():
        return {}
    shape = {"shape": draw_shape} if run.sweeps_robot else {}
    return {"accuracy": draw_accuracy, **shape}


def draw_accuracy(run: RunData, most: float = np.inf) -> "Figure":
    """Draw means over structures with 95 % confidence intervals; of few structures, each one.

    Without a sweep, conditions have a row each. With one, rows are points, and conditions differ in
    color and marker; of many conditions, they have the rows. Open markers are published numbers,
    whose unit of length is not defined.
    """
    published = [measure.published for measure in MAIN]
    table = run.table("table.csv", ["condition"], ["cases", *published, *DRAWN], after="cases")
    table = with_points(table)
    keys = _rows_and_series(table)
    row, of = (_joined(table, each) for each in keys)
    table = table.assign(row=row, of=of)
    series, names = list(dict.fromkeys(of)), list(dict.fromkeys(row))
    shown = names[: max(1, MOST_ROWS // len(series))]
    few = table["cases"].max() < FEWEST
    room = _ROOM if len(shown) * len(series) < _MANY else 0.7 * _ROOM
    height = 0.9 + room * len(shown) * (1 + len(series))
    panels = figure_style.Panels(height, len(MAIN), len(MAIN), share="y", most=most)
    for axes, measure in panels.each(MAIN):
        for index, name in enumerate(series):
            rows = table[table["of"] == name].set_index("row").reindex(shown)
            place = np.arange(len(shown)) + (index - 0.5 * (len(series) - 1)) / (1 + len(series))
            look = figure_style.dot_style(index)
            error = None if few else rows[measure.ci95].fillna(0.0)
            axes.errorbar(rows[measure.mean], place, xerr=error, label=name or "mean", **look)
            axes.plot(rows[measure.published], place, markerfacecolor="white", **look)
            if few:
                each = _each_structure(run, measure.column, keys, name)
                each = each[each.index.isin(shown)]
                at = place[[shown.index(where) for where in each.index]]
                axes.plot(each, at, **{**look, "markersize": 1.8, "alpha": 0.6})
    finish_rows(panels, shown, MAIN)
    if table[published].notna().any(axis=None):
        panels.first.plot(
            [], [], "o", color="0.35", markerfacecolor="white", markersize=3.5,
            label=_PUBLISHED,
        )  # fmt: skip
    entries = figure_style.entries_of(panels.first)
    if _PUBLISHED in entries:  # matplotlib lists lines before error bars
        entries[_PUBLISHED] = entries.pop(_PUBLISHED)
    number = counted(int(table["cases"].max()), "structure")
    title = f"mean, and each of {number} (small)" if few else f"mean and 95 % CI, {number}"
    panels.legend(title, entries, loc="outside upper right")
    left = counted(len(names) - len(shown), "more row") + " in table.csv"
    return panels.finish(left if len(shown) < len(names) else "", run.note)


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


def _joined(table: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    """Join the words of some columns."""
    return [", ".join(filter(None, row)) for row in table[[*keys]].to_numpy().tolist()]


def _each_structure(
    run: RunData, measure: str, keys: Sequence[Sequence[str]], name: str
) -> "pd.Series[float]":
    """Take a measure of each case of a series that is done, by row."""
    cases = run.summary.reindex(columns=["condition", "point", "status", measure])
    cases = cases[cases["status"] == "done"].fillna({"point": "", "condition": ""})
    row, of = (_joined(cases, each) for each in keys)
    cases.index = pd.Index(row)
    found: pd.Series[float] = cases.loc[np.array(of, dtype=object) == name, measure]
    return found


def draw_shape(run: RunData, most: float = np.inf) -> "Figure":
    """Draw accuracy and structure by the robots' shape: a row for each point of the sweep.

    Conditions differ in color and marker; where all are equal, gray stands for all.
    """
    numbers = [column for each in _OF_SHAPES for column in (each.mean, each.ci95)]
    table = run.table("table.csv", ["condition"], ["cases", *numbers], after="cases")
    table = with_points(table)
    points = list(dict.fromkeys(table["point"]))
    shown = points[:MOST_ROWS]
    series = dict(list(table.groupby("condition", sort=False))[: figure_style.MOST_SERIES])
    panels = figure_style.Panels(0.9 + 0.17 * len(shown), len(_OF_SHAPES), 4, share="y", most=most)
    for axes, measure in panels.each(_OF_SHAPES):
        alike = table.groupby("point")[measure.mean].nunique().max() <= 1
        for index, (condition, rows) in enumerate(series.items()):
            look = {**figure_style.dot_style(index, 3.0), "linewidth": 0.8}
            look |= {"color": "0.4", "marker": "o"} if alike else {}
            part = rows.set_index("point").reindex(shown)
            axes.errorbar(
                part[measure.mean], np.arange(len(shown)), label=condition,
                xerr=part[measure.ci95].fillna(0.0), **look,
            )  # fmt: skip
    finish_rows(panels, shown, _OF_SHAPES)
    for axes, measure in [*panels.each(_OF_SHAPES)][1:]:
        end = (table[measure.mean] + table[measure.ci95].fillna(0.0)).max()
        top = float(np.nan_to_num(end)) or 1.0
        axes.set(xscale="linear", xlim=(-0.04 * top, 1.08 * top))  # there may be no floppy mode
    for axes in panels.axes:
        axes.tick_params(axis="x", labelsize=6.0)
    words = figure_style.mean_words(table["cases"])
    panels.legend(words, structures=int(table["cases"].max()), loc="outside upper right")
    return panels.finish(figure_style.left_out(len(points) - len(shown), "table.csv"), run.note)


def finish_rows(
    panels: figure_style.Panels, names: Sequence[str], measures: Sequence[Measure]
) -> None:
    """Label rows, from the top, and axes."""
    for axes, measure in panels.each(measures):
        axes.set_xlabel(measure.axis)
        means = np.concatenate([np.asarray(line.get_xdata(), float) for line in axes.lines])
        axes.locator_params(axis="x", nbins=6)
        figure_style.fit_axis(axes, "x", means, nonpositive="clip")
        axes.grid(axis="y", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
    figure_style.label_rows(panels.first, names)
    panels.first.set_ylim(len(names) - 0.5, -0.5)


_FEWEST_GRADES = 3
_UNITS = {"_deg": "deg", "_noise": "R"}
"""Units by the ends of keys."""


def _grade_painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figure of graded conditions by file name, if a run has some.

    Rounds of back-propagation have a figure of their own.
    """
    if not (run.folder / "table.csv").is_file():
        return {}
    table = run.table("table.csv", ["condition"], [], after="cases")
    has_rounds = table.get("round_every", pd.Series(dtype=float)).notna().any()
    return {} if has_rounds or not _families(run, table) else {"grades": draw_grades}


def draw_grades(run: RunData, most: float = np.inf) -> "Figure":
    """Draw RMSE against the number in which conditions differ that else agree.

    They share a panel, in which each point of the sweep has a line. A dashed line in its color is
    the first condition that belongs to no panel.
    """
    table = run.table("table.csv", ["condition"], ["cases", RMSE.mean, RMSE.ci95], after="cases")
    table = table[table[RMSE.mean].notna()]
    families = _families(run, table)
    table = with_points(table)
    points = list(dict.fromkeys(table["point"]))
    shown = points[: figure_style.MOST_SERIES]
    graded = {name for family in families for name in family.names.values()}
    plain = next((name for name in table["condition"] if name not in graded), "")
    columns = figure_style.columns_of(len(families))
    height = 0.6 + 2.1 * -(-len(families) // columns)
    panels = figure_style.Panels(height, len(families), columns, share="y", most=most)
    for axes, family in panels.each(families):
        low, high = min(family.names), max(family.names)
        if low > 0.0:
            figure_style.set_log(axes, "x")
            margin = (high / low) ** 0.05
            axes.set_xlim(low / margin, high * margin)  # dashed lines would widen it to 1
        for place, point in enumerate(shown):
            rows = table[table["point"] == point].set_index("condition")
            look = {
                "label": point or "mean",
                **figure_style.marker_style(place),
            }
            _draw_line(axes, rows, family.names, look)
            if plain in rows.index:
                axes.axhline(float(rows.loc[plain, RMSE.mean]), **_dashed(look))
        figure_style.set_title(axes, family.title)
        axes.set_xlabel(_meaning(family.keys))
        axes.set_xticks([*family.names], [f"{grade:g}" for grade in family.names])
        axes.minorticks_off()
    means = table.loc[table["condition"].isin(graded | {plain}), RMSE.mean].to_numpy(float)
    figure_style.fit_axis(panels.first, "y", means, nonpositive="clip")
    panels.label_once(y=RMSE.axis)
    level = f"; dashed: {plain}" if plain else ""
    number = counted(int(table["cases"].max()), "structure")
    panels.legend(f"{figure_style.mean_words(table['cases'])}, {number}{level}")
    return panels.finish(figure_style.left_out(len(points) - len(shown), "table.csv"), run.note)


class _Family(NamedTuple):
    """Conditions that differ in one number."""

    title: str
    keys: Sequence[str]  # settings that have the number
    names: Mapping[float, str]  # of the conditions, by the number, ascending


def _families(run: RunData, table: pd.DataFrame) -> list[_Family]:
    """Gather conditions that set the same keys, and among these one number that differs."""
    each = stated_conditions(run.folder).items()
    stated = {str(entries.get(LABEL, name)): entries for name, entries in each}
    alike: dict[tuple[str, ...], dict[str, dict[str, Any]]] = {}
    for name in dict.fromkeys(table["condition"]):
        if entries := stated.get(name):
            alike.setdefault(tuple(sorted({*entries} - {LABEL})), {})[name] = entries
    families = []
    for keys, members in alike.items():
        varied = [key for key in keys if len({repr(each[key]) for each in members.values()}) > 1]
        grades: dict[float, str] = {}
        for name, entries in members.items():
            values = [entries[key] for key in varied]
            if {*map(type, values)} <= {int, float} and len({*values}) == 1:
                grades[values[0]] = name
        if len(grades) == len(members) >= _FEWEST_GRADES:
            title = commonprefix([*members]).rstrip("-_ .0123456789")  # noqa: RUF071 - no paths
            families.append(_Family(title, varied, dict(sorted(grades.items()))))
    return families


def _meaning(keys: Sequence[str]) -> str:
    """Name settings, with the unit that their names state."""
    words = " = ".join(key.split(".")[-1].removesuffix("_deg").replace("_", " ") for key in keys)
    units = [unit for end, unit in _UNITS.items() if any(key.endswith(end) for key in keys)]
    return f"{words} [{units[0]}]" if units else words


def _draw_line(
    axes: "Axes", rows: pd.DataFrame, grades: Mapping[float, str], look: dict[str, Any]
) -> None:
    """Draw the means of graded conditions with their intervals."""
    part = rows.reindex([*grades.values()])
    half = part[RMSE.ci95].fillna(0.0)
    axes.errorbar([*grades], part[RMSE.mean], yerr=half, markersize=3.0, elinewidth=0.6, **look)


def _dashed(look: dict[str, Any]) -> dict[str, Any]:
    return {"color": look["color"], "linestyle": "--", "linewidth": 0.8}


_BY = "structure.navigate_by"
_PANELS = {
    HEIGHT: ("tower", "Tower height [R]"),
    REACH: ("cantilever", "Cantilever reach [R]"),
    CROSSED: ("bridge", "Bridges closed [1]"),
    FLIPS_AS_PLANNED: ("", "Flips as planned [1]"),
}
"""By measure: the kind of structure that a panel shows, all if empty; its axis."""


def _building_painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figure by file name, if some robots of a run navigate by estimates."""
    planned = run.summary.get(FLIPS_AS_PLANNED.column)
    return {"building": draw_building} if planned is not None and planned.notna().any() else {}


def draw_building(run: RunData, most: float = np.inf) -> "Figure":
    """Draw how high, far and often robots build, with a row for what they navigate by.

    A marker is the mean of a kind of structure with its 95 % confidence interval.
    """
    done = run.summary[run.summary["status"] == "done"]
    rows = done.assign(structure=_structures(done), by=_navigation(done))
    rows = rows.drop_duplicates(["by", "structure", "seed"])  # conditions may share structures
    names, kinds = list(dict.fromkeys(rows["by"])), list(dict.fromkeys(rows["structure"]))
    shown = {
        measure.column: panel
        for measure, panel in _PANELS.items()
        if _of_kind(rows, panel[0])[measure.column].any()
    }
    height = 0.9 + len(names) * (0.16 + 0.07 * len(kinds))
    panels = figure_style.Panels(height, len(shown), len(shown), share="y", most=most)
    for axes, (column, (kind, label)) in panels.each(shown.items()):
        _draw_panel(axes, _of_kind(rows, kind), column, names, kinds)
        axes.set_xlabel(label)
        axes.set_xlim(left=0.0)
    figure_style.label_rows(panels.first, names)
    panels.first.invert_yaxis()
    structures = int(rows.groupby(["by", "structure"]).size().max())
    entries = panels.entries()
    words = figure_style.mean_words(rows.groupby(["by", "structure"]).size())
    panels.legend(words, entries, structures=structures, loc="outside upper right")
    return panels.finish(run.note)


def _navigation(done: pd.DataFrame) -> "pd.Series[str]":
    """Name what the robots of each case go by: the truth, or the estimates of a condition."""
    by = done.get(_BY, pd.Series("estimate", done.index))
    return done["condition"].where(by != "truth", "the truth")


def _structures(done: pd.DataFrame) -> "pd.Series[str]":
    """Name the structure of each case: its kind, and of a bridge its span."""
    span = done.get("right_edge_R", pd.Series(np.nan, done.index))
    words = [f", {x:g} R" if np.isfinite(x) else "" for x in span]
    return done["kind"] + pd.Series(words, done.index)


def _of_kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    return rows[rows["kind"] == kind] if kind else rows


def _draw_panel(
    axes: "Axes", rows: pd.DataFrame, column: str, names: list[str], kinds: list[str]
) -> None:
    """Draw the mean of a column for each name, a marker for each kind of structure."""
    for index, kind in enumerate(kinds):
        mine = rows[rows["structure"] == kind]
        found = mine.groupby("by")[column].agg(["mean", figure_style.half_width]).reindex(names)
        place = np.arange(len(names)) + 0.16 * (index - 0.5 * (len(kinds) - 1))
        if found["mean"].notna().any():
            half = found["half_width"]
            axes.errorbar(
                found["mean"], place, xerr=half, label=kind, **figure_style.dot_style(index)
            )
