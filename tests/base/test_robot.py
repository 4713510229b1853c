"""Robots have their docks where their shape, or their list of docks, places them."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from tiswarm.base.robot import FIREANT_RHO, SHAPES, RobotGeometry

EDGES = {  # edge of the regular shape whose corners are 1 from the center
    "line": 2.0,
    "triangle": np.sqrt(3.0),
    "square": np.sqrt(2.0),
    "tetrahedron": np.sqrt(8.0 / 3.0),
    "octahedron": np.sqrt(2.0),
    "cube": 2.0 / np.sqrt(3.0),
}
CORNERS = {"line": 2, "triangle": 3, "square": 4, "tetrahedron": 4, "octahedron": 6, "cube": 8}


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_are_regular_and_lie_on_a_side(shape):
    """Every corner is alike; the lowest ones, three or all of a flat shape, are on the ground."""
    robot = RobotGeometry(shape=shape, rho=2.0)
    body = robot.dock_offset_body

    apart = np.sort(squareform(pdist(body)), axis=1)
    lowest = np.isclose(body[:, 2], body[:, 2].min()).sum()
    assert len(body) == robot.dock_count == CORNERS[shape]
    np.testing.assert_allclose(np.linalg.norm(body, axis=1), 2.0)
    np.testing.assert_allclose(body.sum(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(apart, np.tile(apart[0], (len(body), 1)), atol=1e-12)
    assert apart[0, 1] == pytest.approx(2.0 * EDGES[shape])
    assert lowest == (3 if shape in {"tetrahedron", "octahedron"} else min(len(body), 4))


@pytest.mark.parametrize("shape", SHAPES)
def test_robots_may_be_as_small_as_their_docks_allow(shape):
    """Docks of one robot may touch, and may not overlap."""
    least = 2.0 / EDGES[shape]

    assert RobotGeometry(shape=shape, rho=least * (1.0 + 1e-12)).rho >= least
    with pytest.raises(ValueError, match=r"overlap|greater than or equal to 1"):
        RobotGeometry(shape=shape, rho=0.999 * least)


def test_fireant_has_three_docks_in_its_plane():
    """The default, as the formula of the design files has it."""
    angle = np.deg2rad([0.0, 120.0, 240.0])
    expected = 1.506 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])

    np.testing.assert_allclose(RobotGeometry().dock_offset_body, expected, atol=1e-15)
    assert RobotGeometry() == RobotGeometry(shape="triangle", rho=FIREANT_RHO)


def test_docks_may_be_anywhere():
    """Listed docks replace those of the shape; distances from the center may differ."""
    docks = ((3.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    robot = RobotGeometry(docks=docks)

    np.testing.assert_array_equal(robot.dock_offset_body, docks)
    assert (robot.dock_count, robot.dock_distance, robot.extent) == (2, 2.0, 3.0)
