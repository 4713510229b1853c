"""Reads poses over time of other programs: GSD, TUM RGB-D, exports of motion capture.

    GSD        particles of all frames; a frame's step is its time
    TUM        time x y z qx qy qz qw, separated by spaces
    Motive     CSV, rows Type, Name, ID, then Rotation and Position; quaternions
    Qualisys   TSV, columns X, Y, Z, Roll, Pitch, Yaw, Residual and maybe Rot[0] to Rot[8]; mm
    Vicon      CSV, blocks Objects or Segments, columns RX, RY, RZ, RW, TX, TY, TZ

A folder of TUM files has one for each robot, whose name is the number in that of the file. A single
file has one line for each robot, as `tiswarm export` writes it; its time is the join index. In
exports of motion capture, a line has all rigid bodies. A body is the robot whose number is in its
name. Bodies that the cameras lost have empty cells, or zeros in Qualisys' exports.
"""

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.parts.formats import poses
from tiswarm.parts.formats.exports import gsd_library
from tiswarm.records.io import LARGEST, numbered_lines, unreadable
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import FAR_FROM_UNIT

_TUM = ["time", *"xyz", "qx", "qy", "qz", "qw"]

LONGEST_TEXT = 2**28
"""Largest content of a file of trajectories [byte], whose rows are all in memory."""


def read_gsd(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read the particles of all frames; return None if the file is not named `.gsd`.

    A particle is the robot that the logged quantity `particles/robot` names, else that of its
    index; constituents of rigid bodies are left out. Positions are from the logged `origin`, if
    there is one, and unwrapped. Docks are the spheres of their shape, if they have one.

    Raises:
        InputError: the file is damaged, or its spheres have another radius.
        EnvironmentTroubleError: the library gsd is not installed.
    """
    if path.suffix != ".gsd":
        return None
    hoomd = gsd_library()
    if not path.is_file():
        raise unreadable(
            path, OSError(0, "no regular file") if path.exists() else FileNotFoundError()
        )
    tables, docks, left_out = [], None, 0
    try:
        with hoomd.open(path, mode="r") as frames:
            for number, frame in enumerate(frames, start=1):
                particles, box = frame.particles, np.asarray(frame.configuration.box, np.float64)
                body = np.asarray(particles.body, np.int64)
                is_robot = (body < 0) | (body == np.arange(particles.N))
                left_out += int((~is_robot).sum())
                place = np.asarray(particles.position, np.float64) + frame.log.get("origin", 0.0)
                around = np.asarray(particles.image, np.float64)
                if around.any() and box[3:].any():
                    problem = (
                        f"frame {number} wraps around a box that is not rectangular; unwrap it"
                    )
                    raise InputError(problem, path=path)
                rows = pd.DataFrame(place + around * box[:3], columns=[*"xyz"])
                rows[poses.QUATERNION] = np.asarray(particles.orientation, np.float64)
                rows["robot"] = np.asarray(
                    frame.log.get("particles/robot", np.arange(particles.N)), np.int64
                )
                rows["time"], rows["line"] = float(frame.configuration.step), number
                tables.append(rows[is_robot])
                docks = _docks(particles, path, assumed.dock_radius) if docks is None else docks
    except (RuntimeError, OSError, LookupError, ValueError, TypeError, MemoryError) as error:
        raise InputError(f"not a whole GSD file ({error}); copy it again", path=path) from error
    if not sum(map(len, tables)):
        raise InputError("there are no particles; name a file with robots", path=path)
    rows = pd.concat(tables).assign(run="")
    poses.refuse_far(rows, path, assumed.dock_radius)
    notes = [f"{counted(left_out, 'constituent')} of rigid bodies left out"] if left_out else []
    return poses.PoseTable(rows, "", (), notes, docks)


def _docks(particles: object, path: Path, dock_radius: float) -> Reals | None:
    """Read the docks of the first type of particles, shape (D, 3); None if it has no spheres."""
    shape = (getattr(particles, "type_shapes", None) or [{}])[0]
    if shape.get("type") != "SphereUnion":
        return None
    for diameter in shape["diameters"]:
        if not np.isclose(diameter, 2.0 * dock_radius, rtol=1e-5):
            problem = f"the spheres have a radius of {diameter / 2.0:g}, not {dock_radius:g}"
            raise InputError(f"{problem}; give that of the file", path=path, argument="dock_radius")
    return np.array(shape["centers"], np.float64)


def read_tum(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read a folder of trajectories, one for each robot, or a file with a robot a line.

    Return None if the path is neither a folder nor named `.tum`.

    Raises:
        InputError: a line is malformed, or a file of the folder has no number in its name.
    """
    if not path.is_dir() and path.suffix != ".tum":
        return None
    drop, notes = assumed.drop_incomplete, list[str]()
    if path.is_dir():
        tables = []
        named: dict[int, str] = {}
        for file in sorted(path.glob("*.tum")):
            numbers = re.findall(r"\d+", file.stem)
            if len(numbers) != 1 or len(numbers[0]) > poses.LONGEST_NUMBER:
                problem = "the name has no number, or several; name the file as robot_7.tum"
                raise InputError(problem, path=file)
            if (other := named.setdefault(int(numbers[0]), file.name)) != file.name:
                problem = f"the name has the number of {other}; give each robot its own"
                raise InputError(problem, path=file)
            rows, lines = _trajectory(file, assumed.dock_radius)
            notes += poses.report_incomplete(file, lines, drop=drop, name=file.name)
            tables.append(rows.assign(robot=int(numbers[0]), file=str(file)))
        if not tables:
            raise InputError("there are no files *.tum; add one for each robot", path=path)
        return poses.PoseTable(pd.concat(tables).assign(run=""), "", (), notes)
    rows, lines = _trajectory(path, assumed.dock_radius)
    notes += poses.report_incomplete(path, lines, drop=drop)
    rank = rows["time"].argsort(kind="stable").argsort().to_numpy()
    note = "a robot a line, numbered by time; for poses over time, name a folder with a file each"
    return poses.PoseTable(
        rows.drop(columns="time").assign(robot=rank, join=rank, run=""), "", (), [note, *notes]
    )


def _trajectory(path: Path, dock_radius: float) -> tuple[pd.DataFrame, list[int]]:
    """Read the lines of a file, with their numbers, and list the lines that have a NaN."""
    rows, lines, incomplete = [], [], []
    for line, text in numbered_lines(path, LONGEST_TEXT):
        cells = text.split()
        if not cells or cells[0].startswith("#"):
            continue
        try:
            row = [*map(float, cells)]
        except ValueError:
            row = []
        if len(row) == len(_TUM) and np.isnan(row).any():
            incomplete.append(line)
            continue
        if len(row) != len(_TUM) or not np.abs(row).max() <= LARGEST:
            problem = (
                "is not time, x, y, z, qx, qy, qz, qw; write eight numbers with spaces between"
            )
            raise InputError(problem, path=path, line=line)
        length = float(np.linalg.norm(row[-4:]))
        if not abs(length - 1.0) <= FAR_FROM_UNIT:
            problem = f"the quaternion has length {length:.6g}; scale it to 1"
            raise InputError(problem, path=path, line=line)
        rows.append(row)
        lines.append(line)
    if not rows and not incomplete:
        raise InputError("there are no poses; add a line for each", path=path, line=1)
    if not rows:
        raise InputError("no line is complete; add a pose", path=path, line=incomplete[0])
    table = pd.DataFrame(rows, columns=_TUM).assign(line=lines)
    poses.refuse_far(table, path, dock_radius)
    return table, incomplete


_VICON = ("Objects", "Segments")
_VICON_OTHERS = ("Trajectories", "Model Outputs", "Joints", "Devices", "Unlabeled")

_LONGEST_HEAD = 100
"""Lines after which a head without an end is none; events of Qualisys have a line each."""

_Line = tuple[int, list[str]]


class _Tracked(NamedTuple):
    """Columns of one rigid body."""

    name: str
    place: tuple[int, ...]
    """Columns of x, y and z."""

    turn: tuple[int, ...]
    """Columns from which its orientation follows."""


class _Layout(NamedTuple):
    """What the head of a file says."""

    bodies: list[_Tracked]
    to_wxyz: Callable[[Reals], Reals]
    """From the numbers of all turns, shape (n, k), to quaternions, shape (n, 4)."""

    time: int
    """Column of the time or frame."""

    unit: str
    notes: list[str]
    has_blocks: bool = False
    """Whether a blank line ends the poses."""


def read_mocap(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read the rigid bodies of an export; return None if the file is none.

    Raises:
        InputError: a line is malformed, or the export lacks orientations or has them in angles
            whose order it does not state.
    """
    lines = _lines(path)
    number, first = next(lines, (1, [""]))
    start = first[0].strip()
    if start == "Format Version":
        layout = _motive(path, first, lines)
    elif start in {"FILE_VERSION", "NO_OF_FRAMES"}:
        layout = _qualisys(path, lines)
    elif start in {*_VICON, *_VICON_OTHERS}:
        layout = _vicon(path, number, start, lines)
    else:
        return None
    if not layout.bodies:
        problem = "there are no rigid bodies; export them, with orientations"
        raise InputError(problem, path=path, line=number)
    return _table(path, lines, layout, assumed.dock_radius)


def _lines(path: Path) -> Iterator[_Line]:
    """Yield the cells of each line."""
    for number, text in numbered_lines(path, LONGEST_TEXT):
        separator = "\t" if "\t" in text else ";" if text.count(";") > text.count(",") else ","
        try:
            cells = next(csv.reader([text], delimiter=separator), [])
        except csv.Error as error:
            problem = f"not a table: {error}; export the file again"
            raise InputError(problem, path=path, line=number) from error
        yield number, [cell.strip() for cell in cells] or [""]


def _head(lines: Iterator[_Line], is_last: Callable[[list[str]], bool]) -> list[list[str]]:
    """Read lines up to one that ends the head of a file, or up to the most that a head has."""
    head: list[list[str]] = []
    for _, cells in islice(lines, _LONGEST_HEAD):
        head.append(cells)
        if is_last(cells):
            break
    return head


def _motive(path: Path, first: Sequence[str], lines: Iterator[_Line]) -> _Layout:
    """Read the head of an export of Motive."""
    facts = dict(zip(first[::2], first[1::2], strict=False))
    wanted = {"Rotation Type": "Quaternion", "Coordinate Space": "Global"}
    for name, value in wanted.items():
        if facts.get(name, value) != value:
            problem = f"{name} is {facts[name][:40]}; export again with {value}"
            raise InputError(problem, path=path, line=1)
    head = _head(lines, lambda cells: cells[0] == "Frame")
    rows = {cells[1]: cells for cells in head if len(cells) > 1}
    if len(head) < 2 or not {"Type", "Name"} <= {*rows} or head[-1][0] != "Frame":  # noqa: PLR2004
        problem = "the head of Motive's export lacks rows Type, Name and Frame; export it with them"
        raise InputError(problem, path=path, line=1)
    columns: dict[str, dict[str, int]] = {}
    heads = zip(rows["Type"], rows["Name"], head[-2], head[-1], strict=False)
    for place, (kind, name, what, axis) in enumerate(heads):
        if kind == "Rigid Body" and what in {"Rotation", "Position"}:
            columns.setdefault(name, {})[f"{what} {axis}"] = place
    bodies = _bodies(columns, [f"Position {a}" for a in "XYZ"], [f"Rotation {a}" for a in "WXYZ"])
    note = "Motive has y up unless an export maps its axes: --up y"
    timed = [*head[-1], "Time (Seconds)"].index("Time (Seconds)")
    unit = facts.get("Length Units", "Meters").lower()
    time = timed if timed < len(head[-1]) else 0
    return _Layout(bodies, lambda wxyz: wxyz, time, unit, [note])


def _qualisys(path: Path, lines: Iterator[_Line]) -> _Layout:
    """Read the head of an export of Qualisys Track Manager."""
    columns: dict[str, dict[str, int]] = {}
    head = _head(lines, lambda cells: cells[0] == "Frame")
    header = head[-1] if head else [""]
    names = next((cells[1:] for cells in head if cells[0] == "BODY_NAMES"), [])
    name = ""
    for place, cell in enumerate(header):
        if found := re.fullmatch(r"(?:(.*) )?X", cell):
            name = found[1] or (names[len(columns)] if len(columns) < len(names) else "")
        if name:
            columns.setdefault(name, {})[cell.removeprefix(f"{name} ")] = place
    if not names or header[0] != "Frame":
        problem = "Qualisys' export lacks BODY_NAMES and a column Frame; export 6D data with "
        raise InputError(f"{problem}both headers", path=path, line=1)
    matrix = [f"Rot[{k}]" for k in range(9)]
    angles = ["Roll", "Pitch", "Yaw"]
    has_matrix = all({*matrix} <= {*of_body} for of_body in columns.values())
    bodies = _bodies(columns, [*"XYZ"], matrix if has_matrix else angles)
    notes = ["Roll, Pitch and Yaw are read as Qualisys' standard: about x, then y, then z"]
    time = header.index("Time" if "Time" in header else "Frame")
    to_wxyz = _from_matrix if has_matrix else _from_angles
    return _Layout(bodies, to_wxyz, time, "mm", [] if has_matrix else notes)


def _vicon(path: Path, number: int, kind: str, lines: Iterator[_Line]) -> _Layout:
    """Read the head of the first block of rigid bodies in an export of Vicon's programs."""
    while kind not in _VICON:
        number, cells = next(lines, (0, [""]))
        if number == 0:
            problem = "Vicon's export has no block Objects or Segments, so no orientations; "
            raise InputError(f"{problem}export rigid bodies, with quaternions", path=path, line=1)
        kind = cells[0] if cells[0] in _VICON else kind
    head = [cells for _, cells in islice(lines, 4)]
    columns: dict[str, dict[str, int]] = {}
    names, axes, units = (head + [[]] * 4)[1:4]
    name = ""
    for place, axis in enumerate(axes):
        if place < len(names) and names[place]:
            name = names[place].removeprefix("Global Angle ").partition(":")[0]
        if name and re.fullmatch("[RT][XYZW]", axis):
            columns.setdefault(name, {})[axis] = place
    bodies = _bodies(columns, ["TX", "TY", "TZ"], ["RW", "RX", "RY", "RZ"])
    if columns and not bodies:
        problem = "Vicon's rotations are RX, RY, RZ: angles in an order that the file does not "
        raise InputError(f"{problem}state; export quaternions", path=path, line=number + 3)
    unit = units[bodies[0].place[0]] if bodies and bodies[0].place[0] < len(units) else "mm"
    return _Layout(bodies, lambda wxyz: wxyz, 0, unit or "mm", [], has_blocks=True)


def _bodies(
    columns: dict[str, dict[str, int]], place: Sequence[str], turn: Sequence[str]
) -> list[_Tracked]:
    """Choose the bodies that have all columns of a pose."""
    return [
        _Tracked(name, tuple(of_body[p] for p in place), tuple(of_body[t] for t in turn))
        for name, of_body in columns.items()
        if {*place, *turn} <= {*of_body}
    ]


def _from_matrix(numbers: Reals) -> Reals:
    """Convert matrices that are listed column by column."""
    matrix = numbers.reshape(-1, 3, 3).swapaxes(1, 2)
    wxyz: Reals = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return wxyz


def _from_angles(numbers: Reals) -> Reals:
    """Convert turns about x, y and z of the body, one after the other [deg]."""
    wxyz: Reals = Rotation.from_euler("XYZ", numbers, degrees=True).as_quat(scalar_first=True)
    return wxyz


def _table(
    path: Path, lines: Iterator[_Line], layout: _Layout, dock_radius: float
) -> poses.PoseTable:
    """Read the lines with poses, and give each body a number."""
    robots, renamed = _numbers([body.name for body in layout.bodies])
    rows: list[tuple[float, ...]] = []
    turns: list[list[float]] = []
    lost = 0
    for number, cells in lines:
        if not any(cells):
            if layout.has_blocks:
                break
            continue
        for robot, body in zip(robots, layout.bodies, strict=True):
            place = _pose(path, number, cells, body)
            if place is None:
                lost += 1
            else:
                time = _number(path, number, cells, layout.time)
                rows.append((robot, number, time, *place[:3]))
                turns.append(place[3:])
    if not rows:
        raise InputError("there are no poses; export frames with bodies", path=path, line=1)
    table = pd.DataFrame(rows, columns=["robot", "line", "time", *"xyz"])
    table[poses.QUATERNION] = layout.to_wxyz(np.array(turns))
    table = table.astype({"robot": int, "line": int}).assign(run="")
    poses.refuse_far(table, path, dock_radius)
    gone = f"{counted(lost, 'pose')} of bodies that the cameras lost left out"
    return poses.PoseTable(table, layout.unit, (), [*layout.notes, *renamed, *[gone] * (lost > 0)])


def _pose(path: Path, line: int, cells: Sequence[str], body: _Tracked) -> list[float] | None:
    """Read position and turn of a body; None if the cameras lost it."""
    columns = (*body.place, *body.turn)
    if max(columns) >= len(cells) or not all(cells[column] for column in columns):
        return None
    numbers = [_number(path, line, cells, column) for column in columns]
    return numbers if any(numbers) else None


def _number(path: Path, line: int, cells: Sequence[str], column: int) -> float:
    text = cells[column] if column < len(cells) else ""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= LARGEST:
        problem = f"{text[:40]!r} in column {column + 1} is no number; export the file again"
        raise InputError(problem, path=path, line=line)
    return number


def _numbers(names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Take the numbers of robots from their names, or count them and say so."""
    found = [re.findall(r"\d+", name) for name in names]
    numbers = [
        int(each[0]) for each in found if [len(n) <= poses.LONGEST_NUMBER for n in each] == [True]
    ]
    if len({*numbers}) == len(names):
        return numbers, []
    listed = ", ".join(f"{name} is {number}" for number, name in enumerate(names[:3]))
    more = ", ..." * (len(names) > 3)  # noqa: PLR2004
    return [*range(len(names))], [f"bodies are numbered as listed: {listed}{more}"]
