"""Least squares finds what the residuals determine, from a start that is near enough."""

import numpy as np
import pytest

from tests.localization.test_problem import true_yaw
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.least_squares import Problem, improve
from tiswarm.localization.params import CUES, LeastSquaresParams, VirtualForceParams
from tiswarm.localization.registry import localize
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import Odometry
from tiswarm.measurements.rows import SPACING, Distances, Places
from tiswarm.sensing import SensingParams, observe

QUICK = LeastSquaresParams(
    walk_contacts=False, odometry=False, rounds=2, start=VirtualForceParams(iterations=50)
)


@pytest.fixture(scope="module")
def log(towers):
    """What the robots of a small tower sensed, their spawns included."""
    return observe(towers[0], SensingParams(spawn_noise=0.0))


@pytest.mark.parametrize("yaw_sd", [0.0, 0.3])
def test_derivatives_are_those_of_the_residuals(log, yaw_sd):
    """Central differences agree, on both sides of D, for the anchor's partners and turns too."""
    rng = np.random.default_rng(0)
    walks = Odometry(log)
    last = walks.final[rng.integers(0, 29, (2, 60))]
    dock = rng.integers(0, 3, (2, 60))
    distances = Distances.of(
        last[0], dock[0], last[1] + (last[0] == last[1]), dock[1], length=SPACING, sd=0.3
    )._replace(is_hinge=rng.random(60) < 0.5, own_variance=rng.uniform(0.1, 1.0, 60))
    stance, way = walks.first[rng.integers(1, 30, 20)], rng.normal(size=(20, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    places = Places.of(stance, dock[0, :20], way, rng.normal(size=20), variance=0.2)
    problem = Problem(
        Measurements.gather(walks, [distances], [places]), log.anchor_position, yaw_sd
    )
    unknowns = problem.unknowns(rng.normal(size=(30, 3)), rng.normal(size=30))
    motion = rng.normal(size=unknowns.shape)

    change = problem.residuals(unknowns + 1e-6 * motion) - problem.residuals(
        unknowns - 1e-6 * motion
    )

    np.testing.assert_allclose(problem.jacobian(unknowns) @ motion, change / 2e-6, atol=1e-6)
    gap = problem.residuals(unknowns)[:60]
    assert (gap[distances.is_hinge] <= 0.0).all()
    assert (gap[~distances.is_hinge] > 0.0).any()


def test_a_bias_of_yaw_is_solved_for(towers):
    """Where starts are known turns and places come out; as it is sensed, yaw ruins places.

    One robot of this tower is caught in a mirror image of its place.
    """
    history = towers[0]
    log = observe(history, SensingParams(spawn_noise=0.0, yaw_bias_deg=15.0))
    start = history.position + 0.1 * np.random.default_rng(0).normal(size=(30, 3))

    solved = improve(log, LeastSquaresParams(odometry_width=0.05), start)
    taken = improve(log, LeastSquaresParams(odometry_width=0.05, solve_yaw=False), start)

    bias = true_yaw(log, history)
    off = np.linalg.norm([e.position - history.position for e in (solved, taken)], axis=2)
    assert np.abs(bias).max() > 0.5
    assert np.quantile(np.abs(solved.yaw - bias), 0.9) < 0.02
    assert taken.yaw is None
    assert np.quantile(off[0], 0.9) < 0.1
    assert np.quantile(off[1], 0.9) > 1.0


@pytest.mark.parametrize("cues", [CUES, ("odometry",), CUES[:5]])
def test_the_truth_is_found_from_nearby(towers, log, cues):
    """Whatever the cues determine comes out exactly, though they start a tenth of an R off."""
    true = towers[0].position
    start = true + 0.1 * np.random.default_rng(0).normal(size=true.shape)

    params = LeastSquaresParams(**{cue: cue in cues for cue in CUES if cue != "touches"})

    estimate = improve(log, params, start)

    known = np.array([word == "yes" for word in observability(log, cues).known])
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
