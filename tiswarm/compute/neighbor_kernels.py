"""Kernels of the neighbor list: a Verlet row for each robot, from docks sorted into cells.

An entry of a row is one integer: other dock, whether the two are connected, own dock. What
functions are given as `grid` is what `tiswarm.compute.sort_kernels` has, and

- own_bits: bits of an entry that number the robot's own dock
- entry_stride: from one entry of a row to the next in `row`
"""

from tiswarm.compute.lang import I32, Float, Ints1, Reals1, Ref, ti
from tiswarm.compute.sort_kernels import (
    BLOCK,
    CELL_LENGTH,
    CELL_WIDTH,
    bucket_of_cell,
    cell,
    dock_at,
    sort_structure,
)

LONGEST_RUN = 10
"""Most cells along x that the ball around a dock reaches."""
REACH_MARGIN = 1e-3
"""What a reach is taken longer by [cutoff], so that rounding cannot shorten it."""


@ti.func
def nearer_side(value, index, per_width):
    """Which cell beside its own a place is nearer to (-1 or 1), and how near, in cutoffs."""
    within = value * per_width - index
    side = ti.select(within < 1.0 - within, -1, 1)
    return side, CELL_WIDTH * ti.min(within, 1.0 - within)


@ti.func
def near_slots(here, square_cutoff, first, sorted_at: Ref):
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
def structure_at(slot, sorted_at: Ref):
    """Structure of a sorted dock."""
    return sorted_at[slot + sorted_at.shape[0] // 4 * 3]


@ti.func
def add_run(
    grid: Ref, here, own, own_first, first, last, sorted_dock: Ref, sorted_at: Ref, row: Ref, place,
    room, count,
):  # fmt: skip
    """Add those of the sorted docks `first` to `last` to a row that are near an own dock."""
    square_cutoff = grid.cutoff * grid.cutoff
    at = first
    while at < last:
        wanted = (1 << ti.min(last - at, BLOCK)) - 1
        near = wanted & near_slots(here, square_cutoff, at, sorted_at)
        while near != 0:
            slot = at + ti.math.popcnt((near & -near) - 1)
            near &= near - 1
            other = sorted_dock[slot]
            # Written always and kept if a neighbor: which it is cannot be predicted.
            row[place + ti.min(count, room) * grid.entry_stride] = (
                other << (grid.own_bits + 1)
            ) | own
            count += ti.cast(
                (other < own_first) | (other >= own_first + grid.docks), ti.i32
            ) & ti.cast(structure_at(slot, sorted_at) == here[3], ti.i32)
        at += BLOCK
    return count


@ti.func
def add_dock(
    grid: Ref, here, own, own_first, begin: Ref, sorted_dock: Ref, sorted_at: Ref, row: Ref, place,
    room, count,
):  # fmt: skip
    """Add the docks near an own dock to a row; return how many entries it has then."""
    per_length = 1.0 / (CELL_LENGTH * grid.cutoff)
    per_width = 1.0 / (CELL_WIDTH * grid.cutoff)
    y = cell(here[1], per_width)
    z = cell(here[2], per_width)
    side_y, gap_y = nearer_side(here[1], y, per_width)
    side_z, gap_z = nearer_side(here[2], z, per_width)
    end = begin[grid.table + grid.buckets]
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
            last = begin[grid.table + ti.min(past, grid.buckets)]
            if past > grid.buckets:  # the run goes round the end of the table
                last += begin[grid.table + past - grid.buckets]
            count = add_run(
                grid, here, own, own_first, grid.slot + first, grid.slot + ti.min(last, end),
                sorted_dock, sorted_at, row, place, room, count,
            )  # fmt: skip
            if last > end:
                count = add_run(
                    grid, here, own, own_first, grid.slot, grid.slot + last - end,
                    sorted_dock, sorted_at, row, place, room, count,
                )  # fmt: skip
    return count


@ti.func
def without_contacts(grid: Ref, contacts, row: Ref, place, count):
    """Take those docks off a row that stand at its head as contacts."""
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
def fill_row(
    grid: Ref, base, robot, dock: Ref, begin: Ref, sorted_dock: Ref, sorted_at: Ref,
    contact_start: Ref, contact: Ref, row: Ref, place, room,
):  # fmt: skip
    """List a robot's contacts, then all other docks near its own; return how many there are.

    The row starts at `place`, where there is room for `room` entries and one that holds nothing.
    What does not fit is counted, not written.
    """
    own_first = robot * grid.docks
    contacts = contact_start[robot + 1] - contact_start[robot]
    for c in range(ti.min(contacts, room)):
        row[place + c * grid.entry_stride] = contact[contact_start[robot] + c]
    count = contacts
    for own in range(grid.docks):
        here = dock_at(dock, base, own_first + own)
        count = add_dock(
            grid, here, own, own_first, begin, sorted_dock, sorted_at, row, place, room, count
        )
    if count <= room:
        count = without_contacts(grid, contacts, row, place, count)
    return count


@ti.func
def fill_rows_of(
    grid: Ref, base, first_robot, last_robot, dock: Ref, begin: Ref, sorted_dock: Ref,
    sorted_at: Ref, contact_start: Ref, contact: Ref, row: Ref, row_first: Ref, row_count: Ref,
    place, room,
):  # fmt: skip
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
def list_structure(
    grid: Ref, base, first_robot, last_robot, dock: Ref, begin: Ref, sorted_dock: Ref,
    sorted_at: Ref, contact_start: Ref, contact: Ref, row: Ref, row_first: Ref, row_count: Ref,
    place, room,
):  # fmt: skip
    """Write the rows of one small structure, on one thread; return how many entries they have."""
    sort_structure(
        grid, base, first_robot * grid.docks, last_robot * grid.docks, dock, begin, sorted_dock,
        sorted_at,
    )  # fmt: skip
    return fill_rows_of(
        grid, base, first_robot, last_robot, dock, begin, sorted_dock, sorted_at, contact_start,
        contact, row, row_first, row_count, place, room,
    )  # fmt: skip


@ti.kernel
def fill_rows(
    docks: I32, own_bits: I32, cutoff: Float, stride_y: I32, stride_z: I32, entry_stride: I32,
    run: I32, run_stride: I32, room: I32, base: I32, dock: Reals1, begin: Ints1, sorted_dock: Ints1,
    sorted_at: Reals1, contact_start: Ints1, contact: Ints1, row: Ints1, row_first: Ints1,
    row_count: Ints1, longest: Ints1,
):  # fmt: skip
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
