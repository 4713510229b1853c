"""Whether to trust an estimate: was a minimum found, and does noise explain what it misses?

Methods that minimize something else than the chi-square of their measurements are judged by it all
the same. The search for its least value begins at the estimate. The true positions would exceed
that value by a chi-square with one degree of freedom for each coordinate that measurements
determine; an estimate that exceeds it by more did not converge. Lengths in R.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.localization.chains.problem import Problem, pose_problem
from tiswarm.localization.cost.cost import SETTLED, Cost
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.localization.mixture.settings import CONVERGENCE, MIXTURE
from tiswarm.localization.settings import LARGE, SWITCHES, ChiSquareParams
from tiswarm.measurements.consistency import are_known
from tiswarm.measurements.model import Measurements
from tiswarm.records.estimate import MOST_MISFIT_SD, MOST_WITHIN, Convergence
from tiswarm.records.sensing_log import SensingLog

_ROUNDS = 8
"""Steps toward the minimum."""

_STAYS = 1e-6
"""Width of the prior that leaves robots where they are [R]."""

_CLEARANCE = 1e4
"""Distance between robots that are guesses, so that their docks meet no others [R]."""

_NINE_OF_TEN = 0.9
"""Share of robots that should be within `MOST_WITHIN` sd [1]."""


class Assessment(NamedTuple):
    """What the measurements say of an estimate of N robots; fields of `Estimate`."""

    convergence: Convergence
    misfit: Reals | None
    outlier_contacts: Ints | None
    outlier_places: Ints | None


class _NearestMinimum(NamedTuple):
    """The least chi-square near an estimate."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    excess: float
    """Robust chi-square of the estimate beyond that of the minimum [1]."""

    outlier: Bools
    """Measurements that the minimum misses, shape (E,)."""

    chi_square: float
    """Least chi-square of all others [1]."""

    freedom: int
    """Its degrees of freedom."""

    square: Reals
    """Part of it that each measurement carries [1], shape (E,)."""


def assess(
    log: SensingLog,
    cues: Collection[str],
    position: Reals,
    *,
    is_guess: Bools,
    sd: Reals | None = None,
    yaw: Reals | None = None,
) -> Assessment:
    """Judge an estimate by the chi-square of its measurements.

    Args:
        log: What was sensed.
        cues: Cues in use.
        position: Estimated centers [R], shape (N, 3).
        is_guess: Robots whose measurements do not count, shape (N,).
        sd: Standard deviation that the method states [R], shape (N,); None where it has none.
        yaw: Yaw corrections [rad], shape (N,); zero if None. What the log states of a bias of yaw
            is solved for, whether or not the method does, up to `LARGE` robots.

    Returns:
        The verdicts. The search converged if noise, or `sd`, explains how far the estimate is from
        the minimum. Beyond `LARGE` robots the estimate itself is taken for it. Outliers are None
        unless noise explains that, and all other measurements.
    """
    chosen = {cue: cue in cues for cue in SWITCHES}
    is_large = log.robot_count > LARGE
    solve_yaw = yaw is not None or not is_large
    problem = pose_problem(log, ChiSquareParams(**chosen, solve_yaw=solve_yaw))
    counts = ~is_guess[problem.rows.robot]
    counts[: len(problem.rows.other)] &= ~is_guess[problem.rows.other]
    rows = problem.rows.select(counts)
    unknowns = 3 * int((~is_guess[1:]).sum())
    state = position, np.zeros(log.robot_count) if yaw is None else yaw
    if is_large:
        found = _itself(rows, state, unknowns)
    else:
        found = _minimum(log, chosen, problem, rows, state, is_guess)
    # Near 0 degrees of freedom, what the search leaves would look like a misfit.
    freedom = max(found.freedom, int(MIXTURE.spare * unknowns), 1)
    misfit_sd = float((found.chi_square - freedom) / np.sqrt(2.0 * freedom))
    is_consistent = misfit_sd <= MOST_MISFIT_SD
    chance = unknowns + CONVERGENCE.chance_sd * np.sqrt(2.0 * unknowns)
    is_near = found.excess <= chance
    links = len(rows.other)
    torn = int(found.outlier[:links].sum())
    reasons = {
        "all positions are guesses": is_guess[1:].any() and not unknowns,
        f"{torn} of {links} contacts and ranges are outliers": (
            torn > CONVERGENCE.most_outliers * links
        ),
        "positions nearby fit the measurements better: "
        f"their chi-square is {found.excess:.3g} less, and noise explains {chance:.3g}": not is_near
        and not _is_within(found.position - position, sd, is_guess),
        f"of more than {LARGE} robots only the estimate itself is judged, and noise does not "
        "explain its chi-square": is_large and not is_consistent,
    }
    reason = next((text for text, applies in reasons.items() if applies), "")
    factor = 1.0
    if not is_consistent and sd is not None:
        factor = float(np.sqrt(found.chi_square / freedom))
    verdicts = Convergence(
        converged=not reason,
        consistent=is_consistent,
        testable=not is_consistent or is_large or found.freedom == freedom,
        spare=None if is_large else found.freedom,
        misfit_sd=misfit_sd,
        sd_factor=factor,
        reason=reason or ("" if is_consistent else "noise as stated does not explain all rows"),
        chains=1,
        restarted=0,
    )
    misfit = misfit_by_robot(rows, found.square)
    if not (verdicts.trusted and is_near):
        return Assessment(verdicts, misfit, None, None)
    outliers = rows.select(found.outlier)
    places = np.concatenate([problem.inconsistent.sensed_places, outliers.sensed_places])
    return Assessment(verdicts, misfit, np.unique(outliers.sensed_contacts, axis=0), places)


def _itself(rows: Measurements, estimate: tuple[Reals, Reals], unknowns: int) -> _NearestMinimum:
    """Take an estimate for the minimum."""
    variance = rows.variance()
    square = rows.residual(*estimate) ** 2 / variance
    outlier = (square > CONVERGENCE.outlier_sd**2) & ~are_known(variance, len(rows.other))
    square[outlier] = 0.0
    freedom = int((~outlier).sum()) - unknowns
    return _NearestMinimum(estimate[0], 0.0, outlier, float(square.sum()), freedom, square)


def _minimum(
    log: SensingLog,
    chosen: dict[str, bool],
    problem: Problem,
    rows: Measurements,
    estimate: tuple[Reals, Reals],
    is_guess: Bools,
) -> _NearestMinimum:
    """Search for the least chi-square from an estimate on: first robust, then without outliers."""

    def cost(rows: Measurements, robust_sd: float | None) -> Cost:
        return Cost(
            log, rows, yaw_precision=problem.yaw_precision, links=problem.connections,
            robust_sd=robust_sd, non_overlap=chosen["non_overlap"],
        )  # fmt: skip

    aside = np.cumsum(is_guess)[:, None] * np.array([_CLEARANCE, 0.0, 0.0])
    start = estimate[0] + is_guess[:, None] * aside, estimate[1]
    robust = cost(rows, ROBUST_SD)
    # The cost of the estimate itself: turns and yaws adapt to it, and positions stay.
    _, own = robust.refine(start, _ROUNDS, np.full(log.robot_count, _STAYS))
    state, least = robust.refine(start, _ROUNDS)
    variance = rows.variance()
    missed = rows.residual(state.position, state.yaw) ** 2 / variance
    outlier = (missed > CONVERGENCE.outlier_sd**2) & ~are_known(variance, len(rows.other))
    _, linear = cost(rows.select(~outlier), None).refine((state.position, state.yaw), _ROUNDS)
    square = np.zeros(len(rows))
    square[~outlier] = linear.square
    excess = own.chi_square - least.chi_square
    moved = np.where(is_guess[:, None], estimate[0], state.position)
    return _NearestMinimum(moved, excess, outlier, linear.chi_square, linear.freedom(), square)


def _is_within(away: Reals, sd: Reals | None, is_guess: Bools) -> bool:
    """Judge whether nine of ten robots are within `MOST_WITHIN` sd of the minimum, and all near it.

    The sd of others excuses no robot that is farther off than `CONVERGENCE.outlier_sd` of its own.
    """
    if sd is None:
        return False
    counts = ~is_guess[1:]
    off, allowed = np.linalg.norm(away, axis=1)[1:][counts], sd[1:][counts]
    is_near = off <= MOST_WITHIN * allowed
    return bool(
        is_near.mean() >= _NINE_OF_TEN
        and (off <= np.maximum(CONVERGENCE.outlier_sd * allowed, SETTLED)).all()
    )


def misfit_by_robot(rows: Measurements, square: Reals) -> Reals:
    """Sum parts of a chi-square (E,) by robot, half of those of a pair for each, shape (N,)."""
    pair = 0.5 * square[: len(rows.other)]
    misfit = np.zeros(rows.robots)
    np.add.at(misfit, rows.robot, np.concatenate([pair, square[len(pair) :]]))
    np.add.at(misfit, rows.other, pair)
    return misfit


def rms(values: Reals) -> Reals:
    """Root mean square along the last axis, 0 where there are no values."""
    mean: Reals = np.sqrt((values**2).sum(axis=-1) / max(values.shape[-1], 1))
    return mean
