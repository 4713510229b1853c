"""Orientations of robots without a compass, chained by connections.

A connection says how robot j is turned seen from robot i, Q = R_i^T R_j. With turns d of the
orientations in the world frame, R -> exp(d) R, its residual log(R_i Q R_j^T) changes by d_i - d_j.
Noise of a connection is alike about all axes. So the sum of squares over all connections is least
where one sparse linear system is solved for each axis: the Laplacian of the graph of connections
(rotation averaging; Hartley et al., "Rotation averaging", IJCV 2013). Compasses stay as they are:
what they gain from connections is small, and least squares over all measurements finds it. Angles
in rad.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.records.sensing_format import STANCE_LISTS
from tiswarm.records.sensing_log import SensingLog, SensingNoise

ASSUMED = SensingNoise(tilt_deg=1.0, yaw_deg=2.0)
"""Noise of a log that states none."""

LINK_SD = math.radians(1.0)
"""Standard deviation of a direction or connection about each axis, of a log that states none."""

_LEAST_SD = 1e-7
"""Noise of connections below this counts as this much."""

_HELD = 1e6
"""Precision of what stays as it is, in those of a connection."""

_ROUNDS = 4
"""Linear problems solved, each at where the last one led."""

_DRAWS = 64
"""Draws of all errors from which variances are computed, to some 10 %."""


class Connections(NamedTuple):
    """Q connections between robots whose orientations are known by now."""

    robot: Ints
    """Robot that sensed each, shape (Q,)."""

    other: Ints
    """Robot that it sensed, shape (Q,)."""

    residual: Reals
    """log(R_i Q R_j^T), in the world frame, shape (Q, 3)."""

    sd: float
    """Standard deviation about each axis."""

    is_chained: Bools
    """Robots whose orientation follows from connections, shape (N,)."""


def with_orientations(log: SensingLog) -> SensingLog:
    """Chain the orientations of robots without a compass from those of robots with one.

    Robots to which no connections lead have no orientation that their docks could be turned by:
    all that these docks sensed is left out, so that such robots count as disconnected. A bias of
    yaw, if the log states one, counts as noise of the compasses.

    Returns:
        The log with the orientations of all robots and their `orientation_sd`; the log itself if
        all robots have a compass.
    """
    is_missing: Bools = np.isnan(log.orientation_wxyz[:, 0])
    if not is_missing.any():
        return log
    guess, is_lost = _chained(log, is_missing)
    noise = log.noise or ASSUMED
    yaw_deg = min(math.hypot(noise.yaw_deg, noise.yaw_bias_deg or 0.0), 180.0)
    known = replace(
        _without(log, is_lost),
        orientation_wxyz=guess,
        noise=replace(noise, yaw_deg=yaw_deg, yaw_bias_deg=None),
    )
    wxyz, sd = _averaged(known, is_missing & ~is_lost)
    sd[~is_missing] = np.nan
    return replace(known, orientation_wxyz=wxyz, orientation_sd=sd)


def connections_of(log: SensingLog) -> Connections:
    """Look up the connections of final stances; all robots of the log have orientations."""
    robot, other = log.connections[:, [0, 2]].astype(np.int64).T
    found = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    turn = Rotation.from_quat(log.connections[:, 4:], scalar_first=True)
    stated = None if log.noise is None else log.noise.connection_deg
    sd = LINK_SD if stated is None else math.radians(stated)
    left = (found[robot] * turn * found[other].inv()).as_rotvec()
    chained = np.zeros((len(found), 2)) if log.orientation_sd is None else log.orientation_sd
    return Connections(robot, other, left, max(sd, _LEAST_SD), ~np.isnan(chained[:, 0]))


def _averaged(log: SensingLog, is_chained: Bools) -> tuple[Reals, Reals]:
    """Average the rotations of some robots, shape (N,), from a guess; the others stay.

    Returns:
        Orientations, shape (N, 4), and standard deviations about a horizontal axis and about the
        vertical, with the noise of the compasses that they follow from, shape (N, 2).
    """
    links = connections_of(log)
    robots, count, weight = log.robot_count, len(links.robot), links.sd**-2.0
    sign, row = np.repeat([1.0, -1.0], count), np.tile(np.arange(count), 2)
    ends = np.concatenate([links.robot, links.other])
    change: csc_array = csc_array((sign, (row, ends)), shape=(count, robots))
    hold = np.where(is_chained, 0.0, _HELD * weight)
    factor = splu(csc_array(weight * (change.T @ change) + diags_array(hold)))
    # The matrix depends on the graph alone: one factorization serves all rounds.
    for _ in range(_ROUNDS):
        step = factor.solve(weight * (change.T @ connections_of(log).residual))
        step[~is_chained] = 0.0
        turned = Rotation.from_rotvec(-step) * Rotation.from_quat(
            log.orientation_wxyz, scalar_first=True
        )
        log = replace(log, orientation_wxyz=turned.as_quat(scalar_first=True))
    noise = log.noise or ASSUMED
    # Variances are the diagonal of an inverse that is dense; draws take one solve for all.
    draw = normal(0, "orientations", np.arange(count + robots)[:, None], np.arange(_DRAWS))
    pull = change.T @ draw[:count] / links.sd
    errors = [
        factor.solve(pull + hold[:, None] * math.radians(sd_deg) * draw[count:])
        for sd_deg in (noise.tilt_deg, noise.yaw_deg)
    ]
    sd = np.sqrt([(error**2).mean(axis=1) for error in errors]).T
    return log.orientation_wxyz, sd


def _chained(log: SensingLog, is_missing: Bools) -> tuple[Reals, Bools]:
    """Follow connections, the fewest to each robot, from robots with a compass.

    Returns:
        Orientations, shape (N, 4), and robots to which no connections lead, shape (N,).
    """
    robots = len(is_missing)
    pair = log.connections[:, [0, 2]].astype(np.int64)
    row_of = {ends: row for row, ends in enumerate(map(tuple, pair.tolist()))}
    with_compass = np.flatnonzero(~is_missing)
    world = np.full_like(with_compass, robots)  # leads to all compasses
    first, second = np.concatenate([pair, np.column_stack([world, with_compass])]).T
    graph = csr_array((np.ones(len(first)), (first, second)), shape=(robots + 1, robots + 1))
    # Errors add up along a chain: breadth first, each robot gets the shortest one.
    order, before = breadth_first_order(graph, robots, directed=False)
    turns = Rotation.from_quat(log.connections[:, 4:], scalar_first=True)
    wxyz = np.where(is_missing[:, None], [1.0, 0.0, 0.0, 0.0], log.orientation_wxyz)
    for i in order[is_missing[np.minimum(order, robots - 1)] & (order < robots)].tolist():
        j = int(before[i])
        seen = turns[row_of[i, j]].inv() if (i, j) in row_of else turns[row_of[j, i]]
        turned = Rotation.from_quat(wxyz[j], scalar_first=True) * seen
        wxyz[i] = turned.as_quat(scalar_first=True)
    is_lost = is_missing.copy()
    is_lost[order[order < robots]] = False
    return wxyz, is_lost


def _without(log: SensingLog, is_lost: Bools) -> SensingLog:
    """Leave out what docks of some robots, shape (N,), sensed or were sensed at, and vectors."""
    final, earlier = {}, {}
    for key, kinds in STANCE_LISTS.items():
        if any("dock" in kind for kind in kinds) or key == "displacements":
            ends = [0, 2] if "robot" in kinds[1:] else [0]
            rows = getattr(log, key)
            final[key] = rows[~is_lost[rows[:, ends].astype(np.int64)].any(axis=1)]
            if log.stances is not None and len(ends) > 1:
                rows = getattr(log.stances, key)
                earlier[key] = rows[~is_lost[rows[:, 2].astype(np.int64)]]
    return replace(log, **final, stances=log.stances and replace(log.stances, **earlier))
