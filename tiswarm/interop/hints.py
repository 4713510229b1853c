"""What is likely wrong with poses whose docks do not touch, or do not stand on the ground.

Each cause is tried, and what docks would then do shows it. No cause is mended unless an option says
so: two errors may look alike.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.interop.assumptions import TOLERANCE, Assumptions
from tiswarm.interop.dock_gaps import surface_gaps
from tiswarm.interop.docking import ENOUGH, FAR_MORE, count_touching, with_docks
from tiswarm.interop.poses import UPWARD, Poses
from tiswarm.measurements.contacts import dock_pairs
from tiswarm.records.messages import counted

_MOST_ROBOTS = 200
"""Robots for which causes are tried; more would show nothing else."""

_OFF_CENTER = 1.0
"""Largest coordinate of a tracked point in the body frame that is tried [dock radii]."""

_STEP = 0.5
"""Step between tried coordinates of that point [dock radii]."""

_NEAR = 0.4
"""Largest gap and overlap of docks that a step may put in contact [dock radii]."""

_BEST = 12
"""Number of tried points that are refined: those that put most docks in contact."""

_UNKNOWNS = 3


def few_contacts(poses: Poses, assumed: Assumptions, contacts: int, overlaps: int) -> list[str]:
    """Warn of too few contacts, or more overlaps than contacts, and say what may be the cause.

    Args:
        poses: Robots, whose docks are known or guessed.
        assumed: Limits of contacts, and docks if they are given.
        contacts: Number of docks in contact.
        overlaps: Number of docks that overlap by more.
    """
    robots = len(poses.robot_id)
    if robots == 1 or (contacts >= ENOUGH * robots and contacts >= overlaps):
        return []
    found = f"{counted(contacts, 'contact')} and {counted(overlaps, 'overlap')}"
    problem = f"{counted(robots, 'robot')} have {found} of docks; "
    usual = "correct --dock-radius and --dock-offset, or give larger --gap and --overlap"
    # Spheres are docks wherever the frame of the body is.
    cause = "" if poses.docks_are_spheres else _likely_cause(poses, assumed, contacts)
    return [problem + (cause or usual)]


def _likely_cause(poses: Poses, assumed: Assumptions, contacts: int) -> str:
    """Name the other meaning of poses that would make far more docks touch; empty if none would."""
    poses = poses.nearest(_MOST_ROBOTS)
    least = max(ENOUGH * len(poses.robot_id), FAR_MORE * contacts, 1.0)
    if (touching := count_touching(poses.conjugate(), assumed)) >= least:
        return f"quaternions that turn world to body give {touching}: add --conjugate"
    quarter = Rotation.create_group("O")
    for turn in (quarter[k] for k in range(1, len(quarter))):
        turned = poses.turned(turn)
        if (touching := count_touching(turned, assumed)) >= least:
            bare = turned._replace(dock_offset_body=np.empty((0, 3)))
            body = with_docks(bare, assumed)[0].dock_offset_body
            return _by_docks(turn.apply(body), touching)
    moved = poses.dock_offset_body + _off_center(poses, assumed)
    as_moved = replace(assumed, dock_offset_body=moved)
    # Fitted unknowns put as many docks in contact by chance, where a structure has N - 1 contacts.
    least = max(least, len(poses.robot_id) - 1.0 + _UNKNOWNS)
    if (touching := count_touching(poses, as_moved)) >= least:
        return _by_docks(moved, touching)
    return ""


def _by_docks(offset: Reals, touching: int) -> str:
    """Name the offsets at which docks would touch, and the remedy."""
    places = ", ".join(f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in (offset + 0.0).tolist())
    return f"docks at {places} in the body frame give {touching}: measure them, and add --docks"


def off_the_ground(poses: Poses, assumed: Assumptions) -> list[str]:
    """Warn if no dock stands on the ground, or if far more do with another axis up."""
    if assumed.ground_z is None:
        return []
    standing, below = _on_ground(poses, assumed)
    by_axis = {up: _on_ground(poses.upright(up), assumed) for up in UPWARD}
    up = max(by_axis, key=lambda up: by_axis[up].standing * (by_axis[up].below == 0))
    other = by_axis[up]
    explains = below > 0 and other.below == 0 and other.standing >= max(1, FAR_MORE * standing)
    if standing and not explains:
        return []
    docks = f"{standing or 'no'} dock{'s stand' if standing > 1 else ' stands'}"
    problem = f"{docks} on the ground at z = {assumed.ground_z:g}, and {below} of "
    problem += f"{poses.docks[..., 0].size} are below it"
    if explains:
        return [f"{problem}; with {up} up, {other.standing} stand and none is below: add --up {up}"]
    lowest = float(poses.docks[..., 2].min()) - assumed.dock_radius
    return [f"{problem}; the lowest reaches to z = {lowest:.4g}: correct --ground-z or --up"]


class _OnGround(NamedTuple):
    """Numbers of docks."""

    standing: int
    below: int


def _on_ground(poses: Poses, assumed: Assumptions) -> _OnGround:
    """Count the docks that stand on the ground and those below it."""
    least, greatest = assumed.level
    height = poses.docks[..., 2]
    below = height < least
    return _OnGround(int((~below & (height <= greatest)).sum()), int(below.sum()))


def _off_center(poses: Poses, assumed: Assumptions) -> Reals:
    """Find by how much docks are off their places in the body frame, all alike, shape (3,).

    Steps at which most docks nearly touch, and none, are refined by the docks that do.
    """
    turn = Rotation.from_quat(poses.orientation_wxyz, scalar_first=True).as_matrix()
    axis = assumed.dock_radius * np.arange(-_OFF_CENTER, _OFF_CENTER + 0.5 * _STEP, _STEP)
    places = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    order = np.argsort([-len(_close(poses.docks, turn, at, assumed)) for at in places])
    refined = []
    for place in [np.zeros(3), *places[order[:_BEST]]]:
        for _ in range(2):  # docks that touch are others after the first time
            pair = _close(poses.docks, turn, place, assumed)
            if len(pair) >= _UNKNOWNS:
                place = _refined(poses.docks, turn, place, pair, assumed.dock_radius)  # noqa: PLW2901
        refined.append(place)

    def touching(place: Reals) -> int:
        moved = poses.dock_offset_body + place
        return count_touching(poses, replace(assumed, dock_offset_body=moved))

    return max(refined, key=touching)


def _close(docks: Reals, turn: Reals, off: Reals, assumed: Assumptions) -> Ints:
    """List the docks that nearly touch where all are off by a vector in the body frame."""
    docks = docks + (turn @ off)[:, None]
    pair = dock_pairs(docks, (2.0 + _NEAR) * assumed.dock_radius)
    return pair[surface_gaps(docks, pair, assumed.dock_radius) >= -_NEAR * assumed.dock_radius]


def _refined(docks: Reals, turn: Reals, off: Reals, pair: Ints, radius: float) -> Reals:
    """Let most of the docks of some pairs touch, shape (3,)."""

    def misfit(place: Reals) -> Reals:
        return surface_gaps(docks + (turn @ place)[:, None], pair, radius) / radius

    found = least_squares(  # type: ignore[operator]
        misfit, off, loss="cauchy", f_scale=TOLERANCE
    )
    return np.asarray(found.x)
