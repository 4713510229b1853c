"""Where robots are put: all at first, again those that got lost, and those that nothing ties."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import random
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.force_kernels import SPACING
from tiswarm.records.sensing_log import SensingLog

LOST = 2.0 * SPACING
"""Docks in contact that are this much farther apart no longer find each other [R]."""
NOISY = 3.0
"""Nor are they lost before they are so many standard deviations off."""


def first_guess(log: SensingLog, known: Equations, seed: int, chains: int) -> NDArray[np.float64]:
    """Put each robot where its contacts with earlier ones meet, give or take a dock radius.

    Which way a dock lies from the one it touches is not sensed. Robots are taken to stand across
    from each other there, for else thousands of them would begin in a heap.

    Returns:
        Positions, another one for each chain, shape (chains, N, 3).
    """
    robot = np.arange(log.robot_count)
    draw = 3 * np.arange(chains)[:, None, None] + np.arange(3)
    guess = random.normal(seed, "first guess", robot[:, None], draw)
    rows = _rows(known, log.robot_count)
    anchor = log.anchor_position / log.dock_radius
    across = _across(known)
    is_known = known.precision > 0.0
    place = known.place - np.pad(known.walk, ((0, 0), (0, 1)))
    guess[:, 0] = anchor
    for i in range(1, log.robot_count):
        mine = rows[i]
        met = guess[:, known.other[mine]] - across[mine] if len(mine) else anchor[None, None]
        guess[:, i] += met.mean(axis=1)
        guess[:, i, is_known[i]] = place[i, is_known[i]]
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
    rows = _rows(known, len(count))
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


def amid(mean: NDArray[np.float64], known: Equations) -> NDArray[np.float64]:
    """Put each part that nothing ties to the anchor amid the robots that something does.

    The annealer holds it near the anchor, which may be at an end of the structure; a structure has
    its robots about its middle.

    Args:
        mean: Mean position of each chain, shape (chains, N, 3).
        known: Its equations.
    """
    middle = mean[:, ~known.untied].mean(axis=1)
    put = mean.copy()
    for part in np.unique(known.part[known.untied]):
        robots = known.part == part
        shift = (middle - mean[:, robots].mean(axis=1)) * known.unplaced
        put[:, robots] += shift[:, None]
    return put


def _rows(known: Equations, robots: int) -> list[NDArray[np.intp]]:
    """Equations of each robot that felt the contact."""
    order = np.argsort(known.robot, kind="stable")
    return np.split(order, np.searchsorted(known.robot[order], np.arange(1, robots)))


def _across(known: Equations) -> NDArray[np.float64]:
    """From the center of an earlier robot back to that of one across from it, shape (C, 3)."""
    length = np.maximum(np.linalg.norm(known.shift, axis=1), SPACING)
    shift: NDArray[np.float64] = known.shift * (1.0 + SPACING * known.is_final / length)[:, None]
    return shift
