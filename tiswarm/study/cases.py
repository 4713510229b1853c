"""Which cases a scenario asks for, and which of them share a structure."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from tiswarm.scenario import Scenario, Variant, variants

ROBOTS_AT_ONCE = 10_000
"""Cases are worked off in chunks of about this many robots, each stored before the next."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One structure, sensed and localized in one way."""

    seed: int
    """Seed of the structure and of every noise."""

    variant: Variant
    """Sweep point and condition, with the settings they come to."""

    @property
    def name(self) -> str:
        """Folder of the case."""
        return f"{self.seed}-{self.variant.label}"

    @property
    def settings(self) -> Scenario:
        """Everything the case is computed from, but the seed."""
        return self.variant.settings


def plan(scenario: Scenario) -> list[Case]:
    """List every case of a scenario, in the order of its tables: by variant, then by seed."""
    return [
        Case(seed=seed, variant=variant)
        for variant in variants(scenario)
        for seed in scenario.seed_list
    ]


def chunks(cases: Sequence[Case]) -> Iterator[list[Case]]:
    """Split cases into lists that grow structures of one kind together.

    All conditions of a structure are in the same chunk, so each is grown once.
    """

    def kind(case: Case) -> tuple[str, int, int]:
        settings = case.settings
        return (repr((settings.structure, settings.robot)), settings.robots, case.seed)

    ordered = sorted(cases, key=kind)
    structures = [list(group) for _, group in groupby(ordered, key=kind)]
    for _, alike in groupby(structures, key=lambda group: kind(group[0])[:2]):
        chunk: list[Case] = []
        robots = 0
        for group in alike:
            chunk += group
            robots += group[0].settings.robots
            if robots >= ROBOTS_AT_ONCE:
                yield chunk
                chunk, robots = [], 0
        if chunk:
            yield chunk
