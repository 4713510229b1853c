"""Robots that do not know the docks of their contacts list them as touches."""

import numpy as np
import pytest

from tests.records.test_sensing_file import content
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.sensing import SensingParams, observe

NOISY = {"wrong_docks": 0.1, "false_contacts": 0.1, "missed_contacts": 0.1}


def known(rows, docks):
    """Touches that rows of (stance or robot, own dock, other robot, other dock) amount to."""
    blank = {(i, a if docks == "own" else -1, j, -1) for i, a, j, _ in rows.tolist()}
    return sorted(blank)


@pytest.mark.parametrize("docks", ["own", "none"])
@pytest.mark.parametrize("noise", [{}, NOISY], ids=["exact", "noisy"])
def test_touches_are_contacts_without_docks(towers, docks, noise):
    """Each contact of each stance has one; two of the same robots may be one touch."""
    both, less = (
        observe(towers[0], SensingParams(contact_docks=which, **noise)) for which in ("both", docks)
    )

    assert [*map(tuple, less.touches.tolist())] == known(both.contacts[:, [2, 3, 0, 1]], docks)
    earlier = [*map(tuple, less.stances.touches.tolist())]
    assert earlier == known(both.stances.contacts, docks)
    assert len(less.contacts) == len(less.stances.contacts) == 0
    assert len(both.touches) == len(both.stances.touches) == 0


def test_touches_come_back_from_a_file(towers, tmp_path):
    """A log of version 2 holds them, bit for bit."""
    log = observe(towers[0], SensingParams(contact_docks="own"))

    write_sensing_log(log, tmp_path / "log")

    assert content(read_sensing_log(tmp_path / "log")) == content(log)


def test_robots_without_contacts_have_no_touches(towers):
    """The switch of contacts is the same for both."""
    log = observe(towers[0], SensingParams(contacts=False, contact_docks="none"))

    assert len(log.touches) == len(log.stances.touches) == 0


@pytest.mark.parametrize("key", ["direction_noise_deg", "connection_noise_deg"])
def test_unknown_docks_have_no_directions(key):
    """Directions and connections name docks."""
    with pytest.raises(ValueError, match="set contact_docks to both"):
        SensingParams(contact_docks="own", **{key: 1.0})


def test_touches_have_the_noise_of_the_log(towers):
    """Orientations keep their draws."""
    noise = {"tilt_noise_deg": 1.0}
    both, less = (
        observe(towers[0], SensingParams(contact_docks=docks, **noise)) for docks in ("both", "own")
    )

    np.testing.assert_array_equal(both.orientation_wxyz, less.orientation_wxyz)
    assert both.noise == less.noise
