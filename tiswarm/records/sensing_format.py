"""The keys of the interchange file `sensing.jsonl`, and checks of one line at a time.

A header comes first, then one robot a line, the anchor first. Each line is a JSON object, and an
optional key may be left out or null. A new optional key takes three declarations: its type in
`RobotLine` or `StanceEntry`, its entry in `ROBOT_NUMBERS` or `STANCE_LISTS`, and its array in
`SensingLog` or `Stances`. Reader and writer loop over the entries. An event says
what changed later, about robots on earlier lines. The log is that of the swarm after all events.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    GetPydanticSchema,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from tiswarm.base.errors import InputError
from tiswarm.base.params import STRICT
from tiswarm.records.messages import did_you_mean, dotted, explain, shown
from tiswarm.records.sensing_log import FARTHEST, SensingNoise

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


def _sourced(*kinds: type) -> GetPydanticSchema:
    """Type a row of so many numbers, after which the name of a source, or null, may stand."""

    def schema(_: Any, handler: GetCoreSchemaHandler) -> CoreSchema:  # noqa: ANN401 - any type
        items = [handler.generate_schema(kind) for kind in (*kinds, str | None)]
        return core_schema.tuple_schema(
            items, variadic_item_index=len(kinds), max_length=len(items), strict=False
        )

    return GetPydanticSchema(schema)


_Radius = Annotated[float, Field(ge=1e-9, le=1e9)]
_Unit = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME), AfterValidator(_column_part)]
_SourceName = Annotated[str, AfterValidator(_source_name)]
_Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
_Contact = Annotated[list[int], Field(min_length=3, max_length=3)]
_Contacts = Annotated[list[_Contact], Field(fail_fast=True)]
_Docks = Annotated[list[int], Field(fail_fast=True)]
_AS_LIST = Field(strict=False)  # JSON has no tuples; numbers in them stay strict
_Fix = Annotated[tuple[Any, ...], _sourced(*[float] * 5)]
_Fixes = Annotated[list[_Fix], Field(fail_fast=True)]
_Range = Annotated[tuple[Any, ...], _sourced(int, float, float)]
_Ranges = Annotated[list[_Range], Field(fail_fast=True)]
_Direction = Annotated[tuple[int, int, int, float, float, float], _AS_LIST]
_Directions = Annotated[list[_Direction], Field(fail_fast=True)]
_Connection = Annotated[tuple[int, int, int, float, float, float, float], _AS_LIST]
_Connections = Annotated[list[_Connection], Field(fail_fast=True)]
_Displacement = Annotated[tuple[int, float, float, float, float], _AS_LIST]
_Displacements = Annotated[list[_Displacement], Field(fail_fast=True)]
_Touch = Annotated[tuple[int | None, int, int | None], _AS_LIST]
Touches = Annotated[list[_Touch], Field(fail_fast=True)]
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

    length_unit: _Unit = "unit"
    """Name of the unit of length."""

    noise: SensingNoise | None = None
    """Standard deviations and rates of errors; without them, those of an IMU are assumed."""

    sources: dict[_SourceName, SourceEntry] | None = None
    """Sources of fixes and ranges, by name. Version 2."""

    @model_validator(mode="after")
    def _refuse_new_keys(self) -> "HeaderLine":
        self.refuse_new("sources", self.sources)
        for key in NEW_NOISE if self.noise else ():
            self.refuse_new(f"noise.{key}", getattr(self.noise, key))
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

    def refuse_new(self, key: str, value: object) -> None:
        """Raise InputError where a key of version 2 has a value in a file of version 1."""
        if self.version == 1 and value is not None:
            problem = "version 1 has no such key; give version 2 in the header"
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

    def source_arrays(self) -> dict[str, Any]:
        """Return the names and standard deviations of the sources, as `SensingLog` has them."""
        sources = self.sources or {}
        shared = np.array([source.shared_sd for source in sources.values()], np.float64)
        return {"source_name": tuple(sources), "source_sd": shared}


class StanceEntry(BaseModel):
    """One stance before the final one."""

    model_config = STRICT

    orientation_wxyz: _Quaternion
    pivot_dock: int
    """Dock that stays in place while the robot flips out of the stance."""

    contacts: _Contacts = []
    ground_docks: _Docks | None = None
    fixes: _Fixes | None = None
    ranges: _Ranges | None = None
    directions: _Directions | None = None
    connections: _Connections | None = None
    touches: Touches | None = None
    displacements: _Displacements | None = None


class RobotLine(BaseModel):
    """One robot: its final stance, and the stances before."""

    model_config = STRICT

    robot: Name
    """Name, an integer that no other robot has."""

    orientation_wxyz: _Quaternion | None
    """Sensed orientation, a unit quaternion from body to world; null, in version 2, for a robot
    without a compass, whose orientation follows from connections."""

    contacts: _Contacts
    """Rows of [own dock, other robot, other dock]; the other robot is on an earlier line."""

    ground_docks: _Docks | None = None
    """Docks on flat ground."""

    fixes: _Fixes | None = None
    """Measured coordinates of the center, rows of [x, y, z, value, sd] or [x, y, z, value, sd,
    source]: along the unit vector (x, y, z) the center is at the value [length unit]. The sd is
    without the error that measurements of the source share. Version 2."""

    ranges: _Ranges | None = None
    """Measured distances of centers, rows of [other robot, distance, sd] or [other robot, distance,
    sd, source] [length unit]; the other robot is on an earlier line. Version 2."""

    directions: _Directions | None = None
    """Measured directions of contacts, rows of [own dock, other robot, other dock, x, y, z]: the
    unit vector in the own body frame from the center of the own dock to that of the other, whose
    robot is on an earlier line. Version 2."""

    connections: _Connections | None = None
    """Measured orientations of robots in contact, rows of [own dock, other robot, other dock, w, x,
    y, z]: a unit quaternion from the body of the other robot, which is on an earlier line, to the
    own body. Version 2."""

    touches: Touches | None = None
    """Contacts of unknown docks, rows of [own dock or null, other robot, other dock or null], at
    least one of them null; the other robot is on an earlier line. Version 2."""

    displacements: _Displacements | None = None
    """Measured vectors between centers, rows of [other robot, x, y, z, sd] [length unit]: from the
    own center to that of the other robot, which is on an earlier line, in the own body frame. The
    sd holds along each axis, beside the noise of the own orientation. Version 2."""

    flip_height: float | None = None
    """Height of the center that the flips imply [length unit]."""

    spawn_position: _Vector | None = None
    """Center at the first stance [length unit]."""

    stances: Annotated[list[StanceEntry], Field(fail_fast=True)] | None = None
    """Stances before the final one, in time order."""

    event: Literal["replace"] | None = None
    """Replace: this is the line of a robot that has one, and that has sensed more since. Version
    3."""


STANCE_LISTS = {
    "contacts": ("dock", "robot", "dock"),
    "ground_docks": ("dock",),
    "fixes": (*("number",) * 5, "source"),
    "ranges": ("robot", "number", "number", "source"),
    "directions": ("dock", "robot", "dock", *("number",) * 3),
    "connections": ("dock", "robot", "dock", *("number",) * 4),
    "touches": ("dock or null", "robot", "dock or null"),
    "displacements": ("robot", *("number",) * 4),
}
"""Lists of every stance, in the order in which they are written, and the numbers in an item.

The log has an array for each list: a row for each item, after a column that names the stance. A
dock that is null is -1 there, as is a source that is left out or null; others are indices."""

REPEATABLE = ("fixes", "ranges", "displacements")
"""Lists whose items may be equal: a device may measure twice, and get the same number."""

NEW_LISTS = ("fixes", "ranges", "directions", "connections", "touches", "displacements")
"""Lists that version 1 does not have."""

CONTACT_LISTS = ("contacts", "directions", "connections", "touches")
"""Lists whose items start with docks that touch: own dock, other robot, other dock."""

NEW_NOISE = ("direction_deg", "connection_deg")
"""Keys of the noise that version 1 does not have."""

ROBOT_NUMBERS: dict[str, float | list[float]] = {
    "flip_height": math.nan,
    "spawn_position": [math.nan] * 3,
}
"""Optional numbers of a robot, with the value that stands in the log where a line has none."""


_Model = TypeVar("_Model", bound=BaseModel)

Line = str | Mapping[str, object]
"""A line of a sensing file, as text or as the value of its JSON."""


def line_text(line: Line) -> str:
    """Write a line of a sensing file."""
    return line if isinstance(line, str) else json.dumps(line)


def parse_header(text: str) -> HeaderLine:
    """Read the first line; an InputError names the key at fault, but neither file nor line."""
    entries = parse_json(text)
    if entries.get("format") != FORMAT:
        problem = f'the first line is not a header; start it with {{"format": "{FORMAT}", ...'
        raise InputError(problem, key="format")
    version = entries.get("version", VERSIONS[-1])
    if type(version) is not int or version not in VERSIONS:
        known = f"{', '.join(map(str, VERSIONS[:-1]))} and {VERSIONS[-1]}"
        problem = f"{shown(version)} is not supported; this program reads versions {known}"
        raise InputError(problem, key="version")
    try:
        return HeaderLine.model_validate_json(text)  # Python values would be no SensingNoise
    except ValidationError as found:
        raise _mistake(found, HeaderLine) from found


def parse_robot(text: str) -> RobotLine:
    """Read the line of a robot that joins; errors as for `parse_header`."""
    entries = parse_json(text)
    if (event := entries.get("event")) is not None:
        problem = "is about a robot that has joined; give the line of one that joins"
        raise InputError(f"{shown(event)} {problem}", key="event")
    return parsed(entries, RobotLine)


def parsed(entries: dict[str, object], model: type[_Model]) -> _Model:
    """Check the content of a line; errors as for `parse_header`."""
    try:
        return model.model_validate(entries)
    except ValidationError as found:
        raise _mistake(found, model) from found


def _mistake(found: ValidationError, model: type[BaseModel]) -> InputError:
    """Describe all that is missing in a line, or else its first mistake."""
    errors = found.errors(include_url=False)
    missing = [dotted(error["loc"]) for error in errors if error["type"] == "missing"]
    if len(missing) > 1:
        return InputError("are missing; add them", key=", ".join(missing))
    error = errors[0]
    path = error["loc"]
    if path[-1:] == ("[key]",):  # a key itself is at fault, not its value
        path = path[:-2]
    noise = [field.name for field in fields(SensingNoise)]
    nested = {
        "stances": list(StanceEntry.model_fields),
        "noise": noise,
        "sources": list(SourceEntry.model_fields),
    }
    allowed = nested.get(str(path[0])) if path[1:] else None
    return InputError(explain(error, allowed or list(model.model_fields)), key=dotted(path))


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

    contacts: Annotated[Touches, Field(min_length=1)]
    """Rows of [own dock, other robot, other dock], null for a dock that is unknown. The line of one
    of the two robots has each."""


SensingLine = RobotLine | LeaveLine | ReleaseLine
"""A line after the header."""

_MODELS: dict[str, type[SensingLine]] = {
    "leave": LeaveLine,
    "release": ReleaseLine,
    "replace": RobotLine,
}


def parse_line(text: str, header: HeaderLine) -> SensingLine:
    """Read a line after this header; an InputError names the key, but neither file nor line."""
    entries = parse_json(text)
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
    return TypeAdapter(HeaderLine | SensingLine).json_schema()
