"""Facts of the paper's structures, and verdicts on its sentences, follow from tables of a run."""

import numpy as np
import pandas as pd
import pytest

from benchmarks import paper_facts, paper_sentences, results
from benchmarks.result_texts import Results
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
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
        ("late_error_R", 5.0),
        ("before_anchor_error_R", 1.0),
        ("from_anchor_error_R", 1.8),  # eight of 1 R, one of 4 R, one of 6 R
        ("narrows", 1.0),
    ],
)
def test_robots_are_split_by_join_index_and_by_the_first_one_on_the_anchor(fact, value):
    """The anchor counts in no part; robots 1 to 10 are early, robot 3 is the first on it."""
    assert paper_facts.OF_ROBOTS[fact].compute(ROBOTS) == pytest.approx(value)


def test_without_a_robot_on_the_anchor_there_is_no_error_before_it():
    """Such a structure has no part in the mean."""
    far = ROBOTS.assign(hops_from_anchor=[0, *[2] * 12])

    assert np.isnan(paper_facts.OF_ROBOTS["before_anchor_error_R"].compute(far))


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
    [([1, 1, 1], "holds"), ([0, 0, 0], "**does not hold**"), ([1, 0, 1], "depends")],
)
def test_a_sentence_depends_if_sets_disagree(holds, verdict):
    """One set of three carries no sentence of the text."""
    findings = [paper_sentences.Finding("", bool(one)) for one in holds]

    assert paper_sentences.verdict(findings) == verdict


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

    text = paper_sentences.sentence_table(
        {"one": paper_sentences.Facts(Results(rows), points, "this")}
    )

    assert text.count("\n") == len(paper_sentences.SENTENCES) + 1
    assert "nan" not in text
