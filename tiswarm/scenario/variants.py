"""The cases of a scenario: every point of the sweep under every condition."""

import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from typing import Any, NamedTuple

from tiswarm.errors import InputError
from tiswarm.records.messages import Part, dotted
from tiswarm.scenario.check import CHOICES, SMALLEST, Mistake, validated
from tiswarm.scenario.model import Plain, Scenario, plain, swept_keys

MAX_VARIANTS = 10_000
MAX_LABEL = 150

Conditions = Mapping[str, Mapping[str, Any]]
Sweep = Mapping[str, Sequence[Any]]


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One point of the sweep under one condition, settled to the last value."""

    label: str
    """Name, fit for a folder: `baseline`, or `robots=300,baseline`."""

    condition: str
    point: Mapping[str, Any]
    """Swept values by dotted key, without those that follow another key."""

    settings: Scenario
    """The scenario as it holds here, without conditions and sweep."""


class _Change(NamedTuple):
    """A value to be set, and where in the scenario it is written."""

    key: str
    value: object
    source: tuple[Part, ...]

    @property
    def path(self) -> tuple[str, ...]:
        return tuple(self.key.split("."))

    @property
    def chooses(self) -> bool:
        """Whether it says which sort of section is meant."""
        return self.path[1:] == (CHOICES.get(self.path[0]),)


class _Case(NamedTuple):
    condition: str
    point: tuple[_Change, ...]
    """What names it."""

    overrides: tuple[_Change, ...]
    """What follows the sweep, then what the condition says."""

    @property
    def label(self) -> str:
        names = [f"{change.key}={_label(change.value)}" for change in self.point]
        label = ",".join([*names, self.condition])
        if len(label) <= MAX_LABEL:
            return label
        return f"{label[: MAX_LABEL - 9]}-{sha256(label.encode()).hexdigest()[:8]}"


def variants(scenario: Scenario) -> list[Variant]:
    """List the cases of a scenario: sweep points in order, under each its conditions in order.

    Raises:
        InputError: a condition or a swept value is wrong; never for a scenario from a file,
            where this has been looked at already.
    """
    found, mistakes = settle(plain(scenario), scenario.conditions, scenario.sweep)
    if mistakes:
        raise InputError(mistakes[0].problem, key=dotted(mistakes[0].path))
    return found


def settle(
    base: Plain, conditions: Conditions, sweep: Sweep
) -> tuple[list[Variant], list[Mistake]]:
    """Apply every case to a sound scenario, and collect what is wrong with conditions and sweep."""
    count = math.prod(map(len, sweep.values())) * len(conditions)
    if count > MAX_VARIANTS:
        problem = f"makes {count} cases; {MAX_VARIANTS} is the most: give fewer values"
        return [], [Mistake(("sweep",), problem)]
    if misshapen := _misshapen(sweep):
        return [], misshapen
    base = {key: value for key, value in base.items() if key not in {"conditions", "sweep"}}
    found: dict[str, Variant] = {}
    mistakes: dict[Mistake, None] = {}
    for case in _cases(conditions, sweep):
        outcome = _resolve(base, case)
        if not isinstance(outcome, Scenario):
            mistakes.update(dict.fromkeys(outcome))
        elif case.label.casefold() in found:
            problem = f"two cases would be called {case.label}; rename a condition or a value"
            mistakes[Mistake(("sweep" if sweep else "conditions",), problem)] = None
        else:
            point = {change.key: change.value for change in case.point}
            found[case.label.casefold()] = Variant(
                label=case.label, condition=case.condition, point=point, settings=outcome
            )
    return list(found.values()), list(mistakes)


def _cases(conditions: Conditions, sweep: Sweep) -> Iterator[_Case]:
    axes = [list(_rows(entry, values)) for entry, values in sweep.items()]
    for rows in itertools.product(*axes):
        followers = [change for row in rows for change in row[1:]]
        for name, entries in conditions.items():
            overrides = [_Change(k, v, ("conditions", name, k)) for k, v in entries.items()]
            yield _Case(name, tuple(row[0] for row in rows), (*followers, *overrides))


def _rows(entry: str, values: Sequence[Any]) -> Iterator[list[_Change]]:
    """Changes of each point of an entry of the sweep, the one that names the point first."""
    keys = swept_keys(entry)
    for place, value in enumerate(values):
        if len(keys) == 1:
            yield [_Change(entry, value, ("sweep", entry, place))]
        else:
            cells = enumerate(zip(keys, value, strict=True))
            yield [_Change(k, v, ("sweep", entry, place, column)) for column, (k, v) in cells]


def _misshapen(sweep: Sweep) -> list[Mistake]:
    """Find rows that do not fit their keys, and keys of several entries."""
    mistakes = []
    seen: set[str] = set()
    for entry, values in sweep.items():
        keys = swept_keys(entry)
        if twice := [key for n, key in enumerate(keys) if key in seen or key in keys[:n]]:
            problem = f"{twice[0]} is swept already; keep one of its places"
            mistakes.append(Mistake(("sweep", entry), problem))
        seen.update(keys)
        problem = f"is no row of {len(keys)} values; give one value for each key of {entry}"
        mistakes += [
            Mistake(("sweep", entry, place), problem)
            for place, row in enumerate(values)
            if len(keys) > 1 and not (isinstance(row, list) and len(row) == len(keys))
        ]
    return mistakes


def _resolve(base: Plain, case: _Case) -> Scenario | list[Mistake]:
    """Apply whole sections first, then what chooses their sort, then the settings in them."""
    data = deepcopy(base)
    changes = sorted([*case.point, *case.overrides], key=lambda c: (len(c.path) > 1, not c.chooses))
    lost = []
    for change in changes:
        if change.chooses and (problem := _start_afresh(data, change)):
            lost.append(Mistake(change.source, problem))
        if problem := put(data, change.path, change.value):
            return [Mistake(change.source, problem)]
    outcome = validated(data)
    if isinstance(outcome, Scenario):
        return lost or outcome
    return [_blame(mistake, changes, case.label) for mistake in outcome]


def put(data: Plain, path: Sequence[str], value: object) -> str:
    """Set a value in plain data in place; returns why it cannot be, or nothing."""
    for place, part in enumerate(path[:-1], start=1):
        data = data.setdefault(part, {})
        if not isinstance(data, dict):
            return f"{dotted(path[:place])} is a single value, not a section; correct the key"
    data[path[-1]] = deepcopy(value)
    return ""


def _start_afresh(data: Plain, change: _Change) -> str:
    """Empty a section that becomes one of another sort; returns what would be lost, or nothing."""
    section, key = change.path
    settings = data[section]
    old = settings.get(key) if isinstance(settings, dict) else None
    if not isinstance(old, str) or old == change.value:
        return ""
    data[section] = {}
    if settings == _defaults(section, old):
        return ""
    problem = f"would drop the settings made for {old}"
    return f"{problem}; sweep {section} as a whole, or move them into the conditions of {old}"


@cache
def _defaults(section: str, sort: str) -> Plain | None:
    outcome = validated({**SMALLEST, section: {CHOICES[section]: sort}})
    return plain(outcome)[section] if isinstance(outcome, Scenario) else None


def _blame(mistake: Mistake, changes: Sequence[_Change], label: str) -> Mistake:
    """Find the change that made a mistake: it set the value at fault, or a part of it."""
    for change in reversed(changes):
        size = len(change.path)
        if change.path == mistake.path[:size]:
            of_key = mistake.about_key and size == len(mistake.path) and change.source[0] == "sweep"
            source = change.source[:2] if of_key else change.source
            return mistake._replace(path=(*source, *mistake.path[size:]))
    for change in reversed(changes):
        if mistake.path == change.path[: len(mistake.path)]:
            return mistake._replace(path=change.source)
    return mistake._replace(problem=f"{mistake.problem} (in case {label})")


def _label(value: object) -> str:
    """Write a swept value with characters that any file system takes."""
    text = value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
    text = re.sub(r"[^A-Za-z0-9._+-]+", "-", text)
    return text.strip("-") if isinstance(value, (dict, list)) else text
