"""YAML text to plain data, with the line on which each value stands.

Scalars follow the core schema of YAML 1.2: `1e-3` is a number; `no`, `on` and `12:30` are text;
`010` is ten. Anchors, aliases and tags are refused, and so are sizes no scenario has.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import yaml

from tiswarm.errors import InputError
from tiswarm.records.io import decode, unreadable
from tiswarm.records.messages import Part, dotted

MAX_BYTES = 256 * 2**10
MAX_DEPTH = 32
MAX_NODES = 20_000

_WORDS = {"true": True, "false": False, "null": None}
_INTEGER = re.compile(r"[-+]?[0-9]{1,300}")  # longer ones are floats, and infinite
_OCTAL = re.compile(r"0o[0-7]{1,99}")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]{1,99}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_OPENING = (yaml.StreamStartEvent, yaml.DocumentStartEvent)


@dataclass(frozen=True)
class Document:
    """Plain data and where it stands."""

    data: object
    """Dicts with text keys, lists, text, numbers, booleans and None."""

    lines: dict[tuple[Part, ...], int]
    """Line of each key and list entry, by the way that leads to it."""

    def line_of(self, path: Sequence[Part]) -> int:
        """Line of a value, or of what would hold it if it is missing."""
        parts = tuple(path)
        while parts not in self.lines:
            parts = parts[:-1]
        return self.lines[parts]


def read_document(path: Path) -> Document:
    """Read a YAML file.

    Raises:
        InputError: the file cannot be read or is not YAML as scenarios use it.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    if len(raw) > MAX_BYTES:
        problem = f"the file is larger than {MAX_BYTES // 2**10} KiB; is this a scenario?"
        raise InputError(problem, path=path)
    return parse_document(decode(raw, path), path)


def parse_document(text: str, path: Path | None = None) -> Document:
    """Read YAML text that came from a file, or from the command line if `path` is None.

    Raises:
        InputError: the text is empty or not YAML as scenarios use it.
    """
    events = _events(text, path)
    builder = _Builder(events, path)
    first = next(event for event in events if not isinstance(event, _OPENING))
    if isinstance(first, yaml.StreamEndEvent):
        problem = "nothing stands here; write the value, or a scenario that starts with `name:`"
        raise InputError(problem, path=path, line=None if path is None else 1)
    data = builder.value(first, ())
    after = next(event for event in events if not isinstance(event, yaml.DocumentEndEvent))
    if not isinstance(after, yaml.StreamEndEvent):
        builder.refuse("a second document starts here; keep one in a file", after, ())
    return Document(data, builder.lines)


def plain_scalar(text: str) -> object:
    """Value of a scalar without quotes."""
    if text in {"", "~"}:
        return None
    if text.lower() in _WORDS and text in {text.lower(), text.upper(), text.capitalize()}:
        return _WORDS[text.lower()]
    if _INTEGER.fullmatch(text):
        return int(text)
    if _OCTAL.fullmatch(text) or _HEXADECIMAL.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "").lower()) if _INFINITE.fullmatch(text) else text


def _events(text: str, path: Path | None) -> Iterator[yaml.Event]:
    """Yield what the parser finds, up to the end of the only document."""
    line, nodes, depth = 1, 0, 0
    try:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = _line(event)
            if isinstance(event, yaml.NodeEvent):
                nodes += 1
                depth += isinstance(event, yaml.CollectionStartEvent)
                if trouble := _trouble(event, nodes, depth):
                    raise InputError(trouble, path=path, line=line)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            yield event
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise InputError(_syntax(error), path=path, line=mark.line + 1 if mark else line) from error
    except yaml.reader.ReaderError as error:
        problem = "holds a character that no text file has; delete it"
        line = text.count("\n", 0, error.position) + 1
        raise InputError(problem, path=path, line=line) from error
    except (ValueError, OverflowError) as error:  # \UFFFFFFFF, a number of thousands of digits
        problem = "not YAML: a number or escape out of range; correct it"
        raise InputError(problem, path=path, line=line) from error


def _trouble(event: yaml.NodeEvent, nodes: int, depth: int) -> str:
    """Say why scenarios do without such a node; empty if they do not."""
    if event.anchor is not None:
        return f"anchors and aliases such as {event.anchor} are not used here; write the value out"
    if getattr(event, "tag", None) is not None:
        return "tags such as !!str are not used here; leave it out"
    if depth > MAX_DEPTH:
        return f"nested deeper than {MAX_DEPTH} levels; is this a scenario?"
    return f"more than {MAX_NODES} values; is this a scenario?" if nodes > MAX_NODES else ""


def _syntax(error: yaml.MarkedYAMLError) -> str:
    found = " ".join(str(error.problem or error.context).split())
    if "\\t" in found:
        return "a tab cannot stand here; indent with spaces"
    return f"not YAML: {found}; check indentation, colons and quotes"


class _Builder:
    """Builds values from events, which the source of the events keeps shallow and few."""

    def __init__(self, events: Iterator[yaml.Event], path: Path | None) -> None:
        self._events = events
        self._path = path
        self.lines: dict[tuple[Part, ...], int] = {(): 1}

    def value(self, event: yaml.Event, at: tuple[Part, ...]) -> object:
        """Build the value that starts with an event."""
        self.lines.setdefault(at, _line(event))
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(at)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(at)
        text = self._text(event, at)
        plain = isinstance(event, yaml.ScalarEvent) and event.implicit[0]
        return plain_scalar(text) if plain else text

    def refuse(self, problem: str, event: yaml.Event, at: tuple[Part, ...]) -> NoReturn:
        """Stop at an event."""
        line = None if self._path is None else _line(event)
        raise InputError(problem, path=self._path, line=line, key=dotted(at))

    def _mapping(self, at: tuple[Part, ...]) -> dict[str, object]:
        entries: dict[str, object] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                self.refuse("a key must be text; write `key: value`", event, at)
            key = self._text(event, at)
            here = (*at, key)
            if key in entries:
                first = self.lines[here]
                self.refuse(f"the key stands on line {first} too; keep one", event, here)
            self.lines[here] = _line(event)
            entries[key] = self.value(next(self._events), here)
        return entries

    def _sequence(self, at: tuple[Part, ...]) -> list[object]:
        entries: list[object] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            entries.append(self.value(event, (*at, len(entries))))
        return entries

    def _text(self, event: yaml.Event, at: tuple[Part, ...]) -> str:
        text = event.value if isinstance(event, yaml.ScalarEvent) else ""
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            self.refuse("half a character (a lone surrogate); correct the escape", event, at)
        return text


def _line(event: yaml.Event) -> int:
    return event.start_mark.line + 1 if event.start_mark else 1
