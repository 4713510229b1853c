"""The kernel language is the one that can be imported; house rules of writing kernels."""

import ast
import os
import sys
from pathlib import Path

import pytest

from tiswarm.compute import lang
from tiswarm.errors import EnvironmentTroubleError

PACKAGE = Path(__file__).parents[2] / "tiswarm"
MOST_PARAMETERS = 10


def _kernel_functions():
    """Every function of a kernel, with its file."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef):
                names = {ast.unparse(decorator) for decorator in node.decorator_list}
                if names & {"ti.func", "ti.kernel"}:
                    yield str(file.relative_to(PACKAGE)), node, "ti.kernel" in names


def test_kernel_functions_take_at_most_ten_arguments():
    """Only a kernel itself lists its arrays; functions take bundles of them."""
    long = [
        f"{file}: {node.name}"
        for file, node, is_kernel in _kernel_functions()
        if not is_kernel and len(node.args.args) > MOST_PARAMETERS
    ]

    assert long == []


def test_kernels_stand_in_files_named_for_them():
    """So that one pattern tells every checker which files hold kernels."""
    files = {file for file, _, _ in _kernel_functions()}

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
    assert not [name for name in os.environ if name.endswith("_ENABLE_PYBUF")]
