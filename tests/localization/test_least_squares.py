"""Least squares finds what the residuals determine, from a start that is near enough."""

import numpy as np
import pytest

from tiswarm.compute.rotations import dock_offsets
from tiswarm.localization.least_squares import Pairs, Places, Problem, improve
from tiswarm.localization.params import CUES, LeastSquaresParams, VirtualForceParams
from tiswarm.localization.registry import localize
from tiswarm.records.certainty import certainty
from tiswarm.sensing import SensingParams, observe

QUICK = LeastSquaresParams(
    walk_contacts=False, odometry=False, rounds=2, start=VirtualForceParams(iterations=50)
)


@pytest.fixture(scope="module")
def log(towers):
    """What the robots of a small tower sensed, their spawns included."""
    return observe(towers[0], SensingParams(spawn_noise=0.0))


def test_derivatives_are_those_of_the_residuals(log):
    """Central differences agree, on both sides of D, for the anchor's partners too."""
    rng = np.random.default_rng(0)
    i = rng.integers(0, 29, 60)
    pairs = Pairs(
        i, i + 1, rng.normal(size=(60, 3)), rng.uniform(0.1, 1.0, 60), rng.random(60) < 0.5
    )
    robots = rng.integers(1, 30, 20)
    places = Places(robots, rng.integers(0, 3, 20), rng.normal(size=20), rng.uniform(0.1, 1, 20))
    problem = Problem(log, [pairs], [places])
    unknowns = rng.normal(size=3 * 29)
    motion = rng.normal(size=unknowns.shape)

    change = problem.residuals(unknowns + 1e-6 * motion) - problem.residuals(
        unknowns - 1e-6 * motion
    )

    np.testing.assert_allclose(problem.jacobian(unknowns) @ motion, change / 2e-6, atol=1e-6)
    gap = problem.residuals(unknowns)[:60]
    assert (gap[pairs.hinge] <= 0.0).all()
    assert (gap[~pairs.hinge] > 0.0).any()


@pytest.mark.parametrize("cues", [CUES, ("odometry",), CUES[:5]])
def test_the_truth_is_found_from_nearby(towers, log, cues):
    """Whatever the cues determine comes out exactly, though they start a tenth of an R off."""
    true = towers[0].position
    start = true + 0.1 * np.random.default_rng(0).normal(size=true.shape)

    params = LeastSquaresParams(**{cue: cue in cues for cue in CUES})

    estimate = improve(log, params, start)

    known = np.array([word == "yes" for word in certainty(log, cues).known])
    assert known.sum() > 20
    # Contacts are felt across a gap of up to 0.02 R.
    np.testing.assert_allclose(estimate.position[known], true[known], atol=0.05)


def test_docks_end_at_D_or_apart(towers, log):  # noqa: N802 - D has a name
    """What is stretched and what overlaps is mended, even from far off."""
    true = towers[0].position
    start = true + np.random.default_rng(0).normal(size=true.shape)

    estimate = improve(log, QUICK, start)

    assert estimate.residual[-1] < estimate.residual[0] / 3
    assert (np.diff(estimate.iteration) > 0).all()
    np.testing.assert_array_equal(estimate.position[0], log.anchor_position)
    np.testing.assert_array_equal(estimate.trace[-1], estimate.position)
    assert _deepest_overlap(log, estimate.position) < _deepest_overlap(log, estimate.trace[0])


def _deepest_overlap(log, position):
    """How much closer than D the two closest docks of different robots are."""
    dock = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    distance = np.linalg.norm(dock[:, None, :, None] - dock[None, :, None], axis=-1)
    distance[np.arange(len(dock)), np.arange(len(dock))] = np.inf
    return 2.0 - distance.min()


def test_least_squares_repeats_bit_for_bit(log):
    """Twice the same log, twice the same bytes."""
    assert localize(log, QUICK).trace.tobytes() == localize(log, QUICK).trace.tobytes()
