"""What equations between robots leave free: motions that nothing sensed would notice."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from tiswarm.compute.math import normal
from tiswarm.measurements.linear import Equations

UNNOTICED = 1e-5
"""A motion is floppy where all that is sensed changes by less than this part of its length."""

HELD = 0.1
"""A robot counts as held where floppy motions shift it by less than this part of what they shift
a robot that nothing holds."""

SHIFTS = 3
"""Ways in which a robot moves without turning: x, y and z."""

PROBES = 16
MOST_UNKNOWNS = 400_000
"""Matrices of more are not factored: too much memory. Those of 100,000 robots take some 1 GB."""


class Ties(NamedTuple):
    """What holds bodies to each other, all equations between the same two taken together."""

    first: NDArray[np.integer]
    second: NDArray[np.integer]
    stiffness: NDArray[np.float64]
    """Sum of the outer products of their ways, shape (pairs, ways, ways); 3 ways to move, or 4."""


class Bodies(NamedTuple):
    """Robots that cannot part, taken as one."""

    of_robot: NDArray[np.integer]
    """Body of each robot and of the world, shape (N + 1,)."""

    lever: NDArray[np.float64]
    """From the center of its body to that of each of them [dock radius], shape (N + 1, 3)."""

    center: NDArray[np.float64]
    """Mean of the centers of each body's robots [dock radius], shape (bodies, 3)."""

    ties: Ties

    @property
    def size(self) -> int:
        """Bodies in all."""
        return len(self.center)

    @property
    def ways(self) -> int:
        """Ways in which each can move: 4 where yaw is unknown, else 3."""
        return self.ties.stiffness.shape[1]

    @property
    def unknowns(self) -> int:
        """Ways in which all can move."""
        return self.ways * (self.size - 1)

    @property
    def fixed(self) -> int:
        """Body of the world, which stays where it is."""
        return int(self.of_robot[-1])

    @property
    def swings(self) -> bool:
        """Whether everything sensed lets the swarm turn about the anchor as a whole."""
        if self.ways == SHIFTS or (self.of_robot[:-1] == self.fixed).any():
            return False
        of_world = (self.ties.first == self.fixed) | (self.ties.second == self.fixed)
        return not self.ties.stiffness[of_world, SHIFTS, SHIFTS].any()


def weld(known: Equations) -> Bodies:
    """Join robots that cannot part into bodies, until no two bodies are held to each other."""
    count = len(known.center)
    body: NDArray[np.integer] = np.arange(count)
    ties = Ties(*known[:2], known.way[:, :, None] * known.way[:, None, :])
    while True:
        ties = _summed(ties, count)
        members = np.bincount(body, minlength=count)[:, None]
        center = np.column_stack([np.bincount(body, axis) for axis in known.center.T]) / members
        seen = _seen_from(center[ties.first], ties.stiffness)
        stiff = _rank(seen) == known.way.shape[1]
        if not stiff.any():
            return Bodies(body, known.center - center[body], center, ties)
        graph = coo_array(
            (np.ones(stiff.sum()), (ties.first[stiff], ties.second[stiff])), shape=(count, count)
        )
        count, joined = connected_components(graph, directed=False)
        body = joined[body]
        ties = Ties(joined[ties.first], joined[ties.second], ties.stiffness)


def floppy_modes(bodies: Bodies) -> int | None:
    """Count the independent motions that change nothing sensed; None where that is too dear.

    What is left after peeling has as many as its stiffness matrix has eigenvalues below
    UNNOTICED^2. Where yaw is unknown a turn of the whole swarm about the anchor is not counted: the
    mean of all compasses holds it.
    """
    peeled, core = _peel(bodies)
    if core.unknowns > MOST_UNKNOWNS:
        return None
    factors = _factors(core)
    left = 0 if factors is None else int((factors.U.diagonal() < 0.0).sum())
    return peeled + left - bodies.swings


def loose(bodies: Bodies) -> NDArray[np.bool_] | None:
    """Whether floppy motions shift each robot, shape (N,); None where that is too dear.

    Of random motions x the factors of the stiffness matrix K tell what is left once K has damped
    all that it notices: -s (K - s 1)^-1 x with s = UNNOTICED^2. Where the swarm may turn as a whole
    that is seen from a mean robot.
    """
    if bodies.unknowns > MOST_UNKNOWNS:
        return None
    factors = _factors(bodies)
    if factors is None:
        return np.zeros(len(bodies.of_robot) - 1, np.bool_)
    coordinate = np.arange(bodies.unknowns)[:, None]
    motion = normal(0, "floppy motion", coordinate, np.arange(PROBES))
    left = -(UNNOTICED**2) * factors.solve(motion).reshape(-1, bodies.ways, PROBES)
    moved = np.insert(left, bodies.fixed, 0.0, axis=0)[bodies.of_robot[:-1]]
    if bodies.ways > SHIFTS:
        turn, lever = moved[:, SHIFTS], bodies.lever[:-1]
        moved[:, :2] += _swept(turn, lever)
        if bodies.swings:
            from_anchor = bodies.center[bodies.of_robot[:-1]] + lever
            moved[:, :2] -= _swept(turn.mean(axis=0), from_anchor)
    shifted = np.sqrt(np.mean(moved[:, :SHIFTS] ** 2, axis=(1, 2)))
    return np.asarray(shifted > HELD)


def _swept(turn: NDArray[np.float64], arm: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much turns (..., PROBES) about the vertical move the ends of arms (N, 3) in x and y.

    Shape (N, 2, PROBES).
    """
    x, y, _ = arm.T[:, :, None]
    return np.stack([-turn * y, turn * x], axis=1)


def _summed(ties: Ties, bodies: int) -> Ties:
    """Sum what ties the same two bodies, and drop what ties a body to itself."""
    apart = ties.first != ties.second
    low, high = np.sort(np.stack([ties.first[apart], ties.second[apart]]), axis=0)
    pair, row = np.unique(low.astype(np.int64) * bodies + high, return_inverse=True)
    total = _by_row(row, ties.stiffness[apart], len(pair))
    return Ties(pair // bodies, pair % bodies, total)


def _by_row(
    row: NDArray[np.integer], matrix: NDArray[np.float64], rows: int
) -> NDArray[np.float64]:
    """Sum square matrices that belong to the same row, shape (rows, ways, ways)."""
    ways = matrix.shape[1]
    total = np.empty((rows, ways**2))
    for place, entry in enumerate(matrix.reshape(-1, ways**2).T):
        total[:, place] = np.bincount(row, entry, rows)
    return total.reshape(-1, ways, ways)


def _from(center: NDArray[np.float64]) -> NDArray[np.float64]:
    """Motions of bodies told from the anchor's axis, by those told from their own centers.

    Shape (..., 4, 4).
    """
    told = np.tile(np.eye(4), (*center.shape[:-1], 1, 1))
    told[..., 0, 3], told[..., 1, 3] = center[..., 1], -center[..., 0]
    return told


def _seen_from(
    center: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    other: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Tell stiffness by motions of bodies about their own centers, not about the anchor's axis."""
    if stiffness.shape[1] == SHIFTS:  # the same from everywhere
        return stiffness
    seen: NDArray[np.float64] = (
        _from(center).swapaxes(1, 2) @ stiffness @ _from(center if other is None else other)
    )
    return seen


def _rank(stiffness: NDArray[np.float64]) -> NDArray[np.int64]:
    """How many directions are held, shape (rows,)."""
    rank: NDArray[np.int64] = (np.linalg.eigvalsh(stiffness) > UNNOTICED**2).sum(axis=1)
    return rank


def _peel(bodies: Bodies) -> tuple[int, Bodies]:
    """Take away bodies whose ties are independent, as long as there are some.

    Such a body's equations hold it and nothing else: without both the others are as free as
    they were with them.

    Returns:
        Floppy modes of what was taken away, and the rest.
    """
    ties, center = bodies.ties, bodies.center
    rank = _rank(_seen_from(center[ties.first], ties.stiffness))
    rests = np.ones(bodies.size, np.bool_)
    modes = 0
    while True:
        end = np.concatenate([ties.first, ties.second])
        total = np.bincount(end, np.tile(rank, 2), bodies.size)
        held = _rank(
            _seen_from(center, _by_row(end, np.tile(ties.stiffness, (2, 1, 1)), bodies.size))
        )
        peels = rests & (total == held)
        peels[bodies.fixed] = False
        if not peels.any():
            break
        rests &= ~peels
        cut = peels[ties.first] | peels[ties.second]
        modes += bodies.ways * int(peels.sum()) - int(rank[cut].sum())
        ties, rank = Ties(*(column[~cut] for column in ties)), rank[~cut]
    number = np.cumsum(rests) - 1
    left = Ties(number[ties.first], number[ties.second], ties.stiffness)
    core = Bodies(number[[bodies.fixed]], np.zeros((1, 3)), center[rests], left)
    return modes, core


def _factors(bodies: Bodies) -> SuperLU | None:
    """Factor K - s 1, K being the stiffness matrix of all bodies but the fixed one.

    By Sylvester's law of inertia it has as many negative pivots as K has eigenvalues below s.
    """
    if bodies.size == 1:
        return None
    first, second, stiffness = bodies.ties
    row = np.concatenate([first, second, first, second])
    column = np.concatenate([first, second, second, first])
    block = np.concatenate([stiffness, stiffness, -stiffness, -stiffness])
    block = _seen_from(bodies.center[row], block, bodies.center[column])
    free = (row != bodies.fixed) & (column != bodies.fixed)
    row, column, block = row[free], column[free], block[free]
    row, column = row - (row > bodies.fixed), column - (column > bodies.fixed)
    ways, unknowns = np.arange(bodies.ways), bodies.unknowns
    rows = np.broadcast_to(len(ways) * row[:, None, None] + ways[:, None], block.shape)
    columns = np.broadcast_to(len(ways) * column[:, None, None] + ways, block.shape)
    matrix = csc_array((block.ravel(), (rows.ravel(), columns.ravel())), shape=(unknowns, unknowns))
    return splu(
        csc_array(matrix - UNNOTICED**2 * eye_array(unknowns)),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
