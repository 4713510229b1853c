"""What the annealer works on: measured distances, and one measured position a robot.

Coordinates along x, y and z are measured independently; of several measurements of a coordinate,
the most precise one counts. Lengths in R.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tiswarm.aliases import Bools, Ints, Reals
from tiswarm.localization.params import JointParams
from tiswarm.measurements.consistency import ALLOWED_SD, inconsistent_places
from tiswarm.measurements.contacts import disconnected, parts, reach
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.measurements.odometry import ASSUMED, Odometry
from tiswarm.records.sensing_log import SensingLog

_CLEARANCE = 10.0
"""Least distance between parts of the contact graph that no measurement ties to each other [R]:
more than docks of two robots that could overlap."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Measurements of one structure of N robots, C of them distances; none is of the anchor."""

    rows: Measurements
    """Measurements that count, E in all."""

    inconsistent: Measurements
    """Coordinates that most others of the same robot contradict; they do not count."""

    variance: Reals
    """Variance of each distance, mean over all directions [R^2], shape (C,)."""

    is_final: Bools
    """Whether the contact is of the final stance, shape (C,)."""

    place: Reals
    """Measured centers [R], with their walks, see `walk`, shape (N, 3)."""

    precision: Reals
    """Precision of each coordinate, 0 where nothing measures it [R^-2], shape (N, 3)."""

    walk: Reals
    """Part of `place` which turns with the robot, x and y to be subtracted; 0 where yaw is taken as
    sensed [R], shape (N, 2)."""

    unobserved: Bools
    """Coordinates of disconnected parts that no measurement ties to the anchor, shape (N, 3). The
    first robot of such a part is held at a place of its own, far from all other parts."""

    part: NDArray[np.int32]
    """Connected part of the contact graph that each robot is in, shape (N,)."""

    untied: Bools
    """Robots of parts that nothing ties to the world, shape (N,)."""

    yaw_precision: float
    """Precision of a bias of yaw that is solved for [rad^-2], 0 if none is."""

    @property
    def robot(self) -> Ints:
        """Robot that sensed each contact, shape (C,)."""
        return self.rows.robot[: len(self.rows.other)]

    @property
    def other(self) -> Ints:
        """Robot that it touched, which joined earlier, shape (C,)."""
        return self.rows.other

    @property
    def pair(self) -> Ints:
        """Robots of each contact, shape (C, 2)."""
        return np.column_stack([self.robot, self.other])

    @property
    def shift(self) -> Reals:
        """Arm of the robot's dock less that of the other's [R], shape (C, 3)."""
        shift: Reals = self.rows.arm[: len(self.other)] - self.rows.other_arm
        return shift

    @property
    def lever(self) -> Reals:
        """Horizontal arms, the robot's x and y and the other's [R], shape (C, 4)."""
        own = self.rows.arm[: len(self.other)]
        return np.column_stack([own[:, :2], self.rows.other_arm[:, :2]])

    @property
    def sensed_place(self) -> Reals:
        """Measured centers, yaw taken as sensed [R], shape (N, 3)."""
        place: Reals = self.place - np.pad(self.walk, ((0, 0), (0, 1)))
        return place

    @property
    def unplaced(self) -> Bools:
        """Axes along which nothing but contacts measures where robots are, shape (3,)."""
        is_held = (self.precision[1:] > 0.0) & ~self.unobserved[1:]
        return np.logical_not(is_held.any(axis=0))

    @property
    def underdetermination(self) -> float:
        """Share of unknown coordinates that measurements are too few for (Maxwell count)."""
        count = len(self.other) + np.count_nonzero(self.precision[1:])
        return max(0.0, 1.0 - count / max(self.place[1:].size, 1))

    @property
    def fewest(self) -> Ints:
        """Final contacts of the robot of each pair that has fewer, at least 1, shape (C,)."""
        count = np.bincount(self.pair[self.is_final].ravel(), minlength=len(self.place))
        fewest: Ints = np.maximum(count[self.pair].min(axis=1), 1)
        return fewest

    def residual(self, position: Reals, yaw: Reals) -> Reals:
        """Compute the residuals of the contacts.

        Args:
            position: Final centers [R], shape (..., N, 3).
            yaw: Yaw corrections [rad], shape (..., N).

        Returns:
            Distance of the docks less D [R], shape (..., C).
        """
        return self.rows.residual(position, yaw)[..., : len(self.other)]

    def reach(self, sigma: float = 0.0, inlier: Bools | None = None) -> Reals:
        """Bound the distance of each robot from the first one of its part.

        With sensed orientations, centers in contact are apart by a fixed vector and a vector of
        length D.

        Args:
            sigma: Standard deviation by which contacts may be missed, beside their noise [R].
            inlier: Contacts that count, shape (C,); all if None.

        Returns:
            Distances [R], shape (N,); infinite where no inliers lead.
        """
        fixed = np.linalg.norm(self.shift, axis=1)
        if self.yaw_precision:  # the horizontal parts of the vector may turn
            own, its = np.split(self.lever, 2, axis=1)
            level = np.linalg.norm(own, axis=1) + np.linalg.norm(its, axis=1)
            fixed = np.hypot(level, self.shift[:, 2])
        longest = fixed + SPACING + ALLOWED_SD * np.sqrt(self.variance + sigma**2)
        counts = slice(None) if inlier is None else inlier
        return reach(self.pair[counts], longest[counts], self.part)


def pose_problem(log: SensingLog, params: JointParams) -> Problem:
    """Gather what a log measures, as far as its cues are in use.

    Args:
        log: What was sensed.
        params: Cues, and the precision that the log does not state.
    """
    noise = log.noise or ASSUMED
    bias = np.radians(noise.yaw_bias_deg or 0.0)
    is_solved = params.solve_yaw and bias > 0.0
    odometry = Odometry(log, replace(noise, yaw_bias_deg=0.0) if is_solved else noise)
    precision = Precision(params.contact_sd, params.height_sd, params.spawn_sd)
    rows = measure(log, params.cues, odometry=odometry, precision=precision)
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
    part, untied = parts(rows), disconnected(rows)
    measured = np.zeros((part.max() + 1, 3), np.bool_)
    np.logical_or.at(measured, part, weight > 0.0)
    problem = Problem(
        rows=rows,
        inconsistent=inconsistent,
        variance=variance[:contacts],
        is_final=rows.distances.stance == odometry.final[rows.robot[:contacts]],
        place=place - arm + np.pad(walk, ((0, 0), (0, 1))),
        precision=weight,
        unobserved=untied[:, None] & ~measured[part],
        walk=walk,
        part=part,
        untied=untied,
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
    for i, x in zip(first.tolist(), middle.tolist(), strict=True):
        free = problem.unobserved[i]
        place[i, free] = np.array([x, anchor[1], anchor[2]])[free]
        precision[i, free] = sd**-2
    return replace(problem, place=place, precision=precision)
