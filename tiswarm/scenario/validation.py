"""Checks of plain data and of `--set` options; each mistake with its place."""

import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import ErrorDetails

from tiswarm.base.errors import InputError, did_you_mean
from tiswarm.base.params import STRICT
from tiswarm.base.plugins import load_plugins
from tiswarm.base.registry import Registered, contents
from tiswarm.localization.methods import LocalizationParams
from tiswarm.localization.settings import SWITCHES
from tiswarm.records.messages import (
    MISSING_KEY,
    UNKNOWN_KEY,
    Part,
    counted,
    dotted,
    explain,
    shown,
)
from tiswarm.scenario.yaml_source import parse_yaml

Plain = dict[str, Any]
"""A scenario, or a part of it, as plain data."""

DISCRIMINATORS = {"structure": "kind", "localization": "method", "sensing": "suite"}
"""By section, the key that selects which settings the section has, or their defaults."""

_SUGGESTED = {"structure": "tower", "localization": "joint"}
"""Those of them without a default, and what a message on a missing one suggests."""

SAME_KEYS = ("sensing",)
"""Those of them whose settings have the same keys, whichever is selected."""

CONDITION_SECTIONS = ("localization", "sensing")
"""Sections that conditions change."""

MOST_MISTAKES = 20
"""Mistakes of a scenario that are listed; of more, the list says that there are others."""

_METHOD = ("localization", "method")

_NAMES = frozenset(
    {
        _METHOD,
        ("localization", "channel"),
        ("localization", "force"),
        ("localization", "integrator"),
        ("sensing", "suite"),
        ("structure", "kind"),
        ("structure", "rule"),
        ("structure", "rule", "name"),
        ("structure", "strength", "law"),
        ("structure", "terrain", "kind"),
    }
)
"""Keys, without indices, whose values are names that plug-ins may add."""

_UNKNOWN_NAME = frozenset({"union_tag_invalid", "literal_error"})
"""Types of errors of a name that is none of those listed."""

_MOVED: Mapping[tuple[Part, ...], tuple[Part, ...]] = {
    ("localization", cue): ("localization", "cues", cue) for cue in SWITCHES
}
"""Keys of earlier versions that are somewhere else now."""

_ENTRY = re.compile(r"(?P<name>.+)\[-?\d+\]")
"""Entry of a list, as errors name it."""

_WITH_KEYS = ("conditions", "sweep")
"""Sections whose keys are names, or keys of other sections, which are checked one by one."""

_CONDITION = re.compile(rf"conditions\.(.+?)(?:\.((?:{'|'.join(CONDITION_SECTIONS)})\..+|label))?")
_Checked = TypeVar("_Checked")


class Mistake(NamedTuple):
    """A problem and its place."""

    path: tuple[Part, ...]
    problem: str
    about_key: bool = False  # whether the key is wrong, not its value


class Setting(NamedTuple):
    """One `--set KEY=VALUE`."""

    text: str
    path: tuple[str, ...]
    value: object

    @property
    def values(self) -> dict[str, object]:
        """Its value and, if that is a mapping, all values in it, by dotted key."""
        return dict(_nested(".".join(self.path), self.value))

    def error(self, problem: str) -> InputError:
        """Return an error that names the setting."""
        return InputError(problem, argument="overrides", key=self.text)


class _HasPath(Protocol):
    @property
    def path(self) -> tuple[str, ...]: ...


_AnyChange = TypeVar("_AnyChange", bound=_HasPath)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _LocalizationSection:
    localization: LocalizationParams


_LOCALIZATION = TypeAdapter(_LocalizationSection)


def validate(adapter: TypeAdapter[_Checked], data: Plain) -> _Checked | list[Mistake]:
    """Build an object from plain data, or list the mistakes in it.

    Of more than MOST_MISTAKES, the list has one beyond these, and wrong keys come first.
    """
    try:
        # Only from JSON does strict validation accept lists for tuples.
        return adapter.validate_json(json.dumps(data))
    except ValidationError as invalid:
        errors = invalid.errors(include_url=False)
        if len(errors) > MOST_MISTAKES:
            errors.sort(key=lambda error: error["type"] not in UNKNOWN_KEY)
        causes = (error for error in errors if not _follows(error, errors))
        return [
            _mistake(error, adapter, data) for error in itertools.islice(causes, MOST_MISTAKES + 1)
        ]


def _follows(error: ErrorDetails, errors: Sequence[ErrorDetails]) -> bool:
    """Whether other mistakes explain this one.

    Mistakes in items keep them out of a list, which is too short then. A misspelled key leaves the
    one that was meant missing.
    """
    path = error["loc"]
    if error["type"] == "too_short":
        return any(
            cause["loc"][: len(path)] == path and len(cause["loc"]) > len(path) for cause in errors
        )
    return error["type"] in MISSING_KEY and any(
        cause["type"] in UNKNOWN_KEY
        and cause["loc"][:-1] == path[:-1]
        and did_you_mean(cause["loc"][-1], [str(path[-1])])
        for cause in errors
    )


def set_key(data: Plain, path: Sequence[str], value: object) -> str:
    """Set a value in plain data in place; return why that is impossible, or nothing."""
    for place, part in enumerate(path, start=1):
        entry = _ENTRY.fullmatch(part)
        if entry and path[0] not in _WITH_KEYS:
            whole = dotted([*path[: place - 1], entry["name"]])
            return f"{dotted(path[:place])} is an entry of a list; set {whole} as a whole"
    for place, part in enumerate(path[:-1], start=1):
        data = data.setdefault(part, {})
        if isinstance(data, list):
            whole = dotted(path[:place])
            return f"{whole} is a list; set {whole} as a whole"
        if not isinstance(data, dict):
            return f"{dotted(path[:place])} is a single value, not a section; correct the key"
    data[path[-1]] = deepcopy(value)
    return ""


def parse_setting(text: str, *section: str) -> Setting:
    """Parse `KEY=VALUE`, the key being one of a section if that is given, or raise InputError."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        problem = "is not KEY=VALUE; write it like robots=20"
        raise InputError(problem, argument="overrides", key=text)
    try:
        path = (*section, *_setting_path(key.strip()))
        return Setting(text, path, parse_yaml(value).data)
    except InputError as error:
        problem = error.problem.partition(", or a scenario")[0]
        raise InputError(problem, argument="overrides", key=text) from error


def first_of(errors: Sequence[InputError], where: str = "") -> InputError:
    """Return the first of some errors, with the number of the others and where these are listed."""
    first = errors[0]
    more = len(errors) - 1
    if not more:
        return first
    problem = f"{first.problem} (and {counted(more, 'more mistake')}{where})"
    places = {name: getattr(first, name) for name in ("path", "line", "column", "argument", "key")}
    return InputError(problem, **places)


def find_culprit(mistake: Mistake, changes: Sequence[_AnyChange]) -> _AnyChange | None:
    """Find the last change that set the value at fault or, failing that, a part of it."""
    path = mistake.path
    last_first = changes[::-1]
    whole = (change for change in last_first if change.path == path[: len(change.path)])
    part = (change for change in last_first if change.path[: len(path)] == path)
    return next(itertools.chain(whole, part), None)


def blame(mistake: Mistake, settings: Sequence[Setting]) -> InputError | None:
    """Return the error of the setting at fault, with the key within its value, if there is one."""
    culprit = find_culprit(mistake, settings)
    if culprit is None:
        return None
    within = dotted(mistake.path).removeprefix(dotted(culprit.path)).lstrip(".")
    is_key = within[:1] != "[" and len(mistake.path) > len(culprit.path)
    return culprit.error(f"{within}: {mistake.problem}" if is_key else mistake.problem)


def localization_params(
    method: str,
    overrides: Sequence[str] = (),
    *,
    cues: Sequence[str] | Mapping[str, object] | None = None,
    values: Mapping[str, object] | None = None,
) -> LocalizationParams:
    """Build the settings of a localization method without a scenario file.

    Args:
        method: Name of the method.
        overrides: Texts `KEY=VALUE`, the key being one of the method's own.
        cues: Cues to use, all others being off, or a mapping that switches some on or off; None for
            the method's own choice.
        values: Settings by key, as plain data.

    Raises:
        InputError: for an unknown method or cue, or for bad settings, a wrong key first.
    """
    load_plugins()
    switches = cues if cues is None or isinstance(cues, Mapping) else _switches(method, cues)
    settings = [parse_setting(text, "localization") for text in overrides]
    section = {"method": method, **(values or {})}
    if switches is not None:
        section["cues"] = dict(switches)
    data: Plain = {"localization": section}
    for setting in settings:
        problem = set_key(data, setting.path, setting.value)
        if problem:
            raise setting.error(problem)
    outcome = validate(_LOCALIZATION, data)
    if isinstance(outcome, _LocalizationSection):
        return outcome.localization
    outcome.sort(key=lambda mistake: not mistake.about_key)
    errors = [
        blame(mistake, settings) or InputError(mistake.problem, argument=dotted(mistake.path[1:]))
        for mistake in outcome
    ]
    raise first_of(errors)


def _switches(method: str, cues: Sequence[str]) -> dict[str, bool]:
    """Switch cues of a method on and all others off, or raise InputError."""
    for cue in cues:
        if cue not in SWITCHES:
            meant = did_you_mean(cue, SWITCHES) or f"; use {', '.join(SWITCHES)}"
            raise InputError(f"{cue} is not a cue{meant}", argument="cues")
    settings = _alternatives("localization", _LOCALIZATION)
    schema = _schema(_LOCALIZATION)
    switches = {
        name: {cue for cue in SWITCHES if "const" not in _form_at(["cues", cue], keys, schema)}
        for name, keys in settings.items()
        if "cues" in keys
    }
    of_method = switches.get(method, set() if method in settings else {*SWITCHES})
    lacking = [cue for cue in cues if cue not in of_method]
    able = [name for name, of_name in switches.items() if {*cues} <= of_name]
    choose = f"choose method {' or '.join(able)}" if able else "leave them out"
    if not of_method:
        keys = settings[method].items()
        flags = ", ".join(key for key, form in keys if form.get("type") == "boolean")
        problem = f"{method} has no choice of cues but its settings {flags}; set these, or {choose}"
        raise InputError(problem, argument="cues")
    if lacking:
        problem = f"{method} cannot use {', '.join(lacking)}; {choose}"
        raise InputError(problem, argument="cues")
    return {cue: cue in cues for cue in SWITCHES if cue in of_method}


def _nested(key: str, value: object) -> Iterator[tuple[str, object]]:
    yield key, value
    if isinstance(value, dict):
        for part, inner in value.items():
            yield from _nested(f"{key}.{part}", inner)


def _setting_path(key: str) -> tuple[str, ...]:
    """Split a dotted key; keys of conditions and sweep have dots of their own."""
    match = _CONDITION.fullmatch(key)
    if match:
        return ("conditions", *(part for part in match.groups() if part))
    head, dot, rest = key.partition(".")
    return (head, rest) if head == "sweep" and dot else tuple(key.split("."))


def _mistake(error: ErrorDetails, adapter: TypeAdapter[Any], data: Plain) -> Mistake:
    path = error["loc"]
    about_key = error["type"] in UNKNOWN_KEY or path[-1:] == ("[key]",)
    if path[-1:] == ("[key]",):
        path = path[:-1]
    elif path[:1] == ("seeds",):  # continues with the alternative that was tried
        path = ("seeds", *path[2:])
    is_missing = error["type"] in MISSING_KEY
    section = str(path[0]) if path else ""
    if is_missing and section in _SUGGESTED and path[1:] in {(), (DISCRIMINATORS[section],)}:
        return _missing_choice(section, adapter)
    problem = explain(error, _allowed(path, adapter, data))
    keys = tuple(part for part in path if not isinstance(part, int))
    if keys in _NAMES and error["type"] in _UNKNOWN_NAME:
        if not problem.endswith("?"):
            problem += ", or one of a plug-in that you load (--plugin FILE)"
        elif not contents():  # no plug-in is loaded that would have a name so near
            problem += " or load the plug-in that has it (--plugin FILE)"
    moved = _MOVED.get(path, ()) if about_key else ()
    if moved:
        new_key = dotted(moved if adapter is not _LOCALIZATION else moved[1:])
        problem = f"the key is now {new_key}; write {new_key}: {shown(error['input'])}"
    return Mistake(path, _by_choice(moved or path, error, adapter, data) or problem, about_key)


def _missing_choice(section: str, adapter: TypeAdapter[Any]) -> Mistake:
    """Show how to write a section that lacks the key which selects its settings."""
    key = DISCRIMINATORS[section]
    names = ", ".join(_alternatives(section, adapter))
    example = f"{section}: {{{key}: {_SUGGESTED[section]}}}"
    return Mistake((section, key), f"is missing; write it like {example}, one of {names}")


def _by_choice(
    path: tuple[Part, ...], error: ErrorDetails, adapter: TypeAdapter[Any], data: Plain
) -> str:
    """Explain a key that other methods or kinds have and the chosen one lacks; else empty."""
    section, *keys = map(str, path)
    if section not in DISCRIMINATORS or not keys:
        return ""
    settings = _alternatives(section, adapter)
    chosen = data[section].get(DISCRIMINATORS[section])
    if not isinstance(chosen, str) or chosen not in settings:
        return ""
    schema = _schema(adapter)
    forms = {name: _form_at(keys, properties, schema) for name, properties in settings.items()}
    owners = [name for name, form in forms.items() if form and "const" not in form]
    is_unknown = error["type"] in UNKNOWN_KEY
    if not owners or chosen in owners or not (is_unknown or "const" in forms[chosen]):
        return ""
    choose = f"leave it out, or choose {DISCRIMINATORS[section]} {' or '.join(owners)}"
    if is_unknown:
        return f"unknown key of {chosen}; {choose}"
    allowed = json.dumps(forms[chosen]["const"])
    return f"{shown(error['input'])} should be {allowed} with {chosen}; {choose}"


def _form_at(keys: Sequence[str], properties: Plain, schema: Plain) -> Plain:
    """Return what the schema says of a key within keys of a section; empty if there is no such."""
    form: Plain = {"properties": properties}
    for key in keys:
        form = _settings(schema, form, None).get("properties", {}).get(key, {})
    return form


def _alternatives(section: str, adapter: TypeAdapter[Any]) -> dict[str, Plain]:
    """Return the properties of the settings that a section may have, by the name that selects."""
    schema = _schema(adapter)
    of_section = schema.get("properties", {}).get(section, {})
    names = of_section.get("discriminator", {}).get("mapping", {})
    return {
        name: _definition(schema, reference).get("properties", {})
        for name, reference in names.items()
    }


def _allowed(path: tuple[Part, ...], adapter: TypeAdapter[Any], data: object) -> tuple[str, ...]:
    """Return the keys of the section that holds the value at a path of some data."""
    schema = _schema(adapter)
    section = schema
    for part in path[:-1]:
        if isinstance(part, int):
            if not isinstance(data, list):  # one entry stands for a list of it
                continue
            data = data[part]
            section = _settings(schema, _entries(section), data)
        else:
            data = data.get(part) if isinstance(data, dict) else None
            section = _settings(schema, section.get("properties", {}).get(part, {}), data)
    return tuple(section.get("properties", ()))


def _entries(section: Plain) -> Plain:
    """Return the schema of the entries of a list, which may be null instead."""
    for form in (section, *section.get("anyOf", ())):
        if "items" in form:
            items: Plain = form["items"]
            return items
    return {}


def _settings(schema: Plain, section: Plain, data: object) -> Plain:
    """Return the definition of those settings that a section may have which some data selects."""
    # A section that may be null, or a name alone, is one of two.
    for form in (section, *section.get("anyOf", ()), *section.get("oneOf", ())):
        if "discriminator" in form and isinstance(data, dict):
            selected = str(data.get(form["discriminator"]["propertyName"]))
            reference = form["discriminator"]["mapping"].get(selected)
        else:
            reference = form.get("$ref")
        if reference:
            return _definition(schema, reference)
    return section


def _definition(schema: Plain, reference: str) -> Plain:
    definition: Plain = schema["$defs"][reference.rpartition("/")[2]]
    return definition


def _schema(adapter: TypeAdapter[Any]) -> Plain:
    """Return the JSON Schema of what an adapter checks, with the plug-ins that are loaded."""
    return _schema_with(adapter, contents())


@lru_cache(maxsize=8)
def _schema_with(adapter: TypeAdapter[Any], _plugins: tuple[Registered, ...]) -> Plain:
    return adapter.json_schema()
