"""Signals and broken surroundings end a command in one line, with nothing left behind."""

import errno
import fcntl
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from tests.runs import REPOSITORY, environment, interruptible
from tiswarm.cli import main

LONG = ("robots=60", "seeds=1000", "localization.iterations=3000", "conditions={a: {}, b: {}}")
"""Settings of a study of many minutes, no launch of which takes long: signals wait for its end."""


@contextmanager
def _interrupted(number: signal.Signals, out: Path, *options: str):
    """Send a signal to a study while it computes; yield its process and its children."""
    settings = [part for text in LONG for part in ("--set", text)]
    command = [sys.executable, "-m", "tiswarm", "run", "tests/tower.yaml", *settings]
    with interruptible():
        process = subprocess.Popen(
            [*command, "--out", str(out), *options],
            cwd=REPOSITORY, env=environment(), stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    children: list[psutil.Process] = []
    with process:
        try:
            ours = psutil.Process(process.pid)
            while not [*out.glob("*/.lock")] or len(children) < ("--workers" in options):
                assert process.poll() is None
                time.sleep(0.05)
                children = ours.children()
            process.send_signal(number)
            yield process, children
        finally:
            for each in [process, *children]:
                with suppress(psutil.NoSuchProcess):
                    each.kill()


@pytest.mark.parametrize(
    ("number", "options"),
    [
        pytest.param(signal.SIGINT, [], marks=pytest.mark.trial),
        pytest.param(signal.SIGTERM, ["--workers", "1"], marks=pytest.mark.trial),
        pytest.param(signal.SIGINT, ["--workers", "1"], marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, [], marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_study_in_one_line(tmp_path, number, options):
    """Its status is that of the signal; children, locks and partial files are gone."""
    with _interrupted(number, tmp_path, *options) as (process, children):
        _, said = process.communicate(timeout=60)

        assert process.returncode == 128 + number
        assert psutil.wait_procs(children, timeout=0.0)[1] == []
    assert said.splitlines()[-1] == (
        "tiswarm: error: interrupted; "
        "the same command again lets a run go on from its finished cases"
    )
    assert "Traceback" not in said
    [lock] = tmp_path.glob("*/.lock")
    with lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert not [*tmp_path.rglob(".*.part"), *tmp_path.rglob(".*.tmp")]


MANY = ("robots=10", "seeds=4000", "conditions={a: {}, b: {}}")
"""Settings of a study whose forecast is minutes, and whose cases take a fraction of a second."""


@pytest.mark.trial
@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_keeps_cases_and_the_same_command_goes_on(tmp_path, presses):
    """A terminal interrupts the processes of a group, workers too; impatient users press twice."""
    settings = [part for text in MANY for part in ("--set", text)]
    command = [sys.executable, "-m", "tiswarm", "run", "tests/tower.yaml", *settings]
    command += ["--out", str(tmp_path), "--workers", "2", "--threads", "2", "--no-pictures"]
    kept: dict[Path, int] = {}
    for _ in range(2):
        with interruptible():
            process = subprocess.Popen(
                command, cwd=REPOSITORY, env=environment(), text=True,
                stderr=subprocess.PIPE, start_new_session=True,
            )  # fmt: skip
        with process:
            while len([*tmp_path.glob("*/cases/*/case.json")]) < len(kept) + 2:
                assert process.poll() is None
                time.sleep(0.05)
            workers = psutil.Process(process.pid).children()
            for _ in range(presses):
                os.killpg(process.pid, signal.SIGINT)
                time.sleep(0.3)
            _, said = process.communicate(timeout=60)

        assert process.returncode == 128 + signal.SIGINT
        assert len(workers) == 2
        assert psutil.wait_procs(workers, timeout=1.0)[1] == []
        assert "Traceback" not in said
        assert said.splitlines()[-1].startswith("tiswarm: error: interrupted; the same command")
        assert all(path.stat().st_mtime_ns == written for path, written in kept.items())
        before, kept = (
            kept,
            {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/cases/*/case.json")},
        )
        assert len(kept) > len(before)
        assert not [*tmp_path.rglob(".*.part"), *tmp_path.rglob(".*.tmp")]
    assert len([*tmp_path.iterdir()]) == 1


def _said(monkeypatch, capsys, *arguments: str) -> tuple[int, str]:
    """Run a command in this process; return its status and what it wrote to standard error."""
    monkeypatch.setattr(sys, "argv", ["tiswarm", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code, capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no device that is full")
def test_a_full_disk_behind_standard_output_is_one_line(tmp_path):
    """No second complaint follows as the process ends."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "tiswarm", "--version"],
            cwd=REPOSITORY,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )

    what = "cannot read or write: No space left on device; check the disk and its permissions"
    assert (done.returncode, done.stderr) == (1, f"tiswarm: error: {what}\n")


@pytest.mark.parametrize(("room", "name"), [(Path, "cwd"), (os, "chdir")])
def test_a_working_folder_that_is_gone_or_closed_is_one_line(monkeypatch, capsys, room, name):
    """The kernel library and open3d would end in a traceback, or abort the process."""

    def refuse(*_):
        raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr(room, name, refuse)

    status, said = _said(monkeypatch, capsys, "schema")

    what = "the working folder cannot be used: No such file or directory; change to another one"
    assert (status, said) == (1, f"tiswarm: error: {what}\n")


def test_figures_ask_for_no_window_system(monkeypatch, capsys):
    """Matplotlib refuses to be imported where the variable names nothing that it knows."""
    monkeypatch.setenv("MPLBACKEND", "nonsense")

    assert _said(monkeypatch, capsys, "--version") == (0, "")

    assert os.environ["MPLBACKEND"] == "agg"
