"""Each measurement leaves fewer places for a robot, and never excludes the true one."""

from dataclasses import replace

import numpy as np
import pytest

from tests import oracle
from tiswarm.base.errors import InputError
from tiswarm.measurements.advice.placement import narrow
from tiswarm.sensing import SensingParams, observe


@pytest.fixture(scope="module", params=[0.0, 2.0], ids=["exact", "noisy"])
def sensed(request, towers):
    """A tower and what its robots sensed, without and with noise of tilt."""
    return towers[0], observe(towers[0], SensingParams(tilt_noise_deg=request.param))


@pytest.mark.parametrize("robot", [1, 7, 29])
def test_the_true_place_remains_to_the_end(sensed, robot):
    """Places that remain come as near to the truth as the draws are dense."""
    history, log = sensed

    steps = narrow(log, robot, history.position)

    for step in steps:
        nearest = np.linalg.norm(step.places - history.position[robot], axis=1).min()
        assert nearest < 0.25, step.name


@pytest.mark.parametrize("robot", [1, 7, 29])
def test_no_measurement_leaves_more_places(sensed, robot):
    """From the docks on, each step chooses among the places of the step before."""
    history, log = sensed

    _, orientation, docks, *others = narrow(log, robot, history.position)

    assert docks.spread < orientation.spread
    before = {tuple(place) for place in docks.places}
    for step in others:
        left = {tuple(place) for place in step.places}
        assert left <= before
        before = left


def test_docks_in_contact_are_two_radii_apart(towers):
    """With known docks the center is on a sphere, with a further contact on a circle."""
    log = observe(towers[0], SensingParams())
    count = np.bincount(log.contacts[:, 2], minlength=30)
    robot = int(np.flatnonzero(count >= 2)[0])
    (i, a, _, b), (j, c, _, d) = log.contacts[log.contacts[:, 2] == robot][:2]
    place, turns = towers[0].position, [oracle.matrix(q) for q in log.orientation_wxyz]

    steps = narrow(log, robot, place)

    for other, dock, own, step, width in ((i, a, b, steps[2], 1e-9), (j, c, d, steps[3], 0.1)):
        center = place[other] + turns[other] @ log.dock_offset_body[dock]
        center = center - turns[robot] @ log.dock_offset_body[own]
        off = np.linalg.norm(step.places - center, axis=1) - 2.0
        assert step.name == f"dock {own} to {dock} of robot {other}"
        assert np.abs(off).max() <= width + 1e-9


@pytest.mark.parametrize("off", [0.0, 0.3])
def test_a_height_leaves_a_band(towers, off):
    """Places are as high as measured, but for a tenth of R and what the estimate misses that by."""
    log = observe(towers[0], SensingParams())
    count = np.bincount(log.contacts[:, 2], minlength=30)
    robot = int(np.flatnonzero((count == 1) & np.isfinite(log.flip_height))[0])
    position = towers[0].position.copy()
    position[robot, 2] += off

    height = next(step for step in narrow(log, robot, position) if step.name == "height")

    error = np.abs(height.places[:, 2] - log.flip_height[robot])
    assert 0.9 * (0.1 + off) < error.max() <= 0.1 + off + 1e-9


def test_robots_whose_place_does_not_follow_from_earlier_ones_are_refused(towers):
    """The anchor is known, and a robot without contacts may be anywhere."""
    log = observe(towers[0], SensingParams())
    alone = replace(log, contacts=log.contacts[log.contacts[:, 2] != 5])

    for each, robot, problem in (
        (log, 0, "0 is the anchor"),
        (log, 30, "no robot of the log"),
        (alone, 5, "5 touches no robot that joined earlier; choose another"),
    ):
        with pytest.raises(InputError, match=problem):
            narrow(each, robot, towers[0].position)
