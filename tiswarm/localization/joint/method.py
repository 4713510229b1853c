"""The joint method: measurements, annealing, and one estimate from all chains."""

from collections.abc import Callable, Hashable, Sequence

import numpy as np

from tiswarm.aliases import Bools, Reals
from tiswarm.localization.joint.annealing import anneal
from tiswarm.localization.joint.chains import Annealed, Verdict, deviation, distinct, failed, judge
from tiswarm.localization.joint.initialization import place_disconnected
from tiswarm.localization.joint.problem import Problem, pose_problem
from tiswarm.localization.joint.refine import is_of_use, refine
from tiswarm.localization.joint.settings import AnnealSchedule
from tiswarm.localization.params import JointParams
from tiswarm.progress import ignore
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog


def batch_key(log: SensingLog, params: JointParams) -> Hashable:
    """Name what logs must share to be annealed together."""
    chains, steps = params.chains_for(log.robot_count), params.steps_for(log.robot_count)
    parts = [part for part in (log, log.stances) if part is not None]
    is_directed = "directions" in params.cues and any(len(part.directions) for part in parts)
    has_touches = "touches" in params.cues and any(len(part.touches) for part in parts)
    docks = len(log.dock_offset_body)
    return (docks, is_directed, has_touches, params.seed, chains, steps, params.hold_steps)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[JointParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures side by side, and report the share that is annealed.

    Returns:
        One estimate a log: the mean over the end of all chains that converged, refined where that
        is of use. `sd` follows from the variance within and between chains, or from the refined
        problem. The residual is the root mean square over the contacts of the distance of their
        docks less D, or of the components of measured offsets.
    """
    problems = [pose_problem(log, p) for log, p in zip(logs, params, strict=True)]
    annealed = anneal(logs, params, problems, on_progress=on_progress)
    return [_estimate(*each) for each in zip(logs, params, problems, annealed, strict=True)]


def _estimate(
    log: SensingLog, params: JointParams, problem: Problem, annealed: Annealed
) -> Estimate:
    annealed, verdict = _restarted(log, params, problem, annealed)
    converged, convergence = verdict.converged, verdict.convergence
    chain, square = place_disconnected(annealed.mean, problem)
    mean = chain[converged]
    position, yaw = mean.mean(axis=0), annealed.mean_yaw[converged].mean(axis=0)
    sd = deviation(problem, annealed.mean, annealed.within, converged, annealed.sigma)
    if params.refines(log.robot_count) and is_of_use(problem) and convergence.converged:
        used = ~verdict.outlier | (not params.robust)
        used[problem.rows.touch] &= _agreed(problem, annealed, converged)
        curved = _curved(problem, annealed)[used[: len(problem.variance)]]
        rows = problem.rows.select(used).associated(position, yaw)
        position, yaw, sd = refine(problem, position, yaw, sd, rows, curved)
    # Chains agree where they place disconnected parts, but nothing measures it.
    sd = np.sqrt(sd**2 + square[converged].mean(axis=0))
    trace = np.concatenate([place_disconnected(annealed.trace[:-1], problem)[0], position[None]])
    yaw_trace = np.concatenate([annealed.yaw_trace[:-1], yaw[None]])
    width = np.sqrt(problem.variance + annealed.sigma**2)
    last = problem.residual(annealed.last[converged], annealed.last_yaw[converged])
    gap = problem.residual(trace, yaw_trace)
    outliers = problem.rows.select(verdict.outlier)
    places = np.concatenate([problem.inconsistent.sensed_places, outliers.sensed_places])
    unit = log.dock_radius
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit,
        disconnected=problem.untied,
        sd=sd * unit,
        yaw=yaw if problem.yaw_precision else None,
        convergence=convergence,
        outlier_contacts=np.unique(outliers.sensed_contacts, axis=0)
        if convergence.converged
        else None,
        outlier_places=places if convergence.converged else None,
        solutions=distinct(mean * unit, _rms(last) * unit, _rms(last / width), log.spacing),
        iteration=annealed.iteration,
        trace=trace * unit,
        residual=_rms(gap) * unit,
        residual_sd=float(_rms(gap[-1:] / width)[0]),
    )


def _restarted(
    log: SensingLog, params: JointParams, problem: Problem, annealed: Annealed
) -> tuple[Annealed, Verdict]:
    """Anneal chains that failed again, in ever smaller steps, and judge all of them."""
    restarted = 0
    has_failed = failed(problem, annealed)
    for attempt in range(1, AnnealSchedule.restarts + 1):
        if not has_failed.any():
            break
        again = anneal([log], [params], [problem], halvings=attempt)[0]
        annealed = annealed.with_chains(has_failed, again)
        restarted += int(has_failed.sum())
        has_failed = failed(problem, annealed)
    return annealed, judge(problem, annealed, has_failed, restarted)


def _agreed(problem: Problem, annealed: Annealed, converged: Bools) -> Bools:
    """Find touches whose docks are the same in all converged chains, shape (T,).

    The mean of chains that differ has neither docks at the right distance.
    """
    pair = problem.rows.association(annealed.mean[converged], annealed.mean_yaw[converged])
    is_agreed: Bools = (pair == pair[0]).all(axis=0)
    return is_agreed


def _curved(problem: Problem, annealed: Annealed) -> Reals:
    """Compute the variance of links about their linear form, since chains move, shape (P,).

    A distance d grows by s^2 / 2d if the one dock is off by s across from the other. Offsets are
    linear.
    """
    rows, length = problem.rows, problem.rows.distances.length
    i, j = rows.robot[: len(length)], rows.other[: len(length)]
    between = (annealed.mean[:, i] - annealed.mean[:, j]).var(axis=0).sum(axis=1)
    within = (annealed.within[:, i] + annealed.within[:, j]).mean(axis=0)
    variance: Reals = ((between + within) / (2.0 * length)) ** 2
    return np.pad(variance, (0, len(rows.offsets.stance)))


def _rms(gap: Reals) -> Reals:
    """Root mean square of gaps (K, P), 0 where there are none, shape (K,)."""
    rms: Reals = np.sqrt((gap**2).sum(axis=1) / max(gap.shape[1], 1))
    return rms
