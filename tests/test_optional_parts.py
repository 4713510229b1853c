"""Optional parts: the spine of the package works without each, and an error names what is missing.

`pyproject.toml` lists the parts and the modules of the spine.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.runs import REPOSITORY, call, environment
from tests.test_architecture import CONTRACT
from tests.test_tour import stops

PARTS = CONTRACT["forbidden_modules"]

JOINT = "localization={method: joint, chains: 1, steps: 10, hold_steps: 5, refine: false}"
SMALL = ["robots=6", "seeds=1", "conditions={joint: {}}", JOINT]
SPINE = f"""
import tiswarm
run = tiswarm.run("tower", {SMALL}, out="runs", pictures=False, quiet=True)
assert run.summary["status"].tolist() == ["done"]
[log] = run.folder.glob("cases/*/sensing.jsonl")
assert tiswarm.read_log(log).localize(chains=1, steps=10, hold_steps=5).position.shape == (6, 3)
"""

ASKED = {
    "tiswarm.app.live": "view runs --live",
    "tiswarm.interop": "export sensing.jsonl estimate.csv",
    "tiswarm.localization.hop_by_hop": "localize sensing.jsonl --method hop-by-hop",
    "tiswarm.localization.least_squares": "localize sensing.jsonl --method least-squares",
    "tiswarm.localization.together": "localize sensing.jsonl --method virtual-force "
    "--set schedule=together",
    "tiswarm.measurements.advice": "advise sensing.jsonl estimate.csv",
    "tiswarm.report.render": "render sensing.jsonl estimate.csv",
    "tiswarm.sensing.suites": "run tower --set sensing.suite=zooids --plan",
}
"""By part, a command that needs it."""


ALONE = """
import sys
# An editable installation would find there what the copy lacks.
sys.meta_path = [find for find in sys.meta_path if "Editable" not in getattr(find, "__name__", "")]
"""


def _call(folder, code, *arguments):
    """Run Python code with the copy of the package in a folder, and no other one."""
    return subprocess.run(
        [sys.executable, "-c", ALONE + code, *arguments],
        cwd=folder,
        env=environment(PYTHONPATH=str(folder)),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Folder of a small case, with its log and its estimate."""
    folder = tmp_path_factory.mktemp("whole")
    settings = [argument for text in SMALL for argument in ("--set", text)]
    done = call("run", "tower", *settings, "--no-pictures", "--out", folder)
    assert done.returncode == 0, done.stderr
    [found] = folder.glob("tower-*/cases/*")
    return found


@pytest.fixture(params=PARTS)
def part(request) -> str:
    """Name of an optional part."""
    return request.param


@pytest.fixture
def copy(part, tmp_path, case) -> Path:
    """Folder with a copy of the package that lacks a part, and with a log and its estimate."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(REPOSITORY / "tiswarm", tmp_path / "tiswarm", ignore=ignored)
    place = tmp_path.joinpath(*part.split("."))
    if place.is_dir():
        shutil.rmtree(place)
    else:
        place.with_suffix(".py").unlink()
    for name in ("sensing.jsonl", "estimate.csv"):
        shutil.copy(case / name, tmp_path)
    return tmp_path


def test_the_spine_works_without_a_part(copy):
    """It imports, runs a study by `joint` and localizes a log."""
    done = _call(copy, SPINE)

    assert done.returncode == 0, done.stderr


def test_who_asks_for_a_missing_part_gets_a_line(copy, part):
    """The line names the module that this copy lacks, and there is no traceback."""
    done = _call(copy, "from tiswarm.cli import main; main()", *ASKED[part].split())

    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert line.startswith("tiswarm: error: ")
    assert f"needs {part}" in line
    assert line.endswith("lacks; install all of it")


def test_the_files_of_the_tour_load_no_part():
    """Not even by a module that the contract forgets."""
    names = [stop.removesuffix(".py").replace("/", ".") for stop in stops()]
    code = f"import sys; import {', '.join(names)}; print(*sys.modules, sep='\\n')"

    loaded = _call(REPOSITORY, code).stdout.splitlines()

    assert {*names} <= {*loaded}
    assert [name for name in loaded if f"{name}.".startswith(tuple(f"{p}." for p in PARTS))] == []
