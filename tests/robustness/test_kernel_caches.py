"""A command whose cache of compiled kernels is damaged compiles anew and gives the same bytes."""

import shutil

import pytest

from tests.robustness.mutations import damaged
from tests.runs import call

pytestmark = pytest.mark.slow


@pytest.fixture
def log(tmp_path):
    """Log of six robots."""
    settings = ("robots=6", "seeds=1", "conditions={a: {}}")
    options = [part for text in settings for part in ("--set", text)]
    out = tmp_path / "run"
    done = call("run", "tests/tower.yaml", *options, "--no-pictures", "--out", out)
    assert done.returncode == 0, done.stderr
    return next(out.rglob("sensing.jsonl"))


def _localize(log, estimate, cache):
    return call(
        "localize",
        log,
        "--method",
        "virtual-force",
        "--out",
        estimate,
        "--overwrite",
        XDG_CACHE_HOME=str(cache),
    )


def test_damaged_kernels_are_never_run(trial, log, tmp_path):
    """A line says that they are cleared; the estimate is the same."""
    whole, cache = tmp_path / "whole.csv", tmp_path / "cache"
    for _ in range(2):  # the second start adds to the cache
        assert _localize(log, whole, cache).returncode == 0
    for number in trial.numbers(100):
        random = trial.random(number)
        copy = shutil.copytree(cache, tmp_path / f"cache-{number}")
        kernels = [file for file in sorted(copy.glob("tiswarm/kernels/*/*")) if file.is_file()]
        path = random.choice(kernels)
        sound = path.read_bytes()
        while path.read_bytes() == sound:
            path.write_bytes(damaged(random, sound))
        estimate = tmp_path / f"{number}.csv"
        with trial.attempt(number, path, what=path.name):
            done = _localize(log, estimate, copy)
            assert done.returncode == 0, done.stderr
            assert "damaged kernel cache cleared; compiling again" in done.stderr
            assert estimate.read_bytes() == whole.read_bytes()
            trial.outcomes[path.suffix or path.name] += 1
        shutil.rmtree(copy)

    assert trial.failures == []
