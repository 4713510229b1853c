"""The batch of structures that are growing: where every dock is, and what is near a place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.cells import CellChains
from tiswarm.robot import DOCK_COUNT
from tiswarm.world.kernels import link_docks


@dataclass(frozen=True, kw_only=True)
class Structures:
    """S structures with room for N robots each; dock 3 i + k is dock k of robot i."""

    dock: NDArray[np.float64]
    """Dock centres [R]; rows of robots that have not joined are meaningless, (S, 3 N, 3)."""

    robot_count: NDArray[np.int32]
    """Robots that have joined, shape (S,)."""

    chains: CellChains
    """The joined docks by place."""

    inverse_edge: float
    """One over the edge of a cube of the cell list [1/R]."""

    @classmethod
    def allocate(cls, structures: int, robots: int, edge: float) -> "Structures":
        """Reserve empty structures whose cell lists have cubes of the given edge [R]."""
        return cls(
            dock=np.zeros((structures, DOCK_COUNT * robots, 3)),
            robot_count=np.zeros(structures, np.int32),
            chains=CellChains.allocate(structures, DOCK_COUNT * robots),
            inverse_edge=1.0 / edge,
        )

    def joined_docks(self, structure: int) -> NDArray[np.float64]:
        """Dock centres of the robots that have joined [R], shape (3 n, 3)."""
        return self.dock[structure, : DOCK_COUNT * self.robot_count[structure]]

    def join(self, structure: NDArray[np.int32], docks: NDArray[np.float64]) -> None:
        """Add one robot to each of the given structures, all different.

        Args:
            structure: Structures that grow, shape (J,).
            docks: Dock centres of the new robots [R], shape (J, 3, 3).
        """
        first = (DOCK_COUNT * self.robot_count[structure]).astype(np.int32)
        for s, start, three in zip(structure, first, docks, strict=True):
            self.dock[s, start : start + DOCK_COUNT] = three
        self.robot_count[structure] += 1
        link_docks(
            structure,
            first,
            self.dock,
            self.inverse_edge,
            self.chains.head,
            self.chains.following,
        )
