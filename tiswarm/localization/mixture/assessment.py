"""Estimates of methods that minimize something else than the chi-square of their measurements.

They are judged by it all the same. The search for its least value begins at the estimate. The true
positions would exceed that value by a chi-square with one degree of freedom for each coordinate
that measurements determine; an estimate that exceeds it by more did not converge. Lengths in R.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.compute.normal_equations import Nearby
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import place_disconnected
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import SETTLED, WholeCost
from tiswarm.localization.mixture import CONVERGENCE
from tiswarm.localization.mixture.ends import Posed
from tiswarm.localization.mixture.verdict import (
    Evidence,
    InlierFit,
    extent,
    judge,
    misfit_by_robot,
    widened,
)
from tiswarm.localization.settings import LARGE, SWITCHES, ChiSquareParams, Cues
from tiswarm.measurements.model import Measurements, are_known
from tiswarm.measurements.turns import Turns
from tiswarm.records.estimate import MOST_WITHIN, Convergence
from tiswarm.records.sensing_log import SensingLog

_ROUNDS = 8
"""Steps toward the minimum."""

_ASIDE = 0.05
"""Random errors that move an estimate aside, in the median distance [1]."""

_TURNED = 15
"""Rounds in which an estimate that was moved aside moves to a minimum [1]."""

_STAYS = 1e-6
"""Width of the prior that leaves robots where they are [R]."""

_CLEARANCE = 1e4
"""Distance between robots that are guesses, so that their docks meet no others [R]."""

_NOTICED = 1.25
"""Ratio of what measurements leave open to the sd that a method states, from which on it counts
[1]: it is computed from draws, and methods have priors."""

_NINE_OF_TEN = 0.9
"""Share of robots that should be within `MOST_WITHIN` sd [1]."""


class Assessment(NamedTuple):
    """What the measurements say of an estimate of N robots; fields of `Estimate`."""

    convergence: Convergence
    misfit: Reals | None
    outlier_contacts: Ints | None
    outlier_places: Ints | None

    torn: Bools
    """Robots that outliers alone tie to the world, shape (N,); no field of its own."""

    sd: Reals | None
    """Standard deviation that the method states, where measurements determine as much; more where
    they leave more open [R], shape (N,)."""

    motions: dict[str, Any]
    """Rigid motions that change no measurement: fields of `Estimate`."""

    def fields(self, untied: Bools, unit: float) -> dict[str, Any]:
        """List fields of an `Estimate` by name.

        Args:
            untied: Robots that no measurement ties to the world, shape (N,).
            unit: R, in the unit of the log.
        """
        values = self._asdict() | {"disconnected": untied | self.torn} | self.motions
        del values["torn"], values["motions"]
        return values | {"sd": None if self.sd is None else self.sd * unit}

    def doubted(self, reason: str) -> "Assessment":
        """Take a method's own doubts of its search; whether noise explains rows stands."""
        verdict = replace(self.convergence, converged=False, reason=reason)
        return self._replace(convergence=verdict, outlier_contacts=None, outlier_places=None)


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

    overlap: float
    """Squared overlaps of docks there, in variances [1]."""

    square: Reals
    """Part of it that each measurement carries [1], shape (E,)."""

    fit: InlierFit | None = None
    """The minimum of the cost of all others; None of more than `LARGE` robots."""


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
    is_large = log.robot_count > LARGE
    posed = _posed(log, cues, solve_yaw=yaw is not None or not is_large)
    problem = posed.problem
    counts = ~is_guess[problem.rows.robot]
    counts[: len(problem.rows.neighbor)] &= ~is_guess[problem.rows.neighbor]
    rows = problem.rows.select(counts)
    state = position, np.zeros(log.robot_count) if yaw is None else yaw
    unknowns = 3 * int((~is_guess[1:]).sum())
    nearest = _itself(rows, state, unknowns) if is_large else _minimum(posed, rows, state, is_guess)
    missed = np.zeros(len(problem.rows), np.bool_)
    missed[counts] = nearest.outlier
    tied = problem.without(missed)
    torn = tied.untied & ~problem.untied
    evidence = Evidence(
        log=log,
        rows=rows,
        outlier=nearest.outlier,
        is_guess=is_guess | torn,
        torn=int(torn.sum()),
        chi_square=nearest.chi_square,
        inlier_fit=nearest.fit,
        unknowns=unknowns,
        freedom=nearest.freedom,
        is_counted=not is_large,
        has_sd=sd is not None,
        overlap=nearest.overlap,
        excess=nearest.excess,
        is_within=_is_within(nearest.position - position, sd, is_guess | torn),
        is_unsearched=is_large,
    )
    verdicts = judge(evidence)
    # What another minimum misses is no outlier of the estimate. Without sd, nothing is claimed.
    if sd is None or (evidence.excess > evidence.chance and not evidence.is_within):
        tied = problem
        torn = np.zeros_like(torn)
    motions: dict[str, Any] = {}
    if sd is not None:
        placed, loose = place_disconnected(position[None], tied)
        loose += ((placed - position) ** 2).sum(axis=2)
        square = widened(sd, verdicts.sd_factor, position) ** 2
        if not is_large:
            open_square = _left_open(posed, state, nearest.position, ~missed)
            square = np.where(open_square > _NOTICED**2 * square, open_square, square)
            of_turns, motions = _opened(log, problem.rows.select(~missed), position)
            wide = widened(of_turns, verdicts.sd_factor, position)
            square = np.where(of_turns > 0.0, wide**2, square)
        sd = np.sqrt(square + np.where(torn, loose[0], 0.0))
    misfit = misfit_by_robot(rows, nearest.square)
    if not (verdicts.trusted and evidence.excess <= evidence.chance):
        return Assessment(verdicts, misfit, None, None, torn, sd, motions)
    outliers = rows.select(nearest.outlier)
    places = np.concatenate([problem.inconsistent.sensed_places, outliers.sensed_places])
    contacts = np.unique(outliers.sensed_contacts, axis=0)
    return Assessment(verdicts, misfit, contacts, places, torn, sd, motions)


def expected_square(log: SensingLog, cues: Collection[str], position: Reals) -> float:
    """Compute the expected mean square error of an estimate near some positions.

    It is that of a search that ends there: of solutions that are mirrored, at the right one.

    Args:
        log: What was sensed.
        cues: Cues in use.
        position: Centers at which measurements are linearized [R], shape (N, 3).

    Returns:
        Mean over the robots that stay [R^2].
    """
    posed = _posed(log, cues, solve_yaw=True)
    every = np.ones(len(posed.problem.rows), np.bool_)
    # Where nothing ties a robot to the world, it may be anywhere within the swarm's extent.
    square = np.where(
        posed.problem.untied,
        extent(position) ** 2,
        open_variance(posed, (position, np.zeros(log.robot_count)), every),
    )
    return float(square[~log.is_gone].mean())


def _posed(log: SensingLog, cues: Collection[str], *, solve_yaw: bool) -> Posed:
    """Gather the measurements of some cues."""
    chosen = Cues(**{cue: cue in cues for cue in SWITCHES})
    params = ChiSquareParams(cues=chosen, solve_yaw=solve_yaw)
    return Posed(log, params, pose_problem(log, params))


def _left_open(posed: Posed, estimate: tuple[Reals, Reals], near: Reals, inlier: Bools) -> Reals:
    """Compute how far off robots may be by what measurements leave open [R^2], shape (N,).

    The minimum of the cost, which begins `near` (N, 3), is the mean of what is likely: the mean
    square distance from an estimate is the variance there, and the square of how far it is away.
    """
    position, yaw = estimate
    rows = posed.problem.rows.select(inlier).averaged().associated(position, yaw)
    cost = posed.cost(rows, non_overlap=False, links=posed.problem.connections, robust_sd=ROBUST_SD)
    minimum = cost.refine(cost.at(near, yaw), _ROUNDS)[0].position
    away: Reals = np.where(posed.problem.untied, 0.0, ((minimum - position) ** 2).sum(axis=1))
    return open_variance(posed, (minimum, yaw), inlier) + away


def open_variance(posed: Posed, state: tuple[Reals, Reals], inlier: Bools) -> Reals:
    """Compute the variance of positions near a minimum, bounded where nothing determines them.

    Robots in contact are joined by hinges, and no robot is farther away than the others are.

    Args:
        posed: A log and its E measurements.
        state: Positions [R], shape (N, 3), and yaw corrections [rad], shape (N,).
        inlier: Measurements that count, shape (E,).

    Returns:
        Variances [R^2], shape (N,); 0 of robots that no measurement ties to the world.
    """
    problem = posed.problem
    hinged = np.unique(problem.pair[problem.is_final & inlier[problem.link]], axis=0)
    rows = problem.rows.select(inlier).averaged().associated(*state)
    cost = posed.cost(rows, non_overlap=False, links=problem.connections, hinged=hinged)
    square = cost.open_variance(*state)
    return np.where(problem.untied, 0.0, np.minimum(square, extent(state[0]) ** 2))


def _itself(rows: Measurements, estimate: tuple[Reals, Reals], unknowns: int) -> _NearestMinimum:
    """Take an estimate for the minimum."""
    variance = rows.variance()
    square = rows.residual(*estimate) ** 2 / variance
    outlier = _outliers(rows, square, variance)
    square[outlier] = 0.0
    freedom = int((~outlier).sum()) - unknowns
    return _NearestMinimum(estimate[0], 0.0, outlier, float(square.sum()), freedom, 0.0, square)


def _minimum(
    posed: Posed, rows: Measurements, estimate: tuple[Reals, Reals], is_guess: Bools
) -> _NearestMinimum:
    """Search for the least chi-square from an estimate on: first robust, then without outliers."""
    links = posed.problem.connections
    aside = np.cumsum(is_guess)[:, None] * np.array([_CLEARANCE, 0.0, 0.0])
    start = estimate[0] + is_guess[:, None] * aside, estimate[1]
    robust = posed.cost(rows, links=links, robust_sd=ROBUST_SD)
    begin = robust.at(*start)
    # The cost of the estimate itself: turns and yaws adapt to it, and positions stay.
    staying = robust.held(np.full(len(is_guess), _STAYS))
    staying.nearby = Nearby()  # none of its factors are near those of robots that move
    _, of_estimate = staying.refine(begin, _ROUNDS)
    state, least = robust.refine(begin, _ROUNDS)
    variance = rows.variance()
    missed = rows.residual(state.position, state.yaw) ** 2 / variance
    outlier = _outliers(rows, missed, variance)
    within = posed.cost(rows.select(~outlier), links=links)
    fit = InlierFit(~outlier, within, *within.refine(within.at(state.position, state.yaw), _ROUNDS))
    linear = fit.linear
    square = np.zeros(len(rows))
    square[~outlier] = linear.square
    excess = of_estimate.chi_square - least.chi_square
    moved = np.where(is_guess[:, None], estimate[0], state.position)
    return _NearestMinimum(
        moved, excess, outlier, linear.chi_square, linear.freedom(),
        linear.overlap, square, fit,
    )  # fmt: skip


def _outliers(rows: Measurements, square: Reals, variance: Reals) -> Bools:
    """Find outliers by squared residuals in variances (E,); a vector is one measurement, (E,)."""
    is_missed = (square > CONVERGENCE.outlier_sd**2) & ~are_known(variance, len(rows.neighbor))
    return rows.any_of_vector(is_missed)


def _is_within(away: Reals, sd: Reals | None, is_guess: Bools) -> bool:
    """Judge whether nine of ten robots are within `MOST_WITHIN` sd of the minimum, and all near it.

    The sd of others excuses no robot that is farther off than `CONVERGENCE.outlier_sd` of its own.
    """
    counts = ~is_guess[1:]
    if sd is None or not counts.any():
        return False
    off = np.linalg.norm(away, axis=1)[1:][counts]
    allowed = sd[1:][counts]
    is_near = off <= MOST_WITHIN * allowed
    return bool(
        is_near.mean() >= _NINE_OF_TEN
        and (off <= np.maximum(CONVERGENCE.outlier_sd * allowed, SETTLED)).all()
    )


def _opened(log: SensingLog, rows: Measurements, position: Reals) -> tuple[Reals, dict[str, Any]]:
    """Find how far free turns move robots from an estimate: one configuration, or the mean.

    Args:
        log: What was sensed.
        rows: Measurements.
        position: Centers [R], shape (N, 3).

    Returns:
        Standard deviation of the estimate, 0 of robots that do not turn [R], shape (N,), and the
        fields `free_frame` and `turns` of an estimate.
    """
    nowhere = np.zeros(len(position))
    if not rows.is_central.any():
        return nowhere, {}
    # At the mean of all, where no range pulls to either side, robots fit no range.
    aside = _ASIDE * float(np.median(rows.distances.length))
    start = position + aside * normal(0, "aside", np.arange(len(position))[:, None], range(3))
    start[0] = position[0]
    rows = rows.associated(position)
    cost = WholeCost(log, rows, robust_sd=ROBUST_SD, non_overlap=False, are_independent=True)
    state, linear = cost.refine(cost.at(start, nowhere), _TURNED)
    turns = Turns.of(rows, state.position)
    if not turns:
        return nowhere, {}
    square = turns.off(state.position, position)
    square += (square > 0.0) * linear.variance(turns.motions(state.position))
    return np.sqrt(square), turns.stated(state.position, log.dock_radius)
