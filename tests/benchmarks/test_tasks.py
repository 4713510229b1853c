"""Policies on tasks are compared by intervals, and fitted on seeds that the table leaves out."""

import json

import numpy as np
import pytest
from scipy.stats import binomtest

pytest.importorskip("gymnasium", reason="the extra learn installs it")

from benchmarks.tasks import FIRST_TEST_SEED, FITTED, TRIED, names, share_interval
from tiswarm.learn import TASKS


@pytest.mark.parametrize(("count", "total"), [(0, 10), (5, 10), (64, 64), (1021, 1280)])
def test_the_interval_of_a_share_is_wilsons(count, total):
    """It stays within 0 and 1, and means something where all or none closed."""
    expected = binomtest(count, total).proportion_ci(method="wilson")

    low, high = share_interval(count, total)

    np.testing.assert_allclose([low, high], [expected.low, expected.high], atol=1e-4)


def test_what_is_fitted_is_fitted_on_training_seeds():
    """No fit has seen a seed of the table, and each is of a task, setting or feature there is."""
    fitted = json.loads(FITTED.read_text(encoding="utf-8"))
    entries = [entry for of_kind in fitted.values() for entry in of_kind.values()]

    last_seeds = [int(entry["training_seeds"].split()[-1]) for entry in entries]

    assert entries
    assert max(last_seeds) < FIRST_TEST_SEED
    assert {task for of_kind in fitted.values() for task in of_kind} <= {*TASKS}
    assert all([*entry["settings"]] == [*TRIED] for entry in fitted["tuned"].values())
    assert all([*entry["weights"]] == names() for entry in fitted["evolved"].values())
