"""Logs of long jobs show how work goes on."""

import itertools
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np

from tiswarm import console
from tiswarm.localization.params import JointParams
from tiswarm.localization.registry import localize
from tiswarm.progress import by_share
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
