"""Draws the figure of the robots that joined last: their errors as they join, and later."""

from typing import TYPE_CHECKING

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.report import figure_style
from tiswarm.report.figure_style import (
    PAGE_WIDTH,
    Painter,
    add_legend,
    entries_of,
    fit_axis,
    label_left,
    line_style,
    new_panels,
)
from tiswarm.report.run_data import RunData, StoredCase

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SCORE, _COLUMN = "rmse_at_join_R", "error_at_join_R"
_SHARE = 4
"""The robots that joined last are one in so many of the smallest structure."""


def joining_painters(run: RunData) -> dict[str, Painter]:
    """List the figure by file name, if a run has structures of several sizes, and such errors."""
    sizes = {case.robots for cases in run.series.values() for case in cases}
    return {"joining": draw_joining} if len(sizes) > 1 and _at_join(run) else {}


def draw_joining(run: RunData, most: float = np.inf) -> "Figure":
    """Draw the RMSE of the last robots against the number of robots by then.

    Each kind of structure has a panel, with a line for each condition. Of a method that places
    robots as they join, it is the error then; a dashed line is that once all robots have joined.
    """
    done = [case for cases in run.series.values() for case in cases]
    kinds = list(dict.fromkeys(case.kind for case in done))
    names = list(dict.fromkeys(case.condition for case in done))
    sizes = sorted({case.robots for case in done})
    online, last = _at_join(run), max(sizes[0] // _SHARE, 1)
    figure, panels = new_panels(PAGE_WIDTH, 3.2, len(kinds), len(kinds), share="y", most=most)
    drawn = []
    for axes, kind in zip(panels, kinds, strict=True):
        for place, name in enumerate(names):
            mine = [case for case in done if (case.kind, case.condition) == (kind, name)]
            joins = any(case.name in online for case in mine)
            column = _COLUMN if joins else "error_R"
            line = [_rms(mine, size, size, column, last) for size in sizes]
            label = f"{name}, as they join" if joins else name
            axes.plot(sizes, line, marker="o", markersize=3.0, label=label, **line_style(place))
            drawn += line
            if joins:
                later = [_rms(mine, sizes[-1], size, "error_R", last) for size in sizes]
                look = line_style(place) | {"linestyle": "--"}
                axes.plot(sizes, later, marker="o", markersize=3.0, label=f"{name}, later", **look)
                drawn += later
        axes.set(xlabel="Robots by then", title=kind, xticks=sizes)
    label_left(panels, f"RMSE of the last {last} robots [R]")
    fit_axis(panels[0], "y", np.array(drawn))
    add_legend(figure, entries_of(panels[:1]))
    figure_style.add_note(figure, run.note)
    return figure


def _at_join(run: RunData) -> set[str]:
    """Name the cases that have errors of robots as they joined."""
    if _SCORE not in run.summary:
        return set()
    return set(run.summary.loc[run.summary[_SCORE].notna(), "case"])


def _rms(cases: list[StoredCase], size: int, until: int, column: str, last: int) -> float:
    """Compute the RMSE of some robots before one, in all structures of a size [R]."""
    tables: list[Reals] = [
        case.columns("robots.csv", [column]) for case in cases if case.robots == size
    ]
    error = np.concatenate([np.empty((0, 1)), *(table[until - last : until] for table in tables)])
    return float(np.sqrt((error**2).mean())) if error.size else float("nan")
