"""Logs of long jobs show how work goes on."""

import io
import itertools
import re
import signal
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.app import console
from tiswarm.base.errors import InputError
from tiswarm.cli import options
from tiswarm.localization.methods import by_share, localize
from tiswarm.localization.settings import JointParams
from tiswarm.scenario.expansion import find_mistakes
from tiswarm.scenario.yaml_source import read_yaml
from tiswarm.sensing import SensingParams, observe


def test_without_a_terminal_lines_show_the_progress(capsys, monkeypatch):
    """Ten steps of ten seconds: a line each half a minute, and one at the end."""
    clock = itertools.count(0.0, 10.0)
    monkeypatch.setattr(console.time, "perf_counter", lambda: next(clock))

    with console.ConsoleProgress().task("grow", 20) as advance:
        for _ in range(10):
            advance(2)

    assert capsys.readouterr().err.splitlines() == [
        "grow: 6 of 20, about 70 s left",
        "grow: 12 of 20, about 40 s left",
        "grow: 18 of 20, about 10 s left",
        "grow: 20 in 110.0 s",
    ]


def test_lines_come_before_the_first_step_is_done(capsys, monkeypatch):
    """Cases may take hours: a user sees that work goes on, and how many failed."""
    clock = itertools.count(0.0, 10.0)
    monkeypatch.setattr(console.time, "perf_counter", lambda: next(clock))
    failed = []

    with console.ConsoleProgress().task(
        "cases", 4, lambda: f"{len(failed)} failed" if failed else ""
    ) as advance:
        for _ in range(3):
            advance(0)
        failed.append("0-a")
        for _ in range(3):
            advance(1)
        advance(1)

    assert capsys.readouterr().err.splitlines() == [
        "cases: 0 of 4",
        "cases: 3 of 4, 1 failed, about 20 s left",
        "cases: 4, 1 failed in 80.0 s",
    ]


def test_steps_of_an_earlier_run_count_but_took_no_time(capsys, monkeypatch):
    """A run that goes on from its stored cases takes as long for each of the others."""
    clock = itertools.count(0.0, 60.0)
    monkeypatch.setattr(console.time, "perf_counter", lambda: next(clock))

    with console.ConsoleProgress().task("cases", 64, done=60) as advance:
        for steps in (0, 1, 1, 2):
            advance(steps)

    assert capsys.readouterr().err.splitlines() == [
        "cases: 60 of 64",
        "cases: 61 of 64, about 360 s left",
        "cases: 62 of 64, about 180 s left",
        "cases: 64 in 300.0 s",
    ]


def test_the_time_left_is_named_once_a_twentieth_is_done(capsys, monkeypatch):
    """The first steps compile kernels: they make hours of minutes."""
    clock = itertools.count(0.0, 60.0)
    monkeypatch.setattr(console.time, "perf_counter", lambda: next(clock))

    with console.ConsoleProgress().task("grow", 100) as advance:
        for steps in (4, 1, 95):
            advance(steps)

    assert capsys.readouterr().err.splitlines() == [
        "grow: 4 of 100",
        "grow: 5 of 100, about 2280 s left",
        "grow: 100 in 240.0 s",
    ]


def test_a_terminal_shows_a_task_within_another(monkeypatch):
    """One display has both bars; a library that draws may refuse a second display."""
    output = io.StringIO()
    terminal = partial(console.Console, file=output, force_terminal=True, width=100)
    monkeypatch.setattr(console, "Console", lambda **_: terminal())
    progress = console.ConsoleProgress()

    with progress.task("cases", 4, lambda: "1 failed") as advance:
        advance(1)
        with progress.task("grow", 20) as advance_growth:
            advance_growth(5)
            shown = [task.description for task in progress.bars.tasks]
            progress.bars.refresh()

    assert shown == ["cases", "grow"]
    assert "1/4" in output.getvalue()
    assert "1 failed" in output.getvalue()
    assert "5/20" in output.getvalue()
    assert progress.bars is None


def test_a_notebook_has_one_output(monkeypatch):
    """Lines stay and the bar moves in it, whatever the number of tasks."""
    clock = itertools.count(0.0, 10.0)
    monkeypatch.setattr(console.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(console, "Console", partial(console.Console, force_jupyter=True))
    outputs = []

    def display(content, **_):
        outputs.append([content["text/plain"]])
        return SimpleNamespace(update=lambda new, **_: outputs[-1].append(new["text/plain"]))

    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    progress = console.ConsoleProgress()
    for name in ("grow", "sense"):
        with progress.task(name, 4) as advance:
            advance(1)
            advance(3)
    progress.info("seed 1: growth ended")

    [shown] = outputs
    assert shown[1] == "grow [#######.......................] 1 of 4, 30 s left"
    assert shown[-1] == "grow: 4 in 30.0 s\nsense: 4 in 30.0 s\nseed 1: growth ended"


def test_parts_of_a_step_add_up():
    """A bar that is done shows all steps, whatever shares were reported."""
    steps = []
    report = by_share(steps.append, 7)

    for share in (*np.cumsum(np.full(30, 1 / 31)), 1.0):
        report(share)

    assert len(steps) == 31
    assert min(steps) >= 0.0
    assert sum(steps) == 7


def test_joint_reports_while_it_anneals(towers):
    """In robots, and without a bit of difference to the estimate."""
    log = observe(towers[0], SensingParams())
    params, steps = JointParams(chains=2, steps=200, hold_steps=50), []

    found = localize(log, params, on_progress=steps.append)

    assert sum(steps) == 30
    assert np.count_nonzero(steps) > 10
    np.testing.assert_array_equal(found.position, localize(log, params).position)


WRONG = (
    "name: x\nrobots: 5\nstructure: {kind: tower, goal_height: tall}\nseedz: 3\n"
    "localization: {method: joint}\n"
)


@pytest.fixture
def mistakes(tmp_path):
    """The mistakes of a scenario: a wrong value, an unknown key."""
    path = tmp_path / "wrong.yaml"
    path.write_text(WRONG)
    return find_mistakes(path)


def test_without_a_terminal_an_error_is_one_line(mistakes, capsys):
    """Logs and pipes get `file:line: key: problem`, as ever."""
    for mistake in mistakes:
        console.fail(mistake)

    lines = capsys.readouterr().err.splitlines()
    assert [re.sub(".*wrong.yaml", "", line)[:26] for line in lines] == [
        ":3: structure.goal_height:",
        ":4: seedz: unknown key; di",
    ]


def test_a_terminal_shows_the_mistake_in_its_file(mistakes, capsys, monkeypatch):
    """A caret stands below a wrong value, or below a key that does not exist."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for mistake in mistakes:
        console.fail(mistake)

    _, wrong, caret, _, unknown, below = capsys.readouterr().err.splitlines()
    assert wrong == "    structure: {kind: tower, goal_height: tall}"
    assert caret.index("^") == wrong.index("tall")
    assert unknown == "    seedz: 3"
    assert below == "    ^"


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("name: x\nstructure: {kind: tower\n", ""),  # the brace is missed at the end of the file
        ("a: 1\nb: " + "x" * 500 + "\na: 2\n", "a: 2"),
        ("a: \x1b[2J\n", ""),  # no column
        ("'" + "é" * 200 + "': &anchor 1\n", "&anchor"),
        ("a:\n\tb: 1\n", "?b: 1"),
    ],
)
def test_excerpts_are_short_and_printable(tmp_path, capsys, monkeypatch, text, at):
    """Neither a long line nor a control character spoils the terminal."""
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)

    with pytest.raises(InputError) as refusal:
        read_yaml(path)
    console.fail(refusal.value)

    _, *excerpt = capsys.readouterr().err.splitlines()
    assert all(line.isprintable() and len(line) <= 80 for line in excerpt)
    if at:
        line, caret = excerpt
        assert line[caret.index("^") :].startswith(at)
    else:
        assert excerpt == []


def test_an_error_without_its_file_is_one_line(mistakes, capsys, monkeypatch):
    """The file may be gone by now."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    mistakes[0].path.unlink()

    console.fail(mistakes[0])

    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    ("command", "ending"),
    [
        ("run", "the same command again lets a run go on from its finished cases"),
        ("import", "outputs are whole, or as before"),
        ("localize", "outputs are whole, or as before"),
    ],
)
def test_an_interrupted_command_speaks_of_a_run_only_where_one_is(
    tiswarm, monkeypatch, command, ending
):
    """Whoever ends an import has no run that could go on."""

    def interrupted(*_arguments, **_options):
        sys.exit(128 + signal.SIGTERM)

    monkeypatch.setattr(options, "app", interrupted)

    done = tiswarm(command, "file")

    assert done.returncode == 128 + signal.SIGTERM
    assert done.stderr == f"tiswarm: error: interrupted; {ending}\n"
