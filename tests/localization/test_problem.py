"""What a log says is true without noise, and as unsure as it is said to be with noise."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests import foreign
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.measurements.cues import measure
from tiswarm.measurements.observability import observability
from tiswarm.sensing import SensingParams, observe

ALL = JointParams()
TRUSTING = JointParams(solve_yaw=False)


def true_yaw(log, history):
    """By how much sensed orientations must be turned about the vertical to be true [rad]."""
    true = np.array([walk.orientation_wxyz[-1] for walk in history.walks])
    sensed = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    return (Rotation.from_quat(true, scalar_first=True) * sensed.inv()).as_rotvec()[:, 2]


@pytest.mark.parametrize("bias", [0.0, 25.0])
def test_every_equation_holds_where_robots_truly_are(towers, bias):
    """Contacts of every stance, heights, grounds and spawns agree with the final poses."""
    for history in towers:
        log = observe(history, SensingParams(spawn_noise=0.0, yaw_bias_deg=bias))
        yaw = true_yaw(log, history)

        known = pose_problem(log, ALL)

        gap = known.residual(history.position, yaw)
        felt = {tuple(row) for row in measure(log, ALL.used_cues).sensed_contacts.tolist()}
        assert {tuple(row) for row in known.rows.sensed_contacts.tolist()} <= felt
        assert (known.is_final.sum(), len(gap)) > (len(log.contacts) - 1, len(log.contacts))
        assert -1e-9 < gap.min() <= gap.max() < 0.02 + 1e-9  # as near as docks must be to feel
        assert known.sensed_place()[1][1:].all()
        np.testing.assert_allclose(_gaps(known, history.position, yaw), 0.0, atol=1e-9)


@settings(max_examples=20)
@given(angle=st.floats(-10.0, 10.0))
def test_turning_everything_about_the_vertical_stretches_nothing(towers, angle):
    """Contacts cannot tell a swarm from the same one turned, robots and all."""
    known = pose_problem(observe(towers[0], SensingParams(yaw_bias_deg=5.0)), ALL)
    yaw = np.linspace(-1.0, 1.0, len(known.part))
    position = towers[0].position
    turned = Rotation.from_rotvec([0.0, 0.0, angle]).apply(position)

    lengths = known.residual(turned, yaw + angle)

    np.testing.assert_allclose(lengths, known.residual(position, yaw), atol=1e-9)


@pytest.mark.parametrize(
    "noise",
    [
        SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, spawn_noise=0.2),
        SensingParams(yaw_bias_deg=3.0, tilt_noise_deg=0.3, spawn_noise=0.0),
    ],
)
def test_residuals_are_as_large_as_foretold(towers, noise):
    """Divided by the standard deviation that follows from the noise they have one of about 1."""
    contacts, places = [], []
    for history in towers:
        for seed in range(5):
            log = observe(dataclasses.replace(history, seed=seed), noise)
            known = pose_problem(log, TRUSTING)
            gap = known.residual(history.position, np.zeros(log.robot_count))
            contacts.append(gap / np.sqrt(known.variance))
            away = _gaps(known, history.position, np.zeros(log.robot_count))
            places.append(away * np.sqrt(known.planes.precision))

    # 15 logs of some 100 equations each, many of which share a flip
    assert 0.85 < np.std(np.concatenate(contacts)) < 1.15
    assert 0.85 < np.sqrt(np.mean(np.concatenate(places) ** 2)) < 1.15


def test_what_equations_are_too_few_for_is_floppy(towers):
    """Where none says what others say already, nothing else is."""
    for history in towers:
        log = observe(history, SensingParams())
        for off in (("height", "ground", "walk_contacts"), ("walk_contacts",), ()):
            params = JointParams(cues=Cues(**dict.fromkeys(off, False)))
            left = observability(log, params.used_cues)
            short = pose_problem(log, params).underdetermination * left.unknowns

            assert 0.0 <= short <= left.floppy_modes + 1e-9
            assert short > 0.5 * left.floppy_modes or "height" in params.used_cues


def test_a_cue_that_is_off_says_nothing(towers):
    """Without cues there are no equations; with one of them, only its own."""
    log = observe(towers[0], SensingParams(spawn_noise=0.0))
    none = dict.fromkeys(["contacts", "height", "ground", "walk_contacts", "odometry"], False)
    silent = pose_problem(log, JointParams(cues=Cues(**none)))
    walked = pose_problem(log, JointParams(cues=Cues(**none | {"walk_contacts": True})))
    level = pose_problem(log, JointParams(cues=Cues(**none | {"height": True})))

    assert len(silent.robot) == 0
    assert silent.underdetermination == 1.0
    assert (silent.loose[1:] == np.eye(3)).all()
    assert len(walked.robot) > 0
    assert not walked.is_final.any()
    assert level.underdetermination == pytest.approx(2.0 / 3.0)
    assert (level.loose[1:] == np.diag([1.0, 1.0, 0.0])).all()


def _gaps(known, position, yaw):
    """How far robots are from the planes on which they were measured to be, shape (P,)."""
    robot, direction, point, walk, _ = known.planes
    walked = np.exp(1j * yaw[robot]) * (walk @ [1.0, 1j])
    away = point - position[robot] - np.column_stack([walked.real, walked.imag, 0.0 * walked.real])
    return (direction * away).sum(axis=1)


def test_parts_that_nothing_ties_are_held_apart_as_precisely_as_stated():
    """Along every axis, with the sd of a height, each beyond the reach of the one before."""
    place = np.zeros((3, 3))

    known = pose_problem(foreign.silent(place), JointParams(height_sd=0.1))

    planes = known.planes
    assert planes.robot.tolist() == [1, 1, 1, 2, 2, 2]
    np.testing.assert_allclose(planes.precision, 0.1**-2)
    first, second = planes.point.reshape(2, 3, 3).sum(axis=1)
    assert 0.0 < first[0] < second[0]
    np.testing.assert_allclose([first[1:], second[1:]], 0.0, atol=1e-12)
