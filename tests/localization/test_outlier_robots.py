"""Robots whose orientations do not count, since all that they sensed disagrees with the rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.estimates.sets import TRAINING, wrong
from tests.structures import NOISY, grown
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import OutlierRobotSettings, outliers, verdict
from tiswarm.localization.mixture.assessment import assess
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.odometry import Odometry, stuck_robots
from tiswarm.measurements.verdicts import describe_outliers
from tiswarm.records.error_law import SURE
from tiswarm.records.estimate import MOST_MISFIT_SD, MOST_WITHIN
from tiswarm.sensing import observe
from tiswarm.world.params import TowerParams

pytestmark = pytest.mark.unchecked

DRIFT = np.radians([0.0, 9.0, 0.0])
"""Error that an orientation gains at each stance, about a horizontal axis. With 6 deg, one seed of
the annealer in two finds outliers among single measurements instead."""


@pytest.fixture(scope="module", params=[24, pytest.param(40, marks=pytest.mark.trial)])
def tower(request):
    """A tower of 24 robots, and of 40 in a trial."""
    return grown(TowerParams(), robots=request.param, seed=1000)


@pytest.fixture(scope="module")
def log(tower):
    """What its robots sensed, with the noise that is stated."""
    return observe(tower, NOISY)


@pytest.fixture(scope="module")
def robot(log):
    """The robot with the longest walk, which has most to say."""
    return int(np.diff(log.stances.start).argmax())


@pytest.fixture(scope="module")
def drifting(log, robot):
    """The same log, but that robot's IMU drifts."""
    return drifted(log, robot)


@pytest.fixture(scope="module")
def estimate(drifting):
    """Estimate of the log with one robot that drifts."""
    return localize(drifting, JointParams())


@pytest.fixture(scope="module")
def sound(log):
    """Estimate of the log without drift; fails if a search for outliers begins."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(outliers, "_next", None)
        return localize(log, JointParams())


def drifted(log, robot, drift=DRIFT):
    """Turn the orientations of a robot ever farther from stance to stance."""
    stances = log.stances
    begin, end = stances.start[robot : robot + 2]
    earlier, final = stances.orientation_wxyz.copy(), log.orientation_wxyz.copy()
    for step, stance in enumerate(range(begin, end)):
        earlier[stance] = _turned(earlier[stance], step * drift)
    final[robot] = _turned(final[robot], (end - begin) * drift)
    stances = replace(stances, orientation_wxyz=earlier)
    return replace(log, orientation_wxyz=final, stances=stances)


def _turned(wxyz, angle):
    turn = Rotation.from_rotvec(angle) * Rotation.from_quat(wxyz, scalar_first=True)
    return turn.as_quat(scalar_first=True)


def test_a_robot_whose_imu_drifts_is_named(estimate, robot):
    """Not its measurements one by one: all of them are wrong, and its neighbors are not."""
    assert estimate.outlier_robots.tolist() == [robot]


def test_an_estimate_with_outlier_robots_is_not_trusted(estimate):
    """The misfit was that robot's, but smaller drifts may be left, which turn the rest."""
    assert estimate.convergence.misfit_sd < MOST_MISFIT_SD
    assert not estimate.convergence.trusted
    assert estimate.convergence.reason == "the orientations of 1 robot are outliers"
    assert estimate.convergence.sd_factor > 1.0


def test_other_robots_are_within_their_sd_without_it(estimate, tower, robot):
    """Nine of ten should be within 1.6 sd; robots share errors, so a structure may have fewer."""
    away = np.linalg.norm(estimate.position - tower.position, axis=1)
    good = np.setdiff1d(np.arange(1, len(away)), robot)

    assert (away <= MOST_WITHIN * estimate.sd)[good].mean() > 0.8


def test_the_robot_that_is_named_is_less_certain_than_before(estimate, sound, robot):
    """Its contacts alone say where it is, with docks that point anywhere."""
    assert estimate.sd[robot] > 2.0 * sound.sd[robot]


@pytest.mark.parametrize("degrees", [0.0, 5.0])
def test_a_drift_that_the_sum_of_all_rows_hides_is_warned_of(monkeypatch, degrees):
    """The cost falls by more than chance explains without the orientations of the seventh robot."""
    history = grown(TowerParams(), robots=24, seed=1000)
    log = drifted(observe(history, NOISY), 7, np.radians([0.0, degrees, 0.0]))
    place = log.anchor_position + history.position - history.position[0]

    def judged():
        nowhere, sd = np.zeros(24, np.bool_), np.full(24, 0.5)
        found = assess(
            log, JointParams().used_cues, place / log.dock_radius, is_guess=nowhere, sd=sd
        )
        return found.convergence

    found = judged()
    monkeypatch.setattr(verdict, "gains_without", lambda *_: (np.zeros(16), np.zeros(16, int)))
    before = judged()

    assert before.trusted
    assert found.consistent == (not degrees)
    of_robot = "noise as stated does not explain the orientations of robot 7"
    assert found.reason == (of_robot if degrees else "")


def test_nobody_is_named_where_noise_explains_the_log(sound):
    """No search begins, so that such logs cost what they did and give the same bytes."""
    assert sound.convergence.consistent
    assert sound.outlier_robots is None


def test_the_robot_is_listed_with_its_line(estimate, drifting, robot):
    """Users find what to repair, beside the single measurements that are wrong."""
    lines = [*describe_outliers(drifting, Path("log.jsonl"), estimate)]

    assert lines[-1] == (
        f"log.jsonl:{robot + 2}: orientation_wxyz: robot {robot}'s orientation is an outlier: its "
        "measurements all disagree; look at its IMU"
    )


def test_no_robot_is_to_blame_for_docks_of_another_size(log):
    """A wrong header is in all measurements alike: the verdict stays, and names nobody."""
    found = localize(replace(log, dock_radius=1.05 * log.dock_radius), JointParams())

    assert not found.convergence.trusted
    assert found.outlier_robots is None


def test_too_many_outliers_are_none(drifting, monkeypatch):
    """Where a large part of the robots would have to be wrong, something else is."""
    monkeypatch.setattr(outliers, "OUTLIER_ROBOTS", OutlierRobotSettings(most=0.0))

    found = localize(drifting, JointParams())

    assert found.outlier_robots is None
    assert not found.convergence.consistent


def test_walks_of_a_robot_that_does_not_count_leave_no_rows(log, robot):
    """What others touched of it, and what it touches at the end, counts."""
    rows = pose_problem(log, JointParams()).rows
    left = pose_problem(log, JointParams(), np.array([robot])).rows

    dropped = rows.is_walked & (rows.robot == robot)
    assert dropped.any()
    assert len(left) == len(rows) - dropped.sum()
    assert not left.is_walked[left.robot == robot].any()


def test_widened_orientations_are_in_the_variance_of_arms(log, robot):
    """Arms of that robot are uncertain; those of others are as before."""
    walks = Odometry(log)
    wide = walks.widened(np.array([robot]), 0.1)
    stance, dock = walks.first, np.zeros(log.robot_count, int)

    before, after = walks.arms(stance, dock)[1], wide.arms(stance, dock)[1]

    others = np.arange(log.robot_count) != robot
    np.testing.assert_allclose(after[others], before[others], rtol=1e-9)
    assert (after[robot] > before[robot]).all()
    axes = np.eye(3)
    along = wide.variance_along(axes, np.repeat(stance[robot], 3), np.zeros(3, int))
    np.testing.assert_allclose(after[robot], along)


@pytest.fixture(scope="module")
def stuck(log):
    """The same log, but the orientation sensors of two robots repeat their first values."""
    orientation, earlier = log.orientation_wxyz.copy(), log.stances.orientation_wxyz.copy()
    for robot in np.argsort(-np.diff(log.stances.start))[:2]:
        begin, end = log.stances.start[robot : robot + 2]
        earlier[begin:end] = orientation[robot] = earlier[begin]
    stances = replace(log.stances, orientation_wxyz=earlier)
    return replace(log, orientation_wxyz=orientation, stances=stances)


def test_robots_whose_sensors_are_stuck_are_named(log, stuck):
    """A flip turns the body: a value that stays the same to the last bit is none of a compass."""
    found = localize(stuck, JointParams())

    expected = np.sort(np.argsort(-np.diff(log.stances.start))[:2])
    np.testing.assert_array_equal(stuck_robots(stuck), expected)
    np.testing.assert_array_equal(found.outlier_robots, expected)
    assert not found.convergence.trusted


def test_stuck_sensors_are_named_where_nobody_looks_for_outliers(stuck, monkeypatch):
    """A structure that is too large to be refined still warns."""
    monkeypatch.setattr(outliers, "disregard", lambda *_: None)

    found = localize(stuck, JointParams())

    assert len(found.outlier_robots) == 2
    assert not found.convergence.trusted


def test_a_structure_of_many_mute_robots_is_not_trusted(tower):
    """Others lose their contacts with these, and noise explains what is left."""
    silent = observe(tower, replace(NOISY, mute=0.3))
    mute = int(np.isnan(silent.orientation_wxyz[:, 0]).sum())

    found = localize(silent, JointParams())

    assert not found.convergence.trusted
    assert found.convergence.reason == f"{mute} robots sensed nothing that shows their orientation"


def test_working_sensors_are_not_stuck(log):
    """Robots without flips have one value, which repeats nothing."""
    assert not len(stuck_robots(log))
    assert not len(stuck_robots(replace(log, stances=None)))


def test_a_mute_robot_hides_none_that_drifts(tower):
    """No connections chain its orientation, so that errors of others stay their own."""
    silent = observe(tower, replace(NOISY, mute=0.1))
    robot = int(np.diff(silent.stances.start).argmax())

    found = localize(drifted(silent, robot), JointParams())

    assert np.isnan(silent.orientation_wxyz).any()
    assert robot in found.outlier_robots


def test_robots_that_drift_are_named_where_docks_overlap():
    """With all orientations, docks overlap at the least cost, so that no row is said to be wrong.

    Without those that drift no robot that is said to be within R is farther off.
    """
    case = wrong(TRAINING + 28)

    estimate = localize(case.log, JointParams())

    assert estimate.convergence.converged
    assert "orientations of" in estimate.convergence.reason
    off = np.linalg.norm(estimate.position - case.truth, axis=1) / case.log.dock_radius
    is_sure = estimate.within(case.log.dock_radius) >= SURE
    assert (off[is_sure] < 1.0).all()
