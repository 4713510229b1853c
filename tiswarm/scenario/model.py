"""The scenario: its keys, its question, its text and its hash.

Each section is defined in the room that uses it.
"""

import json
import re
from collections import Counter
from dataclasses import field
from hashlib import sha256
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    JsonValue,
    Tag,
    TypeAdapter,
    ValidationInfo,
    field_validator,
)
from pydantic.dataclasses import dataclass

from tiswarm.base.params import STRICT, UNLESS_SET, Arch
from tiswarm.base.robot import RobotGeometry
from tiswarm.base.sections import Described, mistake_at
from tiswarm.localization.methods import LocalizationParams
from tiswarm.records.run_folder import LABEL
from tiswarm.scenario import validation
from tiswarm.scenario.labels import BASELINE, labels_of, swept_keys, without_label
from tiswarm.scenario.yaml_source import plain_scalar
from tiswarm.sensing import SensingParams
from tiswarm.world.params import StructureParams, anchor_fault, ground_fault

Question = Annotated[
    Literal["least-error", "reached", "traffic", "cues", "sizes"],
    Field(
        description="What the table of results, which `run` prints at its end, has beside errors. "
        "`least-error`: nothing. `reached`: heights, reaches and depths of structures, and bridges "
        "closed. `traffic`: bytes that a robot sends. `cues`: changes from the first condition. "
        "`sizes`: the power of the number of robots as which RMSE grows."
    ),
]
"""A question as a key of a scenario."""


_SWEEP_SECTIONS = (
    *("robots", "seeds", "precision", "arch", "threads", "workers"),
    *("robot", "structure", "sensing", "localization"),
)
_SLUG = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9._-]{0,98}[A-Za-z0-9_-])?")
_LONGEST = 60
_Values = TypeVar("_Values", bound=tuple[Any, ...])


def _slug(text: str) -> str:
    if not _SLUG.fullmatch(text):
        raise ValueError(f"{text!r} cannot name a folder; use letters, digits, '-', '_' and '.'")
    return text


def _condition_key(key: str) -> str:
    if key != LABEL and key.partition(".")[0] not in validation.CONDITION_SECTIONS:
        message = "conditions change localization and sensing only; use sweep for the rest"
        raise ValueError(message)
    return key


def _labeled(conditions: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    _check_labels([entries.get(LABEL, name) for name, entries in conditions.items()], "conditions")
    return conditions


def _check_labels(labels: list[Any], named: str) -> None:
    counts = Counter(label for label in labels if isinstance(label, str))
    for label in labels:
        if not (isinstance(label, str) and label.isprintable() and 1 <= len(label) <= _LONGEST):
            raise ValueError(f"label {label!r}: give a text of 1 to {_LONGEST} letters")
        if counts[label] > 1:
            raise ValueError(f"two {named} have the label {label}; give each its own")


def _sweep_key(entry: str) -> str:
    if any(key.partition(".")[0] not in _SWEEP_SECTIONS for key in swept_keys(entry)):
        raise ValueError(f"cannot be swept; sweep {', '.join(_SWEEP_SECTIONS)} or keys in them")
    return entry


def _distinct(values: _Values) -> _Values:
    seen = set()
    for text in [json.dumps(value, sort_keys=True) for value in values]:
        if text in seen:
            raise ValueError(f"{text} occurs twice; give each value once")
        seen.add(text)
    return values


def _labeled_rows(values: _Values) -> _Values:
    _check_labels([label for value in values for label in labels_of(value)], "rows")
    return values


_Slug = Annotated[str, AfterValidator(_slug)]
_SEEDS = 2**63  # number of seeds that there are
_Seed = Annotated[int, Field(ge=0, lt=_SEEDS)]
_SeedCount = Annotated[int, Field(ge=1, le=1_000_000), Tag("count")]
_SeedList = Annotated[
    tuple[_Seed, ...], Field(min_length=1), AfterValidator(_distinct), Tag("list")
]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SeedRange:
    """Consecutive seeds."""

    first: _Seed
    """The first seed."""

    count: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of seeds."""

    def __post_init__(self) -> None:
        """Refuse seeds that no other form of the key may have."""
        if self.first + self.count > _SEEDS:
            raise ValueError(f"the last seed is greater than {_SEEDS - 1}; give a smaller first")


def _form_of_seeds(seeds: object) -> str:
    if isinstance(seeds, (dict, SeedRange)):
        return "range"
    return "list" if isinstance(seeds, (list, tuple)) else "count"


_Seeds = Annotated[
    _SeedCount | _SeedList | Annotated[SeedRange, Tag("range")], Discriminator(_form_of_seeds)
]
_Overrides = dict[Annotated[str, AfterValidator(_condition_key)], JsonValue]
_SweepValues = Annotated[
    tuple[JsonValue, ...],
    Field(min_length=1),
    AfterValidator(_distinct),
    AfterValidator(_labeled_rows),
]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Scenario:
    """A reproducible study: structures to grow, and ways to localize their robots."""

    name: _Slug
    """Name of the study, with which its result folder starts."""

    description: str = ""
    """Purpose of the study."""

    question: Question = "least-error"

    robots: Annotated[int, Field(ge=2, lt=2**31)] = 100
    """Robots in each structure."""

    seeds: _Seeds = 1
    """Random seeds, one structure each: a list, a number n for 0 to n - 1, or a range
    `{first: 1000, count: n}`."""

    precision: Literal["auto", "f64", "f32"] = "auto"
    """Floating-point type of `joint`, and of `virtual-force` under the schedule `together`; all
    else computes in f64. `auto` takes f64 on processors, where f32 is slower, and on cards that
    compute it at half the rate of f32, else f32."""

    arch: Annotated[Arch | None, UNLESS_SET] = None
    """Device of methods that are parallel; that of the command if left out."""

    threads: Annotated[int | None, Field(ge=1), UNLESS_SET] = None
    """CPU threads of all stages; those of the command if left out. No result depends on them."""

    workers: Annotated[int | None, Field(ge=1), UNLESS_SET] = None
    """Processes that compute structures at the same time; as the command says if left out. No
    result depends on them."""

    robot: RobotGeometry = RobotGeometry()
    """Geometry of a robot."""

    structure: StructureParams
    """Structure to grow."""

    sensing: SensingParams = SensingParams()
    """What the robots sense, with which noise."""

    localization: LocalizationParams
    """Localization method and its settings; `{method: none}` measures structures alone."""

    @field_validator("localization")
    @classmethod
    def _fit_structure(cls, method: LocalizationParams, info: ValidationInfo) -> object:
        structure = info.data.get("structure")
        navigates = structure and structure.navigate_by == "estimate"
        if navigates and not method.places_robots:
            problem = (
                "robots navigate by estimates (structure.navigate_by), which none does not make"
            )
            raise mistake_at(("method",), f"{problem}; choose joint")
        return method

    conditions: Annotated[
        dict[_Slug, _Overrides], Field(min_length=1), AfterValidator(_labeled)
    ] = field(default_factory=lambda: {BASELINE: {}})
    """By name, settings of `localization.*` and `sensing.*` that differ from those above. All
    conditions run on the same structures. Pages and figures show a condition's `label`, if any."""

    sweep: dict[Annotated[str, AfterValidator(_sweep_key)], _SweepValues] = field(
        default_factory=dict
    )
    """By dotted key, values to run in all combinations. Keys that change together share an entry
    with a row of values for each point, which the first key names:
    `robots, structure.movers: [[100, 1], [1000, 10]]`. A mapping may have a `label`, which pages
    and figures show."""

    @field_validator("structure")
    @classmethod
    def _keep_docks_in_plane(cls, structure: StructureParams, info: ValidationInfo) -> object:
        if structure.plane and not info.data.get("robot", RobotGeometry()).is_flat:
            raise ValueError("in a plane robots are flat; use another robot.shape, or plane: false")
        return structure

    @field_validator("structure")
    @classmethod
    def _place_anchors(cls, structure: StructureParams, info: ValidationInfo) -> object:
        robots = info.data.get("robots")
        robot = info.data.get("robot")
        if not robots or not robot:
            return structure
        fault = anchor_fault(structure, robots, robot)
        if fault:
            raise mistake_at(("anchors",), fault)
        return structure

    @field_validator("structure")
    @classmethod
    def _start_on_ground(cls, structure: StructureParams, info: ValidationInfo) -> object:
        shape = info.data.get("robot")
        if shape and (fault := ground_fault(structure, shape)):
            raise mistake_at(("terrain",), fault)
        return structure

    @property
    def seed_list(self) -> tuple[int, ...]:
        """The seeds, one by one."""
        if isinstance(self.seeds, SeedRange):
            return tuple(range(self.seeds.first, self.seeds.first + self.seeds.count))
        return tuple(range(self.seeds)) if isinstance(self.seeds, int) else self.seeds


ADAPTER = TypeAdapter(Scenario)


def from_plain(data: validation.Plain) -> Scenario | list[validation.Mistake]:
    """Build a scenario from plain data, or list every mistake in it."""
    return validation.validate(ADAPTER, data)


def to_plain(scenario: Scenario) -> validation.Plain:
    """Convert a scenario to plain data, every default included."""
    data: validation.Plain = ADAPTER.dump_python(scenario, mode="json")
    return data


def _stated(scenario: Scenario) -> validation.Plain:
    """Convert a scenario to what its file states: studies of the engine have no structure."""
    data = to_plain(scenario)
    if scenario.localization.runs_engine:
        del data["structure"], data["sensing"]
    return data


def scenario_schema() -> validation.Plain:
    """Return the JSON Schema of a scenario file, for editors."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema = ADAPTER.json_schema(schema_generator=Described)
    schema["required"].remove("structure")  # studies of the engine have none
    return {**dialect, **schema}


class _Dumper(yaml.SafeDumper):
    """Repeats equal values, and quotes text that would not be read as text."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(plain_scalar(text), str) else "'"
    if not text.isprintable():  # some line breaks do not survive other styles
        style = '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


def dump_scenario(scenario: Scenario) -> str:
    """Write a scenario as YAML with every default; it loads back to an equal scenario."""
    data = _stated(scenario)
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def scenario_hash(scenario: Scenario) -> str:
    """Hash a scenario without its description, question and labels to eight hex digits.

    The order of keys, comments and defaults written out make no difference.
    """
    data = _stated(scenario)
    del data["description"], data["question"]
    for entries in data["conditions"].values():
        entries.pop(LABEL, None)
    data["sweep"] = {
        entry: [
            [*map(without_label, row)] if isinstance(row, list) else without_label(row)
            for row in rows
        ]
        for entry, rows in data["sweep"].items()
    }
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return sha256(text.encode()).hexdigest()[:8]
