"""Reads tables of poses by what the names of their columns mean, in the words of any program.

A row has the pose of one robot, or those of all. What a program calls its columns is a row of the
tables below; what a table does not state, an import has to assume.
"""

import csv
import io
import re
import string
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.formats.poses import QUATERNION, Assumptions, PoseTable, some
from tiswarm.records.io import MAX_TABLE_BYTES, CsvFile, numbered_lines, open_input
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import FARTHEST

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
        *("header.stamp", "__time", "stamp.sec", "header.stamp.sec", "sec", "secs", "seconds"),
        *("elapsed", "elapsed_time"),
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

_BEFORE_UNIT = ("_", "/", " in ")
_LETTERS_OF_UNITS = f"{string.ascii_letters}°µ"

_QUANTITIES = {
    r"(?P<body>.*)qpos[\W_]{0,8}(?P<number>\d+)\]?": "",
    r"(?P<body>)p(?:_[a-z]{1,2})+_(?P<axis>[xyz])": "",
    r"(?P<body>)q(?:_[a-z]{1,2})+_(?P<axis>[wxyz])": "q",
    r"(?P<body>.*?)(?P<axis>roll|pitch|yaw|alpha|beta|gamma)": "",
    r"(?P<body>.*?)(?:rotation|rot)?[\W_]{0,8}(?P<axis>angle)": "",
    r"(?P<body>.*?)(?:rotation|rot|r)(?P<axis>[wxyz])": "r",
    r"(?P<body>.*?)(?:rotation|rot)[\W_]{1,8}(?P<axis>[wxyz])": "r",
    r"(?P<body>.*?)(?:orientation|quaternion|x?quat|q)[\W_]{0,8}(?P<axis>[wxyz])": "q",
    r"(?P<body>.*?)(?:axis[\W_]{0,8}|a)(?P<axis>[xyz])": "a",
    r"(?P<body>.*?)(?:rot\[|matrix[\W_]{0,8}|m)(?P<axis>\d)\]?": "m",
    r"(?P<body>.*?)(?:rotation|rot|matrix|r|m)[\W_]{0,8}(?P<axis>[0-3]{2})\]?": "m",
    r"(?P<axis>[xyz])[\W_]{0,8}(?P<body>\d+)": "",
    r"q(?P<axis>[wxyz])[\W_]{0,8}(?P<body>\d+)": "q",
    r"(?P<body>.*?)(?P<axis>[xyz])[\W_]{0,8}(?:position|pos)": "",
    r"(?P<body>.*?)(?:position|x?pos|translation|trans|location|p|t)?[\W_]{0,8}(?P<axis>[xyz])": "",
}
"""Names of quantities as programs write them, in lower case, and how their meanings begin. The body
is the rest; the numbers of `qpos` are those of free joints in a row. Repetitions within a pattern
have limits, so that its time is linear in the length of a name."""

_QPOS = ("x", "y", "z", "qw", "qx", "qy", "qz")

_MESSAGES = {*("field", "pose", "msg", "data", "transform", "header", "state"), ""}
"""Parts of a message's name that name no robot."""

_OTHERS = {
    *("vel", "velocity", "speed", "twist", "linear", "angular", "acc", "accel", "acceleration"),
    *("v", "w", "scale", "size"),
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
    **{tuple(f"m{r + i}{r + j}" for j in range(3) for i in range(3)): "" for r in (0, 1)},
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


_SEPARATORS = "\t,;|"

_LONGEST_PROSE = 50
"""Lines among which the head of a table is looked for."""

_OTHER_FILES = {
    b"PK\x03\x04": "a workbook or an archive; save the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old workbook; save the sheet as CSV",
    b"PAR1": "a Parquet file; write its table as CSV",
    b"\x89HDF": "an HDF5 file; write its table as CSV",
    b"MATLAB 5.0": "a MAT file; write its table as CSV",
    b"\x93NUMPY": "an array without names of columns; write a CSV with a head",
    b"\x1f\x8b": "a file compressed by gzip; unpack it",
    b"\xff\xfe": "text in UTF-16; save it as UTF-8",
    b"\xfe\xff": "text in UTF-16; save it as UTF-8",
    b'{"format": "tiswarm-sensing"': "a sensing log already; give it to tiswarm localize",
    b"{": "JSON; write a table, a robot a row",
    b"[{": "JSON; write a table, a robot a row",
    b"<": "HTML or XML; save its table as CSV",
}
"""First bytes of files that are no tables, with what they are and what to do."""


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
    is_wide, others = "robot" not in known and robot is None, list[str]()
    if is_wide and not sheet.program:
        others = [body.name for body in bodies if not re.search(r"\d", body.name)]
        bodies = [body for body in bodies if body.name not in others] or bodies
    pick = _of_bodies if is_wide else partial(_of_rows, robot=robot)
    rows, notes = pick(table, bodies, known, assumed)
    if others:
        notes.append(f"no robots, since their names have no number: {some(others)}")
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
    if not bare:
        return Sheet("\n".join(lines))
    head = _head(lines, bare)
    comments = [k for k in range(head) if re.match(r"[#%]\s*[A-Za-z_]", lines[k])]
    if comments and head == bare[0] and _are_numbers(_cells(lines[head])):
        head = comments[-1]
    names = _cells(lines[head].lstrip("#% "))
    sep = max(_SEPARATORS, key=lines[head].count)
    rows = [k for k in bare if k > head]
    units = _cells(lines[rows[0]]) if rows else []
    is_unit = {unit.lower() for unit in (*LENGTHS, *_TIMES, *_ANGLES, "")}
    if any(units) and {unit.strip("[]() ").lower() for unit in units} <= is_unit:
        names = [
            f"{name} [{unit.strip('[]() ')}]" if unit else name
            for name, unit in zip(names, units, strict=False)
        ]
        lines[rows.pop(0)] = "#"
    if sep not in lines[head]:  # blanks; R and pandas give numbers of rows no name
        cells = [_words(text) for text in lines]
        names = ["", *names] if {len(cells[k]) for k in rows} == {len(names) + 1} else names
        lines = ["\t".join(each) for each in cells]
    elif {(lines[k].count(sep), lines[k].rstrip()[-1]) for k in rows} == {(len(names), sep)}:
        names.append("")
    if sep == "|":
        sep, lines = "\t", [text.replace("|", "\t") for text in lines]
    text = [text if text.strip() else "#" for text in lines]
    above = [line if line.startswith("#") else f"#{line}" for line in text[:head]]
    return Sheet("\n".join([*above, header_line(names, sep), *text[head + 1 :]]))


def _head(lines: Sequence[str], bare: Sequence[int]) -> int:
    """Find the head below lines of prose: the first names that are as many as cells of most rows.

    It is the first line where there are none.
    """
    first = [len(_cells(lines[k])) for k in bare[:_LONGEST_PROSE]]
    usual = max(first, key=first.count)
    for place, count in zip(bare, first, strict=False):
        if count == usual and first[0] < usual:
            is_named = not any(_are_numbers([cell]) for cell in _cells(lines[place]) if cell)
            return place if is_named else bare[0]
    return bare[0]


def refuse_other_files(path: Path) -> None:
    """Refuse a file whose first bytes are those of another format, and name what to do."""
    if not path.is_dir():
        with open_input(path) as file:
            start = file.read(64).lstrip()
        if path.suffix in {".yaml", ".yml"}:
            raise InputError("this is YAML, no table; give a scenario to tiswarm run", path=path)
        for first, problem in _OTHER_FILES.items():
            if start.startswith(first):
                raise InputError(f"this is {problem}", path=path)


def header_line(names: Sequence[str], separator: str) -> str:
    """Write names as a line of a table."""
    line = io.StringIO()
    csv.writer(line, delimiter=separator, lineterminator="").writerow(names)
    return line.getvalue()


def _cells(text: str) -> list[str]:
    """Split a line at the separator that it has."""
    sep = max(_SEPARATORS, key=text.count)
    if sep not in text:
        return _words(text)
    try:
        cells = next(csv.reader([text], delimiter=sep, skipinitialspace=True), [])
    except csv.Error:
        cells = text.split(sep)
    return [cell.strip() for cell in cells]


def _words(text: str) -> list[str]:
    """Split a line at blanks, except within quotes."""
    return [quoted or bare for quoted, bare in re.findall(r'"([^"]+)"|([^\s"]+)', text)]


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
        if (column := assumed.columns.get(name) or find_column(header, name))
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
) -> Sequence[_PoseColumns]:
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
    is_named = "robot" in known or is_one
    if not is_named and "sphere" not in known:
        several = [body for body in whole if body.name]
        if several and (sheet.program or any(re.search(r"\d", body.name) for body in several)):
            return several
    chosen = _together([*found.values()], whole, is_named=is_named, has_spheres="sphere" in known)
    if len(chosen) > 1:
        sets = (",".join(body.columns.get(axis, "") for axis in _AXES) for body in chosen)
        problem = f"positions are in {' and in '.join(sets)}; choose by --column x=NAME,y=NAME,..."
        if not is_named:
            problem += ", or give robots names with numbers, such as bot_7"
        raise InputError(problem, path=path, line=sheet.line)
    _refuse_lacking(header, known, chosen, found, path, sheet, is_one=is_one)
    return chosen


def _together(
    found: Sequence[_PoseColumns],
    whole: Sequence[_PoseColumns],
    *,
    is_named: bool,
    has_spheres: bool,
) -> Sequence[_PoseColumns]:
    """Choose the columns of a pose, which may have positions and orientations under two names.

    Args:
        found: Columns by what they are of.
        whole: Those with positions and orientations.
        is_named: Whether rows are of robots that are known, so that sets of positions are a choice.
        has_spheres: Whether rows are of spheres, which have no orientations.
    """
    placed = [body for body in found if {*_AXES} & {*body.columns}]
    if has_spheres:
        whole = [body._replace(turn=()) for body in placed]
    elif not whole and len(placed) == 1:
        turned = [body for body in found if body.turn]
        turn = turned[0] if turned else placed[0]
        both = {**{name: turn.columns[name] for name in turn.turn}, **placed[0].columns}
        whole = [placed[0]._replace(columns=both, turn=turn.turn)] if len(turned) <= 1 else []
    elif not whole and is_named:
        several = [body for body in placed if {*_AXES} <= {*body.columns}]
        whole = several if len(several) > 1 else []
    return [body for body in whole if not body.name] or whole


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
    if any(header) and _are_numbers(header):
        problem = "there are no names of columns; write robot,x,y,z,qw,qx,qy,qz, or what they are, "
        raise InputError(f"{problem}above the numbers", path=path, line=sheet.line)
    problem = "the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z but "
    problem += f"{','.join(header)[:200] or 'none'}; rename or add {','.join(lacking)}"
    problem += f", or name columns as by --column {lacking[0]}=NAME"
    raise InputError(problem, path=path, line=sheet.line)


def _meaning(name: str, units: Collection[str], *, is_export: bool) -> _Column | None:
    """Read the name of a column; None if it has no part in a pose."""
    bare, unit = split_unit(name, units)
    for pattern, begin in _QUANTITIES.items():
        whole_words = pattern.replace("(?P<body>.*?)", "(?P<body>|.*?[^a-z])")
        found = re.fullmatch(pattern if is_export else whole_words, bare.lower())
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
        is_pose = not {*re.findall(r"[a-z]{2,}|[a-z](?!\d)", body.lower())} & _OTHERS
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
    """Split a column's name into what it names and its unit, of lengths or angles.

    Names have units as in `x_mm`, `x/mm`, `x in mm`, `x [mm]`, `x (mm)`, `qw [-]` and `qw [1]`.
    """
    name, unit = _split_suffix(column) or _split_brackets(column) or (column, "")
    is_unit = not unit or unit.lower() in {*units, *_ANGLES}
    return (name.strip(), unit) if is_unit else (column.strip(), "")


def _split_suffix(column: str) -> tuple[str, str] | None:
    """Split off the letters behind the last sign that a unit may follow; None without them."""
    start = column.rstrip(_LETTERS_OF_UNITS)
    suffix = column[len(start) :]
    for sign in _BEFORE_UNIT:
        if suffix and start.endswith(sign):
            return start.removesuffix(sign), suffix
    return None


def _split_brackets(column: str) -> tuple[str, str] | None:
    """Split off what stands in brackets at the end, and is no number but 1; None without it."""
    if re.search(r"\s[\[(]1[\])]\Z", column):
        return column[: -len(" [1]")], ""
    if not column.endswith(("]", ")")):
        return None
    inner = column[:-1]
    first = max((match.end() for match in re.finditer(r"[\])\d]", inner)), default=0)
    bracket = re.compile(r"[\[(]").search(inner, first)
    if bracket is None:
        return None
    name = inner[: len(inner[: bracket.start()].replace("_", " ").rstrip())]
    return name, inner[bracket.end() :].strip().strip("-")


def find_column(header: Sequence[str], meaning: str) -> str:
    """Find the column of a quantity by its names, of a time with a unit or not; else return ""."""
    for name in _NAMES.get(meaning, (meaning,)):
        for column in header:
            bare = re.sub(r"^(?:field|data|msg)[./]", "", column.lower()).replace("/", ".")
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
    first: Any = robot if robot is not None else robots_of(table, columns["robot"])
    numbers: dict[str, Any] = {
        name: table.integers(column) if name in {"sphere", "join"} else table.numbers(column)
        for name, column in columns.items()
        if name not in {"robot", "time"}
    }
    if "time" in columns:
        numbers["time"] = _times(table, columns["time"])
    rows = pd.DataFrame({"robot": first, **numbers, "line": [*table.rows]})
    rows = rows.assign(run=_runs(table, known))
    if "time" in columns:
        _refuse_clocks_set_anew(rows, table.path, columns["time"])
    return rows, notes


def _of_bodies(
    table: CsvFile, bodies: Sequence[_PoseColumns], known: Mapping[str, str], _: Assumptions
) -> tuple[pd.DataFrame, list[str]]:
    """Read a table with all robots in a row; returns rows of each, and what was left out."""
    names = [_listed_name(table, body.name) for body in bodies]
    robots, notes = robot_numbers(names)
    lines, parts, lost = np.array([*table.rows]), [], 0
    time = _times(table, known["time"]) if "time" in known else lines.astype(float)
    clock = pd.DataFrame({"robot": 0, "run": "", "time": time, "line": lines})
    _refuse_clocks_set_anew(clock, table.path, known.get("time", ""))
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


_PARTS_OF_SECONDS = ("nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs")


def _times(table: CsvFile, column: str) -> Reals:
    """Read times: numbers, seconds beside a column of nanoseconds, dates, or times of a day [s]."""
    cells = table.words(column).tolist()
    if cells and re.match(r"\s*\d+[-/:.]\d+[-/:]", cells[0]):
        try:
            stamps = pd.to_datetime(pd.Series(cells), format="mixed", utc=True)
        except ValueError as error:
            problem = f"not all times are dates or times of a day ({str(error)[:80]}); write them "
            raise InputError(f"{problem}like 12.5 [s]", path=table.path, key=column) from None
        return np.array((stamps - stamps.iloc[0]).dt.total_seconds(), np.float64)
    time = table.numbers(column)
    start = re.sub(r"(?:sec|secs|seconds)$", "", column, flags=re.IGNORECASE)
    for name in table.columns:
        if start != column and name in {f"{start}{part}" for part in _PARTS_OF_SECONDS}:
            time += 1e-9 * table.numbers(name) - time[0]
    return time


_RARE = 0.05
"""Share of steps back in time up to which rows are sorted, but for a clock that was set anew."""

_SET_BACK = 10
"""Rows by which such a clock goes back at least; messages that overtook others go back by fewer."""


def _refuse_clocks_set_anew(rows: pd.DataFrame, path: Path, column: str) -> None:
    """Refuse rows in order of time that start again in the middle, as two recordings do.

    Rows in another order are sorted.

    Raises:
        InputError: a robot's time goes back by many rows, rarely.
    """
    for (_, robot), one in rows.groupby(["run", "robot"], sort=False):
        time = one["time"].to_numpy(float)
        back = np.flatnonzero(np.diff(time) < 0.0)
        if not 0 < len(back) <= _RARE * len(time):
            continue
        again = [int((time[: k + 1] > time[k + 1]).sum()) for k in back]
        if max(again) > _SET_BACK:
            k = back[int(np.argmax(again))]
            problem = f"the time of robot {robot} goes back from {time[k]:g} to {time[k + 1]:g}; "
            problem += "import each recording alone, or sort the rows if they are of one"
            raise InputError(problem, path=path, line=int(one["line"].iloc[k + 1]), key=column)


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
    if len({*(numbers := numbers_in(names))}) == len(names):
        return numbers, []
    listed = ", ".join(f"{name} is {number}" for number, name in enumerate(names[:3]))
    more = ", ..." * (len(names) > 3)  # noqa: PLR2004
    return [*range(len(names))], [f"bodies are numbered as listed: {listed}{more}"]


def numbers_in(names: Sequence[str]) -> list[int]:
    """Read the number in each name, the one that differs where names have several; else nothing.

    >>> numbers_in(["tb3_0/base", "tb3_12/base"])
    [0, 12]
    """
    found = [re.findall(r"\d+", name) for name in names]
    if len({*map(len, found)}) != 1 or not found[0]:
        return []
    differ = [place for place in zip(*found, strict=True) if len({*place}) > 1]
    several = differ if len(found[0]) > 1 else [*zip(*found, strict=True)]
    if len(several) != 1 or max(map(len, several[0])) > LONGEST_NUMBER:
        return []
    return [*map(int, several[0])]


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
    angles = numbers[:, :1] if turn[0] == "angle" else numbers
    by_name = {name: split_unit(body.columns[name], ())[1].lower() for name in turn}
    units = {by_name["angle"]} if turn[0] == "angle" else {*by_name.values()}
    if len({_ANGLES.get(unit) for unit in units}) > 1:
        listed = ", ".join(f"{name} in {unit or 'none'}" for name, unit in by_name.items())
        problem = f"the angles have different units: {listed}; convert them to one"
        raise InputError(problem, path=table.path, line=sheet.line)
    degrees = _ANGLES.get(min(units), sheet.degrees)
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
        return np.asarray(Rotation.from_euler(euler, chosen).as_quat(scalar_first=True))
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


def robots_of(text: CsvFile, column: str) -> Ints:
    """Read numbers of robots, or the only one in each name, such as 7 in `bot_7`, shape (rows,)."""
    names: list[str] = text.words(column).tolist()
    if any(re.fullmatch(r"\s*[-+]?\d+\s*", name) for name in names):
        return text.integers(column)
    single = [*dict.fromkeys(names)]
    numbers, named = numbers_in(single), dict[int, str]()
    if not numbers:
        odd = next((name for name in single if len(re.findall(r"\d+", name)) != 1), "")
        odd = odd or max(single, key=len)
        problem = f"{odd[:40]!r} has no number, or several; write it like bot_7, or delete its "
        problem += "rows if it is no robot"
        raise InputError(problem, path=text.path, line=text.line(names.index(odd)), key=column)
    for number, name in zip(numbers, single, strict=True):
        if named.setdefault(number, name) != name:
            problem = f"{name[:40]!r} has the number of another robot; give each its own"
            raise InputError(problem, path=text.path, line=text.line(names.index(name)), key=column)
    robot = dict(zip(single, numbers, strict=True))
    return np.array([robot[name] for name in names], np.int64)


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
