"""The light that robots block from points of a scene."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Reals

Array32 = NDArray[np.float32]

_SHADE_RANGE = 8.0  # beyond it robots cast no shade [R]; half of it in a crowd, to save time
_CROWD = 2_000  # robots of a crowd
_SAME_PLACE = 1e-6  # distance from its center within which a robot casts no shade: its hub [R]


def blocked_light(points: Reals, blockers: Reals) -> Array32:
    """Sum the light that robots block from points, in terms that are linear in the normal.

    A sphere of radius r at distance d in direction u blocks (r/d)^2 max(0, n.u) of the light
    on a surface with normal n; 1/4 + n.u / 2 approximates max(0, n.u). Rows of `blockers` are
    center and radius of the spheres [R].
    """
    center = blockers[:, :3]
    reach = _SHADE_RANGE if len(center) <= _CROWD else _SHADE_RANGE / 2.0
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(center), reach, output_type="ndarray")
    i, j = pairs["i"], pairs["j"]
    away = center[j] - points[i]
    distance = np.maximum(pairs["v"], 1e-9)
    blocked = np.minimum((blockers[j, 3] / distance) ** 2, 0.5) * (1.0 - distance / reach)
    blocked *= _SHADE_RANGE / reach  # makes up for the shorter range in a crowd
    blocked[pairs["v"] < _SAME_PLACE] = 0.0
    terms = np.column_stack([blocked / 4.0, away * (blocked / distance / 2.0)[:, None]])
    sums = [np.bincount(i, weights=term, minlength=len(points)) for term in terms.T]
    return np.column_stack(sums).astype(np.float32)


def dot(a: Array32, b: Array32) -> Array32:
    """Multiply rows, shape (n,)."""
    products: Array32 = np.einsum("ij,ij->i", a, b)
    return products


def unit(vectors: Array32) -> Array32:
    """Scale rows to length 1."""
    length = np.sqrt(np.maximum(dot(vectors, vectors), np.float32(1e-12)))
    units: Array32 = (vectors / length[:, None]).astype(np.float32)
    return units
