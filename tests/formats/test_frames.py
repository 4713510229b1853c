"""Poses in a tree of frames are composed up to its root as products of rigid motions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tiswarm.base.errors import InputError
from tiswarm.formats.frames import FrameTrack, to_root


def held(parent, motion, times=(0,)):
    """A frame that holds a pose, a matrix of shape (4, 4), in its parent."""
    count = len(times)
    turn = Rotation.from_matrix(motion[:3, :3]).as_quat(scalar_first=True)
    position = np.tile(motion[:3, 3], (count, 1))
    return FrameTrack(np.array(times), [parent] * count, position, np.tile(turn, (count, 1)))


def drawn_motion(rng):
    """A rigid motion, as a matrix of shape (4, 4)."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.random(rng=rng).as_matrix()
    motion[:3, 3] = rng.normal(size=3)
    return motion


@given(seed=st.integers(0, 2**32 - 1), depth=st.integers(0, 6))
def test_a_pose_is_the_product_of_the_motions_above_it(seed, depth):
    """The root is the first frame without a pose of its own."""
    rng = np.random.default_rng(seed)
    motions = [drawn_motion(rng) for _ in range(depth + 1)]
    frames = {f"f{k}": held(f"f{k - 1}", motions[k]) for k in range(1, depth + 1)}
    expected = np.eye(4)
    for motion in [*motions[1:], motions[0]]:
        expected = expected @ motion

    pose = to_root(held(f"f{depth}", motions[0], times=(0, 5)), frames)

    assert pose.parent == ["f0", "f0"]
    np.testing.assert_allclose(pose.position, np.tile(expected[:3, 3], (2, 1)), atol=1e-9)
    turns = Rotation.from_quat(pose.orientation_wxyz, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turns, np.tile(expected[:3, :3], (2, 1, 1)), atol=1e-9)


def test_a_frame_moves_evenly_between_its_poses():
    """Half of the time is half of the way and of the turn; before and after, the ends hold."""
    wxyz = Rotation.from_euler("z", [0.0, 90.0], degrees=True).as_quat(scalar_first=True)
    frame = FrameTrack(np.array([10, 20]), ["map", "map"], np.array([[0.0] * 3, [2.0] * 3]), wxyz)

    track = frame.at(np.array([0, 15, 30]))

    np.testing.assert_allclose(track.position[:, 0], [0.0, 1.0, 2.0])
    yaw = Rotation.from_quat(track.orientation_wxyz, scalar_first=True).as_euler(
        "zyx", degrees=True
    )
    np.testing.assert_allclose(yaw[:, 0], [0.0, 45.0, 90.0])


def test_a_frame_holds_until_it_has_another_parent():
    """Poses in different parents are not mixed."""
    still = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    frame = FrameTrack(
        np.array([0, 10]), ["left", "right"], np.array([[1.0] * 3, [9.0] * 3]), still
    )

    track = frame.at(np.array([4, 10]))

    assert track.parent == ["left", "right"]
    np.testing.assert_array_equal(track.position[:, 0], [1.0, 9.0])


def test_frames_in_a_circle_are_refused():
    """There is no root."""
    unmoved = np.eye(4)
    frames = {"a": held("b", unmoved), "b": held("a", unmoved)}

    with pytest.raises(InputError, match=r"the frame [ab] is above itself"):
        to_root(held("a", unmoved), frames)
