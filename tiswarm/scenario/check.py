"""From plain data to a scenario, or to a list of mistakes, each with its place."""

import json
from functools import cache
from typing import NamedTuple

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from tiswarm.records.messages import UNKNOWN_KEY, Part, explain
from tiswarm.scenario.model import ADAPTER, Plain, Scenario

CHOICES = {"structure": "kind", "localization": "method"}
"""Sections of which there are several sorts, and the key that says which."""

SMALLEST: Plain = {"name": "smallest", "structure": {"kind": "tower"}}
"""A scenario that leaves everything else at its default."""

REMOVED: dict[tuple[Part, ...], str] = {
    ("scorecard",): "scenarios have no such key any more; remove it and compare the structures "
    "with published laws by python -m benchmarks.reactivebuild SCENARIO",
}
"""Keys of earlier versions, and what to do about them."""

_SORTED = {*CHOICES, "seeds"}
"""Values for which pydantic names the sort it tried, after the key."""


class Mistake(NamedTuple):
    """One thing that is wrong."""

    path: tuple[Part, ...]
    problem: str
    about_key: bool = False
    """Whether the key itself is wrong, not the value."""


def validated(data: Plain) -> Scenario | list[Mistake]:
    """Build a scenario from plain data, or say everything that is wrong with it."""
    if data.get("scorecard") == "none":  # earlier versions wrote this into every run folder
        data = {key: value for key, value in data.items() if key != "scorecard"}
    localization = data.get("localization")
    if isinstance(localization, dict):
        data = {**data, "localization": {"method": "virtual-force", **localization}}
    try:
        # As JSON, so that lists become tuples and mappings become parameters, strict as we are.
        return ADAPTER.validate_json(json.dumps(data))
    except ValidationError as found:
        return [_mistake(error) for error in found.errors(include_url=False)]


@cache
def scenario_schema() -> Plain:
    """JSON Schema of a scenario file, for editors."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return {**dialect, **ADAPTER.json_schema()}


def _mistake(error: ErrorDetails) -> Mistake:
    path = error["loc"]
    about_key = error["type"] in UNKNOWN_KEY or path[-1:] == ("[key]",)
    if path[-1:] == ("[key]",):
        path = path[:-1]
    elif path and path[0] in _SORTED:
        path = (path[0], *path[2:])
    if error["type"] in {"union_tag_invalid", "union_tag_not_found"}:
        path = (path[0], CHOICES[str(path[0])])
    problem = REMOVED.get(path) or explain(error, _allowed(error["loc"]))
    return Mistake(path, problem, about_key)


def _allowed(path: tuple[Part, ...]) -> tuple[str, ...]:
    """Keys that may stand in the section that holds the value at a path."""
    section: Plain = scenario_schema()
    for part in path[:-1]:
        sorts = section.get("discriminator", {}).get("mapping", {})
        section = section.get("properties", {}).get(part) or {"$ref": sorts.get(part, "")}
        section = _definition(section)
    return tuple(section.get("properties", ()))


def _definition(section: Plain) -> Plain:
    sorts = [section, *section.get("anyOf", ())]  # a section that may be null is one of two
    name = next((sort["$ref"] for sort in sorts if "$ref" in sort), "").rpartition("/")[2]
    found: Plain = scenario_schema()["$defs"].get(name, section)
    return found
