"""Errors that equations share count once, and what is left of them is told."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.structures import with_directions
from tiswarm.localization.joint import refine as module
from tiswarm.localization.joint.problem import pose_problem
from tiswarm.localization.joint.refine import is_of_use, refine
from tiswarm.localization.joint.settings import RefineSettings
from tiswarm.localization.params import LARGE, JointParams
from tiswarm.localization.registry import localize
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import CENTER
from tiswarm.robot import RobotGeometry
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams

NOISY = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0)
BIASED = dataclasses.replace(NOISY, yaw_bias_deg=20.0, spawn_noise=0.0)
ALL = JointParams()
UNIT = 1e-6


def _problem(known):
    curved = np.zeros(len(known.variance))
    return module._LeastSquares(known.rows, curved, known.yaw_precision)  # noqa: SLF001


def _state(position, yaw, turn):
    return module._State(position, yaw, turn)  # noqa: SLF001


def _sensed(log):
    """Orientations in the order of the walks: a robot's stances, its final one last."""
    start, every = log.stances.start, log.stances.orientation_wxyz
    rows = []
    for j in range(log.robot_count):
        rows += [*every[start[j] : start[j + 1]], log.orientation_wxyz[j]]
    return Rotation.from_quat(np.array(rows), scalar_first=True)


def _walked_slowly(log, known, state):
    """Docks and centers at every stance, flip by flip, back from where robots stand at last."""
    sd = np.radians([log.noise.tilt_deg, log.noise.tilt_deg, log.noise.yaw_deg])
    owner = known.rows.odometry.owner
    yaw = Rotation.from_rotvec(np.array([0.0, 0.0, 1.0]) * state.yaw[owner, None])
    true = Rotation.from_rotvec(-state.turn * sd) * yaw * _sensed(log)
    center = np.zeros((len(owner), 3))
    dock = np.array([true.apply(d) for d in log.dock_offset_body]).swapaxes(0, 1)
    pivot = iter(log.stances.pivot_dock[::-1])
    for s in range(len(owner) - 1, -1, -1):
        if s == known.rows.odometry.final[owner[s]]:
            center[s] = state.position[owner[s]]
        else:
            held = next(pivot)
            center[s] = center[s + 1] + dock[s + 1, held] - dock[s, held]
    return center[:, None] + dock, center


@pytest.mark.parametrize("noise", [NOISY, BIASED, dataclasses.replace(NOISY, spawn_noise=0.3)])
def test_residuals_are_those_of_walks_taken_flip_by_flip(towers, noise):
    """Wherever robots are, and however wrong their orientations."""
    log = observe(towers[0], noise)
    known = pose_problem(log, ALL)
    draw = np.random.default_rng(1)
    state = _state(
        towers[0].position + draw.normal(size=(log.robot_count, 3)),
        draw.normal(size=log.robot_count) * (noise is BIASED),
        draw.normal(size=(len(known.rows.odometry.owner), 3)),
    )
    dock, center = _walked_slowly(log, known, state)

    problem = _problem(known)
    residual = problem.linearized(state, np.ones(log.robot_count)).residual

    expected = []
    for robot, stance, own, other, its in known.rows.sensed_contacts.tolist():
        here = dock[known.rows.odometry.first[robot] + stance, own]
        there = dock[known.rows.odometry.final[other], its]
        expected.append(np.linalg.norm(here - there) - log.spacing)
    places = known.rows.places
    for row, own, direction, variance in zip(
        places.stance, places.dock, places.direction, places.own_variance, strict=True
    ):
        axis = int(direction.argmax())
        if own != CENTER:
            expected.append(dock[row, own, axis] - log.dock_radius - log.ground_z)
        elif axis == 2 and variance == pytest.approx(ALL.height_sd**2):
            expected.append(center[row, 2] - log.ground_z - log.dock_radius)
        else:
            robot = known.rows.odometry.owner[row]
            expected.append(center[row, axis] - log.spawn_position[robot, axis])
    np.testing.assert_allclose(residual, expected, atol=1e-9)


@pytest.mark.parametrize("robots", [[], range(0, 30, 2), None])
def test_nothing_is_left_where_robots_truly_are(towers, robots):
    """With the turns that orientations were sensed with, however large, and with directions."""
    noise = SensingParams(tilt_noise_deg=10.0, yaw_noise_deg=20.0, spawn_noise=0.0)
    for history in towers:
        log = with_directions(observe(history, noise), history, sd_deg=0.0, robots=robots)
        known = pose_problem(log, dataclasses.replace(ALL, height=False))
        true = np.concatenate([walk.orientation_wxyz for walk in history.walks])
        wrong = (_sensed(log) * Rotation.from_quat(true, scalar_first=True).inv()).as_rotvec()
        turn = wrong / np.radians([10.0, 10.0, 20.0])
        state = _state(history.position, np.zeros(log.robot_count), turn)

        residual = _problem(known).linearized(state, np.ones(log.robot_count)).residual

        offsets = len(known.rows.offsets.stance)
        assert offsets == 0 or robots != []
        # Gaps of docks shorten what is left of a vector of length D.
        assert -1e-9 - 0.02 * (offsets > 0) < residual.min() <= residual.max() < 0.02 + 1e-9


@pytest.mark.parametrize(("noise", "robots"), [(NOISY, []), (BIASED, []), (NOISY, None)])
def test_derivatives_are_those_of_the_residuals(towers, noise, robots):
    """To all unknowns, and to turns of earlier stances, at no turn."""
    log = with_directions(observe(towers[0], noise), towers[0], sd_deg=1.0, robots=robots)
    known = pose_problem(log, ALL)
    robots, stances = log.robot_count, len(known.rows.odometry.owner)
    draw = np.random.default_rng(2)
    at = _state(
        towers[0].position + 0.1 * draw.normal(size=(robots, 3)),
        0.3 * draw.normal(size=robots) * (noise is BIASED),
        np.zeros((stances, 3)),
    )
    problem = _problem(known)
    linear = problem.linearized(at, np.ones(robots))
    shift, yaw, turn = (draw.normal(size=part.shape) for part in at)
    shift[0] = 0.0
    yaw *= noise is BIASED
    unknown = np.concatenate([shift.ravel(), turn[known.rows.odometry.final].ravel(), yaw])[
        linear.free
    ]
    slope = linear.jacobian @ unknown + linear.noise @ turn.ravel()[problem.earlier]

    def residual(by):
        moved = _state(*(a + by * d for a, d in zip(at, (shift, yaw, turn), strict=True)))
        return problem.linearized(moved, np.ones(robots)).residual

    np.testing.assert_allclose((residual(UNIT) - residual(-UNIT)) / (2.0 * UNIT), slope, atol=1e-5)


def test_steps_and_variances_are_those_of_generalized_least_squares(towers):
    """Written out with dense matrices."""
    log = observe(towers[0], NOISY)
    known = pose_problem(log, ALL)
    robots = log.robot_count
    state = _state(
        towers[0].position, np.zeros(robots), np.zeros((len(known.rows.odometry.owner), 3))
    )
    problem = _problem(known)
    linear = problem.linearized(state, np.full(robots, 0.7))
    jacobian, noise = linear.jacobian.toarray(), linear.noise.toarray()
    weight = np.linalg.inv(noise @ noise.T + np.diag(linear.own_variance))
    posterior = np.linalg.inv(
        jacobian.T @ weight @ jacobian + np.diag(linear.precision[linear.free])
    )
    step = -posterior @ jacobian.T @ weight @ linear.residual
    turn = -noise.T @ weight @ (linear.residual + jacobian @ step)

    found = problem.solved(state, state, linear)
    variance = linear.variance()

    shift = 3 * (robots - 1)
    moved = (found.position - state.position)[1:]
    assert np.linalg.norm(moved, axis=1).max() < RefineSettings.longest_step
    np.testing.assert_allclose(moved.ravel(), step[:shift], atol=1e-9)
    assert not state.turn.any()  # it was not written to
    turned = found.turn.ravel()
    np.testing.assert_allclose(turned[problem.final], step[shift:], atol=1e-9)
    np.testing.assert_allclose(turned[problem.earlier], turn, atol=1e-9)
    true = np.diag(posterior)[:shift].reshape(-1, 3).sum(axis=1)
    assert variance[0] == 0.0
    # Of 64 draws in three dimensions each is uncertain by a tenth or so, their mean by less.
    assert np.abs(np.log(variance[1:] / true)).max() < 0.6
    assert np.mean(variance[1:] / true) == pytest.approx(1.0, abs=0.1)


def test_only_noisy_walks_are_refined_and_no_great_bias(towers):
    """Else nothing changes, to the last bit."""
    quiet, noisy = observe(towers[0], SensingParams()), observe(towers[0], NOISY)
    biased, mild = (
        observe(towers[0], dataclasses.replace(BIASED, yaw_bias_deg=bias)) for bias in (20.0, 10.0)
    )
    final = JointParams(walk_contacts=False, steps=500, chains=2, hold_steps=100)

    assert is_of_use(pose_problem(noisy, ALL))
    assert is_of_use(pose_problem(mild, ALL))
    assert not is_of_use(pose_problem(biased, ALL))
    assert not is_of_use(pose_problem(quiet, ALL))
    assert not is_of_use(pose_problem(noisy, final))
    assert not is_of_use(pose_problem(mild, dataclasses.replace(ALL, solve_yaw=False)))
    estimates = [
        localize(noisy, dataclasses.replace(final, refine=choice)) for choice in (True, False)
    ]
    np.testing.assert_array_equal(*(estimate.position for estimate in estimates))
    assert ALL.refines(LARGE)
    assert not ALL.refines(LARGE + 1)
    assert dataclasses.replace(ALL, refine=True).refines(LARGE + 1)


def test_robots_end_nearer_and_it_is_told_how_near(towers):
    """Than where chains that know nothing of shared errors ended, in every structure."""
    within = []
    for history in towers:
        log = observe(history, NOISY)
        before, after = (
            localize(log, dataclasses.replace(ALL, refine=choice)) for choice in (False, True)
        )
        far, near = (
            np.linalg.norm(estimate.position - history.position, axis=1)[1:]
            for estimate in (before, after)
        )
        assert np.sqrt((near**2).mean()) < np.sqrt((far**2).mean())
        np.testing.assert_array_equal(after.trace[-1], after.position)
        within += list(near / after.sd[1:])

    assert 0.6 < np.sqrt(np.mean(np.square(within))) < 1.4


def test_contacts_that_are_not_trusted_do_not_pull(towers):
    """A contact with a dock that is far off moves nobody."""
    log = observe(towers[0], NOISY)
    known = pose_problem(log, ALL)
    robots, count = log.robot_count, len(known.robot)
    rows = known.rows
    dock = rows.distances.other_dock.copy()
    dock[-1] = (dock[-1] + 1) % 3
    distances = rows.distances._replace(other_dock=dock)
    wrong = Measurements.gather(rows.odometry, [distances], [rows.places])
    trusted = np.arange(len(rows)) != count - 1
    args = (known, towers[0].position, np.zeros(robots), np.full(robots, 0.3))
    none = np.zeros(count)

    right, without, misled = (
        refine(*args, rows, none).position,
        refine(*args, wrong.select(trusted), none[1:]).position,
        refine(*args, wrong, none).position,
    )

    np.testing.assert_array_equal(without, refine(*args, rows.select(trusted), none[1:]).position)
    assert np.abs(misled - right).max() > 2.0 * np.abs(without - right).max()


def test_of_what_nothing_holds_chains_tell_how_far_off_it_is(towers):
    """A robot of one contact and no height turns about it, whatever else is known."""
    log = observe(towers[0], NOISY)
    known = pose_problem(log, ALL)
    robots = log.robot_count
    alone = robots - 1
    trusted = known.rows.robot != alone
    trusted[: len(known.other)] &= known.other != alone
    sd = np.full(robots, 0.3)
    rows = known.rows.select(trusted)
    curved = np.zeros(len(rows.other))

    found = refine(known, towers[0].position, np.zeros(robots), sd, rows, curved)

    assert found.sd[alone] == sd[alone]
    assert np.median(found.sd[1:alone] / sd[1:alone]) < 0.5


def test_chains_do_not_hold_back_what_many_robots_share():
    """All of 300 moved alike go back, though each by itself was off by what is likely."""
    robots, off = 300, 0.3
    params = TowerParams(force_threshold=1e9)
    (history,) = grow(params, robots=robots, seeds=[5], robot=RobotGeometry())
    log = observe(history, NOISY)
    known = pose_problem(log, dataclasses.replace(ALL, contact_sd=np.sqrt(0.1)))
    count = len(known.robot)
    rest = (np.zeros(robots), np.full(robots, off), known.rows, np.zeros(count))
    moved = history.position.copy()
    moved[1:, 0] += off

    there, back = (refine(known, at, *rest).position for at in (history.position, moved))

    assert np.linalg.norm(back - there, axis=1).mean() < 0.03 * off
