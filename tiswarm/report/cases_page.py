"""Writes the page of the cases of many runs."""

from collections.abc import Sequence

import pandas as pd

from tiswarm.records.measures import LOCATED, MAIN, OF_LOCATED, Measure
from tiswarm.report.table_page import Column, FirstView, page_columns, table_page

_NAMING = ("point", "condition", "kind", "method", "measurements", "seed")
"""Columns that name a case, where cases differ in them."""

_FURTHER = ("contacts_per_robot", "floppy_modes", "height_R")
"""Columns of the table that say how hard a case is."""


def cases_page(title: str, cases: pd.DataFrame, words: Sequence[str], *, file: str) -> str:
    """Write the page.

    Args:
        title: Its title.
        cases: A row for each case; columns of numbers without any value are left out.
        words: Columns of words; the others have numbers.
        file: Name of the table that has all cases and columns.
    """
    columns = page_columns(cases, words)
    return table_page(
        title,
        f"{len(cases):,} cases of {cases['run'].nunique()} runs",
        columns,
        _first_view(columns),
        count=len(cases),
        noun="cases",
        example="tower joint",
        file=file,
    )


def _errors(columns: Sequence[Column]) -> Sequence[Measure]:
    """Choose the measures that state accuracy: where not all robots are located, how many are."""
    shares = next((column.cells for column in columns if column.name == LOCATED.column), [])
    return OF_LOCATED if any(share is not None and share < 1.0 for share in shares) else MAIN


def _first_view(columns: Sequence[Column]) -> FirstView:
    """Choose what a reader sees first.

    The chart has the first error over the number of robots if that differs, by condition or run.
    """
    varying = [column.name for column in columns if column.varies]
    numbers = [column.name for column in columns if not column.words]
    errors = [measure.column for measure in _errors(columns) if measure.column in numbers]
    y = [*errors, *numbers][0]
    x = next((name for name in ("robots", "joined") if name in varying), "run")
    color = next((name for name in ("condition", "point") if name in varying), "run")
    of_table = [name for name in _NAMING if name in varying]
    shown = [*dict.fromkeys(["run", *of_table, x, *errors, y, *_FURTHER])]
    names = {column.name for column in columns}
    return FirstView(x, y, color, [name for name in shown if name in names])
