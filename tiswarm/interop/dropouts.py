"""Finds rests that no pose shows, since the cameras lost the robot there.

Where poses beside a gap are in motion, the robot rested where their flips lead: the flip after the
gap, run backward, meets a pose in which a dock is where the pose before the gap has it; or the flip
before the gap, run forward, meets one for the pose after it. One angle is unknown, and the place of
a dock has three coordinates, so chance hardly satisfies it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets

_STAYS = 0.5
"""A pivot moves less than this part of what the dock farthest from it moves."""

_SAME_AXIS = 0.9
"""Least cosine of the angle between two axes that are the same but for noise."""

_ANGLES = np.radians(np.arange(1.0, 361.0))
"""Angles by which flips are continued [rad]; between them docks move by less than 0.1 R."""


_Candidate = tuple[float, Reals, Reals]
"""How far a dock is from its place in another pose, position and orientation of a possible rest."""


class Track(NamedTuple):
    """K poses of one robot at which it may rest, in the order of time."""

    begin: Reals  # first time of each, (K,)
    end: Reals  # last time of each, (K,)
    position: Reals  # centers, (K, 3)
    orientation_wxyz: Reals  # body to world, (K, 4)

    def docks(self, dock_offset_body: Reals) -> Reals:
        """Locate docks at offsets (D, 3) from the center, shape (K, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, dock_offset_body)

    @property
    def turn(self) -> Rotation:
        """Rotations from body to world."""
        return Rotation.from_quat(self.orientation_wxyz, scalar_first=True)

    def chosen(self, rows: Ints | Bools | slice) -> "Track":
        """Return some poses."""
        return Track(*(column[rows] for column in self))


def motions(docks: Reals) -> tuple[Ints, Reals, Reals]:
    """Find the dock that moves least from each of K poses, (K, D, 3), to the next one.

    Returns:
        The dock, how far it moves, and how far the dock that moves most does, shapes (K - 1,).
    """
    moved = np.linalg.norm(np.diff(docks, axis=0), axis=2)
    return moved.argmin(axis=1), moved.min(axis=1), moved.max(axis=1)


def are_flips(docks: Reals, put: float) -> Bools:
    """Whether a flip about a dock leads from each of K poses to the next one, shape (K - 1,)."""
    _, moved, farthest = motions(docks)
    flips: Bools = (moved <= put) & (moved < _STAYS * farthest)
    return flips


def continues(docks: Reals, turn: Rotation) -> Bools:
    """Whether the motion out of each of K poses goes on with that into it, shape (K,)."""
    going_on = np.zeros(len(docks), np.bool_)
    if len(docks) > 1:
        about, moved, farthest = motions(docks)
        stays = moved < _STAYS * farthest
        axis = (turn[1:] * turn[:-1].inv()).as_rotvec()
        axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), np.finfo(float).tiny)
        along = (axis[1:] * axis[:-1]).sum(axis=1) > _SAME_AXIS
        going_on[1:-1] = stays[1:] & stays[:-1] & (about[1:] == about[:-1]) & along
    return going_on


def with_unseen_rests(track: Track, dock_offset_body: Reals, put: float) -> tuple[Track, int]:
    """Insert rests that no pose shows, and count them.

    Poses in motion beside a gap, which are no rests, leave the track for those that are inserted.

    Args:
        track: Poses at which a robot may rest.
        dock_offset_body: Center to dock, shape (D, 3).
        put: Largest motion of a pivot from one rest to the next.
    """
    found = 0
    if 2 * (track.end > track.begin).sum() < len(track.begin):
        return track, found  # a table of stances, in which no pose is in motion
    for k in np.flatnonzero(~are_flips(track.docks(dock_offset_body), put))[::-1].tolist():
        for position, wxyz in _unseen(track, track.docks(dock_offset_body), k, put):
            longer = _inserted(track, k + 1, position, wxyz)
            in_motion = longer.end == longer.begin
            beside = [n for n in (k, k + 2) if in_motion[n] and 0 < n < len(in_motion) - 1]
            if continues(longer.docks(dock_offset_body), longer.turn)[beside].all():
                track = longer.chosen(np.delete(np.arange(len(in_motion)), beside))
                found += 1
                break
    return track, found


def _inserted(track: Track, at: int, position: Reals, wxyz: Reals) -> Track:
    """Insert a pose between the last time of the one before and the first time of the next."""
    return Track(
        np.insert(track.begin, at, track.end[at - 1]),
        np.insert(track.end, at, track.begin[at]),
        np.insert(track.position, at, position, axis=0),
        np.insert(track.orientation_wxyz, at, wxyz, axis=0),
    )


def _unseen(track: Track, docks: Reals, before: int, put: float) -> list[tuple[Reals, Reals]]:
    """List positions and orientations at which a robot may rest between two poses, likeliest first.

    A pose is the likelier, the nearer a dock is to where one of the two poses has it.
    """
    after, in_motion = before + 1, track.end == track.begin
    found: list[_Candidate] = []
    if in_motion[after] and after + 1 < len(docks):
        found += _continued(track, docks, (after + 1, after), before)
    if in_motion[before] and before > 0:
        found += _continued(track, docks, (before - 1, before), after)
    found.sort(key=lambda each: each[0])
    return [(position, wxyz) for off, position, wxyz in found if off <= put]


def _continued(track: Track, docks: Reals, flip: tuple[int, int], target: int) -> list[_Candidate]:
    """Continue a flip from one pose to another, to where each dock is nearest to a target's."""
    start, end = flip
    pivot = int(np.linalg.norm(docks[end] - docks[start], axis=1).argmin())
    turn, center = track.turn, docks[end, pivot]
    way = (turn[end] * turn[start].inv()).as_rotvec()
    axis = way / max(float(np.linalg.norm(way)), np.finfo(float).tiny)

    def off(angle: float) -> Reals:
        moved = center + Rotation.from_rotvec(angle * axis).apply(docks[end] - center)
        distance: Reals = np.linalg.norm(moved - docks[target], axis=1)
        return distance

    apart = np.array([off(angle) for angle in _ANGLES])
    found: list[_Candidate] = []
    for dock in np.delete(np.arange(docks.shape[1]), pivot).tolist():
        near = _ANGLES[apart[:, dock].argmin()]
        angle = _least(off, dock, near)
        swing = Rotation.from_rotvec(angle * axis)
        wxyz = (swing * turn[end]).as_quat(scalar_first=True)
        position = center + swing.apply(track.position[end] - center)
        found.append((float(off(angle)[dock]), position, wxyz))
    return found


def _least(off: Callable[[float], Reals], dock: int, near: float) -> float:
    """Find the angle at which a dock is least far off, within a step of another one [rad]."""
    found = optimize.least_squares(  # type: ignore[operator]
        lambda angle: off(float(angle[0]))[[dock]],
        [near],
        bounds=([near - _ANGLES[0]], [near + _ANGLES[0]]),
    )
    return float(found.x[0])
