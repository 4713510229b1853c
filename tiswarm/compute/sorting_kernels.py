"""Kernels that sort docks into cells, by a linear hash of the cell: a counting sort.

Functions work for one dock or bucket at a time. `dock` and `grid` are those of
`tiswarm.compute.neighbor_kernels`.
"""

from typing import NamedTuple

from tiswarm.compute.lang import I32, Float, Ints1, Reals1, Ref, ti

_STRIDE_STRUCTURE = 1_779_033_703
CELL_LENGTH = 0.25
"""Edge of a cell along x, in cutoffs: short, since runs of cells along x are cheap."""
CELL_WIDTH = 2.0
"""Edge along y and z, in cutoffs: the ball around a dock reaches at most one cell more."""
BLOCK = 16
"""Sorted docks that are compared at a time."""
SCAN_BLOCK = 256
"""Numbers that one thread sums up: buckets, then totals of these, then totals of those."""


class Cells(NamedTuple):
    """M docks in the order of the buckets of their cells, one table after the other."""

    begin: Ints1
    """First slot of each bucket, then M and a spare, shape (buckets + 2,) a table."""

    dock: Ints1
    """Dock in each slot; docks of a bucket in ascending order, shape (M,)."""

    place: Reals1
    """x of the docks slot by slot, then all y, all z, all structures, each followed by room for
    BLOCK more, shape (4 (M + BLOCK),)."""


@ti.func
def dock_at(dock: Ref, base, m):
    """Read the place of dock `m` and, last, the number of its structure."""
    at = base + 4 * m
    return ti.Vector([dock[at], dock[at + 1], dock[at + 2], dock[at + 3]])


@ti.func
def cell(value, per_length):
    """Find the index of a cell along one axis."""
    return ti.cast(ti.floor(value * per_length), ti.i64)


@ti.func
def bucket_of_cell(grid: Ref, x, y, z, structure):
    """Hash a cell to its bucket, linearly: cells along x have buckets in succession."""
    key = x + grid.stride_y * y + grid.stride_z * z
    key += _STRIDE_STRUCTURE * ti.cast(structure, ti.i64)
    return ti.cast(key & ti.cast(grid.buckets - 1, ti.i64), ti.i32)


@ti.func
def _own_bucket(grid: Ref, at):
    """Find the bucket of the cell that holds a dock."""
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    return bucket_of_cell(
        grid, cell(at[0], per_length), cell(at[1], per_width), cell(at[2], per_width), at[3]
    )


@ti.func
def count_dock(grid: Ref, base, m, dock: Ref, cells: Ref):
    """Count a dock in its bucket; offset by two, so that scan and scatter yield starts in place."""
    ti.atomic_add(cells.begin[grid.table + _own_bucket(grid, dock_at(dock, base, m)) + 2], 1)


@ti.func
def scatter_dock(grid: Ref, base, m, dock: Ref, cells: Ref):
    """Put a dock into the next free slot of its bucket."""
    bucket = _own_bucket(grid, dock_at(dock, base, m))
    slot = grid.slot + ti.atomic_add(cells.begin[grid.table + bucket + 1], 1)
    cells.dock[slot] = m


@ti.func
def sort_bucket(grid: Ref, base, bucket, dock: Ref, cells: Ref):
    """Order the docks of a bucket by number, since threads have scattered them in any order."""
    first = grid.slot + cells.begin[grid.table + bucket]
    last = grid.slot + cells.begin[grid.table + bucket + 1]
    for slot in range(first + 1, last):
        m = cells.dock[slot]
        to = slot
        while to > first and cells.dock[ti.max(to - 1, 0)] > m:
            cells.dock[to] = cells.dock[to - 1]
            to -= 1
        cells.dock[to] = m
    for slot in range(first, last):
        at = dock_at(dock, base, cells.dock[slot])
        for c in ti.static(range(4)):
            cells.place[slot + c * (cells.place.shape[0] // 4)] = at[c]


@ti.func
def _sum_up(value: Ref, first, past):
    """Add to each of some numbers those before it; return the sum of all."""
    total = 0
    for k in range(first, past):
        total += value[k]
        value[k] = total
    return total


@ti.kernel
def sort_docks(
    docks: I32, cutoff: Float, stride_y: I32, stride_z: I32, base: I32, dock: Reals1,
    block_total_out: Ints1, group_total_out: Ints1,
    begin_out: Ints1, sorted_dock_out: Ints1, sorted_place_out: Reals1,  # Cells
):  # fmt: skip
    """Counting sort of all docks by the bucket of their cell; within a bucket, by number.

    Numbers are those of `grid`, with one table for all docks.

    Args:
        base: Where the current docks start in `dock`.
        dock: Places, last the structure, rows of four.
        block_total_out: Scratch, shape (B,) with B = ceil(buckets / SCAN_BLOCK).
        group_total_out: Scratch, shape (ceil(B / SCAN_BLOCK),).
    """
    cells = ti.static(Cells(begin_out, sorted_dock_out, sorted_place_out))
    grid = ti.Struct(
        docks=docks, cutoff=cutoff, stride_y=stride_y, stride_z=stride_z,
        buckets=begin_out.shape[0] - 2, table=0, slot=0,
    )  # fmt: skip
    # Computed here, the bounds of loops need no launch before each loop.
    buckets, blocks, groups = grid.buckets, block_total_out.shape[0], group_total_out.shape[0]
    for k in range(begin_out.shape[0]):
        begin_out[k] = 0
    for m in range(sorted_dock_out.shape[0]):
        count_dock(grid, base, m, dock, cells)
    for block in range(blocks):
        past = ti.min((block + 1) * SCAN_BLOCK, buckets)
        block_total_out[block] = _sum_up(begin_out, block * SCAN_BLOCK + 2, past + 2)
    for group in range(groups):
        past = ti.min((group + 1) * SCAN_BLOCK, blocks)
        group_total_out[group] = _sum_up(block_total_out, group * SCAN_BLOCK, past)
    ti.loop_config(serialize=True)
    for group in range(1, groups):
        group_total_out[group] += group_total_out[group - 1]
    for block in range(SCAN_BLOCK, blocks):
        block_total_out[block] += group_total_out[block // SCAN_BLOCK - 1]
    for k in range(SCAN_BLOCK, buckets):
        begin_out[k + 2] += block_total_out[k // SCAN_BLOCK - 1]
    for m in range(sorted_dock_out.shape[0]):
        scatter_dock(grid, base, m, dock, cells)
    for bucket in range(buckets):
        sort_bucket(grid, base, bucket, dock, cells)
