"""Reads the columns of a table of poses by their meaning: names, units, times, incomplete rows."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.records.io import CsvFile
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import FARTHEST

QUATERNION = ["qw", "qx", "qy", "qz"]
_AXES = [*"xyz"]
_ROBOT_NAME = "robot_name"
LONGEST_NUMBER = 18
"""Digits of a number that an integer of 64 bits holds."""

_WHOLE = ("robot", "sphere", "join")
_NAMES = {
    "robot": ("robot", "robot_id", "id", _ROBOT_NAME),
    "time": ("time", "t", "stamp", "timestamp", "frame", "step"),
}
"""Names of a column, the first that a table has is read; others have their meaning as name."""

_LENGTHS = (
    *("m", "cm", "mm", "dm", "um", "µm", "nm", "km", "in", "ft", "yd", "R"),
    *("meters", "centimeters", "millimeters", "inches", "feet"),
)
"""Units of length that a column may name, in capitals or not. Other words after an axis name other
quantities, such as velocities and standard deviations."""

_NO_UNIT = "unit"
"""Unit of tables that name none, as exports write it."""

_TIMES = ("s", "sec", "seconds", "ms", "us", "µs", "ns", "min", "steps", "frames")
"""Units of time that a column may name."""

_UNIT = re.compile(
    r"(?P<name>\w+?)(?:_(?P<suffix>[A-Za-z]+)|\s*[\[(]\s*(?P<brackets>[^\])]*?)\s*[\])])"
)
"""A name with its unit: `x_mm`, `x [mm]`, `x (mm)`."""


_MESSAGE = re.compile(r"(?:.*[./])?(?:position|(?P<turn>orientation))[./](?P<axis>[wxyz])")
"""A name as tables of ROS messages have it: `pose.position.x`, `pose.orientation.w`."""


class PoseTable(NamedTuple):
    """Poses, or spheres, of all robots in the order of their file."""

    rows: pd.DataFrame
    """Columns `robot`, `x`, `y`, `z`, then `qw`, `qx`, `qy`, `qz` or `sphere`; `join` and `time`
    where the file has them; `line`, and `run` with the name of the structure."""

    length_unit: str
    """Unit of lengths as the columns name it; empty where they do not."""

    quaternion_order: Sequence[str]
    """Columns of the quaternion in the order of the file; none of spheres."""

    notes: Sequence[str] = ()
    """What was left out, in lines."""

    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None where the file has no docks."""


def read_table(
    path: Path, *, dock_radius: float, drop_incomplete: bool, length_unit: str = _NO_UNIT
) -> PoseTable:
    """Read a table `robot,x,y,z,qw,qx,qy,qz` or `robot,sphere,x,y,z`, in any order of columns.

    Times count only where a robot, or sphere, has several rows: other tables are free to have a
    column of that name.

    Args:
        path: The table.
        dock_radius: Radius of a dock sphere.
        drop_incomplete: Whether to leave out rows that lack a number, instead of refusing them.
        length_unit: A unit of length that columns may name beside the usual ones.

    Raises:
        InputError: the table is malformed, or lacks a column.
    """
    text = CsvFile(path)
    columns, unit = _columns(text.columns, path, length_unit)
    notes = _without_incomplete(text, columns.values(), drop=drop_incomplete)
    time = _find(text.columns, "time")
    single = [name for name in ("run",) if name in text.columns] + [
        columns[name] for name in ("robot", "sphere") if name in columns
    ]
    cells = zip(*(text.words(name).tolist() for name in single), strict=True)
    if time and len({*cells}) < len(text.rows):
        notes += _without_incomplete(text, [time], drop=drop_incomplete)
        columns["time"] = time
    numbers = {
        name: text.integers(column) if name in _WHOLE else text.numbers(column)
        for name, column in columns.items()
        if column.lower() != _ROBOT_NAME
    }
    if columns["robot"].lower() == _ROBOT_NAME:
        numbers["robot"] = _numbers_in(text, columns["robot"])
    rows = pd.DataFrame(numbers | {"line": [*text.rows], "run": _runs(text)})
    refuse_far(rows, path, dock_radius, columns)
    turned = sorted(
        QUATERNION, key=lambda name: text.columns.index(columns.get(name, columns["x"]))
    )
    return PoseTable(rows, unit, () if "sphere" in columns else turned, notes)


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


def _columns(header: Sequence[str], path: Path, length_unit: str) -> tuple[dict[str, str], str]:
    """Find the column of each quantity, and the unit of lengths."""
    found = {
        name: column for name in ("robot", "sphere", "join") if (column := _find(header, name))
    }
    for name in QUATERNION if "sphere" not in found else ():
        if column := _find(header, name):
            found[name] = column
    wanted = ["sphere"] if "sphere" in found else QUATERNION
    lengths, unit = _positions(header, path, length_unit)
    needed = {name: found.get(name) or lengths.get(name) for name in ("robot", *_AXES, *wanted)}
    if lacking := [name for name, column in needed.items() if not column]:
        problem = "the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z but "
        problem += f"{','.join(header)[:200] or 'none'}; rename or add {','.join(lacking)}"
        raise InputError(problem, path=path, line=1)
    columns = {name: found[name] for name in ("robot", *wanted, "join") if name in found} | lengths
    for column in columns.values():
        if header.count(column) > 1:
            problem = f"there are {header.count(column)} columns of this name; rename all but one"
            raise InputError(problem, path=path, line=1, key=column)
    return columns, unit


def _positions(header: Sequence[str], path: Path, length_unit: str) -> tuple[dict[str, str], str]:
    """Find the columns of x, y and z, all in one unit, and that unit; axes may lack a column.

    Raises:
        InputError: there are two sets of such columns, or axes have different units.
    """
    known = {unit.lower() for unit in ("", *_LENGTHS, _NO_UNIT, length_unit)}
    found: dict[str, dict[str, list[str]]] = {axis: {} for axis in _AXES}
    unknown: dict[str, str] = {}
    for column in header:
        axis, unit = _split(column)
        if axis in found and unit.lower() in known:
            found[axis].setdefault(unit.lower(), []).append(column)
        elif axis in found:
            unknown.setdefault(unit, column)
    sets = [{*units} for units in found.values()]
    complete = [unit for unit in found["x"] if unit in set.intersection(*sets)]
    several = [",".join(units[unit][0] for units in found.values()) for unit in complete]
    if len(complete) == 1:
        columns = ([*chain(*units.values())] for units in found.values())
        several = next((names for names in columns if len(names) > 1), [])
    if len(several) > 1:
        problem = f"positions are in {' and in '.join(several)}; keep one, or rename the others"
        raise InputError(problem, path=path, line=1)
    if not complete and all(sets):
        units = ", ".join(f"{axis} in {next(iter(found[axis])) or 'none'}" for axis in found)
        problem = f"the axes have different units: {units}; convert them to one"
        raise InputError(problem, path=path, line=1)
    if unknown and not any(sets):
        unit, column = next(iter(unknown.items()))
        problem = f"{unit[:40]!r} is no known unit of length; rename it to one of "
        problem += f"{', '.join(_LENGTHS)}, or give --length-unit {unit[:40]}"
        raise InputError(problem, path=path, line=1, key=column)
    lengths = {axis: next(iter(units.values()))[0] for axis, units in found.items() if units}
    if complete:
        lengths = {axis: units[complete[0]][0] for axis, units in found.items()}
    return lengths, _split(lengths.get("x", ""))[1]


def _split(column: str) -> tuple[str, str]:
    """Split a column's name into its meaning in lower case, and its unit."""
    if found := _MESSAGE.fullmatch(column):
        return f"{'q' if found['turn'] else ''}{found['axis']}", ""
    found = _UNIT.fullmatch(column)
    if found is None:
        return column.lower(), ""
    return found["name"].lower(), found["suffix"] or found["brackets"] or ""


def _find(header: Sequence[str], meaning: str) -> str:
    """Find the column of a quantity by its names, of a time with a unit or not; else return ""."""
    for name in _NAMES.get(meaning, (meaning,)):
        for column in header:
            if column.lower() == name or (name in QUATERNION and _split(column) == (name, "")):
                return column
            if meaning == "time" and _split(column)[0] == name and _split(column)[1] in _TIMES:
                return column
    return ""


def _without_incomplete(text: CsvFile, columns: Iterable[str], *, drop: bool) -> list[str]:
    """Drop rows that lack a number and say so in a line, or refuse them all at once."""
    lines = text.incomplete(columns)
    note = report_incomplete(text.path, lines, drop=drop)
    if lines:
        text.drop(lines)
    return note


def _numbers_in(text: CsvFile, column: str) -> Ints:
    """Read the only number in the name of each robot, such as 7 in `bot_7`, shape (rows,)."""
    names: list[str] = text.words(column).tolist()
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


def _runs(text: CsvFile) -> list[str]:
    """Read the structure of each row; its name becomes that of a folder."""
    if "run" not in text.columns:
        return [""] * len(text.rows)
    names: list[str] = text.words("run").tolist()
    for row, name in enumerate(names):
        if not re.fullmatch(r"(?!\.)[A-Za-z0-9._-]{1,80}", name):
            problem = f"{name[:40]!r} cannot be a folder; use letters, digits, dots, - and _"
            raise InputError(problem, path=text.path, line=text.line(row), key="run")
    return names
