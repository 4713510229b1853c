"""From a scenario file and `--set` options to a scenario, its variants and its cases.

A variant is one point of the sweep under one condition, a case one of its seeds.
"""

import itertools
import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from tiswarm.base.errors import InputError
from tiswarm.base.plugins import load_plugins
from tiswarm.base.registry import Registered, contents
from tiswarm.records.messages import Part, dotted
from tiswarm.records.run_folder import ENGINE_METHOD, LABEL, cell_of, variant_name
from tiswarm.scenario.labels import BASELINE, row_labels, swept_keys, without_label
from tiswarm.scenario.model import ADAPTER, Scenario, from_plain, to_plain
from tiswarm.scenario.validation import (
    CONDITION_SECTIONS,
    DISCRIMINATORS,
    MOST_MISTAKES,
    SAME_KEYS,
    Mistake,
    Plain,
    Setting,
    blame,
    find_culprit,
    first_of,
    parse_setting,
    set_key,
)
from tiswarm.scenario.yaml_source import NOWHERE, YamlSource, find_scenario, read_yaml

_MAX_VARIANTS = 10_000

_MAX_FAILURES = 1000
"""Variants with mistakes after which no others are built: many have the same mistake."""

_FEW_VALUES = 20
"""Longest list of values that are checked one by one within the whole scenario."""

_LACKS = "is missing; give a number, or sweep it"

_Sweep = Mapping[str, Sequence[Any]]

_NOT_OF_ENGINE = ("structure", "sensing")
"""Sections that studies of the engine do not have."""

_MINIMAL: Plain = {
    "name": "minimal",
    "structure": {"kind": "tower"},
    "localization": {"method": "virtual-force"},
}
"""A scenario of what is required only."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One point of the sweep under one condition."""

    label: str  # name of a folder: `baseline`, or `robots=300,baseline`
    condition: str  # name of the condition
    point: Mapping[str, Any]  # swept values by dotted key, without those that follow another key
    settings: Scenario  # the scenario at this point and condition, without conditions and sweep
    condition_words: str = ""  # what pages call the condition, without its measurements
    point_words: str = ""  # what pages call the point; empty without a sweep

    @property
    def words(self) -> str:
        """Condition and point for people; empty where the scenario has neither."""
        condition = "" if self.condition == BASELINE else self.condition_words
        return ", ".join(filter(None, [condition, self.point_words]))


def load_scenario(file_or_data: Path | Plain, overrides: Sequence[str] = ()) -> Scenario:
    """Read and check a scenario with all its conditions and swept values.

    Args:
        file_or_data: YAML file, the name of a shipped scenario, or plain data as such a file has.
        overrides: Texts `KEY=VALUE`: a dotted key and a YAML value that replaces the file's.

    Raises:
        InputError: for the first wrong key, or else the first mistake, with the number of others.
    """
    scenario, mistakes = examine(file_or_data, overrides)
    if scenario is not None and not mistakes:
        return scenario
    if len(mistakes) > MOST_MISTAKES:
        raise first_of(mistakes[:MOST_MISTAKES], " at least; check lists these")
    raise first_of(mistakes, "; check lists all")


def find_mistakes(file_or_data: Path | Plain, overrides: Sequence[str] = ()) -> list[InputError]:
    """List the mistakes in a scenario in file order, those in options last.

    Of mistakes in one place, wrong keys come first. Of more than MOST_MISTAKES, the last entry says
    that there are others.
    """
    try:
        _, mistakes = examine(file_or_data, overrides)
    except InputError as error:
        return [error]
    return in_file_order(mistakes)


def in_file_order(mistakes: Sequence[InputError]) -> list[InputError]:
    """Sort mistakes that `examine` returned by line, those in options last."""
    listed = sorted(mistakes[:MOST_MISTAKES], key=lambda error: (error.line is None, error.line))
    return [*listed, *mistakes[MOST_MISTAKES:]]


def variants(scenario: Scenario) -> list[Variant]:
    """List the variants of a scenario: sweep points in order, at each its conditions in order.

    A wrong condition or swept value raises InputError; scenarios from files have none.
    """
    expanded, mistakes = _expand(scenario, scenario.conditions, scenario.sweep)
    if mistakes:
        raise InputError(mistakes[0].problem, key=dotted(mistakes[0].path))
    return expanded


def examine(
    file_or_data: Path | Plain, overrides: Sequence[str] = ()
) -> tuple[Scenario | None, list[InputError]]:
    """Check a scenario, and list its mistakes: wrong keys first, options last of either.

    Args:
        file_or_data: As for `load_scenario`.
        overrides: As for `load_scenario`.

    Returns:
        The scenario, None if it has a mistake outside its conditions and its sweep. Its mistakes;
        of more than MOST_MISTAKES, an entry after these says that there are others.

    Raises:
        InputError: the file cannot be read as a mapping.
    """
    load_plugins()
    path = find_scenario(file_or_data) if isinstance(file_or_data, Path) else None
    source = read_yaml(path) if path else YamlSource(deepcopy(file_or_data), {(): NOWHERE})
    data = source.data
    if not isinstance(data, dict):
        problem = "a scenario is a mapping of keys to values; start it with `name:`"
        if path and path.suffix == ".csv":
            problem += ", or give a table to tiswarm import"
        raise InputError(problem, path=path, line=source.position_of(()).line)
    settings, unread = _parsed(overrides)
    swept = any(setting.path[0] == "sweep" for setting in settings)
    for setting in settings:
        problem = set_key(data, setting.path, setting.value)
        if problem:
            unread.append(setting.error(problem))
        sweep = data.get("sweep")
        if isinstance(sweep, dict):  # the option replaces it
            for key in setting.values:
                sweep.pop(key, None)
    useless = _fitted_to_engine(data)
    outcome = from_plain(data)
    mistakes = [*useless, *_mistakes(data, outcome)]
    if not mistakes and not swept:
        mistakes = _swept_over(data)
    mistakes = [_with_sweep(mistake, data, settings) for mistake in mistakes]
    placed = [(mistake.about_key, _placed(mistake, path, source, settings)) for mistake in mistakes]
    placed.sort(key=lambda entry: (not entry[0], entry[1].line is None, entry[1].line))
    errors = [*(error for _, error in placed), *unread]
    if len(errors) > MOST_MISTAKES:
        problem = f"has more than {MOST_MISTAKES} mistakes; correct those that are listed first"
        errors = [*errors[:MOST_MISTAKES], InputError(problem, path=path)]
    return (outcome if isinstance(outcome, Scenario) else None), errors


def _parsed(overrides: Sequence[str]) -> tuple[list[Setting], list[InputError]]:
    """Parse options `KEY=VALUE`; return the settings, and errors of those that are none."""
    settings: list[Setting] = []
    unread: list[InputError] = []
    for text in overrides:
        try:
            settings.append(parse_setting(text))
        except InputError as error:
            unread.append(error)
    return settings, unread


def _fitted_to_engine(data: Plain) -> list[Mistake]:
    """Let a study of the engine do without a structure; list what has no use in one.

    The structure that takes the place of none is not part of the study.
    """
    localization = data.get("localization")
    if not isinstance(localization, dict) or localization.get("method") != ENGINE_METHOD:
        return []
    sweep = data.get("sweep")
    entries = [str(entry) for entry in sweep] if isinstance(sweep, dict) else []
    useless: list[tuple[str, ...]] = [(name,) for name in _NOT_OF_ENGINE if name in data]
    useless += [
        ("sweep", entry)
        for entry in entries
        if any(key.partition(".")[0] in _NOT_OF_ENGINE for key in swept_keys(entry))
    ]
    conditions = data.get("conditions")
    useless += [
        ("conditions", str(name), str(key))
        for name, settings in (conditions.items() if isinstance(conditions, dict) else ())
        for key in (settings if isinstance(settings, dict) else ())
        if str(key).partition(".")[0] in _NOT_OF_ENGINE
    ]
    data["structure"] = deepcopy(_MINIMAL["structure"])
    data.pop("sensing", None)
    problem = f"has no use: {ENGINE_METHOD} moves robots from localization.start; leave it out"
    return [Mistake(place, problem, about_key=True) for place in useless]


def _with_sweep(mistake: Mistake, data: Plain, settings: Sequence[Setting]) -> Mistake:
    """Add how to sweep a key to a mistake about a list of values that are right one by one."""
    values = None
    for setting in settings:
        if setting.path == mistake.path:
            values = setting.value
    if mistake.about_key or not isinstance(values, list) or not values:
        return mistake
    single = deepcopy(data)
    set_key(single, [str(part) for part in mistake.path], None)  # copies without the list are short
    if not all(_is_right(value, mistake.path, single, len(values)) for value in values):
        return mistake
    key = dotted(mistake.path)
    text = json.dumps(values).replace('"', "")
    sweep = data.get("sweep")
    option = f"sweep={{{key}: {text}}}"
    if isinstance(sweep, dict) and sweep:
        swept = itertools.chain.from_iterable(map(swept_keys, sweep))
        if key not in swept:
            option = f"sweep.{key}={text}"
    return mistake._replace(problem=f"{mistake.problem}; to sweep {key}, give --set '{option}'")


def _is_right(value: object, path: tuple[Part, ...], data: Plain, count: int) -> bool:
    """Whether one of `count` values is right at a path of some data; one of many, in its section.

    A section is checked in a fraction of the time that the scenario needs with all variants.
    """
    keys = [str(part) for part in path]
    section = keys[0]
    if count > _FEW_VALUES:
        alone = {section: deepcopy(data.get(section))}
        if not set_key(alone, keys, value) and _checked_section(section, alone[section]):
            return True
    single = deepcopy(data)
    set_key(single, keys, value)
    return all(problem.path != path for problem in _mistakes(single, from_plain(single)))


def _swept_over(data: Plain) -> list[Mistake]:
    """List the values of a valid scenario that its sweep replaces at every point.

    A value at its default has no effect either, but files of runs have all defaults.
    """
    mistakes = []
    defaults = _default_of(data) if data.get("sweep") else {}
    for key in itertools.chain.from_iterable(map(swept_keys, data.get("sweep", {}))):
        section, *rest = key.split(".")
        selects = rest == [DISCRIMINATORS.get(section)]
        value = _value_at(data, key)
        if selects or value is None or isinstance(value, dict):
            continue
        # A section that is null by default is valid only with the keys that it requires.
        if rest[:-1] and _value_at(defaults, key.rpartition(".")[0]) is None:
            continue
        if value != _value_at(defaults, key):
            problem = f"has no effect, as sweep sets {key}; leave out or set sweep={{{key}: [...]}}"
            mistakes.append(Mistake((section, *rest), problem, about_key=True))
    return mistakes


def _default_of(data: Plain) -> Plain:
    """Return a scenario of defaults whose sections have the settings that one selects."""
    chosen = {
        section: {key: data[section][key]}
        for section, key in DISCRIMINATORS.items()
        if isinstance(data.get(section), dict) and key in data[section]
    }
    outcome = from_plain({**_MINIMAL, **chosen})
    return to_plain(outcome) if isinstance(outcome, Scenario) else {}


def _value_at(data: Plain, key: str) -> object:
    """Return the value of a dotted key; None if it is not set."""
    value: Any = data
    for part in key.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _mistakes(data: Plain, outcome: Scenario | list[Mistake]) -> list[Mistake]:
    """List the mistakes of some data; conditions and swept values of bad sections are not checked.

    Args:
        data: A scenario as plain data.
        outcome: What `from_plain` makes of it.
    """
    mistakes = [] if isinstance(outcome, Scenario) else outcome
    if len(mistakes) > MOST_MISTAKES:
        return mistakes
    bad = {part for mistake in mistakes for part in mistake.path[:1]}

    def good(entries: Mapping[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in entries.items() if key.partition(".")[0] not in bad}

    scenario = from_plain({**_MINIMAL, **good(data)})
    if not isinstance(scenario, Scenario):
        return mistakes
    conditions = {name: good(entries) for name, entries in scenario.conditions.items()}
    return [*mistakes, *_expand(scenario, conditions, good(scenario.sweep))[1]]


def _placed(
    mistake: Mistake, path: Path | None, source: YamlSource, settings: Sequence[Setting]
) -> InputError:
    error = blame(mistake, settings)
    if error:
        return error
    if path is None:
        return InputError(mistake.problem, key=dotted(mistake.path))
    position = source.position_of(mistake.path)
    column = position.column if mistake.about_key else position.value_column
    return InputError(
        mistake.problem, path=path, line=position.line, column=column, key=dotted(mistake.path)
    )


class _ChangedKey(NamedTuple):
    """A value to set, and its place in the scenario."""

    key: str
    value: object
    source: tuple[Part, ...]

    @property
    def path(self) -> tuple[str, ...]:
        return tuple(self.key.split("."))

    @property
    def selects(self) -> bool:
        """Whether it selects which settings a section has."""
        return self.path[1:] == (DISCRIMINATORS.get(self.path[0]),)


def _expand(
    scenario: Scenario, conditions: Mapping[str, Mapping[str, Any]], sweep: _Sweep
) -> tuple[list[Variant], list[Mistake]]:
    """Build the variants of a valid scenario, and list mistakes in its conditions and sweep.

    No variants follow once there are more than MOST_MISTAKES mistakes, or _MAX_FAILURES variants
    with mistakes.
    """
    count = math.prod(map(len, sweep.values())) * len(conditions)
    if count > _MAX_VARIANTS:
        problem = f"makes {count} cases; {_MAX_VARIANTS} is the most: give fewer values"
        return [], [Mistake(("sweep",), problem)]
    malformed = _malformed(sweep)
    if malformed:
        return [], malformed
    base = _Base.of(scenario)
    labels = row_labels(sweep)
    failures = 0
    by_folder: dict[str, Variant] = {}
    mistakes: dict[Mistake, None] = {}
    points = itertools.product(*(list(_rows(entry, values)) for entry, values in sweep.items()))
    for rows, (condition, entries) in itertools.product(points, conditions.items()):
        point = {row[0].key: row[0].value for row in rows}
        label = variant_name(point, condition)
        changes = [row[0] for row in rows]
        changes += [follower for row in rows for follower in row[1:]]
        changes += [
            _ChangedKey(key, value, ("conditions", condition, key))
            for key, value in entries.items()
            if key != LABEL
        ]
        outcome = _apply(base, changes, label)
        if not isinstance(outcome, Scenario):
            mistakes.update(dict.fromkeys(outcome))
            failures += 1
        elif outcome.localization.lacks:
            mistakes[Mistake(("localization", *outcome.localization.lacks), _LACKS)] = None
        elif outcome.localization.runs_engine != scenario.localization.runs_engine:
            problem = (
                f"{ENGINE_METHOD} is a study of its own; no condition or point may change to it"
            )
            place = ("conditions", condition) if entries else ("sweep",)
            mistakes[Mistake(place, f"{problem}, or away")] = None
        elif label.casefold() in by_folder:
            problem = f"two cases would have the name {label}; rename a condition or a value"
            mistakes[Mistake(("sweep" if sweep else "conditions",), problem)] = None
        else:
            by_folder[label.casefold()] = Variant(
                label=label,
                condition=condition,
                point=point,
                settings=outcome,
                condition_words=str(entries.get(LABEL, condition)),
                point_words=_in_words(point, labels),
            )
        if len(mistakes) > MOST_MISTAKES or failures == _MAX_FAILURES:
            break
    return list(by_folder.values()), list(mistakes)


def _in_words(point: Mapping[str, Any], labels: Mapping[str, Mapping[str, str]]) -> str:
    """Write a point by the labels of its rows; values that all points share have none."""
    cells = [labels.get(key, {}).get(cell_of(value), "") for key, value in point.items()]
    return ", ".join(filter(None, cells))


def _rows(entry: str, values: Sequence[Any]) -> Iterator[list[_ChangedKey]]:
    """Yield the changes at each point of an entry, first the one that names the point."""
    keys = swept_keys(entry)
    for place, value in enumerate(values):
        if len(keys) == 1:
            yield [_ChangedKey(entry, without_label(value), ("sweep", entry, place))]
        else:
            yield [
                _ChangedKey(key, without_label(cell), ("sweep", entry, place, column))
                for column, (key, cell) in enumerate(zip(keys, value, strict=True))
            ]


def _malformed(sweep: _Sweep) -> list[Mistake]:
    """Find rows that do not fit their keys, and keys in several entries."""
    mistakes = []
    seen: set[str] = set()
    for entry, values in sweep.items():
        keys = swept_keys(entry)
        repeated = []
        for key in keys:
            if key in seen:
                repeated.append(key)
            seen.add(key)
        if repeated:
            key = repeated[0]
            problem = f"{key} is swept already; keep one, or set sweep={{{key}: [...]}}"
            mistakes.append(Mistake(("sweep", entry), problem))
        problem = f"should be a row of {len(keys)} values, one for each key of {entry}"
        mistakes += [
            Mistake(("sweep", entry, place), problem)
            for place, row in enumerate(values)
            if len(keys) > 1 and not (isinstance(row, list) and len(row) == len(keys))
        ]
    return mistakes


@dataclass(frozen=True, kw_only=True)
class _Base:
    """What the variants of a scenario change: it without its conditions and its sweep."""

    plain: Plain  # as plain data
    checked: Mapping[str, Any]  # each field, checked

    @classmethod
    def of(cls, scenario: Scenario) -> "_Base":
        """Take the fields of a scenario that variants have."""
        plain = to_plain(scenario)
        names = [f.name for f in fields(scenario) if f.name not in {"conditions", "sweep"}]
        return cls(
            plain={name: plain[name] for name in names if name in plain},
            checked={name: getattr(scenario, name) for name in names},
        )

    def with_sections(self, data: Plain, changed: Collection[str]) -> Scenario | None:
        """Build a scenario and check the changed sections of some data; None at a mistake."""
        values = dict(self.checked)
        for name in changed:
            values[name] = data[name]
            if isinstance(data[name], dict | list):
                scenario = _checked_section(name, data[name])
                if scenario is None:
                    return None
                values[name] = getattr(scenario, name)
        try:
            return Scenario(**values)
        except ValidationError:
            return None


def _checked_section(name: str, section: object) -> Scenario | None:
    """Return a scenario with nothing but a section of some data; None if it has a mistake."""
    return _checked_json(name, json.dumps(section), contents())


@lru_cache(maxsize=_MAX_VARIANTS)
def _checked_json(name: str, section: str, _plugins: tuple[Registered, ...]) -> Scenario | None:
    sections = {key: json.dumps(value) for key, value in _MINIMAL.items()}
    sections[name] = section
    entries = ", ".join(f'"{key}": {text}' for key, text in sections.items())
    try:
        return ADAPTER.validate_json(f"{{{entries}}}")
    except ValidationError:
        return None


def _apply(base: _Base, changes: Sequence[_ChangedKey], label: str) -> Scenario | list[Mistake]:
    """Apply whole sections first, then keys that select settings, then the settings."""
    data = dict(base.plain)
    changed = {change.path[0] for change in changes}
    data.update({name: deepcopy(data[name]) for name in changed if name in data})
    dropped = []
    changes = sorted(changes, key=lambda change: (len(change.path) > 1, not change.selects))
    for change in changes:
        if change.selects:
            problem = _reset_section(data, change)
            if problem:
                dropped.append(Mistake(change.source, problem))
        problem = set_key(data, change.path, change.value)
        if problem:
            return [Mistake(change.source, problem)]
    outcome = base.with_sections(data, changed) or from_plain(data)
    if isinstance(outcome, Scenario):
        return dropped or outcome
    return [_attribute(mistake, changes, label) for mistake in outcome]


def _reset_section(data: Plain, change: _ChangedKey) -> str:
    """Empty a section that is to have other settings; return which are lost, or nothing.

    A section keeps settings that differ from their default where the others have the same keys.
    """
    section, key = change.path
    settings = data[section]
    old = settings.get(key) if isinstance(settings, dict) else None
    if not isinstance(old, str) or old == change.value:
        return ""
    default = _defaults(section, old, contents()) or {}
    changed = {name: value for name, value in settings.items() if value != default.get(name)}
    data[section] = changed if section in SAME_KEYS else {}
    if section in SAME_KEYS or not changed:
        return ""
    problem = f"would drop {', '.join(changed)}, set for {old}; sweep {section} as a whole"
    if section not in CONDITION_SECTIONS:
        return problem
    return f"{problem}, or give {section} as a whole in the condition"


@lru_cache(maxsize=64)
def _defaults(section: str, selected: str, _plugins: tuple[Registered, ...]) -> Plain | None:
    """Return the defaults of the settings that a name selects, with the plug-ins loaded."""
    outcome = from_plain({**_MINIMAL, section: {DISCRIMINATORS[section]: selected}})
    return to_plain(outcome)[section] if isinstance(outcome, Scenario) else None


def _attribute(mistake: Mistake, changes: Sequence[_ChangedKey], label: str) -> Mistake:
    """Move a mistake to the change that set the value at fault, or a part of it."""
    change = find_culprit(mistake, changes)
    if change is None:
        return mistake._replace(problem=f"{mistake.problem} (in case {label})")
    size = len(change.path)
    source = change.source
    if mistake.about_key and size == len(mistake.path) and source[0] == "sweep":
        source = source[:2]
    return mistake._replace(path=(*source, *mistake.path[size:]))


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
    points = variants(scenario)
    cases = [
        Case(seed=seed, variant=point) for point in points for seed in point.settings.seed_list
    ]
    kinds = {point.label: structure_kind(point.settings) for point in points}

    def key(case: Case) -> tuple[tuple[int, str], int]:
        return kinds[case.variant.label], case.seed

    shared = itertools.groupby(sorted(cases, key=key), key=key)
    return Plan(cases=cases, structures=[tuple(group) for _, group in shared])


def structure_kind(settings: Scenario) -> tuple[int, str]:
    """Return all that determines a structure but its seed: size and settings."""
    # Small structures sort first: they finish early, and need no memory that large ones took.
    structure = settings.structure
    navigation: dict[str, tuple[object, ...]] = {
        "truth": (),
        "error": (settings.sensing,),
        "estimate": (settings.sensing, settings.localization),
    }
    navigation_settings = navigation[structure.navigate_by]
    # Growth takes a time of its own with each number of threads and workers.
    timing: tuple[int | None, ...] = (settings.threads, settings.workers)
    if timing == (None, None):
        timing = ()
    return settings.robots, repr((structure, settings.robot, *navigation_settings, *timing))
