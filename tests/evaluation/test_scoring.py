"""Two tables are scored robot by robot, in one unit, or not at all."""

import numpy as np
import pytest

from tiswarm.errors import InputError
from tiswarm.evaluation.scoring import score_files
from tiswarm.records.positions import write_positions

SHAPE = np.random.default_rng(1).normal(size=(6, 3)) * [1.0, 2.0, 6.0]


def test_robots_are_matched_by_name(tmp_path):
    """Rows may come in any order; a turn about the vertical is told from a wrong shape."""
    order = np.array([3, 1, 4, 0, 5, 2])
    turned = SHAPE @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    write_positions(tmp_path / "truth.csv", np.arange(6), SHAPE, length_unit="mm")
    write_positions(tmp_path / "estimate.csv", order, turned[order], length_unit="mm")

    unit, scores = score_files(tmp_path / "truth.csv", tmp_path / "estimate.csv")

    assert unit == "mm"
    assert scores["RMSE"] > 1.0
    assert scores["RMSE, yaw and place aligned"] == pytest.approx(0.0, abs=1e-9)
    assert scores["Procrustes disparity"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("robots", "unit", "problem"),
    [([0, 1], "R", "robot 2 is in one of the two tables only"), ([0, 1, 2], "cm", "rename them")],
)
def test_what_does_not_match_is_refused(tmp_path, robots, unit, problem):
    """Neither missing robots nor another unit pass for errors."""
    write_positions(tmp_path / "truth.csv", np.arange(3), SHAPE[:3])
    path = tmp_path / "estimate.csv"
    write_positions(path, np.array(robots), SHAPE[: len(robots)], length_unit=unit)

    with pytest.raises(InputError, match=problem):
        score_files(tmp_path / "truth.csv", path)


def test_a_table_without_a_unit_is_refused(tmp_path):
    """The message shows what the columns should be."""
    (tmp_path / "truth.csv").write_text("robot,x,y,z\n0,0,0,0\n")

    with pytest.raises(InputError, match="write them like robot,x_R,y_R,z_R"):
        score_files(tmp_path / "truth.csv", tmp_path / "truth.csv")
