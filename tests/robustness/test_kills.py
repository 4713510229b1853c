"""A study whose processes are killed at random moments ends in the bytes of an undisturbed one."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from tests.robustness.studies import END_S, Study
from tests.runs import assert_same_bytes, assert_same_results
from tiswarm.compute.backend import available_threads

pytestmark = pytest.mark.slow

STUDY = (
    "robots=6",
    "seeds=4",
    "conditions={a: {}, b: {localization.method: joint, localization.steps: 40}}",
)
"""Settings of eight cases of two methods."""
CASES = 8
PROCESSES = ("--workers", "2", "--case-limit", "600")
"""So little work would be done by one process, but for the limit."""
NOBODY_S = 20.0
"""Wall time in which processes end whose parent was killed [s]; they look once a second."""


def _study(out: Path, cache: Path) -> Study:
    return Study(out, cache, STUDY)


def _moment(study: Study) -> str:
    """Return how many cases are stored, or else which drawing was reported last."""
    stored = len([*study.out.glob("*/cases/[!.]*/case.json")])
    if stored < CASES:
        return f"{'no' if stored == 0 else 'some'} cases stored"
    drawn = re.findall(r"^(figures|renders)/", study.said.read_text(), flags=re.MULTILINE)
    return f"all cases stored{''.join(f', some {what} drawn' for what in drawn[-1:])}"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Cache of kernels; by option, an undisturbed run's parent folder and time [s]."""
    temporary = tmp_path_factory.mktemp("undisturbed")
    cache, found = temporary / "cache", {}
    half = max(1, available_threads() // 2)  # threads of each of two workers
    # Workers keep no kernels: the first two runs compile them, for workers and for the parent.
    plain = "--no-pictures"
    runs = [(plain, half), (plain, None), (plain, None), ("--pictures", None)]
    for number, (pictures, threads) in enumerate(runs):
        study = _study(temporary / str(number), cache)
        limited = [] if threads is None else ["--threads", str(threads)]
        begun = time.monotonic()
        study.finish(pictures, *limited)
        found[pictures] = study.out, time.monotonic() - begun
    return cache, found


@pytest.fixture
def study(undisturbed, tmp_path):
    """Return a study to disturb."""
    cache, _ = undisturbed
    return _study(tmp_path / "killed", cache)


def _assert_nothing_amiss(whole: Path, study: Study, compare) -> None:
    """Compare all bytes except measured ones, and look for leftovers; then remove the folder."""
    a, b = next(whole.iterdir()), next(study.out.iterdir())
    compare(a, b)
    manifests = [json.loads((folder / "manifest.json").read_text()) for folder in (a, b)]
    assert manifests[0].keys() == manifests[1].keys()
    assert all(json.loads(path.read_text()) for path in b.glob("cases/*/cost.json"))
    assert len([*b.glob("cases/*/cost.json")]) == CASES
    assert not [*b.rglob(".*.part"), *b.rglob(".*.tmp")]
    shutil.rmtree(study.out)


@pytest.mark.parametrize(
    ("end", "kills"),
    [
        pytest.param(lambda process: os.killpg(process.pid, signal.SIGKILL), 100, id="all at once"),
        pytest.param(lambda process: process.kill(), 50, id="the parent alone"),
    ],
)
def test_killed_studies_lose_and_double_nothing(trial, undisturbed, study, end, kills):
    """Kill and give the same command again at once, until it ends; children soon end too."""
    random = trial.random()
    pictures, orphans = "--no-pictures", []
    killed, number = 0, len(trial.numbers(kills))
    while killed < number or study.out.exists():
        if not study.out.exists():  # a new study
            pictures = random.choice(["--no-pictures", "--no-pictures", "--pictures"])
        whole, takes = undisturbed[1][pictures]
        process = study.start(pictures, *random.choice([[], PROCESSES]))
        with suppress(subprocess.TimeoutExpired):
            # Late moments are more likely: a study spends half of its time on imports.
            process.wait(END_S if killed == number else takes * random.random() ** 0.5)
        status = process.poll()
        if status is None and killed < number:
            orphans = psutil.Process(process.pid).children(recursive=True)
            end(process)
            process.wait()
            killed += 1
            trial.outcomes[_moment(study)] += 1
            continue
        with trial.attempt(killed, study.said):
            assert status == 0, study.said.read_text()
            assert psutil.wait_procs(orphans, timeout=NOBODY_S)[1] == []
            _assert_nothing_amiss(whole, study, assert_same_results)
        if status is None:
            os.killpg(process.pid, signal.SIGKILL)
        shutil.rmtree(study.out, ignore_errors=True)

    assert trial.failures == []


def test_studies_outlive_children_that_are_killed(trial, undisturbed, study):
    """Kill workers and renderers one by one; what they did is done again, here or elsewhere."""
    random = trial.random()
    killed, number = 0, len(trial.numbers(50))
    while killed < number:
        pictures = random.choice(["--no-pictures", "--pictures"])
        whole, takes = undisturbed[1][pictures]
        process = study.start(pictures, *PROCESSES)
        at = time.monotonic() + random.uniform(0.0, takes)
        while process.poll() is None and killed < number:
            time.sleep(0.02)
            children = psutil.Process(process.pid).children(recursive=True)
            if children and time.monotonic() > at:
                with suppress(psutil.NoSuchProcess):  # it has just ended
                    random.choice(children).kill()
                    killed += 1
                    trial.outcomes[_moment(study)] += 1
                at = time.monotonic() + random.uniform(0.0, takes / 2.0)
        status, said = process.wait(END_S), study.said.read_text()
        again = study.start(pictures).wait(END_S)
        with trial.attempt(killed, study.said):
            assert status in {0, 3}, said  # 3: a case lost its process each time
            assert "Traceback" not in said
            assert again == 0, study.said.read_text()
            # Pictures may be those of another renderer.
            _assert_nothing_amiss(whole, study, assert_same_bytes)
        shutil.rmtree(study.out, ignore_errors=True)

    assert trial.failures == []
