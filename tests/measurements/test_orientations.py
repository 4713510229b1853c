"""Connections turn robots without a compass, as well as their noise lets them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

from tests.strategies import rotations
from tests.structures import with_connections, with_directions
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import Cues, JointParams, VirtualForceParams
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.measurements.odometry import Odometry, connections_of, with_orientations
from tiswarm.records.sensing_log import SensingLog, SensingNoise
from tiswarm.sensing import SensingParams, observe

EXACT = SensingNoise(tilt_deg=0.0, yaw_deg=0.0, connection_deg=1.0, direction_deg=1.0)


def connected(history, *, sd_deg=0.0, keep=(0,)) -> SensingLog:
    """Sense final contacts and connections; only the robots to keep have a compass."""
    log = with_connections(observe(history, SensingParams()), history, sd_deg=sd_deg)
    wxyz = np.full_like(log.orientation_wxyz, np.nan)
    wxyz[[*keep]] = log.orientation_wxyz[[*keep]]
    return replace(log, stances=None, orientation_wxyz=wxyz, noise=EXACT)


def turned_by(log, history):
    """How far the orientations of a log are from the true ones, shape (N, 3)."""
    found, true = (
        Rotation.from_quat(one.orientation_wxyz, scalar_first=True) for one in (log, history)
    )
    return (found * true.inv()).as_rotvec()


def test_exact_connections_lead_to_the_true_orientations(towers):
    """From the anchor to every robot, with no residual."""
    for history in towers:
        log = with_orientations(connected(history))

        np.testing.assert_allclose(turned_by(log, history), 0.0, atol=1e-9)
        np.testing.assert_allclose(connections_of(log).residual, 0.0, atol=1e-9)
        assert np.isnan(log.orientation_sd[0]).all()


def test_a_log_of_compasses_stays_as_it_is(towers):
    """Not a bit of it changes, whether or not it has connections."""
    log = connected(towers[0], keep=range(30))

    assert with_orientations(log) is log


def test_residuals_of_each_chained_robot_balance(towers):
    """That is where a sum of squares of rotations is least; those of compasses stay."""
    log = with_orientations(connected(towers[0], sd_deg=5.0, keep=(0, 11)))
    links = connections_of(log)

    total = np.zeros((30, 3))
    np.add.at(total, links.robot, links.residual)
    np.subtract.at(total, links.neighbor, links.residual)

    chained = links.is_chained
    assert np.flatnonzero(~chained).tolist() == [0, 11]
    # To second order in the residuals the mean is that of their logarithms.
    assert np.abs(total[chained]).max() < 0.02 * np.abs(links.residual).max()
    np.testing.assert_allclose(turned_by(log, towers[0])[[0, 11]], 0.0, atol=1e-4)


def test_errors_are_as_large_as_their_standard_deviations(towers):
    """Over 20 draws, mean squares agree; each variance is from 64 draws, uncertain by a sixth."""
    squares, stated = [], []
    for seed in range(20):
        history = replace(towers[0], seed=seed)
        log = with_orientations(connected(history, sd_deg=1.0))
        squares.append(turned_by(log, history)[1:] ** 2)
        stated.append(log.orientation_sd[1:, [0, 0, 1]] ** 2)

    assert np.mean(squares) == pytest.approx(np.mean(stated), rel=0.15)
    ratio = np.mean(squares, axis=(0, 2)) / np.mean(stated, axis=(0, 2))
    assert 0.4 < ratio.min() < ratio.max() < 2.5


def test_noise_of_the_anchor_turns_all_robots(towers):
    """Whom connections turn exactly shares the error of the compass that they start from."""
    log = connected(towers[0])
    noisy = replace(log, noise=replace(EXACT, tilt_deg=1.0, yaw_deg=3.0, connection_deg=0.0))

    sd = with_orientations(noisy).orientation_sd[1:]

    np.testing.assert_allclose(sd, np.radians([1.0, 3.0]) * np.ones((29, 1)), rtol=0.35)
    np.testing.assert_allclose(sd, sd[:1] * np.ones((29, 1)), rtol=1e-3)


@settings(max_examples=10)
@given(wxyz=rotations)
def test_a_turned_anchor_turns_all_robots(towers, wxyz):
    """Orientations are relative to the anchor's."""
    log = connected(towers[0], sd_deg=2.0)
    turn = Rotation.from_quat(wxyz, scalar_first=True)
    anchor = turn * Rotation.from_quat(log.orientation_wxyz[0], scalar_first=True)
    elsewhere = replace(log, orientation_wxyz=log.orientation_wxyz.copy())
    elsewhere.orientation_wxyz[0] = anchor.as_quat(scalar_first=True)

    here, there = (
        Rotation.from_quat(with_orientations(one).orientation_wxyz, scalar_first=True)
        for one in (log, elsewhere)
    )

    np.testing.assert_allclose((turn * here * there.inv()).as_rotvec(), 0.0, atol=1e-6)


def test_a_robot_without_connections_is_disconnected(towers):
    """What its docks sensed is left out, and nothing of other robots; its height counts."""
    log = connected(towers[0])
    ends = log.connections[:, [0, 2]]
    cut = replace(log, connections=log.connections[(ends != 7).all(axis=1)])

    rows, known = (measure(one, cue_names()).sensed_contacts for one in (cut, log))
    found = localize(cut, JointParams(chains=2, steps=300, hold_steps=100))

    of_others = known[(known[:, [0, 3]] != 7).all(axis=1)]
    np.testing.assert_array_equal(rows, of_others)
    assert np.flatnonzero(found.disconnected).tolist() == [7]
    assert abs(found.position[7, 2] - log.flip_height[7]) < 0.1


def test_touches_of_a_robot_without_an_orientation_do_not_count(towers):
    """Nobody knows where its docks are, whether it felt the touch or was felt."""
    log = connected(towers[0])
    kept = log.connections[(log.connections[:, [0, 2]] != 7).all(axis=1)]
    touches = np.array([[7, -1, 3, -1], [9, 0, 7, -1], [9, 1, 3, -1]], np.int32)

    found = with_orientations(replace(log, connections=kept, touches=touches))

    assert found.touches.tolist() == [[9, 1, 3, -1]]


def test_chained_orientations_are_as_noisy_as_stated(towers):
    """Arms of chained robots have a variance of their own, all others that of the header."""
    log = connected(towers[0], sd_deg=1.0, keep=(0, 5))
    log = replace(log, noise=replace(EXACT, tilt_deg=0.2, yaw_deg=0.4))
    walks = Odometry(log)

    sd = walks.turn_sd[walks.final]

    chained = with_orientations(log).orientation_sd
    np.testing.assert_allclose(sd[[0, 5]], np.radians([[0.2, 0.4]] * 2))
    np.testing.assert_array_equal(np.delete(sd, [0, 5], axis=0), np.delete(chained, [0, 5], axis=0))
    assert sd[-1].min() > np.radians(0.5)


@pytest.mark.parametrize(
    ("params", "largest"),
    [
        (JointParams(chains=3, steps=600, hold_steps=200), 0.25),
        (LeastSquaresParams(cues=Cues(non_overlap=False)), 0.4),
        (VirtualForceParams(iterations=40), 8.0),
    ],
    ids=lambda p: getattr(p, "method", ""),
)
def test_every_method_places_robots_without_a_compass(towers, params, largest):
    """Connections of 1 deg and directions make poses; virtual-force has the contacts alone."""
    for history in towers[:2]:
        log = replace(connected(history, sd_deg=1.0), flip_height=np.full(30, np.nan))
        log = with_directions(log, history, sd_deg=1.0)

        error = np.linalg.norm(localize(log, params).position - history.position, axis=1)

        assert np.sqrt((error**2).mean()) < largest


def test_refined_errors_of_chained_poses_are_as_large_as_sd(towers):
    """Robots share errors of the connections near the anchor, and `sd` accounts for it."""
    squares = []
    for seed in range(6):
        history = replace(towers[seed % 3], seed=seed)
        log = replace(connected(history, sd_deg=1.0), flip_height=np.full(30, np.nan))
        log = with_directions(log, history, sd_deg=1.0)
        found = localize(log, JointParams(chains=2, steps=500, hold_steps=150))
        error = np.linalg.norm(found.position - history.position, axis=1)[1:]
        squares.append(((error / found.sd[1:]) ** 2).mean())

    assert 0.5 < np.mean(squares) < 1.8
