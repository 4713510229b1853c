"""The robots' own senses: their noise, and robots that fail.

Some robots are mute or deaf, or their orientation sensors drift or are stuck. The header of the log
states no failure: robots do not know of them. Anchors never fail.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets, normal, uniform
from tiswarm.records.sensing_log import KNOWN_SD
from tiswarm.sensing.params import Failure, SensingParams
from tiswarm.world.history import History, Walk

NO_SOURCE = -1
"""Source of fixes and ranges whose errors have no part in common."""

_PLANE_SD = 0.01
"""Standard deviation of the plane that a planar robot is in [R]."""


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
    sd[0] *= not is_planar
    turn = sd * normal(seed, "orientation", robot[:, None], draw)
    bias = np.zeros_like(turn)
    bias[:, 2] = np.radians(params.yaw_bias_deg) * normal(seed, "yaw bias", robot, 0)
    return Rotation.from_rotvec(bias) * Rotation.from_rotvec(turn)


def sensed_contacts(history: History, params: SensingParams) -> NDArray[np.int32]:
    """Return the contacts sensed at all stances, sorted and unique, shape (K, 5).

    A row is (robot, stance, own dock, other robot, other dock).
    """
    true = history.table("contacts")
    if params.missed_contacts == params.wrong_docks == params.false_contacts == 0.0:
        return true
    robot = true[:, 0]
    place = np.concatenate([np.arange(len(walk.contacts)) for walk in history.walks])

    def draw(stream: str, which: int) -> Reals:
        return uniform(history.seed, stream, robot, 4 * place + which)

    docks = len(history.robot.dock_offset_body)
    false = true.copy()
    false[:, 2] = draw("false contact", 1) * docks
    false[:, 3] = draw("false contact", 2) * robot
    false[:, 4] = draw("false contact", 3) * docks
    false = false[draw("false contact", 0) < params.false_contacts]
    is_wrong = draw("wrong dock", 0) < params.wrong_docks
    turned = 1 + (draw("wrong dock", 1) * (docks - 1)).astype(np.int32)
    sensed = true.copy()
    sensed[is_wrong, 4] = (sensed[:, 4] + turned)[is_wrong] % docks
    sensed = sensed[draw("missed contact", 0) >= params.missed_contacts]
    rows: NDArray[np.int32] = np.unique(np.concatenate([sensed, false]), axis=0)
    return rows


def spawn_position(history: History, params: SensingParams) -> Reals:
    """Return each robot's sensed spawn position [R], shape (N, 3); NaN without `spawn_noise`."""
    true = np.array([walk.center[0] for walk in history.walks])
    if params.spawn_noise is None:
        return np.full_like(true, np.nan)
    robot = np.arange(history.robot_count)[:, None]
    return true + params.spawn_noise * normal(history.seed, "spawn position", robot, np.arange(3))


def planes(history: History) -> Reals:
    """Return y = 0 at the final stance of each planar robot, as a fix, shape (F, 8)."""
    robot = np.arange(history.robot_count if history.is_planar else 0)
    last = np.array([walk.stance_count for walk in history.walks])[robot] - 1
    fix = np.tile([0.0, 1.0, 0.0, 0.0, _PLANE_SD, NO_SOURCE], (len(robot), 1))
    return np.column_stack([robot, last, fix])


def anchors(history: History) -> Reals:
    """Return the position of each anchor but the first as three fixes, shape (F, 8)."""
    robot = np.repeat(np.flatnonzero(history.is_anchor)[1:], 3)
    last = np.array([walk.stance_count for walk in history.walks])[robot] - 1
    axis = np.arange(len(robot)) % 3
    known = np.tile([KNOWN_SD * history.robot.dock_radius, NO_SOURCE], (len(robot), 1))
    return np.column_stack([robot, last, np.eye(3)[axis], history.position[robot, axis], known])


def flip_height(history: History, sensed: Reals, end: Ints) -> Reals:
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


def split_touches(contacts: NDArray[np.int32], params: SensingParams) -> dict[str, NDArray[Any]]:
    """Split contacts into those with docks and touches, whose docks robots do not all know."""
    touches = contacts.copy()
    touches[:, 4] = -1
    if params.contact_docks == "none":
        touches[:, 2] = -1
    has_docks = params.contact_docks == "both"
    return {
        "contacts": contacts if has_docks else contacts[:0],
        "touches": touches[:0] if has_docks else np.unique(touches, axis=0),
    }


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
    each = zip(history.walks, is_deaf, is_mute, strict=True)
    heard = ((replace(w, contacts=w.contacts[:0]) if d else w, m) for w, d, m in each)
    walks = [_mute(w) if m else w for w, m in heard]
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
