"""GTSAM minimizes the chi-square of `least-squares` too, by formulas of its own."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from tests.benchmarks.commands import call
from tests.structures import with_directions
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import Cues
from tiswarm.sensing import SensingParams, observe

pytest.importorskip("gtsam")
from benchmarks.least_squares.__main__ import PARAMS, ours
from benchmarks.least_squares.factor_graph import levenberg_marquardt


@pytest.mark.parametrize("robots", [[], range(0, 30, 2)], ids=["contacts", "directions"])
@pytest.mark.parametrize("yaw_bias_deg", [0.0, 15.0])
def test_gtsam_finds_the_same_minimum(towers, yaw_bias_deg, robots):
    """Both solvers come from one start to the same positions and yaws."""
    history = towers[0]
    noise = SensingParams(spawn_noise=0.05, yaw_bias_deg=yaw_bias_deg)
    log = with_directions(observe(history, noise), history, sd_deg=1.0, robots=robots)
    start = history.position + 0.1 * np.random.default_rng(0).normal(size=(30, 3))
    start[0] = history.position[0]
    problem = pose_problem(log, PARAMS)

    found = ours(log, problem, start, np.zeros(30))
    theirs = levenberg_marquardt(problem, start, np.zeros(30))

    np.testing.assert_allclose(found.position, theirs.position, atol=2e-3)
    np.testing.assert_allclose(found.yaw, theirs.yaw, atol=2e-3)
    assert found.chi_square == pytest.approx(theirs.chi_square, abs=0.01)
    assert bool(found.yaw.any()) == bool(yaw_bias_deg)


def test_a_robot_without_measurements_stays_at_its_start(towers):
    """Neither solver needs a residual for every robot."""
    log = observe(towers[0], SensingParams(spawn_noise=0.0))
    silent = dataclasses.replace(
        log,
        contacts=log.contacts[(log.contacts[:, [0, 2]] != 29).all(axis=1)],
        flip_height=np.where(np.arange(30) == 29, np.nan, log.flip_height),
    )
    start = np.random.default_rng(0).normal(scale=9.0, size=(30, 3))
    params = dataclasses.replace(PARAMS, cues=Cues(walk_contacts=False, odometry=False))
    problem = pose_problem(silent, params)

    for found in (
        ours(silent, problem, start, np.zeros(30)),
        levenberg_marquardt(problem, start, np.zeros(30)),
    ):
        np.testing.assert_array_equal(found.position[29], start[29])
        assert (found.position[1:29] != start[1:29]).any(axis=1).all()


@pytest.mark.trial
def test_the_command_compares_the_solvers(tmp_path):
    """The table has a row a log and solver, with the error where the truth is known."""
    done = call("least_squares", "--robots", 6, "--seeds", 1, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "least-squares.csv")
    assert table["solver"].tolist() == ["tiswarm", "gtsam"] * 2
    assert table["log"].drop_duplicates().tolist() == ["tower/0-baseline", "cantilever/0-baseline"]
    assert (table["largest_distance_R"] < 0.01).all()
    assert table["rmse_R"].notna().all()
