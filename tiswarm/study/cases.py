"""Cases of a scenario, and the structures that they share."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from tiswarm.scenario.expansion import Variant, variants
from tiswarm.scenario.model import Scenario

ROBOTS_AT_ONCE = 10_000
"""Cases are computed in batches of about this many robots, each stored before the next."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One structure, sensed and localized in one way; its seed is also that of all noise."""

    seed: int
    variant: Variant

    @property
    def name(self) -> str:
        """Folder of the case."""
        return f"{self.seed}-{self.variant.label}"

    @property
    def settings(self) -> Scenario:
        """Settings of the case, without its seed."""
        return self.variant.settings


def plan(scenario: Scenario) -> list[Case]:
    """List every case of a scenario in the order of its tables: by variant, then by seed."""
    points = variants(scenario)
    return [Case(seed=seed, variant=point) for point in points for seed in scenario.seed_list]


def point_cells(point: Mapping[str, Any]) -> dict[str, str]:
    """Write the values of a point of a sweep as YAML does, as `{kind: tower}` or `true`, by key."""
    return {key: json.dumps(value).replace('"', "") for key, value in point.items()}


def point_text(point: Mapping[str, Any]) -> str:
    """Write a point of a sweep in one line, as `robots=300, structure={kind: tower}`."""
    return ", ".join(f"{key}={value}" for key, value in point_cells(point).items())


def series_text(point: Mapping[str, Any], condition: str) -> str:
    """Name the cases of a point and a condition, which differ by their seeds alone."""
    return ", ".join(filter(None, [point_text(point), condition]))


def structure_kind(settings: Scenario) -> tuple[int, str]:
    """Return all that determines a structure but its seed: size and settings."""
    # Small structures sort first: they finish early, and need no memory that large ones took.
    return settings.robots, repr((settings.structure, settings.robot))


def structure_key(case: Case) -> tuple[int, str, int]:
    """Return all that determines the structure of a case: size, settings and seed."""
    return (*structure_kind(case.settings), case.seed)


def structures(cases: Sequence[Case]) -> list[list[Case]]:
    """List cases by the structure that they share, structures of one kind side by side."""
    ordered = sorted(cases, key=structure_key)
    return [list(group) for _, group in groupby(ordered, key=structure_key)]


def batches(cases: Sequence[Case], robots_at_once: int = ROBOTS_AT_ONCE) -> Iterator[list[Case]]:
    """Split cases into batches whose structures are of one kind and grow together.

    All conditions of a structure are in the same batch, so each structure is grown once. A batch
    ends when its structures have `robots_at_once` robots.
    """
    for _, alike in groupby(structures(cases), key=lambda group: structure_kind(group[0].settings)):
        batch: list[Case] = []
        robots = 0
        for group in alike:
            batch += group
            robots += group[0].settings.robots
            if robots >= robots_at_once:
                yield batch
                batch, robots = [], 0
        if batch:
            yield batch


def halves(batch: Sequence[Case]) -> list[list[Case]]:
    """Split a batch in two, between structures if it has several."""
    seeds = sorted({case.seed for case in batch})
    if len(seeds) > 1:
        middle = seeds[len(seeds) // 2]
        return [[c for c in batch if c.seed < middle], [c for c in batch if c.seed >= middle]]
    return [list(batch[: len(batch) // 2]), list(batch[len(batch) // 2 :])]


def shard(cases: Sequence[Case], number: int, count: int) -> list[Case]:
    """Return the cases of share `number`, counted from 1, of `count` shares of the structures."""
    mine = {c.name for group in structures(cases)[number - 1 :: count] for c in group}
    return [case for case in cases if case.name in mine]
