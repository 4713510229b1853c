"""Loads of contacts in the files, pages and exports of runs whose docks have a strength."""

import filecmp
import json

import numpy as np
import pandas as pd
import pytest

import tiswarm
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.app.results import open_run
from tiswarm.base.progress import Progress
from tiswarm.report.page import write_page
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view, view_data
from tiswarm.scenario.expansion import load_scenario

STRENGTH = {"law": "bending", "limit": 25.0, "robot_mass_kg": 1.2, "radius_mm": 33.0}
LOADED = f"structure={json.dumps({'kind': 'tower', 'strength': STRENGTH})}"
"""Structure of these runs: a tower whose docks have a strength in N m."""

SETTINGS = [
    "name=loads",
    "robots=15",
    "seeds=[2]",
    "conditions={a: {localization.method: hop-by-hop}}",
]


def _run(folder, *further):
    scenario = load_scenario(REPOSITORY / "scenarios" / "tower.yaml", [*SETTINGS, *further])
    return study.run(scenario, folder, progress=Progress()).folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a run of a tower whose docks have a strength in N m."""
    return _run(tmp_path_factory.mktemp("loaded"), LOADED)


def test_the_table_of_loads_has_the_margins_of_robots(folder):
    """By a loop over the contacts of each robot; margin times load is the limit."""
    case = folder / "cases" / "2-a"
    loads = pd.read_csv(case / "loads.csv")
    robots = pd.read_csv(case / "robots.csv")

    np.testing.assert_allclose(loads["margin"] * loads["bending_N_m"], 25.0, rtol=1e-9)
    for robot, margin in zip(robots["robot"], robots["margin"], strict=True):
        of_robot = [
            row.margin
            for row in loads.itertuples()
            if robot == row.robot or str(robot) == row.neighbor
        ]
        assert min(of_robot, default=np.nan) == pytest.approx(margin, nan_ok=True)


def test_a_structure_in_python_has_the_loads_of_a_run(folder):
    """The same table, digit by digit, with the seed before it."""
    stored = (folder / "cases" / "2-a" / "loads.csv").read_text()

    table = tiswarm.grow(
        {"kind": "tower", "strength": STRENGTH}, robots=15, seeds=[2], quiet=True
    ).load_table

    assert {*table["seed"]} == {2}
    of_structure = table.drop(columns="seed")
    assert of_structure.to_csv(index=False, lineterminator="\n") == stored


def test_exports_have_the_table_of_loads(folder, tmp_path):
    """Of a case of a run, with its bytes; of a structure."""
    structures = tiswarm.grow(
        {"kind": "tower", "strength": STRENGTH}, robots=15, seeds=[2], quiet=True
    )

    open_run(folder).export("csv", out=tmp_path / "case", quiet=True)
    structures.export("csv", out=tmp_path / "structure", quiet=True)
    structures.export("parquet", out=tmp_path / "parquet", quiet=True)

    stored = folder / "cases" / "2-a" / "loads.csv"
    assert filecmp.cmp(stored, tmp_path / "case" / "loads.csv", shallow=False)
    assert filecmp.cmp(stored, tmp_path / "structure" / "loads.csv", shallow=False)
    packed = pd.read_parquet(tmp_path / "parquet" / "loads.parquet")
    assert packed["neighbor"].tolist() == structures[0].load_table["neighbor"].tolist()


def test_the_page_lists_the_weakest_contacts(folder):
    """Ten at most, with the units of the strength, below a heading."""
    page = write_page(load_run(folder), Progress()).read_text()
    loads = pd.read_csv(folder / "cases" / "2-a" / "loads.csv")

    table = page[page.index('aria-label="Weakest contacts"') :]
    table = table[: table.index("</table>")]

    assert "bending [N m]" in table
    assert "stress [MPa]" in table
    assert table.count("<tr>") == 1 + min(10, len(loads))
    assert f"here {len(loads)}" in page


def test_structures_without_an_estimate_have_loads_too(folder, tmp_path):
    """The same table, and margins in the view."""
    measured = _run(tmp_path, LOADED, "localization={method: none}", "conditions={a: {}}")

    loads = "cases/2-a/loads.csv"
    assert filecmp.cmp(folder / loads, measured / loads, shallow=False)
    case = load_run(measured).cases[0]
    colors = view_data(read_case_view(case), read_case_view(case).colorings)["colors"]
    assert [color["label"] for color in colors] == ["sensed force", "margin"]


def test_docks_that_hold_any_load_have_no_table_of_loads(tmp_path):
    """Neither in the folder of the case nor on the page nor in exports."""
    folder = _run(tmp_path)

    open_run(folder).export("csv", out=tmp_path / "out", quiet=True)

    assert not (folder / "cases" / "2-a" / "loads.csv").exists()
    assert not (tmp_path / "out" / "loads.csv").exists()
    assert "margin" not in pd.read_csv(folder / "cases" / "2-a" / "robots.csv")
    page = write_page(load_run(folder), Progress()).read_text()
    assert 'aria-label="Weakest contacts"' not in page
