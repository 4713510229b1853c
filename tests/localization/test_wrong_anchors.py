"""A known position that all other measurements contradict is left out, and named."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.estimates import lies
from benchmarks.estimates.sets import grown
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.cost import WholeCost
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture.anchors import without_anchors
from tiswarm.localization.mixture.ends import Posed
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.cues import in_plane, measure
from tiswarm.measurements.verdicts import distrust
from tiswarm.sensing import SensingParams
from tiswarm.world.params import TowerParams

JOINT = JointParams(chains=4)
ROBOTS = 24


@pytest.fixture(scope="module", params=[False, True], ids=["in space", "in a plane"])
def tower(request):
    """Sense a tower with all contacts of walks, which determine where most robots are."""
    sensed = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0)
    params = TowerParams(plane=request.param)
    return grown(params, ROBOTS, 31, sensed, RobotGeometry())


def _stated_positions(log):
    """List the further anchors and where they are said to be, shapes (K,) and (K, 3)."""
    anchors = np.flatnonzero(np.isfinite(log.fixed_position[:, 0]))
    return anchors, log.fixed_position[anchors]


def test_an_anchor_that_walks_contradict_is_left_out_and_named(tower):
    """It is 2 R off; the estimate puts it where it is, and says that it may be wrong."""
    log, truth = tower
    lied = lies.wrong_anchor(log, truth, np.random.default_rng(3))
    anchors, stated = _stated_positions(lied)
    off = np.linalg.norm(stated - truth[anchors], axis=1)
    wrong = anchors[off.argmax()]

    estimate = localize(lied, JOINT)

    verdict = estimate.convergence
    assert verdict.consistent is False
    assert f"known position of robot {wrong} and contacts" in verdict.reason
    assert set(estimate.outlier_places[:, 0].tolist()) == {wrong}
    assert "measure that position again, or leave it out of the log" in distrust(lied, estimate)
    assert np.linalg.norm(estimate.position[wrong] - truth[wrong]) < 0.5
    assert estimate.sd[wrong] > 0.01


def test_anchors_that_are_right_stay_where_they_are(tower):
    """The same two anchors, both rightly known, are in no list of outliers."""
    log, truth = tower
    lied = lies.wrong_anchor(log, truth, np.random.default_rng(3))
    anchors, stated = _stated_positions(lied)
    fixes = lied.fixes.copy()
    for robot, place, right in zip(anchors, stated, truth[anchors], strict=True):
        of_robot = fixes[:, 0] == robot
        fixes[of_robot, 4] += fixes[of_robot, 1:4] @ (right - place)

    estimate = localize(replace(lied, fixes=fixes), JOINT)

    assert estimate.convergence.trusted
    assert not len(estimate.outlier_places)
    assert estimate.position[anchors] == pytest.approx(truth[anchors], abs=0.01)


def test_a_planar_robot_stays_in_its_plane_without_its_known_position():
    """Only where it is in the plane is left out."""
    noisy = SensingParams(tilt_noise_deg=1.0)
    log, truth = grown(TowerParams(plane=True), 12, 31, noisy, RobotGeometry())
    lied = lies.wrong_anchor(log, truth, np.random.default_rng(3))
    anchors, _ = _stated_positions(lied)
    posed = Posed(lied, JOINT, pose_problem(lied, JOINT))

    without = without_anchors(posed, anchors[:1]).log

    planar = [set(sensed.fixes[in_plane(sensed), 0].tolist()) for sensed in (log, lied, without)]
    assert planar[0] == planar[1] == planar[2] >= {*range(1, log.robot_count)}
    assert _stated_positions(without)[0].tolist() == anchors[1:].tolist()


def test_losses_are_those_of_cauchy_and_of_squares(tower):
    """By hand: k^2 log(1 + r^2 / (k^2 v)) with a width of k standard deviations, or r^2 / v."""
    log, truth = tower
    rows = measure(log, ["contacts"]).associated(truth / log.dock_radius)
    residual = np.linspace(-5.0, 5.0, len(rows))

    robust = WholeCost(log, rows, robust_sd=3.0).losses(residual)
    square = WholeCost(log, rows).losses(residual)

    assert square == pytest.approx(residual**2 / rows.variance())
    assert robust == pytest.approx(9.0 * np.log1p(square / 9.0))
