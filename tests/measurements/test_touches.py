"""The docks of a touch are those, of all that may touch, whose distance is nearest to D."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import SPACING
from tiswarm.measurements.observability import observability
from tiswarm.sensing import SensingParams, observe

NOISY = {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0}


def touches(history, docks, **noise):
    """Rows of the touches of all stances."""
    return measure(observe(history, SensingParams(contact_docks=docks, **noise)), ["touches"])


@pytest.mark.parametrize("docks", ["own", "none"])
def test_the_docks_that_touch_are_found_at_the_true_positions(towers, docks):
    """Docks touch up to 0.02 R apart; other pairs are as near to D by chance alone."""
    history = towers[0]
    rows = touches(history, docks)
    contacts = measure(observe(history, SensingParams()), ["contacts", "walk_contacts"])

    found = rows.associated(history.position)

    assert np.abs(rows.residual(history.position)).max() < 0.021
    np.testing.assert_allclose(
        found.residual(history.position), rows.residual(history.position), atol=1e-12
    )
    true = {tuple(row) for row in contacts.sensed_contacts.tolist()}
    known = [tuple(row) in true for row in found.sensed_contacts.tolist()]
    # A dock that stays put is named at its last stance alone, which touches cannot know.
    assert np.mean(known) > (0.95 if docks == "own" else 0.5)


@pytest.mark.parametrize("yaw_sd", [0.0, 0.5])
def test_all_pairs_are_tried(towers, yaw_sd):
    """Anywhere, with any yaw, and in several chains at once: a slow search finds the same."""
    rng = np.random.default_rng(0)
    rows = touches(towers[0], "none", **NOISY)
    position, yaw = 3.0 * rng.normal(size=(2, 30, 3)), yaw_sd * rng.normal(size=(2, 30))

    together = rows.residual(position, yaw)
    pair = rows.association(position, yaw)

    (own, _), (its, _) = rows.touch_arms
    every = [*product(range(3), repeat=2)]
    for chain, row in product(range(2), range(0, len(rows), 5)):
        i, j = rows.robot[row], rows.neighbor[row]
        ends = [
            [position[chain, robot] + _turned(arm, yaw[chain, robot]) for arm in arms]
            for robot, arms in ((i, own[row]), (j, its[row]))
        ]
        off = [np.linalg.norm(ends[0][a] - ends[1][b]) - SPACING for a, b in every]
        best = int(np.abs(off).argmin())
        assert pair[chain, row] == best
        assert together[chain, row] == pytest.approx(off[best], abs=1e-9)


def _turned(arm, angle):
    x, y, z = arm
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x - s * y, s * x + c * y, z])


def test_of_equally_near_docks_the_first_is_taken(towers):
    """Two robots in the same place, turned alike, have three pairs of docks at distance 0."""
    log = observe(towers[0], SensingParams(contact_docks="none"))
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (log.robot_count, 1))
    ring = np.array([[0.5, 0.0, 0.0], [-0.25, 3**0.5 / 4, 0.0], [-0.25, -(3**0.5) / 4, 0.0]])
    rows = measure(
        replace(log, orientation_wxyz=upright, dock_offset_body=ring, stances=None), ["touches"]
    )

    pair = rows.association(np.zeros((log.robot_count, 3)))

    # Docks of a ring of radius 0.5 R are up to 0.87 R apart: nearest to D are different ones.
    assert set(pair.tolist()) <= {1, 2}


def test_a_touch_determines_as_much_as_its_docks(towers):
    """To first order: where the docks are found, the constraint is that of a contact."""
    history = towers[0]
    both, own = (
        observe(history, SensingParams(contact_docks=docks, stances=False))
        for docks in ("both", "own")
    )

    left = [
        observability(log, ["contacts", "touches", "height", "ground"], history.position)
        for log in (both, own)
    ]

    assert left[0].floppy_modes == left[1].floppy_modes
    assert "touches" in left[1].cues


def test_variance_is_the_mean_over_docks(towers):
    """Noise of orientations moves unknown docks as it moves known ones."""
    both = measure(observe(towers[0], SensingParams(stances=False, **NOISY)), ["contacts"])
    none = touches(towers[0], "none", stances=False, **NOISY)

    assert np.median(none.variance()) == pytest.approx(np.median(both.variance()), rel=0.3)
