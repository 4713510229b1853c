"""All steps of small structures, one thread a structure."""

from tiswarm.compute.lang import GRAIN, I32, Float, Ints1, Ints2, Reals1, Reals2, Static, ti
from tiswarm.compute.neighbor_kernels import (
    BUCKETS,
    END,
    FIRST,
    STRIDE_Y,
    STRIDE_Z,
    TABLE,
    ConnectedDocks,
    Rows,
    begin_structure,
    fits,
    list_structure,
)
from tiswarm.compute.sorting_kernels import Cells
from tiswarm.engine.kernels import Gains, SwarmState, share_at, step_robot


@ti.kernel
def relax_structures(
    guided: Static, own_bits: I32, cutoff: Float, stray_limit: Float, unit: Float,
    attraction_gain: Float, repulsion_gain: Float, height_gain: Float, spacing: Float,
    max_step: Float, parting_gain: Float, momentum: Float,  # Gains
    share: Reals2, structure_out: Ints2,
    begin_out: Ints1, sorted_dock_out: Ints1, sorted_place_out: Reals1,  # Cells
    connection_start: Ints1, connection: Ints1,  # ConnectedDocks
    entry_out: Ints1, row_first_out: Ints1, row_count_out: Ints1,  # Rows
    position_out: Reals2, reference_out: Reals2, height: Reals1, arm: Reals2, dock_out: Reals1,
    mobility: Reals2, last_step_out: Reals2,  # SwarmState
    largest_move_out: Reals2,
):  # fmt: skip
    """Take every step of small structures, each on one thread.

    A structure stops where its rows do not fit.

    Args:
        guided: Whether robots have a mobility and inertia.
        own_bits: First number of `grid`.
        stray_limit: As for `step_robots`, like `unit`.
        share: Shares of attraction and repulsion in each step, shape (T, 2).
        structure_out: Columns as `neighbor_kernels` names them, shape (S, 10).
        largest_move_out: Longest step of a robot by structure and step [R], shape (S, T).
    """
    cells = ti.static(Cells(begin_out, sorted_dock_out, sorted_place_out))
    connections = ti.static(ConnectedDocks(connection_start, connection))
    rows = ti.static(Rows(entry_out, row_first_out, row_count_out))
    robots = ti.static(SwarmState(
        position_out, reference_out, height, arm, dock_out, mobility, last_step_out
    ))  # fmt: skip
    gains = ti.static(Gains(
        attraction_gain, repulsion_gain, height_gain, spacing, max_step, parting_gain, momentum
    ))  # fmt: skip
    table = ti.static(structure_out)
    docks = arm.shape[0] // position_out.shape[0]
    half = dock_out.shape[0] // 2
    for s, idle in ti.ndrange(table.shape[0], GRAIN):
        if idle == 0:
            first, end = table[s, FIRST], table[s, END]
            grid = ti.Struct(
                docks=docks, own_bits=own_bits, cutoff=cutoff, table=table[s, TABLE],
                buckets=table[s, BUCKETS], stride_y=table[s, STRIDE_Y],
                stride_z=table[s, STRIDE_Z], slot=first * docks, entry_stride=1, unit=unit,
            )  # fmt: skip
            begin_structure(s, table)
            stale = 1
            for t in range(share.shape[0]):
                base = t % 2 * half
                if stale == 1 and fits(s, table):
                    list_structure(grid, s, base, dock_out, cells, connections, rows, table)
                    stale = 0
                    for robot in range(first, end):
                        for c in ti.static(range(3)):
                            reference_out[robot, c] = position_out[robot, c]
                if fits(s, table):
                    moved = 0.0
                    for robot in range(first, end):
                        moved_by, way = step_robot(
                            False, grid, gains, guided, share_at(share, t), base, half - base,
                            robot, rows, robots,
                        )  # fmt: skip
                        moved = ti.max(moved, moved_by)
                        if way > stray_limit * stray_limit:
                            stale = 1
                    largest_move_out[s, t] = ti.sqrt(moved)
