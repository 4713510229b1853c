"""The chains of `joint`, from where the structure is. Lengths in R."""

from dataclasses import fields

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization import methods
from tiswarm.localization.chains.annealer import anneal
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import place_disconnected, set_apart
from tiswarm.localization.cost.cost import Cost
from tiswarm.localization.cost.neighborhood import Configuration
from tiswarm.localization.cost.settings import CANDIDATES, ROBUST_SD
from tiswarm.localization.mixture.ends import Fit, Posed, ranked
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.outliers import without_outlier_robots
from tiswarm.localization.mixture.settings import CONVERGENCE
from tiswarm.localization.settings import ChiSquareParams, JointParams
from tiswarm.parts.online.settings import TIMES, OnlineParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_ANNEALER = ("chains", "steps", "hold_steps", "start_sigma")


def reannealed(
    log: SensingLog, params: OnlineParams, state: Configuration, *, anew: bool = False
) -> tuple[Configuration, Reals, Reals]:
    """Anneal a structure of N robots from where it is, and keep the best minimum.

    Args:
        log: What was sensed; the anchor is at the origin.
        params: Settings.
        state: Where robots are.
        anew: Whether to anneal it from the starts of `joint`, too.

    Returns:
        The state, which is near the present one if no chain found a better one; the shift from
        there to the mean of all likely ends of chains [R], shape (N, 3); and the standard deviation
        of that [R], shape (N,).
    """
    fit = _fitted(log, params, state)
    problem, ends = fit.problem, ranked(fit)
    cost = Cost(
        log,
        problem.rows,
        robust_sd=ROBUST_SD if params.robust else None,
        non_overlap=params.non_overlap,
    )
    walks = problem.rows.odometry
    # Turns of earlier stances follow from those of final ones in a step.
    turn = np.zeros((len(walks.owner), 3))
    turn[walks.final] = state.turn
    yaw = np.zeros(log.robot_count)
    best = int(ends.cost.argmin())
    # Chains may all end higher than where they began, which is near a minimum already.
    found = [
        cost.refine((set_apart(problem, state.position), yaw), 0, turn=turn),
        cost.refine((ends.position[best], yaw), TIMES.rounds),
    ]
    if anew:
        start = _searched(log, params).solutions[0].position / log.dock_radius
        found.append(cost.refine((set_apart(problem, start), yaw), TIMES.rounds))
    there, linear = min(found, key=lambda each: each[1].cost)
    placed, square = place_disconnected(there.position[None], problem)
    own = linear.variance(draws=TIMES.draws)
    # Ends are minima of a cost whose errors are independent: where they are is not where the cost
    # is least, but where they differ, several places are likely.
    apart = ends.position - ends.position[best] + found[1][0].position - there.position
    apart[np.linalg.norm(apart, axis=2) <= np.sqrt(own)] = 0.0
    mean = np.tensordot(ends.weight, apart, 1)
    between = ends.weight @ ((apart - mean) ** 2).sum(axis=2)
    # Chains that ended far above the best minimum say nothing about it.
    counts = ~problem.untied & (found[1][1].cost <= linear.cost + CANDIDATES.likely)
    shift = np.where(counts[:, None], mean, 0.0)
    sd = np.sqrt(own + np.where(counts, between, square[0]))
    return Configuration(placed[0], there.turn[walks.final]), shift, sd


def annealed_estimate(log: SensingLog, params: OnlineParams, state: Configuration) -> Estimate:
    """Anneal a structure from where it is, and mix the chains as `joint` does; as `reannealed`.

    An estimate that is not to be trusted gives way to that of `joint`, if that is trusted.
    """
    fit = _fitted(log, params, state)
    estimate = without_outlier_robots(fit, mixed(fit))
    if estimate.convergence is None or estimate.convergence.trusted:
        return estimate
    other = _searched(log, params)
    is_better = other.convergence is not None and other.convergence.trusted
    return other if is_better else estimate


def elsewhere(log: SensingLog, params: OnlineParams, position: Reals, sd: Reals) -> Bools:
    """Find robots that a search from no present estimate puts elsewhere, shape (N,).

    Args:
        log: What was sensed; the anchor is at the origin.
        params: Settings.
        position: Where robots are [R], shape (N, 3).
        sd: Standard deviation of each position [R], shape (N,).
    """
    allowed = np.maximum(CONVERGENCE.outlier_sd * sd, CANDIDATES.distinct)
    share = np.zeros(log.robot_count)
    for solution in _searched(log, params).solutions:
        away = np.linalg.norm(solution.position / log.dock_radius - position, axis=1)
        share += np.where(away > allowed, solution.weight, 0.0)
    return share > CANDIDATES.rival


def _searched(log: SensingLog, params: OnlineParams) -> Estimate:
    """Localize as `joint` does, whose chains know nothing of the present estimate."""
    names = [field.name for field in fields(ChiSquareParams)]
    cold = JointParams(**{name: getattr(params, name) for name in names})
    return methods.localize_batch([log], [cold])[0]


def _fitted(log: SensingLog, params: OnlineParams, state: Configuration) -> Fit:
    """Anneal a structure from where it is."""
    names = [*(field.name for field in fields(ChiSquareParams)), *_ANNEALER]
    warm = JointParams(**{name: getattr(params, name) for name in names})
    problem = pose_problem(log, warm)
    # All chains begin at one place; their kicks differ.
    start = np.tile(set_apart(problem, state.position), (warm.chains_for(log.robot_count), 1, 1))
    chains = anneal([log], [warm], [problem], start=[start])[0]
    return Fit.of(Posed(log, warm, problem), chains)
