"""Signals and broken surroundings end a command in one line, with nothing left behind."""

import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.runs import REPOSITORY

LONG = ("robots=60", "seeds=40", "localization.iterations=100000", "conditions={a: {}, b: {}}")
"""Settings of a study of many minutes."""


def _interrupt(number: signal.Signals, out: Path, *options: str):
    """Start a study, send a signal while it computes, and return its process and its children."""
    settings = [part for text in LONG for part in ("--set", text)]
    command = [sys.executable, "-m", "tiswarm", "run", "scenarios/tower.yaml", *settings]
    process = subprocess.Popen(
        [*command, "--out", str(out), *options],
        cwd=REPOSITORY,
        env={k: v for k, v in os.environ.items() if k != "TISWARM_DEBUG"},
        stderr=subprocess.PIPE,
        text=True,
    )
    ours = psutil.Process(process.pid)
    while not [*out.glob("*/.lock")] or len(ours.children()) < ("--workers" in options):
        assert process.poll() is None
        time.sleep(0.05)
    children = ours.children()
    process.send_signal(number)
    return process, children


@pytest.mark.parametrize(
    ("number", "options"),
    [
        (signal.SIGINT, []),
        (signal.SIGTERM, ["--workers", "1"]),
        pytest.param(signal.SIGINT, ["--workers", "1"], marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, [], marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_study_in_one_line(tmp_path, number, options):
    """Its status is that of the signal; children, locks and partial files are gone."""
    process, children = _interrupt(number, tmp_path, *options)

    _, said = process.communicate(timeout=60)

    assert process.returncode == 128 + number
    assert said.splitlines()[-1] == (
        "tiswarm: error: interrupted; finished results are kept, "
        "and the same command continues from there"
    )
    assert "Traceback" not in said
    assert psutil.wait_procs(children, timeout=0.0)[1] == []
    [lock] = tmp_path.glob("*/.lock")
    with lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert not [*tmp_path.rglob(".*.part"), *tmp_path.rglob(".*.tmp")]
