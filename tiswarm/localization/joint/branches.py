"""Branches of a structure: what contacts tie to the anchor only by way of robots nearer to it.

As orientations are sensed, a branch can move as one only by a shift. Moving its robots one by one
would take ever longer the more there are, so the annealer shifts whole branches too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.csgraph import dijkstra

from tiswarm.compute.arrays import Allocator
from tiswarm.localization.joint.arrays import Subtrees
from tiswarm.localization.joint.equations import Equations
from tiswarm.measurements.contacts import touching

BRANCH_WEIGHT = 3.0
"""Least mass of a branch, in masses of its own robots: these are held by no less than the branch
is, and move beside it."""
MOST_MOBILITY = 3.0
"""Most that the branches a robot is in may add up to in one over their mass, for a robot of mass 1.
An overlap of two robots pushes them and all branches that hold one of them, so a step does work in
proportion to that sum, which would grow with the number of robots in a thin arm. Generated trees,
loops, balls and chains are found alike with 1 and with 3."""


@dataclass(frozen=True, kw_only=True)
class Branches:
    """Branches of one structure, each before those that grow out of it.

    All robots that are a number of contacts or more from the anchor fall apart into branches. A
    branch's own robots are its nearest to the anchor; its others are own ones of branches that grow
    out of it. The first branch is everyone.
    """

    order: NDArray[np.int64]
    """Robots, own ones of branch after branch, so that those of each stand in a row, shape (N,)."""

    first: NDArray[np.int64]
    """Where in `order` the own robots of each branch start, shape (B + 1,)."""

    parent: NDArray[np.int64]
    """Branch that each grows out of, 0 of the first, shape (B,)."""


def branches(pair: NDArray[np.int64], robots: int) -> Branches:
    """Part a structure into branches; robots that nothing ties to the anchor are in the first.

    Args:
        pair: Robots that touch each other at any stance, as often as they do, shape (C, 2).
        robots: How many robots there are.
    """
    pair = np.unique(pair, axis=0)
    level = _levels(robots, pair)
    owner, parent = _grown(level, pair[level[pair[:, 0]] >= 0])
    number = _from_the_anchor(parent)
    owner = number[owner]
    return Branches(
        order=np.lexsort((level, owner)),
        first=np.searchsorted(np.sort(owner), np.arange(len(parent) + 1)),
        parent=number[parent[np.argsort(number)]],
    )


def subtree_arrays(
    memory: Allocator, known: Sequence[Equations], trees: Sequence[Branches], chains: int
) -> Subtrees:
    """Put the subtrees of all structures on the device, at rest.

    Args:
        memory: Where arrays are allocated.
        known: Equations of each structure.
        trees: Subtrees of each.
        chains: Chains of each.
    """
    count = np.array([len(tree.parent) for tree in trees])
    own = np.concatenate([np.diff(tree.first) for tree in trees])
    of_robot = np.add.outer(len(own) * np.arange(chains), np.repeat(np.arange(len(own)), own))
    table = [
        np.column_stack([t.first[:-1], t.first[1:], t.parent, np.tile(e.unplaced, (n, 1))])
        for t, e, n in zip(trees, known, count, strict=True)
    ]
    copies = chains * len(own)
    return Subtrees(
        of_robot=memory.upload(of_robot.ravel()),
        table=memory.upload(np.concatenate(table)),
        weight=memory.upload(np.concatenate([weights(tree) for tree in trees])),
        first=memory.upload(np.cumsum([0, *np.tile(count, chains)])),
        pull=memory.upload(np.zeros((copies, 4))),
        velocity=memory.upload(np.zeros((copies, 3))),
        shift=memory.upload(np.zeros((copies, 3))),
    )


def weights(tree: Branches) -> NDArray[np.float64]:
    """Weigh each branch, in masses of its own robots, such that no robot is moved by too many.

    Thin branches that grow out of each other are heavier the more of them there are; what a branch
    needs for its longest continuation holds for all others.
    """
    mobility = 1.0 / (BRANCH_WEIGHT * np.diff(tree.first))
    mobility[0] = 0.0  # everyone together does not move
    total = mobility.copy()
    for branch in range(1, len(total)):
        total[branch] += total[tree.parent[branch]]
    for branch in range(len(total) - 1, 0, -1):
        total[tree.parent[branch]] = max(total[tree.parent[branch]], total[branch])
    return BRANCH_WEIGHT * np.maximum(1.0, total / MOST_MOBILITY)


def _levels(robots: int, pair: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many contacts from the anchor each robot is, -1 if none lead there, shape (N,)."""
    anchor = np.zeros(1, np.int64)
    hops = dijkstra(touching(pair, robots), directed=False, indices=anchor, unweighted=True)[0]
    return np.where(np.isfinite(hops), hops, -1).astype(np.int64)


def _grown(
    level: NDArray[np.int64], pair: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Branch of each robot and parent of each branch, found from the tips to the anchor."""
    owner, parent = np.zeros(len(level), np.int64), [0]
    nearer = level[pair].min(axis=1)
    joined = DisjointSet(range(len(level)))
    tops: dict[int, list[int]] = {}  # branches of each set that have no parent yet
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


def _from_the_anchor(parent: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number branches such that each stands before all that grow out of it, and they in a row."""
    grown: list[list[int]] = [[] for _ in parent]
    for branch in range(1, len(parent)):
        grown[parent[branch]].append(branch)
    number = np.empty(len(parent), np.int64)
    waiting = [0]
    for count in range(len(parent)):
        branch = waiting.pop()
        number[branch] = count
        waiting += grown[branch]
    return number
