"""What the annealer works on: measured distances, and planes on which robots were measured to be.

Flips and the ground imply coordinates whose errors are related: of those of a robot in one
direction, the most precise one counts. All fixes count. Lengths in R.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.localization.settings import ChiSquareParams
from tiswarm.measurements.contacts import connected_parts, reach, spans, untied_directions
from tiswarm.measurements.cues import Measured, Precision
from tiswarm.measurements.model import ALLOWED_SD, Measurements, are_known, inconsistent_places
from tiswarm.measurements.odometry import (
    ASSUMED,
    Connections,
    Odometry,
    connections_of,
    with_orientations,
)
from tiswarm.records.sensing_log import SensingLog

NO_ROBOTS: Ints = np.empty(0, np.int64)

_MORE_THAN_ANY = 4
"""Directions that the anchor counts as measured in: more than any other robot."""

_MOSTLY = 0.5
"""Part of the axis x that must be loose for parts to stand along it [1]."""

_CLEARANCE = 10.0
"""Least distance between parts of the contact graph that no measurement ties to each other [R]:
more than docks of two robots that could overlap."""

_PERPENDICULAR = 1e-6
"""Cosine, or squared cosine, below which a direction has no part along another one."""

_FLAT = 1e-12
"""Part of the greatest precision below which nothing is measured along a direction."""

_LONGEST_WALK_SD = 1.0
"""Standard deviation of the way from a stance to the final center, beyond which its rows do not
count [R]: half the distance of docks in contact. Their direction is not known, and so no linear
problem is near enough to lead to it."""

DISREGARDED_SD = 1.0
"""Standard deviation of an orientation that does not count, about each axis [rad]: a drift of 3 deg
a stance over a walk of twenty stances."""


class Planes(NamedTuple):
    """P planes on which robots were measured to be; none is of the anchor."""

    robot: Ints
    """Robot of each, shape (P,)."""

    direction: Reals
    """Unit vector perpendicular to it, shape (P, 3)."""

    point: Reals
    """A point of it [R], with the robot's walk, see `walk`, shape (P, 3)."""

    walk: Reals
    """Part of `point` which turns with the robot, x and y to be subtracted; 0 where yaw is taken as
    sensed [R], shape (P, 2)."""

    precision: Reals
    """Precision of the distance from it [R^-2], shape (P,)."""

    def along(self, robots: int) -> Bools:
        """Find the axes along which each of N robots was measured, shape (N, 3)."""
        along = np.zeros((robots, 3), np.bool_)
        np.logical_or.at(along, self.robot, np.abs(self.direction) > _PERPENDICULAR)
        return along

    def rank(self, robots: int) -> Ints:
        """Count the independent directions in which each of N robots was measured, shape (N,)."""
        span = spans(self.robot, self.direction, robots)
        return np.asarray(np.linalg.matrix_rank(span, hermitian=True), np.int64)

    def crowd(self, robots: int) -> Reals:
        """Return 1 where all other planes of the robot are perpendicular, else 3, shape (P,)."""
        of_robot = spans(self.robot, self.direction, robots)[self.robot]
        return np.where(self._square(of_robot) > 1.0 + _PERPENDICULAR, 3.0, 1.0)

    def is_redundant(self, part: NDArray[np.int32]) -> Bools:
        """Find planes without which other planes, or the anchor, still hold the robot's part.

        Without one that is not redundant, nothing holds the part in some direction: no majority of
        measurements can contradict it.

        Args:
            part: Connected part of the contact graph that each robot is in, shape (N,).

        Returns:
            Whether the leverage of each, n^T (sum of n n^T)^+ n over its part, is below 1, (P,).
        """
        of_plane = part[self.robot]
        span = spans(of_plane, self.direction, part.max() + 1)
        # The anchor holds its own part as three measured coordinates would.
        span[part[0]] += np.eye(3)
        inverse = np.asarray(np.linalg.pinv(span, rcond=_FLAT, hermitian=True), np.float64)
        return self._square(inverse[of_plane]) < 1.0 - _PERPENDICULAR

    def centers(self, robots: int) -> tuple[Reals, Bools]:
        """Compute the centers of N robots from their planes, yaw taken as sensed.

        Returns:
            Centers [R], and which coordinates are measured, both of shape (N, 3).
        """
        robot = self.robot
        direction = self.direction
        point = self.point - np.pad(self.walk, ((0, 0), (0, 1)))
        row = np.arange(len(robot))
        axis = np.abs(direction).argmax(axis=1)
        center = np.zeros((robots, 3))
        center[robot, axis] = point[row, axis]  # exact along axes that one plane alone measures
        residual = (direction * (point - center[robot])).sum(axis=1)
        information = spans(robot, direction, robots, self.precision)
        pull = np.zeros((robots, 3))
        np.add.at(pull, robot, direction * (self.precision * residual)[:, None])
        inverse = np.linalg.pinv(information, rcond=_FLAT, hermitian=True)
        center += (inverse @ pull[:, :, None])[:, :, 0]
        share = np.diagonal(inverse @ information, axis1=1, axis2=2)
        return center, share > 1.0 - _PERPENDICULAR

    def _square(self, form: Reals) -> Reals:
        """Evaluate a quadratic form of each plane, shape (P, 3, 3), at its direction, (P,)."""
        value: Reals = np.einsum("pi,pij,pj->p", self.direction, form, self.direction)
        return value


def measured_planes(rows: Measurements, variance: Reals, *, is_solved: bool) -> Planes:
    """Turn measured coordinates into planes; if yaw is solved for, walks turn with the robots.

    Args:
        rows: Measurements, E in all.
        variance: Variance of each [R^2], shape (E,).
        is_solved: Whether yaw is solved for.
    """
    links = len(rows.neighbor)
    direction = rows.places.direction
    arm = rows.arm[links:]
    # A turn about the vertical changes no height: walks of heights need not turn.
    is_level = np.any(direction[:, :2] != 0.0, axis=1, keepdims=True)
    level = arm * np.array([1.0, 1.0, 0.0]) * (is_level & is_solved)
    # The coordinate that would be measured of a center, yaw taken as sensed.
    value = -rows.residual(np.zeros((rows.robots, 3)))[links:] + (direction * level).sum(axis=1)
    return Planes(
        robot=rows.robot[links:],
        direction=direction,
        point=direction * value[:, None],
        walk=level[:, :2],
        precision=1.0 / variance[links:],
    )


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Measurements of one structure of N robots with C links; no coordinate is of the anchor.

    A link is a distance, which has one row, or an offset, which has three.
    """

    rows: Measurements
    """Measurements that count, E in all, P of them of links."""

    inconsistent: Measurements
    """Coordinates that most others of the same robot contradict; they do not count."""

    variance: Reals
    """Variance of each row of a link; of a distance the mean over all directions [R^2], (P,)."""

    planes: Planes
    """Measured coordinates, and made-up ones of parts that `loose` is about."""

    loose: Reals
    """Projector onto directions in which no measurement ties a robot's part to the anchor, (N, 3,
    3). The first robot of such a part is held at a place of its own, far from all other parts."""

    part: NDArray[np.int32]
    """Connected part of the contact graph that each robot is in, shape (N,)."""

    connections: Connections | None
    """What the orientations were chained by; None where they were sensed."""

    yaw_precision: float
    """Precision of a bias of yaw that is solved for [rad^-2], 0 if none is."""

    gone: Ints
    """Robots that have left, whose docks are in nobody's way, shape (G,)."""

    moves: Bools
    """Robots that move, the anchor by its turn alone; all others are constants, shape (N,)."""

    @property
    def is_chained(self) -> bool:
        """Whether robots learned their orientations from their connections."""
        return self.connections is not None and len(self.connections.robot) > 0

    @property
    def is_gone(self) -> Bools:
        """Whether each robot has left, so that its docks are in nobody's way, shape (N,)."""
        return np.isin(np.arange(len(self.part)), self.gone)

    @property
    def is_present(self) -> Bools:
        """Which links are of robots that have not left, shape (C,)."""
        is_present: Bools = np.logical_not(self.is_gone[self.pair].any(axis=1))
        return is_present

    @property
    def known(self) -> Bools:
        """Coordinates that never give way, shape (E,)."""
        return are_known(self.rows.variance(), len(self.rows.neighbor))

    @property
    def untied(self) -> Bools:
        """Robots of parts that nothing ties to the world, shape (N,)."""
        is_untied: Bools = np.any(self.loose, axis=(1, 2))
        return is_untied

    def without(self, outlier: Bools) -> "Problem":
        """Find parts and what holds them where some rows, shape (E,), do not count."""
        if not outlier.any():
            return self
        rows = self.rows.select(~outlier)
        return replace(self, part=connected_parts(rows), loose=untied_directions(rows))

    def averaged(self) -> "Problem":
        """Replace readings of the same quantity by their mean, as precise as one of them.

        Hundreds of springs side by side are stiff at any temperature: chains stay where they
        begin. Ends are moved to the minimum of all readings, which are precise.
        """
        rows = self.rows.averaged(as_precise_as_one=True)
        if len(rows) == len(self.rows):
            return self
        return replace(self, rows=rows, variance=rows.variance()[: len(rows.neighbor)])

    @property
    def link(self) -> Ints:
        """First row of each link, shape (C,)."""
        return self.rows.link

    @property
    def is_offset(self) -> Bools:
        """Which links are offsets: the vector between their docks is measured, shape (C,)."""
        is_offset: Bools = self.link >= len(self.rows.distances.stance)
        return is_offset

    @property
    def is_touch(self) -> Bools:
        """Which links are touches, shape (C,)."""
        return np.isin(self.link, self.rows.touch)

    @property
    def robot(self) -> Ints:
        """Robot that sensed each link, shape (C,)."""
        return self.rows.robot[self.link]

    @property
    def neighbor(self) -> Ints:
        """Robot that it sensed, which joined earlier, shape (C,)."""
        return self.rows.neighbor[self.link]

    @property
    def pair(self) -> Ints:
        """Robots of each link, shape (C, 2)."""
        return np.column_stack([self.robot, self.neighbor])

    @property
    def is_final(self) -> Bools:
        """Which links are contacts of the final stance, shape (C,)."""
        rows = self.rows
        stance = np.concatenate([rows.distances.stance, rows.offsets.stance])
        is_final: Bools = rows.is_contact & (
            stance == rows.odometry.final[rows.odometry.owner[stance]]
        )
        return is_final[self.link]

    @property
    def vector(self) -> Reals:
        """Measured vector from the robot's dock to the other's, 0 of a distance [R], (C, 3)."""
        distances = len(self.rows.distances.stance)
        return np.concatenate([np.zeros((distances, 3)), self.rows.offsets.vector[::3]])

    @property
    def length(self) -> Reals:
        """Measured distance, 0 of an offset [R], shape (C,)."""
        return np.concatenate([self.rows.distances.length, np.zeros(self.is_offset.sum())])

    @property
    def shift(self) -> Reals:
        """Arm of the robot's dock, and its vector, less the arm of the other's [R], (C, 3)."""
        shift: Reals = self.rows.arm[self.link] - self.rows.neighbor_arm[self.link]
        return shift

    @property
    def lever(self) -> Reals:
        """Horizontal arms, the robot's x and y with its vector, and the other's [R], (C, 4)."""
        arm = self.rows.arm[self.link]
        neighbor_arm = self.rows.neighbor_arm[self.link]
        return np.column_stack([arm[:, :2], neighbor_arm[:, :2]])

    def by_link(self, square: Reals) -> Reals:
        """Sum squares, shape (..., P), over the rows of each link, shape (..., C)."""
        total: Reals = np.add.reduceat(square, self.link, axis=-1) if square.size else square
        return total

    def sensed_place(self) -> tuple[Reals, Bools]:
        """Return centers [R] and which coordinates are measured, both (N, 3); `Planes.centers`."""
        return self._sensed_place

    @cached_property
    def _sensed_place(self) -> tuple[Reals, Bools]:
        """Centers as planes say [R], and which coordinates are measured, both of shape (N, 3)."""
        return self.planes.centers(len(self.part))

    @property
    def roots(self) -> Ints:
        """The anchor, and the robots of each other part that most directions were measured of."""
        rank = self.planes.rank(len(self.part))
        rank[0] = _MORE_THAN_ANY
        most = np.zeros_like(rank)
        np.maximum.at(most, self.part, rank)
        return np.flatnonzero(rank == most[self.part])

    @property
    def underdetermination(self) -> float:
        """Share of unknown coordinates that measurements are too few for (Maxwell count)."""
        return max(0.0, 1.0 - len(self.rows) / max(3 * len(self.part) - 3, 1))

    @property
    def fewest(self) -> Ints:
        """Final contacts of the robot of each pair that has fewer, at least 1, shape (C,)."""
        return fewest_contacts(self.pair, self.is_final, len(self.part))

    def residual(self, position: Reals, yaw: Reals) -> Reals:
        """Compute the residuals of the links.

        Args:
            position: Final centers [R], shape (..., N, 3).
            yaw: Yaw corrections [rad], shape (..., N).

        Returns:
            Distances less what was measured, D for docks that touch, and the components of offsets
            [R], shape (..., P).
        """
        return self.rows.residual(position, yaw)[..., : len(self.rows.neighbor)]

    def reach(self, sigma: float = 0.0, inlier: Bools | None = None) -> Reals:
        """Bound the distance of each robot from the first one of its part.

        With sensed orientations, centers in contact are apart by a fixed vector and a vector of
        length D.

        Args:
            sigma: Standard deviation by which links may be missed, beside their noise [R].
            inlier: Links that count, shape (C,); all if None.

        Returns:
            Distances [R], shape (N,); infinite where no inliers lead.
        """
        fixed = np.linalg.norm(self.shift, axis=1)
        if self.yaw_precision:  # the horizontal parts of the vector may turn
            lever, other_lever = np.split(self.lever, 2, axis=1)
            level = np.linalg.norm(lever, axis=1) + np.linalg.norm(other_lever, axis=1)
            fixed = np.hypot(level, self.shift[:, 2])
        if len(self.rows.touch):
            (arms, _), (neighbor_arms, _) = self.rows.touch_arms
            farthest = np.linalg.norm(arms, axis=2).max(axis=1)
            other_farthest = np.linalg.norm(neighbor_arms, axis=2).max(axis=1)
            fixed[self.is_touch] = farthest + other_farthest
        variance = self.by_link(self.variance)
        longest = fixed + self.length + ALLOWED_SD * np.sqrt(variance + sigma**2)
        counts = slice(None) if inlier is None else inlier
        return reach(self.pair[counts], longest[counts], self.part)


def fewest_contacts(pair: Ints, is_final: Bools, robots: int) -> Ints:
    """Count final contacts of the robot of each pair that has fewer, at least 1.

    Args:
        pair: Pairs of N robots, shape (C, 2).
        is_final: Which of them are contacts at final stances, shape (C,).
        robots: N.
    """
    count = np.bincount(pair[is_final].ravel(), minlength=robots)
    fewest: Ints = np.maximum(count[pair].min(axis=1), 1)
    return fewest


def pose_problem(
    log: SensingLog, params: ChiSquareParams, disregarded: Ints = NO_ROBOTS
) -> Problem:
    """Gather what a log measures, as far as its cues are in use.

    Args:
        log: What was sensed.
        params: Cues, and the precision that the log does not state.
        disregarded: Robots whose orientations are hardly known, so that nothing that they sensed
            on their walks counts, shape (K,).
    """
    log = with_orientations(log)
    noise = log.noise or ASSUMED
    bias = np.radians(noise.yaw_bias_deg or 0.0)
    is_solved = params.solve_yaw and bias > 0.0
    odometry = Odometry(log, replace(noise, yaw_bias_deg=0.0) if is_solved else noise)
    if len(disregarded):
        odometry = odometry.widened(disregarded, DISREGARDED_SD)
    rows, inconsistent = chosen_rows(log, params, odometry, disregarded)
    variance = rows.variance()
    problem = Problem(
        rows=rows,
        inconsistent=inconsistent,
        variance=variance[: len(rows.neighbor)],
        planes=measured_planes(rows, variance, is_solved=is_solved),
        loose=untied_directions(rows),
        part=connected_parts(rows),
        connections=None if log.orientation_sd is None else connections_of(log),
        yaw_precision=bias**-2 if is_solved else 0.0,
        gone=log.gone,
        moves=np.ones(rows.robots, np.bool_),
    )
    apart = _separating(problem, log.anchor_position / log.dock_radius, params.height_sd)
    every = zip(problem.planes, apart, strict=True)
    return replace(problem, planes=Planes._make(map(np.concatenate, every)))


def chosen_rows(
    log: SensingLog, params: ChiSquareParams, odometry: Odometry, disregarded: Ints = NO_ROBOTS
) -> tuple[Measurements, Measurements]:
    """Measure a log, and choose the rows that count; arguments as for `pose_problem`.

    Which rows of a robot count depends on its own rows alone.

    Returns:
        Rows that count, and coordinates that most others of the same robot contradict.
    """
    precision = Precision(params.contact_sd, params.height_sd, params.spawn_sd)
    cues = [cue for cue in params.used_cues if cue != "fixes"]
    measured = Measured(log, odometry, precision)
    rows = measured.rows(cues)
    rows = rows.select(has_sure_way(rows))
    if len(disregarded):
        rows = rows.select(~(rows.is_walked & np.isin(rows.robot, disregarded)))
    variance = rows.variance()
    is_wrong = (
        inconsistent_places(rows, variance)
        & params.robust
        & ~are_known(variance, len(rows.neighbor))
    )
    inconsistent = rows.select(is_wrong)
    rows = rows.select(~is_wrong)
    rows = rows.select(_most_precise(rows, variance[~is_wrong]))
    # All fixes of a robot count, unlike other coordinates: none is a repetition of another.
    if not measured.used({*params.used_cues} & {"fixes"}):
        return rows, inconsistent
    fixed = measured.rows({"fixes"})
    fixed = fixed.select(fixed.robot > 0)
    every_place = [rows.places, fixed.places]
    tables = [rows.distances], every_place, [rows.offsets]
    return Measurements.gather(odometry, *tables, shared_sd=rows.shared_sd), inconsistent


def has_sure_way(rows: Measurements) -> Bools:
    """Find rows of stances from which the way to the final center is known well enough, (E,)."""
    return walk_sd(rows) <= _LONGEST_WALK_SD


def walk_sd(rows: Measurements) -> Reals:
    """Compute the sd of the way from the stance of each row to the final center [R], (E,)."""
    return np.asarray(np.sqrt(rows.odometry.walked.sum(axis=1))[rows.stance])


def _most_precise(rows: Measurements, variance: Reals) -> Bools:
    """Choose all links, known coordinates, and the most precise one of a robot in each direction.

    Args:
        rows: Rows to choose from.
        variance: Their variance [R^2], shape (E,).

    Returns:
        Rows that are chosen, shape (E,); none is of the anchor alone.
    """
    contacts = len(rows.neighbor)
    coordinate = np.column_stack([rows.robot[contacts:], rows.places.direction])
    _, group = np.unique(coordinate, axis=0, return_inverse=True)
    # By group, then by variance: the first of each group is the most precise.
    order = np.lexsort((variance[contacts:], group))
    _, first = np.unique(group[order], return_index=True)
    chosen = np.arange(len(rows)) < contacts
    chosen[contacts + order[first]] = True
    chosen |= are_known(variance, contacts)
    chosen[contacts:] &= rows.robot[contacts:] > 0
    return chosen


def _separating(problem: Problem, anchor: Reals, sd: float) -> Planes:
    """Make up coordinates that hold disconnected parts where no other part can be.

    Parts that overlap would push each other, though nothing measures where they are. Their first
    robots stand in a row along x, or along the direction that nothing measures.
    """
    part = problem.part
    first = np.unique(part, return_index=True)[1]
    size = np.zeros(len(first))
    np.maximum.at(size, part, problem.reach())
    first = np.sort(first[problem.untied[first]])
    # As wide as the longest chain of contacts from the first robot, in either direction.
    width = size[part[np.r_[0, first]]] + _CLEARANCE
    is_loose, axis = np.linalg.eigh(problem.loose[first])
    along_x = problem.loose[first][:, 0]
    way = np.where(along_x[:, :1] > _MOSTLY, along_x, axis[:, :, 2])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    target = anchor + np.cumsum(width[1:] + width[:-1])[:, None] * way
    # Eigenvalues of a projector are 0 and 1, but for rounding.
    which, column = np.nonzero(np.rint(is_loose))
    direction = axis[which, :, column]
    return Planes(
        robot=first[which],
        direction=direction,
        point=direction * (direction * target[which]).sum(axis=1, keepdims=True),
        walk=np.zeros((len(which), 2)),
        precision=np.full(len(which), sd**-2),
    )
