"""Fits of gains: separate training structures, repetition, continuation."""

import json
import re

import pytest

from benchmarks.tuning import fit as fits
from benchmarks.tuning.fit import GAINS, tune
from tests.benchmarks.commands import call
from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.localization import methods
from tiswarm.localization.settings import VirtualForceParams
from tiswarm.records.run_folder import LABEL
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe

PAPER = REPOSITORY / "scenarios" / "paper.yaml"


def _fit(path, *, trials=3):
    """Fit gains on two small structures of each point."""
    tune(
        load_scenario(PAPER, ["robots=5"]), path, trials=trials, training_seeds=2, conditions=[],
        progress=Progress(),
    )  # fmt: skip
    return path


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """Path of the record of a fit of three trials."""
    return _fit(tmp_path_factory.mktemp("fits") / "fit.json")


def test_the_first_trial_is_what_the_scenario_says(record):
    """A fit is never worse than the scenario, and the chosen trial is about as good as the best."""
    fit = json.loads(record.read_text())

    assert fit["training_seeds"] == [1000, 1001]
    assert len(fit["trials"]) == 3
    assert fit["best"]["sse_R2"] == min(trial["sse_R2"] for trial in fit["trials"])
    assert fit["chosen"]["sse_R2"] <= 1.02**2 * fit["best"]["sse_R2"]
    errors = fit["trials"][0]["by_point_R"]
    assert len(errors) == 6 * 5  # three sets of towers and cantilevers, all conditions
    assert fit["trials"][0]["rmse_R"] == pytest.approx(sum(errors) / len(errors), abs=1e-4)


def test_a_fit_goes_on_as_if_it_had_never_been_left(tmp_path, record):
    """A record cut short after one trial, as by a kill, ends in the same bytes."""
    whole = json.loads(record.read_text())
    cut = tmp_path / "fit.json"
    cut.write_text(json.dumps(whole | {"trials": whole["trials"][:1]}))

    _fit(cut)

    assert cut.read_bytes() == record.read_bytes()


@pytest.mark.trial
def test_the_command_writes_the_record(tmp_path, record):
    """Its options are the arguments of the call."""
    small = ("--set", "robots=5", "--training-seeds", "2", "--trials", 3)

    done = call("tuning", PAPER, *small, "--out", tmp_path / "fit.json")

    assert done.returncode == 0, done.stderr
    assert (tmp_path / "fit.json").read_bytes() == record.read_bytes()


@pytest.mark.parametrize(
    ("robots", "seeds", "conditions", "message"),
    [
        (5, "[3, 1001]", [], "seeds: the scenario reports on seed 1001"),
        (5, "1", ["no-zz"], "condition: no condition 'no-zz'; choose among all-cues"),
        (
            9,
            "1",
            [],
            "is the record of a fit with other settings or other code",
        ),
    ],
)
def test_a_fit_that_would_mislead_is_refused(record, robots, seeds, conditions, message):
    """The message says why, and the record stays as it is."""
    scenario = load_scenario(PAPER, [f"robots={robots}", f"seeds={seeds}"])
    before = record.read_bytes()

    with pytest.raises(InputError, match=re.escape(message)):
        tune(
            scenario, record, trials=4, training_seeds=2, conditions=conditions,
            progress=Progress(),
        )  # fmt: skip

    assert record.read_bytes() == before


def test_a_record_of_other_code_is_not_continued(tmp_path):
    """The shipped record has no digest of its code, so other code may have made its trials."""
    record = tmp_path / "virtual-force.json"
    record.write_bytes((REPOSITORY / "docs" / "fits" / record.name).read_bytes())

    with pytest.raises(
        InputError, match=r"is the record of a fit with .* other code; give another"
    ):
        tune(
            load_scenario(PAPER), record, trials=500, training_seeds=12, conditions=[],
            progress=Progress(),
        )  # fmt: skip


def test_a_fit_analyzes_no_rigidity(tmp_path, monkeypatch):
    """A trial needs positions; what a log determines does not depend on the gains."""

    def fail(*_, **__):
        raise AssertionError

    monkeypatch.setattr(methods, "observability", fail)
    small = load_scenario(PAPER, ["robots=6", "sweep={}", "conditions={a: {}}"])

    fit = tune(
        small, tmp_path / "fit.json", trials=1, training_seeds=1, conditions=[],
        progress=Progress(),
    )  # fmt: skip

    assert fit["best"]["rmse_R"] > 0.0


def test_shipped_gains_are_those_of_the_record_and_never_reported_on():
    """Gains agree to two digits, and no shipped scenario grows a training structure."""
    fit = json.loads((REPOSITORY / "docs" / "fits" / "virtual-force.json").read_text())
    shipped = VirtualForceParams()

    assert {name: getattr(shipped, name) for name in GAINS} == {
        name: float(f"{fit['chosen'][name]:.2g}") for name in GAINS
    }
    for path in (REPOSITORY / "scenarios").glob("*.yaml"):
        assert not set(load_scenario(path).seed_list) & set(fit["training_seeds"]), path.name


def test_a_stable_fit_has_no_cap_and_leaves_out_gains_with_which_rounding_grows(
    tmp_path, monkeypatch
):
    """The best trial is the least of those in which a nudge of the anchor stays small."""
    small = load_scenario(PAPER, ["robots=6", "sweep={}", "conditions={a: {}}"])
    growth = iter([1e9, 2.0, 1e6])
    monkeypatch.setattr(fits, "growth_of_a_nudge", lambda *_: next(growth))

    fit = tune(
        small, tmp_path / "fit.json", trials=3, training_seeds=2, conditions=[],
        progress=Progress(), stable=True,
    )  # fmt: skip

    trials = json.loads((tmp_path / "fit.json").read_text())["trials"]
    assert fit["best"]["sse_R2"] == min(trial["sse_R2"] for trial in trials[1:])
    assert "max_step" not in fit["best"]
    assert fit["best"]["repulsion_gain"] <= 0.2


def test_a_nudge_grows_where_repulsion_is_strong_and_not_where_it_is_weak(towers):
    """With the default gains robots bounce; with weak repulsion they move as the anchor does."""
    log = observe(towers[0], SensingParams())
    cases = [fits.TrainingCase("", log, towers[0].position, VirtualForceParams())]
    usual = {name: getattr(VirtualForceParams(), name) for name in GAINS}

    strong = fits.growth_of_a_nudge(cases, usual)
    weak = fits.growth_of_a_nudge(cases, {**usual, "repulsion_gain": 0.01, "max_step": 1e9})

    assert weak < 1e3
    assert strong > 1e6


def test_shipped_stable_gains_are_the_best_of_their_record():
    """To two digits, and no step is capped."""
    fit = json.loads((REPOSITORY / "docs" / "fits" / "stable.json").read_text())
    experiments = load_scenario(REPOSITORY / "scenarios" / "paper-experiments.yaml")

    shipped = dict(experiments.conditions["stable"])
    shipped.pop(LABEL)

    gains = {f"localization.{name}": float(f"{fit['best'][name]:.2g}") for name in fit["ranges"]}
    assert shipped == gains | {"localization.max_step": fits.NO_CAP}
    assert fit["best"]["growth"] <= 1e6


def test_a_fit_to_another_objective_ranks_by_it(tmp_path):
    """The record says what was minimized, and its best trial is the least of that."""
    small = load_scenario(PAPER, ["robots=6", "sweep={}", "conditions={a: {}}"])

    fit = tune(
        small, tmp_path / "fit.json", trials=3, training_seeds=2, conditions=[],
        progress=Progress(), objective="rmse",
    )  # fmt: skip

    trials = json.loads((tmp_path / "fit.json").read_text())["trials"]
    assert fit["objective"] == "mean RMSE over structures [R]"
    assert fit["best"]["rmse_R"] == min(trial["rmse_R"] for trial in trials)
    # The SSE is six times the mean square, which is at least the square of the mean RMSE.
    assert trials[0]["sse_R2"] >= 6 * trials[0]["rmse_R"] ** 2 * (1 - 1e-5)
