"""The lines of a sensing file: a header, then one robot a line, each a JSON object.

An optional key may be left out or null.
"""

import json
from collections import Counter
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tiswarm.errors import InputError
from tiswarm.records.wording import dotted, explain, shown

FORMAT = "tiswarm-sensing"
VERSION = 1

RobotName = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Contact = Annotated[list[int], Field(min_length=3, max_length=3)]
Contacts = Annotated[list[Contact], Field(fail_fast=True)]
Docks = Annotated[list[int], Field(fail_fast=True)]
Spread = Annotated[float, Field(ge=0.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class _Line(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


class NoiseEntry(_Line):
    """How wrong the senses are; keys as `SensingNoise` explains them."""

    tilt_deg: Spread
    yaw_deg: Spread
    yaw_bias_deg: Spread | None = None
    spawn: Spread | None = None
    missed_contacts: Fraction | None = None
    wrong_docks: Fraction | None = None
    false_contacts: Fraction | None = None


class HeaderLine(_Line):
    """What holds for all robots; keys in the order they are written."""

    format: Literal["tiswarm-sensing"]
    version: Literal[1]
    dock_radius: Annotated[float, Field(gt=0.0)]
    dock_offsets: Annotated[list[Vector], Field(min_length=1, fail_fast=True)]
    anchor_position: Vector
    ground_z: float | None
    length_unit: Annotated[str, Field(min_length=1)]
    noise: NoiseEntry | None = None


class StanceEntry(_Line):
    """One stance before the final one."""

    orientation_wxyz: Quaternion
    pivot_dock: int
    contacts: Contacts = []
    ground_docks: Docks | None = None


class RobotLine(_Line):
    """One robot, at its final stance and at those before."""

    robot: RobotName
    orientation_wxyz: Quaternion
    contacts: Contacts
    ground_docks: Docks | None = None
    flip_height: float | None = None
    spawn_position: Vector | None = None
    stances: Annotated[list[StanceEntry], Field(fail_fast=True)] | None = None


_Model = TypeVar("_Model", HeaderLine, RobotLine)
_NESTED: dict[str | int, type[_Line]] = {"stances": StanceEntry, "noise": NoiseEntry}


def parse_header(text: str) -> HeaderLine:
    """Read the first line.

    Raises:
        InputError: with the key at fault, but without file and line.
    """
    entries = _parse_json(text)
    if entries.get("format") != FORMAT:
        problem = f'the first line is not a header; start it with {{"format": "{FORMAT}", ...'
        raise InputError(problem, key="format")
    version = entries.get("version")
    if type(version) is not int or version != VERSION:
        problem = f"{shown(version)} is not supported; this program reads version {VERSION}"
        raise InputError(problem, key="version")
    return _validate(entries, HeaderLine)


def parse_robot(text: str) -> RobotLine:
    """Read any line but the first.

    Raises:
        InputError: with the key at fault, but without file and line.
    """
    return _validate(_parse_json(text), RobotLine)


def _validate(entries: dict[str, object], model: type[_Model]) -> _Model:
    try:
        return model.model_validate(entries)
    except ValidationError as found:
        error = found.errors(include_url=False)[0]
    place = error["loc"]
    section = _NESTED.get(place[0], model) if len(place) > 1 else model
    raise InputError(explain(error, section.model_fields), key=dotted(place))


def _parse_json(text: str) -> dict[str, object]:
    if not text.strip():
        problem = "the line is empty; delete it"
        raise InputError(problem)
    try:
        entries = _DECODER.decode(text)
    except json.JSONDecodeError as error:
        problem = f"not JSON at column {error.colno}: {error.msg}; write one JSON object a line"
        raise InputError(problem) from error
    except (ValueError, RecursionError) as error:
        problem = "nested too deep, or a number of thousands of digits; write one robot a line"
        raise InputError(problem) from error
    if not isinstance(entries, dict):
        problem = f"{shown(entries)} is not a JSON object; write the line as {{...}}"
        raise InputError(problem)
    return entries


def _without_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = counts.most_common(1)[0][0]
        problem = "the key stands twice in one object; keep one of the two"
        raise InputError(problem, key=dotted([twice]))
    return entries


_DECODER = json.JSONDecoder(object_pairs_hook=_without_duplicates)
