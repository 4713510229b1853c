"""Configurations beside one: mirrored in part, or built from distances.

Where measured distances fit as a whole, chains start beside those of the annealer.

Parts have second places, which chains seldom find. Orientations are known: a part that hangs on few
robots moves by a shift, and nothing within it changes. Each distance to a robot outside puts the
shift on a sphere, and measured coordinates fix it along axes. Where two points are left, one is the
mirror image of the other in the plane, line or point that the centers of the spheres span. A part
whose rows measure centers alone has no orientation to keep: it is mirrored itself. Lengths in R.
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tiswarm.base.aliases import Bools, Reals
from tiswarm.compute.normal_equations import damped, solved
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.cost import OVERLAP_SD
from tiswarm.localization.mixture import MIXTURE
from tiswarm.measurements.contacts import close_docks, overlaps, spans
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.records.sensing_log import SensingLog

MOST_ROBOTS = 1000
"""Robots beyond which the matrix of all distances takes too long."""

_RIDGE = 1e-6


def scaled_distances(problem: Problem, anchor: Reals) -> list[Reals]:
    """Place robots by classical multidimensional scaling, and both images where they are known.

    The distance of two robots is taken to be the shortest way along measured distances (Shang et
    al., MobiHoc 2003). An affine map fits the result to measured coordinates; the nearest turn and
    shift counts.

    Args:
        problem: Measurements.
        anchor: Center of the anchor [R], shape (3,).

    Returns:
        Two mirror images, shape (N, 3) each; none without ranges, or beyond `MOST_ROBOTS`.
    """
    robots = problem.rows.robots
    rows = problem.rows
    if rows.is_contact.all() or not AXES <= robots <= MOST_ROBOTS:
        return []
    length = np.where(
        problem.is_offset,
        np.linalg.norm(problem.shift, axis=1),
        np.where(
            rows.is_contact[problem.link],
            np.hypot(np.linalg.norm(problem.shift, axis=1), SPACING),
            np.maximum(problem.length, 0.0),  # a range less what all ranges share may be negative
        ),
    )
    # Sparse matrices add up entries at the same place: keep the shortest of each pair.
    order = np.argsort(length, kind="stable")
    low, high = np.sort(problem.pair[order], axis=1).T
    ends, shortest = np.unique(low * robots + high, return_index=True)
    graph = coo_array((length[order][shortest], np.divmod(ends, robots)), shape=(robots, robots))
    away = dijkstra(graph, directed=False)
    farthest = away[np.isfinite(away)].max()
    square: Reals = -0.5 * np.where(np.isfinite(away), away, farthest) ** 2
    # Double centering turns squared distances into products of arms from the mean.
    square -= square.mean(axis=0)
    square -= square.mean(axis=1)[:, None]
    value, vector = eigh(square, subset_by_index=(robots - AXES, robots - 1))
    shape = vector * np.sqrt(np.maximum(value, 0.0))
    shape -= shape[0]
    return [_fitted(image, problem, anchor) for image in (shape, shape * [1.0, 1.0, -1.0])]


def _fitted(shape: Reals, problem: Problem, anchor: Reals) -> Reals:
    """Turn and shift a shape about its anchor to fit measured coordinates, shape (N, 3)."""
    rows = problem.rows
    links = len(problem.rows.neighbor)
    robot = rows.robot[links:]
    direction = rows.places.direction
    value = -rows.residual(np.tile(anchor, (rows.robots, 1)))[links:]
    # n . A x = value, with nine unknowns
    matrix = (direction[:, :, None] * shape[robot][:, None, :]).reshape(-1, AXES**2)
    ridge = _RIDGE * max(float((matrix**2).sum()), 1.0)
    affine = solved(damped(matrix.T @ matrix, ridge), matrix.T @ value).reshape(AXES, AXES)
    u, _, vt = np.linalg.svd(affine)
    # The nearest proper rotation to the map (Kabsch 1976): no mirror image.
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    fitted: Reals = anchor + shape @ turn.T
    return fitted


class PartImages:
    """Second places of the K parts of N robots, by E measurements whose docks are known."""

    def __init__(
        self,
        log: SensingLog,
        rows: Measurements,
        further_variance: float = 0.0,
        *,
        non_overlap: bool = True,
    ) -> None:
        """Find the parts; rows have some variance beside their noise [R^2]."""
        self._log = log
        self._rows = rows
        self._non_overlap = non_overlap
        self._weight = 1.0 / (rows.variance() + further_variance)
        self.parts = hanging_parts(rows)
        """Robots of each part, shape (K, N)."""
        pairs = len(rows.neighbor)
        is_member, is_other_member = (
            self.parts.take(robots, axis=1) for robots in (rows.robot, rows.neighbor)
        )
        # How the vector of each row moves with each part: 1, -1, or not at all.
        self._sign = is_member.astype(np.float64)
        self._sign[:, :pairs] -= is_other_member
        is_oriented = np.any(rows.arm, axis=1)
        is_oriented[:pairs] |= rows.neighbor_arm.any(axis=1)
        is_oriented[len(rows.distances.stance) : pairs] = True
        is_member[:, :pairs] |= is_other_member
        is_single = self.parts.sum(axis=1) == 1
        self._is_shifted = (is_member & is_oriented).any(axis=1) | is_single
        # Docks that only must not overlap leave no sphere.
        self._sign[:, np.flatnonzero(rows.distances.is_hinge)] = 0.0

    def of(self, position: Reals, yaw: Reals) -> Iterator[tuple[Reals, float]]:
        """Find the images of all parts at a minimum that may be minima, too.

        Args:
            position: Centers [R], shape (N, 3).
            yaw: Yaw corrections [rad], shape (N,).

        Yields:
            Centers, and the cost beyond that of the minimum, all else as it is [1].
        """
        rows = self._rows
        vector = rows.vectors(position, yaw)
        missed = rows.residual(position, yaw)
        axes = np.concatenate([rows.axes(yaw), rows.places.direction])
        cost = self._weight @ missed**2 + self._overlap(position, yaw)
        for number, part in enumerate(self.parts):
            shift = self._shift(number, vector, axes, position)
            if shift is None or np.linalg.norm(shift, axis=-1).max() < MIXTURE.image_shift:
                continue
            image = np.where(part[:, None], position + shift, position)
            excess = float(self._weight @ rows.residual(image, yaw) ** 2 - cost)
            if excess <= MIXTURE.image_worst:
                excess += self._overlap(image, yaw)
            if excess <= MIXTURE.image_worst:
                yield image, excess

    def _shift(self, number: int, vector: Reals, axes: Reals, position: Reals) -> Reals | None:
        """Find the shift of a part to its image, (3,), or of each robot, (N, 3), if there is one.

        Args:
            number: The part.
            vector: `Measurements.vectors`, shape (P, 3).
            axes: Axes of all rows but distances, shape (E - C, 3).
            position: Centers [R], shape (N, 3).
        """
        distances = self._rows.distances
        moved = np.flatnonzero(self._sign[number])
        sign = self._sign[number, moved, None]
        weight = self._weight[moved]
        count = int(np.searchsorted(moved, len(distances.stance)))
        link = moved[:count]
        along = axes[moved[count:] - len(distances.stance)] * sign[count:]
        size, basis = np.linalg.eigh((along.T * weight[count:]) @ along)
        basis = basis[:, size < MIXTURE.image_fixed**-2]
        # With fewer distances than free directions, a motion is left: nothing to mirror.
        if not 0 < basis.shape[1] <= count:
            return None
        if not self._is_shifted[number]:
            ends = self._rows.neighbor[link], self._rows.robot[link]
            partner = np.where(sign[:count, 0] > 0.0, *ends)
            normal, middle = _plane(position[partner], weight[:count], basis)
            return 2.0 * ((middle - position) @ normal)[:, None] * normal
        center = -sign[:count] * vector[link]
        normal, middle = _plane(center, weight[:count], basis)
        shift: Reals = 2.0 * (middle @ normal) * normal
        return shift

    def _overlap(self, position: Reals, yaw: Reals) -> float:
        """Sum the squares of all overlaps of docks [variances]."""
        if not self._non_overlap:
            return 0.0
        point = position[:, None] + self._rows.docks(yaw)
        depth = overlaps(point, close_docks(self._log, point, SPACING)).depth / OVERLAP_SD
        return float(depth @ depth)


def _plane(point: Reals, weight: Reals, basis: Reals) -> tuple[Reals, Reals]:
    """Fit a plane to points: its normal, which is in a subspace, and the mean of the points.

    Args:
        point: Points, shape (n, 3).
        weight: Their weights, shape (n,).
        basis: Orthonormal basis of the subspace, shape (3, d).
    """
    middle = weight @ point / weight.sum()
    off = (point - middle) @ basis
    normal: Reals = basis @ np.linalg.eigh((off.T * weight) @ off)[1][:, 0]
    return normal, middle


def hanging_parts(rows: Measurements) -> Bools:
    """List the parts that lose their way to the world without one robot, or without two.

    The world is the anchor, and all robots whose coordinates are measured along all axes. Each
    other robot is a part, too.

    Args:
        rows: Measurements of N robots.

    Returns:
        Robots of each part, small parts first, shape (K, N).
    """
    robots = rows.robots
    pairs = len(rows.neighbor)
    place = rows.robot[pairs:], rows.places.direction
    information = spans(*place, robots, 1.0 / rows.variance()[pairs:])
    is_world = np.linalg.eigvalsh(information)[:, 0] > MIXTURE.image_fixed**-2
    is_world[0] = True
    # The world is one vertex, that of the anchor.
    vertex = np.where(is_world, 0, np.arange(robots))
    pair = vertex[np.column_stack([rows.robot[:pairs], rows.neighbor])]
    near: list[list[int]] = [[] for _ in range(robots)]
    for one, another in np.unique(pair[pair[:, 0] != pair[:, 1]], axis=0).tolist():
        near[one].append(another)
        near[another].append(one)
    free = np.flatnonzero(~is_world).tolist()
    sets: set[tuple[int, ...]] = {(robot,) for robot in free}
    for without in [-1, *(free if robots <= MIXTURE.image_robots else [])]:
        sets |= {tuple(sorted(part)) for part in _cut_off(near, without)}
    ordered = sorted(sets, key=lambda part: (len(part), part))
    is_in = [np.isin(np.arange(robots), part) for part in ordered]
    return np.array(is_in, np.bool_).reshape(len(ordered), robots)


def _cut_off(near: list[list[int]], without: int) -> Iterator[list[int]]:
    """Find the parts that lose their way to vertex 0 without one vertex and another one.

    Depth-first search finds them all at once (Hopcroft and Tarjan 1973).

    Args:
        near: Neighbors of each vertex.
        without: The vertex that is left out; none if -1.
    """
    entered = [-1] * len(near)
    low = [0] * len(near)
    order = [0]
    stack = [(0, iter(near[0]))]
    entered[0] = 0
    while stack:
        vertex, further = stack[-1]
        for neighbor in further:
            if neighbor == without:
                continue
            if entered[neighbor] < 0:
                entered[neighbor] = low[neighbor] = len(order)
                order.append(neighbor)
                stack.append((neighbor, iter(near[neighbor])))
                break
            low[vertex] = min(low[vertex], entered[neighbor])
        else:
            stack.pop()
            if stack:
                above = stack[-1][0]
                low[above] = min(low[above], low[vertex])
                if low[vertex] >= entered[above]:
                    yield order[entered[vertex] :]
