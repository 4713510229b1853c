"""From the ends of all chains to one estimate: solutions, their weights, and two verdicts.

Every end is moved to a minimum of the cost nearby. Ends at the same minimum are one solution. Its
weight is exp(-cost / 2) for each of its chains, since chains end in wide basins more often. The
estimate is the mean of this mixture; `sd` is its root mean square deviation: within solutions by
the curvature of the cost, or by the chains where the cost leaves motions open, and between
solutions by their weights.

A chain moves about its mean for three reasons: measurements are noisy, they leave directions open,
and the temperature lets them be missed. Only the first two are errors, and make `sd`. Lengths in R.
"""

from collections.abc import Mapping
from dataclasses import replace
from heapq import heappop, heappush
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.chi_square import chi_square_limit, chi_square_sd
from tiswarm.localization.chains.annealer import Annealed
from tiswarm.localization.chains.problem import Problem, walk_sd
from tiswarm.localization.chains.views import ANNEALING, place_disconnected
from tiswarm.localization.cost.cost import SETTLED, State, WholeCost, grouped, moments
from tiswarm.localization.cost.linear import DRAWS, FEW_DRAWS, Linear
from tiswarm.localization.mixture import CONVERGENCE, MIXTURE, REFINEMENT, SD_CALIBRATION
from tiswarm.localization.mixture.ends import Ends, Fit, aligned, descended, ends_of, ranked
from tiswarm.localization.mixture.frames import PartImages
from tiswarm.localization.mixture.verdict import (
    Evidence,
    InlierFit,
    extent,
    judge,
    misfit_by_robot,
    rms,
    widened,
)
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import stuck_robots
from tiswarm.records.estimate import Estimate, Solution

_LEAST_CHAINS = 1.5
"""Effective number of chains below which their spread says nothing."""


class Minimum(NamedTuple):
    """The minimum of the cost of one solution."""

    configuration: Reals
    """Centers at the minimum [R], shape (N, 3)."""

    position: Reals
    """Centers at the minimum, but the means of chains for robots that measurements do not hold [R],
    shape (N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (N,)."""

    sd: Reals
    """Standard deviation of each position [R], shape (N,)."""

    is_held: Bools
    """Whether measurements hold the robot; else chains say where it is, shape (N,)."""

    aside: Reals
    """Square of how far free turns move a robot's mean from where it is at the minimum, 0 of all
    others [R^2], shape (N,)."""

    cost: float
    """Squared residuals and overlaps in variances, priors of turns included [1]."""

    chi_square: float
    """Squared residuals in variances, and priors of turns, without overlaps [1]."""

    freedom: int
    """Measurements beyond the unknowns that they determine."""

    square: Reals
    """Part of the chi-square that each measurement carries [1], shape (E,)."""

    log_volume: float
    """Logarithm of the width of the minimum, up to a sum that is the same for all of a cost; 0 of
    an estimate that is not refined, which has one minimum."""

    chains: int
    """Chains that lead to it."""

    inlier_fit: InlierFit | None = None
    """Measurements that count, and the minimum of their cost; None unless refined."""

    @property
    def log_height(self) -> float:
        """Logarithm of its probability up to a constant, by Laplace's approximation."""
        return self.log_volume - 0.5 * self.cost


def mixed(fit: Fit, *, restarted: int = 0, prior_sd: Reals | None = None) -> Estimate:
    """Make one estimate of the chains of a structure, or of starts that do not move.

    Args:
        fit: Chains.
        restarted: How many annealings were repeated.
        prior_sd: Standard deviation of positions that measurements leave open [R], shape (N,); that
            of the chains if None.
    """
    ends = aligned(ranked(fit))
    ends = ends if fit.is_refined else gathered(ends)
    log = fit.log
    problem = fit.problem
    annealed = ends.fit.annealed
    outlier = _outliers(ends)
    if prior_sd is None:
        hinged = _hinged_variance(ends, ~outlier)
        open_sd = _open_sd(ends, hinged)
        most_sd = _sampled_sd(ends, hinged)
    else:
        open_sd = prior_sd
        most_sd = np.full(len(prior_sd), np.inf)
    minima, share = _minima(ends, ~outlier, open_sd)
    # Which solutions there are, and where, does not depend on what chains sample.
    open_sd = np.minimum(open_sd, most_sd)
    minima = [_bounded(solution, most_sd) for solution in minima]
    # A robot that some solution leaves open has no mean over all: chains say where it is.
    is_held = np.all([solution.is_held for solution in minima], axis=0)
    at = np.array([solution.position for solution in minima])
    # The variance of a mixture: the mean within its parts, and that between their means.
    mean, between = moments(share, at)
    within = share @ np.array([solution.sd**2 for solution in minima])
    position = np.where(is_held[:, None], mean, np.tensordot(ends.weight, annealed.mean, 1))
    # Chains agree where disconnected parts are, but nothing measures it.
    whole = [position, *(solution.configuration for solution in minima)]
    tied = problem.without(outlier)
    placed, loose = place_disconnected(np.array(whole), tied)
    if len(ends.weight) < CONVERGENCE.jury:  # few chains tear contacts that are right
        torn = tied.untied & ~problem.untied
        placed[:, torn] = np.array(whole)[:, torn]
    sd = np.where(is_held, np.sqrt(within + between), open_sd)
    verdict = judge(_evidence(ends, outlier, tied.untied, minima[0]))
    sd = np.sqrt(widened(sd, verdict.sd_factor, placed[0]) ** 2 + loose[0])
    yaw = np.tensordot(share, np.array([solution.yaw for solution in minima]), 1)
    stuck = stuck_robots(log)
    unit = log.dock_radius
    motions = ends.turns.stated(minima[0].configuration, unit) if ends.turns else {}
    return Estimate(
        robot_id=log.robot_id,
        position=placed[0] * unit,
        disconnected=tied.untied,
        sd=sd * unit,
        yaw=yaw if problem.yaw_precision else None,
        convergence=replace(verdict, restarted=restarted),
        outlier_robots=stuck if len(stuck) else None,
        misfit=misfit_by_robot(problem.rows, minima[0].square),
        mirrored=between > within,
        solutions=tuple(
            _solution(fit, *described)
            for described in zip(minima, share, placed[1:], loose[1:], strict=True)
        ),
        **_listed(problem, outlier) if verdict.converged else {},
        **_traced(fit, placed[0], yaw),
        **motions,
    )


def gathered(ends: Ends) -> Ends:
    """Put all ends of many robots at the minimum that the mean of their chains leads to."""
    fit = ends.fit
    weight = ends.weight
    annealed = ends.fit.annealed
    start = moments(weight, annealed.mean)[0], weight @ annealed.mean_yaw
    position, yaw, cost = descended(fit, start, annealed.sigma, MIXTURE.rounds)
    least = np.where(np.isfinite(ends.cost), cost, np.inf)
    positions = np.tile(position, (len(weight), 1, 1))
    met = ends_of(fit, positions, np.tile(yaw, (len(weight), 1)), least)
    # Between chains that differ, the mean misses what each of them meets.
    return replace(met, weight=weight, missed=np.minimum(met.missed, ends.missed))


def _open_sd(ends: Ends, hinged: Reals) -> Reals:
    """Compute the standard deviation of positions that measurements leave open [R], shape (N,).

    Chains agree on motions that the search has not tried. Robots that only their contacts hold are
    as uncertain as if hinges joined them.
    """
    fit = ends.fit
    annealed = ends.fit.annealed
    sd = deviation(fit.problem, annealed.mean, annealed.within, ends.weight, annealed.sigma)
    return np.sqrt(SD_CALIBRATION.chains * sd**2 + hinged) if fit.is_refined else sd


def _hinged_variance(ends: Ends, inlier: Bools) -> Reals:
    """Compute what counts of the variance of positions if contacts were hinges [R^2], shape (N,).

    It is 0 of robots that nothing ties to the world, and of structures too large to be refined.
    """
    fit = ends.fit
    problem = ends.fit.problem
    if not fit.is_refined:
        return np.zeros(len(problem.part))
    best = int(ends.cost.argmin())
    start = ends.position[best], ends.yaw[best]
    joins = problem.is_final if problem.is_final.any() else np.ones(len(problem.pair), np.bool_)
    cost = fit.cost(
        problem.rows.select(inlier).associated(*start),
        are_independent=True,
        further_variance=ANNEALING.coldest**2,
        hinged=np.unique(problem.pair[joins], axis=0),
    )
    square = cost.open_variance(*start, part=SD_CALIBRATION.hinged)
    return np.where(problem.untied, 0.0, square)


def _sampled_sd(ends: Ends, hinged: Reals) -> Reals:
    """Bound the standard deviation of positions by what chains sample [R], shape (N,).

    Where chains go at least as far as hinges would say, they reach all that measurements leave
    open: their variance is that of the posterior. Minima that are linearized there overstate it,
    and so does what chains of larger structures need in addition, since they are too slow. It is
    infinite where they are, of structures too large to be refined, and of robots that nothing ties.
    """
    problem = ends.fit.problem
    annealed = ends.fit.annealed
    variance = ends.weight @ annealed.within + between_chains(annealed.mean, ends.weight)
    is_slow = hinged.mean() >= variance.mean()
    if is_slow or not ends.fit.is_refined or not _are_errors_independent(problem):
        return np.full(len(variance), np.inf)
    return np.where(problem.untied, np.inf, np.sqrt(np.maximum(variance, hinged)))


def _are_errors_independent(problem: Problem) -> bool:
    """Judge whether rows have the independent errors that chains take them to have.

    Errors of a walk, of a source, of chained orientations and of a bias are in many rows at once.
    Chains seldom find the second places of ranges between centers.
    """
    rows = problem.rows
    has_common_errors = bool(rows.is_walked.any()) or bool((rows.source >= 0).any())
    has_common_errors |= problem.is_chained or rows.odometry.bias > 0.0
    return not has_common_errors and not rows.is_central.any()


def _bounded(solution: Minimum, most_sd: Reals) -> Minimum:
    """Bound the standard deviations of a solution; motions that are small enough are linear."""
    bound = np.where(solution.is_held, np.maximum(most_sd, REFINEMENT.linear_sd), most_sd)
    return solution._replace(sd=np.minimum(solution.sd, bound))


def _solution(fit: Fit, minimum: Minimum, share: float, position: Reals, loose: Reals) -> Solution:
    """Describe a minimum with its share in the mixture, in the unit of the log.

    Args:
        fit: Chains.
        minimum: The minimum.
        share: Its weight [1].
        position: Its centers, those of disconnected robots as placed [R], shape (N, 3).
        loose: Variance of these [R^2], shape (N,).
    """
    unit = fit.log.dock_radius
    gap = fit.problem.residual(position[None], minimum.yaw[None])
    width = np.sqrt(fit.problem.variance + fit.annealed.sigma**2)
    return Solution(
        weight=float(share),
        chains=minimum.chains,
        chi_square=minimum.cost,
        residual=float(rms(gap)[0]) * unit,
        residual_sd=float(rms(gap / width)[0]),
        position=position * unit,
        sd=np.sqrt(minimum.sd**2 + minimum.aside + loose) * unit,
    )


def _listed(problem: Problem, outlier: Bools) -> Mapping[str, Any]:
    """List outliers (E,), by names of fields of an estimate."""
    rows = problem.rows.select(outlier)
    places = [problem.inconsistent.sensed_places, rows.sensed_places]
    contacts = np.unique(rows.sensed_contacts, axis=0)
    return {"outlier_contacts": contacts, "outlier_places": np.concatenate(places)}


def _traced(fit: Fit, position: Reals, yaw: Reals) -> Mapping[str, Any]:
    """Trace chains up to positions and yaws, by names of fields of an estimate."""
    annealed = fit.annealed
    problem = fit.problem
    unit = fit.log.dock_radius
    width = np.sqrt(problem.variance + annealed.sigma**2)
    trace = place_disconnected(annealed.trace[:-1], problem)[0]
    trace = np.concatenate([trace, position[None]])
    yaws = np.concatenate([annealed.yaw_trace[:-1], yaw[None]])
    # One configuration after the other: residuals of all at once take much memory.
    gaps = (problem.residual(*state) for state in zip(trace[:, None], yaws[:, None], strict=True))
    residual = np.concatenate([rms(gap) for gap in gaps])
    last = problem.residual(position[None], yaw[None])
    return {
        "iteration": annealed.iteration,
        "trace": trace * unit,
        "residual": residual * unit,
        "residual_sd": float(rms(last / width)[0]),
    }


def _minima(ends: Ends, inlier: Bools, open_sd: Reals) -> tuple[list[Minimum], Reals]:
    """Find the minimum of each solution, the likeliest first, and their weights."""
    if not ends.fit.is_refined:
        return [minimum(ends, ends.weight, inlier, open_sd)], np.ones(1)
    solution = np.where(ends.weight > 0.0, ends.solution, -1)
    groups = [np.flatnonzero(solution == n) for n in range(solution.max() + 1)]
    minima = [_least(ends, members, inlier, open_sd) for members in groups]
    # Where a mode is floppy, chains alone say how far a solution reaches.
    if _are_held(minima) and not ends.turns:
        parts = [
            _parted(ends, members, least.sd) for members, least in zip(groups, minima, strict=True)
        ]
        minima = [
            least if len(of_group) == 1 else _least(ends, np.array(part), inlier, open_sd)
            for of_group, least in zip(parts, minima, strict=True)
            for part in of_group
        ]
        groups = [np.array(part) for of_group in parts for part in of_group]
        minima += _mirrored(ends, minima, inlier, open_sd)
    share = np.ones(len(minima))
    share[: len(groups)] = [ends.weight[members].sum() for members in groups]
    return _weighed(minima, share)


def _are_held(minima: list[Minimum]) -> bool:
    """Whether measurements hold all robots at all minima."""
    return all(solution.is_held[1:].all() for solution in minima)


def _least(ends: Ends, members: Ints, inlier: Bools, open_sd: Reals) -> Minimum:
    """Find the minimum of the cost that some ends lead to."""
    weight = np.zeros(len(ends.weight))
    weight[members] = ends.weight[members] / ends.weight[members].sum()
    return minimum(ends, weight, inlier, open_sd)


def _parted(ends: Ends, members: Ints, sd: Reals) -> list[list[int]]:
    """Group the ends of one solution that agree to its sd, the best end of each group first."""
    order = members[np.argsort(ends.cost[members], kind="stable")]
    place = ends.position
    return grouped(order, lambda k, firsts: _agree(place[firsts], place[k], sd))


def _agree(position: Reals, reference: Reals, sd: Reals) -> Bools:
    """Find configurations (k, N, 3) that agree with another one to the sd of every robot, (k,)."""
    away = np.linalg.norm(position - reference, axis=2)
    return np.asarray((away <= np.maximum(sd, MIXTURE.image_nearest)).all(axis=1))


def _mirrored(ends: Ends, minima: list[Minimum], inlier: Bools, open_sd: Reals) -> list[Minimum]:
    """Find minima where no chain is: parts of others are mirrored, several at once if need be.

    Images of the least cost come first. Those of a new minimum are tried, too, unless its weight is
    too small to count.
    """
    fit = ends.fit
    best = minima[0]
    rows = fit.problem.rows.select(inlier).associated(best.configuration, best.yaw)
    further = (MIXTURE.tempered * fit.annealed.sigma) ** 2
    parts = PartImages(fit.log, rows, further, non_overlap=fit.params.cues.non_overlap)
    accepted = list(minima)
    tried_places = [solution.configuration for solution in minima]
    waiting: list[tuple[float, int, Reals, Minimum]] = []
    number = count()
    expanded = 0
    tried = 0
    while tried < MIXTURE.most_images:
        for solution in accepted[expanded:]:
            for position, excess in parts.of(solution.configuration, solution.yaw):
                # The number keeps arrays from being compared.
                heappush(waiting, (solution.cost + excess, next(number), position, solution))
        expanded = len(accepted)
        if not waiting:
            break
        *_, position, solution = heappop(waiting)
        if _agree(np.array(tried_places), position, best.sd).any():
            continue
        tried += 1
        end = ends.at(position, solution.yaw)
        if len(position) > MIXTURE.image_robots:
            # Of many robots, a search of all takes long.
            alone = _moved_alone(ends, solution, position)
            if _agree(np.array(tried_places), alone, best.sd).any():
                continue
        image_fit = _fitted(end, np.ones(1), inlier, open_sd)
        is_new = not _agree(np.array(tried_places), image_fit.state.position, best.sd).any()
        tried_places += [position, image_fit.state.position]
        if not is_new:
            continue
        image = _described(end, np.ones(1), open_sd, image_fit)
        least = max(solution.log_height for solution in accepted) + np.log(MIXTURE.least_weight)
        if image.log_height >= least and _are_held([image]):
            accepted.append(image._replace(chains=0))
    return accepted[len(minima) :]


def _moved_alone(ends: Ends, solution: Minimum, image: Reals) -> Reals:
    """Move the robots of an image (N, 3) to a minimum, all others as they are at a solution."""
    if solution.inlier_fit is None:
        return image
    rows = solution.inlier_fit.cost.rows.associated(image, solution.yaw)
    is_moved = (image != solution.configuration).any(axis=1)
    cost = _cost(ends, rows, MIXTURE.tepid * ends.fit.annealed.sigma, moves=is_moved)
    start = solution.inlier_fit.state._replace(position=image)
    return cost.refine(start, REFINEMENT.rounds)[0].position


def _weighed(minima: list[Minimum], share: Reals) -> tuple[list[Minimum], Reals]:
    """Weigh solutions, and sort those that count by descending weight.

    Where measurements hold all robots, weights are the likelihoods of the minima times their
    widths (Laplace). Elsewhere nothing but the chains says how wide a solution is; those whose cost
    exceeds the least one by more than chance explains do not count.
    """
    cost = np.array([solution.cost for solution in minima])
    chance = CONVERGENCE.chance_sd * chi_square_sd(len(minima[0].square))
    share = np.where(cost <= cost.min() + chance, share, 0.0)
    # Laplace's approximation needs a minimum that is curved along every coordinate.
    if _are_held(minima):
        minima, cost = _distinct(minima, cost)
        height = np.array([solution.log_height for solution in minima])
        share = np.exp(height - height.max())
    share = np.where(share < MIXTURE.least_weight * share.max(), 0.0, share / share.sum())
    order = np.argsort(-share, kind="stable")[: np.count_nonzero(share)]
    return [minima[n] for n in order], share[order] / share.sum()


def _distinct(minima: list[Minimum], cost: Reals) -> tuple[list[Minimum], Reals]:
    """Keep one of the minima that agree to the sd of every robot, the one of least cost."""

    def alike(candidate: int, firsts: list[int]) -> Bools:
        away = [
            np.linalg.norm(minima[candidate].position - minima[k].position, axis=1) for k in firsts
        ]
        least = [np.maximum(minima[k].sd, SETTLED) for k in firsts]
        return np.array([(a <= b).all() for a, b in zip(away, least, strict=True)], np.bool_)

    kept = [
        minima[group[0]]._replace(chains=sum(minima[n].chains for n in group))
        for group in grouped(np.argsort(cost, kind="stable"), alike)
    ]
    return kept, np.array([least.cost for least in kept])


def _outliers(ends: Ends) -> Bools:
    """Find measurements that every end in the mixture misses, and each of the best few, (E,).

    A single chain tears contacts that are right.
    """
    problem = ends.fit.problem
    order = np.argsort(np.argsort(ends.cost, kind="stable"))
    jury = (ends.weight > 0.0) | ((order < CONVERGENCE.jury) & np.isfinite(ends.cost))
    missed = (ends.missed[jury] > CONVERGENCE.outlier_sd**2).all(axis=0)
    return problem.rows.any_of_vector(missed & ~problem.known)


def _evidence(ends: Ends, outlier: Bools, is_guess: Bools, best: Minimum) -> Evidence:
    """Gather what chains and the likeliest solution say of an estimate."""
    problem = ends.fit.problem
    links = len(ends.fit.problem.variance)
    agreed = ends.cost <= (1.0 + MIXTURE.same) * ends.cost.min()
    chance = MIXTURE.least_cost_sd * chi_square_sd(len(problem.rows))
    is_least = ends.cost <= ends.cost.min() + chance
    is_missed = ends.missed[int(ends.cost.argmin()), :links] > CONVERGENCE.outlier_sd**2
    return Evidence(
        log=ends.fit.log,
        rows=problem.rows,
        outlier=outlier,
        is_guess=is_guess,
        torn=int((is_guess & ~problem.untied).sum()),
        chi_square=best.chi_square,
        inlier_fit=best.inlier_fit,
        unknowns=3 * (len(problem.part) - 1),
        freedom=best.freedom,
        chains=int((ends.weight > 0.0).sum()),
        all_failed=bool(ends.fit.has_failed.all()),
        is_alone=len(is_least) > 1 and int(is_least.sum()) == 1,
        is_single=len(agreed) > 1 and int(agreed.sum()) == 1,
        overlap=best.cost - best.chi_square,
        missed=int(is_missed[~outlier[:links]].sum()),
    )


def minimum(ends: Ends, weight: Reals, inlier: Bools, sd: Reals) -> Minimum:
    """Find the minimum of the cost of one solution, by generalized least squares.

    Args:
        ends: Minima that chains lead to.
        weight: Weights of the chains of this solution, which add up to 1, shape (K,).
        inlier: Measurements that count, shape (E,).
        sd: Standard deviation of positions by the chains [R], shape (N,).
    """
    return _described(ends, weight, sd, _fitted(ends, weight, inlier, sd))


def _fitted(ends: Ends, weight: Reals, inlier: Bools, sd: Reals) -> InlierFit:
    """Go to that minimum; arguments as for `minimum`."""
    problem = ends.fit.problem
    members = weight > 0.0
    best = int(np.where(members, ends.cost, np.inf).argmin())
    start = ends.position[best], ends.yaw[best]
    used = inlier.copy()
    used[problem.rows.touch] &= _agreed(problem.rows, ends.fit.annealed, members)
    rows = problem.rows.select(used).associated(*start)
    loose = _loose(ends, sd, start[0])
    prior = np.maximum(REFINEMENT.prior_sd * np.sqrt(len(sd)) * loose, REFINEMENT.least_prior)
    return InlierFit(used, *_refined(ends, rows, start, prior))


def _loose(ends: Ends, sd: Reals, position: Reals) -> Reals:
    """Widen the sd of chains (N,): they do not know errors that chained orientations share."""
    return np.hypot(sd, extent(position)) if ends.fit.problem.is_chained else sd


def _described(ends: Ends, weight: Reals, sd: Reals, fit: InlierFit) -> Minimum:
    """Describe a minimum; other arguments as for `minimum`."""
    problem = ends.fit.problem
    annealed = ends.fit.annealed
    members = weight > 0.0
    best = int(np.where(members, ends.cost, np.inf).argmin())
    state = fit.state
    linear = fit.linear
    free = None
    mean = state.position
    swept = np.zeros(sd.shape)
    if ends.turns:
        free = ends.turns.motions(mean)
        (mean, swept) = ends.turns.swept(mean)
    # The factors with which motions are counted, and those of draws, are not held at once.
    freedom = linear.freedom()
    draws = DRAWS if ends.fit.is_refined else FEW_DRAWS
    linear_sd = REFINEMENT.sd_scale * np.sqrt(linear.variance(free, draws))
    is_biased = 0.0 < problem.yaw_precision < REFINEMENT.most_yaw_bias**-2
    is_biased &= bool(annealed.within.any())  # only chains say better
    loose = _loose(ends, sd, ends.position[best])
    small = np.maximum(REFINEMENT.open_sd * loose, REFINEMENT.linear_sd)
    is_held = ((linear_sd <= small) | (swept > 0.0)) & ~problem.untied & (not is_biased)
    square = np.zeros(len(problem.rows))
    square[fit.inlier] = linear.square
    return Minimum(
        configuration=state.position,
        position=np.where(is_held[:, None], mean, np.tensordot(weight, annealed.mean, 1)),
        yaw=np.where(is_held, state.yaw, weight @ annealed.mean_yaw),
        sd=np.where(is_held, np.hypot(linear_sd, np.sqrt(swept)), sd),
        is_held=is_held,
        aside=((state.position - mean) ** 2).sum(axis=1),
        cost=linear.cost,
        chi_square=linear.chi_square,
        freedom=freedom,
        square=square,
        log_volume=linear.log_volume if ends.fit.is_refined else 0.0,
        chains=int(members.sum()),
        inlier_fit=fit if ends.fit.is_refined else None,
    )


def _refined(
    ends: Ends, rows: Measurements, start: tuple[Reals, Reals], prior: Reals
) -> tuple[WholeCost, State, Linear]:
    """Go to the minimum of the cost from positions [R] and yaws [rad], by Gauss-Newton steps.

    Args:
        ends: Minima that chains lead to.
        rows: Measurements that count.
        start: Positions and yaws, shapes (N, 3) and (N,).
        prior: Width of the prior of each position [R], shape (N,).

    Returns:
        The cost, the minimum and the linear problem there.
    """
    sd = MIXTURE.tepid * ends.fit.annealed.sigma
    cost = _cost(ends, rows, sd, nearby=ends.nearby[sd])
    held = cost.held(prior)
    first = cost.at(*start)
    is_long = walk_sd(rows) > REFINEMENT.long_walk_sd
    if not ends.fit.is_refined or not is_long.any():
        return cost, *held.refine(first, REFINEMENT.rounds)
    # Contacts seen over a long way are not linear in its turns, which begin at zero. So a search
    # comes near first, where contacts may be missed by as much as is linear.
    sd = REFINEMENT.linear_sd
    warm = _cost(ends, rows, sd, nearby=ends.nearby[sd]).held(prior)
    nearer, _ = warm.refine(first, REFINEMENT.warm_rounds)
    state, linear = held.refine(nearer, REFINEMENT.rounds)
    limit = chi_square_limit(max(len(rows) - 3 * len(prior), 1), CONVERGENCE.chance_sd)
    if is_long.mean() >= REFINEMENT.mostly_long and linear.cost <= limit:
        return cost, state, linear
    direct_state, direct_linear = held.refine(first, REFINEMENT.rounds)
    if direct_linear.cost <= linear.cost:
        return cost, direct_state, direct_linear
    return cost, state, linear


def _cost(ends: Ends, rows: Measurements, sd: float, **options: Any) -> WholeCost:  # noqa: ANN401
    """Return the cost of rows that may be missed by a further sd [R]; options as of `WholeCost`."""
    problem = ends.fit.problem
    return ends.fit.cost(
        rows,
        links=problem.connections,
        # A bias that is not solved for is in all stances of a robot.
        are_independent=problem.rows.odometry.bias > 0.0 or not ends.fit.is_refined,
        further_variance=sd**2,
        **options,
    )


def _agreed(rows: Measurements, annealed: Annealed, members: Bools) -> Bools:
    """Find touches whose docks are the same in some chains, shape (T,).

    The mean of chains that differ has neither docks at the right distance.
    """
    pair = rows.association(annealed.mean[members], annealed.mean_yaw[members])
    is_agreed: Bools = (pair == pair[0]).all(axis=0)
    return is_agreed


def deviation(
    problem: Problem,
    mean: Reals,
    within: Reals,
    weight: Reals,
    sigma: float,
) -> Reals:
    """Compute the standard deviation of the weighted mean of chains [R], shape (N,).

    Args:
        problem: Measurements of the structure.
        mean: Mean position of each chain [R], shape (chains, N, 3).
        within: Within-chain variance [R^2], shape (chains, N).
        weight: Weights of the chains, which add up to 1, shape (chains,).
        sigma: Square root of the temperature at which the chains ended [R].
    """
    fit = SD_CALIBRATION
    between = between_chains(mean, weight)
    # Displacements that a robot shares with all others: few chains show them, so they weigh more.
    total = mean[:, 1:].sum(axis=1, keepdims=True)
    other_mean = (total - mean) / max(mean.shape[1] - 2, 1)
    between += fit.shared * between_chains(other_mean, weight)
    square = weight @ within + between
    noise = _noise_share(problem.variance)
    thermal = fit.thermal_variance * (1.0 - noise) * sigma**2
    # Where little more is found than the temperature alone causes, it counts for little.
    square *= square / np.maximum(square + thermal, np.finfo(np.float64).tiny)
    power = fit.shared_noise_power * noise
    related = np.sqrt(square) ** (1.0 - power) * (fit.shared_noise_at * sigma) ** power
    sharp = (fit.sharp * (sigma / ANNEALING.warmest) ** fit.sharp_power) ** (1.0 - noise)
    lacking = 1.0 + fit.underdetermined * problem.underdetermination
    sd: Reals = related * sharp * lacking
    sd[0] = 0.0  # the position of the anchor is known
    return sd


def between_chains(mean: Reals, weight: Reals) -> Reals:
    """Compute the mean square error of the mean of chains that are draws like the truth, (N,).

    The mean of n draws is off by (n + 1) / n of their variance; the draws around it show
    (n - 1) / n of that. n is their effective number, 1 / sum of squared weights. Of less than two,
    all chains together show how much they differ.
    """
    chains = 1.0 / (weight**2).sum()
    if chains < _LEAST_CHAINS:
        weight = np.full(len(mean), 1.0 / len(mean))
        chains = float(len(mean))
    square = moments(weight, mean)[1]
    return square * ((chains + 1.0) / (chains - 1.0) if chains > 1.0 else 1.0)


def _noise_share(variance: Reals) -> float:
    """Share of the contacts' variance that is noise, not temperature; 1 without contacts."""
    if not len(variance):
        return 1.0
    return float(np.mean(variance / (variance + ANNEALING.warmest**2)))
