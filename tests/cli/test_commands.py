"""Every command explains itself, and bad input ends in one line and status 2."""

import ast
import json
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from tests.runs import REPOSITORY
from tests.structures import Rule, structure
from tiswarm.app import doctor
from tiswarm.cli import main
from tiswarm.records.sensing_file import write_sensing_log

COMMANDS = (
    "run", "design", "localize", "view", "advise", "redraw", "compare", "import",
    "export", "score", "check", "schema", "doctor",
)  # fmt: skip


def _only_line(done) -> str:
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]


def test_help_shows_an_example(tiswarm):
    """`--help` of the whole and of each command ends with a command line to try."""
    for arguments in ((), *((name,) for name in COMMANDS)):
        done = tiswarm(*arguments, "--help")

        assert done.returncode == 0
        assert "Example: tiswarm" in done.stdout


def test_version_is_printed(tiswarm):
    """`--version` prints name and version."""
    assert tiswarm("--version").stdout.startswith("tiswarm 0.")


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (("fly",), "No such command"),
        (("run",), "Missing argument 'SCENARIO'; give it as in tiswarm run scenarios/tower.yaml"),
        (("compare",), "'RUN RUN ...'; give it as in tiswarm compare reports/tower-1a2b3c4d "),
        (("import", "p.csv"), "--out: give a folder for the log, or --check"),
        (("import", "scenarios/tower.yaml", "--out", "z"), "give a scenario to tiswarm run"),
        (("run", "notes.jsonl"), "give a log to tiswarm localize"),
        (("localize", "scenarios/tower.yaml"), "give a scenario to tiswarm run"),
        (("run", "tower", "--set", "arch=gpu"), "did you mean cuda?"),
        (("advise", "log.jsonl", "--budget", "0"), "--budget: 0 should be at least 1"),
        (
            ("advise", "log.jsonl", "--budget", "1", "--kinds", "compass"),
            "--kinds: 'compass' should",
        ),
        (("run", "nowhere.yaml"), "nowhere.yaml"),
        (("run", "scenarios/tower.yaml", "--arch", "abacus"), "abacus"),
        (("run", "scenarios/tower.yaml", "--set", "robots=-3"), "--set robots=-3"),
        (
            ("run", "scenarios/scaling.yaml", "--set", "robots=[20,40]"),
            "should be a whole number; to sweep robots, give --set 'sweep={robots: [20, 40]}'",
        ),
        (
            ("run", "scenarios/closed-loop.yaml", "--set", "robots=[20,40]"),
            "should be a whole number; to sweep robots, give --set 'sweep.robots=[20, 40]'",
        ),
        (
            ("run", "scenarios/tower.yaml", "--set", "structure.kind=[tower, bridge]"),
            "; to sweep structure.kind, give --set 'sweep={structure.kind: [tower, bridge]}'",
        ),
        (("run", "scenarios/tower.yaml", "--set", "robtos=3"), "did you mean robots"),
        (("run", "scenarios/tower.yaml", "--threads", "0"), "give 1 or more"),
        (("run", "scenarios/tower.yaml", "--shard", "3/2"), "invalid shard 3/2: use I/N"),
        (
            ("run", "scenarios/tower.yaml", "--scheduler", "tcp://here:1", "--workers", "2"),
            "--workers: a scheduler has workers of its own; leave one out",
        ),
        (("run", "scenarios/tower.yaml", "--shard", "0/0"), "invalid shard 0/0: use"),
        (("run", "scenarios/tower.yaml", "--shard", "0/0", "--plan"), "invalid shard 0/0: use"),
        (
            ("run", "scenarios/tower.yaml", "--case-limit", "1e400", "--plan"),
            "--case-limit: inf should be a number of seconds above 0; leave it out for no limit",
        ),
        (("run", "scenarios/tower.yaml", "--movie", "avi"), "--movie"),
        (("localize", "nowhere.jsonl"), "nowhere.jsonl"),
        (("localize", "log.jsonl", "--method", "guess"), "--method"),
        (("localize", "log.jsonl", "--set", "solve_yav=no"), "did you mean solve_yaw"),
        (
            ("localize", "log.jsonl", "--method", "virtual-force", "--seed", "3"),
            "unknown key of virtual-force; leave it out, or choose method distributed or joint or ",
        ),
        (
            ("localize", "log.jsonl", "--method", "virtual-force", "--cues", "contacts"),
            "--cues: virtual-force has no choice of cues but its settings z_correction, ground, ",
        ),
        (
            ("localize", "log.jsonl", "--method", "joint", "--cues", "contacts, height"),
            "log.jsonl: there is no such file",
        ),
        (
            ("localize", "log.jsonl", "--method", "least-squares", "--cues", "contacts,smell"),
            "--cues: smell is not a cue; use contacts, non_overlap",
        ),
        (
            ("localize", "log.jsonl", "--method", "least-squares", "--set", "starts=x"),
            '--set starts=x: "x" should be a whole number',
        ),
        (("redraw", "scenarios"), "run folder"),
        (("run", "tower", "--seeds", "5"), "No such option: --seeds; use --set seeds=5"),
        (("run", "tower", "--seed=3"), "No such option: --seed; use --set seeds=3"),
        (("check", "scenarios/tower.yaml", "--robots=50"), "use --set robots=50"),
        (("run", "tower", "--goal-height", "30"), "use --set structure.goal_height=30"),
        (("localize", "log.jsonl", "--chains", "2"), "use --set chains=2"),
        (("localize", "log.jsonl", "--chains"), "use --set chains=VALUE"),
        (("localize", "log.jsonl", "--goal-height", "2"), "No such option: --goal-height"),
        (("score", "truth.csv", "estimate.csv", "--robots", "5"), "No such option: --robots"),
        (("run", "tower", "--theads", "3"), "(Possible options: --threads)"),
    ],
)
def test_bad_commands_end_in_one_line(tmp_path, monkeypatch, capsys, arguments, printed):
    """Status 2, one line that names the trouble, nothing written; in this process, to be quick."""
    (tmp_path / "scenarios").symlink_to(REPOSITORY / "scenarios")
    (tmp_path / "notes.jsonl").write_text('{"robot": 0}\n{"robot": 1}\n')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["tiswarm", *arguments])

    with pytest.raises(SystemExit) as end:
        main()

    assert end.value.code == 2
    line, empty = capsys.readouterr().err.split("\n")
    assert printed in line
    assert empty == ""
    assert {path.name for path in tmp_path.iterdir()} == {"scenarios", "notes.jsonl"}


def test_a_mistake_in_a_scenario_is_reported_with_its_line(tiswarm, tmp_path):
    """File, line and key of the mistake come first."""
    scenario = tmp_path / "bad.yaml"
    text = "name: bad\nstructure:\n  kind: tower\n  goal_heigth: 3\nlocalization: {method: joint}\n"
    scenario.write_text(text)

    done = tiswarm("run", scenario, cwd=tmp_path)

    assert done.returncode == 2
    line = _only_line(done)
    assert f"{scenario}:4: structure.goal_heigth: " in line
    assert "goal_height" in line
    assert list(tmp_path.iterdir()) == [scenario]


def test_check_finds_every_mistake(tiswarm, tmp_path):
    """All mistakes of a file are listed, one a line, and sound files are summed up."""
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: bad\nrobots: -1\nstructure:\n  kind: tower\n  goal_height: high\n")

    done = tiswarm("check", REPOSITORY / "tests" / "tower.yaml", bad)

    assert done.returncode == 2
    assert "9 cases" in done.stdout
    assert [f"{bad}:2: robots" in done.stderr, f"{bad}:5: structure" in done.stderr] == [True] * 2


def test_check_reads_logs_too(tiswarm, small_run, tmp_path):
    """A valid log is described with its unknowns; a damaged one is refused at its line."""
    log = small_run / "cases" / "0-baseline" / "sensing.jsonl"
    lines = log.read_text().splitlines()
    damaged = tmp_path / "damaged.jsonl"
    damaged.write_text("\n".join([*lines[:5], lines[5].replace("[", "(", 1), *lines[6:]]))

    printed = tiswarm("check", log).stdout
    assert "12 robots" in printed
    assert "contacts: " in printed
    assert "contacts, ground, height, walk contacts: " in printed
    assert "floppy modes (free motions) of 33 unknowns" in printed
    done = tiswarm("check", damaged)
    assert done.returncode == 2
    assert f"{damaged}:6" in _only_line(done)


def test_what_cannot_be_known_is_said_and_marked(tiswarm, small_run, tmp_path):
    """A robot without contacts and a contact that cannot be are named with file and line."""
    log = small_run / "cases" / "0-baseline" / "sensing.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    lines[-2]["flip_height"] += 50.0
    for pose in (lines[-1], *lines[-1]["stances"]):
        pose["contacts"] = []
    broken = tmp_path / "broken.jsonl"
    broken.write_text("\n".join(map(json.dumps, lines)))

    checked = tiswarm("check", broken)
    chosen = ("--method", "virtual-force", "--out", tmp_path / "estimate.csv")
    localized = tiswarm("localize", broken, *chosen)

    for done, status in ((checked, 0), (localized, 4)):
        assert done.returncode == status
        assert "disconnected from the anchor (positions are guesses): 1 robot (11)" in done.stdout
        assert f"{broken}:{len(lines) - 1}: contacts: robot 10's contact" in done.stdout
    marks = [row.split(",")[-1] for row in (tmp_path / "estimate.csv").read_text().split()]
    assert marks[0] == "known"
    assert marks[-1] == "disconnected"
    assert marks[1] == "yes"


def test_an_estimate_that_did_not_converge_is_written_with_a_warning(tiswarm, tmp_path):
    """The last line says so and what to do, even if quiet; the exit status is 4."""
    log, _ = structure(Rule(kind="loops"), 20, 0)
    contacts = log.contacts.copy()
    contacts[4:, 0] = 0  # all robots cannot touch the anchor's three docks
    write_sensing_log(replace(log, contacts=np.unique(contacts, axis=0)), tmp_path / "bad.jsonl")
    out = tmp_path / "estimate.csv"
    chosen = ("--method", "joint", "--set", "steps=600", "--set", "chains=3", "--out", out)

    done = tiswarm("localize", tmp_path / "bad.jsonl", *chosen)
    quiet = tiswarm("localize", tmp_path / "bad.jsonl", *chosen, "--quiet", "--overwrite")

    assert done.returncode == quiet.returncode == 4
    assert done.stderr.splitlines()[-1] == quiet.stderr.strip()
    assert quiet.stderr.startswith("tiswarm: warning: not converged: all chains ended out of reach")
    assert "positions and sd may be far off; " in quiet.stderr
    statement, verdict, *_ = done.stdout.splitlines()
    assert statement.startswith("1 of 20 robots is within 1 R of where it is shown (95 %); ")
    assert statement.endswith(f" -> {out}")
    assert verdict == "not converged"
    assert "outlier" not in done.stdout
    assert len(out.read_text().splitlines()) == 21


@pytest.mark.parametrize(
    ("robots", "seed", "steps"), [(12, 1, 400), pytest.param(20, 0, 600, marks=pytest.mark.trial)]
)
def test_outliers_are_listed_with_their_line(tiswarm, tmp_path, robots, seed, steps):
    """One planted in a log is named where it stands, and a run says how many were found."""
    noise = ["sensing.tilt_noise_deg=1", "sensing.yaw_noise_deg=2", "sensing.false_contacts=0.1"]
    hold = steps // 3
    joint = f"localization={{method: joint, chains: 2, steps: {steps}, hold_steps: {hold}}}"
    sets = [
        part
        for text in (*noise, joint, f"robots={robots}", f"seeds=[{seed}]")
        for part in ("--set", text)
    ]
    settings = ("--set", "conditions={one: {}}", *sets, "--no-pictures", "--out", tmp_path)
    done = tiswarm("run", "tests/tower.yaml", *settings)
    assert done.returncode == 0, done.stderr
    case = next(tmp_path.glob("*/cases/*"))
    scores = json.loads((case / "case.json").read_text())["scores"]

    chosen = ("--set", "chains=2", "--set", f"steps={steps}", "--set", f"hold_steps={hold}")
    out = ("--out", tmp_path / "estimate.csv")
    printed = tiswarm("localize", case / "sensing.jsonl", "--method", "joint", *chosen, *out).stdout

    found = re.findall(
        r"jsonl:(\d+): (?:stances\[(\d+)\].)?contacts: robot (\d+)'s contact (.*) is an outlier",
        printed,
    )
    assert len(found) == scores["outliers"] > 0
    assert scores["outlier_precision"] > 0.8
    assert scores["wrong_contacts"] > robots / 4
    lines = [json.loads(line) for line in (case / "sensing.jsonl").read_text().splitlines()]
    for line, stance, robot, contact in found:
        entry = lines[int(line) - 1]
        assert entry["robot"] == int(robot)
        at = entry["stances"][int(stance)] if stance else entry
        assert json.loads(contact) in at["contacts"]


def test_schema_accepts_what_is_shipped_and_refuses_what_is_not(tiswarm):
    """The printed JSON Schema is one, and editors can check scenarios by it."""
    schema = json.loads(tiswarm("schema").stdout)
    scenario = yaml.safe_load((REPOSITORY / "tests" / "tower.yaml").read_text())

    jsonschema.validate(scenario, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**scenario, "robotz": 3}, schema)


@pytest.mark.trial
def test_doctor_knows_what_works(tiswarm, monkeypatch):
    """The CPU works, metal does not on Linux, some renderer does; software cards take long."""
    monkeypatch.setattr(doctor, "ARCHS", ("cpu", "metal"))

    done = tiswarm("doctor")

    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert any(line.startswith("ok") and "backend cpu" in line for line in lines)
    assert any(line.startswith("ok") and "renderer" in line for line in lines)
    assert any("cores" in line for line in lines)
    assert not any(line.startswith("ok") and "backend metal" in line for line in lines)


def test_quiet_says_nothing(tiswarm, tmp_path):
    """With --quiet a run that goes well prints nothing at all."""
    done = tiswarm(
        "run", "tests/tower.yaml", "--quiet", "--no-pictures",
        "--set", "robots=5", "--set", "seeds=1", "--out", tmp_path,
    )  # fmt: skip

    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_folder_that_cannot_be_written_is_trouble_with_the_environment(tiswarm):
    """Status 1 and one line that says what to choose instead."""
    done = tiswarm("run", "tests/tower.yaml", "--out", Path(os.devnull) / "reports")

    assert done.returncode == 1
    assert "choose another --out" in _only_line(done)


def test_help_begins_with_what_people_do_most(monkeypatch, capsys):
    """Runs, then one's own logs, then folders; advice comes last."""
    monkeypatch.setattr(sys, "argv", ["tiswarm", "--help"])

    with pytest.raises(SystemExit):
        main()

    listed = capsys.readouterr().out.partition("Commands:")[2].partition("Example:")[0]
    names = re.findall(r"^  (\w+)", listed, re.MULTILINE)
    assert [names[0], names[1], names[7], names[-1]] == ["run", "localize", "redraw", "doctor"]
    assert "..." not in listed  # whole sentences


def test_commands_reach_the_rooms_through_the_api():
    """What a command does can be called from Python, too.

    Schemas and lists only print texts; the best format of a film is a default of an option. An
    import that goes on to a report checks the names of all outputs first.
    """
    texts = {"records.sensing_format", "scenario.model", "scenario.yaml_source"}
    defaults = {"report.pictures.pictures"}
    checks = {"records.outputs"}
    imported = set()
    for file in (REPOSITORY / "tiswarm" / "cli").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("tiswarm"):
                module = node.module.removeprefix("tiswarm").removeprefix(".")
                imported |= {module} if module else {alias.name for alias in node.names}

    reached = {name for name in imported if name.split(".")[0] not in {"api", "app", "base", "cli"}}
    assert reached <= texts | defaults | checks
