"""Stances of robots that moved: what stands still between two flips.

A flip turns a robot about an axis through the center of one dock, the pivot. A robot rests where
the pivot or the axis of the motion into a pose differs from that of the motion out of it. So a file
may list each stance once, or sample motions at any rate.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.interop.assumptions import Assumptions
from tiswarm.interop.dropouts import Track, are_flips, continues, motions, with_unseen_rests
from tiswarm.interop.poses import Poses, Samples
from tiswarm.records.sensing_log import Stances

_NEAR = 3.0
"""Runs of samples, in a row and within this many limits of stillness, are one rest."""

_BACK_AND_FORTH = 0.75
"""Noise moves docks in two steps by less than this part of the sum of both."""

_OFTEN = 0.25
"""Share of samples in which noise alone moves docks, where robots mostly rest."""

_ROUNDING = 1e-6
"""Least motion of a pivot that counts [dock radii]."""

_NOISE_MARGIN = 3.0
"""Largest motion of a robot at rest, per median of a step that noise alone makes."""


class Rests(NamedTuple):
    """The M poses at rest of N robots, by robot and then by time; the last is the final one."""

    start: Ints
    """First rest of each robot, shape (N + 1,)."""

    begin: Reals
    """Time at which each begins, shape (M,)."""

    end: Reals
    """Time at which each ends, shape (M,)."""

    position: Reals
    """Centers, shape (M, 3)."""

    orientation_wxyz: Reals
    """Body to world, shape (M, 4)."""

    pivot: Ints
    """Dock that stays put as the robot leaves each but the last, shape (M,); -1 for the last."""

    appeared: Reals
    """Time of the first pose of each robot, shape (N,)."""

    cut: Ints
    """Robots whose earlier poses are left out, since no flip leads from them to later ones."""

    unseen: int
    """Number of rests that no pose shows."""

    @property
    def in_motion(self) -> Ints:
        """Robots that move to the end of their samples, where most rests have several samples."""
        lasting, last = self.end > self.begin, self.last
        before: Ints = np.setdiff1d(np.arange(len(lasting)), last)
        if not len(before) or 2 * lasting[before].sum() < len(before):
            return np.empty(0, np.int64)
        came = np.diff(self.start) > 1
        came[self.cut] = True
        return np.flatnonzero(~lasting[last] & came)

    @property
    def last(self) -> Ints:
        """The final rest of each robot, shape (N,)."""
        return self.start[1:] - 1

    @property
    def arrival(self) -> Reals:
        """Times by which robots join, the most important last: first pose, final rest, (2, N)."""
        return np.stack([self.appeared, self.begin[self.last]])


class Limits(NamedTuple):
    """Largest motions that noise explains, of docks at rest and of pivots."""

    still: float
    """Largest motion of a dock of a robot at rest."""

    put: float
    """Largest motion of a pivot from one rest to the next."""


def motion_limits(samples: Samples, docks: Reals, assumed: Assumptions) -> Limits:
    """Derive limits of motion from those of contacts, wider where samples at rest are noisier.

    Args:
        samples: Poses over time.
        docks: Centers of their docks, shape (S, D, 3).
        assumed: Limits of contacts.
    """
    limits = assumed.largest_gap, assumed.largest_overlap
    put = max(sum(limits), _ROUNDING * assumed.dock_radius)
    noise = _NOISE_MARGIN * _step_of_noise(docks, samples.robot, most=put)
    return Limits(max(0.5 * max(*limits, 0.5 * put), noise), max(put, noise))


def find_rests(poses: Poses, assumed: Assumptions) -> Rests | None:
    """Find where robots rested, in poses over time; None if each robot has one pose.

    Args:
        poses: Robots, whose docks are known.
        assumed: Limits of contacts.
    """
    samples = poses.samples
    if samples is None:
        return None
    docks = samples.docks(poses.dock_offset_body)
    still, put = motion_limits(samples, docks, assumed)
    turn = Rotation.from_quat(samples.orientation_wxyz, scalar_first=True)
    start = np.searchsorted(samples.robot, np.arange(len(poses.robot_id) + 1))
    tracks, pivot, cut, unseen = [], [], [], 0
    for robot, (first, after) in enumerate(pairwise(start.tolist())):
        runs = first + _runs_at_rest(docks[first:after], still)
        ends = np.append(runs[1:], after) - 1
        middle = np.array([_middle(docks, *run) for run in zip(runs, ends, strict=True)])
        rests = np.flatnonzero(~continues(docks[middle], turn[middle]))
        begins, lasts = _joined(docks[middle], rests, _NEAR * still)
        middle = _corners(docks, runs, ends, begins, lasts)
        track = Track(
            samples.time[runs[begins]],
            samples.time[ends[lasts]],
            samples.position[middle],
            samples.orientation_wxyz[middle],
        )
        track, inserted = with_unseen_rests(track, poses.dock_offset_body, put)
        lost = np.flatnonzero(~are_flips(track.docks(poses.dock_offset_body), put))
        if len(lost):
            cut.append(robot)
            track = track.chosen(slice(lost[-1] + 1, None))
        tracks.append(track)
        pivot.append(np.append(motions(track.docks(poses.dock_offset_body))[0], -1))
        unseen += inserted
    whole = Track(*(np.concatenate(parts) for parts in zip(*tracks, strict=True)))
    return Rests(
        start=np.cumsum([0, *(len(track.begin) for track in tracks)]),
        begin=whole.begin,
        end=whole.end,
        position=whole.position,
        orientation_wxyz=whole.orientation_wxyz,
        pivot=np.concatenate(pivot),
        appeared=samples.time[start[:-1]],
        cut=np.array(cut, np.int64),
        unseen=unseen,
    )


def _step_of_noise(docks: Reals, robot: Ints, most: float) -> float:
    """Estimate how far noise moves docks from a sample to the next, (S, D, 3); 0 if it is unknown.

    Noise moves docks back and forth, while motions go on. In tables of stances docks move back and
    forth by more than noise, `most`, does.
    """
    one = np.linalg.norm(docks[1:] - docks[:-1], axis=2).max(axis=1)
    two = np.linalg.norm(docks[2:] - docks[:-2], axis=2).max(axis=1)
    same = robot[2:] == robot[:-2]
    at_rest = same & (two < _BACK_AND_FORTH * (one[1:] + one[:-1]))
    if at_rest.sum() < _OFTEN * max(1, same.sum()):
        return 0.0
    step = float(np.median(one[1:][at_rest]))
    return step if step <= most else 0.0


def _runs_at_rest(docks: Reals, still: float) -> Ints:
    """Return the first sample of each run without motion, of docks of one robot, (S, D, 3)."""
    first = [0]
    ahead, length = 1, 1
    while ahead < len(docks):
        off = np.linalg.norm(docks[ahead : ahead + length] - docks[first[-1]], axis=2).max(axis=1)
        if (off > still).any():
            first.append(ahead + int((off > still).argmax()))
            ahead, length = first[-1] + 1, 1
        else:
            ahead, length = ahead + length, 2 * length
    return np.array(first)


def _middle(docks: Reals, first: int, last: int) -> int:
    """Return the sample of a run that is nearest to the median of all."""
    run = docks[first : last + 1]
    off = np.linalg.norm(run - np.median(run, axis=0), axis=2).sum(axis=1)
    return int(first + off.argmin())


def _joined(docks: Reals, rests: Ints, near: float) -> tuple[Ints, Ints]:
    """Join runs at rest that are one: samples turn a corner within a run, or noise splits it.

    Args:
        docks: Centers of docks at the middle of each run, shape (K, D, 3).
        rests: Runs at rest, shape (R,).
        near: Largest distance of a dock between the first and any other run of a rest.

    Returns:
        First and last run of each rest.
    """
    begins, lasts = [rests[0]], [rests[0]]
    for run in rests[1:].tolist():
        off = np.linalg.norm(docks[run] - docks[begins[-1]], axis=1).max()
        if run == lasts[-1] + 1 and off <= near:
            lasts[-1] = run
        else:
            begins.append(run)
            lasts.append(run)
    return np.array(begins), np.array(lasts)


def _corners(docks: Reals, runs: Ints, ends: Ints, first: Ints, last: Ints) -> Ints:
    """Return the sample of each rest, shape (K,), where the way of the docks turns a corner.

    It makes the longest detour between the samples at the outer ends of the runs next to the rest.
    A robot rests at the first sample of its first run, and at the last one of its last run.

    Args:
        docks: Centers of docks at all samples, shape (S, D, 3).
        runs: First sample of each run, shape (R,).
        ends: Last sample of each run, shape (R,).
        first: First run of each rest, shape (K,).
        last: Last run of each rest, shape (K,).
    """
    corners = [runs[0], *ends[last[1:]]]
    for k in range(1, len(first) - 1):
        start, end = runs[first[k] - 1], ends[last[k] + 1]
        between = docks[start + 1 : end]
        detour = sum(np.linalg.norm(between - docks[at], axis=2).sum(axis=1) for at in (start, end))
        corners[k] = start + 1 + detour.argmax()
    return np.array(corners)


def stances_of(
    rests: Rests,
    poses: Poses,
    order: Ints,
    assumed: Assumptions,
) -> tuple[Stances | None, int]:
    """Derive what robots sensed at rest before their final poses.

    Contacts are with robots that joined earlier and, unless a join order is given, had reached
    their final poses by the clock.

    Args:
        rests: Poses at rest.
        poses: Final poses.
        order: Robots that are in the log, in join order.
        assumed: Limits of contacts, and the ground.

    Returns:
        The stances, None if there are none; and the number of contacts that only the clock
        excludes, which is 0 but for chance where all robots have one clock.
    """
    rows = [np.arange(rests.start[robot], rests.last[robot]) for robot in order.tolist()]
    start = np.cumsum([0, *map(len, rows)])
    chosen = np.concatenate(rows)
    if not len(chosen):
        return None, 0
    spacing, level = assumed.spacing, assumed.level
    turn = rests.orientation_wxyz[chosen]
    docks = rests.position[chosen, None] + dock_offsets(turn, poses.dock_offset_body)
    final, number = poses.docks[order], docks.shape[1]
    near = cKDTree(docks.reshape(-1, 3)).query_ball_tree(
        cKDTree(final.reshape(-1, 3)), spacing[1], p=2.0
    )
    pair = [(own, other) for own, others in enumerate(near) for other in others]
    own, other = np.array(pair, np.int64).reshape(-1, 2).T
    apart = np.linalg.norm(docks.reshape(-1, 3)[own] - final.reshape(-1, 3)[other], axis=1)
    stance, robot = own // number, other // number
    place = np.repeat(np.arange(len(order)), np.diff(start))
    is_contact = (apart >= spacing[0]) & (robot < place[stance])
    early = np.zeros(len(is_contact), np.bool_)
    if poses.join is None:
        arrived = rests.begin[rests.last[order]]
        early = is_contact & (arrived[robot] > rests.end[chosen[stance]])
        is_contact &= ~early
    contacts = np.column_stack([stance, own % number, robot, other % number])[is_contact]
    standing = (docks[:, :, 2] >= level[0]) & (docks[:, :, 2] <= level[1])
    stances = Stances(
        start=start,
        orientation_wxyz=turn,
        pivot_dock=rests.pivot[chosen].astype(np.int32),
        contacts=np.unique(contacts, axis=0).astype(np.int32),
        ground_docks=np.argwhere(standing).astype(np.int32),
    )
    return stances, int(early.sum())
