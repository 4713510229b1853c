"""What a log says is true without noise, and as unsure as it is said to be with noise."""

import dataclasses

import numpy as np
import pytest

from tiswarm.localization.joint.equations import equations
from tiswarm.localization.params import JointParams
from tiswarm.sensing import SensingParams, observe

ALL = JointParams()


def test_every_equation_holds_where_robots_truly_are(towers):
    """Contacts of every stance, heights, grounds and spawns agree with the final positions."""
    for history in towers:
        log = observe(history, SensingParams(spawn_noise=0.0))

        known = equations(log, ALL)

        gap = known.lengths(history.position) - log.spacing
        assert (known.is_final.sum(), len(gap)) > (len(log.contacts) - 1, len(log.contacts))
        assert -1e-9 < gap.min() <= gap.max() < 0.02 + 1e-9  # as near as docks must be to feel
        assert (known.precision > 0.0).all()
        np.testing.assert_allclose(known.place, history.position, atol=1e-9)


@pytest.mark.parametrize(
    "noise",
    [
        SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, spawn_noise=0.2),
        SensingParams(yaw_bias_deg=3.0, tilt_noise_deg=0.3, spawn_noise=0.0),
    ],
)
def test_residuals_are_as_large_as_foretold(towers, noise):
    """Divided by the standard deviation that follows from the noise they have one of about 1."""
    contacts, places = [], []
    for history in towers:
        for seed in range(5):
            log = observe(dataclasses.replace(history, seed=seed), noise)
            known = equations(log, ALL)
            gap = known.lengths(history.position) - log.spacing
            contacts.append(gap / np.sqrt(known.variance))
            places.append((known.place - history.position)[1:] * np.sqrt(known.precision[1:]))

    # 15 logs of some 100 equations each, many of which share a flip
    assert 0.85 < np.std(np.concatenate(contacts)) < 1.15
    assert 0.85 < np.sqrt(np.mean(np.concatenate(places) ** 2)) < 1.15


def test_a_cue_that_is_off_says_nothing(towers):
    """Without cues there are no equations; with one of them, only its own."""
    log = observe(towers[0], SensingParams(spawn_noise=0.0))
    none = {"contacts": False, "height": False, "ground": False, "walk_contacts": False}
    silent = equations(log, JointParams(**none, odometry=False))
    walked = equations(log, JointParams(**none | {"walk_contacts": True}, odometry=False))
    level = equations(log, JointParams(**none | {"height": True}, odometry=False))

    assert len(silent.robot) == 0
    assert (silent.precision < 0.1).all()  # but that nobody is a world away
    assert len(walked.robot) > 0
    assert not walked.is_final.any()
    assert (level.precision[:, :2] < 0.1).all()
    assert (level.precision[:, 2] > 100.0).all()
