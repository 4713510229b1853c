"""Plug-ins: methods and formats from a file of a user, and what happens where one is wrong."""

import json
import pickle
import re
import runpy
import shutil
import sys
import textwrap
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

import tiswarm as library
from tests.runs import REPOSITORY
from tiswarm.base import plugins, registry
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.model import Scenario, dump_scenario, scenario_schema
from tiswarm.scenario.validation import localization_params
from tiswarm.study import runner

PAGE = (REPOSITORY / "docs" / "own-method.md").read_text()
CHAIN, RADAR, FADES, LEANING, WORST, _WALKS, XYZ, READ, DRAW = re.findall(
    r"```python\n(.*?)```", PAGE, re.DOTALL
)
[STUDY] = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
RULES = (REPOSITORY / "docs" / "guides" / "rules.md").read_text()
[RANDOM, *_] = re.findall(r"```python\n(.*?)```", RULES, re.DOTALL)
[MY_RULES] = re.findall(r"```yaml\n(.*?)```", RULES, re.DOTALL)
ORIGIN = """
import numpy as np
import tiswarm

@tiswarm.method("origin")
def locate(log):
    return np.zeros((log.robot_count, 3))
"""
FAILS = ORIGIN.replace("np.zeros((log", "np.zeros((log_")
SCENARIO = """
name: own
robots: 5
seeds: 2
structure: {kind: tower}
localization: {method: origin}
conditions:
  own: {}
  hops: {localization: {method: hop-by-hop}}
"""
RADARS = """
name: own
robots: 5
seeds: 2
structure: {kind: tower}
localization: {method: hop-by-hop}
conditions:
  usual: {}
  radar: {sensing: {suite: radar}}
"""


@pytest.fixture(autouse=True)
def _forget():
    """Leave no plug-in to the next test."""
    yield
    plugins.forget()


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Working folder with a plug-in and a scenario for it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(ORIGIN)
    (tmp_path / "own.yaml").write_text(SCENARIO)
    return tmp_path


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Folder of a run of the scenario."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "own.py").write_text(ORIGIN)
    (folder / "own.yaml").write_text(SCENARIO)
    run = _run(folder)
    plugins.forget()
    return run.folder


@pytest.fixture
def log(files, whole):
    """A sensing log in a run of the working folder, whose plug-in is loaded."""
    run = shutil.copytree(whole, files / "runs" / whole.name)
    library.check("own.yaml", plugins=["own.py"])
    return run / "cases" / "0-own" / "sensing.jsonl"


def _run(files, **options):
    named = {"out": files / "runs", "pictures": False, "quiet": True, **options}
    return library.run(files / "own.yaml", plugins=[files / "own.py"], **named)


def _record(run, case):
    return json.loads((run.folder / "cases" / case / "case.json").read_text())


@pytest.mark.parametrize("workers", [(), pytest.param(("--workers", "2"), marks=pytest.mark.trial)])
def test_the_example_of_the_page_runs(tiswarm, tmp_path, workers):
    """Its commands check the scenario, run it, on two workers too, and localize a log."""
    (tmp_path / "chain.py").write_text(CHAIN)
    (tmp_path / "study.yaml").write_text(STUDY)
    small = ["--set", "robots=6", "--set", "seeds=1", "--no-pictures"]

    checked = tiswarm("check", "study.yaml", "--plugin", "chain.py", cwd=tmp_path)
    run = tiswarm("run", "study.yaml", "--plugin", "chain.py", *workers, *small, cwd=tmp_path)
    [case] = tmp_path.glob("reports/*/cases/0-chain")
    done = tiswarm(
        *("localize", case / "sensing.jsonl", "--plugin", "chain.py", "--method", "chain"),
        *("--set", "gap=2.1"),
        cwd=tmp_path,
    )

    assert checked.returncode == 0, checked.stderr
    assert run.returncode == 0, run.stderr
    assert re.search(r"^chain / .* \d", run.stdout, re.MULTILINE)
    assert json.loads((case / "case.json").read_text())["status"] == "done"
    assert "-> estimate.csv" in done.stdout


def test_a_setting_is_checked_as_any_other(files):
    """A wrong key, type or value is a line with its place."""
    (files / "own.py").write_text(CHAIN)
    library.check("own.yaml", plugins=["own.py"])
    wrong = {"gap=-1": "0 or more", "gap=x": "should be a number", "gab=1": "did you mean"}

    for setting, words in wrong.items():
        with pytest.raises(InputError, match=words):
            localization_params("chain", [setting])


def test_the_schema_has_settings_of_plugins(files):
    """Editors complete them, with their docstrings and defaults, and lose none of the others."""
    (files / "own.py").write_text(CHAIN)

    plugins.load_plugins(["own.py"])

    schema = scenario_schema()
    gap = schema["$defs"]["OwnChainParams"]["properties"]["gap"]
    assert gap["default"] == 2.0
    assert gap["description"] == "Distance of docks that touch [dock radii]."
    for section in (schema, *schema["$defs"].values()):
        for key, each in section.get("properties", {}).items():
            assert each.get("description"), key


def test_positions_get_verdicts(log):
    """All robots at the anchor fit no contact: the estimate says that it did not converge."""
    with pytest.warns(library.base.errors.ResultWarning):
        found = library.localize(log, "origin")

    assert found.convergence is not None
    assert not found.convergence.trusted


def test_an_estimate_is_returned_as_it_is(files, log):
    """A method that returns an estimate without verdicts has none."""
    code = ORIGIN.replace(
        "return np.zeros((log.robot_count, 3))",
        "from tiswarm.records.estimate import Estimate\n"
        "    position, none = np.zeros((log.robot_count, 3)), np.zeros(log.robot_count, bool)\n"
        "    return Estimate(robot_id=log.robot_id, position=position, disconnected=none,\n"
        "                    iteration=np.zeros(1), trace=position[None], residual=np.zeros(1))",
    )
    (files / "own.py").write_text(code)

    found = library.localize(log, "origin", plugins=["own.py"])

    assert found.convergence is None
    anchor = found.log.anchor_position
    np.testing.assert_array_equal(found.position, np.tile(anchor, (found.robot_count, 1)))


def test_the_record_of_a_case_has_the_digest_of_its_plugin(files):
    """Twelve hex digits of the file follow the digest of the package."""
    run = _run(files)

    digest = sha256((files / "own.py").read_bytes()).hexdigest()[:12]
    assert _record(run, "0-own")["code"].endswith(f"+{digest}")
    assert "+" not in _record(run, "0-hops")["code"]


def test_an_edit_computes_the_cases_of_the_plugin_again(files):
    """Cases of other methods stay as they are, to the inode."""
    before = _run(files)
    x = before.frame("estimate", case="0-own")["x_R"]
    kept = (before.folder / "cases" / "0-hops" / "case.json").stat().st_ino
    code = _record(before, "0-own")["code"]

    (files / "own.py").write_text(ORIGIN.replace("zeros", "ones"))
    after = _run(files)

    assert (after.folder / "cases" / "0-hops" / "case.json").stat().st_ino == kept
    assert _record(after, "0-own")["code"] != code
    moved = after.frame("estimate", case="0-own")["x_R"] - x
    np.testing.assert_allclose(moved, 1.0, rtol=1e-12)  # the anchor's place is rounded


@pytest.mark.parametrize("workers", [[], pytest.param(["--workers", "1"], marks=pytest.mark.trial)])
def test_an_exception_leaves_its_traceback_in_the_case(tiswarm, files, workers):
    """The case fails with a line that names the file, all others are done; --debug prints it."""
    (files / "own.py").write_text(FAILS)

    command = (
        "run",
        "own.yaml",
        "--plugin",
        "own.py",
        "--no-pictures",
        "--set",
        "seeds=1",
        *workers,
    )
    done = tiswarm(*command, cwd=files)
    debugged = tiswarm(*command[:7], "--debug", cwd=files)

    [run] = files.glob("reports/*")
    record = json.loads((run / "cases" / "0-own" / "case.json").read_text())
    traceback = (run / "cases" / "0-own" / "traceback.txt").read_text()
    hops = json.loads((run / "cases" / "0-hops" / "case.json").read_text())
    assert done.returncode == debugged.returncode == 3
    assert record["status"] == "failed"
    assert f"{files / 'own.py'}:7: origin failed: NameError" in record["reason"]
    assert record["reason"].endswith("cases/0-own/traceback.txt has the traceback")
    assert "Traceback (most recent call last)" in traceback
    assert hops["status"] == "done"
    assert "Traceback" not in done.stderr
    assert traceback in debugged.stderr


def test_localize_prints_a_line_or_with_debug_the_traceback(tiswarm, files, log):
    """A user of the method reads the line, its author the rest."""
    (files / "own.py").write_text(FAILS)

    command = ("localize", log, "--plugin", "own.py", "--method", "origin")
    done, debugged = tiswarm(*command, cwd=files), tiswarm(*command, "--debug", cwd=files)

    assert done.returncode == debugged.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "own.py:7: origin failed: NameError" in done.stderr
    assert "Traceback" in debugged.stderr


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("x = 1\n", "own.py: registers nothing; decorate a function"),
        ("def f(:\n", "own.py:1: invalid syntax; correct the plug-in"),
        ("\n1 / 0\n", "own.py:2: ZeroDivisionError: division by zero; correct the plug-in"),
        (ORIGIN.replace('"origin"', '"joint"'), "own.py:5: method joint is taken by tiswarm"),
        (ORIGIN.replace('"origin"', '"My Own"'), "own.py:5: 'My Own' names no method; use words"),
        (ORIGIN.replace('"origin"', '"o", cues=["smell"]'), "own.py:5: smell is not a cue; use"),
        (ORIGIN.replace('"origin"', '"o", settings=int'), "own.py:5: .* is no frozen dataclass"),
        (CHAIN.replace("gap: float", "method: float"), "own.py:.* method has a meaning already"),
        (CHAIN.replace("gap: float", "title: float"), "own.py:.* title has a meaning already"),
        (CHAIN.replace("gap: float", "gap: np.ndarray"), "own.py:.* use types like float or str"),
        (RADAR.replace('"radar"', '"atron"'), "own.py:6: sensor atron is taken by tiswarm itself"),
        (RADAR.replace('"ranges"', '"smells"'), "own.py:6: fills: the log has no list smells"),
        (XYZ.replace('"xyz"', '"ply"'), "own.py:4: export format ply is taken by tiswarm itself"),
        (READ.replace('"poses"', '"gsd"'), "own.py:6: import format gsd is taken by tiswarm"),
        (DRAW.replace('"cases"', '"error"'), "own.py:6: figure error is taken by tiswarm itself"),
        (LEANING.replace('"leaning"', '"chain"'), "own.py:7: structure chain is taken by tiswarm"),
        (LEANING.replace('"leaning"', '"a wall"'), "own.py:7: 'a wall' names no kind of structure"),
        (
            LEANING.replace("(TowerParams)", ""),
            "own.py:7: leaning: .* is no kind of structure",
        ),
        (LEANING.replace("TowerParams", "GrowthParams"), "own.py:7: leaning lacks terrain, behind"),
        (LEANING.replace("lean: float", "lean: np.ndarray"), "own.py:7: .* use types like float"),
        (WORST.replace('"worst_R"', '"rmse_R"'), "own.py:6: measure rmse_R is taken by tiswarm"),
        (WORST.replace('"worst_R"', '"worst R"'), "own.py:6: 'worst R' names no column; use lett"),
    ],
)
def test_a_mistake_in_a_plugin_is_a_line(files, code, problem):
    """It names file and line, what is wrong and what to do, and registers nothing."""
    (files / "own.py").write_text(code)

    with pytest.raises(InputError, match=problem):
        library.check("own.yaml", plugins=["own.py"])

    assert registry.contents() == ()


@pytest.mark.parametrize(
    "decorator",
    [
        'strength("own")',
        'method("own")',
        'sensor("own", fills="ranges")',
        'channel("own")',
        'force("own")',
        'integrator("own")',
        'measure("own", meaning="nothing")',
        'export_format("own", ".own")',
        'import_format("own", ".own")',
        'figure("own", "Nothing.")',
    ],
)
@pytest.mark.parametrize("wrong", ["class Own:\n    size: float = 1.0\n", "5"])
def test_what_has_to_be_a_function_is_nothing_else(files, decorator, wrong):
    """The line of the decorator, before anything is checked or computed."""
    code = f"import tiswarm\n\n\n@tiswarm.{decorator}\n{wrong}"
    if wrong == "5":
        code = f"import tiswarm\n\ntiswarm.{decorator}(5)\n"
    (files / "own.py").write_text(code)

    with pytest.raises(InputError, match=r"own.py:[34]: .* own is (the class Own|5); ") as caught:
        library.check("own.yaml", plugins=["own.py"])

    assert "define a function" in caught.value.problem
    assert registry.contents() == ()


def test_a_plugin_that_is_missing_is_a_line(tiswarm, files):
    """A wrong path is no traceback."""
    done = tiswarm("check", "own.yaml", "--plugin", "none.py", cwd=files)

    assert done.returncode == 2
    assert done.stderr == (
        "tiswarm: error: none.py: cannot be read: No such file or directory; "
        "correct the path of the plug-in\n"
    )


def test_a_name_of_another_plugin_is_taken(files):
    """The line names the file that has it."""
    (files / "other.py").write_text(ORIGIN)

    with pytest.raises(InputError, match=r"other.py:5: method origin is taken by .*own.py"):
        library.check("own.yaml", plugins=["own.py", "other.py"])


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        ("np.zeros((2, 3))", r"returned ndarray of shape \(2, 3\); return positions"),
        ("np.full((log.robot_count, 3), np.nan)", "returned positions that are not finite"),
        ("np.full((log.robot_count, 3), 1e300)", r"that are not within 1e\+10 R of the origin"),
        ("np.ones((log.robot_count, 3)) * 1j", "that are no real numbers, but complex128"),
        ("[['a'] * 3] * log.robot_count", "that are no real numbers, but <U1; give guesses"),
        ("[[1.0], [2.0, 3.0]]", "own.py: origin failed: ValueError"),
    ],
)
def test_a_wrong_result_is_a_line(files, log, returned, problem):
    """It says what was returned, and what is wanted."""
    (files / "own.py").write_text(ORIGIN.replace("np.zeros((log.robot_count, 3))", returned))

    with pytest.raises(plugins.PluginError, match=problem):
        library.localize(log, "origin", plugins=["own.py"])


@pytest.mark.parametrize("where", ["\nimport sys; sys.exit(3)\n", "\n1 / 0\n"])
def test_a_plugin_neither_ends_the_program_nor_moves_it(files, log, where):
    """An exit ended a run without a word; a change of the folder sent its files elsewhere."""
    moves = f"    import os; os.chdir('/')\n{textwrap.indent(where.strip(), '    ')}"
    (files / "own.py").write_text(ORIGIN.replace("    return", f"{moves}\n    return"))
    (files / "bad.py").write_text(
        f"{ORIGIN.replace('origin', 'bad')}import os; os.chdir('/'){where}"
    )

    with pytest.raises(plugins.PluginError, match=r"own.py:8: origin failed: (SystemExit: 3|Zero)"):
        library.localize(log, "origin", plugins=["own.py"])
    with pytest.raises(InputError, match=r"bad.py:9: (SystemExit: 3|Zero.*); correct the plug-in"):
        library.check("own.yaml", plugins=["bad.py"])

    assert Path.cwd() == files


@pytest.mark.parametrize(
    ("code", "scenario", "line"),
    [
        (ORIGIN, SCENARIO, "    return"),
        (RADAR, RADARS.replace("  usual: {}\n", ""), "    columns"),
    ],
)
def test_a_plugin_is_called_once_for_each_case(files, monkeypatch, code, scenario, line):
    """A warm-up called it once more for each job, unseen, without limit of time or errors."""
    monkeypatch.setattr(runner, "_compiled", {})
    count = "    with open('calls', 'a') as file: file.write('call ')\n"
    (files / "own.py").write_text(code.replace(line, f"{count}{line}", 1))
    (files / "own.yaml").write_text(scenario)

    _run(files)

    assert (files / "calls").read_text() == "call " * 2


@pytest.mark.trial
def test_a_plugin_that_never_returns_is_stopped(files):
    """The limit of a case did not count while kernels were warmed up by the plug-in."""
    (files / "own.py").write_text(ORIGIN.replace("    return", "    while True: pass\n    return"))
    (files / "own.yaml").write_text(SCENARIO.replace("seeds: 2", "seeds: 1"))

    with pytest.warns(library.base.errors.ResultWarning, match="1 case failed"):
        run = _run(files, case_limit_s=2.0)

    assert "took longer than 2 s; raise --case-limit" in _record(run, "0-own")["reason"]
    assert _record(run, "0-hops")["status"] == "done"


def test_no_file_loads_code_by_itself(tiswarm, files, log):
    """A scenario, a log and the folder of a run leave a plug-in beside them alone."""
    (files / "own.py").write_text(f"{ORIGIN}\nopen('loaded', 'w').close()\n")
    run = log.parents[2]
    (run / "own.py").write_text((files / "own.py").read_text())

    plugins.forget()  # those of the run that made the log
    commands = [
        ("check", "own.yaml"),
        ("run", "own.yaml"),
        ("localize", log, "--method", "origin"),
        ("redraw", run),
    ]
    found = [tiswarm(*command, cwd=files) for command in commands]

    assert [done.returncode for done in found] == [2, 2, 2, 2]
    assert all('"origin" should be one of' in done.stderr for done in found)
    assert all("that you load (--plugin FILE)" in done.stderr for done in found)
    assert not (files / "loaded").exists()


def test_a_worker_refuses_a_plugin_that_changed(files):
    """Cases of one run are computed by one state of the code."""
    library.check("own.yaml", plugins=["own.py"])
    sent = pickle.dumps(localization_params("origin"))
    same = pickle.loads(sent)  # noqa: S301 - our own

    (files / "own.py").write_text(ORIGIN.replace("zeros", "ones"))

    assert same == localization_params("origin")
    with pytest.raises(EnvironmentTroubleError, match=r"own.py: the plug-in has changed"):
        pickle.loads(sent)  # noqa: S301 - our own


@pytest.mark.parametrize(
    ("code", "section"),
    [
        (CHAIN, {"localization": {"method": "chain", "gap": 2.1}}),
        (FADES, {"localization": {"method": "distributed", "channel": "fades"}}),
        (RADAR, {"sensing": {"suite": "radar"}}),
        (LEANING, {"structure": {"kind": "leaning", "lean": 3.0}}),
        (RANDOM, {"structure": {"kind": "tower", "rule": {"name": "random", "flips": 3}}}),
    ],
    ids=["method", "channel", "sensor", "structure", "rule"],
)
def test_settings_bring_their_plugin_to_a_worker(files, code, section):
    """A process that has loaded nothing receives them, and knows each name that they have."""
    (files / "own.py").write_text(code)
    usual = {"name": "own", "structure": {"kind": "tower"}, "localization": {"method": "joint"}}
    plugins.load_plugins(["own.py"])
    scenario = load_scenario(usual | section)
    sent = pickle.dumps(scenario)

    plugins.forget()
    received = pickle.loads(sent)  # noqa: S301 - our own

    assert dump_scenario(received) == dump_scenario(scenario)
    assert [entry.plugin.file for entry in registry.contents()] == [files / "own.py"]


@pytest.mark.parametrize("code", [ORIGIN, LEANING, RANDOM])
def test_a_prompt_without_sources_says_so(code):
    """Python before 3.13 forgets what is typed at its prompt; results state a digest of it."""
    with pytest.raises(InputError, match=r"^this prompt keeps no source of what is typed; "):
        exec(compile(code, "<stdin>", "exec"), {"__name__": "__main__"})  # noqa: S102 - as typed


def test_a_method_of_a_session_needs_no_file(log):
    """A notebook registers a function and localizes by it; only workers need a file."""

    @library.method("here")
    def locate(log):
        return np.zeros((log.robot_count, 3))

    with pytest.warns(library.base.errors.ResultWarning):
        found = library.localize(log, "here")

    assert found.robot_count == 5
    with pytest.raises(InputError, match="workers cannot load what this session defines"):
        pickle.dumps(localization_params("here"))


@pytest.mark.trial
def test_an_installed_plugin_needs_no_option(process, files):
    """An entry point of its package names the module, also to a worker."""
    (files / "mine.py").write_text(ORIGIN)
    folder = files / "mine-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[tiswarm.plugins]\norigin = mine\n")
    path = f"{files}:{REPOSITORY}"

    command = ("run", "own.yaml", "--workers", "1", "--no-pictures")
    run = process(*command, cwd=files, PYTHONPATH=path)
    (files / "mine.py").write_text("import nothing_of_that_name\n")
    broken = process("check", "own.yaml", cwd=files, PYTHONPATH=path)

    assert run.returncode == 0, run.stderr
    assert broken.returncode == 1
    assert broken.stderr.startswith("tiswarm: error: plug-in origin (mine): ")
    assert broken.stderr.endswith("; repair or uninstall it\n")


def test_the_working_folder_installs_no_plugin(files, monkeypatch):
    """`python -m tiswarm` ran what metadata in the working folder named, `tiswarm` did not."""
    found = []
    monkeypatch.setattr("tiswarm.cli.main", lambda: found.append([*sys.path]))

    for path in ([str(files), *sys.path], [str(files), str(files), *sys.path]):
        monkeypatch.setattr(sys, "path", path)
        runpy.run_module("tiswarm", run_name="__main__")

    assert [path.count(str(files)) for path in found] == [0, 1]  # PYTHONPATH may name it


def test_a_working_folder_that_is_gone_stops_nothing(tmp_path, monkeypatch):
    """`python -m tiswarm` ended in a traceback there, `tiswarm` did not."""
    found = []
    monkeypatch.setattr("tiswarm.cli.main", lambda: found.append("called"))
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()

    runpy.run_module("tiswarm", run_name="__main__")

    assert found == ["called"]


def test_a_format_of_a_plugin_is_written(tiswarm, files, log):
    """The example of the page lists the robots as atoms; an unknown format is a line."""
    (files / "xyz.py").write_text(XYZ)

    command = ("export", log, log.with_name("estimate.csv"), "--format")
    unknown = tiswarm(*command, "xyz", cwd=files)
    done = tiswarm(*command, "xyz", "--plugin", "xyz.py", cwd=files)

    assert done.returncode == 0, done.stderr
    assert (files / "export" / "case.xyz").read_text().startswith("5\n")
    assert unknown.returncode == 2
    assert "--format: there is no export format xyz" in unknown.stderr


def test_a_format_of_a_plugin_is_imported(tiswarm, files):
    """The example of the page reads poses in mm; a line that is wrong names the file."""
    (files / "poses.py").write_text(READ)
    (files / "two.poses").write_text("0 0 0 49.7 1 0 0 0\n7 165.4 0 49.7 1 0 0 0\n")
    (files / "bad.poses").write_text("0 0 0 far 1 0 0 0\n")

    command = ("--plugin", "poses.py", "--dock-radius", "33", "--out", "imported")
    done = tiswarm("import", "two.poses", *command, cwd=files)
    wrong = tiswarm("import", "bad.poses", *command, cwd=files)

    assert done.returncode == 0, done.stderr
    log = library.read_log(files / "imported" / "sensing.jsonl")
    assert (log.robot_id.tolist(), log.length_unit) == ([0, 7], "mm")
    assert wrong.returncode == 2
    assert re.match(r"tiswarm: error: bad\.poses:2: z_mm: ", wrong.stderr)


def test_a_reader_that_returns_no_table_is_a_line(tiswarm, files):
    """Columns of different lengths ended in a traceback."""
    columns = "return {'robot': [0, 7], 'x_mm': [0.0]}"
    (files / "poses.py").write_text(re.sub("return pd.*", columns, READ))
    (files / "two.poses").write_text("")

    command = ("import", "two.poses", "--plugin", "poses.py", "--dock-radius", "33")
    done = tiswarm(*command, "--out", "imported", cwd=files)

    assert done.returncode == 1
    assert not (files / "imported").exists()
    assert re.match(r"tiswarm: error: .*poses\.py: poses failed: ValueError", done.stderr)
    assert len(done.stderr.splitlines()) == 1


def test_a_figure_of_a_plugin_is_on_the_page(tiswarm, files, whole):
    """The example of the page draws an earlier run; a figure that fails is a line."""
    run = shutil.copytree(whole, files / "run")
    (files / "figure.py").write_text(DRAW)
    (files / "wrong.py").write_text(DRAW.replace('"rmse_R"', '"smell"'))

    given = ("--plugin", "own.py", "--plugin")
    done = tiswarm("redraw", run, *given, "figure.py", cwd=files)
    plugins.forget()
    wrong = tiswarm("redraw", run, *given, "wrong.py", cwd=files)

    assert done.returncode == 0, done.stderr
    assert (run / "figures" / "cases.png").is_file()
    assert "Error of each case against the number of robots." in (run / "report.html").read_text()
    assert wrong.returncode == 1
    assert re.search(r"error: .*wrong\.py:\d+: cases failed: KeyError", wrong.stderr)


@pytest.mark.parametrize("workers", [None, pytest.param(1, marks=pytest.mark.trial)])
def test_a_sensor_of_a_plugin_fills_its_list(files, workers):
    """Its ranges are near the distances to the anchor; workers and tables know the suite."""
    (files / "own.py").write_text(RADAR)
    (files / "own.yaml").write_text(RADARS)

    run = _run(files, workers=workers)

    log = library.read_log(run.folder / "cases" / "0-radar" / "sensing.jsonl")
    truth = run.frame("truth", case="0-radar")[["x_R", "y_R", "z_R"]].to_numpy()
    distance = np.linalg.norm(truth[1:] - truth[0], axis=1)
    assert log.ranges[:, [0, 1]].tolist() == [[robot, 0] for robot in range(1, 5)]
    # Five of its standard deviations.
    np.testing.assert_allclose(log.ranges[:, 2], distance, atol=0.5)
    assert run.frame("suites")["suite"].tolist() == ["fireant-v3", "radar"]


def test_an_edit_of_a_sensor_computes_its_cases_again(files):
    """Those of other suites are kept."""
    (files / "own.py").write_text(RADAR)
    (files / "own.yaml").write_text(RADARS)
    before = _run(files)
    kept = (before.folder / "cases" / "0-usual" / "case.json").stat().st_ino

    (files / "own.py").write_text(RADAR.replace("0.1", "0.2"))
    after = _run(files)

    assert (after.folder / "cases" / "0-usual" / "case.json").stat().st_ino == kept
    log = library.read_log(after.folder / "cases" / "0-radar" / "sensing.jsonl")
    assert set(log.ranges[:, 3]) == {0.2}
    assert _record(after, "0-radar")["code"].count("+") == 1


@pytest.mark.parametrize(
    "returned",
    [
        "columns[:2]",
        "np.full(6, 9.0)",
        "np.full(6, np.nan)",
        "np.column_stack(columns) * 1e300",
        "np.column_stack(columns) * 1j",
    ],
)
def test_wrong_rows_of_a_sensor_fail_the_case(files, returned):
    """The reason names the file, and cases of other suites are done."""
    (files / "own.py").write_text(RADAR.replace("np.column_stack(columns)", returned))
    (files / "own.yaml").write_text(RADARS)

    with pytest.warns(library.base.errors.ResultWarning, match="2 cases failed"):
        run = _run(files)

    assert str(files / "own.py") in _record(run, "0-radar")["reason"]
    assert _record(run, "0-usual")["status"] == "done"


LEANINGS = """
name: own
robots: 8
seeds: [100000]
structure: {kind: tower}
localization: {method: hop-by-hop}
sweep:
  structure: [{kind: leaning, lean: 60.0, goal_height: 1.0}, {kind: tower}]
"""


def _leaning(name="leaning", settings=", lean: 60.0, goal_height: 1.0"):
    return re.sub(r"sweep:.*", "", LEANINGS, flags=re.DOTALL).replace(
        "{kind: tower}", f"{{kind: {name}{settings}}}"
    )


@pytest.mark.parametrize("workers", [(), pytest.param(("--workers", "2"), marks=pytest.mark.trial)])
def test_a_structure_of_a_plugin_is_grown_and_drawn(tiswarm, files, workers):
    """The example of the page grows toward its goal, on workers too, and has figures and a page."""
    (files / "own.py").write_text(LEANING)
    (files / "own.yaml").write_text(LEANINGS)

    given = ("own.yaml", "--plugin", "own.py")
    checked = tiswarm("check", *given, cwd=files)
    run = tiswarm("run", *given, *workers, cwd=files)

    assert checked.returncode == 0, checked.stderr
    assert run.returncode == 0, run.stderr
    [folder] = files.glob("reports/*")
    summary = library.open_run(folder).summary
    assert summary["kind"].tolist() == ["leaning", "tower"]
    leaning, upright = summary["reach_R"]
    assert leaning > upright + 3.0  # a robot is 5 R wide
    assert (folder / "figures" / "error-along-growth.png").is_file()
    assert (folder / "renders" / "structure.png").is_file()  # of the first case
    assert "kind: leaning" in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("code", "scenario", "problem"),
    [
        (LEANING, _leaning(settings=", lean: far"), 'own.yaml:5: structure.lean: "far" should'),
        (LEANING, _leaning(settings=", leen: 1"), "own.yaml:5: structure.leen: unknown key; did"),
        (LEANING, _leaning("leening"), "own.yaml:5: structure.kind: .* did you mean leaning.$"),
        (ORIGIN, _leaning(), "own.yaml:5: structure.kind: .* or one of a plug-in that you load"),
        (
            LEANING.replace("def goal", 'def __post_init__(self):\n        raise ValueError("no")\n'
                            "\n    def goal"),
            _leaning(), "own.yaml:5: structure: no",
        ),
    ],
)  # fmt: skip
def test_a_mistake_in_settings_of_a_structure_has_its_place(files, code, scenario, problem):
    """File, line and key, as for the package's own kinds."""
    (files / "own.py").write_text(code)
    (files / "own.yaml").write_text(scenario)

    [mistake] = library.check("own.yaml", plugins=["own.py"]).mistakes

    assert re.match(problem, str(mistake)), str(mistake)


CHECKED = {
    "method": (
        "localization",
        """
        from dataclasses import dataclass
        import tiswarm
        @dataclass(frozen=True)
        class Own:
            size: float = 1.0
            def __post_init__(self):
                CHECK
        @tiswarm.method("own", settings=Own)
        def locate(log, settings):
            pass
        """,
        {"localization": {"method": "own", "size": -1.0}},
    ),
    "structure": (
        "structure",
        """
        import tiswarm
        from tiswarm.world.params import TowerParams
        @tiswarm.structure("own")
        class Own(TowerParams):
            size: float = 1.0
            def __post_init__(self):
                CHECK
        """,
        {"structure": {"kind": "own", "size": -1.0}},
    ),
    "rule": (
        "structure.rule",
        """
        import tiswarm
        @tiswarm.rule("own")
        class Own:
            size: float = 1.0
            def __post_init__(self):
                CHECK
            def choose(self, step):
                return -1
        """,
        {"structure": {"kind": "tower", "rule": {"name": "own", "size": -1.0}}},
    ),
    "terrain": (
        "structure.terrain",
        """
        import tiswarm
        from tiswarm import ti
        @tiswarm.terrain("own")
        class Own:
            size: float = 1.0
            def __post_init__(self):
                CHECK
            def distance(self):
                return ti.func(lambda point: point[2])
        """,
        {"structure": {"kind": "tower", "terrain": [{"kind": "own", "size": -1.0}]}},
    ),
}
"""By kind whose plug-ins are classes with settings, the place of these, code and scenario."""


@pytest.mark.parametrize(
    ("check", "problem"),
    [
        ("raise ValueError(f'{self.size:g} is too small')", "-1 is too small"),
        ("self.sise", r".*own.py:\d+: own.__post_init__ failed: AttributeError: .*; correct the"),
        ("raise SystemExit(3)", r".*own.py:\d+: own.__post_init__ failed: SystemExit: 3; correct"),
    ],
)
@pytest.mark.parametrize("kind", CHECKED)
def test_what_a_class_says_of_its_settings_is_a_line(files, kind, check, problem):
    """At the section, for each kind of plug-in that is a class."""
    place, code, section = CHECKED[kind]
    (files / "own.py").write_text(textwrap.dedent(code).replace("CHECK", check))
    usual = {"name": "own", "structure": {"kind": "tower"}, "localization": {"method": "joint"}}

    [mistake] = library.check(usual | section, plugins=["own.py"]).mistakes

    assert re.match(rf"{place}(\[0\])?: {problem}", str(mistake)), str(mistake)


def test_the_schema_describes_settings_of_a_structure(files):
    """Those that it inherits, too."""
    (files / "own.py").write_text(LEANING)

    plugins.load_plugins(["own.py"])

    own = scenario_schema()["$defs"]["OwnLeaningParams"]["properties"]
    tower = scenario_schema()["$defs"]["TowerParams"]["properties"]
    assert own["lean"]["description"] == "Distance of the goal from the axis, along x [R]."
    assert {name: own[name]["description"] for name in tower} == {
        name: each["description"] for name, each in tower.items()
    } | {"kind": own["kind"]["description"]}


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        (
            "np.zeros(2)",
            r"own.py: leaning.goal returned shape \(2,\); return .* \(3,\)",
        ),
        ("np.full(3, np.nan)", "own.py: leaning.goal returned numbers that are not finite; corr"),
        ("self.leen", "own.py:16: leaning.goal failed: AttributeError"),
    ],
)
def test_a_wrong_goal_fails_the_case(files, returned, problem):
    """The reason names the file, and cases of other kinds are done."""
    wrong = LEANING.replace("np.array([self.lean, 0.0, self.goal_height])", returned)
    (files / "own.py").write_text(wrong)
    (files / "own.yaml").write_text(LEANINGS)

    with pytest.warns(library.base.errors.ResultWarning, match="1 case failed"):
        run = _run(files)

    leaning, tower = run.summary.to_dict("records")
    assert tower["status"] == "done"
    assert re.search(problem, leaning["reason"]), leaning["reason"]


def test_an_edit_of_a_structure_computes_its_cases_again(files):
    """Those of other kinds are kept."""
    (files / "own.py").write_text(LEANING)
    (files / "own.yaml").write_text(LEANINGS)
    before = _run(files)
    other, kept = (before.folder / "cases" / each for each in before.summary["case"])
    inode, reach = (kept / "case.json").stat().st_ino, before.summary["reach_R"].iloc[0]

    (files / "own.py").write_text(LEANING.replace("[self.lean,", "[-self.lean,"))
    after = _run(files)

    assert (kept / "case.json").stat().st_ino == inode
    assert "+" not in _record(after, kept.name)["code"]
    assert _record(after, other.name)["code"].count("+") == 1
    assert after.summary["reach_R"].iloc[0] < reach - 3.0  # a robot is 5 R wide


GROWTHS = """
name: own
robots: 8
seeds: [100000]
structure: {kind: tower}
localization: {method: hop-by-hop}
sweep: {structure.rule: [reactive-build, {name: random, flips: 4}]}
"""


def _ruled(rule):
    return re.sub(r"sweep:.*", "", GROWTHS).replace(
        "{kind: tower}", f"{{kind: tower, rule: {rule}}}"
    )


@pytest.mark.parametrize("workers", [(), pytest.param(("--workers", "2"), marks=pytest.mark.trial)])
def test_a_rule_of_a_plugin_grows_structures(tiswarm, files, workers):
    """The example of the guide is checked, and grows its structures, on workers too."""
    (files / "rules.py").write_text(RANDOM)
    (files / "rules.yaml").write_text(MY_RULES)
    small = ["--set", "robots=6", "--set", "seeds=1", "--set", "structure.rule.flips=4"]
    small += ["--set", "localization={method: hop-by-hop}", "--no-pictures"]

    given = ("rules.yaml", "--plugin", "rules.py")
    checked = tiswarm("check", *given, cwd=files)
    run = tiswarm("run", *given, *small, *workers, cwd=files)

    assert checked.returncode == 0, checked.stderr
    assert run.returncode == 0, run.stderr
    [case] = files.glob("reports/*/cases/*")
    assert json.loads((case / "case.json").read_text())["status"] == "done"
    log = library.read_log(case / "sensing.jsonl")
    assert np.diff(log.stances.start)[1:].min() >= 4


def test_a_rule_of_a_plugin_chooses_by_estimates_in_a_run(files):
    """Robots draw flips among those that they plan by what their method estimates."""
    (files / "rules.py").write_text(RANDOM)
    (files / "rules.yaml").write_text(
        MY_RULES.replace("{kind: tower,", "{kind: tower, navigate_by: estimate,")
    )
    given = ["robots=6", "seeds=1", "structure.rule.flips=4", "localization={method: online}"]
    given.append("sensing.tilt_noise_deg=1")

    run = library.run("rules.yaml", given, plugins=["rules.py"], pictures=False, quiet=True)

    [case] = run.summary.to_dict("records")
    assert case["failed_flips"] > 0.0
    assert case["belief_building_R"] > 0.0
    assert 0.0 < case["flips_as_planned"] < 1.0


def test_an_edit_of_a_rule_computes_its_cases_again(files):
    """Those of other rules are kept."""
    (files / "own.py").write_text(RANDOM)
    (files / "own.yaml").write_text(GROWTHS)
    before = _run(files)
    kept, other = (before.folder / "cases" / each for each in before.summary["case"])
    inode = (kept / "case.json").stat().st_ino
    x = before.frame("truth", case=other.name)["x_R"].to_numpy()

    (files / "own.py").write_text(RANDOM.replace('"flip"', '"flop"'))
    after = _run(files)

    assert (kept / "case.json").stat().st_ino == inode
    assert "+" not in _record(after, kept.name)["code"]
    assert _record(after, other.name)["code"].count("+") == 1
    assert not np.array_equal(x, after.frame("truth", case=other.name)["x_R"])


@pytest.mark.parametrize(
    ("rule", "problem"),
    [
        ("rendom", '"rendom" should be .* did you mean random.$'),
        ("{name: rendom}", 'name: "rendom" should be .* did you mean random.$'),
        ("{name: random, flops: 1}", "flops: unknown key; did you mean flips.$"),
        ("{name: random, flips: many}", 'flips: "many" should be a whole number'),
        ("{flips: 1}", "name: is missing; add it"),
        ("7", "7 should be 'reactive-build' or 'random', or one of a plug-in that you load"),
    ],
)
def test_a_mistake_in_a_rule_has_its_place(files, rule, problem):
    """File, line and key, whether the rule is a name or settings."""
    (files / "own.py").write_text(RANDOM)
    (files / "own.yaml").write_text(_ruled(rule))

    [mistake] = library.check("own.yaml", plugins=["own.py"]).mistakes

    assert re.match(rf"own.yaml:5: structure\.rule[.:] ?{problem}", str(mistake)), str(mistake)


def test_a_rule_that_no_plugin_brings_is_a_line(files):
    """The line says how to load one."""
    (files / "own.yaml").write_text(_ruled("random"))

    [mistake] = library.check("own.yaml", plugins=["own.py"]).mistakes

    assert str(mistake).startswith('own.yaml:5: structure.rule: "random" should be ')
    assert str(mistake).endswith("or one of a plug-in that you load (--plugin FILE)")


def test_the_schema_describes_settings_of_a_rule(files):
    """A rule is a name or settings, of every kind of structure; none is lost afterwards."""
    (files / "own.py").write_text(RANDOM)
    before = scenario_schema()

    plugins.load_plugins(["own.py"])

    sections = scenario_schema()["$defs"]
    assert sections["OwnRandomParams"]["properties"]["flips"]["default"] == 10
    for kind in ("TowerParams", "ChainParams"):
        name, settings = sections[kind]["properties"]["rule"]["oneOf"]
        assert name["enum"] == ["reactive-build", "random"]
        assert {*settings["discriminator"]["mapping"]} == {*name["enum"]}
    plugins.forget()
    assert scenario_schema() == before


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        (RANDOM.replace("def choose", "def chose"), r"own.py:\d+: random should have choose"),
        (RANDOM.replace('"random"', '"Random"'), r"own.py:\d+: 'Random' names no rule; use words"),
        (RANDOM.replace('"random"', '"reactive-build"'), "rule reactive-build is taken by tiswarm"),
    ],
)
def test_a_rule_that_cannot_be_is_a_line(files, code, problem):
    """It names the file and what to do."""
    (files / "own.py").write_text(code)

    with pytest.raises(InputError, match=problem):
        plugins.load_plugins(["own.py"])


def test_a_measure_of_a_plugin_is_in_tables_and_on_the_page(tiswarm, files, whole):
    """The example of the page, added to an earlier run; its cases stay, and it goes again."""
    run = shutil.copytree(whole, files / "run")
    (files / "worst.py").write_text(WORST)
    case = (run / "cases" / "0-hops" / "case.json").stat().st_ino

    given = ("redraw", run, "--plugin", "own.py")
    done = tiswarm(*given, "--plugin", "worst.py", cwd=files)
    found = library.open_run(run)
    page = (run / "report.html").read_text()
    robots = found.frame("robots", case="0-hops")
    paired, mean = found.frame("paired"), found.table["worst_R_mean"]
    worst = found.summary.set_index("case")["worst_R"]
    plugins.forget()
    without = tiswarm(*given, cwd=files)

    assert done.returncode == without.returncode == 0, done.stderr + without.stderr
    assert worst["0-hops"] == pytest.approx(robots["error_R"].max(), rel=1e-12)
    assert mean.tolist() == pytest.approx(worst.to_numpy().reshape(2, 2).mean(axis=1), rel=1e-12)
    assert "worst_R" in paired["measure"].tolist()
    assert "worst_R: largest position error of a robot." in page
    assert page.count(">worst_R [R]</") == 2  # means, and cases
    assert "worst_R" not in library.open_run(run).summary
    assert "worst_R" not in (run / "report.html").read_text()
    assert (run / "cases" / "0-hops" / "case.json").stat().st_ino == case


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        ("estimate.smell", r"worst.py:\d+: worst_R failed: AttributeError"),
        ("estimate.position", r"worst.py: worst_R returned array\(.*; return a number, or NaN"),
        ("np.inf", r"worst.py: worst_R returned inf; return a number, or NaN"),
        ("'far'", r"worst.py: worst_R returned 'far'; return a number, or NaN"),
        ("[[1.0], [2.0, 3.0]]", r"worst.py: worst_R failed: ValueError"),
    ],
)
def test_a_measure_that_fails_is_a_line(tiswarm, files, whole, returned, problem):
    """It names the file; the tables stay as they were."""
    run = shutil.copytree(whole, files / "run")
    before = (run / "summary.csv").read_bytes()
    code = re.sub("return np.*", f"return {returned}", WORST)
    (files / "worst.py").write_text(code)

    done = tiswarm("redraw", run, "--plugin", "own.py", "--plugin", "worst.py", cwd=files)

    assert done.returncode == 1
    assert re.search(problem, done.stderr), done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert (run / "summary.csv").read_bytes() == before


def test_a_measure_that_fails_ends_a_study_after_its_first_structure(tiswarm, files):
    """Hours of cases would else be computed before its line; the same command stops before one."""
    (files / "worst.py").write_text(re.sub("return np.*", "return truth.contacts", WORST))
    given = (
        "run", "own.yaml", "--plugin", "own.py", "--plugin", "worst.py", "--out", files / "runs",
        "--no-pictures",
    )  # fmt: skip

    done = tiswarm(*given, cwd=files)
    again = tiswarm(*given, cwd=files)

    for command in (done, again):
        assert command.returncode == 1
        line = command.stderr.splitlines()[-1]
        assert re.search(r"worst\.py:\d+: worst_R failed: AttributeError", line), command.stderr
    cases = sorted(path.name for path in (files / "runs").glob("*/cases/*"))
    assert cases == ["0-hops", "0-own"]


def test_ground_of_a_class_derived_from_terrain_is_refused(files):
    """Robots would stand on flat ground: kernels know no other methods than those of Terrain."""
    code = LEANING.replace(
        "import numpy as np", "import numpy as np\nfrom tiswarm.records import terrain"
    )
    code += """

class Hill(terrain.Terrain):
    def depth(self, point, radius):
        return 0.5 * point[:, 0] + radius - point[:, 2]


@tiswarm.structure("hillside")
class Hillside(TowerParams):
    terrain = Hill()
"""
    (files / "own.py").write_text(code)
    problem = "own.py: hillside.terrain returned Hill; return a Terrain itself: robots would not"

    with pytest.raises(plugins.PluginError, match=problem):
        library.grow("hillside", robots=3, plugins=["own.py"], quiet=True)


def test_what_is_forgotten_leaves_the_scenario(files):
    """The schema lists the settings of plug-ins while these are loaded, and no class changes."""
    (files / "leaning.py").write_text(LEANING)
    before = scenario_schema()
    checks = Scenario.__pydantic_validator__

    plugins.load_plugins(["own.py", "leaning.py"])
    loaded = scenario_schema()["$defs"].keys()
    plugins.forget()

    assert loaded - before["$defs"].keys() == {"OwnOriginParams", "OwnLeaningParams"}
    assert scenario_schema() == before
    assert Scenario.__pydantic_validator__ is checks


@pytest.mark.trial
def test_a_channel_of_the_page_is_chosen(tiswarm, files):
    """Robots localize by it, though a fifth of all transmissions is lost."""
    (files / "fades.py").write_text(FADES)
    sets = ["robots=4", "seeds=1", "localization={method: distributed, channel: fades, chains: 0}"]
    done = tiswarm(
        "run", "tower", "--plugin", files / "fades.py", "--out", files, "--no-pictures",
        "--set", "conditions={own: {}}",
        *(each for text in sets for each in ("--set", text)),
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
