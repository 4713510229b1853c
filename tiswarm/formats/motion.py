"""Stances of robots that moved: what stands still between two flips.

A flip turns a robot about an axis through the center of one dock, the pivot. A robot rests where
the pivot or the axis of the motion into a pose differs from that of the motion out of it. So a file
may list each stance once, or sample motions at any rate.

Rests that no pose shows are found, too: the cameras lost the robot there. Where poses beside a gap
are in motion, the robot rested where their flips lead: the flip after the gap, run backward, meets
a pose in which a dock is where the pose before the gap has it; or the flip before the gap, run
forward, meets one for the pose after it. One angle is unknown, and the place of a dock has three
coordinates, so chance hardly satisfies it.

Errors of tracking, such as swapped markers, are left out. During a flip one dock stays where it is,
so from a sample to the next some dock stays. A few samples in a row are an error if no dock stays
from the one before to them, none stays from them to the one after, and one does from the one before
to the one after. The last samples are an error if the robot rested before them: a robot leaves a
rest by one flip.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.poses import TOLERANCE, Assumptions, Poses, Samples, first_names
from tiswarm.formats.segments import REST, Noise, Segment, divide, gaps, has_noise, middle, tracks
from tiswarm.records.messages import counted, percent
from tiswarm.records.sensing_log import Stances

_STAYS = 0.5
"""A pivot moves less than this part of what the dock farthest from it moves."""

_SAME_AXIS = 0.9
"""Least cosine of the angle between two axes that are the same but for noise."""

_ANGLES = np.radians(np.arange(1.0, 361.0))
"""Angles by which flips are continued [rad]; between them docks move by less than 0.1 R."""


class _Candidate(NamedTuple):
    """Pose of a possible rest."""

    distance: float  # of a dock from its place in another pose
    position: Reals  # (3,)
    orientation_wxyz: Reals  # (4,)


class Track(NamedTuple):
    """K poses of one robot at which it may rest, in the order of time."""

    begin: Reals  # first time of each, (K,)
    end: Reals  # last time of each, (K,)
    position: Reals  # centers, (K, 3)
    orientation_wxyz: Reals  # body to world, (K, 4)
    number: Ints  # samples that each is the mean of; 0 where no pose shows it, (K,)

    def docks(self, dock_offset_body: Reals) -> Reals:
        """Locate docks at offsets (D, 3) from the center, shape (K, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, dock_offset_body)

    @property
    def turn(self) -> Rotation:
        """Rotations from body to world."""
        return Rotation.from_quat(self.orientation_wxyz, scalar_first=True)

    def chosen(self, rows: Ints | Bools | slice) -> "Track":
        """Return some poses."""
        return Track(
            self.begin[rows],
            self.end[rows],
            self.position[rows],
            self.orientation_wxyz[rows],
            self.number[rows],
        )


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
    inserted = 0
    if 2 * (track.end > track.begin).sum() < len(track.begin):
        return track, inserted  # a table of stances, in which no pose is in motion
    for k in np.flatnonzero(~are_flips(track.docks(dock_offset_body), put))[::-1].tolist():
        for position, wxyz in _unseen(track, track.docks(dock_offset_body), k, put):
            longer = _inserted(track, k + 1, position, wxyz)
            in_motion = longer.end == longer.begin
            beside = [n for n in (k, k + 2) if in_motion[n] and 0 < n < len(in_motion) - 1]
            if continues(longer.docks(dock_offset_body), longer.turn)[beside].all():
                track = longer.chosen(np.delete(np.arange(len(in_motion)), beside))
                inserted += 1
                break
    return track, inserted


def _inserted(track: Track, at: int, position: Reals, wxyz: Reals) -> Track:
    """Insert a pose between the last time of the one before and the first time of the next."""
    return Track(
        np.insert(track.begin, at, track.end[at - 1]),
        np.insert(track.end, at, track.begin[at]),
        np.insert(track.position, at, position, axis=0),
        np.insert(track.orientation_wxyz, at, wxyz, axis=0),
        np.insert(track.number, at, 0),
    )


def _unseen(track: Track, docks: Reals, before: int, put: float) -> list[tuple[Reals, Reals]]:
    """List positions and orientations at which a robot may rest between two poses, likeliest first.

    A pose is the likelier, the nearer a dock is to where one of the two poses has it.
    """
    after = before + 1
    in_motion = track.end == track.begin
    candidates: list[_Candidate] = []
    if in_motion[after] and after + 1 < len(docks):
        candidates += _continued(track, docks, (after + 1, after), before)
    if in_motion[before] and before > 0:
        candidates += _continued(track, docks, (before - 1, before), after)
    candidates.sort(key=lambda candidate: candidate.distance)
    return [(position, wxyz) for distance, position, wxyz in candidates if distance <= put]


def _continued(track: Track, docks: Reals, flip: tuple[int, int], target: int) -> list[_Candidate]:
    """Continue a flip from one pose to another, to where each dock is nearest to a target's."""
    start, end = flip
    pivot = int(np.linalg.norm(docks[end] - docks[start], axis=1).argmin())
    turn = track.turn
    center = docks[end, pivot]
    way = (turn[end] * turn[start].inv()).as_rotvec()
    axis = way / max(float(np.linalg.norm(way)), np.finfo(float).tiny)

    def distances(angle: float) -> Reals:
        moved = center + Rotation.from_rotvec(angle * axis).apply(docks[end] - center)
        apart: Reals = np.linalg.norm(moved - docks[target], axis=1)
        return apart

    distances_by_angle = np.array([distances(angle) for angle in _ANGLES])
    candidates: list[_Candidate] = []
    for dock in np.delete(np.arange(docks.shape[1]), pivot).tolist():
        near = _ANGLES[distances_by_angle[:, dock].argmin()]
        angle = _nearest_angle(distances, dock, near)
        swing = Rotation.from_rotvec(angle * axis)
        wxyz = (swing * turn[end]).as_quat(scalar_first=True)
        position = center + swing.apply(track.position[end] - center)
        candidates.append(_Candidate(float(distances(angle)[dock]), position, wxyz))
    return candidates


def _nearest_angle(distances: Callable[[float], Reals], dock: int, start: float) -> float:
    """Find the angle at which a dock is least far off, within a step of another one [rad]."""
    solution = optimize.least_squares(  # type: ignore[operator]
        lambda angle: distances(float(angle[0]))[[dock]],
        [start],
        bounds=([start - _ANGLES[0]], [start + _ANGLES[0]]),
    )
    return float(solution.x[0])


_NEAR = 3.0
"""Runs of samples, in a row and within this many limits of stillness, are one rest."""

_SAME = 4.0
"""Rests whose docks are less apart than by so many standard deviations are one."""

_BACK_AND_FORTH = 0.75
"""Noise moves docks in two steps by less than this part of the sum of both."""

_OFTEN = 0.25
"""Share of samples in which noise alone moves docks, where robots mostly rest."""

_ROUNDING = 1e-6
"""Least motion of a pivot that counts [dock radii]."""

LOUDEST = 0.12
"""Largest step that counts as noise [dock radii]; flips move docks by more than one."""

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

    number: Ints
    """Samples that each is the mean of; 0 where no pose shows it, shape (M,)."""

    pivot: Ints
    """Dock that stays put as the robot leaves each but the last, shape (M,); -1 for the last."""

    appeared: Reals
    """Time of the first pose of each robot, shape (N,)."""

    cut: Ints
    """Robots whose earlier poses are left out, since no flip leads from them to later ones."""

    unseen: int
    """Number of rests that no pose shows."""

    noise: Noise | None
    """Noise of samples; None if too few rests have several."""

    flips: Ints
    """Flips as rows of (robot, first sample, sample after the last, pivot), shape (F, 4)."""

    @property
    def in_motion(self) -> Ints:
        """Robots that move to the end of their samples, where most rests have several samples."""
        lasting = self.end > self.begin
        last = self.last
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
    gap = assumed.largest_gap
    overlap = assumed.largest_overlap
    put = max(gap + overlap, _ROUNDING * assumed.dock_radius)
    still = 0.5 * max(gap, overlap, 0.5 * put)
    noise = _NOISE_MARGIN * step_of_noise(docks, samples.robot, LOUDEST * assumed.dock_radius)
    return Limits(max(still, noise), max(put, noise))


def with_final_rests(poses: Poses, rests: Rests | None) -> tuple[Poses, float]:
    """Put robots at the means of their last rests.

    Args:
        poses: Robots.
        rests: Where they rested; None if each has one pose.

    Returns:
        The poses, and the part of noise that is left [1], which is 1 where none is measured.
    """
    if rests is None or rests.noise is None:
        return poses, 1.0
    last = rests.last
    poses = poses._replace(
        position=rests.position[last], orientation_wxyz=rests.orientation_wxyz[last]
    )
    return poses, float(rests.number[last].min() ** -0.5)


def find_rests(poses: Poses, assumed: Assumptions) -> Rests | None:
    """Find where robots rested, in poses over time; None if each robot has one pose.

    Args:
        poses: Robots, whose docks are known.
        assumed: Limits of contacts.
    """
    samples = poses.samples
    if samples is None:
        return None
    offset = poses.dock_offset_body
    still, put = motion_limits(samples, samples.docks(offset), assumed)
    recordings = tracks(samples)
    is_exact = not has_noise(samples, assumed.dock_radius)
    divided: list[list[Segment]] = [[] for _ in recordings]
    noise = None
    step = 0.0
    if not is_exact:
        divided, noise = divide(samples, offset, assumed.dock_radius)
    if noise is not None:
        step = _SAME * noise.of_docks(offset)
    chosen = []
    pivots = []
    cut = []
    unseen = 0
    for robot, (recorded, parts) in enumerate(zip(recordings, divided, strict=True)):
        if is_exact:
            track = _corners_of(recorded, offset, still)
        else:
            track = _resting(recorded, parts, offset, put)
            track = _joined(track, offset, step, TOLERANCE * assumed.dock_radius)
            track = track.chosen(~continues(track.docks(offset), track.turn))
        track, inserted = with_unseen_rests(track, offset, put)
        breaks = np.flatnonzero(~are_flips(track.docks(offset), put))
        if len(breaks):
            cut.append(robot)
            track = track.chosen(slice(breaks[-1] + 1, None))
        chosen.append(track)
        pivot, _, _ = motions(track.docks(offset))
        pivots.append(np.append(pivot, -1))
        unseen += inserted
    rests = Track(*(np.concatenate(parts) for parts in zip(*chosen, strict=True)))
    start = np.searchsorted(samples.robot, np.arange(len(poses.robot_id)))
    flips = [
        (robot, first + part.first, first + part.after, part.pivot)
        for robot, (first, parts) in enumerate(zip(start.tolist(), divided, strict=True))
        for part in parts
        if part.pivot != REST
    ]
    return Rests(
        start=np.cumsum([0, *(len(track.begin) for track in chosen)]),
        begin=rests.begin,
        end=rests.end,
        position=rests.position,
        orientation_wxyz=rests.orientation_wxyz,
        number=rests.number,
        pivot=np.concatenate(pivots),
        appeared=samples.time[start],
        cut=np.array(cut, np.int64),
        unseen=unseen,
        noise=noise,
        flips=np.array(flips, np.int64).reshape(-1, 4),
    )


def _resting(recorded: Samples, parts: list[Segment], offset: Reals, put: float) -> Track:
    """List the poses at which a robot may rest: at rests, and where flips meet or are cut off."""
    docks = recorded.docks(offset)
    is_gap = gaps(recorded.time)
    last = len(docks)
    place = [
        np.median(docks[part.first : part.after, max(part.pivot, 0)], axis=0) for part in parts
    ]
    stretches = [(part.first, part.after) for part in parts if part.pivot == REST]
    if parts[0].pivot != REST:
        stretches.append((0, 1))
    if parts[-1].pivot != REST:
        stretches.append((last - 1, last))
    for k, (before, after) in enumerate(pairwise(parts)):
        edge = after.first
        if is_gap[edge - 1]:
            for n, part, beside, sample in (
                (k, before, after, edge - 1),
                (k + 1, after, before, edge),
            ):
                if part.pivot == REST:
                    continue
                dock = np.median(docks[beside.first : beside.after, part.pivot], axis=0)
                if beside.pivot != REST or np.linalg.norm(dock - place[n]) > put:
                    stretches.append((sample, sample + 1))
        elif REST not in {before.pivot, after.pivot}:
            earlier = np.linalg.norm(docks[edge - 1, after.pivot] - place[k + 1])
            later = np.linalg.norm(docks[edge, before.pivot] - place[k])
            corner = edge - 1 if earlier <= later else edge
            stretches.append((corner, corner + 1))
    stretches.sort()
    rows = [middle(first, after, last) for first, after in stretches]
    turns = [
        Rotation.from_quat(recorded.orientation_wxyz[row], scalar_first=True).mean() for row in rows
    ]
    return Track(
        np.array([recorded.time[first] for first, _ in stretches]),
        np.array([recorded.time[after - 1] for _, after in stretches]),
        np.array([recorded.position[row].mean(axis=0) for row in rows]),
        np.array([turn.as_quat(scalar_first=True) for turn in turns]),
        np.array([row.stop - row.start for row in rows]),
    )


def _joined(track: Track, offset: Reals, step: float, least: float) -> Track:
    """Join neighboring rests at one pose.

    Args:
        track: Poses at which a robot may rest.
        offset: Center to dock, shape (D, 3).
        step: Largest distance of docks of two samples that noise explains.
        least: Least distance of docks of two rests.
    """
    docks = track.docks(offset)
    chosen = [0]
    end = track.end.copy()
    for k in range(1, len(docks)):
        earlier = chosen[-1]
        near = step * np.sqrt((1.0 / track.number[[earlier, k]]).sum())
        apart = np.linalg.norm(docks[k] - docks[earlier], axis=1).max()
        if apart > max(near, least):
            chosen.append(k)
        else:
            end[earlier] = end[k]
    return track._replace(end=end).chosen(np.array(chosen))


def step_of_noise(docks: Reals, robot: Ints, most: float) -> float:
    """Estimate how far noise moves docks from a sample to the next, (S, D, 3); 0 if it is unknown.

    Noise moves docks back and forth, while motions go on. In tables of stances docks move back and
    forth by more than noise, `most`, does.
    """
    step = np.linalg.norm(docks[1:] - docks[:-1], axis=2).max(axis=1)[1:]
    at_rest = _moves_of_noise(docks, robot)
    median = float(np.median(step[at_rest])) if at_rest.any() else 0.0
    return median if median <= most else 0.0


def _moves_of_noise(docks: Reals, robot: Ints) -> Bools:
    """Whether docks moved back and forth up to each sample from the third, (S - 2,), if often."""
    in_one_step = np.linalg.norm(docks[1:] - docks[:-1], axis=2).max(axis=1)
    in_two_steps = np.linalg.norm(docks[2:] - docks[:-2], axis=2).max(axis=1)
    is_one_robot = robot[2:] == robot[:-2]
    way = in_one_step[1:] + in_one_step[:-1]
    at_rest: Bools = is_one_robot & (in_two_steps < _BACK_AND_FORTH * way)
    is_often = at_rest.sum() >= _OFTEN * max(1, is_one_robot.sum())
    return at_rest if is_often else np.zeros_like(at_rest)


def _corners_of(recorded: Samples, offset: Reals, still: float) -> Track:
    """List the poses at which a robot may rest, of samples without noise.

    It rests where its motion, sampled at any rate, turns a corner: without noise, that is exact.
    """
    docks = recorded.docks(offset)
    turn = Rotation.from_quat(recorded.orientation_wxyz, scalar_first=True)
    runs = _runs_at_rest(docks, still)
    ends = np.append(runs[1:], len(docks)) - 1
    center = np.array([_middle(docks, *run) for run in zip(runs, ends, strict=True)])
    resting = np.flatnonzero(~continues(docks[center], turn[center]))
    begins, lasts = _runs_joined(docks[center], resting, _NEAR * still)
    corners = _corners(docks, runs, ends, begins, lasts)
    return Track(
        recorded.time[runs[begins]],
        recorded.time[ends[lasts]],
        recorded.position[corners],
        recorded.orientation_wxyz[corners],
        np.ones(len(corners), np.int64),
    )


def _runs_at_rest(docks: Reals, still: float) -> Ints:
    """Return the first sample of each run without motion, of docks of one robot, (S, D, 3)."""
    first = [0]
    ahead = 1
    length = 1
    while ahead < len(docks):
        moved = np.linalg.norm(docks[ahead : ahead + length] - docks[first[-1]], axis=2).max(axis=1)
        if (moved > still).any():
            first.append(ahead + int((moved > still).argmax()))
            ahead = first[-1] + 1
            length = 1
        else:
            ahead += length
            length *= 2
    return np.array(first)


def _middle(docks: Reals, first: int, last: int) -> int:
    """Return the sample of a run that is nearest to the median of all."""
    run = docks[first : last + 1]
    distance = np.linalg.norm(run - np.median(run, axis=0), axis=2).sum(axis=1)
    return int(first + distance.argmin())


def _runs_joined(docks: Reals, rests: Ints, near: float) -> tuple[Ints, Ints]:
    """Join runs at rest that are one: samples turn a corner within a run, or noise splits it.

    Args:
        docks: Centers of docks at the middle of each run, shape (K, D, 3).
        rests: Runs at rest, shape (R,).
        near: Largest distance of a dock between the first and any other run of a rest.

    Returns:
        First and last run of each rest.
    """
    begins = [rests[0]]
    lasts = [rests[0]]
    for run in rests[1:].tolist():
        moved = np.linalg.norm(docks[run] - docks[begins[-1]], axis=1).max()
        if run == lasts[-1] + 1 and moved <= near:
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
        start = runs[first[k] - 1]
        end = ends[last[k] + 1]
        between = docks[start + 1 : end]
        to_start = np.linalg.norm(between - docks[start], axis=2).sum(axis=1)
        to_end = np.linalg.norm(between - docks[end], axis=2).sum(axis=1)
        corners[k] = start + 1 + (to_start + to_end).argmax()
    return np.array(corners)


def stances_of(
    rests: Rests,
    poses: Poses,
    order: Ints,
    assumed: Assumptions,
    moving: Assumptions,
) -> tuple[Stances | None, int]:
    """Derive what robots sensed at rest before their final poses.

    Contacts are with robots that joined earlier and, unless a join order is given, had reached
    their final poses by the clock.

    Args:
        rests: Poses at rest.
        poses: Final poses.
        order: Robots that are in the log, in join order.
        assumed: Limits of final contacts, and the ground.
        moving: Limits of contacts in single samples; those of means are narrower.

    Returns:
        The stances, None if there are none; and the number of contacts that only the clock
        excludes, which is 0 but for chance where all robots have one clock.
    """
    rows = [np.arange(rests.start[robot], rests.last[robot]) for robot in order.tolist()]
    start = np.cumsum([0, *map(len, rows)])
    chosen = np.concatenate(rows)
    if not len(chosen):
        return None, 0
    turn = rests.orientation_wxyz[chosen]
    docks = rests.position[chosen, None] + dock_offsets(turn, poses.dock_offset_body)
    number = docks.shape[1]
    stance_docks = docks.reshape(-1, 3)
    final_docks = poses.docks[order].reshape(-1, 3)
    share = np.maximum(rests.number[chosen], 1) ** -0.5
    gap = np.maximum(assumed.largest_gap, share * moving.largest_gap)
    overlap = np.maximum(assumed.largest_overlap, share * moving.largest_overlap)
    apart = 2.0 * assumed.dock_radius
    farthest = apart + float(gap.max())
    neighbors = cKDTree(stance_docks).query_ball_tree(cKDTree(final_docks), farthest, p=2.0)
    pairs = [(row, neighbor) for row, rows in enumerate(neighbors) for neighbor in rows]
    stance_row, final_row = np.array(pairs, np.int64).reshape(-1, 2).T
    distance = np.linalg.norm(stance_docks[stance_row] - final_docks[final_row], axis=1)
    stance = stance_row // number
    robot = final_row // number
    mover = np.repeat(np.arange(len(order)), np.diff(start))
    is_contact = (distance >= apart - overlap[stance]) & (distance <= apart + gap[stance])
    is_contact &= robot < mover[stance]
    early = np.zeros(len(is_contact), np.bool_)
    if poses.join is None:
        arrived = rests.begin[rests.last[order]]
        early = is_contact & (arrived[robot] > rests.end[chosen[stance]])
        is_contact &= ~early
    contacts = np.column_stack([stance, stance_row % number, robot, final_row % number])[is_contact]
    ground_z = np.nan if assumed.ground_z is None else assumed.ground_z
    height = docks[:, :, 2] - ground_z - assumed.dock_radius
    standing = (height >= -overlap[:, None]) & (height <= gap[:, None])
    stances = Stances(
        start=start,
        orientation_wxyz=turn,
        pivot_dock=rests.pivot[chosen].astype(np.int32),
        contacts=np.unique(contacts, axis=0).astype(np.int32),
        ground_docks=np.argwhere(standing).astype(np.int32),
    )
    return stances, int(early.sum())


_FINE = 0.5
"""Samples follow a motion if the dock that moves most moves by less than this part of the distance
between two docks, in the median: by less than 30 degrees of a flip."""

_GAP = 1.5
"""A time between two samples that is longer than the median by this factor is a gap."""

_RARE = 0.05
"""Larger share of poses that no flip explains is noise, not errors of tracking."""


class _Motion(NamedTuple):
    """The samples of one robot."""

    docks: Reals
    """Centers of docks, shape (S, D, 3)."""

    time: Reals
    """Time of each sample, shape (S,)."""

    stays: Bools
    """Whether some dock stays from a sample to the next, shape (S - 1,)."""


def without_glitches(poses: Poses, assumed: Assumptions) -> tuple[Poses, list[str]]:
    """Leave out poses over time that are errors of tracking, and say so in a note.

    Args:
        poses: Robots, whose docks are known.
        assumed: Limits of contacts, and most samples in a row that are one error.
    """
    samples = poses.samples
    most = assumed.glitch_frames
    if samples is None or most == 0:
        return poses, []
    docks = samples.docks(poses.dock_offset_body)
    still, put = motion_limits(samples, docks, assumed)
    start = np.searchsorted(samples.robot, np.arange(len(poses.robot_id) + 1))
    step = np.linalg.norm(np.diff(docks, axis=0), axis=2)
    same = np.diff(samples.robot) == 0
    stays = step.min(axis=1) <= put
    moving = step.max(axis=1)[same & stays & (step.max(axis=1) > still)]
    arm = _least_distance(poses.dock_offset_body)
    follows = bool(len(moving) and np.median(moving) < _FINE * arm)
    bad = np.zeros(len(docks), np.bool_)
    for first, after in pairwise(start.tolist()):
        motion = _Motion(docks[first:after], samples.time[first:after], stays[first : after - 1])
        bad[first:after] = _between(motion, put, most)
        if follows:
            bad[first:after] |= _at_end(motion, bad[first:after], still, most)
    if bad.mean() > _RARE:
        share = f"{percent(float(bad.mean()))} % of the poses are where no flip leads"
        return poses, [
            f"{share}: they are noisier than the limits of contacts; give a larger --gap"
        ]
    if not bad.any():
        return poses, []
    return _kept(poses, samples, bad), [_note(poses, samples, bad)]


def _least_distance(offset: Reals) -> float:
    """Return the least distance of two docks of a robot; 0 if it has one."""
    if len(offset) <= 1:
        return 0.0
    apart = np.linalg.norm(offset[:, None] - offset, axis=2)
    return float(apart[np.triu_indices(len(offset), 1)].min())


def _between(motion: _Motion, put: float, most: int) -> Bools:
    """Mark samples that a robot leaves for where it was before, shape (S,)."""
    docks = motion.docks
    stays = motion.stays
    is_error = np.zeros(len(docks), np.bool_)
    resume = 0
    for before in np.flatnonzero(~stays).tolist():
        if before < resume:
            continue
        ahead = docks[before + 2 : before + 2 + most]
        back = np.linalg.norm(ahead - docks[before], axis=2).min(axis=1) <= put
        back &= ~stays[before + 1 : before + 1 + len(ahead)]
        if back.any():
            resume = before + 2 + int(back.argmax())
            is_error[before + 1 : resume] = True
    return is_error


def _at_end(motion: _Motion, bad: Bools, still: float, most: int) -> Bools:
    """Mark the last samples if they are not where a robot goes from its rest, shape (S,)."""
    is_error = np.zeros(len(bad), np.bool_)
    kept: Ints = np.flatnonzero(~bad)
    docks = motion.docks[kept]
    time = motion.time[kept]
    tail = np.flatnonzero(~motion.stays)
    tail = tail[tail >= len(bad) - 1 - most]
    # The first jump counts: what follows it within the error may jump on.
    if not len(tail) or bad[tail[0]] or bad[tail[0] + 1]:
        return is_error
    k = int(np.searchsorted(kept, tail[0]))
    if k == 0 or k + 1 >= len(kept):
        return is_error
    rested = np.linalg.norm(docks[k] - docks[k - 1], axis=1).max() <= still
    in_time = time[k + 1] - time[k] <= _GAP * np.median(np.diff(time))
    is_error[tail[0] + 1 :] = rested and in_time
    return is_error


def _kept(poses: Poses, samples: Samples, bad: Bools) -> Poses:
    """Return the poses without bad samples; each robot ends at its last good one."""
    kept = Samples(
        samples.robot[~bad],
        samples.time[~bad],
        samples.position[~bad],
        samples.orientation_wxyz[~bad],
    )
    last = np.searchsorted(kept.robot, np.arange(len(poses.robot_id)), side="right") - 1
    return poses._replace(
        samples=kept,
        position=kept.position[last],
        orientation_wxyz=kept.orientation_wxyz[last],
    )


def _note(poses: Poses, samples: Samples, bad: Bools) -> str:
    """Count the poses that are left out, and name their robots and times."""
    first = np.flatnonzero(bad & ~np.append(False, bad[:-1] & (np.diff(samples.robot) == 0)))
    names = poses.robot_id[samples.robot[first]].tolist()
    places = [
        f"robot {name} at time {time:g}"
        for name, time in zip(names, samples.time[first].tolist(), strict=True)
    ]
    note = f"{counted(int(bad.sum()), 'pose')} left out, {first_names(places)}: "
    return f"{note}no flip about a dock leads there (keep them with --glitch-frames 0)"
