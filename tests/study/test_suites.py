"""Sensor suites of Table I side by side: prices, accuracy, and the figure and page of both."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.runs import REPOSITORY
from tests.structures import SUITES
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.page import write_page
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario

TABLE_1 = load_scenario(REPOSITORY / "scenarios" / "table-1.yaml", ["robots=8", "seeds=2"])
CHOSEN = ["fireant-v3", "fireant-v3-joint", "zooids", "zooids-joint", "zooids-touch", "kilobot"]


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Towers under a few conditions of the scenario."""
    conditions = {name: TABLE_1.conditions[name] for name in CHOSEN}
    scenario = replace(TABLE_1, conditions=conditions, sweep={"structure.kind": ("tower",)})
    return study.run(scenario, tmp_path_factory.mktemp("suites"), progress=Progress()).folder


def test_each_suite_has_three_conditions():
    """Its system's own way, `joint` on the same log, and `joint` with touch; ours has touch."""
    conditions = {f"{name}{way}" for name in SUITES for way in ("", "-joint", "-touch")}

    assert {*TABLE_1.conditions} == conditions - {"fireant-v3-touch"}


def test_the_joint_of_our_own_sensors_is_plain_joint(measured, tmp_path):
    """Other conditions of the run and the choice of a suite change no byte."""
    path = tmp_path / "plain.yaml"
    path.write_text(
        "{name: plain, robots: 8, structure: {kind: tower}, localization: {method: joint},"
        " sensing: {tilt_noise_deg: 1.0, yaw_noise_deg: 2.0}}"
    )
    plain = study.run(load_scenario(path), tmp_path, progress=Progress()).folder
    [ours] = (measured / "cases").glob("0-*fireant-v3-joint")
    [theirs] = (plain / "cases").glob("0-*")

    for name in ("sensing.jsonl", "truth.csv", "estimate.csv", "robots.csv", "convergence.csv"):
        assert (ours / name).read_bytes() == (theirs / name).read_bytes()
    assert not (plain / "suites.csv").exists()


def test_suites_stand_beside_their_prices(measured):
    """A row for each condition; located are robots that the method or its cues determine."""
    table = pd.read_csv(measured / "suites.csv").set_index("condition")
    listed = pd.read_csv(REPOSITORY / "docs" / "columns.csv").query("file == 'suites.csv'")[
        "column"
    ]
    assert {*", ".join(listed).split(", ")} <= {*table}
    summary = pd.read_csv(measured / "summary.csv").groupby("condition", sort=False)

    measures = ["rmse_located_R", "procrustes_disparity", "floppy_modes"]
    assert list(table) == [
        "structure.kind", "suite", "way", "needs", "cases",
        "usd_1", "usd_100", "usd_1000", "usd_10000",
        "rmse_R_mean", "rmse_R_ci95", "located_mean", "located_ci95_low", "located_ci95_high",
        *(f"{name}_{kind}" for name in measures for kind in ("mean", "ci95")),
    ]  # fmt: skip
    assert list(table.index) == CHOSEN
    assert table.loc["zooids-touch", "suite":"way"].tolist() == ["zooids", "joint / touch"]
    assert table["usd_100"].tolist() == [2000.0, 2000.0, 1100.0, 1100.0, 3100.0, 0.0]
    for name in ("rmse_R", "procrustes_disparity", "floppy_modes"):
        np.testing.assert_allclose(table[f"{name}_mean"], summary[name].mean())
    assert (table["floppy_modes_mean"] > 0).tolist() == (table["located_mean"] < 1.0).tolist()
    assert table.loc[["zooids", "zooids-joint"], "located_mean"].tolist() == [0.0, 0.0]  # no z
    assert table.loc["kilobot", "located_mean"] == summary["located"].mean()["kilobot"]
    assert table["rmse_located_R_mean"].isna().equals(table["located_mean"] == 0.0)


def test_the_page_compares_suites_first(measured):
    """The table follows the headline, and says what robots of a lattice mean here."""
    run = load_run(measured)
    draw_figures(run, Progress())

    page = write_page(run, Progress()).read_text()

    assert re.findall(r"<h3[^>]*><a[^>]*>([^<]*)", page)[0] == "Table I, measured"
    assert "<th scope" in page
    assert "robots whose docks know the pose of a connection" in page
    assert "10,000 robots [USD]" in page
    assert re.findall(r'title="(figures/[^"]*)"', page)[0] == "figures/price-and-error.png"
    drawn = {*re.findall(r"<text[^>]*>([^<]*)", page)}
    assert {"FireAntV3", "Zooids", "Algorithm 1", "hop by hop", "joint / touch"} <= drawn
    assert {"RMSE of all robots [R]"} <= drawn
    assert not {"zooids", "virtual-force", "hop-by-hop"} & drawn
