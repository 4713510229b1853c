"""Minima of the cost that chains lead to: ranked, weighed, sorted into solutions.

A chain failed if it put a robot farther away than its contacts reach, or if its kinetic temperature
ran away. Lengths in R.
"""

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.chi_square import chi_square_sd
from tiswarm.compute.normal_equations import Nearby
from tiswarm.localization.chains.annealer import Annealed
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import WholeCost, boltzmann_weights, grouped
from tiswarm.localization.mixture import CONVERGENCE, MIXTURE
from tiswarm.localization.mixture.frames import scaled_distances
from tiswarm.localization.settings import ChiSquareParams
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.measurements.turns import Turns
from tiswarm.records.sensing_log import SensingLog


@dataclass(frozen=True)
class Posed:
    """A log of N robots, the settings of a method, and the rows that they choose."""

    log: SensingLog
    params: ChiSquareParams
    problem: Problem

    @property
    def is_refined(self) -> bool:
        """Whether estimates of so many robots are moved to a minimum."""
        return self.params.refines(self.log.robot_count)

    def cost(self, rows: Measurements, *, non_overlap: bool = True, **options: Any) -> WholeCost:  # noqa: ANN401
        """Return the cost of some of its rows; further options as for `WholeCost`."""
        return WholeCost(
            self.log,
            rows,
            yaw_precision=self.problem.yaw_precision,
            non_overlap=non_overlap and self.params.cues.non_overlap,
            **{"moves": self.problem.moves, **options},
        )


@dataclass(frozen=True)
class Fit(Posed):
    """A log of N robots, the rows that a method chooses, and K chains that were fitted to them."""

    annealed: Annealed

    has_failed: Bools
    """Chains that no noise of the measurements explains, as many as were annealed."""

    @classmethod
    def of(cls, posed: Posed, annealed: Annealed) -> "Fit":
        """Find which chains failed."""
        is_failed = failed(posed.problem, annealed)
        return cls(posed.log, posed.params, posed.problem, annealed, is_failed)


@dataclass(frozen=True, kw_only=True)
class Ends:
    """Minima that K chains lead to."""

    fit: Fit
    """The chains."""

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

    turns: Turns = field(default_factory=Turns)
    """Rigid motions that nothing resists, by which ends are aligned."""

    nearby: dict[float, Nearby] = field(default_factory=partial(defaultdict, Nearby))
    """Factors of costs of solutions, by the standard deviation by which rows may be missed [R]."""

    def at(self, position: Reals, yaw: Reals) -> "Ends":
        """Return one end at a configuration, (N, 3) and (N,), in place of all."""
        chain = self.fit.annealed.still(position[None], yaw[None])
        one = np.ones(1)
        fit = replace(self.fit, annealed=chain)
        place = (chain.last, chain.last_yaw)
        return replace(self, fit=fit, position=place[0], yaw=place[1], cost=0.0 * one, weight=one)


def failed(problem: Problem, annealed: Annealed) -> Bools:
    """Find chains that no noise of the measurements explains, shape (chains,)."""
    missed = squares(problem, annealed)[:, : len(problem.variance)]
    # A wrong contact bounds no distance; most chains tear it.
    torn = (missed > CONVERGENCE.outlier_sd**2).mean(axis=0) >= CONVERGENCE.most_chains
    torn = problem.by_link(torn.astype(np.float64)) > 0.0
    # Nothing measures how far a part without the anchor is away: count from its own first robot.
    first = np.unique(problem.part, return_index=True)[1][problem.part]
    distance = np.linalg.norm(annealed.last - annealed.last[:, first], axis=2)
    beyond = (distance > problem.reach(annealed.sigma, ~torn)).any(axis=1)
    is_failed: Bools = beyond | (annealed.temperature > CONVERGENCE.runaway)
    return is_failed


def squares(problem: Problem, annealed: Annealed) -> Reals:
    """Compute the squared residuals of each chain at its end, in variances.

    The variance is that of the measurement and of the temperature together.

    Returns:
        Squares, shape (chains, E).
    """
    residual = problem.rows.residual(annealed.last, annealed.last_yaw)
    square: Reals = residual**2 / (problem.rows.variance() + annealed.sigma**2)
    return square


def ranked(fit: Fit) -> Ends:
    """Move each chain to a minimum of the cost, and weigh it.

    The cost is that at `MIXTURE.tempered` times the temperature of the chains: they end
    where it lets measurements be missed. Of many robots ends stay where they are.
    """
    annealed = fit.annealed
    position = annealed.last.copy()
    yaw = annealed.last_yaw.copy()
    cost = np.full(len(position), np.inf)
    rounds = MIXTURE.rounds if fit.is_refined else 0
    # Where every chain failed, the least bad one has to do; the verdict says so.
    for k in np.flatnonzero(fit.has_failed.all() | ~fit.has_failed).tolist():
        start = position[k], yaw[k]
        position[k], yaw[k], cost[k] = descended(fit, start, annealed.sigma, rounds)
    return ends_of(fit, position, yaw, cost)


def descended(
    posed: Posed, start: tuple[Reals, Reals], sigma: float, rounds: int
) -> tuple[Reals, Reals, float]:
    """Move a configuration to a minimum of the cost nearby: positions, yaw, and the cost."""
    # Many ends are compared: independent errors are quicker, and do for a ranking.
    cost = posed.cost(
        posed.problem.rows.associated(*start),
        robust_sd=ROBUST_SD if posed.params.robust else None,
        are_independent=True,
        further_variance=(MIXTURE.tempered * sigma) ** 2,
    )
    state, linear = cost.refine(cost.at(*start), rounds)
    return state.position, state.yaw, linear.cost


def ends_of(fit: Fit, position: Reals, yaw: Reals, cost: Reals) -> Ends:
    """Weigh ends, and sort them into solutions."""
    rows = fit.problem.rows
    weight = _weights(cost, len(rows))
    return Ends(
        fit=fit,
        position=position,
        yaw=yaw,
        cost=cost,
        missed=rows.residual(position, yaw) ** 2 / (rows.variance() + fit.annealed.sigma**2),
        weight=weight,
        solution=_solutions(position, weight),
    )


def settled(posed: Posed, position: Reals, sigma: float, rounds: int) -> tuple[Reals, Reals, float]:
    """Move positions that no chain led to: first warm, then to a minimum as `descended` does."""
    length = posed.problem.length[~posed.problem.is_offset]
    warm = MIXTURE.unfolding * float(np.median(length)) if len(length) else sigma
    start = position, np.zeros(len(position))
    position, yaw, _ = descended(posed, start, warm, MIXTURE.warm_rounds)
    return descended(posed, (position, yaw), sigma, rounds)


def further_starts(posed: Posed) -> list[Reals]:
    """Find where measured distances fit as a whole, by ascending cost [R], (N, 3) each.

    None where contacts alone tie robots, or for structures too large to be refined. Of two mirror
    images, one that measurements exclude is left out.
    """
    if not posed.is_refined:
        return []
    anchor = posed.log.anchor_position / posed.log.dock_radius
    rounds = MIXTURE.warm_rounds
    minima = []
    for start in scaled_distances(posed.problem, anchor):
        position, _, cost = settled(posed, start, ANNEALING.warmest, rounds)
        minima.append((cost, position))
    # By the cost alone: of equal costs, arrays would be compared, which fails.
    minima.sort(key=lambda pair: pair[0])
    chance = CONVERGENCE.chance_sd * chi_square_sd(len(posed.problem.rows))
    return [position for cost, position in minima if cost <= minima[0][0] + chance]


def aligned(ends: Ends) -> Ends:
    """Move all ends by rigid motions that nothing resists to where the best one is."""
    problem = ends.fit.problem
    annealed = ends.fit.annealed
    least = int(ends.cost.argmin())
    is_missed = ends.missed[least] > CONVERGENCE.outlier_sd**2
    rows = problem.rows.select(~problem.rows.any_of_vector(is_missed))
    if not rows.is_central.any():
        return ends
    turns = Turns.of(rows, ends.position[least])
    if not turns:
        return ends
    position, mean, last = turns.aligned(ends.position, annealed.mean, annealed.last, to=least)
    return replace(
        ends,
        fit=replace(ends.fit, annealed=replace(annealed, mean=mean, last=last)),
        position=position,
        solution=_solutions(position, ends.weight),
        turns=turns,
    )


def _weights(cost: Reals, measurements: int) -> Reals:
    """Weigh ends by their least costs, shape (K,).

    A chain makes mistakes of its own in many parts of a structure, however the rest is. So up to
    the width of the chi-square, its cost says little about the whole: costs are divided by what
    leaves `MIXTURE.fewest` ends in the mixture, where that is in reach.
    """
    hottest = max(1.0, chi_square_sd(measurements) / MIXTURE.chance)
    for heat in np.geomspace(1.0, hottest, MIXTURE.heats):
        weight = boltzmann_weights(cost, heat)
        if 1.0 / (weight**2).sum() >= MIXTURE.fewest:
            break
    weight[weight < MIXTURE.least_weight] = 0.0
    scaled: Reals = weight / weight.sum()
    return scaled


def _solutions(position: Reals, weight: Reals) -> Ints:
    """Number the solutions of ends, shape (K,): those that agree to a dock's width at all robots.

    Beyond that distance robots could have changed places. An end belongs to the weightiest one that
    it agrees with.
    """

    def alike(k: int, firsts: list[int]) -> Bools:
        apart = np.linalg.norm(position[firsts] - position[k], axis=2)
        return np.asarray(apart.max(axis=1) <= SPACING)

    number = np.empty(len(position), np.int64)
    # The weightiest first, so that each solution is named by its best end.
    for solution, members in enumerate(grouped(np.argsort(-weight, kind="stable"), alike)):
        number[members] = solution
    total = np.bincount(number, weight)
    rank: Ints = np.argsort(np.argsort(-total, kind="stable"), kind="stable")
    of_end: Ints = rank[number]
    return of_end
