"""Lengths in another unit than the rest of a log are named; logs in one unit pass."""

from dataclasses import replace

import numpy as np
import pytest

from tests.structures import SUITES, Rule, structure, with_fixes, with_ranges
from tiswarm.measurements.units import HEADER, slips
from tiswarm.sensing import SensingParams, observe


@pytest.fixture(scope="module")
def log(towers):
    """What thirty robots sensed with noise, ranges to those within 12 R, and spawn positions."""
    return observe(towers[0], SensingParams(tilt_noise_deg=1.0, range_reach=12.0, spawn_noise=0.2))


def _scaled(log, key, factor, rows=slice(None)):
    """Multiply some lengths of a log; a range and the value of a fix have columns of their own."""
    column = {"ranges": 2, "fixes": 4}.get(key)
    values = getattr(log, key).copy()
    values[rows if column is None else (rows, column)] *= factor
    return replace(log, **{key: values})


@pytest.mark.parametrize("suite", sorted(SUITES))
def test_logs_in_one_unit_pass(towers, suite):
    """Neither noise nor false contacts nor any sensor suite looks like another unit."""
    wrong = {"false_contacts": 0.1, "wrong_docks": 0.05, "tilt_noise_deg": 2.0}
    for history in towers[:2]:
        for noise in ({}, wrong):
            assert slips(observe(history, SensingParams(suite=suite, touch=True, **noise))) == []


@pytest.mark.parametrize("factor", [25.4, 100.0, 1000.0])
@pytest.mark.parametrize("key", ["flip_height", "ranges", "spawn_position"])
def test_a_column_in_another_unit_than_contacts_is_one_finding(log, key, factor):
    """A line for each robot would hide that the mistake is one."""
    (slip,) = slips(_scaled(log, key, factor))

    assert slip.key == key
    assert 4.0 < slip.factor < 1.05 * factor
    assert slip.against in {"contacts", "ground_docks"}


def test_heights_that_are_too_short_contradict_the_ground(log):
    """Docks on the ground say how high the center is; chains of contacts bound from above only."""
    (slip,) = slips(_scaled(log, "flip_height", 0.001))

    assert (slip.key, slip.against) == ("flip_height", "ground_docks")
    assert slip.factor == pytest.approx(0.001, rel=0.1)


def test_heights_that_are_a_little_off_are_in_one_unit(log):
    """Near a height of 0, 0.4 R more is several times as much, though not by another unit."""
    standing = np.unique(log.ground_docks[:, 0])
    down = np.median(log.flip_height[standing]) - 0.2
    below = np.array([0.0, 0.0, down])
    low = replace(
        log,
        ground_z=log.ground_z - down,
        anchor_position=log.anchor_position - below,
        flip_height=log.flip_height - down + 0.4,
        spawn_position=log.spawn_position - below,
    )

    assert slips(low) == []


@pytest.mark.parametrize("key", ["flip_height", "ranges", "spawn_position"])
def test_one_length_longer_than_contacts_reach_is_named(log, key):
    """The row of the last robot's first length counts in millimeters where others count in R."""
    rows = {"ranges": len(log.ranges) - 1}.get(key, 29)

    (slip,) = slips(_scaled(log, key, 1000.0, rows=rows))

    assert (slip.robot, slip.key) == (29, key)
    assert 20.0 < slip.factor <= 1000.0


def test_a_fix_in_another_unit_is_named_with_its_length(log, towers):
    """Other robots have good fixes, and ranges to this one."""
    fixed = with_fixes(log, towers[0], range(1, 30), each=3, sd=0.1)
    row = int(np.flatnonzero(fixed.fixes[:, 0] == 17)[np.abs(fixed.fixes[51 - 3 : 51, 4]).argmax()])

    (slip,) = slips(_scaled(fixed, "fixes", 1000.0, rows=row))

    assert (slip.robot, slip.key) == (17, "fixes")
    away = 1000.0 * fixed.fixes[row, 4] - fixed.fixes[row, 1:4] @ log.anchor_position
    assert slip.what == f"{abs(away):.4g} R from the anchor"


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"anchor_position": np.array([0.0, 0.0, 33.0])}, "anchor_position"),
        ({"dock_offset_body": 1000.0 * np.eye(3)}, "dock_offsets"),
    ],
    ids=["anchor-above-the-ground", "arms-longer-than-robots"],
)
def test_lengths_of_the_header_are_compared(changes, key):
    """An anchor that stands on the ground has a height of few radii."""
    log, _ = structure(Rule(), 1, 0)
    log = replace(
        log, ground_z=0.0, ground_docks=np.array([[0, 0]], np.int32),
        anchor_position=np.array([0.0, 0.0, 1.0]),
    )  # fmt: skip

    found = slips(replace(log, **changes))

    assert (HEADER, key) in {(slip.robot, slip.key) for slip in found}


@pytest.mark.parametrize("robots", [100, pytest.param(300, marks=pytest.mark.trial)])
def test_many_ranges_take_bounded_time(robots):
    """Robots that range to hundreds compare a sample, with the longest and the shortest in it."""
    log, center = structure(Rule(kind="loops"), robots, 0)
    history = type("History", (), {"position": center})
    ranged = with_ranges(log, history, reach=30.0, sd=0.1)
    row = len(ranged.ranges) // 2

    (slip,) = slips(_scaled(ranged, "ranges", 1000.0, rows=row))

    assert len(ranged.ranges) > 0.45 * robots**2
    assert slip.robot == int(ranged.ranges[row, 0])
