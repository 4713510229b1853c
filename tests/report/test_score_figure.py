"""A score is drawn as the numbers that it is: errors in join order, truth and estimate."""

import numpy as np
import pytest

from tiswarm import api
from tiswarm.base.errors import InputError
from tiswarm.records.positions import write_positions
from tiswarm.report.pictures.swarm_figures import draw_score


@pytest.fixture
def tables(tmp_path):
    """Tables of a truth, sorted by name, and of an estimate in another order, in mm."""
    rng = np.random.default_rng(0)
    names, true = np.arange(40), rng.normal(size=(40, 3))
    order = rng.permutation(40)
    off = np.linspace(0.0, 1.0, 40)[:, None] * [0.0, 0.0, 1.0]
    truth, estimate = tmp_path / "truth.csv", tmp_path / "estimate.csv"
    write_positions(truth, names, true, length_unit="mm")
    write_positions(estimate, names[order], true[order] + off, length_unit="mm")
    return truth, estimate


def test_errors_are_drawn_in_join_order(tables):
    """The estimate's table has that order; its errors grow from robot to robot."""
    scores = api.score(*tables)

    errors, side, above = draw_score(scores.true, scores.estimated, scores.errors, scores.unit).axes

    np.testing.assert_allclose(errors.lines[0].get_ydata(), np.linspace(0.0, 1.0, 40), atol=1e-12)
    assert f"RMSE {scores['RMSE']:.3g} mm" in errors.get_legend().get_texts()[0].get_text()
    for axes, (across, upward) in ((side, (0, 2)), (above, (0, 1))):
        for line, position in zip(axes.lines[1:], (scores.true, scores.estimated), strict=True):
            np.testing.assert_array_equal(line.get_xdata(), position[:, across])
            np.testing.assert_array_equal(line.get_ydata(), position[:, upward])
        assert "[mm]" in axes.get_xlabel()


def test_a_score_has_a_figure_beside_the_estimate(tables, tiswarm):
    """Its name is that of the estimate; --out chooses another one, as pixels or vectors."""
    truth, estimate = tables
    default = estimate.with_name("estimate-score.png")

    done = tiswarm("score", truth, estimate)
    chosen = tiswarm("score", truth, estimate, "--out", estimate.with_name("mine.pdf"), "--quiet")

    assert done.returncode == 0, done.stderr
    assert done.stdout == chosen.stdout == f"{api.score(truth, estimate)}\n"
    assert str(default) in done.stderr
    assert chosen.stderr == ""
    assert default.read_bytes().startswith(b"\x89PNG")
    assert estimate.with_name("mine.pdf").read_bytes().startswith(b"%PDF")


def test_a_figure_of_another_format_is_refused(tables):
    """Nothing is written."""
    with pytest.raises(InputError, match=r"out: 'score.jpg' should end in .png or .pdf; rename it"):
        api.score(*tables, out=tables[0].with_name("score.jpg"))

    assert len(list(tables[0].parent.iterdir())) == 2
