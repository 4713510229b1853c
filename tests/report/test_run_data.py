"""A run folder is read once, and its cases are found by name."""

import pytest

from tests.report.conftest import write_table
from tiswarm.errors import InputError
from tiswarm.report.run_data import load_run


def test_a_condition_may_have_any_name(tmp_path):
    """Names such as `null` are words, not missing values."""
    rows = [[f"0-{name}", "done", name, name, 8] for name in ("null", "NA", "none")]
    write_table(tmp_path / "summary.csv", "case,status,series,condition,robots", rows)

    run = load_run(tmp_path)

    assert list(run.series) == ["null", "NA", "none"]
    assert [case.condition for case in run.cases] == ["null", "NA", "none"]


def test_the_first_of_the_largest_cases_is_chosen(run_folder):
    """A failed case cannot be chosen, nor one that does not exist."""
    rows = [["0-a", "done", 5], ["1-a", "done", 9], ["2-a", "done", 9], ["3-a", "failed", ""]]
    write_table(run_folder / "summary.csv", "case,status,robots", rows)
    run = load_run(run_folder)

    assert run.choose(None).name == "1-a"
    assert run.choose("0-a").robots == 5
    for name in ("3-a", "4-a"):
        with pytest.raises(InputError, match="choose one of 0-a, 1-a, 2-a"):
            run.choose(name)
    assert run.note == "1 of 4 cases failed and are left out"


def test_a_missing_table_may_be_empty(run_folder):
    """A table that not every run has is empty; others are an error."""
    run = load_run(run_folder)

    assert run.table("paired.csv", optional=True).empty
    with pytest.raises(InputError, match=r"table\.csv: cannot be read"):
        run.table("table.csv")
