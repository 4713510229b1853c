"""Candidates of a design: a scenario with every combination of some values.

Keys of `sensing` make sensor suites. Keys of `structure`, `robot` and `robots` make structures.
"""

import itertools
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, Literal

from tiswarm.base.errors import InputError, require_name
from tiswarm.localization.settings import LARGE
from tiswarm.records.messages import counted, shown
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.scenario.model import Scenario, SeedRange, to_plain
from tiswarm.scenario.validation import DISCRIMINATORS
from tiswarm.study.design.goals import Goal
from tiswarm.study.design.prices import Prices

Part = Literal["sensing", "growth"]
"""What is designed: sensors of the robots, or how structures grow."""

PRICE = "price"
"""Name of the result that is the price of a candidate."""

Values = Mapping[str, Any]
"""Values by dotted key."""

_SECTIONS: Mapping[Part, tuple[str, ...]] = {
    "sensing": ("sensing",),
    "growth": ("structure", "robot", "robots"),
}
_LONGEST_NAME = 80
"""Letters of a scenario's name that the names of its designs begin with."""

_UNSEEN = ("drift", "drift_deg", "stuck")
"""Failures that logs do not state: no expected error depends on them."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One combination of values."""

    point: Values
    """Its values by key."""

    settings: Scenario
    """The scenario with these values."""

    price: float
    """Sum of the prices of its values; 0 without prices."""


def base_scenario(scenario: Scenario, condition: str | None) -> Scenario:
    """Return a scenario as one of its conditions has it, without conditions.

    Args:
        scenario: Scenario of a user.
        condition: Name of the condition; the only one if None.

    Raises:
        InputError: there is no such condition, several without a choice, or a sweep.
    """
    names = [*scenario.conditions]
    if scenario.sweep:
        problem = "a design varies keys of its own; leave it out, as by --set sweep={}"
        raise InputError(problem, key="sweep")
    if condition is None and len(names) > 1:
        problem = f"the scenario has several; choose one of {', '.join(names)}"
        raise InputError(problem, argument="condition")
    chosen = names[0] if condition is None else condition
    require_name(chosen, names, "condition")
    settings = next(one.settings for one in variants(scenario) if one.condition == chosen)
    if settings.localization.runs_engine:
        problem = "relax moves robots from where they start; name a scenario that grows structures"
        raise InputError(problem, key="localization.method")
    return settings


def part_of(keys: Sequence[str]) -> Part:
    """Return what some keys belong to.

    Raises:
        InputError: there is no key, or one belongs to another part, or to none.
    """
    if not keys:
        problem = "is missing; write it like sensing.tilt_noise_deg=1,2,4"
        raise InputError(problem, argument="vary")
    parts: dict[Part, str] = {}
    for key in keys:
        section, dot, setting = key.partition(".")
        part: Part = "sensing" if section in _SECTIONS["sensing"] else "growth"
        is_whole = (section == "robots") == bool(dot)
        if section not in _SECTIONS[part] or is_whole:
            problem = "vary robots, or keys of sensing, structure or robot, such as sensing.stances"
            raise InputError(f"{key}: {problem}", argument="vary")
        if part == "sensing" and setting in _UNSEEN:
            problem = "logs do not state such failures, so no error is predicted; leave it out"
            raise InputError(f"{key}: {problem}", argument="vary")
        parts.setdefault(part, key)
    if len(parts) > 1:
        problem = "vary sensing alone or growth alone; first growth, then sensing on its design"
        raise InputError(f"{parts['sensing']}: {problem}", argument="vary")
    return next(iter(parts))


def list_candidates(
    base: Scenario, vary: Mapping[str, Sequence[Any]], prices: Prices | None
) -> list[Candidate]:
    """List the candidates of a scenario, the last key changing fastest.

    Args:
        base: Scenario without conditions and sweep.
        vary: Values by dotted key.
        prices: Prices of all these values; none if None.

    Raises:
        InputError: a key or value is wrong, or a value has no price.
    """
    try:
        swept = load_scenario(_swept(base, vary))
    except InputError as error:
        key = error.key.removeprefix("sweep.")
        raise InputError(f"{key}: {error.problem}", argument="vary") from error
    candidates = []
    combinations = itertools.product(*vary.values())
    for point, combination in zip(variants(swept), combinations, strict=True):
        values = dict(zip(vary, combination, strict=True))
        price = 0.0 if prices is None else prices.of_values(values)
        settings = replace(point.settings, seeds=base.seeds)
        candidates.append(Candidate(point=values, settings=settings, price=price))
    return candidates


def _swept(base: Scenario, vary: Mapping[str, Sequence[Any]]) -> dict[str, Any]:
    """Return a scenario with a sweep of some values, as plain data, without these keys before."""
    data = deepcopy(to_plain(base))
    for key in vary:
        *sections, last = key.split(".")
        section: Any = data
        for name in sections:
            section = section.get(name) if isinstance(section, dict) else None
        selects = sections[:1] and DISCRIMINATORS.get(sections[0]) == last
        if isinstance(section, dict) and not selects:
            section.pop(last, None)
    return {**data, "sweep": {key: [*values] for key, values in vary.items()}}


def study_of(candidate: Candidate, number: int, *, first_seed: int, count: int) -> Scenario:
    """Return the study that runs a candidate, `NAME-design-1` for the first one.

    Args:
        candidate: What to run.
        number: Its number, from 1.
        first_seed: First seed.
        count: Structures.
    """
    settings = candidate.settings
    values = ", ".join(f"{key}={shown(value)}" for key, value in candidate.point.items())
    return replace(
        settings,
        name=f"{settings.name[:_LONGEST_NAME]}-design-{number}",
        description=f"Design with {values}.",
        seeds=SeedRange(first=first_seed, count=count),
    )


def require_sensing(base: Scenario, goals: Sequence[Goal]) -> None:
    """Refuse a scenario whose errors cannot be predicted, or that localizes nothing.

    Raises:
        InputError: there are too many robots, no method, or robots that build by estimates.
    """
    if base.robots > LARGE:
        problem = f"errors are predicted for up to {counted(LARGE, 'robot')}; give fewer"
        raise InputError(problem, key="robots")
    if not base.localization.places_robots:
        problem = f"{base.localization.method} has no {goals[0].name}; choose another, as joint"
        raise InputError(problem, key="localization.method")
    if base.structure.navigate_by != "truth":
        problem = "robots that build by what they sense grow other structures by each suite; "
        raise InputError(f"{problem}set it to truth", key="structure.navigate_by")
