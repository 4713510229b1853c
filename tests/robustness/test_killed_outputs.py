"""Commands that are killed as they write a file leave no half of it, and nothing for good."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.runs import REPOSITORY, environment

pytestmark = pytest.mark.trial

ESTIMATE, TRUTH, LOG = "estimate.csv", "truth.csv", "sensing.jsonl"
SAVE = """
import sys, tiswarm
tiswarm.grow('tower', robots=12, seeds=2).save('swarms.npz', overwrite='--overwrite' in sys.argv)
"""

COMMANDS = {
    "localize": ["-m", "tiswarm", "localize", LOG, "--method", "hop-by-hop", "--out", "new.csv"],
    "track": ["-m", "tiswarm", "track", LOG, "--set", "chains=1", "--set", "steps=5", "--set",
              "hold_steps=2", "--out", "answers.jsonl", "--estimate", "last.csv"],
    "import": ["-m", "tiswarm", "import", "poses.csv", "--dock-radius", "0.5", "--out", "imported"],
    "export": ["-m", "tiswarm", "export", LOG, ESTIMATE, "--format", "csv", "--out", "exported"],
    "score": ["-m", "tiswarm", "score", TRUTH, ESTIMATE, "--out", "score.png"],
    "save": ["-c", SAVE],
}  # fmt: skip
"""Arguments of Python, by what writes the outputs."""

KILLS = 10
"""Attempts at each command."""

AGAIN_AFTER = 3
"""Kills after which the command may end."""

END_S = 300.0
"""Wall time in which a command ends that nobody disturbs [s]."""


def start(arguments: list[str], folder: Path) -> "subprocess.Popen[bytes]":
    """Start a command in a folder."""
    return subprocess.Popen(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment(PYTHONPATH=str(REPOSITORY)),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def finish(arguments: list[str], folder: Path) -> None:
    """Run a command to its end, which is without errors."""
    process = start(arguments, folder)
    _, said = process.communicate(timeout=END_S)
    assert process.returncode == 0, said.decode()


def contents(folder: Path) -> dict[str, bytes]:
    """Read the files of a folder that are not hidden."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def temporaries(folder: Path) -> list[str]:
    """List the hidden files of a folder."""
    return [str(path.relative_to(folder)) for path in folder.rglob(".*")]


def kill_at_a_write(process: "subprocess.Popen[bytes]", folder: Path, delay_s: float) -> None:
    """Kill a command a moment after it has begun a file, unless it ends before."""
    places = [folder, folder / "imported", folder / "exported"]
    limit = time.monotonic() + END_S
    while process.poll() is None and time.monotonic() < limit:
        names = [path.name for place in places if place.exists() for path in place.iterdir()]
        if any(name.startswith(".") for name in names):
            time.sleep(delay_s)
            break
    kill(process)


def kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill the processes of a command."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=END_S)


def remove_outputs(folder: Path, inputs: Path) -> None:
    """Remove what commands wrote, but no hidden file of theirs."""
    for name in contents(folder).keys() - contents(inputs).keys():
        (folder / name).unlink()


@pytest.fixture(scope="module")
def inputs(small_run, tmp_path_factory) -> Path:
    """Folder with what the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    case = small_run / "cases" / "0-baseline"
    for name in (LOG, ESTIMATE, TRUTH):
        shutil.copy(case / name, folder)
    shutil.copy(REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv", folder / "poses.csv")
    return folder


@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_leaves_whole_files_and_the_next_succeeds(trial, inputs, tmp_path, name):
    """Each file is whole or absent, and the same command again leaves no hidden file."""
    arguments = COMMANDS[name]
    undisturbed = tmp_path / "undisturbed"
    shutil.copytree(inputs, undisturbed)
    begun_s = time.monotonic()
    finish(arguments, undisturbed)
    lasts_s = time.monotonic() - begun_s
    whole = contents(undisturbed)
    folder = tmp_path / "killed"
    shutil.copytree(inputs, folder)

    for number in trial.numbers(KILLS):
        random = trial.random(number)
        with trial.attempt(number, *folder.glob("*")):
            replaces = contents(folder).keys() == whole.keys()
            process = start([*arguments, "--overwrite"] if replaces else arguments, folder)
            if number % 2:
                time.sleep(random.uniform(0.3, 1.0) * lasts_s)
                kill(process)
            else:
                kill_at_a_write(process, folder, random.choice([0.0, 0.0005, 0.002, 0.01]))
            what = "killed" if process.returncode == -signal.SIGKILL else "ended before"
            if replaces:
                what += " as it replaces"
            if temporaries(folder):
                what += " with hidden files"
            trial.outcomes[what] += 1
            assert contents(folder).items() <= whole.items()
            if number % AGAIN_AFTER == AGAIN_AFTER - 1 or number == trial.numbers(KILLS)[-1]:
                finish([*arguments, "--overwrite"], folder)
                assert contents(folder) == whole
                assert temporaries(folder) == []
            if random.random() < 0.5:  # outputs are new in the next attempt
                remove_outputs(folder, inputs)

    assert not trial.failures
