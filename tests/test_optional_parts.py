"""Optional parts: the core of the package works without each, and an error names what is missing.

What is in `tiswarm/parts/` is a part.
"""

import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.runs import REPOSITORY, call, python
from tests.test_tour import stops
from tiswarm.base import parts

PARTS = sorted(
    f"tiswarm.parts.{path.stem}"
    for path in (REPOSITORY / "tiswarm" / "parts").iterdir()
    if not path.name.startswith("__")
)

JOINT = "localization={method: joint, chains: 1, steps: 10, hold_steps: 5, refine: false}"
SMALL = ["robots=6", "seeds=1", "conditions={joint: {}}", JOINT]
CORE = f"""
import tiswarm
run = tiswarm.run("tower", {SMALL}, out="runs", quiet=True)
assert run.summary["status"].tolist() == ["done"]
[log] = run.folder.glob("cases/*/sensing.jsonl")
assert run.figures and run.page.is_file() and not (run.folder / "renders").exists()
estimate = tiswarm.read_log(log).localize(chains=1, steps=10, hold_steps=5)
assert estimate.position.shape == (6, 3)
assert estimate.view(out="view.html").is_file()
"""

ASKED = {
    "tiswarm.parts.live": "view runs --live",
    "tiswarm.parts.comparison": "compare one other",
    "tiswarm.parts.doctor": "doctor --missing-packages",
    "tiswarm.parts.formats": "export sensing.jsonl known.csv --format csv",
    "tiswarm.parts.between": "localize sensing.jsonl --method distributed",
    "tiswarm.parts.channels": "localize sensing.jsonl --method distributed",
    "tiswarm.parts.peers": "localize sensing.jsonl --method hop-by-hop",
    "tiswarm.parts.online": "localize sensing.jsonl --method online",
    "tiswarm.parts.advice": "advise sensing.jsonl known.csv",
    "tiswarm.parts.pictures": "export sensing.jsonl known.csv --format png",
    "tiswarm.parts.navigation": "run tower --set structure.navigate_by=estimate --set robots=4 "
    "--set seeds=1 --no-pictures --quiet",
    "tiswarm.parts.flips": "localize sensing.jsonl --set flip_axes=6",
    "tiswarm.parts.forecast": "run tower --plan",
    "tiswarm.parts.cluster": "run tower --scheduler tcp://127.0.0.1:1",
    "tiswarm.parts.growth": "run tower --plugin rule.py --set structure.rule=stay --set robots=4 "
    "--set seeds=1 --no-pictures --quiet",
    "tiswarm.parts.suites": "run tower --set sensing.suite=zooids --plan",
}
"""By part, a command that needs it."""

CALLED = {
    "tiswarm.parts.swarms": "tiswarm.grow(robots=4, quiet=True)",
    "tiswarm.parts.forces": "tiswarm.relax([], [], [], robot=None, steps=0)",
}
"""By part, a call that needs it, where no command does."""

STAY = """
import tiswarm
@tiswarm.rule("stay")
class Stay:
    def choose(self, step):
        return 0 * step.stance - 1
"""

SILENT = {"tiswarm.parts.curve_figures", "tiswarm.parts.questions", "tiswarm.parts.units"}
"""Parts without which a page or check has less in it, and no command fails."""

ALSO_LACKING = {
    "tiswarm.parts.online": ["tiswarm.parts.between"],
}
"""By part, others that begin where it ends, and cannot do without it."""

ASK = f"""
from tiswarm.scenario.model import scenario_schema
scenario_schema()
import tiswarm
assert not tiswarm.check("tower").mistakes
assert not tiswarm.check("sensing.jsonl").mistakes
missing = sys.argv.pop(1)
for part in {PARTS}:
    if part not in [missing, *{ALSO_LACKING}.get(missing, [])]:
        __import__(part)
from tiswarm.cli import main
call = {CALLED}.get(missing)
if call is None:
    main()
else:
    try:
        eval(call)
    except tiswarm.EnvironmentTroubleError as error:
        sys.exit(f"tiswarm: error: {{error}}")
"""
"""Loads what lists methods, senses and formats, and all other parts; then asks for the part."""


ALONE = """
import sys
# An editable installation would find there what the copy lacks.
sys.meta_path = [find for find in sys.meta_path if "Editable" not in getattr(find, "__name__", "")]
"""


def _call(folder, code, *arguments):
    """Run Python code with the copy of the package in a folder, and no other one."""
    return python("-c", ALONE + code, *arguments, cwd=folder, PYTHONPATH=str(folder))


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Folder of a small case, with its log and its estimate."""
    folder = tmp_path_factory.mktemp("whole")
    settings = [argument for text in SMALL for argument in ("--set", text)]
    done = call("run", "tower", *settings, "--no-pictures", "--out", folder)
    assert done.returncode == 0, done.stderr
    [found] = folder.glob("tower-*/cases/*")
    return found


def _copy_without(parts, folder, case) -> Path:
    """Copy the package without some parts, and a log and its estimate, into a folder."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(REPOSITORY / "tiswarm", folder / "tiswarm", ignore=ignored)
    for part in parts:
        place = folder.joinpath(*part.split("."))
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.with_suffix(".py").unlink()
    shutil.copy(case / "sensing.jsonl", folder)
    shutil.copy(case / "estimate.csv", folder / "known.csv")
    (folder / "rule.py").write_text(STAY)
    return folder


@pytest.mark.parametrize("part", sorted({*PARTS} - SILENT - {*CALLED}))
def test_a_part_that_is_missing_is_named(tiswarm, small_run, tmp_path, monkeypatch, part):
    """A command that needs it ends in a line, here where its import fails."""
    case = small_run / "cases" / "0-baseline"
    shutil.copy(case / "sensing.jsonl", tmp_path)
    shutil.copy(case / "estimate.csv", tmp_path / "known.csv")
    (tmp_path / "rule.py").write_text(STAY)
    for name in [*sys.modules]:
        if f"{name}.".startswith(f"{part}."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, part, None)

    done = tiswarm(*ASKED[part].split(), cwd=tmp_path)

    assert done.returncode == 1, done.stderr
    [line] = done.stderr.splitlines()
    lack = rf"needs {part}(\.\w+)?, which this copy of tiswarm lacks; install all of it"
    assert re.fullmatch(rf"tiswarm: error: .* {lack}", line)


@pytest.mark.trial
def test_the_core_works_without_any_part(tmp_path, case):
    """It imports, runs a study by `joint` with figures and page, localizes a log and shows it."""
    done = _call(_copy_without(PARTS, tmp_path, case), CORE)

    assert done.returncode == 0, done.stderr


@pytest.mark.trial
@pytest.mark.parametrize("part", sorted({*PARTS} - SILENT))
def test_without_a_part_all_others_are_there_and_it_is_named(tmp_path, case, part):
    """Who asks for it gets a line that names the module; no other part needs it to be loaded."""
    done = _call(_copy_without([part], tmp_path, case), ASK, part, *ASKED.get(part, "").split())

    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert line.startswith("tiswarm: error: ")
    assert f"needs {part}" in line
    assert line.endswith("lacks; install all of it")


@pytest.mark.trial
def test_the_files_of_the_tour_load_settings_of_parts_only():
    """A scenario checks the settings of every method; their code waits until it is used."""
    names = [stop.removesuffix(".py").replace("/", ".") for stop in stops()]
    code = f"import sys; import {', '.join(names)}; print(*sys.modules, sep='\\n')"

    loaded = _call(REPOSITORY, code).stdout.splitlines()

    methods = {place.partition(":")[0] for place in parts.PARTS["method"].values()}
    assert {*names} <= {*loaded}
    assert {name for name in loaded if name.startswith("tiswarm.parts.")} == {
        name for name in methods if name.startswith("tiswarm.parts.")
    }
