"""One step of the whole swarm under the virtual forces, and many steps of small structures.

A force is the step of a robot's center in one iteration [R]. It is gathered from a robot's row,
never scattered, so runs repeat bit for bit. Docks are read from the half of `dock` that starts at
`base` and written to the one at `next_base`. `grid` is as in `tiswarm.compute.neighbor_kernels`;
`law` holds the gains, D and the largest step.
"""

from tiswarm.compute.lang import (  # fmt: skip
    GRAIN,
    I32,
    Float,
    Ints1,
    Ints2,
    Reals1,
    Reals2,
    Ref,
    ti,
)
from tiswarm.compute.math_kernels import rotate, vector_at
from tiswarm.compute.neighbor_kernels import Cells, Connections, Rows, list_structure
from tiswarm.engine.force_kernels import TINY, capped, pull_of

TAKEN = 0
STALE = 1
STEPS_A_LAUNCH = 4
UNKNOWN = -1e30


@ti.func
def virtual_force(grid: Ref, law: Ref, ramp, base, robot, first, entries, dock: Ref, row: Ref):
    """Sum of Eqs. (1) and (2) over a robot's row."""
    force = ti.Vector([0.0, 0.0, 0.0])
    flag = 1 << grid.own_bits
    attraction = law.attraction_gain * ramp
    repulsion = law.repulsion_gain * (1.0 - ramp)
    for e in range(entries):
        entry = row[first + e * grid.entry_stride]
        own = base + 4 * (robot * grid.docks + (entry & (flag - 1)))
        other = base + 4 * (entry >> (grid.own_bits + 1))
        offset = ti.Vector(
            [
                dock[other] - dock[own],
                dock[other + 1] - dock[own + 1],
                dock[other + 2] - dock[own + 2],
            ]
        )
        distance = offset.norm()
        pull = pull_of(distance, (entry & flag) != 0, attraction, repulsion, law.spacing)
        force += pull / ti.max(distance, TINY) * offset
    return force


@ti.func
def step_robot(
    grid: Ref, law: Ref, ramp, base, next_base, robot, first, entries, dock: Ref, row: Ref,
    arm: Ref, height: Ref, reference: Ref, position: Ref,
):  # fmt: skip
    """Move a robot by its forces; return its squared step and distance from its list's place."""
    here = vector_at(position, robot)
    force = virtual_force(grid, law, ramp, base, robot, first, entries, dock, row)
    if law.height_gain > 0.0:  # nested, since the language evaluates both sides of an `and`
        if height[robot] != UNKNOWN:
            force[2] += law.height_gain * (height[robot] - here[2])
    step = capped(force, law.max_step)
    here += step
    strayed = 0.0
    for c in ti.static(range(3)):
        position[robot, c] = here[c]
        strayed += (here[c] - reference[robot, c]) ** 2
    for m in range(robot * grid.docks, (robot + 1) * grid.docks):
        for c in ti.static(range(3)):
            dock[next_base + 4 * m + c] = here[c] + arm[m, c]
    return step.norm_sqr(), strayed


@ti.kernel
def take_steps(
    docks: I32, own_bits: I32, entry_stride: I32, attraction_gain: Float, repulsion_gain: Float,
    height_gain: Float, spacing: Float, max_step: Float, stray_limit: Float, first_t: I32,
    ramp: Reals1, dock: Reals1, row: Ints1, row_first: Ints1, row_count: Ints1, arm: Reals2,
    height: Reals1, reference: Reals2, position: Reals2, control: Ints1, largest_move: Reals1,
):  # fmt: skip
    """Move every robot a few times, as long as the list has not gone stale.

    One launch for several steps, since each takes as long as a thousand robots do.

    Args:
        stray_limit: How far a robot may be from where its row was made.
        first_t: Which step comes first.
        ramp: Share of attraction in each step, shape (T,).
        dock: Places of docks, two halves of M rows of four; in step t the half `t % 2` is read.
        row: Rows of the neighbor list.
        row_first: Where each starts, shape (N,).
        row_count: Length of each, shape (N,).
        arm: Center to dock, world frame [R], shape (M, 3).
        height: Height that is pulled toward, or UNKNOWN [R], shape (N,) or (1,) if unused.
        reference: Positions for which the rows were made, shape (N, 3).
        position: Read and written, shape (N, 3).
        control: Steps taken, and whether rows are stale or no step is left; read and written.
        largest_move: Written: largest step of a robot in step t [R], shape (T,) or longer.
    """
    grid = ti.Struct(docks=docks, own_bits=own_bits, entry_stride=entry_stride)
    law = ti.Struct(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, height_gain=height_gain,
        spacing=spacing, max_step=max_step,
    )  # fmt: skip
    half = dock.shape[0] // 2
    for k in ti.static(range(STEPS_A_LAUNCH)):
        t = first_t + k
        moved = 0.0
        strayed = 0.0
        for robot in range(row_count.shape[0]):
            if control[STALE] == 0:
                base = (first_t + k) % 2 * half
                step, way = step_robot(
                    grid, law, ramp[first_t + k], base, half - base, robot, row_first[robot],
                    row_count[robot], dock, row, arm, height, reference, position,
                )  # fmt: skip
                ti.atomic_max(moved, step)
                ti.atomic_max(strayed, way)
        if control[STALE] == 0:
            control[TAKEN] = t + 1
            gone = strayed > stray_limit * stray_limit or t + 1 == ramp.shape[0]
            control[STALE] = ti.cast(gone, ti.i32)
            largest_move[t] = ti.sqrt(moved)


@ti.kernel
def turn_docks(orientation_wxyz: Reals2, dock_offset_body: Reals2, arm: Reals2):
    """Turn every robot's docks into the world.

    Args:
        orientation_wxyz: Body to world, shape (N, 4).
        dock_offset_body: Center to dock, body frame [R], shape (docks, 3).
        arm: Written: center to dock, world frame [R], shape (N * docks, 3).
    """
    docks = dock_offset_body.shape[0]
    for m in range(arm.shape[0]):
        turn = ti.Vector([orientation_wxyz[m // docks, c] for c in range(4)])
        offset = rotate(turn, vector_at(dock_offset_body, m % docks))
        for c in ti.static(range(3)):
            arm[m, c] = offset[c]


@ti.kernel
def place_docks(structure: Ints1, position: Reals2, arm: Reals2, dock: Reals1):
    """Place every robot's docks.

    Args:
        structure: Number of each robot's structure, shape (N,).
        position: Centers [R], shape (N, 3).
        arm: Center to dock, world frame [R], shape (N * docks, 3).
        dock: Written: places of docks and, last, their structure, rows of four, all of them twice.
    """
    docks = arm.shape[0] // position.shape[0]
    for m in range(arm.shape[0]):
        place = vector_at(position, m // docks) + vector_at(arm, m)
        for half in ti.static(range(2)):
            at = 4 * (half * arm.shape[0] + m)
            for c in ti.static(range(3)):
                dock[at + c] = place[c]
            dock[at + 3] = structure[m // docks]


@ti.kernel
def start_interval(position: Reals2, reference: Reals2, control: Ints1):
    """Remember where robots are as their rows are made; arguments as `take_step` has them."""
    for robot, c in ti.ndrange(position.shape[0], 3):
        reference[robot, c] = position[robot, c]
    control[STALE] = 0


@ti.kernel
def relax_structures(
    docks: I32, own_bits: I32, cutoff: Float, capacity: I32, attraction_gain: Float,
    repulsion_gain: Float, height_gain: Float, spacing: Float, max_step: Float, start: Ints1,
    ramp: Reals1, dock: Reals1, table: Ints2, begin: Ints1, sorted_dock: Ints1, sorted_at: Reals1,
    contact_start: Ints1, contact: Ints1, row: Ints1, row_first: Ints1, row_count: Ints1,
    arm: Reals2, height: Reals1, reference: Reals2, position: Reals2, builds: Ints1, longest: Ints1,
    largest_move: Reals2,
):  # fmt: skip
    """Take every step of small structures, each on one thread; others as `take_step` has them.

    Args:
        start: First robot of each structure, shape (S + 1,).
        table: Where each structure's table starts, its buckets and strides, shape (S, 4).
        begin: Scratch: the tables.
        builds: Written: how often each structure's rows were made, shape (S,).
        longest: Written: most entries of its rows; a structure stopped where they were more than
            `capacity` a robot, shape (S,).
        largest_move: Written: largest step of a robot by structure and step [R], shape (S, T).
    """
    law = ti.Struct(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, height_gain=height_gain,
        spacing=spacing, max_step=max_step,
    )  # fmt: skip
    cells = ti.static(Cells(begin, sorted_dock, sorted_at))
    connections = ti.static(Connections(contact_start, contact))
    rows = ti.static(Rows(row, row_first, row_count))
    stray_limit = 0.5 * (cutoff - spacing)
    half = dock.shape[0] // 2
    for i in range((start.shape[0] - 1) * GRAIN):
        if i % GRAIN == 0:
            s = i // GRAIN
            grid = ti.Struct(
                docks=docks, own_bits=own_bits, cutoff=cutoff, table=table[s, 0],
                buckets=table[s, 1], stride_y=table[s, 2], stride_z=table[s, 3],
                slot=start[s] * docks, entry_stride=1,
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
                        step, way = step_robot(
                            grid, law, ramp[t], base, half - base, robot, row_first[robot],
                            row_count[robot], dock, row, arm, height, reference, position,
                        )  # fmt: skip
                        moved = ti.max(moved, step)
                        if way > stray_limit * stray_limit:
                            stale = 1
                    largest_move[s, t] = ti.sqrt(moved)
