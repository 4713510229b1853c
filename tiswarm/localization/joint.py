"""The joint method: measurements, annealing, and one estimate from all chains."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.base.progress import ignore
from tiswarm.localization.chains.annealed import Annealed
from tiswarm.localization.chains.annealer import anneal
from tiswarm.localization.chains.initialization import place_disconnected
from tiswarm.localization.chains.problem import Problem, pose_problem
from tiswarm.localization.chains.settings import ANNEALING
from tiswarm.localization.mixture.ends import failed, further_starts
from tiswarm.localization.mixture.mixture import mix
from tiswarm.localization.mixture.outliers import disregard, explains, warned
from tiswarm.localization.mixture.verdict import rms
from tiswarm.localization.settings import ChiSquareParams, JointParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import SensingLog


def batch_key(log: SensingLog, params: JointParams) -> Hashable:
    """Name what logs must share to be annealed together."""
    chains, steps = params.chains_for(log.robot_count), params.steps_for(log.robot_count)
    parts = [part for part in (log, log.stances) if part is not None]
    is_directed = "directions" in params.cues and any(len(part.directions) for part in parts)
    has_touches = "touches" in params.cues and any(len(part.touches) for part in parts)
    traits = (len(log.dock_offset_body), is_directed, has_touches, bool(len(log.gone)))
    return (*traits, params.seed, chains, steps, params.hold_steps)


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
    estimates = []
    for log, p, problem, chains in zip(logs, params, problems, annealed, strict=True):
        ended, has_failed, restarted = _further(log, p, problem, chains)
        estimate = mixed(log, p, problem, ended, has_failed, restarted=restarted)
        estimates.append(without_outlier_robots(log, p, problem, ended, estimate))
    return estimates


def without_outlier_robots(
    log: SensingLog,
    params: JointParams,
    problem: Problem,
    annealed: Annealed,
    estimate: Estimate,
) -> Estimate:
    """Localize again without the orientations of robots that explain most of a misfit, if any.

    A drift that is too small to be named may turn the rest of the structure. So the estimate stays
    as uncertain, and as little to be trusted, as the misfit of all measurements says.
    """
    found = disregard(log, params, problem, annealed, estimate)
    estimate = warned(log, estimate)
    if found is None:
        return estimate
    chains = found.annealed.joined(anneal([found.log], [params], [found.problem])[0])
    has_failed = failed(found.problem, chains)
    again = mixed(found.log, params, found.problem, chains, has_failed)
    before, after = estimate.convergence, again.convergence
    if before is None or after is None or again.sd is None or not explains(before, after):
        return estimate
    factor = max(before.sd_factor, after.sd_factor)
    missed = [each.outlier_contacts for each in (estimate, again)]
    contacts = [each for each in missed if each is not None]
    verdict = replace(
        after,
        consistent=False,
        sd_factor=factor,
        reason=f"the orientations of {counted(len(found.robots), 'robot')} are outliers",
    )
    return replace(
        again,
        convergence=verdict,
        sd=again.sd * (factor / after.sd_factor),
        outlier_robots=np.sort(found.robots),
        # Wrong contacts make a robot suspect, too: they stay listed.
        outlier_contacts=np.unique(np.concatenate(contacts), axis=0) if contacts else None,
    )


def mixed(
    log: SensingLog,
    params: ChiSquareParams,
    problem: Problem,
    annealed: Annealed,
    has_failed: Bools,
    *,
    restarted: int = 0,
    prior_sd: Reals | None = None,
) -> Estimate:
    """Make an estimate of chains, or of starts that do not move; arguments as for `mix`."""
    mixture = mix(log, params, problem, annealed, has_failed, prior_sd)
    position, yaw = mixture.position, mixture.yaw
    trace = np.concatenate([place_disconnected(annealed.trace[:-1], problem)[0], position[None]])
    yaw_trace = np.concatenate([annealed.yaw_trace[:-1], yaw[None]])
    gap = problem.residual(trace, yaw_trace)
    width = np.sqrt(problem.variance + annealed.sigma**2)
    outliers = problem.rows.select(mixture.outlier)
    places = np.concatenate([problem.inconsistent.sensed_places, outliers.sensed_places])
    unit, found = log.dock_radius, mixture.convergence.converged
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit,
        disconnected=problem.untied,
        sd=mixture.sd * unit,
        yaw=yaw if problem.yaw_precision else None,
        convergence=replace(mixture.convergence, restarted=restarted),
        outlier_contacts=np.unique(outliers.sensed_contacts, axis=0) if found else None,
        outlier_places=places if found else None,
        misfit=mixture.misfit,
        mirrored=mixture.mirrored,
        free_frame=mixture.free_frame,
        solutions=tuple(
            replace(
                each,
                residual=each.residual * unit,
                position=each.position * unit,
                sd=None if each.sd is None else each.sd * unit,
            )
            for each in mixture.solutions
        ),
        iteration=annealed.iteration,
        trace=trace * unit,
        residual=rms(gap) * unit,
        residual_sd=float(rms(gap[-1:] / width)[0]),
    )


def _further(
    log: SensingLog, params: JointParams, problem: Problem, annealed: Annealed
) -> tuple[Annealed, Bools, int]:
    """Anneal as many chains from where ranges fit, if there are any; else those that failed again.

    Such starts unfold what the initial guess has folded. Returns as `_restarted`.
    """
    starts = further_starts(log, params, problem)
    if not starts:
        return _restarted(log, params, problem, annealed)
    start = np.array([starts[k % len(starts)] for k in range(len(annealed.mean))])
    annealed = annealed.joined(anneal([log], [params], [problem], start=[start])[0])
    return annealed, failed(problem, annealed), 0


def _restarted(
    log: SensingLog, params: JointParams, problem: Problem, annealed: Annealed
) -> tuple[Annealed, Bools, int]:
    """Anneal chains that failed again, in ever smaller steps.

    Returns:
        All chains, which of them failed, shape (chains,), and how many annealings were repeated.
    """
    restarted = 0
    has_failed = failed(problem, annealed)
    for attempt in range(1, ANNEALING.restarts + 1):
        if not has_failed.any():
            break
        again = anneal([log], [params], [problem], halvings=attempt)[0]
        annealed = annealed.with_chains(has_failed, again)
        restarted += int(has_failed.sum())
        has_failed = failed(problem, annealed)
    return annealed, has_failed, restarted
