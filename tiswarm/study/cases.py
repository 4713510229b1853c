"""Which cases a scenario asks for, and which of them share a structure."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from tiswarm.scenario import Scenario, Variant, variants

ROBOTS_AT_ONCE = 10_000
"""Cases are worked off in chunks of about this many robots, each stored before the next."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One structure, sensed and localized in one way."""

    seed: int
    """Seed of the structure and of every noise."""

    variant: Variant

    @property
    def name(self) -> str:
        """Folder of the case."""
        return f"{self.seed}-{self.variant.label}"

    @property
    def settings(self) -> Scenario:
        """Everything the case is computed from, but the seed."""
        return self.variant.settings


def point_text(point: Mapping[str, Any]) -> str:
    """Write a point of a sweep in one line, as `robots=300, structure={kind: tower}`."""
    values = [json.dumps(value).replace('"', "") for value in point.values()]
    return ", ".join(f"{key}={value}" for key, value in zip(point, values, strict=True))


def series_text(point: Mapping[str, Any], condition: str) -> str:
    """Name all cases of a point and a condition, whose seeds alone differ."""
    return ", ".join(filter(None, [point_text(point), condition]))


def plan(scenario: Scenario) -> list[Case]:
    """List every case of a scenario, in the order of its tables: by variant, then by seed."""
    return [
        Case(seed=seed, variant=variant)
        for variant in variants(scenario)
        for seed in scenario.seed_list
    ]


def chunks(cases: Sequence[Case], robots_at_once: int = ROBOTS_AT_ONCE) -> Iterator[list[Case]]:
    """Split cases into lists that grow structures of one kind together.

    All conditions of a structure are in the same chunk, so each is grown once. A chunk is closed
    once its structures have `robots_at_once` robots.
    """
    for _, alike in groupby(structures(cases), key=lambda group: structure_key(group[0])[:2]):
        chunk: list[Case] = []
        robots = 0
        for group in alike:
            chunk += group
            robots += group[0].settings.robots
            if robots >= robots_at_once:
                yield chunk
                chunk, robots = [], 0
        if chunk:
            yield chunk


def robots_to_grow(cases: Sequence[Case]) -> int:
    """Count the robots of all structures, each of which is grown once."""
    return sum(group[0].settings.robots for group in structures(cases))


def halves(chunk: Sequence[Case]) -> list[list[Case]]:
    """Split a chunk in two, between structures if it has several."""
    seeds = sorted({case.seed for case in chunk})
    if len(seeds) > 1:
        middle = seeds[len(seeds) // 2]
        parts = [[c for c in chunk if c.seed < middle], [c for c in chunk if c.seed >= middle]]
    else:
        parts = [list(chunk[: len(chunk) // 2]), list(chunk[len(chunk) // 2 :])]
    return parts


def shard(cases: Sequence[Case], number: int, count: int) -> list[Case]:
    """Deal structures out and return the cases of one share, in their order.

    Args:
        cases: All cases.
        number: Which share, from 1.
        count: How many shares there are.
    """
    mine = {c.name for group in structures(cases)[number - 1 :: count] for c in group}
    return [case for case in cases if case.name in mine]


def structure_key(case: Case) -> tuple[int, str, int]:
    """Return all that the structure of a case grows from: its size, its settings and its seed."""
    settings = case.settings
    # The small ones first: they are done soon, and memory that large ones took is not theirs.
    return (settings.robots, repr((settings.structure, settings.robot)), case.seed)


def structures(cases: Sequence[Case]) -> list[list[Case]]:
    """List cases by the structure they share, structures of one kind side by side."""
    return [
        list(group) for _, group in groupby(sorted(cases, key=structure_key), key=structure_key)
    ]
