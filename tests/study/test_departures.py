"""Runs of structures that lose robots: what logs, scores, tables and views have of them."""

import json

import numpy as np
import pandas as pd
import pytest

import tiswarm
from tests.runs import REPOSITORY
from tests.structures import grown
from tiswarm import study
from tiswarm.app.logs import open_log
from tiswarm.base.progress import Progress
from tiswarm.evaluation.tables import LOSSES
from tiswarm.records.sensing_file import log_entries, read_sensing_log
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view, view_data, view_log
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.params import DepartureParams, TowerParams

LEAVING = "structure={kind: tower, departures: {rate: 0.3}}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a run of a tower of 15 robots, a third of which leave."""
    scenario = load_scenario(
        REPOSITORY / "scenarios" / "tower.yaml",
        [
            LEAVING,
            "robots=15",
            "seeds=[1]",
            "conditions={a: {localization.method: online}, b: {localization.method: hop-by-hop}}",
        ],
    )
    return study.run(scenario, tmp_path_factory.mktemp("leaving"), progress=Progress()).folder


@pytest.fixture(scope="module")
def history():
    """The structure of that run."""
    params = TowerParams(departures=DepartureParams(rate=0.3))
    return grown(params, robots=15, seed=1)


def test_a_log_says_where_robots_left(history, folder):
    """After the line of the robot that joined last before; nobody names a robot that has left."""
    log = observe(history, SensingParams())
    joined, gone, left = 0, set(), []
    for line in list(log_entries(log))[1:]:
        if line.get("event") == "leave":
            gone.add(line["robot"])
            left.append((line["robot"], joined))
            continue
        stances = [line, *line["stances"]]
        assert not gone & {other for stance in stances for _, other, _ in stance["contacts"]}
        joined += 1

    expected = sorted((robot, after) for robot, after, _ in history.departures.tolist())
    assert sorted(left) == expected
    assert len(expected) > 2
    stored = read_sensing_log(folder / "cases" / "1-a" / "sensing.jsonl")
    assert [*log_entries(stored)][1:] == [
        json.loads(line)
        for line in (folder / "cases" / "1-a" / "sensing.jsonl").read_text().splitlines()[1:]
    ]
    np.testing.assert_array_equal(stored.gone, log.gone)
    np.testing.assert_array_equal(stored.left_after, log.left_after)


@pytest.mark.parametrize("condition", ["a", "b"])
def test_robots_that_remain_are_scored(folder, history, condition):
    """Their root mean square error, by hand; those that left have a position, and no error."""
    case = folder / "cases" / f"1-{condition}"
    robots, estimate = pd.read_csv(case / "robots.csv"), pd.read_csv(case / "estimate.csv")
    scores = json.loads((case / "case.json").read_text())["scores"]
    stays = ~history.is_gone

    lost = {robot: (LOSSES[k], after) for robot, after, k in history.departures.tolist()}
    stated = robots["lost"].dropna()
    assert (
        dict(
            zip(stated.index, zip(stated, robots["lost_after"].dropna(), strict=True), strict=True)
        )
        == lost
    )
    assert (estimate["gone"] == "no").tolist() == stays.tolist()
    assert (robots["lost"].isna()).tolist() == stays.tolist()
    off = estimate[["x_R", "y_R", "z_R"]].to_numpy() - history.position
    error = np.linalg.norm(off, axis=1)
    assert scores["rmse_R"] == pytest.approx(np.sqrt((error[stays] ** 2).mean()), rel=1e-9)
    assert robots["error_R"].isna().tolist() == history.is_gone.tolist()
    assert scores["height_R"] == pytest.approx(history.position[stays, 2].max())
    profile = pd.read_csv(folder / "profiles.csv")
    by_join = profile[(profile["by"] == "join") & (profile["condition"] == condition)]
    assert by_join["count"].sum() == np.count_nonzero(stays)


def test_all_ways_to_score_agree(folder, tmp_path):
    """On the robots that remain: the run, its files, and the page of its log."""
    case, page = folder / "cases" / "1-a", tmp_path / "view.html"
    rmse = json.loads((case / "case.json").read_text())["scores"]["rmse_R"]
    truth, table = case / "truth.csv", case / "estimate.csv"
    estimate = open_log(case / "sensing.jsonl").with_estimate(table)
    left = int(estimate.gone.sum())

    text = estimate.view(truth, out=page).read_text()

    assert left > 2
    for found in (tiswarm.score(truth, table), tiswarm.score(truth, estimate)):
        assert found["RMSE"] == pytest.approx(rmse, rel=1e-9)
        assert found.left == left
    assert f"{15 - left} robots" in text
    assert f"The RMSE is {rmse:.3g} R. {left} left." in text
    view = view_log(estimate.log, estimate, estimate.log.positions(truth))
    assert np.isnan(view.error).tolist() == estimate.gone.tolist()


def test_growth_counts_who_is_left(folder, history):
    """Height after each join is that of the robots that stand then; losses add up."""
    table = pd.read_csv(folder / "cases" / "1-a" / "growth.csv")
    events = history.departures.tolist()
    for n in range(1, 16):
        gone = {robot for robot, after, _ in events if after <= n}
        top = max(history.position[j, 2] for j in range(n) if j not in gone)
        assert table["height_R"][n - 1] == pytest.approx(top)
        assert table["left"][n - 1] + table["fell"][n - 1] == len(gone)
    assert (table["died"] == 0).all()
    means = pd.read_csv(folder / "table.csv").iloc[0][["left_mean", "fell_mean", "died_mean"]]
    assert means.tolist() == [sum(k == event for _, _, k in events) for event in range(3)]


def test_a_view_shows_who_is_left(folder, history):
    """Robots that left are in no picture of the run, nor are their contacts."""
    view = read_case_view(load_run(folder).cases[0])
    shown = view_data(view)

    stays = np.flatnonzero(~history.is_gone)
    assert view.has_truth
    assert shown["robot"] == stays.tolist()
    pairs = {(shown["robot"][i], shown["robot"][j]) for i, _, j, _ in shown["contacts"]}
    assert pairs == {(i, j) for i, _, j, _ in history.contacts.tolist()}


@pytest.mark.parametrize("losses", [LEAVING, "structure.strength={limit: 100}"])
def test_robots_that_leave_or_fall_may_localize_each_other(losses):
    """A scenario of `distributed` may have departures, and docks that break."""
    file = REPOSITORY / "scenarios" / "tower.yaml"

    scenario = load_scenario(
        file, [losses, "localization={method: distributed}", "conditions={a: {}}"]
    )

    assert scenario.localization.method == "distributed"
