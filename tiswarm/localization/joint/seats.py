"""Where robots are put: at first, again if they got lost, and at last if nothing ties them."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.math import normal
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.force_kernels import SPACING
from tiswarm.records.sensing_log import SensingLog

LOST = 2.0 * SPACING
"""Docks in contact that are this much farther apart no longer find each other [R]."""
NOISY = 3.0
"""Nor are they lost before they are so many standard deviations off."""
RECENT = 5.0
"""Robots that join meanwhile make it e times less likely that one joins where another did."""
FORGOTTEN = 200
"""After so many nothing is left of it, to rounding."""
UNTOLD = 3.0
"""Mean square error of what is put there, in variances of where robots joined."""


def first_guess(log: SensingLog, known: Equations, seed: int, chains: int) -> NDArray[np.float64]:
    """Put each robot where its contacts with robots already put meet, give or take a dock radius.

    Robots follow each other along the chains of contacts, from the first robot of each part on.
    Which way a dock lies from the one it touches is not sensed. Robots are taken to stand across
    from each other there, for else thousands of them would begin in a heap.

    Returns:
        Positions, another one for each chain, shape (chains, N, 3).
    """
    robot = np.arange(log.robot_count)
    draw = 3 * np.arange(chains)[:, None, None] + np.arange(3)
    guess = normal(seed, "first guess", robot[:, None], draw)
    across = _across(known)
    toward = np.concatenate([across, -across])
    partner = np.concatenate([known.other, known.robot])
    rows = _rows(np.concatenate([known.robot, known.other]), log.robot_count)
    is_known = known.precision > 0.0
    place = known.sensed_place
    guess[:, 0] = log.anchor_position / log.dock_radius
    is_put = robot == 0
    for i in np.argsort(known.reach(), kind="stable").tolist():
        if is_put[i]:
            continue
        mine = rows[i][is_put[partner[rows[i]]]]
        met = guess[:, partner[mine]] - toward[mine] if len(mine) else guess[:, :1]
        guess[:, i] += met.mean(axis=1)
        guess[:, i, is_known[i]] = place[i, is_known[i]]
        is_put[i] = True
    return guess


def reseat(known: Equations, position: NDArray[np.float64], yaw: NDArray[np.float64]) -> int:
    """Move robots of one structure to where contacts meet that most of their docks have lost.

    Others may move in front of a robot while all is soft; what it touches is then too far to pull.

    Args:
        known: Its equations.
        position: Read and written, shape (chains, N, 3).
        yaw: How far each robot is turned, shape (chains, N).

    Returns:
        How many are moved.
    """
    gap = np.abs(known.lengths(position, yaw) - SPACING)
    count = np.bincount(known.robot, minlength=position.shape[1])
    across = _across(known)
    rows = _rows(known.robot, len(count))
    moved = 0
    far = np.maximum(LOST, NOISY * np.sqrt(known.variance))
    for here, missed in zip(position, gap > far, strict=True):
        lost = np.bincount(known.robot[missed], minlength=len(count)) > 0.5 * count
        for i in np.flatnonzero(lost).tolist():
            mine = rows[i]
            met = np.median(here[known.other[mine]] - across[mine], axis=0)
            here[i] = np.where(known.precision[i] > 0.0, here[i], met)
            moved += 1
    return moved


def rejoined(
    mean: NDArray[np.float64], known: Equations
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Put each part that nothing ties to the anchor where its first robot may have joined.

    It touched one that was there before, and robots join where the last ones did. The annealer
    keeps such parts away from all others, and shapes them alone.

    Args:
        mean: Mean position of each chain, shape (chains, N, 3).
        known: Its equations.

    Returns:
        These positions with such parts put there, and mean squares by which these may be off, 0
        for all others, shape (chains, N).
    """
    put, square = mean.copy(), np.zeros(mean.shape[:2])
    firsts = np.unique(known.part, return_index=True)[1]
    for first in np.sort(firsts[known.untied[firsts]]).tolist():
        earlier_robots = slice(max(first - FORGOTTEN, 0), first)
        earlier = put[:, earlier_robots]
        weight = np.exp(np.arange(1 - earlier.shape[1], 1) / RECENT)
        weight /= weight.sum()
        place = weight @ earlier
        away = (earlier - place[:, None]) * known.unobserved[first]
        part = known.part == known.part[first]
        put[:, part] += ((place - put[:, first]) * known.unobserved[first])[:, None]
        # The earlier ones may be put where nothing ties them, too.
        uncertain = UNTOLD * (away**2).sum(axis=2) + square[:, earlier_robots]
        square[:, part] = (uncertain @ weight)[:, None]
    return put, square


def _rows(robot: NDArray[np.int64], robots: int) -> list[NDArray[np.intp]]:
    """Where each robot stands in a list of them."""
    order = np.argsort(robot, kind="stable")
    return np.split(order, np.searchsorted(robot[order], np.arange(1, robots)))


def _across(known: Equations) -> NDArray[np.float64]:
    """From the center of an earlier robot back to that of one across from it, shape (C, 3)."""
    length = np.maximum(np.linalg.norm(known.shift, axis=1), SPACING)
    shift: NDArray[np.float64] = known.shift * (1.0 + SPACING * known.is_final / length)[:, None]
    return shift
