"""One parameter that all robots share, if it explains what noise does not.

A dock offset that is off by a hundredth of R makes all contacts wrong by a little, and a few robots
carry more of the misfit than others by chance. So before robots are named we free one common
parameter at a time: it is one column more of the linear problem, or three of a turn. Where the
column explains more than chance, Gauss-Newton steps of the parameter and of all unknowns lead to
its value. It is the cause only if the log that states this value is consistent. Lengths in R.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.compute.chi_square import binomial_chance, chi_square_chance
from tiswarm.localization.chains.problem import has_sure_way, pose_problem
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import State, WholeCost, shortened
from tiswarm.localization.cost.linear import Linear
from tiswarm.localization.mixture import COMMON_CAUSES
from tiswarm.localization.mixture.ends import Posed
from tiswarm.localization.mixture.verdict import outlier_rate
from tiswarm.measurements.common import COMMON_PARAMETERS, CommonParameter
from tiswarm.measurements.cues import Precision, measure
from tiswarm.records.estimate import CommonCause, Estimate
from tiswarm.records.sensing_log import SensingLog

_DIFFERENCE = 1e-5
"""Change of a parameter by which derivatives are computed [R, 1, rad]."""


class _Score(NamedTuple):
    """What a linear problem says of a change of a parameter."""

    step: Reals
    """Likeliest change [R, 1, rad], shape (components,)."""

    covariance: Reals
    """Covariance of its components, 0 of those that nothing determines, shape (components,) * 2."""

    gain: float
    """By how much the cost falls [1]."""

    freedom: int
    """Components that measurements determine."""


class _Fitted(NamedTuple):
    """A minimum of the robust cost over all unknowns and one parameter."""

    parameter: CommonParameter
    change: Reals
    covariance: Reals
    posed: Posed
    state: State

    cost: float
    """Cost there [1]."""

    chance: float
    """Chance that the change is none [1]."""

    def described(self, log: SensingLog) -> CommonCause:
        """Describe the value in the unit of the log."""
        parameter = self.parameter
        is_turn = parameter.kind == "turn"
        unit = log.dock_radius
        unit_name = log.length_unit
        if is_turn:
            unit = 180.0 / np.pi
            unit_name = "deg"
        elif parameter.kind == "factor":
            unit = 1.0
            unit_name = "1"
        along = np.ones(1)
        if is_turn:
            along = self.change / np.linalg.norm(self.change)
        stated = parameter.stated(log)
        return CommonCause(
            parameter=parameter.name,
            key=parameter.key,
            stated=stated,
            value=stated + unit * float(along @ self.change),
            sd=unit * float(np.sqrt(along @ self.covariance @ along)),
            unit=unit_name,
            axis=tuple(along.tolist()) if is_turn else None,
            is_height=parameter.kind == "height",
        )


def with_common_causes(
    posed: Posed, estimate: Estimate, localized: Callable[[SensingLog], Estimate]
) -> Estimate | None:
    """Find a common parameter that explains what speaks against an estimate.

    Args:
        posed: What was sensed.
        estimate: The estimate that it leads to.
        localized: Localizes another log by the same method, without a search for causes.

    Returns:
        The estimate with its causes, not consistent then; None if nothing speaks against it, no
        parameter explains more than chance, or the log with its value is not consistent either.
    """
    if posed.log.robot_count > COMMON_CAUSES.most_robots or not posed.is_refined:
        return None
    if not _is_doubtful(posed, estimate):
        return None
    causes = _causes(posed, estimate, localized)
    return estimate.with_common_causes(causes) if causes else None


def _is_doubtful(posed: Posed, estimate: Estimate) -> bool:
    """Judge whether a verdict, or the number of outliers, speaks against an estimate.

    Where measurements of one kind are wrong and robots have more of others, these are outliers.
    """
    verdict = estimate.convergence
    if verdict is None or not verdict.trusted:
        return verdict is not None
    listed = (estimate.outlier_contacts, estimate.outlier_places)
    count = sum(len(rows) for rows in listed if rows is not None)
    total = len(posed.problem.rows) + len(posed.problem.inconsistent)
    chance = binomial_chance(count, total, outlier_rate(posed.log))
    return count > 0 and chance < COMMON_CAUSES.chance


def _causes(
    posed: Posed, estimate: Estimate, localized: Callable[[SensingLog], Estimate]
) -> tuple[CommonCause, ...]:
    """Find the parameter that explains most, and those that fit as well."""
    robots = posed.log.robot_count
    position = estimate.configuration / posed.log.dock_radius
    yaw = np.zeros(robots) if estimate.yaw is None else estimate.yaw
    fitted = _candidates(posed, (position, yaw))
    for candidate in fitted[: COMMON_CAUSES.most_tested]:
        cause = _confirmed(posed, candidate, localized)
        if cause is None:
            continue
        alike = [
            rival.described(posed.log)
            for rival in fitted
            if rival.parameter is not cause.parameter
            and rival.cost - candidate.cost <= COMMON_CAUSES.as_likely
        ]
        return (cause.described(posed.log), *alike)
    return ()


def _candidates(posed: Posed, start: tuple[Reals, Reals]) -> list[_Fitted]:
    """Fit the parameters that explain more than chance, by ascending cost."""
    parameters = [p for p in COMMON_PARAMETERS if p.applies(posed.log)]
    cost = _robust(_posed(posed, posed.log), start)
    state, linear = cost.refine(cost.at(*start), COMMON_CAUSES.rounds)
    scored: list[tuple[float, int, CommonParameter]] = []
    for parameter in parameters:
        score = _score(parameter, posed, np.zeros(parameter.components), state, linear)
        if _chance(score, len(parameters)) < COMMON_CAUSES.chance:
            scored.append((-score.gain, len(scored), parameter))
    scored.sort()
    fitted = [
        _fit(parameter, posed, state, len(parameters))
        for _, _, parameter in scored[: COMMON_CAUSES.most_fitted]
    ]
    significant = [one for one in fitted if one is not None and one.chance < COMMON_CAUSES.chance]
    return sorted(significant, key=lambda one: one.cost)


def _confirmed(
    posed: Posed, candidate: _Fitted, localized: Callable[[SensingLog], Estimate]
) -> _Fitted | None:
    """Localize the log that states the value of a parameter; None if it is not trusted either.

    A search that began at a wrong configuration may have led to a wrong value: the parameter is
    fitted again from where that log leads to.
    """
    for _ in range(COMMON_CAUSES.confirmations):
        log = candidate.parameter.changed(posed.log, candidate.change)
        again = localized(log)
        again_posed = _posed(posed, log)
        if not _is_doubtful(again_posed, again):
            return candidate
        position = again.configuration / log.dock_radius
        yaw = np.zeros(log.robot_count) if again.yaw is None else again.yaw
        cost = _robust(again_posed, (position, yaw))
        state, _ = cost.refine(cost.at(position, yaw), COMMON_CAUSES.rounds)
        refitted = _fit(candidate.parameter, posed, state, 1, candidate.change)
        if refitted is None or refitted.cost >= candidate.cost - COMMON_CAUSES.as_likely:
            return None
        candidate = refitted
    return None


def _posed(posed: Posed, log: SensingLog) -> Posed:
    """Pose the problem of another log with the same settings and all its rows.

    A method leaves out coordinates of a robot that others make superfluous, or contradict. Here
    they count: they may be those that depend on a parameter.
    """
    params = posed.params
    problem = pose_problem(log, params)
    precision = Precision(params.contact_sd, params.height_sd, params.spawn_sd)
    rows = measure(log, params.used_cues, odometry=problem.rows.odometry, precision=precision)
    return Posed(log, params, replace(problem, rows=rows.select(has_sure_way(rows))))


def _robust(posed: Posed, start: tuple[Reals, Reals]) -> WholeCost:
    """Return the robust cost of all rows, touches as at positions and yaws."""
    problem = posed.problem
    return posed.cost(
        problem.rows.associated(*start),
        links=problem.connections,
        robust_sd=ROBUST_SD,
        are_independent=problem.rows.odometry.bias > 0.0,
    )


def _chance(score: _Score, tried: int) -> float:
    """Chance of a gain if the parameter is right, of the least one of several [1]."""
    if not score.freedom:
        return 1.0
    chance = chi_square_chance(np.array([score.gain]), np.array([score.freedom]))
    return float(tried * chance[0])


def _score(
    parameter: CommonParameter, posed: Posed, change: Reals, state: State, linear: Linear
) -> _Score:
    """Find the likeliest change of a parameter beside one that it has.

    Args:
        parameter: The parameter.
        posed: The log as it is stated.
        change: How far the parameter is from its stated value, shape (components,).
        state: Where the cost was linearized.
        linear: The cost of the log with this change, linearized.
    """
    column = _columns(parameter, posed, change, state, linear)
    weighted = linear.weighted(column)
    coupling = np.asarray(linear.jacobian.T @ weighted)
    moved = linear.undamped.solve(coupling)
    whole = column.T @ weighted
    information = whole - coupling.T @ moved
    slope = weighted.T @ linear.residual - moved.T @ linear.slope
    # In units of what rows alone would say, eigenvalues are shares that unknowns leave.
    scale = 1.0 / np.sqrt(np.maximum(whole.diagonal(), np.finfo(np.float64).tiny))
    value, vector = np.linalg.eigh(information * scale[:, None] * scale)
    is_determined = (value > COMMON_CAUSES.least_share) & (whole.diagonal().max() > 0.0)
    vector = scale[:, None] * vector[:, is_determined]
    covariance = (vector / value[is_determined]) @ vector.T
    step = -covariance @ slope
    gain = float(slope @ covariance @ slope)
    return _Score(step, covariance, gain, int(is_determined.sum()))


def _columns(
    parameter: CommonParameter, posed: Posed, change: Reals, state: State, linear: Linear
) -> Reals:
    """Compute derivatives of all rows by a parameter, overlaps included, shape (n, components).

    Arguments as for `_score`.
    """
    columns = []
    for axis in np.eye(parameter.components):
        pair = []
        for sign in (1.0, -1.0):
            log = parameter.changed(posed.log, change + sign * _DIFFERENCE * axis)
            cost = _robust(_posed(posed, log), (state.position, state.yaw))
            pair.append([table.residual for table in cost.linearized(state).tables])
        column = []
        for table, more, less in zip(linear.tables, *pair, strict=True):
            slope = np.zeros(len(table.residual))
            # Docks that just begin to overlap are rows of one side only.
            if len(slope) == len(more) == len(less):
                slope = (more - less) / (2.0 * _DIFFERENCE)
            column.append(slope)
        columns.append(np.concatenate(column))
    return np.column_stack(columns)


def _fit(
    parameter: CommonParameter,
    posed: Posed,
    state: State,
    tried: int,
    change: Reals | None = None,
) -> _Fitted | None:
    """Take Gauss-Newton steps of a parameter, each to where all unknowns are at a minimum.

    Args:
        parameter: The parameter.
        posed: The log as it is stated.
        state: Where to begin.
        tried: Number of parameters, the likeliest of them being chosen.
        change: Change of the parameter to begin with, none if None.
    """
    if change is None:
        change = np.zeros(parameter.components)
    for _ in range(COMMON_CAUSES.steps):
        log = parameter.changed(posed.log, change)
        posed_again = _posed(posed, log)
        cost = _robust(posed_again, (state.position, state.yaw))
        state, linear = cost.refine(state, COMMON_CAUSES.rounds)
        score = _score(parameter, posed, change, state, linear)
        if not score.freedom:
            return None
        if score.gain < COMMON_CAUSES.settled:
            break
        change = change + shortened(score.step[None], COMMON_CAUSES.longest_step)[0]
    information = np.linalg.pinv(score.covariance, hermitian=True)
    whole = score._replace(gain=float(change @ information @ change))
    return _Fitted(
        parameter=parameter,
        change=change,
        covariance=score.covariance,
        posed=posed_again,
        state=state,
        cost=linear.cost,
        chance=_chance(whole, tried),
    )
