"""Segments of the recorded motion of a robot: rests and flips, and the noise of its poses.

At a rest, all poses are one but for noise. During a flip, one dock, the pivot, stays where it is,
and orientations turn about one axis: as unit quaternions they lie in one plane through the origin.
So each stretch of samples has a misfit as a rest, and one as a flip about each dock, in chi-square.
We choose the segments whose sum of misfits and penalties is least, exactly, by dynamic programming
over change points (Killick et al., "Optimal detection of changepoints with a linear computational
cost", JASA 2012). A penalty is what the further parameters of a segment must gain: about two
log-likelihoods of a parameter that some dozens of samples determine.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.poses import Samples

REST = -1
"""In place of the pivot of a flip."""

_LEAST = 1e-4
"""Noise of positions below this [dock radii], and of orientations [rad], counts as this much."""

_LOUDEST = 0.06
"""Largest noise of a position [dock radii]; greater scatter is motion."""

_PLAY = 0.005
"""How far a pivot gives way during a flip, 1 sd [dock radii]."""

_PLAY_OF_AXIS = 0.003
"""How far the axis of a flip turns, 1 sd [rad]."""

_SHARED = 3.0
"""Variance of the misfits of a flip, per variance of each: both have the noise of orientations, so
that their sum varies by more than one of independent parts."""

_STIFF = 0.001
"""Play of pivots [dock radii] and axes [rad] where poses have no noise, as of simulators."""

_OF_REST = 20.0
"""Penalty of a rest: six parameters."""

_OF_FLIP = 20.0
"""Penalty of a flip: place of the pivot, direction of the axis, choice of a dock."""

_OF_ANGLE = 3.0
"""Penalty of each sample of a flip, whose angle is free, beside what a rest has of noise."""

_OF_CORNER = 10.0
"""Further penalty where flips meet without a sample at rest."""

_OF_BREAK = 150.0
"""Penalty where poses of two neighboring segments do not meet: something was not recorded."""

_SAME = 16.0
"""Chi-square, of six degrees of freedom, up to which two blocks of samples join in one."""

_LONGEST_BLOCK = 64
"""Most samples of a block."""

_SMALL = 0.12
"""Least step of a dock, from a sample to the next, that may be a whole flip [dock radii]."""

_SDS_OF_STEP = 5.0
"""Largest step of a dock that noise makes, in standard deviations of one coordinate of a step."""

_FEWEST_TO_TURN = 3
"""Fewest samples of a flip that turns back."""

_SDS_OF_TURN = 6.0
"""Least angle by which a flip turns back, in standard deviations."""

_SDS_OF_LEVEL = 4.0
"""Angle from the point of return within which a robot rests there, in standard deviations."""

_PART_AT_ENDS = 6
"""Part of the samples of a rest, at each end, that may be in slow motion already."""

_ROUNDS = 3
"""Most times that segments are chosen, with the noise that the last ones have."""

_ABOUT = 0.2
"""Noise is as assumed if it differs by less than this part."""

_FEWEST_FREE = 10
"""Fewest samples, beside the first of each rest, that state a noise."""

_UNUSUAL = 4.0
"""Variance of a rest, per median of all, from which on it does not count."""

_LONG_GAP = 5.0
"""A time between samples that is longer than the median by this factor is a gap."""

_FEW = 0.25
"""Part of steps between samples that robots at rest make, at least."""


class Noise(NamedTuple):
    """Standard deviations of recorded poses."""

    position: float  # of each coordinate of a center
    tilt: float  # of an orientation about each horizontal axis [rad]
    yaw: float  # of an orientation about the vertical [rad]

    @property
    def turn(self) -> float:
        """Standard deviation of an orientation about each axis, in the mean [rad]."""
        return float(np.sqrt((2.0 * self.tilt**2 + self.yaw**2) / 3.0))

    def of_docks(self, offset: Reals) -> float:
        """Standard deviation of each coordinate of the dock that is farthest from the center.

        Noise of an orientation moves a dock in two of three directions.
        """
        reach = float(np.linalg.norm(offset, axis=1).max(initial=0.0))
        return float(np.sqrt(self.position**2 + 2.0 / 3.0 * (self.turn * reach) ** 2))


class Segment(NamedTuple):
    """Samples of one rest or one flip."""

    first: int
    after: int
    pivot: int  # dock that stays, or REST


def rough_noise(samples: Samples, dock_radius: float) -> Noise:
    """Estimate noise before rests are known; 0 where robots never seem to rest.

    We compare the lower quartile of steps between samples, and of second differences, with what
    noise alone would give: steps of rests are noise, and so are second differences of slow motion.
    """
    turn = Rotation.from_quat(samples.orientation_wxyz, scalar_first=True)
    same = np.diff(samples.robot) == 0
    step = np.diff(samples.position, axis=0)[same]
    if not len(step):
        return Noise(0.0, 0.0, 0.0)
    swing = (turn[1:] * turn[:-1].inv()).as_rotvec()[same]
    following = (np.diff(samples.robot)[1:] == 0)[same[:-1]]
    quartile = float(np.sqrt(chi2.ppf(_FEW, 3)))
    sizes = []
    for first in (step, swing):
        second = np.linalg.norm(np.diff(first, axis=0), axis=1)[following[: len(first) - 1]]
        by_step = np.quantile(np.linalg.norm(first, axis=1), _FEW) / np.sqrt(2.0)
        by_second = np.quantile(second, _FEW) / np.sqrt(6.0) if len(second) else np.inf
        sizes.append(float(min(by_step, by_second)) / quartile)
    if sizes[0] > _LOUDEST * dock_radius:
        return Noise(0.0, 0.0, 0.0)
    return Noise(sizes[0], sizes[1], sizes[1])


def has_noise(samples: Samples, dock_radius: float) -> bool:
    """Whether poses of robots at rest scatter by more than rounding."""
    noise = rough_noise(samples, dock_radius)
    return noise.position > _LEAST * dock_radius or noise.turn > _LEAST


class _Blocks:
    """Sums over the first blocks of samples of a robot, from which misfits of any stretch follow.

    A block is a few samples in a row that differ by noise alone.
    """

    def __init__(self, track: Samples, offset: Reals, noise: Noise, dock_radius: float) -> None:
        center = track.position - track.position.mean(axis=0)
        wxyz = track.orientation_wxyz * _signs(track.orientation_wxyz)[:, None]
        docks = center[:, None] + dock_offsets(wxyz, offset)
        position = max(noise.position, _LEAST * dock_radius)
        turn = max(noise.turn, _LEAST)
        reach = np.linalg.norm(offset, axis=1)
        # Noise of an orientation moves a dock in two of three directions.
        self.dock_variance = position**2 + 2.0 / 3.0 * (turn * reach) ** 2
        play = min(_STIFF * dock_radius + noise.position, _PLAY * dock_radius)
        self.pivot_variance = _SHARED * self.dock_variance + play**2
        # A unit quaternion turns by half of the angle.
        play_of_axis = min(_STIFF + noise.turn, _PLAY_OF_AXIS)
        self.axis_variance = 0.25 * (_SHARED * turn**2 + play_of_axis**2)
        # What noise alone makes of the misfit of a sample: of a rest, six; of a flip, less.
        of_flip = 3.0 * self.dock_variance / self.pivot_variance
        of_flip += 0.5 * turn**2 / self.axis_variance
        self.angle_penalty = _OF_ANGLE + 6.0 - of_flip
        pose = np.column_stack([center / position, 2.0 * wxyz / turn])
        self.edge = _block_edges(pose)
        self.pose = _summed(pose)
        self.pose_square = _summed((pose**2).sum(axis=1))
        self.wxyz_square = _summed(np.einsum("ni,nj->nij", wxyz, wxyz))
        self.docks = _summed(docks)
        self.docks_square = _summed((docks**2).sum(axis=2))
        self.is_gap = gaps(track.time)
        farthest = np.linalg.norm(np.diff(docks, axis=0), axis=2).max(axis=1)
        noise_step = _SDS_OF_STEP * float(np.sqrt(2.0 * self.dock_variance.max()))
        self.creeps = ~self.is_gap & (farthest < max(_SMALL * dock_radius, noise_step))

    def misfit_of_rest(self, first: Ints, after: int) -> Reals:
        """Compute the chi-square of samples from each of `first`, as a rest."""
        number = after - first
        total = self.pose[after] - self.pose[first]
        result: Reals = (
            self.pose_square[after] - self.pose_square[first] - (total**2).sum(axis=1) / number
        )
        return result

    def misfit_of_pivots(self, first: Ints, after: Ints | int) -> Reals:
        """Compute the chi-square of the place of each dock, shape (n, docks)."""
        number = (after - first)[:, None]
        total = self.docks[after] - self.docks[first]
        square = self.docks_square[after] - self.docks_square[first]
        scatter = square - (total**2).sum(axis=2) / number
        result: Reals = np.maximum(scatter, 0.0) / self.pivot_variance
        return result

    def misfit_of_axis(self, first: Ints, after: int) -> Reals:
        """Compute the chi-square of orientations about one axis."""
        return _out_of_plane(self.wxyz_square[after] - self.wxyz_square[first]) / self.axis_variance


def _signs(wxyz: Reals) -> Reals:
    """Return the signs by which neighbors of quaternions are on one side, shape (S,)."""
    flips = np.where((wxyz[1:] * wxyz[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.concatenate([[1.0], np.cumprod(flips)])


def _summed(values: Reals) -> Reals:
    """Sum values over the first samples; none first."""
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def _out_of_plane(square: Reals) -> Reals:
    """Sum the two least eigenvalues of symmetric matrices, (n, 4, 4)."""
    result: Reals = np.maximum(np.linalg.eigvalsh(square)[:, :2].sum(axis=1), 0.0)
    return result


def _block_edges(pose: Reals) -> Ints:
    """Return the first sample of each block, and the number of samples.

    Args:
        pose: Coordinates of poses, whose noise has a standard deviation of 1, shape (S, 7).
    """
    edges = np.arange(len(pose) + 1)
    total = _summed(pose)
    length = 1
    while length < _LONGEST_BLOCK and len(edges) > 2:  # noqa: PLR2004 - a pair of blocks
        first = edges[:-1]
        number = np.diff(edges)
        mean = (total[edges[1:]] - total[first]) / number[:, None]
        apart = (np.diff(mean, axis=0) ** 2).sum(axis=1)
        weight = number[1:] * number[:-1] / (number[1:] + number[:-1])
        full = (number[1:] == length) & (number[:-1] == length)
        joins = full & (weight * apart <= _SAME)
        # Pairs must not overlap: of a chain of pairs, the first, third, ... join.
        place = np.arange(len(joins)) - np.maximum.accumulate(
            np.where(joins, -1, np.arange(len(joins)))
        )
        chosen = joins & (place % 2 == 1)
        if not chosen.any():
            break
        edges = np.delete(edges, np.flatnonzero(chosen) + 1)
        length *= 2
    return edges


def segments(track: Samples, offset: Reals, noise: Noise, dock_radius: float) -> list[Segment]:
    """Divide the samples of one robot into rests and flips.

    Args:
        track: Samples of one robot.
        offset: Center to dock, shape (D, 3).
        noise: Noise of poses.
        dock_radius: Radius of a dock sphere.
    """
    blocks = _Blocks(track, offset, noise, dock_radius)
    edge = blocks.edge
    count = len(edge) - 1
    docks = len(offset)
    kinds = docks + 1  # a flip about each dock, and last a rest
    cost = np.full((count + 1, kinds), np.inf)
    start = np.zeros((count + 1, kinds), np.int64)
    # Cheapest way to begin a segment of each kind at each block, and the kind of that before.
    opening = np.full((count + 1, kinds), np.inf)
    opened_by = np.full((count + 1, kinds), -1)
    # A recording may begin and end in a flip, but a rest is likelier.
    opening[0, :docks] = _OF_REST + _OF_FLIP
    opening[0, docks] = _OF_REST
    active: list[Ints] = [np.zeros(1, np.int64) for _ in range(2)]  # of flips, and of rests
    for end in range(1, count + 1):
        after = int(edge[end])
        rests = active[1]
        value = opening[rests, docks] + blocks.misfit_of_rest(edge[rests], after)
        best = int(value.argmin())
        cost[end, docks] = value[best]
        start[end, docks] = rests[best]
        flips = active[0]
        misfit = _misfit_of_pivots(blocks, edge[flips], after)
        flip_value = opening[flips, :docks] + misfit
        least = float(min(cost[end, docks], flip_value.min()))
        worth = (flip_value < least + _OF_FLIP + _OF_CORNER).any(axis=1)
        flips = flips[worth]
        flip_value = flip_value[worth]
        if len(flips):
            flip_value += _misfit_of_axis(blocks, edge[flips], after)[:, None]
            best_flip = flip_value.argmin(axis=0)
            cost[end, :docks] = flip_value[best_flip, np.arange(docks)]
            start[end, :docks] = flips[best_flip]
        least = float(cost[end].min())
        slack = _OF_FLIP + _OF_REST + _OF_BREAK
        active[0] = np.append(flips[(flip_value < least + slack).any(axis=1)], end)
        active[1] = np.append(rests[value < least + slack], end)
        if end < count:
            _open(blocks, end, cost, opening, opened_by)
    cost[count, :docks] += _OF_REST
    divided = []
    for segment in _traced(edge, cost, start, opened_by):
        divided += [segment] if segment.pivot == REST else _at_reversals(track, segment, noise)
    return divided


def _at_reversals(track: Samples, flip: Segment, noise: Noise) -> list[Segment]:
    """Divide a flip where it turns back: the robot rested there.

    Both parts have the same pivot and axis, so that they fit one flip.
    """
    begin = max(flip.first - 1, 0)
    wxyz = track.orientation_wxyz[begin : flip.after + 1]
    if len(wxyz) < _FEWEST_TO_TURN:
        return [flip]
    _, _, axes = np.linalg.svd(wxyz, full_matrices=False)
    # A quaternion turns by half of the angle along the great circle in the plane.
    angle = np.unwrap(2.0 * np.arctan2(wxyz @ axes[1], wxyz @ axes[0]))
    least = _SDS_OF_TURN * (noise.turn + _STIFF)
    level = _SDS_OF_LEVEL * max(noise.turn, _LEAST)
    for sign in (1.0, -1.0):
        high = sign * angle
        top = int(high.argmax())
        if high[top] - max(high[0], high[-1]) > least:
            moves = high < high[top] - level
            before = begin + top - int(moves[: top + 1][::-1].argmax()) + 1
            after = begin + top + int(moves[top:].argmax())
            parts = [Segment(before, after, REST)]
            if before > flip.first:
                parts = _at_reversals(track, Segment(flip.first, before, flip.pivot), noise) + parts
            if after < flip.after:
                parts += _at_reversals(track, Segment(after, flip.after, flip.pivot), noise)
            return parts
    return [flip]


def _misfit_of_pivots(blocks: _Blocks, first: Ints, after: int) -> Reals:
    """Compute what flips from each of `first` cost, without that of the axis, shape (n, docks)."""
    free = (after - first)[:, None] * blocks.angle_penalty
    outer_first, outer_after = _with_neighbors(blocks, first, after)
    joined = blocks.misfit_of_pivots(outer_first, outer_after)
    alone = blocks.misfit_of_pivots(first, after) + _OF_BREAK
    result: Reals = np.minimum(joined, alone) + free
    return result


def _misfit_of_axis(blocks: _Blocks, first: Ints, after: int) -> Reals:
    """Compute the misfit of the axes of flips from each of `first`, shape (n,)."""
    outer_first, outer_after = _with_neighbors(blocks, first, after)
    joined = blocks.misfit_of_axis(outer_first, outer_after)
    return np.minimum(joined, blocks.misfit_of_axis(first, after) + _OF_BREAK)


def _with_neighbors(blocks: _Blocks, first: Ints, after: int) -> tuple[Ints, int]:
    """Add the samples beside flips, which belong to them, too, unless something was not recorded.

    They are the last and the first sample of the rests before and after.
    """
    last = len(blocks.pose) - 1
    outer_first = np.where((first > 0) & ~blocks.is_gap[first - 1], first - 1, first)
    outer_after = after + 1 if after < last and not blocks.is_gap[after - 1] else after
    return outer_first, outer_after


def _open(blocks: _Blocks, end: int, cost: Reals, opening: Reals, opened_by: Ints) -> None:
    """Find how segments of each kind best begin at a block."""
    docks = cost.shape[1] - 1
    rest = cost[end, docks]
    flip = int(cost[end, :docks].argmin())
    after_flip = cost[end, flip]
    # A flip without a recorded sample leads from a rest to a rest.
    first, middle, after = blocks.edge[end - 1 : end + 2].tolist()
    number = np.array([middle - first, after - middle])
    mean = (blocks.docks[[middle, after]] - blocks.docks[[first, middle]]) / number[:, None, None]
    moved = (np.diff(mean, axis=0)[0] ** 2).sum(axis=1)
    misfit = float((moved / (blocks.pivot_variance * (1.0 / number).sum())).min())
    after_rest = rest + _OF_FLIP + min(misfit, _OF_BREAK)
    if blocks.creeps[middle - 1]:
        after_rest += _OF_BREAK
    if after_flip <= after_rest:
        opening[end, docks] = after_flip + _OF_REST
        opened_by[end, docks] = flip
    else:
        opening[end, docks] = after_rest + _OF_REST
        opened_by[end, docks] = docks
    by_flip = after_flip + _OF_REST + _OF_CORNER
    opening[end, :docks] = min(rest, by_flip) + _OF_FLIP
    opened_by[end, :docks] = docks if rest <= by_flip else flip


def _traced(edge: Ints, cost: Reals, start: Ints, opened_by: Ints) -> list[Segment]:
    """Follow the choices from the last block back to the first."""
    docks = cost.shape[1] - 1
    end = len(cost) - 1
    kind = int(cost[end].argmin())
    backward = []
    while end > 0:
        first = int(start[end, kind])
        backward.append(Segment(int(edge[first]), int(edge[end]), REST if kind == docks else kind))
        kind = int(opened_by[first, kind])
        end = first
    return backward[::-1]


def gaps(time: Reals) -> Bools:
    """Whether poses are lost between each sample and the next, shape (S - 1,)."""
    step = np.diff(time)
    is_gap: Bools = step > _LONG_GAP * np.median(step) if len(step) else step > 0.0
    return is_gap


def middle(first: int, after: int, last: int) -> slice:
    """Return the samples of a rest without those at its ends, which may be in slow motion already.

    Args:
        first: First sample of the rest.
        after: Sample after its last one.
        last: Sample after the last one of the robot.
    """
    part = (after - first) // _PART_AT_ENDS
    return slice(first + part * (first > 0), after - part * (after < last))


def tracks(samples: Samples) -> list[Samples]:
    """Return the samples of each robot."""
    start = np.searchsorted(samples.robot, np.arange(int(samples.robot[-1]) + 2))
    return [
        Samples(
            samples.robot[first:after],
            samples.time[first:after],
            samples.position[first:after],
            samples.orientation_wxyz[first:after],
        )
        for first, after in pairwise(start.tolist())
    ]


def divide(
    samples: Samples, offset: Reals, dock_radius: float
) -> tuple[list[list[Segment]], Noise | None]:
    """Divide the samples of all robots into rests and flips, whose scatter is the noise.

    Args:
        samples: Poses over time.
        offset: Center to dock, shape (D, 3).
        dock_radius: Radius of a dock sphere.

    Returns:
        Segments of each robot, and noise; None if too few rests have several samples.
    """
    noise = rough_noise(samples, dock_radius)
    robots = tracks(samples)
    for _ in range(_ROUNDS):
        divided = [segments(track, offset, noise, dock_radius) for track in robots]
        measured = _scatter(robots, divided)
        if measured is None or _is_near(measured, noise, dock_radius):
            break
        noise = measured
    return divided, measured


def _is_near(noise: Noise, assumed: Noise, dock_radius: float) -> bool:
    """Whether noise was measured about as it was assumed, or is least."""
    pairs = [
        (noise.position / dock_radius, assumed.position / dock_radius),
        (noise.turn, assumed.turn),
    ]
    return all(abs(one - two) <= _ABOUT * two or max(one, two) <= _LEAST for one, two in pairs)


def _scatter(robots: list[Samples], divided: list[list[Segment]]) -> Noise | None:
    """Measure the noise of poses within rests; None if too few have several samples."""
    squares = []
    freedom = []
    for track, parts in zip(robots, divided, strict=True):
        last = len(track.time)
        for first, after, pivot in parts:
            rows = middle(first, after, last)
            number = rows.stop - rows.start
            if pivot != REST or number < 2:  # noqa: PLR2004 - one has no scatter
                continue
            turn = Rotation.from_quat(track.orientation_wxyz[rows], scalar_first=True)
            swing = (turn * turn.mean().inv()).as_rotvec()
            center = track.position[rows]
            squares.append(
                [
                    ((center - center.mean(axis=0)) ** 2).sum() / 3.0,
                    (swing[:, :2] ** 2).sum() / 2.0,
                    (swing[:, 2] ** 2).sum(),
                ]
            )
            freedom.append(number - 1)
    if sum(freedom) < _FEWEST_FREE:
        return None
    weight = np.array(freedom, float)
    variance = np.array(squares) / weight[:, None]
    # Rests that are none, as in slow motion, scatter by far more.
    order = np.argsort(variance, axis=0)
    share = np.cumsum(weight[order], axis=0) / weight.sum()
    median = variance[order[(share >= 0.5).argmax(axis=0), range(3)], range(3)]  # noqa: PLR2004
    usual = (variance <= _UNUSUAL * median + np.finfo(float).tiny).all(axis=1)
    pooled = (weight[usual, None] * variance[usual]).sum(axis=0) / weight[usual].sum()
    return Noise(*np.sqrt(pooled).tolist())
