"""Measures are defined in one table, from which tables, page and documentation follow."""

from pathlib import Path

import pandas as pd
import pytest

from tiswarm.records.measures import BUILT_FOR, MAIN, MEASURES, PAGE, paired_measures

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_of_files_has_the_table():
    """A reader finds each column with its unit and meaning."""
    listed = pd.read_csv(DOCS / "measures.csv", keep_default_na=False, dtype=str)
    rows = [
        (
            each.column + ("" if each.averaged else " (no mean)"),
            each.unit,
            each.source,
            each.meaning,
            each.better,
        )
        for each in MEASURES.values()
    ]

    assert [*listed.columns] == ["column", "unit", "from", "meaning", "better"]
    assert [*listed.itertuples(index=False, name=None)] == rows
    assert ":file: measures.csv" in (DOCS / "files.md").read_text()


@pytest.mark.parametrize("place", PAGE)
def test_headings_of_a_table_differ(place):
    """Two measures with one heading would share a column."""
    headings = PAGE[place].values()

    assert len({*headings}) == len(headings)
    assert all(measure.averaged for measure in PAGE[place])


def test_measures_of_accuracy_are_better_where_they_are_smaller():
    """Headlines sort by them, and `paired.csv` counts the structures where one is smaller."""
    assert {*MAIN} <= {*paired_measures()}
    assert all(measure.better == "smaller" for measure in paired_measures())
    assert all(measure.label for measure in (*MAIN, *BUILT_FOR.values()))
    assert all(column == measure.column for column, measure in MEASURES.items())
