"""Robots fail: what they no longer sense, or sense wrongly, and that all others sense as before."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.records.test_sensing_file import content
from tests.structures import grown
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.records.sensing_log import LISTS
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.failures import failing
from tiswarm.world.params import TowerParams

NOISY = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, false_contacts=0.05, spawn_noise=0.1)
WAYS = ("mute", "deaf", "drift", "stuck")

shares = st.fixed_dictionaries({way: st.sampled_from([0.0, 0.1, 0.3, 1.0]) for way in WAYS})


def sensed(history, **share):
    """What robots sense with some noise, where some of them fail."""
    return observe(history, dataclasses.replace(NOISY, **share))


def failed(history, **share):
    """Robots that fail in any of some ways, in order."""
    params = SensingParams(**share)
    return np.flatnonzero(np.any([failing(history, params, way) for way in share], axis=0))


def lines(log):
    """What each robot sensed, by robot: its numbers, its stances, and its rows of each list."""
    found = []
    for j in range(log.robot_count):
        begin, end = log.stances.start[j : j + 2]
        numbers = [log.orientation_wxyz[j], log.flip_height[j], log.spawn_position[j]]
        walked = [log.stances.orientation_wxyz[begin:end], log.stances.pivot_dock[begin:end]]
        lists = {}
        for key in LISTS:
            final, earlier = getattr(log, key), getattr(log.stances, key)
            own = final[:, 2] if key == "contacts" else final[:, 0]
            at = (earlier[:, 0] >= begin) & (earlier[:, 0] < end)
            lists[key] = (final[own == j].tolist(), _since(earlier[at], begin).tolist())
        found.append((*map(np.ndarray.tolist, map(np.asarray, numbers + walked)), lists))
    return found


def _since(rows, begin):
    """Count the stances of rows, stance first, from the first of their robot."""
    return rows - begin * np.eye(1, rows.shape[1], dtype=rows.dtype)


@settings(max_examples=30)
@given(share=shares, seed=st.integers(0, 1000))
def test_robots_that_work_sense_as_before(towers, share, seed):
    """Draws of one robot are its own, so that effects of failures are those of the failed robots.

    Lines are compared as text, where two missing numbers are equal.
    """
    history = dataclasses.replace(towers[0], seed=seed)

    before, after = lines(sensed(history)), lines(sensed(history, **share))

    works = np.setdiff1d(np.arange(history.robot_count), failed(history, **share))
    assert [repr(after[j]) for j in works] == [repr(before[j]) for j in works]


@settings(max_examples=30)
@given(share=shares, robots=st.integers(1, 29))
def test_the_first_robots_sense_the_same_before_others_join(towers, share, robots):
    """Methods that localize robots as they join read the log as far as it goes."""
    history = towers[1]
    part = dataclasses.replace(
        history,
        walks=history.walks[:robots],
        loads=history.loads[:robots],
        sensed=history.sensed[:robots],
    )

    whole, prefix = sensed(history, **share), sensed(part, **share)

    assert repr(lines(prefix)) == repr(lines(whole)[:robots])


@settings(max_examples=20)
@given(share=shares)
def test_logs_of_failing_robots_come_back_from_a_file(towers, scratch, share):
    """The log stays one that every reader takes, with all checks of its format."""
    log = sensed(towers[0], **share)

    write_sensing_log(log, scratch)

    assert content(read_sensing_log(scratch)) == content(log)


@pytest.mark.parametrize("way", WAYS)
def test_a_larger_share_adds_robots(towers, way):
    """A sweep of shares compares the same failures and more of them; the anchor never fails."""
    few, more, all_of_them = (failed(towers[0], **{way: share}) for share in (0.1, 0.3, 1.0))

    assert set(few) < set(more) < set(all_of_them)
    assert all_of_them.tolist() == [*range(1, 30)]


@pytest.mark.parametrize("way", WAYS)
def test_shares_of_failing_robots_are_those_of_the_settings(towers, way):
    """Some 3,000 robots fail by chance: five standard errors of a fifth are 0.037."""
    seeds = [dataclasses.replace(towers[0], seed=seed) for seed in range(100)]

    share = np.mean([len(failed(history, **{way: 0.2})) / 29 for history in seeds])

    assert share == pytest.approx(0.2, abs=0.037)


def test_ways_to_fail_are_drawn_one_by_one(towers):
    """A robot that drifts is no more likely to be mute."""
    chosen = {tuple(failed(towers[0], **{way: 0.3})) for way in WAYS}

    assert len(chosen) == len(WAYS)


def test_a_mute_robot_leaves_an_empty_line(towers):
    """It has neither orientation nor stances; later robots that touch it say so."""
    mute = failed(towers[0], mute=0.3)

    log = sensed(towers[0], mute=0.3)
    before = sensed(towers[0])

    found = lines(log)
    for j in mute:
        *numbers, lists = found[j]
        assert np.isnan(np.hstack(numbers[:3])).all()
        assert numbers[3:] == [[], []]
        assert not any(final or earlier for final, earlier in lists.values())
    later = log.contacts[np.isin(log.contacts[:, 0], mute)]
    kept = before.contacts[
        np.isin(before.contacts[:, 0], mute) & ~np.isin(before.contacts[:, 2], mute)
    ]
    assert len(later)
    np.testing.assert_array_equal(later, kept)


def test_a_deaf_robot_senses_all_but_robots(towers):
    """It walks, stands on the ground and knows its height and orientation."""
    params = dataclasses.replace(NOISY, direction_noise_deg=1.0, connection_noise_deg=1.0)

    before, after = (
        lines(observe(towers[0], dataclasses.replace(params, deaf=share))) for share in (0.0, 0.3)
    )

    for j in failed(towers[0], deaf=0.3):
        assert repr(after[j][:-1]) == repr(before[j][:-1])
        for key, rows in after[j][-1].items():
            expected = before[j][-1][key] if key == "ground_docks" else ([], [])
            assert rows == expected


def test_mute_robots_measure_no_ranges(towers):
    """Others measure ranges to them."""
    params = SensingParams(range_reach=6.0, mute=0.3)
    mute = failed(towers[0], mute=0.3)

    ranges = observe(towers[0], params).ranges

    assert not np.isin(ranges[:, 0], mute).any()
    assert np.isin(ranges[:, 1], mute).any()


def test_drift_turns_as_a_literal_loop_does(towers):
    """Each flip adds the same turn in the world frame, by the angle of the settings."""
    exact = SensingParams()
    turned = dataclasses.replace(exact, drift=0.3, drift_deg=5.0)
    before, after = (lines(observe(towers[2], params)) for params in (exact, turned))

    axes = []
    for j in failed(towers[2], drift=0.3):
        true, found = ([*each[j][3], each[j][0]] for each in (before, after))
        assert found[0] == true[0]
        one = _turn(found[1], true[1])
        assert np.degrees(one.magnitude()) == pytest.approx(5.0)
        total = Rotation.identity()
        for stance in range(1, len(true)):
            total = one * total
            np.testing.assert_allclose(
                (_turn(found[stance], true[stance]) * total.inv()).magnitude(), 0.0, atol=1e-9
            )
        axes.append(one.as_rotvec())
    # Robots have axes of their own.
    assert np.linalg.matrix_rank(axes) == 3


def _turn(sensed_wxyz, true_wxyz):
    turn, true = (Rotation.from_quat(q, scalar_first=True) for q in (sensed_wxyz, true_wxyz))
    return turn * true.inv()


def test_drift_of_planar_robots_stays_in_their_plane():
    """They turn about y: a drift about another axis would lift docks from the plane."""
    history = grown(TowerParams(plane=True), robots=12, seed=3)

    log = observe(history, SensingParams(drift=1.0))

    np.testing.assert_allclose(log.orientation_wxyz[:, [1, 3]], 0.0, atol=1e-12)
    assert (log.orientation_wxyz != observe(history, SensingParams()).orientation_wxyz).any()


def test_a_stuck_sensor_repeats_its_first_value(towers):
    """Noise of that value stays in it: all stances have the same bits."""
    before, after = (lines(sensed(towers[0], stuck=share)) for share in (0.0, 0.3))

    for j in failed(towers[0], stuck=0.3):
        values = [*after[j][3], after[j][0]]
        assert values == [[*before[j][3], before[j][0]][0]] * len(values)


@pytest.mark.parametrize("way", ["drift", "stuck"])
def test_without_a_compass_none_fails(way):
    """A setting without effect is a mistake."""
    senses = {"compass": False, "stances": False, "heights": False}

    with pytest.raises(ValueError, match="drift and stuck are failures of compasses; set both"):
        SensingParams(**senses, **{way: 0.1})
