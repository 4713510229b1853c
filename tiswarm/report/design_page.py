"""Writes the page of a design: all candidates, their front, and what fresh structures gave."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from tiswarm.records.measures import MEASURES
from tiswarm.report.design_figure import result_column
from tiswarm.report.table_page import FirstView, heading_of, page_columns, table_page

_KINDS = {
    "predicted": "predicted",
    "found": "fresh structures,",
    "least": "least",
    "most": "largest",
}
"""What columns of a result begin with, and what their headings do."""

_VERDICT, _ON_FRESH = "verdict", "on_fresh"


def design_page(
    table: pd.DataFrame,
    keys: Sequence[str],
    objectives: Sequence[str],
    *,
    title: str,
    result: str,
    note: str,
    file: str,
) -> str:
    """Write the page.

    Args:
        table: A row for each candidate, the best first, `design.csv`.
        keys: Columns of the values that candidates differ in.
        objectives: Names of the results that count; the first is `price` if there are prices.
        title: Its title.
        result: What was asked for, and how many candidates reach it.
        note: Which structures answered.
        file: Name of the table.
    """
    rows = table.drop(columns=["reaches", "front", "found_reaches"])
    rows.insert(len(keys), _VERDICT, _verdicts(table))
    rows.insert(len(keys) + 1, _ON_FRESH, _verdicts_on_fresh(table))
    names = [*map(str, rows)]
    words = [name for name in names if not pd.api.types.is_numeric_dtype(rows[name])]
    headings = {key: _heading_of_key(key) for key in keys}
    headings[_ON_FRESH] = "on fresh structures"
    headings |= {
        f"{kind}_{name}": f"{text} {heading_of(MEASURES[name])}"
        for name in objectives
        if name in MEASURES
        for kind, text in _KINDS.items()
    }
    columns = page_columns(rows, words, headings)
    results = [result_column(table, name, "predicted") for name in objectives]
    across, up = results[:2] if len(results) > 1 else (keys[0], results[0])
    further = [name for name in names if name.startswith("found_") and name not in results]
    return table_page(
        title,
        result,
        columns,
        FirstView(across, up, _VERDICT, [*keys, *results, *further, _VERDICT, _ON_FRESH]),
        count=len(table),
        noun="candidates",
        example="front",
        file=file,
        note=note,
    )


def _heading_of_key(key: str) -> str:
    """Write the last part of a key in words; of angles, with their unit."""
    name = key.rpartition(".")[2]
    quantity = name.removesuffix("_deg").replace("_", " ")
    return f"{quantity} [deg]" if name.endswith("_deg") else quantity


def _verdicts(table: pd.DataFrame) -> list[str]:
    """Say what a search made of each candidate."""
    is_complete = table["structures"] == table["structures"].max()
    chosen = [table["front"], table["reaches"], is_complete]
    texts = ["on the front", "reaches the goals", "misses a goal"]
    verdicts = np.select(chosen, texts, "given up on fewer structures")
    return [str(verdict) for verdict in verdicts]


def _verdicts_on_fresh(table: pd.DataFrame) -> list[str]:
    """Say of each candidate that was run whether it reaches the goals."""
    is_run = table["fresh_structures"] > 0
    reached = table["found_reaches"].eq(True)  # noqa: FBT003 - missing where none was run
    verdicts = np.select([is_run & reached, is_run], ["reaches the goals", "misses a goal"], "")
    return [str(verdict) for verdict in verdicts]
