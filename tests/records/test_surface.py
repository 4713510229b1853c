"""The surface of uneven ground, as runs keep it beside a case."""

import dataclasses

import numpy as np
import pytest

from tiswarm.base.errors import InputError
from tiswarm.records.surface import SURFACE_FILE, GroundSurface, read_surface, write_surface

SURFACE = GroundSurface(
    corner=np.array([-3.0, 2.0]),
    cell=0.5,
    height=np.random.default_rng(1).normal(size=(9, 7)),
    foot_dock=np.array([[0, 2], [4, 1]]),
    foot=np.array([[-1.0, 3.0, 0.5], [0.5, 4.0, -0.25]]),
)


def test_a_surface_is_read_as_it_was_written(tmp_path):
    """To the bit, its feet too."""
    path = tmp_path / SURFACE_FILE
    write_surface(path, SURFACE)

    surface = read_surface(path)

    for field in dataclasses.fields(GroundSurface):
        np.testing.assert_array_equal(getattr(surface, field.name), getattr(SURFACE, field.name))


DAMAGED = {
    "no number": {"height": np.full((9, 7), np.nan)},
    "one row": {"height": np.zeros((1, 7))},
    "no cell": {"cell": 0.0},
    "a foot too many": {"foot": np.zeros((3, 3))},
    "a dock before the first": {"foot_dock": np.array([[0, -1], [4, 1]])},
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_surface_is_refused(tmp_path, name):
    """In a line, whatever is wrong with it."""
    path = tmp_path / SURFACE_FILE
    write_surface(path, dataclasses.replace(SURFACE, **DAMAGED[name]))

    with pytest.raises(InputError, match="damaged"):
        read_surface(path)


def test_a_file_that_is_cut_off_is_refused(tmp_path):
    """As a full disk leaves it."""
    path = tmp_path / SURFACE_FILE
    write_surface(path, SURFACE)
    path.write_bytes(path.read_bytes()[:-200])

    with pytest.raises(InputError, match="damaged"):
        read_surface(path)


def test_a_file_with_other_bytes_is_refused(tmp_path):
    """Wherever in the compressed heights."""
    path = tmp_path / SURFACE_FILE
    write_surface(path, SURFACE)
    whole = path.read_bytes()
    refused = 0

    for place in range(100, len(whole) - 100, 37):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        try:
            read_surface(path)
        except InputError:
            refused += 1

    assert refused > 10


def test_heights_between_those_of_a_surface_are_bilinear():
    """Beyond its border there are none."""
    corners = SURFACE.height[2:4, 3:5]
    place = SURFACE.corner + 0.5 * np.array([[2.25, 3.5], [2.0, 3.0], [-0.5, 1.0]])

    height = SURFACE.height_at(place)

    between = 0.5 * (
        0.75 * (corners[0, 0] + corners[0, 1]) + 0.25 * (corners[1, 0] + corners[1, 1])
    )
    np.testing.assert_allclose(height, [between, SURFACE.height[2, 3], np.nan], atol=1e-12)


def test_a_thinned_surface_covers_the_same_places():
    """With fewer heights, which are those of the surface there."""
    thin = SURFACE.thinned(5)

    x, y = (thin.corner[k] + thin.cell * np.arange(thin.height.shape[k]) for k in range(2))
    places = np.stack(np.meshgrid(np.minimum(x, SURFACE.end[0]), np.minimum(y, SURFACE.end[1]),
                                  indexing="ij"), axis=-1).reshape(-1, 2)  # fmt: skip
    assert max(thin.height.shape) <= 5
    assert (thin.end >= SURFACE.end - 1e-12).all()
    np.testing.assert_allclose(thin.height.ravel(), SURFACE.height_at(places), atol=1e-12)


def test_faces_of_a_surface_look_up():
    """Four corners each, counterclockwise from above."""
    faces = SURFACE.faces()

    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    assert faces.shape == (48, 4, 3)
    assert (normal[:, 2] > 0.0).all()


def test_a_moved_surface_moves_with_its_feet():
    """By the same vector."""
    by = np.array([1.0, -2.0, 0.5])

    moved = SURFACE.moved(by)

    place = np.array([[-2.2, 3.1]])
    np.testing.assert_allclose(moved.height_at(place + by[:2]), SURFACE.height_at(place) + by[2])
    np.testing.assert_allclose(moved.foot, SURFACE.foot + by)
