"""Facts of the paper's structures, and verdicts on its sentences, follow from tables of a run."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmarks import paper_facts, paper_sentences, results
from benchmarks.result_texts import Results
from benchmarks.statements import STATEMENTS
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.base.robot import FIREANT_RHO, RobotGeometry
from tiswarm.scenario.expansion import load_scenario

ROBOTS = pd.DataFrame(
    {
        "robot": range(13),
        "z_R": [1.0, *[2.0] * 6, *[5.0] * 4, *[9.0] * 2],
        "error_R": [0.0, *[1.0] * 10, 4.0, 6.0],
        "hops_from_anchor": [0, 2, 2, 1, *[3] * 9],
    }
)


@pytest.mark.parametrize(
    ("fact", "value"),
    [
        ("early_error_R", 1.0),
        ("late_error_R", 11.0 / 3.0),  # 1 R, 4 R and 6 R
        ("narrows", 1.0),
    ],
)
def test_the_first_ten_robots_are_early_and_the_anchor_counts_in_no_part(fact, value):
    """The paper counts from 1, so the tenth has join index 9."""
    assert paper_facts.OF_ROBOTS[fact].compute(ROBOTS) == pytest.approx(value)


@pytest.mark.parametrize(
    ("true_R", "estimated_R", "pairs"),
    [(8.0, 0.0, 2), (8.0, 1.0, 0), (np.sqrt(4.0 - 0.75 * FIREANT_RHO**2), 0.0, 0)],
)
def test_docks_collapse_if_they_overlap_by_the_estimate_alone(true_R, estimated_R, pairs):  # noqa: N803
    """A dock faces two of another robot: they overlap by .7 R, by .4 R, or touch in truth."""
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    true, estimated = (
        np.array([[0.0, 0.0, 0.0], [1.5 * FIREANT_RHO + gap, 0.0, 0.0]])
        for gap in (true_R, estimated_R)
    )

    collapsed = paper_facts.collapsed_docks(true, estimated, turns, RobotGeometry())

    assert collapsed == pairs / 2


@pytest.mark.parametrize(
    ("rmse", "step"),
    [([9.0, 3.0, 2.1, 2.0], 10), ([2.0, 2.0, 2.0, 2.0], 0), ([9.0, 2.0, 3.0, 2.0], 15)],
)
def test_an_estimate_settles_where_it_stays_within_a_tenth_of_its_last_error(rmse, step):
    """A passage through that band does not count."""
    convergence = pd.DataFrame({"iteration": [0, 5, 10, 15], "rmse_R": rmse})

    assert paper_facts.settled_step(convergence) == step


@pytest.mark.parametrize(
    ("holds", "verdict"),
    [([1, 1, 1], "holds"), ([0, 0, 0], "does not hold"), ([1, 0, 1], "depends")],
)
def test_a_sentence_depends_if_sets_disagree(holds, verdict):
    """One set of three carries no sentence of the text."""
    assert paper_sentences.verdict(holds) == verdict


def test_a_run_of_the_scenario_has_every_number_of_the_table(tmp_path):
    """A fresh run rewrites the table: no number of it is typed."""
    scenario = load_scenario(
        REPOSITORY / "scenarios" / "paper.yaml",
        [
            "robots=12",
            "seeds=3",
            "sweep={structure: [{kind: tower}, {kind: cantilever, founders: 2, anchor: 5.0}]}",
        ],
    )
    run = study.run(scenario, tmp_path, progress=Progress()).folder
    rows = results.rows_of(run, "this")
    points = {
        "tower": "structure={kind: tower}",
        "cantilever": "structure={kind: cantilever, founders: 2, anchor: 5.0}",
    }

    sets = {"one": paper_sentences.Facts(Results(rows), points, "this")}
    text = paper_sentences.sentence_table(sets)

    assert text.count("\n") == len(paper_sentences.SENTENCES) + 1
    assert "nan" not in text


def test_a_verdict_by_the_own_axis_stands_where_the_start_without_z_matters():
    """Means of towers without Z are 3 R if robots start upward, and 2 R along their own axis."""
    rows = [
        {"condition": condition, "measure": measure, "value": value}
        for condition, rmse in (("all-cues", 2.0), ("no-z", 3.0), ("own-axis-no-z", 2.0))
        for measure, value in (("rmse_R", rmse), ("rmse_R_p_all", 0.01))
    ]
    shared = {"scenario": "paper", "point": "tower", "kind": "this", "structures": 25}
    results_of_rows = Results(pd.DataFrame(rows).assign(**shared, low=0.0, high=0.0))
    facts = paper_sentences.Facts(results_of_rows, {"tower": "tower"}, "this")
    (sentence,) = (s for s in paper_sentences.SENTENCES if s.says.startswith("towers, no Z: RMSE"))

    upward, own_axis = (
        sentence.judge(replace(facts, own_axis=own_axis)).holds for own_axis in (False, True)
    )

    assert upward
    assert not own_axis


def test_counts_follow_from_the_table_of_sentences():
    """A verdict by the own axis is that of the upward start where the cell is empty."""
    results_of_file = Results(results.read_results())
    header, _, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in STATEMENTS["paper-sentences"](results_of_file).splitlines()
    ]
    upward = [row[header.index("here")] for row in rows]
    own_axis = [row[header.index("own axis")] or row[header.index("here")] for row in rows]

    last = STATEMENTS["paper-counts"](results_of_file).splitlines()[-1]

    names = ("holds", "depends", "does not hold")
    counts = [str(verdicts.count(name)) for verdicts in (upward, own_axis) for name in names]
    assert last == f"| sentences | {' | '.join(counts)} |"
