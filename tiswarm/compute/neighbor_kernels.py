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
- entry_stride: from one entry of a row to the next in `row`

`dock` holds places of docks and, last, the number of their structure: rows of four numbers, of
which `base` is where the current ones start.
"""

from tiswarm.compute.dialect import I32, Float, Ints1, Reals1, ti

STRIDE_STRUCTURE = 1_779_033_703
CELL_LENGTH = 0.25
"""Edge of a cell along x, in cutoffs: short, since runs of cells along x are cheap."""
CELL_WIDTH = 2.0
"""Edge along y and z, in cutoffs: the ball around a dock reaches one cell more at most."""
LONGEST_RUN = 10
"""Most cells along x that the ball around a dock reaches."""
REACH_MARGIN = 1e-3
"""What a reach is taken longer by [cutoff], so that rounding cannot shorten it."""
BLOCK = 16
"""Sorted docks that are compared at a time."""
SCAN_BLOCK = 512
"""Buckets that one thread sums up at a time."""


@ti.func
def dock_at(dock: ti.template(), base, m):
    """Place of dock `m` and, last, the number of its structure."""
    at = base + 4 * m
    return ti.Vector([dock[at], dock[at + 1], dock[at + 2], dock[at + 3]])


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
def count_dock(grid: ti.template(), base, m, dock: ti.template(), begin: ti.template()):
    """Count a dock in its bucket, two places on: there scan and scatter will leave the start."""
    ti.atomic_add(begin[grid.table + own_bucket(grid, dock_at(dock, base, m)) + 2], 1)


@ti.func
def scatter_dock(
    grid: ti.template(),
    base,
    m,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
):
    """Put a dock into the next free slot of its bucket."""
    bucket = own_bucket(grid, dock_at(dock, base, m))
    slot = grid.slot + ti.atomic_add(begin[grid.table + bucket + 1], 1)
    sorted_dock[slot] = m


@ti.func
def sort_bucket(
    grid: ti.template(),
    base,
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
        at = dock_at(dock, base, sorted_dock[slot])
        for c in ti.static(range(4)):
            sorted_at[slot + c * (sorted_at.shape[0] // 4)] = at[c]


@ti.func
def nearer_side(value, index, per_width):
    """Which cell beside its own a place is nearer to (-1 or 1), and how near, in cutoffs."""
    within = value * per_width - index
    side = ti.select(within < 1.0 - within, -1, 1)
    return side, CELL_WIDTH * ti.min(within, 1.0 - within)


@ti.func
def near_slots(here, square_cutoff, first, sorted_at: ti.template()):
    """Which of the BLOCK sorted docks from `first` on are near, a bit each.

    Nothing is written and all are looked at, wanted or not, so that compilers compare many
    docks at a time.
    """
    near = 0
    docks = sorted_at.shape[0] // 4
    for k in range(BLOCK):
        to_x = sorted_at[first + k] - here[0]
        to_y = sorted_at[first + k + docks] - here[1]
        to_z = sorted_at[first + k + 2 * docks] - here[2]
        square = to_x * to_x + to_y * to_y + to_z * to_z
        near |= ti.cast(square < square_cutoff, ti.i32) << k
    return near


@ti.func
def structure_at(slot, sorted_at: ti.template()):
    """Structure of a sorted dock."""
    return sorted_at[slot + sorted_at.shape[0] // 4 * 3]


@ti.func
def fill_row(
    grid: ti.template(),
    base,
    robot,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
    sorted_at: ti.template(),
    contact_start: ti.template(),
    contact: ti.template(),
    row: ti.template(),
    place,
    room,
):
    """List a robot's contacts, then all other docks near its own; return how many there are.

    The row starts at `place`, where there is room for `room` entries and one that holds nothing.
    What does not fit is counted, not written.
    """
    own_first = robot * grid.docks
    contacts = contact_start[robot + 1] - contact_start[robot]
    for c in range(ti.min(contacts, room)):
        row[place + c * grid.entry_stride] = contact[contact_start[robot] + c]
    count = contacts
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    square_cutoff = grid.cutoff * grid.cutoff
    end = begin[grid.table + grid.buckets]
    for own in range(grid.docks):
        here = dock_at(dock, base, own_first + own)
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
                # The run may go round the end of the sorted docks too.
                ends = ti.Vector([ti.min(first + length, end), first + length - end])
                for part in ti.static(range(2)):
                    at = first * (1 - part)
                    while at < ends[part]:
                        wanted = (1 << ti.min(ends[part] - at, BLOCK)) - 1
                        near = wanted & near_slots(here, square_cutoff, grid.slot + at, sorted_at)
                        while near != 0:
                            slot = grid.slot + at + ti.math.popcnt((near & -near) - 1)
                            near &= near - 1
                            other = sorted_dock[slot]
                            # Written always and kept if a neighbor: that cannot be predicted.
                            row[place + ti.min(count, room) * grid.entry_stride] = (
                                other << (grid.own_bits + 1)
                            ) | own
                            count += ti.cast(
                                (other < own_first) | (other >= own_first + grid.docks), ti.i32
                            ) & ti.cast(structure_at(slot, sorted_at) == here[3], ti.i32)
                        at += BLOCK
    if count <= room:
        flag = 1 << grid.own_bits
        for c in range(contacts):
            same = row[place + c * grid.entry_stride] ^ flag
            found = -1
            for e in range(contacts, count):
                found = ti.max(found, ti.select(row[place + e * grid.entry_stride] == same, e, -1))
            if found >= 0:
                count -= 1
                row[place + found * grid.entry_stride] = row[place + count * grid.entry_stride]
    return count


@ti.func
def fill_rows_of(
    grid: ti.template(),
    base,
    first_robot,
    last_robot,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
    sorted_at: ti.template(),
    contact_start: ti.template(),
    contact: ti.template(),
    row: ti.template(),
    row_first: ti.template(),
    row_count: ti.template(),
    place,
    room,
):
    """Write rows of successive robots, one behind the other; return how many entries they have."""
    used = 0
    for robot in range(first_robot, last_robot):
        free = ti.min(used, room)
        row_first[robot] = place + free
        row_count[robot] = fill_row(
            grid, base, robot, dock, begin, sorted_dock, sorted_at, contact_start, contact,
            row, place + free, room - free,
        )  # fmt: skip
        used += row_count[robot]
    return used


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
    base,
    first_robot,
    last_robot,
    dock: ti.template(),
    begin: ti.template(),
    sorted_dock: ti.template(),
    sorted_at: ti.template(),
    contact_start: ti.template(),
    contact: ti.template(),
    row: ti.template(),
    row_first: ti.template(),
    row_count: ti.template(),
    place,
    room,
):
    """Write the rows of one small structure, on one thread; return how many entries they have."""
    for k in range(grid.buckets + 2):
        begin[grid.table + k] = 0
    for m in range(first_robot * grid.docks, last_robot * grid.docks):
        count_dock(grid, base, m, dock, begin)
    for k in range(1, grid.buckets):
        begin[grid.table + k + 2] += begin[grid.table + k + 1]
    for m in range(first_robot * grid.docks, last_robot * grid.docks):
        scatter_dock(grid, base, m, dock, begin, sorted_dock)
    for bucket in range(grid.buckets):
        sort_bucket(grid, base, bucket, dock, begin, sorted_dock, sorted_at)
    return fill_rows_of(
        grid, base, first_robot, last_robot, dock, begin, sorted_dock, sorted_at, contact_start,
        contact, row, row_first, row_count, place, room,
    )  # fmt: skip


@ti.kernel
def sort_docks(
    docks: I32,
    cutoff: Float,
    stride_y: I32,
    stride_z: I32,
    base: I32,
    dock: Reals1,
    begin: Ints1,
    block_total: Ints1,
    sorted_dock: Ints1,
    sorted_at: Reals1,
):
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


@ti.kernel
def fill_rows(
    docks: I32,
    own_bits: I32,
    cutoff: Float,
    stride_y: I32,
    stride_z: I32,
    entry_stride: I32,
    run: I32,
    run_stride: I32,
    room: I32,
    base: I32,
    dock: Reals1,
    begin: Ints1,
    sorted_dock: Ints1,
    sorted_at: Reals1,
    contact_start: Ints1,
    contact: Ints1,
    row: Ints1,
    row_first: Ints1,
    row_count: Ints1,
    longest: Ints1,
):
    """Write every robot's row; arguments as above and as `sort_docks` has them.

    Args:
        run: Robots whose rows one thread writes one behind the other.
        run_stride: From where one run's rows start to where those of the next do.
        room: Entries that a run's rows may have in all.
        contact_start: First contact of each robot, shape (N + 1,).
        contact: Contacts as row entries, connected, shape (C,).
        row: Written.
        row_first: Written: where each robot's row starts, shape (N,).
        row_count: Written: entries of each row, those that did not fit included, shape (N,).
        longest: Written: most entries of a run, shape (1,).
    """
    grid = ti.Struct(
        docks=docks, own_bits=own_bits, cutoff=cutoff, stride_y=stride_y, stride_z=stride_z,
        buckets=begin.shape[0] - 2, entry_stride=entry_stride, table=0, slot=0,
    )  # fmt: skip
    most = 0
    robots = row_count.shape[0]
    for first in range(robots):
        if first % run == 0:
            used = fill_rows_of(
                grid, base, first, ti.min(first + run, robots), dock, begin, sorted_dock,
                sorted_at, contact_start, contact, row, row_first, row_count,
                first // run * run_stride, room,
            )  # fmt: skip
            ti.atomic_max(most, used)
    longest[0] = most
