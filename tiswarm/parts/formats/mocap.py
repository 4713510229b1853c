"""Reads rigid bodies in the exports of motion-capture programs, which list all bodies in each line.

    Motive     CSV, rows Type, Name, ID, then Rotation and Position; quaternions
    Qualisys   TSV, columns X, Y, Z, Roll, Pitch, Yaw, Residual and maybe Rot[0] to Rot[8]; mm
    Vicon      CSV, blocks Objects or Segments, columns RX, RY, RZ, RW, TX, TY, TZ

A body is the robot whose number is in its name. Bodies that the cameras lost have empty cells, or
zeros in Qualisys' exports.
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
from tiswarm.parts.formats.poses import LONGEST_NUMBER, QUATERNION, PoseTable, refuse_far
from tiswarm.parts.formats.trajectories import LONGEST_TEXT
from tiswarm.records.io import LARGEST, numbered_lines
from tiswarm.records.messages import counted

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


def read_mocap(path: Path, *, dock_radius: float) -> PoseTable | None:
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
    return _table(path, lines, layout, dock_radius)


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


def _table(path: Path, lines: Iterator[_Line], layout: _Layout, dock_radius: float) -> PoseTable:
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
    table[QUATERNION] = layout.to_wxyz(np.array(turns))
    table = table.astype({"robot": int, "line": int}).assign(run="")
    refuse_far(table, path, dock_radius)
    gone = f"{counted(lost, 'pose')} of bodies that the cameras lost left out"
    return PoseTable(table, layout.unit, (), [*layout.notes, *renamed, *[gone] * (lost > 0)])


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
    numbers = [int(each[0]) for each in found if [len(n) <= LONGEST_NUMBER for n in each] == [True]]
    if len({*numbers}) == len(names):
        return numbers, []
    listed = ", ".join(f"{name} is {number}" for number, name in enumerate(names[:3]))
    more = ", ..." * (len(names) > 3)  # noqa: PLR2004
    return [*range(len(names))], [f"bodies are numbered as listed: {listed}{more}"]
