"""`docs/architecture.md` tells the truth about the repository, which stays within its limits."""

import ast
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from benchmarks.house import ROOTS, House, places
from tests.test_tour import stops
from tiswarm.measurements.cues import CUES
from tiswarm.records.measures import MEASURES as COLUMNS
from tiswarm.records.sensing_log import KEYS, NUMBERS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).parents[1]
PAGE = (REPOSITORY / "docs" / "architecture.md").read_text()
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())

IN_BACKTICKS = re.findall(r"(?<!`)`([^`\s]+)`(?!`)", PAGE)
PATHS = {
    name for name in IN_BACKTICKS if "/" in name or re.search(r"\.(md|py|toml|txt|yaml)$", name)
}
HOUSE = House(REPOSITORY)
MODULES: dict[str, ast.Module] = {
    str(file.relative_to(REPOSITORY)): tree
    for file, tree in zip(
        sorted((REPOSITORY / "tiswarm").rglob("*.py")), HOUSE.tree.values(), strict=True
    )
}
"""By file, the syntax tree of each module."""

_Node = TypeVar("_Node", bound=ast.AST)


def _room_files() -> set[str]:
    package = REPOSITORY / "tiswarm"
    modules = {f"tiswarm/{file.name}" for file in package.glob("*.py")} - {"tiswarm/__init__.py"}
    return modules | {f"tiswarm/{file.parent.name}/" for file in package.glob("*/__init__.py")}


def _distributions() -> set[str]:
    project = PROJECT["project"]
    requirements = sum(project["optional-dependencies"].values(), project["dependencies"])
    return {re.split(r"[^\w.-]", requirement)[0] for requirement in requirements}


def _nodes(kind: type[_Node]) -> Iterator[tuple[str, _Node]]:
    """Yield each syntax node of a kind in the package, with its file."""
    for file, tree in MODULES.items():
        yield from ((file, node) for node in ast.walk(tree) if isinstance(node, kind))


def test_paths_on_the_page_exist():
    """Somebody who follows the page finds what it names."""
    assert [path for path in sorted(PATHS) if not (REPOSITORY / path).exists()] == []


def test_rooms_are_on_the_page():
    """No room is left unexplained."""
    assert sorted(_room_files() - PATHS) == []


def test_the_layers_on_the_page_are_those_that_are_checked():
    """The diagram and the import contract say the same."""
    layers = "\n".join(PROJECT["tool"]["importlinter"]["contracts"][0]["layers"])

    assert f"```text\n{layers}\n```" in PAGE


def test_dependencies_have_a_reason_on_the_page():
    """Nothing is installed that the page does not account for."""
    tables = PAGE.partition("## Dependencies")[2]
    first_cells = [row.split("|")[1] for row in tables.splitlines() if row.startswith("| `")]
    explained = set(re.findall(r"`([^`]+)`", " ".join(first_cells)))

    assert explained == _distributions()


def _tour_lines() -> int:
    return sum(len((REPOSITORY / stop).read_text().splitlines()) for stop in stops())


def _places() -> int:
    return sum(places(HOUSE, "").values())


def _names_taken() -> int:
    """Count names that a method's modules import from another's; `between` builds on `online`."""
    taken = HOUSE.taken()
    return sum(not (of == "distributed" and name.startswith("parts.online.")) for of, name in taken)


def _imported(tree: ast.Module) -> Iterator[str]:
    """Yield the full names that a module imports from the package, without `tiswarm.`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("tiswarm"):
            for name in node.names:
                yield f"{node.module}.{name.name}".removeprefix("tiswarm.")


def _core_files_that_name_a_part() -> int:
    """Count files that import from `tiswarm.parts`, for types too, or have its name in a text."""
    naming = {
        file
        for file, tree in MODULES.items()
        for name in [*_imported(tree), *_texts(tree)]
        if name.removeprefix("tiswarm.").startswith("parts.")
    }
    return len({file for file in naming if not file.startswith("tiswarm/parts/")})


def _texts(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from re.findall(r"tiswarm\.[\w.]+", node.value)


def _entries() -> int:
    entries = {path.name for path in (REPOSITORY / "tiswarm").iterdir()}
    return len(entries - {"__pycache__", "py.typed"})


def _names_that_cross_rooms() -> int:
    """Count what core modules import from rooms that are not their own, each name once."""
    crossing = {
        name
        for file, tree in MODULES.items()
        for name in _imported(tree)
        if name.split(".")[0] not in {file.removesuffix(".py").split("/")[1], "parts"}
        and not file.startswith("tiswarm/parts/")
    }
    return len(crossing)


def _names_with_two_meanings() -> int:
    names = Counter(node.name.lstrip("_") for _, node in _nodes(ast.ClassDef))
    return sum(count > 1 for count in names.values())


def _functions() -> tuple[list[ast.FunctionDef], list[ast.FunctionDef]]:
    """Return the functions of the package, and its kernels."""
    kinds: tuple[list[ast.FunctionDef], list[ast.FunctionDef]] = ([], [])
    for _, node in _nodes(ast.FunctionDef):
        kinds["ti.kernel" in map(ast.unparse, node.decorator_list)].append(node)
    return kinds


def _body_lines(node: ast.FunctionDef) -> int:
    """Count the lines of a function after its signature and docstring."""
    has_docstring = ast.get_docstring(node) is not None
    return node.end_lineno - (node.body[0].end_lineno if has_docstring else node.body[0].lineno - 1)


def _files_that_name_a_measure() -> int:
    """Count the modules with a measure's column as text, of the measure that has most.

    Columns of one word are left out: estimates and logs use such words, too.
    """
    files: dict[str, set[str]] = {name: set() for name in COLUMNS if "_" in name}
    statistic = re.compile(r"(.+?)(_mean|_std|_ci95|_least|_most)?")
    for file, node in _nodes(ast.Constant):
        if isinstance(node.value, str) and (found := statistic.fullmatch(node.value)):
            files.get(found[1], set()).add(file)
    return max(map(len, files.values()))


def _files_that_name_a_key() -> int:
    """Count the modules with an optional key of a log, or a cue, as text or attribute: the most.

    In rooms without logs these names, and in all rooms other cues of one word, mean other things.
    """
    optional = {name for name, key in KEYS.items() if key.version > 1 or name in NUMBERS}
    files: dict[str, set[str]] = {
        name: set()
        for name in optional | {cue.name for cue in CUES if cue.rows and "_" in cue.name}
    }
    for kind, named in ((ast.Constant, "value"), (ast.Attribute, "attr")):
        for file, node in _nodes(kind):
            name = getattr(node, named)
            if isinstance(name, str) and file.split("/")[1] not in {"compute", "engine", "world"}:
                files.get(name, set()).add(file)
    return max(map(len, files.values()))


MEASURES: dict[str, Callable[[], float]] = {
    "files of the tour": lambda: len(stops()),
    "lines of these files": _tour_lines,
    "files of the package": lambda: len(MODULES),
    "lines of the core": lambda: HOUSE.lines() - HOUSE.lines("parts"),
    "import lines per 100 lines": lambda: 100.0 * HOUSE.import_lines() / HOUSE.lines(),
    "lines that the import of `joint` loads": lambda: HOUSE.closure(ROOTS["joint"]),
    "places where the concepts of `benchmarks/places.csv` stand": _places,
    "names that methods take from each other, but `distributed` from `online`": _names_taken,
    "files of the core that name a part": _core_files_that_name_a_part,
    "entries at the top of the package": _entries,
    "names that modules of the core import from other rooms": _names_that_cross_rooms,
    "class names with two meanings": _names_with_two_meanings,
    "arguments of a kernel": lambda: max(len(node.args.args) for node in _functions()[1]),
    "lines of the body of a kernel": lambda: max(map(_body_lines, _functions()[1])),
    "lines of the body of another function": lambda: max(map(_body_lines, _functions()[0])),
    "modules that name one measure": _files_that_name_a_measure,
    "modules that name one key or cue": _files_that_name_a_key,
    "comments per 100 lines of numerical code": HOUSE.comments,
}
"""By name on the page, what measures a quantity."""


def _limits() -> dict[str, tuple[str, float]]:
    """Read the table of limits: by quantity the side of the limit, and the limit."""
    table = PAGE.partition("## Limits that tests hold")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| ([^|]+) \| (at \w+) ([\d.,]+) \|", table, re.MULTILINE)
    return {name: (side, float(limit.replace(",", ""))) for name, side, limit in rows}


def test_each_limit_is_on_the_page():
    """A reader of the table knows all that is measured."""
    assert {*_limits()} == {*MEASURES}


@pytest.mark.parametrize("quantity", MEASURES)
def test_a_limit_is_held(quantity):
    """The house stays as small as its page says."""
    side, limit = _limits()[quantity]

    now = MEASURES[quantity]()

    assert now <= limit if side == "at most" else now >= limit, f"{quantity}: {now:,}"


def test_settings_are_read_from_instances():
    """A frozen dataclass protects its instances; its class could be written to."""
    defaults = {
        node.name: {
            line.target.id
            for line in node.body
            if isinstance(line, ast.AnnAssign) and line.value is not None
        }
        for _, node in _nodes(ast.ClassDef)
        if any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)
    }
    read_from_class = [
        f"{file}:{node.lineno}: {ast.unparse(node)}"
        for file, node in _nodes(ast.Attribute)
        if isinstance(node.value, ast.Name) and node.attr in defaults.get(node.value.id, ())
    ]

    assert read_from_class == []
