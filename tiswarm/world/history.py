"""What happened while a structure grew: every stance of every robot, as it truly was."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.robot import RobotGeometry
from tiswarm.world.terrain import Terrain


@dataclass(frozen=True, kw_only=True)
class Walk:
    """The stances of one robot, from its spawn to where it stays.

    L stances; contacts are with robots that joined earlier.
    """

    center: NDArray[np.float64]
    """Centers [R], shape (L, 3)."""

    orientation_wxyz: NDArray[np.float64]
    """Body to world, shape (L, 4)."""

    pivot_dock: NDArray[np.int32]
    """Dock that stays put as the robot leaves each stance but the last, shape (L - 1,)."""

    contacts: NDArray[np.int32]
    """Rows of (stance, own dock, other robot, other dock), sorted, shape (K, 4)."""

    ground_docks: NDArray[np.int32]
    """Docks on flat ground, rows of (stance, own dock), sorted, shape (G, 2)."""

    edge_docks: NDArray[np.int32]
    """Docks on the rounded edge or the underside of a slab, likewise, shape (E, 2)."""

    recruited: bool = False
    """Whether the robot stays because it was called for."""

    @property
    def stance_count(self) -> int:
        """L."""
        return len(self.center)

    def at_rest(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Rows, stance first, that are of the last stance, without it."""
        return rows[rows[:, 0] == self.stance_count - 1, 1:]


@dataclass(frozen=True, kw_only=True)
class Strain:
    """How a structure bears its weight; NaN where it was not solved after that join."""

    peak: float = math.nan
    """Largest stress in any contact [weight of a dock / R^2]."""

    sensed_max: float = math.nan
    """Most that any robot senses [weight of a dock]."""

    calling: int = 0
    """Robots that call for help."""

    least_support: float = math.nan
    """Least upward force of the ground on a dock; negative where the ground pulls."""

    imbalance: float = math.nan
    """Weight less ground forces, per weight [1]."""


@dataclass(frozen=True, kw_only=True)
class History:
    """A structure of N robots as it grew; the truth that sensing and evaluation start from."""

    seed: int
    robot: RobotGeometry
    terrain: Terrain
    walks: tuple[Walk, ...]
    """One walk for each robot, in join order."""

    spawns: int
    """Robots spawned in all, those that never joined included."""

    strain: tuple[Strain, ...]
    """How the structure bore its weight after each join, in join order."""

    sensed: NDArray[np.float64]
    """What each robot senses in the end, shape (N,)."""

    crossed: bool = False
    """Whether a bridge joins both sides of its gap."""

    ended: str = ""
    """Why growth stopped before all robots had joined; empty where it did not."""

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.walks)

    @property
    def position(self) -> NDArray[np.float64]:
        """Final centers [R], shape (N, 3)."""
        return np.array([walk.center[-1] for walk in self.walks])

    @property
    def orientation_wxyz(self) -> NDArray[np.float64]:
        """Final orientations, body to world, shape (N, 4)."""
        return np.array([walk.orientation_wxyz[-1] for walk in self.walks])

    @property
    def ground_z(self) -> float:
        """Height of the flat ground [R]."""
        return self.terrain.ground_z

    @property
    def contacts(self) -> NDArray[np.int32]:
        """Docked pairs as the joiner felt them, rows of (i, dock of i, j, dock of j), i < j."""
        rows = [_contacts_at_rest(j, walk) for j, walk in enumerate(self.walks)]
        return np.concatenate(rows) if rows else np.empty((0, 4), np.int32)

    @property
    def ground_docks(self) -> NDArray[np.int32]:
        """Docks on flat ground in the end, rows of (robot, dock)."""
        return self._numbered(lambda walk: walk.ground_docks)

    @property
    def edge_docks(self) -> NDArray[np.int32]:
        """Docks on an edge or underside in the end, rows of (robot, dock)."""
        return self._numbered(lambda walk: walk.edge_docks)

    def _numbered(self, rows_of: Callable[[Walk], NDArray[np.int32]]) -> NDArray[np.int32]:
        rows = [
            np.column_stack([np.full(len(docks), j, np.int32), docks])
            for j, walk in enumerate(self.walks)
            for docks in [walk.at_rest(rows_of(walk))]
        ]
        return np.concatenate(rows).astype(np.int32) if rows else np.empty((0, 2), np.int32)


def _contacts_at_rest(j: int, walk: Walk) -> NDArray[np.int32]:
    """Contacts of the last stance of robot `j`, earlier robot first."""
    own, other, dock = walk.at_rest(walk.contacts).T
    return np.column_stack([other, dock, np.full(len(own), j, np.int32), own])
