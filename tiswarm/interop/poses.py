"""Reads tables of robot poses, of any simulator or motion-capture system."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.records.io import CsvFile
from tiswarm.records.sensing_builder import FAR_FROM_UNIT
from tiswarm.records.sensing_log import FARTHEST

_QUATERNION = ["qw", "qx", "qy", "qz"]
_WHOLE = ["robot", "sphere", "join"]


class Poses(NamedTuple):
    """N robots in the order of their file, in its unit of length."""

    robot_id: Ints  # (N,)
    position: Reals  # centers, (N, 3)
    orientation_wxyz: Reals  # body to world, (N, 4)
    dock_offset_body: Reals  # (D, 3); no rows where the file has poses, not spheres
    join: Ints | None  # rank of each robot in join order, (N,); None where the file has none
    length_unit: str  # as the columns name it; empty where they do not

    @property
    def docks(self) -> Reals:
        """Centers of the docks, shape (N, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, self.dock_offset_body)


def read_poses(path: Path, *, dock_radius: float, shape_error: float) -> dict[str, Poses]:
    """Read a table `robot,x,y,z,qw,qx,qy,qz` or `robot,sphere,x,y,z`, structure by structure.

    The columns may be in any order, among others. Lengths may name their unit, as in `x_mm`. A
    column `join` states the join order of the robots. A column `run` names the structure of each
    row. A robot of spheres has its center at their mean; the first robot of a structure defines
    the body frame. One sphere is a dock at the center.

    Args:
        path: The table.
        dock_radius: Radius of a dock sphere.
        shape_error: Largest distance of a sphere from its place in the first robot's shape.

    Returns:
        Poses of each structure by its name, or by "" without a column `run`.

    Raises:
        InputError: the table is malformed.
    """
    text = CsvFile(path)
    columns, unit = _columns(text.columns, path)
    numbers = {
        name: text.integers(column) if name in _WHOLE else text.numbers(column)
        for name, column in columns.items()
    }
    for axis in "xyz":
        far = np.flatnonzero(np.abs(numbers[axis]) > FARTHEST * dock_radius)
        if len(far):
            problem = f"{numbers[axis][far[0]]:g} is too far out; move the origin to the robots"
            raise InputError(problem, path=path, line=text.line(far[0]), key=columns[axis])
    table = pd.DataFrame(numbers | {"line": list(text.rows), "run": _runs(text)})
    return {
        str(run): _poses(_by_robot(rows, path), unit, path, shape_error)
        for run, rows in table.groupby("run", sort=False)
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


def _poses(table: pd.DataFrame, unit: str, path: Path, shape_error: float) -> Poses:
    first = table.drop_duplicates("robot")
    place = table[[*"xyz"]].to_numpy(float).reshape(len(first), -1, 3)
    position = place.mean(axis=1)
    if "sphere" in table:
        dock_offset_body = place[0] - position[0]
        orientation = _align(place - position[:, None], first, path, shape_error)
    else:
        dock_offset_body = np.empty((0, 3))
        orientation = _unit_quaternions(first, path)
    return Poses(
        robot_id=first["robot"].to_numpy(np.int64),
        position=position,
        orientation_wxyz=orientation,
        dock_offset_body=dock_offset_body,
        join=first["join"].to_numpy(np.int64) if "join" in first else None,
        length_unit=unit,
    )


def _columns(header: list[str], path: Path) -> tuple[dict[str, str], str]:
    """Find the column of each quantity, and the unit of lengths."""
    units = [name[2:] for name in header if re.fullmatch(r"x_[A-Za-z]+", name)]
    for unit in ["", *units]:
        lengths = {axis: f"{axis}_{unit}" if unit else axis for axis in "xyz"}
        rest = ["robot", *(["sphere"] if "sphere" in header else _QUATERNION)]
        if {*lengths.values(), *rest} <= {*header}:
            rest += [name for name in ("join",) if name in header]
            return {**{name: name for name in rest}, **lengths}, unit
    problem = "the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z; rename them"
    raise InputError(problem, path=path, line=1)


def _by_robot(table: pd.DataFrame, path: Path) -> pd.DataFrame:
    """Gather the rows of each robot, sorted by sphere; every robot has the same spheres."""
    spheres = "sphere" in table
    repeated = table[table.duplicated(["robot", "sphere"] if spheres else ["robot"])]
    if len(repeated):
        what = f"sphere {repeated['sphere'].iloc[0]} of robot" if spheres else "robot"
        problem = f"{what} {repeated['robot'].iloc[0]} has a row already; keep one"
        raise InputError(problem, path=path, line=int(repeated["line"].iloc[0]))
    if not spheres:
        return table
    robot, _ = pd.factorize(table["robot"])
    table = table.iloc[np.lexsort((table["sphere"], robot))]
    wanted: list[int] = []
    for name, rows in table.groupby("robot", sort=False):
        found = rows["sphere"].tolist()
        wanted = wanted or found
        if found != wanted:
            problem = f"robot {name} has spheres {found}, the first robot {wanted}; complete it"
            raise InputError(problem, path=path, line=int(rows["line"].min()), key="sphere")
    return table


def _unit_quaternions(table: pd.DataFrame, path: Path) -> Reals:
    """Scale quaternions to length 1; refuse those whose length is far from it."""
    quaternion = table[_QUATERNION].to_numpy()
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
