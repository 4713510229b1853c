"""The ground is one function: the distance to it, checked against formulas written out slowly."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tiswarm.compute.lang import F64, Reals1, Reals2, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.world.ground import grids
from tiswarm.world.ground.bodies import (
    BoxParams,
    CylinderParams,
    PlaneParams,
    SlabParams,
    SphereParams,
)
from tiswarm.world.ground.kernels import (
    CLOSED_GRID,
    HEIGHT_GRID,
    GroundArray,
    arc_angle,
    arc_clearance,
)
from tiswarm.world.ground.solid import Body, solid_ground

coordinates = st.floats(-12.0, 12.0)
places = st.tuples(coordinates, coordinates, coordinates).map(np.array)
angles = st.floats(-180.0, 180.0)


def _distance(bodies, place):
    return solid_ground([params.body() for params in bodies]).distance(np.atleast_2d(place))


def _in_frame(params, place):
    """Express a place in the frame of a body, turned about x, y and z in that order."""
    turns = {"x": params.roll_deg, "y": params.pitch_deg, "z": params.yaw_deg}
    local = np.array(place) - params.position
    for axis in "zyx":
        local = Rotation.from_euler(axis, -turns[axis], degrees=True).apply(local)
    return local


def _box_distance(params, local):
    """Distance to a rounded box: that to the box within it, less the radius."""
    inner = 0.5 * np.array(params.size) - params.edge_radius
    outside = np.abs(local) - inner
    if (outside <= 0.0).all():
        return outside.max() - params.edge_radius
    nearest = np.clip(local, -inner, inner)
    return np.linalg.norm(local - nearest) - params.edge_radius


def _cylinder_distance(params, local):
    """Distance to a rounded cylinder: that to the cylinder within it, less the radius."""
    radius = params.radius - params.edge_radius
    half = 0.5 * params.height - params.edge_radius
    around = np.hypot(local[0], local[1])
    if around <= radius and abs(local[2]) <= half:
        return max(around - radius, abs(local[2]) - half) - params.edge_radius
    nearest = np.array([min(around, radius), np.clip(local[2], -half, half)])
    return np.linalg.norm([around, local[2]] - nearest) - params.edge_radius


def _slab_distance(params, local):
    """Distance to a slab: that to the half plane in its middle, less half of its thickness."""
    spine = np.array([min(local[0], 0.0), local[1], -params.edge_radius])
    return np.linalg.norm(local - spine) - params.edge_radius


@given(place=places, roll=angles, pitch=angles, yaw=angles)
def test_a_turned_box_is_as_far_as_the_formula_says(place, roll, pitch, yaw):
    """Inside and outside, with round edges."""
    box = BoxParams(
        position=(1.0, -2.0, 0.5), roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw,
        size=(6.0, 4.0, 3.0), edge_radius=0.7,
    )  # fmt: skip

    distance = _distance([box], place)

    assert distance == pytest.approx(_box_distance(box, _in_frame(box, place)), abs=1e-11)


@given(place=places, roll=angles, pitch=angles)
def test_a_turned_cylinder_is_as_far_as_the_formula_says(place, roll, pitch):
    """Inside and outside, with round edges."""
    cylinder = CylinderParams(
        position=(-1.0, 2.0, 0.0), roll_deg=roll, pitch_deg=pitch, radius=3.0, height=5.0,
        edge_radius=0.4,
    )  # fmt: skip

    distance = _distance([cylinder], place)

    expected = _cylinder_distance(cylinder, _in_frame(cylinder, place))
    assert distance == pytest.approx(expected, abs=1e-11)


@given(place=places, yaw=angles)
def test_a_turned_slab_is_as_far_as_the_formula_says(place, yaw):
    """Above, below and beyond its edge."""
    slab = SlabParams(position=(3.0, 0.0, 1.5), yaw_deg=yaw, edge_radius=1.2)

    distance = _distance([slab], place)

    assert distance == pytest.approx(_slab_distance(slab, _in_frame(slab, place)), abs=1e-11)


@given(place=places)
def test_the_ground_is_as_far_as_the_nearest_of_its_bodies(place):
    """A union: the least distance counts, and its body is named."""
    plane = PlaneParams(position=(0.0, 0.0, -1.0), pitch_deg=20.0)
    sphere = SphereParams(position=(4.0, 0.0, 0.0), radius=2.5)
    ground = solid_ground([plane.body(), sphere.body()])
    across = np.array([np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))])

    distance, body = ground.distance(place[None])[0], ground.body_at(place[None])[0]

    each = [across @ (place - plane.position), np.linalg.norm(place - sphere.position) - 2.5]
    assert distance == pytest.approx(min(each), abs=1e-11)
    assert each[body] == pytest.approx(min(each), abs=1e-11)


BOULDER = trimesh.creation.icosphere(subdivisions=3, radius=4.0)
_X = np.arange(16.0)
HEIGHTS = 2.0 * np.sin(_X[:, None] / 3.0) * np.cos(_X[None] / 4.0)


def _boulder(cell):
    grid = grids.grid_of_mesh(np.array(BOULDER.vertices), np.array(BOULDER.faces), cell)
    return solid_ground(
        [Body(CLOSED_GRID, np.zeros(3), Rotation.identity(), grid=grid, lipschitz=grids.LIPSCHITZ)]
    )


def _field(cell):
    grid = grids.grid_of_heights(HEIGHTS, 1.0, cell)
    return solid_ground(
        [Body(HEIGHT_GRID, np.zeros(3), Rotation.identity(), grid=grid, lipschitz=grids.LIPSCHITZ)]
    )


@pytest.mark.parametrize("cell", [1.0, 0.5, 0.25])
def test_a_grid_of_a_mesh_is_as_near_as_its_cell_allows(cell):
    """Against a triangle mesh that is a sphere but for .04 R; errors fall with the cell squared."""
    way = np.random.default_rng(3).normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    radius = np.linspace(3.0, 6.0, 500)

    distance = _boulder(cell).distance(radius[:, None] * way)

    assert np.abs(distance - (radius - 4.0)).max() < 0.04 + 0.1 * cell**2


def test_a_grid_of_heights_is_zero_at_its_heights():
    """At the points of the field, and on straight lines between two of them."""
    i, j = np.random.default_rng(4).integers(0, 15, (2, 200))
    middle = 0.5 * (HEIGHTS[i, j] + HEIGHTS[i + 1, j])

    at = _field(0.25).distance(np.column_stack([i, j, HEIGHTS[i, j]]))
    between = _field(0.25).distance(np.column_stack([i + 0.5, j, middle]))

    assert np.abs(at).max() < 0.02
    assert np.abs(between).max() < 0.02


def test_a_grid_of_heights_is_a_true_distance_within_a_dock():
    """Against the nearest of many points of the surface."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(3, 12, 300), np.linspace(3, 12, 300)))
    i, j = x.astype(int), y.astype(int)
    u, v = x - i, y - j
    z = (1 - u) * ((1 - v) * HEIGHTS[i, j] + v * HEIGHTS[i, j + 1])
    z += u * ((1 - v) * HEIGHTS[i + 1, j] + v * HEIGHTS[i + 1, j + 1])
    surface = np.column_stack([x, y, z])
    rng = np.random.default_rng(5)
    place = surface[rng.integers(0, len(surface), 2000)] + rng.uniform(-1.2, 1.2, (2000, 3))
    place = place[((place[:, :2] > 5.0) & (place[:, :2] < 10.0)).all(axis=1)][:60]

    distance = np.abs(_field(0.25).distance(place))

    slow = np.linalg.norm(place[:, None] - surface, axis=2).min(axis=1)
    np.testing.assert_allclose(distance, slow, atol=0.03)


def test_inside_is_negative_where_parts_of_a_mesh_overlap():
    """Two overlapping boulders are one body."""
    other = BOULDER.copy()
    other.apply_translation([3.0, 0.0, 0.0])
    both = trimesh.util.concatenate([BOULDER, other])

    grid = grids.grid_of_mesh(np.array(both.vertices), np.array(both.faces), 0.5)

    place = (np.array([1.5, 0.0, 0.0]) - grid.corner) / grid.cell
    assert grid.value[tuple(np.round(place).astype(int))] < 0.0


GROUNDS = {
    "solids": lambda: solid_ground([
        params.body()
        for params in (
            PlaneParams(pitch_deg=10.0),
            SlabParams(position=(2.0, 0.0, 3.0), yaw_deg=40.0),
            BoxParams(
                position=(4.0, 1.0, 1.0), size=(3.0, 2.0, 4.0), edge_radius=0.5, yaw_deg=30.0
            ),
            CylinderParams(position=(-5.0, 2.0, 2.0), radius=1.5, height=6.0, roll_deg=15.0),
            SphereParams(position=(0.0, -6.0, 0.0), radius=3.0),
        )
    ]),
    "mesh": lambda: _boulder(0.5),
    "heights": lambda: _field(0.5),
}  # fmt: skip


@pytest.mark.parametrize("name", GROUNDS)
@settings(max_examples=200)
@given(one=places, other=places)
def test_the_distance_changes_by_no_more_than_its_lipschitz_constant_allows(name, one, other):
    """So nothing can be met within the distance over that constant."""
    ground = _kept(name)

    first, second = ground.distance(np.array([one, other]))

    assert abs(first - second) <= ground.lipschitz * np.linalg.norm(one - other) + 1e-12


_GROUND = {}


def _kept(name):
    """Make a ground once."""
    if name not in _GROUND:
        _GROUND[name] = GROUNDS[name]()
    return _GROUND[name]


@given(start=places, end=places)
def test_ground_hides_what_is_behind_it(start, end):
    """Against many points of the segment; what only grazes the ground is left open."""
    ground = _kept("solids")
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    least = ground.distance(start + share * (end - start)).min()

    hidden = ground.hides(start[None], end[None])[0]

    step = np.linalg.norm(end - start) / 2000.0
    assert hidden or least > -2e-3
    assert not hidden or least < step


@pytest.mark.parametrize("x", [-9.0, -5.0, 0.0, 2.5, 4.0, 7.0])
def test_a_robot_is_put_where_its_lowest_dock_touches_the_ground(x):
    """Somewhere on solids, turned at random."""
    ground = _kept("solids")
    arm = Rotation.from_euler("xyz", [x, 2.0 * x, 3.0]).apply(1.5 * np.eye(3))

    [level] = ground.levels(np.array([[x, 0.5]]), arm[None], 1.0)

    gap = ground.distance(np.array([x, 0.5, level]) + arm) - 1.0
    assert gap.min() == pytest.approx(0.0, abs=1e-9)
    assert gap.min() >= -1e-11


def test_a_robot_is_put_nowhere_where_there_is_no_ground():
    """Beside a slab."""
    ground = solid_ground([SlabParams().body()])

    [level] = ground.levels(np.array([[50.0, 0.0]]), np.zeros((1, 1, 3)), 1.0)

    assert level == -np.inf


def test_robots_that_are_put_down_together_rest_where_each_rests_alone():
    """On solids: the number of robots changes no bit of their heights."""
    ground = _kept("solids")
    place = np.random.default_rng(5).uniform(-9.0, 9.0, (12, 2))
    turns = Rotation.from_euler("z", 30.0 * np.arange(12), degrees=True)
    arm = np.array([turn.apply(1.5 * np.eye(3)) for turn in turns])

    together = ground.levels(place, arm, 1.0)

    alone = [ground.levels(place[i : i + 1], arm[i : i + 1], 1.0)[0] for i in range(12)]
    np.testing.assert_array_equal(together, alone)


@ti.kernel
def _follow_arcs(
    middle: Reals2, across: Reals2, onward: Reals2, aim: Reals2, array: Reals1, out: Reals2
):
    ground = ti.static(GroundArray(array, ()))
    for i in range(middle.shape[0]):
        place, start, side = vector_at(middle, i), vector_at(across, i), vector_at(onward, i)
        wanted = ti.Vector([aim[i, 0], aim[i, 1], aim[i, 2], aim[i, 3]])
        most = ti.cast(2.0 * np.pi, F64)
        out[i, 0] = arc_angle(place, start, side, 1.0, most, wanted, ground)
        out[i, 1] = arc_clearance(place, start, side, ground)


def _arcs(seed, count):
    """Draw arcs of docks: middles, and vectors from there to the start and onward."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([-9.0, -9.0, -2.0], [9.0, 9.0, 6.0], (count, 3))
    turn = Rotation.random(count, rng=rng).as_matrix()
    return middle, *(2.6 * np.ascontiguousarray(turn[:, k]) for k in range(2))


def _ground(kind):
    if kind == "slope":
        return solid_ground([PlaneParams(pitch_deg=20.0).body()])
    return _kept(kind)


@pytest.mark.parametrize("kind", ["solids", "slope"])
def test_a_turn_that_gains_enough_ends_where_the_whole_search_ends_it(kind):
    """A search that leaves out what gains too little moves no end that counts.

    Another dock may end the turn before, at the angle `first`.
    """
    ground = _ground(kind)
    arcs = _arcs(3, 6000)
    rng = np.random.default_rng(4)
    gain = rng.uniform(-1.0, 1.0, (6000, 2))
    more = rng.uniform(-1.0, 1.0, 6000) ** 3
    first = rng.uniform(0.1, 9.0, 6000)
    everything = np.tile([0.0, 0.0, -np.inf, 0.0], (6000, 1))
    whole, quick = np.zeros((2, 6000, 2))
    _follow_arcs(*arcs, everything, ground.array, whole)
    end = np.minimum(whole[:, 0], first)
    gained = np.cos(end) * gain[:, 0] + np.sin(end) * gain[:, 1]
    aim = np.column_stack([gain, gained + more, np.full(6000, 0.05)])

    _follow_arcs(*arcs, aim, ground.array, quick)

    quick_end = np.minimum(quick[:, 0], first)
    quick_gain = np.cos(quick_end) * gain[:, 0] + np.sin(quick_end) * gain[:, 1]
    counts = (more < -1e-5) & (end >= 0.05)
    np.testing.assert_allclose(quick_end[counts], end[counts], atol=1e-9)
    is_lost = (quick_end < 0.05) | (quick_gain < gained + more + 1e-5)
    assert (counts | is_lost | (np.abs(more) <= 1e-5)).all()


def test_no_turning_dock_comes_nearer_than_its_clearance():
    """Exact on one plane, a bound on other ground."""
    middle, across, onward = _arcs(5, 200)
    turn = np.linspace(0.0, 2.0 * np.pi, 721)[:, None, None]
    path = middle + np.cos(turn) * across + np.sin(turn) * onward
    clearance = {}
    least = {}

    for kind in ("slope", "solids"):
        ground = _ground(kind)
        numbers = np.zeros((200, 2))
        _follow_arcs(middle, across, onward, np.zeros((200, 4)), ground.array, numbers)
        clearance[kind] = numbers[:, 1]
        least[kind] = ground.distance(path.reshape(-1, 3)).reshape(721, 200).min(axis=0)

    np.testing.assert_allclose(least["slope"], clearance["slope"], atol=1e-4)
    assert (least["solids"] >= clearance["solids"] - 1e-9).all()
