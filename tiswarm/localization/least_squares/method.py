"""All robots at once by a general optimiser: the reference that other methods are held against.

The sum of squares has many minima. From a poor start least squares ends in a poor one: robots
on the wrong side of their contacts, held there by docks that may not overlap.
"""

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from tiswarm.compute.math import dock_offsets
from tiswarm.localization import virtual_force
from tiswarm.localization.least_squares import factor_graph
from tiswarm.localization.least_squares.factor_graph import Found
from tiswarm.localization.least_squares.problem import (
    Problem,
    Reals,
    close,
    docks_at,
    places_known,
    touching,
)
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.measurements.contacts import located
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

SETTLED = 1e-6
"""The rounds end when one lowers the cost by less than this part."""


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


def improve(log: SensingLog, params: LeastSquaresParams, start: Reals) -> Estimate:
    """Move robots from given positions until the weighted residuals are as small as they get.

    Args:
        log: What the swarm sensed.
        params: Settings.
        start: Positions to start from, in the log's unit, shape (N, 3).
    """
    yaw_sd = log.yaw_bias * params.solve_yaw
    yaw: Reals = np.zeros(log.robot_count)
    if yaw_sd:
        start = improve(log, replace(params, solve_yaw=False), start).position
    position: Reals = np.concatenate([log.anchor_position[None], start[1:]])
    poses, iteration, cost = [(position, yaw)], [0], np.inf
    contacts, places = list(touching(log, params)), list(places_known(log, params))
    for _ in range(params.rounds if log.robot_count > 1 else 0):
        pairs = [*contacts, *close(log, params, position, yaw)]
        problem = Problem(log, pairs, places, yaw_sd)
        found = _minimize(problem, problem.unknowns(position, yaw), params)
        position, yaw = problem.poses(found.x)
        poses.append((position, yaw))
        iteration.append(iteration[-1] + found.nfev)
        if found.status > 0 and found.cost >= (1.0 - SETTLED) * cost:
            break
        cost = found.cost
    return Estimate(
        robot_id=log.robot_id,
        position=position,
        located=located(log),
        yaw=yaw if yaw_sd else None,
        iteration=np.array(iteration),
        trace=np.array([frame for frame, _ in poses]),
        residual=np.array([_stretch(log, *pose) for pose in poses]),
    )


def _minimize(problem: Problem, unknowns: Reals, params: LeastSquaresParams) -> Found:
    if params.optimizer == "gtsam":
        return factor_graph.minimize(problem, unknowns, params.evaluations)
    found = least_squares(  # type: ignore[operator]  # the stubs take it for a module
        problem.residuals,
        unknowns,
        jac=problem.jacobian,
        method="trf",
        tr_solver="lsmr",
        loss=params.loss,
        max_nfev=params.evaluations,
    )
    return Found(found.x, found.cost, found.nfev, found.status)


def _stretch(log: SensingLog, position: Reals, yaw: Reals) -> float:
    """Root mean square of distance less D of the docks in contact, in the log's unit."""
    i, a, j, b = log.contacts.T
    dock = docks_at(position, dock_offsets(log.orientation_wxyz, log.dock_offset_body), yaw)
    gap = np.linalg.norm(dock[j, b] - dock[i, a], axis=1) - log.spacing
    return float(np.sqrt(np.mean(gap**2))) if len(gap) else 0.0
