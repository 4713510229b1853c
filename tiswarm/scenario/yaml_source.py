"""YAML files: the scenarios that come with the package, and text to plain data with each position.

Scalars follow the core schema of YAML 1.2: `1e-3` is a number; `no`, `on` and `12:30` are text;
`010` is ten. Beyond that schema, `1e3` is the whole number 1000. Anchors, aliases, tags and very
large files are refused.
"""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from tiswarm.base.errors import InputError, did_you_mean
from tiswarm.records.io import decode, open_input, unreadable
from tiswarm.records.messages import Part, dotted

_MAX_BYTES = 256 * 2**10
_MAX_DEPTH = 32
_MAX_NODES = 20_000

_CONSTRUCTORS: dict[str, Callable[[str], object]] = {
    r"~|null|Null|NULL|": lambda _text: None,
    r"true|True|TRUE|false|False|FALSE": lambda text: text.lower() == "true",
    r"[-+]?[0-9]{1,300}": int,  # longer ones are floats, and infinite
    r"0o[0-7]{1,99}|0x[0-9a-fA-F]{1,99}": lambda text: int(text, 0),
    r"[-+]?([0-9]{1,2}[eE]\+?[0-9]|[0-9][eE]\+?1[0-5])": lambda text: int(float(text)),
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?": float,
    r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)": lambda text: float(text.replace(".", "").lower()),
}
"""How plain scalars become values, by their pattern; all others are text. Whole numbers with an
exponent are exact, as all below 2^53."""


class SourcePosition(NamedTuple):
    """Where a key or a list entry starts, and its value; all counted from 1."""

    line: int
    column: int
    value_column: int  # of the key if the value starts on another line


NOWHERE = SourcePosition(0, 0, 0)
"""Position of data that comes from no file."""


@dataclass(frozen=True)
class YamlSource:
    """Plain data and where in a file it comes from."""

    data: Any  # dicts with text keys, lists, text, numbers, booleans and None
    positions: dict[tuple[Part, ...], SourcePosition]  # of each key and list entry, by its path

    def position_of(self, path: Sequence[Part]) -> SourcePosition:
        """Return the position of a value, or of the section that lacks it."""
        parts = tuple(path)
        while parts not in self.positions:
            parts = parts[:-1]
        position = self.positions[parts]
        return position if parts == tuple(path) else position._replace(value_column=position.column)


def read_yaml(path: Path) -> YamlSource:
    """Read a YAML file, or raise InputError."""
    try:
        with open_input(path) as file:
            raw = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    if len(raw) > _MAX_BYTES:
        problem = f"the file is larger than {_MAX_BYTES // 2**10} KiB; is this a scenario?"
        raise InputError(problem, path=path)
    return parse_yaml(decode(raw, path), path)


def parse_yaml(text: str, path: Path | None = None) -> YamlSource:
    """Parse YAML text from a file, or from the command line if `path` is None.

    Text that is empty or not YAML as scenarios use it raises InputError.
    """
    positions: dict[tuple[Part, ...], SourcePosition] = {(): SourcePosition(1, 1, 1)}
    try:
        root = _compose(text)
        data = _value(root, (), positions)
    except InputError as error:
        line, column = (None, None) if path is None else (error.line, error.column)
        raise InputError(
            error.problem, path=path, line=line, column=column, key=error.key
        ) from error
    return YamlSource(data, positions)


def plain_scalar(text: str) -> object:
    """Return the value of a scalar without quotes."""
    for pattern, construct in _CONSTRUCTORS.items():
        if re.fullmatch(pattern, text):
            return construct(text)
    return text


class _Loader(yaml.SafeLoader):
    """Composes nodes, which it keeps shallow and few; their scalars stay text."""

    depth = nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        self.nodes += 1
        self.depth += 1
        problem = ""
        if event.anchor is not None:
            name = f"anchors and aliases such as {event.anchor}"
            problem = f"{name} are not used here; write the value out"
        elif getattr(event, "tag", None) is not None:
            problem = "tags such as !!str are not used here; leave it out"
        elif self.depth > _MAX_DEPTH and not isinstance(event, yaml.ScalarEvent):
            problem = f"nested deeper than {_MAX_DEPTH} levels; is this a scenario?"
        elif self.nodes > _MAX_NODES:
            problem = f"more than {_MAX_NODES} values; is this a scenario?"
        if problem:
            raise _mistake(problem, event.start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def _compose(text: str) -> yaml.Node:
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if mark is None:
            raise InputError(_syntax(error), line=1) from error
        raise _mistake(_syntax(error), mark) from error
    except yaml.reader.ReaderError as error:
        problem = "contains a character that is not allowed in text files; delete it"
        line = text.count("\n", 0, error.position) + 1
        raise InputError(problem, line=line) from error
    except (ValueError, OverflowError) as error:  # such as \UFFFFFFFF
        problem = "not YAML: an escape is out of range; correct it"
        raise InputError(problem, line=loader.line + 1 if loader else 1) from error
    if node is None:
        raise InputError("is empty; write a value, or a scenario that starts with `name:`", line=1)
    return node


def _syntax(error: yaml.MarkedYAMLError) -> str:
    problem = " ".join(str(error.problem or error.context).split())
    if "another document" in problem:
        return "a second document starts here; keep one in a file"
    if "\\t" in problem:
        return "a tab cannot stand here; indent with spaces"
    is_log = "'<document start>', but found '{'" in problem  # the second of lines of JSON
    remedy = "give a log to tiswarm localize" if is_log else "check indentation, colons and quotes"
    return f"not YAML: {problem}; {remedy}"


def _value(
    node: yaml.Node, path: tuple[Part, ...], positions: dict[tuple[Part, ...], SourcePosition]
) -> object:
    """Convert a node to plain data, and note its positions."""
    positions.setdefault(path, _position(node, node))
    if isinstance(node, yaml.SequenceNode):
        return [_value(entry, (*path, n), positions) for n, entry in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        text = _text(node, path)
        is_plain = isinstance(node, yaml.ScalarNode) and node.style is None
        return plain_scalar(text) if is_plain else text
    entries: dict[str, object] = {}
    for key_node, value_node in node.value:
        if not isinstance(key_node, yaml.ScalarNode):
            problem = "a key must be text; write `key: value`"
            raise _mistake(problem, key_node.start_mark, path)
        key = _text(key_node, path)
        key_path = (*path, key)
        if key in entries:
            problem = f"the key stands on line {positions[key_path].line} too; keep one"
            raise _mistake(problem, key_node.start_mark, key_path)
        positions[key_path] = _position(key_node, value_node)
        entries[key] = _value(value_node, key_path, positions)
    return entries


def _text(node: yaml.Node, path: tuple[Part, ...]) -> str:
    text = str(node.value)
    if any("\ud800" <= letter <= "\udfff" for letter in text):
        problem = "half a character (a lone surrogate); correct the escape"
        raise _mistake(problem, node.start_mark, path)
    return text


def _position(key: yaml.Node, value: yaml.Node) -> SourcePosition:
    start = key.start_mark
    end = value.start_mark
    value_column = end.column if end.line == start.line else start.column
    return SourcePosition(start.line + 1, start.column + 1, value_column + 1)


def _mistake(problem: str, mark: yaml.Mark, path: tuple[Part, ...] = ()) -> InputError:
    return InputError(problem, line=mark.line + 1, column=mark.column + 1, key=dotted(path))


_FOLDER = Path(__file__).parent / "files"


FIRST = ["tower", "cantilever", "bridge", "chain", "paper", "scaling", "closed-loop", "failures"]
"""Scenarios to begin with."""


def shipped_scenarios() -> dict[str, Path]:
    """List the files of the scenarios by name, sorted."""
    return {path.stem: path for path in sorted(_FOLDER.glob("*.yaml"), key=lambda path: path.stem)}


def find_scenario(path: Path) -> Path:
    """Return the path of a file or, if there is none, that of the shipped scenario of this name.

    Raises:
        InputError: a name without folder and suffix is neither a file nor a shipped scenario, or
            both; or a file that does not exist has the name of a shipped scenario.
    """
    if str(path) != path.stem:
        is_shipped = path.suffix in {".yaml", ".yml"} and path.stem in shipped_scenarios()
        if is_shipped and not os.path.lexists(path):
            problem = f"there is no such file; did you mean tiswarm run {path.stem}?"
            raise InputError(problem, path=path)
        return path
    # Unlike those of Path, functions of os.path do not raise for names that are too long.
    shipped = shipped_scenarios().get(str(path))
    if shipped and os.path.isfile(path):  # noqa: PTH113
        file = path.absolute()
        problem = f"both a file here and a scenario of tiswarm's; name {file} or {shipped}"
        raise InputError(problem, path=path)
    if shipped:
        return shipped
    if os.path.exists(path):  # noqa: PTH110
        return path
    problem = "neither a file nor a scenario of tiswarm's; tiswarm scenarios --all lists these"
    raise InputError(problem + did_you_mean(path, shipped_scenarios()), path=path)


def describe_scenarios(*, every: bool = False) -> list[str]:
    """List names and descriptions of the scenarios to begin with, or of all, in lines."""
    shipped = shipped_scenarios()
    names = [*shipped] if every else [name for name in FIRST if name in shipped]
    width = max(map(len, names), default=0)
    lines = []
    for name in names:
        description = yaml.safe_load(shipped[name].read_text())["description"]
        lines.append(f"{name:<{width}}  {description}")
    return lines
