"""What robots feel while the world grows, with noise.

From the true history to the log that is the localizers' whole world.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.spatial.transform import Rotation

from tiswarm.compute import random
from tiswarm.compute.rotations import dock_offsets
from tiswarm.params import STRICT
from tiswarm.records.sensing_log import SensingLog, SensingNoise, Stances
from tiswarm.world.history import History


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SensingParams:
    """Noise of the robots' senses; none by default, as in the paper."""

    tilt_noise_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 0.0
    """Standard deviation of the sensed orientation about each horizontal axis, drawn anew for
    each stance [deg]."""

    yaw_noise_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    """Standard deviation of the sensed orientation about the vertical, drawn anew for each
    stance [deg]."""


def observe(history: History, params: SensingParams) -> SensingLog:
    """Let every robot of a structure sense its whole walk.

    Args:
        history: What truly happened.
        params: Noise of the senses. Draws depend on the history's seed, the robot and the
            stance alone.

    Returns:
        The log; it holds no true position but the anchor's.
    """
    length = np.array([walk.stance_count for walk in history.walks])
    end = np.cumsum(length)
    sensed = _sensed_orientation(history, length, params)
    return SensingLog(
        robot_id=np.arange(history.robot_count),
        dock_radius=history.robot.dock_radius,
        dock_offset_body=history.robot.dock_offset_body,
        anchor_position=history.walks[0].center[-1],
        orientation_wxyz=sensed[end - 1],
        contacts=history.contacts,
        ground_z=history.ground_z,
        ground_docks=history.ground_docks,
        flip_height=_flip_height(history, sensed, end),
        spawn_position=np.full((history.robot_count, 3), np.nan),
        stances=_stances(history, sensed, length),
        noise=SensingNoise(tilt_deg=params.tilt_noise_deg, yaw_deg=params.yaw_noise_deg),
    )


def _sensed_orientation(
    history: History, length: NDArray[np.int64], params: SensingParams
) -> NDArray[np.float64]:
    """Orientation that each robot senses at each of its stances, shape (all stances, 4)."""
    true = np.concatenate([walk.orientation_wxyz for walk in history.walks])
    if params.tilt_noise_deg == 0.0 and params.yaw_noise_deg == 0.0:
        return true
    robot = np.repeat(np.arange(len(length)), length)
    stance = np.concatenate([np.arange(count) for count in length])
    draw = 3 * stance[:, None] + np.arange(3)
    sd = np.radians([params.tilt_noise_deg, params.tilt_noise_deg, params.yaw_noise_deg])
    turn = sd * random.normal(history.seed, "orientation", robot[:, None], draw)
    sensed = Rotation.from_rotvec(turn) * Rotation.from_quat(true, scalar_first=True)
    wxyz: NDArray[np.float64] = sensed.as_quat(canonical=True, scalar_first=True)
    return wxyz


def _flip_height(
    history: History, sensed: NDArray[np.float64], end: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Height of each robot's centre as it follows from its own flips, shape (N,).

    A robot starts flat on the ground. A flip about the dock at b moves its centre by
    (R - R') b, with R and R' the orientations it senses before and after.
    """
    dock_height = dock_offsets(sensed, history.robot.dock_offset_body)[:, :, 2]
    start_height = history.ground_z + history.robot.dock_radius
    height = np.full(len(end), start_height)
    for j, walk in enumerate(history.walks):
        rows = dock_height[end[j] - walk.stance_count : end[j]]
        step = np.arange(walk.stance_count - 1)
        height[j] += np.sum(rows[step, walk.pivot_dock] - rows[step + 1, walk.pivot_dock])
    return height


def _stances(history: History, sensed: NDArray[np.float64], length: NDArray[np.int64]) -> Stances:
    """Every stance but each robot's last, robot after robot."""
    start = np.concatenate([[0], np.cumsum(length - 1)])
    is_last = np.zeros(len(sensed), np.bool_)
    is_last[np.cumsum(length) - 1] = True
    contacts = [_before_last(walk.contacts, walk.stance_count) for walk in history.walks]
    ground = [_before_last(walk.ground_docks, walk.stance_count) for walk in history.walks]
    return Stances(
        start=start,
        orientation_wxyz=sensed[~is_last],
        pivot_dock=np.concatenate([walk.pivot_dock for walk in history.walks]),
        contacts=_renumbered(contacts, start),
        ground_docks=_renumbered(ground, start),
    )


def _before_last(rows: NDArray[np.int32], stance_count: int) -> NDArray[np.int32]:
    """Rows, stance first, that are not of the last stance."""
    return rows[rows[:, 0] < stance_count - 1]


def _renumbered(rows: list[NDArray[np.int32]], start: NDArray[np.int64]) -> NDArray[np.int32]:
    """Join the robots' rows, counting stances through the whole log."""
    shifted = [part.copy() for part in rows]
    for part, first in zip(shifted, start[:-1], strict=True):
        part[:, 0] += np.int32(first)
    return np.concatenate(shifted)
