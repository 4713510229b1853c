"""Writes a page of a table: readers plot, sort and select its rows by any column."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.records.measures import Measure, all_measures
from tiswarm.report.figure_style import ERROR_COLORS, PALETTE
from tiswarm.report.page import render

MOST_ROWS = 20_000
"""Rows of a page; more make it slow, and are in its table of files alone."""

_DIGITS = 5


class Column(NamedTuple):
    """A column of a table as the page has it."""

    name: str
    heading: str
    meaning: str
    words: bool
    cells: list[Any]

    @property
    def varies(self) -> bool:
        """Whether rows differ in it."""
        return len({*self.cells}) > 1


class FirstView(NamedTuple):
    """What a reader sees first: names of columns."""

    x: str
    y: str
    color: str
    columns: Sequence[str]
    """Columns of the table; all others are a click away."""


def page_columns(
    table: pd.DataFrame, words: Sequence[str], headings: Mapping[str, str] | None = None
) -> list[Column]:
    """Turn a table into columns of a page; those without any value are left out.

    Args:
        table: Its rows; the page has the first `MOST_ROWS`.
        words: Columns of words; the others have numbers.
        headings: Headings of columns that are no measure.
    """
    shown = table.head(MOST_ROWS)
    columns = [
        _column(shown[key], key in words, (headings or {}).get(key)) for key in map(str, shown)
    ]
    return [column for column in columns if any(cell not in {None, ""} for cell in column.cells)]


def _column(cells: "pd.Series[Any]", words: bool, heading: str | None) -> Column:  # noqa: FBT001
    name = str(cells.name)
    measure = {measure.column: measure for measure in all_measures()}.get(name)
    if heading is None:
        heading = name.replace("_", " ") if measure is None else heading_of(measure)
    values: list[Any]
    if words:
        values = cells.fillna("").astype(str).tolist()
    else:
        numbers = pd.to_numeric(cells, errors="coerce").to_numpy(np.float64)
        values = [float(f"{x:.{_DIGITS}g}") if np.isfinite(x) else None for x in numbers]
    return Column(name, heading, measure.meaning if measure else "", words, values)


def heading_of(measure: Measure) -> str:
    """Write the label of a measure with its unit, or else its column in words."""
    if measure.label:
        return measure.axis
    suffix = "_" + measure.unit.replace("^", "")
    words = measure.column.removesuffix(suffix).replace("_", " ")
    unit = measure.unit.replace("^2", "²")
    return words if measure.unit == "1" else f"{words} [{unit}]"


def table_page(
    title: str,
    result: str,
    columns: Sequence[Column],
    first: FirstView,
    *,
    count: int,
    noun: str,
    example: str,
    file: str,
    note: str = "",
) -> str:
    """Write the page.

    Args:
        title: Its title.
        result: What it is of, in a line.
        columns: Columns of the table, as `page_columns` returns them.
        first: What a reader sees first.
        count: Rows of the whole table.
        noun: What a row is, in the plural.
        example: Words that a reader may look for.
        file: Name of the table that has all rows and columns.
        note: What a reader should know of the rows.
    """
    return render(
        "table.html",
        name=title,
        result=result,
        note=note,
        omitted=max(0, count - MOST_ROWS),
        file=file,
        noun=noun,
        example=example,
        data={
            "columns": [column._asdict() for column in columns],
            "palette": PALETTE,
            "scale": ERROR_COLORS,
            "noun": noun,
            "first": {
                "x": first.x,
                "y": first.y,
                "color": first.color,
                "columns": " ".join(first.columns),
            },
        },
    )
