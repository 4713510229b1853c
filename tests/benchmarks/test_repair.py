"""The table of repair counts places that robots left, and the guide has its columns."""

from types import SimpleNamespace

import numpy as np

from benchmarks.repair import PAGE, measure, taken, write_rule


def test_a_place_counts_once_for_the_first_robot_near_it():
    """Robot 1 leaves after the third join; of those that come later, the fourth is too far."""
    x = np.array([0.0, 5.0, 10.0, 7.5, 6.5, 5.5])
    structure = SimpleNamespace(
        position=np.column_stack([x, 0 * x, 0 * x]), robot_count=6, flips=np.arange(6),
        departures=np.array([[1, 3, 0]]),
    )  # fmt: skip

    assert taken(structure) == (1, 4)


def test_rows_have_the_columns_of_the_guide(tmp_path):
    """A row of few structures has means without intervals."""
    rule = {"name": "repair"}

    row = measure("tower", 0.2, rule, file=write_rule(tmp_path), robots=8, seeds=2, patience=3)

    assert f"| {' | '.join(row)} |" in PAGE.read_text()
    assert row["rule"] == "`repair`"
    assert "±" not in row["size [R]"]
