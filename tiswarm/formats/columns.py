"""Reads tables of poses by what the names of their columns mean, in the words of any program.

A row has the pose of one robot, or those of all. What a program calls its columns is a row of the
tables below; what a table does not state, an import has to assume.
"""

import csv
import io
import re
import string
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.formats.bag_messages import has_other_words
from tiswarm.formats.layouts import EXPORTS, TABLES, Layout, with_joints_named
from tiswarm.formats.poses import QUATERNION, Assumptions, PoseTable, first_names
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

_MESSAGES = {*("field", "pose", "msg", "data", "transform", "header", "state"), ""}
"""Parts of a message's name that name no robot."""

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
    b"\x89MCAP": "a part of a bag of ROS 2; name its folder, made whole by ros2 bag reindex",
    b"SQLite format 3": "a part of a bag of ROS 2; name its folder, made whole by ros2 bag reindex",
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
    if not assumed.left_handed:
        _refuse_left_handed(sheet, path)
    table = CsvFile(path, sheet.text)
    label_columns = _label_columns(table.columns, assumed, path)
    bodies = _bodies(table.columns, label_columns, assumed, path, sheet, is_one=robot is not None)
    is_wide = "robot" not in label_columns and robot is None
    unnumbered: list[str] = []
    if is_wide and not sheet.program:
        unnumbered = [body.name for body in bodies if not re.search(r"\d", body.name)]
        bodies = [body for body in bodies if body.name not in unnumbered] or bodies
    if is_wide:
        rows, notes = _read_wide_rows(table, bodies, label_columns)
    else:
        rows, notes = _read_long_rows(table, bodies, label_columns, assumed, robot)
    if unnumbered:
        notes.append(f"no robots, since their names have no number: {first_names(unnumbered)}")
    first_body = bodies[0]
    if "sphere" not in label_columns:
        notes += _add_quaternions(rows, table, first_body, assumed, sheet)
    refuse_far(rows, path, assumed.dock_radius, first_body.columns)
    unit = first_body.unit or sheet.length_unit
    order = _quaternion_order(first_body, table.columns)
    return PoseTable(rows, unit, order, [*sheet.notes, *notes])


def _refuse_left_handed(sheet: Sheet, path: Path) -> None:
    """Raise InputError where a table says near its start that its frame is left-handed."""
    statement = re.search(r"left[-_ ]?hand", sheet.text[:10_000], re.IGNORECASE)
    if statement:
        problem = "the frame is left-handed; add --left-handed to turn it to a right-handed one"
        line = 1 + sheet.text.count("\n", 0, statement.start())
        raise InputError(problem, path=path, line=line)


def _quaternion_order(body: _PoseColumns, header: Sequence[str]) -> list[str]:
    """List the parts of a quaternion in the order of their columns; empty without quaternions."""
    if body.turn not in {("qw", "qx", "qy", "qz"), ("rw", "rx", "ry", "rz")}:
        return []
    place = {
        part: header.index(body.columns[name])
        for part, name in zip(QUATERNION, body.turn, strict=True)
    }
    return sorted(QUATERNION, key=place.__getitem__)


def plain_sheet(path: Path) -> Sheet:
    """Read a table of any separator; its head is the first line, or a comment before numbers.

    Lines keep their numbers. A line of units below the head becomes part of it.
    """
    lines = [text.rstrip("\r\n") for _, text in numbered_lines(path, MAX_TABLE_BYTES)]
    content = [k for k, text in enumerate(lines) if text.strip() and not text.startswith("#")]
    if not content:
        return Sheet("\n".join(lines))
    head = _head(lines, content)
    comments = [k for k in range(head) if re.match(r"[#%]\s*[A-Za-z_]", lines[k])]
    if comments and head == content[0] and _are_numbers(_cells(lines[head])):
        head = comments[-1]
    names = _cells(lines[head].lstrip("#% "))
    separator = max(_SEPARATORS, key=lines[head].count)
    rows = [k for k in content if k > head]
    units = _cells(lines[rows[0]]) if rows else []
    if _are_units(units):
        names = [
            f"{name} [{unit.strip('[]() ')}]" if unit else name
            for name, unit in zip(names, units, strict=False)
        ]
        lines[rows.pop(0)] = "#"
    if separator not in lines[head]:  # blanks
        cells = [_words(text) for text in lines]
        if {len(cells[k]) for k in rows} == {len(names) + 1}:
            names = ["", *names]  # R and pandas give numbers of rows no name
        lines = ["\t".join(words) for words in cells]
    elif _all_end_with(separator, [lines[k] for k in rows], len(names)):
        names.append("")
    if separator == "|":
        separator = "\t"
        lines = [text.replace("|", "\t") for text in lines]
    lines = [text if text.strip() else "#" for text in lines]
    prose = [text if text.startswith("#") else f"#{text}" for text in lines[:head]]
    return Sheet("\n".join([*prose, header_line(names, separator), *lines[head + 1 :]]))


def _are_units(cells: Sequence[str]) -> bool:
    """Whether the cells of a line are units; single ones may be empty."""
    units = {unit.lower() for unit in (*LENGTHS, *_TIMES, *_ANGLES, "")}
    return any(cells) and {cell.strip("[]() ").lower() for cell in cells} <= units


def _all_end_with(separator: str, rows: Sequence[str], count: int) -> bool:
    """Whether each row ends with the last of `count` separators; not if there are no rows."""
    return {(row.count(separator), row.rstrip()[-1]) for row in rows} == {(count, separator)}


def _head(lines: Sequence[str], content: Sequence[int]) -> int:
    """Find the head below lines of prose: the first names that are as many as cells of most rows.

    It is the first line where there are none.

    Args:
        lines: Lines of the table.
        content: Places of those that are neither empty nor a comment; there is one at least.
    """
    counts = [len(_cells(lines[k])) for k in content[:_LONGEST_PROSE]]
    usual = max(counts, key=counts.count)
    for k, count in zip(content, counts, strict=False):
        if count == usual and counts[0] < usual:
            is_named = not any(_are_numbers([cell]) for cell in _cells(lines[k]) if cell)
            return k if is_named else content[0]
    return content[0]


def refuse_other_files(path: Path) -> None:
    """Refuse a file whose first bytes are those of another format, and name what to do."""
    if path.is_dir():
        return
    with open_input(path) as file:
        start = file.read(64).lstrip()
    if path.suffix in {".yaml", ".yml"}:
        raise InputError("this is YAML, no table; give a scenario to tiswarm run", path=path)
    for first_bytes, problem in _OTHER_FILES.items():
        if start.startswith(first_bytes):
            raise InputError(f"this is {problem}", path=path)


def header_line(names: Sequence[str], separator: str) -> str:
    """Write names as a line of a table."""
    line = io.StringIO()
    csv.writer(line, delimiter=separator, lineterminator="").writerow(names)
    return line.getvalue()


def _cells(text: str) -> list[str]:
    """Split a line at the separator that it has."""
    separator = max(_SEPARATORS, key=text.count)
    if separator not in text:
        return _words(text)
    try:
        cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        cells = text.split(separator)
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
            row = rows.iloc[far[0]]
            problem = f"{row[axis]:g} is too far out; move the origin to the robots"
            key = axis if columns is None else columns[axis]
            raise InputError(problem, path=path, line=int(row["line"]), key=key)


def _label_columns(header: Sequence[str], assumed: Assumptions, path: Path) -> dict[str, str]:
    """Find the columns that an option names, and those of robots, times, joins and spheres."""
    quantities = {*chain(*TURNS), *_AXES, "robot", "time", "join", "sphere", "run"}
    for meaning, column in assumed.columns.items():
        if meaning not in quantities:
            usual = ["robot", "time", "join", *_AXES, *QUATERNION, "roll", "pitch", "yaw"]
            problem = f"{meaning!r} is no quantity; use {', '.join(usual)}"
            raise InputError(problem, argument="column")
        if header.count(column) != 1:
            problem = f"there is no column {column!r}, or there are several; name one of "
            raise InputError(problem + ",".join(header)[:200], path=path, line=1)
    label_columns = {}
    for name in ("robot", "sphere", "join", "time", "run"):
        column = assumed.columns.get(name) or find_column(header, name)
        if column:
            label_columns[name] = column
    for column in label_columns.values():
        if header.count(column) > 1:
            problem = f"there are {header.count(column)} columns of this name; rename all but one"
            raise InputError(problem, path=path, line=1, key=column)
    return label_columns


def _bodies(
    header: Sequence[str],
    label_columns: Mapping[str, str],
    assumed: Assumptions,
    path: Path,
    sheet: Sheet,
    *,
    is_one: bool,
) -> Sequence[_PoseColumns]:
    """Find the columns of each robot, or those of all robots if a column names them."""
    has_spheres = "sphere" in label_columns
    layouts = [EXPORTS[sheet.program]] if sheet.program else TABLES
    names = [name for name in header if name not in label_columns.values()]
    poses = [
        body
        for layout in layouts
        for body in _bodies_in(layout, names, assumed, path)
        if {*_AXES} <= {*body.columns} and (body.turn or has_spheres)
    ]
    complete: list[_PoseColumns] = []
    for body in poses:
        if all(body.columns["x"] != earlier.columns["x"] for earlier in complete):
            complete.append(body)
    is_named = "robot" in label_columns or is_one
    if not is_named and not has_spheres:
        several = [body for body in complete if body.name]
        if several and (sheet.program or any(re.search(r"\d", body.name) for body in several)):
            return several
    chosen = [body for body in complete if not body.name] or complete
    if len(chosen) > 1:
        sets = (",".join(body.columns[axis] for axis in _AXES) for body in chosen)
        problem = f"positions are in {' and in '.join(sets)}; choose by --column x=NAME,y=NAME,..."
        if not is_named:
            problem += ", or give robots names with numbers, such as bot_7"
        raise InputError(problem, path=path, line=sheet.line)
    plain = next(iter(_bodies_in(layouts[0], names, assumed, path)), None)
    _refuse_lacking(header, label_columns, chosen, plain, path, sheet, is_one=is_one)
    return [body._replace(turn=() if has_spheres else body.turn) for body in chosen]


def _bodies_in(
    layout: Layout, names: Sequence[str], assumed: Assumptions, path: Path
) -> list[_PoseColumns]:
    """Find the columns of poses in a layout, and those that the user names; by robot."""
    assigned = {column: meaning for meaning, column in assumed.columns.items()}
    units = {unit.lower() for unit in ("", *LENGTHS, _NO_UNIT, assumed.length_unit)}
    columns_of: dict[str, list[_Column]] = {}
    for name in names:
        bare, unit = split_unit(name, units)
        if name in assigned:
            columns_of.setdefault("", []).append(_Column(name, "", assigned[name], unit))
            continue
        read = layout.read(with_joints_named(bare))
        if read is None or read[1] in assumed.columns or has_other_words(read[0]):
            continue
        body, meaning = read
        if layout.program not in EXPORTS:
            parts = [part for part in re.split(r"[./|:\s]+", body) if part.lower() not in _MESSAGES]
            body = ".".join(parts).strip("_- ")
        columns_of.setdefault(body, []).append(_Column(name, body, meaning, unit))
    return [_body(name, columns, path) for name, columns in columns_of.items()]


def _refuse_lacking(
    header: Sequence[str],
    label_columns: Mapping[str, str],
    complete: Sequence[_PoseColumns],
    plain: _PoseColumns | None,
    path: Path,
    sheet: Sheet,
    *,
    is_one: bool,
) -> None:
    """Refuse a table without columns of robots, positions or orientations."""
    meanings = {*label_columns}
    if complete:
        meanings |= {*complete[0].columns}
    elif plain is not None:
        meanings |= {*plain.columns}
    needed = [] if is_one else ["robot"]
    needed += _AXES
    if "sphere" not in label_columns and not (complete and complete[0].turn):
        needed += QUATERNION
    lacking = [name for name in needed if name not in meanings]
    if not lacking:
        return
    if sheet.program:
        problem = f"{sheet.program}'s export has no rigid bodies with positions and orientations; "
        raise InputError(f"{problem}export them", path=path, line=1)
    if not {*_AXES} & meanings:
        _refuse_unknown_units(header, path)
    if any(header) and _are_numbers(header):
        problem = "there are no names of columns; write robot,x,y,z,qw,qx,qy,qz, or what they are, "
        raise InputError(f"{problem}above the numbers", path=path, line=sheet.line)
    problem = "the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z but "
    problem += f"{','.join(header)[:200] or 'none'}; rename or add {','.join(lacking)}"
    asked = ",".join(f"{name}=NAME" for name in lacking)
    raise InputError(f"{problem}, or name columns by --column {asked}", path=path, line=sheet.line)


def _refuse_unknown_units(header: Sequence[str], path: Path) -> None:
    """Raise InputError where a name of a column would be an axis but for its unit."""
    for column in header:
        axis = re.fullmatch(r"[xyz][_ ]*[\[(]?([a-z]+)[\])]?", column, re.IGNORECASE)
        if axis:
            unit = axis[1][:40]
            problem = f"{unit!r} is no known unit of length; rename it to one of "
            problem += f"{', '.join(LENGTHS)}, or give --length-unit {unit}"
            raise InputError(problem, path=path, line=1, key=column)


def _body(name: str, columns: Sequence[_Column], path: Path) -> _PoseColumns:
    """Choose the columns of a robot: positions in one unit, and an orientation.

    Raises:
        InputError: there are two sets of positions, or axes have different units.
    """
    lengths, unit = _positions(columns, path)
    columns_of: dict[str, list[str]] = {}
    for column in columns:
        columns_of.setdefault(column.meaning, []).append(column.name)
    turn = next((turn for turn in TURNS if {*turn} <= {*columns_of}), ())
    for meaning, names in columns_of.items():
        if meaning in turn and len(names) > 1:
            problem = f"{meaning} is in {' and in '.join(names)}; choose by --column {meaning}=NAME"
            raise InputError(problem, path=path, line=1)
    turn_columns = {meaning: columns_of[meaning][0] for meaning in turn}
    return _PoseColumns(name, {**turn_columns, **lengths}, turn, unit)


def _positions(columns: Sequence[_Column], path: Path) -> tuple[dict[str, str], str]:
    """Find the columns of x, y and z, all in one unit, and that unit; axes may lack a column."""
    columns_of: dict[str, dict[str, list[_Column]]] = {axis: {} for axis in _AXES}
    for column in columns:
        if column.meaning in columns_of:
            columns_of[column.meaning].setdefault(column.unit.lower(), []).append(column)
    sets = [{*units} for units in columns_of.values()]
    complete = [unit for unit in columns_of["x"] if unit in set.intersection(*sets)]
    several = [",".join(units[unit][0].name for units in columns_of.values()) for unit in complete]
    if len(complete) == 1:
        listed = (
            [column.name for column in chain(*units.values())] for units in columns_of.values()
        )
        several = next((names for names in listed if len(names) > 1), [])
    if len(several) > 1:
        problem = f"positions are in {' and in '.join(several)}; keep one, or rename the others"
        raise InputError(problem, path=path, line=1)
    if not complete and all(sets):
        first_units = {axis: next(iter(units)) for axis, units in columns_of.items()}
        listed_units = ", ".join(
            f"{axis} in {unit or 'none'}" for axis, unit in first_units.items()
        )
        problem = f"the axes have different units: {listed_units}; convert them to one"
        raise InputError(problem, path=path, line=1)
    if complete:
        chosen = {axis: units[complete[0]][0] for axis, units in columns_of.items()}
    else:
        chosen = {
            axis: next(iter(units.values()))[0] for axis, units in columns_of.items() if units
        }
    unit = chosen["x"].unit if "x" in chosen else ""
    return {axis: column.name for axis, column in chosen.items()}, unit


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


def _read_long_rows(
    table: CsvFile,
    bodies: Sequence[_PoseColumns],
    label_columns: Mapping[str, str],
    assumed: Assumptions,
    robot: int | None,
) -> tuple[pd.DataFrame, list[str]]:
    """Read a table with a robot a row; returns its rows, and what was left out."""
    drop = assumed.drop_incomplete
    labels = ["sphere", "join"] if robot is not None else ["robot", "sphere", "join"]
    columns = {name: label_columns[name] for name in labels if name in label_columns}
    columns |= bodies[0].columns
    for column in columns.values():
        if table.columns.count(column) > 1:
            problem = f"there are {table.columns.count(column)} columns of this name; rename all "
            raise InputError(f"{problem}but one", path=table.path, line=1, key=column)
    notes = _without_incomplete(table, columns.values(), drop=drop)
    keys = [label_columns[name] for name in ("run", "robot", "sphere") if name in label_columns]
    row_keys = {*zip(*(table.words(name).tolist() for name in keys), strict=True)}
    if "time" in label_columns and (robot is not None or len(row_keys) < len(table.rows)):
        notes += _without_incomplete(table, [label_columns["time"]], drop=drop)
        columns["time"] = label_columns["time"]
    robots: Ints | int = robot if robot is not None else robots_of(table, columns["robot"])
    numbers: dict[str, Any] = {
        name: table.integers(column) if name in {"sphere", "join"} else table.numbers(column)
        for name, column in columns.items()
        if name not in {"robot", "time"}
    }
    if "time" in columns:
        numbers["time"] = times_of(table, columns["time"])
    rows = pd.DataFrame({"robot": robots, **numbers, "line": [*table.rows]})
    rows = rows.assign(run=_runs(table, label_columns))
    if "time" in columns:
        _refuse_clocks_set_anew(rows, table.path, columns["time"])
    return rows, notes


def _read_wide_rows(
    table: CsvFile, bodies: Sequence[_PoseColumns], label_columns: Mapping[str, str]
) -> tuple[pd.DataFrame, list[str]]:
    """Read a table with all robots in a row; returns rows of each, and what was left out."""
    names = [_listed_name(table, body.name) for body in bodies]
    robots, notes = robot_numbers(names)
    lines = np.array([*table.rows])
    time = (
        times_of(table, label_columns["time"]) if "time" in label_columns else lines.astype(float)
    )
    clock = pd.DataFrame({"robot": 0, "run": "", "time": time, "line": lines})
    _refuse_clocks_set_anew(clock, table.path, label_columns.get("time", ""))
    rows_of_robots = []
    lost = 0
    for robot, body in zip(robots, bodies, strict=True):
        columns = [*body.columns.values()]
        for line in table.incomplete(columns):
            for column in columns:
                table.rows[line][table.columns.index(column)] = ""
        numbers = {
            name: table.numbers(column, empty=np.nan) for name, column in body.columns.items()
        }
        poses = pd.DataFrame({"robot": robot, "time": time, **numbers, "line": lines})
        is_zero = (poses[[*body.columns]] == 0.0).all(axis=1)
        is_whole = poses[[*body.columns]].notna().all(axis=1)
        seen = poses[~is_zero & is_whole]
        lost += len(poses) - len(seen)
        rows_of_robots.append(seen)
    rows = pd.concat(rows_of_robots, ignore_index=True).assign(run="")
    if not len(rows):
        problem = "there are no poses; export frames with bodies"
        raise InputError(problem, path=table.path, line=1)
    if lost:
        notes.append(f"{counted(lost, 'pose')} of bodies that the cameras lost left out")
    if len(lines) == 1:
        rows = rows.drop(columns="time")
    return rows, notes


_PARTS_OF_SECONDS = ("nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs")


def times_of(table: CsvFile, column: str) -> Reals:
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
    for (_, robot), samples in rows.groupby(["run", "robot"], sort=False):
        time = samples["time"].to_numpy(float)
        back = np.flatnonzero(np.diff(time) < 0.0)
        if not 0 < len(back) <= _RARE * len(time):
            continue
        rows_back = [int((time[: k + 1] > time[k + 1]).sum()) for k in back]
        if max(rows_back) > _SET_BACK:
            k = back[int(np.argmax(rows_back))]
            problem = f"the time of robot {robot} goes back from {time[k]:g} to {time[k + 1]:g}; "
            problem += "import each recording alone, or sort the rows if they are of one"
            raise InputError(problem, path=path, line=int(samples["line"].iloc[k + 1]), key=column)


def _listed_name(table: CsvFile, body: str) -> str:
    """Return the name that a message lists for a body, such as `name3` for `pose3`, or its own."""
    number = re.search(r"\d+", body)
    if number is None:
        return body
    for column in table.columns:
        is_name = re.fullmatch(rf"(?:field\.)?name\[?{number[0]}\]?", column)
        if is_name or column.endswith(f"{body}.child_frame_id"):
            return str(table.words(column)[0])
    return body


_EXAMPLES = 3
"""Bodies that a note about their numbers lists."""


def robot_numbers(names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Take the numbers of robots from their names, or count them and say so."""
    numbers = numbers_in(names)
    if len({*numbers}) == len(names):
        return numbers, []
    examples = [f"{name} is {number}" for number, name in enumerate(names)]
    if len(examples) > _EXAMPLES:
        examples = [*examples[:_EXAMPLES], "..."]
    return [*range(len(names))], [f"bodies are numbered as listed: {', '.join(examples)}"]


def numbers_in(names: Sequence[str]) -> list[int]:
    """Read the number in each name, the one that differs where names have several; else nothing.

    >>> numbers_in(["tb3_0/base", "tb3_12/base"])
    [0, 12]
    """
    digits = [re.findall(r"\d+", name) for name in names]
    counts = {len(numbers) for numbers in digits}
    if len(counts) != 1 or counts == {0}:
        return []
    candidates = [*zip(*digits, strict=True)]
    if counts != {1}:
        candidates = [texts for texts in candidates if len({*texts}) > 1]
    if len(candidates) != 1 or max(map(len, candidates[0])) > LONGEST_NUMBER:
        return []
    return [int(text) for text in candidates[0]]


def _add_quaternions(
    rows: pd.DataFrame, table: CsvFile, body: _PoseColumns, assumed: Assumptions, sheet: Sheet
) -> list[str]:
    """Convert what states orientations to quaternions, in place, and say what was assumed.

    Raises:
        InputError: the order of angles is unknown, or a matrix is no rotation.
    """
    turn = body.turn
    numbers = rows[[*turn]].to_numpy(float)
    for name in turn:
        del rows[name]
    if turn[0] in {"qw", "rw"}:
        rows[QUATERNION] = numbers
        return []
    if len(turn) == _CELLS_OF_A_MATRIX:
        rows[QUATERNION] = _quaternions_of_matrices(numbers, rows, table, body)
        return []
    has_axis = turn[0] == "angle"
    angles = numbers[:, :1] if has_axis else numbers
    stated = _stated_degrees(body, table, sheet)
    is_largest_in_degrees = bool(np.abs(angles).max(initial=0.0) > 2.0 * np.pi + 1e-3)
    degrees = is_largest_in_degrees if stated is None else stated
    if degrees:
        angles = np.radians(angles)
    if has_axis:
        axis = numbers[:, 1:]
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        vector = angles * axis / np.maximum(length, np.finfo(float).tiny)
        rows[QUATERNION] = Rotation.from_rotvec(vector).as_quat(scalar_first=True)
        return []
    euler = assumed.euler or sheet.euler or TURNS[turn]
    if not euler:
        listed = ",".join(body.columns[name] for name in turn)
        problem = f"{listed} are angles in an order that the file does not state; export "
        problem += "quaternions, or add --euler XYZ or --euler rotvec"
        raise InputError(problem, path=table.path, line=sheet.line)
    rows[["a1", "a2", "a3"]] = angles
    rows[QUATERNION] = turns_by(angles, euler)
    if assumed.euler and stated is not None:
        return []
    if euler not in ORDERS:
        return [f"angles read as --euler {euler}"]
    unit = "degrees" if degrees else "radians"
    return [f"angles read as {', '.join(turn)} in {unit}: {ORDERS[euler]}"]


_CELLS_OF_A_MATRIX = 9


def _quaternions_of_matrices(
    numbers: Reals, rows: pd.DataFrame, table: CsvFile, body: _PoseColumns
) -> Reals:
    """Convert matrices, column by column in rows of shape (n, 9), to quaternions wxyz, (n, 4).

    Raises:
        InputError: a matrix is no rotation.
    """
    matrix = numbers.reshape(-1, 3, 3).swapaxes(1, 2)
    mirrored = np.flatnonzero(~(np.linalg.det(matrix) > 0.5))  # noqa: PLR2004 - 1 but for rounding
    if len(mirrored):
        problem = "the matrix mirrors, it is no rotation; export a right-handed frame"
        line = int(rows["line"].iloc[mirrored[0]])
        raise InputError(problem, path=table.path, line=line, key=body.columns[body.turn[0]])
    wxyz: Reals = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return wxyz


def _stated_degrees(body: _PoseColumns, table: CsvFile, sheet: Sheet) -> bool | None:
    """Whether a table says that angles are in degrees; None if it does not say.

    Raises:
        InputError: columns of angles have different units.
    """
    unit_of = {name: split_unit(body.columns[name], ())[1].lower() for name in body.turn}
    units = {unit_of["angle"]} if body.turn[0] == "angle" else {*unit_of.values()}
    if len({_ANGLES.get(unit) for unit in units}) > 1:
        listed = ", ".join(f"{name} in {unit or 'none'}" for name, unit in unit_of.items())
        problem = f"the angles have different units: {listed}; convert them to one"
        raise InputError(problem, path=table.path, line=sheet.line)
    return _ANGLES.get(min(units), sheet.degrees)


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
    unique = [*dict.fromkeys(names)]
    numbers = numbers_in(unique)
    if not numbers:
        odd = next((name for name in unique if len(re.findall(r"\d+", name)) != 1), "")
        odd = odd or max(unique, key=len)
        problem = f"{odd[:40]!r} has no number, or several; write it like bot_7, or delete its "
        problem += "rows if it is no robot"
        raise InputError(problem, path=text.path, line=text.line(names.index(odd)), key=column)
    taken: set[int] = set()
    for number, name in zip(numbers, unique, strict=True):
        if number in taken:
            problem = f"{name[:40]!r} has the number of another robot; give each its own"
            raise InputError(problem, path=text.path, line=text.line(names.index(name)), key=column)
        taken.add(number)
    number_of = dict(zip(unique, numbers, strict=True))
    return np.array([number_of[name] for name in names], np.int64)


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
    rows = counted(len(lines), "incomplete row")
    where = f"line {line_ranges(lines)}"
    if drop:
        source = f"{rows} of {name}" if name else rows
        return [f"{source} dropped: {where}"]
    problem = f"{rows}, empty or NaN: {where}; complete them, or drop them with --drop-incomplete"
    raise InputError(problem, path=path, line=lines[0])


def line_ranges(lines: Collection[int]) -> str:
    """Write ascending numbers of lines, those in a row as a range.

    >>> line_ranges([2, 3, 4, 7, 9, 10])
    '2-4, 7, 9-10'
    """
    number = np.fromiter(lines, int)
    parts = np.split(number, np.flatnonzero(np.diff(number) > 1) + 1)
    return ", ".join(f"{part[0]}" if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in parts)


def _runs(text: CsvFile, label_columns: Mapping[str, str]) -> list[str]:
    """Read the structure of each row; its name becomes that of a folder."""
    if "run" not in label_columns:
        return [""] * len(text.rows)
    names: list[str] = text.words(label_columns["run"]).tolist()
    for row, name in enumerate(names):
        if not re.fullmatch(r"(?!\.)[A-Za-z0-9._-]{1,80}", name):
            problem = f"{name[:40]!r} cannot be a folder; use letters, digits, dots, - and _"
            raise InputError(problem, path=text.path, line=text.line(row), key="run")
    return names
