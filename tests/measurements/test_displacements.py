"""A measured vector between two centers makes three rows, in the frame of the robot that saw it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.measurements.test_orientations import connected
from tiswarm.evaluation.metrics import rmse
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import JointParams, VirtualForceParams
from tiswarm.measurements.cues import measure
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import with_orientations
from tiswarm.measurements.rigidity import weld
from tiswarm.measurements.verdicts import describe_outliers
from tiswarm.records.sensing_log import SensingNoise
from tiswarm.sensing import SensingParams, observe

SD = 0.05


def seen(log, history, *, sd=0.0, seed=0):
    """Let each robot see the center of the one before it, with an error along each axis."""
    rng = np.random.default_rng(seed)
    later = np.arange(1, log.robot_count)
    away = history.position[later - 1] - history.position[later] + rng.normal(0.0, sd, (29, 3))
    turn = Rotation.from_quat(history.orientation_wxyz[later], scalar_first=True)
    return np.column_stack([later, later - 1, turn.inv().apply(away), np.full(29, SD)])


@pytest.fixture
def log(towers):
    """What thirty robots know that see the one before them and sense nothing else."""
    log = observe(towers[0], SensingParams())
    return replace(
        log, displacements=seen(log, towers[0]), contacts=log.contacts[:0], stances=None,
        ground_docks=log.ground_docks[:0], flip_height=np.full(30, np.nan),
        spawn_position=np.full((30, 3), np.nan), noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0),
    )  # fmt: skip


def test_the_true_positions_have_no_residual(log, towers):
    """Each vector has three rows, and leaves no motion of the two robots."""
    rows = measure(log, ["displacements"])

    np.testing.assert_allclose(rows.residual(towers[0].position), 0.0, atol=1e-9)
    assert len(rows) == 87
    np.testing.assert_allclose(rows.own_variance, SD**2)
    assert weld(rows, towers[0].position).floppy_modes == 0


def test_noise_of_the_orientation_counts_across_the_vector(log):
    """A turn moves the far end by its angle times the length, and not along the vector."""
    noisy = replace(log, noise=SensingNoise(tilt_deg=2.0, yaw_deg=2.0))
    rows = measure(noisy, ["displacements"])

    along, *across = (rows.variance() - rows.own_variance).reshape(-1, 3).T
    length = np.linalg.norm(rows.offsets.vector[::3], axis=1)

    np.testing.assert_allclose(along, 0.0, atol=1e-12)
    for each in across:
        np.testing.assert_allclose(np.sqrt(each), np.radians(2.0) * length, rtol=1e-6)


def test_ranges_of_the_same_robots_and_repeated_vectors_count(log):
    """Every reading has rows of its own."""
    vectors = log.displacements
    twice = replace(
        log,
        displacements=np.repeat(vectors, 2, axis=0),
        ranges=np.column_stack([vectors[:, :2], np.ones(29), np.full(29, 0.1), -np.ones(29)]),
    )

    assert len(measure(twice, ["displacements", "ranges"])) == 2 * 87 + 29


@pytest.mark.parametrize(
    "params",
    [
        JointParams(chains=4),
        LeastSquaresParams(),
        HopByHopParams(),
        VirtualForceParams(),
    ],
    ids=lambda params: params.method,
)
def test_methods_place_robots_by_displacements_alone(log, towers, params):
    """Errors add up along a chain of 29 vectors; Algorithm 1 has contacts only."""
    noisy = replace(log, displacements=seen(log, towers[0], sd=SD))

    found = localize(noisy, params)

    error = rmse(found.position, towers[0].position)
    assert (error < 3.0 * SD * np.sqrt(29.0)) == (params.method != "virtual-force")


def test_a_robot_without_a_compass_sees_in_its_chained_orientation(towers):
    """Where no connection leads to it, its vectors have no frame, and are left out."""
    whole = connected(towers[0])
    log = replace(whole, displacements=seen(whole, towers[0]))
    lone = replace(log, connections=log.connections[log.connections[:, 0] != 29])

    rows = measure(log, ["displacements"])

    np.testing.assert_allclose(rows.residual(towers[0].position), 0.0, atol=1e-6)
    assert {*with_orientations(lone).displacements[:, 0]} == {*range(1, 29)}
    assert "displacements" in observability(log, ["displacements"], towers[0].position).cues


def test_an_outlier_is_named(log, towers):
    """One vector of thirty robots that also touch each other is far off."""
    contacts = observe(towers[0], SensingParams()).contacts
    wrong = log.displacements.copy()
    wrong[14, 2:5] += 3.0

    found = localize(
        replace(log, displacements=wrong, contacts=contacts),
        JointParams(chains=4, steps=600, hold_steps=200),
    )

    assert any(
        "displacement to robot 14" in line for line in describe_outliers(log, Path("log"), found)
    )
