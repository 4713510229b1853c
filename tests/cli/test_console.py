"""Logs of long jobs show how work goes on."""

import itertools

from tiswarm import console


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
