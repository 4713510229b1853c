"""Subtrees of the contact graph: robots tied to the anchor only by way of robots nearer to it.

Measured coordinates tie a part without the anchor to it: each such part is a subtree, too. With
orientations sensed, a subtree can move as one only by a shift. Moving its robots one by one
would take ever longer the more there are, so the annealer shifts whole subtrees too.
"""

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.csgraph import dijkstra

from tiswarm.base.aliases import Ints, Reals
from tiswarm.measurements.contacts import touching

_SUBTREE_WEIGHT = 3.0
"""Least mass of a subtree, in masses of its own robots: contacts hold these no less stiffly than
the subtree, and they move beside it."""
_MOST_MOBILITY = 3.0
"""Most that 1 / mass of all subtrees a robot is in may add up to, for a robot of mass 1. An overlap
of two robots pushes them and all subtrees that contain one of them, so the work of a step is
proportional to that sum, which would grow with the number of robots in a thin arm. Results on
generated trees, loops, balls and chains are alike with 1 and with 3."""


@dataclass(frozen=True, kw_only=True)
class Forest:
    """Subtrees of one structure of N robots, each before those that grow out of it.

    All robots that are a number of hops or more from the anchor fall apart into subtrees. The own
    robots of a subtree are its nearest to the anchor; its others are own ones of subtrees that grow
    out of it. The first subtree is everyone.
    """

    order: Ints
    """Robots, own ones of subtree after subtree, so that those of each stand in a row, (N,)."""

    first: Ints
    """Where in `order` the own robots of each subtree start, shape (T + 1,)."""

    parent: Ints
    """Subtree that each grows out of, 0 of the first, shape (T,)."""


def find_subtrees(pair: Ints, roots: Ints, robots: int) -> Forest:
    """Split a structure into subtrees; robots that nothing ties to the anchor are in the first.

    Args:
        pair: Robots that touch each other at any stance, as often as they do, shape (C, 2).
        roots: Robots that hold their parts. Their measured coordinates tie them to the anchor, so
            that each part without it is a subtree, too.
        robots: N.
    """
    roots = roots[roots > 0]
    tied = np.column_stack([roots, np.zeros_like(roots)])
    pair = np.unique(np.concatenate([pair, tied]), axis=0)
    level = _levels(robots, pair)
    owner, parent = _grown(level, pair[level[pair[:, 0]] >= 0])
    number = _from_the_anchor(parent)
    owner = number[owner]
    return Forest(
        order=np.lexsort((level, owner)),
        first=np.searchsorted(np.sort(owner), np.arange(len(parent) + 1)),
        parent=number[parent[np.argsort(number)]],
    )


def weights(tree: Forest) -> Reals:
    """Weigh each subtree, in masses of its own robots, so that no robot is moved by too many.

    Thin subtrees that grow out of each other are heavier the more of them there are; the longest
    continuation of a subtree decides.
    """
    mobility = 1.0 / (_SUBTREE_WEIGHT * np.diff(tree.first))
    mobility[0] = 0.0  # everyone together does not move
    total = mobility.copy()
    for subtree in range(1, len(total)):
        total[subtree] += total[tree.parent[subtree]]
    for subtree in range(len(total) - 1, 0, -1):
        total[tree.parent[subtree]] = max(total[tree.parent[subtree]], total[subtree])
    return _SUBTREE_WEIGHT * np.maximum(1.0, total / _MOST_MOBILITY)


def _levels(robots: int, pair: Ints) -> Ints:
    """Count the hops from the anchor to each robot, -1 if none lead there, shape (N,)."""
    anchor = np.zeros(1, np.int64)
    hops = dijkstra(touching(pair, robots), directed=False, indices=anchor, unweighted=True)[0]
    return np.where(np.isfinite(hops), hops, -1).astype(np.int64)


def _grown(level: Ints, pair: Ints) -> tuple[Ints, Ints]:
    """Find the subtree of each robot and the parent of each, from the tips to the anchor."""
    owner, parent = np.zeros(len(level), np.int64), [0]
    nearer = level[pair].min(axis=1)
    joined = DisjointSet(range(len(level)))
    tops: dict[int, list[int]] = {}  # subtrees of each set that have no parent yet
    # From the tips inward: robots of a level that farther ones connect are in one subtree.
    for hops in range(level.max(), 0, -1):
        for i, j in pair[nearer == hops].tolist():
            parts = {joined[i], joined[j]}
            joined.merge(i, j)
            tops[joined[i]] = [top for part in parts for top in tops.pop(part, [])]
        made: dict[int, int] = {}
        for i in np.flatnonzero(level == hops).tolist():
            part = joined[i]
            if part not in made:
                made[part] = len(parent)
                parent.append(0)
                for top in tops.get(part, []):
                    parent[top] = made[part]
                tops[part] = [made[part]]
            owner[i] = made[part]
    return owner, np.array(parent)


def _from_the_anchor(parent: Ints) -> Ints:
    """Number subtrees so that each stands before all that grow out of it, and they in a row."""
    grown: list[list[int]] = [[] for _ in parent]
    for subtree in range(1, len(parent)):
        grown[parent[subtree]].append(subtree)
    number = np.empty(len(parent), np.int64)
    waiting = [0]
    for count in range(len(parent)):
        subtree = waiting.pop()
        number[subtree] = count
        waiting += grown[subtree]
    return number
