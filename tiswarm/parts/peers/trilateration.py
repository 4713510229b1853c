"""Trilateration: where robots are by rows to others whose centers are known.

A distance puts a robot on a sphere, a coordinate on a plane, a measured vector on three planes.
Their intersection follows in closed form, and then from Gauss-Newton steps weighted by variance.
Lengths in R.
"""

from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.measurements.model import SPACING, Measurements

POINTS = 3
"""Independent linear equations from which on spheres and planes intersect in one or two points."""

INDEPENDENT = 0.03
"""Least singular value of unit rows that counts [1]: three whose directions are within two degrees
of a plane determine a point no better than two do."""

_STEPS = 16
"""Gauss-Newton steps at most; a point that overshot took ten."""

_SETTLED = 1e-9
"""Steps of a point end when one is not longer [R]."""

_DAMPING = 1e-9
"""Damping of a step relative to the information: it stops motions that no row measures."""

_LEAST = 1e-13
"""Part of the largest eigenvalue below which rounding hides others."""

_UP = np.array([0.0, 0.0, 1.0])
_TINY = np.finfo(np.float64).tiny


class Ties(NamedTuple):
    """E rows as one of their robots sees them, sorted by robot; p is its center.

    A sphere has the equation |p - q - shift| = reach, a plane normal . (p - q - shift) = reach,
    with q the center of the partner, or 0 for the world.
    """

    robot: Ints
    """Robot, shape (E,)."""

    partner: Ints
    """Other robot, or N for the world, shape (E,)."""

    shift: Reals
    """From the partner's center to the middle of the sphere, or the origin of the plane [R], shape
    (E, 3)."""

    normal: Reals
    """Unit normal of a plane, 0 of a sphere, shape (E, 3)."""

    reach: Reals
    """Radius of the sphere, or coordinate of the plane [R], shape (E,)."""

    variance: Reals
    """Variance of the row, without that of the partner [R^2], shape (E,)."""

    is_sphere: Bools
    """Whether the row is a sphere, shape (E,)."""

    @classmethod
    def of(cls, rows: Measurements) -> "Ties":
        """List each row of a pair twice, so that each of its robots can be located from the other.

        Each robot has a row of infinite variance, too, so that no sum over its rows is empty.
        """
        d, robots, count = rows.distances, rows.robots, len(rows.other)
        i, j, robot = rows.robot[:count], rows.other, rows.robot[count:]
        shift, variance = rows.other_arm - rows.arm[:count], rows.variance()
        owner = np.concatenate([i, j, robot, np.arange(robots)])
        nothing = np.zeros((robots, 3))
        normal = np.concatenate([np.zeros((len(d.length), 3)), rows.offsets.axis])
        reach = np.concatenate([d.length, np.zeros(len(rows.offsets.axis))])
        sphere = np.arange(count) < len(d.length)
        no_sphere = np.zeros(len(robot) + robots, np.bool_)
        ties = cls(
            robot=owner,
            partner=np.concatenate([j, i, np.full(len(robot) + robots, robots)]),
            shift=np.concatenate([shift, -shift, -rows.arm[count:], nothing]),
            normal=np.concatenate([normal, normal, rows.places.direction, nothing]),
            reach=np.concatenate([reach, reach, rows.places.value, nothing[:, 0]]),
            variance=np.concatenate([variance[:count], variance, np.full(robots, np.inf)]),
            is_sphere=np.concatenate([sphere, sphere, no_sphere]),
        )
        return ties.select(np.argsort(owner, kind="stable"))

    def select(self, chosen: Bools | Ints) -> "Ties":
        """Keep rows, or sort them."""
        return Ties._make(column[chosen] for column in self)


class Trilateration:
    """Rows of n robots whose partners have been placed."""

    def __init__(self, ties: Ties, position: Reals, covariance: Reals) -> None:
        """Look partners up.

        Args:
            ties: Rows.
            position: Center of each robot, and 0 for the world [R], shape (N + 1, 3).
            covariance: Covariance of each [R^2], shape (N + 1, 3, 3).
        """
        self.ties = ties
        is_first = np.diff(ties.robot, prepend=-1) > 0
        self.first = np.flatnonzero(is_first)
        """First row of each robot, shape (n,)."""
        self.of = np.cumsum(is_first) - 1
        """Robot of each row, counted from 0, shape (E,)."""
        self.partner = position[ties.partner]
        """Center of the partner [R], shape (E, 3)."""
        self.middle = self.partner + ties.shift
        """Middle of the sphere, or origin of the plane [R], shape (E, 3)."""
        # A partner's own error is in what its robots measure from it.
        of_partner = covariance[ties.partner]
        along = (ties.normal[:, None] @ of_partner @ ties.normal[:, :, None])[:, 0, 0]
        mean = np.trace(of_partner, axis1=1, axis2=2) / 3.0
        self.precision = 1.0 / (ties.variance + np.where(ties.is_sphere, mean, along))
        """Inverse variance; of the partner's, a sphere has the mean over directions, (E,)."""
        spheres = np.maximum(self.sum(ties.is_sphere), 1.0)
        self.origin = self.sum(ties.is_sphere[:, None] * self.middle) / spheres[:, None]
        """Mean of the middles of spheres [R], shape (n, 3)."""
        away = length(self.middle - self.origin[self.of]) + np.abs(ties.reach)
        farthest = np.maximum.reduceat(away, self.first) + SPACING
        self.bound = farthest[:, None, None] / INDEPENDENT
        """How far from `origin` rows that do not contradict each other meet [R], (n, 1, 1)."""

    def sum(self, values: Reals | Bools) -> Reals:
        """Sum values of rows (E, ...) over those of each robot, shape (n, ...)."""
        total: Reals = np.add.reduceat(values, self.first, axis=0, dtype=np.float64)
        return total

    def rank(self) -> Ints:
        """Count independent linear equations of each robot, shape (n,)."""
        square = np.linalg.eigvalsh(self.sum(outer(self._linear()[0])))
        rank: Ints = (square > INDEPENDENT**2).sum(axis=1)
        return rank

    def _linear(self) -> tuple[Reals, Reals]:
        """Write rows as linear equations of x = p - origin and |x|^2 / D.

        Returns:
            Coefficients, shape (E, 4), and right sides [R], shape (E,).
        """
        ties, is_sphere = self.ties, self.ties.is_sphere
        middle = self.middle - self.origin[self.of]
        radius = np.maximum(ties.reach, SPACING)  # dividing by it makes residuals distances
        on_sphere = 0.5 * (ties.reach**2 - (middle**2).sum(axis=1)) / radius
        on_plane = ties.reach + (ties.normal * middle).sum(axis=1)
        row = np.empty((len(radius), 4))
        row[:, :3] = np.where(is_sphere[:, None], -middle / radius[:, None], ties.normal)
        row[:, 3] = np.where(is_sphere, 0.5 * SPACING / radius, 0.0)
        return row, np.where(is_sphere, on_sphere, on_plane)

    def crossings(self) -> Reals:
        """Intersect the line that the linear equations determine best with a paraboloid, |x|^2.

        Returns:
            Two points of each robot, the upper one first [R], shape (n, 2, 3). They are equal where
            planes alone determine one, or where the line misses the paraboloid. Below the rank
            `POINTS` they have no meaning.
        """
        row, value = self._linear()
        weighted = self.precision[:, None] * row
        square, axis = np.linalg.eigh(self.sum(weighted[:, :, None] * row[:, None]))
        moment = self.sum(weighted * value[:, None])
        floor = _LEAST * square[:, 3:] + _TINY
        share = (moment[:, None] @ axis)[:, 0, 1:] / np.maximum(square[:, 1:], floor)
        foot = (axis[:, :, 1:] @ share[:, :, None])[:, :, 0]
        along = axis[:, :, 0]
        a = (along[:, :3] ** 2).sum(axis=1)
        b = 2.0 * (foot[:, :3] * along[:, :3]).sum(axis=1) - SPACING * along[:, 3]
        c = (foot[:, :3] ** 2).sum(axis=1) - SPACING * foot[:, 3]
        square = b**2 - 4.0 * a * c
        # The usual formula would subtract nearly equal numbers where a or c is small.
        half = -0.5 * (b + np.copysign(np.sqrt(np.maximum(square, 0.0)), b))
        near = np.divide(c, half, out=np.zeros_like(c), where=square > 0.0)
        far = np.divide(half, a, out=near.copy(), where=a > _DAMPING)
        step = np.column_stack([np.where(square > 0.0, near, far), far])[:, :, None]
        offset = foot[:, None, :3] + step * along[:, None, :3]
        point = self.origin[:, None] + self._bounded(offset)
        is_lower = point[:, 0, 2] < point[:, 1, 2]
        return np.where(is_lower[:, None, None], point[:, ::-1], point)

    def residual(self, point: Reals) -> tuple[Reals, Reals]:
        """Compute what points miss rows by.

        Args:
            point: K centers of each robot [R], shape (n, K, 3).

        Returns:
            Derivatives by the point, which are unit vectors, shape (E, K, 3), and residuals [R],
            shape (E, K). At the middle of a sphere the vector is up.
        """
        away = point[self.of] - self.middle[:, None]
        distance = length(away)
        outward = np.where(distance[..., None] > 0.0, unit(away), _UP)
        is_sphere, plane = self.ties.is_sphere[:, None], self.ties.normal[:, None]
        normal = np.where(is_sphere[..., None], outward, plane)
        along = np.where(is_sphere, distance, (away * plane).sum(axis=2))
        return normal, along - self.ties.reach[:, None]

    def descend(self, start: Reals) -> tuple[Reals, Reals]:
        """Take Gauss-Newton steps from K centers of each robot, shape (n, K, 3).

        Returns:
            The best points on the way [R], shape (n, K, 3), and their chi-square, shape (n, K).
        """
        point, best, least = start, start, np.full(start.shape[:2], np.inf)
        is_moving = np.ones(start.shape[:2], np.bool_)  # each by itself, in any batch
        for _ in range(_STEPS):
            normal, residual = self.residual(point)
            pull = self.precision[:, None] * residual
            misfit = self.sum(pull * residual)
            is_better = is_moving & (misfit < least)
            best, least = np.where(is_better[..., None], point, best), np.fmin(misfit, least)
            information = self.sum(self.precision[:, None, None, None] * outer(normal))
            damping = _DAMPING * np.trace(information, axis1=2, axis2=3) + _TINY
            damped = information + damping[..., None, None] * np.eye(3)
            slope = self.sum(pull[..., None] * normal)
            step = self._bounded(np.linalg.solve(damped, slope[..., None])[..., 0])
            is_moving &= length(step) > _SETTLED
            if not is_moving.any():
                break
            point = np.where(is_moving[..., None], point - step, point)
        return best, least

    def _bounded(self, vector: Reals) -> Reals:
        """Shorten vectors (n, K, 3) beyond the bound, which rows in contradiction can lead to."""
        bounded: Reals = vector / np.maximum(length(vector)[..., None] / self.bound, 1.0)
        return bounded

    def covariance(self, point: Reals, prior: Reals, shared: Reals) -> tuple[Reals, Reals]:
        """Compute the covariance of centers, with independent and with equal errors of partners.

        Partners owe their errors to much the same rows, which therefore do not average out.

        Args:
            point: Centers [R], shape (n, 3).
            prior: Information of a prior [R^-2], shape (n,).
            shared: Covariance of each robot's partners, and 0 for the world [R^2], (N + 1, 3, 3).

        Returns:
            Covariance if partners' errors are independent, which rows are weighted by, and if
            partners are off by the same vector [R^2], both of shape (n, 3, 3).
        """
        normal = self.residual(point[:, None])[0][:, 0]
        weighted = self.precision[:, None, None] * outer(normal)
        information = self.sum(weighted)
        least = np.maximum(prior, _LEAST * np.trace(information, axis1=1, axis2=2))
        of_prior = least[:, None, None] * np.eye(3)
        inverse = np.linalg.inv(information + of_prior)
        # Rows of infinite variance have no weight; 0 times infinity would be NaN.
        own = np.where(self.precision > 0.0, self.ties.variance, 0.0) * self.precision
        noise = self.sum(own[:, None, None] * weighted) + of_prior
        is_tied = self.ties.partner < len(shared) - 1
        tied = (self.precision * is_tied)[:, None, None]
        mean = self.sum(tied * shared[self.ties.partner]) / np.maximum(self.sum(tied), _TINY)
        moved = inverse @ self.sum(is_tied[:, None, None] * weighted)
        return inverse, inverse @ noise @ inverse + moved @ mean @ moved.swapaxes(1, 2)

    def open_axes(self, point: Reals, least: Reals) -> Bools:
        """Find coordinates along which rows alone give less than some information [R^-2].

        Args:
            point: Centers [R], shape (n, 3).
            least: Least information along each direction, shape (n,).

        Returns:
            Coordinates, shape (n, 3); at least one where the rank is below `POINTS`.
        """
        normal = self.residual(point[:, None])[0][:, 0]
        information = self.sum(outer(normal) / self.ties.variance[:, None, None])
        square, axis = np.linalg.eigh(information)
        is_open = square < np.maximum(least, _DAMPING * square[:, 2])[:, None]
        is_open[:, 0] |= self.rank() < POINTS
        share = (axis**2 @ is_open[:, :, None])[:, :, 0]
        return np.asarray(share > INDEPENDENT**2)


def length(vector: Reals) -> Reals:
    """Compute the lengths of vectors (..., 3)."""
    square: Reals = (vector**2).sum(axis=-1)
    return np.sqrt(square)


def unit(vector: Reals) -> Reals:
    """Divide vectors (..., 3) by their lengths; 0 stays 0."""
    divisor = length(vector)[..., None]
    return np.divide(vector, divisor, out=np.zeros_like(vector), where=divisor > 0.0)


def outer(vector: Reals) -> Reals:
    """Multiply vectors (..., k) with themselves, shape (..., k, k)."""
    return vector[..., :, None] * vector[..., None, :]
