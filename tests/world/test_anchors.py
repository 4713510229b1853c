"""Structures grow from several anchors: robots on the ground whose positions are known."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.runs import REPOSITORY
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation.tables import by_join, totals
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.model import dump_scenario, scenario_hash
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history_file import find_fault, read_history, write_history
from tiswarm.world.params import (
    BridgeParams,
    CantileverParams,
    ChainParams,
    StructureParams,
    TowerParams,
    anchor_fault,
    anchor_places,
)

FIREANT = RobotGeometry()
APART = TowerParams(anchors=((0.0, 0.0), (40.0, 0.0), (0.0, 40.0)))
"""Robots climb toward a goal above the first; whoever meets another one on the way stays there."""


def _grown(params: StructureParams, seed: int = 3, robots: int = 25):
    return grow(params, robots=robots, seeds=[seed], robot=FIREANT)[0]


def _walks(history):
    return [(*walk.center.ravel(), *walk.contacts.ravel()) for walk in history.walks]


@settings(max_examples=4)
@given(
    params=st.sampled_from([TowerParams(), CantileverParams(), BridgeParams(), ChainParams()]),
    count=st.integers(2, 6),
    plane=st.booleans(),
    movers=st.integers(1, 3),
    seed=st.integers(0, 999),
)
def test_anchors_stay_where_they_are_put(params, count, plane, movers, seed):
    """They join first, stand on flat ground, and no robot overlaps another one."""
    params = dataclasses.replace(params, anchors=count, plane=plane, movers=movers)

    history = _grown(params, seed, robots=12)

    assert history.anchors == count <= history.robot_count
    docks = [walk.center[0] for walk in history.walks[:count]]
    at = np.array(docks)[:, :2] if not plane else None
    assert at is None or np.array_equal(at, anchor_places(params, FIREANT))
    assert all(walk.stance_count == 1 for walk in history.walks[:count])
    assert all(len(walk.ground_docks) for walk in history.walks[:count])
    assert find_fault(history, contact_gap=0.02) == ""
    touching = set(history.contacts[:, 2].tolist())
    alone = set(range(count, history.robot_count)) - touching
    assert not alone
    assert history.robot_count == 12 or history.ended


@pytest.mark.parametrize("kind", [TowerParams, CantileverParams])
def test_one_anchor_in_a_list_is_the_anchor_that_is_put(kind):
    """Both keys grow the same structure, byte for byte."""
    one, other = kind(anchor=3.5, founders=2), kind(anchors=((-3.5, 0.0),), founders=2)

    assert _walks(_grown(one)) == _walks(_grown(other))


def test_scenarios_without_the_key_keep_their_hash():
    """Folders of earlier runs have their names still; with the key, they have others."""
    path = REPOSITORY / "scenarios" / "tower.yaml"
    plain, several = load_scenario(path), load_scenario(path, ["structure.anchors=2"])

    assert scenario_hash(plain) == "70e9f7c1" != scenario_hash(several)
    assert "anchors" not in dump_scenario(plain)
    assert "anchors: 2" in dump_scenario(several)


def test_logs_and_files_state_every_anchor(tmp_path):
    """Three fixes of each but the first, read back; the file of a structure knows the anchors."""
    history = _grown(TowerParams(anchors=4))
    write_sensing_log(observe(history, SensingParams(tilt_noise_deg=1.0)), tmp_path / "log")
    log = read_sensing_log(tmp_path / "log")

    known = log.known_position
    write_history(history, tmp_path / "structure.npz")
    back = read_history(tmp_path / "structure.npz", TowerParams(anchors=4), FIREANT)

    np.testing.assert_allclose(known[:4], history.position[:4], rtol=0.0, atol=1e-12)
    assert np.isnan(known[4:]).all()
    assert len(log.fixes) == 9
    assert back is not None
    assert back.anchors == 4


def test_anchors_never_fail_and_know_how_they_stand():
    """Robots without a compass take their orientations from all anchors."""
    history = _grown(TowerParams(anchors=3))

    mute = observe(history, SensingParams(mute=1.0))
    blind = observe(history, SensingParams(suite="m-blocks"))

    assert not np.isnan(mute.orientation_wxyz[:3]).any()
    assert np.isnan(mute.orientation_wxyz[3:]).all()
    np.testing.assert_array_equal(blind.orientation_wxyz[:3], history.orientation_wxyz[:3])


def test_tables_count_from_the_nearest_anchor():
    """Parts that have not met are all anchored, and who touches any anchor is on one."""
    history = _grown(APART, robots=30)

    table, found = by_join(history), totals(history)

    on_one = sorted(set(history.contacts[history.contacts[:, 0] < 3, 2].tolist()))
    assert table["anchored"].tolist() == table["robots"].tolist()
    assert table["on_anchor"].iloc[-1] == len(on_one)
    assert found["first_on_anchor"] == on_one[0]


@pytest.mark.parametrize(
    ("kind", "sides", "problem"),
    [
        (BridgeParams, (-1, -1), "both sides need an anchor; add one"),
        (BridgeParams, (1, 1), "both sides need an anchor; add one"),
        (BridgeParams, (-1, 1), ""),
        (TowerParams, (1, 1), ""),
        (TowerParams, (-1, -1), ""),
    ],
)
def test_only_a_bridge_needs_an_anchor_on_each_side(kind, sides, problem):
    """A bridge grows from both; other structures do from wherever anchors stand."""
    params = kind(anchors=tuple((60.0 * side, 20.0 * y) for y, side in enumerate(sides)))

    assert anchor_fault(params, 8, FIREANT) == problem


BAD = [
    ("tower", "[[0, 0], [4, 0]]", "anchors 0 and 1 are 4 R apart and may overlap"),
    ("tower", "0", "0 should be a number from 1 to 1,000, or that many places"),
    ("tower", "[]", "[] should be a number"),
    ("tower", "[[0, 0, 0]]", "should be a number"),
    ("tower", "9", "9 anchors are more than 8 robots; give fewer"),
    ("cantilever", "[[-6, 0], [0, 9]]", "anchor 1 at [0, 9] is off the ground"),
    ("bridge", "[[-6, 0], [10, 0]]", "anchor 1 at [10, 0] is off the ground"),
    ("bridge", "1", "both sides need an anchor; add one"),
]


@pytest.mark.parametrize(("kind", "anchors", "problem"), BAD)
def test_bad_anchors_are_refused_in_one_line(tiswarm, tmp_path, kind, anchors, problem):
    """With the line of the key, and exit status 2."""
    path = tmp_path / "bad.yaml"
    path.write_text(
        f"name: bad\nrobots: 8\nstructure:\n  kind: {kind}\n  anchors: {anchors}\n"
        "localization: {method: joint}\n"
    )

    done = tiswarm("run", path, "--out", tmp_path)

    assert done.returncode == 2
    assert done.stderr.startswith(f"tiswarm: error: {path}:5: structure.anchors: ")
    assert problem in done.stderr
    assert done.stderr.count("\n") == 1


def test_anchors_off_the_plane_or_placed_twice_are_refused(tmp_path):
    """In a plane y is 0, and anchor is a place of its own."""
    path = REPOSITORY / "tests" / "tower.yaml"
    for change, problem in [
        (["structure.plane=true", "structure.anchors=[[0, 0], [20, 1]]"], "not in the plane"),
        (["structure.anchor=1.0", "structure.anchors=2"], "leave out one of the two keys"),
    ]:
        with pytest.raises(Exception, match=problem):
            load_scenario(path, change)
