"""Every localization method, by name."""

from collections.abc import Collection, Hashable, Sequence
from dataclasses import replace
from typing import Any

from tiswarm.base.errors import InputError
from tiswarm.base.params import AnyArch, AnyPrecision
from tiswarm.base.parts import load
from tiswarm.base.progress import Advance, by_share, ignore
from tiswarm.compute import backend
from tiswarm.compute.backend import Backend
from tiswarm.localization.settings import LocalizationParams, VirtualForceParams
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog, moved

METHODS = {
    "joint": "tiswarm.localization.joint",
    "virtual-force": "tiswarm.localization.virtual_force.method",
    "least-squares": "tiswarm.parts.peers.least_squares",
    "hop-by-hop": "tiswarm.parts.peers.hop_by_hop",
    "online": "tiswarm.parts.online.method",
    "distributed": "tiswarm.parts.between.method",
}
OWN = "tiswarm.localization.plugins"
"""Modules with the functions `batch_key` and `localize_batch`, imported when they are used; `OWN`
has those of the methods of plug-ins. Methods that place robots as they join have `joining`, too.

`localize_batch` takes one log a structure, settings for each, and a function that it calls with the
share of its work that is done [1]; it returns an estimate for each.
All logs of a batch have, with their settings, the same `batch_key`. Methods that localize one log
after the other choose batches by the settings, so that each batch has a cost of its own.
"""

PARALLEL = frozenset({"joint", "virtual-force together"})
"""Titles of methods that run on the device that a user chooses; others run on the processor in
f64."""


def module_of(method: str) -> Any:  # noqa: ANN401 - a module
    """Import the module of a method."""
    return load(METHODS.get(method, OWN), f"method {method}")


def joining(params: LocalizationParams) -> Any | None:  # noqa: ANN401 - a class
    """Return the class that localizes robots as they join; None if these settings need all.

    It is made of a log's header and the settings, and has `join`, which takes the line of a robot,
    and `positions`.
    """
    of_method = getattr(module_of(params.method), "joining", None)
    return of_method(params) if of_method else None


def title(params: LocalizationParams) -> str:
    """Name a method, and its schedule unless robots move in join order."""
    if isinstance(params, VirtualForceParams) and params.schedule != "join-order":
        return f"{params.method} {params.schedule}"
    return params.method


def require_use(titles: Collection[str], arch: AnyArch, precision: AnyPrecision = "auto") -> None:
    """Refuse a device or f32 that none of these methods can use.

    Raises:
        InputError: none of them is parallel, and a device or f32 was named.
    """
    if not PARALLEL.isdisjoint(titles):
        return
    problem = (
        f"has no use: {' and '.join(sorted(set(titles)))} always computes on cpu in f64; "
        "choose method joint, or virtual-force with schedule together, or leave this out"
    )
    if arch not in {"cpu", "auto"}:
        raise InputError(f"{arch} {problem}", argument="arch")
    if precision == "f32":
        raise InputError(f"f32 {problem}", key="precision")


def start_device(
    titles: Collection[str],
    arch: AnyArch,
    *,
    threads: int | None = None,
    precision: AnyPrecision = "auto",
) -> Backend:
    """Start what the parallel ones of these methods run on; arguments as for `backend.start`.

    Raises:
        InputError: none of the methods is parallel, and a device or f32 was named.
        EnvironmentTroubleError: the machine lacks the device.
    """
    require_use(titles, arch, precision)
    if PARALLEL.isdisjoint(titles):
        return backend.start("cpu", threads=threads)
    return backend.start(arch, threads=threads, precision=precision)


def start_for(params: LocalizationParams) -> Backend:
    """Start the device of a method with its settings, unless it runs."""
    return backend.device() if title(params) in PARALLEL else backend.processor()


def where(titles: Collection[str], running: Backend) -> str:
    """Say in a line on what these methods compute, `running` being what the parallel ones use."""
    parallel = sorted(PARALLEL.intersection(titles))
    if not parallel:
        return f"all stages compute on {running}"
    compute = "computes" if len(parallel) == 1 else "compute"
    return f"{' and '.join(parallel)} {compute} on {running}, all other stages on cpu in f64"


def batch_key(log: SensingLog, params: LocalizationParams) -> Hashable:
    """Name what logs and their settings share if `localize_many` computes them side by side."""
    return params.method, module_of(params.method).batch_key(log, params)


def localize(
    log: SensingLog, params: LocalizationParams, *, on_progress: Advance = ignore
) -> Estimate:
    """Work out from what a swarm sensed where every robot is; the steps reported are robots."""
    [estimate] = localize_many(
        [log], [params], with_observability=True,
        on_progress=lambda structures: on_progress(structures * log.robot_count),
    )  # fmt: skip
    return estimate


@backend.exclusive()
def localize_many(
    logs: Sequence[SensingLog],
    params: Sequence[LocalizationParams],
    *,
    with_observability: bool = False,
    on_progress: Advance = ignore,
) -> list[Estimate]:
    """Localize structures side by side, as far as their settings let them share a launch.

    Args:
        logs: What each swarm sensed.
        params: Method and settings for each.
        with_observability: Whether to analyze what each log determines, which takes as long as some
            methods do.
        on_progress: Called with the number of structures, or parts of one, that were finished.

    Returns:
        One estimate a log; the same as if each had been localized alone.
    """
    logs = [with_orientations(log) for log in logs]
    batches: dict[Hashable, list[int]] = {}
    for n, (log, p) in enumerate(zip(logs, params, strict=True)):
        batches.setdefault(batch_key(log, p), []).append(n)
    estimates: dict[int, Estimate] = {}
    for members in batches.values():
        method = module_of(params[members[0]].method)
        start_for(params[members[0]])
        about_anchor = [centered(logs[n]) for n in members]
        report = by_share(on_progress, len(members))
        batch = method.localize_batch(about_anchor, [params[n] for n in members], report)
        for n, relative in zip(members, batch, strict=True):
            estimate = uncentered(relative, logs[n])
            if with_observability:
                # Half way between two images, measurements may resist less than at either.
                at = estimate.solutions[0] if estimate.solutions else estimate
                known = observability(
                    logs[n], params[n].cues, at.position, yaw_unknown=estimate.yaw is not None
                )
                estimate = replace(estimate, observability=known)
            estimates[n] = estimate
        report(1.0)
    return [estimates[n] for n in range(len(logs))]


def centered(log: SensingLog) -> SensingLog:
    """Put the anchor at the origin: far from it, numbers lose the digits that robots differ by."""
    return moved(log, -log.anchor_position)


def uncentered(estimate: Estimate, log: SensingLog) -> Estimate:
    """Put an estimate relative to the anchor where that of its log is, and mark who has left."""
    by = log.anchor_position
    return replace(
        estimate,
        length_unit=log.length_unit,
        gone=log.is_gone if log.gone.size else None,
        position=estimate.position + by,
        trace=estimate.trace + by,
        at_join=None if estimate.at_join is None else estimate.at_join + by,
        solutions=tuple(replace(s, position=s.position + by) for s in estimate.solutions),
    )
