"""Pictures show the ground that the robots stand on, with its edges."""

import numpy as np
import pytest

from tiswarm.records.terrain import Terrain
from tiswarm.report.pictures.scene import lay_ground
from tiswarm.report.swarm_view import ground_pieces

PLANE, SLAB, GAP = Terrain(), Terrain(left_edge=0.0), Terrain(left_edge=0.0, right_edge=20.0)
DOCKS = np.array([[-9.0, -4.0, 1.0], [-2.0, 5.0, 1.0], [8.0, 0.0, 1.0], [24.0, 1.0, 1.0]])


@pytest.mark.parametrize(("terrain", "pieces"), [(PLANE, 1), (SLAB, 1), (GAP, 2)])
def test_faces_cover_the_ground_and_look_outward(terrain, pieces):
    """Every corner lies on the ground's surface, and the ground surrounds the docks on it."""
    found = ground_pieces(terrain, DOCKS)

    assert len(found) == pieces
    faces = np.concatenate(found)
    corners = faces.reshape(-1, 3)
    np.testing.assert_allclose(terrain.depth(corners, 0.0), 0.0, atol=1e-12)
    a, b, c, d = faces.transpose(1, 0, 2)
    outward = np.cross(c - a, d - b)
    raised = faces.mean(axis=1) + 0.05 * outward / np.linalg.norm(outward, axis=1)[:, None]
    on_top = np.abs(outward[:, 1]) < 1e-9
    assert (terrain.depth(raised, 0.0)[on_top] < 0.0).all()
    sides = outward[~on_top, 1] * (faces[~on_top, 0, 1] - DOCKS[:, 1].mean())
    assert (sides > 0.0).all()
    assert (corners.min(axis=0) <= [-9.0, -4.0, 0.0]).all()


def test_rays_meet_a_slab_where_its_surface_is():
    """Hits lie on the surface between the cut sides, and normals look toward the eye."""
    ground = lay_ground(GAP, DOCKS, np.array([[0.0, 0.0, 3.0, 1.45]]))
    eye = np.array([12.0, -80.0, 20.0], np.float32)
    aim = np.random.default_rng(0).uniform([-25.0, -9.0, -4.0], [45.0, 9.0, 1.0], (4000, 3))

    depth, normal = ground.cast(eye, (aim - eye).astype(np.float32))

    hit = np.isfinite(depth)
    points = eye + depth[hit, None] * (aim[hit] - eye)
    on_surface = np.abs(GAP.depth(points, 0.0)) < 1e-3
    cut = (GAP.depth(points, 0.0) > -1e-3) & (np.abs(np.abs(normal[hit][:, 1]) - 1.0) < 1e-6)
    rear = np.abs(normal[hit][:, 0]) == 1.0
    assert (on_surface | cut | rear).all()
    assert ((normal[hit] * (eye - points)).sum(axis=1) >= 0.0).all()
    inside = (GAP.depth(aim, 0.0) > 0.1) & (aim[:, 0] > -11.0) & (aim[:, 0] < 26.0)
    assert hit[inside & (np.abs(aim[:, 1]) < 6.0)].all()


def test_no_dock_on_a_plane_means_no_ground():
    """A log without a dock on the ground shows robots before white."""
    aloft = np.add(DOCKS, [0.0, 0.0, 5.0])

    assert lay_ground(PLANE, aloft, np.empty((0, 4))) is None
    assert ground_pieces(PLANE, aloft) == []
