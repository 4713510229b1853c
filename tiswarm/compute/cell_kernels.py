"""A cell list that grows one item at a time: a hash table of chains.

Space is cut into cubes; a linear hash of the cube's indices names a bucket, and each bucket
holds a chain of items. Cubes that share a bucket cost time but are never confused, since
every item found is tested by its distance; and no item is found twice, because the 27 cubes
around a point always have 27 different buckets.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.lang import Ref, ti

STRIDE_Y = 1_640_531_527
STRIDE_Z = 1_013_904_223
MIN_BUCKETS = 128
"""Fewest buckets for which the 27 cubes around a point keep apart (and any power of two above)."""


@dataclass(frozen=True, kw_only=True)
class CellChains:
    """Chains of S structures with up to K items each."""

    head: NDArray[np.int32]
    """First item of each bucket or -1, shape (S, buckets)."""

    following: NDArray[np.int32]
    """Next item of the chain or -1, shape (S, K)."""

    @classmethod
    def allocate(cls, structures: int, capacity: int) -> "CellChains":
        """Reserve empty chains for `structures` structures of `capacity` items."""
        buckets = max(MIN_BUCKETS, 1 << (2 * capacity - 1).bit_length())
        return cls(
            head=np.full((structures, buckets), -1, np.int32),
            following=np.full((structures, capacity), -1, np.int32),
        )


@ti.func
def cube_of(point, inverse_edge):
    """Indices of the cube that holds `point`."""
    return ti.cast(ti.floor(point * inverse_edge), ti.i64)


@ti.func
def neighbor_cube(cube, which):
    """One of the 27 cubes around and including `cube`; `which` runs from 0 to 26."""
    return cube + ti.Vector([which % 3 - 1, which // 3 % 3 - 1, which // 9 - 1])


@ti.func
def bucket_of(cube, buckets):
    """Bucket of a cube; `buckets` is a power of two."""
    key = cube[0] + STRIDE_Y * cube[1] + STRIDE_Z * cube[2]
    return ti.cast(key & ti.cast(buckets - 1, ti.i64), ti.i32)


@ti.func
def link(head: Ref, following: Ref, structure, item, cube):
    """Put an item in front of its bucket's chain."""
    bucket = bucket_of(cube, head.shape[1])
    following[structure, item] = head[structure, bucket]
    head[structure, bucket] = item


@ti.func
def relink(head: Ref, following: Ref, structure, item, old, new):
    """Move an item from the chain of one cube to the front of another's."""
    bucket = bucket_of(old, head.shape[1])
    if bucket != bucket_of(new, head.shape[1]):
        after = following[structure, item]
        if head[structure, bucket] == item:
            head[structure, bucket] = after
        else:
            before = head[structure, bucket]
            while following[structure, before] != item:
                before = following[structure, before]
            following[structure, before] = after
        link(head, following, structure, item, new)
