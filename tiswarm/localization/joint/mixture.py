"""From the ends of all chains to one estimate: solutions, their weights, and two verdicts.

Every end is moved to a minimum of the cost nearby. Ends at the same minimum are one solution. Its
weight is exp(-cost / 2) for each of its chains, since chains end in wide basins more often. The
estimate is the mean of this mixture; `sd` is its root mean square deviation: within solutions by
the curvature of the cost, or by the chains where the cost leaves motions open, and between
solutions by their weights. Lengths in R.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tiswarm.aliases import Bools, Ints, Reals
from tiswarm.localization.assessment import misfit_by_robot
from tiswarm.localization.joint.chains import Annealed, deviation
from tiswarm.localization.joint.frames import Frame, align, free_frame
from tiswarm.localization.joint.initialization import place_disconnected
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.settings import (
    AnnealSchedule,
    ConvergenceTest,
    MixtureSettings,
    RefineSettings,
)
from tiswarm.localization.joint.starts import images, scaled_distances
from tiswarm.localization.params import ChiSquareParams
from tiswarm.localization.refinement import Cost
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.rows import SPACING
from tiswarm.records.estimate import Convergence, Solution
from tiswarm.records.sensing_log import SensingLog


@dataclass(frozen=True, kw_only=True)
class Ends:
    """Minima that K chains lead to."""

    position: Reals
    """Centers [R], shape (K, N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (K, N)."""

    cost: Reals
    """Least cost of each; infinite for chains that failed, shape (K,)."""

    missed: Reals
    """Squared residuals in variances, shape (K, E)."""

    weight: Reals
    """Share in the mixture [1], shape (K,)."""

    solution: Ints
    """Solution of each, counted by descending weight, shape (K,)."""


class Minimum(NamedTuple):
    """The minimum of the cost of one solution."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (N,)."""

    sd: Reals
    """Standard deviation of each position [R], shape (N,)."""

    is_held: Bools
    """Whether measurements hold the robot; else chains say where it is, shape (N,)."""

    chi_square: float
    """Squared residuals in variances, priors included [1]."""

    freedom: int
    """Degrees of freedom of the chi-square: measurements beyond the unknowns that they determine."""

    square: Reals
    """Part of the chi-square that each measurement carries [1], shape (E,)."""

    log_volume: float
    """Logarithm of the width of the minimum, up to a constant."""


class Mixture(NamedTuple):
    """The estimate of one structure of N robots."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (N,)."""

    sd: Reals
    """Standard deviation of each position [R], shape (N,)."""

    mirrored: Bools
    """Whether solutions put the robot farther apart than its sd within one, shape (N,)."""

    free_frame: tuple[str, ...]
    """Rigid motions of all robots that change no measurement."""

    outlier: Bools
    """Measurements that every solution misses, shape (E,)."""

    misfit: Reals
    """Part of the chi-square that each robot's measurements carry, shape (N,)."""

    convergence: Convergence
    """The two verdicts."""

    solutions: tuple[Solution, ...]
    """Solutions, the likeliest first [R]."""


def mix(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    annealed: Annealed,
    has_failed: Bools,
    prior_sd: Reals | None = None,
) -> Mixture:
    """Mix the chains of one structure into one estimate.

    Args:
        log: What was sensed.
        params: Settings.
        problem: Measurements.
        annealed: Chains.
        has_failed: Chains that no noise of the measurements explains, shape (K,).
        prior_sd: Standard deviation of positions that measurements leave open [R], shape (N,); that
            of the chains if None.
    """
    ends = rank(log, params, problem, annealed, has_failed)
    if params.refines(log.robot_count):
        anchor = log.anchor_position / log.dock_radius
        best = ends.position[int(ends.cost.argmin())]
        further = [*scaled_distances(problem, anchor), *images(problem, best)]
        annealed, ends = _joined(log, params, problem, annealed, ends, further)
    annealed, ends, frame = _aligned(problem, annealed, ends)
    outlier = _outliers(problem, ends)
    by_chains = prior_sd
    if by_chains is None:
        by_chains = deviation(problem, annealed.mean, annealed.within, ends.weight, annealed.sigma)
    placed, square = place_disconnected(annealed.mean, problem)
    minima, shares, untied = [], [], problem.untied[:, None]
    for solution in range(int(ends.solution[ends.weight > 0.0].max()) + 1):
        weight = np.where(ends.solution == solution, ends.weight, 0.0)
        shares.append(weight.sum())
        chosen = weight / weight.sum()
        found = minimum(log, params, problem, annealed, chosen, ~outlier, by_chains)
        # Parts stay apart until the end, so that their docks push no others.
        at = np.where(untied, np.tensordot(chosen, placed, 1), found.position)
        minima.append(found._replace(position=at))
    minima, share = _weighed(minima, np.array(shares))
    best = minima[0]
    is_held = np.all([each.is_held for each in minima], axis=0)
    at = np.array([each.position for each in minima])
    position = np.where(
        is_held[:, None], np.tensordot(share, at, 1), np.tensordot(ends.weight, placed, 1)
    )
    within = share @ np.array([each.sd**2 for each in minima])
    between = share @ ((at - np.tensordot(share, at, 1)) ** 2).sum(axis=2)
    sd = np.where(is_held, np.sqrt(within + between), by_chains)
    verdict = _convergence(problem, ends, outlier, best, has_failed)
    # Chains agree where they place disconnected parts, but nothing measures it.
    sd = verdict.sd_factor * np.sqrt(sd**2 + ends.weight @ square)
    gap = problem.residual(at, np.array([each.yaw for each in minima]))
    width = np.sqrt(problem.variance + annealed.sigma**2)
    solutions = tuple(
        Solution(
            weight=float(share[n]),
            chains=int((ends.weight[ends.solution == n] > 0.0).sum()),
            chi_square=each.chi_square,
            residual=float(np.sqrt((gap[n] ** 2).mean())) if gap.size else 0.0,
            residual_sd=float(np.sqrt(((gap[n] / width) ** 2).mean())) if gap.size else 0.0,
            position=each.position,
            sd=each.sd,
        )
        for n, each in enumerate(minima)
    )
    return Mixture(
        position=position,
        yaw=np.tensordot(share, np.array([each.yaw for each in minima]), 1),
        sd=sd,
        mirrored=between > within,
        free_frame=frame.names,
        outlier=outlier,
        misfit=misfit_by_robot(problem.rows, best.square),
        convergence=verdict,
        solutions=solutions,
    )


def _weighed(minima: list[Minimum], share: Reals) -> tuple[list[Minimum], Reals]:
    """Weigh solutions, and sort those that count by descending weight.

    Where measurements hold all robots, weights are the likelihoods of the minima times their
    widths (Laplace). Elsewhere nothing but the chains says how wide a solution is.
    """
    if all(each.is_held[1:].all() for each in minima):
        height = np.array([each.log_volume - 0.5 * each.chi_square for each in minima])
        share = np.exp(height - height.max())
    share = np.where(share < MixtureSettings.least_weight * share.max(), 0.0, share / share.sum())
    order = np.argsort(-share, kind="stable")[: np.count_nonzero(share)]
    return [minima[n] for n in order], share[order] / share.sum()


def _outliers(problem: Problem, ends: Ends) -> Bools:
    """Find measurements that every end in the mixture misses, and each of the best few, (E,).

    A single chain tears contacts that are right.
    """
    test = ConvergenceTest
    order = np.argsort(np.argsort(ends.cost, kind="stable"))
    jury = (ends.weight > 0.0) | ((order < test.jury) & np.isfinite(ends.cost))
    outlier: Bools = (ends.missed[jury] > test.outlier_sd**2).all(axis=0)
    links = len(problem.variance)
    outlier[:links] = problem.any_of_link(outlier[:links])
    return outlier


def _convergence(
    problem: Problem, ends: Ends, outlier: Bools, best: Minimum, has_failed: Bools
) -> Convergence:
    """Give the verdicts, and the first reason for a bad one."""
    test, links = ConvergenceTest, len(problem.variance)
    alike = ends.cost <= ends.cost.min() + np.sqrt(2.0 * len(problem.rows))
    first = int(ends.cost.argmin())
    torn = int((ends.missed[first, :links][~outlier[:links]] > test.outlier_sd**2).sum())
    width = np.sqrt(2.0 * max(best.freedom, 1))
    misfit_sd = float((best.chi_square - best.freedom) / width)
    is_consistent = misfit_sd <= test.chance_sd
    reasons = {
        "all chains ended out of reach of their contacts, or ran hot": has_failed.all(),
        "no two chains or starts ended at the same least cost": len(alike) > 1 and alike.sum() == 1,
        f"the best chain misses {torn} contacts or ranges": (
            torn > test.torn_anyway + test.most_torn * links
        ),
        f"{outlier[:links].sum()} of {links} contacts and ranges are outliers": (
            outlier[:links].sum() > test.most_outliers * links
        ),
    }
    reason = next((text for text, applies in reasons.items() if applies), "")
    converged = not reason
    if not reason and not is_consistent:
        reason = f"chi-square exceeds its expectation by {misfit_sd:.0f} sd"
    factor = 1.0 if is_consistent else float(np.sqrt(best.chi_square / max(best.freedom, 1)))
    return Convergence(
        converged=converged,
        consistent=is_consistent,
        misfit_sd=misfit_sd,
        sd_factor=factor,
        reason=reason,
        chains=int((ends.weight > 0.0).sum()),
        restarted=0,
    )


def rank(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    annealed: Annealed,
    has_failed: Bools,
) -> Ends:
    """Move each chain to a minimum of the cost, and weigh it.

    The cost is that at `MixtureSettings.tempered` times the temperature of the chains: they end
    where it lets measurements be missed.
    """
    position, yaw = annealed.last.copy(), annealed.last_yaw.copy()
    cost = np.full(len(position), np.inf)
    rounds = MixtureSettings.rounds if params.refines(log.robot_count) else 0
    for k in np.flatnonzero(has_failed.all() | ~has_failed).tolist():
        position[k], yaw[k], cost[k] = _descended(
            log, params, problem, (position[k], yaw[k]), annealed.sigma, rounds
        )
    return _ends(problem, position, yaw, cost, annealed.sigma)


def settled(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    position: Reals,
    sigma: float,
    rounds: int,
) -> tuple[Reals, Reals, float]:
    """Move positions that no chain led to: first warm, then to a minimum as `_descended` does."""
    length = problem.length[~problem.is_offset]
    warm = MixtureSettings.unfolding * float(np.median(length)) if len(length) else sigma
    start = position, np.zeros(len(position))
    position, yaw, _ = _descended(log, params, problem, start, warm, MixtureSettings.warm_rounds)
    return _descended(log, params, problem, (position, yaw), sigma, rounds)


def _descended(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    start: tuple[Reals, Reals],
    sigma: float,
    rounds: int,
) -> tuple[Reals, Reals, float]:
    """Move a configuration to a minimum of the cost nearby: positions, yaw, and the cost."""
    cost = Cost(
        log,
        problem.rows.associated(*start),
        yaw_precision=problem.yaw_precision,
        robust_sd=AnnealSchedule.outlier_sd if params.robust else None,
        non_overlap=params.non_overlap,
        are_independent=True,
        further_variance=(MixtureSettings.tempered * sigma) ** 2,
    )
    state, linear = cost.refine(start, rounds)
    return state.position, state.yaw, linear.cost


def _ends(problem: Problem, position: Reals, yaw: Reals, cost: Reals, sigma: float) -> Ends:
    """Weigh ends, and sort them into solutions."""
    residual = problem.rows.residual(position, yaw)
    weight = _weights(cost, len(problem.rows))
    return Ends(
        position=position,
        yaw=yaw,
        cost=cost,
        missed=residual**2 / (problem.rows.variance() + sigma**2),
        weight=weight,
        solution=_solutions(position, weight),
    )


def _joined(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    annealed: Annealed,
    ends: Ends,
    further: list[Reals],
) -> tuple[Annealed, Ends]:
    """Add the minima that further starts lead to, as chains that do not move."""
    if not further:
        return annealed, ends
    rounds = 5 * MixtureSettings.rounds
    found = [settled(log, params, problem, each, annealed.sigma, rounds) for each in further]
    position, yaw, cost = (np.array(column) for column in zip(*found, strict=True))
    within = np.zeros(position.shape[:2])
    annealed = annealed.joined(position, yaw, within)
    columns = zip((ends.position, ends.yaw, ends.cost), (position, yaw, cost), strict=True)
    position, yaw, cost = (np.concatenate(pair) for pair in columns)
    return annealed, _ends(problem, position, yaw, cost, annealed.sigma)


def _aligned(problem: Problem, annealed: Annealed, ends: Ends) -> tuple[Annealed, Ends, Frame]:
    """Move all ends by rigid motions that nothing resists to where the best one is."""
    best = ends.position[int(ends.cost.argmin())]
    moves = problem.part == problem.part[0]
    frame = free_frame(problem.rows, best, moves)
    if not frame.names:
        return annealed, ends, frame
    turn = align(ends.position, best, frame, moves)

    def turned(position: Reals) -> Reals:
        about = position[:, :1]
        return np.where(moves[:, None], about + (position - about) @ turn, position)

    ends = replace(ends, position=turned(ends.position))
    ends = replace(ends, solution=_solutions(ends.position, ends.weight))
    aligned = replace(annealed, mean=turned(annealed.mean), last=turned(annealed.last))
    return aligned, ends, frame


def _weights(cost: Reals, measurements: int) -> Reals:
    """Weigh ends by their least costs, shape (K,).

    A chain makes mistakes of its own in many parts of a structure, whatever the rest is like. So
    up to the width of the chi-square, its cost says little about the whole: costs are divided by
    what leaves `MixtureSettings.fewest` ends in the mixture, where that is in reach.
    """
    excess = cost - cost.min()
    hottest = max(1.0, np.sqrt(2.0 * measurements) / MixtureSettings.chance)
    for heat in np.geomspace(1.0, hottest, MixtureSettings.heats):
        weight = np.exp(-0.5 * excess / heat)
        weight /= weight.sum()
        if 1.0 / (weight**2).sum() >= MixtureSettings.fewest:
            break
    weight[weight < MixtureSettings.least_weight] = 0.0
    scaled: Reals = weight / weight.sum()
    return scaled


def _solutions(position: Reals, weight: Reals) -> Ints:
    """Number the solutions of ends, shape (K,): those that agree to a dock's width at all robots.

    Beyond that distance robots could have changed places. An end belongs to the weightiest one that
    it agrees with.
    """
    number = np.full(len(position), -1)
    firsts: list[int] = []
    for k in np.argsort(-weight, kind="stable").tolist():
        for solution, first in enumerate(firsts):
            if np.linalg.norm(position[k] - position[first], axis=1).max() <= SPACING:
                number[k] = solution
                break
        else:
            number[k] = len(firsts)
            firsts.append(k)
    total = np.bincount(number, weight)
    return np.argsort(np.argsort(-total, kind="stable"), kind="stable")[number]


def minimum(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    annealed: Annealed,
    weight: Reals,
    inlier: Bools,
    sd: Reals,
) -> Minimum:
    """Find the minimum of the cost of one solution, by generalized least squares.

    Args:
        log: What was sensed.
        params: Settings.
        problem: Measurements.
        annealed: Chains.
        weight: Weights of the chains of this solution, which add up to 1, shape (K,).
        inlier: Measurements that count, shape (E,).
        sd: Standard deviation of positions by the chains [R], shape (N,).
    """
    members = weight > 0.0
    position, yaw = np.tensordot(weight, annealed.mean, 1), weight @ annealed.mean_yaw
    used = inlier.copy()
    used[problem.rows.touch] &= _agreed(problem.rows, annealed, members)
    rows = problem.rows.select(used).associated(position, yaw)
    curved = np.full(len(problem.rows), (0.5 * annealed.sigma) ** 2)
    curved[: len(problem.rows.other)] += _curved(problem.rows, annealed, weight)
    cost = Cost(
        log,
        rows,
        yaw_precision=problem.yaw_precision,
        links=problem.connections,
        non_overlap=params.non_overlap,
        further_variance=curved[used],
    )
    prior = RefineSettings.prior_sd * np.sqrt(len(sd)) * sd
    prior = np.maximum(prior, RefineSettings.least_prior)
    state, linear = cost.refine((position, yaw), RefineSettings.rounds, prior)
    left = RefineSettings.sd_scale * np.sqrt(linear.variance())
    is_held = (left <= RefineSettings.open_sd * sd) & ~problem.untied
    square = np.zeros(len(problem.rows))
    square[used] = linear.square
    return Minimum(
        position=np.where(is_held[:, None], state.position, position),
        yaw=np.where(is_held, state.yaw, yaw),
        sd=np.where(is_held, left, sd),
        is_held=is_held,
        chi_square=linear.chi_square,
        freedom=max(linear.freedom(), int(MixtureSettings.spare * 3 * (len(sd) - 1))),
        square=square,
        log_volume=linear.log_volume,
    )


def _agreed(rows: Measurements, annealed: Annealed, members: Bools) -> Bools:
    """Find touches whose docks are the same in some chains, shape (T,).

    The mean of chains that differ has neither docks at the right distance.
    """
    pair = rows.association(annealed.mean[members], annealed.mean_yaw[members])
    is_agreed: Bools = (pair == pair[0]).all(axis=0)
    return is_agreed


def _curved(rows: Measurements, annealed: Annealed, weight: Reals) -> Reals:
    """Compute the variance of links about their linear form, since chains move, shape (P,).

    A distance d grows by s^2 / 2d if the one dock is off by s across from the other. Offsets are
    linear.
    """
    length = rows.distances.length
    i, j = rows.robot[: len(length)], rows.other[: len(length)]
    apart = annealed.mean[:, i] - annealed.mean[:, j]
    between = weight @ ((apart - np.tensordot(weight, apart, 1)) ** 2).sum(axis=2)
    within = weight @ (annealed.within[:, i] + annealed.within[:, j])
    variance: Reals = ((between + within) / (2.0 * length)) ** 2
    return np.pad(variance, (0, len(rows.offsets.stance)))
