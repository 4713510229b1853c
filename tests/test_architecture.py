"""`docs/architecture.md` tells the truth about the repository."""

import re
import sys
from pathlib import Path

import pytest

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
BARE_FILE_NAMES = {"kernels.py"}  # one in several rooms


def _room_files() -> set[str]:
    package = REPOSITORY / "tiswarm"
    modules = {f"tiswarm/{file.name}" for file in package.glob("*.py")} - {"tiswarm/__init__.py"}
    return modules | {f"tiswarm/{file.parent.name}/" for file in package.glob("*/__init__.py")}


def _distributions() -> set[str]:
    project = PROJECT["project"]
    requirements = project["dependencies"] + project["optional-dependencies"]["dev"]
    return {re.split(r"[^\w.-]", requirement)[0] for requirement in requirements}


@pytest.mark.parametrize("path", sorted(PATHS - BARE_FILE_NAMES))
def test_a_path_on_the_page_exists(path):
    """Somebody who follows the page finds what it names."""
    assert (REPOSITORY / path).exists()


@pytest.mark.parametrize("room", sorted(_room_files()))
def test_a_room_is_on_the_page(room):
    """No room is left unexplained."""
    assert room in PATHS


def test_the_layers_on_the_page_are_those_that_are_checked():
    """The diagram and the import contract say the same."""
    layers = "\n".join(PROJECT["tool"]["importlinter"]["contracts"][0]["layers"])

    assert f"```text\n{layers}\n```" in PAGE


@pytest.mark.parametrize("distribution", sorted(_distributions()))
def test_a_dependency_has_a_reason_on_the_page(distribution):
    """Nothing is installed that the page does not account for."""
    tables = PAGE.partition("## Dependencies")[2]
    rows = [row.split("|")[1] for row in tables.splitlines() if row.startswith("| `")]

    assert any(f"`{distribution}`" in row for row in rows)
