"""Kills in the middle of writes, and equal runs in one folder whose locks do not work."""

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.robustness.studies import END_S, Study, with_lines
from tests.runs import assert_same_results, environment
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe

pytestmark = pytest.mark.slow

KILLS = 30
"""Kills of each kind."""

WAYS = ("half", "whole", "renamed")
"""What there is of a file: half of its bytes, all under a temporary name, all."""

STUDY = ("robots=6", "seeds=2", "conditions={a: {}, b: {localization.iterations: 20}}")
CLOSED_LOOP = (
    "robots=6",
    "seeds=2",
    "sensing.tilt_noise_deg=1",
    "structure.navigate_by=estimate",
    "conditions={a: {}, b: {localization.back_propagation: {every: 3}}}",
)

KILLED = """
import io, os, signal, sys
from pathlib import Path

AT, WAY = int(os.environ.get("KILL_AT", "0")), os.environ.get("KILL_WAY", "")
opened, seen, replaced = Path.open, [], Path.replace

def die():
    os.killpg(0, signal.SIGKILL)

class Half(io.BufferedWriter):
    def write(self, data):
        super().write(memoryview(data).cast("B")[: len(data) // 2])
        self.flush()
        die()

def open_counted(path, mode="r", *rest, **named):
    if mode != "xb":
        return opened(path, mode, *rest, **named)
    seen.append(path)
    if len(seen) == AT and WAY == "half":
        return Half(io.FileIO(path, "xb"))
    return opened(path, mode, *rest, **named)

def replace_counted(path, target):
    chosen = len(seen) >= AT > 0 and path == seen[AT - 1]
    if chosen and WAY == "whole":
        die()
    replaced(path, target)
    if chosen and WAY == "renamed":
        die()

Path.open, Path.replace = open_counted, replace_counted
if "KEEP" in os.environ:
    from tiswarm.study import runner
    runner.KEPT_FROM_S = 0.0  # also structures are kept for the next run
"""

UNLOCKED = """
import fcntl
fcntl.flock = lambda *_: None
"""


def _kill(
    trial, start: Callable[..., subprocess.Popen], folder: Path, check: Callable, *, writes: int
) -> None:
    """Kill a command at one of its first writes, give it again until it ends, and so on."""
    random = trial.random()
    killed, number = 0, len(trial.numbers(KILLS))
    while killed < number:
        at, way = random.randint(1, writes), random.choice(WAYS)
        status = start(KILL_AT=str(at), KILL_WAY=way).wait(END_S)
        if status == -signal.SIGKILL:
            killed += 1
            trial.outcomes[f"{way} written" if way != "renamed" else way] += 1
            if killed < number:
                continue
            status = start().wait(END_S)
        with trial.attempt(killed):
            assert status == 0
            check()
        shutil.rmtree(folder)
    assert trial.failures == []


@pytest.mark.parametrize("settings", [STUDY, CLOSED_LOOP], ids=["study", "closed loop"])
def test_studies_killed_as_they_write(trial, tmp_path, settings):
    """Half a file, a whole one without its name, or a renamed one: the run ends in its bytes."""
    lines = with_lines(tmp_path / "site", KILLED) | {"KEEP": ""}
    whole = Study(tmp_path / "whole", tmp_path / "cache", settings)
    study = Study(tmp_path / "killed", tmp_path / "cache", settings)
    for _ in range(2):  # kernels are stored as the first process ends
        shutil.rmtree(whole.out, ignore_errors=True)
        whole.finish("--no-pictures", **lines)
    [expected] = whole.out.iterdir()

    def check() -> None:
        [found] = study.out.iterdir()
        assert_same_results(expected, found)
        assert sorted(path.name for path in found.iterdir()) == sorted(
            path.name for path in expected.iterdir()
        )

    _kill(
        trial, lambda **env: study.start("--no-pictures", **lines, **env), study.out, check,
        writes=12,
    )  # fmt: skip


def test_streams_killed_as_they_write(trial, tmp_path, towers):
    """The same lines give the same answers; a table is whole, whether it is the new one or none."""
    write_sensing_log(observe(towers[0], SensingParams()), tmp_path / "log.jsonl")
    head = (tmp_path / "log.jsonl").read_text().splitlines(keepends=True)[:6]
    (tmp_path / "log.jsonl").write_text("".join(head))
    lines = with_lines(tmp_path / "site", KILLED)
    folder, table = tmp_path / "killed", tmp_path / "killed" / "estimate.csv"
    settings = ["--set", "chains=1", "--set", "steps=20", "--set", "hold_steps=10"]
    command = [sys.executable, "-m", "tiswarm", "track", tmp_path / "log.jsonl", *settings]

    def start(**env: str) -> subprocess.Popen:
        folder.mkdir(exist_ok=True)
        with (folder / "answers.jsonl").open("wb") as answers:
            return subprocess.Popen(
                [*command, "--estimate", table], cwd=folder, stdout=answers,
                env=environment() | lines | env, stderr=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip

    assert start().wait(END_S) == 0
    whole = {path.name: path.read_bytes() for path in folder.iterdir()}

    def check() -> None:
        found = {path.name: path.read_bytes() for path in folder.iterdir()}
        left = {name for name in found if name.endswith(".tmp")}
        assert {name: found[name] for name in found.keys() - left} == whole

    _kill(trial, start, folder, check, writes=1)


def test_equal_runs_without_locks(trial, tmp_path):
    """Two at once in one folder, where locks exclude nobody: both end well, in the same bytes."""
    lines = with_lines(tmp_path / "site", UNLOCKED)
    whole = Study(tmp_path / "whole", tmp_path / "cache", STUDY)
    for _ in range(2):
        shutil.rmtree(whole.out, ignore_errors=True)
        begun = time.monotonic()
        whole.finish("--no-pictures")
    takes = time.monotonic() - begun
    study = Study(tmp_path / "pair", tmp_path / "cache", STUDY)
    for number in trial.numbers(KILLS):
        random = trial.random(number)
        said = [tmp_path / f"{name}.txt" for name in ("first", "second")]
        first = study.start("--no-pictures", said=said[0], **lines)
        time.sleep(random.choice([0.0, random.uniform(0.0, 2.0 * takes)]))
        second = study.start("--no-pictures", said=said[1], **lines)
        with trial.attempt(number, *said):
            assert [first.wait(END_S), second.wait(END_S)] == [0, 0], said[1].read_text()
            [found] = study.out.iterdir()
            assert_same_results(next(whole.out.iterdir()), found)
            stored = said[1].read_text().count("already stored")
            trial.outcomes["second found some cases" if stored else "second found none"] += 1
        shutil.rmtree(study.out, ignore_errors=True)

    assert trial.failures == []
