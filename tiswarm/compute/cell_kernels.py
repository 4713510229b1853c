"""A cell list that grows one item at a time: a hash table of chains.

Space is cut into cubes; a linear hash of the cube's indices names a bucket, and each bucket
holds a chain of items. Cubes that share a bucket cost time but are never confused, since
every item found is tested by its distance; and no item is found twice, because the 27 cubes
around a point always have 27 different buckets.
"""

from typing import NamedTuple

import numpy as np

from tiswarm.compute.lang import Ints2, Ref, ti

_STRIDE_Y, _STRIDE_Z = 1_640_531_527, 1_013_904_223
_MIN_BUCKETS = 128
"""Fewest buckets for which the 27 cubes around a point keep apart (and any power of two above)."""


class CellList(NamedTuple):
    """Chains of S structures with up to K items each."""

    head: Ints2
    """First item of each bucket or -1, shape (S, buckets)."""

    following: Ints2
    """Next item of the chain or -1, shape (S, K)."""

    @classmethod
    def allocate(cls, structures: int, capacity: int) -> "CellList":
        """Reserve empty chains for `structures` structures of `capacity` items."""
        buckets = max(_MIN_BUCKETS, 1 << (2 * capacity - 1).bit_length())
        return cls(
            head=np.full((structures, buckets), -1, np.int32),
            following=np.full((structures, capacity), -1, np.int32),
        )


@ti.func
def cube_of(point, inverse_edge):
    """Find the indices of the cube that holds `point`."""
    return ti.cast(ti.floor(point * inverse_edge), ti.i64)


@ti.func
def _bucket_of(cube, buckets):
    """Hash a cube to its bucket; `buckets` is a power of two."""
    key = cube[0] + _STRIDE_Y * cube[1] + _STRIDE_Z * cube[2]
    return ti.cast(key & ti.cast(buckets - 1, ti.i64), ti.i32)


@ti.func
def first_item(cells: Ref, structure, cube, which):
    """Read the head of the chain of one of the 27 cubes around and including `cube`.

    `which` runs from 0 to 26.
    """
    neighbor = cube + ti.Vector([which % 3 - 1, which // 3 % 3 - 1, which // 9 - 1])
    return cells.head[structure, _bucket_of(neighbor, cells.head.shape[1])]


@ti.func
def link(cells: Ref, structure, item, cube):
    """Put an item in front of its bucket's chain."""
    bucket = _bucket_of(cube, cells.head.shape[1])
    cells.following[structure, item] = cells.head[structure, bucket]
    cells.head[structure, bucket] = item


@ti.func
def relink(cells: Ref, structure, item, old, new):
    """Move an item from the chain of one cube to the front of another's."""
    bucket = _bucket_of(old, cells.head.shape[1])
    if bucket != _bucket_of(new, cells.head.shape[1]):
        after = cells.following[structure, item]
        if cells.head[structure, bucket] == item:
            cells.head[structure, bucket] = after
        else:
            before = cells.head[structure, bucket]
            while cells.following[structure, before] != item:
                before = cells.following[structure, before]
            cells.following[structure, before] = after
        link(cells, structure, item, new)
