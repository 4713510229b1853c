"""Error profiles group robots by variables, and pairs of robots by hops."""

import numpy as np
import pandas as pd
import pytest

from tests.structures import exact_estimate
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation.metrics import (
    BINS,
    by_hops_apart,
    error_profile,
    relative_errors,
    relative_profile,
)
from tiswarm.evaluation.tables import by_robot, score
from tiswarm.measurements.contacts import hops
from tiswarm.measurements.cues import measure
from tiswarm.records.positions import Truth
from tiswarm.sensing import SensingParams, observe

RNG = np.random.default_rng(3)


def _scored(history, off):
    """Truth, log, and an estimate that is off by so much."""
    log = observe(history, SensingParams())
    truth = Truth(
        robot_id=log.robot_id,
        position=history.position,
        orientation_wxyz=history.orientation_wxyz,
    )
    estimate = exact_estimate(log, history.position + off)
    return truth, log, estimate


def _hops_slowly(log, start):
    """Spread from robot to robot, one contact at a time."""
    apart = {start: 0}
    edge = [start]
    while edge:
        touching = {(i, j) for i, _, j, _ in log.contacts.tolist()}
        near = {b for pair in touching for a, b in (pair, pair[::-1]) if a in edge}
        edge = sorted(near - set(apart))
        apart |= dict.fromkeys(edge, max(apart.values()) + 1)
    return [apart.get(robot, np.inf) for robot in range(log.robot_count)]


def test_hops_are_counted_along_contacts(towers):
    """As by spreading from each robot in turn."""
    log = observe(towers[0], SensingParams())

    apart = hops(log, np.arange(log.robot_count))

    for robot in (0, 7, 29):
        np.testing.assert_array_equal(apart[robot], _hops_slowly(log, robot))


def test_relative_errors_do_not_see_a_shift(towers):
    """What moves all robots alike moves none as another sees it; a stretch grows with hops."""
    shifted = by_hops_apart(*_scored(towers[0], np.array([3.0, 1.0, -2.0])))
    stretched = by_hops_apart(*_scored(towers[0], 0.1 * towers[0].position))

    np.testing.assert_allclose(shifted["rmse_R"], 0.0, atol=1e-12)
    assert stretched["rmse_R"].is_monotonic_increasing
    assert stretched["hops_apart"].tolist()[:3] == [1, 2, 4]


def test_one_hop_is_one_pair_that_touches(towers):
    """Means over pairs are those over contacts, counted once a pair and way."""
    truth, log, estimate = _scored(towers[0], RNG.normal(size=(30, 3)))
    pairs = np.unique(log.contacts[:, [0, 2]], axis=0)

    table = by_hops_apart(truth, log, estimate)

    error = relative_errors(estimate.position, truth.position, pairs)
    assert table["pairs"][0] == 2 * len(pairs)
    assert table["rmse_R"][0] == pytest.approx(np.sqrt(np.mean(error**2)))


def test_every_robot_is_in_one_range_of_each_profile(towers):
    """Ranges lie apart, and their errors add up to the error of all."""
    truth, log, estimate = _scored(towers[0], RNG.normal(size=(30, 3)))
    robots = by_robot(truth, log, estimate, towers[0]).assign(join=np.arange(30))

    for _, part in error_profile(robots).groupby("by"):
        assert part["count"].sum() == 30
        assert len(part) <= BINS
        assert (part["low"].to_numpy()[1:] >= part["high"].to_numpy()[:-1] - 1e-9).all()
        total = (part["count"] * part["rmse_R"] ** 2).sum()
        assert total == pytest.approx((robots["error_R"] ** 2).sum())


def test_relative_profiles_weigh_structures_by_their_pairs():
    """Three pairs of error 2 and one of 6."""
    table = pd.DataFrame(
        {"hops_apart": [1, 1], "pairs": [3, 1], "mean_error_R": [2.0, 6.0], "rmse_R": [2.0, 6.0]}
    )

    row = relative_profile(table).iloc[0]

    assert (row["count"], row["mean_error_R"]) == (4, 3.0)
    assert row["rmse_R"] == pytest.approx(np.sqrt((3 * 4 + 36) / 4))


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_tiny_structures_are_scored(towers, robots):
    """One robot has no contacts to average; all else is a number, and nothing warns."""
    history = towers[0]
    small = type(history)(
        **{
            **vars(history),
            "walks": history.walks[:robots],
            "loads": history.loads[:robots],
            "sensed": history.sensed[:robots],
        }
    )
    truth, log, estimate = _scored(small, np.full(3, 0.5))

    scores = score(truth, log, estimate, RobotGeometry(), rows=measure(log, ("contacts", "height")))
    table = by_robot(truth, log, estimate, small).assign(join=np.arange(robots))

    unknown = {name for name, value in scores.items() if np.isnan(value)}
    alone = {
        "contacts_per_robot", "rmse_per_contact_R", "procrustes_disparity", "within_dock",
        "contacts_within_dock", "located", "rmse_located_R",
    }  # fmt: skip
    assert unknown == (alone if robots == 1 else set())
    assert scores["rmse_rigid_aligned_R"] == pytest.approx(0.0, abs=1e-9)
    assert error_profile(table).groupby("by")["count"].sum().eq(robots).all()


def test_ranges_are_equally_wide_and_hold_the_largest_value():
    """Eleven joins from 10 on are pairs and one left over; a height ends where the next starts."""
    robots = pd.DataFrame({"join": np.arange(10, 21), "z_R": np.arange(11.0), "error_R": 1.0})

    profile = error_profile(robots.assign(hops_from_anchor=1, contacts=1)).groupby("by")

    joins, heights = profile.get_group("join"), profile.get_group("height_R")
    assert joins["low"].tolist() == [10, 12, 14, 16, 18, 20]
    assert joins["high"].tolist() == [11, 13, 15, 17, 19, 20]
    assert heights["low"].tolist() == [*range(BINS)]
    assert heights["count"].tolist() == [1] * (BINS - 1) + [2]
