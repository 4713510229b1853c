"""Processes that the program starts import what it imports, and nothing of the working folder."""

import os
import subprocess

from tests.runs import REPOSITORY
from tiswarm.base.process import child_command


def test_a_child_imports_nothing_of_the_working_folder(tmp_path):
    """Files named like modules there neither run nor hide the modules, even at start-up."""
    names = ("calendar", "linecache", "numpy", "random", "tiswarm")
    for name in names:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported from here')")

    done = subprocess.run(
        child_command(f"import {', '.join(names)}; print(tiswarm.__file__)"),
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )

    assert (done.stderr, done.stdout.strip()) == ("", str(REPOSITORY / "tiswarm" / "__init__.py"))


def test_children_are_started_in_one_way():
    """No other module of the package names the interpreter."""
    modules = (REPOSITORY / "tiswarm").rglob("*.py")

    named = [path.name for path in modules if "sys.executable" in path.read_text()]

    assert named == ["process.py"]
