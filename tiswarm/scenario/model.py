"""What a scenario says, and that as text.

The parameters themselves are defined in the rooms that use them.
"""

import json
import re
from dataclasses import field
from hashlib import sha256
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import AfterValidator, Discriminator, Field, JsonValue, Tag, TypeAdapter
from pydantic.dataclasses import dataclass

from tiswarm.localization.params import LocalizationParams, VirtualForceParams
from tiswarm.params import STRICT
from tiswarm.robot import RobotGeometry
from tiswarm.scenario.document import plain_scalar
from tiswarm.sensing import SensingParams
from tiswarm.world.params import StructureParams

Plain = dict[str, Any]
"""A scenario, or a part of it, as it would stand in a file."""

CONDITION_SECTIONS = ("localization", "sensing")
SWEEP_SECTIONS = ("robots", "precision", "robot", "structure", "sensing", "localization")

_SLUG = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9._-]{0,98}[A-Za-z0-9_-])?")
_Values = TypeVar("_Values", bound=tuple[Any, ...])


def _slug(text: str) -> str:
    if not _SLUG.fullmatch(text):
        message = f"{text!r} cannot name a folder; use letters, digits, '-', '_' and '.'"
        raise ValueError(message)
    return text


def _condition_key(key: str) -> str:
    if key.partition(".")[0] not in CONDITION_SECTIONS or "." not in key:
        message = "conditions change localization.* and sensing.* only; use sweep for the rest"
        raise ValueError(message)
    return key


def swept_keys(entry: str) -> list[str]:
    """Keys that an entry of the sweep sets: one, or several that change together."""
    return [key.strip() for key in entry.split(",")]


def _sweep_key(entry: str) -> str:
    if any(key.partition(".")[0] not in SWEEP_SECTIONS for key in swept_keys(entry)):
        message = f"this cannot be swept; sweep {', '.join(SWEEP_SECTIONS)} or what is in them"
        raise ValueError(message)
    return entry


def _distinct(values: _Values) -> _Values:
    seen = set()
    for value in values:
        text = json.dumps(value, sort_keys=True)
        if text in seen:
            message = f"{text} stands twice; give each value once"
            raise ValueError(message)
        seen.add(text)
    return values


def _count_or_list(seeds: object) -> str:
    return "list" if isinstance(seeds, (list, tuple)) else "count"


Slug = Annotated[str, AfterValidator(_slug)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
SeedCount = Annotated[int, Field(ge=1, le=1_000_000)]
SeedList = Annotated[tuple[Seed, ...], Field(min_length=1), AfterValidator(_distinct)]
Seeds = Annotated[
    Annotated[SeedCount, Tag("count")] | Annotated[SeedList, Tag("list")],
    Discriminator(_count_or_list),
]
Overrides = dict[Annotated[str, AfterValidator(_condition_key)], JsonValue]
SweepValues = Annotated[tuple[JsonValue, ...], Field(min_length=1), AfterValidator(_distinct)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Scenario:
    """One reproducible study: structures to grow, and ways to localize their robots."""

    name: Slug
    """Name of the study; the folder of its results starts with it."""

    description: str = ""
    """What the study is for, in words."""

    robots: Annotated[int, Field(ge=2, lt=2**31)] = 100
    """Robots in each structure."""

    seeds: Seeds = 1
    """Random seeds, one structure each: a count from 0 up, or a list."""

    precision: Literal["f64", "f32"] = "f64"
    """Floating point numbers of the localizer; structures always grow in f64."""

    robot: RobotGeometry = RobotGeometry()
    """Geometry of a robot."""

    structure: StructureParams
    """What is grown."""

    sensing: SensingParams = SensingParams()
    """What the robots feel of it."""

    localization: LocalizationParams = VirtualForceParams()
    """How the robots find out where they are."""

    conditions: Annotated[dict[Slug, Overrides], Field(min_length=1)] = field(
        default_factory=lambda: {"baseline": {}}
    )
    """By name, settings of `localization.*` and `sensing.*` that differ from those above; each
    is run on the same structures."""

    sweep: dict[Annotated[str, AfterValidator(_sweep_key)], SweepValues] = field(
        default_factory=dict
    )
    """By dotted key, values to be run one after another, in all combinations. Keys that change
    together stand in one entry, as `robots, structure.movers: [[100, 1], [1000, 10]]`: a row a
    point, which the first key names."""

    @property
    def seed_list(self) -> tuple[int, ...]:
        """Every seed."""
        return tuple(range(self.seeds)) if isinstance(self.seeds, int) else self.seeds


ADAPTER = TypeAdapter(Scenario)


def plain(scenario: Scenario) -> Plain:
    """Turn a scenario into plain data, every default written out."""
    document: Plain = ADAPTER.dump_python(scenario, mode="json")
    return document


class _Dumper(yaml.SafeDumper):
    """Writes values out wherever they occur, and quotes text that would not read as text."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(plain_scalar(text), str) else "'"
    if not text.isprintable():  # some line breaks do not survive other styles
        style = '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


def dump_scenario(scenario: Scenario) -> str:
    """Write a scenario as YAML, every default included; it loads back to an equal scenario."""
    data = plain(scenario)
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def scenario_hash(scenario: Scenario) -> str:
    """Eight hex digits that stand for all a scenario says, but for its description.

    The order of keys, comments and what was left at its default make no difference.
    """
    data = plain(scenario)
    del data["description"]
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return sha256(text.encode()).hexdigest()[:8]
