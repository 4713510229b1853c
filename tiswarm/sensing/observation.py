"""Turns the true history of a structure into the noisy log that localizers read."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tiswarm.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.records.sensing_log import SensingLog, Stances
from tiswarm.sensing.noise import sensed_contacts, sensed_orientation, spawn_position
from tiswarm.sensing.params import SensingParams
from tiswarm.world.history import History

_PLANE_SD = 0.01
"""Standard deviation of the plane that a planar robot is in [R]."""


def observe(history: History, params: SensingParams) -> SensingLog:
    """Sense the whole walk of every robot in a structure.

    A random draw depends on the seed of the history, the robot, and the stance or contact only.
    The only positions of the log are the anchor's and, with `spawn_noise`, the spawns'.

    >>> from tiswarm.robot import RobotGeometry
    >>> from tiswarm.world.growth import grow
    >>> from tiswarm.world.params import TowerParams
    >>> [history] = grow(TowerParams(), robots=3, seeds=[0], robot=RobotGeometry())
    >>> log = observe(history, SensingParams(tilt_noise_deg=1.0))
    >>> log.robot_count, log.noise.tilt_deg
    (3, 1.0)
    """
    if history.is_planar:
        params = replace(params, yaw_noise_deg=0.0, yaw_bias_deg=0.0)
    length = np.array([walk.stance_count for walk in history.walks])
    end = np.cumsum(length)
    sensed = sensed_orientation(history, length, params)
    contacts = sensed_contacts(history, params)
    at_rest = contacts[:, 1] == length[contacts[:, 0]] - 1
    return SensingLog(
        robot_id=np.arange(history.robot_count),
        dock_radius=history.robot.dock_radius,
        dock_offset_body=history.robot.dock_offset_body,
        anchor_position=history.walks[0].center[-1],
        orientation_wxyz=sensed[end - 1],
        contacts=np.ascontiguousarray(contacts[at_rest][:, [3, 4, 0, 2]]),
        ground_z=history.ground_z,
        ground_docks=history.ground_docks,
        fixes=_planes(history),
        flip_height=_flip_height(history, sensed, end),
        spawn_position=spawn_position(history, params),
        stances=_stances(history, sensed, length, contacts[~at_rest]),
        noise=params.noise,
    )


def _planes(history: History) -> Reals:
    """Return y = 0 as a fix of each planar robot, rows as in `SensingLog.fixes`."""
    robot = np.arange(history.robot_count if history.is_planar else 0)
    return np.column_stack([robot, np.tile([0.0, 1.0, 0.0, 0.0, _PLANE_SD], (len(robot), 1))])


def _flip_height(history: History, sensed: Reals, end: Ints) -> Reals:
    """Return the height of each robot's center that its own flips imply, shape (N,).

    A robot starts on the ground, with its center above the docks that stand there. A flip about the
    dock at b moves its center by (R - R') b, where R and R' are the orientations sensed before and
    after. NaN for a robot that starts without a dock on the ground.
    """
    dock_height = dock_offsets(sensed, history.robot.dock_offset_body)[:, :, 2]
    height = np.full(len(end), history.ground_z + history.robot.dock_radius)
    for j, walk in enumerate(history.walks):
        rows = dock_height[end[j] - walk.stance_count : end[j]]
        standing = walk.ground_docks[walk.ground_docks[:, 0] == 0, 1]
        height[j] -= rows[0, standing].mean() if len(standing) else np.nan
        step = np.arange(walk.stance_count - 1)
        height[j] += np.sum(rows[step, walk.pivot_dock] - rows[step + 1, walk.pivot_dock])
    return height


def _stances(history: History, sensed: Reals, length: Ints, contacts: NDArray[np.int32]) -> Stances:
    """Gather every stance except each robot's last; `contacts` are those of these stances."""
    start = np.concatenate([[0], np.cumsum(length - 1)])
    ground = history.table("ground_docks")
    return Stances(
        start=start,
        orientation_wxyz=np.delete(sensed, np.cumsum(length) - 1, axis=0),
        pivot_dock=np.concatenate([walk.pivot_dock for walk in history.walks]),
        contacts=_numbered(contacts, start),
        ground_docks=_numbered(ground[ground[:, 1] < length[ground[:, 0]] - 1], start),
    )


def _numbered(rows: NDArray[np.int32], start: Ints) -> NDArray[np.int32]:
    """Replace (robot, stance) at the start of each row by the stance's index in the log."""
    stance = (start[rows[:, 0]] + rows[:, 1]).astype(np.int32)
    return np.column_stack([stance, rows[:, 2:]])
