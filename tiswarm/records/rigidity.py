"""What is sensed, as equations between robots.

Orientations are known, so robots only shift. Everything sensed says how far two of them are
apart along one direction: a contact along the line between its docks, a height along the
vertical from the anchor.
"""

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.rotations import dock_offsets
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.walks import displacements, owners

UP = np.array([[0.0, 0.0, 1.0]])
EVERY_WAY = np.eye(3)


class Equations(NamedTuple):
    """What is sensed, linearised: robots `first` and `second` cannot part along `unit`."""

    first: NDArray[np.integer]
    """Shape (K,); the anchor where the second's own place is known."""

    second: NDArray[np.integer]
    """Shape (K,)."""

    unit: NDArray[np.float64]
    """Unit vectors, shape (K, 3)."""


def equations(position: NDArray[np.float64], log: SensingLog, cues: Collection[str]) -> Equations:
    """Linearise what is sensed.

    Args:
        position: Centers at which to do so, shape (N, 3).
        log: What was sensed.
        cues: Which of it counts, of "contacts", "ground", "height", "walk_contacts" (those of
            every stance, carried to the final one by the flips) and "odometry"; others add no
            equation.
    """
    nobody = np.empty(0, np.int64)
    parts = [(nobody, nobody, np.empty((0, 3))), *_by_touch(position, log, cues)]
    for robot, ways in _by_place(log, cues):
        second = np.repeat(robot, len(ways))
        parts.append((np.zeros_like(second), second, np.tile(ways, (len(robot), 1))))
    first, second, apart = (np.concatenate(column) for column in zip(*parts, strict=True))
    length = np.linalg.norm(apart, axis=1, keepdims=True)
    unit = np.divide(apart, length, out=np.zeros_like(apart), where=length > 0.0)
    return Equations(first, second, unit)


def _by_touch(
    position: NDArray[np.float64], log: SensingLog, cues: Collection[str]
) -> Iterator[tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.float64]]]:
    """Pairs of robots whose docks touch, and the vector between those docks."""
    dock = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    if "contacts" in cues:
        i, a, j, b = log.contacts.T
        yield i, j, dock[j, b] - dock[i, a]
    if "walk_contacts" in cues and log.stances is not None:
        stance, b, i, a = log.stances.contacts.T
        j = owners(log.stances)[stance]
        there = position[j] + displacements(log, log.stances)[stance]
        offset = dock_offsets(log.stances.orientation_wxyz, log.dock_offset_body)
        yield i, j, there + offset[stance, b] - dock[i, a]


def _by_place(
    log: SensingLog, cues: Collection[str]
) -> Iterator[tuple[NDArray[np.integer], NDArray[np.float64]]]:
    """Robots that know something of their place, and along which directions."""
    if "ground" in cues:
        yield log.ground_docks[:, 0], UP
        if "walk_contacts" in cues and log.stances is not None:
            yield owners(log.stances)[log.stances.ground_docks[:, 0]], UP
    if "height" in cues:
        yield np.flatnonzero(np.isfinite(log.flip_height)), UP
    if "odometry" in cues and log.stances is not None:
        yield np.flatnonzero(np.isfinite(log.spawn_position).all(axis=1)), EVERY_WAY
