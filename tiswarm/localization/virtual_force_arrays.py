"""Arrays that the kernel of Algorithm 1 reads and writes. Lengths in R."""

from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from tiswarm.compute.lang import Ints1, Ints2, Reals1, Reals2, Reals3

NO_DOCKS, DOCKS_OF_NEIGHBORS, ALL_DOCKS = 0, 1, 2
"""Docks that repel each other where they overlap without being connected."""


class VirtualForceGains(NamedTuple):
    """Columns of the kernel's `gains`; see `VirtualForceParams`."""

    attraction_gain: float
    """A of Eq. (1) [1]."""

    repulsion_gain: float
    """B of Eqs. (1) and (2) [R^-3]."""

    height_gain: float
    """k_z of Eq. (3) [1]."""

    initial_offset: float
    """Distance of a robot from the mean of its earlier neighbors at first [R]."""

    max_step: float
    """Longest step of a robot [R]."""

    sweep_gain: float
    """Share of a step that a robot takes in back-propagation [1]."""

    sweep_repulsion: float
    """Share of repulsion with which back-propagation begins [1]."""

    spacing: float
    """D: distance between the centers of two docks that touch [R]."""

    undocked: float
    """NO_DOCKS, DOCKS_OF_NEIGHBORS or ALL_DOCKS."""

    height_last: float
    """1 where Eq. (3) is a step of its own, after that of the docks."""

    stop_error: float
    """Misfit of a robot below which it stops [R]."""


class LogArrays(NamedTuple):
    """Logs of N robots of all structures, end to end."""

    contact_start: Ints1
    """First contact row of each robot, shape (N + 1,)."""

    contact: Ints2
    """Rows of (own dock, other robot within the structure, its dock), shape (2 C, 3)."""

    initial_direction: Reals2
    """Unit vector of the initial offset, shape (N, 3)."""

    height: Reals1
    """Measured height of each center [R], NaN where unknown, shape (N,)."""

    is_planar: Ints1
    """Whether each robot stays at the anchor's y, shape (N,)."""

    is_gone: Ints1
    """Whether each robot has left, so that its docks are in nobody's way, shape (N,)."""

    is_anchor: Ints1
    """Whether the position of each robot is known, so that it stays there, shape (N,)."""


class PlacedRobots(NamedTuple):
    """Estimated positions of N robots."""

    dock_offset: Reals3
    """Center to dock, world frame [R], shape (N, docks, 3)."""

    position: Reals2
    """Centers [R], shape (N, 3); those of anchors and of robots placed before are read."""


class Trace(NamedTuple):
    """Recorded frames, F in all."""

    position: Reals3
    """Centers at each frame [R], shape (F, N, 3)."""

    step_length: Reals2
    """Last step before each frame [R], shape (F, N)."""

    steps: Ints1
    """Steps of each robot before the next one joined and in rounds, shape (N,)."""

    @classmethod
    def allocate(cls, frames: int, robots: int, dtype: DTypeLike) -> "Trace":
        """Reserve a trace of so many frames and robots."""
        return cls(
            np.empty((frames, robots, 3), dtype),
            np.empty((frames, robots), dtype),
            np.empty(robots, np.int32),
        )
