"""Where a robot's own flips say that it stood, seen from where it stands now."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.math import dock_offsets
from tiswarm.records.sensing_log import SensingLog, Stances


def owners(stances: Stances) -> NDArray[np.int64]:
    """Robot that each earlier stance is of, shape (M,)."""
    count = np.diff(stances.start)
    return np.repeat(np.arange(len(count)), count)


def displacements(log: SensingLog, stances: Stances) -> NDArray[np.float64]:
    """From each robot's final center to its center at every earlier stance, shape (M, 3).

    The dock at b that a robot flips about stays put, so its center moves by (R - R') b, with R
    and R' its orientations before and after; the walk is summed backward from its end.
    """
    row = np.arange(len(stances.pivot_dock))
    is_last = np.zeros(len(row), np.bool_)
    is_last[stances.start[1:][np.diff(stances.start) > 0] - 1] = True
    before = dock_offsets(stances.orientation_wxyz, log.dock_offset_body)
    final = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    after = np.where(
        is_last[:, None],
        final[owners(stances), stances.pivot_dock],
        before[(row + 1) % max(len(row), 1), stances.pivot_dock],
    )
    step = before[row, stances.pivot_dock] - after
    walked = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    moved: NDArray[np.float64] = walked[:-1] - walked[stances.start[1:]][owners(stances)]
    return moved


def felt_contacts(log: SensingLog, cues: Collection[str]) -> NDArray[np.int64]:
    """Contacts of the final stances and of those before them, as far as cues make use of them.

    Rows of (robot, its stance from the spawn on, own dock, other robot, its dock), shape (K, 5).
    """
    parts = []
    if "contacts" in cues:
        i, a, j, b = log.contacts.T.astype(np.int64)
        last = np.zeros_like(j) if log.stances is None else np.diff(log.stances.start)[j]
        parts.append(np.column_stack([j, last, b, i, a]))
    if "walk_contacts" in cues and log.stances is not None:
        stance = log.stances.contacts[:, 0]
        robot = owners(log.stances)[stance]
        place = stance - log.stances.start[robot]
        parts.append(np.column_stack([robot, place, log.stances.contacts[:, 1:]]))
    return np.concatenate([np.empty((0, 5), np.int64), *parts])
