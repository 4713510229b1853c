"""A study that is killed at random moments ends in the bytes of an uninterrupted one."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.runs import REPOSITORY, assert_same_results

pytestmark = pytest.mark.slow  # a hundred kills take a quarter of an hour

KILLS = int(os.environ.get("TISWARM_KILLS", "10"))
SEED = int(os.environ.get("TISWARM_KILL_SEED", "0"))
STUDY = (
    "robots=30",
    "seeds=10",
    "conditions={a: {}, b: {localization.method: joint, localization.steps: 300}}",
)
"""Settings of twenty cases of two methods."""


class _Study:
    """Command of a study, and its folder."""

    def __init__(self, out: Path, temporary: Path) -> None:
        self.out = out
        self.said = temporary / "said.txt"
        self.environment = {k: v for k, v in os.environ.items() if k != "TISWARM_DEBUG"}
        # A separate cache of kernels, since a killed process may leave a damaged one.
        self.environment["XDG_CACHE_HOME"] = str(temporary / "cache")

    def start(self, *options: str) -> "subprocess.Popen[bytes]":
        """Start the command in its own process group."""
        settings = [part for text in STUDY for part in ("--set", text)]
        command = [sys.executable, "-m", "tiswarm", "run", "scenarios/tower.yaml", *settings]
        with self.said.open("wb") as said:
            return subprocess.Popen(
                [*command, "--out", self.out, *options],
                cwd=REPOSITORY,
                env=self.environment,
                stdout=said,
                stderr=said,
                start_new_session=True,
            )

    def moment(self) -> str:
        """Return the last reported stage of the command, and what is half-written."""
        lines = self.said.read_text().splitlines() or ["nothing"]
        last = re.split("[:/]", lines[-1].rpartition("of 20 ")[2])[0]
        stored = len([*self.out.glob("*/cases/[!.]*/case.json")])
        share = "no" if not stored else "all" if stored == 20 else "some"
        halves = "".join(
            f", within a {what}"
            for what, pattern in (("case", ".*.part"), ("file", ".*.tmp"))
            if [*self.out.rglob(pattern)]
        )
        return f"{share} cases stored, last heard of: {last}{halves}"


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="there are no groups of processes here")
def test_kills_at_random_moments_lose_and_double_nothing(tmp_path):
    """Kill all processes with -9 and repeat the command; restart studies that finish."""
    random = np.random.default_rng(SEED)
    whole = _Study(tmp_path / "whole", tmp_path)
    for out in (tmp_path / "first", whole.out):  # the first one compiles kernels too
        whole.out = out
        begun = time.monotonic()
        assert whole.start().wait(300) == 0, whole.said.read_text()
        takes = time.monotonic() - begun
    moments: Counter[str] = Counter()
    study = _Study(tmp_path / "killed", tmp_path)
    ends = 0
    while moments.total() < KILLS or study.out.exists():
        process = study.start(*([] if random.random() < 0.5 else ["--workers", "2"]))
        try:
            is_last = moments.total() == KILLS
            status = process.wait(300 if is_last else random.uniform(0.0, takes))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            moments[study.moment()] += 1
            continue
        assert status == 0, study.said.read_text()
        _assert_nothing_amiss(whole.out, study.out)
        shutil.rmtree(study.out)
        ends += 1

    sys.stdout.write(f"{KILLS} kills, {ends} studies, {takes:.1f} s each if left alone\n")
    sys.stdout.writelines(f"{count:4d} {moment}\n" for moment, count in moments.most_common())


def _assert_nothing_amiss(whole: Path, killed: Path) -> None:
    """Compare all bytes except measured ones, and look for leftovers."""
    a, b = next(whole.iterdir()), next(killed.iterdir())
    assert_same_results(a, b)
    manifests = [json.loads((folder / "manifest.json").read_text()) for folder in (a, b)]
    assert manifests[0].keys() == manifests[1].keys()
    assert all(json.loads(path.read_text()) for path in b.glob("cases/*/cost.json"))
    assert len([*b.glob("cases/*/cost.json")]) == 20
