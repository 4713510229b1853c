"""Studies of the method `none` grow and measure structures, and estimate nothing."""

import re

import numpy as np
import pytest

import tiswarm as api
from tests.runs import QUIET, assert_same_bytes
from tiswarm import study
from tiswarm.app.drawing import draw_all
from tiswarm.records.measures import MEASURES
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.forecast import forecast

LIMITS = (40.0, 1e6)
SEEDS = range(700, 703)
DATA = {
    "name": "hold",
    "question": "reached",
    "robots": 6,
    "seeds": {"first": SEEDS[0], "count": len(SEEDS)},
    "structure": {"kind": "tower", "force_threshold": 5.0},
    "localization": {"method": "none"},
    "sweep": {"structure.strength": [{"limit": limit} for limit in LIMITS]},
}
OF_ESTIMATES = ("error", "rmse", "disparity", "converged", "floppy", "_est_R", "paper")


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A drawn run of towers whose docks break, without localization."""
    out = tmp_path_factory.mktemp("structures")
    result = study.run(load_scenario(DATA), out, progress=QUIET)
    draw_all(result, QUIET)
    return api.open_run(result.folder)


def test_no_file_of_a_case_is_about_an_estimate(measured):
    """There is nothing to estimate, so no table has an empty column or an error for it."""
    case = next(measured.folder.glob("cases/*"))

    names = {path.name for path in case.iterdir()}

    assert {"case.json", "cost.json", "growth.csv", "robots.csv", "sensing.jsonl"} <= names
    assert not {"estimate.csv", "trace.csv", "convergence.csv", "relative.csv"} & names
    for table in (
        measured.frame("robots", case=case.name),
        measured.summary,
        measured.frame("table"),
    ):
        assert not [column for column in table if any(word in column for word in OF_ESTIMATES)]


@pytest.mark.filterwarnings("ignore:.* ended before all robots joined")
def test_structures_are_those_that_grow_returns(measured):
    """A study is another way to the same structures: seeds, heights and robots that stand."""
    summary = measured.summary
    for limit in LIMITS:
        strength = {"limit": limit}
        rows = summary[summary["structure.strength"].str.contains(f" {limit}}}", regex=False)]
        grown = api.grow(
            {"kind": "tower", "force_threshold": 5.0, "strength": strength},
            robots=6, seeds=SEEDS, quiet=True,
        )  # fmt: skip

        expected = grown.table

        for name in ("seed", "height_R", "standing", "fell", "broken", "peak_stress", "joined"):
            np.testing.assert_array_equal(rows[name], expected[name], err_msg=name)


def test_the_answer_names_what_structures_reached(measured):
    """The table that `run` prints states height, standing and broken, and no error."""
    answer = measured.answer

    assert [*answer][:6] == ["condition", "n", "height [R]", "standing", "fell", "broken contacts"]
    assert len(answer) == len(LIMITS)
    assert "Disparity" not in str(measured)
    mean = measured.frame("table")["height_R_mean"]
    assert [float(cell.split()[0]) for cell in answer["height [R]"]] == pytest.approx(
        mean, rel=5e-3
    )


def test_page_and_figures_show_structures_and_no_error(measured):
    """A reader finds structures first; nothing speaks of accuracy."""
    page = measured.page.read_text()

    text = re.sub(r"<(script|style)\b.*?</\1>|<[^>]+>", " ", page, flags=re.DOTALL)

    figures = {*measured.figures}
    assert {"structures", "contact-graph", "sensed-force", "structure"} <= figures
    assert not {"accuracy", "convergence", "error", "sd", "truth-and-estimate"} & figures
    assert "Robots that stand" in text
    words = text.partition("Machine and versions")[0]
    assert not re.search(r"RMSE|[Dd]isparity|Accuracy|estimated", words)


def test_a_finished_case_is_not_computed_again(measured, tmp_path):
    """Cases without estimates are whole; one that lost a table is computed again, to the byte."""
    scenario = load_scenario(DATA)
    run = study.run(scenario, tmp_path, progress=QUIET).folder
    next(run.glob("cases/*/growth.csv")).unlink()

    result = study.run(scenario, tmp_path, progress=QUIET)

    assert (result.computed, result.found) == (1, len(LIMITS) * len(SEEDS) - 1)
    assert_same_bytes(run, measured.folder)


def test_conditions_with_and_without_estimates_share_structures(tmp_path):
    """A condition may localize what others only measure; its errors stand alone in the table."""
    conditions = {"plain": {}, "localized": {"localization": {"method": "virtual-force"}}}
    data = DATA | {"conditions": conditions, "sweep": {}}

    run = api.run(data, out=tmp_path, pictures=False, quiet=True)

    rmse = run.frame("table").set_index("condition")["rmse_R_mean"]
    assert np.isnan(rmse["plain"])
    assert rmse["localized"] > 0.0
    truths = {path.read_bytes() for path in run.folder.glob("cases/700-*/truth.csv")}
    assert len(truths) == 1
    for name in ("accuracy", "convergence"):
        assert run.figure(name).axes


def test_a_case_can_be_shown_exported_and_localized_later(measured, tmp_path):
    """The log of a structure is stored: views, exports and a later localization need it."""
    case = f"{SEEDS[0]}-structure.strength=limit-1000000.0,baseline"

    files = [*measured.export("csv", out=tmp_path / "csv", case=case, quiet=True).iterdir()]
    log = api.read_log(measured.folder / "cases" / case / "sensing.jsonl")
    estimate = log.localize("hop-by-hop", quiet=True)

    assert {path.name for path in files} >= {"structure.csv", "contacts.csv"}
    assert estimate.position.shape == (6, 3)


def test_navigation_by_estimates_needs_a_method(tmp_path, tiswarm):
    """Robots cannot build by estimates that nobody makes: a line names the key."""
    file = tmp_path / "study.yaml"
    file.write_text(
        "name: x\nstructure: {kind: tower, navigate_by: estimate}\nlocalization: {method: none}\n"
    )

    done = tiswarm("run", file, "--out", tmp_path / "out")

    assert done.returncode == 2
    assert f"{file}:3: localization.method: robots navigate by estimates" in done.stderr
    assert not (tmp_path / "out").exists()


def test_no_log_is_localized_by_none(measured, tmp_path, tiswarm):
    """`none` is a method of studies; `localize` and `compare` say what to choose instead."""
    log = next(measured.folder.glob("cases/*/sensing.jsonl"))
    out = tmp_path / "estimate.csv"

    done = tiswarm("localize", log, "--method", "none", "--out", out)
    compared = tiswarm("compare", measured.folder, measured.folder.parent, "--out", tmp_path / "c")

    assert (done.returncode, compared.returncode) == (2, 2)
    assert "none estimates no positions; choose another method" in done.stderr
    assert "has no estimates to compare" in compared.stderr
    assert not out.exists()


@pytest.mark.trial
def test_a_study_of_sizes_has_costs_without_localization(tmp_path):
    """Scaling of growth alone is a study, too: heights and times, but no errors."""
    data = DATA | {"robots": 100, "sweep": {"robots": [3, 6]}, "seeds": 2}

    run = api.run(data, out=tmp_path, quiet=True)

    measures = {*run.frame("scaling")["measure"]}
    assert {"height_R", "grow_cpu_s", "joins_per_cpu_s"} <= measures
    assert not [name for name in measures if name.startswith(("rmse", "localize"))]
    assert {"scaling", "sizes"} <= {*run.figures}


def test_forecasts_count_no_localization():
    """`--plan` expects growth and measures alone."""
    assert forecast(load_scenario(DATA)).localize_s == 0.0


@pytest.mark.parametrize(
    ("seeds", "mistake"),
    [
        ("{first: 5}", "seeds.count"),
        ("{first: -1, count: 2}", "seeds.first: -1 should be greater than or equal to 0"),
        ("{first: 9223372036854775807, count: 2}", "the last seed is greater than"),
    ],
)
def test_mistakes_of_a_range_of_seeds_have_their_key(seeds, mistake, tmp_path, tiswarm):
    """A range is checked as the other forms of the key are."""
    file = tmp_path / "study.yaml"
    file.write_text(
        f"name: x\nstructure: {{kind: tower}}\nlocalization: {{method: none}}\nseeds: {seeds}\n"
    )

    done = tiswarm("check", file)

    assert done.returncode == 2
    assert f"{file}:4: " in done.stderr
    assert mistake in done.stderr


def test_every_measure_of_structures_has_a_mean(measured):
    """The columns that a table has follow from what measures are computed from."""
    table = measured.frame("table")

    for measure in MEASURES.values():
        is_expected = measure.averaged and not (measure.needs_estimate or measure.is_of_engine)
        assert (measure.mean in table) == is_expected, measure.column


@pytest.mark.trial
def test_the_answer_of_the_guide_comes_from_the_command(tmp_path):
    """The shipped scenario makes the tables of `docs/guides/will-it-hold.md`: one cell of them."""
    settings = ["sweep={structure.strength: [{limit: 150}]}", "structure.force_threshold=5"]

    run = api.run("will-it-hold", settings, out=tmp_path, pictures=False, quiet=True)

    [row] = run.answer.to_dict("records")
    assert (row["height [R]"], row["standing"]) == ("20.3 ± 0.6", "59.7 ± 0.3")
