"""Structures of a closed loop grow once each, in parts, and go on where they were stopped."""

import pandas as pd
import pytest

from benchmarks import closed_loop, results
from tests.runs import REPOSITORY
from tiswarm.scenario.expansion import load_scenario, variants

TRUTH = "structure={kind: tower}, structure.navigate_by=truth"
ESTIMATE = "structure={kind: tower}, structure.navigate_by=estimate"


def small(**changed):
    """Scenario of two conditions, by the truth and by estimates."""
    data = {
        "name": "small",
        "robots": 4,
        "seeds": 20,
        "structure": {"kind": "tower"},
        "sweep": {"structure": [{"kind": "tower"}], "structure.navigate_by": ["truth", "estimate"]},
        "localization": {"method": "online"},
        "conditions": {"a": {}, "b": {"localization.chains": 1}},
    }
    return load_scenario(data | changed)


def test_structures_that_know_the_truth_grow_once_for_all_conditions():
    """They do not depend on the method; those by estimates have a part for each condition."""
    found = closed_loop.tasks(variants(small()), None, [("b", ESTIMATE, seed) for seed in range(9)])

    listed = [(task.variant.condition, task.point, len(task.seeds)) for task in found]
    assert listed == [
        ("a", TRUTH, 20),
        ("a", ESTIMATE, 8),
        ("a", ESTIMATE, 8),
        ("a", ESTIMATE, 4),
        ("b", ESTIMATE, 8),
        ("b", ESTIMATE, 3),
    ]


@pytest.mark.trial
def test_a_folder_has_each_structure_once_and_results_can_be_taken_from_it(tmp_path):
    """A second call of more seeds adds those that are missing."""
    shipped = load_scenario(REPOSITORY / "scenarios" / "belief-errors.yaml", ["robots=4"])
    [wanted, *_] = variants(shipped)

    for count in (2, 3):
        closed_loop.run(tmp_path / "belief-errors-grown", [wanted], range(count), workers=1)

    table = pd.read_csv(tmp_path / "belief-errors-grown" / "summary.csv")
    assert table["seed"].tolist() == [0, 1, 2]
    rows = results.rows_of(tmp_path / "belief-errors-grown")
    assert set(rows["scenario"]) == {"belief-errors"}
    assert rows.set_index("measure").loc["joined", "value"] == table["joined"].mean()
