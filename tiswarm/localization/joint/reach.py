"""How far contacts let robots be from each other, in any direction. Lengths in R.

With sensed orientations, centers in contact are apart by a fixed vector c and a vector of length D,
so by |c| + D at most; along a chain of contacts these bounds add up.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra


def reach(
    pair: NDArray[np.int64], longest: NDArray[np.float64], part: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Bound the distance of each robot from the first robot of its connected part, shape (N,).

    Args:
        pair: Robots in contact, shape (C, 2).
        longest: How far apart the centers of each pair can be, shape (C,).
        part: Connected part of each robot, shape (N,).

    Returns:
        Length of the shortest chain of contacts [R], shape (N,); infinite where `part` is not
        connected by these contacts.
    """
    order = np.lexsort((longest, *np.sort(pair, axis=1).T))
    low, high = np.sort(pair, axis=1)[order].T
    again = np.r_[False, (np.diff(low) == 0) & (np.diff(high) == 0)][: len(low)]
    edge = (longest[order][~again], (low[~again], high[~again]))
    graph = coo_array(edge, shape=(len(part), len(part)))
    firsts = np.unique(part, return_index=True)[1]
    bound: NDArray[np.float64] = dijkstra(graph, directed=False, indices=firsts, min_only=True)
    return bound
