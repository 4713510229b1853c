"""Every localization method, by name."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

from tiswarm.localization import least_squares, virtual_force
from tiswarm.localization.joint import method as joint
from tiswarm.localization.params import LocalizationParams
from tiswarm.measurements.observability import observability
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog


@dataclass(frozen=True, kw_only=True)
class Method:
    """How to call a method."""

    localize_batch: Callable[..., list[Estimate]]
    """Localizes logs side by side, given settings for each."""

    batch_key: Callable[..., Hashable]
    """Logs (each with its settings) of equal key may share a batch."""


METHODS = {
    "joint": Method(localize_batch=joint.localize_batch, batch_key=joint.batch_key),
    "virtual-force": Method(
        localize_batch=virtual_force.localize_batch, batch_key=virtual_force.batch_key
    ),
    "least-squares": Method(
        localize_batch=least_squares.localize_batch, batch_key=least_squares.batch_key
    ),
}


def localize(log: SensingLog, params: LocalizationParams) -> Estimate:
    """Work out from what a swarm sensed where every robot is."""
    return localize_many([log], [params], with_observability=True)[0]


def localize_many(
    logs: Sequence[SensingLog],
    params: Sequence[LocalizationParams],
    *,
    with_observability: bool = False,
    on_progress: Callable[[int], None] = lambda _done: None,
) -> list[Estimate]:
    """Localize structures side by side, as far as their settings let them share a launch.

    Args:
        logs: What each swarm sensed.
        params: Method and settings for each.
        with_observability: Whether to analyze what each log determines, which takes as long as some
            methods do.
        on_progress: Called with the number of structures that were finished.

    Returns:
        One estimate a log; the same as if each had been localized alone.
    """
    batches: dict[Hashable, list[int]] = {}
    for n, (log, p) in enumerate(zip(logs, params, strict=True)):
        batches.setdefault((p.method, METHODS[p.method].batch_key(log, p)), []).append(n)
    estimates: dict[int, Estimate] = {}
    for members in batches.values():
        method = METHODS[params[members[0]].method]
        batch = method.localize_batch([logs[n] for n in members], [params[n] for n in members])
        for n, estimate in zip(members, batch, strict=True):
            estimates[n] = estimate
            if with_observability:
                known = observability(
                    logs[n], params[n].cues, estimate.position, yaw_unknown=estimate.yaw is not None
                )
                estimates[n] = replace(estimate, observability=known)
        on_progress(len(members))
    return [estimates[n] for n in range(len(logs))]
