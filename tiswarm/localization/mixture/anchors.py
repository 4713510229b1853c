"""Known positions as outliers: anchors that contradict what robots sensed.

A known position is exact, so that chains bend the rest of a structure to it. We compare costs with
and without each of them, at the estimate and at where chains without it end. A wrong anchor gives
three coordinates that its own measurements then determine. So it is an outlier if more than three
contacts or ranges would have to be wrong in its place. Lengths in R.
"""

from dataclasses import replace
from typing import cast

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.chains.annealer import anneal
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.mixture import ANCHORS
from tiswarm.localization.mixture.ends import Fit, Posed
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.verdict import contradiction, misfit_by_robot, outlier_cost
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.cues import in_plane
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import Measurements
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_State = tuple[Reals, Reals]
"""Centers [R], shape (N, 3), and yaw corrections [rad], shape (N,)."""


def without_wrong_anchors(fit: Fit, estimate: Estimate) -> Estimate | None:
    """Localize again without known positions that contradict the other measurements.

    Args:
        fit: Chains.
        estimate: Estimate that they lead to.

    Returns:
        The estimate, which is not consistent and lists these positions; None if none is wrong, or
        if the rest is not to be trusted without them either.
    """
    first = fit
    anchors = _anchors(fit.log)
    if not fit.is_refined:
        return None
    wrong: Ints = np.empty(0, np.int64)
    while len(wrong) < ANCHORS.most * len(anchors):
        worst = _worst(fit, estimate)
        if worst is None:
            return None
        robot, fit, estimate = worst
        wrong = np.append(wrong, robot)
        if _is_trusted(estimate):
            rows = first.problem.rows
            is_wrong = first.problem.known & np.isin(rows.robot, wrong)
            return with_wrong_anchors(estimate, first.log, rows.select(is_wrong), np.sort(wrong))
    return None


def with_wrong_anchors(
    estimate: Estimate, log: SensingLog, rows: Measurements, robots: Ints
) -> Estimate:
    """Add known positions of some robots, rows of coordinates, to the outliers."""
    verdict = estimate.convergence
    if verdict is None:
        return estimate
    places = [rows.sensed_places]
    if estimate.outlier_places is not None:
        places.append(estimate.outlier_places)
    if verdict.converged:
        reason = contradiction(log, robots)
        verdict = replace(verdict, consistent=False, testable=True, reason=reason)
    return replace(estimate, convergence=verdict, outlier_places=np.concatenate(places))


def without_anchors(posed: Posed, robots: Ints) -> Posed:
    """Pose a log again without what is known of the positions of some robots but their plane."""
    log = posed.log
    is_left_out = log.is_of_anchor & ~in_plane(log) & np.isin(log.fixes[:, 0], robots)
    fewer = replace(log, fixes=log.fixes[~is_left_out])
    return Posed(fewer, posed.params, pose_problem(fewer, posed.params))


def _anchors(log: SensingLog) -> Ints:
    """List the robots of known positions beside the first one."""
    robots: Ints = np.unique(log.fixes[log.is_of_anchor, 0].astype(np.int64))
    return robots


def _is_trusted(estimate: Estimate) -> bool:
    return estimate.convergence is not None and estimate.convergence.trusted


def _worst(fit: Fit, estimate: Estimate) -> tuple[int, Fit, Estimate] | None:
    """Find the anchor without which the cost falls most, if by more than three outliers cost.

    Returns:
        The anchor, and chains and estimate without it.
    """
    params = cast("JointParams", fit.params)  # a fit is of chains
    state = _state(fit, estimate)
    cost, loss = _least(fit, state)
    misfit = misfit_by_robot(fit.problem.rows, loss)
    anchors = _anchors(fit.log)
    trials = []
    for robot in anchors[np.argsort(-misfit[anchors], kind="stable")][: ANCHORS.compared].tolist():
        posed = without_anchors(fit, np.array([robot]))
        trials.append((cost - _least(posed, state)[0], robot, posed))
    trials.sort(key=lambda trial: trial[:2], reverse=True)
    worst = None
    most = AXES * outlier_cost(fit.log)
    for gain, robot, posed in trials[: ANCHORS.tried]:
        if _is_trusted(estimate) and gain < ANCHORS.promising:
            break
        again = Fit.of(posed, anneal([posed.log], [params], [posed.problem])[0])
        placed = mixed(again)
        end = _state(again, placed)
        lower = min(cost, _least(fit, end)[0]) - min(cost - gain, _least(posed, end)[0])
        if lower > most:
            most = lower
            worst = robot, again, placed
    return worst


def _state(fit: Fit, estimate: Estimate) -> _State:
    """Take the likeliest solution."""
    position = estimate.solutions[0].position / fit.log.dock_radius
    return position, np.zeros(len(position)) if estimate.yaw is None else estimate.yaw


def _least(posed: Posed, state: _State) -> tuple[float, Reals]:
    """Find the least robust cost near a state, of a contact or range at most that of an outlier.

    Returns:
        The cost [1], and the loss of each measurement [1], shape (E,).
    """
    rows = posed.problem.rows
    cost = posed.cost(rows.associated(*state), robust_sd=ROBUST_SD)
    _, linear = cost.refine(cost.at(*state), ANCHORS.rounds)
    loss = cost.losses(linear.residual[: len(rows)])
    beyond = np.maximum(loss[rows.link] - outlier_cost(posed.log), 0.0).sum()
    return float(linear.cost - beyond), loss
