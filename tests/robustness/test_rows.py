"""A log may lack, repeat or confuse any rows: each method returns an estimate or refuses it."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from tests.robustness.mutations import as_json_lines
from tests.robustness.quick_methods import METHODS
from tests.robustness.sensed_rows import logs_of_all_kinds, with_damaged_rows
from tests.structures import silent
from tiswarm.app.logs import Log
from tiswarm.base.errors import InputError
from tiswarm.localization.methods import localize
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import read_estimate, write_estimate
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Logs of small swarms of many kinds, in a row."""
    return [*logs_of_all_kinds(tmp_path_factory.mktemp("logs")).values()]


def _assert_finite(log: SensingLog, estimate: Estimate) -> None:
    """Demand that all numbers of an estimate are finite, and standard deviations none below 0."""
    assert estimate.position.shape == (log.robot_count, 3)
    parts = {"mean": estimate, **{str(k): s for k, s in enumerate(estimate.solutions)}}
    for name, part in parts.items():
        assert np.isfinite(part.position).all(), f"position of {name}"
        if part.sd is not None:
            assert np.isfinite(part.sd).all(), f"sd of {name}"
            assert (part.sd >= 0.0).all(), f"sd of {name}"
    for key in ("yaw", "misfit", "residual", "trace", "at_join"):
        values = getattr(estimate, key)
        assert values is None or np.isfinite(values).all(), key


def _assert_described(log: SensingLog, estimate: Estimate, table: Path) -> None:
    """Demand that the estimate is put into words, and that its table reads back."""
    lines = str(Log.of(log).with_estimate(estimate)).splitlines()
    assert all(line.isprintable() for line in lines)
    write_estimate(table, estimate)
    np.testing.assert_allclose(read_estimate(log, table).position, estimate.position)


def _try_methods(trial, number: int, path: Path, methods: Iterable[str]) -> None:
    """Localize a log by methods; count estimates and refusals."""
    try:
        log = read_sensing_log(path)
    except InputError:
        trial.outcomes["log refused"] += 1
        return
    for method in methods:
        with trial.attempt(number, path, what=method):
            try:
                estimate = localize(log, METHODS[method])
            except InputError:
                trial.outcomes[f"{method}: refused"] += 1
            else:
                _assert_finite(log, estimate)
                _assert_described(log, estimate, path.with_name("estimate.csv"))
                trial.outcomes[f"{method}: estimate"] += 1


@pytest.mark.parametrize("params", METHODS.values(), ids=METHODS)
def test_an_anchor_that_sensed_nothing_is_where_it_is(params):
    """A log of no other robot has no unknown."""
    log = silent([[1.0, 2.0, 3.0]])

    estimate = localize(log, params)

    np.testing.assert_array_equal(estimate.position, [[1.0, 2.0, 3.0]])
    assert estimate.sd is None or estimate.sd.tolist() == [0.0]


ATTEMPTS = [
    pytest.param(35, 1, id="35 logs, methods in turn"),
    pytest.param(100, 7, id="100 logs", marks=pytest.mark.trial),
    pytest.param(600, 7, id="600 logs", marks=pytest.mark.slow),
]
"""Damaged logs, and how many methods try each; one log of ten is refused before."""


@pytest.mark.parametrize(("attempts", "methods_each"), ATTEMPTS)
def test_logs_with_damaged_rows_are_localized_or_refused(
    trial, logs, tmp_path, attempts, methods_each
):
    """Nothing but InputError is raised, and no number of an estimate is NaN or infinite."""
    path, titles = tmp_path / "sensing.jsonl", [*METHODS]
    for number in trial.numbers(attempts):
        random = trial.random(number)
        path.write_bytes(as_json_lines(with_damaged_rows(random, random.choice(logs))))
        first = number % len(titles)
        _try_methods(trial, number, path, (titles[first:] + titles[:first])[:methods_each])

    assert trial.failures == []
    assert sum("estimate" in outcome for outcome in trial.outcomes) == len(METHODS)
