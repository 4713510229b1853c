"""Warnings name what is likely wrong with poses, and the number that shows it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.formats.test_imports import POSES, bring_in
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry

BODY = RobotGeometry().dock_offset_body
QUARTER = {axis: Rotation.from_euler(axis, 90.0, degrees=True) for axis in "xyz"}


@pytest.fixture(scope="module")
def pose(towers):
    """Positions and orientations of the first 12 robots of a tower, on the ground."""
    turn = Rotation.from_quat(towers[0].orientation_wxyz[:12], scalar_first=True)
    return towers[0].position[:12], turn


def imported(folder, position, turn, **known):
    """Import robots at some poses."""
    wxyz = turn.as_quat(scalar_first=True).tolist()
    rows = [[n, *p, *q] for n, (p, q) in enumerate(zip(position.tolist(), wxyz, strict=True))]
    return bring_in(folder, POSES, rows, **{"ground_z": 0.0, **known})


def test_right_poses_have_no_warning(pose, tmp_path):
    """Neither with docks that are given, nor with docks that are found."""
    for body in (BODY, None):
        assert imported(tmp_path, *pose, dock_offset_body=body).warnings == []


def test_quaternions_from_world_to_body_are_named_and_mended_by_an_option(pose, tmp_path):
    """The contacts that they would give are as many as there are."""
    position, turn = pose
    right = imported(tmp_path, position, turn)

    wrong = imported(tmp_path, position, turn.inv())
    mended = imported(tmp_path, position, turn.inv(), conjugate=True)

    count = len(right.log.contacts)
    (warning,) = wrong.warnings
    assert warning.endswith(f"turn world to body give {count}: add --conjugate")
    assert len(wrong.log.contacts) < count
    np.testing.assert_array_equal(mended.log.contacts, right.log.contacts)
    assert mended.warnings == []


def test_an_option_that_was_wrong_to_give_is_named(pose, tmp_path):
    """Poses that are right without an option are read as if another one were needed."""
    position, turn = pose
    count = len(imported(tmp_path, position, turn).log.contacts)

    (warning,) = imported(tmp_path, position, turn, conjugate=True).warnings

    assert warning.endswith(f"turn body to world give {count}: leave --conjugate out")


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("body", [BODY, None], ids=["given", "found"])
def test_bodies_that_are_turned_by_a_right_angle_are_named(pose, tmp_path, axis, body):
    """The warning has docks that put as many in contact as there are."""
    position, turn = pose
    count = len(imported(tmp_path, position, turn).log.contacts)

    found = imported(tmp_path, position, turn * QUARTER[axis], dock_offset_body=body)

    (warning,) = found.warnings
    docks = docks_in(warning)
    assert f"in the body frame give {count}: measure them, and give them by --docks" in warning
    mended = imported(tmp_path, position, turn * QUARTER[axis], dock_offset_body=docks)
    assert len(mended.log.contacts) == count


def docks_in(warning):
    """Read the places of docks in a warning."""
    places = warning.partition("docks at (")[2].partition(") in the body")[0]
    return np.array([[*map(float, place.split(","))] for place in places.split("), (")])


@pytest.mark.parametrize("off", [(0.3, -0.2, 0.4), (0.05, -0.1, 0.0)])
def test_a_tracked_point_off_the_center_is_named(pose, tmp_path, off):
    """Markers are seldom about the center: all docks are off by one vector of the body."""
    position, turn = pose
    count = len(imported(tmp_path, position, turn).log.contacts)

    found = imported(tmp_path, position + turn.apply(off), turn)

    (warning,) = found.warnings
    np.testing.assert_allclose(docks_in(warning), BODY - off, atol=0.01)
    assert f"give {count}: measure them" in warning


@pytest.mark.parametrize(("robots", "width"), [(12, 8.0), (40, 12.0), (40, 30.0)])
def test_poses_that_nothing_explains_get_no_wrong_advice(tmp_path, robots, width):
    """Robots at random touch under no meaning of their poses."""
    position = np.random.default_rng(0).uniform(0.0, width, (robots, 3))
    turn = Rotation.random(robots, random_state=robots)

    (warning,) = imported(tmp_path, position, turn).warnings

    assert "correct --dock-radius and --dock-offset" in warning


@pytest.mark.parametrize(
    ("up", "to_up"),
    [
        ("y", Rotation.from_euler("x", -90, degrees=True)),
        ("x", Rotation.from_euler("y", 90, degrees=True)),
        ("-z", Rotation.from_euler("x", 180, degrees=True)),
    ],
)
def test_another_axis_that_is_up_is_named_and_mended_by_an_option(pose, tmp_path, up, to_up):
    """Motion capture has y up by default: docks stand on the ground once that axis is z."""
    position, turn = pose
    right = imported(tmp_path, position, turn)

    wrong = imported(tmp_path, to_up.apply(position), to_up * turn)
    mended = imported(tmp_path, to_up.apply(position), to_up * turn, up=up)

    standing = len(right.log.ground_docks)
    (warning,) = wrong.warnings
    assert warning.startswith("no dock stands on the ground at z = 0, and ")
    assert warning.endswith(f"with {up} up, {standing} stand and none is below: give --up {up}")
    np.testing.assert_array_equal(mended.log.ground_docks, right.log.ground_docks)
    np.testing.assert_allclose(mended.position, right.position, atol=1e-12)
    assert mended.warnings == []


@pytest.mark.parametrize("stated", ["x", "y", "-z"])
@pytest.mark.parametrize(("up", "to_up"), [("z", Rotation.identity()), ("-y", QUARTER["x"])])
def test_an_axis_that_is_not_up_is_named_with_the_one_that_is(pose, tmp_path, stated, up, to_up):
    """The advice is about the axes of the file, however the wrong option turned them."""
    position, turn = pose
    standing = len(imported(tmp_path, position, turn).log.ground_docks)

    (warning,) = imported(tmp_path, to_up.apply(position), to_up * turn, up=stated).warnings

    advice = "leave --up out" if up == "z" else f"give --up {up}"
    assert warning.endswith(f"{standing} stand and none is below: {advice}")


def test_ground_that_is_stated_is_not_asked_for(pose, tmp_path):
    """Where no dock stands on it, a note proposes no option that was given."""
    position, turn = pose

    lacking = imported(tmp_path, position + np.array([0.0, 0.0, 3.0]), turn)
    without = imported(tmp_path, position, turn, ground_z=None)

    (note,) = [note for note in lacking.notes if note.startswith("the log lacks")]
    assert note.startswith("the log lacks ground contacts, heights (--heights)")
    (note,) = [note for note in without.notes if note.startswith("the log lacks")]
    assert note.startswith("the log lacks ground contacts (--ground-z), heights (--heights)")


def test_ground_at_another_height_is_named(pose, tmp_path):
    """The lowest dock says where the ground may be."""
    position, turn = pose

    (warning,) = imported(tmp_path, position - [0.0, 0.0, 3.0], turn).warnings

    assert warning.startswith("no dock stands on the ground at z = 0, and ")
    assert warning.endswith("the lowest reaches to z = -3: correct --ground-z or --up")


def test_an_axis_that_there_is_not_is_refused(pose, tmp_path):
    """The line has those that there are."""
    with pytest.raises(InputError, match="'Z' is no axis; use z, y, x, -z, -y, -x"):
        imported(tmp_path, *pose, up="Z")
