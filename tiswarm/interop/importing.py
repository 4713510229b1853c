"""Makes a sensing log and a truth of poses alone: who touches whom, and in which order."""

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.compute.math import dock_offsets
from tiswarm.errors import InputError
from tiswarm.interop.poses import Poses, read_poses
from tiswarm.progress import Progress
from tiswarm.records.io import make_folder
from tiswarm.records.messages import counted
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.records.sensing_log import SensingLog, canonical_contacts


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """What a table of poses does not say; lengths in its own unit."""

    dock_radius: float
    tolerance: float
    """Two docks touch whose distance is their diameter to within this."""

    anchor: int | None
    """Name of the robot whose place is known; the first to join, or of the file, if None."""

    ground_z: float | None
    """Height of flat ground; None where there is none."""

    length_unit: str
    """Unit where the columns do not name it."""


def import_poses(
    path: Path,
    out: Path,
    dock_offset_body: NDArray[np.float64],
    assumed: Assumptions,
    progress: Progress,
) -> None:
    """Turn a table of poses into `sensing.jsonl` and `truth.csv`.

    Args:
        path: The table, see `read_poses`.
        out: Folder for the two files; made if need be.
        dock_offset_body: Center to dock, body frame, shape (D, 3); spheres say it themselves.
        assumed: What the table does not say.
        progress: Receives a line on what was found, and on each assumption.

    Raises:
        InputError: the table is malformed or has no such anchor.
        EnvironmentTroubleError: where `out` cannot be made or written to.
    """
    poses = read_poses(path, dock_offset_body, assumed.tolerance)
    unit = poses.length_unit or assumed.length_unit
    docks = poses.position[:, None] + dock_offsets(poses.orientation_wxyz, poses.dock_offset_body)
    contacts, too_close = _contacts(docks, assumed)
    order = _join_order(poses, contacts, assumed.anchor, path, progress)
    log = _log(poses, contacts, docks, order, assumed, unit)
    make_folder(out)
    write_sensing_log(log, out / "sensing.jsonl")
    write_positions(out / "truth.csv", log.robot_id, poses.position[order], length_unit=unit)
    size = f"{counted(log.robot_count, 'robot')}, {counted(len(contacts), 'contact')}"
    progress.info(f"{size} -> {out}")
    if too_close:
        by = f"by more than {assumed.tolerance:g} {unit}"
        progress.info(f"{counted(too_close, 'overlap')} of two docks {by}")


def _contacts(docks: NDArray[np.float64], assumed: Assumptions) -> tuple[NDArray[np.int32], int]:
    """Pairs of docks that touch, rows of (robot, dock, robot, dock); and how many overlap."""
    count = docks.shape[1]
    spacing = 2.0 * assumed.dock_radius
    tree = cKDTree(docks.reshape(-1, 3))
    pairs = tree.query_pairs(spacing + assumed.tolerance, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // count != pairs[:, 1] // count]
    apart = np.linalg.norm(tree.data[pairs[:, 0]] - tree.data[pairs[:, 1]], axis=1)
    touching = pairs[apart >= spacing - assumed.tolerance]
    rows = np.column_stack([touching[:, :1] // count, touching[:, :1] % count,
                            touching[:, 1:] // count, touching[:, 1:] % count])  # fmt: skip
    return rows.astype(np.int32), len(pairs) - len(touching)


def _join_order(
    poses: Poses, contacts: NDArray[np.int32], anchor: int | None, path: Path, progress: Progress
) -> NDArray[np.int64]:
    """Rows of the robots as they joined, or as they might have: outward from the anchor."""
    if poses.join is not None:
        order: NDArray[np.int64] = np.argsort(poses.join, kind="stable")
        if anchor is None or poses.robot_id[order[0]] == anchor:
            return order
        problem = f"robot {poses.robot_id[order[0]]} joined first, not {anchor}; leave --anchor out"
        raise InputError(problem, path=path, key="join")
    first = 0 if anchor is None else _row_of(anchor, poses, path)
    neighbors: list[list[int]] = [[] for _ in poses.robot_id]
    for i, _, j, _ in contacts.tolist():
        neighbors[i].append(j)
        neighbors[j].append(i)
    found, waiting = {first: None}, deque([first])
    while waiting:
        new = sorted(set(neighbors[waiting.popleft()]) - found.keys())
        found |= dict.fromkeys(new)
        waiting.extend(new)
    progress.info(
        f"no column join: robots join outward from robot {poses.robot_id[first]}, by contacts"
    )
    lost = len(neighbors) - len(found)
    if lost:
        progress.info(f"{counted(lost, 'disconnected robot')} placed last in join order")
    return np.array(list(found | dict.fromkeys(range(len(neighbors)))), np.int64)


def _row_of(robot: int, poses: Poses, path: Path) -> int:
    found = np.flatnonzero(poses.robot_id == robot)
    if not len(found):
        problem = f"there is no robot {robot}; name one of the file"
        raise InputError(problem, path=path, key="--anchor")
    return int(found[0])


def _log(
    poses: Poses,
    contacts: NDArray[np.int32],
    docks: NDArray[np.float64],
    order: NDArray[np.int64],
    assumed: Assumptions,
    unit: str,
) -> SensingLog:
    """Say in the swarm's own words what it would have felt at rest."""
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order))
    renamed = contacts.copy()
    renamed[:, [0, 2]] = place[contacts[:, [0, 2]]]
    swapped = renamed[:, 0] > renamed[:, 2]
    renamed[swapped] = renamed[swapped][:, [2, 3, 0, 1]]
    standing: NDArray[np.int32] = np.empty((0, 2), np.int32)
    if assumed.ground_z is not None:
        height = docks[order, :, 2] - assumed.dock_radius - assumed.ground_z
        standing = np.argwhere(np.abs(height) <= assumed.tolerance).astype(np.int32)
    count = len(order)
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
        length_unit=unit,
    )
