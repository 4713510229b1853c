"""Who touches whom: robots are the nodes of a graph, contacts its edges."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.records.sensing_log import SensingLog


def stand_across(shift: Reals, *, is_contact: Bools | bool = True) -> Reals:
    """Guess how robots lie from those whose docks theirs touch: on one line with both docks.

    Args:
        shift: Arm of one dock less that of the dock that it touches [R], shape (C, 3).
        is_contact: Where docks touch; elsewhere robots lie as far apart as the arms say, (C,).

    Returns:
        From the center of one robot to that of the other [R], shape (C, 3).
    """
    length = np.maximum(np.linalg.norm(shift, axis=1), SPACING)
    across: Reals = shift * (1.0 + SPACING * is_contact / length)[:, None]
    return across


def hops(log: SensingLog, start: Ints) -> Reals:
    """Count the fewest contacts that lead from some robots to every robot.

    Args:
        log: What was sensed.
        start: Where to start, shape (n,).

    Returns:
        Count of contacts, infinite where none lead there, shape (n, N).
    """
    graph = touching(log.contacts[:, [0, 2]], log.robot_count)
    return dijkstra(graph, directed=False, indices=start, unweighted=True)


def contact_count(log: SensingLog) -> Ints:
    """Count the contacts that each robot takes part in, shape (N,); they count at both ends."""
    return np.bincount(log.contacts[:, [0, 2]].ravel(), minlength=log.robot_count)


def touching(pair: AnyInts, robots: int) -> coo_matrix:
    """Make a graph of pairs of robots (n, 2), each pair at its two numbers, shape (N, N)."""
    ones = np.ones(len(pair), dtype=np.int8)
    return coo_matrix((ones, (pair[:, 0], pair[:, 1])), shape=(robots, robots))


def connected_parts(rows: Measurements) -> NDArray[np.int32]:
    """Number the parts of the swarm that measured distances connect, shape (N,)."""
    pair = np.column_stack([rows.robot[: len(rows.neighbor)], rows.neighbor])
    _, part = connected_components(touching(pair, rows.robots), directed=False)
    return part


def disconnected(rows: Measurements) -> Bools:
    """Find robots of parts that nothing ties to the world in all three directions, shape (N,).

    A part is tied by the anchor, or by measured coordinates whose directions span space.
    """
    is_untied: Bools = np.any(untied_directions(rows), axis=(1, 2))
    return is_untied


def untied_directions(rows: Measurements) -> Reals:
    """Find the directions in which nothing ties each robot's part to the world.

    Returns:
        Projector onto these directions, 0 for robots of parts that are tied, shape (N, 3, 3).
    """
    part = connected_parts(rows)
    of_row = part[rows.robot[len(rows.neighbor) :]]
    span = spans(of_row, rows.places.direction, part.max() + 1)
    square, axis = np.linalg.eigh(span)
    # An eigenvalue that rounding explains counts as 0.
    is_open = square <= 3.0 * np.finfo(np.float64).eps * square[:, 2:]
    # The anchor holds its part, also one that measures nothing.
    is_open[part[0]] = False
    loose: Reals = (axis * is_open[:, None]) @ axis.swapaxes(1, 2)
    return loose[part]


def spans(group: AnyInts, direction: Reals, groups: int, weight: float | Reals = 1.0) -> Reals:
    """Sum the outer products of directions, by group.

    Args:
        group: Group of each direction, shape (n,).
        direction: Vectors, shape (n, 3).
        groups: G.
        weight: Weight of each, shape (n,), or of all.

    Returns:
        Sums of w n n^T, shape (G, 3, 3); their range is the span of the group's directions.
    """
    weighted = direction * np.broadcast_to(weight, len(group))[:, None]
    span = np.zeros((groups, 3, 3))
    np.add.at(span, group, weighted[:, :, None] * direction[:, None, :])
    return span


def close_docks(log: SensingLog, point: Reals, within: float) -> Ints:
    """List docks of different robots that are close to each other and not in contact.

    Robots that have left have no docks: later ones may stand in their places.

    Args:
        log: What was sensed.
        point: Centers of the docks, shape (N, docks, 3).
        within: Greatest distance of two that count as close, in the unit of `point`.

    Returns:
        Rows of (later robot, its dock, earlier robot, its dock), shape (n, 4).
    """
    robots, docks, _ = point.shape
    shape = (robots, docks, robots, docks)
    pair = dock_pairs(point, within)
    in_contact = np.ravel_multi_index(tuple(log.contacts.T), shape)
    pair = pair[~log.is_gone[pair[:, [0, 2]]].any(axis=1)]
    apart = pair[~np.isin(np.ravel_multi_index(tuple(pair.T), shape), in_contact)]
    return apart[:, [2, 3, 0, 1]]


class Overlaps(NamedTuple):
    """Docks of different robots that reach into each other, n pairs."""

    docks: Ints
    """Rows of (later robot, its dock, earlier robot, its dock), shape (n, 4)."""

    depth: Reals
    """By how much less than D their centers are apart [R], shape (n,)."""

    direction: Reals
    """Unit vector from the center of the second dock to that of the first, shape (n, 3)."""


def overlap_depth(distance: Reals) -> Reals:
    """Compute how far docks reach into each other [R]; 0 at a distance of D or more.

    A kernel has it from `equations.missed_distance`, as a hinge of length D.

    Args:
        distance: Distance of their centers [R], any shape.
    """
    depth: Reals = np.maximum(SPACING - distance, 0.0)
    return depth


def overlaps(point: Reals, docks: Ints) -> Overlaps:
    """Find the docks that overlap, among pairs as `close_docks` lists them.

    Docks at the same point are left out: no direction would part them.

    Args:
        point: Centers of all docks [R], shape (N, docks, 3).
        docks: Pairs that may overlap, shape (n, 4).
    """
    between = point[docks[:, 0], docks[:, 1]] - point[docks[:, 2], docks[:, 3]]
    distance = np.linalg.norm(between, axis=1)
    depth = overlap_depth(distance)
    overlap = np.flatnonzero((depth > 0.0) & (distance > 0.0))
    direction = between[overlap] / distance[overlap, None]
    return Overlaps(docks[overlap], depth[overlap], direction)


def nearest_overlap(dock: Reals, obstacles: Reals) -> Reals:
    """Compute how far docks reach into the nearest of others [R]; 0 at a distance of D or more.

    Args:
        dock: Centers of docks [R], shape (..., 3).
        obstacles: Centers of docks that are in their way [R], at least one, shape (n, 3).

    Returns:
        Overlaps, shape (...).
    """
    distance: Reals = np.asarray(cKDTree(obstacles).query(dock)[0])
    return overlap_depth(distance)


def dock_pairs(point: Reals, within: float) -> Ints:
    """List docks of different robots that are close to each other, in an order that repeats.

    Args:
        point: Centers of the docks, shape (N, docks, 3).
        within: Greatest distance of two that count as close, in the unit of `point`.

    Returns:
        Rows of (earlier robot, its dock, later robot, its dock), shape (n, 4).
    """
    docks = point.shape[1]
    pair = cKDTree(point.reshape(-1, 3)).query_pairs(within, output_type="ndarray").astype(np.int64)
    pair = pair[pair[:, 0] // docks != pair[:, 1] // docks]
    # The tree lists pairs in an order of its own, in which sums would round differently.
    pair = pair[np.lexsort(pair.T)]
    return np.stack(np.divmod(pair, docks), axis=-1).reshape(-1, 4)


def reach(pair: Ints, longest: Reals, part: NDArray[np.int32], start: Ints | None = None) -> Reals:
    """Bound the distance of each robot from the first robot of its connected part.

    Along a chain of contacts the distances of centers add up.

    Args:
        pair: Robots in contact, shape (C, 2).
        longest: How far apart the centers of each pair can be [R], shape (C,).
        part: Connected part of each robot, shape (N,).
        start: Robots to count from instead, the nearest one; None for those first robots.

    Returns:
        Length of the shortest chain of contacts [R], shape (N,); infinite where `part` is not
        connected by these contacts.
    """
    # Sparse matrices add up entries at the same place: of each two robots only the shortest edge
    # may enter.
    order = np.argsort(longest, kind="stable")
    low, high = np.sort(pair[order], axis=1).T
    ends, shortest = np.unique(low * len(part) + high, return_index=True)
    edges = (np.maximum(longest[order][shortest], 0.0), np.divmod(ends, len(part)))
    graph = coo_array(edges, shape=(len(part), len(part)))
    if start is None:
        start = np.unique(part, return_index=True)[1]
    bound: Reals = dijkstra(graph, directed=False, indices=start, min_only=True)
    return bound
