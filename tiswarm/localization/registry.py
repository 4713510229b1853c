"""Every localization method, by name."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from types import ModuleType

import numpy as np

from tiswarm.aliases import Reals
from tiswarm.localization import least_squares, virtual_force
from tiswarm.localization.joint import method as joint
from tiswarm.localization.params import LocalizationParams
from tiswarm.measurements.observability import observability
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

METHODS: dict[str, ModuleType] = {
    "joint": joint,
    "virtual-force": virtual_force,
    "least-squares": least_squares,
}
"""Modules with the functions `batch_key` and `localize_batch`.

`localize_batch` takes one log a structure and settings for each, and returns an estimate for each.
All logs of a batch have, with their settings, the same `batch_key`.
"""


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
        centered = [_centered(logs[n]) for n in members]
        batch = method.localize_batch(centered, [params[n] for n in members])
        for n, relative in zip(members, batch, strict=True):
            estimate = _moved(relative, logs[n].anchor_position)
            if with_observability:
                known = observability(
                    logs[n], params[n].cues, estimate.position, yaw_unknown=estimate.yaw is not None
                )
                estimate = replace(estimate, observability=known)
            estimates[n] = estimate
        on_progress(len(members))
    return [estimates[n] for n in range(len(logs))]


def _centered(log: SensingLog) -> SensingLog:
    """Put the anchor at the origin: far from it, numbers lose the digits that robots differ by."""
    anchor = log.anchor_position
    return replace(
        log,
        anchor_position=np.zeros(3),
        ground_z=None if log.ground_z is None else log.ground_z - float(anchor[2]),
        flip_height=log.flip_height - anchor[2],
        spawn_position=log.spawn_position - anchor,
    )


def _moved(estimate: Estimate, by: Reals) -> Estimate:
    """Move an estimate by a vector, shape (3,)."""
    return replace(
        estimate,
        position=estimate.position + by,
        trace=estimate.trace + by,
        solutions=tuple(replace(s, position=s.position + by) for s in estimate.solutions),
    )
