"""The figure of a design: all candidates, their front, and what fresh structures gave."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pandas as pd

from tiswarm.records.measures import MEASURES
from tiswarm.report.figure_style import PAGE_WIDTH, Drawing, Panels, dot_style, line_style
from tiswarm.report.table_page import heading_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHT = 3.0
"""Height of the figure [inch]."""


def draw_front(table: pd.DataFrame, objectives: Sequence[str]) -> "Figure":
    """Draw candidates by the first two objectives.

    Args:
        table: A row for each candidate, `design.csv`.
        objectives: Names of two results or more; the first is `price` if there are prices.
    """
    across, up = objectives[:2]
    run = table[table["fresh_structures"] > 0]

    def paint(axes: "Axes", panel: str, series: Sequence[str]) -> None:  # noqa: ARG001 - one panel
        _draw_candidates(axes, table, across, up)
        axes.set_xlabel(_label(across))
        axes.set_ylabel(_label(up))

    def complete(panels: Panels) -> list[str]:
        panels.legend(structures=int(run["fresh_structures"].max()))
        return []

    drawing = Drawing(
        panels=["front"], paint=paint, complete=complete, row_height=_HEIGHT, head_height=0.0,
        alone=PAGE_WIDTH,
    )  # fmt: skip
    return drawing.draw()


def _draw_candidates(axes: "Axes", table: pd.DataFrame, across: str, up: str) -> None:
    """Draw candidates, the front as predicted, and what fresh structures gave."""
    # A search gives up candidates on few structures: their results are less certain than others.
    is_complete = table["structures"] == table["structures"].max()
    for chosen, label, alpha in (
        (is_complete, "candidates", 1.0),
        (~is_complete, "given up on fewer structures", 0.3),
    ):
        if chosen.any():
            x, y = (_values(table[chosen], name, "predicted") for name in (across, up))
            axes.plot(x, y, label=label, alpha=alpha, **dot_style(6, 2.5))
    x = _values(table, across, "predicted")
    front = table[table["front"]].iloc[x[table["front"]].argsort(kind="stable")]
    x, y = (_values(front, name, "predicted") for name in (across, up))
    axes.plot(x, y, label="front, as predicted", **line_style(0))
    run = table[table["fresh_structures"] > 0]
    x, y = (_values(run, name, "found") for name in (across, up))
    axes.plot(x, y, label="found on fresh structures", **dot_style(1))


def result_column(table: pd.DataFrame, name: str, kind: str) -> str:
    """Return the column of predicted or found values of a result; a price is the same in both."""
    column = f"{kind}_{name}"
    return column if column in table else name


def _values(table: pd.DataFrame, name: str, kind: str) -> "pd.Series[float]":
    return table[result_column(table, name, kind)]


def _label(name: str) -> str:
    """Label the axis of a result; a price has no unit."""
    return heading_of(MEASURES[name]) if name in MEASURES else name
