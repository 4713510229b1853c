"""Methods of plug-ins: a function of a log, and of settings if it has some, becomes a method.

    @tiswarm.method("my-locate")
    def locate(log):
        return positions  # shape (N, 3), in the unit of the log

The registry loads this module for all of them: it has the functions of a method.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, make_dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeVar, Union, get_type_hints

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as checked_dataclass

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.params import STRICT
from tiswarm.base.plugins import (
    Plugin,
    PluginError,
    fault_of_numbers,
    guarded,
    register,
    registered,
)
from tiswarm.base.progress import ignore
from tiswarm.localization.settings import DOCKS_UNKNOWN, LocalizationParams, all_cues
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import FARTHEST, SensingLog

KIND = "method"
"""What plug-ins register here."""

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_BUILT_IN = ("joint", "virtual-force", "least-squares", "hop-by-hop", "online", "distributed")
_TAKEN = ("method", "cues", "settings")
_USUAL = tuple(name for name in all_cues() if name not in DOCKS_UNKNOWN)

_Locate = TypeVar("_Locate", bound=Callable[..., Any])


@dataclass(frozen=True, kw_only=True)
class OwnMethod:
    """A method that a plug-in registered."""

    name: str
    locate: Callable[..., Any]
    """Function of a log, and of settings if there are any; returns positions or an estimate."""

    settings: type[Any] | None
    """Class of its settings."""

    cues: tuple[str, ...]
    """What of the log it uses."""

    params: type["OwnParams"]
    """Section `localization` of a scenario: the name of the method, and its settings."""


class OwnParams:
    """Section `localization` with the method of a plug-in; each has a class with its settings."""

    method: str
    """Name of the method."""

    @property
    def cues(self) -> tuple[str, ...]:
        """What of the log is used."""
        return _own(self.method).cues

    @property
    def settings(self) -> Any:  # noqa: ANN401 - an object of the plug-in
        """Settings as the plug-in defines them; None if it has none."""
        kind = _own(self.method).settings
        return None if kind is None else kind(**self._values())

    def _values(self) -> dict[str, Any]:
        names = (each.name for each in fields(self))  # type: ignore[arg-type]
        return {name: getattr(self, name) for name in names if name != "method"}

    def __reduce__(self) -> tuple[Callable[..., "OwnParams"], tuple[Plugin, str, dict[str, Any]]]:
        """Send the plug-in ahead, so that a worker loads it before it needs the class."""
        plugin = registered(KIND)[self.method].plugin
        return _received, (plugin, self.method, self._values())


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
    if name in _BUILT_IN:
        raise InputError(f"method {name} is taken by tiswarm itself; choose another name")
    for cue in cues:
        if cue not in all_cues():
            raise InputError(f"{cue} is not a cue; use {', '.join(all_cues())}")
    section = _section(name, settings)

    def add(locate: _Locate) -> _Locate:
        own = OwnMethod(
            name=name, locate=locate, settings=settings, cues=tuple(cues), params=section
        )
        register(KIND, name, own, locate)
        return locate

    return add


def all_params() -> Any:  # noqa: ANN401 - a type
    """Return the type of the settings of any method, those of plug-ins included."""
    built_in = LocalizationParams.__origin__.__args__  # type: ignore[attr-defined]
    kinds = (*built_in, *(found.value.params for found in registered(KIND).values()))
    return Annotated[Union[kinds], pydantic.Field(discriminator="method")]  # noqa: UP007


def batch_key(log: SensingLog, params: OwnParams) -> Hashable:  # noqa: ARG001
    """Name what logs share that are localized in one batch, one after the other: the settings."""
    return repr(params)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[OwnParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures one after the other.

    Returns:
        One estimate a log. Where the method returns positions only, the residual is the root mean
        square over contacts, ranges, and the components of measured offsets.

    Raises:
        PluginError: the method failed, or returned something else.
    """
    estimates: list[Estimate] = []
    for log, each in zip(logs, params, strict=True):
        estimates.append(_localize(log, each))
        on_progress(len(estimates) / len(logs))
    return estimates


def _localize(log: SensingLog, params: OwnParams) -> Estimate:
    own, plugin = _own(params.method), registered(KIND)[params.method].plugin
    settings = () if own.settings is None else (params.settings,)

    def locate() -> tuple[Any, NDArray[Any]]:
        found = own.locate(log, *settings)
        return found, np.asarray(found.position if isinstance(found, Estimate) else found)

    found, position = guarded(plugin, own.name, locate)
    if wrong := _fault(log, found, position):
        problem = f"{plugin.file}: {own.name} returned {wrong}"
        raise PluginError(problem, f"{problem}\n")
    if isinstance(found, Estimate):
        return found
    return _judged(log, own.cues, position.astype(np.float64))


def _fault(log: SensingLog, found: object, position: NDArray[Any]) -> str:
    """Say what is wrong with a method's result, and what is wanted; empty if nothing is."""
    if position.shape != (log.robot_count, 3):
        what = f"{type(found).__name__} of shape {position.shape}"
        return f"{what}; return positions of shape ({log.robot_count}, 3), or an Estimate"
    farthest = FARTHEST * log.dock_radius
    where = f"within {farthest:g} {log.length_unit} of the origin"
    wrong = fault_of_numbers(position, farthest, where)
    return wrong and f"positions that are {wrong}; give guesses"


def _judged(log: SensingLog, cues: Sequence[str], position: Reals) -> Estimate:
    """Make an estimate of positions [log unit], with verdicts by their measurements."""
    from tiswarm.localization.mixture.verdict import assess, rms  # noqa: PLC0415 - slow to import
    from tiswarm.measurements.contacts import disconnected  # noqa: PLC0415 - slow to import
    from tiswarm.measurements.cues import measure  # noqa: PLC0415 - slow to import

    rows = measure(log, cues)
    untied, center = disconnected(rows), position / log.dock_radius
    gap = rows.residual(center)[: len(rows.other)]
    return Estimate(
        robot_id=log.robot_id,
        position=position,
        disconnected=untied,
        **assess(log, cues, center, is_guess=untied)._asdict(),
        iteration=np.zeros(1, np.int64),
        trace=position[None],
        residual=np.array([rms(gap)]) * log.dock_radius,
    )


def _own(name: str) -> OwnMethod:
    found: OwnMethod = registered(KIND)[name].value
    return found


def _received(plugin: Plugin, name: str, values: Mapping[str, Any]) -> OwnParams:  # noqa: ARG001
    """Make settings on a worker, where the plug-in has been loaded."""
    return _own(name).params(**values)


def _section(name: str, settings: type[Any] | None) -> type[OwnParams]:
    """Make the class of a section from the class of the settings.

    Raises:
        InputError: the settings are no frozen dataclass, or have a field that cannot be checked.
    """
    kind: Any = Annotated[Literal[name], pydantic.Field(description="Name of the method.")]
    described: list[tuple[str, Any, Any]] = [("method", kind, field(default=name))]
    if settings is not None:
        if not is_dataclass(settings) or not settings.__dataclass_params__.frozen:  # type: ignore[attr-defined]
            problem = f"settings of {name}: {settings!r} is no frozen dataclass"
            raise InputError(f"{problem}; decorate it with @dataclass(frozen=True)")
        kinds, texts = get_type_hints(settings, include_extras=True), _texts(settings)
        for each in fields(settings):
            if each.name in _TAKEN:
                problem = f"settings of {name}: {each.name} has a meaning already; rename it"
                raise InputError(problem)
            kind = Annotated[kinds[each.name], pydantic.Field(description=texts.get(each.name))]
            described.append((each.name, kind, _default(each)))

    def check(self: OwnParams) -> None:
        self.settings  # noqa: B018 - raises what the plug-in's own check finds

    title = f"Own{''.join(word.capitalize() for word in name.split('-'))}Params"  # in the schema
    text = (settings and settings.__doc__) or f"Settings of {name}."
    made = make_dataclass(
        title, described, bases=(OwnParams,), frozen=True, kw_only=True,
        namespace={"__doc__": text, "__post_init__": check, "__module__": __name__},
    )  # fmt: skip
    config = ConfigDict(**{**STRICT, "use_attribute_docstrings": False})
    try:
        checked: Any = checked_dataclass(made, frozen=True, kw_only=True, config=config)
    except pydantic.errors.PydanticSchemaGenerationError as error:
        problem = f"settings of {name}: {str(error).splitlines()[0]}; use types like float or str"
        raise InputError(problem) from error
    section: type[OwnParams] = checked
    return section


def _default(each: "Field[Any]") -> Any:  # noqa: ANN401 - a default
    """Copy the default of a field."""
    if each.default_factory is not MISSING:
        return field(default_factory=each.default_factory)
    return field() if each.default is MISSING else field(default=each.default)


def _texts(settings: type[Any]) -> dict[str, str]:
    """Read the docstrings below the fields of a class; empty where it has no source."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(settings)))
    except (OSError, TypeError, SyntaxError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    return {
        named.target.id: inspect.cleandoc(str(text.value.value))
        for named, text in pairwise(body)
        if isinstance(named, ast.AnnAssign) and isinstance(named.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }  # fmt: skip
