"""Whole robots as outliers: those whose orientations disagree with all that others sensed.

The error of an IMU that drifts grows from stance to stance. It is in everything that the robot
sensed on its walk, and no single measurement is to blame. Where noise does not explain the least
chi-square, we look for the robot without whose orientations the cost is least. It is an outlier if
chance does not explain how much lower the cost is. Then we look for the next. A sensor that repeats
one value while its robot flips is an outlier without a search. Lengths in R.
"""

from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.chi_square import MEDIAN_SQUARE, chi_square_chance
from tiswarm.localization.chains.annealer import Annealed, anneal
from tiswarm.localization.chains.problem import DISREGARDED_SD, pose_problem
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import State
from tiswarm.localization.cost.linear import Linear
from tiswarm.localization.mixture import OUTLIER_ROBOTS
from tiswarm.localization.mixture.ends import Fit, Posed
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.verdict import gains_without, widened
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.odometry import stuck_robots
from tiswarm.records.estimate import MOST_MISFIT_SD, Convergence, Estimate
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import SensingLog

_TRIAL_TURN = 1.5
"""Turn about each axis, in both directions, from which an orientation is searched [rad]."""

_TRIAL_SD = 0.3
"""Standard deviation by which measurements may be missed as this search begins [R]."""


class Disregarded(NamedTuple):
    """A structure without the orientations of some robots."""

    robots: Ints
    """These robots, shape (K,)."""

    posed: Posed
    """What was sensed, with final orientations of these robots that meet other measurements, and
    the rows without those of their walks."""

    annealed: Annealed
    """Chains, with these robots where the other measurements put them."""


class _Trial(NamedTuple):
    """A minimum of the robust cost without the orientations of K robots."""

    robots: Ints
    posed: Posed
    state: State
    linear: Linear


def without_outlier_robots(fit: Fit, estimate: Estimate) -> Estimate:
    """Localize again without the orientations of robots that explain most of a misfit, if any.

    A drift that is too small to be named may turn the rest of the structure. So the estimate stays
    as uncertain, and as little to be trusted, as the misfit of all measurements says.
    """
    trial = disregard(fit, estimate)
    if trial is None:
        return estimate
    posed = trial.posed
    params = cast("JointParams", posed.params)  # a fit is of chains
    chains = anneal([posed.log], [params], [posed.problem])[0]
    again = mixed(Fit.of(posed, trial.annealed.joined(chains)))
    before = estimate.convergence
    after = again.convergence
    if before is None or after is None or again.sd is None or not explains(before, after):
        return estimate
    factor = max(before.sd_factor, after.sd_factor)
    missed = [listed.outlier_contacts for listed in (estimate, again)]
    contacts = [listed for listed in missed if listed is not None]
    verdict = replace(
        after,
        consistent=False,
        sd_factor=factor,
        reason=f"the orientations of {counted(len(trial.robots), 'robot')} are outliers",
    )
    return replace(
        again,
        convergence=verdict,
        sd=widened(again.sd, factor / after.sd_factor, again.position),
        outlier_robots=np.sort(trial.robots),
        # Wrong contacts make a robot suspect, too: they stay listed.
        outlier_contacts=np.unique(np.concatenate(contacts), axis=0) if contacts else None,
    )


def disregard(fit: Fit, estimate: Estimate) -> Disregarded | None:
    """Find the robots whose orientations do not count, where an estimate is not consistent.

    Args:
        fit: Chains.
        estimate: Estimate that all orientations lead to.

    Returns:
        The structure without them. None if there are none, or too many to be outliers, or if the
        structure is too large to be refined.
    """
    log = fit.log
    problem = fit.problem
    verdict = estimate.convergence
    stuck = stuck_robots(log)
    # Orientations that are off also make docks overlap, or trap chains, so that no row is blamed.
    is_explained = verdict is None or verdict.trusted or verdict.misfit_sd <= MOST_MISFIT_SD
    if is_explained and not len(stuck):
        return None
    # The error of an orientation that was chained is that of many robots.
    if not fit.is_refined or problem.is_chained:
        return None
    position = estimate.solutions[0].position / log.dock_radius
    yaw = np.zeros(log.robot_count) if estimate.yaw is None else estimate.yaw
    trial = _fitted(stuck, _posed(fit, stuck) if len(stuck) else fit, (position, yaw))
    for robot in stuck.tolist():
        trial = _searched(trial, robot)
    further = None if is_explained else _next(trial)
    while further is not None:
        trial = further
        if len(trial.robots) - len(stuck) > OUTLIER_ROBOTS.most * log.robot_count:
            return None
        further = _next(trial)
    trial = _justified(trial, stuck)
    if not len(trial.robots):
        return None
    turned = replace(trial.posed, log=_turned(trial))
    return Disregarded(trial.robots, _posed(turned, trial.robots), _placed(fit.annealed, trial))


def _posed(posed: Posed, disregarded: Ints) -> Posed:
    """Choose the rows of a log without the orientations of some robots."""
    problem = pose_problem(posed.log, posed.params, disregarded)
    return Posed(posed.log, posed.params, problem)


def explains(before: Convergence, after: Convergence) -> bool:
    """Judge whether outlier robots explain a misfit, if there was one: without them it is small.

    Where docks or noise are not as stated, a few robots are worse than others, but most of the
    misfit is left.
    """
    if before.misfit_sd <= MOST_MISFIT_SD:
        return after.converged and after.misfit_sd <= MOST_MISFIT_SD
    return after.converged and after.misfit_sd <= OUTLIER_ROBOTS.most_left * before.misfit_sd


def _fitted(
    robots: Ints,
    posed: Posed,
    start: tuple[Reals, Reals],
    turns: tuple[Reals, Reals] | None = None,
    sd: float = 0.0,
) -> _Trial:
    """Find the minimum of the robust cost near positions, yaws, and turns as in `WholeCost.at`.

    Measurements may be missed by some standard deviation [R] beside their noise; docks may overlap
    then.
    """
    cost = posed.cost(
        posed.problem.rows.associated(*start),
        robust_sd=ROBUST_SD,
        non_overlap=not sd,
        further_variance=sd**2,
    )
    begin = cost.at(*start, *(turns or ()))
    return _Trial(robots, posed, *cost.refine(begin, OUTLIER_ROBOTS.rounds))


def _without(trial: _Trial, robots: Ints) -> _Trial:
    """Leave out the orientations of some robots, and find the minimum near another one.

    What the other minimum had to turn these robots by is given in widths of its priors.
    """
    posed = _posed(trial.posed, robots)
    state = trial.state
    sd, before = (variant.problem.rows.odometry.turn_sd for variant in (posed, trial.posed))
    ratio = np.divide(before, sd, out=np.zeros_like(sd), where=sd > 0.0)[:, [0, 0, 1]]
    final = posed.problem.rows.odometry.final
    turns = state.turn * ratio[final], state.earlier * np.delete(ratio, final, axis=0)
    return _fitted(robots, posed, (state.position, state.yaw), turns)


def _next(trial: _Trial) -> _Trial | None:
    """Leave out the orientations of the robot that chance explains least, if there is one."""
    rows = trial.posed.problem.rows
    gain, freed = gains_without(rows, trial.linear, np.arange(rows.robots))
    predicted = _significance(gain, freed, trial)
    predicted[trial.robots] = 0.0
    best = None
    most = OUTLIER_ROBOTS.least
    for robot in np.argsort(-predicted, kind="stable")[: OUTLIER_ROBOTS.tried].tolist():
        # Sorted: no later robot is more promising.
        if predicted[robot] < OUTLIER_ROBOTS.promising:
            break
        further = _without(trial, np.append(trial.robots, robot))
        lower = np.array([trial.linear.chi_square - further.linear.chi_square])
        significance = _significance(lower, freed[[robot]], further)[0]
        if significance >= most:
            best = further
            most = significance
    return None if best is None else _searched(best, int(best.robots[-1]))


def _searched(trial: _Trial, robot: int) -> _Trial:
    """Find the least cost over orientations of a robot that does not count.

    An IMU may have drifted by more than a right angle. The search begins where contacts may be
    missed by more than their noise, since far from all minima the robust loss is flat.
    """
    robots, posed, state, _ = trial
    trials = []
    for axis in np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]):
        turn = state.turn.copy()
        # States hold turns in standard deviations.
        turn[robot] += axis * _TRIAL_TURN / DISREGARDED_SD
        start = state.position, state.yaw
        trials.append(_fitted(robots, posed, start, (turn, state.earlier), sd=_TRIAL_SD))
    best = min(trials, key=lambda candidate: candidate.linear.cost).state
    # Costs of the search let contacts be missed: only those without that can be compared.
    again = _fitted(robots, posed, (best.position, best.yaw), (best.turn, best.earlier))
    return min(trial, again, key=lambda candidate: candidate.linear.cost)


def _justified(trial: _Trial, stuck: Ints) -> _Trial:
    """Let orientations that are not stuck count where chance explains how much the cost rises.

    Before the robot that is to blame was found, its neighbors may have looked worse.
    """
    for robot in trial.robots[len(stuck) : -1].tolist():
        back = _without(trial, trial.robots[trial.robots != robot])
        rise = np.array([back.linear.chi_square - trial.linear.chi_square])
        _, freed = gains_without(back.posed.problem.rows, back.linear, np.array([robot]))
        if _significance(rise, freed, trial)[0] < OUTLIER_ROBOTS.least:
            trial = back
    return trial


def _significance(gain: Reals, freed: Ints, trial: _Trial) -> Reals:
    """Compute how surely the rows that were freed are wrong, if that lowers the cost so much.

    Args:
        gain: Differences of costs [1], shape (n,).
        freed: Rows that were freed, shape (n,).
        trial: Minimum whose typical squares say how noisy good measurements are.

    Returns:
        -log10 of the chance of such a gain if they are right, shape (n,).
    """
    square = trial.linear.square
    spare = len(square) / max(trial.linear.freedom(), 1)
    # Where noise is stated too small, all squares are large, and the gain of one robot says little.
    noise = max(1.0, float(np.median(square) / MEDIAN_SQUARE) * spare)
    with np.errstate(divide="ignore"):  # a gain beyond any chance is infinitely significant
        significance = -np.log10(chi_square_chance(gain / noise, freed))
    return np.where(freed > 0, significance, 0.0)


def _turned(trial: _Trial) -> SensingLog:
    """Turn robots whose orientations do not count as other measurements say."""
    robots = trial.robots
    log = trial.posed.log
    walks = trial.posed.problem.rows.odometry
    final = walks.final[robots]
    yaw = Rotation.from_rotvec(np.outer(trial.state.yaw[robots], [0.0, 0.0, 1.0]))
    turn = Rotation.from_rotvec(-trial.state.turn[robots] * walks.turn_sd[final][:, [0, 0, 1]])
    sensed = Rotation.from_quat(log.orientation_wxyz[robots], scalar_first=True)
    orientation = log.orientation_wxyz.copy()
    # Yaw corrections of the new log come first, too.
    orientation[robots] = (yaw.inv() * turn * yaw * sensed).as_quat(scalar_first=True)
    return replace(log, orientation_wxyz=orientation)


def _placed(annealed: Annealed, trial: _Trial) -> Annealed:
    """Move robots whose orientations do not count to where other measurements put them."""
    mean = annealed.mean.copy()
    last = annealed.last.copy()
    within = annealed.within.copy()
    mean[:, trial.robots] = last[:, trial.robots] = trial.state.position[trial.robots]
    within[:, trial.robots] = trial.linear.variance()[trial.robots]
    return replace(annealed, mean=mean, last=last, within=within)
