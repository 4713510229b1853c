"""Steps of every robot of every chain: forces, then motions, then the age of the Verlet rows."""

from tiswarm.compute.lang import (
    GRAIN,
    I32,
    Float,
    Ints1,
    Ints2,
    Reals1,
    Reals2,
    Reals3,
    Ref,
    Static,
    ti,
)  # fmt: skip
from tiswarm.compute.neighbor_kernels import Cells, Connections, Rows, list_structure
from tiswarm.localization.joint.arrays import (
    Blocks,
    Contacts,
    Priors,
    Robots,
    Step,
    Subtrees,
    Swarm,
)  # fmt: skip
from tiswarm.localization.joint.force_kernels import pull_robot
from tiswarm.localization.joint.motion_kernels import move_robot, move_subtrees

SKIN = 2.0
"""Reach of Verlet rows beyond the distance at which docks can touch [R]."""
THIN_SKIN = 0.01
"""Skin while robots move too fast for longer rows to serve two steps [R]."""
SMALLEST = 0.1
"""Size of docks in the first step, as a part of their full size. Docks that are solid at once push
each other out of the initial heap faster than friction takes the heat away."""
STALE = -1
"""Age of rows that have to be built anew."""


@ti.func
def grow_old(b, strayed, blocks: Ref):
    """Decide whether the rows of block b serve one more step, and how far the next ones reach.

    Args:
        b: The block.
        strayed: Largest squared distance of a robot from where its row was built [R^2].
        blocks: Ages and skins.
    """
    is_new = blocks.age[b] == 0
    blocks.age[b] = ti.select(strayed > (0.5 * blocks.skin[b]) ** 2, STALE, blocks.age[b] + 1)
    if is_new:
        blocks.skin[b] = ti.select(strayed > (0.25 * SKIN) ** 2, THIN_SKIN, SKIN)


@ti.func
def growth_at(t, growing):
    """Size of the docks in step `t`, as a part of their full size."""
    return ti.min(1.0, ti.max(SMALLEST, (t + 1.0) / growing))


@ti.kernel
def take_steps(
    by_block: Static,
    docks: Static,
    turning: Static,
    own_bits: I32,
    entry_stride: I32,
    capacity: I32,
    near: Float,
    seed: I32,
    until: I32,
    hold: I32,
    growing: Float,
    inertia_factor: Float,
    sigma: Reals2,
    # Robots
    structure: Ints1,
    number: Ints1,
    non_overlap: Ints1,
    robust: Reals1,
    # Contacts
    contact_start: Ints1,
    partner: Ints1,
    is_final: Ints1,
    extension: Reals1,
    contact_shift: Reals2,
    lever: Reals2,
    variance: Reals1,
    # Priors
    place: Reals2,
    precision: Reals2,
    walk: Reals2,
    yaw_precision: Reals1,
    # Subtrees
    subtree: Ints1,
    subtree_table: Ints2,
    subtree_weight: Reals1,
    first_subtree: Ints1,
    subtree_pull: Reals2,
    subtree_velocity: Reals2,
    subtree_shift: Reals2,
    table: Ints2,
    # Cells
    begin: Ints1,
    sorted_dock: Ints1,
    sorted_place: Reals1,
    # Connections
    none_start: Ints1,
    none: Ints1,
    longest: Ints1,
    # Rows
    entry: Ints1,
    row_first: Ints1,
    row_count: Ints1,
    # Swarm
    arm: Reals3,
    position: Reals2,
    velocity: Reals2,
    force: Reals2,
    mass: Reals1,
    heading: Reals2,
    total: Reals2,
    square_total: Reals1,
    # Blocks
    block_start: Ints1,
    taken: Ints1,
    age: Ints1,
    skin: Reals1,
    listed: Reals1,
):
    """Move every robot but the anchors, from the step that was taken last.

    Args:
        by_block: Whether one thread takes all steps of a block, and builds its rows anew when they
            are stale. Else all threads take the next step together, and the host builds rows.
        docks: Docks of a robot.
        turning: Whether any robot turns; no bit of others depends on it.
        own_bits: Bits of a row's entry that are of no use here.
        entry_stride: From one entry to the next.
        capacity: Entries that rows can hold, on average over a block.
        near: Largest distance of robots whose docks overlap [R].
        seed: Seed of the random numbers.
        until: Step before which to stop.
        hold: First step that counts for the averages.
        growing: Steps in which docks grow to their full size.
        inertia_factor: Factor of every mass; 4 halves the steps.
        sigma: Square root of the temperature of each structure at each step [R], shape (S, steps).
        structure: First array of `Robots`, whose others follow; then come those of `Contacts`,
            `Priors` and `Subtrees`.
        table: Where each block's table starts, its buckets and strides, shape (B, 4); `Cells` and
            `Connections` follow.
        longest: Written: entries of a block's rows; if too many, it stopped there, shape (B,).
        entry: First array of `Rows`; those of `Swarm` and `Blocks` follow.
    """
    robots = ti.static(Robots(structure, number, non_overlap, robust))
    contacts = ti.static(
        Contacts(contact_start, partner, is_final, extension, contact_shift, lever, variance)
    )
    priors = ti.static(Priors(place, precision, walk, yaw_precision))
    trees = ti.static(
        Subtrees(
            subtree, subtree_table, subtree_weight, first_subtree, subtree_pull, subtree_velocity,
            subtree_shift,
        )
    )  # fmt: skip
    cells = ti.static(Cells(begin, sorted_dock, sorted_place))
    connections = ti.static(Connections(none_start, none))
    rows = ti.static(Rows(entry, row_first, row_count))
    swarm = ti.static(Swarm(arm, position, velocity, force, mass, heading, total, square_total))
    blocks = ti.static(Blocks(block_start, taken, age, skin, listed))
    if ti.static(by_block):
        for i in range(taken.shape[0] * GRAIN):
            if i % GRAIN == 0:
                b = i // GRAIN
                start, end = block_start[b], block_start[b + 1]
                grid = ti.Struct(
                    docks=1, own_bits=own_bits, cutoff=near, near=near,
                    table=table[b, 0], buckets=table[b, 1], stride_y=table[b, 2],
                    stride_z=table[b, 3], slot=start, entry_stride=entry_stride,
                )  # fmt: skip
                room = capacity * (end - start)
                longest[b] = 0
                while taken[b] < until and longest[b] <= room:
                    t = taken[b]
                    s = sigma[b % sigma.shape[0], t]
                    growth = growth_at(t, growing)
                    is_averaged = t >= hold
                    step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
                    if age[b] == STALE:
                        grid.cutoff = near + skin[b]
                        for r in range(start, end):
                            for c in ti.static(range(3)):
                                listed[4 * r + c] = position[r, c]
                        longest[b] = list_structure(
                            grid, 0, start, end, listed, cells, connections, rows,
                            start * capacity + b, room,
                        )  # fmt: skip
                        age[b] = 0
                    if longest[b] <= room:
                        for r in range(start, end):
                            pull_robot(
                                r, docks, turning, step, robots, contacts, priors, grid, rows, swarm
                            )
                        move_subtrees(b, step, trees, blocks, swarm)
                        strayed = 0.0
                        for r in range(start, end):
                            distance = move_robot(
                                r, turning, step, robots, priors, trees, blocks, swarm
                            )
                            strayed = ti.max(strayed, distance)
                        grow_old(b, strayed, blocks)
                        taken[b] = t + 1
    else:
        t = taken[0]
        growth = growth_at(t, growing)
        is_averaged = t >= hold
        grid = ti.Struct(own_bits=own_bits, near=near, entry_stride=entry_stride)
        for r in range(row_count.shape[0]):
            s = sigma[structure[r % structure.shape[0]], t]
            step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
            pull_robot(r, docks, turning, step, robots, contacts, priors, grid, rows, swarm)
        for i in range((block_start.shape[0] - 1) * GRAIN):
            if i % GRAIN == 0:
                b = i // GRAIN
                s = sigma[b % sigma.shape[0], t]
                step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
                move_subtrees(b, step, trees, blocks, swarm)
        strayed = 0.0
        for r in range(row_count.shape[0]):
            s = sigma[structure[r % structure.shape[0]], t]
            step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
            distance = move_robot(r, turning, step, robots, priors, trees, blocks, swarm)
            ti.atomic_max(strayed, distance)
        taken[0] = t + 1
        grow_old(0, strayed, blocks)


@ti.kernel
def note_places(position: Reals2, listed: Reals1):
    """Write down where robots are as their rows are built."""
    for r, c in ti.ndrange(position.shape[0], 3):
        listed[4 * r + c] = position[r, c]
