"""Place all robots together: anneal the log's rows from several starts, weigh the ends."""

from collections.abc import Callable, Hashable, Sequence

from tiswarm.base.progress import ignore
from tiswarm.localization.chains.annealer import anneal
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.mixture.ends import Posed
from tiswarm.localization.mixture.search import searched
from tiswarm.localization.settings import JointParams
from tiswarm.records.estimate import Estimate
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
        One estimate a log: the mean of the solutions that the ends of its chains lead to, each with
        its weight. `sd` follows from the variance within and between chains, or from the refined
        problem. The residual is the root mean square over the contacts of the distance of their
        docks less D, or of the components of measured offsets.
    """
    problems = [pose_problem(log, p) for log, p in zip(logs, params, strict=True)]
    annealed = anneal(logs, params, problems, on_progress=on_progress)
    every = zip(logs, params, problems, annealed, strict=True)
    return [searched(Posed(log, p, problem), chains) for log, p, problem, chains in every]
