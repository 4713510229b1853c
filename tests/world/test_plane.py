"""Planar robots stand, flip and join in y = 0, and never leave it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import frames, oracle
from tiswarm.base.robot import PlanarRobot, RobotGeometry
from tiswarm.measurements.cues import measure
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.history_file import find_fault, read_history, write_history
from tiswarm.world.params import BridgeParams, CantileverParams, ChainParams, TowerParams

FIREANT = RobotGeometry()
KINDS = {
    "tower": TowerParams(plane=True),
    "cantilever": CantileverParams(plane=True),
    "bridge": BridgeParams(plane=True),
    "chain": ChainParams(plane=True),
}


def _stances(history: History) -> tuple[np.ndarray, np.ndarray]:
    """Centers and orientations of all stances of all robots."""
    centers = np.concatenate([walk.center for walk in history.walks])
    return centers, np.concatenate([walk.orientation_wxyz for walk in history.walks])


@settings(max_examples=12)
@given(
    kind=st.sampled_from(sorted(KINDS)),
    seed=st.integers(0, 2**32),
    movers=st.integers(1, 2),
    anchor=st.none() | st.floats(0.0, 4.0),
)
def test_no_stance_leaves_the_plane(kind, seed, movers, anchor):
    """Every center has y = 0 exactly, and every orientation is a turn about y."""
    params = replace(KINDS[kind], movers=movers, anchor=anchor)

    [history] = grow(params, robots=12, seeds=[seed], robot=FIREANT)

    centers, orientations = _stances(history)
    assert not centers[:, 1].any()
    assert not orientations[:, [1, 3]].any()
    assert find_fault(history, contact_gap=0.02) == ""


@pytest.mark.parametrize("kind", KINDS)
def test_robots_start_upright_with_their_lowest_dock_on_the_ground(kind):
    """One dock touches it, at a random turn, wherever the docks of others leave room."""
    [history] = grow(KINDS[kind], robots=12, seeds=[4], robot=FIREANT)

    body = PlanarRobot().dock_offset_body
    for walk in history.walks:
        docks = walk.center[0] + body @ oracle.matrix(walk.orientation_wxyz[0]).T
        assert docks[:, 2].min() == pytest.approx(1.0, abs=1e-12)
        standing = walk.ground_docks[walk.ground_docks[:, 0] == 0, 1]
        assert docks[:, 2].argmin() in standing
    assert len({walk.orientation_wxyz[0].tobytes() for walk in history.walks}) > 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_fulfills_all_measurements(kind):
    """Heights, ground and plane to rounding, contacts to the gap, and those of flips exactly."""
    [history] = grow(KINDS[kind], robots=20, seeds=[3], robot=FIREANT)
    log = observe(history, SensingParams())

    for cue in ("height", "ground", "plane"):
        rows = measure(log, [cue])
        assert len(rows) == history.robot_count or cue == "ground"
        np.testing.assert_allclose(rows.residual(history.position), 0.0, atol=1e-9)
    rows = measure(log, ["contacts", "walk_contacts"])
    gap = rows.residual(history.position)
    assert gap.min() > -1e-9
    assert gap.max() < 0.02
    assert (np.abs(gap) < 1e-9).sum() >= history.robot_count - 1


def test_planar_structures_rise_reach_and_close():
    """Forty robots build a tower and a cantilever; the sides of a gap meet."""
    tower, cantilever, bridge = (
        grow(KINDS[kind], robots=40, seeds=[4], robot=FIREANT)[0]
        for kind in ("tower", "cantilever", "bridge")
    )

    assert tower.position[:, 2].max() > 20.0
    assert cantilever.position[:, 0].max() > 10.0
    assert bridge.crossed


def test_weight_bends_a_planar_structure_in_its_plane():
    """The ground bears the whole weight, and pushes nobody out of the plane."""
    [history] = grow(KINDS["tower"], robots=20, seeds=[3], robot=FIREANT)

    loads = frames.solve(frames.grown(history, 20))

    assert loads.ground_force[:, 2].sum() == pytest.approx(60.0)
    np.testing.assert_allclose(loads.ground_force[:, 1], 0.0, atol=1e-6)


@pytest.mark.parametrize("shape", ["line", "square"])
def test_flat_robots_of_other_docks_stay_in_the_plane(shape):
    """Two docks or four, all of them in y = 0."""
    robot = RobotGeometry(shape=shape, rho=1.8)

    [history] = grow(KINDS["tower"], robots=12, seeds=[1], robot=robot)

    centers, orientations = _stances(history)
    assert not centers[:, 1].any()
    assert not orientations[:, [1, 3]].any()
    assert history.robot.dock_count == robot.dock_count
    assert history.robot_count == 12
    assert find_fault(history, contact_gap=0.02) == ""


def test_settings_of_other_axes_have_no_effect():
    """In a plane, robots have one axis to flip about, and none to settle about."""
    climb = replace(CantileverParams().climb, twists=3, settle=1.0)
    changed = replace(KINDS["cantilever"], climb=climb, spawn_width=9.0)

    default, other = (
        grow(params, robots=12, seeds=[2], robot=FIREANT)[0]
        for params in (KINDS["cantilever"], changed)
    )

    assert np.array_equal(default.position, other.position)


def test_a_stored_planar_structure_is_planar_again(tmp_path):
    """What is read back has upright docks, as what was written."""
    [history] = grow(KINDS["tower"], robots=4, seeds=[0], robot=RobotGeometry(rho=1.7))
    write_history(history, tmp_path / "tower.npz")

    again = read_history(tmp_path / "tower.npz", KINDS["tower"], RobotGeometry(rho=1.7))

    assert again is not None
    assert again.is_planar
    assert again.robot == history.robot
