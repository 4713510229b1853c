"""One step of the whole swarm under the virtual forces, and many steps of small structures.

A force is the step of a robot's center in one iteration [R]. It is gathered from a robot's row,
never scattered, so runs repeat bit for bit. Docks are read from one half of `dock` and written
to the other. `grid` is as in `tiswarm.compute.neighbor_kernels`; `law` holds the gains, D and the
largest step.
"""

from tiswarm.compute.dialect import (
    GRAIN,
    I32,
    Float,
    Ints1,
    Ints2,
    Reals1,
    Reals2,
    Reals3,
    ti,
)  # fmt: skip
from tiswarm.compute.kernels import vector_at
from tiswarm.compute.neighbor_kernels import list_structure
from tiswarm.compute.rotations import rotate
from tiswarm.engine.force_kernels import TINY, capped, pull_of

TAKEN = 0
STALE = 1
UNKNOWN = -1e30


@ti.func
def virtual_force(
    grid: ti.template(),
    law: ti.template(),
    ramp,
    half,
    robot,
    entries,
    dock: ti.template(),
    row: ti.template(),
):
    """Sum of Eqs. (1) and (2) over a robot's row."""
    force = ti.Vector([0.0, 0.0, 0.0])
    place = robot * grid.robot_stride
    flag = 1 << grid.own_bits
    attraction = law.attraction_gain * ramp
    repulsion = law.repulsion_gain * (1.0 - ramp)
    for e in range(entries):
        entry = row[place + e * grid.entry_stride]
        own = robot * grid.docks + (entry & (flag - 1))
        other = entry >> (grid.own_bits + 1)
        offset = ti.Vector(
            [
                dock[half, other, 0] - dock[half, own, 0],
                dock[half, other, 1] - dock[half, own, 1],
                dock[half, other, 2] - dock[half, own, 2],
            ]
        )
        distance = offset.norm()
        pull = pull_of(distance, (entry & flag) != 0, attraction, repulsion, law.spacing)
        force += pull / ti.max(distance, TINY) * offset
    return force


@ti.func
def step_robot(
    grid: ti.template(),
    law: ti.template(),
    ramp,
    half,
    robot,
    entries,
    dock: ti.template(),
    row: ti.template(),
    arm: ti.template(),
    height: ti.template(),
    reference: ti.template(),
    position: ti.template(),
):
    """Move a robot by its forces; return its squared step and distance from its list's place."""
    here = vector_at(position, robot)
    force = virtual_force(grid, law, ramp, half, robot, entries, dock, row)
    if law.height_gain > 0.0:  # nested, since the language evaluates both sides of an `and`
        if height[robot] != UNKNOWN:
            force[2] += law.height_gain * (height[robot] - here[2])
    step = capped(force, law.max_step)
    here += step
    strayed = 0.0
    for c in ti.static(range(3)):
        position[robot, c] = here[c]
        strayed += (here[c] - reference[robot, c]) ** 2
    first = robot * grid.docks
    for k in range(grid.docks):
        for c in ti.static(range(3)):
            dock[1 - half, first + k, c] = here[c] + arm[first + k, c]
    return step.norm_sqr(), strayed


@ti.kernel
def take_step(
    docks: I32,
    own_bits: I32,
    robot_stride: I32,
    entry_stride: I32,
    attraction_gain: Float,
    repulsion_gain: Float,
    height_gain: Float,
    spacing: Float,
    max_step: Float,
    stray_limit: Float,
    t: I32,
    ramp: Float,
    dock: Reals3,
    row: Ints1,
    row_count: Ints1,
    arm: Reals2,
    height: Reals1,
    reference: Reals2,
    position: Reals2,
    control: Ints1,
    largest_move: Reals1,
):
    """Move every robot once, unless the list has gone stale.

    Args:
        stray_limit: How far a robot may be from where its row was made.
        t: Which step.
        ramp: Share of attraction in this step.
        dock: Places of docks, read from half `t % 2`, shape (2, M, 4).
        row: Rows of the neighbor list.
        row_count: Length of each, shape (N,).
        arm: Center to dock, world frame [R], shape (M, 3).
        height: Height that is pulled toward, or UNKNOWN [R], shape (N,) or (1,) if unused.
        reference: Positions for which the rows were made, shape (N, 3).
        position: Read and written, shape (N, 3).
        control: Steps taken, and whether rows are stale; read and written.
        largest_move: Written: largest step of a robot in step t [R], shape (T,) or longer.
    """
    grid = ti.Struct(
        docks=docks, own_bits=own_bits, robot_stride=robot_stride, entry_stride=entry_stride
    )
    law = ti.Struct(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, height_gain=height_gain,
        spacing=spacing, max_step=max_step,
    )  # fmt: skip
    moved = 0.0
    strayed = 0.0
    for robot in range(row_count.shape[0]):
        if control[STALE] == 0:
            step, way = step_robot(
                grid, law, ramp, t % 2, robot, row_count[robot],
                dock, row, arm, height, reference, position,
            )  # fmt: skip
            ti.atomic_max(moved, step)
            ti.atomic_max(strayed, way)
    if control[STALE] == 0:
        control[TAKEN] = t + 1
        control[STALE] = ti.cast(strayed > stray_limit * stray_limit, ti.i32)
        largest_move[t] = ti.sqrt(moved)


@ti.kernel
def place_docks(
    orientation_wxyz: Reals2,
    dock_offset_body: Reals2,
    structure: Ints1,
    position: Reals2,
    arm: Reals2,
    dock: Reals3,
):
    """Turn every robot's docks into the world.

    Args:
        orientation_wxyz: Body to world, shape (N, 4).
        dock_offset_body: Center to dock, body frame [R], shape (docks, 3).
        structure: Number of each robot's structure, shape (N,).
        position: Centers [R], shape (N, 3).
        arm: Written: center to dock, world frame [R], shape (N * docks, 3).
        dock: Written: places of docks and, last, their structure, twice, shape (2, N * docks, 4).
    """
    docks = dock_offset_body.shape[0]
    for m in range(arm.shape[0]):
        robot = m // docks
        k = m % docks
        turn = ti.Vector([orientation_wxyz[robot, c] for c in range(4)])
        offset = rotate(turn, ti.Vector([dock_offset_body[k, c] for c in range(3)]))
        for c in ti.static(range(3)):
            arm[m, c] = offset[c]
            for half in ti.static(range(2)):
                dock[half, m, c] = position[robot, c] + offset[c]
                dock[half, m, 3] = structure[robot]


@ti.kernel
def start_interval(position: Reals2, reference: Reals2, control: Ints1):
    """Remember where robots are as their rows are made; arguments as `take_step` has them."""
    for robot, c in ti.ndrange(position.shape[0], 3):
        reference[robot, c] = position[robot, c]
    control[STALE] = 0


@ti.kernel
def relax_structures(
    docks: I32,
    own_bits: I32,
    cutoff: Float,
    capacity: I32,
    attraction_gain: Float,
    repulsion_gain: Float,
    height_gain: Float,
    spacing: Float,
    max_step: Float,
    start: Ints1,
    ramp: Reals1,
    dock: Reals3,
    table: Ints2,
    begin: Ints1,
    sorted_dock: Ints1,
    sorted_at: Reals2,
    contact_start: Ints1,
    contact: Ints1,
    row: Ints1,
    row_count: Ints1,
    arm: Reals2,
    height: Reals1,
    reference: Reals2,
    position: Reals2,
    builds: Ints1,
    longest: Ints1,
    largest_move: Reals2,
):
    """Take every step of small structures, each on one thread; others as `take_step` has them.

    Args:
        start: First robot of each structure, shape (S + 1,).
        table: Where each structure's table starts, its buckets and strides, shape (S, 4).
        begin: Scratch: the tables.
        builds: Written: how often each structure's rows were made, shape (S,).
        longest: Written: its longest row; above `capacity` its robots stopped there, shape (S,).
        largest_move: Written: largest step of a robot by structure and step [R], shape (S, T).
    """
    law = ti.Struct(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, height_gain=height_gain,
        spacing=spacing, max_step=max_step,
    )  # fmt: skip
    stray_limit = 0.5 * (cutoff - spacing)
    for i in range((start.shape[0] - 1) * GRAIN):
        if i % GRAIN == 0:
            s = i // GRAIN
            grid = ti.Struct(
                docks=docks, own_bits=own_bits, cutoff=cutoff, table=table[s, 0],
                buckets=table[s, 1], stride_y=table[s, 2], stride_z=table[s, 3],
                slot=start[s] * docks, robot_stride=capacity + 1, entry_stride=1,
                capacity=capacity,
            )  # fmt: skip
            stale = 1
            builds[s] = 0
            longest[s] = 0
            for t in range(ramp.shape[0]):
                if stale == 1 and longest[s] <= capacity:
                    longest[s] = ti.max(longest[s], list_structure(
                        grid, t % 2, start[s], start[s + 1], dock, begin, sorted_dock, sorted_at,
                        contact_start, contact, row, row_count,
                    ))  # fmt: skip
                    builds[s] += 1
                    stale = 0
                    for robot in range(start[s], start[s + 1]):
                        for c in ti.static(range(3)):
                            reference[robot, c] = position[robot, c]
                if longest[s] <= capacity:
                    moved = 0.0
                    for robot in range(start[s], start[s + 1]):
                        step, way = step_robot(
                            grid, law, ramp[t], t % 2, robot, row_count[robot],
                            dock, row, arm, height, reference, position,
                        )  # fmt: skip
                        moved = ti.max(moved, step)
                        if way > stray_limit * stray_limit:
                            stale = 1
                    largest_move[s, t] = ti.sqrt(moved)
