"""Imports poses of other simulators as a sensing log and a truth."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.robot import FIREANT_RHO, docks_in_plane
from tiswarm.interop.dock_gaps import FARTHEST_SHOWN, guess_dock_offset, histogram, surface_gaps
from tiswarm.interop.pose_table import read_table
from tiswarm.interop.poses import Poses, poses_by_run, read_contacts
from tiswarm.measurements.contacts import dock_pairs
from tiswarm.measurements.orientations import ASSUMED
from tiswarm.records.io import at_line, make_folder
from tiswarm.records.messages import counted, explain
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import check_header, write_sensing_log
from tiswarm.records.sensing_format import MOST_CONTACTS
from tiswarm.records.sensing_log import SensingLog, SensingNoise, canonical_contacts

TOLERANCE = 0.02
"""Largest gap and overlap of a contact unless stated otherwise [dock radii]."""

GAINS = (
    "on towers of 100 robots, joint's mean RMSE is 1.03 R from contacts and ground, 0.70 R with "
    "heights, 0.21 R with contacts of stances too (docs/accuracy.md)"
)
"""What heights and stances gain."""

_KNOWN_SD = 1e-3
"""Standard deviation of each coordinate of a further anchor [dock radii]."""

_ENOUGH_CONTACTS = 0.5
"""Fewer contacts per robot point to a wrong robot geometry."""


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Facts that a table of poses does not state; lengths in its own unit."""

    dock_radius: float = 1.0
    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None for the three docks in a plane at which
    most docks touch. A table of spheres needs none."""

    gap: float | None = None
    """Largest gap of two docks in contact; 2 % of the dock radius if None."""

    overlap: float | None = None
    """Largest overlap of two docks in contact; 2 % of the dock radius if None."""

    contacts: Path | None = None
    """Table `robot,dock,other,other_dock` of all contacts; found from the gaps if None."""

    anchors: tuple[int, ...] = ()
    """Names of robots at known positions, the anchor first; the first robot to join, or of the
    file, if there are none."""

    ground_z: float | None = None
    """Height of flat ground; None where there is none."""

    heights: bool = False
    """Whether the robots know the heights of their centers."""

    drop_disconnected: bool = False
    """Whether to drop the robots that contacts do not connect to an anchor."""

    drop_incomplete: bool = False
    """Whether to drop rows that lack a number, instead of refusing them."""

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


class Imported(NamedTuple):
    """What became of a table of poses."""

    log: SensingLog  # what the robots would have sensed at rest
    position: Reals  # true centers in join order, shape (N, 3)
    notes: list[str]  # contacts, gaps and what was assumed, in lines
    warning: str  # why the contacts are probably wrong; empty if they are plausible


def import_poses(path: Path, assumed: Assumptions) -> dict[str, Imported]:
    """Turn a table of poses, as `read_table` describes it, into sensing logs and truths.

    Returns:
        What became of each structure, by its name in the column `run`, or "" without that column.

    Raises:
        InputError: a table is malformed or does not contain the anchors.
    """
    table = read_table(
        path, dock_radius=assumed.dock_radius, drop_incomplete=assumed.drop_incomplete
    )
    runs = poses_by_run(table, path, shape_error=assumed.largest_gap)
    if assumed.contacts is not None and len(runs) > 1:
        problem = "the poses have several runs; import each with its own contacts"
        raise InputError(problem, path=path, argument="contacts")
    found = {run: _import_run(path, poses, assumed) for run, poses in runs.items()}
    for imported in found.values():
        imported.notes[:0] = table.notes
    return found


def write_import(imported: Imported, out: Path) -> None:
    """Write `sensing.jsonl` and `truth.csv` to a folder, which is made if need be.

    Raises:
        EnvironmentTroubleError: `out` cannot be made or written to.
    """
    log = imported.log
    make_folder(out)
    write_sensing_log(log, out / "sensing.jsonl")
    truth = out / "truth.csv"
    write_positions(truth, log.robot_id, imported.position, length_unit=log.length_unit)


def _import_run(path: Path, poses: Poses, assumed: Assumptions) -> Imported:
    poses, notes = _with_docks(poses, assumed, path)
    contacts, gaps, warning = _contacts(poses, assumed)
    anchors = _anchors(poses, assumed.anchors, path)
    order, joined = _join_order(
        poses, contacts, anchors, drop_disconnected=assumed.drop_disconnected
    )
    log = _log(poses, contacts, anchors, order, assumed)
    with at_line(path, 1):
        check_header(log)
    _refuse_crowds(log, path)
    size = f"{counted(log.robot_count, 'robot')}, {counted(len(log.contacts), 'contact')}"
    notes += [*gaps, *joined, *_describe(log), size]
    return Imported(log, poses.position[order], notes, warning)


def _with_docks(poses: Poses, assumed: Assumptions, path: Path) -> tuple[Poses, list[str]]:
    """Add the docks in the body frame, and say where they are a guess."""
    radius, body = assumed.dock_radius, assumed.dock_offset_body
    poses = poses._replace(length_unit=poses.length_unit or assumed.length_unit)
    if len(poses.dock_offset_body):
        if body is None:
            return poses, []
        problem = "the spheres are the docks; leave out offsets of docks"
        raise InputError(problem, path=path, key="sphere")
    if body is not None:
        return poses._replace(dock_offset_body=body), []
    width = assumed.largest_gap + assumed.largest_overlap
    offset = guess_dock_offset(poses.position, poses.orientation_wxyz, radius, width)
    if offset is not None:
        note = f"dock offset {offset:g} {poses.length_unit}: most docks touch there"
    else:
        offset = FIREANT_RHO * radius
        note = f"no dock offset stands out: {offset:g} {poses.length_unit}, FireAntV3's, is assumed"
    return poses._replace(dock_offset_body=docks_in_plane(offset)), [note]


def _contacts(poses: Poses, assumed: Assumptions) -> tuple[Ints, list[str], str]:
    """Find contacts, describe gaps, and warn where they are implausible.

    Contacts are rows of (robot, dock, later robot, its dock), shape (n, 4).
    """
    radius, unit = assumed.dock_radius, poses.length_unit
    gap_limit, overlap_limit = assumed.largest_gap, assumed.largest_overlap
    if assumed.contacts is None:
        within = max(gap_limit, FARTHEST_SHOWN * radius)
        pair = dock_pairs(poses.docks, 2.0 * radius + within)
    else:
        pair = read_contacts(assumed.contacts, poses)
    gap = surface_gaps(poses.docks, pair, radius)
    wide, deep = gap > gap_limit, gap < -overlap_limit
    limits = {"largest_gap": gap_limit, "largest_overlap": overlap_limit}
    notes = [*histogram(gap, radius, unit=unit, **limits)]
    if deep.any():
        by = f"by more than {overlap_limit:g} {unit}"
        notes.append(f"{counted(deep.sum(), 'overlap')} of two docks {by}")
    if assumed.contacts is None:
        pair = pair[~wide & ~deep]
    elif wide.any():
        listed = counted(wide.sum(), "listed contact")
        notes.append(f"{listed} with a gap of more than {gap_limit:g} {unit}")
    return pair, notes, _implausible(len(poses.robot_id), len(pair), int(deep.sum()))


def _refuse_crowds(log: SensingLog, path: Path) -> None:
    """Refuse more contacts of a dock than a log may have."""
    docks = len(log.dock_offset_body)
    ends = log.contacts.reshape(-1, 2) @ [docks, 1]
    number = np.bincount(ends, minlength=1)
    if (most := int(number.max())) > MOST_CONTACTS:
        robot, dock = divmod(int(number.argmax()), docks)
        problem = f"dock {dock} of robot {log.robot_id[robot]} has {most} contacts, more than "
        remedy = f"{MOST_CONTACTS}; correct radius and offset of docks, or give smaller limits"
        raise InputError(problem + remedy, path=path)


def _implausible(robots: int, contacts: int, overlaps: int) -> str:
    """Warn of too few contacts, or more overlaps than contacts."""
    if robots == 1 or (contacts >= _ENOUGH_CONTACTS * robots and contacts >= overlaps):
        return ""
    found = f"{counted(contacts, 'contact')} and {counted(overlaps, 'overlap')}"
    return (
        f"{counted(robots, 'robot')} have {found} of docks; correct --dock-radius and "
        "--dock-offset, or give larger --gap and --overlap"
    )


def _anchors(poses: Poses, names: tuple[int, ...], path: Path) -> list[int]:
    """Find the rows of the robots at known positions; the first is the anchor, and joins first."""
    row = {name: row for row, name in enumerate(poses.robot_id.tolist())}
    for name in names:
        if name not in row:
            problem = f"there is no robot {name}; name one of the file"
            raise InputError(problem, path=path, argument="anchor")
    first = 0 if poses.join is None else int(poses.join.argmin())
    anchors = [*dict.fromkeys(row[name] for name in names)] or [first]
    if poses.join is not None and anchors[0] != first:
        problem = f"robot {poses.robot_id[first]} joined first, not {names[0]}; name it first"
        raise InputError(problem, path=path, key="join")
    return anchors


def _join_order(
    poses: Poses, contacts: Ints, anchors: list[int], *, drop_disconnected: bool
) -> tuple[Ints, list[str]]:
    """Sort robots by their join index; without it, by hops from the anchors, and say so."""
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
    if poses.join is None:
        order = np.array([*tied | dict.fromkeys(range(len(neighbors)))])
        name = poses.robot_id[anchors[0]]
        notes.append(f"no column join: robots join outward from robot {name}, by contacts")
    else:
        order = np.argsort(poses.join, kind="stable")
    if lost := len(neighbors) - len(tied):
        fate = "dropped" if drop_disconnected else "kept: drop them with --drop-disconnected"
        notes.append(f"{counted(lost, 'robot')} disconnected from the anchor {fate}")
    return order[np.isin(order, [*tied])] if drop_disconnected else order, notes


def _log(
    poses: Poses, contacts: Ints, anchors: list[int], order: Ints, assumed: Assumptions
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
    standing: NDArray[np.int32] = np.empty((0, 2), np.int32)
    if assumed.ground_z is not None:
        height = poses.docks[order, :, 2] - assumed.dock_radius - assumed.ground_z
        stands = (height <= assumed.largest_gap) & (height >= -assumed.largest_overlap)
        standing = np.argwhere(stands).astype(np.int32)
    known = sorted(anchors[1:], key=lambda row: place[row])
    fixes = [
        (place[row], *axis, along, _KNOWN_SD * assumed.dock_radius, -1)
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


def _describe(log: SensingLog) -> Iterator[str]:
    """Say in lines what a log lacks, and what it would gain."""
    has = {
        "ground contacts (--ground-z)": len(log.ground_docks) > 0,
        "heights (--heights)": not np.isnan(log.flip_height).all(),
        "stances": log.stances is not None,
        "noise (--tilt-deg, --yaw-deg)": log.noise is not None,
    }
    yield f"the log lacks {', '.join(what for what, is_there in has.items() if not is_there)}"
    yield GAINS
