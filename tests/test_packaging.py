"""What is installed, and what is handed out."""

import ast
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import tiswarm
from tiswarm.compute import lang

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).parents[1]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
PINS = (REPOSITORY / "constraints.txt").read_text().splitlines()

IMPORTED_AS = {  # modules that are not named after what brings them
    "PIL": "pillow",
    "backports": "backports.zstd",
    "mpl_toolkits": "matplotlib",
    "pydantic_core": "pydantic",
    "yaml": "pyyaml",
}
SAME_MODULE = {"open3d-cpu"}  # imported as open3d

REGISTRY = re.compile(r"pythonhoste[d]|pypi[.]org|index-ur[l]|find-link[s]|trusted-hos[t]")
HOME = re.compile(r"/hom[e]/\w|(?<![\w.])/roo[t]\b|/User[s]/\w|[A-Z]:\\User[s]\\")


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _names(requirements: list[str]) -> set[str]:
    return {_normal(re.split(r"[^\w.-]", requirement)[0]) for requirement in requirements}


def _imported() -> set[str]:
    """List what the package imports, anywhere in it, that Python itself does not bring."""
    modules = set()
    for file in (REPOSITORY / "tiswarm").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                modules.add(node.module.partition(".")[0])
    newer = {"compression"}  # of Python 3.14
    return modules - sys.stdlib_module_names - newer - {"tiswarm"}


def _handed_out() -> list[Path]:
    folders = (".ci", "benchmarks", "docs", "scenarios", "tests", "tiswarm")
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*")]
    files += [file for file in REPOSITORY.iterdir() if file.name not in {".coverage", ".git"}]
    return [file for file in files if file.is_file() and "__pycache__" not in file.parts]


@pytest.mark.parametrize("module", ["matplotlib", "open3d", "pandas", "taichi"])
def test_importing_tiswarm_is_light(module):
    """`import tiswarm` loads none of the libraries that take long."""
    code = f"import sys, tiswarm; sys.exit({module!r} in sys.modules)"

    done = subprocess.run([sys.executable, "-c", code], check=False)

    assert done.returncode == 0


def test_types_are_handed_out():
    """A user's type checker reads our annotations if this file is installed."""
    tool = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]

    assert "py.typed" in tool["setuptools"]["package-data"]["tiswarm"]
    assert (REPOSITORY / "tiswarm" / "py.typed").is_file()


def test_the_version_is_said_once():
    """What is installed carries the version that the package states."""
    assert metadata.version("tiswarm") == tiswarm.__version__


def test_constraints_are_pins():
    """A line is a name, a version and at most a condition; no place to fetch it from."""
    pin = re.compile(r"[\w.-]+==[\w.!+]+( ?; [\w.'\" =<>!()-]+)?")

    assert [line for line in PINS if not pin.fullmatch(line)] == []


def test_every_dependency_is_pinned():
    """Runtime, extras and build: none is left to the day of the installation."""
    pyproject = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    wanted = sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"])
    wanted += pyproject["build-system"]["requires"]

    assert _names(wanted) <= _names(PINS)


def test_every_import_is_a_dependency():
    """What the package imports is what it or an extra asks for, no more and no less."""
    modules = _imported() | set(lang.LIBRARIES)  # these are imported by name
    needed = {_normal(IMPORTED_AS.get(module, module)) for module in modules}
    extras = {**PROJECT["optional-dependencies"], "bench": [], "dev": []}.values()

    assert needed == _names(sum(extras, PROJECT["dependencies"])) - SAME_MODULE


def test_no_file_names_a_registry_or_a_home():
    """The repository works for anybody: it knows no package server and nobody's folders."""
    found = []
    for file in _handed_out():
        text = file.read_bytes().decode(errors="ignore")
        found += [(file.name, hit) for rule in (REGISTRY, HOME) for hit in rule.findall(text)]

    assert found == []


def test_the_example_of_the_readme_runs():
    """As it stands there."""
    example = re.search(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.DOTALL)

    done = subprocess.run([sys.executable, "-c", example[1]], check=False, cwd=REPOSITORY)

    assert done.returncode == 0
