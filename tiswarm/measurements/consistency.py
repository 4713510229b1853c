"""Contacts that are inconsistent, wherever the robots are.

With orientations known, a contact says that the later robot's center lies on a sphere of radius D
about a point fixed to the earlier one. Around a closed chain of n contacts the n vectors of length
D must make up for the sum of the fixed ones, which is therefore no longer than n D. Chains of two
and three contacts, and heights, are checked. What noise can explain is consistent. Lengths in R.
"""

import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import KNOWN, SPACING, Measurements
from tiswarm.records.sensing_log import SensingLog

ALLOWED_SD = 4.0
"""Standard deviations that noise may explain."""

_ALLOWED_GAP = 0.05
"""Docks may sense each other though this much lies between them [R]."""

_MOST_PAIRS = 4_000_000
"""Pairs of coordinates that are compared; of more than 2,000, a sample is compared with all."""


class Contradiction(NamedTuple):
    """Contacts that cannot all be true."""

    line: int
    """Line of the log with the robot that joined last of those concerned."""

    problem: str
    """Which contacts they are, and what to do."""


def contradictions(log: SensingLog) -> list[Contradiction]:
    """Find the contradictions of a log, in join order."""
    found = [*_by_height(log), *_by_chain(log, measure(log, ["contacts"]))]
    return [Contradiction(log.line_of(joiner), problem) for joiner, problem in sorted(set(found))]


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


def _by_height(log: SensingLog) -> Iterator[tuple[int, str]]:
    """Contacts of robots whose flips took them to heights too different."""
    rows = measure(log, ["contacts", "height"])
    contacts, variance = len(rows.other), rows.variance()
    height, spread = np.full(log.robot_count, np.nan), np.zeros(log.robot_count)
    measured = rows.robot[contacts:]
    height[measured] = rows.places.value - rows.arm[contacts:, 2]
    spread[measured] = variance[contacts:]
    height[0], spread[0] = log.anchor_position[2] / log.dock_radius, 0.0
    robot, other = rows.robot[:contacts], rows.other
    slack = ALLOWED_SD * np.sqrt(spread[robot] + spread[other] + variance[:contacts]) + _ALLOWED_GAP
    apart = np.abs(height[robot] - height[other] + _fixed_part(rows)[:, 2])
    for row in np.flatnonzero(apart > SPACING + slack).tolist():
        text = f"{_names(log, rows, [row])} is inconsistent: by their flips the docks are"
        unit, length = log.length_unit, apart[row] * log.dock_radius
        text = f"{text} {length:.3g} {unit} apart in height, not {log.spacing:g} {unit}; look at it"
        yield int(robot[row]), text


def _by_chain(log: SensingLog, rows: Measurements) -> Iterator[tuple[int, str]]:
    """Two contacts with one robot, or with two that touch each other, that cannot both be."""
    fixed = _fixed_part(rows)
    # The variance is a mean over directions; along the worst one it is at most thrice that.
    unsure = ALLOWED_SD * np.sqrt(3.0 * rows.variance().max(initial=0.0))
    between = defaultdict(list)
    of_joiner = defaultdict(list)
    for row, (joiner, earlier) in enumerate(
        zip(rows.robot.tolist(), rows.other.tolist(), strict=True)
    ):
        between[earlier, joiner].append(row)
        of_joiner[joiner].append(row)
    for joiner, mine in of_joiner.items():
        for one, two in combinations(sorted(mine, key=lambda row: int(rows.other[row])), 2):
            first, second = rows.other[[one, two]].tolist()
            closing = [[]] if first == second else [[row] for row in between[first, second]]
            for third in closing:
                gap = np.linalg.norm(fixed[one] - fixed[two] - fixed[third].sum(axis=0))
                count = 2 + len(third)
                if gap > count * (SPACING + _ALLOWED_GAP) + unsure * math.sqrt(count):
                    names = _names(log, rows, [one, two, *third])
                    yield joiner, f"{names} are inconsistent; look at each"


def _fixed_part(rows: Measurements) -> Reals:
    """Arm of the robot's dock less that of the other's, shape (C, 3)."""
    fixed: Reals = rows.arm[: len(rows.other)] - rows.other_arm
    return fixed


def _names(log: SensingLog, rows: Measurements, chosen: list[int]) -> str:
    """Write contacts as the log's lines do: robot, then (own dock, other robot, its dock)."""
    name, d = log.robot_id, rows.distances
    return " and ".join(
        f"robot {name[rows.robot[row]]}'s contact "
        f"[{d.dock[row]}, {name[rows.other[row]]}, {d.other_dock[row]}]"
        for row in chosen
    )


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
