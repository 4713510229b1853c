"""Variances of a robot's arms at all stances, against turns of one stance after the other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiswarm.measurements.odometry import Odometry
from tiswarm.records.sensing_log import SensingNoise
from tiswarm.sensing import SensingParams, observe

UNIT = 1e-6


@pytest.fixture(scope="module")
def log(towers):
    """What the robots of a small tower sensed."""
    return observe(towers[0], SensingParams())


def _turned(log, stance, by):
    """Turn what a robot's compass says at one of its stances, counted over all stances."""
    walks = Odometry(log)
    robot, turn = walks.owner[stance], Rotation.from_rotvec(by)
    own = log.orientation_wxyz.copy(), log.stances.orientation_wxyz.copy()
    if stance == walks.final[robot]:
        which, row = 0, robot
    else:
        which, row = 1, log.stances.start[robot] + stance - walks.first[robot]
    right = Rotation.from_quat(own[which][row], scalar_first=True)
    own[which][row] = (turn * right).as_quat(scalar_first=True)
    stances = replace(log.stances, orientation_wxyz=own[1])
    return replace(log, orientation_wxyz=own[0], stances=stances)


@pytest.mark.parametrize("bias_deg", [None, 9.0])
def test_variances_of_arms_are_those_of_turned_stances(log, bias_deg):
    """Each stance is off by itself, about each axis; all are off by the bias about the vertical."""
    noise = SensingNoise(tilt_deg=1.0, yaw_deg=2.0, yaw_bias_deg=bias_deg)
    walks = Odometry(log, noise)
    robot = int(np.bincount(walks.owner).argmax())
    stances = np.arange(walks.first[robot], walks.final[robot] + 1)
    dock = np.zeros(len(stances), np.int64)
    arm, variance = walks.arms(stances, dock)
    slow = np.zeros(arm.shape)
    for stance in stances.tolist():
        for axis, sd_deg in zip(np.eye(3), (1.0, 1.0, 2.0), strict=True):
            moved = Odometry(_turned(log, stance, UNIT * axis), noise).arms(stances, dock)[0]
            slow += ((moved - arm) / UNIT * np.radians(sd_deg)) ** 2
    across = np.cross([0.0, 0.0, 1.0], arm)

    slow += (np.radians(bias_deg or 0.0) * across) ** 2

    assert len(stances) > 3
    np.testing.assert_allclose(variance, slow, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("bias_deg", [None, 9.0])
def test_variances_along_axes_are_those_of_coordinates(log, bias_deg):
    """Along any axis the bias turns the arm, too."""
    walks = Odometry(log, SensingNoise(tilt_deg=1.0, yaw_deg=2.0, yaw_bias_deg=bias_deg))
    stances = np.arange(len(walks.owner))
    dock = stances % walks.arm.shape[1]
    arm, variance = walks.arms(stances, dock)

    along = [walks.variance_along(np.tile(e, (len(arm), 1)), stances, dock) for e in np.eye(3)]

    np.testing.assert_allclose(np.transpose(along), variance, rtol=1e-9, atol=1e-12)


def test_arms_are_those_of_a_log_in_another_unit(log):
    """Lengths are in R, so the unit of a log cancels."""
    in_mm = replace(
        log, dock_radius=30.0 * log.dock_radius, dock_offset_body=30.0 * log.dock_offset_body
    )
    stances = np.arange(len(Odometry(log).owner))

    here, there = (Odometry(each).arms(stances, 0 * stances) for each in (log, in_mm))

    np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-12)
