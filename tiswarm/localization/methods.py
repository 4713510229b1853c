"""Every localization method, by name, and the one door to all of them.

A method is a class of settings, and a module with a function of a log and such settings. Plug-ins
register a function:

    @tiswarm.method("my-locate")
    def locate(log):
        return positions  # shape (N, 3), in the unit of the log

The libraries of kernels are imported as the first log is localized.
"""

import math
import re
from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.params import AnyArch, AnyPrecision
from tiswarm.base.plugins import call_plugin, fault_of_numbers
from tiswarm.base.progress import Advance, ignore
from tiswarm.base.registry import get, register
from tiswarm.base.sections import Section, settings_class, settings_object
from tiswarm.localization.settings import DOCKS_UNKNOWN, MethodParams, all_cues
from tiswarm.measurements.flips import fit_orientations
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import FARTHEST, SensingLog, moved

if TYPE_CHECKING:
    from tiswarm.compute.backend import Backend

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_USUAL = tuple(name for name in all_cues() if name not in DOCKS_UNKNOWN)

_Locate = TypeVar("_Locate", bound=Callable[..., Any])

_PARTS = 64
"""Parts of a step that are reported: a power of 2, so that sums of them are exact."""


def settings_of(name: str) -> type[MethodParams]:
    """Return the class of settings of a method; one of this package names its module.

    A module has `localize`. It takes a log whose anchor is at the origin, settings, and a function
    that it calls with the share of its work that is done [1]; it returns an estimate. A module
    whose logs share launches has `batch_key` and `localize_batch` instead, see `joint`: all logs of
    a batch have, with their settings, the same key.

    Raises:
        InputError: there is no such method.
    """
    params: type[MethodParams] = get("method", name)
    return params


LocalizationParams = Annotated[MethodParams, Section("method")]
"""Settings of any method, those of plug-ins included."""


def joining(params: MethodParams) -> Callable[..., Any] | None:
    """Return the class that localizes robots as they join; None if these settings need all.

    It is made of a log's header and the settings. `join` adds the next robot by its line of a
    sensing file; `positions` are the centers in join order [log unit], shape (n, 3). If it knows
    their standard deviations [log unit], `sd` has them, shape (n,). If robots send messages, `sent`
    has the bytes that each has sent so far, shape (n,).
    """
    return getattr(_module_of(params), params.joining) if params.joining else None


def require_use(
    params: Collection[MethodParams], arch: AnyArch, precision: AnyPrecision = "auto"
) -> None:
    """Refuse a device or f32 that none of these methods can use.

    Raises:
        InputError: none of them is parallel, and a device or f32 was named.
    """
    if any(settings.is_parallel for settings in params):
        return
    titles = sorted({settings.title for settings in params})
    problem = (
        f"has no use: {' and '.join(titles)} always computes on cpu in f64; "
        "choose method joint, or virtual-force with schedule together, or leave this out"
    )
    if arch not in {"cpu", "auto"}:
        raise InputError(f"{arch} {problem}", argument="arch")
    if precision == "f32":
        raise InputError(f"f32 {problem}", key="precision")


def start_device(
    params: Collection[MethodParams],
    arch: AnyArch,
    *,
    threads: int | None = None,
    precision: AnyPrecision = "auto",
) -> "Backend":
    """Start what the parallel ones of these methods run on; arguments as for `backend.start`.

    Raises:
        InputError: none of the methods is parallel, and a device or f32 was named.
        EnvironmentTroubleError: the machine lacks the device.
    """
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import

    require_use(params, arch, precision)
    if not any(settings.is_parallel for settings in params):
        return backend.start("cpu", threads=threads, precision=precision)
    return backend.start(arch, threads=threads, precision=precision)


def start_for(params: MethodParams) -> "Backend":
    """Start the device of a method with its settings, unless it runs."""
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import

    return backend.device() if params.is_parallel else backend.processor()


def where(params: Collection[MethodParams], running: "Backend") -> str:
    """Say in a line on what these methods compute, `running` being what the parallel ones use."""
    parallel = sorted({settings.title for settings in params if settings.is_parallel})
    if not parallel:
        return f"all stages compute on {running}"
    compute = "computes" if len(parallel) == 1 else "compute"
    return f"{' and '.join(parallel)} {compute} on {running}, all other stages on cpu in f64"


def batch_key(log: SensingLog, params: MethodParams) -> Hashable:
    """Name what logs and their settings share if `localize_many` computes them side by side.

    Methods that localize one log after the other share the settings, so that each batch has a cost
    of its own.
    """
    if not params.places_robots:
        return params.method, repr(params)
    of_method = getattr(_module_of(params), "batch_key", None)
    return params.method, of_method(log, params) if of_method else repr(params)


def localize(log: SensingLog, params: MethodParams, *, on_progress: Advance = ignore) -> Estimate:
    """Work out from what a swarm sensed where every robot is; the steps reported are robots.

    Raises:
        InputError: the method is `none`.
    """
    if not params.places_robots:
        problem = f"{params.method} estimates no positions; choose another method"
        raise InputError(problem, argument="method")
    [estimate] = localize_many(
        [log], [params], with_observability=True,
        on_progress=lambda structures: on_progress(structures * log.robot_count),
    )  # fmt: skip
    return estimate


def localize_many(
    logs: Sequence[SensingLog],
    params: Sequence[MethodParams],
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
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import

    logs = [with_orientations(log) for log in logs]
    batches: dict[Hashable, list[int]] = {}
    for n, p in enumerate(params):
        if axes := getattr(p, "flip_axes", None):
            logs[n] = fit_orientations(logs[n], axes)
        batches.setdefault(batch_key(logs[n], p), []).append(n)
    estimates: dict[int, Estimate] = {}
    with backend.exclusive():
        for members in batches.values():
            start_for(params[members[0]])
            about_anchor = [centered(logs[n]) for n in members]
            report = by_share(on_progress, len(members))
            batch = localize_batch(about_anchor, [params[n] for n in members], report)
            for n, relative in zip(members, batch, strict=True):
                estimate = uncentered(relative, logs[n])
                if with_observability:
                    estimate = _observed(estimate, logs[n], params[n])
                estimates[n] = estimate
            report(1.0)
    return [estimates[n] for n in range(len(logs))]


def _observed(estimate: Estimate, log: SensingLog, params: MethodParams) -> Estimate:
    """Add to an estimate what its log determines."""
    # Half way between two images, measurements may resist less than at either.
    configuration = estimate.configuration
    yaw_unknown = estimate.yaw is not None
    determined = observability(log, params.used_cues, configuration, yaw_unknown=yaw_unknown)
    return replace(estimate, observability=determined)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[MethodParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize logs of the same `batch_key`, whose anchors are at the origin.

    Returns:
        One estimate a log, relative to its anchor.
    """
    module = _module_of(params[0])
    if of_method := getattr(module, "localize_batch", None):
        batch: list[Estimate] = of_method(logs, params, on_progress)
        return batch
    estimates: list[Estimate] = []
    total, done = sum(log.robot_count for log in logs), 0
    for log, p in zip(logs, params, strict=True):

        def report(share: float, begun: int = done, robots: int = log.robot_count) -> None:
            on_progress((begun + share * robots) / total)

        estimates.append(module.localize(log, p, report))
        report(1.0)
        done += log.robot_count
    return estimates


def _module_of(params: MethodParams) -> Any:  # noqa: ANN401 - a module
    """Import the module of a method; that of a plug-in is the class of its settings."""
    if isinstance(params, PluginMethodParams):
        return PluginMethodParams
    return import_module(params.module)


def centered(log: SensingLog) -> SensingLog:
    """Put the anchor at the origin: far from it, numbers lose the digits that robots differ by."""
    return moved(log, -log.anchor_position)


def uncentered(estimate: Estimate, log: SensingLog) -> Estimate:
    """Put an estimate relative to the anchor where that of its log is, and mark who has left."""
    by = log.anchor_position
    if estimate.common_causes:
        lifted = tuple(cause.lifted(float(by[2])) for cause in estimate.common_causes)
        estimate = estimate.with_common_causes(lifted)
    return replace(
        estimate,
        length_unit=log.length_unit,
        dock_radius=log.dock_radius,
        gone=log.is_gone if log.gone.size else None,
        position=estimate.position + by,
        trace=estimate.trace + by,
        at_join=None if estimate.at_join is None else estimate.at_join + by,
        solutions=tuple(replace(s, position=s.position + by) for s in estimate.solutions),
        turns=tuple(replace(turn, place=turn.place + by) for turn in estimate.turns),
    )


class PluginMethodParams(MethodParams):
    """Section `localization` with the method of a plug-in; each has a class with its settings."""

    plugin_function: ClassVar[Callable[..., Any]]
    """Function of a log, and of settings if there are any; returns positions or an estimate."""

    plugin_settings: ClassVar[type[Any] | None]
    """Class of the settings as the plug-in defines them; None if it has none."""

    plugin_cues: ClassVar[tuple[str, ...]]
    """What of the log the method uses."""

    @property
    def used_cues(self) -> tuple[str, ...]:
        """What of the log is used."""
        return self.plugin_cues

    @property
    def settings(self) -> Any:  # noqa: ANN401 - an object of the plug-in
        """Settings as the plug-in defines them; None if it has none."""
        if self.plugin_settings is None:
            return None
        return settings_object("method", self, self.plugin_settings)

    @staticmethod
    def localize(
        log: SensingLog, params: "PluginMethodParams", _on_progress: Callable[[float], None]
    ) -> Estimate:
        """Localize a log by the function of the plug-in.

        Returns:
            Its estimate. Where it returns positions only, the residual is the root mean square over
            contacts, ranges, and the components of measured offsets.

        Raises:
            PluginError: the function failed, or returned something else.
        """
        settings = () if params.plugin_settings is None else (params.settings,)

        def locate() -> tuple[Any, NDArray[Any]]:
            result = type(params).plugin_function(log, *settings)
            return result, np.asarray(result.position if isinstance(result, Estimate) else result)

        result, position = call_plugin(
            "method", params.method, locate, lambda pair: _fault(log, *pair)
        )
        if isinstance(result, Estimate):
            return result
        return _judged(log, params.used_cues, position.astype(np.float64))


def method(
    name: str, *, settings: type[Any] | None = None, cues: Sequence[str] = _USUAL
) -> Callable[[_Locate], _Locate]:
    """Register a function as a localization method.

    The function takes a log, and settings if it has a class of them. It returns the robots'
    positions [log unit] in join order, shape (N, 3), or an `Estimate`. Positions get the verdicts
    of other methods, by the chi-square of the measurements of the cues.

    Args:
        name: Name of the method in scenarios and commands: words of letters and digits, with "-".
        settings: Frozen dataclass, whose fields are settings of scenarios; None for no settings.
        cues: What of the log the method uses, as `tiswarm localize --cues` names it.

    Raises:
        InputError: the name is taken or invalid, there is no such cue, or settings cannot be
            checked.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} names no method; use words like my-method")
    for cue in cues:
        if cue not in all_cues():
            raise InputError(f"{cue} is not a cue; use {', '.join(all_cues())}")
    _require_settings(name, settings)

    def add(locate: _Locate) -> _Locate:
        register("method", name, _section(name, settings, locate, cues), locate)
        return locate

    return add


def _fault(log: SensingLog, returned: object, position: NDArray[Any]) -> str:
    """Say what is wrong with a method's result, and what is wanted; empty if nothing is."""
    if position.shape != (log.robot_count, 3):
        what = f"{type(returned).__name__} of shape {position.shape}"
        return f"{what}; return positions of shape ({log.robot_count}, 3), or an Estimate"
    farthest = FARTHEST * log.dock_radius
    where = f"within {farthest:g} {log.length_unit} of the origin"
    wrong = fault_of_numbers(position, farthest, where)
    return wrong and f"positions that are {wrong}; give guesses"


def _judged(log: SensingLog, cues: Sequence[str], position: Reals) -> Estimate:
    """Make an estimate of positions [log unit], with verdicts by their measurements."""
    # slow to import
    from tiswarm.localization.mixture.assessment import assess  # noqa: PLC0415
    from tiswarm.localization.mixture.verdict import rms  # noqa: PLC0415
    from tiswarm.measurements.contacts import disconnected  # noqa: PLC0415 - slow to import
    from tiswarm.measurements.cues import measure  # noqa: PLC0415 - slow to import

    rows = measure(log, cues)
    untied, center = disconnected(rows), position / log.dock_radius
    gap = rows.residual(center)[: len(rows.neighbor)]
    return Estimate(
        robot_id=log.robot_id,
        position=position,
        **assess(log, cues, center, is_guess=untied).fields(untied, log.dock_radius),
        iteration=np.zeros(1, np.int64),
        trace=position[None],
        residual=np.array([rms(gap)]) * log.dock_radius,
    )


def _require_settings(name: str, settings: type[Any] | None) -> None:
    """Refuse settings of a method whose fields cannot be keys of a scenario.

    Raises:
        InputError: the settings are no frozen dataclass, or a field has a name with a meaning.
    """
    if settings is None:
        return
    if not is_dataclass(settings) or not settings.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        problem = f"settings of {name}: {settings!r} is no frozen dataclass"
        raise InputError(f"{problem}; decorate it with @dataclass(frozen=True)")
    for setting in fields(settings):
        if setting.name in _TAKEN:
            problem = f"settings of {name}: {setting.name} has a meaning already; rename it"
            raise InputError(problem)


_TAKEN = {"method", "cues", *PluginMethodParams.__annotations__, *dir(PluginMethodParams)}
"""Names that a setting of a plug-in cannot have."""


def _section(
    name: str, settings: type[Any] | None, locate: Callable[..., Any], cues: Sequence[str]
) -> type[PluginMethodParams]:
    """Make the class of a section from the class of the settings.

    Raises:
        InputError: a field of the settings cannot be checked.
    """
    namespace = {
        "plugin_function": staticmethod(locate),
        "plugin_settings": settings,
        "plugin_cues": tuple(cues),
    }
    section: type[PluginMethodParams] = settings_class(
        "method", name, settings, PluginMethodParams, namespace
    )
    return section


def by_share(advance: Advance, steps: int) -> Callable[[float], None]:
    """Return a function that reports the share [1] that is done of some steps."""
    reported = 0.0

    def report(share: float) -> None:
        nonlocal reported
        done = steps * math.floor(_PARTS * share) / _PARTS
        advance(done - reported)
        reported = done

    return report
