"""Place all robots together: anneal the log's rows from several starts, weigh the ends."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from tiswarm.base.progress import ignore
from tiswarm.localization.chains.annealer import Annealed, anneal
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.mixture.anchors import without_wrong_anchors
from tiswarm.localization.mixture.common_causes import with_common_causes
from tiswarm.localization.mixture.ends import Fit, Posed, further_starts
from tiswarm.localization.mixture.exchange import with_exchanges
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.outliers import without_outlier_robots
from tiswarm.localization.settings import MOST_STEPS, JointParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog


def batch_key(log: SensingLog, params: JointParams) -> Hashable:
    """Name what logs must share to be annealed together."""
    chains = params.chains_for(log.robot_count)
    steps = params.steps_for(log.robot_count)
    parts = [part for part in (log, log.stances) if part is not None]
    is_directed = "directions" in params.used_cues and any(len(part.directions) for part in parts)
    has_touches = "touches" in params.used_cues and any(len(part.touches) for part in parts)
    traits = (len(log.dock_offset_body), is_directed, has_touches, bool(len(log.gone)))
    return (*traits, params.seed, chains, steps, params.hold_steps)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[JointParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures side by side, and report the share that is done.

    Returns:
        One estimate a log: the mean of the solutions that the ends of its chains lead to, each with
        its weight. `sd` follows from the variance within and between chains, or from the refined
        problem. The residual is the root mean square over the contacts of the distance of their
        docks less D, or of the components of measured offsets.
    """
    problems = [pose_problem(log, settings) for log, settings in zip(logs, params, strict=True)]
    annealed = anneal(logs, params, problems, on_progress=lambda share: on_progress(share / 2))
    estimates: list[Estimate] = []
    for log, settings, problem, chains in zip(logs, params, problems, annealed, strict=True):
        estimates.append(_searched(Posed(log, settings, problem), settings, chains))
        on_progress(0.5 + len(estimates) / (2 * len(logs)))
    return estimates


def _searched(posed: Posed, params: JointParams, annealed: Annealed) -> Estimate:
    """Estimate positions from first chains, whose starts no estimate chose."""
    fit, estimate = _mixed(posed, params, annealed)
    without_anchors = without_wrong_anchors(fit, estimate)
    if without_anchors is not None:
        return without_anchors
    # One wrong number of all robots may look like some wrong robots: it is tried before them.
    with_causes = with_common_causes(posed, estimate, lambda log: _of_log(log, params))
    if with_causes is not None:
        return with_causes
    without_robots = without_outlier_robots(fit, estimate)
    if without_robots is not estimate:
        return without_robots
    return with_exchanges(fit, estimate) or estimate


def _of_log(log: SensingLog, params: JointParams) -> Estimate:
    """Localize a log without a search for what is wrong in it."""
    posed = Posed(log, params, pose_problem(log, params))
    return _mixed(posed, params, _annealed(posed))[1]


def _mixed(posed: Posed, params: JointParams, annealed: Annealed) -> tuple[Fit, Estimate]:
    """Mix the ends of first chains, and of longer ones where these are not to be trusted."""
    fit, restarted = _further(posed, annealed)
    estimate = mixed(fit, restarted=restarted)
    steps = params.steps_for(posed.log.robot_count)
    verdict = estimate.convergence
    few = params.steps is None and posed.is_refined and steps < MOST_STEPS
    if few and verdict is not None and not verdict.trusted:
        # Motions of long chains of robots are slow: their time grows with the square of the length.
        # Where chains are trapped, rows seem to be wrong.
        longer = replace(posed, params=replace(params, steps=MOST_STEPS))
        again, more = _further(longer, _annealed(longer))
        fit = Fit.of(longer, fit.annealed.joined(again.annealed))
        estimate = mixed(fit, restarted=restarted + more + len(annealed.mean))
    return fit, estimate


def _further(posed: Posed, annealed: Annealed) -> tuple[Fit, int]:
    """Anneal as many chains from where ranges fit, if there are any; else those that failed again.

    Such starts unfold what the initial guess has folded.

    Returns:
        All chains, and how many annealings were repeated.
    """
    starts = further_starts(posed)
    if not starts:
        return _restarted(Fit.of(posed, annealed))
    start = np.array([starts[k % len(starts)] for k in range(len(annealed.mean))])
    return Fit.of(posed, annealed.joined(_annealed(posed, start=[start]))), 0


def _restarted(fit: Fit) -> tuple[Fit, int]:
    """Anneal chains that failed again, in ever smaller steps.

    Returns:
        All chains, and how many annealings were repeated.
    """
    restarted = 0
    for attempt in range(1, ANNEALING.restarts + 1):
        if not fit.has_failed.any():
            break
        again = _annealed(fit, halvings=attempt)
        restarted += int(fit.has_failed.sum())
        fit = Fit.of(fit, fit.annealed.with_chains(fit.has_failed, again))
    return fit, restarted


def _annealed(posed: Posed, **options: Any) -> Annealed:  # noqa: ANN401 - those of `anneal`
    """Anneal the chains of one log; options as for `anneal`."""
    params = cast("JointParams", posed.params)
    return anneal([posed.log], [params], [posed.problem], **options)[0]
