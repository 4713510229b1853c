"""From a scenario file and `--set` options to a scenario, or to errors with file and line."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tiswarm.errors import InputError
from tiswarm.localization.params import CUES, LocalizationParams
from tiswarm.records.messages import Part, counted, dotted
from tiswarm.scenario.check import SMALLEST, Mistake, validated
from tiswarm.scenario.document import Document, parse_document, read_document
from tiswarm.scenario.model import CONDITION_SECTIONS, Plain, Scenario, plain
from tiswarm.scenario.variants import put, settle

_CONDITION = re.compile(rf"conditions\.(.+?)(?:\.((?:{'|'.join(CONDITION_SECTIONS)})\..+))?")


class _Setting(NamedTuple):
    """One `--set KEY=VALUE`."""

    text: str
    path: tuple[str, ...]
    value: object

    def error(self, problem: str) -> InputError:
        return InputError(problem, key=f"--set {self.text}")


def load_scenario(path: Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read and check a scenario, every condition and swept value included.

    Args:
        path: YAML file.
        overrides: Texts `KEY=VALUE`: a dotted key and a YAML value that replaces the file's.

    Raises:
        InputError: for the first mistake in the file; it tells how many more there are.
    """
    scenario, mistakes = _examine(path, overrides)
    if scenario is not None and not mistakes:
        return scenario
    first, more = mistakes[0], len(mistakes) - 1
    if not more:
        raise first
    problem = f"{first.problem} (and {counted(more, 'more mistake')})"
    raise InputError(problem, path=first.path, line=first.line, key=first.key)


def find_mistakes(path: Path, overrides: Sequence[str] = ()) -> list[InputError]:
    """List everything that is wrong with a scenario file, in file order; `--set` comes last."""
    try:
        return _examine(path, overrides)[1]
    except InputError as error:
        return [error]


def localization_params(
    method: str,
    overrides: Sequence[str] = (),
    *,
    cues: Sequence[str] | None = None,
    values: Mapping[str, object] | None = None,
) -> LocalizationParams:
    """Build the settings of a localization method without a scenario file.

    Args:
        method: Name of the method.
        overrides: Texts `KEY=VALUE`, the key being one of the method's own.
        cues: The cues to use, all others being off; what the method does by itself if None.
        values: Settings by key, as plain data.

    Raises:
        InputError: for an unknown method or cue, or for the first bad setting.
    """
    for cue in cues or ():
        if cue not in CUES:
            problem = f"{cue} is not a choice here; use {', '.join(CUES)}"
            raise InputError(problem, key="--cues")
    switches = {} if cues is None else {cue: cue in cues for cue in CUES}
    settings = [_parse_setting(text, "localization") for text in overrides]
    data: Plain = {**SMALLEST, "localization": {"method": method, **switches, **(values or {})}}
    _put_all(data, settings)
    outcome = validated(data)
    if isinstance(outcome, Scenario):
        return outcome.localization
    first = outcome[0]
    if culprit := _culprit(first, settings):
        raise culprit.error(first.problem)
    key = dotted(first.path[1:])
    option = "--method" if key == "method" else "--cues" if key in switches else key
    raise InputError(first.problem, key=option)


def _examine(path: Path, overrides: Sequence[str]) -> tuple[Scenario | None, list[InputError]]:
    document = read_document(path)
    data = document.data
    if not isinstance(data, dict):
        problem = "a scenario is a mapping of keys to values; start it with `name:`"
        raise InputError(problem, path=path, line=document.line_of(()))
    settings = [_parse_setting(text) for text in overrides]
    _put_all(data, settings)
    outcome = validated(data)
    mistakes = [] if isinstance(outcome, Scenario) else outcome
    bad = {part for mistake in mistakes for part in mistake.path[:1]}
    found = [*mistakes, *_case_mistakes(data, bad)]
    errors = [_placed(mistake, path, document, settings) for mistake in found]
    errors.sort(key=lambda error: (error.line is None, error.line))
    return (outcome if isinstance(outcome, Scenario) else None), errors


def _case_mistakes(data: Plain, bad: set[Part]) -> list[Mistake]:
    """Check conditions and sweep as far as they touch no section that is wrong itself."""
    good = {key: value for key, value in data.items() if key not in bad}
    scenario = validated({**SMALLEST, **good})
    if not isinstance(scenario, Scenario):
        return []

    def sound(key: str) -> bool:
        return key.partition(".")[0] not in bad

    conditions = {
        name: {key: value for key, value in entries.items() if sound(key)}
        for name, entries in scenario.conditions.items()
    }
    sweep = {key: values for key, values in scenario.sweep.items() if sound(key)}
    return settle(plain(scenario), conditions, sweep)[1]


def _placed(
    mistake: Mistake, path: Path, document: Document, settings: Sequence[_Setting]
) -> InputError:
    """Say where a mistake was made: in an option or in the file."""
    if culprit := _culprit(mistake, settings):
        return culprit.error(mistake.problem)
    line = document.line_of(mistake.path)
    return InputError(mistake.problem, path=path, line=line, key=dotted(mistake.path))


def _culprit(mistake: Mistake, settings: Sequence[_Setting]) -> _Setting | None:
    """Find the last option that set the value at fault or, failing that, a part of it."""
    for setting in reversed(settings):
        if setting.path == mistake.path[: len(setting.path)]:
            return setting
    for setting in reversed(settings):
        if mistake.path == setting.path[: len(mistake.path)]:
            return setting
    return None


def _put_all(data: Plain, settings: Sequence[_Setting]) -> None:
    for setting in settings:
        if problem := put(data, setting.path, setting.value):
            raise setting.error(problem)


def _parse_setting(text: str, *section: str) -> _Setting:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        problem = "is not KEY=VALUE; write it like robots=20"
        raise InputError(problem, key=f"--set {text}")
    try:
        path = (*section, *_setting_path(key.strip()))
        return _Setting(text, path, parse_document(value).data)
    except InputError as error:
        raise InputError(error.problem, key=f"--set {text}") from error


def _setting_path(key: str) -> tuple[str, ...]:
    """Split a dotted key; keys of conditions and sweep have dots of their own."""
    if match := _CONDITION.fullmatch(key):
        return ("conditions", *(part for part in match.groups() if part))
    head, dot, rest = key.partition(".")
    return (head, rest) if head == "sweep" and dot else tuple(key.split("."))
