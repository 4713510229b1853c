"""Lines of a sensing file after the header: robots, and events, which say what changed later.

An event is about robots on earlier lines. The log is that of the swarm after all of its events.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, Field, TypeAdapter

from tiswarm.base.errors import InputError
from tiswarm.base.params import STRICT
from tiswarm.records.messages import did_you_mean, shown
from tiswarm.records.sensing_format import (
    HeaderLine,
    Name,
    RobotLine,
    Touches,
    parse_json,
    parsed,
)

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
