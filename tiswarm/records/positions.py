"""Positions as a table: `robot,x_R,y_R,z_R` and, of an estimate, `sd_R`, `known`, `yaw_deg`."""

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiswarm.errors import InputError
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import at_line, numbered_lines, write_text

KNOWN = "known"
YAW = "yaw_deg"
_ID_LIMIT = 2**63


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True poses of N robots, in join order."""

    robot_id: NDArray[np.int64]
    """Name of each robot, shape (N,)."""

    position: NDArray[np.float64]
    """Centers [R], shape (N, 3)."""

    orientation_wxyz: NDArray[np.float64]
    """Body to world, unit quaternion, shape (N, 4)."""


def write_positions(
    path: Path,
    robot_id: NDArray[np.int64],
    position: NDArray[np.float64],
    certainty: Mapping[str, Sequence[object]] | None = None,
    *,
    length_unit: str = "R",
) -> None:
    """Write a table of positions, every number in the shortest form that reads back exactly.

    Args:
        path: Where to.
        robot_id: Name of each robot, shape (N,).
        position: Centers, finite, shape (N, 3).
        certainty: Further columns, by name.
        length_unit: Unit of all lengths; part of the column names.

    Raises:
        ValueError: a position is not finite.
    """
    if not np.isfinite(position).all():
        message = f"{path.name}: positions must be finite"
        raise ValueError(message)
    places = [robot_id.tolist(), *position.T.tolist()]
    columns = dict(zip(_header(length_unit), places, strict=False)) | dict(certainty or {})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_text(path, text.getvalue())


def write_estimate(path: Path, estimate: Estimate, *, length_unit: str = "R") -> None:
    """Write an estimate with all that is known of its certainty."""
    known: dict[str, Sequence[object]] = {}
    if estimate.sd is not None:
        sds = estimate.sd.tolist()
        known[f"sd_{length_unit}"] = ["" if math.isnan(sd) else sd for sd in sds]
    if estimate.observability is not None:
        known[KNOWN] = estimate.observability.known
    if estimate.yaw is not None:
        known[YAW] = np.degrees(estimate.yaw).tolist()
    write_positions(path, estimate.robot_id, estimate.position, known, length_unit=length_unit)


def read_positions(
    path: Path, *, length_unit: str = "R"
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read the names, shape (N,), and the positions, shape (N, 3), of such a table.

    Raises:
        InputError: the table cannot be read or a row is malformed; tells file and line.
    """
    lines = numbered_lines(path)
    number, text = next(lines, (1, ""))
    columns = _header(length_unit)
    with at_line(path, number):
        header = read_cells(text)
        if header != [name for name in columns if name in {*columns[:4], *header}]:
            must, may = ",".join(columns[:4]), "".join(f"[,{name}]" for name in columns[4:])
            problem = f"the columns are not {must}{may}; rename them"
            raise InputError(problem)
    rows = dict(_rows(lines, header, path))
    if not rows:
        problem = "there are no robots; add a row for each"
        raise InputError(problem, path=path, line=2)
    return np.array(list(rows), dtype=np.int64), np.array(list(rows.values()), dtype=np.float64)


def read_length_unit(path: Path) -> str:
    """Read the unit of such a table from the names of its columns.

    Raises:
        InputError: the table cannot be read or names none.
    """
    number, text = next(numbered_lines(path), (1, ""))
    with at_line(path, number):
        place, _, unit = (read_cells(text)[1:2] or [""])[0].partition("_")
        if place != "x" or not unit:
            problem = "the columns name no unit of length; write them like robot,x_R,y_R,z_R"
            raise InputError(problem)
    return unit


def _header(length_unit: str) -> list[str]:
    return ["robot", *(f"{name}_{length_unit}" for name in ("x", "y", "z", "sd")), KNOWN, YAW]


def read_cells(line: str, count: int | None = None) -> list[str]:
    """Split a row of a table into so many cells.

    Raises:
        InputError: quotes do not match, or there are more or less; without file and line.
    """
    try:
        cells = next(csv.reader([line], strict=True), [])
    except csv.Error as error:
        problem = f"not a row of a table: {error}; write numbers with commas between them"
        raise InputError(problem) from error
    if count is not None and len(cells) != count:
        problem = f"has {len(cells)} cells; {count} are needed"
        raise InputError(problem)
    return cells


def _rows(
    lines: Iterable[tuple[int, str]], header: list[str], path: Path
) -> Iterator[tuple[int, list[float]]]:
    seen: set[int] = set()
    for number, text in lines:
        with at_line(path, number):
            cells = read_cells(text, len(header))
            robot = read_whole(cells[0], "robot")
            if robot in seen:
                problem = f"robot {robot} has a row already; keep one"
                raise InputError(problem, key="robot")
            seen.add(robot)
            position = [read_number(cells[k], header[k]) for k in (1, 2, 3)]
            for name, cell in zip(header[4:], cells[4:], strict=True):
                if name != KNOWN and cell:
                    read_number(cell, name)
        yield robot, position


def read_whole(cell: str, key: str) -> int:
    """Read a whole number, such as the name of a robot.

    Raises:
        InputError: it is none; without file and line.
    """
    try:
        if "_" not in cell and -_ID_LIMIT <= (whole := int(cell)) < _ID_LIMIT:
            return whole
    except ValueError:
        pass
    problem = f"{cell[:40]!r} is not a {key}; write a whole number"
    raise InputError(problem, key=key)


def read_number(cell: str, key: str) -> float:
    """Read a finite number.

    Raises:
        InputError: it is none; without file and line.
    """
    try:
        if "_" not in cell and math.isfinite(length := float(cell)):
            return length
    except ValueError:
        pass
    problem = f"{cell[:40]!r} is not a finite number; write it like 0.5 or 1e-3"
    raise InputError(problem, key=key)
