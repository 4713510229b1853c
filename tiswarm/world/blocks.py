"""A symmetric sparse matrix of 6 x 6 blocks that grows as a structure does."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csc_matrix

Array = NDArray[np.float64]
SIDE = 6


class BlockMatrix:
    """Blocks by (row, column); those of one place are added up in the order of their coming."""

    def __init__(self) -> None:
        """Start empty."""
        self.place: NDArray[np.int64] = np.empty(0, np.int64)
        self.block: Array = np.empty((0, SIDE, SIDE))
        self.waiting: list[tuple[NDArray[np.int64], Array]] = []

    def add(self, nodes: NDArray[np.intp], square: Array) -> None:
        """Add square matrices that couple nodes.

        Args:
            nodes: Nodes of each, shape (n, m).
            square: The matrices, shape (n, 6 m, 6 m).
        """
        n, m = nodes.shape
        blocks = square.reshape(n, m, SIDE, m, SIDE).swapaxes(2, 3).reshape(-1, SIDE, SIDE)
        row = np.repeat(nodes, m, axis=1).ravel()
        column = np.tile(nodes, (1, m)).ravel()
        self.waiting.append((_place(row, column), blocks))

    def assemble(self, nodes: int) -> csc_matrix:
        """Build the matrix over nodes 0 to `nodes` - 1."""
        place = np.concatenate([self.place, *(place for place, _ in self.waiting)])
        block = np.concatenate([self.block, *(block for _, block in self.waiting)])
        order = np.argsort(place, kind="stable")
        place, block = place[order], block[order]
        first = np.flatnonzero(np.r_[True, place[1:] != place[:-1]])
        self.place, self.block = place[first], np.add.reduceat(block, first)
        self.waiting = []
        row, column = self.place >> ROW_BITS, self.place & COLUMN_MASK
        start = np.searchsorted(row, np.arange(nodes + 1))
        matrix = bsr_matrix((self.block, column, start), shape=(SIDE * nodes, SIDE * nodes))
        by_row = matrix.tocsr()
        # Symmetric: the rows of the one format are the columns of the other.
        return csc_matrix((by_row.data, by_row.indices, by_row.indptr), shape=by_row.shape)


ROW_BITS = 32
COLUMN_MASK = (1 << ROW_BITS) - 1


def _place(row: NDArray[np.intp], column: NDArray[np.intp]) -> NDArray[np.int64]:
    """One sortable number for a row and a column."""
    return (row.astype(np.int64) << ROW_BITS) | column
