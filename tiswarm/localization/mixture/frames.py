"""Whole configurations beside one: mirrored, or built from distances.

Where measured distances fit as a whole, chains start beside those of the annealer. Lengths in R.
"""

from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tiswarm.base.aliases import Bools, Reals
from tiswarm.compute.math import normal
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.cost.cost import WholeCost
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.records.sensing_log import SensingLog

_ASIDE, _ROUNDS = 0.05, 15
"""Random errors that move an estimate aside, in the median distance [1], and rounds in which it
moves to a minimum."""

_AXES = 3
MOST_ROBOTS = 1000
"""Robots beyond which the matrix of all distances takes too long."""

_RIDGE = 1e-6


def opened(log: SensingLog, rows: Measurements, position: Reals) -> tuple[Reals, dict[str, Any]]:
    """Find how far free turns move robots from an estimate that is one configuration, or the mean.

    Args:
        log: What was sensed.
        rows: Measurements.
        position: Centers [R], shape (N, 3).

    Returns:
        Standard deviation of the estimate, 0 of robots that do not turn [R], shape (N,), and the
        fields `free_frame` and `turns` of an estimate.
    """
    nowhere = np.zeros(len(position))
    if not rows.is_central.any():
        return nowhere, {}
    # At the mean of all, where no range pulls to either side, robots fit no range.
    aside = _ASIDE * float(np.median(rows.distances.length))
    start = position + aside * normal(0, "aside", np.arange(len(position))[:, None], range(_AXES))
    start[0] = position[0]
    rows = rows.associated(position)
    cost = WholeCost(log, rows, robust_sd=ROBUST_SD, non_overlap=False, are_independent=True)
    state, linear = cost.refine(cost.at(start, nowhere), _ROUNDS)
    turns = rows.free_turns(state.position)
    if not turns:
        return nowhere, {}
    mean, square = turns.swept(state.position)
    own = linear.variance(turns.motions(state.position)) + ((position - mean) ** 2).sum(axis=1)
    sd = np.sqrt(np.where(square > 0.0, square + own, 0.0))
    return sd, turns.stated(state.position, log.dock_radius)


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
    robots, rows = problem.rows.robots, problem.rows
    if rows.is_contact.all() or not _AXES <= robots <= MOST_ROBOTS:
        return []
    length = np.where(
        problem.is_offset,
        np.linalg.norm(problem.shift, axis=1),
        np.where(
            rows.is_contact[problem.link],
            np.hypot(np.linalg.norm(problem.shift, axis=1), SPACING),
            problem.length,
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
    value, vector = eigh(square, subset_by_index=(robots - _AXES, robots - 1))
    shape = vector * np.sqrt(np.maximum(value, 0.0))
    shape -= shape[0]
    return [_fitted(image, problem, anchor) for image in (shape, shape * [1.0, 1.0, -1.0])]


def _fitted(shape: Reals, problem: Problem, anchor: Reals) -> Reals:
    """Turn and shift a shape about its anchor to fit measured coordinates, shape (N, 3)."""
    rows, links = problem.rows, len(problem.rows.other)
    robot, direction = rows.robot[links:], rows.places.direction
    value = -rows.residual(np.tile(anchor, (rows.robots, 1)))[links:]
    # n . A x = value, with nine unknowns
    matrix = (direction[:, :, None] * shape[robot][:, None, :]).reshape(-1, _AXES**2)
    ridge = _RIDGE * max(float((matrix**2).sum()), 1.0) * np.eye(_AXES**2)
    affine = np.linalg.solve(matrix.T @ matrix + ridge, matrix.T @ value).reshape(_AXES, _AXES)
    u, _, vt = np.linalg.svd(affine)
    # The nearest proper rotation to the map (Kabsch 1976): no mirror image.
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    fitted: Reals = anchor + shape @ turn.T
    return fitted


def images(problem: Problem, position: Reals) -> list[Reals]:
    """Mirror a configuration in the plane nearest to the robots whose places are measured.

    Where these are in one plane, as beacons on a ceiling, ranges exclude neither image.

    Args:
        problem: Measurements.
        position: Centers [R], shape (N, 3).

    Returns:
        The image, shape (N, 3), if at least three robots are measured in all directions.
    """
    known: Bools = np.all(problem.sensed_place()[1], axis=1)
    known[0] = True
    if known.sum() < _AXES or known.all():
        return []
    center = position[known].mean(axis=0)
    normal = np.linalg.svd(position[known] - center, full_matrices=False)[2][2]
    mirrored = position - 2.0 * ((position - center) @ normal)[:, None] * normal
    return [np.where(known[:, None], position, mirrored)]
