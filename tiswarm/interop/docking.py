"""Where docks are, and which of them touch."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tiswarm.base.aliases import Ints
from tiswarm.base.errors import InputError
from tiswarm.base.robot import FIREANT_RHO, docks_in_plane
from tiswarm.interop.assumptions import TOLERANCE, Assumptions
from tiswarm.interop.dock_gaps import (
    FARTHEST_SHOWN,
    contact_limit,
    guess_dock_offset,
    histogram,
    surface_gaps,
)
from tiswarm.interop.poses import Poses, read_contacts
from tiswarm.measurements.contacts import dock_pairs
from tiswarm.records.messages import counted
from tiswarm.records.sensing_format import MOST_CONTACTS
from tiswarm.records.sensing_log import SensingLog

ENOUGH = 0.5
"""Fewer contacts per robot point to a wrong robot geometry."""

FAR_MORE = 2.0
"""Contacts by another meaning of the poses, per contact as stated, that point to that meaning."""


def with_docks(
    poses: Poses, assumed: Assumptions, path: Path | None = None
) -> tuple[Poses, list[str]]:
    """Add the docks in the body frame, and say where they are a guess.

    Raises:
        InputError: the file has docks, and offsets of docks are given.
    """
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


def with_limits(poses: Poses, assumed: Assumptions) -> tuple[Assumptions, list[str]]:
    """Set limits of gap and overlap that are not given, and say so where errors widen them."""
    if assumed.gap is not None and assumed.overlap is not None:
        return assumed, []
    radius, least = assumed.dock_radius, TOLERANCE * assumed.dock_radius
    pair = dock_pairs(poses.docks, (2.0 + FARTHEST_SHOWN) * radius)
    limit = contact_limit(surface_gaps(poses.docks, pair, radius), radius, least)
    if limit is None or limit == least:
        return assumed, []
    gap, overlap = (limit if given is None else given for given in (assumed.gap, assumed.overlap))
    found = replace(assumed, gap=gap, overlap=overlap)
    text = f"contacts have gaps up to {gap:g} and overlaps up to {overlap:g} {poses.length_unit}"
    return found, [f"{text}: about as far, docks overlap by errors of the poses"]


def in_likely_order(poses: Poses, assumed: Assumptions) -> tuple[Poses, list[str]]:
    """Read quaternions in the other order where far more docks touch so, and say so."""
    robots = len(poses.robot_id)
    if poses.other_order == 0 or (touching := count_touching(poses, assumed)) >= ENOUGH * robots:
        return poses, []
    other = poses.reordered()
    more = count_touching(other, assumed)
    if more < max(ENOUGH * robots, FAR_MORE * touching):
        return poses, []
    names = "x, y, z, w" if poses.other_order == 1 else "w, x, y, z"
    found = f"{counted(more, 'contact')} instead of {touching}"
    note = f"quaternions read as {names}, though columns have the other order: {found}"
    return other, [f"{note}; rename the columns"]


def count_touching(poses: Poses, assumed: Assumptions) -> int:
    """Count docks in contact, at offsets that are given or guessed.

    The count is 0 if no offset stands out, or if more docks overlap: they are rigid.
    """
    radius, body = assumed.dock_radius, assumed.dock_offset_body
    limits = assumed.largest_gap, assumed.largest_overlap
    if body is None:
        turn = poses.orientation_wxyz
        offset = guess_dock_offset(poses.position, turn, radius, sum(limits))
        body = None if offset is None else docks_in_plane(offset)
    if body is None:
        return 0
    docks = poses._replace(dock_offset_body=body).docks
    gap = surface_gaps(docks, dock_pairs(docks, 2.0 * radius + limits[0]), radius)
    touching = int((gap >= -limits[1]).sum())
    return touching if 2 * touching >= len(gap) else 0


def find_contacts(poses: Poses, assumed: Assumptions) -> tuple[Ints, list[str], int]:
    """Find contacts, describe gaps, and count the docks that overlap by more.

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
    return pair, notes, int(deep.sum())


def refuse_crowds(log: SensingLog, path: Path) -> None:
    """Refuse more contacts of a dock than a log may have."""
    docks = len(log.dock_offset_body)
    ends = log.contacts.reshape(-1, 2) @ [docks, 1]
    number = np.bincount(ends, minlength=1)
    if (most := int(number.max())) > MOST_CONTACTS:
        robot, dock = divmod(int(number.argmax()), docks)
        problem = f"dock {dock} of robot {log.robot_id[robot]} has {most} contacts, more than "
        remedy = f"{MOST_CONTACTS}; correct radius and offset of docks, or give smaller limits"
        raise InputError(problem + remedy, path=path)
