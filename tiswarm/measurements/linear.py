"""What is sensed, as equations between robots.

Everything sensed says how far two of them, or one and the world, are apart along one direction: a
contact along the line between its docks, a height along the vertical. With orientations known
robots only shift; where their yaw is unknown they turn about the vertical too, and so does all that
was seen from them.
"""

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import displacements, owners
from tiswarm.records.sensing_log import SensingLog

UP = np.array([[0.0, 0.0, 1.0]])
EVERY_WAY = np.eye(3)

Touch = tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.float64], NDArray[np.float64]]
Place = tuple[NDArray[np.integer], NDArray[np.float64], NDArray[np.float64]]


class Equations(NamedTuple):
    """What is sensed, linearised: `first` and `second` cannot move differently along `way`.

    The world, which never moves, is number N. Robots move by x, y and z, and where their yaw is
    unknown by a fourth coordinate, how far they turn about the vertical through the anchor. Then x,
    y and z are what they carry along that axis: all motions are told from one place, so that only
    their differences count.
    """

    first: NDArray[np.integer]
    """Shape (K,)."""

    second: NDArray[np.integer]
    """Shape (K,)."""

    way: NDArray[np.float64]
    """Unit vectors, shape (K, 3); with their moments about that axis [dock radius], (K, 4)."""

    center: NDArray[np.float64]
    """Of each robot and the world, seen from the anchor [dock radius], shape (N + 1, 3)."""


def equations(
    position: NDArray[np.float64], log: SensingLog, cues: Collection[str], *, turning: bool = False
) -> Equations:
    """Linearise what is sensed.

    Args:
        position: Centers at which to do so, shape (N, 3).
        log: What was sensed.
        cues: Which of it counts, of "contacts", "ground", "height", "walk_contacts" (those of
            every stance, carried to the final one by the flips) and "odometry"; others add no
            equation.
        turning: Whether yaw is unknown, one angle for all stances of a robot. What is known of
            such angles beforehand is no equation: it is off by degrees.
    """
    touches = list(_by_touch(position, log, cues))
    for robot, at, ways in _by_place(position, log, cues):
        second = np.repeat(robot, len(ways))
        world = np.full_like(second, log.robot_count)
        touches.append((world, second, np.repeat(at, len(ways), 0), np.tile(ways, (len(robot), 1))))
    first, second, at, apart = (np.concatenate(column) for column in zip(*touches, strict=True))
    length = np.linalg.norm(apart, axis=1, keepdims=True)
    way = np.divide(apart, length, out=np.zeros_like(apart), where=length > 0.0)
    if turning:
        x, y, _ = (at - position[0]).T / log.dock_radius
        way = np.column_stack([way, way[:, 1] * x - way[:, 0] * y])
    center = np.concatenate([position - position[0], np.zeros((1, 3))]) / log.dock_radius
    return Equations(first, second, way, center)


def _by_touch(
    position: NDArray[np.float64], log: SensingLog, cues: Collection[str]
) -> Iterator[Touch]:
    """Pairs of robots whose docks touch, where that is, and the vector between those docks."""
    dock = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    if "contacts" in cues:
        i, a, j, b = log.contacts.T
        yield i, j, dock[i, a], dock[j, b] - dock[i, a]
    if "walk_contacts" in cues and log.stances is not None:
        stance, b, i, a = log.stances.contacts.T
        j = owners(log.stances)[stance]
        there = position[j] + displacements(log, log.stances)[stance]
        offset = dock_offsets(log.stances.orientation_wxyz, log.dock_offset_body)
        yield i, j, dock[i, a], there + offset[stance, b] - dock[i, a]


def _by_place(
    position: NDArray[np.float64], log: SensingLog, cues: Collection[str]
) -> Iterator[Place]:
    """Robots that know something of their place, what place that is, and along which directions."""
    yield np.zeros(1, np.int64), position[:1], EVERY_WAY
    if "ground" in cues:
        standing = log.ground_docks[:, 0]
        yield standing, position[standing], UP
        if "walk_contacts" in cues and log.stances is not None:
            stood = owners(log.stances)[log.stances.ground_docks[:, 0]]
            yield stood, position[stood], UP
    if "height" in cues:
        flipped = np.flatnonzero(np.isfinite(log.flip_height))
        yield flipped, position[flipped], UP
    if "odometry" in cues and log.stances is not None:
        begun = position.copy()
        walked = np.flatnonzero(np.diff(log.stances.start))
        begun[walked] += displacements(log, log.stances)[log.stances.start[walked]]
        placed = np.flatnonzero(np.isfinite(log.spawn_position).all(axis=1))
        yield placed, begun[placed], EVERY_WAY
