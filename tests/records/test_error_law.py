"""P(error < x) follows from sd by one law, and is stated only where a method knows its error."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.runs import REPOSITORY
from tests.structures import Rule, exact_estimate, structure
from tiswarm.base.errors import InputError
from tiswarm.records.error_law import ERRORS, SURE, ErrorLaw, sure_ratio
from tiswarm.records.positions import read_estimate, write_estimate

RECORD = json.loads((REPOSITORY / "docs" / "fits" / "errors.json").read_text())


@pytest.fixture(scope="module")
def log():
    """A log of five robots; R is half a unit."""
    sensed, _ = structure(Rule(kind="tree"), 5, 1)
    return sensed


def _estimate(log, **fields):
    return exact_estimate(log, np.zeros((5, 3)), **fields)


def test_the_law_is_that_of_a_fit_to_training_logs():
    """The record has the constants, and no log that results are reported on."""
    assert RECORD["chosen"] == {
        name: getattr(ERRORS, name) for name in ("width", "dimensions", "tail_share", "tail_width")
    }
    assert RECORD["training_numbers"][0] >= 100_000
    assert RECORD["loss_of_chosen"] < RECORD["loss"] + 0.01


def test_the_law_is_a_mixture_of_a_normal_core_and_a_student_tail():
    """Drawn errors have its distribution: the largest difference is that of chance.

    Of 100,000 draws it exceeds 0.0061 once in a thousand (Kolmogorov).
    """
    rng = np.random.default_rng(0)
    law = ErrorLaw(width=0.8, dimensions=3.0, tail_share=0.2, tail_width=2.0)
    core = 0.8 * np.linalg.norm(rng.normal(size=(80_000, 3)), axis=1) / np.sqrt(3.0)
    tail = 2.0 * np.sqrt(stats.f.rvs(3, 1, size=20_000, random_state=rng))

    drawn = np.sort(np.concatenate([core, tail]))

    away = np.abs(law.probability(drawn) - (np.arange(100_000) + 0.5) / 100_000)
    assert away.max() < 0.0061


@given(ratio=st.floats(0.0, 1e9), more=st.floats(1.001, 10.0), share=st.floats(0.01, 0.999))
def test_a_greater_distance_is_no_less_probable(ratio, more, share):
    """A ratio of a probability has that probability."""
    near, far = ERRORS.probability(np.array([ratio, more * ratio]))

    assert 0.0 <= near <= far <= 1.0
    assert ERRORS.probability(np.array(ERRORS.ratio(share))) == pytest.approx(share, abs=1e-9)


def test_probabilities_follow_sd_and_are_not_stated_of_guesses(log):
    """The anchor is where it is; nothing is known of robots that nothing ties, or without sd."""
    sd = np.array([0.0, 1.0 / sure_ratio(), 100.0, 0.1, np.nan])
    estimate = _estimate(log, sd=sd, disconnected=np.arange(5) == 3)

    probability = estimate.within(1.0)

    assert probability[:2] == pytest.approx([1.0, SURE])
    assert probability[2] < 0.05
    assert np.isnan(probability[3:]).all()


def test_robots_that_were_not_located_are_guesses(log):
    """Methods that place robots one by one say which."""
    undetermined = np.zeros((5, 3), bool)
    undetermined[2, 0] = True
    estimate = _estimate(log, sd=np.full(5, 0.1), undetermined=undetermined)

    assert np.isnan(estimate.within(1.0)).tolist() == [False, False, True, False, False]


def test_a_method_without_sd_states_no_error(log, tmp_path):
    """Its column is empty, so that no script takes a robot of it for sure."""
    estimate = _estimate(log)
    path = tmp_path / "estimate.csv"

    write_estimate(path, estimate)

    assert estimate.within(1.0) is None
    assert path.read_text().splitlines()[0] == "robot,x_R,y_R,z_R,within_1R"
    assert path.read_text().splitlines()[1].endswith(",")
    assert read_estimate(log, path).within(1.0) is None


@pytest.mark.parametrize("distance", [0.0, -1.0, np.inf, np.nan])
def test_a_distance_is_a_positive_number(log, distance):
    """Nobody is within less than nothing."""
    with pytest.raises(InputError, match="should be above 0; give a length"):
        _estimate(log, sd=np.ones(5)).within(distance)


def test_tables_have_the_probability_of_r_and_of_a_distance_of_the_user(log, tmp_path):
    """R is that of the dock in any unit; a table read again states the same."""
    path = tmp_path / "estimate.csv"
    of_mm = replace(log, dock_radius=20.0, length_unit="mm")
    estimate = _estimate(
        of_mm, sd=np.linspace(0.0, 40.0, 5), length_unit="mm", dock_radius=20.0, tolerance=5.0
    )

    columns = estimate.columns()
    write_estimate(path, estimate)

    assert [*columns][:7] == ["robot", "x_mm", "y_mm", "z_mm", "sd_mm", "within_1R", "within_5mm"]
    assert columns["within_1R"] == estimate.within(20.0).round(4).tolist()
    assert columns["within_5mm"] == estimate.within(5.0).round(4).tolist()
    again = read_estimate(of_mm, path)
    assert again.within(20.0).tolist() == estimate.within(20.0).tolist()


@pytest.mark.parametrize(
    ("sd", "fields", "statement"),
    [
        (None, {}, "the method states no error of the positions of 5 robots"),
        (
            0.1,
            {},
            "all 5 robots are within 1 R of where they are shown (95 %); expected RMSE 0.1 R",
        ),
        (
            0.1,
            {"length_unit": "mm", "dock_radius": 30.0},
            (
                "all 5 robots are within 30 mm (1 R) of where they are shown (95 %); expected RMSE "
                "0.1 mm"
            ),
        ),
        (
            0.1,
            {"length_unit": "mm", "dock_radius": 30.0, "tolerance": 2.5},
            (
                "all 5 robots are within 2.5 mm of where they are shown (95 %); expected RMSE "
                "0.1 mm"
            ),
        ),
        (
            0.1,
            {"free_frame": ("rotation",)},
            (
                "all 5 robots are within 1 R of where they are shown, up to a motion of all, (95 "
                "%); expected RMSE 0.1 R"
            ),
        ),
        (
            1.0,
            {},
            (
                "none of 5 robots is known to be within 1 R of where it is shown (95 %); 5 may be "
                "anywhere within 2.2 R; expected RMSE 1 R"
            ),
        ),
        (
            [0.0, 0.1, 0.1, 1.0, 100.0],
            {},
            (
                "3 of 5 robots are within 1 R of where they are shown (95 %); 2 may be anywhere "
                "within 220 R; expected RMSE 45 R"
            ),
        ),
        (
            [0.0, 2.0, 0.1, 0.1, 0.1],
            {"disconnected": np.arange(5) // 2 == 1, "gone": np.arange(5) == 4},
            (
                "1 of 4 robots is within 1 R of where it is shown (95 %); 1 may be anywhere within "
                "4.3 R; the positions of 2 are guesses; expected RMSE 1.4 R"
            ),
        ),
    ],
)  # fmt: skip
def test_a_sentence_says_how_many_robots_are_near_where_they_are_shown(log, sd, fields, statement):
    """It has the distance of the user, and how far off the others may be."""
    stated = None if sd is None else np.broadcast_to(np.asarray(sd, float), 5)

    estimate = _estimate(log, sd=stated, **fields)

    assert estimate.statement == statement
    assert repr(estimate) == f"Estimate({statement})"
