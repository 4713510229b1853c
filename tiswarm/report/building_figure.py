"""Draws the figure of what robots build that go by their own estimates, beside the truth."""

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.figure_style import (
    PAGE_WIDTH,
    Painter,
    add_legend,
    entries_of,
    label_rows,
    marker_style,
    new_panels,
)
from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BY = "structure.navigate_by"
_PANELS = {
    "height_R": ("tower", "Tower height [R]"),
    "reach_R": ("cantilever", "Cantilever reach [R]"),
    "crossed": ("bridge", "Bridges closed [1]"),
    "flips_as_planned": ("", "Flips as planned [1]"),
}
"""By column of `summary.csv`: the kind of structure that a panel shows, all if empty; its axis."""

_NORMAL_95 = 1.96


def building_painters(run: RunData) -> dict[str, Painter]:
    """List the figure by file name, if some robots of a run navigate by estimates."""
    planned = run.summary.get("flips_as_planned")
    return {"building": draw_building} if planned is not None and planned.notna().any() else {}


def draw_building(run: RunData, most: float = np.inf) -> "Figure":
    """Draw how high, far and often robots build, with a row for what they navigate by.

    A marker is the mean of a kind of structure with its 95 % confidence interval.
    """
    done = run.summary[run.summary["status"] == "done"]
    rows = done.assign(structure=_structures(done), by=_navigation(done))
    rows = rows.drop_duplicates(["by", "structure", "seed"])  # conditions may share structures
    names, kinds = list(dict.fromkeys(rows["by"])), list(dict.fromkeys(rows["structure"]))
    shown = {name: panel for name, panel in _PANELS.items() if _of_kind(rows, panel[0])[name].any()}
    height = 0.9 + len(names) * (0.16 + 0.07 * len(kinds))
    figure, panels = new_panels(PAGE_WIDTH, height, len(shown), len(shown), share="y", most=most)
    for axes, (column, (kind, label)) in zip(panels, shown.items(), strict=True):
        _draw_panel(axes, _of_kind(rows, kind), column, names, kinds)
        axes.set_xlabel(label)
        axes.set_xlim(left=0.0)
    label_rows(panels[0], names)
    panels[0].invert_yaxis()
    structures = counted(int(rows.groupby(["by", "structure"]).size().max()), "structure")
    title = f"mean and 95 % CI, {structures}"
    add_legend(figure, entries_of(panels), title, loc="outside upper right")
    figure_style.add_note(figure, run.note)
    return figure


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
        found = mine.groupby("by")[column].agg(["mean", "std", "count"]).reindex(names)
        place = np.arange(len(names)) + 0.16 * (index - 0.5 * (len(kinds) - 1))
        half = _NORMAL_95 * found["std"].fillna(0.0) / np.sqrt(found["count"])
        if found["mean"].notna().any():
            look = {**marker_style(index), "linestyle": "", "markersize": 3.5}
            axes.errorbar(found["mean"], place, xerr=half, label=kind, **look)
