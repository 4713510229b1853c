"""Planes on which robots were measured to be: all that is known of where they are. Lengths in R."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.measurements.contacts import spans
from tiswarm.measurements.model import Measurements

_PERPENDICULAR = 1e-6
"""Cosine, or squared cosine, below which a direction has no part along another one."""

_FLAT = 1e-12
"""Part of the greatest precision below which nothing is measured along a direction."""


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
        robot, direction = self.robot, self.direction
        point = self.point - np.pad(self.walk, ((0, 0), (0, 1)))
        row, axis = np.arange(len(robot)), np.abs(direction).argmax(axis=1)
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
    links, direction = len(rows.other), rows.places.direction
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
