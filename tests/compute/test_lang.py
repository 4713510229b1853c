"""The kernel language is the one that can be imported; house rules of writing kernels."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.compute import lang

PACKAGE = Path(__file__).parents[2] / "tiswarm"
MOST_PARAMETERS = 10


def _functions():
    """Every function of the package, with its file and the decorators of kernels that it has."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef):
                names = {ast.unparse(decorator) for decorator in node.decorator_list}
                yield str(file.relative_to(PACKAGE)), node, names & {"ti.func", "ti.kernel"}


def _kernels():
    """Every kernel, with its file."""
    return [(file, node) for file, node, kinds in _functions() if "ti.kernel" in kinds]


def _written(kernel):
    """Names of the arrays to which a kernel itself writes, not through a bundle."""
    arguments = {argument.arg for argument in kernel.args.args}
    for node in ast.walk(kernel):
        targets = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AugAssign):
            targets = [node.target]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).startswith("ti.atomic"):
            targets = node.args[:1]
        for target in targets:
            if isinstance(target, ast.Subscript) and ast.unparse(target.value) in arguments:
                yield ast.unparse(target.value)


def test_kernel_functions_take_at_most_ten_arguments():
    """Only a kernel itself lists its arrays; functions take bundles of them."""
    long = [
        f"{file}: {node.name}"
        for file, node, kinds in _functions()
        if kinds == {"ti.func"} and len(node.args.args) > MOST_PARAMETERS
    ]

    assert long == []


def test_arrays_that_kernels_write_are_named_for_it():
    """Whoever reads the arguments knows what a launch changes."""
    unnamed = {
        f"{file}: {node.name} writes {name}"
        for file, node in _kernels()
        for name in _written(node)
        if not name.endswith("_out")
    }

    assert unnamed == set()


def test_kernels_stand_in_files_named_for_them():
    """So that one pattern tells every checker which files hold kernels."""
    files = {file for file, _, kinds in _functions() if kinds}

    assert {file for file in files if not file.endswith("kernels.py")} == set()


@pytest.fixture
def without_taichi(monkeypatch):
    """A machine on which taichi is installed, but not the library that it loads."""

    def import_module(name):
        if name == "taichi":
            sys.setdlopenflags(0)
            message = "libX11.so.6: no such file"
            raise ImportError(message)
        return name

    monkeypatch.setattr(lang, "find_spec", lambda name: name)
    monkeypatch.setattr(lang, "import_module", import_module)


def test_quadrants_takes_the_place_of_a_taichi_that_cannot_be_imported(
    without_taichi, monkeypatch, capsys
):
    """One line says so, since the last digits of stresses differ."""
    monkeypatch.delenv("TISWARM_BACKEND", raising=False)
    flags = sys.getdlopenflags()

    assert lang.load_library() == ("quadrants", "quadrants")

    said = "taichi cannot be imported: libX11.so.6: no such file; computing with quadrants"
    assert capsys.readouterr().err == f"tiswarm: warning: {said}\n"
    assert sys.getdlopenflags() == flags


def test_a_library_that_is_asked_for_is_not_replaced(without_taichi, monkeypatch):
    """The error names the package to install."""
    monkeypatch.setenv("TISWARM_BACKEND", "taichi")

    with pytest.raises(EnvironmentTroubleError, match=r"libX11.*; on Debian, run: .* libx11-6"):
        lang.load_library()


def test_child_processes_print_as_they_would_alone():
    """How this process prints is in no variable that they inherit."""
    assert not [name for name in os.environ if name.endswith(("_ENABLE_PYBUF", "_LOG_LEVEL"))]


@pytest.mark.trial
def test_replaced_output_stays_silent():
    """A program that collects its output in a text finds no line of the library on the terminal."""
    replaced = (
        "import io, sys; sys.stdout = sys.stderr = io.StringIO(); import tiswarm.compute.lang"
    )

    done = subprocess.run([sys.executable, "-c", replaced], capture_output=True, check=True)

    assert (done.stdout, done.stderr) == (b"", b"")


class _Plane(lang.Columns):
    POINT = 3
    PRECISION = 1


class _NamedPlane(_Plane):
    NUMBER = 1


def test_functions_of_classes_are_known_by_where_they_stand():
    """The library asks this of each function that is defined, and passes `self` to these alone."""
    found = {}

    def define(name):
        found[name] = lang._is_in_class(3)  # noqa: SLF001

    class Outer:
        define("class")

        def method(self):
            define("method")

    Outer().method()
    define("function")

    assert found == {"class": True, "method": False, "function": False}


def test_columns_have_one_place_and_one_width():
    """A table is packed as it was declared, whatever the order of arguments."""
    point, precision = np.arange(6.0).reshape(2, 3), np.array([7.0, 8.0])

    table = _NamedPlane.pack(NUMBER=precision, PRECISION=precision, POINT=point)

    assert (_NamedPlane.POINT, _NamedPlane.PRECISION, _NamedPlane.NUMBER) == (0, 3, 4)
    assert (_Plane.TOTAL, _NamedPlane.TOTAL) == (4, 5)
    np.testing.assert_array_equal(table[:, _NamedPlane.PRECISION], precision)
    np.testing.assert_array_equal(table[:, :3], point)


@pytest.mark.parametrize(
    "columns", [{"PRECISION": 1}, {"POINT": 2}, {"POINT": 3, "NUMBER": 1}], ids=str
)
def test_a_table_without_its_columns_is_refused(columns):
    """A column is missing, has another width, or is of another table."""
    arrays = {name: np.ones((4, width)) for name, width in columns.items()}

    with pytest.raises(ValueError, match="columns of _Plane"):
        _Plane.pack(**arrays)
