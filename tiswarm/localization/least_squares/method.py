"""All robots at once by a general optimiser: the reference that other methods are held against.

The sum of squares has many minima. From a poor start least squares ends in a poor one: robots
on the wrong side of their contacts, held there by docks that may not overlap.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tiswarm.compute.math import dock_offsets
from tiswarm.localization import virtual_force
from tiswarm.localization.least_squares.problem import (
    Problem,
    Reals,
    close,
    docks_at,
    places_known,
    touching,
)
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.measurements.contacts import disconnected
from tiswarm.measurements.cues import measure
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

SETTLED = 1e-6
"""The rounds end when one lowers the cost by less than this part."""


class Minimum(NamedTuple):
    """The end of a solve, with the names of scipy's OptimizeResult."""

    x: Reals
    """Unknowns, shape (unknowns,)."""

    cost: float
    """Half the sum of squares."""

    nfev: int
    """Evaluations of the residuals."""

    status: int
    """0 if the solve used up its evaluations, positive if it converged."""


Minimize = Callable[[Problem, Reals, LeastSquaresParams], Minimum]
"""A solver: the problem, the unknowns to start from, settings."""


def batch_key(log: SensingLog, params: LeastSquaresParams) -> Hashable:
    """Name what logs must share to be started in one launch."""
    return virtual_force.batch_key(log, params.start)


def localize_batch(
    logs: Sequence[SensingLog], params: Sequence[LeastSquaresParams]
) -> list[Estimate]:
    """Localize structures one after the other, started side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.

    Returns:
        One estimate a log. The residual is the root mean square of distance less D of the
        docks in contact, in the log's unit.
    """
    starts = virtual_force.localize_batch(logs, [p.start for p in params])
    return [
        improve(log, p, start.position) for log, p, start in zip(logs, params, starts, strict=True)
    ]


def trust_region(problem: Problem, unknowns: Reals, params: LeastSquaresParams) -> Minimum:
    """Minimize the residuals by scipy's trust region reflective method."""
    found = least_squares(  # type: ignore[operator]  # the stubs take it for a module
        problem.residuals,
        unknowns,
        jac=problem.jacobian,
        method="trf",
        tr_solver="lsmr",
        loss=params.loss,
        max_nfev=params.evaluations,
    )
    return Minimum(found.x, found.cost, found.nfev, found.status)


def improve(
    log: SensingLog,
    params: LeastSquaresParams,
    start: Reals,
    *,
    minimize: Minimize = trust_region,
) -> Estimate:
    """Move robots from given positions to a minimum of the weighted residuals.

    Args:
        log: What the swarm sensed.
        params: Settings.
        start: Positions to start from, in the log's unit, shape (N, 3).
        minimize: Solver of each round; benchmarks compare others with scipy's.
    """
    yaw_sd = log.yaw_bias * params.solve_yaw
    yaw: Reals = np.zeros(log.robot_count)
    if yaw_sd:
        positions_only = replace(params, solve_yaw=False)
        start = improve(log, positions_only, start, minimize=minimize).position
    position: Reals = np.concatenate([log.anchor_position[None], start[1:]])
    poses, iteration, cost = [(position, yaw)], [0], np.inf
    contacts, places = list(touching(log, params)), list(places_known(log, params))
    for _ in range(params.rounds if log.robot_count > 1 else 0):
        pairs = [*contacts, *close(log, params, position, yaw)]
        problem = Problem(log, pairs, places, yaw_sd)
        found = minimize(problem, problem.unknowns(position, yaw), params)
        position, yaw = problem.poses(found.x)
        poses.append((position, yaw))
        iteration.append(iteration[-1] + found.nfev)
        if found.status > 0 and found.cost >= (1.0 - SETTLED) * cost:
            break
        cost = found.cost
    return Estimate(
        robot_id=log.robot_id,
        position=position,
        disconnected=disconnected(measure(log, params.cues)),
        yaw=yaw if yaw_sd else None,
        iteration=np.array(iteration),
        trace=np.array([frame for frame, _ in poses]),
        residual=np.array([_stretch(log, *pose) for pose in poses]),
    )


def _stretch(log: SensingLog, position: Reals, yaw: Reals) -> float:
    """Root mean square of distance less D of the docks in contact, in the log's unit."""
    i, a, j, b = log.contacts.T
    dock = docks_at(position, dock_offsets(log.orientation_wxyz, log.dock_offset_body), yaw)
    gap = np.linalg.norm(dock[j, b] - dock[i, a], axis=1) - log.spacing
    return float(np.sqrt(np.mean(gap**2))) if len(gap) else 0.0
