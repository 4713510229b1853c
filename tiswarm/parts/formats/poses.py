"""Poses of robots, of any simulator or motion-capture system, and tables of docks and contacts.

Columns are read by their meaning: names, units, times. What a table does not state, an import has
to assume.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.records.io import MAX_TABLE_BYTES, CsvFile, numbered_lines
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import FAR_FROM_UNIT
from tiswarm.records.sensing_log import FARTHEST

TOLERANCE = 0.02
"""Largest gap and overlap of a contact unless stated otherwise [dock radii]."""


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Facts that a table of poses does not state; lengths in its own unit."""

    dock_radius: float = 1.0
    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None for the three docks in a plane at which
    most docks touch. A table of spheres needs none."""

    gap: float | None = None
    """Largest gap of two docks in contact; if None, 2 % of the dock radius, or more where errors
    of the poses make docks overlap by more."""

    overlap: float | None = None
    """Largest overlap of two docks in contact; as for `gap` if None."""

    contacts: Path | None = None
    """Table `robot,dock,other,other_dock` of all contacts; found from the gaps if None."""

    anchors: tuple[int, ...] = ()
    """Names of robots at known positions, the anchor first; the first robot to join, or of the
    file, if there are none."""

    up: str = "z"
    """Axis of the poses that is up: x, y, z, -x, -y or -z; it becomes z."""

    conjugate: bool = False
    """Whether quaternions turn the world frame to the body's, instead of body to world."""

    ground_z: float | None = None
    """Height of flat ground; None where there is none."""

    heights: bool = False
    """Whether the robots know the heights of their centers."""

    left_handed: bool = False
    """Whether the frame of the poses is left-handed; one horizontal axis is then reversed."""

    euler: str = ""
    """Order of angles, as `turns_by` has it; empty where the file or its columns imply it."""

    columns: Mapping[str, str] = field(default_factory=dict)
    """Columns of the table by what they mean, such as `{"x": "center_x"}`, where names do not say
    so."""

    beacons: Path | None = None
    """Table of beacons, where the file has ranges instead of poses."""

    range_sd: float | None = None
    """Standard deviation of a range, where the file states none."""

    drop_disconnected: bool = False
    """Whether to drop the robots that contacts do not connect to an anchor."""

    drop_incomplete: bool = False
    """Whether to drop rows that lack a number, instead of refusing them."""

    glitch_frames: int = 10
    """Most poses in a row that are left out as one error of tracking; 0 keeps all."""

    tilt_deg: float | None = None
    """Standard deviation of orientations about horizontal axes [deg]; stated if not None."""

    yaw_deg: float | None = None
    """Standard deviation of orientations about the vertical [deg]; stated if not None."""

    length_unit: str = "unit"
    """Unit of lengths where the columns do not name it."""

    @property
    def largest_gap(self) -> float:
        """Largest gap of two docks in contact."""
        return TOLERANCE * self.dock_radius if self.gap is None else self.gap

    @property
    def largest_overlap(self) -> float:
        """Largest overlap of two docks in contact."""
        return TOLERANCE * self.dock_radius if self.overlap is None else self.overlap

    @property
    def spacing(self) -> Reals:
        """Least and greatest distance of the centers of two docks in contact, shape (2,)."""
        return 2.0 * self.dock_radius + np.array([-self.largest_overlap, self.largest_gap])

    @property
    def level(self) -> Reals:
        """Least and greatest height of the center of a dock on the ground; NaN without, (2,)."""
        ground = math.nan if self.ground_z is None else self.ground_z
        return ground + self.dock_radius + np.array([-self.largest_overlap, self.largest_gap])


QUATERNION = ["qw", "qx", "qy", "qz"]
_AXES = [*"xyz"]
LONGEST_NUMBER = 18
"""Digits of a number that an integer of 64 bits holds."""

_NAMES = {
    "robot": (
        *("robot", "robot_id", "id", "robot_name", "name", "model", "model_name", "body", "agent"),
        *("rigid_body", "child_frame_id"),
    ),
    "time": (
        *("time", "t", "stamp", "timestamp", "frame", "step", "tick", "clock", "sim_time"),
        *("header.stamp", "__time"),
    ),
}
"""Names of a column, the first that a table has is read; others have their meaning as name."""

LENGTHS = (
    *("m", "cm", "mm", "dm", "um", "µm", "nm", "km", "in", "ft", "yd", "R"),
    *("meters", "centimeters", "millimeters", "inches", "feet"),
)
"""Units of length that a column may name, in capitals or not. Other words after an axis name other
quantities, such as velocities and standard deviations."""

_NO_UNIT = "unit"
"""Unit of tables that name none, as exports write it."""

_TIMES = ("s", "sec", "seconds", "ms", "us", "µs", "ns", "min", "steps", "frames")
"""Units of time that a column may name."""

_ANGLES = {"deg": True, "degrees": True, "°": True, "rad": False, "radians": False}
"""Whether a unit of angles that a column may name is the degree."""

_UNIT = re.compile(
    r"(?P<name>.*?)\s*(?:_(?P<suffix>[A-Za-z°µ]+)|[\[(]\s*(?P<brackets>[^\])\d]*?)\s*[\])])"
)
"""A name with its unit: `x_mm`, `x [mm]`, `x (mm)`."""

_QUANTITIES = {
    r"(?P<body>.*)qpos[\W_]*(?P<number>\d+)\]?": "",
    r"(?P<body>)p(?:_[a-z]{1,2})+_(?P<axis>[xyz])": "",
    r"(?P<body>)q(?:_[a-z]{1,2})+_(?P<axis>[wxyz])": "q",
    r"(?P<body>.*?)(?P<axis>roll|pitch|yaw|alpha|beta|gamma)": "",
    r"(?P<body>.*?)(?:rotation|rot)?[\W_]*(?P<axis>angle)": "",
    r"(?P<body>.*?)(?:rotation|rot|r)(?P<axis>[wxyz])": "r",
    r"(?P<body>.*?)(?:rotation|rot)[\W_]+(?P<axis>[wxyz])": "r",
    r"(?P<body>.*?)(?:orientation|quaternion|x?quat|q)[\W_]*(?P<axis>[wxyz])": "q",
    r"(?P<body>.*?)(?:axis[\W_]*|a)(?P<axis>[xyz])": "a",
    r"(?P<body>.*?)(?:rot\[|matrix[\W_]*|m)(?P<axis>\d)\]?": "m",
    r"(?P<axis>[xyz])[\W_]*(?P<body>\d+)": "",
    r"q(?P<axis>[wxyz])[\W_]*(?P<body>\d+)": "q",
    r"(?P<body>.*?)(?P<axis>[xyz])[\W_]*(?:position|pos)": "",
    r"(?P<body>.*?)(?:position|x?pos|translation|trans|location|p|t)?[\W_]*(?P<axis>[xyz])": "",
}
"""Names of quantities as programs write them, in lower case, and how their meanings begin. The body
is the rest; the numbers of `qpos` are those of free joints in a row."""

_QPOS = ("x", "y", "z", "qw", "qx", "qy", "qz")

_MESSAGES = {*("field", "pose", "msg", "data", "transform", "header", "state"), ""}
"""Parts of a message's name that name no robot."""

_OTHERS = {
    *("vel", "velocity", "twist", "linear", "angular", "acc", "accel", "acceleration", "v", "w"),
    *("cmd", "command", "goal", "target", "desired", "setpoint", "ref", "reference", "origin"),
    *("std", "sd", "sigma", "cov", "covariance", "var", "err", "error", "residual", "rms"),
    *("force", "torque", "wrench", "omega", "gyro", "bias", "imu", "mag", "d", "delta"),
}
"""Words before an axis that name other quantities than poses."""

TURNS: Mapping[tuple[str, ...], str] = {
    ("qw", "qx", "qy", "qz"): "",
    ("rw", "rx", "ry", "rz"): "",
    ("angle", "rx", "ry", "rz"): "",
    ("angle", "ax", "ay", "az"): "",
    tuple(f"m{k}" for k in range(9)): "",
    ("roll", "pitch", "yaw"): "ZYX",
    ("alpha", "beta", "gamma"): "XYZ",
    ("rx", "ry", "rz"): "",
}
"""By the quantities that state an orientation, the order of angles that programs with these names
have: roll, pitch, yaw as ROS and Gazebo, alpha, beta, gamma as CoppeliaSim."""

EULER = (
    *("ZYX", "XYZ", "YXZ", "ZXY", "XZY", "YZX"),
    *("zxz", "zyz", "xyx", "xzx", "yxy", "yzy"),
)
"""Orders of angles that are tried; the fixed-axis order of one is the reverse of another."""


class Sheet(NamedTuple):
    """Text of a table whose head is one line, and what the program that wrote it implies."""

    text: str
    program: str = ""
    length_unit: str = ""
    degrees: bool | None = None
    """Whether angles are in degrees where columns do not say; None if that is unknown."""

    euler: str = ""
    """Order of angles; empty where the names of columns decide."""

    notes: Sequence[str] = ()

    @property
    def line(self) -> int:
        """Line of the head."""
        return 1 + len(re.match(r"(?:#[^\n]*\n)*", self.text)[0].splitlines())  # type: ignore[index]


class PoseTable(NamedTuple):
    """Poses, or spheres, of all robots in the order of their file."""

    rows: pd.DataFrame
    """Columns `robot`, `x`, `y`, `z`, then `qw`, `qx`, `qy`, `qz` or `sphere`; `join` and `time`
    where the file has them; `line`, and `run` with the name of the structure; `a1`, `a2`, `a3`
    [rad] where it has angles."""

    length_unit: str
    """Unit of lengths as the columns name it; empty where they do not."""

    quaternion_order: Sequence[str]
    """Columns of the quaternion in the order of the file; none of spheres and angles."""

    notes: Sequence[str] = ()
    """What was left out, in lines."""

    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None where the file has no docks."""


class _Column(NamedTuple):
    """What the name of a column says."""

    name: str
    body: str
    meaning: str
    unit: str


class _PoseColumns(NamedTuple):
    """Columns of a robot, or of all of them."""

    name: str
    columns: dict[str, str]  # by x, y, z and the quantities of its orientation
    turn: tuple[str, ...]  # the quantities of its orientation
    unit: str


def read_table(
    path: Path, assumed: Assumptions, sheet: Sheet | None = None, robot: int | None = None
) -> PoseTable:
    """Read a table of poses, or `robot,sphere,x,y,z`, in any order of columns.

    A row has the pose of one robot, which a column names, or the poses of all, whose names the
    columns begin with. Times count only where a robot, or sphere, has several rows: other tables
    are free to have a column of that name.

    Args:
        path: The table.
        assumed: Facts that the table does not state.
        sheet: The table as text, if it is not in the file as it is.
        robot: Number of the robot that all rows are of; None if the table names robots.

    Raises:
        InputError: the table is malformed, or lacks a column.
    """
    sheet = sheet or plain_sheet(path)
    said = re.search(r"left[-_ ]?hand", sheet.text[:10_000], re.IGNORECASE)
    if said and not assumed.left_handed:
        problem = "the frame is left-handed; add --left-handed to turn it to a right-handed one"
        raise InputError(problem, path=path, line=1 + sheet.text.count("\n", 0, said.start()))
    table = CsvFile(path, sheet.text)
    known = _known_columns(table.columns, assumed, path)
    bodies = _bodies(table.columns, known, assumed, path, sheet, is_one=robot is not None)
    is_wide = "robot" not in known and robot is None
    pick = _of_bodies if is_wide else partial(_of_rows, robot=robot)
    rows, notes = pick(table, bodies, known, assumed)
    numbers = dict(zip(bodies[0].columns, bodies[0].columns.values(), strict=True))
    if "sphere" not in known:
        notes += _add_quaternions(rows, table, bodies[0], assumed, sheet)
    refuse_far(rows, path, assumed.dock_radius, numbers)
    order: list[str] = []
    if bodies[0].turn in {("qw", "qx", "qy", "qz"), ("rw", "rx", "ry", "rz")}:
        place = dict(zip(QUATERNION, (numbers[name] for name in bodies[0].turn), strict=True))
        order = sorted(QUATERNION, key=lambda name: table.columns.index(place[name]))
    return PoseTable(rows, bodies[0].unit or sheet.length_unit, order, [*sheet.notes, *notes])


def plain_sheet(path: Path) -> Sheet:
    """Read a table of any separator; its head is the first line, or a comment before numbers.

    Lines keep their numbers. A line of units below the head becomes part of it.
    """
    lines = [text.rstrip("\r\n") for _, text in numbered_lines(path, MAX_TABLE_BYTES)]
    bare = [k for k, text in enumerate(lines) if text.strip() and not text.startswith("#")]
    head = bare[0] if bare else 0
    comments = [k for k in range(head) if re.match(r"[#%]\s*[A-Za-z_]", lines[k])]
    if bare and comments and _are_numbers(_cells(lines[head])):
        head = comments[-1]
    elif not bare:
        return Sheet("\n".join(lines))
    names = _cells(lines[head].lstrip("#% "))
    sep = max("\t,;", key=lines[head].count)
    after = next((k for k in bare if k > head), head)
    units = _cells(lines[after])
    is_unit = {unit.lower() for unit in (*LENGTHS, *_TIMES, *_ANGLES, "")}
    if after > head and any(units) and {unit.strip("[]() ").lower() for unit in units} <= is_unit:
        names = [
            f"{name} [{unit.strip('[]() ')}]" if unit else name
            for name, unit in zip(names, units, strict=False)
        ]
        lines[after] = "#"
    if sep not in lines[head]:
        lines = ["\t".join(text.split()) for text in lines]
    text = [text if text.strip() else "#" for text in lines]
    above = [line if line.startswith("#") else f"#{line}" for line in text[:head]]
    return Sheet("\n".join([*above, header_line(names, sep), *text[head + 1 :]]))


def header_line(names: Sequence[str], separator: str) -> str:
    """Write names as a line of a table."""
    line = io.StringIO()
    csv.writer(line, delimiter=separator, lineterminator="").writerow(names)
    return line.getvalue()


def _cells(text: str) -> list[str]:
    """Split a line at the separator that it has."""
    sep = max("\t,;", key=text.count)
    try:
        cells = next(csv.reader([text], delimiter=sep), []) if sep in text else text.split()
    except csv.Error:
        cells = text.split(sep)
    return [cell.strip() for cell in cells]


def _are_numbers(cells: Sequence[str]) -> bool:
    return all(re.fullmatch(r"[-+\d.,eE]*|-?nan", cell) for cell in cells)


def refuse_far(
    rows: pd.DataFrame, path: Path, dock_radius: float, columns: Mapping[str, str] | None = None
) -> None:
    """Raise InputError where a coordinate is too large for a log, or is not a number.

    Args:
        rows: Rows of a table of poses.
        path: Their file.
        dock_radius: Radius of a dock sphere.
        columns: Names of the columns in the file; x, y and z if None.
    """
    for axis in _AXES:
        far = np.flatnonzero(~(np.abs(rows[axis].to_numpy()) <= FARTHEST * dock_radius))
        if len(far):
            value, line = rows[axis].iloc[far[0]], int(rows["line"].iloc[far[0]])
            problem = f"{value:g} is too far out; move the origin to the robots"
            key = axis if columns is None else columns[axis]
            raise InputError(problem, path=path, line=line, key=key)


def _known_columns(header: Sequence[str], assumed: Assumptions, path: Path) -> dict[str, str]:
    """Find the columns that an option names, and those of robots, times, joins and spheres."""
    quantities = {*chain(*TURNS), *_AXES, "robot", "time", "join", "sphere", "run"}
    for meaning, column in assumed.columns.items():
        if meaning not in quantities:
            names = ", ".join(
                ["robot", "time", "join", *_AXES, *QUATERNION, "roll", "pitch", "yaw"]
            )
            problem = f"{meaning!r} is no quantity; use {names}"
            raise InputError(problem, argument="column")
        if header.count(column) != 1:
            problem = f"there is no column {column!r}, or there are several; name one of "
            raise InputError(problem + ",".join(header)[:200], path=path, line=1)
    found = {
        name: column
        for name in ("robot", "sphere", "join", "time", "run")
        if (column := assumed.columns.get(name) or _find(header, name))
    }
    repeated = next((column for column in found.values() if header.count(column) > 1), "")
    if repeated:
        problem = f"there are {header.count(repeated)} columns of this name; rename all but one"
        raise InputError(problem, path=path, line=1, key=repeated)
    return found


def _bodies(
    header: Sequence[str],
    known: Mapping[str, str],
    assumed: Assumptions,
    path: Path,
    sheet: Sheet,
    *,
    is_one: bool,
) -> list[_PoseColumns]:
    """Find the columns of each robot, or those of all robots if a column names them."""
    forced = {column: meaning for meaning, column in assumed.columns.items()}
    units = {unit.lower() for unit in ("", *LENGTHS, _NO_UNIT, assumed.length_unit)}
    columns = []
    for name in header:
        read = _meaning(name, units, is_export=bool(sheet.program))
        if name in forced:
            columns.append(_Column(name, "", forced[name], read.unit if read else ""))
        elif name not in known.values() and read and read.meaning not in assumed.columns:
            columns.append(read)
    names = [*dict.fromkeys(column.body for column in columns)]
    found = {name: _body(name, [c for c in columns if c.body == name], path) for name in names}
    whole = [body for body in found.values() if {*_AXES} <= {*body.columns} and body.turn]
    if "robot" not in known and not is_one and ("sphere" not in known):
        several = [body for body in whole if body.name]
        if several and (sheet.program or re.search(r"\d", several[0].name)):
            return several
    placed = [body for body in found.values() if {*_AXES} & {*body.columns}]
    turned = [body for body in found.values() if body.turn]
    if not whole and len(placed) == 1 and len(turned) <= 1 and "sphere" not in known:
        turn = turned[0] if turned else placed[0]
        both = {**{name: turn.columns[name] for name in turn.turn}, **placed[0].columns}
        whole = [placed[0]._replace(columns=both, turn=turn.turn)]
    if "sphere" in known:
        whole = [body._replace(turn=()) for body in placed]
    whole = [body for body in whole if not body.name] or whole
    _refuse_lacking(header, known, whole, found, path, sheet, is_one=is_one)
    if len(whole) > 1:
        sets = " and in ".join(",".join(body.columns[axis] for axis in _AXES) for body in whole)
        problem = f"positions are in {sets}; choose by --column x=NAME,y=NAME,..."
        raise InputError(problem, path=path, line=1)
    return whole


def _refuse_lacking(
    header: Sequence[str],
    known: Mapping[str, str],
    whole: Sequence[_PoseColumns],
    found: Mapping[str, _PoseColumns],
    path: Path,
    sheet: Sheet,
    *,
    is_one: bool,
) -> None:
    """Refuse a table without columns of robots, positions or orientations."""
    has = {*known, *(whole[0].columns if whole else found[""].columns if "" in found else ())}
    turn = [] if "sphere" in known or (whole and whole[0].turn) else QUATERNION
    robot = [] if is_one else ["robot"]
    lacking = [name for name in (*robot, *_AXES, *turn) if name not in has]
    if not lacking:
        return
    if sheet.program:
        problem = f"{sheet.program}'s export has no rigid bodies with positions and orientations; "
        raise InputError(f"{problem}export them", path=path, line=1)
    for column in header if not {*_AXES} & has else ():
        if stray := re.fullmatch(r"[xyz][_ ]*[\[(]?([a-z]+)[\])]?", column, re.IGNORECASE):
            problem = f"{stray[1][:40]!r} is no known unit of length; rename it to one of "
            problem += f"{', '.join(LENGTHS)}, or give --length-unit {stray[1][:40]}"
            raise InputError(problem, path=path, line=1, key=column)
    problem = "the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z but "
    problem += f"{','.join(header)[:200] or 'none'}; rename or add {','.join(lacking)}"
    raise InputError(f"{problem}, or name columns by --column", path=path, line=1)


def _meaning(name: str, units: Collection[str], *, is_export: bool) -> _Column | None:
    """Read the name of a column; None if it has no part in a pose."""
    bare, unit = split_unit(name, units)
    for pattern, begin in _QUANTITIES.items():
        found = re.fullmatch(pattern, bare.lower())
        if found is None or (re.search(r"[a-z]$", found["body"]) and not is_export):
            continue
        body, meaning = (
            bare[slice(*found.span("body"))],
            begin + (found.groupdict().get("axis") or ""),
        )
        if "number" in found.groupdict():
            robot, place = divmod(int(found["number"]), len(_QPOS))
            body, meaning = f"{body}{robot}", _QPOS[place]
        if is_export:
            return _Column(name, body.rstrip("/"), meaning, unit)
        parts = [part for part in re.split(r"[./|:\s]+", body) if part.lower() not in _MESSAGES]
        body = ".".join(parts).strip("_- ")
        is_pose = not {*re.findall(r"[a-z]+", body.lower())} & _OTHERS
        return _Column(name, body, meaning, unit) if is_pose else None
    return None


def _body(name: str, columns: Sequence[_Column], path: Path) -> _PoseColumns:
    """Choose the columns of a robot: positions in one unit, and an orientation.

    Raises:
        InputError: there are two sets of positions, or axes have different units.
    """
    lengths, unit = _positions(columns, path)
    others = {column.meaning: column.name for column in columns if column.meaning not in _AXES}
    turn = next((turn for turn in TURNS if {*turn} <= {*others}), ())
    for column in columns if turn else ():
        same = [each.name for each in columns if each.meaning == column.meaning]
        if column.meaning in turn and len(same) > 1:
            problem = f"{column.meaning} is in {' and in '.join(same)}; choose by --column "
            raise InputError(f"{problem}{column.meaning}=NAME", path=path, line=1)
    return _PoseColumns(name, {**{each: others[each] for each in turn}, **lengths}, turn, unit)


def _positions(columns: Sequence[_Column], path: Path) -> tuple[dict[str, str], str]:
    """Find the columns of x, y and z, all in one unit, and that unit; axes may lack a column."""
    found: dict[str, dict[str, list[_Column]]] = {axis: {} for axis in _AXES}
    for column in columns:
        if column.meaning in found:
            found[column.meaning].setdefault(column.unit.lower(), []).append(column)
    sets = [{*units} for units in found.values()]
    complete = [unit for unit in found["x"] if unit in set.intersection(*sets)]
    several = [",".join(units[unit][0].name for units in found.values()) for unit in complete]
    if len(complete) == 1:
        listed = ([c.name for c in chain(*units.values())] for units in found.values())
        several = next((names for names in listed if len(names) > 1), [])
    if len(several) > 1:
        problem = f"positions are in {' and in '.join(several)}; keep one, or rename the others"
        raise InputError(problem, path=path, line=1)
    if not complete and all(sets):
        units = ", ".join(f"{axis} in {next(iter(found[axis])) or 'none'}" for axis in found)
        problem = f"the axes have different units: {units}; convert them to one"
        raise InputError(problem, path=path, line=1)
    first = {axis: next(iter(units.values()))[0] for axis, units in found.items() if units}
    if complete:
        first = {axis: units[complete[0]][0] for axis, units in found.items()}
    unit = first["x"].unit if "x" in first else ""
    return {axis: column.name for axis, column in first.items()}, unit


def split_unit(column: str, units: Collection[str]) -> tuple[str, str]:
    """Split a column's name into what it names and its unit, of lengths or angles."""
    found = _UNIT.fullmatch(column)
    if found is None:
        return column.strip(), ""
    unit = found["suffix"] or found["brackets"] or ""
    is_unit = unit.lower() in {*units, *_ANGLES} or (found["brackets"] is not None and not unit)
    return (found["name"].strip(), unit) if is_unit else (column.strip(), "")


def _find(header: Sequence[str], meaning: str) -> str:
    """Find the column of a quantity by its names, of a time with a unit or not; else return ""."""
    for name in _NAMES.get(meaning, (meaning,)):
        for column in header:
            bare = re.sub(r"^(?:field|data|msg)[./]", "", column.lower())
            if bare == name or (meaning == "time" and split_unit(bare, _TIMES)[0] == name):
                return column
    return ""


def _of_rows(
    table: CsvFile,
    bodies: Sequence[_PoseColumns],
    known: Mapping[str, str],
    assumed: Assumptions,
    robot: int | None,
) -> tuple[pd.DataFrame, list[str]]:
    """Read a table with a robot a row; returns its rows, and what was left out."""
    drop = assumed.drop_incomplete
    columns = {name: known[name] for name in ("robot", "sphere", "join") if name in known}
    if robot is not None:
        columns.pop("robot", None)
    columns |= bodies[0].columns
    for column in columns.values():
        if table.columns.count(column) > 1:
            problem = f"there are {table.columns.count(column)} columns of this name; rename all "
            raise InputError(f"{problem}but one", path=table.path, line=1, key=column)
    notes = _without_incomplete(table, columns.values(), drop=drop)
    single = [known[name] for name in ("run", "robot", "sphere") if name in known]
    cells = zip(*(table.words(name).tolist() for name in single), strict=True)
    if "time" in known and (robot is not None or len({*cells}) < len(table.rows)):
        notes += _without_incomplete(table, [known["time"]], drop=drop)
        columns["time"] = known["time"]
    first: Any = robot if robot is not None else _robots(table, columns["robot"])
    numbers: dict[str, Any] = {
        name: table.integers(column) if name in {"sphere", "join"} else table.numbers(column)
        for name, column in columns.items()
        if name != "robot"
    }
    rows = pd.DataFrame({"robot": first, **numbers, "line": [*table.rows]})
    return rows.assign(run=_runs(table, known)), notes


def _of_bodies(
    table: CsvFile, bodies: Sequence[_PoseColumns], known: Mapping[str, str], _: Assumptions
) -> tuple[pd.DataFrame, list[str]]:
    """Read a table with all robots in a row; returns rows of each, and what was left out."""
    names = [_listed_name(table, body.name) for body in bodies]
    robots, notes = robot_numbers(names)
    lines, parts, lost = np.array([*table.rows]), [], 0
    time = table.numbers(known["time"]) if "time" in known else lines.astype(float)
    for robot, body in zip(robots, bodies, strict=True):
        columns = [*body.columns.values()]
        for line in table.incomplete(columns):
            for column in columns:
                table.rows[line][table.columns.index(column)] = ""
        numbers = {name: table.numbers(c, empty=np.nan) for name, c in body.columns.items()}
        part = pd.DataFrame({"robot": robot, "time": time, **numbers, "line": lines})
        zero = (part[[*body.columns]] == 0.0).all(axis=1)
        kept = part[~zero & part[[*body.columns]].notna().all(axis=1)]
        lost += len(part) - len(kept)
        parts.append(kept)
    rows = pd.concat(parts, ignore_index=True).assign(run="")
    if not len(rows):
        problem = "there are no poses; export frames with bodies"
        raise InputError(problem, path=table.path, line=1)
    if lost:
        notes.append(f"{counted(lost, 'pose')} of bodies that the cameras lost left out")
    return rows if len(lines) > 1 else rows.drop(columns="time"), notes


def _listed_name(table: CsvFile, body: str) -> str:
    """Return the name that a message lists for a body, such as `name3` for `pose3`, or its own."""
    number = re.search(r"\d+", body)
    for column in table.columns if number else ():
        if number and re.fullmatch(rf"(?:field\.)?name\[?{number[0]}\]?", column):
            return str(table.words(column)[0])
        if column.endswith(f"{body}.child_frame_id"):
            return str(table.words(column)[0])
    return body


def robot_numbers(names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Take the numbers of robots from their names, or count them and say so."""
    found = [re.findall(r"\d+", name) for name in names]
    numbers = [int(each[0]) for each in found if [len(n) <= LONGEST_NUMBER for n in each] == [True]]
    if len({*numbers}) == len(names):
        return numbers, []
    listed = ", ".join(f"{name} is {number}" for number, name in enumerate(names[:3]))
    more = ", ..." * (len(names) > 3)  # noqa: PLR2004
    return [*range(len(names))], [f"bodies are numbered as listed: {listed}{more}"]


def _add_quaternions(
    rows: pd.DataFrame, table: CsvFile, body: _PoseColumns, assumed: Assumptions, sheet: Sheet
) -> list[str]:
    """Convert what states orientations to quaternions, in place, and say what was assumed.

    Raises:
        InputError: the order of angles is unknown, or a matrix is no rotation.
    """
    numbers, turn = rows[[*body.turn]].to_numpy(float), body.turn
    for name in turn:
        del rows[name]
    if turn[0] in {"qw", "rw"}:
        rows[QUATERNION] = numbers
        return []
    if len(turn) == 9:  # noqa: PLR2004 - a matrix, column by column
        matrix = numbers.reshape(-1, 3, 3).swapaxes(1, 2)
        if len(mirrored := np.flatnonzero(~(np.linalg.det(matrix) > 0.5))):  # noqa: PLR2004
            problem = "the matrix mirrors, it is no rotation; export a right-handed frame"
            line = int(rows["line"].iloc[mirrored[0]])
            raise InputError(problem, path=table.path, line=line, key=body.columns[turn[0]])
        rows[QUATERNION] = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
        return []
    units = {split_unit(body.columns[name], ())[1].lower() for name in turn} & {*_ANGLES}
    degrees = _ANGLES[units.pop()] if units else sheet.degrees
    angles = numbers[:, :1] if turn[0] == "angle" else numbers
    guessed = degrees is None
    if degrees is None:
        degrees = bool(np.abs(angles).max(initial=0.0) > 2.0 * np.pi + 1e-3)
    angles = np.radians(angles) if degrees else angles
    if turn[0] == "angle":
        length = np.linalg.norm(numbers[:, 1:], axis=1, keepdims=True)
        vector = angles * numbers[:, 1:] / np.maximum(length, np.finfo(float).tiny)
        rows[QUATERNION] = Rotation.from_rotvec(vector).as_quat(scalar_first=True)
        return []
    euler = assumed.euler or sheet.euler or TURNS[turn]
    if not euler:
        problem = (
            f"{','.join(body.columns[name] for name in turn)} are angles in an order that the "
        )
        problem += "file does not state; export quaternions, or add --euler XYZ or --euler rotvec"
        raise InputError(problem, path=table.path, line=sheet.line)
    rows[["a1", "a2", "a3"]] = angles
    rows[QUATERNION] = turns_by(angles, euler)
    unit = "degrees" if degrees else "radians"
    how = f"{', '.join(turn)} in {unit}: {ORDERS[euler]}" if euler in ORDERS else f"--euler {euler}"
    return [] if assumed.euler and not guessed else [f"angles read as {how}"]


ORDERS = {
    "ZYX": "yaw, pitch, roll about axes of the body, as ROS and Gazebo (--euler ZYX)",
    "XYZ": "about x, then y, then z of the body (--euler XYZ)",
}
"""What usual orders of angles mean."""


def turns_by(angles: Reals, euler: str) -> Reals:
    """Convert angles about x, y and z, shape (n, 3) [rad], to quaternions wxyz, shape (n, 4).

    Args:
        angles: Angles about x, y and z; in the order of the axes if one of these comes twice.
        euler: Axes in order, as SciPy has them: capitals for axes of the body, small letters for
            fixed axes; or `rotvec` for rotation vectors.

    Raises:
        InputError: there is no such order.
    """
    if euler == "rotvec":
        wxyz: Reals = Rotation.from_rotvec(angles).as_quat(scalar_first=True)
        return wxyz
    axes = ["xyz".find(axis) for axis in euler.lower()]
    try:
        chosen = angles if len({*axes}) < len(axes) else angles[:, axes]
        return _wxyz(Rotation.from_euler(euler, chosen))
    except (ValueError, IndexError):
        problem = f"{euler!r} is no order of angles; write it like ZYX, or rotvec"
        raise InputError(problem, argument="euler") from None


def _without_incomplete(text: CsvFile, columns: Iterable[str], *, drop: bool) -> list[str]:
    """Drop rows that lack a number and say so in a line, or refuse them all at once."""
    lines = text.incomplete(columns)
    note = report_incomplete(text.path, lines, drop=drop)
    if lines:
        text.drop(lines)
    return note


def _robots(text: CsvFile, column: str) -> Ints:
    """Read numbers of robots, or the only one in each name, such as 7 in `bot_7`, shape (rows,)."""
    names: list[str] = text.words(column).tolist()
    if any(re.fullmatch(r"\s*[-+]?\d+\s*", name) for name in names):
        return text.integers(column)
    named: dict[int, str] = {}
    for row, name in enumerate(names):
        found = re.findall(r"\d+", name)
        problem = ""
        if len(found) != 1 or len(found[0]) > LONGEST_NUMBER:
            problem = f"{name[:40]!r} has no number, or several; write it like bot_7"
        elif named.setdefault(int(found[0]), name) != name:
            problem = f"{name[:40]!r} has the number of another robot; give each its own"
        if problem:
            raise InputError(problem, path=text.path, line=text.line(row), key=column)
    number = {name: robot for robot, name in named.items()}
    return np.array([number[name] for name in names], np.int64)


def report_incomplete(path: Path, lines: Sequence[int], *, drop: bool, name: str = "") -> list[str]:
    """Say in a line that rows without a number are dropped, or refuse them all at once.

    Args:
        path: Their file.
        lines: Lines of the rows; there may be none.
        drop: Whether they are dropped.
        name: Name of the file if it is one of several.
    """
    if not lines:
        return []
    rows, where = counted(len(lines), "incomplete row"), f"line {line_ranges(lines)}"
    if drop:
        return [f"{rows}{f' of {name}' * bool(name)} dropped: {where}"]
    problem = f"{rows}, empty or NaN: {where}; complete them, or drop them with --drop-incomplete"
    raise InputError(problem, path=path, line=lines[0])


def line_ranges(lines: Collection[int]) -> str:
    """Write ascending numbers of lines, those in a row as a range.

    >>> line_ranges([2, 3, 4, 7, 9, 10])
    '2-4, 7, 9-10'
    """
    number = np.fromiter(lines, int)
    parts = np.split(number, np.flatnonzero(np.diff(number) > 1) + 1)
    return ", ".join(f"{p[0]}" if len(p) == 1 else f"{p[0]}-{p[-1]}" for p in parts)


def _runs(text: CsvFile, known: Mapping[str, str]) -> list[str]:
    """Read the structure of each row; its name becomes that of a folder."""
    if "run" not in known:
        return [""] * len(text.rows)
    names: list[str] = text.words(known["run"]).tolist()
    for row, name in enumerate(names):
        if not re.fullmatch(r"(?!\.)[A-Za-z0-9._-]{1,80}", name):
            problem = f"{name[:40]!r} cannot be a folder; use letters, digits, dots, - and _"
            raise InputError(problem, path=text.path, line=text.line(row), key="run")
    return names


_OTHER_ORDER: dict[tuple[str, ...], int] = {
    ("qw", "qx", "qy", "qz"): 1,
    ("qx", "qy", "qz", "qw"): -1,
}
"""Places by which wxyz turn around where numbers in such columns have the other order."""


UPWARD = {
    "y": (0.5, "x"),
    "x": (-0.5, "y"),
    "-z": (1.0, "x"),
    "-y": (-0.5, "x"),
    "-x": (0.5, "y"),
}
"""By the axis that is up, the turn that makes it z: half turns, and the axis of the turn."""


def horizontal_mirror(up: str) -> Reals:
    """Return the signs of x, y and z that reverse a horizontal axis, shape (3,)."""
    return np.array([1.0, 1.0, -1.0] if up.endswith("y") else [1.0, -1.0, 1.0])


_MOST_NAMED = 5
"""Robots that a note names."""


def some(names: Sequence[object]) -> str:
    """List the first names, and count the others."""
    more = f" and {len(names) - _MOST_NAMED} more" * (len(names) > _MOST_NAMED)
    return ", ".join(map(str, names[:_MOST_NAMED])) + more


class Samples(NamedTuple):
    """S poses over time, by robot and then by time."""

    robot: Ints  # row of the robot in `Poses`, (S,)
    time: Reals  # on one clock for all robots, (S,)
    position: Reals  # (S, 3)
    orientation_wxyz: Reals  # (S, 4)

    def docks(self, dock_offset_body: Reals) -> Reals:
        """Locate docks at offsets (D, 3) from the center, shape (S, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, dock_offset_body)


class Poses(NamedTuple):
    """N robots in the order of their file, in its unit of length."""

    robot_id: Ints  # (N,)
    position: Reals  # centers, the last ones of poses over time, (N, 3)
    orientation_wxyz: Reals  # body to world, (N, 4)
    dock_offset_body: Reals  # (D, 3); no rows where the file has poses, not spheres
    join: Ints | None  # rank of each robot in join order, (N,); None where the file has none
    length_unit: str  # as the columns name it; empty where they do not
    samples: Samples | None = None  # all poses; None where each robot has one
    other_order: int = 0  # turns wxyz into the other order of the same numbers; 0 if there is none
    angles: Reals | None = None  # angles that state orientations [rad], (N, 3)
    docks_are_spheres: bool = False  # whether the file has the docks, not orientations

    @property
    def docks(self) -> Reals:
        """Centers of the docks, shape (N, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, self.dock_offset_body)

    def reordered(self) -> "Poses":
        """Read the numbers of each quaternion in the other order."""
        return self._mapped(lambda wxyz: np.roll(wxyz, self.other_order, axis=1))

    def conjugate(self) -> "Poses":
        """Read quaternions as turns from world to body."""
        return self._mapped(lambda wxyz: wxyz * [1.0, -1.0, -1.0, -1.0])

    def turned(self, turn: Rotation) -> "Poses":
        """Turn the frame of each body."""
        return self._mapped(lambda wxyz: _wxyz(_rotation(wxyz) * turn))

    def upright(self, up: str) -> "Poses":
        """Turn the world so that an axis, a key of `UPWARD`, becomes z."""
        half_turns, axis = UPWARD[up]
        turn = Rotation.from_euler(axis, 180.0 * half_turns, degrees=True)
        return self._mapped(lambda wxyz: _wxyz(turn * _rotation(wxyz)), turn.apply)

    def right_handed(self, up: str) -> "Poses":
        """Reverse the horizontal axis of a left-handed world, and that of bodies."""
        sign = horizontal_mirror(up)
        return self._mapped(
            lambda wxyz: wxyz * [1.0, *(-sign)],
            lambda place: place * sign,
        )._replace(dock_offset_body=self.dock_offset_body * sign)

    def nearest(self, most: int) -> "Poses":
        """Return the robots that are nearest to the first one, without samples."""
        off = np.linalg.norm(self.position - self.position[0], axis=1)
        near = np.sort(off.argsort(kind="stable")[:most])
        return self._replace(
            robot_id=self.robot_id[near],
            position=self.position[near],
            orientation_wxyz=self.orientation_wxyz[near],
            angles=None if self.angles is None else self.angles[near],
            samples=None,
        )

    def _mapped(
        self,
        orientation: Callable[[Reals], Reals],
        position: Callable[[Reals], Reals] | None = None,
    ) -> "Poses":
        """Map all orientations, and positions."""
        place = position or (lambda there: there)
        samples = self.samples and self.samples._replace(
            orientation_wxyz=orientation(self.samples.orientation_wxyz),
            position=place(self.samples.position),
        )
        return self._replace(
            orientation_wxyz=orientation(self.orientation_wxyz),
            position=place(self.position),
            samples=samples,
        )


def poses_by_run(table: PoseTable, path: Path, *, shape_error: float) -> dict[str, Poses]:
    """Gather the rows of each robot, structure by structure.

    A robot of spheres has its center at their mean; the first robot of a structure defines the body
    frame. One sphere is a dock at the center.

    Args:
        table: Poses or spheres.
        path: Their file.
        shape_error: Largest distance of a sphere from its place in the first robot's shape.

    Returns:
        Poses of each structure by its name, or by "" without a column `run`.

    Raises:
        InputError: a robot has several rows of a time, or none of a sphere, or a quaternion of
            another length than 1.
    """
    return {
        str(run): _poses(rows, table, path, shape_error)
        for run, rows in table.rows.groupby("run", sort=False)
    }


def read_dock_offsets(path: Path) -> Reals:
    """Read a table `dock,x,y,z` of a robot's docks in the body frame, shape (D, 3).

    Lengths are in the unit of the poses; docks are numbered from 0.

    Raises:
        InputError: the table is malformed.
    """
    table = CsvFile(path)
    if {*table.columns} != {"dock", *"xyz"}:
        problem = "the columns are not dock,x,y,z, in the unit of the poses; rename them"
        raise InputError(problem, path=path, line=1)
    number = table.integers("dock")
    offset = np.column_stack([table.numbers(axis) for axis in "xyz"])
    if sorted(number) != list(range(len(number))):
        problem = f"docks {sorted(number.tolist())} are not numbered 0, 1, ...; renumber them"
        raise InputError(problem, path=path, line=2, key="dock")
    ordered: Reals = offset[number.argsort()]
    return ordered


def read_contacts(path: Path, poses: Poses) -> Ints:
    """Read a table `robot,dock,other,other_dock` of docks in contact.

    Returns:
        Rows of (robot, its dock, later robot, its dock), robots counted from 0, shape (n, 4).

    Raises:
        InputError: the table is malformed, or a robot or dock does not exist.
    """
    table, columns = CsvFile(path), ["robot", "dock", "other", "other_dock"]
    if {*table.columns} != {*columns}:
        problem = f"the columns are not {','.join(columns)}; rename them"
        raise InputError(problem, path=path, line=1)
    rows = np.column_stack([table.integers(name) for name in columns])
    docks = len(poses.dock_offset_body)
    number = {name: row for row, name in enumerate(poses.robot_id.tolist())}
    for row, (robot, dock, other, other_dock) in enumerate(rows.tolist()):
        problem = ""
        if unknown := [name for name in (robot, other) if name not in number]:
            problem = f"there is no robot {unknown[0]} in the poses; correct it"
        elif robot == other:
            problem = f"robot {robot} cannot touch itself; name another robot"
        elif not (0 <= dock < docks and 0 <= other_dock < docks):
            problem = f"docks count from 0 to {docks - 1}; correct dock or other_dock"
        if problem:
            raise InputError(problem, path=path, line=table.line(row))
        rows[row, [0, 2]] = number[robot], number[other]
    swapped = rows[:, 0] > rows[:, 2]
    rows[swapped] = rows[swapped][:, [2, 3, 0, 1]]
    return np.unique(rows, axis=0)


def _rotation(wxyz: Reals) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def _wxyz(turn: Rotation) -> Reals:
    return turn.as_quat(scalar_first=True)


def _poses(rows: pd.DataFrame, table: PoseTable, path: Path, shape_error: float) -> Poses:
    by = ["robot", "time"] if "time" in rows else ["robot"]
    rows = _by_robot(rows, by, path)
    pose = rows.drop_duplicates(by)
    place = rows[[*"xyz"]].to_numpy(float).reshape(len(pose), -1, 3)
    position = place.mean(axis=1)
    if "sphere" in rows:
        dock_offset_body = place[0] - position[0]
        orientation = _align(place - position[:, None], pose, path, shape_error)
    else:
        dock_offset_body = np.empty((0, 3))
        if table.dock_offset_body is not None:
            dock_offset_body = table.dock_offset_body
        orientation = _unit_quaternions(pose, path)
    robot, names = pd.factorize(pose["robot"])
    last = np.flatnonzero(~pose["robot"].duplicated(keep="last"))
    over_time = len(last) < len(pose)
    return Poses(
        robot_id=np.asarray(names, np.int64),
        position=position[last],
        orientation_wxyz=orientation[last],
        dock_offset_body=dock_offset_body,
        join=pose["join"].to_numpy(np.int64)[last] if "join" in pose else None,
        length_unit=table.length_unit,
        samples=Samples(robot, pose["time"].to_numpy(float), position, orientation)
        if over_time
        else None,
        other_order=_OTHER_ORDER.get(tuple(table.quaternion_order), 0),
        angles=pose[["a1", "a2", "a3"]].to_numpy(float)[last] if "a1" in pose else None,
        docks_are_spheres="sphere" in rows,
    )


def _by_robot(table: pd.DataFrame, by: list[str], path: Path) -> pd.DataFrame:
    """Gather the rows of each robot, sorted by time and sphere; all have the same spheres."""
    spheres = "sphere" in table
    repeated = table[table.duplicated([*by, "sphere"] if spheres else by)]
    if len(repeated):
        first = repeated.iloc[0]
        what = f"sphere {first['sphere']} of robot" if spheres else "robot"
        when = f" at time {first['time']:g}" if "time" in by else ""
        remedy = "keep one" if when else "keep one, or give the time of each in a column time"
        problem = f"{what} {repeated['robot'].iloc[0]} has a row already{when}; {remedy}"
        file = Path(first.get("file", path))  # one of a folder
        raise InputError(problem, path=file, line=int(first["line"]))
    if not spheres and "time" not in by:
        return table
    robot, _ = pd.factorize(table["robot"])
    minor = ["sphere"] * spheres + ["time"] * ("time" in by)
    table = table.iloc[np.lexsort((*(table[name].to_numpy() for name in minor), robot))]
    wanted: list[int] = []
    for _, rows in table.groupby(by, sort=False) if spheres else ():
        found = rows["sphere"].tolist()
        wanted = wanted or found
        if found != wanted:
            what = f"robot {rows['robot'].iloc[0]} has spheres {found}, the first robot {wanted}"
            problem = f"{what}; complete it"
            raise InputError(problem, path=path, line=int(rows["line"].min()), key="sphere")
    return table


def _unit_quaternions(table: pd.DataFrame, path: Path) -> Reals:
    """Scale quaternions to length 1; refuse those whose length is far from it."""
    quaternion = table[QUATERNION].to_numpy()
    length = np.linalg.norm(quaternion, axis=1)
    far = np.flatnonzero(~(np.abs(length - 1.0) <= FAR_FROM_UNIT))
    if len(far):
        problem = f"the quaternion has length {length[far[0]]:.6g}; scale it to 1"
        raise InputError(problem, path=path, line=int(table["line"].iloc[far[0]]), key="qw")
    unit: Reals = quaternion / length[:, None]
    return unit


def _align(offset: Reals, first: pd.DataFrame, path: Path, shape_error: float) -> Reals:
    """Rotate the first robot's shape onto each robot, whose spheres are at `offset`, (N, D, 3).

    This is the best rotation (Kabsch 1976), and any of these where spheres are in one line.
    """
    left, _, right = np.linalg.svd(np.einsum("nda,db->nab", offset, offset[0]))
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    rotation = left @ right
    off = np.linalg.norm(offset[0] @ rotation.swapaxes(1, 2) - offset, axis=2).max(axis=1)
    if not (off <= shape_error).all():
        worst = int(np.argmax(~(off <= shape_error)))
        problem = (
            f"the spheres of robot {first['robot'].iloc[worst]} are up to {off[worst]:.3g} off the "
            "first robot's shape; give rigid robots of one shape, or a larger --gap"
        )
        raise InputError(problem, path=path, line=int(first["line"].iloc[worst]))
    wxyz: Reals = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
    return wxyz
