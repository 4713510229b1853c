"""The three tables of measurements, whose equations `Measurements` has. Lengths in R."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.records.sensing_log import KNOWN_SD

SPACING = 2.0
"""D: distance between the centers of two docks that touch [R]."""

KNOWN = KNOWN_SD**2 * (1.0 + 1e-9)
"""Variance of a coordinate up to which it never gives way, as that of an anchor [R^2]."""

_AXES = 3


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
        return cls(
            stance=stance.astype(np.int64),
            dock=dock.astype(np.int64),
            other_stance=other_stance.astype(np.int64),
            other_dock=other_dock.astype(np.int64),
            length=np.broadcast_to(length, rows),
            own_variance=np.broadcast_to(np.square(sd), rows),
            is_hinge=np.full(rows, is_hinge),
            source=np.broadcast_to(source, rows),
        )


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
        number = np.column_stack([stance, dock, other_stance, other_dock]).astype(np.int64)
        thrice = np.repeat(number, _AXES, axis=0)
        return cls(
            stance=thrice[:, 0],
            dock=thrice[:, 1],
            other_stance=thrice[:, 2],
            other_dock=thrice[:, 3],
            vector=np.repeat(vector, _AXES, axis=0),
            axis=axis.reshape(-1, _AXES),
            own_variance=np.column_stack([along, across, across]).ravel() ** 2,
        )


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
            np.broadcast_to(direction, (len(value), _AXES)),
            value,
            np.broadcast_to(variance, len(value)),
            np.broadcast_to(source, len(value)),
        )
        return cls._make(column[is_known] for column in every)


def _frames(along: Reals) -> Reals:
    """Complete unit vectors to orthonormal axes, they themselves first, shape (n, 3, 3)."""
    # The coordinate axis that is least parallel: its cross product is never near 0.
    least = np.eye(_AXES)[np.abs(along).argmin(axis=1)]
    across = np.cross(along, least)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([along, across, np.cross(along, across)], axis=1)


_NONE = np.empty(0, np.int64)
_NO_VECTOR = np.empty((0, _AXES))
NO_DISTANCES = Distances.of(_NONE, _NONE, _NONE, _NONE, length=SPACING, sd=0.0)
NO_OFFSETS = Offsets.of(_NONE, _NONE, _NONE, _NONE, _NO_VECTOR, along_sd=0.0, across_sd=0.0)
NO_COORDINATES = Coordinates.of(_NONE, _NONE, np.eye(_AXES)[2], np.empty(0), variance=0.0)
NO_SOURCES = np.empty(0)


def ends(d: Distances, o: Offsets, p: Coordinates = NO_COORDINATES) -> tuple[Ints, Ints, Reals]:
    """Stance and dock where the arm of each row begins, and its vector beyond the dock [R]."""
    stance = np.concatenate([d.stance, o.stance, p.stance])
    dock = np.concatenate([d.dock, o.dock, p.dock])
    beyond = np.zeros((len(stance), _AXES))
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
