"""Fixes and ranges: true to the structure up to the stated noise, and only where in sight."""

import dataclasses

import numpy as np
import pytest

from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.sight import find_lookouts, in_sight
from tiswarm.sensing.suites import CEILING, STATIONS, WALL_TAGS

NO_TOUCH = {"contacts": False, "ground_docks": False, "heights": False, "stances": False}


def centers(history, log):
    """Center of each row of final fixes, then of those at earlier stances."""
    rows = [(history.position[i] for i in log.fixes[:, 0].astype(int))]
    earlier = np.concatenate([walk.center[:-1] for walk in history.walks])
    if log.stances is not None:
        rows.append(earlier[i] for i in log.stances.fixes[:, 0].astype(int))
    return np.array([center for part in rows for center in part])


def fixes(log):
    """All fixes without the stance: rows of (direction (3), value, sd, source)."""
    earlier = np.empty((0, 7)) if log.stances is None else log.stances.fixes
    return np.concatenate([log.fixes, earlier])[:, 1:]


@pytest.mark.parametrize("sight_at", ["end", "stances"])
@pytest.mark.parametrize("beacons", [(CEILING,), WALL_TAGS])
def test_robots_in_sight_of_a_beacon_have_two_coordinates(towers, beacons, sight_at):
    """Each has one fix of x and one of y, from however many beacons; others have none."""
    params = SensingParams(beacons=beacons, fix_noise=1e-6, sight_at=sight_at)
    history = towers[0]

    log = observe(history, params)

    lookouts = find_lookouts(history, params)
    seen = np.any([in_sight(history, lookouts.toward(np.array(b))) for b in beacons], axis=0)
    last = np.array([walk.stance_count for walk in history.walks])[lookouts.robot] - 1
    at_end = lookouts.select(seen & (lookouts.stance == last))
    earlier = lookouts.select(seen & (lookouts.stance < last))
    rows = log.stances.start[earlier.robot] + earlier.stance
    np.testing.assert_array_equal(log.fixes[:, 0], np.repeat(at_end.robot, 2))
    np.testing.assert_array_equal(log.stances.fixes[:, 0], np.repeat(rows, 2))
    measured = fixes(log)
    assert {tuple(row) for row in measured[:, :3].tolist()} == {(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)}
    value = (measured[:, :3] * centers(history, log)).sum(axis=1)
    np.testing.assert_allclose(measured[:, 3], value, atol=1e-5)
    assert (len(earlier.robot) > 0) == (sight_at == "stances")


def test_fixes_err_by_their_standard_deviation(towers):
    """Errors are independent draws, whose deviation is that of the settings and of the row."""
    errors = []
    for seed in range(10):
        history = dataclasses.replace(towers[1], seed=seed)
        log = observe(history, SensingParams(beacons=WALL_TAGS, fix_noise=0.3, sight_at="stances"))
        measured = fixes(log)
        errors.append(measured[:, 3] - (measured[:, :3] * centers(history, log)).sum(axis=1))
        assert set(measured[:, 4]) == {0.3}
    error = np.concatenate(errors)

    # Some 10,000 errors: five standard errors of a deviation are 4 %.
    assert len(error) > 5_000
    np.testing.assert_allclose(error.std(), 0.3, rtol=0.05)
    np.testing.assert_allclose(error.mean(), 0.0, atol=5 * 0.3 / np.sqrt(len(error)))
    assert len(np.unique(error)) == len(error)


def test_a_lighthouse_gives_two_planes_that_meet_in_the_beam(towers):
    """Without error both hold the station and the robot, and slant by 30 deg either way."""
    params = SensingParams(beacons=STATIONS[:1], beacon_kind="sweep", fix_noise=1e-6)

    log = observe(towers[0], params)

    measured = fixes(log)
    np.testing.assert_allclose(np.linalg.norm(measured[:, :3], axis=1), 1.0, atol=1e-12)
    at_robot = (measured[:, :3] * centers(towers[0], log)).sum(axis=1)
    np.testing.assert_allclose(measured[:, 3], at_robot, atol=1e-5)
    np.testing.assert_allclose(measured[:, 3], measured[:, :3] @ STATIONS[0], atol=1e-5)
    robots, count = np.unique(log.fixes[:, 0], return_counts=True)
    assert set(count) == {2}
    assert len(robots) > 10
    np.testing.assert_allclose(np.sort(measured[:, 2].reshape(-1, 2)), [[-0.5, 0.5]] * len(robots))


def test_a_lighthouse_does_not_reach_robots_below_it(towers):
    """Planes that slant by 30 deg never come steeper than 60 deg."""
    below = SensingParams(beacons=((0.0, 0.0, 150.0),), beacon_kind="sweep")

    assert len(observe(towers[0], below).fixes) == 0


def test_a_station_errs_by_the_same_in_all_rows(towers):
    """Each plane of a station has a constant error in a structure, beside the jitter."""
    biases = []
    for seed in range(150):
        history = dataclasses.replace(towers[2], seed=seed)
        params = SensingParams(
            beacons=STATIONS[:1], beacon_kind="sweep", fix_noise=0.03, fix_bias=0.5
        )
        log = observe(history, params)
        measured = fixes(log)
        error = measured[:, 3] - (measured[:, :3] * centers(history, log)).sum(axis=1)
        for source in (0, 1):
            mine = error[measured[:, 5] == source]
            # Some 25 rows: a deviation beyond twice the jitter does not happen.
            assert mine.std() < 0.06
            biases.append(mine.mean())
        assert len({*zip(measured[:, 5], measured[:, 2] > 0.0, strict=True)}) == 2
        assert set(measured[:, 4]) == {0.03}
        assert log.source_name == ("beacon 0 plane 0", "beacon 0 plane 1")
        assert log.source_sd.tolist() == [0.5, 0.5]

    # 300 biases: five standard errors are 20 %.
    np.testing.assert_allclose(np.std(biases), 0.5, rtol=0.2)


def test_each_plane_of_each_station_is_a_source(towers):
    """Stations err independently of each other, and so do the two planes of one."""
    log = observe(towers[0], SensingParams(suite="coachbot-v2", sight_at="stances", stances=True))

    measured = fixes(log)

    names = [f"beacon {number} plane {plane}" for number in (0, 1) for plane in (0, 1)]
    assert log.source_name == tuple(names)
    source = measured[:, 5].astype(int)
    assert set(source) == {0, 1, 2, 3}
    station = np.array(STATIONS)[source // 2]
    # The plane holds its station but for its error, some 0.5 R.
    off = measured[:, 3] - (measured[:, :3] * station).sum(axis=1)
    assert np.abs(off).max() < 3.0


@pytest.mark.parametrize(
    "senses",
    [
        {"suite": "coachbot-v1"},
        {"suite": "zooids"},
        {"suite": "swarmbang"},
        {"suite": "kilobot"},
        {"beacons": STATIONS, "beacon_kind": "sweep"},
    ],
    ids=str,
)
def test_independent_errors_have_no_source(towers, senses):
    """A source without a shared error would say nothing, and cost an unknown."""
    log = observe(towers[0], SensingParams(**senses))

    assert log.source_name == ()
    assert len(log.source_sd) == 0
    assert set(fixes(log)[:, 5]) == {-1.0}
    assert set(log.ranges[:, 4]) <= {-1.0}


def test_the_errors_of_a_robot_do_not_depend_on_who_blocks(towers):
    """A robot has the same fix as the first of its structure and among all."""
    cut = dataclasses.replace(towers[0], walks=towers[0].walks[:5])
    params = SensingParams(beacons=(CEILING,), range_reach=8.0, **NO_TOUCH)

    few, all_ = (observe(history, params) for history in (cut, towers[0]))

    for name in ("fixes", "ranges"):
        rows = {tuple(row[:4]): row for row in getattr(few, name).tolist()}
        more = {tuple(row[:4]): row for row in getattr(all_, name).tolist()}
        both = rows.keys() & more.keys()
        assert both
        assert all(rows[key] == more[key] for key in both)


def test_seed_robots_are_known(towers):
    """All coordinates of the first robots after the anchor are fixed, sight or not."""
    log = observe(towers[0], SensingParams(seed_robots=4, fix_noise=0.01, **NO_TOUCH))

    np.testing.assert_array_equal(log.fixes[:, 0], np.repeat([1, 2, 3], 3))
    found = (log.fixes[:, 1:4] * log.fixes[:, 4:5]).reshape(3, 3, 3).sum(axis=1)
    # Nine errors: five standard deviations.
    np.testing.assert_allclose(found, towers[0].position[1:4], atol=0.05)


def test_ranges_reach_robots_in_sight(towers):
    """Each pair in reach and sight has one range, whose error is that of the settings."""
    errors = []
    for history in towers:
        log = observe(history, SensingParams(range_reach=8.0, range_noise=0.06))
        robot, other = log.ranges[:, :2].astype(int).T
        true = np.linalg.norm(history.position[robot] - history.position[other], axis=1)
        errors.append(log.ranges[:, 2] - true)
        assert (other < robot).all()
        assert len(np.unique(log.ranges[:, :2], axis=0)) == len(robot)
        assert true.max() <= 8.0

        # Robots in contact whose docks are all that is between them see each other.
        apart = np.linalg.norm(history.position[:, None] - history.position, axis=2)
        near = {(i, j) for i, j in zip(*np.nonzero(apart < 8.0), strict=True) if j < i}
        pairs = set(zip(robot.tolist(), other.tolist(), strict=True))
        closest = {(i, int(apart[i, :i].argmin())) for i in range(1, 30)}
        assert pairs < near
        assert len(closest & pairs) > 20

    # Some 400 errors: five standard errors are 18 %.
    np.testing.assert_allclose(np.concatenate(errors).std(), 0.06, rtol=0.18)


def test_all_ranges_of_a_structure_share_an_error(towers):
    """Radios of one kind err by the same, which the log states apart from the noise."""
    senses = {"range_reach": 8.0, "range_noise": 0.06}
    shared = []
    for seed in range(100):
        history = dataclasses.replace(towers[0], seed=seed)
        alone = observe(history, SensingParams(**senses))
        log = observe(history, SensingParams(**senses, range_bias=0.2))
        np.testing.assert_array_equal(log.ranges[:, [0, 1, 3]], alone.ranges[:, [0, 1, 3]])
        off = log.ranges[:, 2] - alone.ranges[:, 2]
        assert np.ptp(off) < 1e-12
        shared.append(off[0])
        assert log.source_name == ("ranges",)
        assert log.source_sd.tolist() == [0.2]
        assert set(log.ranges[:, 4]) == {0.0}

    # Five standard errors of a deviation of 100 draws are 35 %.
    np.testing.assert_allclose(np.std(shared), 0.2, rtol=0.35)


def test_lighthouses_and_ranges_have_sources_of_their_own(towers):
    """Each row names the source whose shared error is in it."""
    params = SensingParams(suite="coachbot-v2", range_reach=8.0, range_bias=0.2)

    log = observe(towers[0], params)

    assert log.source_name[-1] == "ranges"
    assert log.source_sd.tolist() == [0.5, 0.5, 0.5, 0.5, 0.2]
    assert set(log.ranges[:, 4]) == {4.0}
    assert set(log.fixes[:, 6]) == {0.0, 1.0, 2.0, 3.0}


def test_ranges_of_every_stance_are_those_to_robots_that_joined(towers):
    """A climbing robot measures from where it stands."""
    history = towers[1]

    log = observe(history, SensingParams(range_reach=8.0, range_noise=1e-6, sight_at="stances"))

    rows = log.stances.ranges
    robot = np.searchsorted(log.stances.start, rows[:, 0], side="right") - 1
    other = rows[:, 1].astype(int)
    center = np.concatenate([walk.center[:-1] for walk in history.walks])[rows[:, 0].astype(int)]
    true = np.linalg.norm(center - history.position[other], axis=1)
    np.testing.assert_allclose(rows[:, 2], true, atol=1e-5)
    assert (other < robot).all()
    assert len(rows) > 300
