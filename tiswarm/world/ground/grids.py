"""Grids of distances to a surface of triangles: of a closed mesh, or of heights.

Within `BAND` of the surface, values are distances to the triangles, negative inside. Farther away
they are `BAND`, or minus that. Between its points a grid is linear along each axis, so edges
sharper than its cell are rounded off.
"""

import math
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute import backend
from tiswarm.world.ground.grid_kernels import count_windings, spread_distances

BAND = 3.0
"""Distance from the surface within which values are true [R]: more than a dock needs to rest."""

LIPSCHITZ = math.sqrt(3.0)
"""Lipschitz constant of what a grid interpolates: along each axis it is at most 1."""

MOST_VALUES = 2**24
"""Most values of a grid, 128 MiB."""

_OFF_EDGES = 1e-7
"""Share of a cell by which columns are moved, so that none passes an edge of a usual mesh."""


class DistanceGrid(NamedTuple):
    """Distances at the points of a grid."""

    corner: Reals
    """Point with the least coordinates [R], shape (3,)."""

    cell: float
    """Distance between neighbors [R]."""

    value: Reals
    """Distances [R], shape (nx, ny, nz)."""


def values_needed(low: Reals, high: Reals, cell: float) -> int:
    """Count the values of the grid around a box with corners `low` and `high` [R]."""
    return int(np.prod(np.ceil((high - low + 2.0 * BAND) / cell) + 1.0))


@backend.exclusive()
def grid_of_mesh(vertex: Reals, face: Ints, cell: float) -> DistanceGrid:
    """Make a grid of the distances to a closed mesh, whose parts may overlap.

    Args:
        vertex: Corners of the triangles [R], shape (V, 3).
        face: Their numbers, shape (M, 3).
        cell: Distance between neighbors [R].
    """
    backend.processor()
    triangle = np.ascontiguousarray(vertex[face].reshape(-1, 9))
    corner = vertex.min(axis=0) - BAND
    count = np.ceil((vertex.max(axis=0) + BAND - corner) / cell).astype(int) + 1
    value = np.full(count, BAND)
    spread_distances(triangle, *corner.tolist(), cell, BAND, value)
    windings = np.zeros(count)
    count_windings(
        triangle, *(corner + _OFF_EDGES * cell * np.array([1.0, 0.7, 0.0])), cell, windings
    )
    return DistanceGrid(corner, cell, np.where(windings != 0.0, -value, value))


@backend.exclusive()
def grid_of_heights(height: Reals, spacing: float, cell: float) -> DistanceGrid:
    """Make a grid of the distances to a surface of heights, bilinear between them.

    Args:
        height: Heights [R], shape (nx, ny); the first is at x = y = 0.
        spacing: Distance between neighbors [R].
        cell: Distance between neighbors of the grid [R], at most about that.
    """
    backend.processor()
    # The surface is cut into pieces of the size of a cell, which bilinear heights bend little.
    pieces = max(1, math.ceil(spacing / cell - 1e-9))
    fine = _refined(_refined(height, pieces).T, pieces).T
    step = spacing / pieces
    x, y = np.meshgrid(*(step * np.arange(n) for n in fine.shape), indexing="ij")
    vertex = np.stack([x, y, fine], axis=-1).reshape(-1, 3)
    number = np.arange(len(vertex)).reshape(fine.shape)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    face = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    corner = np.array([0.0, 0.0, height.min() - BAND])
    extent = spacing * (np.array(height.shape) - 1)
    top = np.array([*extent, height.max() + BAND])
    count = np.ceil((top - corner) / cell - 1e-9).astype(int) + 1
    value = np.full(count, BAND)
    spread_distances(
        np.ascontiguousarray(vertex[face].reshape(-1, 9)), *corner.tolist(), cell, BAND, value
    )
    columns = [np.minimum(cell * np.arange(n), e) for n, e in zip(count[:2], extent, strict=True)]
    below = _bilinear(height, spacing, *columns)
    z = corner[2] + cell * np.arange(count[2])
    return DistanceGrid(corner, cell, np.where(z < below[..., None], -value, value))


def _refined(height: Reals, pieces: int) -> Reals:
    """Interpolate rows linearly, so many pieces to each."""
    place = np.arange((len(height) - 1) * pieces + 1) / pieces
    low = np.minimum(place.astype(int), len(height) - 2)
    share = (place - low)[:, None]
    refined: Reals = (1.0 - share) * height[low] + share * height[low + 1]
    return refined


def _bilinear(height: Reals, spacing: float, x: Reals, y: Reals) -> Reals:
    """Interpolate heights at all pairs of coordinates, shape (len(x), len(y))."""
    i = np.minimum((x / spacing).astype(int), height.shape[0] - 2)
    j = np.minimum((y / spacing).astype(int), height.shape[1] - 2)
    u, v = (x / spacing - i)[:, None], (y / spacing - j)[None]
    low = (1.0 - v) * height[np.ix_(i, j)] + v * height[np.ix_(i, j + 1)]
    high = (1.0 - v) * height[np.ix_(i + 1, j)] + v * height[np.ix_(i + 1, j + 1)]
    between: Reals = (1.0 - u) * low + u * high
    return between
