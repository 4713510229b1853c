"""Contacts that cannot all be true, however the robots stand.

With orientations known, a contact says that the later robot's center lies on a sphere of
radius D about a point fixed to the earlier one. Around a closed chain of n contacts the n
vectors of length D must make up for the sum of the fixed ones, which is therefore no longer
than n D. Chains through a third robot and heights are looked at too. What noise can explain is
no contradiction.
"""

import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.math import dock_offsets
from tiswarm.records.sensing_log import SensingLog, SensingNoise

ASSUMED = SensingNoise(tilt_deg=1.0, yaw_deg=2.0)
"""Noise of a log that states none."""

ALLOWED_SD = 4.0
"""Standard deviations that noise may explain."""

ALLOWED_GAP = 0.05
"""Docks may feel each other though this much lies between them [dock radius]."""

ASSUMED_FLIPS = 100
"""Flips of a robot whose log does not tell them."""

HEADER_LINES = 1


class Contradiction(NamedTuple):
    """Contacts that cannot all be true."""

    line: int
    """Line of the log with the robot that joined last of those concerned."""

    problem: str
    """Which contacts they are, and what to do."""


def contradictions(log: SensingLog) -> list[Contradiction]:
    """Find the contradictions of a log, in the order of its lines."""
    found = [*_by_height(log), *_by_chain(log)]
    return [
        Contradiction(HEADER_LINES + 1 + joiner, problem) for joiner, problem in sorted(set(found))
    ]


def _by_height(log: SensingLog) -> Iterator[tuple[int, str]]:
    """Contacts of robots whose flips took them to heights too different."""
    i, _, j, _ = log.contacts.T
    height = np.r_[log.anchor_position[2], log.flip_height[1:]]
    tilt = math.radians((log.noise or ASSUMED).tilt_deg)
    told = None if log.stances is None else np.diff(log.stances.start)
    flips = np.full(log.robot_count, ASSUMED_FLIPS) if told is None else told
    reach = np.linalg.norm(log.dock_offset_body, axis=1).max()
    variance = 4.0 * reach**2 * tilt**2 * (1.0 + flips)  # a flip's dock is 2 reach from the next
    slack = ALLOWED_SD * np.sqrt(variance[i] + variance[j]) + ALLOWED_GAP * log.dock_radius
    apart = np.abs(height[j] - height[i] - _fixed_part(log)[:, 2])
    for row in np.flatnonzero(apart > log.spacing + slack).tolist():
        text = f"{_told(log, [row])} cannot be: by their flips the docks are {apart[row]:.3g}"
        unit = log.length_unit
        yield int(j[row]), f"{text} {unit} apart in height, not {log.spacing:g} {unit}; look at it"


def _by_chain(log: SensingLog) -> Iterator[tuple[int, str]]:
    """Two contacts with one robot, or with two that touch each other, that cannot both be."""
    fixed = _fixed_part(log)
    noise = log.noise or ASSUMED
    turn = math.radians(math.hypot(noise.tilt_deg, noise.yaw_deg, noise.yaw_bias_deg or 0.0))
    unsure = ALLOWED_SD * turn * np.linalg.norm(log.dock_offset_body, axis=1).max()
    reach = log.spacing + ALLOWED_GAP * log.dock_radius
    between = defaultdict(list)
    of_joiner = defaultdict(list)
    for row, (i, _, j, _) in enumerate(log.contacts.tolist()):
        between[i, j].append(row)
        of_joiner[j].append(row)
    for joiner, rows in of_joiner.items():
        for one, two in combinations(sorted(rows, key=lambda r: log.contacts[r, 0]), 2):
            earlier, later = log.contacts[[one, two], 0].tolist()
            ways: list[list[int]] = (
                [[]] if earlier == later else [[r] for r in between[earlier, later]]
            )
            for way in ways:
                gap = np.linalg.norm(fixed[one] - fixed[two] - fixed[way].sum(axis=0))
                count = 2 + len(way)
                if gap > count * reach + unsure * math.sqrt(2 * count):
                    problem = f"{_told(log, [one, two, *way])} cannot all be; look at each"
                    yield joiner, problem


def _fixed_part(log: SensingLog) -> NDArray[np.float64]:
    """From the earlier robot's center to that of the sphere of the later one's, shape (C, 3)."""
    offset = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    i, a, j, b = log.contacts.T
    apart: NDArray[np.float64] = offset[i, a] - offset[j, b]
    return apart


def _told(log: SensingLog, rows: list[int]) -> str:
    """Write contacts as the log's lines do: robot, then (own dock, other robot, its dock)."""
    name = log.robot_id.tolist()
    told = [
        f"robot {name[j]}'s contact [{b}, {name[i]}, {a}]"
        for i, a, j, b in log.contacts[rows].tolist()
    ]
    return " and ".join(told)
