"""Measures are defined in one table, from which tables, page and documentation follow."""

from pathlib import Path

import pytest

from tiswarm.records.measures import BUILT_FOR, MAIN, MEASURES, PAGE, PAIRED

PAGE_OF_FILES = Path(__file__).parents[2] / "docs" / "files.md"


def measures_table() -> str:
    """Write all measures as the table of Markdown on the page of files."""
    lines = ["| column | unit | from | meaning | better |", "|---|---|---|---|---|"]
    for each in MEASURES.values():
        name = f"`{each.column}`" + ("" if each.averaged else " (no mean)")
        lines.append(f"| {name} | {each.unit} | {each.source} | {each.meaning} | {each.better} |")
    return "\n".join(lines) + "\n"


def test_the_page_of_files_has_the_table():
    """A reader finds each column with its unit and meaning."""
    assert measures_table() in PAGE_OF_FILES.read_text()


@pytest.mark.parametrize("place", PAGE)
def test_headings_of_a_table_differ(place):
    """Two measures with one heading would share a column."""
    headings = PAGE[place].values()

    assert len({*headings}) == len(headings)
    assert all(measure.averaged for measure in PAGE[place])


def test_measures_of_accuracy_are_better_where_they_are_smaller():
    """Headlines sort by them, and `paired.csv` counts the structures where one is smaller."""
    assert {*MAIN} <= {*PAIRED}
    assert all(measure.better == "smaller" for measure in PAIRED)
    assert all(measure.label for measure in (*MAIN, *BUILT_FOR.values()))
    assert all(column == measure.column for column, measure in MEASURES.items())
