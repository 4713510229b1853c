"""What equations between robots leave free: motions that nothing sensed would notice."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from tiswarm.compute import random
from tiswarm.records.rigidity import Equations

UNNOTICED = 1e-5
"""A motion is floppy where all that is sensed changes by less than this part of its length."""

HELD = 0.1
"""A robot counts as held where floppy motions shift it by less than this part of what they shift
a robot that nothing holds."""

PROBES = 16
MOST_BODIES = 30_000
"""Matrices of more bodies are not factored: too much memory."""


class Ties(NamedTuple):
    """What holds bodies to each other, all equations between the same two taken together."""

    first: NDArray[np.integer]
    second: NDArray[np.integer]
    stiffness: NDArray[np.float64]
    """Sum of the outer products of their unit vectors, shape (pairs, 3, 3)."""


class Bodies(NamedTuple):
    """Robots that cannot part, taken as one."""

    of_robot: NDArray[np.integer]
    """Body of each robot, shape (N,)."""

    size: int
    """Bodies in all."""

    ties: Ties

    @property
    def fixed(self) -> int:
        """Body of the anchor, which stays where it is."""
        return int(self.of_robot[0])


def weld(known: Equations, robot_count: int) -> Bodies:
    """Join robots that cannot part into bodies, until no two bodies are held to each other."""
    body: NDArray[np.integer] = np.arange(robot_count)
    count = robot_count
    ties = Ties(*known[:2], known.unit[:, :, None] * known.unit[:, None, :])
    while True:
        ties = _summed(ties, count)
        stiff = _rank(ties.stiffness) == 3  # noqa: PLR2004 - every direction
        if not stiff.any():
            return Bodies(body, count, ties)
        graph = coo_array(
            (np.ones(stiff.sum()), (ties.first[stiff], ties.second[stiff])), shape=(count, count)
        )
        count, joined = connected_components(graph, directed=False)
        body = joined[body]
        ties = Ties(joined[ties.first], joined[ties.second], ties.stiffness)


def floppy_modes(bodies: Bodies) -> int | None:
    """Count the independent motions that change nothing sensed; None where that is too dear.

    What is left after peeling has as many as its stiffness matrix has eigenvalues below
    UNNOTICED^2.
    """
    peeled, core = _peel(bodies)
    if core.size > MOST_BODIES:
        return None
    factors = _factors(core)
    return peeled if factors is None else peeled + int((factors.U.diagonal() < 0.0).sum())


def loose(bodies: Bodies) -> NDArray[np.bool_] | None:
    """Whether floppy motions shift each robot, shape (N,); None where that is too dear.

    Of random motions x the factors of the stiffness matrix K tell what is left once K has damped
    all that it notices: -s (K - s 1)^-1 x with s = UNNOTICED^2.
    """
    if bodies.size > MOST_BODIES:
        return None
    factors = _factors(bodies)
    if factors is None:
        return np.zeros(len(bodies.of_robot), np.bool_)
    coordinate = np.arange(factors.shape[0])[:, None]
    motion = random.normal(0, "floppy motion", coordinate, np.arange(PROBES))
    left = -(UNNOTICED**2) * factors.solve(motion)
    shifted = np.sqrt(np.mean(left.reshape(-1, 3 * PROBES) ** 2, axis=1))
    is_loose: NDArray[np.bool_] = np.insert(shifted > HELD, bodies.fixed, False)[bodies.of_robot]
    return is_loose


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
    """Sum 3 x 3 matrices that belong to the same row, shape (rows, 3, 3)."""
    total = np.empty((rows, 9))
    for place, entry in enumerate(matrix.reshape(-1, 9).T):
        total[:, place] = np.bincount(row, entry, rows)
    return total.reshape(-1, 3, 3)


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
    ties, rank = bodies.ties, _rank(bodies.ties.stiffness)
    rests = np.ones(bodies.size, np.bool_)
    modes = 0
    while True:
        end = np.concatenate([ties.first, ties.second])
        total = np.bincount(end, np.tile(rank, 2), bodies.size)
        held = _rank(_by_row(end, np.tile(ties.stiffness, (2, 1, 1)), bodies.size))
        peels = rests & (total == held)
        peels[bodies.fixed] = False
        if not peels.any():
            break
        rests &= ~peels
        cut = peels[ties.first] | peels[ties.second]
        modes += 3 * int(peels.sum()) - int(rank[cut].sum())
        ties, rank = Ties(*(column[~cut] for column in ties)), rank[~cut]
    number = np.cumsum(rests) - 1
    left = Ties(number[ties.first], number[ties.second], ties.stiffness)
    return modes, Bodies(number[[bodies.fixed]], int(rests.sum()), left)


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
    free = (row != bodies.fixed) & (column != bodies.fixed)
    row, column, block = row[free], column[free], block[free]
    row, column = row - (row > bodies.fixed), column - (column > bodies.fixed)
    rows = np.broadcast_to(3 * row[:, None, None] + np.arange(3)[:, None], block.shape)
    columns = np.broadcast_to(3 * column[:, None, None] + np.arange(3), block.shape)
    unknowns = 3 * (bodies.size - 1)
    matrix = csc_array((block.ravel(), (rows.ravel(), columns.ravel())), shape=(unknowns, unknowns))
    return splu(
        csc_array(matrix - UNNOTICED**2 * eye_array(unknowns)),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
