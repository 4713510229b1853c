"""Kernels that find neighbors: a cell list that grows, and Verlet rows of docks sorted into cells.

`CellList` grows one item at a time. It is a hash table of chains: space is cut into cubes; a linear
hash of the cube's indices names a bucket, and each bucket holds a chain of items. Cubes that share
a bucket cost time but are never confused, since every item found is tested by its distance; and no
item is found twice, because the 27 cubes around a point always have 27 different buckets.

`Cells` hold all docks at once, in the order of a linear hash of their cells: a counting sort. Rows
are written of them. Functions work for one dock, bucket or row at a time. A swarm-wide loop over
threads and one thread that lists a whole small structure therefore run the same lines.

A robot has one row, or, where a graphics card computes (`on_card`), each of its docks has one: a
card needs many threads that each do little. An entry of a row is one integer: other dock, whether
the two are connected, own dock. `dock` holds places of docks and, last, the number of their
structure: rows of four numbers, the current ones from `base` on. They are real, or whole numbers of
some unit of length, which is that of the cutoff then. `grid` is a struct:

- docks: docks of a robot
- own_bits: bits of an entry that number the own dock within its row
- entry_stride: from one entry of a row to the next
- earlier: 1 if rows list the docks of all other robots, 0 if only those of later ones
- cutoff: docks nearer than this are neighbors
- stride_y, stride_z: from a bucket to that of the next cell along y and z; 1 along x
- buckets: size of the hash table, a power of two
- table, slot: where the structure starts in `Cells.begin`, and in `Cells.dock`

Where one thread lists a whole structure, `structure` has the columns of `StructureTable`.
"""

from typing import NamedTuple

import numpy as np

from tiswarm.compute.lang import I32, Columns, Float, Ints1, Ints2, Reals1, Ref, Static, ti

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


_STRIDE_STRUCTURE = 1_779_033_703
CELL_LENGTH = 0.25
"""Edge of a cell along x, in cutoffs: short, since runs of cells along x are cheap."""
CELL_WIDTH = 2.0
"""Edge along y and z, in cutoffs: the ball around a dock reaches at most one cell more."""
BLOCK = 16
"""Sorted docks that are compared at a time."""
_FEW = 256
"""Docks up to which each is compared with all later ones: sorting them into cells takes longer."""
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
        _note_place(slot, base, dock, cells)


@ti.func
def _note_place(slot, base, dock: Ref, cells: Ref):
    """Write the place of the dock in a slot."""
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


class StructureTable(Columns):
    """Columns of structures that one thread lists, S rows."""

    FIRST = 1
    """First robot of the structure."""
    END = 1
    """The one after its last."""
    TABLE = 1
    """Where its table starts in `Cells.begin`."""
    BUCKETS = 1
    """Size of its hash table, as `grid` has it."""
    STRIDE_Y = 1
    """Stride along y, as `grid` has it."""
    STRIDE_Z = 1
    """Stride along z, as `grid` has it."""
    ROW = 1
    """Its first entry in `Rows.entry`."""
    ROOM = 1
    """Entries that fit."""
    LONGEST = 1
    """Most entries that its rows needed; written."""
    BUILDS = 1
    """How often its rows were made; written."""


LONGEST_RUN = 10
"""Most cells along x that the ball around a dock reaches."""
_REACH_MARGIN = 1e-3
"""Lengthening of a reach, so that rounding cannot shorten it [cutoff]."""


class ConnectedDocks(NamedTuple):
    """Connected docks, as entries of the rows of both."""

    start: Ints1
    """First entry of each row, shape (rows + 1,)."""

    entry: Ints1
    """Entries row by row, shape (2 C,)."""


class Rows(NamedTuple):
    """Verlet rows: the neighbors of each robot, or of each dock, connected docks first."""

    entry: Ints1
    """Entries of all rows."""

    first: Ints1
    """Where each row starts, shape (rows,)."""

    count: Ints1
    """Entries of each row, those that did not fit included, shape (rows,)."""


@ti.func
def _nearer_side(value, index, per_width):
    """Find the cell beside its own that a place is nearer to (-1 or 1), and how near [cutoff]."""
    within = value * per_width - index
    side = ti.select(within < 1.0 - within, -1, 1)
    return side, CELL_WIDTH * ti.min(within, 1.0 - within)


@ti.func
def _square_distance(here, slot, cells: Ref):
    """Square the distance of a sorted dock from a place."""
    docks = cells.place.shape[0] // 4
    to_x = ti.cast(cells.place[slot] - here[0], float)
    to_y = ti.cast(cells.place[slot + docks] - here[1], float)
    to_z = ti.cast(cells.place[slot + 2 * docks] - here[2], float)
    return to_x * to_x + to_y * to_y + to_z * to_z


@ti.func
def _near_slots(here, square_cutoff, first, cells: Ref):
    """Set a bit for each of the BLOCK sorted docks from `first` on that is near.

    The loop writes nothing and leaves none out, so that compilers compare many docks at a time.
    """
    near = 0
    for k in range(BLOCK):
        near |= ti.cast(_square_distance(here, first + k, cells) < square_cutoff, ti.i32) << k
    return near


@ti.func
def _add_slot(grid: Ref, here, own, robot_first, slot, cells: Ref, rows: Ref, space, count):
    """Add a sorted dock to a row if it is another robot's of the same structure."""
    other = cells.dock[slot]
    # Always write, and count neighbors only: a branch could not be predicted.
    entry = space[0] + ti.min(count, space[1]) * grid.entry_stride
    rows.entry[entry] = (other << (grid.own_bits + 1)) | own
    foreign = (other < grid.earlier * robot_first) | (other >= robot_first + grid.docks)
    fellow = cells.place[slot + cells.place.shape[0] // 4 * 3] == here[3]
    return count + (ti.cast(foreign, ti.i32) & ti.cast(fellow, ti.i32))


@ti.func
def _add_run(
    on_card: Static, grid: Ref, here, own, robot_first, slots, cells: Ref, rows: Ref, space,
    count,
):  # fmt: skip
    """Add to a row those of the sorted docks in a range of slots that are near an own dock."""
    square_cutoff = grid.cutoff * grid.cutoff
    if ti.static(on_card):
        for slot in range(slots[0], slots[1]):
            if _square_distance(here, slot, cells) < square_cutoff:
                count = _add_slot(grid, here, own, robot_first, slot, cells, rows, space, count)
    else:
        at = slots[0]
        while at < slots[1]:
            wanted = (1 << ti.min(slots[1] - at, BLOCK)) - 1
            near = wanted & _near_slots(here, square_cutoff, at, cells)
            while near != 0:
                slot = at + ti.math.popcnt((near & -near) - 1)
                near &= near - 1
                count = _add_slot(grid, here, own, robot_first, slot, cells, rows, space, count)
            at += BLOCK
    return count


@ti.func
def _add_dock(
    on_card: Static, grid: Ref, here, own, robot_first, cells: Ref, rows: Ref, space, count
):
    """Add the docks near an own dock to a row; return how many entries it has then."""
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    y = cell(here[1], per_width)
    z = cell(here[2], per_width)
    side_y, gap_y = _nearer_side(here[1], y, per_width)
    side_z, gap_z = _nearer_side(here[2], z, per_width)
    end = cells.begin[grid.table + grid.buckets]
    for column in range(4):
        # In a column of cells, visit only the run that the ball around the dock can reach.
        one_y = column & 1
        one_z = column >> 1
        square = 1.0 - one_y * gap_y * gap_y - one_z * gap_z * gap_z
        if square > -_REACH_MARGIN:
            reach = (ti.sqrt(ti.max(square, 0.0)) + _REACH_MARGIN) * grid.cutoff
            left = cell(here[0] - reach, per_length)
            length = ti.min(cell(here[0] + reach, per_length) - left + 1, LONGEST_RUN)
            bucket = bucket_of_cell(grid, left, y + one_y * side_y, z + one_z * side_z, here[3])
            past = bucket + ti.cast(length, ti.i32)
            first = cells.begin[grid.table + bucket]
            last = cells.begin[grid.table + ti.min(past, grid.buckets)]
            if past > grid.buckets:  # the run goes round the end of the table
                last += cells.begin[grid.table + past - grid.buckets]
            slots = grid.slot + ti.Vector([first, ti.min(last, end)])
            count = _add_run(
                on_card, grid, here, own, robot_first, slots, cells, rows, space, count
            )
            if last > end:
                slots = grid.slot + ti.Vector([0, last - end])
                count = _add_run(
                    on_card, grid, here, own, robot_first, slots, cells, rows, space, count
                )
    return count


@ti.func
def _without_connected(grid: Ref, connected, rows: Ref, place, count):
    """Remove from a row the docks that its first entries list as connected."""
    flag = 1 << grid.own_bits
    for c in range(connected):
        same = rows.entry[place + c * grid.entry_stride] ^ flag
        found = -1
        for e in range(connected, count):
            entry = rows.entry[place + e * grid.entry_stride]
            found = ti.max(found, ti.select(entry == same, e, -1))
        if found >= 0:
            count -= 1
            last = rows.entry[place + count * grid.entry_stride]
            rows.entry[place + found * grid.entry_stride] = last
    return count


@ti.func
def _fill_rows_of(
    on_card: Static, grid: Ref, base, span, is_sorted, dock: Ref, cells: Ref,
    connections: Ref, rows: Ref, space,
):  # fmt: skip
    """Write rows from `span[0]` to `span[1]` in succession; return how many entries.

    Where docks are not sorted by cells, their slots are in the order of their numbers. A row lists
    the connected docks, then all others that are near. From `space[0]` on `space[1]` entries fit
    and a spare one. Entries that do not fit are counted, not written.
    """
    row_docks = 1 if ti.static(on_card) else grid.docks
    used = 0
    for row in range(span[0], span[1]):
        at = space[0] + ti.min(used, space[1])
        free = space[1] - ti.min(used, space[1])
        connected = connections.start[row + 1] - connections.start[row]
        for c in range(ti.min(connected, free)):
            entry = connections.entry[connections.start[row] + c]
            rows.entry[at + c * grid.entry_stride] = entry
        count = connected
        robot_first = row - row % grid.docks if ti.static(on_card) else row * grid.docks
        for own in range(row_docks):
            here = dock_at(dock, base, row * row_docks + own)
            room = ti.Vector([at, free])
            if is_sorted:
                count = _add_dock(on_card, grid, here, own, robot_first, cells, rows, room, count)
            else:
                later = grid.slot + (ti.Vector([row + 1, span[1]]) - span[0]) * grid.docks
                count = _add_run(
                    on_card, grid, here, own, robot_first, later, cells, rows, room, count
                )
        if count <= free:
            count = _without_connected(grid, connected, rows, at, count)
        rows.first[row] = at
        rows.count[row] = count
        used += count
    return used


@ti.func
def begin_structure(s, structure: Ref):
    """Begin to count for structure s: its rows were never made."""
    structure[s, StructureTable.LONGEST] = 0
    structure[s, StructureTable.BUILDS] = 0


@ti.func
def fits(s, structure: Ref):
    """Whether all rows of structure s fitted so far."""
    return structure[s, StructureTable.LONGEST] <= structure[s, StructureTable.ROOM]


@ti.func
def _sort_structure(grid: Ref, base, first, last, dock: Ref, cells: Ref):
    """Sort the docks `first` to `last` of one structure into cells, on one thread."""
    for k in range(grid.buckets + 2):
        cells.begin[grid.table + k] = 0
    for m in range(first, last):
        count_dock(grid, base, m, dock, cells)
    _sum_up(cells.begin, grid.table + 2, grid.table + grid.buckets + 2)
    for m in range(first, last):
        scatter_dock(grid, base, m, dock, cells)
    for bucket in range(grid.buckets):
        sort_bucket(grid, base, bucket, dock, cells)


@ti.func
def list_structure(
    grid: Ref, s, base, dock: Ref, cells: Ref, connections: Ref, rows: Ref, structure: Ref
):
    """Write the rows of one small structure, on one thread; see above."""
    first, last = structure[s, StructureTable.FIRST], structure[s, StructureTable.END]
    is_sorted = grid.earlier == 1 or (last - first) * grid.docks > _FEW
    if is_sorted:
        _sort_structure(grid, base, first * grid.docks, last * grid.docks, dock, cells)
    else:
        for m in range((last - first) * grid.docks):
            cells.dock[grid.slot + m] = first * grid.docks + m
            _note_place(grid.slot + m, base, dock, cells)
    space = ti.Vector([structure[s, StructureTable.ROW], structure[s, StructureTable.ROOM]])
    used = _fill_rows_of(
        False,
        grid,
        base,
        ti.Vector([first, last]),
        is_sorted,
        dock,
        cells,
        connections,
        rows,
        space,
    )
    structure[s, StructureTable.LONGEST] = ti.max(structure[s, StructureTable.LONGEST], used)
    structure[s, StructureTable.BUILDS] += 1


@ti.kernel
def fill_rows(
    on_card: Static, docks: I32, own_bits: I32, cutoff: Float, stride_y: I32, stride_z: I32,
    entry_stride: I32, run: I32, run_stride: I32, room: I32, base: I32, dock: Reals1,
    longest_out: Ints1,
    begin: Ints1, sorted_dock: Ints1, sorted_place: Reals1,  # Cells
    start: Ints1, connection: Ints1,  # ConnectedDocks
    entry_out: Ints1, row_first_out: Ints1, row_count_out: Ints1,  # Rows
):  # fmt: skip
    """Write all rows. Numbers are those of `grid`, with one table for all docks.

    Args:
        on_card: Whether each dock has a row, and many threads compare docks one by one.
        run: Rows that one thread writes in succession; 1 on cards.
        run_stride: From the start of one run's rows to that of the next; unused on cards.
        room: Entries that fit for a run's rows.
        base: Where the current docks start in `dock`.
        dock: Places, last the structure, rows of four.
        longest_out: Most entries of a run, shape (1,).
    """
    cells = ti.static(Cells(begin, sorted_dock, sorted_place))
    connections = ti.static(ConnectedDocks(start, connection))
    rows = ti.static(Rows(entry_out, row_first_out, row_count_out))
    grid = ti.Struct(
        docks=docks, own_bits=own_bits, earlier=1, cutoff=cutoff, stride_y=stride_y,
        stride_z=stride_z, buckets=begin.shape[0] - 2, entry_stride=entry_stride, table=0, slot=0,
    )  # fmt: skip
    longest_out[0] = 0
    count = row_count_out.shape[0]
    for first in range(count):
        if first % run == 0:
            place = first // run * run_stride
            if ti.static(on_card):  # threads that each walk the rows of a robot read side by side
                place = first // docks + first % docks * (count // docks)
            last = ti.min(first + run, count)
            used = _fill_rows_of(
                on_card, grid, base, ti.Vector([first, last]), True, dock, cells, connections,
                rows, ti.Vector([place, room]),
            )  # fmt: skip
            if used > longest_out[0]:  # most runs need no atomic operation then
                ti.atomic_max(longest_out[0], used)
