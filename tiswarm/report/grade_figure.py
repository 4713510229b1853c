"""Draws the figure of graded conditions: what each grade of a sensor or setting buys."""

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.figure_style import (
    PAGE_WIDTH,
    PALETTE,
    Painter,
    add_legend,
    entries_of,
    fit_axis,
    marker_style,
    new_panels,
    set_log,
    set_title,
    shortened,
)
from tiswarm.report.run_data import RunData, stated_conditions, swept_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GRADED = re.compile(r"(.+?)[-_ ](\d+(?:\.\d+)?)")
_FEWEST_GRADES = 3
_UNITS = {"_deg": "deg", "_noise": "R"}
"""Units by the ends of keys."""

_ERROR, _HALF = "rmse_R_mean", "rmse_R_ci95"


def grade_painters(run: RunData) -> dict[str, Painter]:
    """List the figure of graded conditions by file name, if a run has some.

    Rounds of back-propagation have a figure of their own.
    """
    if not (run.folder / "table.csv").is_file():
        return {}
    table = run.table("table.csv", ["condition"], [], after="cases")
    has_rounds = table.get("round_every", pd.Series(dtype=float)).notna().any()
    return {} if has_rounds or not _families(table) else {"grades": draw_grades}


def draw_grades(run: RunData, most: float = np.inf) -> "Figure":
    """Draw RMSE against the number at the end of the names of conditions that else agree.

    Conditions whose names begin alike share a panel, in which each point of the sweep has a line.
    A dashed line in its color is the first condition without such a number.
    """
    table = run.table("table.csv", ["condition"], ["cases", _ERROR, _HALF], after="cases")
    table = table[table[_ERROR].notna()]
    families = _families(table)
    swept = swept_words(table).drop(columns="condition")
    words = [zip(swept.columns, row, strict=True) for row in swept.to_numpy().tolist()]
    table["point"] = [", ".join(f"{key}={value}" for key, value in row) for row in words]
    points = list(dict.fromkeys(table["point"]))
    shown = points[: len(PALETTE)]
    graded = {name for grades in families.values() for name in grades.values()}
    plain = next((name for name in table["condition"] if name not in graded), "")
    stated = stated_conditions(run.folder)
    columns = min(2 if len(families) in {2, 4} else 3, len(families))
    height = 0.6 + 2.1 * -(-len(families) // columns)
    figure, panels = new_panels(PAGE_WIDTH, height, len(families), columns, share="y", most=most)
    for axes, (family, grades) in zip(panels, families.items(), strict=True):
        for place, point in enumerate(shown):
            rows = table[table["point"] == point].set_index("condition")
            look = {"label": shortened(point) or "mean", **marker_style(place)}
            _draw_line(axes, rows, grades, look)
            if plain in rows.index:
                axes.axhline(float(rows.loc[plain, _ERROR]), **_dashed(look))
        set_title(axes, family)
        axes.set_xlabel(_meaning([stated.get(name, {}) for name in grades.values()]))
        axes.set_xticks([*grades], [f"{grade:g}" for grade in grades])
        axes.minorticks_off()
    means = table.loc[table["condition"].isin(graded | {plain}), _ERROR].to_numpy(float)
    fit_axis(panels[0], "y", means, nonpositive="clip")
    figure.supylabel("RMSE [R]", fontsize=8.0)
    level = f"; dashed: {plain}" if plain else ""
    number = counted(int(table["cases"].max()), "structure")
    add_legend(figure, entries_of(panels[:1]), f"mean and 95 % CI, {number}{level}")
    more = figure_style.left_out(len(points) - len(shown), "table.csv")
    figure_style.add_note(figure, more, run.note)
    return figure


def _families(table: pd.DataFrame) -> dict[str, dict[float, str]]:
    """Gather conditions by the beginning of their names: the names by grade, ascending."""
    families: dict[str, dict[float, str]] = {}
    for name in dict.fromkeys(table["condition"]):
        if found := _GRADED.fullmatch(name):
            families.setdefault(found[1], {})[float(found[2])] = name
    return {
        family: dict(sorted(grades.items()))
        for family, grades in families.items()
        if len(grades) >= _FEWEST_GRADES
    }


def _meaning(conditions: list[dict[str, Any]]) -> str:
    """Name the settings in which conditions differ, with the unit that their names state."""
    keys = [
        key
        for key, value in conditions[0].items()
        if any(other.get(key) != value for other in conditions)
    ]
    words = " = ".join(key.split(".")[-1].removesuffix("_deg").replace("_", " ") for key in keys)
    units = [unit for end, unit in _UNITS.items() if any(key.endswith(end) for key in keys)]
    return f"{words} [{units[0]}]" if units else words


def _draw_line(
    axes: "Axes", rows: pd.DataFrame, grades: dict[float, str], look: dict[str, Any]
) -> None:
    """Draw the means of graded conditions with their intervals, on a logarithmic axis."""
    part = rows.reindex([*grades.values()])
    half = part[_HALF].fillna(0.0)
    at = np.array([*grades])
    axes.errorbar(at, part[_ERROR], yerr=half, markersize=3.0, elinewidth=0.6, **look)
    if at.min() > 0.0:
        set_log(axes, "x")


def _dashed(look: dict[str, Any]) -> dict[str, Any]:
    return {"color": look["color"], "linestyle": "--", "linewidth": 0.8}
