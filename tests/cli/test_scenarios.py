"""Shipped scenarios are found by name, listed and printed."""

from pathlib import Path

import pytest

from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.yaml_source import (
    FIRST,
    describe_scenarios,
    find_scenario,
    shipped_scenarios,
)

FILES = [*(REPOSITORY / "scenarios").glob("*.yaml")]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """No file of the checkout is at hand."""
    monkeypatch.chdir(tmp_path)


def test_every_scenario_ships():
    """The package has them all, with a description each."""
    assert [*shipped_scenarios()] == sorted(path.stem for path in FILES)
    listed = [line.split(maxsplit=1) for line in describe_scenarios(every=True)]
    assert [name for name, _ in listed] == [*shipped_scenarios()]


def test_a_name_means_the_shipped_scenario():
    """The command line and Python both load it."""
    assert load_scenario(Path("tower")) == load_scenario(REPOSITORY / "scenarios" / "tower.yaml")


def test_a_folder_of_that_name_hides_nothing(tmp_path):
    """It is no scenario, and may be the folder of a run."""
    (tmp_path / "tower").mkdir()

    assert load_scenario(Path("tower")).name == "tower"


def test_of_two_files_of_a_name_neither_is_taken(tmp_path):
    """Nobody's file is passed over, and none hides the shipped one: the path decides."""
    mine = tmp_path / "tower"
    mine.write_text("name: mine\nstructure: {kind: tower}\nlocalization: {method: joint}\n")

    with pytest.raises(InputError, match="both a file here and a scenario of tiswarm's; name "):
        load_scenario(Path("tower"))
    assert load_scenario(mine).name == "mine"


@pytest.mark.parametrize("path", ["tower.yaml", "./x/tower", "../tower", "x" * 5000])
def test_only_bare_names_are_looked_up(path):
    """A path means what it says, so a typing error in it never runs something else."""
    with pytest.raises(InputError):
        load_scenario(Path(path))


@pytest.mark.parametrize("path", ["scenarios/tower.yaml", "tower.yml"])
def test_a_page_that_is_read_outside_the_repository_leads_to_the_name(path, tmp_path, monkeypatch):
    """An installed package has the scenarios that pages name by their files in the repository."""
    monkeypatch.chdir(tmp_path)

    with pytest.raises(InputError, match=rf"^{path}: .*did you mean tiswarm run tower\?$"):
        load_scenario(Path(path))


def test_an_unknown_name_says_where_names_are():
    """The message leads to the list, and to the nearest name."""
    meant = "did you mean tower\\?"
    with pytest.raises(
        InputError, match=rf"^towr: .*; tiswarm scenarios --all lists these; {meant}$"
    ):
        find_scenario(Path("towr"))


def test_a_scenario_is_printed_as_it_is(tiswarm):
    """Users start from a copy of it."""
    listed, printed, unknown = (tiswarm("scenarios", *name) for name in ([], ["tower"], ["towr"]))

    *first, more = listed.stdout.splitlines()
    assert first == describe_scenarios()
    assert [line.split()[0] for line in first] == [*FIRST]
    assert more == f"tiswarm scenarios --all lists all {len(FILES)}"
    assert printed.stdout == (REPOSITORY / "scenarios" / "tower.yaml").read_text()
    assert unknown.returncode == 2
    assert unknown.stderr == (
        "tiswarm: error: towr: there is no such scenario; tiswarm scenarios --all lists all\n"
    )
