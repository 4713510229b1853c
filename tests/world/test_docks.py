"""Robots of any number of docks grow by the same rules as those of three."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import frames, oracle
from tiswarm.base.robot import SHAPES, RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history_file import find_fault
from tiswarm.world.params import CantileverParams, ClimbParams, TowerParams

ROBOTS = {shape: RobotGeometry(shape=shape, rho=1.8) for shape in SHAPES} | {
    "uneven": RobotGeometry(
        docks=((1.5, 0.0, 0.0), (-1.5, 0.0, 0.0), (0.0, 0.0, 2.5), (0, 3, 0.5))
    ),
    "upright": RobotGeometry(docks=((0.0, 0.0, 1.6), (0.0, 0.0, -1.6))),
}
FLAT_OR_NOT = ("square", "tetrahedron", "uneven")


@pytest.fixture(scope="module")
def grown():
    """Two towers and two cantilevers of 20 robots of each kind, half of which settle."""
    climb = ClimbParams(settle=0.5)
    kinds = (TowerParams(climb=climb), CantileverParams(climb=climb))
    return {
        name: [h for kind in kinds for h in grow(kind, robots=20, seeds=[0, 2], robot=robot)]
        for name, robot in ROBOTS.items()
    }


def _docks(walk, body, stance=-1):
    return walk.center[stance] + body @ oracle.matrix(walk.orientation_wxyz[stance]).T


@pytest.mark.parametrize("name", ROBOTS)
def test_structures_are_sound_and_touch_where_they_say(grown, name):
    """No overlap, all held, weight in balance, and exactly the contacts of the final places."""
    body = ROBOTS[name].dock_offset_body
    for history in grown[name]:
        docks = np.array([_docks(walk, body) for walk in history.walks])
        expected = {
            (i, a, j, b)
            for j in range(history.robot_count)
            for i in range(j)
            for a, b in np.argwhere(np.linalg.norm(docks[i][:, None] - docks[j], axis=2) < 2.02)
        }

        assert find_fault(history, contact_gap=0.02) == ""
        assert {tuple(row) for row in history.contacts.tolist()} == expected
        assert history.robot_count == 20
        assert 0.0 <= history.loads[-1].imbalance < 1e-9


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_start_on_their_lowest_docks(grown, name):
    """Upright, these docks on the ground, all others above it."""
    body = ROBOTS[name].dock_offset_body
    lowest = np.flatnonzero(body[:, 2] < body[:, 2].min() + 0.02)
    for walk in (walk for history in grown[name][:2] for walk in history.walks):
        docks = _docks(walk, body, stance=0)

        np.testing.assert_allclose(docks[:, 2] - body[:, 2], 1.0 - body[:, 2].min())
        standing = walk.ground_docks[walk.ground_docks[:, 0] == 0, 1]
        assert standing.tolist() == lowest.tolist()


@pytest.mark.parametrize("name", FLAT_OR_NOT)
def test_flips_turn_across_the_line_from_pivot_to_center_until_a_dock_touches(grown, name):
    """The pivot is attached and stays; on the way is nothing; the axes are six for each dock."""
    body = ROBOTS[name].dock_offset_body
    twists = set()
    for history in grown[name][:2]:
        for j in range(1, history.robot_count):
            walk = history.walks[j]
            others = np.concatenate([_docks(earlier, body) for earlier in history.walks[:j]])
            attached = {(s, k) for s, k, *_ in walk.contacts} | {*map(tuple, walk.ground_docks)}
            for step, k in enumerate(walk.pivot_dock):
                before, after = (_docks(walk, body, stance=s) for s in (step, step + 1))
                turn = [oracle.matrix(q) for q in walk.orientation_wxyz[[step, step + 1]]]
                axis = Rotation.from_matrix(turn[1] @ turn[0].T).as_rotvec()
                axis /= np.linalg.norm(axis)
                paths = oracle.flip_paths(walk, step, body, k)

                assert (step, k) in attached
                np.testing.assert_allclose(after[k], before[k], atol=1e-9)
                assert max(_clearance(docks, others) for docks in paths) > -1e-6
                if step < walk.stance_count - 2:  # the last may settle about two docks
                    assert axis @ (walk.center[step] - before[k]) == pytest.approx(0.0, abs=1e-6)
                    twists.add(round(_twist(turn[0].T @ axis, body[k]) % 180.0, 3) % 180.0)
    assert twists <= {0.0, 30.0, 60.0, 90.0, 120.0, 150.0}
    assert len(twists) > 2


def _twist(axis, arm):
    """Angle of an axis, body frame, from the one across `arm` that is nearest to z [deg]."""
    arm = arm / np.linalg.norm(arm)
    across = np.cross(np.cross(arm, [0.0, 0.0, 1.0]), arm)
    if np.linalg.norm(across) < 1e-3:
        across = np.array([1.0, 0.0, 0.0])
    return np.degrees(np.arctan2(axis @ np.cross(across, -arm), axis @ across))


def _clearance(docks, others):
    """Least gap to the structure and the ground along a path of docks, (steps, docks, 3)."""
    gap = np.linalg.norm(docks[:, :, None] - others, axis=3).min() - 2.0
    return min(gap, docks[..., 2].min() - 1.0)


@pytest.mark.parametrize("name", ["square", "tetrahedron", "octahedron", "cube"])
def test_settled_robots_touch_with_three_docks(name):
    """Robots of more than three docks turn about two until a third touches, not until all do."""
    params = TowerParams(climb=ClimbParams(settle=1.0))
    [history] = grow(params, robots=30, seeds=[7], robot=ROBOTS[name])

    touching = [
        len(
            {own for own, *_ in walk.at_rest(walk.contacts)}
            | {*walk.at_rest(walk.ground_docks)[:, 0]}
        )
        for walk in history.walks
    ]
    assert np.mean([count >= 3 for count in touching]) > 0.8


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_sense_what_a_frame_built_anew_says(grown, name):
    """Growth hands on what its mechanics found, robot by robot."""
    for history in grown[name]:
        loads = frames.solve(frames.grown(history))

        np.testing.assert_allclose(history.sensed, loads.sensed, rtol=1e-8)
