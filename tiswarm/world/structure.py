"""The batch of structures that are growing: where every dock is, and what is near a place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.cell_kernels import CellChains
from tiswarm.robot import DOCK_COUNT


@dataclass(frozen=True, kw_only=True)
class Structures:
    """S structures with room for N robots each; dock 3 i + k is dock k of robot i."""

    dock: NDArray[np.float64]
    """Dock centers [R]; rows of robots that have not joined are meaningless, (S, 3 N, 3)."""

    robot_count: NDArray[np.int32]
    """Robots that have joined, shape (S,)."""

    relay: NDArray[np.int32]
    """What each dock passes on to whoever touches it; positive recruits, shape (S, 3 N)."""

    chains: CellChains
    """The joined docks by place."""

    @classmethod
    def allocate(cls, structures: int, robots: int) -> "Structures":
        """Reserve empty structures."""
        docks = DOCK_COUNT * robots
        return cls(
            dock=np.zeros((structures, docks, 3)),
            robot_count=np.zeros(structures, np.int32),
            relay=np.zeros((structures, docks), np.int32),
            chains=CellChains.allocate(structures, docks),
        )

    def joined_docks(self, structure: int) -> NDArray[np.float64]:
        """Dock centers of the robots that have joined [R], shape (3 n, 3)."""
        return self.dock[structure, : DOCK_COUNT * self.robot_count[structure]]
