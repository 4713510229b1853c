"""Cell list, Verlet rows and the step, as loops that numba compiles.

A row lists the docks that interact with a robot's docks. An entry is one integer: 8 * other dock +
2 * own dock + connected. A dock has 4 numbers, so none straddles two cache lines. Each thread
computes one piece of the robots; one thread sorts the docks into cells.
"""

import numpy as np
from numba import njit, prange

FAST_MATH = {"reassoc", "contract", "nsz", "arcp", "afn"}
"""Fast-math flags, which allow the compiler to vectorize sums."""


@njit(cache=True, error_model="numpy", inline="always")
def _cell(coordinate, per_edge):
    return np.int64(np.floor(coordinate * per_edge))


@njit(cache=True, error_model="numpy")
def sort_by_cell(dock, reach, stride_y, stride_z, bucket, start, slot_dock, slot_id):
    """Sort K docks by the bucket of their cell; ids ascend within a cell.

    Cells are cubes of edge `reach`. Fills `bucket` (K,), `start` (buckets + 1,), `slot_dock`
    (K, 4) and `slot_id` (K,).
    """
    mask = start.size - 2
    per_edge = dock.dtype.type(1) / reach
    start[:] = 0
    for k in range(dock.shape[0]):
        x = _cell(dock[k, 0], per_edge)
        y = _cell(dock[k, 1], per_edge)
        z = _cell(dock[k, 2], per_edge)
        bucket[k] = (x + stride_y * y + stride_z * z) & mask
        start[bucket[k] + 1] += 1
    for b in range(mask + 1):
        start[b + 1] += start[b]
    for k in range(dock.shape[0]):
        slot = start[bucket[k]]
        start[bucket[k]] = slot + 1
        slot_dock[slot, 0] = dock[k, 0]
        slot_dock[slot, 1] = dock[k, 1]
        slot_dock[slot, 2] = dock[k, 2]
        slot_id[slot] = k
    for b in range(mask + 1, 0, -1):
        start[b] = start[b - 1]
    start[0] = 0


@njit(cache=True, error_model="numpy")
def _scan(low, high, own, reach, dock, slot_dock, slot_id, row, at):
    """Append the docks of other robots within reach in the slots `low` to `high`.

    Entries that do not fit are counted but not written.
    """
    x, y, z = dock[own, 0], dock[own, 1], dock[own, 2]
    first_own, k = own - own % 3, own % 3
    for slot in range(low, high):
        dx = slot_dock[slot, 0] - x
        dy = slot_dock[slot, 1] - y
        dz = slot_dock[slot, 2] - z
        other = slot_id[slot]
        row[min(at, row.size - 1)] = 8 * other + 2 * k
        foreign = (other < first_own) | (other >= first_own + 3)
        at += (dx * dx + dy * dy + dz * dz < reach * reach) & foreign
    return at


def _find_rows(
    dock,
    reach,
    stride_y,
    stride_z,
    start,
    slot_dock,
    slot_id,
    contact_start,
    contact_entry,
    first,
    end,
    entry,
    used,
):
    """Write each robot's row: its contacts at any distance, then the other docks within reach.

    Fills `first` and `end` (N,), `entry` (pieces, room) and `used` (pieces,), which exceeds the
    room if the entries do not fit.
    """
    buckets = start.size - 1
    pieces, room = entry.shape
    robots = first.size
    per_edge = dock.dtype.type(1) / reach
    for piece in prange(pieces):
        row = entry[piece]
        at = np.int64(0)
        for i in range(robots * piece // pieces, robots * (piece + 1) // pieces):
            first[i] = piece * room + at
            own_contacts = contact_entry[contact_start[i] : contact_start[i + 1]]
            for contact in own_contacts:
                row[min(at, room - 1)] = contact
                at += 1
            begin = at
            for k in range(3 * i, 3 * i + 3):
                x = _cell(dock[k, 0], per_edge) - 1
                y = _cell(dock[k, 1], per_edge) - 1
                z = _cell(dock[k, 2], per_edge) - 1
                for column in range(9):
                    b = x + stride_y * (y + column % 3) + stride_z * (z + column // 3)
                    b &= buckets - 1
                    over = max(b + 3 - buckets, 0)
                    low, high = start[b], start[b + 3 - over]
                    at = _scan(low, high, k, reach, dock, slot_dock, slot_id, row, at)
                    if over > 0:
                        at = _scan(0, start[over], k, reach, dock, slot_dock, slot_id, row, at)
            kept = begin
            for e in range(begin, min(at, room)):
                known = False
                for contact in own_contacts:
                    known |= contact == row[e] + 1
                row[kept] = row[e]
                kept += not known
            at = kept if at <= room else at
            end[i] = piece * room + at
        used[piece] = at


def _take_step(
    first,
    end,
    entry,
    dock,
    dock_offset,
    position,
    origin,
    attraction,
    repulsion,
    spacing,
    max_step,
    moved_position,
    moved_dock,
    farthest,
):
    """Move every robot by the forces on its docks, and measure its distance from `origin`.

    Fills `moved_position` (N, 3), `moved_dock` (3 N, 4) and `farthest` (pieces,), the largest
    squared distance from `origin`.
    """
    zero = spacing * 0
    robots = first.size
    pieces = farthest.size
    for piece in prange(pieces):
        far = zero
        for i in range(robots * piece // pieces, robots * (piece + 1) // pieces):
            fx, fy, fz = zero, zero, zero
            for e in range(first[i], end[i]):
                word = entry[e]
                own = 3 * i + ((word >> 1) & 3)
                other = word >> 3
                dx = dock[other, 0] - dock[own, 0]
                dy = dock[other, 1] - dock[own, 1]
                dz = dock[other, 2] - dock[own, 2]
                distance = np.sqrt(dx * dx + dy * dy + dz * dz)
                gap = distance - spacing
                pushed = min(gap, zero) * min(gap, zero)
                pulled = attraction * max(gap, zero) if word & 1 else zero
                pull = (pulled - repulsion * pushed * pushed) / distance
                fx += pull * dx
                fy += pull * dy
                fz += pull * dz
            squared = fx * fx + fy * fy + fz * fz
            if squared > max_step * max_step:
                scale = max_step / np.sqrt(squared)
                fx, fy, fz = scale * fx, scale * fy, scale * fz
            x, y, z = position[i, 0] + fx, position[i, 1] + fy, position[i, 2] + fz
            moved_position[i, 0], moved_position[i, 1], moved_position[i, 2] = x, y, z
            for k in range(3 * i, 3 * i + 3):
                moved_dock[k, 0] = x + dock_offset[k, 0]
                moved_dock[k, 1] = y + dock_offset[k, 1]
                moved_dock[k, 2] = z + dock_offset[k, 2]
            x, y, z = x - origin[i, 0], y - origin[i, 1], z - origin[i, 2]
            far = max(far, x * x + y * y + z * z)
        farthest[piece] = far


find_rows = njit(cache=True, error_model="numpy")(_find_rows)
take_step = njit(cache=True, error_model="numpy", fastmath=FAST_MATH)(_take_step)
find_rows_in_parallel = njit(cache=True, error_model="numpy", parallel=True)(_find_rows)
take_step_in_parallel = njit(cache=True, error_model="numpy", fastmath=FAST_MATH, parallel=True)(
    _take_step
)
