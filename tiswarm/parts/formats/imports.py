"""Imports poses of other simulators as a sensing log and a truth."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import ValidationError

from tiswarm.app.results import choose
from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.parts import PARTS, find, guarded, registered
from tiswarm.measurements.odometry import ASSUMED
from tiswarm.parts.formats.docks import (
    few_contacts,
    find_contacts,
    in_likely_order,
    off_the_ground,
    refuse_crowds,
    with_docks,
    with_limits,
)
from tiswarm.parts.formats.mocap import read_mocap
from tiswarm.parts.formats.motion import Rests, find_rests, stances_of, without_glitches
from tiswarm.parts.formats.poses import (
    UPWARD,
    Assumptions,
    Poses,
    PoseTable,
    poses_by_run,
    read_dock_offsets,
    read_table,
    some,
)
from tiswarm.parts.formats.trajectories import read_gsd, read_tum
from tiswarm.records import outputs
from tiswarm.records.io import at_line, make_folder
from tiswarm.records.messages import counted, explain
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import check_header, write_sensing_log
from tiswarm.records.sensing_log import (
    KNOWN_SD,
    SensingLog,
    SensingNoise,
    Stances,
    canonical_contacts,
)

GAINS = (
    "on towers of 100 robots, joint's mean RMSE is 1.0 R from contacts and ground, 0.7 R with "
    "heights, 0.2 R with contacts of stances too (docs/accuracy.md)"
)
"""What heights and stances gain."""


class Imported(NamedTuple):
    """What became of a table of poses."""

    log: SensingLog  # what the robots would have sensed at rest
    position: Reals  # true centers in join order, shape (N, 3)
    notes: list[str]  # contacts, gaps and what was assumed, in lines
    warnings: list[str]  # why contacts or final poses are probably wrong, in lines


def convert(
    path: Path,
    assumed: Mapping[str, Any],
    *,
    docks: Path | None = None,
    out: Path | None = None,
    overwrite: bool = False,
) -> dict[str, Imported]:
    """Import poses, and write what became of them if `out` is given.

    Args:
        path: File or folder of poses.
        assumed: Fields of `Assumptions`.
        docks: Table of the docks in the body frame, in place of `dock_offset_body`.
        out: Folder to write to; nothing is written if None.
        overwrite: Whether to replace files that no tiswarm command wrote.

    Raises:
        InputError: a table is malformed, there is no such field, or an output would replace
            another file.
    """
    for name in assumed:
        choose(name, [field.name for field in fields(Assumptions)], "assumed")
    body = {} if docks is None else {"dock_offset_body": read_dock_offsets(docks)}
    stated = Assumptions(**{**assumed, **body})
    found = import_poses(path, stated)
    if out is not None:
        inputs = [*(path.iterdir() if path.is_dir() else [path]), stated.contacts, docks]
        write_imports(found, out, inputs, overwrite=overwrite)
    return found


def import_poses(path: Path, assumed: Assumptions) -> dict[str, Imported]:
    """Turn a table of poses, as `read_table` describes it, into sensing logs and truths.

    Returns:
        What became of each structure, by its name in the column `run`, or "" without that column.

    Raises:
        InputError: a table is malformed or does not contain the anchors.
    """
    table = _read(path, assumed)
    runs = poses_by_run(table, path, shape_error=assumed.largest_gap)
    if assumed.contacts is not None and len(runs) > 1:
        problem = "the poses have several runs; import each with its own contacts"
        raise InputError(problem, path=path, argument="contacts")
    found = {run: _import_run(path, poses, assumed) for run, poses in runs.items()}
    for imported in found.values():
        imported.notes[:0] = table.notes
    return found


def _read(path: Path, assumed: Assumptions) -> PoseTable:
    """Read poses in the first format that their file or folder has."""
    for name, own in registered("import_format").items():
        if path.name.endswith(own.value.suffix):
            columns = guarded(own.plugin, name, partial(own.value.read, path))
            return _read_table(path, assumed, pd.DataFrame(columns).to_csv(index=False))
    readers = (find("import_format", name) for name in PARTS["import_format"])
    found: Iterator[PoseTable | None] = (read(path, assumed) for read in readers)
    return next(table for table in found if table)


def read_tum_files(path: Path, assumed: Assumptions) -> PoseTable | None:
    """Read a file or folder of trajectories."""
    if not path.is_dir() and path.suffix != ".tum":
        return None
    return read_tum(path, dock_radius=assumed.dock_radius, drop_incomplete=assumed.drop_incomplete)


def read_gsd_file(path: Path, assumed: Assumptions) -> PoseTable | None:
    """Read the frames of a GSD file."""
    return read_gsd(path, dock_radius=assumed.dock_radius) if path.suffix == ".gsd" else None


def read_mocap_export(path: Path, assumed: Assumptions) -> PoseTable | None:
    """Read an export of motion capture."""
    return read_mocap(path, dock_radius=assumed.dock_radius)


def read_table_file(path: Path, assumed: Assumptions) -> PoseTable:
    """Read a table, as any other file is."""
    return _read_table(path, assumed)


def _read_table(path: Path, assumed: Assumptions, text: str | None = None) -> PoseTable:
    return read_table(
        path,
        dock_radius=assumed.dock_radius,
        drop_incomplete=assumed.drop_incomplete,
        length_unit=assumed.length_unit,
        text=text,
    )


def write_imports(
    found: Mapping[str, Imported],
    out: Path,
    inputs: Sequence[object] = (),
    *,
    overwrite: bool = False,
) -> None:
    """Write `sensing.jsonl` and `truth.csv` of each structure to a folder of its name in `out`.

    Args:
        found: What became of each structure, by its name.
        out: Folder, which is made if need be.
        inputs: Files and folders that were read, which no output replaces.
        overwrite: Whether to replace files that no tiswarm command wrote.

    Raises:
        InputError: an output would replace another file; then nothing is written.
        EnvironmentTroubleError: `out` cannot be made or written to.
    """
    files = [out / run / name for run in found for name in ("sensing.jsonl", "truth.csv")]
    outputs.check({"out": files}, inputs, overwrite=overwrite)
    opened = partial(outputs.opened, overwrite=overwrite)
    for run, (log, position, *_) in found.items():
        make_folder(out / run)
        write_sensing_log(log, out / run / "sensing.jsonl", opened=opened)
        write_positions(
            out / run / "truth.csv", log.robot_id, position, length_unit=log.length_unit,
            opened=opened,
        )  # fmt: skip


def _import_run(path: Path, poses: Poses, assumed: Assumptions) -> Imported:
    if assumed.up not in {"z", *UPWARD}:
        problem = f"{assumed.up!r} is no axis; use z, {', '.join(UPWARD)}"
        raise InputError(problem, argument="up")
    poses = poses if assumed.up == "z" else poses.upright(assumed.up)
    poses = poses.conjugate() if assumed.conjugate else poses
    poses, order_of_numbers = in_likely_order(poses, assumed)
    poses, guessed = with_docks(poses, assumed, path)
    poses, glitches = without_glitches(poses, with_limits(poses, assumed)[0])
    assumed, widened = with_limits(poses, assumed)
    contacts, gaps, overlaps = find_contacts(poses, assumed)
    rests = find_rests(poses, assumed)
    anchors = _anchors(poses, rests, assumed.anchors, path)
    order, joined = _join_order(
        poses, contacts, anchors, rests, drop_disconnected=assumed.drop_disconnected
    )
    stances, early = (None, 0) if rests is None else stances_of(rests, poses, order, assumed)
    log = _log(poses, contacts, anchors, order, stances, assumed)
    with at_line(path, 1):
        check_header(log)
    refuse_crowds(log, path)
    size = f"{counted(log.robot_count, 'robot')}, {counted(len(log.contacts), 'contact')}"
    if log.stances is not None:
        size = log.size
    notes = [*order_of_numbers, *guessed, *glitches, *widened, *gaps, *joined]
    notes += [*_describe_rests(poses, rests), *_describe(log), size]
    few = few_contacts(poses, assumed, len(contacts), overlaps)
    # Docks at wrong places stand nowhere, so the ground says nothing more.
    warnings = [*(few or off_the_ground(poses, assumed)), *_unrested(poses, rests)]
    if early:
        problem = f"{counted(early, 'contact')} of stances left out: by the time, the other robot "
        problem += "had not arrived; if robots have clocks of their own, set them to one"
        warnings.append(f"{problem}, or give a column join")
    return Imported(log, poses.position[order], notes, warnings)


def _anchors(poses: Poses, rests: Rests | None, names: tuple[int, ...], path: Path) -> list[int]:
    """Find the rows of the robots at known positions; the first is the anchor, and joins first."""
    row = {name: row for row, name in enumerate(poses.robot_id.tolist())}
    for name in names:
        if name not in row:
            problem = f"there is no robot {name}; name one of the file"
            raise InputError(problem, path=path, argument="anchor")
    key, first, is_first = "anchor", 0, np.ones(len(row), np.bool_)
    if poses.join is not None:
        key, first = "join", int(poses.join.argmin())
        is_first = np.arange(len(row)) == first
    elif rests is not None:
        key, first = "time", int(np.lexsort(rests.arrival)[0])
        is_first = (rests.arrival == rests.arrival[:, [first]]).all(axis=0)
    anchors = [*dict.fromkeys(row[name] for name in names)] or [first]
    if not is_first[anchors[0]]:
        problem = f"robot {poses.robot_id[first]} joined first, not {names[0]}; name it first"
        raise InputError(problem, path=path, key=key)
    return anchors


def _join_order(
    poses: Poses,
    contacts: Ints,
    anchors: list[int],
    rests: Rests | None,
    *,
    drop_disconnected: bool,
) -> tuple[Ints, list[str]]:
    """Sort robots by join index, or as they reach their final poses, or by hops; say which."""
    neighbors: list[list[int]] = [[] for _ in poses.robot_id]
    for i, _, j, _ in contacts.tolist():
        neighbors[i].append(j)
        neighbors[j].append(i)
    tied, waiting = dict.fromkeys(anchors), deque(anchors)
    while waiting:
        new = sorted({other for other in neighbors[waiting.popleft()] if other not in tied})
        tied |= dict.fromkeys(new)
        waiting.extend(new)
    notes = []
    outward = np.array([*tied | dict.fromkeys(range(len(neighbors)))])
    if poses.join is not None:
        order = np.argsort(poses.join, kind="stable")
    elif rests is not None:
        order = outward[np.lexsort(rests.arrival[:, outward])]
        notes.append("no column join: robots join as they reach their final poses")
    else:
        order = outward
        name = poses.robot_id[anchors[0]]
        notes.append(f"no column join: robots join outward from robot {name}, by contacts")
    if lost := len(neighbors) - len(tied):
        fate = "dropped" if drop_disconnected else "kept: drop them with --drop-disconnected"
        notes.append(f"{counted(lost, 'robot')} disconnected from the anchor {fate}")
    return order[np.isin(order, [*tied])] if drop_disconnected else order, notes


def _log(
    poses: Poses,
    contacts: Ints,
    anchors: list[int],
    order: Ints,
    stances: Stances | None,
    assumed: Assumptions,
) -> SensingLog:
    """Derive what the robots in `order` would have sensed at rest."""
    count = len(order)
    place = np.full(len(poses.robot_id), -1)
    place[order] = np.arange(count)
    renamed = contacts.astype(np.int32)
    renamed[:, [0, 2]] = place[contacts[:, [0, 2]]]
    renamed = renamed[(renamed[:, [0, 2]] >= 0).all(axis=1)]
    swapped = renamed[:, 0] > renamed[:, 2]
    renamed[swapped] = renamed[swapped][:, [2, 3, 0, 1]]
    least, greatest = assumed.level
    height = poses.docks[order, :, 2]
    standing = np.argwhere((height >= least) & (height <= greatest)).astype(np.int32)
    known = sorted(anchors[1:], key=lambda row: place[row])
    fixes = [
        (place[row], *axis, along, KNOWN_SD * assumed.dock_radius, -1)
        for row in known
        for axis, along in zip(np.eye(3), poses.position[row], strict=True)
    ]
    return SensingLog(
        robot_id=poses.robot_id[order],
        dock_radius=assumed.dock_radius,
        dock_offset_body=poses.dock_offset_body,
        anchor_position=poses.position[order[0]],
        orientation_wxyz=poses.orientation_wxyz[order],
        contacts=canonical_contacts(renamed),
        ground_z=assumed.ground_z,
        ground_docks=standing,
        fixes=np.array(fixes).reshape(-1, 7),
        flip_height=poses.position[order, 2] if assumed.heights else np.full(count, np.nan),
        spawn_position=np.full((count, 3), np.nan),
        stances=stances,
        noise=_noise(assumed),
        length_unit=poses.length_unit,
    )


def _noise(assumed: Assumptions) -> SensingNoise | None:
    """State the noise of orientations if it is given."""
    tilt, yaw = assumed.tilt_deg, assumed.yaw_deg
    if tilt is None and yaw is None:
        return None
    try:
        return SensingNoise(
            tilt_deg=ASSUMED.tilt_deg if tilt is None else tilt,
            yaw_deg=ASSUMED.yaw_deg if yaw is None else yaw,
        )
    except ValidationError as found:
        error = found.errors(include_url=False)[0]
        raise InputError(explain(error), key=str(error["loc"][0])) from found


def _describe_rests(poses: Poses, rests: Rests | None) -> Iterator[str]:
    """Say in lines what became of poses over time."""
    if rests is None or poses.samples is None:
        return
    number = len(rests.position) - len(poses.robot_id)
    many = counted(len(poses.samples.time), "pose")
    yield f"{counted(number, 'stance')} before the final poses, from {many} over time"
    if rests.unseen:
        yield f"{counted(rests.unseen, 'stance')} without a pose: where flips beside a gap lead"
    if len(rests.cut):
        why = "no flip about a dock leads from them to later ones"
        yield f"earlier poses of {_named(poses, rests.cut)} left out: {why}"


def _unrested(poses: Poses, rests: Rests | None) -> Iterator[str]:
    """Warn of robots that move to the end of their tracks."""
    if rests is not None and len(rests.in_motion):
        robots = _named(poses, rests.in_motion)
        yield f"the tracks of {robots} end in motion, not at final poses; record until they rest"


def _named(poses: Poses, robots: Ints) -> str:
    """Count robots and name the first ones."""
    return f"{counted(len(robots), 'robot')} ({some(poses.robot_id[robots].tolist())})"


def _describe(log: SensingLog) -> Iterator[str]:
    """Say in lines what a log lacks, and what it would gain."""
    has = {
        "ground contacts (--ground-z)": len(log.ground_docks) > 0,
        "heights (--heights)": not np.isnan(log.flip_height).all(),
        "stances": log.stances is not None,
        "noise (--tilt-deg, --yaw-deg)": log.noise is not None,
    }
    if lacking := [what for what, is_there in has.items() if not is_there]:
        yield f"the log lacks {', '.join(lacking)}"
    if np.isnan(log.flip_height).all() or log.stances is None:
        yield GAINS
