"""Rigid motions that no measurement resists, and configurations aligned along them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests import foreign
from tests.strategies import rotations, unit_vectors
from tests.structures import with_directions
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.turns import Turn, align, free_frame
from tiswarm.sensing import SensingParams, observe

ROBOTS = 8
EVERYONE = np.ones(ROBOTS, np.bool_)


def frame(axes, moves=EVERYONE, *, is_hand_free=True):
    """Free turns about the first robot."""
    return Turn(moves, np.zeros(1, np.int64), axes, is_hand_free=is_hand_free)


FREE = frame(np.eye(3))
MIRROR = np.diag([-1.0, 1.0, 1.0])


def ranged(seed=0, **known):
    """Robots that know all their distances, and more of each other or of the world."""
    log, place = foreign.without_beacons(ROBOTS, seed)
    if heights := known.get("heights"):
        level = np.full(ROBOTS, np.nan)
        level[heights] = place[heights, 2]
        log = replace(log, flip_height=level, ground_z=0.0)
    if fixed := known.get("fixed"):
        log = foreign.with_places(log, place, fixed)
    return log, place / log.dock_radius


def frame_of(log, position, moves=EVERYONE):
    """Free frame of a log."""
    return free_frame(pose_problem(log, JointParams()).rows, position, moves)


def turned(position, matrix):
    """Multiply arms from the anchor by a matrix."""
    return position[0] + (position - position[0]) @ matrix


@pytest.mark.parametrize("seed", range(3))
def test_ranges_alone_leave_every_rotation_and_the_hand(seed):
    """About the anchor, whose position is known."""
    frame = frame_of(*ranged(seed))

    assert frame.names == ("rotation", "hand")
    np.testing.assert_allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("heights", [[1, 2, 3], [*range(1, ROBOTS)]])
def test_heights_leave_a_turn_about_the_vertical_and_the_hand(heights):
    """The mirror plane contains the axis, so that no height changes."""
    frame = frame_of(*ranged(heights=heights))

    assert frame.names == ("axis", "hand")
    np.testing.assert_allclose(np.abs(frame.axes), [[0.0, 0.0, 1.0]], atol=1e-6)


def test_one_robot_at_a_known_place_leaves_a_turn_about_the_line_to_it():
    """And a mirror image in any plane through that line."""
    log, position = ranged(fixed=[3])
    along = (position[3] - position[0]) / np.linalg.norm(position[3] - position[0])

    frame = frame_of(log, position)

    assert frame.names == ("axis", "hand")
    np.testing.assert_allclose(np.abs(frame.axes @ along), [1.0], atol=1e-9)


def test_two_robots_at_known_places_leave_no_motion():
    """A mirror image in the plane of three known robots is a second solution, not a frame."""
    frame = frame_of(*ranged(fixed=[3, 5]))

    assert frame.names == ()


def test_a_line_of_robots_does_not_turn_about_itself():
    """So one robot at a known place holds it; ranges alone do not."""
    place = np.outer(np.arange(ROBOTS), [0.6, 0.0, 0.8])
    line = foreign.with_all_ranges(foreign.silent(place), place, sd=0.1, seed=0)
    held = foreign.with_places(line, place, [ROBOTS - 1])

    free, fixed = (frame_of(log, place / log.dock_radius) for log in (line, held))

    assert free.names == ("rotation", "hand")
    assert fixed.names == ()


def test_contacts_and_directions_leave_no_motion(tall_towers):
    """Orientations are sensed, so that arms of docks do not turn with the swarm."""
    log = observe(tall_towers[0], SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=1.0))
    directed = with_directions(log, tall_towers[0], sd_deg=1.0)
    moves = np.ones(30, np.bool_)

    names = [frame_of(each, tall_towers[0].position, moves).names for each in (log, directed)]

    assert names == [(), ()]


def test_robots_that_do_not_move_hold_no_frame():
    """A part that nothing ties to the anchor has its own place; the anchor alone has no frame."""
    log, position = ranged()
    apart = replace(log, ranges=log.ranges[(log.ranges[:, 0] < 6) | (log.ranges[:, 1] >= 6)])
    moves = np.arange(ROBOTS) < 6

    assert frame_of(apart, position, moves).names == ("rotation", "hand")
    assert frame_of(log, position, np.arange(ROBOTS) < 1).names == ()


@given(seed=st.integers(0, 99), turn=rotations, is_mirrored=st.booleans())
def test_a_turned_or_mirrored_copy_comes_back(seed, turn, is_mirrored):
    """To 1e-9: alignment is a rigid motion about the anchor that may change the hand."""
    position = np.random.default_rng(seed).normal(size=(ROBOTS, 3))
    matrix = Rotation.from_quat(turn, scalar_first=True).as_matrix()
    copy = turned(position, matrix @ MIRROR if is_mirrored else matrix)

    (motion,) = align(copy[None], position, FREE)

    np.testing.assert_allclose(motion.T @ motion, np.eye(3), atol=1e-9)
    assert np.linalg.det(motion) == pytest.approx(-1.0 if is_mirrored else 1.0)
    np.testing.assert_allclose(turned(copy, motion), position, atol=1e-9)


@given(seed=st.integers(0, 99), axis=unit_vectors, angle=st.floats(-3.0, 3.0), hand=st.booleans())
def test_a_copy_turned_about_an_axis_comes_back_about_it(seed, axis, angle, hand):
    """The motion keeps the axis; a mirror image is taken in a plane through it."""
    position = np.random.default_rng(seed).normal(size=(ROBOTS, 3))
    matrix = Rotation.from_rotvec(angle * axis).as_matrix()
    across = np.cross(axis, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across)
    mirror = np.eye(3) - 2.0 * np.outer(across, across)
    copy = turned(position, matrix @ mirror if hand else matrix)

    (motion,) = align(copy[None], position, frame(axis[None]))

    np.testing.assert_allclose(motion.T @ motion, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(axis @ motion, axis, atol=1e-9)
    np.testing.assert_allclose(turned(copy, motion), position, atol=1e-9)


@given(seed=st.integers(0, 99), turn=rotations)
def test_a_mirror_image_stays_one_where_the_hand_is_known(seed, turn):
    """Then only turns align, and the nearest of them leaves the image apart."""
    position = np.random.default_rng(seed).normal(size=(ROBOTS, 3))
    matrix = Rotation.from_quat(turn, scalar_first=True).as_matrix() @ MIRROR

    (motion,) = align(
        turned(position, matrix)[None], position, frame(np.eye(3), is_hand_free=False)
    )

    assert np.linalg.det(motion) == pytest.approx(1.0)


def test_alignment_is_to_the_nearest_and_by_robots_that_move_alone():
    """No other turn brings the copies nearer; robots of other parts do not count."""
    rng = np.random.default_rng(0)
    position, moves = rng.normal(size=(ROBOTS, 3)), np.arange(ROBOTS) < 6
    copies = turned(position, Rotation.random(random_state=1).as_matrix())
    copies = copies + 0.2 * rng.normal(size=(3, ROBOTS, 3))
    copies[:, 0] = position[0]
    off = copies.copy()
    off[:, 6:] += 99.0

    motions = align(copies, position, frame(np.eye(3), moves))

    np.testing.assert_allclose(align(off, position, frame(np.eye(3), moves)), motions, atol=1e-12)
    for copy, motion in zip(copies, motions, strict=True):
        least = np.linalg.norm((turned(copy, motion) - position)[moves])
        for near in Rotation.from_rotvec(1e-3 * rng.normal(size=(20, 3))).as_matrix():
            assert np.linalg.norm((turned(copy, motion @ near) - position)[moves]) >= least


def test_nothing_moves_without_a_free_frame():
    """Copies are left as they are."""
    position = np.random.default_rng(0).normal(size=(2, ROBOTS, 3))
    nothing = frame(np.empty((0, 3)), is_hand_free=False)

    motions = align(position, position[0], nothing)

    np.testing.assert_array_equal(motions, np.tile(np.eye(3), (2, 1, 1)))
