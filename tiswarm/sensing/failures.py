"""Robots that fail: mute and deaf ones, and orientation sensors that drift or are stuck.

The header of the log states no failure: robots do not know of them. Anchors never fail.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal, uniform
from tiswarm.sensing.params import Failure, SensingParams
from tiswarm.world.history import History, Walk


def failing(history: History, params: SensingParams, name: Failure) -> Bools:
    """Choose the robots that fail in one way, shape (N,).

    The draw of a robot depends on the seed and the robot alone: a larger share adds robots, and
    those of a structure fail as its first robots did before more joined.
    """
    robot = np.arange(history.robot_count)
    fails: Bools = uniform(history.seed, name, robot, 0) < getattr(params, name)
    return fails & ~history.is_anchor


def sensed_part(history: History, params: SensingParams) -> History:
    """Leave out of a history what deaf and mute robots do not sense: contacts, or all but the end.

    A mute robot keeps its final stance, where later robots touch it.
    """
    is_deaf, is_mute = (failing(history, params, name) for name in ("deaf", "mute"))
    if not (is_deaf | is_mute).any():
        return history
    deaf = [_deaf(w) if d else w for w, d in zip(history.walks, is_deaf, strict=True)]
    walks = [_mute(w) if m else w for w, m in zip(deaf, is_mute, strict=True)]
    return replace(history, walks=tuple(walks))


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
    drifts, is_stuck = (failing(history, params, name) for name in ("drift", "stuck"))
    first = np.cumsum(length) - length
    robot = np.repeat(np.arange(len(length)), length)
    flips = np.arange(len(robot)) - first[robot]
    found = sensed.copy()
    if (rows := np.flatnonzero(drifts[robot] & (flips > 0))).size:
        angle = np.radians(params.drift_deg) * flips[rows, None]
        turn = Rotation.from_rotvec(angle * _drift_axis(history)[robot[rows]])
        turned = turn * Rotation.from_quat(sensed[rows], scalar_first=True)
        found[rows] = turned.as_quat(canonical=True, scalar_first=True)
    rows = np.flatnonzero(is_stuck[robot])
    found[rows] = sensed[first[robot[rows]]]
    return found


def _drift_axis(history: History) -> Reals:
    """Draw the unit axis about which each robot's orientation drifts, shape (N, 3)."""
    robot = np.arange(history.robot_count)[:, None]
    axis = normal(history.seed, "drift axis", robot, np.arange(3))
    if history.is_planar:
        axis[:, [0, 2]] = 0.0  # a planar robot turns about y alone
    unit: Reals = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return unit


def _deaf(walk: Walk) -> Walk:
    return replace(walk, contacts=walk.contacts[:0])


def _mute(walk: Walk) -> Walk:
    return replace(
        walk,
        center=walk.center[-1:],
        orientation_wxyz=walk.orientation_wxyz[-1:],
        pivot_dock=walk.pivot_dock[:0],
        contacts=walk.contacts[:0],
        ground_docks=walk.ground_docks[:0],
        edge_docks=walk.edge_docks[:0],
    )
