"""Imported poses become the log that their robots would sense at rest."""

import numpy as np
import pytest

from tests.recorder import Recorder
from tiswarm.compute.math import dock_offsets
from tiswarm.errors import InputError
from tiswarm.interop.imports import Assumptions, import_poses
from tiswarm.records.positions import read_positions
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.robot import RobotGeometry
from tiswarm.sensing import SensingParams, observe

BODY = RobotGeometry().dock_offset_body
POSES = "robot,x,y,z,qw,qx,qy,qz"
SPHERES = "robot,sphere,x,y,z"


def bring_in(folder, header, rows, progress=None, **known):
    """Import some rows, in units of R; return the log and the true positions."""
    table = folder / "poses.csv"
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    table.write_text("\n".join(lines) + "\n")
    usual = {"dock_radius": 1.0, "tolerance": 1e-3, "anchor": None, "ground_z": None}
    assumed = Assumptions(**{**usual, "length_unit": "R", **known})
    import_poses(table, folder / "in", BODY, assumed, progress or Recorder())
    _, position = read_positions(folder / "in" / "truth.csv", length_unit=assumed.length_unit)
    return read_sensing_log(folder / "in" / "sensing.jsonl"), position


def poses_of(history):
    """Rows of name and pose, the names not being indices."""
    return [
        [100 + n, *place, *turn]
        for n, (place, turn) in enumerate(
            zip(history.position.tolist(), history.orientation_wxyz.tolist(), strict=True)
        )
    ]


def named_contacts(log):
    """Contacts by name, independent of the order of the robots."""
    names = log.robot_id
    return {frozenset([(names[i], a), (names[j], b)]) for i, a, j, b in log.contacts.tolist()}


def test_contacts_of_a_grown_structure_come_back(towers, tmp_path):
    """Poses and the column `join` suffice, even if rows are shuffled."""
    history = towers[0]
    sensed = observe(history, SensingParams())
    rows = [[*row, join] for join, row in enumerate(poses_of(history))]
    np.random.default_rng(0).shuffle(rows)

    log, position = bring_in(tmp_path, f"{POSES},join", rows, ground_z=0.0)

    np.testing.assert_array_equal(log.robot_id, np.arange(100, 130))
    np.testing.assert_array_equal(log.contacts, sensed.contacts)
    np.testing.assert_array_equal(log.ground_docks, sensed.ground_docks)
    np.testing.assert_array_equal(position, history.position)


def test_without_an_order_robots_join_outward_from_the_anchor(towers, tmp_path):
    """Each robot touches an earlier one, hops from the anchor increase, and progress says so."""
    progress = Recorder()

    log, _ = bring_in(tmp_path, POSES, poses_of(towers[0])[::-1], progress, anchor=100)

    assert log.robot_id[0] == 100
    assert set(range(1, 30)) == {j for _, _, j, _ in log.contacts.tolist()}
    assert named_contacts(log) == {
        frozenset([(100 + i, a), (100 + j, b)])
        for i, a, j, b in observe(towers[0], SensingParams()).contacts.tolist()
    }
    assert progress.lines[0] == "no column join: robots join outward from robot 100, by contacts"


def test_spheres_say_the_same_as_poses(towers, tmp_path):
    """Docks keep their positions in the frame that the first robot's shape defines."""
    history = towers[0]
    docks = history.position[:, None] + dock_offsets(history.orientation_wxyz, BODY)
    rows = [
        [robot, sphere, *place]
        for robot, own in enumerate(docks.tolist())
        for sphere, place in enumerate(own)
    ]

    log, position = bring_in(tmp_path, SPHERES, rows)

    np.testing.assert_allclose(position[log.robot_id.argsort()], history.position, atol=1e-9)
    turned = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    np.testing.assert_allclose(turned[log.robot_id.argsort()], docks, atol=1e-6)
    assert len(log.contacts) == len(observe(history, SensingParams()).contacts)


def test_gaps_within_the_tolerance_are_contacts_and_overlaps_beyond_it_are_told(tmp_path):
    """Two robots stand side by side, and the gap between their docks varies."""
    found = {}
    for gap in (0.05, -0.05, 0.2, -0.2):
        progress = Recorder()
        apart = 2.0 * BODY[0, 0] + 2.0 + gap
        rows = [[0, 0, 0, 0, 1, 0, 0, 0], [1, apart, 0, 0, 0, 0, 0, 1]]
        log, _ = bring_in(tmp_path, POSES, rows, progress, tolerance=0.1)
        found[gap] = (log.contacts.tolist(), "1 overlap of two docks" in progress.lines[-1])

    touching = [[0, 0, 1, 0]]
    assert found == {
        0.05: (touching, False), -0.05: (touching, False), 0.2: ([], False), -0.2: ([], True),
    }  # fmt: skip


TRIANGLE = [[0, 0, 0, 0, 0], [0, 1, 2.6, 0, 0], [0, 2, 0, 2.6, 0]]


@pytest.mark.parametrize(
    ("header", "rows", "known", "problem"),
    [
        ("robot,x,y,z", [], {}, "poses.csv:1: the columns are neither robot,x,y,z,qw,qx,qy,qz nor"),
        (POSES, [], {}, "poses.csv:2: there are no robots"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0]], {}, "poses.csv:2: has 7 cells; 8 are needed"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0, 9]], {}, "poses.csv:2: has 9 cells; 8 are needed"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0], [1.5, *"0001000"]], {}, "poses.csv:3: robot: '1.5' is"),
        (POSES, [["a", 0, "b", 0, 1, 0, 0, 0]], {}, "poses.csv:2: robot: 'a' is not a whole"),
        (POSES, [[0, 0, -2e10, 0, 1, 0, 0, 0]], {}, "poses.csv:2: y: -2e+10 is too far out"),
        (POSES, [[0, 0, 0, 0, 1, 1, 0, 0]], {}, "poses.csv:2: qw: the quaternion has length 1.41"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0]] * 2, {}, "poses.csv:3: robot 0 has a row already"),
        (POSES, [[2**62 + 1, 0, 0, 0, 1, 0, 0, 0]] * 2, {}, "robot 4611686018427387905 has a row"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0]], {"anchor": 5}, "--anchor: there is no robot 5"),
        (
            POSES,
            [[0, 0, 0, 0, 1, 0, 0, 0]],
            {"length_unit": "a,b"},
            'poses.csv:1: length_unit: "a,b" cannot be part of a column\'s name; write',
        ),
        (
            SPHERES,
            [[0, s, np.sin(s), np.cos(s), 0] for s in range(65)],
            {},
            "poses.csv:1: dock_offsets: List should have at most 64 items",
        ),
        (POSES, [[0, 1e308, 0, 0, 1, 0, 0, 0]], {}, "poses.csv:2: x: '1e+308' is not a finite"),
        (SPHERES, TRIANGLE[:2], {}, "poses.csv:2: sphere: 2 spheres leave the orientation"),
        (SPHERES, [*TRIANGLE, [1, 0, 9, 9, 9]], {}, "poses.csv:5: sphere: robot 1 has spheres [0]"),
        (
            SPHERES,
            [*TRIANGLE, *([1, s, x + 9, 1.5 * y, z] for _, s, x, y, z in TRIANGLE)],
            {},
            "poses.csv:5: the spheres of robot 1 are up to",
        ),
    ],
)
def test_malformed_poses_are_refused(tmp_path, header, rows, known, problem):
    """The message names file, line and column, and nothing is written."""
    with pytest.raises(InputError) as refusal:
        bring_in(tmp_path, header, rows, **known)

    assert problem in str(refusal.value)
    assert not (tmp_path / "in").exists()
