"""The measurement model: everything that is sensed is a row of one of two tables.

| table | equation |
|---|---|
| `Distances` | |p_i + T_i a - p_j - T_j b| = length |
| `Places` | n . (p + T a) = value |

p are the final centers, a and b arms from them to docks in the world frame, as sensed, and T turns
an arm about the vertical by the robot's yaw correction. Lengths in R.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from tiswarm.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.measurements.odometry import CENTER, Odometry

SPACING = 2.0
"""D: distance between the centers of two docks that touch [R]."""

_AXES = 3


class Distances(NamedTuple):
    """C measured distances of docks or centers; dock a of robot i senses dock b of robot j."""

    stance: Ints
    """Stance of robot i at which its dock was there, shape (C,)."""

    dock: Ints
    """Dock a, or CENTER, shape (C,)."""

    other_stance: Ints
    """Stance of robot j, shape (C,)."""

    other_dock: Ints
    """Dock b, or CENTER, shape (C,)."""

    length: Reals
    """Measured distance [R], shape (C,)."""

    own_variance: Reals
    """Variance of the distance, without noise of orientations [R^2], shape (C,)."""

    is_hinge: Bools
    """Whether only shorter distances count, as for docks that must not overlap, shape (C,)."""

    @classmethod
    def of(
        cls,
        stance: AnyInts,
        dock: AnyInts,
        other_stance: AnyInts,
        other_dock: AnyInts,
        *,
        length: float | Reals,
        sd: float | Reals,
        is_hinge: bool = False,
    ) -> "Distances":
        """Make rows with their length [R] and standard deviation [R], of one kind."""
        rows = len(stance)
        return cls(
            stance=stance.astype(np.int64),
            dock=dock.astype(np.int64),
            other_stance=other_stance.astype(np.int64),
            other_dock=other_dock.astype(np.int64),
            length=np.broadcast_to(length, rows),
            own_variance=np.broadcast_to(np.square(sd), rows),
            is_hinge=np.full(rows, is_hinge),
        )


class Places(NamedTuple):
    """K measured coordinates of docks or centers."""

    stance: Ints
    """Stance at which the point was there, shape (K,)."""

    dock: Ints
    """Dock, or CENTER, shape (K,)."""

    direction: Reals
    """n: unit vector along which the coordinate is measured, shape (K, 3)."""

    value: Reals
    """Measured coordinate [R], shape (K,)."""

    own_variance: Reals
    """Variance of the coordinate, without noise of orientations [R^2], shape (K,)."""

    @classmethod
    def of(
        cls,
        stance: AnyInts,
        dock: AnyInts,
        direction: Reals,
        value: Reals,
        *,
        variance: float | Reals,
    ) -> "Places":
        """Make rows with their variance [R^2]; a value that is not finite makes none."""
        is_known = np.isfinite(value)
        every = cls(
            stance.astype(np.int64),
            dock.astype(np.int64),
            np.broadcast_to(direction, (len(value), _AXES)),
            value,
            np.broadcast_to(variance, len(value)),
        )
        return cls._make(column[is_known] for column in every)


_NO_DISTANCES = Distances.of(*[np.empty(0, np.int64)] * 4, length=SPACING, sd=0.0)
_NO_PLACES = Places.of(
    np.empty(0, np.int64), np.empty(0, np.int64), np.eye(_AXES)[2], np.empty(0), variance=0.0
)


@dataclass(frozen=True, kw_only=True)
class Measurements:
    """Rows of N robots, those of `distances` before those of `places`: E = C + K in all."""

    odometry: Odometry
    """Stances that rows are about."""

    distances: Distances
    places: Places

    robot: Ints
    """Robot of each row, shape (E,)."""

    other: Ints
    """The other robot of each distance, shape (C,)."""

    arm: Reals
    """T = 1: from the robot's final center to its dock [R], shape (E, 3)."""

    other_arm: Reals
    """The same of the other robot, shape (C, 3)."""

    @classmethod
    def gather(
        cls, odometry: Odometry, distances: Sequence[Distances] = (), places: Sequence[Places] = ()
    ) -> "Measurements":
        """Concatenate tables, and look up the robots and arms that they are about."""
        d = Distances(*map(np.concatenate, zip(_NO_DISTANCES, *distances, strict=True)))
        p = Places(*map(np.concatenate, zip(_NO_PLACES, *places, strict=True)))
        stance, dock = np.concatenate([d.stance, p.stance]), np.concatenate([d.dock, p.dock])
        return cls(
            odometry=odometry,
            distances=d,
            places=p,
            robot=odometry.owner[stance],
            other=odometry.owner[d.other_stance],
            arm=odometry.arms(stance, dock)[0],
            other_arm=odometry.arms(d.other_stance, d.other_dock)[0],
        )

    @property
    def robots(self) -> int:
        """N."""
        return len(self.odometry.final)

    def __len__(self) -> int:
        """E."""
        return len(self.robot)

    @property
    def is_contact(self) -> Bools:
        """Which distances are those of docks that touch, shape (C,)."""
        is_contact: Bools = self.distances.dock != CENTER
        return is_contact

    @property
    def sensed_contacts(self) -> Ints:
        """Robot, its stance, own dock or CENTER, other robot and the same of it, shape (C, 5)."""
        d, robot = self.distances, self.robot[: len(self.other)]
        stance = d.stance - self.odometry.first[robot]
        return np.column_stack([robot, stance, d.dock, self.other, d.other_dock])

    @property
    def sensed_places(self) -> Ints:
        """Robot, its stance, and dock or CENTER of each coordinate, shape (K, 3)."""
        p, robot = self.places, self.robot[len(self.other) :]
        return np.column_stack([robot, p.stance - self.odometry.first[robot], p.dock])

    @property
    def own_variance(self) -> Reals:
        """Variance of each row, without noise of orientations [R^2], shape (E,)."""
        return np.concatenate([self.distances.own_variance, self.places.own_variance])

    def select(self, chosen: Bools) -> "Measurements":
        """Keep rows chosen by an array of shape (E,)."""
        distance, place = np.split(chosen, [len(self.other)])
        return replace(
            self,
            distances=Distances._make(column[distance] for column in self.distances),
            places=Places._make(column[place] for column in self.places),
            robot=self.robot[chosen],
            other=self.other[distance],
            arm=self.arm[chosen],
            other_arm=self.other_arm[distance],
        )

    def variance(self) -> Reals:
        """Propagate the noise of orientations to the rows.

        The direction of a distance is unknown before the positions are: its variance is the mean
        over all directions.

        Returns:
            Variance of each row [R^2], shape (E,).
        """
        d, p = self.distances, self.places
        stance, dock = np.concatenate([d.stance, p.stance]), np.concatenate([d.dock, p.dock])
        noise = self.odometry.arms(stance, dock)[1]
        noise[: len(self.other)] += self.odometry.arms(d.other_stance, d.other_dock)[1]
        every = np.full((len(self.other), _AXES), _AXES**-0.5)
        direction = np.concatenate([every, p.direction])
        variance: Reals = (direction**2 * noise).sum(axis=1) + self.own_variance
        return variance

    def vectors(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute the vectors from the other dock of each distance to its dock.

        Args:
            position: Final centers [R], shape (..., N, 3).
            yaw: Yaw corrections [rad], shape (..., N); 0 if None.

        Returns:
            Vectors [R], shape (..., C, 3).
        """
        i, j = self.robot[: len(self.other)], self.other
        arm = turned(self.arm[: len(j)], None if yaw is None else yaw[..., i])
        its = turned(self.other_arm, None if yaw is None else yaw[..., j])
        apart: Reals = position[..., i, :] + (arm - its) - position[..., j, :]
        return apart

    def points(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute the points whose coordinates `places` measures [R], shape (..., K, 3)."""
        robot = self.robot[len(self.other) :]
        arm = turned(self.arm[len(self.other) :], None if yaw is None else yaw[..., robot])
        points: Reals = position[..., robot, :] + arm
        return points

    def residual(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute what each row's equation is missed by; arguments as in `vectors`.

        Returns:
            Residuals [R], shape (..., E).
        """
        gap = np.linalg.norm(self.vectors(position, yaw), axis=-1) - self.distances.length
        gap = np.where(self.distances.is_hinge, np.minimum(gap, 0.0), gap)
        away = (self.points(position, yaw) * self.places.direction).sum(axis=-1)
        return np.concatenate([gap, away - self.places.value], axis=-1)

    def directions(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute the derivative of each residual by its robot's center, shape (E, 3).

        It is a unit vector, or 0 where docks coincide or a hinge is open.
        """
        apart = self.vectors(position, yaw)
        length = np.linalg.norm(apart, axis=1)
        counts = (length > 0.0) & ~(self.distances.is_hinge & (length >= self.distances.length))
        slope = np.divide(counts, length, out=np.zeros_like(length), where=counts)
        return np.concatenate([slope[:, None] * apart, self.places.direction])

    def jacobian(self, position: Reals, yaw: Reals | None = None) -> csc_array:
        """Compute the derivatives of the residuals; arguments as in `vectors`.

        Returns:
            Derivatives by x, y and z of each center [1], then by each yaw [R], shape (E, 4 N).
        """
        direction = self.directions(position, yaw)
        count, i, j = len(self.other), self.robot, self.other
        arm = turned(self.arm, None if yaw is None else yaw[i])
        its = turned(self.other_arm, None if yaw is None else yaw[j])
        of_turn = direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]
        toward = direction[:count]
        of_its_turn = toward[:, 1] * its[:, 0] - toward[:, 0] * its[:, 1]
        every, axis = np.arange(len(i)), np.arange(_AXES)
        thrice = np.repeat(every, _AXES)
        row = [thrice, thrice[: _AXES * count], every, every[:count]]
        column = [
            (_AXES * i[:, None] + axis).ravel(),
            (_AXES * j[:, None] + axis).ravel(),
            _AXES * self.robots + i,
            _AXES * self.robots + j,
        ]
        value = [direction.ravel(), -toward.ravel(), of_turn, -of_its_turn]
        entries = (np.concatenate(value), (np.concatenate(row), np.concatenate(column)))
        return csc_array(entries, shape=(len(i), (_AXES + 1) * self.robots))


def turned(arm: Reals, yaw: Reals | None) -> Reals:
    """Turn arms about the vertical.

    Args:
        arm: Arms, shape (n, 3).
        yaw: Angles [rad], shape (..., n); 0 if None.

    Returns:
        Arms, shape (..., n, 3).
    """
    if yaw is None:
        return arm
    x, y, z = arm.T
    level = np.exp(1j * yaw) * (x + 1j * y)
    return np.stack([level.real, level.imag, np.broadcast_to(z, level.shape)], axis=-1)
