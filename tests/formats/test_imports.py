"""Imported poses become the log that their robots would sense at rest."""

import re

import numpy as np
import pytest

from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.imports import import_poses, write_imports
from tiswarm.formats.poses import Assumptions, read_dock_offsets
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.records.positions import read_positions
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingNoise
from tiswarm.sensing import SensingParams, observe

BODY = RobotGeometry().dock_offset_body
POSES = "robot,x,y,z,qw,qx,qy,qz"
SPHERES = "robot,sphere,x,y,z"


def bring_in(folder, header, rows, **known):
    """Import some rows, in units of R."""
    table = folder / "poses.csv"
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    table.write_text("\n".join(lines) + "\n")
    body = None if header == SPHERES else BODY
    usual = {"dock_offset_body": body, "gap": 1e-3, "overlap": 1e-3, "length_unit": "R"}
    return import_poses(table, Assumptions(**{**usual, **known}))[""]


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

    imported = bring_in(tmp_path, f"{POSES},join", rows, ground_z=0.0)
    write_imports({"": imported}, tmp_path / "in")
    log = read_sensing_log(tmp_path / "in" / "sensing.jsonl")
    _, position, _ = read_positions(tmp_path / "in" / "truth.csv")

    np.testing.assert_array_equal(log.robot_id, np.arange(100, 130))
    np.testing.assert_array_equal(log.contacts, sensed.contacts)
    np.testing.assert_array_equal(log.ground_docks, sensed.ground_docks)
    np.testing.assert_array_equal(position, history.position)


def test_without_an_order_robots_join_outward_from_the_anchor(towers, tmp_path):
    """Each robot touches an earlier one, hops from the anchor increase, and a note says so."""
    log, _, notes, _ = bring_in(tmp_path, POSES, poses_of(towers[0])[::-1], anchors=(100,))

    assert log.robot_id[0] == 100
    assert set(range(1, 30)) == {j for _, _, j, _ in log.contacts.tolist()}
    assert named_contacts(log) == {
        frozenset([(100 + i, a), (100 + j, b)])
        for i, a, j, b in observe(towers[0], SensingParams()).contacts.tolist()
    }
    assert "no column join: robots join outward from robot 100, by contacts" in notes


def test_spheres_say_the_same_as_poses(towers, tmp_path):
    """Docks keep their positions in the frame that the first robot's shape defines."""
    history = towers[0]
    docks = history.position[:, None] + dock_offsets(history.orientation_wxyz, BODY)
    rows = [
        [robot, sphere, *place]
        for robot, own in enumerate(docks.tolist())
        for sphere, place in enumerate(own)
    ]

    log, position, _, _ = bring_in(tmp_path, SPHERES, rows)

    np.testing.assert_allclose(position[log.robot_id.argsort()], history.position, atol=1e-9)
    turned = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    np.testing.assert_allclose(turned[log.robot_id.argsort()], docks, atol=1e-6)
    assert len(log.contacts) == len(observe(history, SensingParams()).contacts)


@pytest.mark.parametrize("spheres", [1, 2, 3])
def test_robots_have_any_number_of_spheres(tmp_path, spheres):
    """Spheres in one line leave a turn about it open, which moves no dock."""
    place = np.array([[0.0, 0, 0], [2, 0, 0], [1, np.sqrt(3), 0], [3, np.sqrt(3), 0]])
    rod = np.outer(np.arange(spheres), [0, 0, 3.0])
    rows = [
        [robot, sphere, *(own + to_sphere)]
        for robot, own in enumerate(place)
        for sphere, to_sphere in enumerate(rod * (-1) ** robot)
    ]

    log, position, _, _ = bring_in(tmp_path, SPHERES, rows)

    docks = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    expected = [own + (-1) ** robot * rod for robot, own in enumerate(place)]
    np.testing.assert_allclose(docks[log.robot_id.argsort()], expected, atol=1e-9)
    assert len(log.contacts) >= 5


def test_docks_of_any_number_come_from_a_file(tmp_path):
    """The order of rows is of no matter; numbers that leave a dock out are refused."""
    table = tmp_path / "docks.csv"
    table.write_text("dock,x,y,z\n1,0,2,0\n0,2,0,0\n3,0,0,-1\n2,0,0,1\n")

    np.testing.assert_array_equal(
        read_dock_offsets(table), [[2, 0, 0], [0, 2, 0], [0, 0, 1], [0, 0, -1]]
    )
    for text, problem in {
        "dock,x,y,z\n1,0,2,0\n": "docks.csv:2: dock: docks [1] are not numbered 0, 1",
        "dock,x_mm,y_mm,z_mm\n0,0,2,0\n": "docks.csv:1: the columns are not dock,x,y,z",
    }.items():
        table.write_text(text)
        with pytest.raises(InputError, match=re.escape(problem)):
            read_dock_offsets(table)


def test_gaps_and_overlaps_have_limits_of_their_own(tmp_path):
    """Two robots stand side by side, and the gap between their docks varies."""
    found = {}
    for gap in (0.05, -0.05, -0.15, 0.2, -0.3):
        rows = [[0, 0, 0, 0, 1, 0, 0, 0], [1, 2.0 * BODY[0, 0] + 2.0 + gap, 0, 0, 0, 0, 0, 1]]
        log, _, notes, _ = bring_in(tmp_path, POSES, rows, gap=0.1, overlap=0.2)
        found[gap] = (log.contacts.tolist(), "1 overlap of two docks by more than 0.2 R" in notes)

    touching = ([[0, 0, 1, 0]], False)
    assert found == {
        0.05: touching, -0.05: touching, -0.15: touching, 0.2: ([], False), -0.3: ([], True),
    }  # fmt: skip


def test_a_histogram_marks_contacts(tmp_path):
    """Its bins end at the limits of contacts, whose count is the sum of their bins."""
    rows = [[0, 0, 0, 0, 1, 0, 0, 0], [1, 2.0 * BODY[0, 0] + 2.03, 0, 0, 0, 0, 0, 1]]

    counted = bring_in(tmp_path, POSES, rows, gap=0.04).notes
    missed = bring_in(tmp_path, POSES, rows, gap=0.025).notes

    assert counted[0] == "gaps between docks [R], contacts marked #:"
    assert counted[1].split() == ["0.02", "to", "0.04", "1", "#" * 40]
    assert missed[1].split() == ["0.025", "to", "0.05", "1", "." * 40]


@pytest.mark.parametrize("scale", [1.0, 32.9])
def test_the_dock_offset_is_where_most_docks_touch(towers, tmp_path, scale):
    """Poses suffice to find the robot's own offset, in any unit."""
    rows = [[row[0], *np.multiply(row[1:4], scale), *row[4:]] for row in poses_of(towers[0])]

    log, _, notes, warnings = bring_in(
        tmp_path, POSES, rows, dock_offset_body=None, dock_radius=scale, gap=None, overlap=None
    )

    np.testing.assert_allclose(log.dock_offset_body, scale * BODY, rtol=1e-4, atol=1e-9)
    assert named_contacts(log) == {
        frozenset([(100 + i, a), (100 + j, b)])
        for i, a, j, b in observe(towers[0], SensingParams()).contacts.tolist()
    }
    assert notes[0].endswith("R: most docks touch there")
    assert warnings == []


@pytest.mark.parametrize(
    "known",
    [{"dock_radius": 0.5, "dock_offset_body": 0.5 * BODY}, {}, {"gap": 0.0, "overlap": 0.0}],
)
def test_a_wrong_geometry_is_no_silent_result(known):
    """A wrong radius or offset, and limits of 0, give a warning for the shipped example."""
    example = REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv"

    (warning,) = import_poses(example, Assumptions(**known))[""].warnings
    assert ("correct --dock-radius" if known else "give --dock-radius 0.5") in warning


def test_runs_of_one_table_are_apart(towers, tmp_path):
    """Each is what its own table gives, even where names of robots repeat."""
    towers_rows = [poses_of(tower) for tower in towers[:2]]
    rows = [[run, *row] for run, own in zip("ba", towers_rows, strict=True) for row in own]
    table = tmp_path / "runs.csv"
    table.write_text("\n".join([f"run,{POSES}", *(",".join(map(str, row)) for row in rows)]))

    both = import_poses(table, Assumptions(dock_offset_body=BODY))

    assert [*both] == ["b", "a"]
    for imported, own in zip(both.values(), towers_rows, strict=True):
        alone = bring_in(tmp_path, POSES, own, gap=None, overlap=None)
        np.testing.assert_array_equal(imported.log.contacts, alone.log.contacts)
        np.testing.assert_array_equal(imported.position, alone.position)
    with pytest.raises(InputError, match="contacts: the poses have several runs"):
        import_poses(table, Assumptions(contacts=table))
    table.write_text(f"run,{POSES}\n../b,0,0,0,0,1,0,0,0\n")
    with pytest.raises(InputError, match=r"runs.csv:2: run: '../b' cannot be a folder"):
        import_poses(table, Assumptions())


def test_listed_contacts_replace_found_ones(towers, tmp_path):
    """Rows in any order and direction; a contact that cannot be is refused with its line."""
    rows, listed = poses_of(towers[0])[:4], tmp_path / "contacts.csv"
    listed.write_text("robot,dock,other,other_dock\n103,0,101,2\n101,2,103,0\n100,1,101,1\n")

    log, _, notes, _ = bring_in(tmp_path, POSES, rows, contacts=listed)

    assert named_contacts(log) == {
        frozenset([(103, 0), (101, 2)]), frozenset([(100, 1), (101, 1)]),
    }  # fmt: skip
    assert any("listed contact" in note for note in notes)
    for row, problem in {
        "100,0,9,0": "there is no robot 9",
        "100,0,100,1": "robot 100 cannot touch itself",
        "100,0,101,3": "docks count from 0 to 2",
    }.items():
        listed.write_text(f"robot,dock,other,other_dock\n{row}\n")
        with pytest.raises(InputError, match=f"contacts.csv:2: {problem}"):
            bring_in(tmp_path, POSES, rows, contacts=listed)


def test_disconnected_robots_are_dropped_on_demand(towers, tmp_path):
    """Those that remain have their contacts, and a note counts the others."""
    rows = poses_of(towers[0])
    far = [[name + 1000, x + 1e3, *rest] for name, x, *rest in rows[:5]]

    log, position, notes, _ = bring_in(
        tmp_path, POSES, [*far, *rows], anchors=(100,), drop_disconnected=True
    )

    alone = bring_in(tmp_path, POSES, rows)
    np.testing.assert_array_equal(log.robot_id, alone.log.robot_id)
    np.testing.assert_array_equal(log.contacts, alone.log.contacts)
    np.testing.assert_array_equal(position, alone.position)
    assert "5 robots disconnected from the anchor dropped" in notes


def test_heights_noise_and_further_anchors_come_from_the_poses(tmp_path):
    """Four spheres in a tetrahedron are known once three are, and the height of the last."""
    corners = np.sqrt(0.5) * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    rows = [[robot, 0, *place] for robot, place in enumerate(corners)]
    known = {"anchors": (0, 2, 1), "heights": True, "tilt_deg": 0.0}

    log = bring_in(tmp_path, SPHERES, rows, **known).log
    found = localize(log, LeastSquaresParams())

    assert log.robot_id.tolist() == [0, 2, 1, 3]
    np.testing.assert_array_equal(log.flip_height, corners[log.robot_id, 2])
    np.testing.assert_array_equal(log.fixes[:, 0], [1, 1, 1, 2, 2, 2])
    np.testing.assert_array_equal(log.fixes[:, 4].reshape(2, 3), corners[[2, 1]])
    assert log.noise == SensingNoise(tilt_deg=0.0, yaw_deg=2.0)
    np.testing.assert_allclose(found.position, corners[log.robot_id], atol=1e-6)


TRIANGLE = [[0, 0, 0, 0, 0], [0, 1, 2.6, 0, 0], [0, 2, 0, 2.6, 0]]


@pytest.mark.parametrize(
    ("header", "rows", "known", "problem"),
    [
        ("robot,x,y,z", [], {}, "poses.csv:1: the columns are neither robot,x,y,z,qw,qx,qy,qz nor"),
        (POSES, [], {}, "poses.csv:2: there are no robots"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0]], {}, "poses.csv:2: has 7 cells; 8 are needed"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0, 9]], {}, "poses.csv:2: has 9 cells; 8 are needed"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0], [1.5, *"0001000"]], {}, "poses.csv:3: robot: '1.5' is"),
        (POSES, [["a", 0, "b", 0, 1, 0, 0, 0]], {}, "poses.csv:2: robot: 'a' has no number,"),
        (POSES, [[0, 0, -2e10, 0, 1, 0, 0, 0]], {}, "poses.csv:2: y: -2e+10 is too far out"),
        (POSES, [[0, 0, 0, 0, 1, 1, 0, 0]], {}, "poses.csv:2: qw: the quaternion has length 1.41"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0]] * 2, {}, "poses.csv:3: robot 0 has a row already"),
        (POSES, [[2**62 + 1, 0, 0, 0, 1, 0, 0, 0]] * 2, {}, "robot 4611686018427387905 has a row"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0]], {"tilt_deg": -1.0}, "tilt_deg: -1.0 should be greater"),
        (POSES, [[0, 0, 0, 0, 1, 0, 0, 0]], {"anchors": (0, 5)}, "anchor: there is no robot 5"),
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
            "should have at most 64 items, not 65",
        ),
        (POSES, [[0, 1e308, 0, 0, 1, 0, 0, 0]], {}, "poses.csv:2: x: '1e+308' is not a finite"),
        (SPHERES, TRIANGLE, {"dock_offset_body": BODY}, "poses.csv: sphere: the spheres are the"),
        (
            SPHERES,
            [[robot, 0, 0.1 * robot, 0, 0] for robot in range(26)],
            {"overlap": 3.0, "gap": 3.0},
            "poses.csv: dock 0 of robot 0 has 25 contacts, more than 24; correct radius",
        ),
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
    """The message names file, line and column."""
    with pytest.raises(InputError) as refusal:
        bring_in(tmp_path, header, rows, **known)

    assert problem in str(refusal.value)


def rounded_contacts(history, folder, **known):
    """Import a structure with docks of 23.5 mm whose positions are rounded to 1 mm."""
    rows = [[row[0], *np.round(23.5 * np.array(row[1:4])), *row[4:]] for row in poses_of(history)]
    known = {"dock_radius": 23.5, "dock_offset_body": None, "gap": None, "overlap": None, **known}
    return bring_in(folder, POSES, rows, length_unit="mm", **known)


@pytest.mark.parametrize("structure", [0, 1, 2])
def test_rounded_poses_keep_their_contacts(towers, tmp_path, structure):
    """Docks that overlap by errors say how wide the gaps of contacts are, and a note says so."""
    true = {
        frozenset([(100 + i, a), (100 + j, b)])
        for i, a, j, b in observe(towers[structure], SensingParams()).contacts.tolist()
    }

    found = rounded_contacts(towers[structure], tmp_path)
    narrow = rounded_contacts(towers[structure], tmp_path, gap=0.47, overlap=0.47)

    assert len(named_contacts(found.log) & true) >= 0.97 * len(true)
    assert len(named_contacts(found.log) - true) <= 1
    assert len(named_contacts(narrow.log) & true) < 0.85 * len(true)
    assert any(note.startswith("contacts have gaps up to ") for note in found.notes)


@pytest.mark.parametrize("known", [{}, {"dock_offset_body": None}])
@pytest.mark.parametrize("columns", ["qw,qx,qy,qz", "qx,qy,qz,qw"])
def test_quaternions_in_the_other_order_are_recognized(towers, tmp_path, columns, known):
    """Numbers under the names of the other order give the contacts of the right one."""
    rows = poses_of(towers[0])
    xyzw = [[*row[:4], *row[5:], row[4]] for row in rows]
    wrong = xyzw if columns.startswith("qw") else rows
    known = {"gap": None, "overlap": None, "anchors": (100,), **known}

    found = bring_in(tmp_path, f"robot,x,y,z,{columns}", wrong, **known)

    expected = bring_in(tmp_path, POSES, rows, **known)
    np.testing.assert_array_equal(found.log.contacts, expected.log.contacts)
    # Lengths of quaternions are sums of squares in another order, which rounds differently.
    np.testing.assert_allclose(
        found.log.orientation_wxyz, expected.log.orientation_wxyz, rtol=0, atol=1e-15
    )
    order = "x, y, z, w" if columns.startswith("qw") else "w, x, y, z"
    assert found.notes[0].startswith(f"quaternions read as {order}, though columns have the other")
    assert found.notes[1:] == expected.notes
