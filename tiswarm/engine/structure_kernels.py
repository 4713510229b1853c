"""All steps of small structures, one thread a structure."""

from tiswarm.compute.lang import GRAIN, I32, Float, Ints1, Ints2, Reals1, Reals2, Static, ti
from tiswarm.compute.neighbor_kernels import Connections, Rows, list_structure
from tiswarm.compute.sorting_kernels import Cells
from tiswarm.engine.kernels import Gains, SwarmState, step_robot


@ti.kernel
def relax_structures(
    guided: Static, docks: I32, own_bits: I32, cutoff: Float, stray_limit: Float, unit: Float,
    capacity: I32,
    attraction_gain: Float, repulsion_gain: Float, height_gain: Float, spacing: Float,
    max_step: Float, parting_gain: Float, momentum: Float,  # Gains
    start: Ints1, ramp: Reals1, table: Ints2,
    begin: Ints1, sorted_dock: Ints1, sorted_place: Reals1,  # Cells
    connection_start: Ints1, connection: Ints1,  # Connections
    entry: Ints1, row_first: Ints1, row_count: Ints1,  # Rows
    position: Reals2, reference: Reals2, height: Reals1, arm: Reals2, dock: Reals1,
    mobility: Reals2, last_step: Reals2,  # SwarmState
    builds: Ints1, longest: Ints1, largest_move: Reals2,
):  # fmt: skip
    """Take every step of small structures, each on one thread.

    Args:
        guided: Whether robots have a mobility and inertia.
        docks: First number of `grid`.
        stray_limit: As for `step_robots`, like `unit`.
        capacity: Entries that fit in rows, a robot on average.
        start: First robot of each structure, shape (S + 1,).
        ramp: Share of attraction in each step, shape (T,).
        table: Where each structure's table starts, its buckets and strides, shape (S, 4).
        builds: Written: how often each structure's rows were made, shape (S,).
        longest: Written: most entries of its rows; a structure stopped where they did not fit,
            shape (S,).
        largest_move: Written: longest step of a robot by structure and step [R], shape (S, T).
    """
    cells = ti.static(Cells(begin, sorted_dock, sorted_place))
    connections = ti.static(Connections(connection_start, connection))
    rows = ti.static(Rows(entry, row_first, row_count))
    robots = ti.static(SwarmState(position, reference, height, arm, dock, mobility, last_step))
    gains = ti.static(Gains(
        attraction_gain, repulsion_gain, height_gain, spacing, max_step, parting_gain, momentum
    ))  # fmt: skip
    half = dock.shape[0] // 2
    for s, idle in ti.ndrange(start.shape[0] - 1, GRAIN):
        if idle == 0:
            grid = ti.Struct(
                docks=docks, own_bits=own_bits, cutoff=cutoff, table=table[s, 0],
                buckets=table[s, 1], stride_y=table[s, 2], stride_z=table[s, 3],
                slot=start[s] * docks, entry_stride=1, unit=unit,
            )  # fmt: skip
            room = capacity * (start[s + 1] - start[s])
            stale = 1
            builds[s] = 0
            longest[s] = 0
            for t in range(ramp.shape[0]):
                base = t % 2 * half
                if stale == 1 and longest[s] <= room:
                    longest[s] = ti.max(longest[s], list_structure(
                        grid, base, start[s], start[s + 1], dock, cells, connections, rows,
                        start[s] * capacity + s, room,
                    ))  # fmt: skip
                    builds[s] += 1
                    stale = 0
                    for robot in range(start[s], start[s + 1]):
                        for c in ti.static(range(3)):
                            reference[robot, c] = position[robot, c]
                if longest[s] <= room:
                    moved = 0.0
                    for robot in range(start[s], start[s + 1]):
                        moved_by, way = step_robot(
                            False, grid, gains, guided, ramp[t], base, half - base, robot, rows,
                            robots,
                        )  # fmt: skip
                        moved = ti.max(moved, moved_by)
                        if way > stray_limit * stray_limit:
                            stale = 1
                    largest_move[s, t] = ti.sqrt(moved)
