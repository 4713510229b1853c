"""A run folder is read once, and its cases are found by name."""

import pytest

from tests.report.conftest import write_case, write_summary, write_table
from tiswarm.base.errors import InputError
from tiswarm.records.terrain import Terrain
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view


def test_a_condition_may_have_any_name(tmp_path):
    """Names such as `null` are words, not missing values."""
    rows = [[f"0-{name}", "done", name, name, 8] for name in ("null", "NA", "none")]
    write_summary(tmp_path, "case,status,series,condition,robots", rows)

    run = load_run(tmp_path)

    assert list(run.series) == ["null", "NA", "none"]
    assert [case.condition for case in run.cases] == ["null", "NA", "none"]


def test_the_first_of_the_largest_cases_is_chosen(run_folder):
    """A failed case cannot be chosen, nor one that does not exist."""
    rows = [["0-a", "done", 5], ["1-a", "done", 9], ["2-a", "done", 9], ["3-a", "failed", ""]]
    write_summary(run_folder, "case,status,robots", rows)
    run = load_run(run_folder)

    assert run.choose(None).name == "1-a"
    assert run.choose("0-a").robots == 5
    for name in ("3-a", "4-a"):
        with pytest.raises(InputError, match="choose one of 0-a, 1-a, 2-a"):
            run.choose(name)
    assert run.note == "1 of 4 cases failed and are left out"


@pytest.mark.parametrize(
    "name", ["../0-baseline", "..", ".", "", "/etc", "0-baseline/..", "linked"]
)
def test_cases_are_in_the_run_alone(run_folder, name):
    """A name in the summary that leads elsewhere is refused, and so is a link."""
    (run_folder / "cases" / "linked").symlink_to(run_folder / "cases" / "0-baseline")
    write_summary(run_folder, "case,status,series", [[name, "done", "baseline"]])

    with pytest.raises(InputError, match=f"case '{name}' has no folder in the run"):
        load_run(run_folder).choose(None)


def test_a_run_with_a_linked_folder_is_refused(run_folder, tmp_path_factory):
    """Pictures would be written through the link."""
    (run_folder / "renders").symlink_to(tmp_path_factory.mktemp("elsewhere"))

    with pytest.raises(InputError, match="renders: is a link"):
        load_run(run_folder)


def test_a_missing_table_may_be_empty(run_folder):
    """A table that not every run has is empty; others are an error."""
    run = load_run(run_folder)

    assert run.table("paired.csv", [], [], after="measure", optional=True).empty
    with pytest.raises(InputError, match=r"table\.csv: cannot be read"):
        run.table("table.csv", [], [], after="cases")


def test_a_table_that_changes_is_read_again(run_folder):
    """Small tables stay in memory, each caller has a copy of its own."""
    first = load_run(run_folder).summary
    first["robots"] = 0
    kept = load_run(run_folder).summary["robots"].to_list()
    write_summary(run_folder, "case,status,robots", [["0-a", "done", 7]])

    assert 0 not in kept
    assert load_run(run_folder).summary["robots"].to_list() == [7]


def test_edges_of_the_ground_come_from_the_summary(tmp_path):
    """Where the summary has none, the ground is a plane."""
    for name in ("0-bridge", "0-tower"):
        write_case(tmp_path / "cases" / name, seed=0)
    rows = [["0-bridge", "done", 0.0, 20.0], ["0-tower", "done", "", ""]]
    write_summary(tmp_path, "case,status,left_edge_R,right_edge_R", rows)

    bridge, tower = (read_case_view(case).terrain for case in load_run(tmp_path).cases)

    assert bridge == Terrain(left_edge=0.0, right_edge=20.0)
    assert tower == Terrain()


def test_labels_stand_for_conditions(tmp_path):
    """Tables and series have them; folders and files keep the name."""
    rows = [[f"0-{name}", "done", f"30, {name}", name, 8] for name in ("a", "aa")]
    write_summary(tmp_path, "case,status,series,condition,robots", rows)
    write_table(tmp_path / "table.csv", "condition,cases", [["a", 1], ["aa", 1]])
    (tmp_path / "scenario.yaml").write_text("conditions: {a: {label: 'Method \\1'}, aa: {}}\n")

    run = load_run(tmp_path)

    assert list(run.series) == ["30 / Method \\1", "30 / aa"]
    assert [case.name for case in run.cases] == ["0-a", "0-aa"]
    table = run.table("table.csv", ["condition"], [], after="cases")
    assert list(table["condition"]) == ["Method \\1", "aa"]


@pytest.mark.parametrize("text", ["conditions: 3", "- 1", "conditions: {a: [1], b: }"])
def test_a_scenario_of_another_form_has_no_labels(tmp_path, text):
    """What is wrong with it, the page says."""
    write_summary(tmp_path, "case,status", [["0-a", "done"]])
    (tmp_path / "scenario.yaml").write_text(text)

    assert load_run(tmp_path).labels.conditions == {}
