"""The joint method: equations, annealing, and one estimate from all chains."""

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.joint.anneal import Annealed, anneal
from tiswarm.localization.joint.convergence import Verdict, failed, judge
from tiswarm.localization.joint.deviation import deviation
from tiswarm.localization.joint.equations import Equations, equations
from tiswarm.localization.joint.force_kernels import SPACING
from tiswarm.localization.joint.refine import is_of_use, refine
from tiswarm.localization.joint.seats import rejoined
from tiswarm.localization.joint.solutions import distinct
from tiswarm.localization.params import JointParams
from tiswarm.measurements.contacts import located
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

RESTARTS = 2
"""How often a chain that failed is annealed again, each time in steps half as long."""


def batch_key(log: SensingLog, params: JointParams) -> Hashable:
    """Name what logs must share to be annealed together."""
    chains, steps = params.chains_for(log.robot_count), params.steps_for(log.robot_count)
    return (len(log.dock_offset_body), params.seed, chains, steps, params.hold_steps)


def localize_batch(logs: Sequence[SensingLog], params: Sequence[JointParams]) -> list[Estimate]:
    """Localize structures side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.

    Returns:
        One estimate a log: the mean over the end of all chains that converged, refined where that
        is of use. `sd` follows from the variance within and between chains, or from the refined
        equations; the residual is the root mean square over the contacts of the distance of their
        docks less D.
    """
    known = [equations(log, p) for log, p in zip(logs, params, strict=True)]
    annealed = anneal(logs, params, known)
    return [_estimate(*each) for each in zip(logs, params, known, annealed, strict=True)]


def _estimate(
    log: SensingLog, params: JointParams, known: Equations, annealed: Annealed
) -> Estimate:
    annealed, verdict = _restarted(log, params, known, annealed)
    sound, convergence = verdict.converged, verdict.convergence
    chain, untold = rejoined(annealed.mean, known)
    mean = chain[sound]
    position, yaw = mean.mean(axis=0), annealed.mean_yaw[sound].mean(axis=0)
    sd = deviation(known, annealed.mean, annealed.spread, sound, annealed.tolerance)
    if params.refines(log.robot_count) and is_of_use(known) and convergence.converged:
        trusted = ~verdict.outlier if params.robust else np.ones_like(verdict.outlier)
        position, yaw, sd = refine(known, position, yaw, sd, trusted, _curved(known, annealed))
    # Chains agree where parts are put that nothing ties, but not where these may be.
    sd = np.sqrt(sd**2 + untold[sound].mean(axis=0))
    trace = np.concatenate([rejoined(annealed.trace[:-1], known)[0], position[None]])
    width = np.sqrt(known.variance + annealed.tolerance**2)
    last = known.lengths(annealed.last[sound], annealed.last_yaw[sound]) - SPACING
    gap = known.lengths(trace, yaw) - SPACING
    return Estimate(
        robot_id=log.robot_id,
        position=position * log.dock_radius,
        located=located(log),
        sd=sd * log.dock_radius,
        yaw=yaw if known.yaw_precision else None,
        convergence=convergence,
        doubted=known.felt[verdict.outlier] if convergence.converged else None,
        solutions=distinct(
            mean * log.dock_radius, _rms(last) * log.dock_radius, _rms(last / width), log.spacing
        ),
        iteration=annealed.iteration,
        trace=trace * log.dock_radius,
        residual=_rms(gap) * log.dock_radius,
        residual_sd=float(_rms(gap[-1:] / width)[0]),
    )


def _restarted(
    log: SensingLog, params: JointParams, known: Equations, annealed: Annealed
) -> tuple[Annealed, Verdict]:
    """Anneal chains that failed again, in ever smaller steps, and judge all of them."""
    restarted = 0
    has_failed = failed(known, annealed)
    for attempt in range(1, RESTARTS + 1):
        if not has_failed.any():
            break
        again = anneal([log], [params], [known], halvings=attempt)[0]
        annealed = annealed.with_chains(has_failed, again)
        restarted += int(has_failed.sum())
        has_failed = failed(known, annealed)
    return annealed, judge(known, annealed, has_failed, restarted)


def _curved(known: Equations, annealed: Annealed) -> NDArray[np.float64]:
    """Variance of contacts about their linear form, because chains stray, shape (C,).

    A distance D grows by s^2 / 2D if the one dock is off by s across from the other.
    """
    apart = annealed.mean[:, known.robot] - annealed.mean[:, known.other]
    differing = apart.var(axis=0).sum(axis=1)
    straying = (annealed.spread[:, known.robot] + annealed.spread[:, known.other]).mean(axis=0)
    variance: NDArray[np.float64] = ((differing + straying) / (2.0 * SPACING)) ** 2
    return variance


def _rms(gap: NDArray[np.float64]) -> NDArray[np.float64]:
    """Root mean square over the contacts of gaps (K, C), 0 where there are none, shape (K,)."""
    rms: NDArray[np.float64] = np.sqrt((gap**2).sum(axis=1) / max(gap.shape[1], 1))
    return rms
