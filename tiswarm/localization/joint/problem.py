"""What the annealer works on: measured distances, and measured coordinates of the robots.

Coordinates along x, y and z are measured independently; of several measurements of a coordinate,
the most precise one counts, but all fixes do. Lengths in R.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tiswarm.aliases import Bools, Ints, Reals
from tiswarm.localization.joint.planes import Planes, fixed_planes
from tiswarm.localization.params import ChiSquareParams
from tiswarm.measurements.consistency import ALLOWED_SD, inconsistent_places
from tiswarm.measurements.contacts import parts, reach, untied_directions
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import Odometry
from tiswarm.measurements.orientations import (
    ASSUMED,
    Connections,
    connections_of,
    with_orientations,
)
from tiswarm.records.sensing_log import SensingLog

_PERPENDICULAR = 1e-6
"""Cosine below which a direction has no part along an axis, or along another one."""

_FLAT = 1e-12
"""Part of the greatest precision below which nothing is measured along a direction."""

_CLEARANCE = 10.0
"""Least distance between parts of the contact graph that no measurement ties to each other [R]:
more than docks of two robots that could overlap."""


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

    place: Reals
    """Measured centers [R], with their walks, see `walk`, shape (N, 3)."""

    precision: Reals
    """Precision of each coordinate, 0 where nothing measures it [R^-2], shape (N, 3)."""

    walk: Reals
    """Part of `place` which turns with the robot, x and y to be subtracted; 0 where yaw is taken as
    sensed [R], shape (N, 2)."""

    loose: Reals
    """Projector onto directions in which no measurement ties a robot's part to the anchor, (N, 3,
    3). The first robot of such a part is held at a place of its own, far from all other parts."""

    part: NDArray[np.int32]
    """Connected part of the contact graph that each robot is in, shape (N,)."""

    fixes: Planes
    """Coordinates that were fixed, in any direction; all of a robot count."""

    connections: Connections | None
    """What the orientations were chained by; None where they were sensed."""

    yaw_precision: float
    """Precision of a bias of yaw that is solved for [rad^-2], 0 if none is."""

    @property
    def untied(self) -> Bools:
        """Robots of parts that nothing ties to the world, shape (N,)."""
        is_untied: Bools = np.any(self.loose, axis=(1, 2))
        return is_untied

    @property
    def unobserved(self) -> Bools:
        """Coordinates that nothing ties to the anchor, shape (N, 3)."""
        is_loose: Bools = np.diagonal(self.loose, axis1=1, axis2=2) > 1.0 - _PERPENDICULAR
        return is_loose

    @property
    def link(self) -> Ints:
        """First row of each link, shape (C,)."""
        distances, rows = len(self.rows.distances.stance), len(self.rows.other)
        return np.concatenate([np.arange(distances), np.arange(distances, rows, 3)])

    @property
    def is_offset(self) -> Bools:
        """Which links are offsets, shape (C,)."""
        is_offset: Bools = self.link >= len(self.rows.distances.stance)
        return is_offset

    @property
    def is_touch(self) -> Bools:
        """Which links are touches, shape (C,)."""
        return np.isin(self.link, self.rows.touch)

    @property
    def touch_arms(self) -> Reals:
        """Arms of the docks that may be those of each touch, and the others [R], (T, docks, 6)."""
        (own, _), (its, _) = self.rows.touch_arms
        return np.concatenate([own, its], axis=2)

    @property
    def robot(self) -> Ints:
        """Robot that sensed each link, shape (C,)."""
        return self.rows.robot[self.link]

    @property
    def other(self) -> Ints:
        """Robot that it sensed, which joined earlier, shape (C,)."""
        return self.rows.other[self.link]

    @property
    def pair(self) -> Ints:
        """Robots of each link, shape (C, 2)."""
        return np.column_stack([self.robot, self.other])

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
        shift: Reals = self.rows.arm[self.link] - self.rows.other_arm[self.link]
        return shift

    @property
    def lever(self) -> Reals:
        """Horizontal arms, the robot's x and y with its vector, and the other's [R], (C, 4)."""
        own, its = self.rows.arm[self.link], self.rows.other_arm[self.link]
        return np.column_stack([own[:, :2], its[:, :2]])

    def by_link(self, square: Reals) -> Reals:
        """Sum squares, shape (..., P), over the rows of each link, shape (..., C)."""
        total: Reals = np.add.reduceat(square, self.link, axis=-1) if square.size else square
        return total

    def any_of_link(self, flag: Bools) -> Bools:
        """Extend flags of rows, shape (P,), to all rows of their links."""
        flagged = self.by_link(flag.astype(np.float64)) > 0.0
        return np.repeat(flagged, np.diff(self.link, append=len(flag)))

    def planes(self) -> Planes:
        """Gather measured coordinates along the axes, and fixes."""
        robots, axis = np.nonzero(self.precision)
        direction = np.eye(3)[axis]
        aligned = Planes(
            robot=robots,
            direction=direction,
            point=direction * self.place[robots],
            precision=self.precision[robots, axis],
            walk=self.walk[robots],
            crowd=np.ones(len(robots)),
        )
        every = Planes.joined([aligned, self.fixes])
        order = np.argsort(every.robot, kind="stable")
        every = Planes._make(column[order] for column in every)
        for robot in np.unique(self.fixes.robot):
            mine = np.flatnonzero(every.robot == robot)
            mine_only = every.direction[mine]
            square = ((mine_only @ (mine_only.T @ mine_only)) * mine_only).sum(axis=1)
            every.crowd[mine] = np.where(square > 1.0 + _PERPENDICULAR, 3.0, 1.0)
        return every

    def sensed_place(self) -> tuple[Reals, Bools]:
        """Compute measured centers, yaw taken as sensed.

        Returns:
            Centers [R], and which coordinates are measured, both of shape (N, 3).
        """
        place: Reals = self.place - np.pad(self.walk, ((0, 0), (0, 1)))
        is_measured = self.precision > 0.0
        planes = self.planes()
        for robot in np.unique(self.fixes.robot):
            mine = planes.robot == robot
            normal, weight = planes.direction[mine], planes.precision[mine]
            away = planes.point[mine] - np.pad(planes.walk[mine], ((0, 0), (0, 1)))
            information = (normal.T * weight) @ normal
            value = (normal.T * weight) @ (normal * away).sum(axis=1)
            inverse = np.linalg.pinv(information, rcond=_FLAT, hermitian=True)
            is_measured[robot] = np.diag(inverse @ information) > 1.0 - _PERPENDICULAR
            place[robot] = inverse @ value
        return place, is_measured

    @property
    def unplaced(self) -> Bools:
        """Axes along which nothing but contacts measures where robots are, shape (3,)."""
        is_held = (self.precision[1:] > 0.0) & ~self.unobserved[1:]
        is_fixed = np.abs(self.fixes.direction) > _PERPENDICULAR
        return np.logical_not(is_held.any(axis=0) | is_fixed.any(axis=0))

    @property
    def underdetermination(self) -> float:
        """Share of unknown coordinates that measurements are too few for (Maxwell count)."""
        count = len(self.rows.other) + np.count_nonzero(self.precision[1:]) + len(self.fixes.robot)
        return max(0.0, 1.0 - count / max(self.place[1:].size, 1))

    @property
    def fewest(self) -> Ints:
        """Final contacts of the robot of each pair that has fewer, at least 1, shape (C,)."""
        count = np.bincount(self.pair[self.is_final].ravel(), minlength=len(self.place))
        fewest: Ints = np.maximum(count[self.pair].min(axis=1), 1)
        return fewest

    def residual(self, position: Reals, yaw: Reals) -> Reals:
        """Compute the residuals of the links.

        Args:
            position: Final centers [R], shape (..., N, 3).
            yaw: Yaw corrections [rad], shape (..., N).

        Returns:
            Distances less what was measured, D for docks that touch, and the components of offsets
            [R], shape (..., P).
        """
        return self.rows.residual(position, yaw)[..., : len(self.rows.other)]

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
            own, its = np.split(self.lever, 2, axis=1)
            level = np.linalg.norm(own, axis=1) + np.linalg.norm(its, axis=1)
            fixed = np.hypot(level, self.shift[:, 2])
        if len(self.rows.touch):
            (own, _), (its, _) = self.rows.touch_arms
            farthest = [np.linalg.norm(arm, axis=2).max(axis=1) for arm in (own, its)]
            fixed[self.is_touch] = farthest[0] + farthest[1]
        variance = self.by_link(self.variance)
        longest = fixed + self.length + ALLOWED_SD * np.sqrt(variance + sigma**2)
        counts = slice(None) if inlier is None else inlier
        return reach(self.pair[counts], longest[counts], self.part)


def pose_problem(log: SensingLog, params: ChiSquareParams) -> Problem:
    """Gather what a log measures, as far as its cues are in use.

    Args:
        log: What was sensed.
        params: Cues, and the precision that the log does not state.
    """
    log = with_orientations(log)
    noise = log.noise or ASSUMED
    bias = np.radians(noise.yaw_bias_deg or 0.0)
    is_solved = params.solve_yaw and bias > 0.0
    odometry = Odometry(log, replace(noise, yaw_bias_deg=0.0) if is_solved else noise)
    precision = Precision(params.contact_sd, params.height_sd, params.spawn_sd)
    cues = [cue for cue in params.cues if cue != "fixes"]
    rows = measure(log, cues, odometry=odometry, precision=precision)
    is_wrong = inconsistent_places(rows) & params.robust
    inconsistent, rows = rows.select(is_wrong), rows.select(~is_wrong)
    rows = rows.select(_most_precise(rows))
    contacts = len(rows.other)
    robot, direction = rows.robot[contacts:], rows.places.direction
    axis = np.abs(direction).argmax(axis=1)
    mine = robot, axis
    variance = rows.variance()
    sign = direction[np.arange(len(axis)), axis]
    place, arm = np.zeros((log.robot_count, 3)), np.zeros((log.robot_count, 3))
    place[mine] = sign * rows.places.value
    arm[mine] = rows.arm[contacts:][np.arange(len(axis)), axis]
    walk = arm[:, :2] if is_solved else np.zeros((log.robot_count, 2))
    weight = np.zeros((log.robot_count, 3))
    weight[mine] = 1.0 / variance[contacts:]
    fixed = measure(log, {*params.cues} & {"fixes"}, odometry=odometry)
    fixed = fixed.select(fixed.robot > 0)
    every_place = [rows.places, fixed.places]
    tables = [rows.distances], every_place, [rows.offsets]
    rows = Measurements.gather(odometry, *tables, shared_sd=rows.shared_sd)
    problem = Problem(
        rows=rows,
        inconsistent=inconsistent,
        variance=variance[:contacts],
        place=place - arm + np.pad(walk, ((0, 0), (0, 1))),
        precision=weight,
        loose=untied_directions(rows),
        walk=walk,
        part=parts(rows),
        fixes=fixed_planes(fixed, is_solved=is_solved),
        connections=None if log.orientation_sd is None else connections_of(log),
        yaw_precision=bias**-2 if is_solved else 0.0,
    )
    return _separated(problem, log.anchor_position / log.dock_radius, params.height_sd)


def _most_precise(rows: Measurements) -> Bools:
    """Choose all distances, and for each coordinate of a robot its most precise measurement.

    Returns:
        Rows that are chosen, shape (E,); none is of the anchor alone.

    Raises:
        ValueError: a coordinate is measured along no axis.
    """
    contacts = len(rows.other)
    robot, direction = rows.robot[contacts:], rows.places.direction
    if np.count_nonzero(direction) > len(direction):
        message = "joint takes coordinates along x, y or z only"
        raise ValueError(message)
    coordinate = 3 * robot + np.abs(direction).argmax(axis=1)
    order = np.lexsort((rows.variance()[contacts:], coordinate))
    order = order[robot[order] > 0]
    _, first = np.unique(coordinate[order], return_index=True)
    chosen = np.arange(len(rows)) < contacts
    chosen[contacts + order[first]] = True
    return chosen


def _separated(problem: Problem, anchor: Reals, sd: float) -> Problem:
    """Hold the first robot of each disconnected part at a place where no other part can be.

    Parts that overlap would push each other, though nothing measures where they are. They stand in
    a row along x.
    """
    first = np.unique(problem.part, return_index=True)[1]
    size = np.zeros(len(first))
    np.maximum.at(size, problem.part, problem.reach())
    first = np.sort(first[problem.untied[first]])
    row = np.r_[0, first]
    width = size[problem.part[row]] + _CLEARANCE
    place, precision = problem.place.copy(), problem.precision.copy()
    middle = anchor[0] + np.cumsum(width[1:] + width[:-1])
    held = [problem.fixes]
    for i, x in zip(first.tolist(), middle.tolist(), strict=True):
        free, target = problem.unobserved[i], np.array([x, anchor[1], anchor[2]])
        place[i, free] = target[free]
        precision[i, free] = sd**-2
        square, axis = np.linalg.eigh(problem.loose[i] - np.diag(free * 1.0))
        oblique = axis.T[np.rint(square) > 0]
        held.append(
            Planes(
                robot=np.full(len(oblique), i),
                direction=oblique,
                point=oblique * (oblique @ target)[:, None],
                precision=np.full(len(oblique), sd**-2),
                walk=np.zeros((len(oblique), 2)),
                crowd=np.ones(len(oblique)),
            )
        )
    return replace(problem, place=place, precision=precision, fixes=Planes.joined(held))
