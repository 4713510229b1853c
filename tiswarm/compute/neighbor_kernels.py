"""Kernels of the neighbor list: docks sorted into cells, then a Verlet row for each robot.

The functions work for one dock, bucket or robot at a time, so that a swarm-wide loop over
threads and one thread that does a whole small structure run the same lines.

An entry of a row is one integer: other dock, whether the two are connected, own dock.

What functions are given as `grid`:

- docks: docks of a robot
- own_bits: bits of an entry that number the robot's own dock
- cutoff: docks nearer than this are neighbors
- stride_y, stride_z: from a bucket to that of the next cell along y and z; 1 along x
- buckets: size of the hash table, a power of two
- table, slot: where the table starts in `begin`, and its docks in `sorted_dock`
- robot_stride, entry_stride: from one row to the next in `row`, and from one entry to the next
- capacity: entries that a row can hold, beside a last one that holds nothing
"""

from tiswarm.compute.dialect import I32, Float, Ints1, Reals2, Reals3, ti

STRIDE_STRUCTURE = 1_779_033_703
CELL_LENGTH = 0.25
"""Edge of a cell along x, in cutoffs: short, since runs of cells along x are cheap."""
CELL_WIDTH = 2.0
"""Edge along y and z, in cutoffs: the ball around a dock reaches one cell more at most."""
LONGEST_RUN = 10
"""Most cells along x that the ball around a dock reaches."""
REACH_MARGIN = 1e-3
"""What a reach is taken longer by [cutoff], so that rounding cannot shorten it."""
SCAN_BLOCK = 512
"""Buckets that one thread sums up at a time."""


@ti.func
def dock_at(dock: ti.template(), half, m):
    """Place of dock `m` and, last, the number of its structure."""
    return ti.Vector([dock[half, m, 0], dock[half, m, 1], dock[half, m, 2], dock[half, m, 3]])


@ti.func
def cell(value, per_length):
    """Index of the cell along one axis."""
    return ti.cast(ti.floor(value * per_length), ti.i64)


@ti.func
def bucket_of_cell(grid: ti.template(), x, y, z, structure):
    """Bucket of a cell: a linear hash, so that cells along x have buckets in a row."""
    key = (
        x
        + grid.stride_y * y
        + grid.stride_z * z
        + STRIDE_STRUCTURE * ti.cast(structure, ti.i64)
    )  # fmt: skip
    return ti.cast(key & ti.cast(grid.buckets - 1, ti.i64), ti.i32)


@ti.func
def own_bucket(grid: ti.template(), at):
    """Bucket of the cell that holds a dock."""
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    return bucket_of_cell(
        grid, cell(at[0], per_length), cell(at[1], per_width), cell(at[2], per_width), at[3]
    )


@ti.func
def count_dock(grid: ti.template(), half, m, dock: ti.template(), begin: ti.template()):
    """Count a dock in its bucket, two places on: there scan and scatter will leave the start."""
    ti.atomic_add(begin[grid.table + own_bucket(grid, dock_at(dock, half, m)) + 2], 1)


@ti.func
def scatter_dock(
    grid: ti.template(),
    half,
    m,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
):
    """Put a dock into the next free slot of its bucket."""
    bucket = own_bucket(grid, dock_at(dock, half, m))
    slot = grid.slot + ti.atomic_add(begin[grid.table + bucket + 1], 1)
    sorted_dock[slot] = m


@ti.func
def sort_bucket(
    grid: ti.template(),
    half,
    bucket,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
    sorted_at: ti.template(),
):
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
        at = dock_at(dock, half, sorted_dock[slot])
        for c in ti.static(range(4)):
            sorted_at[slot, c] = at[c]


@ti.func
def nearer_side(value, index, per_width):
    """Which cell beside its own a place is nearer to (-1 or 1), and how near, in cutoffs."""
    within = value * per_width - index
    side = ti.select(within < 1.0 - within, -1, 1)
    return side, CELL_WIDTH * ti.min(within, 1.0 - within)


@ti.func
def fill_row(
    grid: ti.template(),
    half,
    robot,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
    sorted_at: ti.template(),
    contact_start: ti.template(),
    contact: ti.template(),
    row: ti.template(),
):
    """List a robot's contacts, then all other docks near its own; return how many there are.

    What does not fit is counted, not written.
    """
    own_first = robot * grid.docks
    place = robot * grid.robot_stride
    contacts = contact_start[robot + 1] - contact_start[robot]
    for c in range(ti.min(contacts, grid.capacity)):
        row[place + c * grid.entry_stride] = contact[contact_start[robot] + c]
    count = contacts
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    square_cutoff = grid.cutoff * grid.cutoff
    end = begin[grid.table + grid.buckets]
    for own in range(grid.docks):
        here = dock_at(dock, half, own_first + own)
        y = cell(here[1], per_width)
        z = cell(here[2], per_width)
        side_y, gap_y = nearer_side(here[1], y, per_width)
        side_z, gap_z = nearer_side(here[2], z, per_width)
        for column in range(4):
            # Of a column of cells, only the run that the ball around the dock can reach.
            one_y = column & 1
            one_z = column >> 1
            square = 1.0 - one_y * gap_y * gap_y - one_z * gap_z * gap_z
            if square > -REACH_MARGIN:
                reach = (ti.sqrt(ti.max(square, 0.0)) + REACH_MARGIN) * grid.cutoff
                left = cell(here[0] - reach, per_length)
                cells = ti.min(cell(here[0] + reach, per_length) - left + 1, LONGEST_RUN)
                bucket = bucket_of_cell(grid, left, y + one_y * side_y, z + one_z * side_z, here[3])
                past = bucket + ti.cast(cells, ti.i32)
                first = begin[grid.table + bucket]
                length = begin[grid.table + ti.min(past, grid.buckets)] - first
                if past > grid.buckets:  # the run goes round the end of the table
                    length += begin[grid.table + past - grid.buckets]
                for step in range(length):
                    slot = first + step
                    if slot >= end:
                        slot -= end
                    slot += grid.slot
                    other = sorted_dock[slot]
                    to_x = sorted_at[slot, 0] - here[0]
                    to_y = sorted_at[slot, 1] - here[1]
                    to_z = sorted_at[slot, 2] - here[2]
                    near = (
                        ti.cast(to_x * to_x + to_y * to_y + to_z * to_z < square_cutoff, ti.i32)
                        & ti.cast(sorted_at[slot, 3] == here[3], ti.i32)
                        & ti.cast((other < own_first) | (other >= own_first + grid.docks), ti.i32)
                    )
                    # Written always and kept if near, since which it is cannot be predicted.
                    place_free = ti.min(count, grid.capacity)
                    row[place + place_free * grid.entry_stride] = (
                        other << (grid.own_bits + 1)
                    ) | own
                    count += near
    if count <= grid.capacity:
        flag = 1 << grid.own_bits
        for c in range(contacts):
            same = row[place + c * grid.entry_stride] ^ flag
            for e in range(contacts, count):
                if row[place + e * grid.entry_stride] == same:
                    count -= 1
                    row[place + e * grid.entry_stride] = row[place + count * grid.entry_stride]
    return count


@ti.func
def scan_block(grid: ti.template(), block, begin: ti.template()):
    """Sum up the counts of a block of buckets, each on top of those before it."""
    total = 0
    for k in range(block * SCAN_BLOCK, ti.min((block + 1) * SCAN_BLOCK, grid.buckets)):
        total += begin[grid.table + k + 2]
        begin[grid.table + k + 2] = total
    return total


@ti.func
def list_structure(
    grid: ti.template(),
    half,
    first_robot,
    last_robot,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
    sorted_at: ti.template(),
    contact_start: ti.template(),
    contact: ti.template(),
    row: ti.template(),
    row_count: ti.template(),
):
    """Write the rows of one small structure, on one thread; return the longest."""
    for k in range(grid.buckets + 2):
        begin[grid.table + k] = 0
    for m in range(first_robot * grid.docks, last_robot * grid.docks):
        count_dock(grid, half, m, dock, begin)
    for k in range(1, grid.buckets):
        begin[grid.table + k + 2] += begin[grid.table + k + 1]
    for m in range(first_robot * grid.docks, last_robot * grid.docks):
        scatter_dock(grid, half, m, dock, begin, sorted_dock)
    for bucket in range(grid.buckets):
        sort_bucket(grid, half, bucket, dock, begin, sorted_dock, sorted_at)
    longest = 0
    for robot in range(first_robot, last_robot):
        row_count[robot] = fill_row(
            grid, half, robot, dock, begin, sorted_dock, sorted_at, contact_start, contact, row
        )
        longest = ti.max(longest, row_count[robot])
    return longest


@ti.kernel
def sort_docks(
    docks: I32,
    cutoff: Float,
    stride_y: I32,
    stride_z: I32,
    half: I32,
    dock: Reals3,
    begin: Ints1,
    block_total: Ints1,
    sorted_dock: Ints1,
    sorted_at: Reals2,
):
    """Counting sort of all docks by the bucket of their cell; within a bucket, by number.

    Args:
        docks: Docks of a robot.
        cutoff: Edge of a cell.
        half: Which half of `dock` is current.
        dock: Places, last the structure, shape (2, M, 4).
        begin: Written: first slot of each bucket and, last, M; shape (buckets + 2,).
        block_total: Scratch, shape (ceil(buckets / SCAN_BLOCK),).
        sorted_dock: Written: docks in the order of their buckets, shape (M,).
        sorted_at: Written: the same docks' places, shape (M, 4).
    """
    grid = ti.Struct(
        docks=docks, cutoff=cutoff, stride_y=stride_y, stride_z=stride_z,
        buckets=begin.shape[0] - 2, table=0, slot=0,
    )  # fmt: skip
    for k in range(begin.shape[0]):
        begin[k] = 0
    for m in range(sorted_dock.shape[0]):
        count_dock(grid, half, m, dock, begin)
    for block in range(block_total.shape[0]):
        block_total[block] = scan_block(grid, block, begin)
    ti.loop_config(serialize=True)
    for block in range(1, block_total.shape[0]):
        block_total[block] += block_total[block - 1]
    for k in range(SCAN_BLOCK, begin.shape[0] - 2):
        begin[k + 2] += block_total[k // SCAN_BLOCK - 1]
    for m in range(sorted_dock.shape[0]):
        scatter_dock(grid, half, m, dock, begin, sorted_dock)
    for bucket in range(begin.shape[0] - 2):
        sort_bucket(grid, half, bucket, dock, begin, sorted_dock, sorted_at)


@ti.kernel
def fill_rows(
    docks: I32,
    own_bits: I32,
    cutoff: Float,
    stride_y: I32,
    stride_z: I32,
    robot_stride: I32,
    entry_stride: I32,
    capacity: I32,
    half: I32,
    dock: Reals3,
    begin: Ints1,
    sorted_dock: Ints1,
    sorted_at: Reals2,
    contact_start: Ints1,
    contact: Ints1,
    row: Ints1,
    row_count: Ints1,
    longest: Ints1,
):
    """Write every robot's row; arguments as above and as `sort_docks` has them.

    Args:
        contact_start: First contact of each robot, shape (N + 1,).
        contact: Contacts as row entries, connected, shape (C,).
        row: Written, shape (N * capacity,).
        row_count: Written: entries of each row, those that did not fit included, shape (N,).
        longest: Written: the longest row, shape (1,).
    """
    grid = ti.Struct(
        docks=docks, own_bits=own_bits, cutoff=cutoff, stride_y=stride_y,
        stride_z=stride_z, buckets=begin.shape[0] - 2,
        robot_stride=robot_stride, entry_stride=entry_stride, capacity=capacity, table=0, slot=0,
    )  # fmt: skip
    most = 0
    for robot in range(row_count.shape[0]):
        count = fill_row(
            grid, half, robot, dock, begin, sorted_dock, sorted_at, contact_start, contact, row
        )
        row_count[robot] = count
        ti.atomic_max(most, count)
    longest[0] = most
