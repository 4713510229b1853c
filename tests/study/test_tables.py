"""Tables of a run beside published numbers."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.app.comparison import compare
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.measures import MEASURES
from tiswarm.report.page_tables import console_text, headline_table
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import tables
from tiswarm.study.runner import failure

TOWER, CANTILEVER = [1.64, 1.84, 2.36], [3.91, 5.26, 5.12]


@pytest.mark.parametrize(
    ("changed", "published"),
    [
        ("description=the same", 3 * [*TOWER, *TOWER[1:], *CANTILEVER, *CANTILEVER[1:]]),
        ("structure.climb.settle=1.0", [1.64]),  # the paper leaves open how flips end
        ("structure.anchor=1", [1.64]),
        ("structure.force_threshold=2.5", [1.64]),  # it states no F, B and J
        ("robots=99", [np.nan]),
        ("structure.movers=2", [np.nan]),
        ("sensing.yaw_noise_deg=1", [np.nan]),
        ("localization={method: joint}", [np.nan]),
    ],
)
def test_published_numbers_stand_beside_their_own_setting_only(changed, published):
    """Rows of the paper's settings have its numbers; rows of other settings have none."""
    only = () if len(published) > 1 else ("sweep={}", "conditions={baseline: {}}")
    paper = load_scenario(REPOSITORY / "scenarios" / "paper.yaml", ["seeds=1", *only, changed])
    cases = study.plan(paper).cases
    records = [replace(failure(case, ""), status="done", scores={"rmse_R": 3.0}) for case in cases]

    table = tables.table(records, [case.settings for case in cases])

    np.testing.assert_equal(table["paper_rmse_radii"].to_numpy(), published)
    np.testing.assert_allclose(table["rmse_R_to_paper"], 3.0 / np.array(published))
    if len(published) > 1:
        of_towers = [0.0, 12.2, 43.9]  # the paper's percentages, but for rounding
        np.testing.assert_allclose(table["paper_rmse_change_percent"][:3], of_towers, atol=0.05)
        assert (table["rmse_change_percent"] == 0.0).all()


def test_no_error_is_a_multiple_of_rounding():
    """A change of 1e12 percent is no number of a table, and a run ended with its refusal."""
    path = REPOSITORY / "scenarios" / "tower.yaml"
    cases = study.plan(load_scenario(path, ["seeds=1"])).cases
    errors = [2e-11, 0.5, 0.6, 0.7]
    records = [
        replace(failure(case, ""), status="done", scores={"rmse_R": error})
        for case, error in zip(cases, errors, strict=True)
    ]

    table = tables.table(records, [case.settings for case in cases])

    assert table["rmse_change_percent"].isna().all()


def test_measurements_are_equal_if_they_are_on_each_structure():
    """One chain may stand on the ground and another may not: methods know as much of either."""
    path = REPOSITORY / "scenarios" / "tower.yaml"
    only = (
        "conditions={a: {}, b: {localization.schedule: together}, c: {localization.ground: false}}"
    )
    cases = study.plan(load_scenario(path, ["seeds=2", only])).cases
    used = {"a": ["contacts, ground", "contacts"], "c": ["contacts", "contacts"]}
    records = [
        replace(
            failure(case, ""), status="done", scores={"rmse_R": 1.0 + case.seed},
            measurements=used[case.variant.condition.replace("b", "a")][case.seed],
        )
        for case in cases
    ]  # fmt: skip
    settings = [case.settings for case in cases]

    paired, table = tables.paired(records, settings), tables.table(records, settings)

    rmse = paired[paired["measure"] == "rmse_R"].set_index(["against", "condition"])
    assert rmse["equal_measurements"].to_dict() == {
        ("a", "b"): True, ("a", "c"): False, ("b", "c"): False,
    }  # fmt: skip
    assert rmse[["smaller", "larger"]].to_numpy().tolist() == [[0, 0]] * 3
    assert table["measurements"].tolist() == ["contacts, ground"] * 2 + ["contacts"]
    assert table["method"].tolist() == ["virtual-force", "virtual-force together", "virtual-force"]


def test_measurements_of_structures_are_in_the_order_of_their_seeds():
    """Structures of one condition may have other cues: no hash of text decides the order."""
    path = REPOSITORY / "scenarios" / "tower.yaml"
    cases = study.plan(load_scenario(path, ["seeds=8", "conditions={a: {}}"])).cases
    cues = [f"cue_{letter}" for letter in "hfbgadce"]
    records = [
        replace(failure(case, ""), status="done", scores={"rmse_R": 1.0}, measurements=cue)
        for case, cue in zip(cases, cues, strict=True)
    ]

    table = tables.table(records, [case.settings for case in cases])

    assert table["measurements"].tolist() == [", ".join(cues)]


def test_rounds_of_back_propagation_are_in_the_table():
    """A round follows the last join at the latest; conditions without rounds have gaps."""
    path = REPOSITORY / "scenarios" / "back-propagation.yaml"
    cases = study.plan(load_scenario(path, ["seeds=1"])).cases
    records = [replace(failure(case, ""), status="done", scores={"rmse_R": 3.0}) for case in cases]

    table = tables.table(records, [case.settings for case in cases]).set_index("condition")

    rounds = table.loc[
        ["never", "once", "every-5-last-20-short", "joint"], "round_every":"round_sweeps"
    ]
    expected = [[np.nan] * 3, [100, np.nan, 2000], [5, 20, 200], [np.nan] * 3]
    np.testing.assert_equal(rounds.to_numpy(float)[::2], expected)


def test_tables_have_verdicts_and_their_reason():
    """`summary.csv` has them by case, `table.csv` their means over structures."""
    paper = load_scenario(REPOSITORY / "scenarios" / "paper.yaml", ["seeds=2", "sweep={}"])
    cases = study.plan(paper).cases[:2]
    scores = {"rmse_R": 3.0, "converged": True, "sd_factor": 2.0, "misfit_sd": 9.0, "mirrored": 3}
    records = [
        replace(
            failure(case, ""),
            status="done",
            scores=scores | {"consistent": bool(n)},
            distrust="" if n else "wrong heights",
        )
        for n, case in enumerate(cases)
    ]
    settings = [case.settings for case in cases]

    summary, table = tables.summary(records, settings), tables.table(records, settings)

    assert summary["distrust"].tolist() == ["wrong heights", ""]
    assert summary.columns.get_loc("distrust") < summary.columns.get_loc("reason")
    assert table["consistent_mean"].mean() == 0.5
    assert table[["sd_factor_mean", "misfit_sd_mean", "mirrored_mean"]].iloc[0].tolist() == [
        2,
        9,
        3,
    ]


@pytest.mark.parametrize("name", ["NA", "null"])
def test_a_condition_may_have_the_name_of_a_missing_value(tmp_path, name):
    """The table of results and the comparison of runs have the names as in `table.csv`."""
    header = "condition,cases,rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean,converged_mean"
    header += ",rmse_R_least,rmse_R_most,procrustes_disparity_ci95"
    for run in ("a", "b"):
        (tmp_path / run).mkdir()
        (tmp_path / run / "table.csv").write_text(f"{header}\n{name},1,2.0,,0.5,,2,2,\n")
        columns = "case,seed,series,condition,point,kind,status,reason,rmse_R"
        case = f"0-a,0,{name},{name},,tower,done,,2"
        (tmp_path / run / "summary.csv").write_text(f"{columns}\n{case}\n")

    rows = read_frame(tmp_path / "a" / "table.csv", ["condition"], ["cases"], numbers_after="cases")
    lines = console_text(headline_table(rows)).splitlines()
    compare([tmp_path / "a", tmp_path / "b"], tmp_path / "both")

    assert lines[-1].split() == [name, "1", "2", "0.500"]
    assert f"a,{name},1," in (tmp_path / "both" / "comparison.csv").read_text()


def _records(scenario, scores):
    """List the cases of a scenario as finished with scores by number of robots, and settings."""
    cases = study.plan(scenario).cases
    done = [
        replace(failure(case, ""), status="done", scores=scores[case.settings.robots, case.seed])
        for case in cases
    ]
    return done, [case.settings for case in cases]


def test_a_structure_that_ended_early_stays_at_its_point_of_the_sweep():
    """Its number of robots is a score beside the number that the sweep asked for."""
    path = REPOSITORY / "scenarios" / "bridge.yaml"
    changes = ["sweep={robots: [40, 60]}", "seeds=2", "conditions={baseline: {}}"]
    scores = {
        (robots, seed): {"joined": min(robots, 50 + seed), "rmse_R": float(seed), "converged": True}
        for robots in (40, 60)
        for seed in (0, 1)
    }
    records, settings = _records(load_scenario(path, changes), scores)

    summary, table = tables.summary(records, settings), tables.table(records, settings)

    assert summary["robots"].tolist() == [40, 40, 60, 60]
    assert summary["joined"].tolist() == [40, 40, 50, 51]
    assert table["robots"].tolist() == ["40", "60"]
    assert table["joined_least"].tolist() == [40.0, 50.0]
    assert table["joined_most"].tolist() == [40.0, 51.0]
    assert table[["rmse_R_least", "rmse_R_most"]].to_numpy().tolist() == [[0.0, 1.0]] * 2
    assert table["located_least"].isna().all()  # a score that no case has


def test_swept_values_are_written_as_in_a_scenario(tmp_path):
    """Python's dict, True and None are no words; a run without a scenario has labels, too."""
    path = REPOSITORY / "scenarios" / "tower.yaml"
    swept = {
        "structure": [{"kind": "tower"}, {"kind": "chain"}],
        "sensing.heights": [True, False],
        "sensing.spawn_noise": [None, 0.5],
    }
    scores = {"rmse_R": 1.0, "procrustes_disparity": 0.1}
    changes = ["robots=6", "seeds=1", f"sweep={json.dumps(swept)}"]
    records, settings = _records(load_scenario(path, changes), {(6, 0): scores})
    table = tables.table(records, settings)
    write_frame(table, tmp_path / "table.csv")
    write_frame(tables.summary(records, settings), tmp_path / "summary.csv")

    run = load_run(tmp_path)
    words = run.table("table.csv", ["condition"], ["cases"], after="cases")
    cells = " ".join(headline_table(words).frame.to_numpy().ravel())

    assert words["structure"].unique().tolist() == ["tower", "chain"]
    assert words["sensing.heights"].unique().tolist() == ["with heights", "without heights"]
    assert words["sensing.spawn_noise"].unique().tolist() == ["no spawn noise", "spawn noise 0.5 R"]
    assert {case.point for case in run.cases} >= {"tower / with heights / no spawn noise"}
    assert not re.search("True|nan|None|'|[{}=]", cells)


def test_every_score_is_a_measure(small_run):
    """A column without a definition has no unit, no mean and no place on the page."""
    records = [json.loads(path.read_text()) for path in small_run.glob("cases/*/case.json")]

    assert records
    assert all(record["scores"].keys() <= MEASURES.keys() for record in records)
