"""GTSAM solves the problems of the method least-squares too, by formulas of its own."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from tests.benchmarks.commands import call
from tiswarm.localization.least_squares import improve, trust_region
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.sensing import SensingParams, observe

pytest.importorskip("gtsam")
from benchmarks.least_squares.factor_graph import levenberg_marquardt


@pytest.mark.parametrize("yaw_bias_deg", [0.0, 15.0])
def test_gtsam_and_scipy_find_the_same_minimum(towers, yaw_bias_deg):
    """Both solvers come from one start to the same positions and yaws."""
    history = towers[0]
    log = observe(history, SensingParams(spawn_noise=0.0, yaw_bias_deg=yaw_bias_deg))
    start = history.position + 0.1 * np.random.default_rng(0).normal(size=(30, 3))
    params = LeastSquaresParams(odometry_width=0.05)

    ours, theirs = (
        improve(log, params, start, minimize=solver)
        for solver in (trust_region, levenberg_marquardt)
    )

    np.testing.assert_allclose(ours.position, theirs.position, atol=1e-3)
    assert theirs.residual[-1] < 0.1 * theirs.residual[0]
    if yaw_bias_deg:
        np.testing.assert_allclose(ours.yaw, theirs.yaw, atol=1e-3)


def test_a_robot_without_measurements_stays_at_its_start(towers):
    """Neither solver needs a residual for every robot."""
    log = observe(towers[0], SensingParams(spawn_noise=0.0))
    silent = dataclasses.replace(
        log,
        contacts=log.contacts[(log.contacts[:, [0, 2]] != 29).all(axis=1)],
        flip_height=np.where(np.arange(30) == 29, np.nan, log.flip_height),
    )
    start = np.random.default_rng(0).normal(scale=9.0, size=(30, 3))
    params = LeastSquaresParams(walk_contacts=False, odometry=False, non_overlap=False, rounds=2)

    for solver in (trust_region, levenberg_marquardt):
        found = improve(silent, params, start, minimize=solver).position

        np.testing.assert_array_equal(found[29], start[29])
        assert (found[1:29] != start[1:29]).any(axis=1).all()


def test_the_command_compares_the_solvers(tmp_path):
    """The table has a row a log and solver, with the error where the truth is known."""
    done = call("least_squares", "--robots", 6, "--seeds", 1, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "least-squares.csv")
    assert table["solver"].tolist() == ["scipy", "gtsam"] * 2
    assert table["log"].drop_duplicates().tolist() == ["tower/0-baseline", "cantilever/0-baseline"]
    assert (table["largest_distance_R"] < 0.01).all()
    assert table["rmse_R"].notna().all()
