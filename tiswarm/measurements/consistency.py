"""What of a log is inconsistent, wherever the robots are. Lengths in R."""

import math

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.measurements.model import KNOWN, Measurements
from tiswarm.records.sensing_log import SensingLog

ALLOWED_SD = 4.0
"""Standard deviations that noise may explain."""

_MOST_PAIRS = 4_000_000
"""Pairs of coordinates that are compared; of more than 2,000, a sample is compared with all."""


def stuck_robots(log: SensingLog) -> Ints:
    """Find the robots whose orientation sensors repeat one value while they flip, shape (K,)."""
    if log.stances is None:
        return np.empty(0, np.int64)
    flips = np.diff(log.stances.start)
    owner = np.repeat(np.arange(log.robot_count), flips)
    repeats = (log.stances.orientation_wxyz == log.orientation_wxyz[owner]).all(axis=1)
    same = np.bincount(owner, weights=repeats, minlength=log.robot_count)
    return np.flatnonzero((flips > 0) & (same == flips))


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
    contacts = len(rows.other)
    found = np.zeros(len(rows), np.bool_)
    robot, direction = rows.robot[contacts:], rows.places.direction
    value = rows.places.value - (direction * rows.arm[contacts:]).sum(axis=1)
    own = (rows.own_variance + rows.shared_variance)[contacts:]
    walked = (rows.variance() if variance is None else variance)[contacts:] - own
    _, group = np.unique(np.column_stack([robot, direction]), axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    for mine in groups if len(order) else []:
        some = mine[:: math.ceil(len(mine) ** 2 / _MOST_PAIRS)]
        # Both arms share the noise of all stances after the later one.
        between = np.abs(walked[some, None] - walked[mine])
        allowed = ALLOWED_SD**2 * (between + own[some, None] + own[mine])
        agrees = (value[some, None] - value[mine]) ** 2 <= allowed
        found[contacts + mine] = ~agrees[agrees.sum(axis=1).argmax()]
    return found
