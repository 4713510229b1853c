"""Rows of one source share an error; whatever takes rows to be independent counts it in each."""

from dataclasses import replace

import numpy as np
import pytest

from tests.structures import with_ranges
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import CENTER
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.suites import STATIONS

CUES = ("contacts", "ground", "fixes", "ranges", "directions", "touches")
LIGHTHOUSES = {"beacons": STATIONS, "beacon_kind": "sweep", "fix_noise": 0.03, "fix_bias": 0.5}


@pytest.fixture(scope="module")
def log(towers):
    """Two lighthouses see robots at all stances; every other range is by a radio."""
    senses = SensingParams(
        **LIGHTHOUSES, sight_at="stances", tilt_noise_deg=1.0, contact_docks="own"
    )
    ranged = with_ranges(observe(towers[0], senses), towers[0], reach=6.0, sd=0.1)
    ranges = ranged.ranges.copy()
    ranges[::2, 4] = 4
    return replace(
        ranged,
        ranges=ranges,
        source_name=(*ranged.source_name, "radio"),
        source_sd=np.append(ranged.source_sd, 0.2),
    )


@pytest.fixture(scope="module")
def rows(log):
    """What the log measures."""
    return measure(log, CUES)


def test_each_row_knows_its_source(log, rows):
    """Fixes of all stances and ranges keep the source of the log; nothing else has one."""
    fixes, fixed = np.concatenate([log.fixes, log.stances.fixes]), rows.places.dock == CENTER
    ranged = rows.distances.dock == CENTER
    source = np.concatenate([rows.distances.source[ranged], rows.places.source[fixed]])

    assert len(rows.source) == len(rows)
    assert sorted(rows.places.source[fixed]) == sorted(fixes[:, 6])
    assert sorted(rows.distances.source[ranged]) == sorted(log.ranges[:, 4])
    assert set(source) == {-1, 0, 1, 2, 3, 4}
    assert (rows.source >= 0).sum() == (source >= 0).sum()
    assert rows.shared_sd.tolist() == [0.5, 0.5, 0.5, 0.5, 0.2]


def test_shared_errors_are_in_the_unit_of_the_rows(log, rows):
    """A log in millimeters has the same rows, in dock radii."""
    scale = 33.0
    length = [1.0, 1.0, 1.0, 1.0, scale, scale, 1.0]
    in_mm = replace(
        log,
        dock_radius=scale,
        dock_offset_body=scale * log.dock_offset_body,
        anchor_position=scale * log.anchor_position,
        fixes=log.fixes * length,
        ranges=log.ranges * [1.0, 1.0, scale, scale, 1.0],
        stances=replace(log.stances, fixes=log.stances.fixes * length),
        source_sd=scale * log.source_sd,
    )

    same = measure(in_mm, CUES)

    np.testing.assert_allclose(same.shared_sd, rows.shared_sd, rtol=1e-12)
    np.testing.assert_allclose(same.variance(), rows.variance(), rtol=1e-9)


def test_variance_is_whole_and_its_parts_are_apart(log, rows):
    """A row's own error, that of its source and the turns of its arms are independent."""
    unshared = measure(replace(log, source_sd=1e-6 * np.ones(5)), CUES)
    shared = np.append(rows.shared_sd, 0.0)[rows.source]

    np.testing.assert_array_equal(rows.own_variance, unshared.own_variance)
    np.testing.assert_array_equal(rows.shared_variance, shared**2)
    np.testing.assert_allclose(rows.variance(), unshared.variance() + shared**2, atol=1e-11)
    of_fixes = rows.own_variance[len(rows.neighbor) :][rows.places.dock == CENTER]
    np.testing.assert_allclose(of_fixes, 0.03**2)


def test_errors_of_a_source_are_one_draw(towers):
    """The residual at the truth is one number a source, but for jitter: the model is that drawn."""
    log = observe(towers[1], SensingParams(**LIGHTHOUSES))

    rows = measure(log, ["fixes"])

    residual = rows.residual(towers[1].position)
    for source in range(4):
        mine = residual[rows.source == source]
        assert len(mine) > 5
        # Some 25 rows: a deviation beyond twice the jitter does not happen.
        assert mine.std() < 2.0 * np.sqrt(rows.own_variance[0])
        assert abs(mine.mean()) < 4.0 * rows.shared_sd[source]
    np.testing.assert_allclose(rows.variance(), 0.03**2 + 0.5**2)


def test_rows_keep_their_source_where_they_go(towers, rows):
    """Selected, gathered again or with their docks found, rows have the variance that they had."""
    chosen = np.random.default_rng(0).random(len(rows)) < 0.5

    some = rows.select(chosen)
    again = Measurements.gather(
        some.odometry, [some.distances], [some.places], [some.offsets], shared_sd=some.shared_sd
    )
    found = rows.associated(towers[0].position)

    assert len(rows.touch) > 0
    for part, expected in ((some, chosen), (again, chosen), (found, slice(None))):
        np.testing.assert_array_equal(part.source, rows.source[expected])
        np.testing.assert_array_equal(part.shared_variance, rows.shared_variance[expected])


def test_sources_without_a_shared_error_are_refused(rows):
    """Who gathers rows and forgets their sources would have them independent, in silence."""
    with pytest.raises(ValueError, match="shared_sd has 0 sources, and rows name more"):
        Measurements.gather(rows.odometry, [rows.distances], [rows.places])


def test_averages_say_what_repeated_readings_say(towers):
    """The information about positions is that of the readings with all that their errors share.

    The errors of a source, and of the orientations at a stance, are in all readings and do not
    average out.
    """
    rng = np.random.default_rng(0)
    log = observe(towers[0], SensingParams(tilt_noise_deg=1.0, range_reach=5.0))
    some = rng.integers(0, len(log.ranges), 60)
    ranges = log.ranges[some] + [0, 0, 0.1, 0, 0] * rng.normal(size=(60, 1))
    ranges[:, 3:] = np.column_stack([rng.uniform(0.05, 0.5, 60), rng.integers(-1, 2, 60)])
    earlier = np.column_stack([log.stances.start[rng.integers(4, 8, 60)], np.tile(np.eye(3)[0], 60)
        .reshape(-1, 3), rng.normal(size=60), ranges[:, 3:]])  # fmt: skip
    log = replace(
        log,
        ranges=ranges,
        stances=replace(log.stances, fixes=earlier),
        source_name=("a", "b"),
        source_sd=np.array([0.1, 0.3]),
    )
    rows = measure(log, ["ranges", "fixes"])

    mean = rows.averaged()

    assert len(mean) < 0.8 * len(rows)
    jacobian, center = rows.jacobian(towers[0].position).toarray(), towers[0].position
    ends = np.column_stack([rows.robot, np.pad(rows.neighbor, (0, len(rows) - len(rows.neighbor)),
                            constant_values=-1), rows.arm, rows.source])  # fmt: skip
    alike = (ends[:, None] == ends).all(axis=2)
    common = rows.variance() - rows.own_variance
    covariance = np.diag(rows.own_variance) + alike * common
    weight = np.linalg.inv(covariance)
    averaged = mean.jacobian(center).T @ np.diag(1.0 / mean.variance())
    np.testing.assert_allclose(
        averaged @ mean.jacobian(center), jacobian.T @ weight @ jacobian, atol=1e-8
    )
    np.testing.assert_allclose(
        averaged @ mean.residual(center), jacobian.T @ weight @ rows.residual(center), atol=1e-8
    )


def test_what_is_measured_once_stays_as_it_is(rows):
    """Logs without repeated readings have the same estimates as ever, to the last bit."""
    mean = rows.averaged()

    for name in ("distances", "offsets", "places"):
        for column, same in zip(getattr(rows, name), getattr(mean, name), strict=True):
            np.testing.assert_array_equal(same, column)


def test_repeated_ranges_and_fixes_are_rows_of_their_own(towers):
    """Two readings of one device are two measurements, though they agree to the last digit."""
    log = observe(towers[0], SensingParams())
    ranges = np.array([[5, 2, 6.0, 0.1, -1], [5, 2, 6.0, 0.1, -1], [5, 2, 6.2, 0.1, -1]])
    fixes = np.array([[4, 1, 0, 0, 3.0, 0.5, -1]] * 2 + [[4, 1, 0, 0, 3.1, 0.5, -1]])
    earlier = fixes.copy()
    earlier[:, 0] = log.stances.start[7]
    stances = replace(log.stances, fixes=earlier)

    rows = measure(replace(log, ranges=ranges, fixes=fixes, stances=stances), ["fixes", "ranges"])

    assert rows.distances.length.tolist() == [6.0, 6.0, 6.2]
    assert rows.places.value.tolist() == [3.0, 3.0, 3.1] * 2
    assert rows.robot.tolist() == [5, 5, 5, 4, 4, 4, 7, 7, 7]
