"""The keys of the interchange file `sensing.jsonl`, and checks of one line at a time.

A header comes first, then one robot a line, the anchor first. Each line is a JSON object, and an
optional key may be left out or null. Keys of robots and stances are those of the table `KEYS` in
`sensing_log.py`: models, reader and writer loop over it. An event says
what changed later, about robots on earlier lines. The log is that of the swarm after all events.
"""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields
from types import new_class
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetPydanticSchema,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from tiswarm.base.errors import InputError, did_you_mean
from tiswarm.base.params import STRICT
from tiswarm.records.messages import counted, dotted, explain, shown
from tiswarm.records.sensing_log import FARTHEST, KEYS, LISTS, NUMBERS, Key, SensingNoise

FORMAT = "tiswarm-sensing"
VERSIONS = (1, 2, 3)
"""Versions of the format; a log is written as the first that has all of its keys."""

MOST_DOCKS = 64
"""Docks of a robot; `joint` takes 20 s on one core for eight robots of so many."""

MOST_CONTACTS = 24
"""Contacts of a dock at the end: twice the twelve spheres that can touch one sphere."""

_LONGEST_ARM = 1e3
"""From a center to a dock [dock radii]; the analysis of floppy modes needs digits to spare."""

_LONGEST_NAME = 40
"""Characters in the name of a source or of the unit of length."""

_SD = (1e-6, 1e6)
"""Least and greatest standard deviation of a fix, a range or a source [dock radii]."""


def _column_part(unit: str) -> str:
    if unit.isprintable() and unit == unit.strip() and not {*unit} & {*',"'}:
        return unit
    raise ValueError(f"{shown(unit)} cannot be part of a column's name; write a name like mm")


def _source_name(name: str) -> str:
    if 0 < len(name) <= _LONGEST_NAME and name.isprintable() and name == name.strip():
        return name
    problem = f"should be 1 to {_LONGEST_NAME} printable characters without spaces around them"
    raise ValueError(f"the name {shown(name)} {problem}; correct it")


def _item(key: Key) -> Any:  # noqa: ANN401 - a type
    """Return the type of an item in a file; where a source may stand, the name is left out or null.

    JSON has no tuples: lists count as such, numbers in them stay strict.
    """
    python = [_PYTHON.get(column, float) for column in key.columns]
    count = len(python)
    if "source" in key.columns:

        def schema(_: Any, handler: GetCoreSchemaHandler) -> CoreSchema:  # noqa: ANN401 - any type
            items = [handler.generate_schema(kind) for kind in python]
            return core_schema.tuple_schema(
                items, variadic_item_index=count - 1, max_length=count, strict=False
            )

        return Annotated[tuple[Any, ...], GetPydanticSchema(schema)]
    if len({*python}) > 1:
        return Annotated[tuple[tuple(python)], Field(strict=False)]  # type: ignore[misc]
    one: Any = python[0]
    if count == 1:
        return one
    return Annotated[list[one], Field(min_length=count, max_length=count)]


def _value(name: str) -> Any:  # noqa: ANN401 - a type
    """Return the type of the value of a key."""
    item: Any = _item(KEYS[name])
    return item if name in NUMBERS else Annotated[list[item], Field(fail_fast=True)]


def _with(keys: Mapping[str, Key], base: type[BaseModel]) -> Any:  # noqa: ANN401 - a class
    """Add keys to a model; all but contacts may be left out or null."""
    kinds: dict[str, Any] = {}
    namespace: dict[str, Any] = {"__module__": __name__, "__annotations__": kinds}
    for name, key in keys.items():
        text = key.meaning if base is _RobotFields else None
        if name == _STATED:
            kinds[name] = _value(name)
            namespace[name] = Field(... if base is _RobotFields else [], description=text)
        else:
            kinds[name] = _value(name) | None
            namespace[name] = Field(None, description=text)
    return new_class(base.__name__, (base,), {}, lambda names: names.update(namespace))


_PYTHON: dict[str, Any] = {
    "dock": int,
    "dock or null": int | None,
    "robot": int,
    "source": str | None,
}
"""Types of numbers that are not real."""

_WHEN_USED = ConfigDict(**STRICT, defer_build=True)
"""Config of models whose validators are built when a line is read, not at start."""

_STATED = "contacts"
"""List that each robot states; a stance may leave it out."""

_Radius = Annotated[float, Field(ge=1e-9, le=1e9)]
_Unit = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME), AfterValidator(_column_part)]
_SourceName = Annotated[str, AfterValidator(_source_name)]
_Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
_Touch: Any = _item(KEYS["touches"])
Name = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]


class SourceEntry(BaseModel):
    """What measures fixes or ranges: a plane of a lighthouse, a beacon, a camera, a device."""

    model_config = STRICT

    shared_sd: float
    """Standard deviation of the error that all measurements of the source share [length unit]."""


class HeaderLine(BaseModel):
    """Values that hold for all robots; keys in the order in which they are written."""

    model_config = STRICT

    format: Literal["tiswarm-sensing"]
    version: Literal[1, 2, 3]
    lines: Annotated[int, Field(ge=1)] | None = None
    """Number of lines after the header, by which a reader notices that a file was cut."""

    dock_radius: _Radius
    """Radius of a dock sphere [length unit]."""

    dock_offsets: Annotated[
        list[_Vector], Field(min_length=1, max_length=MOST_DOCKS, fail_fast=True)
    ]
    """Vectors from the center to each dock, body frame [length unit]."""

    anchor_position: _Vector
    """Known center of the first robot [length unit]."""

    ground_z: float | None = None
    """Height of flat ground [length unit]."""

    ground_form: Literal["uneven"] | None = None
    """Ground that is no plane: docks on it say nothing about heights. Version 3."""

    length_unit: _Unit = "unit"
    """Name of the unit of length."""

    noise: SensingNoise | None = None
    """Standard deviations and rates of errors; without them, those of an IMU are assumed."""

    sources: dict[_SourceName, SourceEntry] | None = None
    """Sources of fixes and ranges, by name. Version 2."""

    @model_validator(mode="after")
    def _refuse_new_keys(self) -> "HeaderLine":
        self.refuse_new("sources", self.sources)
        self.refuse_new("ground_form", self.ground_form, EVENT_VERSION)
        for key in KEYS.values():
            if self.noise and key.noise:
                stated = getattr(self.noise, key.noise)
                self.refuse_new(f"noise.{key.noise}", stated, key.version)
        return self

    @model_validator(mode="after")
    def _refuse_two_grounds(self) -> "HeaderLine":
        if self.ground_form is not None and self.ground_z is not None:
            problem = f"{self.ground_form} ground has no height; leave out ground_z or ground_form"
            raise InputError(problem, key="ground_z")
        return self

    @model_validator(mode="after")
    def _refuse_wrong_sources(self) -> "HeaderLine":
        for name, source in (self.sources or {}).items():
            self.refuse_sd(dotted(["sources", name, "shared_sd"]), source.shared_sd)
        return self

    @model_validator(mode="after")
    def _refuse_far_lengths(self) -> "HeaderLine":
        for dock, offset in enumerate(self.dock_offsets):
            self.refuse_far(f"dock_offsets[{dock}]", offset, 0.0, _LONGEST_ARM)
        self.refuse_far("anchor_position", self.anchor_position, 0.0)
        self.refuse_far("ground_z", self.ground_z, self.anchor_position[2])
        self.refuse_far("noise.spawn", self.noise.spawn if self.noise else None, 0.0)
        return self

    def refuse_new(self, key: str, value: object, version: int = 2) -> None:
        """Raise InputError where a key of a later version has a value."""
        if self.version < version and value is not None:
            problem = (
                f"version {self.version} has no such key; give version {version} in the header"
            )
            raise InputError(problem, key=key)

    def refuse_far(
        self, key: str, lengths: ArrayLike | None, start: ArrayLike, limit: float = FARTHEST
    ) -> None:
        """Raise InputError where lengths, if given, are beyond a limit [dock radii] of a start."""
        farthest = limit * self.dock_radius
        if lengths is None or (np.abs(np.subtract(lengths, start)) <= farthest).all():
            return
        within = f"within {farthest:g} {self.length_unit} of {shown(start)}"
        why = f"{limit:g} times dock_radius"
        raise InputError(f"{shown(lengths)} should be {within}, {why}; correct one", key=key)

    def refuse_sd(self, key: str, sd: float) -> None:
        """Raise InputError where a standard deviation [length unit] is out of bounds."""
        least, most = (bound * self.dock_radius for bound in _SD)
        if not least <= sd <= most:
            problem = f"the standard deviation {shown(sd)} should be from {least:g} to {most:g}"
            raise InputError(f"{problem}; correct it", key=key)

    def require_lines(self, count: int) -> None:
        """Raise InputError where another number of lines follows than the header states."""
        if self.lines is not None and count != self.lines:
            problem = f"{counted(self.lines, 'line')} should follow, and {count} do; "
            remedy = "get the whole file, or leave out this key if no line is missing"
            raise InputError(f"{problem}{remedy}", key="lines")

    def source_arrays(self) -> dict[str, Any]:
        """Return the names and standard deviations of the sources, as `SensingLog` has them."""
        sources = self.sources or {}
        shared = np.array([source.shared_sd for source in sources.values()], np.float64)
        return {"source_name": tuple(sources), "source_sd": shared}


class _StanceFields(BaseModel):
    model_config = _WHEN_USED

    orientation_wxyz: _Quaternion
    pivot_dock: int
    """Dock that stays in place while the robot flips out of the stance."""


class _RobotFields(BaseModel):
    model_config = _WHEN_USED

    robot: Name
    """Name, an integer that no other robot has."""

    orientation_wxyz: _Quaternion | None
    """Sensed orientation, a unit quaternion from body to world; null, in version 2, for a robot
    without a compass, whose orientation follows from connections."""


class StanceEntry(_with(LISTS, _StanceFields), _StanceFields):  # type: ignore[misc]
    """One stance before the final one."""


class RobotLine(_with(KEYS, _RobotFields), _RobotFields):  # type: ignore[misc]
    """One robot: its final stance, and the stances before."""

    stances: Annotated[list[StanceEntry], Field(fail_fast=True)] | None = None
    """Stances before the final one, in time order."""

    event: Literal["replace"] | None = None
    """Replace: this is the line of a robot that has one, and that has sensed more since. Version
    3."""


_Model = TypeVar("_Model", bound=BaseModel)

Line = str | Mapping[str, object]
"""A line of a sensing file, as text or as the value of its JSON."""


def parse_header(line: Line | HeaderLine) -> HeaderLine:
    """Read the first line; an InputError names the key at fault, but neither file nor line."""
    if isinstance(line, HeaderLine):
        return line
    text = _text(line)
    if text.strip() and text.lstrip()[0] not in "{[":
        problem = "the first line is no JSON object; start a log with its header, or make a log of "
        raise InputError(f"{problem}a table by tiswarm import; give a scenario to tiswarm run")
    entries = parse_json(text)
    if entries.get("format") != FORMAT:
        problem = f'the first line is not a header; start it with {{"format": "{FORMAT}", ...'
        raise InputError(problem, key="format")
    version = entries.get("version", VERSIONS[-1])
    if type(version) is not int or version not in VERSIONS:
        versions = f"{', '.join(map(str, VERSIONS[:-1]))} and {VERSIONS[-1]}"
        problem = f"{shown(version)} is not supported; this program reads versions {versions}"
        raise InputError(problem, key="version")
    try:
        return HeaderLine.model_validate_json(text)  # Python values would be no SensingNoise
    except ValidationError as error:
        raise _mistake(error, HeaderLine) from error


def _text(line: Line) -> str:
    return line if isinstance(line, str) else json.dumps(line)


def parse_robot(line: Line | RobotLine) -> RobotLine:
    """Read the line of a robot that joins; errors as for `parse_header`."""
    if isinstance(line, RobotLine):
        return line
    entries = parse_json(_text(line))
    event = entries.get("event")
    if event is not None:
        problem = "is about a robot that has joined; give the line of one that joins"
        raise InputError(f"{shown(event)} {problem}", key="event")
    return parsed(entries, RobotLine)


def parsed(entries: dict[str, object], model: type[_Model]) -> _Model:
    """Check the content of a line; errors as for `parse_header`."""
    try:
        return model.model_validate(entries)
    except ValidationError as error:
        raise _mistake(error, model) from error


def _mistake(error: ValidationError, model: type[BaseModel]) -> InputError:
    """Describe all that is missing in a line, or else its first mistake."""
    errors = error.errors(include_url=False)
    missing = [dotted(first["loc"]) for first in errors if first["type"] == "missing"]
    if len(missing) > 1:
        return InputError("are missing; add them", key=", ".join(missing))
    first = errors[0]
    path = first["loc"]
    if path[-1:] == ("[key]",):  # a key itself is at fault, not its value
        path = path[:-2]
    noise = [field.name for field in fields(SensingNoise)]
    nested = {
        "stances": list(StanceEntry.model_fields),
        "noise": noise,
        "sources": list(SourceEntry.model_fields),
    }
    allowed = nested.get(str(path[0])) if path[1:] else None
    return InputError(explain(first, allowed or list(model.model_fields)), key=dotted(path))


def parse_json(text: str) -> dict[str, object]:
    """Read a line as a JSON object; errors as for `parse_header`."""
    if not text.strip():
        raise InputError("the line is empty; delete it")
    try:
        entries = _DECODER.decode(text)
    except json.JSONDecodeError as error:
        problem = f"not JSON at column {error.colno}: {error.msg}; write one JSON object a line"
        raise InputError(problem) from error
    except (ValueError, RecursionError) as error:
        problem = "nested too deep, or a number of thousands of digits; write one robot a line"
        raise InputError(problem) from error
    if not isinstance(entries, dict):
        raise InputError(f"{shown(entries)} is not a JSON object; write the line as {{...}}")
    return entries


def _without_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        repeated = Counter(key for key, _ in pairs).most_common(1)[0][0]
        problem = "the key stands twice in one object; keep one of the two"
        raise InputError(problem, key=dotted([repeated]))
    return entries


_DECODER = json.JSONDecoder(object_pairs_hook=_without_duplicates)


EVENT_VERSION = 3
"""First version of the format that has events."""


class LeaveLine(BaseModel):
    """A robot has left. What it sensed, and what others sensed of it, stays."""

    model_config = STRICT

    event: Literal["leave"]

    robot: Name
    """Name of a robot on an earlier line, other than the anchor."""


class ReleaseLine(BaseModel):
    """A robot has let go of others: docks that touched no longer do."""

    model_config = STRICT

    event: Literal["release"]

    robot: Name
    """Name of a robot on an earlier line."""

    contacts: Annotated[list[_Touch], Field(min_length=1, fail_fast=True)]
    """Rows of [own dock, other robot, other dock], null for a dock that is unknown. The line of one
    of the two robots has each."""


SensingLine = RobotLine | LeaveLine | ReleaseLine
"""A line after the header."""

_MODELS: dict[str, type[SensingLine]] = {
    "leave": LeaveLine,
    "release": ReleaseLine,
    "replace": RobotLine,
}


def parse_line(line: Line, header: HeaderLine) -> SensingLine:
    """Read a line after this header; an InputError names the key, but neither file nor line."""
    entries = parse_json(_text(line))
    event = entries.get("event")
    if event is None:
        return parsed(entries, RobotLine)
    if header.version < EVENT_VERSION:
        remedy = f"give version {EVENT_VERSION} in the header"
        raise InputError(f"version {header.version} has no events; {remedy}", key="event")
    if not isinstance(event, str) or event not in _MODELS:
        problem = f"{shown(event)} should be one of {', '.join(_MODELS)}"
        raise InputError(f"{problem}{did_you_mean(event, _MODELS)}", key="event")
    return parsed(entries, _MODELS[event])


def line_schema() -> dict[str, object]:
    """Return the JSON Schema of a line: the header, a robot or an event."""
    from tiswarm.base.sections import Described  # noqa: PLC0415 - of no other use here

    return TypeAdapter(HeaderLine | SensingLine).json_schema(schema_generator=Described)
