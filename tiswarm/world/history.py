"""What happened while a structure grew: every stance of every robot, as it truly was."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.robot import RobotGeometry


@dataclass(frozen=True, kw_only=True)
class Walk:
    """The stances of one robot, from its spawn to where it stays.

    L stances; contacts are with robots that joined earlier.
    """

    center: NDArray[np.float64]
    """Centres [R], shape (L, 3)."""

    orientation_wxyz: NDArray[np.float64]
    """Body to world, shape (L, 4)."""

    pivot_dock: NDArray[np.int32]
    """Dock that stays put as the robot leaves each stance but the last, shape (L - 1,)."""

    contacts: NDArray[np.int32]
    """Rows of (stance, own dock, other robot, other dock), sorted, shape (K, 4)."""

    ground_docks: NDArray[np.int32]
    """Rows of (stance, own dock), sorted, shape (G, 2)."""

    @property
    def stance_count(self) -> int:
        """L."""
        return len(self.center)

    @property
    def joins(self) -> bool:
        """Whether the robot touches another at its last stance."""
        return bool((self.contacts[:, 0] == self.stance_count - 1).any())


@dataclass(frozen=True, kw_only=True)
class History:
    """A structure of N robots as it grew; the truth that sensing and evaluation start from."""

    seed: int
    """Seed that it grew from."""

    robot: RobotGeometry
    """The robots' shape."""

    ground_z: float
    """Height of the flat ground [R]."""

    walks: tuple[Walk, ...]
    """One walk for each robot, in join order."""

    spawns: int
    """Robots spawned in all, those that never joined included."""

    ended: str = ""
    """Why growth stopped before all robots had joined; empty where it did not."""

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.walks)

    @property
    def position(self) -> NDArray[np.float64]:
        """Final centres [R], shape (N, 3)."""
        return np.array([walk.center[-1] for walk in self.walks])

    @property
    def orientation_wxyz(self) -> NDArray[np.float64]:
        """Final orientations, body to world, shape (N, 4)."""
        return np.array([walk.orientation_wxyz[-1] for walk in self.walks])

    @property
    def contacts(self) -> NDArray[np.int32]:
        """Docked pairs as the joiner felt them, rows of (i, dock of i, j, dock of j), i < j."""
        rows = [_last_contacts(j, walk) for j, walk in enumerate(self.walks)]
        return np.concatenate(rows) if rows else np.empty((0, 4), np.int32)

    @property
    def ground_docks(self) -> NDArray[np.int32]:
        """Docks on the ground in the end, rows of (robot, dock)."""
        rows: list[NDArray[np.int32]] = [
            np.column_stack([np.full(len(docks), j, np.int32), docks])
            for j, walk in enumerate(self.walks)
            for docks in [walk.ground_docks[walk.ground_docks[:, 0] == walk.stance_count - 1, 1]]
        ]
        pairs: NDArray[np.int32] = np.concatenate(rows).astype(np.int32)
        return pairs


def _last_contacts(j: int, walk: Walk) -> NDArray[np.int32]:
    """Contacts of the last stance of robot `j`, earlier robot first."""
    felt = walk.contacts[walk.contacts[:, 0] == walk.stance_count - 1]
    return np.column_stack([felt[:, 2], felt[:, 3], np.full(len(felt), j, np.int32), felt[:, 1]])
