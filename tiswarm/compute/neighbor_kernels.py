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

_STRIDE_Y = 1_640_531_527
_STRIDE_Z = 1_013_904_223
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
def _bucket_of_cube(cube, buckets):
    """Hash a cube to its bucket; `buckets` is a power of two."""
    key = cube[0] + _STRIDE_Y * cube[1] + _STRIDE_Z * cube[2]
    return ti.cast(key & ti.cast(buckets - 1, ti.i64), ti.i32)


@ti.func
def first_item(cells: Ref, structure, cube, which):
    """Read the head of the chain of one of the 27 cubes around and including `cube`.

    `which` runs from 0 to 26.
    """
    neighbor = cube + ti.Vector([which % 3 - 1, which // 3 % 3 - 1, which // 9 - 1])
    return cells.head[structure, _bucket_of_cube(neighbor, cells.head.shape[1])]


@ti.func
def link(cells: Ref, structure, item, cube):
    """Put an item in front of its bucket's chain."""
    bucket = _bucket_of_cube(cube, cells.head.shape[1])
    cells.following[structure, item] = cells.head[structure, bucket]
    cells.head[structure, bucket] = item


@ti.func
def relink(cells: Ref, structure, item, old, new):
    """Move an item from the chain of one cube to the front of another's."""
    bucket = _bucket_of_cube(old, cells.head.shape[1])
    if bucket != _bucket_of_cube(new, cells.head.shape[1]):
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
LONGEST_RUN = 10
"""Most cells along x that the ball around a dock reaches."""
BLOCK = 32
"""Sorted docks that are compared at a time."""
_FEW = 256
"""Docks up to which each is compared with all later ones: sorting them into cells takes longer."""
AHEAD = 6_144
"""Docks from one at work to one that is read ahead; what lies between fits into a core's cache."""
SCAN_BLOCK = 256
"""Numbers that one thread sums up: buckets, then totals of these, then totals of those."""
_FINE = 6
"""Docks are also placed on a grid of cutoff / 2^_FINE; edges of cells are whole steps of it."""
_LENGTH_BITS = _FINE - 2
_WIDTH_BITS = _FINE + 1
_HALF = (1 << _FINE) + 1
"""Steps from a dock to the sides of a box that holds all near ones; one more, by rounding."""
_FIELD = 9
"""Bits of steps along an axis. A place packs three such fields, each with a guard bit above it."""
_UNITS = 1 | 1 << _FIELD + 1 | 1 << 2 * (_FIELD + 1)
_STEPS = ((1 << _FIELD) - 1) * _UNITS
_GUARDS = (1 << _FIELD) * _UNITS


class Cells(NamedTuple):
    """M docks in the order of the buckets of their cells, one table after the other."""

    begin: Ints1
    """First slot of each bucket, then M and a spare, shape (buckets + 2,) a table."""

    dock: Ints1
    """Dock in each slot; docks of a bucket in ascending order, shape (M,)."""

    place: Ints1
    """Place of the dock in each slot, packed, then room for BLOCK more, shape (M + BLOCK,)."""


@ti.func
def dock_at(dock: Ref, base, m):
    """Read the place of dock `m` and, last, the number of its structure."""
    at = base + 4 * m
    return ti.Vector([dock[at], dock[at + 1], dock[at + 2], dock[at + 3]])


@ti.func
def read_ahead(base, m, number, dock: Ref):
    """Read docks past `m` by AHEAD, since caches fetch in time only what is read in order.

    Returns a number up to 0.
    """
    at = ti.min(base + 4 * (m + AHEAD), dock.shape[0] - 4 * number) + 3
    return -ti.cast(dock[at] + dock[at + 4 * (number - 1)], ti.i32)


@ti.func
def _steps_of(grid: Ref, at):
    """Find the place of a dock on the fine grid."""
    per_step = (1 << _FINE) / grid.cutoff
    return ti.Vector([ti.cast(ti.floor(at[c] * per_step), ti.i64) for c in range(3)])


@ti.func
def _packed(step):
    """Pack a place on the fine grid, modulo the length of a field, into one number."""
    number = 0
    for c in ti.static(range(3)):
        number |= ti.cast(step[c] & ((1 << _FIELD) - 1), ti.i32) << c * (_FIELD + 1)
    return number


@ti.func
def _bucket_of(grid: Ref, step, structure):
    """Hash the cell of a place to its bucket, linearly: those along x are in succession."""
    key = (step[0] >> _LENGTH_BITS) + grid.stride_y * (step[1] >> _WIDTH_BITS)
    key += grid.stride_z * (step[2] >> _WIDTH_BITS)
    key += _STRIDE_STRUCTURE * ti.cast(structure, ti.i64)
    return ti.cast(key & ti.cast(grid.buckets - 1, ti.i64), ti.i32)


@ti.func
def count_dock(grid: Ref, base, m, dock: Ref, cells: Ref):
    """Count a dock in its bucket; offset by two, so that scan and scatter yield starts in place."""
    at = dock_at(dock, base, m)
    ti.atomic_add(cells.begin[grid.table + _bucket_of(grid, _steps_of(grid, at), at[3]) + 2], 1)


@ti.func
def scatter_dock(grid: Ref, base, m, dock: Ref, cells: Ref):
    """Put a dock into the next free slot of its bucket."""
    at = dock_at(dock, base, m)
    step = _steps_of(grid, at)
    bucket = _bucket_of(grid, step, at[3])
    slot = grid.slot + ti.atomic_add(cells.begin[grid.table + bucket + 1], 1)
    cells.dock[slot] = m
    cells.place[slot] = _packed(step)


@ti.func
def sort_bucket(grid: Ref, bucket, cells: Ref):
    """Order the docks of a bucket by number, since threads have scattered them in any order."""
    first = grid.slot + cells.begin[grid.table + bucket]
    last = grid.slot + cells.begin[grid.table + bucket + 1]
    for slot in range(first + 1, last):
        m = cells.dock[slot]
        place = cells.place[slot]
        to = slot
        while to > first and cells.dock[ti.max(to - 1, 0)] > m:
            cells.dock[to] = cells.dock[to - 1]
            cells.place[to] = cells.place[to - 1]
            to -= 1
        cells.dock[to] = m
        cells.place[to] = place


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
    begin_out: Ints1, sorted_dock_out: Ints1, sorted_place_out: Ints1,  # Cells
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
    buckets = grid.buckets
    blocks = block_total_out.shape[0]
    groups = group_total_out.shape[0]
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
        sort_bucket(grid, bucket, cells)


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
def _is_in_box(place, corner):
    """Whether a place is up to 2 _HALF steps beyond another along each axis, three at once."""
    beyond = ((place | _GUARDS) - corner) & _STEPS
    return ((2 * _HALF * _UNITS | _GUARDS) - beyond) & _GUARDS == _GUARDS


@ti.func
def _find_in_box(grid: Ref, corner, at, past, cells: Ref):
    """Look at the next docks of a run: slot of the first, their number, bits of those in a box.

    They are up to BLOCK docks from `at` on; a run goes round the end of the table. The loop writes
    nothing and leaves none out, so that compilers compare many docks at a time.
    """
    end = cells.begin[grid.table + grid.buckets]
    first = grid.slot + ti.select(at < end, at, at - end)
    number = ti.min(BLOCK, past - at, ti.select(at < end, end - at, BLOCK))
    in_box = 0
    for k in range(BLOCK):
        in_box |= ti.cast(_is_in_box(cells.place[first + k], corner), ti.i32) << k
    return first, number, in_box & ti.cast((ti.i64(1) << number) - 1, ti.i32)


@ti.func
def _is_near(grid: Ref, query: Ref, candidate, dock: Ref):
    """Whether a dock is near, another robot's, and of the same structure."""
    at = dock_at(dock, query.base, candidate)
    apart = ti.Vector([ti.cast(at[c] - query.at[c], float) for c in range(3)])
    near = apart.norm_sqr() < grid.cutoff * grid.cutoff
    foreign = (candidate < grid.earlier * query.robot) | (candidate >= query.robot + grid.docks)
    fellow = at[3] == query.at[3]
    return ti.cast(near, ti.i32) & ti.cast(foreign, ti.i32) & ti.cast(fellow, ti.i32)


@ti.func
def _add_from_box(grid: Ref, query: Ref, first, in_box, dock: Ref, cells: Ref, rows: Ref, count):
    """Add to a row those of the docks whose bits are set that are near."""
    # If the place of an entry depended on a distance, later reads would wait for both.
    near = 0
    while in_box != 0:
        bit = ti.math.popcnt((in_box & -in_box) - 1)
        in_box &= in_box - 1
        near |= _is_near(grid, query, cells.dock[first + bit], dock) << bit
    while near != 0:
        neighbor = cells.dock[first + ti.math.popcnt((near & -near) - 1)]
        near &= near - 1
        entry = query.row + ti.min(count, query.free) * grid.entry_stride
        rows.entry[entry] = (neighbor << (grid.own_bits + 1)) | query.number
        count += 1
    return count


@ti.func
def _add_run(grid: Ref, query: Ref, at, past, dock: Ref, cells: Ref, rows: Ref, count):
    """Add to a row those of the sorted docks from `at` to `past` that are near."""
    while at < past:
        first, number, in_box = _find_in_box(grid, query.corner, at, past, cells)
        count = _add_from_box(grid, query, first, in_box, dock, cells, rows, count)
        at += number
    return count


@ti.func
def _run_of(grid: Ref, bucket, length, cells: Ref):
    """Find the sorted docks of a run of cells: the first, and the one after the last."""
    first = cells.begin[grid.table + bucket]
    past = cells.begin[grid.table + ti.min(bucket + length, grid.buckets)]
    if bucket + length > grid.buckets:
        past += cells.begin[grid.table + bucket + length - grid.buckets]
    return first, past


@ti.func
def _add_near(on_card: Static, grid: Ref, query: Ref, dock: Ref, cells: Ref, rows: Ref, count):
    """Add the docks near the query dock to a row; return how many entries it has then."""
    step = _steps_of(grid, query.at)
    # Cells along y and z beside that of the query: those on the nearer side.
    side_y = ti.select(step[1] & (1 << _FINE) == 0, -grid.stride_y, grid.stride_y)
    side_z = ti.select(step[2] & (1 << _FINE) == 0, -grid.stride_z, grid.stride_z)
    first_cell = (step[0] - _HALF) >> _LENGTH_BITS
    last_cell = (step[0] + _HALF) >> _LENGTH_BITS
    length = ti.cast(last_cell - first_cell, ti.i32) + 1
    step[0] -= _HALF
    own_bucket = _bucket_of(grid, step, query.at[3])
    if ti.static(on_card):
        end = cells.begin[grid.table + grid.buckets]
        for column in range(4):
            bucket = own_bucket + (column & 1) * side_y + (column >> 1) * side_z
            at, past = _run_of(grid, bucket & (grid.buckets - 1), length, cells)
            while at < past:
                slot = grid.slot + ti.select(at < end, at, at - end)
                if _is_in_box(cells.place[slot], query.corner):
                    count = _add_from_box(grid, query, slot, 1, dock, cells, rows, count)
                at += 1
    else:
        none = ti.Vector([0, 0, 0, 0])
        at = none
        past = none
        first = none
        number = none
        in_box = none
        # A core reads all four runs before it branches, since it cannot predict how many are near.
        for c in ti.static(range(4)):
            bucket = own_bucket + (c & 1) * side_y + (c >> 1) * side_z
            at[c], past[c] = _run_of(grid, bucket & (grid.buckets - 1), length, cells)
            first[c], number[c], in_box[c] = _find_in_box(grid, query.corner, at[c], past[c], cells)
        for c in range(4):
            count = _add_from_box(grid, query, first[c], in_box[c], dock, cells, rows, count)
            count = _add_run(grid, query, at[c] + number[c], past[c], dock, cells, rows, count)
    return count


@ti.func
def _without_connected(grid: Ref, connected, rows: Ref, place, count):
    """Remove from a row the docks that its first entries list as connected."""
    flag = 1 << grid.own_bits
    for c in range(connected):
        same = rows.entry[place + c * grid.entry_stride] ^ flag
        duplicate = -1
        for e in range(connected, count):
            entry = rows.entry[place + e * grid.entry_stride]
            duplicate = ti.max(duplicate, ti.select(entry == same, e, -1))
        if duplicate >= 0:
            count -= 1
            last = rows.entry[place + count * grid.entry_stride]
            rows.entry[place + duplicate * grid.entry_stride] = last
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
        if ti.static(not on_card):
            count = ti.max(count, read_ahead(base, row * grid.docks, grid.docks, dock))
        robot = row - row % grid.docks if ti.static(on_card) else row * grid.docks
        for number in range(row_docks):
            place = dock_at(dock, base, row * row_docks + number)
            query = ti.Struct(
                at=place, corner=_packed(_steps_of(grid, place) - _HALF), number=number, base=base,
                robot=robot, row=at, free=free,
            )  # fmt: skip
            if is_sorted:
                count = _add_near(on_card, grid, query, dock, cells, rows, count)
            else:
                later = (ti.Vector([row + 1, span[1]]) - span[0]) * grid.docks
                count = _add_run(grid, query, later[0], later[1], dock, cells, rows, count)
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
def list_structure(
    grid: Ref, s, base, dock: Ref, cells: Ref, connections: Ref, rows: Ref, structure: Ref
):
    """Sort the docks of one small structure and write its rows, on one thread.

    Of very few docks each is compared with all: sorting would take longer.
    """
    span = ti.Vector([structure[s, StructureTable.FIRST], structure[s, StructureTable.END]])
    docks = span * grid.docks
    is_sorted = grid.earlier == 1 or docks[1] - docks[0] > _FEW
    if is_sorted:
        for k in range(grid.buckets + 2):
            cells.begin[grid.table + k] = 0
        for m in range(docks[0], docks[1]):
            count_dock(grid, base, m, dock, cells)
        _sum_up(cells.begin, grid.table + 2, grid.table + grid.buckets + 2)
        for m in range(docks[0], docks[1]):
            scatter_dock(grid, base, m, dock, cells)
        for bucket in range(grid.buckets):
            sort_bucket(grid, bucket, cells)
    else:
        for k in range(docks[1] - docks[0]):
            cells.dock[grid.slot + k] = docks[0] + k
            at = dock_at(dock, base, docks[0] + k)
            cells.place[grid.slot + k] = _packed(_steps_of(grid, at))
        cells.begin[grid.table + grid.buckets] = docks[1] - docks[0]
    space = ti.Vector([structure[s, StructureTable.ROW], structure[s, StructureTable.ROOM]])
    used = _fill_rows_of(
        False, grid, base, span, is_sorted, dock, cells, connections, rows, space
    )  # fmt: skip
    structure[s, StructureTable.LONGEST] = ti.max(structure[s, StructureTable.LONGEST], used)
    structure[s, StructureTable.BUILDS] += 1


@ti.kernel
def fill_rows(
    on_card: Static, docks: I32, own_bits: I32, cutoff: Float, stride_y: I32, stride_z: I32,
    entry_stride: I32, run: I32, run_stride: I32, room: I32, base: I32, dock: Reals1,
    longest_out: Ints1,
    begin: Ints1, sorted_dock: Ints1, sorted_place: Ints1,  # Cells
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
        stride_z=stride_z, buckets=begin.shape[0] - 2, table=0, slot=0,
        entry_stride=entry_stride if ti.static(on_card) else 1,  # which compilers should know
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
