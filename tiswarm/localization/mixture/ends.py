"""Minima of the cost that chains lead to: ranked, weighed, sorted into solutions.

A chain failed if it put a robot farther away than its contacts reach, or if its kinetic temperature
ran away. Lengths in R.
"""

from dataclasses import dataclass, replace

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.localization.chains.annealed import Annealed
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.chains.settings import ANNEALING
from tiswarm.localization.cost.cost import Cost
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.localization.mixture.frames import HELD, Frame, align, free_frame
from tiswarm.localization.mixture.settings import CONVERGENCE, MIXTURE
from tiswarm.localization.mixture.starts import scaled_distances
from tiswarm.localization.settings import ChiSquareParams
from tiswarm.measurements.model import SPACING
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

    frame: Frame = HELD
    """Rigid motions of the anchor's part that nothing resists, by which ends are aligned."""


def failed(problem: Problem, annealed: Annealed) -> Bools:
    """Find chains that no noise of the measurements explains, shape (chains,)."""
    missed = squares(problem, annealed)[:, : len(problem.variance)]
    # A wrong contact bounds no distance; most chains tear it.
    torn = (missed > CONVERGENCE.outlier_sd**2).mean(axis=0) >= CONVERGENCE.most_chains
    torn = problem.any_of_link(torn)[problem.link]
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


def ranked(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    annealed: Annealed,
    has_failed: Bools,
) -> Ends:
    """Move each chain to a minimum of the cost, and weigh it.

    The cost is that at `MIXTURE.tempered` times the temperature of the chains: they end
    where it lets measurements be missed.
    """
    position, yaw = annealed.last.copy(), annealed.last_yaw.copy()
    cost = np.full(len(position), np.inf)
    rounds = MIXTURE.rounds if params.refines(log.robot_count) else 0
    # Where every chain failed, the least bad one has to do; the verdict says so.
    for k in np.flatnonzero(has_failed.all() | ~has_failed).tolist():
        position[k], yaw[k], cost[k] = _descended(
            log, params, problem, (position[k], yaw[k]), annealed.sigma, rounds
        )
    return _ends(problem, position, yaw, cost, annealed.sigma)


def _descended(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    start: tuple[Reals, Reals],
    sigma: float,
    rounds: int,
) -> tuple[Reals, Reals, float]:
    """Move a configuration to a minimum of the cost nearby: positions, yaw, and the cost."""
    # Many ends are compared: independent errors are quicker, and do for a ranking.
    cost = Cost(
        log,
        problem.rows.associated(*start),
        yaw_precision=problem.yaw_precision,
        robust_sd=ROBUST_SD if params.robust else None,
        non_overlap=params.non_overlap,
        are_independent=True,
        further_variance=(MIXTURE.tempered * sigma) ** 2,
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


def with_further(
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
    rounds = MIXTURE.warm_rounds
    found = [
        _descended(log, params, problem, (position, ends.yaw[0]), annealed.sigma, rounds)
        for position in further
    ]
    position, yaw = (np.array([each[k] for each in found]) for k in (0, 1))
    annealed = annealed.joined(annealed.still(position, yaw))
    return annealed, _ends(
        problem,
        np.concatenate([ends.position, position]),
        np.concatenate([ends.yaw, yaw]),
        np.concatenate([ends.cost, [cost for _, _, cost in found]]),
        annealed.sigma,
    )


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
    warm = MIXTURE.unfolding * float(np.median(length)) if len(length) else sigma
    start = position, np.zeros(len(position))
    position, yaw, _ = _descended(log, params, problem, start, warm, MIXTURE.warm_rounds)
    return _descended(log, params, problem, (position, yaw), sigma, rounds)


def further_starts(log: SensingLog, params: ChiSquareParams, problem: Problem) -> list[Reals]:
    """Find where measured distances fit as a whole, by ascending cost [R], (N, 3) each.

    None where contacts alone tie robots, or for structures too large to be refined. Of two mirror
    images, one that measurements exclude is left out.
    """
    if not params.refines(log.robot_count):
        return []
    anchor, rounds = log.anchor_position / log.dock_radius, MIXTURE.warm_rounds
    found = []
    for start in scaled_distances(problem, anchor):
        position, _, cost = settled(log, params, problem, start, ANNEALING.warmest, rounds)
        found.append((cost, position))
    # By the cost alone: of equal costs, arrays would be compared, which fails.
    found.sort(key=lambda pair: pair[0])
    chance = CONVERGENCE.chance_sd * np.sqrt(2.0 * len(problem.rows))
    return [position for cost, position in found if cost <= found[0][0] + chance]


def aligned(problem: Problem, annealed: Annealed, ends: Ends) -> tuple[Annealed, Ends]:
    """Move all ends by rigid motions that nothing resists to where the best one is."""
    best = ends.position[int(ends.cost.argmin())]
    moves = problem.part == problem.part[0]
    frame = free_frame(problem.rows, best, moves)
    if not frame.names:
        return annealed, ends
    turn = align(ends.position, best, frame, moves)

    def turned(position: Reals) -> Reals:
        about = position[:, :1]
        return np.where(moves[:, None], about + (position - about) @ turn, position)

    position = turned(ends.position)
    solution = _solutions(position, ends.weight)
    aligned = replace(annealed, mean=turned(annealed.mean), last=turned(annealed.last))
    return aligned, replace(ends, position=position, solution=solution, frame=frame)


def _weights(cost: Reals, measurements: int) -> Reals:
    """Weigh ends by their least costs, shape (K,).

    A chain makes mistakes of its own in many parts of a structure. So
    up to the width of the chi-square, its cost says little about the whole: costs are divided by
    what leaves `MIXTURE.fewest` ends in the mixture, where that is in reach.
    """
    excess = cost - cost.min()
    hottest = max(1.0, np.sqrt(2.0 * measurements) / MIXTURE.chance)
    for heat in np.geomspace(1.0, hottest, MIXTURE.heats):
        weight = np.exp(-0.5 * excess / heat)
        weight /= weight.sum()
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
    number = np.full(len(position), -1)
    firsts: list[int] = []
    # The weightiest first, so that each solution is named by its best end.
    for k in np.argsort(-weight, kind="stable").tolist():
        for solution, first in enumerate(firsts):
            if np.linalg.norm(position[k] - position[first], axis=1).max() <= SPACING:
                number[k] = solution
                break
        else:
            number[k] = len(firsts)
            firsts.append(k)
    total = np.bincount(number, weight)
    rank: Ints = np.argsort(np.argsort(-total, kind="stable"), kind="stable")
    of_end: Ints = rank[number]
    return of_end
