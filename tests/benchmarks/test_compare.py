"""Baselines are stored, and a work that takes longer than its baseline is named."""

import json

import pytest

from benchmarks.compare import BASELINES, COMPARED, Timing, compared
from tests.benchmarks.commands import call

OPTIONS = ["--works", "swarm step", "--share", 0.01, "--rounds", 2]


def _timing(**changed):
    values = {
        "work": "growth", "amount": 8, "unit": "towers", "rounds": 9, "ratio": 10.0,
        "scatter": 0.02, "cpu_s": 1.0, "calibration_s": 0.1, "code": "", "machine": {},
    }  # fmt: skip
    return Timing(**values | changed)


@pytest.mark.parametrize(
    ("ratio", "verdict"),
    [(10.6, "within scatter"), (10.8, "slower"), (9.5, "within scatter"), (9.2, "faster")],
)
def test_changes_count_beyond_the_scatters_of_both_runs(ratio, verdict):
    """With scatters of 5 and 2 %, a ratio of 10 may have grown to 10.7 by chance."""
    stored = vars(_timing(scatter=0.05))

    row, found = compared(_timing(ratio=ratio), stored)

    assert found == verdict
    assert row == f"| growth | 10 | {ratio:.3g} | {ratio / 10 - 1:+.0%} | 7% | 1 | 1 | {verdict} |"


def test_other_amounts_are_not_compared():
    """Half of the work is not twice as fast."""
    _, found = compared(_timing(amount=4, ratio=5.0), vars(_timing()))

    assert found == "not comparable: the baseline is of 8 towers"


@pytest.mark.trial
def test_a_slower_work_ends_the_command_with_an_error(tmp_path):
    """The command stores what it measured, and fails against a baseline of a thousandth of it."""
    stored = call("compare", *OPTIONS, "--store", "--baselines", tmp_path)
    assert stored.returncode == 0, stored.stderr
    file = tmp_path / "swarm-step.json"
    baseline = json.loads(file.read_text())
    file.write_text(json.dumps(baseline | {"ratio": baseline["ratio"] / 1000.0, "scatter": 0.0}))

    done = call("compare", *OPTIONS, "--baselines", tmp_path)

    assert baseline["machine"]["load"], "the load is stored"
    assert done.returncode == 1, done.stderr
    assert "| slower |" in done.stdout


def test_each_work_has_a_baseline():
    """What is stored in the repository is of the works and amounts that are timed."""
    stored = [json.loads(file.read_text()) for file in sorted(BASELINES.glob("*.json"))]

    assert {each["work"]: each["amount"] for each in stored} == {
        name: work.amount for name, work in COMPARED.items()
    }
