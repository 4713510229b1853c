"""Errors and shapes are measured as Eqs. (4) to (7) say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.strategies import rotations, vectors
from tiswarm.evaluation import metrics
from tiswarm.records.intervals import mean_share_ci95, mean_std_ci95, share_ci95
from tiswarm.records.measures import FEWEST

SHAPE = np.random.default_rng(1).normal(size=(40, 3)) * [1.0, 2.0, 6.0]


def test_sums_are_those_of_the_equations():
    """SSE and RMSE on numbers small enough to do by hand."""
    truth = np.zeros((2, 3))
    estimate = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])

    assert metrics.sse(estimate, truth) == 25.0
    assert metrics.rmse(estimate, truth) == pytest.approx(np.sqrt(12.5))
    np.testing.assert_array_equal(metrics.robot_errors(estimate, truth), [5.0, 0.0])


@given(turn=rotations, shift=vectors)
def test_disparity_ignores_where_the_shape_is_and_how_it_is_turned(turn, shift):
    """A rotated and shifted copy is congruent."""
    copy = Rotation.from_quat(turn, scalar_first=True).apply(SHAPE) + shift

    assert metrics.procrustes_disparity(copy, SHAPE) < 1e-12


def test_a_mirror_image_is_not_congruent():
    """No reflection is allowed, unlike in scipy.spatial.procrustes."""
    assert metrics.procrustes_disparity(SHAPE * [-1, 1, 1], SHAPE) > 0.05


@pytest.mark.parametrize("scale", [0.5, 2.0, 3.0])
def test_a_scaled_copy_is_not_congruent(scale):
    """No scaling is allowed: a copy scaled by s scores (s - 1)^2, beyond 1 if need be."""
    assert metrics.procrustes_disparity(scale * SHAPE, SHAPE) == pytest.approx((scale - 1) ** 2)


def test_disparity_is_the_least_over_rotations():
    """No rotation near the one found fits better."""
    rng = np.random.default_rng(2)
    estimate = SHAPE + rng.normal(size=SHAPE.shape)
    aligned = metrics.rigidly_aligned(estimate, SHAPE)
    best = metrics.sse(aligned, SHAPE)

    center = aligned.mean(axis=0)
    for _ in range(50):
        nudge = Rotation.from_rotvec(rng.normal(size=3) * 0.05)
        assert metrics.sse(nudge.apply(aligned - center) + center, SHAPE) >= best


@given(yaw=st.floats(-3.1, 3.1), shift=vectors)
def test_gravity_leaves_yaw_and_place_open(yaw, shift):
    """Turned about the vertical, a copy fits again; tilted, it does so only rigidly."""
    tilted = Rotation.from_euler("x", 0.3).apply(SHAPE)

    turned = Rotation.from_euler("z", yaw).apply(SHAPE) + shift
    assert metrics.rmse(metrics.yaw_aligned(turned, SHAPE), SHAPE) < 1e-9
    assert metrics.rmse(metrics.yaw_aligned(tilted, SHAPE), SHAPE) > 0.5
    assert metrics.rmse(metrics.rigidly_aligned(tilted, SHAPE), SHAPE) < 1e-9


@given(seed=st.integers(0, 10_000), robots=st.integers(1, 4), rank=st.integers(0, 3))
def test_more_freedom_never_fits_worse(seed, robots, rank):
    """Few robots, on a line, in a plane or in one place: numbers, and in the right order."""
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=(robots, rank)) @ rng.normal(size=(rank, 3)) + 1.0
    estimate = rng.normal(size=(robots, 3)) * rng.integers(0, 2)

    free = metrics.rmse(estimate, truth)
    yaw = metrics.rmse(metrics.yaw_aligned(estimate, truth), truth)
    rigid = metrics.rmse(metrics.rigidly_aligned(estimate, truth), truth)

    assert 0.0 <= rigid <= yaw + 1e-9
    assert yaw <= free + 1e-9


def test_straight_and_flat_shapes_are_handled():
    """Points on a line or a plane align without a warning."""
    line = np.outer(np.arange(5.0), [0.0, 0.0, 1.0])

    assert metrics.procrustes_disparity(line + 3.0, line) < 1e-12
    assert metrics.procrustes_disparity(SHAPE * [1, 1, 0], SHAPE * [1, 1, 0]) < 1e-12


def test_a_shape_without_extent_has_no_disparity():
    """Robots that are all in one place have no shape to compare: the disparity is NaN."""
    assert np.isnan(metrics.procrustes_disparity(np.ones((3, 3)), np.zeros((3, 3))))


def test_intervals_hold_the_mean_as_often_as_they_say():
    """Of 2,000 samples of five normal numbers, 95 % within four standard errors."""
    samples = np.random.default_rng(0).normal(size=(2000, 5))

    held = np.mean([abs(s["mean"]) <= s["ci95"] for s in map(mean_std_ci95, samples)])

    assert held == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 2000))


def test_an_interval_of_a_share_ends_at_one():
    """Of zeros and ones it is Wilson's: 1.96 standard errors of its ends, not of the mean."""
    values = np.array([1.0] * 63 + [0.0])

    low, high = share_ci95(values).values()

    assert 0.0 < low < 63 / 64 < high < 1.0
    for end in (low, high):  # the ends solve the equation that Wilson's interval states
        assert abs(63 / 64 - end) == pytest.approx(1.959964 * np.sqrt(end * (1 - end) / 64))
    assert share_ci95(np.ones(64))["ci95_high"] == 1.0
    assert share_ci95(np.zeros(3))["ci95_low"] == 0.0
    assert np.isnan(share_ci95(np.array([np.nan]))["ci95_low"])


def test_a_mean_of_shares_of_robots_has_the_interval_of_a_mean():
    """Of eight structures whose robots are all located, Wilson's went from 68 % to 100 %."""
    shares = np.array([0.9, 0.95, 0.97, 0.99, 1.0, 1.0])

    low, high = mean_share_ci95(shares).values()

    student = mean_std_ci95(shares)
    assert low == student["mean"] - student["ci95"]
    assert high == 1.0 < student["mean"] + student["ci95"]
    assert [*mean_share_ci95(np.ones(8)).values()] == [1.0, 1.0]
    assert np.isnan([*mean_share_ci95(shares[: FEWEST - 1]).values()]).all()


def test_intervals_of_powers_hold_the_true_one():
    """Of 1,000 fits to 4 sizes of 5 structures with noise, 95 % within four standard errors."""
    rng = np.random.default_rng(2)
    sizes = np.repeat([10.0, 30.0, 100.0, 300.0], 5)
    noise = np.exp(0.3 * rng.normal(size=(1000, len(sizes))))

    fits = [metrics.power_law(sizes, 5.0 * sizes**-0.8 * factor) for factor in noise]

    held = np.mean([abs(p + 0.8) <= half for p, half in fits])
    assert held == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 1000))
    assert np.isnan(metrics.power_law(sizes[:10], sizes[:10])).all()  # two sizes fit exactly


def test_paired_differences_see_through_what_structures_share():
    """A small gain on very different structures is certain, and missing ones are left out."""
    rng = np.random.default_rng(3)
    structure = 100.0 * rng.normal(size=21)
    gain = 1.0 + 0.1 * rng.normal(size=21)
    second = structure - gain
    second[20] = np.nan

    difference = metrics.paired_difference(structure, second)

    assert (difference["structures"], difference["smaller"]) == (20, 20)
    assert difference["difference_mean"] == pytest.approx(-gain[:20].mean())
    assert difference["difference_ci95"] < 0.1
    assert difference["wilcoxon_p"] == pytest.approx(2.0 / 2**20)


def test_structures_that_agree_leave_the_others_to_be_compared():
    """A pair without a difference says nothing; Wilcoxon's test leaves it out."""
    first = np.arange(FEWEST + 1.0)

    difference = metrics.paired_difference(first, first - 0.1 * first**2)

    assert difference["wilcoxon_p"] == pytest.approx(2.0 / 2**FEWEST)


def test_too_few_structures_have_no_interval():
    """Statistics of none or one structure, and of two that agree, are NaN where undefined."""
    assert np.isnan(mean_std_ci95(np.array([]))["mean"])
    assert np.isnan(mean_std_ci95(np.array([2.0]))["ci95"])
    few, enough = np.arange(FEWEST - 1.0), np.arange(FEWEST + 0.0)
    assert np.isnan(mean_std_ci95(few)["ci95"])
    assert mean_std_ci95(enough)["ci95"] > 0.0
    assert np.isnan(metrics.paired_difference(few, few + 1.0)["wilcoxon_p"])
    assert np.isnan(metrics.paired_difference(np.ones(2), np.ones(2))["wilcoxon_p"])
