"""What a log leaves free: motions of the robots that nothing sensed would notice.

Orientations are known, so robots only shift. Everything sensed says how far two of them are
apart along one direction: a contact along the line between its docks, a height along the
vertical from the anchor.
"""

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from tiswarm.compute import random
from tiswarm.compute.rotations import dock_offsets
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.walks import displacements, owners

UNNOTICED = 1e-5
"""A motion is floppy where all that is sensed changes by less than this part of its length."""

HELD = 0.1
"""A robot counts as held where floppy motions shift it by less than this part of what they shift
a robot that nothing holds."""

PROBES = 16
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


class Freedom(NamedTuple):
    """What equations leave free."""

    floppy_modes: int
    """Independent motions that change nothing sensed."""

    loose: NDArray[np.bool_]
    """Whether such motions shift each robot, shape (N,)."""


class _Ties(NamedTuple):
    """Equations between the same two robots taken together."""

    first: NDArray[np.integer]
    second: NDArray[np.integer]
    stiffness: NDArray[np.float64]
    """Sum of the outer products of their unit vectors, shape (pairs, 3, 3)."""


def equations(position: NDArray[np.float64], log: SensingLog, cues: Collection[str]) -> Equations:
    """Linearise what is sensed.

    Args:
        position: Centres at which to do so, shape (N, 3).
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


def floppy_modes(position: NDArray[np.float64], log: SensingLog, cues: Collection[str]) -> int:
    """Count the independent motions that change nothing sensed; arguments as for `equations`."""
    return freedom(equations(position, log, cues), log.robot_count).floppy_modes


def freedom(known: Equations, robot_count: int) -> Freedom:
    """Count and find what equations leave free, with robot 0 in its place.

    Robots that cannot part are first made one body. The floppy modes of the rest are the
    eigenvalues of its stiffness matrix K below s = UNNOTICED^2; by Sylvester's law of inertia
    the factors of K - s 1 have as many negative pivots. The same factors tell what is left of
    random motions once K has damped all others: -s (K - s 1)^-1 x.
    """
    body, ties = _weld(known, robot_count)
    bodies = int(body.max()) + 1
    matrix = _stiffness_matrix(ties, bodies, fixed=int(body[0]))
    if not matrix.shape[0]:
        return Freedom(0, np.zeros(robot_count, np.bool_))
    shift = UNNOTICED**2
    factors = splu(
        csc_array(matrix - shift * eye_array(matrix.shape[0])),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    modes = int((factors.U.diagonal() < 0.0).sum())
    coordinate = np.arange(matrix.shape[0])[:, None]
    motion = random.normal(0, "floppy motion", coordinate, np.arange(PROBES))
    left = -shift * factors.solve(motion)
    shifted = np.sqrt(np.mean(left.reshape(-1, 3 * PROBES) ** 2, axis=1))
    return Freedom(modes, np.insert(shifted > HELD, body[0], False)[body])


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


def _weld(known: Equations, robot_count: int) -> tuple[NDArray[np.integer], _Ties]:
    """Join robots that cannot part into bodies, until no two bodies are held to each other.

    Returns:
        Body of each robot, shape (N,), and what ties the bodies.
    """
    body: NDArray[np.integer] = np.arange(robot_count)
    ties = _Ties(*known[:2], known.unit[:, :, None] * known.unit[:, None, :])
    while True:
        ties = _summed(ties, int(body.max()) + 1)
        stiff = np.linalg.eigvalsh(ties.stiffness)[:, 0] > UNNOTICED**2
        if not stiff.any():
            return body, ties
        count = int(body.max()) + 1
        graph = coo_array(
            (np.ones(stiff.sum()), (ties.first[stiff], ties.second[stiff])), shape=(count, count)
        )
        _, joined = connected_components(graph, directed=False)
        body = joined[body]
        ties = _Ties(joined[ties.first], joined[ties.second], ties.stiffness)


def _summed(ties: _Ties, bodies: int) -> _Ties:
    """Sum what ties the same two bodies, and drop what ties a body to itself."""
    apart = ties.first != ties.second
    low, high = np.sort(np.stack([ties.first[apart], ties.second[apart]]), axis=0)
    pair, row = np.unique(low.astype(np.int64) * bodies + high, return_inverse=True)
    entries = ties.stiffness[apart].reshape(-1, 9).T
    total = np.empty((len(pair), 9))
    for place, entry in enumerate(entries):
        total[:, place] = np.bincount(row, entry, len(pair))
    return _Ties(pair // bodies, pair % bodies, total.reshape(-1, 3, 3))


def _stiffness_matrix(ties: _Ties, bodies: int, *, fixed: int) -> csc_array:
    """Matrix K of the bodies but the fixed one: x K x is the sum of the squared changes."""
    row = np.concatenate([ties.first, ties.second, ties.first, ties.second])
    column = np.concatenate([ties.first, ties.second, ties.second, ties.first])
    block = np.concatenate([ties.stiffness, ties.stiffness, -ties.stiffness, -ties.stiffness])
    free = (row != fixed) & (column != fixed)
    row, column = row[free] - (row[free] > fixed), column[free] - (column[free] > fixed)
    rows = np.broadcast_to(3 * row[:, None, None] + np.arange(3)[:, None], block[free].shape)
    columns = np.broadcast_to(3 * column[:, None, None] + np.arange(3), block[free].shape)
    size = 3 * (bodies - 1)
    return csc_array((block[free].ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))
