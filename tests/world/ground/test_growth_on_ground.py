"""Structures on ground of any form: no dock is in it, and all that stands is where it says."""

import numpy as np
import pytest
import trimesh

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history_file import find_fault, from_arrays, to_arrays
from tiswarm.world.params import structure_ground

PLANE = {"kind": "plane"}
HILL = [PLANE, {"kind": "sphere", "position": [0.0, 0.0, -40.0], "radius": 60.0}]
SLOPE = {"kind": "plane", "pitch_deg": 20.0, "roll_deg": -10.0}
STAIRS = [
    PLANE,
    *(
        {"kind": "box", "position": [30.0 + 6.0 * n, 0.0, 2.0 * n], "size": [60.0, 120.0, 4.0 * n]}
        for n in (1, 2, 3)
    ),
]
CANYON = [
    {"kind": "slab"},
    {"kind": "slab", "position": [18.0, 0.0, 3.0], "yaw_deg": 160.0},
    {"kind": "cylinder", "position": [9.0, 2.0, -14.0], "radius": 2.0, "height": 20.0},
]


def _structure(kind, terrain, **more):
    section = {"kind": kind, "terrain": terrain, **more}
    given = {"name": "ground", "structure": section, "localization": {"method": "joint"}}
    return load_scenario(given).structure


def _docks(history):
    turned = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
    return history.position[:, None] + turned


def _grown(kind, terrain, robots=16, seeds=(0, 1), **more):
    params = _structure(kind, terrain, **more)
    return params, grow(params, robots=robots, seeds=[*seeds], robot=RobotGeometry())


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A boulder of triangles, and a field of heights."""
    folder = tmp_path_factory.mktemp("ground")
    boulder = trimesh.creation.icosphere(subdivisions=2, radius=6.0)
    boulder.apply_scale([1.5, 1.0, 0.6])
    boulder.export(folder / "boulder.stl")
    x = np.arange(30.0)
    height = 3.0 * np.sin(x[:, None] / 4.0) * np.cos(x[None] / 5.0)
    np.savetxt(folder / "dunes.csv", height, delimiter=",")
    return folder


def _terrains(folder):
    return {
        "hill": ("tower", HILL),
        "slope": ("tower", SLOPE),
        "stairs": ("tower", STAIRS),
        "canyon": ("bridge", CANYON),
        "overhang": ("cantilever", [{"kind": "slab", "edge_radius": 2.5}]),
        "boulder": ("tower", [PLANE, {"kind": "mesh", "file": str(folder / "boulder.stl")}]),
        "dunes": (
            "tower", {"kind": "heightfield", "file": str(folder / "dunes.csv"), "cell": 2.0}
        ),
    }  # fmt: skip


@pytest.mark.parametrize(
    "name", ["hill", "slope", "stairs", "canyon", "overhang", "boulder", "dunes"]
)
@pytest.mark.parametrize(
    ("robots", "structures"), [(16, 2), pytest.param(40, 143, marks=pytest.mark.slow)]
)
def test_no_dock_is_in_the_ground_and_feet_touch_it(files, name, robots, structures):
    """At every stance of every robot, for ground of each form; 1,001 structures at full size."""
    kind, terrain = _terrains(files)[name]

    params, histories = _grown(kind, terrain, robots, range(structures))

    ground = structure_ground(params)
    for history in histories:
        stances = history.stances
        turned = dock_offsets(stances.orientation_wxyz, history.robot.dock_offset_body)
        dock = (stances.center[:, None] + turned).reshape(-1, 3)
        gap = ground.distance(dock).reshape(len(stances.robot), -1) - 1.0
        assert gap.min() > -1e-9
        robot, dock_of = history.edge_docks.T
        feet = ground.distance(_docks(history)[robot, dock_of]) - 1.0
        assert len(robot) > 0
        assert (np.abs(feet) < 0.02).all()
        assert not len(history.ground_docks)
        assert not find_fault(history, contact_gap=params.climb.contact_gap)


def test_towers_on_a_plane_that_is_a_distance_are_as_high_as_on_a_plane():
    """Means of 16 structures differ by less than chance explains (three standard errors)."""
    below = {"kind": "sphere", "position": [0.0, 0.0, -90.0], "radius": 10.0}
    seeds = range(16)

    _, flat = _grown("tower", PLANE, 15, seeds)
    _, measured = _grown("tower", [PLANE, below], 15, seeds)

    heights = [
        np.array([history.position[:, 2].max() for history in histories])
        for histories in (flat, measured)
    ]
    spread = np.sqrt(sum(height.var(ddof=1) / len(height) for height in heights))
    assert abs(heights[0].mean() - heights[1].mean()) < 3.0 * spread


def test_a_level_plane_alone_is_the_ground_of_a_tower():
    """It has the closed form, and leads to the same structures."""
    params = _structure("tower", {"kind": "plane", "position": [5.0, 5.0, 0.0]})

    [own] = grow(params, robots=12, seeds=[3], robot=RobotGeometry())

    [usual] = grow(_structure("tower", None), robots=12, seeds=[3], robot=RobotGeometry())
    np.testing.assert_array_equal(own.position, usual.position)


def test_a_bridge_over_a_canyon_ends_when_it_stands_on_both_banks():
    """A pillar between them counts for neither side."""
    params, histories = _grown("bridge", CANYON, 40, [0, 1], gap=18.0)

    ground = structure_ground(params)
    for history in histories:
        robot, dock = history.edge_docks.T
        banks = set(ground.body_at(_docks(history)[robot, dock]).tolist()) - {2}
        assert len(banks) == 2
        assert history.crossed == history.ended.startswith("the gap is bridged")
    assert any(history.crossed for history in histories)


def test_no_robot_stands_or_starts_in_a_region_that_it_may_not_enter():
    """Nor does any stance of its walk."""
    zone = {"kind": "box", "position": [0.0, 14.0, 5.0], "size": [200.0, 20.0, 30.0]}

    _, histories = _grown("tower", None, 16, [0, 1], no_entry=zone)

    for history in histories:
        stances = history.stances
        turned = dock_offsets(stances.orientation_wxyz, history.robot.dock_offset_body)
        assert (stances.center[:, None] + turned)[..., 1].max() <= 3.0
        assert history.position[:, 2].max() > 5.0


def test_a_structure_on_ground_is_read_back_as_it_was():
    """The ground follows from the settings."""
    params, [history, _] = _grown("tower", HILL, 12)

    again = from_arrays(to_arrays(history), params, RobotGeometry())

    assert not find_fault(again, contact_gap=params.climb.contact_gap)
    np.testing.assert_array_equal(again.position, history.position)


def test_the_log_says_that_ground_is_uneven_and_lists_no_dock_on_it():
    """Heights stay those above z = 0: robots know how high they start."""
    _, [history, _] = _grown("tower", HILL, 12)

    log = observe(history, SensingParams())

    assert (log.ground_z, log.ground_form) == (None, "uneven")
    assert not len(log.ground_docks)
    assert not len(log.stances.ground_docks)
    np.testing.assert_allclose(log.flip_height, history.position[:, 2], atol=1e-9)


def test_the_log_of_flat_ground_is_as_before():
    """A plane at some height has a height, and no form."""
    params = _structure("tower", {"kind": "plane", "position": [0.0, 0.0, 7.0]})
    [history] = grow(params, robots=6, seeds=[0], robot=RobotGeometry())

    log = observe(history, SensingParams())

    assert (log.ground_z, log.ground_form) == (7.0, None)
    assert len(log.ground_docks)
