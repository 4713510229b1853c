"""Line of sight ends at docks of other robots and at the ground, and nowhere else."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests import oracle, oracle_terrain
from tests.strategies import vectors
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.records.terrain import Terrain
from tiswarm.sensing import SensingParams
from tiswarm.sensing.sight import Views, find_lookouts, in_sight
from tiswarm.world.history import History, Walk

AIR = Terrain(ground_z=-1e8)
"""Ground out of the way."""


def cloud(seed, robots, extent, terrain=AIR):
    """Robots anywhere in a box, whether they overlap or not."""
    rng = np.random.default_rng(seed)
    none = {2: np.empty((0, 2), np.int32), 4: np.empty((0, 4), np.int32)}
    walks = tuple(
        Walk(
            center=(rng.random((1, 3)) - 0.5) * extent,
            orientation_wxyz=Rotation.random(random_state=rng).as_quat(scalar_first=True)[None],
            pivot_dock=np.empty(0, np.int32),
            contacts=none[4],
            ground_docks=none[2],
            edge_docks=none[2],
        )
        for _ in range(robots)
    )
    return History(
        seed=seed, robot=RobotGeometry(), terrain=terrain, walks=walks, spawns=robots, loads=(),
        sensed=np.zeros(robots),
    )  # fmt: skip


def docks(history):
    """Docks of all robots, shape (N, 3, 3)."""
    return oracle_terrain.docks(history).reshape(-1, 3, 3)


def views(seed, history, count, extent):
    """Segments anywhere, short ones, and such that graze a dock; robots that look or block."""
    rng = np.random.default_rng(seed)
    robots = history.robot_count
    start, end = (rng.random((2, count, 3)) - 0.5) * 1.5 * np.array(extent)
    end[::4] = start[::4] + rng.normal(size=end[::4].shape)
    way, side = rng.normal(size=(2, *end[1::2].shape))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    side = np.cross(way, side)
    side *= rng.uniform(0.9, 1.1, (len(side), 1)) / np.linalg.norm(side, axis=1, keepdims=True)
    grazed = side + rng.choice(docks(history).reshape(-1, 3), len(side))
    start[1::2] = grazed - way * rng.exponential(9.0, (len(side), 1))
    end[1::2] = grazed + way * rng.exponential(9.0, (len(side), 1))
    return Views(
        start, end, rng.integers(robots + 1, size=count), rng.integers(robots, size=count),
        rng.integers(-1, robots, size=count),
    )  # fmt: skip


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    robots=st.integers(1, 30),
    extent=st.sampled_from([(9.0, 9.0, 9.0), (5.0, 5.0, 90.0), (2e3, 3.0, 0.0), (40.0, 40.0, 9.0)]),
)
def test_segments_are_free_where_they_meet_no_sphere(seed, robots, extent):
    """Dense, tall, flat and wide swarms; robots that look, are looked at or join later."""
    history = cloud(seed, robots, extent)
    rays = views(seed, history, 500, extent)

    seen = in_sight(history, rays)

    robot, sphere = np.repeat(np.arange(robots), 3), docks(history).reshape(-1, 3)
    expected = [
        not oracle.is_hidden(start, end, sphere[(robot < n) & ~np.isin(robot, mine)], 1.0)
        for start, end, n, *mine in zip(*rays, strict=True)
    ]
    np.testing.assert_array_equal(seen, expected)


def test_a_point_is_hidden_inside_a_dock_only():
    """A segment of no length is that point."""
    history = cloud(0, 2, 50.0)
    dock = docks(history)[1, 0]
    place = dock + np.outer([0.0, 1.01], [0.0, 0.0, 1.0])

    seen = in_sight(history, Views(place, place, *np.array([[2, 2], [0, 0], [-1, -1]])))

    assert seen.tolist() == [False, True]


@pytest.mark.parametrize(
    "terrain",
    [Terrain(ground_z=-0.5), Terrain(left_edge=0.0),
     Terrain(ground_z=0.25, left_edge=0.5, right_edge=4.5)],
)  # fmt: skip
def test_the_ground_hides_what_is_behind_it(terrain):
    """Planes, slabs and gaps: compared with the depth of many places along each segment."""
    rng = np.random.default_rng(3)
    start, end = rng.uniform([-9, -3, -6], [13, 3, 6], (2, 400, 3))
    share = np.linspace(0.0, 1.0, 1000)[:, None]
    depth = [oracle_terrain.depth(terrain, a + share * (b - a)).max() - 1.0
             for a, b in zip(start, end, strict=True)]  # fmt: skip

    hidden = terrain.hides(start, end)

    # Places are at most 0.03 R apart; the deepest is within half of that of the true one.
    clear = np.abs(depth) > 0.02
    np.testing.assert_array_equal(hidden[clear], np.array(depth)[clear] > 0.0)
    assert clear.sum() > 350
    assert 0.1 < hidden.mean() < 0.9


def test_the_precision_of_the_device_changes_nothing():
    """The same bytes come out beside a localizer in float32."""
    history = cloud(1, 60, 30.0)
    rays = views(1, history, 2000, [30.0, 30.0, 30.0])
    alone = in_sight(history, rays)

    backend.choose(precision="f32")
    beside = in_sight(history, rays)

    assert alone.tobytes() == beside.tobytes()
    assert 0.1 < alone.mean() < 0.95


def moved(history, shift, robots=slice(None)):
    """Shift some robots of a structure."""
    walks = list(history.walks)
    walks[robots] = [dataclasses.replace(w, center=w.center + shift) for w in walks[robots]]
    return dataclasses.replace(history, walks=tuple(walks))


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), robot=st.integers(0, 11))
def test_to_move_a_robot_away_hides_nothing(seed, robot):
    """What is in sight remains so, and what only that robot hid comes into sight."""
    history = cloud(seed, 12, 12.0)
    rays = views(seed, history, 60, [12.0] * 3)

    before = in_sight(history, rays)
    after = in_sight(moved(history, [0.0, 0.0, 1e5], slice(robot, robot + 1)), rays)

    assert (after >= before).all()


def test_a_robot_alone_sees_everything():
    """No dock of its own is in the way."""
    history = cloud(0, 1, 1.0)
    end = np.random.default_rng(0).normal(scale=50.0, size=(200, 3))
    start = np.tile(history.position, (200, 1))
    ones = np.ones(200, np.int64)

    assert in_sight(history, Views(start, end, ones, 0 * ones, -ones)).all()


@settings(max_examples=30)
@given(shift=vectors, seed=st.integers(0, 10_000))
def test_sight_moves_along_with_a_structure(shift, seed):
    """To shift robots, ground and beacons by the same vector changes nothing."""
    history = cloud(seed, 12, 12.0, Terrain(ground_z=-3.0, left_edge=2.0))
    rays = views(seed, history, 60, [12.0] * 3)
    terrain = Terrain(ground_z=-3.0 + shift[2], left_edge=2.0 + shift[0])
    elsewhere = dataclasses.replace(moved(history, shift), terrain=terrain)

    there = in_sight(elsewhere, rays._replace(start=rays.start + shift, end=rays.end + shift))

    np.testing.assert_array_equal(there, in_sight(history, rays))


def test_only_robots_that_joined_block_those_that_climb(towers):
    """What a robot sees as it joins is what it would see if no others had followed."""
    history = towers[0]
    above = np.array([0.0, 0.0, 150.0])
    lookouts = find_lookouts(history, SensingParams(sight_at="stances"))

    seen = in_sight(history, lookouts.toward(above))

    for j in (3, 12, 29):
        cut = dataclasses.replace(history, walks=history.walks[: j + 1])
        mine = lookouts.select(lookouts.robot == j)
        whole = mine._replace(joined=np.full(len(mine.robot), j + 1))
        np.testing.assert_array_equal(in_sight(cut, whole.toward(above)), seen[lookouts.robot == j])
    end = find_lookouts(history, SensingParams())
    assert seen.mean() > in_sight(history, end.toward(above)).mean()
