"""Poses over time become the stances that the robots had."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.evaluation.metrics import rmse
from tiswarm.formats.imports import import_poses, write_imports
from tiswarm.formats.poses import Assumptions
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import JointParams
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.sensing import SensingParams, observe

BODY = RobotGeometry().dock_offset_body
POSES = "robot,x,y,z,qw,qx,qy,qz"


def rows_of(history):
    """Rows of robot, pose and time: each robot walks after the one before has stopped."""
    rows = []
    for robot, walk in enumerate(history.walks):
        for place, turn in zip(walk.center.tolist(), walk.orientation_wxyz.tolist(), strict=True):
            rows.append([robot, *place, *turn, len(rows)])
    return rows


def bring_in(folder, rows, header=f"{POSES},time", **known):
    """Import some rows of a structure on the ground, in units of R."""
    table = folder / "poses.csv"
    table.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    usual = {"dock_offset_body": BODY, "ground_z": 0.0, "length_unit": "R"}
    return import_poses(table, Assumptions(**{**usual, **known}))[""]


def assert_same_stances(log, sensed):
    """Check that robots of a log had the stances, contacts and pivots of another."""
    np.testing.assert_array_equal(log.contacts, sensed.contacts)
    np.testing.assert_array_equal(log.ground_docks, sensed.ground_docks)
    np.testing.assert_array_equal(log.stances.start, sensed.stances.start)
    np.testing.assert_array_equal(log.stances.pivot_dock, sensed.stances.pivot_dock)
    np.testing.assert_array_equal(log.stances.contacts, sensed.stances.contacts)
    np.testing.assert_array_equal(log.stances.ground_docks, sensed.stances.ground_docks)
    turn = Rotation.from_quat(log.stances.orientation_wxyz, scalar_first=True)
    true = Rotation.from_quat(sensed.stances.orientation_wxyz, scalar_first=True)
    assert (turn * true.inv()).magnitude().max() < 1e-6


@pytest.mark.parametrize("structure", [0, 1, 2])
def test_stances_of_a_grown_structure_come_back(towers, tmp_path, structure):
    """A row for each stance suffices, in any order; the log is that of the simulation."""
    rows = rows_of(towers[structure])
    np.random.default_rng(0).shuffle(rows)

    imported = bring_in(tmp_path, rows)
    write_imports({"": imported}, tmp_path / "in")

    sensed = observe(towers[structure], SensingParams())
    log = read_sensing_log(tmp_path / "in" / "sensing.jsonl")
    np.testing.assert_array_equal(log.robot_id, np.arange(30))
    assert_same_stances(log, sensed)
    np.testing.assert_array_equal(imported.position, towers[structure].position)
    assert imported.notes[-1] == sensed.size
    assert "no column join: robots join as they reach their final poses" in imported.notes


def sampled(history, steps, dwell, waiting):
    """Rows as a simulator writes them: all robots at each of its frames, in motion too.

    Args:
        history: Structure, whose robots walk one after the other.
        steps: Frames of each flip.
        dwell: Frames at each stance.
        waiting: Whether robots are there, far away, before they start.
    """
    rows, frame, there = [], 0, {}
    for robot, walk in enumerate(history.walks):
        turn = Rotation.from_quat(walk.orientation_wxyz, scalar_first=True)
        frames = []
        for k in range(walk.stance_count):
            frames += [(walk.center[k], turn[k])] * dwell
            if k < walk.stance_count - 1:
                arm = BODY[walk.pivot_dock[k]]
                pivot = walk.center[k] + turn[k].apply(arm)
                way = (turn[k + 1] * turn[k].inv()).as_rotvec()
                for part in np.arange(1, steps) / steps:
                    at = Rotation.from_rotvec(part * way) * turn[k]
                    frames.append((pivot - at.apply(arm), at))
        for place, at in frames:
            there[robot] = (place, at)
            rest = range(robot + 1, history.robot_count) if waiting else ()
            far = {other: ([1e3 * other, 0.0, 1.0], Rotation.identity()) for other in rest}
            for name, (where, how) in {**there, **far}.items():
                rows.append([name, *where, *how.as_quat(scalar_first=True), frame])
            frame += 1
    return rows


@pytest.fixture(scope="module")
def short(towers):
    """The first six robots of a tower."""
    history = towers[0]
    return replace(
        history, walks=history.walks[:6], loads=history.loads[:6], sensed=history.sensed[:6]
    )


@settings(max_examples=4)
@given(steps=st.integers(1, 40), dwell=st.integers(1, 4), waiting=st.booleans())
def test_any_sampling_of_motions_gives_the_same_stances(
    short, tmp_path_factory, steps, dwell, waiting
):
    """Frames between stances, repeated ones, and robots that wait elsewhere change nothing."""
    rows = sampled(short, steps, dwell, waiting)

    imported = bring_in(tmp_path_factory.mktemp("sampled"), rows, header=f"{POSES},frame")

    assert_same_stances(imported.log, observe(short, SensingParams()))
    cut = any("left out: no flip about a dock leads" in note for note in imported.notes)
    assert cut == waiting
    assert any(note.endswith(f"from {len(rows)} poses over time") for note in imported.notes)


def shaken(rows, *, sd, deg):
    """Add noise to each pose: of each coordinate [R], and of a turn about each axis [deg]."""
    rng = np.random.default_rng(0)
    for robot, *pose, time in rows:
        place = np.array(pose[:3]) + rng.normal(0.0, sd, 3)
        turn = Rotation.from_rotvec(rng.normal(0.0, np.radians(deg), 3))
        turn *= Rotation.from_quat(pose[3:], scalar_first=True)
        yield [robot, *place.tolist(), *turn.as_quat(scalar_first=True).tolist(), time]


def test_noise_at_rest_makes_no_stances(short, tmp_path):
    """Robots that rest show how far noise moves docks; each frame has the next stance."""
    rows = shaken(sampled(short, 1, 1, waiting=False), sd=0.003, deg=0.05)

    log = bring_in(tmp_path, rows).log

    sensed = observe(short, SensingParams())
    np.testing.assert_array_equal(log.stances.start, sensed.stances.start)
    np.testing.assert_array_equal(log.stances.pivot_dock, sensed.stances.pivot_dock)
    np.testing.assert_array_equal(log.stances.contacts, sensed.stances.contacts)


def test_noisy_motions_keep_nearly_all_stances(short, tmp_path):
    """A hundredth of R and a fifth of a degree blur corners; no robot loses its history."""
    rows = shaken(sampled(short, 15, 10, waiting=False), sd=0.01, deg=0.2)

    imported = bring_in(tmp_path, rows, gap=0.1, overlap=0.1)

    sensed = observe(short, SensingParams())
    count = len(sensed.stances.pivot_dock)
    assert 0.9 * count <= len(imported.log.stances.pivot_dock) <= 1.2 * count
    assert len(imported.log.stances.contacts) >= 0.9 * len(sensed.stances.contacts)
    assert not any("left out" in note for note in imported.notes)


def test_spheres_over_time_have_stances_too(short, tmp_path):
    """Docks say the same as poses, in the body frame that the first pose defines."""
    rows = []
    for robot, *pose, time in rows_of(short):
        docks = np.array(pose[:3]) + dock_offsets(np.array([pose[3:]]), BODY)[0]
        rows += [[robot, sphere, *place, time] for sphere, place in enumerate(docks.tolist())]

    log = bring_in(tmp_path, rows, header="robot,sphere,x,y,z,t", dock_offset_body=None).log

    sensed = observe(short, SensingParams())
    np.testing.assert_array_equal(log.contacts, sensed.contacts)
    np.testing.assert_array_equal(log.stances.pivot_dock, sensed.stances.pivot_dock)
    np.testing.assert_array_equal(log.stances.contacts, sensed.stances.contacts)
    np.testing.assert_array_equal(log.stances.ground_docks, sensed.stances.ground_docks)


def test_stances_gain_what_they_promise(towers, tmp_path):
    """On exact poses over time, the error of joint is a fraction of that on final poses."""
    history = towers[0]
    final = [row[:-1] for row in rows_of(history)]
    last = {row[0]: row for row in final}
    exact = {"tilt_deg": 0.0, "yaw_deg": 0.0}
    error = {}

    for name, imported in {
        "final": bring_in(tmp_path, last.values(), POSES, anchors=(0,), **exact),
        "stances": bring_in(tmp_path, rows_of(history), **exact),
    }.items():
        found = localize(imported.log, JointParams(chains=8))
        error[name] = rmse(found.position, imported.position)

    assert error["stances"] < 0.5 * error["final"]


def test_a_join_order_beats_the_clock(short, tmp_path):
    """Times may count the steps of each robot alone where a column states the join order."""
    rows, seen = [], {}
    for robot, *pose, _ in rows_of(short):
        seen[robot] = seen.get(robot, -1) + 1
        rows.append([robot, *pose, seen[robot], robot])

    log = bring_in(tmp_path, rows, header=f"{POSES},step,join").log

    assert_same_stances(log, observe(short, SensingParams()))


def test_clocks_of_each_robot_lose_no_contact_without_a_word(towers, tmp_path):
    """Recorders that start with their robot count from 0: the contacts that they cost are named."""
    rows, start = rows_of(towers[0]), {}
    own = [[*row[:-1], row[-1] - start.setdefault(row[0], row[-1])] for row in rows]

    right, found = bring_in(tmp_path, rows), bring_in(tmp_path, own)

    assert right.warnings == []
    (warning,) = found.warnings
    lost = int(re.match(r"(\d+) contacts of stances left out: by the time, ", warning)[1])
    assert lost > 0.2 * len(right.log.stances.contacts)


def test_a_clock_that_others_contradict_is_named(towers, tmp_path):
    """Flips hold on to a robot before it arrives by its clock, which is ahead by no less."""
    rows = rows_of(towers[0])
    ahead = 300
    robot = 3
    shifted = [[*row[:-1], row[-1] + ahead * (row[0] == robot)] for row in rows]

    (warning,) = bring_in(tmp_path, shifted).warnings

    pattern = rf"time shift of robot {robot} against ([\d, ]+).*: at least (\S+), by (\d+) flips"
    others, least, flips = re.search(pattern, warning).groups()
    assert "," in others
    assert 0.0 < float(least) <= ahead
    assert int(flips) > 1


def test_a_shift_within_the_waiting_time_changes_nothing(short, tmp_path):
    """Final poses do not say when they were reached: a shift that keeps the order shows nowhere."""
    rows = rows_of(short)
    shifted = [[*row[:-1], row[-1] + 0.5 * (row[0] == 2)] for row in rows]

    right, found = bring_in(tmp_path, rows), bring_in(tmp_path, shifted)

    assert found.warnings == []
    assert_same_stances(found.log, right.log)


def test_robots_in_motion_are_no_contacts(short, tmp_path):
    """What comes to a place later is not there yet: a contact with it is none."""
    rows = rows_of(short)
    late = [[robot, *pose, time + 1000 * (robot == 2)] for robot, *pose, time in rows]

    log = bring_in(tmp_path, late).log

    assert log.robot_id.tolist() == [0, 1, 3, 4, 5, 2]
    assert not (log.stances.contacts[:, 2] == 5).any()


def test_a_repeated_time_is_refused(short, tmp_path):
    """A robot is at one place at a time; without times, the message asks for them."""
    rows = rows_of(short)
    for header, problem in {
        f"{POSES},time": f"poses.csv:{len(rows) + 2}: robot 5 has a row already at time",
        f"{POSES},note": "poses.csv:3: robot 0 has a row already; keep one, or give the time of",
    }.items():
        with pytest.raises(InputError, match=re.escape(problem)):
            bring_in(tmp_path, [*rows, rows[-1]], header=header)


def test_the_anchor_is_the_first_to_rest(short, tmp_path):
    """Another one cannot be named."""
    with pytest.raises(InputError, match=r"time: robot 0 joined first, not 3; name it first"):
        bring_in(tmp_path, rows_of(short), anchors=(3,))


def test_times_of_robots_with_one_row_each_mean_nothing(towers, tmp_path):
    """A plain table may have a column of any content by that name."""
    rows = [[*row[:-1], "noon"] for row in {row[0]: row for row in rows_of(towers[0])}.values()]

    timed = bring_in(tmp_path, rows, anchors=(0,))

    plain = bring_in(tmp_path, [row[:-1] for row in rows], POSES, anchors=(0,))
    assert timed.notes == plain.notes
    assert timed.log.stances is None
    np.testing.assert_array_equal(timed.log.contacts, plain.log.contacts)


@pytest.mark.parametrize("sd", [0.005, 0.01, 0.02])
def test_tolerances_are_those_of_robots_at_rest(towers, tmp_path, sd):
    """No contact is lost to noise, and the log states how orientations vary."""
    history = replace(towers[0], walks=towers[0].walks[:8], loads=towers[0].loads[:8])
    rng = np.random.default_rng(0)
    rows = []
    for robot, *pose, frame in sampled(history, steps=8, dwell=6, waiting=False):
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.5 * sd, 3)) * Rotation.from_quat(
            pose[3:], scalar_first=True
        )
        place = np.array(pose[:3]) + rng.normal(0.0, sd, 3)
        rows.append([robot, *place, *turn.as_quat(scalar_first=True), frame])

    found = bring_in(tmp_path, rows)

    def named(log):
        name = log.robot_id.tolist()
        return {frozenset([(name[i], a), (name[j], b)]) for i, a, j, b in log.contacts.tolist()}

    assert named(observe(history, SensingParams())) <= named(found.log)
    # 1,000 steps at rest state an sd to 4 %; flips among them add some.
    (note,) = [note for note in found.notes if note.startswith("orientations vary by")]
    tilt, yaw = map(float, re.findall(r"(\S+) deg of", note)[:2])
    assert [tilt, yaw] == pytest.approx([np.degrees(0.5 * sd)] * 2, rel=0.2)
    # Rests are means of several poses.
    assert 0.0 < found.log.noise.tilt_deg < tilt
    assert 0.0 < found.log.noise.yaw_deg < yaw
