"""The measurement model: everything that is sensed is a row of one of three tables.

| table | equation |
|---|---|
| `Distances` | |p_i + T_i a - p_j - T_j b| = length |
| `Offsets` | T_i n . (p_i + T_i (a + v) - p_j - T_j b) = 0 |
| `Coordinates` | n . (p + T a) = value |

p are the final centers, a and b arms from them to docks in the world frame, as sensed, and T turns
an arm about the vertical by the robot's yaw correction. Lengths in R.

A touch is a distance of docks, one or both UNKNOWN. It is that of the two docks, among all
that they may be, whose distance is nearest to what was measured.

Rows may have a source, such as a plane of a lighthouse: one error, added to the measured length or
value, is then in all rows of the source. Beside it each row has errors of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.measurements.equations import (
    AXES,
    components,
    missed_along,
    missed_distance,
    slope_by_turn,
)
from tiswarm.measurements.odometry import CENTER, UNKNOWN, Odometry
from tiswarm.records.sensing_log import KNOWN_SD

SPACING = 2.0
"""D: distance between the centers of two docks that touch [R]."""

ALLOWED_SD = 4.0
"""Standard deviations that noise may explain."""

_MOST_PAIRS = 4_000_000
"""Pairs of coordinates that are compared; of more than 2,000, a sample is compared with all."""

KNOWN = KNOWN_SD**2 * (1.0 + 1e-9)
"""Variance of a coordinate up to which it never gives way, as that of an anchor [R^2]."""


class Distances(NamedTuple):
    """C measured distances of docks or centers; dock a of robot i senses dock b of robot j."""

    stance: Ints
    """Stance of robot i at which its dock was there, shape (C,)."""

    dock: Ints
    """Dock a, CENTER or UNKNOWN, shape (C,)."""

    other_stance: Ints
    """Stance of robot j, shape (C,)."""

    other_dock: Ints
    """Dock b, CENTER or UNKNOWN, shape (C,)."""

    length: Reals
    """Measured distance [R], shape (C,)."""

    own_variance: Reals
    """Variance of the distance, without noise of orientations and without what its source has in
    common [R^2], shape (C,)."""

    is_hinge: Bools
    """Whether only shorter distances count, as for docks that must not overlap, shape (C,)."""

    source: Ints
    """Source of the distance, -1 for none, shape (C,)."""

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
        source: int | AnyInts = -1,
    ) -> "Distances":
        """Make rows with their length [R], own standard deviation [R] and source, of one kind."""
        rows = len(stance)
        i, a, j, b = np.stack([stance, dock, other_stance, other_dock]).astype(np.int64)
        return cls(
            i, a, j, b,
            length=np.broadcast_to(length, rows),
            own_variance=np.broadcast_to(np.square(sd), rows),
            is_hinge=np.full(rows, is_hinge),
            source=np.broadcast_to(source, rows),
        )  # fmt: skip


class Offsets(NamedTuple):
    """O components of measured vectors from dock a of robot i to dock b of robot j.

    Each vector has three rows, in a row: along it and along two axes across. These axes turn with
    robot i, so that their variances stay independent.
    """

    stance: Ints
    """Stance of robot i at which it measured the vector, shape (O,)."""

    dock: Ints
    """Dock a, or CENTER, shape (O,)."""

    other_stance: Ints
    """Stance of robot j, shape (O,)."""

    other_dock: Ints
    """Dock b, or CENTER, shape (O,)."""

    vector: Reals
    """v: measured vector in the world frame, as sensed [R], shape (O, 3)."""

    axis: Reals
    """n: unit vector along which the row measures, as sensed, shape (O, 3)."""

    own_variance: Reals
    """Variance of the component, without noise of orientations [R^2], shape (O,)."""

    @classmethod
    def of(
        cls,
        stance: AnyInts,
        dock: AnyInts,
        other_stance: AnyInts,
        other_dock: AnyInts,
        vector: Reals,
        *,
        along_sd: float | Reals,
        across_sd: float | Reals,
    ) -> "Offsets":
        """Make the rows of n vectors other than 0, with standard deviations [R].

        Args:
            stance: Stance of the robot that measured each, shape (n,).
            dock: Its dock, shape (n,).
            other_stance: Stance of the other robot, shape (n,).
            other_dock: Its dock, shape (n,).
            vector: Vectors in the world frame [R], shape (n, 3).
            along_sd: Standard deviation of their lengths, of all or of each, shape (n,).
            across_sd: Standard deviation across, along each of two axes, as for lengths.
        """
        axis = _frames(vector / np.linalg.norm(vector, axis=1, keepdims=True))
        along, across = (np.broadcast_to(sd, len(vector)) for sd in (along_sd, across_sd))
        number = np.stack([stance, dock, other_stance, other_dock]).astype(np.int64)
        i, a, j, b = np.repeat(number, AXES, axis=1)
        return cls(
            i, a, j, b,
            vector=np.repeat(vector, AXES, axis=0),
            axis=axis.reshape(-1, AXES),
            own_variance=np.column_stack([along, across, across]).ravel() ** 2,
        )  # fmt: skip


class Coordinates(NamedTuple):
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
    """Variance of the coordinate, without noise of orientations and without what its source has in
    common [R^2], shape (K,)."""

    source: Ints
    """Source of the coordinate, -1 for none, shape (K,)."""

    @classmethod
    def of(
        cls,
        stance: AnyInts,
        dock: AnyInts,
        direction: Reals,
        value: Reals,
        *,
        variance: float | Reals,
        source: int | AnyInts = -1,
    ) -> "Coordinates":
        """Make rows with own variance [R^2] and source; a value that is not finite makes none."""
        is_known = np.isfinite(value)
        every = cls(
            stance.astype(np.int64),
            dock.astype(np.int64),
            np.broadcast_to(direction, (len(value), AXES)),
            value,
            np.broadcast_to(variance, len(value)),
            np.broadcast_to(source, len(value)),
        )
        return cls._make(column[is_known] for column in every)

    @property
    def rank(self) -> int:
        """Number of independent directions that were measured, 0 of no coordinates."""
        return int(np.linalg.matrix_rank(self.direction)) if len(self.direction) else 0


def _frames(along: Reals) -> Reals:
    """Complete unit vectors to orthonormal axes, they themselves first, shape (n, 3, 3)."""
    # The coordinate axis that is least parallel: its cross product is never near 0.
    least = np.eye(AXES)[np.abs(along).argmin(axis=1)]
    across = np.cross(along, least)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([along, across, np.cross(along, across)], axis=1)


_NONE = np.empty(0, np.int64)
_NO_VECTOR = np.empty((0, AXES))
NO_DISTANCES = Distances.of(_NONE, _NONE, _NONE, _NONE, length=SPACING, sd=0.0)
NO_OFFSETS = Offsets.of(_NONE, _NONE, _NONE, _NONE, _NO_VECTOR, along_sd=0.0, across_sd=0.0)
NO_COORDINATES = Coordinates.of(_NONE, _NONE, np.eye(AXES)[2], np.empty(0), variance=0.0)
NO_SOURCES = np.empty(0)


def ends(d: Distances, o: Offsets, p: Coordinates = NO_COORDINATES) -> tuple[Ints, Ints, Reals]:
    """Stance and dock where the arm of each row begins, and its vector beyond the dock [R]."""
    stance = np.concatenate([d.stance, o.stance, p.stance])
    dock = np.concatenate([d.dock, o.dock, p.dock])
    beyond = np.zeros((len(stance), AXES))
    beyond[len(d.stance) : len(d.stance) + len(o.stance)] = o.vector
    return stance, dock, beyond


def other_ends(d: Distances, o: Offsets) -> tuple[Ints, Ints]:
    """Stance and dock where the other arm of each pair ends."""
    stance = np.concatenate([d.other_stance, o.other_stance])
    return stance, np.concatenate([d.other_dock, o.other_dock])


def weighted_means(
    key: Sequence[NDArray[Any]], value: Reals, variance: Reals
) -> tuple[Ints, Reals, Reals]:
    """Average values whose keys, columns of shape (n,), are equal.

    Returns:
        First row of each key, in their order, with the mean and its variance.
    """
    keys = np.column_stack(key)
    order = np.lexsort(keys.T)
    is_first = np.ones(len(keys), np.bool_)
    is_first[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    start = np.flatnonzero(is_first)
    # Where nothing repeats, values stay as they are, to the last bit.
    if len(start) == len(keys):
        return np.arange(len(keys)), value, variance
    weight = 1.0 / variance[order]
    total = np.add.reduceat(weight, start)
    mean = np.add.reduceat(weight * value[order], start) / total
    first = order[start]
    in_order = np.argsort(first)
    return first[in_order], mean[in_order], 1.0 / total[in_order]


@dataclass(frozen=True, kw_only=True)
class Measurements:
    """Rows of N robots: those of `distances`, of `offsets`, and of `places`, E = C + O + K in all.

    The first P = C + O are of pairs of robots.
    """

    odometry: Odometry
    """Stances that rows are about."""

    distances: Distances
    offsets: Offsets
    places: Coordinates

    robot: Ints
    """Robot of each row, shape (E,)."""

    neighbor: Ints
    """Neighbor that the robot of each pair measures, shape (P,)."""

    arm: Reals
    """T = 1: from the robot's final center to its dock, or to the end of its vector [R], (E, 3)."""

    neighbor_arm: Reals
    """From the neighbor's final center to its dock [R], shape (P, 3)."""

    shared_sd: Reals
    """Standard deviation of the error that all rows of a source share [R], shape (sources,)."""

    @classmethod
    def gather(
        cls,
        odometry: Odometry,
        distances: Sequence[Distances] = (),
        places: Sequence[Coordinates] = (),
        offsets: Sequence[Offsets] = (),
        *,
        shared_sd: Reals = NO_SOURCES,
    ) -> "Measurements":
        """Concatenate tables, and look up the robots and arms that they are about.

        Raises:
            ValueError: rows have a source without a shared error.
        """
        d = Distances(*map(np.concatenate, zip(NO_DISTANCES, *distances, strict=True)))
        o = Offsets(*map(np.concatenate, zip(NO_OFFSETS, *offsets, strict=True)))
        p = Coordinates(*map(np.concatenate, zip(NO_COORDINATES, *places, strict=True)))
        stance, dock, beyond = ends(d, o, p)
        other_stance, other_dock = other_ends(d, o)
        if np.concatenate([d.source, p.source]).max(initial=-1) >= len(shared_sd):
            message = f"shared_sd has {len(shared_sd)} sources, and rows name more"
            raise ValueError(message)
        return cls(
            odometry=odometry,
            distances=d,
            offsets=o,
            places=p,
            robot=odometry.owner[stance],
            neighbor=odometry.owner[other_stance],
            arm=odometry.arms(stance, dock)[0] + beyond,
            neighbor_arm=odometry.arms(other_stance, other_dock)[0],
            shared_sd=shared_sd,
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
        """Which rows of pairs are those of docks that touch, shape (P,)."""
        is_contact: Bools = ends(self.distances, self.offsets)[1] != CENTER
        return is_contact

    @property
    def is_central(self) -> Bools:
        """Which distances are between centers, and turn with their robots, shape (C,)."""
        arms = (self.arm[: len(self.distances.stance)], self.neighbor_arm)
        is_central: Bools = ~np.any([arm[: len(arms[0])].any(axis=1) for arm in arms], axis=0)
        return is_central & ~self.distances.is_hinge

    @property
    def touch(self) -> Ints:
        """Distances with an unknown dock, shape (T,)."""
        d = self.distances
        return np.flatnonzero((d.dock == UNKNOWN) | (d.other_dock == UNKNOWN))

    @property
    def touch_arms(self) -> tuple[tuple[Reals, Reals], tuple[Reals, Reals]]:
        """Arms of the docks of each touch, and the others, as `Odometry.candidates` has them."""
        d = self.distances
        touch = self.touch
        arms = self.odometry.candidates(d.stance[touch], d.dock[touch])
        return arms, self.odometry.candidates(d.other_stance[touch], d.other_dock[touch])

    @property
    def sensed_contacts(self) -> Ints:
        """Robot, its stance, own dock, CENTER or UNKNOWN, other robot and its dock, of each pair.

        Shape (P, 5); the rows of a vector are alike.
        """
        robot = self.robot[: len(self.neighbor)]
        stance, dock, _ = ends(self.distances, self.offsets)
        other_dock = other_ends(self.distances, self.offsets)[1]
        at = stance - self.odometry.first[robot]
        return np.column_stack([robot, at, dock, self.neighbor, other_dock])

    @property
    def sensed_places(self) -> Ints:
        """Robot, its stance, and dock or CENTER of each coordinate, shape (K, 3)."""
        p = self.places
        robot = self.robot[len(self.neighbor) :]
        return np.column_stack([robot, p.stance - self.odometry.first[robot], p.dock])

    @property
    def stance(self) -> Ints:
        """Stance at which the robot of each row sensed it, shape (E,)."""
        return ends(self.distances, self.offsets, self.places)[0]

    @property
    def is_walked(self) -> Bools:
        """Which rows are about a stance of their robot before the final one, shape (E,)."""
        is_walked: Bools = self.stance != self.odometry.final[self.robot]
        return is_walked

    @property
    def source(self) -> Ints:
        """Source of each row, -1 for none; offsets have none, shape (E,)."""
        none = np.full(len(self.offsets.stance), -1)
        return np.concatenate([self.distances.source, none, self.places.source])

    @property
    def own_variance(self) -> Reals:
        """Variance of each row's own error, without noise of orientations [R^2], shape (E,)."""
        tables = (self.distances, self.offsets, self.places)
        return np.concatenate([table.own_variance for table in tables])

    @property
    def shared_variance(self) -> Reals:
        """Variance of the error that each row shares with its source, 0 without [R^2], (E,)."""
        variance: Reals = np.append(self.shared_sd, 0.0)[self.source] ** 2  # -1 is the last
        return variance

    @property
    def vector_rows(self) -> slice:
        """Rows of `offsets` among all: three of each vector, one after another."""
        return slice(len(self.distances.stance), len(self.neighbor))

    @property
    def link(self) -> Ints:
        """First row of each measurement of a pair: a vector has three, shape (C,)."""
        distances = len(self.distances.stance)
        return np.concatenate(
            [np.arange(distances), np.arange(distances, len(self.neighbor), AXES)]
        )

    def any_of_vector(self, flag: Bools) -> Bools:
        """Extend flags of rows, shape (E,), to all three rows of their vectors."""
        extended = flag.copy()
        of_vector = flag[self.vector_rows].reshape(-1, AXES)
        extended[self.vector_rows] = np.repeat(of_vector.any(axis=1), AXES)
        return extended

    def select(self, chosen: Bools) -> "Measurements":
        """Keep rows chosen by an array of shape (E,).

        Raises:
            ValueError: some rows of a vector are chosen, and not all three.
        """
        if chosen.all():
            return self
        if not np.array_equal(self.any_of_vector(chosen), chosen):
            message = "the three rows of a vector are one measurement; choose all or none"
            raise ValueError(message)
        tables = np.split(chosen, [len(self.distances.stance), len(self.neighbor)])
        return self.ordered(*map(np.flatnonzero, tables))

    def ordered(self, distance: Ints, offset: Ints, place: Ints) -> "Measurements":
        """Keep these rows of each table in this order."""
        pair = np.concatenate([distance, len(self.distances.stance) + offset])
        row = np.concatenate([pair, len(self.neighbor) + place])
        return replace(
            self,
            distances=Distances._make(column[distance] for column in self.distances),
            offsets=Offsets._make(column[offset] for column in self.offsets),
            places=Coordinates._make(column[place] for column in self.places),
            robot=self.robot[row],
            neighbor=self.neighbor[pair],
            arm=self.arm[row],
            neighbor_arm=self.neighbor_arm[pair],
        )

    @property
    def quantity(self) -> Ints:
        """Number of what each row reads: equal where a source reads one quantity again, (E,)."""
        d = self.distances
        o = self.offsets
        p = self.places
        read = [d.stance, d.dock, d.other_stance, d.other_dock, d.is_hinge, d.source]
        along = [p.stance, p.dock, *p.direction.T, p.source]
        pair, place = (
            np.unique(np.column_stack(key), axis=0, return_inverse=True)[1].ravel()
            for key in (read, along)
        )
        alone = np.arange(len(o.stance)) + len(pair)
        return np.concatenate([pair, alone, place + len(self.neighbor)])

    def averaged(self, *, as_precise_as_one: bool = False) -> "Measurements":
        """Replace readings of the same quantity by the same source by their weighted mean.

        Only their own errors average out. That of the source is in all of them, and so is the noise
        of orientations: the mean says what the readings say together. Rows keep their order.

        Args:
            as_precise_as_one: Whether a mean has the variance of its first reading.
        """
        d = self.distances
        p = self.places
        ends = [d.stance, d.dock, d.other_stance, d.other_dock, d.is_hinge, d.source]
        one, length, variance = weighted_means(ends, d.length, d.own_variance)
        if as_precise_as_one:
            variance = d.own_variance[one]
        distances = Distances._make(column[one] for column in d)
        along = [p.stance, p.dock, *p.direction.T, p.source]
        first, value, spread = weighted_means(along, p.value, p.own_variance)
        if as_precise_as_one:
            spread = p.own_variance[first]
        places = Coordinates._make(column[first] for column in p)
        return Measurements.gather(
            self.odometry,
            [distances._replace(length=length, own_variance=variance)],
            [places._replace(value=value, own_variance=spread)],
            [self.offsets],
            shared_sd=self.shared_sd,
        )

    def first_parts(self) -> Reals:
        """Part of the arm of each row that its own stance turns [R], shape (E, 3)."""
        return self.odometry.first_parts(*ends(self.distances, self.offsets, self.places))

    def variance(self) -> Reals:
        """Sum each row's variances: its own, that of its source, and the noise of orientations.

        It is for users that take rows to be independent. The direction of a distance is unknown
        before the positions are: its variance is the mean over all directions, and over all docks
        that may touch.

        Returns:
            Variance of each row [R^2], shape (E,).
        """
        d = self.distances
        o = self.offsets
        p = self.places
        stance = np.concatenate([d.stance, p.stance])
        dock = np.concatenate([d.dock, p.dock])
        noise = self.odometry.arms(stance, dock)[1]
        noise[: len(d.stance)] += self.odometry.arms(d.other_stance, d.other_dock)[1]
        touch = self.touch
        if len(touch):
            noise[touch] = sum(side[1].mean(axis=1) for side in self.touch_arms)
        # The mean of n n^T over all directions n is a third of the identity.
        every = np.full((len(d.stance), AXES), AXES**-0.5)
        direction = np.concatenate([every, p.direction])
        variance = (direction**2 * noise).sum(axis=1)
        of_offsets: Reals = np.empty(0)
        if len(o.stance):  # most logs have none
            of_offsets = self.odometry.variance_along(o.axis, o.stance, o.dock, o.vector)
            of_offsets += self.odometry.variance_along(o.axis, o.other_stance, o.other_dock)
        # Rows of offsets stand between those of distances and those of places.
        of_turns = np.insert(variance, len(d.stance), of_offsets)
        return of_turns + self.own_variance + self.shared_variance

    def vectors(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute the vectors from the other arm's end of each pair to that of its arm.

        Args:
            position: Final centers [R], shape (..., N, 3).
            yaw: Yaw corrections [rad], shape (..., N); 0 if None.

        Returns:
            Vectors [R], shape (..., P, 3).
        """
        i = self.robot[: len(self.neighbor)]
        j = self.neighbor
        arm = turned(self.arm[: len(j)], None if yaw is None else yaw[..., i])
        neighbor_arm = turned(self.neighbor_arm, None if yaw is None else yaw[..., j])
        apart: Reals = position[..., i, :] + (arm - neighbor_arm) - position[..., j, :]
        if len(self.touch):
            apart[..., self.touch, :] = self._nearest_docks(position, yaw)[0]
        return apart

    def associated(self, position: Reals, yaw: Reals | None = None) -> "Measurements":
        """Replace unknown docks by those that touch at one configuration; as in `vectors`."""
        if not len(self.touch):
            return self
        d = self.distances
        docks = self.odometry.arm.shape[1]
        dock = d.dock.copy()
        other_dock = d.other_dock.copy()
        pair = np.divmod(self.association(position, yaw), docks)
        for column, nearest in zip((dock, other_dock), pair, strict=True):
            stated = column[self.touch]
            column[self.touch] = np.where(stated == UNKNOWN, nearest, stated)
        distances = d._replace(dock=dock, other_dock=other_dock)
        return Measurements.gather(
            self.odometry, [distances], [self.places], [self.offsets], shared_sd=self.shared_sd
        )

    def association(self, position: Reals, yaw: Reals | None = None) -> Ints:
        """Find which docks touch: docks times one robot's dock plus the other's, (..., T)."""
        return self._nearest_docks(position, yaw)[1]

    def _nearest_docks(self, position: Reals, yaw: Reals | None) -> tuple[Reals, Ints]:
        """Choose the docks of each touch; of equally near pairs the first.

        Returns:
            Vectors between them [R], shape (..., T, 3), and their `association`.
        """
        touch = self.touch
        i = self.robot[touch]
        j = self.neighbor[touch]
        (arms, _), (neighbor_arms, _) = self.touch_arms
        between = position[..., i, :] - position[..., j, :]
        turned_arms = [
            turned(arm, None if yaw is None else yaw[..., i]) for arm in arms.swapaxes(0, 1)
        ]
        other_turned_arms = [
            turned(arm, None if yaw is None else yaw[..., j])
            for arm in neighbor_arms.swapaxes(0, 1)
        ]
        apart = np.empty_like(between)
        pair = np.zeros(between.shape[:-1], np.int64)
        least = np.full(pair.shape, np.inf)
        # One pair of docks at a time: all at once would take docks^2 times the memory.
        for number, (arm, neighbor_arm) in enumerate(product(turned_arms, other_turned_arms)):
            vector = between + arm - neighbor_arm
            off = np.abs(np.linalg.norm(vector, axis=-1) - self.distances.length[touch])
            is_nearer = off < least
            least = np.where(is_nearer, off, least)
            pair = np.where(is_nearer, number, pair)
            apart = np.where(is_nearer[..., None], vector, apart)
        return apart, pair

    def points(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute the points whose coordinates `places` measures [R], shape (..., K, 3)."""
        robot = self.robot[len(self.neighbor) :]
        arm = turned(self.arm[len(self.neighbor) :], None if yaw is None else yaw[..., robot])
        points: Reals = position[..., robot, :] + arm
        return points

    def docks(self, yaw: Reals | None = None) -> Reals:
        """Turn the final arms of all docks by yaw, shape (N,) [R], shape (N, docks, 3)."""
        arm = self.odometry.arm[self.odometry.final]
        of_dock = None if yaw is None else np.repeat(yaw, arm.shape[1])
        return turned(arm.reshape(-1, AXES), of_dock).reshape(arm.shape)

    def axes(self, yaw: Reals | None = None) -> Reals:
        """Compute the unit vectors along which `offsets` measures, shape (..., O, 3)."""
        robot = self.robot[len(self.distances.stance) : len(self.neighbor)]
        return turned(self.offsets.axis, None if yaw is None else yaw[..., robot])

    def residual(self, position: Reals, yaw: Reals | None = None) -> Reals:
        """Compute what each row's equation is missed by; arguments as in `vectors`.

        Returns:
            Residuals [R], shape (..., E).
        """
        return self._missed(position, yaw)[0]

    def linearized(self, position: Reals, yaw: Reals | None = None) -> tuple[Reals, Reals]:
        """Compute residuals (..., E), and the derivative of each by its robot's center.

        It is a unit vector, or 0 where docks coincide or a hinge is open, shape (..., E, 3).
        Arguments as in `vectors`.
        """
        residual, along = self._missed(position, yaw)
        fixed = [self.axes(yaw), self.places.direction]
        shape = position.shape[:-2]
        axes = [np.broadcast_to(axis, (*shape, *axis.shape[-2:])) for axis in fixed]
        return residual, np.concatenate([along, *axes], axis=-2)

    def _missed(self, position: Reals, yaw: Reals | None) -> tuple[Reals, Reals]:
        """Compute residuals, shape (..., E), and the directions of distances, (..., C, 3)."""
        d = self.distances
        apart = self.vectors(position, yaw)
        line, offset = np.split(apart, [len(d.stance)], axis=-2)
        # In the memory order of `apart`, configuration by configuration or row by row.
        residual = np.empty_like(apart[..., 0])
        distance, component = np.split(residual, [len(d.stance)], axis=-1)
        # A hinge is missed while it is too short: docks may be apart, but not overlap.
        distance[...], slope = missed_distance(components(line), d.length, d.is_hinge)
        component[...] = missed_along(components(offset), components(self.axes(yaw)), 0.0)
        away = self.points(position, yaw)
        axis = self.places.direction
        place = missed_along(components(away), components(axis), self.places.value)
        return np.concatenate([residual, place], axis=-1), slope[..., None] * line

    def jacobian(self, position: Reals, yaw: Reals | None = None) -> csc_array:
        """Compute the derivatives of the residuals by arms that are known: see `associated`.

        Arguments as in `vectors`.

        Returns:
            Derivatives by x, y and z of each center [1], then by each yaw [R], shape (E, 4 N).
        """
        direction = self.linearized(position, yaw)[1]
        count = len(self.neighbor)
        i = self.robot
        j = self.neighbor
        arm = turned(self.arm, None if yaw is None else yaw[i]).copy()
        neighbor_arm = turned(self.neighbor_arm, None if yaw is None else yaw[j])
        # A vector turns with its axes: the derivative is that of an arm to the other dock.
        offset = slice(len(self.distances.stance), count)
        arm[offset] = position[j[offset]] + neighbor_arm[offset] - position[i[offset]]
        toward = direction[:count]
        of_turn = -slope_by_turn(components(direction), components(arm))[2]
        of_other_turn = -slope_by_turn(components(toward), components(neighbor_arm))[2]
        every = np.arange(len(i))
        axis = np.arange(AXES)
        thrice = np.repeat(every, AXES)
        row = [thrice, thrice[: AXES * count], every, every[:count]]
        column = [
            (AXES * i[:, None] + axis).ravel(),
            (AXES * j[:, None] + axis).ravel(),
            AXES * self.robots + i,
            AXES * self.robots + j,
        ]
        value = [direction.ravel(), -toward.ravel(), of_turn, -of_other_turn]
        entries = (np.concatenate(value), (np.concatenate(row), np.concatenate(column)))
        return csc_array(entries, shape=(len(i), (AXES + 1) * self.robots))


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
    # A product of complex numbers turns all configurations in one broadcast.
    level = np.exp(1j * yaw) * (x + 1j * y)
    return np.stack([level.real, level.imag, np.broadcast_to(z, level.shape)], axis=-1)


def are_known(variance: Reals, pairs: int) -> Bools:
    """Find coordinates that never give way: rows so certain, after those of pairs, shape (E,)."""
    is_known: Bools = variance <= KNOWN
    is_known[:pairs] = False
    return is_known


def inconsistent_places(rows: Measurements, variance: Reals | None = None) -> Bools:
    """Find coordinates that disagree with most others that the same robot measured.

    The walk between two stances is known, so that what a robot measured at one of them predicts
    what it measures at the other, wherever it is. A robot that takes a rounded edge for the flat
    ground contradicts its own flips.

    Args:
        rows: All rows.
        variance: Their variance [R^2], if it is known already, shape (E,).

    Returns:
        Rows that disagree with the one that most rows agree with, shape (E,); distances never do.
    """
    contacts = len(rows.neighbor)
    inconsistent = np.zeros(len(rows), np.bool_)
    robot = rows.robot[contacts:]
    direction = rows.places.direction
    value = rows.places.value - (direction * rows.arm[contacts:]).sum(axis=1)
    own_variance = (rows.own_variance + rows.shared_variance)[contacts:]
    walked = (rows.variance() if variance is None else variance)[contacts:] - own_variance
    _, group = np.unique(np.column_stack([robot, direction]), axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    for members in groups if len(order) else []:
        some = members[:: math.ceil(len(members) ** 2 / _MOST_PAIRS)]
        # Both arms share the noise of all stances after the later one.
        between = np.abs(walked[some, None] - walked[members])
        allowed = ALLOWED_SD**2 * (between + own_variance[some, None] + own_variance[members])
        agrees = (value[some, None] - value[members]) ** 2 <= allowed
        inconsistent[contacts + members] = ~agrees[agrees.sum(axis=1).argmax()]
    return inconsistent
