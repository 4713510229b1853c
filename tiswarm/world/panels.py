"""Solution of large structures by panels, in an order that is given; see `panel_kernels`."""

import numpy as np

from tiswarm.base.aliases import AnyInts, Reals
from tiswarm.compute.numerics import aligned_zeros, native_vectors, optimized_by_llvm
from tiswarm.world import panel_kernels
from tiswarm.world.block_kernels import ROW_WIDTH
from tiswarm.world.panel_kernels import FactorArrays, OrderedNode, Panel, Total

_SPARE = 1.5
"""Room to reserve, in parts of what is needed: structures grow."""


class PanelSolver:
    """Room for the panels of one structure after the other."""

    def __init__(self) -> None:
        self.row = np.empty(0, np.int32)
        self.work = FactorArrays(*(_rows(0) for _ in FactorArrays._fields))

    def solve(self, order: AnyInts, ends: AnyInts, stiffness: Reals, load: Reals) -> Reals:
        """Find how the nodes of a structure move.

        Args:
            order: Nodes in the order of elimination, shape (M,).
            ends: What beams join, columns of `frame_kernels.BeamEnds`, shape (B, 4).
            stiffness: Of each beam between its nodes: K_aa, K_ab, K_ba, K_bb, shape (4 B, 6, 6).
            load: Force and moment on each node, and two zeros, shape (M, 8).

        Returns:
            Displacements and rotations, and two numbers of no meaning, shape (M, 8); NaN where
            nothing holds the structure.
        """
        nodes = len(order)
        total = np.zeros(Total.TOTAL, np.int32)
        arrays = panel_kernels.PanelArrays(
            node=np.empty((nodes, OrderedNode.TOTAL), np.int32),
            next_beam=np.empty(len(ends), np.int32),
            panel=np.empty((nodes, Panel.TOTAL), np.int32),
            row=self.row,
            sequence=np.empty(nodes, np.int32),
            total=total,
        )
        with optimized_by_llvm():
            panel_kernels.find_panels(order, ends, *arrays)
            while total[Total.ROWS] > len(arrays.row):
                self.row = np.empty(int(2 * total[Total.ROWS]), np.int32)
                arrays = arrays._replace(row=self.row)
                panel_kernels.find_panels(order, ends, *arrays)
            self._reserve(total, nodes)
            motion: Reals = self.work.motion[0, :nodes]
            motion[:] = load
            with native_vectors():
                panel_kernels.solve_by_panels(ends, stiffness[None], *arrays, *self.work)
        return motion

    def _reserve(self, total: AnyInts, nodes: int) -> None:
        """Make room for a structure of so many nodes."""
        needed = FactorArrays(
            factor=6 * total[Total.FACTOR],
            update=6 * total[Total.UPDATES],
            front=6 * total[Total.FRONT],
            motion=nodes,
        )
        self.work = FactorArrays(
            *(
                rows if rows.shape[1] >= count else _rows(int(_SPARE * count))
                for rows, count in zip(self.work, needed, strict=True)
            )
        )


def _rows(count: int) -> Reals:
    """Reserve so many rows of blocks, at least one, shape (1, count, 8)."""
    return aligned_zeros(1, max(count, 1), ROW_WIDTH)
