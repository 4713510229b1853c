"""Kernels that sort docks into cells.

The functions work for one dock or bucket at a time, so that a swarm-wide loop over threads and one
thread that sorts a whole small structure run the same lines.

What functions are given as `grid`:

- docks: docks of a robot
- cutoff: docks nearer than this are neighbors
- stride_y, stride_z: from a bucket to that of the next cell along y and z; 1 along x
- buckets: size of the hash table, a power of two
- table, slot: where the table starts in `begin`, and its docks in `sorted_dock`

`dock` holds places of docks and, last, the number of their structure: rows of four numbers, of
which `base` is where the current ones start.
"""

from tiswarm.compute.lang import I32, Float, Ints1, Reals1, Ref, ti

STRIDE_STRUCTURE = 1_779_033_703
CELL_LENGTH = 0.25
"""Edge of a cell along x, in cutoffs: short, since runs of cells along x are cheap."""
CELL_WIDTH = 2.0
"""Edge along y and z, in cutoffs: the ball around a dock reaches one cell more at most."""
BLOCK = 16
"""Sorted docks that are compared at a time."""
SCAN_BLOCK = 512
"""Buckets that one thread sums up at a time."""


@ti.func
def dock_at(dock: Ref, base, m):
    """Place of dock `m` and, last, the number of its structure."""
    at = base + 4 * m
    return ti.Vector([dock[at], dock[at + 1], dock[at + 2], dock[at + 3]])


@ti.func
def cell(value, per_length):
    """Index of the cell along one axis."""
    return ti.cast(ti.floor(value * per_length), ti.i64)


@ti.func
def bucket_of_cell(grid: Ref, x, y, z, structure):
    """Bucket of a cell: a linear hash, so that cells along x have buckets in a row."""
    key = (
        x
        + grid.stride_y * y
        + grid.stride_z * z
        + STRIDE_STRUCTURE * ti.cast(structure, ti.i64)
    )  # fmt: skip
    return ti.cast(key & ti.cast(grid.buckets - 1, ti.i64), ti.i32)


@ti.func
def own_bucket(grid: Ref, at):
    """Bucket of the cell that holds a dock."""
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    return bucket_of_cell(
        grid, cell(at[0], per_length), cell(at[1], per_width), cell(at[2], per_width), at[3]
    )


@ti.func
def count_dock(grid: Ref, base, m, dock: Ref, begin: Ref):
    """Count a dock in its bucket, two places on: there scan and scatter will leave the start."""
    ti.atomic_add(begin[grid.table + own_bucket(grid, dock_at(dock, base, m)) + 2], 1)


@ti.func
def scatter_dock(grid: Ref, base, m, dock: Ref, begin: Ref, sorted_dock: Ref):
    """Put a dock into the next free slot of its bucket."""
    bucket = own_bucket(grid, dock_at(dock, base, m))
    slot = grid.slot + ti.atomic_add(begin[grid.table + bucket + 1], 1)
    sorted_dock[slot] = m


@ti.func
def sort_bucket(grid: Ref, base, bucket, dock: Ref, begin: Ref, sorted_dock: Ref, sorted_at: Ref):
    """Order the docks of a bucket by number: threads have scattered them in any order."""
    first = grid.slot + begin[grid.table + bucket]
    last = grid.slot + begin[grid.table + bucket + 1]
    for slot in range(first + 1, last):
        m = sorted_dock[slot]
        to = slot
        while to > first and sorted_dock[ti.max(to - 1, 0)] > m:
            sorted_dock[to] = sorted_dock[to - 1]
            to -= 1
        sorted_dock[to] = m
    for slot in range(first, last):
        at = dock_at(dock, base, sorted_dock[slot])
        for c in ti.static(range(4)):
            sorted_at[slot + c * (sorted_at.shape[0] // 4)] = at[c]


@ti.func
def scan_block(grid: Ref, block, begin: Ref):
    """Sum up the counts of a block of buckets, each on top of those before it."""
    total = 0
    for k in range(block * SCAN_BLOCK, ti.min((block + 1) * SCAN_BLOCK, grid.buckets)):
        total += begin[grid.table + k + 2]
        begin[grid.table + k + 2] = total
    return total


@ti.func
def sort_structure(
    grid: Ref, base, first, last, dock: Ref, begin: Ref, sorted_dock: Ref, sorted_at: Ref
):
    """Sort the docks `first` to `last` of one small structure, on one thread."""
    for k in range(grid.buckets + 2):
        begin[grid.table + k] = 0
    for m in range(first, last):
        count_dock(grid, base, m, dock, begin)
    for k in range(1, grid.buckets):
        begin[grid.table + k + 2] += begin[grid.table + k + 1]
    for m in range(first, last):
        scatter_dock(grid, base, m, dock, begin, sorted_dock)
    for bucket in range(grid.buckets):
        sort_bucket(grid, base, bucket, dock, begin, sorted_dock, sorted_at)


@ti.kernel
def sort_docks(
    docks: I32, cutoff: Float, stride_y: I32, stride_z: I32, base: I32, dock: Reals1, begin: Ints1,
    block_total: Ints1, sorted_dock: Ints1, sorted_at: Reals1,
):  # fmt: skip
    """Counting sort of all docks by the bucket of their cell; within a bucket, by number.

    Args:
        docks: Docks of a robot.
        cutoff: Edge of a cell.
        base: Where the current docks start in `dock`.
        dock: Places, last the structure, rows of four.
        begin: Written: first slot of each bucket and, last, M; shape (buckets + 2,).
        block_total: Scratch, shape (ceil(buckets / SCAN_BLOCK),).
        sorted_dock: Written: docks in the order of their buckets, shape (M,).
        sorted_at: Written: the same docks' x, then all y, all z, all structures,
            each followed by room for BLOCK more, shape (4 (M + BLOCK),).
    """
    grid = ti.Struct(
        docks=docks, cutoff=cutoff, stride_y=stride_y, stride_z=stride_z,
        buckets=begin.shape[0] - 2, table=0, slot=0,
    )  # fmt: skip
    for k in range(begin.shape[0]):
        begin[k] = 0
    for m in range(sorted_dock.shape[0]):
        count_dock(grid, base, m, dock, begin)
    for block in range(block_total.shape[0]):
        block_total[block] = scan_block(grid, block, begin)
    ti.loop_config(serialize=True)
    for block in range(1, block_total.shape[0]):
        block_total[block] += block_total[block - 1]
    for k in range(SCAN_BLOCK, begin.shape[0] - 2):
        begin[k + 2] += block_total[k // SCAN_BLOCK - 1]
    for m in range(sorted_dock.shape[0]):
        scatter_dock(grid, base, m, dock, begin, sorted_dock)
    for bucket in range(begin.shape[0] - 2):
        sort_bucket(grid, base, bucket, dock, begin, sorted_dock, sorted_at)
