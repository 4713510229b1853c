"""Hundreds of cases in one process need no more memory than the first."""

import gc
from statistics import median

import psutil
import pytest

from tests.runs import REPOSITORY
from tiswarm.base.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import run

pytestmark = pytest.mark.slow

METHODS = "conditions={a: {}, b: {localization.method: joint, localization.steps: 40}}"
CASES_EACH = 10
DRAWN_EVERY = 5
WARM_UP = 10
"""Runs in which kernels compile, modules load and the allocator finds its size; also, how many runs
the median of memory is over: figures take some for a while."""


def test_five_hundred_cases_need_the_memory_of_the_first_hundred(trial, tmp_path):
    """Resident memory of the last ten runs exceeds that of the second ten by 5 % at most."""
    process, memory_mb = psutil.Process(), []  # resident
    for number in range(50):
        sizes = [f"robots={4 + number % 7}", f"seeds=[{', '.join(map(str, range(5)))}]"]
        scenario = load_scenario(REPOSITORY / "tests" / "tower.yaml", [METHODS, *sizes])
        with trial.attempt(number):
            result = run(scenario, tmp_path / str(number), progress=Progress())
            assert result.computed == CASES_EACH
            if number % DRAWN_EVERY == 0:
                draw_figures(load_run(result.folder), Progress())
        gc.collect()
        memory_mb.append(process.memory_info().rss / 2**20)

    assert trial.failures == []
    warm, last = median(memory_mb[WARM_UP : 2 * WARM_UP]), median(memory_mb[-WARM_UP:])
    trial.outcomes[f"runs of ten cases, {warm:.0f} MB at first, {last:.0f} MB at last"] = len(
        memory_mb
    )
    assert last < 1.05 * warm, [round(each) for each in memory_mb]
