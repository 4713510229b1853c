"""`docs/architecture.md` tells the truth about the repository, and each class has its own name."""

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

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
MODULES = {
    str(file.relative_to(REPOSITORY)): ast.parse(file.read_text(encoding="utf-8"))
    for file in sorted((REPOSITORY / "tiswarm").rglob("*.py"))
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


def test_a_class_name_has_one_meaning():
    """A reader who knows a name from one room is not misled in another one."""
    names = Counter(node.name.lstrip("_") for _, node in _nodes(ast.ClassDef))

    assert {name for name, count in names.items() if count > 1} == set()


def test_the_package_has_at_most_18_entries():
    """A stranger who lists the folder sees the rooms and little else."""
    package = REPOSITORY / "tiswarm"
    entries = {path.name for path in package.iterdir()} - {"__pycache__", "py.typed"}

    assert len(entries) <= 18, sorted(entries)


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
