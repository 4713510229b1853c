"""The ground is where it says, and docks meet it exactly where they first touch it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import oracle, oracle_terrain
from tests.strategies import unit_vectors
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.lang import Reals2, ti
from tiswarm.records.terrain import Terrain
from tiswarm.world.climb_kernels import ClimbLimits, slab_angles
from tiswarm.world.params import ClimbParams
from tiswarm.world.walks import climb_limits

FULL_TURN = 2.0 * np.pi
ROBOT = RobotGeometry()
ARM = np.sqrt(3.0) * ROBOT.rho
"""Distance between two docks of a robot [R]."""

PLANE = Terrain(ground_z=-0.5)
SLAB = Terrain(left_edge=0.0)
GAP = Terrain(ground_z=0.25, left_edge=0.5, right_edge=4.5)

places = st.tuples(st.floats(-6.0, 11.0), st.floats(-3.0, 3.0), st.floats(-9.0, 6.0)).map(np.array)
"""Around both edges of `GAP`, above and below it."""


@ti.kernel
def _slab_angles(law: ClimbLimits, path: Reals2, angles: Reals2):
    for i in range(path.shape[0]):
        middle = ti.Vector([path[i, 0], path[i, 1], path[i, 2]])
        across = ti.Vector([path[i, 3], path[i, 4], path[i, 5]])
        onward = ti.Vector([path[i, 6], path[i, 7], path[i, 8]])
        left = slab_angles(middle, across, onward, law.left_edge, 1.0, law)
        right = slab_angles(middle, across, onward, law.right_edge, -1.0, law)
        for way in ti.static(range(2)):
            angles[i, way] = ti.min(left[way], right[way])


def _meetings(terrain, pivot, arm, axis):
    """Angles, forward and backward, at which docks at `arm` from `pivot` meet the ground."""
    along = np.sum(arm * axis, axis=-1, keepdims=True) * axis
    path = np.concatenate([pivot + along, arm - along, np.cross(axis, arm)], axis=-1)
    path = np.atleast_2d(path)
    angles = np.zeros((len(path), 2))
    _slab_angles(climb_limits(ClimbParams(), ROBOT, terrain, by_belief=False), path, angles)
    return angles


@pytest.mark.parametrize("terrain", [PLANE, SLAB, GAP])
@given(place=places)
def test_depth_is_how_far_a_dock_reaches_into_the_ground(terrain, place):
    """Above the top, below the underside and around the edge of either slab."""
    depth = terrain.depth(place[None], 1.0)[0]

    assert depth == pytest.approx(oracle_terrain.depth(terrain, place[None])[0], abs=1e-12)


@pytest.mark.parametrize("terrain", [PLANE, SLAB, GAP])
@given(place=places)
def test_a_foot_is_the_nearest_place_on_the_ground(terrain, place):
    """It lies on the surface, and no other place of the surface is nearer."""
    if oracle_terrain.depth(terrain, place[None])[0] > 1.0 - 1e-3:
        return  # in the ground itself

    foot = terrain.foot(place[None])[0]

    gap = np.linalg.norm(place - foot)
    assert terrain.depth(foot[None], 0.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert gap == pytest.approx(-terrain.depth(place[None], 0.0)[0], abs=1e-12)


def test_only_ground_without_edges_is_a_plane():
    """An edge on either side can be reached."""
    assert Terrain().is_plane
    assert not SLAB.is_plane
    assert not GAP.is_plane


def _random_turns(rng, terrain, count):
    """Pivots and arms around edges, the turning docks clear of the ground at first."""
    pivot = rng.uniform([-4.0, -3.0, -6.0], [6.0, 3.0, 4.0], (count, 3))
    arm, axis = rng.normal(size=(2, count, 3))
    arm *= ARM / np.linalg.norm(arm, axis=1, keepdims=True)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    clear = terrain.depth(pivot + arm, 1.0) < -1e-6
    return pivot[clear], arm[clear], axis[clear]


@pytest.mark.parametrize("terrain", [SLAB, GAP])
def test_edges_are_met_where_a_fine_sweep_first_overlaps(terrain):
    """Docks around both edges, above and below, turning either way about any axis."""
    turns = _random_turns(np.random.default_rng(3), terrain, 1200)
    angles = _meetings(terrain, *turns)

    met = 0
    for pivot, arm, axis, both in zip(*turns, angles, strict=True):
        for angle, sign in zip(both, (1.0, -1.0), strict=True):
            swept, closest = oracle_terrain.first_meeting(terrain, pivot, arm, sign * axis)
            if abs(closest) < 1e-4:
                continue  # a graze that a sweep in steps may miss
            if np.isinf(swept):
                assert angle == FULL_TURN
            else:
                end = pivot + oracle.turned(arm, axis, sign * angle)
                # The sweep's own step, and where the edge is left the solver's last step.
                assert swept - FULL_TURN / oracle.FINE - 1e-9 < angle < swept + 1e-9
                assert terrain.depth(end[None], 1.0)[0] == pytest.approx(0.0, abs=1e-10)
                met += 1
    assert met > 600


def test_the_underside_of_a_slab_is_met_from_below():
    """A dock that swings up under a slab stops 1 R below its lower face."""
    pivot, arm = np.array([-4.0, 0.0, -5.0]), np.array([ARM, 0.0, 0.0])

    angles = _meetings(SLAB, pivot, arm, np.array([0.0, 1.0, 0.0]))[0]

    # About the y axis forward is down: all of the lower half circle, and on to the far side.
    rise = np.arcsin(2.0 / ARM)
    np.testing.assert_allclose(angles, [np.pi + rise, rise], atol=1e-9)


def _resting(rng, count):
    """Docks that rest on the left edge of `SLAB`: front, and both ends of its curve."""
    way = rng.uniform(-0.2, np.pi + 0.2, count)
    x, up = 2.0 * np.sin(way), 2.0 * np.cos(way)
    inland = x < 0.0
    x[inland] *= 10.0
    up[inland] = 2.0 * np.sign(up[inland])
    return np.column_stack([x, rng.uniform(-2.0, 2.0, count), up - 1.0])


def test_a_dock_that_rests_on_an_edge_turns_off_it_but_not_into_it():
    """Touching at the start blocks the turn inward at once, and leaves the other way free."""
    rng = np.random.default_rng(5)
    dock = _resting(rng, 2000)
    foot = SLAB.foot(dock)
    arm, axis = rng.normal(size=(2, len(dock), 3))
    arm *= ARM / np.linalg.norm(arm, axis=1, keepdims=True)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    off = np.sum(np.cross(axis, arm) * (dock - foot), axis=1)
    steep = np.abs(off) > 0.05

    angles = _meetings(SLAB, dock - arm, arm, axis)[steep]

    inward = np.where(off[steep] < 0.0, angles[:, 0], angles[:, 1])
    outward = np.where(off[steep] < 0.0, angles[:, 1], angles[:, 0])
    # Rounding leaves such docks 1e-16 R off the edge.
    np.testing.assert_allclose(inward, 0.0, atol=1e-10)
    assert outward.min() > 0.04


def test_a_dock_that_leaves_an_edge_meets_it_where_a_sweep_does():
    """From rest, too, the other way round ends at the first contact that comes."""
    rng = np.random.default_rng(6)
    dock = _resting(rng, 600)
    arm, axis = rng.normal(size=(2, len(dock), 3))
    arm *= ARM / np.linalg.norm(arm, axis=1, keepdims=True)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    off = np.sum(np.cross(axis, arm) * (dock - SLAB.foot(dock)), axis=1)
    axis *= np.sign(off)[:, None]
    steep = np.abs(off) > 0.05

    angles = _meetings(SLAB, dock - arm, arm, axis)

    for d, r, u, angle in zip(dock[steep], arm[steep], axis[steep], angles[steep], strict=True):
        swept, closest = oracle_terrain.first_meeting(SLAB, d - r, r, u)
        if closest < -1e-4:
            assert angle[0] == pytest.approx(swept, abs=2.0 * FULL_TURN / oracle.FINE)


@given(axis=unit_vectors, x=st.floats(-30.0, -5.0), tilt=st.floats(0.3, 1.2))
def test_far_from_edges_a_slab_is_a_plane(axis, x, tilt):
    """A turn that cannot reach the edge ends where it does on flat ground without one."""
    pivot = np.array([x, 0.0, 1.0])
    arm = ARM * np.array([np.cos(tilt), 0.0, np.sin(tilt)])

    slab, plane = (_meetings(terrain, pivot, arm, axis) for terrain in (SLAB, Terrain()))

    np.testing.assert_allclose(slab, plane, atol=1e-12)


@pytest.mark.parametrize("kind", ["cantilevers", "bridges", "chains"])
def test_no_dock_passes_through_the_ground_on_the_way(kind, request):
    """One of the two ways round each flip, sampled, is free of ground and structure."""
    for history in request.getfixturevalue(kind):
        for j, walk in enumerate(history.walks):
            others = oracle_terrain.docks(history)[: 3 * j]
            for step in range(walk.stance_count - 1):
                clear = [
                    min(
                        -history.terrain.depth(path.reshape(-1, 3), 1.0).max(),
                        np.linalg.norm(path.reshape(-1, 1, 3) - others, axis=2).min(initial=9.0)
                        - 2.0,
                    )
                    for path in oracle.flip_paths(
                        walk, step, ROBOT.dock_offset_body, walk.pivot_dock[step]
                    )
                ]

                assert max(clear) > -1e-9


@pytest.mark.parametrize("kind", ["cantilevers", "bridges", "chains"])
def test_docks_stand_on_the_kind_of_ground_they_say(kind, request):
    """Every stance's docks on flat ground and on edges are those within the contact gap."""
    for history in request.getfixturevalue(kind):
        terrain = history.terrain
        for walk in history.walks:
            flat, edge = (set(map(tuple, rows)) for rows in (walk.ground_docks, walk.edge_docks))
            for stance, (center, q) in enumerate(
                zip(walk.center, walk.orientation_wxyz, strict=True)
            ):
                docks = center + ROBOT.dock_offset_body @ oracle.matrix(q).T
                touching = terrain.depth(docks, 1.0) > -0.02
                level = [oracle_terrain.is_flat_at(terrain, dock) for dock in docks]
                for k in range(3):
                    assert ((stance, k) in flat) == (touching[k] and level[k])
                    assert ((stance, k) in edge) == (touching[k] and not level[k])
