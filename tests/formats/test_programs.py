"""One structure as some thirty programs write it: it comes out, or a line says what is wrong.

Layouts are those of the programs' manuals; numbers are our own.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.formats.test_mocap import UPWARD, motive, qualisys, vicon
from tests.formats.test_stances import assert_same_stances, sampled
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.imports import import_poses
from tiswarm.formats.poses import Assumptions
from tiswarm.sensing import SensingParams, observe

BODY = RobotGeometry().dock_offset_body
SWAPPED = [0, 2, 1]
"""Axes of a left-handed frame with y up, as Unity has it."""


def wxyz(place, turn):
    """Position, then a quaternion."""
    return [*place, *turn.as_quat(scalar_first=True)]


def xyzw(place, turn):
    """Position, then a quaternion in the other order."""
    return [*place, *turn.as_quat()]


def angles(euler, *, degrees=False, order=(0, 1, 2)):
    """Position, then angles that the program lists in some order."""
    return lambda place, turn: [*place, *turn.as_euler(euler, degrees=degrees)[[*order]]]


def axis_angle(place, turn):
    """Position, then the axis and the angle about it, as Webots writes rotations."""
    vector = turn.as_rotvec()
    angle = np.linalg.norm(vector)
    return [*place, *(vector / angle), angle]


def unity(place, turn):
    """Position and quaternion in a left-handed frame with y up."""
    x, y, z, w = turn.as_quat()
    return [*place[SWAPPED], -x, -z, -y, w]


class Format(NamedTuple):
    """How a program writes poses: a robot a row, all robots a row, or a file for each."""

    head: str
    """Names of the columns; {} stands for the robot's number where all are in a row."""

    cells: Callable[[np.ndarray, Rotation], Sequence[float]] = wxyz
    shape: str = "long"
    before: str = ""
    """Columns before those of a pose, with their cells as `name=cell`; {} is the number."""

    top: str = ""
    separator: str = ","
    known: Mapping[str, Any] = {}


def dotted(name, axes):
    """Names such as `position.x`."""
    return ",".join(f"{name}{axis}" for axis in axes)


ROS = f"{dotted('position.', 'xyz')},{dotted('orientation.', 'xyzw')}"
FIELD = f"{dotted('field.pose{}.position.', 'xyz')},{dotted('field.pose{}.orientation.', 'xyzw')}"
TF = "field.transforms{0}.transform."
FORMATS = {
    "PyBullet": Format("x [m],y [m],z [m],qx,qy,qz,qw", xyzw, before="body={}"),
    "ROS, a table of robots": Format(ROS, xyzw, before="robot_name=bot_{},twist.linear.x=9"),
    "ROS, rostopic of a robot": Format(
        dotted("field.pose.pose.position.", "xyz") + "," +
        dotted("field.pose.pose.orientation.", "xyzw"), xyzw, "folder",
        "%time=1000{},field.header.seq={},field.child_frame_id=base,field.pose.covariance0=1",
    ),
    "ROS, model_states": Format(
        FIELD, xyzw, "wide", "%time=17,field.name{}=bot_{},field.twist{}.linear.x=3"
    ),
    "ROS, tf": Format(
        dotted(f"{TF}translation.", "xyz") + "," + dotted(f"{TF}rotation.", "xyzw"), xyzw, "wide",
        "%time=17,field.transforms{}.child_frame_id=bot_{}",
    ),
    "PlotJuggler": Format(
        dotted("/bot_{}/pose/position/", "xyz") + "," + dotted("/bot_{}/pose/orientation/", "xyzw"),
        xyzw, "wide", "__time=17,/bot_{}/cmd/position/x=1",
    ),
    "Gazebo": Format("x,y,z,roll,pitch,yaw", angles("ZYX", order=(2, 1, 0)), before="model=bot_{}"),
    "SDF in degrees": Format(
        "x (m),y (m),z (m),roll (deg),pitch (deg),yaw (deg)",
        angles("ZYX", degrees=True, order=(2, 1, 0)), before="name=bot_{}",
    ),
    "Webots": Format(
        dotted("translation.", "xyz") + "," + dotted("rotation.", "xyz") + ",rotation.angle",
        axis_angle, before="name=bot{}",
    ),
    "ARGoS": Format("x y z qw qx qy qz", before="clock=10 id=fb{}", separator=" "),
    "CoppeliaSim": Format(
        dotted("/bot[{}]/p", "xyz") + ",/bot[{}]/alpha,/bot[{}]/beta,/bot[{}]/gamma",
        angles("XYZ"), "wide", "time=0.05",
    ),
    "MuJoCo, bodies": Format(
        dotted("xpos_", "xyz") + "," + dotted("xquat_", "wxyz"), before="body=robot_{}"
    ),
    "MuJoCo, qpos": Format(",".join(f"qpos[{{}}:{k}]" for k in range(7)), shape="wide"),
    "MATLAB": Format("x{},y{},z{},qw{},qx{},qy{},qz{}", shape="wide", before="t=0"),
    "TUM with a head": Format(
        "tx ty tz qx qy qz qw", xyzw, "folder", "timestamp=17.5", "# ground truth\n", " "
    ),
    "EuRoC": Format(
        dotted("p_RS_R_", ["x [m]", "y [m]", "z [m]"]) + "," + dotted("q_RS_", "wxyz"),
        shape="folder", before="timestamp [ns]=1403636580,v_RS_R_x [m s^-1]=2,b_w_RS_S_x []=3",
    ),
    "Unity": Format(
        dotted("pos_", "xyz") + "," + dotted("rot_", "xyzw"), unity, before="agent=bot_{}",
        known={"left_handed": True, "up": "y", "dock_offset_body": BODY[:, SWAPPED]},
    ),
    "units below the head": Format(
        "x;y;z;qw;qx;qy;qz", before="id={};std_x=9", separator=";", top="units"
    ),
    "names of one's own": Format(
        "mx,my,mz,o1,o2,o3,o4", before="label={},x=8,y=8,z=8",
        known={"columns": dict(zip(
            ["robot", "x", "y", "z", "qw", "qx", "qy", "qz"],
            ["label", "mx", "my", "mz", "o1", "o2", "o3", "o4"], strict=True))},
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def pose(towers):
    """Positions and orientations of the first eight robots of a tower."""
    turn = Rotation.from_quat(towers[0].orientation_wxyz[:8], scalar_first=True)
    return towers[0].position[:8], turn


def written(folder, form, place, turn):
    """Write poses as a program does; returns the file or folder."""
    names, cells = [], []
    for k in range(len(place)):
        row = [pair.partition("=")[::2] for pair in form.before.split(form.separator) if pair]
        head = [name.format(k) for name, _ in row] + form.head.format(*[k] * 7).split(
            form.separator
        )
        if "qpos" in form.head:
            head = [f"qpos[{7 * k + each}]" for each in range(7)]
        names.append(head)
        cells.append(
            [*(c.format(k) for _, c in row), *map(repr, map(float, form.cells(place[k], turn[k])))]
        )
    shared = [name for name in names[0] if name in names[-1]] if form.shape == "wide" else names[0]
    top = form.top
    if top == "units":
        top, unit = "", ";;mm;mm;mm;;;;\n"
    else:
        unit = ""
    mark = "#" * ("timestamp" in form.before)
    if form.shape == "folder":
        for k, row in enumerate(cells):
            text = f"{top}{mark}{form.separator.join(names[0])}\n{form.separator.join(row)}\n"
            (folder / f"bot_{k}.csv").write_text(text)
        return folder
    if form.shape == "wide":
        first = [n for n in names[0] if n in shared]
        head = first + [n for each in names for n in each if n not in shared]
        row = cells[0][: len(first)] + [
            c
            for each, of in zip(names, cells, strict=True)
            for n, c in zip(each, of, strict=True)
            if n not in shared
        ]
        lines = [head, row]
    else:
        lines = [names[0], *cells]
    text = "\n".join(form.separator.join(line) for line in lines)
    head, _, rest = text.partition("\n")
    (folder / "poses.csv").write_text(f"{top}{mark}{head}\n{unit}{rest}\n")
    return folder / "poses.csv"


def structure(imported):
    """What a log says in any order and body frame: docks in space, and which touch."""
    log = imported.log
    order = log.robot_id.argsort()
    docks = imported.position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    names = log.robot_id.tolist()
    touching = {frozenset([(names[i], a), (names[j], b)]) for i, a, j, b in log.contacts.tolist()}
    return log.robot_id[order], docks[order], touching


def assert_same(found, expected):
    """Assert that two logs are of one structure."""
    robots, docks, touching = structure(found)
    names, centers, contacts = structure(expected)
    np.testing.assert_array_equal(robots, names)
    np.testing.assert_allclose(docks, centers, atol=1e-4)
    assert touching == contacts


def bring_in(path, **known):
    """Import a file whose docks are FireAntV3's unless stated."""
    usual = {"dock_offset_body": BODY, "anchors": (0,), "ground_z": 0.0}
    return import_poses(path, Assumptions(**{**usual, **known}))[""]


@pytest.fixture(scope="module")
def plain(pose, tmp_path_factory):
    """The log of the poses under our own names."""
    folder = tmp_path_factory.mktemp("plain")
    form = Format("x,y,z,qw,qx,qy,qz", before="robot={}")
    return bring_in(written(folder, form, *pose))


@pytest.mark.parametrize("name", FORMATS)
def test_the_poses_of_a_program_are_read(name, pose, plain, tmp_path):
    """The structure is that of a table under our own names; no warning says anything."""
    form = FORMATS[name]

    found = bring_in(written(tmp_path, form, *pose), **form.known)

    assert_same(found, plain)
    assert found.warnings == []


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


def motive_in_angles(frames):
    """Motive's export with a row of parents, and rotations about axes of the body."""
    lines = [*motive(frames, **{"Rotation Type": "XYZ"})]
    for number, line in enumerate(lines):
        for k in range(2, len(line) - 1, 11) if number > 1 else ():
            if number > 6 and line[k] != "":
                turn = Rotation.from_quat(line[k : k + 4])
                line[k : k + 3] = turn.as_euler("XYZ", degrees=True)
        line[:] = [cell for k, cell in enumerate(line) if number < 2 or k < 2 or (k - 2) % 11 != 3]
    return [*lines[:5], ["", "Parent", *[""] * 30], *lines[5:]]


def vicon_in_vectors(frames):
    """Nexus' export of segments, whose rotations are vectors."""
    axes = ("RX", "RY", "RZ", "TX", "TY", "TZ")
    lines = [*vicon(frames, axes)]
    lines[0] = ["Segments"]
    lines[4] = ["", "", *["rad", "rad", "rad", "mm", "mm", "mm"] * 3]
    for frame, line in zip(frames, lines[5:], strict=False):
        for robot, pose in frame.items():
            vector = Rotation.from_quat(pose[3:], scalar_first=True).as_rotvec()
            line[2 + 6 * robot : 5 + 6 * robot] = vector
    return lines


EXPORTS = {
    "Motive": (motive, {"up": "y"}),
    "Motive in angles": (motive_in_angles, {"up": "y"}),
    "Qualisys": (partial(qualisys, matrix=False), {}),
    "Qualisys, matrices": (partial(qualisys, matrix=True), {}),
    "Vicon": (vicon, {}),
    "Vicon in vectors": (vicon_in_vectors, {"euler": "rotvec"}),
}


def exported(path, lines):
    """Write the lines of an export of motion capture."""
    separator = "\t" if path.suffix == ".tsv" else ","
    path.write_text("\n".join(separator.join(map(str, line)) for line in lines) + "\n")
    return path


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_of_motion_capture_is_read(name, few, frames, tmp_path):
    """Stances are those of the structure."""
    lines, known = EXPORTS[name]
    path = tmp_path / f"take.{'tsv' if 'Qualisys' in name else 'csv'}"

    found = bring_in(exported(path, lines(frames)), **known)

    assert_same_stances(found.log, observe(few, SensingParams()))


def table(folder, form, place, turn, top=""):
    """Write a table of poses that are wrong, below a comment."""
    return written(folder, form._replace(top=top), place, turn)


OURS = Format("x,y,z,qw,qx,qy,qz", before="robot={}")


def mirrored_matrix(place, turn):
    """Position, then a matrix that mirrors."""
    return [*place, *(turn.as_matrix() * [-1.0, 1.0, 1.0]).T.ravel()]


MATRIX = Format(f"x,y,z,{','.join(f'm{k}' for k in range(9))}", mirrored_matrix, before="robot={}")
GAZEBO = FORMATS["Gazebo"]
UNITS = OURS._replace(head="x [m],y [mm],z [m],qw,qx,qy,qz")
SPEEDS = OURS._replace(head="x_vel,y_vel,z_vel,qw,qx,qy,qz")
STATIC_FAULTS: dict[str, tuple[Callable[..., Any], Mapping[str, Any], str]] = {
    "left-handed": (
        lambda to, p, t: table(to, OURS, p, t, "# Frame: left-handed\n"), {},
        "poses.csv:1: the frame is left-handed; add --left-handed",
    ),
    "matrices that mirror": (
        lambda to, p, t: table(to, MATRIX, p, t), {},
        "poses.csv:2: m0: the matrix mirrors, it is no rotation; export a right-handed frame",
    ),
    "units of axes": (
        lambda to, p, t: table(to, UNITS, p, t), {},
        "poses.csv:1: the axes have different units: x in m, y in mm, z in m; convert them to one",
    ),
    "speeds alone": (
        lambda to, p, t: table(to, SPEEDS, p, t), {}, "x_vel: 'vel' is no known unit of length;",
    ),
    "quaternions from world to body": (
        lambda to, p, t: table(to, OURS, p, t.inv()), {}, "world to body give 12: add --conjugate",
    ),
    "angles in another order": (
        lambda to, p, t: table(to, GAZEBO._replace(cells=angles("XYZ")), p, t), {},
        "angles read as XYZ give 12: give --euler XYZ",
    ),
    "millimeters beside meters": (
        lambda to, p, t: table(to, OURS, 1000.0 * p, t), {"dock_offset_body": None},
        "a dock radius of 1000 in the unit of the poses gives 12: give --dock-radius 1000, and",
    ),
    "meters beside millimeters": (
        lambda to, p, t: table(to, OURS, 0.001 * p, t), {"dock_offset_body": None},
        "a dock radius of 0.001 in the unit of the poses gives 12: give --dock-radius 0.001, and",
    ),
    "docks in meters beside poses in millimeters": (
        lambda to, p, t: table(to, OURS, p, t), {"dock_offset_body": 0.001 * BODY},
        "docks 1000 times as far from the center give 12: give them in",
    ),
    "one axis in millimeters": (
        lambda to, p, t: table(to, OURS, p * [1.0, 1.0, 1000.0], t), {},
        "z times 0.001 gives 12: the axes have different units; multiply z by 0.001",
    ),
    "positions of another hand": (
        lambda to, p, t: table(to, OURS, p * [1.0, -1.0, 1.0], t), {},
        "y reversed gives 12: positions and orientations have frames of different hands",
    ),
    "y up": (
        lambda to, p, t: table(to, OURS, UPWARD.apply(p), UPWARD * t), {},
        "with y up, 4 stand and none is below: give --up y",
    ),
}  # fmt: skip
"""How a table is written, options, and the sentence that names its fault."""


@pytest.mark.parametrize("name", STATIC_FAULTS)
def test_a_fault_of_a_table_is_named(name, pose, tmp_path):
    """A refusal, or a warning beside the log."""
    write, known, sentence = STATIC_FAULTS[name]
    path = write(tmp_path, *pose)

    try:
        said = "\n".join(bring_in(path, **known).warnings)
    except InputError as refusal:
        said = str(refusal)

    assert sentence in said


def jump(frames, at):
    """Robot 1 is a meter away in one frame."""
    frames[at][1] = frames[at][1] + [100.0, 0, 0, 0, 0, 0, 0]


def swap_of_markers(frames, at):
    """Two markers of robot 1 swap, and turn it by a third of a turn, in two frames."""
    for k in (at, at + 1):
        turn = Rotation.from_quat(frames[k][1][3:], scalar_first=True)
        third = Rotation.from_euler("z", 120.0, degrees=True)
        frames[k][1] = np.array(wxyz(frames[k][1][:3], turn * third))


def swap_of_bodies(frames, at):
    """Robots 0 and 1 have each other's poses in three frames."""
    for k in (at, at + 1, at + 2):
        frames[k][0], frames[k][1] = frames[k][1], frames[k][0]


def gap(frames, at):
    """The cameras lose robot 1 in six frames."""
    for k in range(at, at + 6):
        del frames[k][1]


def cut_in_motion(frames, at):
    """The recording ends while robot 1 moves."""
    del frames[at + 2 :]


MOVING_FAULTS = {
    "a jump": (jump, "1 pose left out, robot 1 at time "),
    "markers that swap": (swap_of_markers, "2 poses left out, robot 1 at time "),
    "bodies that swap": (swap_of_bodies, "6 poses left out, robot 0 at time "),
    "a gap": (gap, "poses of bodies that the cameras lost left out"),
    "a last frame in motion": (cut_in_motion, "the tracks of 1 robot (1) end in motion"),
}


@pytest.mark.parametrize("name", MOVING_FAULTS)
def test_a_fault_of_a_track_is_named(name, few, frames, tmp_path):
    """Notes count what is left out, and the stances stay; a warning names a cut."""
    spoil, sentence = MOVING_FAULTS[name]
    spoiled = [dict(frame) for frame in frames]
    at = next(k for k, frame in enumerate(frames) if 1 in frame) + 10
    spoil(spoiled, at)

    found = bring_in(exported(tmp_path / "take.csv", motive(spoiled)), up="y")

    assert sentence in "\n".join([*found.notes, *found.warnings])
    if spoil is cut_in_motion:
        assert len(found.warnings) == 1  # that docks do not touch is no fault of the geometry
    else:
        assert_same_stances(found.log, observe(few, SensingParams()))


def test_the_command_names_columns_and_refuses_in_a_line(pose, tmp_path, tiswarm):
    """Options are those of the call; a refusal writes nothing."""
    form = FORMATS["names of one's own"]
    path = written(tmp_path, form, *pose)
    named = ",".join(f"{name}={column}" for name, column in form.known["columns"].items())
    out = tmp_path / "imported"

    wrong = tiswarm("import", path, "--out", out, "--column", "x=mz,q=o1")
    absent = tiswarm("import", path, "--out", out, "--column", "x=mw")
    done = tiswarm("import", path, "--out", out, "--column", named)

    assert (wrong.returncode, absent.returncode, done.returncode) == (2, 2, 0)
    assert "--column: 'q' is no quantity; use robot, time, join, x, y, z, qw" in wrong.stderr
    assert (
        "poses.csv:1: there is no column 'mw', or there are several; name one of" in absent.stderr
    )
    assert sorted(file.name for file in out.iterdir() if file.suffix) == [
        "sensing.jsonl",
        "truth.csv",
    ]


@pytest.mark.parametrize("order", ["xyzx", "q", "ROTVEC", "xYz"])
def test_an_order_that_there_is_not_is_refused(pose, tmp_path, order):
    """SciPy's names, and no others."""
    path = written(tmp_path, FORMATS["Gazebo"], *pose)

    with pytest.raises(InputError, match=f"euler: '{order}' is no order of angles; write it like"):
        bring_in(path, euler=order)


@given(text=st.text(alphabet="robtxyzqw0123456789.,;\t\n# []()-", max_size=200))
def test_any_text_is_a_table_or_refused(scratch, text):
    """Nothing but a line with a remedy escapes."""
    scratch.write_text(text)

    with pytest.raises(InputError):
        bring_in(scratch)


MUTATIONS = {
    "lacks a letter": lambda name: name[:-1],
    "has another letter": lambda name: f"{name}u",
    "has another word": lambda name: f"goal_{name}",
    "is in capitals": str.upper,
    "has a unit": lambda name: f"{name} [m]",
    "has blanks": lambda name: f" {name} ",
    "is empty": lambda name: "",
    "is of another robot": lambda name: re.sub(r"\d", "7", name),
}
"""What may happen to the name of a column."""


@pytest.fixture(scope="module")
def tables(pose, tmp_path_factory):
    """Tables of some programs by name, as lines of cells; each with its separator."""
    read = {}
    for name in ("PyBullet", "ROS, a table of robots", "PlotJuggler", "MATLAB"):
        form = FORMATS[name]
        lines = written(tmp_path_factory.mktemp("form"), form, *pose).read_text().splitlines()
        read[name] = [line.split(form.separator) for line in lines], form.separator
    return read


@settings(max_examples=200)
@given(
    name=st.sampled_from(["PyBullet", "ROS, a table of robots", "PlotJuggler", "MATLAB"]),
    column=st.integers(0, 60),
    mutation=st.sampled_from([*MUTATIONS]),
)
def test_a_name_that_changed_exchanges_nothing(tables, plain, scratch, name, column, mutation):
    """The table is refused or leaves robots out, or its poses are those of before."""
    lines, separator = tables[name]
    header = [*lines[0]]
    header[column % len(header)] = MUTATIONS[mutation](header[column % len(header)])
    scratch.write_text("\n".join(separator.join(cells) for cells in [header, *lines[1:]]) + "\n")

    try:
        swarm = bring_in(scratch)
    except InputError:
        return

    names, docks, _ = structure(swarm)
    _, expected, _ = structure(plain)
    np.testing.assert_allclose(docks, expected[names], atol=1e-4)
