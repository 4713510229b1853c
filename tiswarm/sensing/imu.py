"""Orientations that robots sense: noise of tilt and yaw, sensors that drift or are stuck."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.sensing.failures import failing
from tiswarm.sensing.params import SensingParams
from tiswarm.world.history import History


def of_shape(params: SensingParams, *, is_planar: bool) -> SensingParams:
    """Return the settings without yaw noise where robots are planar, which know their plane."""
    return replace(params, yaw_noise_deg=0.0, yaw_bias_deg=0.0) if is_planar else params


def sensed_orientation(history: History, length: Ints, params: SensingParams) -> Reals:
    """Return the orientation sensed at each stance of each robot, shape (all stances, 4)."""
    true = np.concatenate([walk.orientation_wxyz for walk in history.walks])
    if params.tilt_noise_deg == params.yaw_noise_deg == params.yaw_bias_deg == 0.0:
        return true
    robot = np.repeat(np.arange(len(length)), length)
    stance = np.concatenate([np.arange(count) for count in length])
    turned = sensed_turn(history.seed, robot, stance, params, is_planar=history.is_planar)
    sensed = turned * Rotation.from_quat(true, scalar_first=True)
    return sensed.as_quat(canonical=True, scalar_first=True)


def sensed_turn(
    seed: int, robot: Ints, stance: Ints, params: SensingParams, *, is_planar: bool
) -> Rotation:
    """Draw turns from true to sensed orientations, one for each (robot, stance), shape (n,) both.

    Planar robots sense no tilt about the first axis; leave out their noise of yaw.
    """
    draw = 3 * stance[:, None] + np.arange(3)
    sd = np.radians([params.tilt_noise_deg, params.tilt_noise_deg, params.yaw_noise_deg])
    if is_planar:
        sd[0] = 0.0
    turn = sd * normal(seed, "orientation", robot[:, None], draw)
    bias = np.zeros_like(turn)
    bias[:, 2] = np.radians(params.yaw_bias_deg) * normal(seed, "yaw bias", robot, 0)
    return Rotation.from_rotvec(bias) * Rotation.from_rotvec(turn)


def failed_orientation(
    history: History, length: Ints, sensed: Reals, params: SensingParams
) -> Reals:
    """Return orientations where some sensors drift or are stuck.

    One that drifts turns by the same angle at each flip, about an axis of the robot's own: from the
    second stance on it is off. One that is stuck repeats its first value.

    Args:
        history: True history of the structure.
        length: Stances of each robot, shape (N,).
        sensed: Orientations that working sensors report, shape (all stances, 4).
        params: Settings.

    Returns:
        Orientations, shape (all stances, 4).
    """
    drifts = failing(history, params, "drift")
    is_stuck = failing(history, params, "stuck")
    first = np.cumsum(length) - length
    robot = np.repeat(np.arange(len(length)), length)
    flips = np.arange(len(robot)) - first[robot]
    reported = sensed.copy()
    rows = np.flatnonzero(drifts[robot] & (flips > 0))
    if rows.size:
        angle = np.radians(params.drift_deg) * flips[rows, None]
        turn = Rotation.from_rotvec(angle * _drift_axis(history)[robot[rows]])
        turned = turn * Rotation.from_quat(sensed[rows], scalar_first=True)
        reported[rows] = turned.as_quat(canonical=True, scalar_first=True)
    rows = np.flatnonzero(is_stuck[robot])
    reported[rows] = sensed[first[robot[rows]]]
    return reported


def _drift_axis(history: History) -> Reals:
    """Draw the unit axis about which each robot's orientation drifts, shape (N, 3)."""
    robot = np.arange(history.robot_count)[:, None]
    axis = normal(history.seed, "drift axis", robot, np.arange(3))
    if history.is_planar:
        axis[:, [0, 2]] = 0.0  # a planar robot turns about y alone
    unit: Reals = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return unit
