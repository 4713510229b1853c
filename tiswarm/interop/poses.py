"""Poses of robots, as other simulators tell them: a table of centers, or one of spheres."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiswarm.errors import InputError
from tiswarm.records.io import at_line, numbered_lines
from tiswarm.records.positions import read_cells, read_number, read_whole
from tiswarm.records.sensing_file import FAR_FROM_UNIT

QUATERNION = ("qw", "qx", "qy", "qz")
FEWEST_SPHERES = 3
"""Fewer do not say how a robot is turned."""


@dataclass(frozen=True, kw_only=True)
class Poses:
    """N robots with D docks each, in the order of their file."""

    robot_id: NDArray[np.int64]
    """Name of each robot, shape (N,)."""

    position: NDArray[np.float64]
    """Centers, in the file's unit, shape (N, 3)."""

    orientation_wxyz: NDArray[np.float64]
    """Body to world, unit quaternion, shape (N, 4)."""

    dock_offset_body: NDArray[np.float64]
    """Center to dock, body frame, shape (D, 3)."""

    join: NDArray[np.int64] | None
    """When each robot joined, ascending in time; None where the file does not say, shape (N,)."""

    length_unit: str
    """Unit of all lengths as the columns name it; empty where they do not."""


@dataclass(frozen=True, kw_only=True)
class _Row:
    line: int
    robot: int
    sphere: int
    join: int
    place: list[float]
    quaternion: list[float]


def read_poses(path: Path, dock_offset_body: NDArray[np.float64], tolerance: float) -> Poses:
    """Read `robot,x,y,z,qw,qx,qy,qz` or `robot,sphere,x,y,z`, in any order, among other columns.

    Lengths may name their unit, as in `x_mm`. A column `join` says in which order robots joined.
    Of spheres, a robot's center is their mean, and the first robot stands upright by definition.

    Args:
        path: The table.
        dock_offset_body: Center to dock, body frame, shape (D, 3); of no use for spheres, which say
            it themselves.
        tolerance: How far a sphere may lie from where the first robot's shape has it.

    Raises:
        InputError: the table cannot be read or a row is malformed; tells file and line.
    """
    lines = numbered_lines(path)
    number, text = next(lines, (1, ""))
    with at_line(path, number):
        header = [cell.strip() for cell in read_cells(text)]
        columns, unit = _columns(header)
    rows = [_row(number, text, header, columns, path) for number, text in lines]
    if not rows:
        problem = "there are no robots; add a row for each"
        raise InputError(problem, path=path, line=2)
    robots = _by_robot(rows, path, spheres="sphere" in columns)
    first = [row[0] for row in robots]
    place = np.array([[row.place for row in group] for group in robots])
    if "sphere" in columns:
        position = place.mean(axis=1)
        dock_offset_body = place[0] - position[0]
        orientation = _turns(place - position[:, None], first, path, tolerance)
    else:
        position = place[:, 0]
        orientation = np.array([row.quaternion for row in first])
    return Poses(
        robot_id=np.array([row.robot for row in first], np.int64),
        position=position,
        orientation_wxyz=orientation,
        dock_offset_body=dock_offset_body,
        join=np.array([row.join for row in first], np.int64) if "join" in columns else None,
        length_unit=unit,
    )


def _columns(header: Sequence[str]) -> tuple[dict[str, int], str]:
    """Find where each wanted column is, and the unit of the lengths."""
    units = [name[2:] for name in header if re.fullmatch(r"x_[A-Za-z]+", name)]
    for unit in ["", *units]:
        lengths = [f"{axis}_{unit}" if unit else axis for axis in "xyz"]
        rest = ["sphere"] if "sphere" in header else [*QUATERNION]
        wanted = dict(zip([*"xyz", "robot", *rest], [*lengths, "robot", *rest], strict=True))
        if set(wanted.values()) <= set(header):
            wanted |= {"join": "join"} if "join" in header else {}
            return {name: header.index(column) for name, column in wanted.items()}, unit
    problem = "the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z; rename them"
    raise InputError(problem)


def _row(
    number: int, text: str, header: Sequence[str], columns: dict[str, int], path: Path
) -> _Row:
    with at_line(path, number):
        cells = read_cells(text, len(header))
        whole = {
            name: read_whole(cells[columns[name]], name) if name in columns else 0
            for name in ("robot", "sphere", "join")
        }
        real = {
            name: read_number(cells[columns[name]], header[columns[name]])
            for name in ("x", "y", "z", *QUATERNION)
            if name in columns
        }
        quaternion = [real[name] for name in QUATERNION if name in real]
        length = float(np.linalg.norm(quaternion))
        if quaternion and abs(length - 1.0) > FAR_FROM_UNIT:
            problem = f"the quaternion has length {length:.6g}; scale it to 1"
            raise InputError(problem, key="qw")
    return _Row(
        line=number,
        **whole,
        place=[real[name] for name in "xyz"],
        quaternion=[part / length for part in quaternion],
    )


def _by_robot(rows: Sequence[_Row], path: Path, *, spheres: bool) -> list[list[_Row]]:
    """Gather the rows of each robot, in the order of its spheres; each has as many."""
    robots: dict[int, dict[int, _Row]] = {}
    for row in rows:
        own = robots.setdefault(row.robot, {})
        if row.sphere in own:
            what = f"sphere {row.sphere} of robot {row.robot}" if spheres else f"robot {row.robot}"
            problem = f"{what} has a row already; keep one"
            raise InputError(problem, path=path, line=row.line)
        own[row.sphere] = row
    names = sorted(next(iter(robots.values())))
    for name, own in robots.items():
        line = next(iter(own.values())).line
        if sorted(own) != names:
            problem = (
                f"robot {name} has spheres {sorted(own)}, the first robot {names}; complete it"
            )
            raise InputError(problem, path=path, line=line, key="sphere")
        if spheres and len(names) < FEWEST_SPHERES:
            problem = f"{len(names)} spheres do not say how a robot is turned; give three or more"
            raise InputError(problem, path=path, line=line, key="sphere")
    return [[own[name] for name in names] for own in robots.values()]


def _turns(
    offset: NDArray[np.float64], first: Sequence[_Row], path: Path, tolerance: float
) -> NDArray[np.float64]:
    """Orientation of each robot against the first one's, shape (N, 4).

    Args:
        offset: Center to sphere, world frame, shape (N, D, 3).
        first: A row of each robot, for its line.
        path: The file, for messages.
        tolerance: How far a sphere may lie from where the first robot's shape has it.
    """
    turns = []
    for own, row in zip(offset, first, strict=True):
        turn, _ = Rotation.align_vectors(own, offset[0])
        off = np.linalg.norm(turn.apply(offset[0]) - own, axis=1).max()
        if off > tolerance:
            problem = (
                f"the spheres of robot {row.robot} lie {off:.3g} off the first robot's shape; "
                "give rigid robots of one shape, or a larger --tolerance"
            )
            raise InputError(problem, path=path, line=row.line)
        turns.append(turn.as_quat(scalar_first=True))
    return np.array(turns)
