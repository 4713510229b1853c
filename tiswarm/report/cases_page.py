"""Writes a page of the cases of many runs: readers plot, sort and select them by any column."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.records.measures import MAIN, Measure, all_measures
from tiswarm.report.figure_style import ERROR_COLORS, PALETTE
from tiswarm.report.page import render

MOST_CASES = 20_000
"""Cases of a page; more make it slow, and are in its table of files alone."""

_DIGITS = 5

_NAMING = ("point", "condition", "kind", "method", "measurements", "seed")
"""Columns that name a case, where cases differ in them."""

_FURTHER = ("contacts_per_robot", "floppy_modes", "height_R")
"""Columns of the table that say how hard a case is."""


class CaseColumn(NamedTuple):
    """A column of the cases as the page has it."""

    name: str
    heading: str
    meaning: str
    words: bool
    cells: list[Any]

    @property
    def varies(self) -> bool:
        """Whether cases differ in it."""
        return len({*self.cells}) > 1


def cases_page(name: str, cases: pd.DataFrame, words: list[str], *, file: str) -> str:
    """Write the page.

    Args:
        name: Its title.
        cases: A row for each case; columns of numbers without any value are left out.
        words: Columns of words; the others have numbers.
        file: Name of the table that has all cases and columns.
    """
    shown = cases.head(MOST_CASES)
    columns = [_column(shown[key], words=key in words) for key in [*map(str, shown)]]
    columns = [column for column in columns if any(cell not in {None, ""} for cell in column.cells)]
    return render(
        "cases.html",
        name=name,
        result=f"{len(cases):,} cases of {cases['run'].nunique()} runs",
        omitted=len(cases) - len(shown),
        file=file,
        data={
            "columns": [column._asdict() for column in columns],
            "palette": PALETTE,
            "scale": ERROR_COLORS,
            "first": _first_choices(columns),
        },
    )


def _column(cells: "pd.Series[Any]", *, words: bool) -> CaseColumn:
    name = str(cells.name)
    measure = {measure.column: measure for measure in all_measures()}.get(name)
    heading = name.replace("_", " ") if measure is None else _heading(measure)
    values: list[Any]
    if words:
        values = cells.fillna("").astype(str).tolist()
    else:
        numbers = pd.to_numeric(cells, errors="coerce").to_numpy(np.float64)
        values = [float(f"{x:.{_DIGITS}g}") if np.isfinite(x) else None for x in numbers]
    return CaseColumn(name, heading, measure.meaning if measure else "", words, values)


def _heading(measure: Measure) -> str:
    """Write the label of a measure with its unit, or else its column in words."""
    if measure.label:
        return measure.axis
    if measure.unit == "1":
        return measure.column.replace("_", " ")
    return f"{measure.column.rpartition('_')[0].replace('_', ' ')} [{measure.unit}]"


def _first_choices(columns: list[CaseColumn]) -> Mapping[str, str]:
    """Choose what a reader sees first: axes, color, and the columns of the table.

    The chart has the first error over the number of robots if that differs, by condition or run.
    """
    varying = [column.name for column in columns if column.varies]
    numbers = [column.name for column in columns if not column.words]
    errors = [measure.column for measure in MAIN if measure.column in numbers]
    y = [*errors, *numbers][0]
    x = next((name for name in ("robots", "joined") if name in varying), "run")
    color = next((name for name in ("condition", "point") if name in varying), "run")
    of_table = [name for name in _NAMING if name in varying]
    shown = [*dict.fromkeys(["run", *of_table, x, *errors, y, *_FURTHER])]
    names = {column.name for column in columns}
    table = " ".join(name for name in shown if name in names)
    return {"x": x, "y": y, "color": color, "columns": table}
