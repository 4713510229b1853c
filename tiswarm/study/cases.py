"""Cases of a scenario, listed once in the order of tables and sorted once to be computed."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from tiswarm.scenario.expansion import Variant, variants
from tiswarm.scenario.model import Scenario


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

    @property
    def structure_key(self) -> tuple[int, str, int]:
        """All that determines the structure of the case: size, settings and seed."""
        return (*structure_kind(self.settings), self.seed)


Group = Sequence[Case]
"""Cases that share a structure."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All cases of a scenario, in both of their orders."""

    cases: Sequence[Case]
    """In the order of tables: by variant, then by seed."""

    structures: Sequence[Group]
    """In the order of computation, by the structure that they share; those of one kind, which
    differ by their seeds, are side by side."""


def plan(scenario: Scenario) -> Plan:
    """List every case of a scenario."""
    points, seeds = variants(scenario), scenario.seed_list
    cases = [Case(seed=seed, variant=point) for point in points for seed in seeds]
    kinds = {point.label: structure_kind(point.settings) for point in points}

    def key(case: Case) -> tuple[tuple[int, str], int]:
        return kinds[case.variant.label], case.seed

    shared = groupby(sorted(cases, key=key), key=key)
    return Plan(cases=cases, structures=[tuple(group) for _, group in shared])


def structure_kind(settings: Scenario) -> tuple[int, str]:
    """Return all that determines a structure but its seed: size and settings."""
    # Small structures sort first: they finish early, and need no memory that large ones took.
    structure = settings.structure
    by_estimate = structure.navigate_by == "estimate"
    known = (settings.sensing, settings.localization) if by_estimate else ()
    return settings.robots, repr((structure, settings.robot, *known))
