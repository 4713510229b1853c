"""Exports of motion-capture programs are read, or their layout is named with what to export."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.formats.test_stances import BODY, assert_same_stances, sampled
from tiswarm.base.errors import InputError
from tiswarm.formats.imports import import_poses
from tiswarm.formats.poses import Assumptions
from tiswarm.sensing import SensingParams, observe

UPWARD = Rotation.from_euler("x", -90.0, degrees=True)
"""From z up to y up."""


@pytest.fixture(scope="module")
def few(towers):
    """The first three robots of a tower."""
    return replace(towers[0], walks=towers[0].walks[:3], loads=towers[0].loads[:3])


@pytest.fixture(scope="module")
def frames(few):
    """By frame, the pose of each robot that is there: center, then quaternion wxyz."""
    rows = sampled(few, steps=5, dwell=3, waiting=False)
    frames = [{} for _ in range(rows[-1][-1] + 1)]
    for robot, *pose, frame in rows:
        frames[frame][robot] = np.array(pose)
    return frames


def bring_in(path, lines, separator=",", **known):
    """Import the lines of an export in units of R."""
    path.write_text("\n".join(separator.join(map(str, line)) for line in lines) + "\n")
    return import_poses(path, Assumptions(dock_offset_body=BODY, ground_z=0.0, **known))[""]


def motive(frames, **facts):
    """Lines as Motive writes them: y up, a marker beside each body, blanks for lost ones."""
    facts = {
        "Format Version": 1.23, "Take Name": "a, b", "Rotation Type": "Quaternion",
        "Length Units": "Meters", "Coordinate Space": "Global", **facts,
    }  # fmt: skip
    first = [f'"{cell}"' if "," in str(cell) else cell for pair in facts.items() for cell in pair]
    yield first
    yield []
    kinds = ["Rigid Body"] * 8 + ["Marker"] * 3
    yield ["", "Type", *kinds * 3]
    yield ["", "Name", *(f"bot {robot}" for robot in range(3) for _ in kinds)]
    yield ["", "ID", *range(33)]
    pose = ["Rotation"] * 4 + ["Position"] * 3
    yield ["", "", *[*pose, "Mean Marker Error", *["Position"] * 3] * 3]
    yield ["Frame", "Time (Seconds)", *[*"XYZWXYZ", "", *"XYZ"] * 3]
    for number, frame in enumerate(frames):
        line = [number, number / 100.0]
        for robot in range(3):
            if robot in frame:
                turn = UPWARD * Rotation.from_quat(frame[robot][3:], scalar_first=True)
                line += [*turn.as_quat(), *UPWARD.apply(frame[robot][:3]), 0.001, 9, 9, 9]
            else:
                line += [""] * 11
        yield line


def qualisys(frames, *, matrix, names_repeated=True):
    """Lines as Qualisys Track Manager writes them, zeros for lost bodies."""
    yield ["NO_OF_FRAMES", len(frames)]
    yield ["NO_OF_BODIES", 3]
    yield ["FREQUENCY", 100]
    yield ["BODY_NAMES", "bot0", "bot1", "bot2"]
    columns = [
        *"XYZ",
        "Roll",
        "Pitch",
        "Yaw",
        "Residual",
        *(f"Rot[{k}]" for k in range(9 * matrix)),
    ]
    named = [
        f"bot{robot} {name}" if names_repeated or name == "X" else name
        for robot in range(3)
        for name in columns
    ]
    yield ["Frame", "Time", *named]
    for number, frame in enumerate(frames):
        line = [number + 1, number / 100.0]
        for robot in range(3):
            if robot in frame:
                turn = Rotation.from_quat(frame[robot][3:], scalar_first=True)
                angles = [0, 0, 0] if matrix else turn.as_euler("XYZ", degrees=True)
                line += [*frame[robot][:3], *angles, 0.1, *turn.as_matrix().T.ravel()[: 9 * matrix]]
            else:
                line += [0.0] * len(columns)
        yield line


def vicon(frames, axes=("RX", "RY", "RZ", "RW", "TX", "TY", "TZ")):
    """Lines as Vicon Tracker writes them, with a block of markers after that of objects."""
    yield ["Objects"]
    yield [100]
    blank = [""] * (len(axes) - 1)
    yield ["", "", *(cell for k in range(3) for cell in [f"Global Angle bot{k}:bot{k}", *blank])]
    yield ["Frame", "Sub Frame", *axes * 3]
    yield ["", "", *["", "", "", "", "mm", "mm", "mm"][-len(axes) :] * 3]
    for number, frame in enumerate(frames):
        line = [number + 1, 0]
        for robot in range(3):
            if robot in frame:
                turn = Rotation.from_quat(frame[robot][3:], scalar_first=True)
                line += [*turn.as_quat(), *frame[robot][:3]][-len(axes) :]
            else:
                line += [""] * len(axes)
        yield line
    yield []
    yield ["Trajectories"]


def test_rigid_bodies_of_motive_are_read(few, frames, tmp_path):
    """With the axis that is up, stances are those of the structure; without, a note names it."""
    found = bring_in(tmp_path / "take.csv", motive(frames), up="y")

    assert_same_stances(found.log, observe(few, SensingParams()))
    assert found.log.length_unit == "meters"
    advice = "Motive has y up unless an export maps its axes: --up y"
    assert bring_in(tmp_path / "turned.csv", motive(frames)).notes[0] == advice
    assert advice not in found.notes
    lost = sum(3 - len(frame) for frame in frames)
    assert found.notes[0] == f"{lost} poses of bodies that the cameras lost left out"


@pytest.mark.parametrize("repeated", [True, False])
@pytest.mark.parametrize("matrix", [True, False])
def test_rigid_bodies_of_qualisys_are_read(few, frames, tmp_path, matrix, repeated):
    """Matrices list columns and need no convention of angles; the angles are the standard ones."""
    lines = qualisys(frames, matrix=matrix, names_repeated=repeated)

    found = bring_in(tmp_path / "take.tsv", lines, "\t")

    assert_same_stances(found.log, observe(few, SensingParams()))
    assert found.log.length_unit == "mm"
    assert any("about x, then y" in note for note in found.notes) != matrix


def test_rigid_bodies_of_vicon_are_read(few, frames, tmp_path):
    """Quaternions suffice; the block of markers after that of objects is left alone."""
    found = bring_in(tmp_path / "take.csv", vicon(frames))

    assert_same_stances(found.log, observe(few, SensingParams()))
    assert found.log.length_unit == "mm"


def test_bodies_without_numbers_are_counted(frames, tmp_path):
    """A note says which body is which robot."""
    lines = [
        [str(cell).replace("bot 0", "ann").replace("bot 1", "bob") for cell in line]
        for line in motive(frames)
    ]

    found = bring_in(tmp_path / "take.csv", lines, up="y")

    assert "bodies are numbered as listed: ann is 0, bob is 1, bot 2 is 2" in found.notes
    assert sorted(found.log.robot_id) == [0, 1, 2]


def exports_without_poses(frames):
    """Exports from which no poses follow, with what to do."""
    angles = ("RX", "RY", "RZ", "TX", "TY", "TZ")
    yield motive(frames, **{"Coordinate Space": "Local"}), ":1: Coordinate Space is Local; export"
    yield [*motive(frames)][:4], ":1: the head of Motive's export lacks rows Type, Name and Frame"
    yield [*motive(frames)][:7], ":1: there are no poses; export frames with bodies"
    yield [*motive(frames[:1]), [3, "x", *[1] * 33]], ":9: Time (Seconds): 'x' is not a finite"
    yield vicon(frames, angles), ":5: bot0/RX,bot0/RY,bot0/RZ are angles in an order that the"
    yield [["Trajectories"], [100]], ":1: Vicon's export has no block Objects or Segments, so no"
    yield [["NO_OF_MARKERS", 3], ["NO_OF_FRAMES", 2]], ":1: the columns are neither robot,x,y,z,"
    yield [["NO_OF_FRAMES", 3], ["Frame", "Time"]], ":1: Qualisys' export lacks BODY_NAMES and a"


def test_exports_without_poses_are_refused_with_what_to_export(frames, tmp_path):
    """The line names the layout and the step in the program that wrote it."""
    for number, (lines, problem) in enumerate(exports_without_poses(frames)):
        path = tmp_path / f"{number}.csv"

        with pytest.raises(InputError, match=re.escape(f"{path}{problem}")):
            bring_in(path, lines)


@pytest.mark.parametrize("names", [("bot 1", "bot 01", "bot 2"), ("bot 1", f"bot {10**19}", "b3")])
def test_bodies_whose_numbers_are_no_names_are_counted(frames, tmp_path, names):
    """Two bodies under one number would be one robot, and a serial number has too many digits."""
    lines = [*motive(frames)]
    lines[3] = ["", "Name", *(name for name in names for _ in range(11))]

    found = bring_in(tmp_path / "take.csv", lines, up="y")

    assert sorted(found.log.robot_id) == [0, 1, 2]
    assert any(note.startswith("bodies are numbered as listed: bot 1 is 0") for note in found.notes)


def test_a_blank_line_ends_no_export_of_motive(frames, tmp_path):
    """Somebody who joined two takes left one, and the poses after it count."""
    lines = [*motive(frames)]

    whole = bring_in(tmp_path / "whole.csv", lines, up="y")
    parted = bring_in(tmp_path / "parted.csv", [*lines[:20], [], *lines[20:], []], up="y")

    assert np.array_equal(parted.position, whole.position)
    assert parted.notes == whole.notes
