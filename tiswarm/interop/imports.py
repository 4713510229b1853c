"""Imports poses of other simulators as a sensing log and a truth."""

import re
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.errors import InputError
from tiswarm.progress import Progress
from tiswarm.records.io import Table, at_line, make_folder
from tiswarm.records.messages import counted
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import FAR_FROM_UNIT, check_header, write_sensing_log
from tiswarm.records.sensing_log import FARTHEST, SensingLog, canonical_contacts

_QUATERNION = ["qw", "qx", "qy", "qz"]
_WHOLE = ["robot", "sphere", "join"]


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Facts that a table of poses does not state; lengths in its own unit."""

    dock_radius: float
    tolerance: float  # largest gap or overlap of two docks in contact
    anchor: int | None  # id of the anchor robot; the first to join, or of the file, if None
    ground_z: float | None  # height of flat ground; None where there is none
    length_unit: str  # unit of lengths where the columns do not name it


class _Poses(NamedTuple):
    """N robots with D docks each, in the order of their file, in its unit of length."""

    robot_id: Ints  # (N,)
    position: Reals  # centers, (N, 3)
    orientation_wxyz: Reals  # body to world, (N, 4)
    dock_offset_body: Reals  # (D, 3)
    join: Ints | None  # rank of each robot in join order, (N,); None where the file has none
    length_unit: str  # as the columns name it; empty where they do not


def import_poses(
    path: Path, out: Path, dock_offset_body: Reals, assumed: Assumptions, progress: Progress
) -> None:
    """Turn a table of poses into `sensing.jsonl` and `truth.csv`.

    The table has the columns `robot,x,y,z,qw,qx,qy,qz` or `robot,sphere,x,y,z`, in any order,
    among others. Lengths may name their unit, as in `x_mm`. A column `join` states the join order
    of the robots. A robot of spheres has its center at their mean; the first robot defines the
    body frame.

    Args:
        path: The table.
        out: Folder for the two files; made if need be.
        dock_offset_body: Vectors from center to dock, body frame, shape (D, 3), but for spheres.
        assumed: Facts that the table does not state.
        progress: Receives a line on the result, and on each assumption.

    Raises:
        InputError: the table is malformed or does not contain the anchor.
        EnvironmentTroubleError: `out` cannot be made or written to.
    """
    poses = _read_poses(path, dock_offset_body, assumed)
    unit = poses.length_unit or assumed.length_unit
    assumed = replace(assumed, length_unit=unit)
    docks = poses.position[:, None] + dock_offsets(poses.orientation_wxyz, poses.dock_offset_body)
    contacts, too_close = _contacts(docks, assumed)
    order = _join_order(poses, contacts, assumed.anchor, path, progress)
    log = _log(poses, contacts, docks, order, assumed)
    with at_line(path, 1):
        check_header(log)
    make_folder(out)
    write_sensing_log(log, out / "sensing.jsonl")
    write_positions(out / "truth.csv", log.robot_id, poses.position[order], length_unit=unit)
    size = f"{counted(log.robot_count, 'robot')}, {counted(len(contacts), 'contact')}"
    progress.info(f"{size} -> {out}")
    if too_close:
        by = f"by more than {assumed.tolerance:g} {unit}"
        progress.info(f"{counted(too_close, 'overlap')} of two docks {by}")


def _read_poses(path: Path, dock_offset_body: Reals, assumed: Assumptions) -> _Poses:
    text = Table(path)
    columns, unit = _columns(text.columns, path)
    numbers = {
        name: text.integers(column) if name in _WHOLE else text.numbers(column)
        for name, column in columns.items()
    }
    for axis in "xyz":
        far = np.flatnonzero(np.abs(numbers[axis]) > FARTHEST * assumed.dock_radius)
        if len(far):
            problem = f"{numbers[axis][far[0]]:g} is too far out; move the origin to the robots"
            raise InputError(problem, path=path, line=text.line(far[0]), key=columns[axis])
    table = _by_robot(pd.DataFrame(numbers | {"line": list(text.rows)}), path)
    first = table.drop_duplicates("robot")
    place = table[[*"xyz"]].to_numpy(float).reshape(len(first), -1, 3)
    position = place.mean(axis=1)
    if "sphere" in table:
        dock_offset_body = place[0] - position[0]
        orientation = _align(place - position[:, None], first, path, assumed.tolerance)
    else:
        orientation = _unit_quaternions(first, path)
    return _Poses(
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
        problem = ""
        if found != wanted:
            problem = f"robot {name} has spheres {found}, the first robot {wanted}; complete it"
        elif len(found) < 3:  # noqa: PLR2004 - three determine an orientation
            problem = f"{len(found)} spheres leave the orientation open; give three or more"
        if problem:
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


def _align(offset: Reals, first: pd.DataFrame, path: Path, tolerance: float) -> Reals:
    """Rotate the first robot's shape onto each robot, whose spheres are at `offset`, (N, D, 3)."""
    rotations = []
    for own, robot, line in zip(offset, first["robot"], first["line"], strict=True):
        rotation, _ = Rotation.align_vectors(own, offset[0])
        off = np.linalg.norm(rotation.apply(offset[0]) - own, axis=1).max()
        if not off <= tolerance:
            problem = (
                f"the spheres of robot {robot} are up to {off:.3g} off the first robot's shape; "
                "give rigid robots of one shape, or a larger --tolerance"
            )
            raise InputError(problem, path=path, line=line)
        rotations.append(rotation.as_quat(scalar_first=True))
    return np.array(rotations)


def _contacts(docks: Reals, assumed: Assumptions) -> tuple[NDArray[np.int32], int]:
    """Find docks in contact, rows of (robot, dock, robot, dock), and count those that overlap."""
    count = docks.shape[1]
    spacing = 2.0 * assumed.dock_radius
    tree = cKDTree(docks.reshape(-1, 3))
    pairs = tree.query_pairs(spacing + assumed.tolerance, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // count != pairs[:, 1] // count]
    apart = np.linalg.norm(tree.data[pairs[:, 0]] - tree.data[pairs[:, 1]], axis=1)
    touching = pairs[apart >= spacing - assumed.tolerance]
    rows = np.stack(np.divmod(touching, count), axis=-1).reshape(-1, 4)
    return rows.astype(np.int32), len(pairs) - len(touching)


def _join_order(
    poses: _Poses, contacts: NDArray[np.int32], anchor: int | None, path: Path, progress: Progress
) -> Ints:
    """Sort robots by their join index; without it, by hops from the anchor."""
    name = poses.robot_id
    if poses.join is not None:
        order: Ints = np.argsort(poses.join, kind="stable")
        if anchor is None or name[order[0]] == anchor:
            return order
        problem = f"robot {name[order[0]]} joined first, not {anchor}; leave --anchor out"
        raise InputError(problem, path=path, key="join")
    if anchor is not None and anchor not in name:
        problem = f"there is no robot {anchor}; name one of the file"
        raise InputError(problem, path=path, key="--anchor")
    first = 0 if anchor is None else int(np.flatnonzero(name == anchor)[0])
    neighbors: list[list[int]] = [[] for _ in name]
    for i, _, j, _ in contacts.tolist():
        neighbors[i].append(j)
        neighbors[j].append(i)
    found, waiting = {first: None}, deque([first])
    while waiting:
        new = sorted(set(neighbors[waiting.popleft()]) - found.keys())
        found |= dict.fromkeys(new)
        waiting.extend(new)
    progress.info(f"no column join: robots join outward from robot {name[first]}, by contacts")
    if lost := len(name) - len(found):
        progress.info(f"{counted(lost, 'disconnected robot')} placed last in join order")
    return np.array(list(found | dict.fromkeys(range(len(name)))), np.int64)


def _log(
    poses: _Poses, contacts: NDArray[np.int32], docks: Reals, order: Ints, assumed: Assumptions
) -> SensingLog:
    """Derive what the robots would have sensed at rest."""
    count = len(order)
    renamed = contacts.copy()
    renamed[:, [0, 2]] = np.argsort(order)[contacts[:, [0, 2]]]
    swapped = renamed[:, 0] > renamed[:, 2]
    renamed[swapped] = renamed[swapped][:, [2, 3, 0, 1]]
    standing: NDArray[np.int32] = np.empty((0, 2), np.int32)
    if assumed.ground_z is not None:
        height = docks[order, :, 2] - assumed.dock_radius - assumed.ground_z
        standing = np.argwhere(np.abs(height) <= assumed.tolerance).astype(np.int32)
    return SensingLog(
        robot_id=poses.robot_id[order],
        dock_radius=assumed.dock_radius,
        dock_offset_body=poses.dock_offset_body,
        anchor_position=poses.position[order[0]],
        orientation_wxyz=poses.orientation_wxyz[order],
        contacts=canonical_contacts(renamed),
        ground_z=assumed.ground_z,
        ground_docks=standing,
        flip_height=np.full(count, np.nan),
        spawn_position=np.full((count, 3), np.nan),
        length_unit=assumed.length_unit,
    )
