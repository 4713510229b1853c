"""Who touches whom: robots are the nodes, contacts the edges."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from tiswarm.records.sensing_log import SensingLog


def located(log: SensingLog) -> NDArray[np.bool_]:
    """Whether a chain of contacts ties each robot to the anchor, shape (N,)."""
    _, part = connected_components(_graph(log), directed=False)
    return np.asarray(part == part[0])


def hops(log: SensingLog, start: NDArray[np.int64]) -> NDArray[np.float64]:
    """Fewest contacts that lead from some robots to every robot, infinite where none do.

    Args:
        log: What was sensed.
        start: Where to start, shape (n,).

    Returns:
        Count of contacts, shape (n, N).
    """
    return dijkstra(_graph(log), directed=False, indices=start, unweighted=True)


def contact_count(log: SensingLog) -> NDArray[np.int64]:
    """Contacts that each robot takes part in, shape (N,); every contact counts at both ends."""
    return np.bincount(log.contacts[:, [0, 2]].ravel(), minlength=log.robot_count)


def earlier_contact_count(log: SensingLog) -> NDArray[np.int64]:
    """Contacts of each robot with robots that joined before it, shape (N,).

    Their mean over all robots but the anchor is what is meant by contacts per robot: the
    equations that a robot has for its three unknowns when it joins.
    """
    return np.bincount(log.contacts[:, 2], minlength=log.robot_count)


def touching(pair: NDArray[np.integer[Any]], robots: int) -> coo_matrix:
    """Make a graph of pairs of robots (n, 2), each pair at its two numbers, shape (N, N)."""
    ones = np.ones(len(pair), dtype=np.int8)
    return coo_matrix((ones, (pair[:, 0], pair[:, 1])), shape=(robots, robots))


def _graph(log: SensingLog) -> coo_matrix:
    return touching(log.contacts[:, [0, 2]], log.robot_count)
