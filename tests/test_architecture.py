"""`docs/architecture.md` is true of the repository, and functions stay readable."""

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
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
MOST_KERNEL_ARGUMENTS = 30
MOST_KERNEL_LINES = 100
MOST_FUNCTION_LINES = 60

_Node = TypeVar("_Node", bound=ast.AST)


def _room_files() -> set[str]:
    package = REPOSITORY / "tiswarm"
    modules = {f"tiswarm/{file.name}" for file in package.glob("*.py")} - {"tiswarm/__init__.py"}
    return modules | {f"tiswarm/{file.parent.name}/" for file in package.glob("*/__init__.py")}


def _distributions() -> set[str]:
    project = PROJECT["project"]
    requirements = sum(project["optional-dependencies"].values(), project["dependencies"])
    return {re.split(r"[^\w.-]", requirement)[0] for requirement in requirements}


@cache
def _modules() -> dict[str, ast.Module]:
    """Return the syntax tree of each module of the package, by its file."""
    return {
        str(file.relative_to(REPOSITORY)): ast.parse(file.read_text(encoding="utf-8"))
        for file in sorted((REPOSITORY / "tiswarm").rglob("*.py"))
    }


def _nodes(kind: type[_Node]) -> Iterator[tuple[str, _Node]]:
    """Yield each syntax node of a kind in the package, with its file."""
    for file, tree in _modules().items():
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


def _functions() -> Iterator[tuple[str, bool, ast.FunctionDef]]:
    """Yield each function of the package: file and name, whether it is a kernel, its node."""
    for file, node in _nodes(ast.FunctionDef):
        is_kernel = "ti.kernel" in map(ast.unparse, node.decorator_list)
        yield f"{file}: {node.name}", is_kernel, node


def _body_lines(node: ast.FunctionDef) -> int:
    """Count the lines of a function after its signature and docstring."""
    has_docstring = ast.get_docstring(node) is not None
    first_line = node.body[0].end_lineno + 1 if has_docstring else node.body[0].lineno
    return node.end_lineno - first_line + 1


def test_kernels_take_at_most_30_arguments():
    """A reader can hold what a launch reads and writes; backends have limits of their own."""
    too_many = [
        name
        for name, is_kernel, node in _functions()
        if is_kernel and len(node.args.args) > MOST_KERNEL_ARGUMENTS
    ]

    assert too_many == []


def test_functions_can_be_read_at_once():
    """A body has at most 60 lines, that of a kernel, which cannot be split as freely, 100."""
    too_long = [
        name
        for name, is_kernel, node in _functions()
        if _body_lines(node) > (MOST_KERNEL_LINES if is_kernel else MOST_FUNCTION_LINES)
    ]

    assert too_long == []


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
