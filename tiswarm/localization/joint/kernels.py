"""Steps of every robot of every chain.

The swarm is C copies, one a chain, of N robots: those of all structures, end to end; the copies
of one structure in one chain are a block. The branches of all structures are T. Forces and masses
are those of `joint.force_kernels`, motions those of `joint.motion_kernels`. Lengths in R.
"""

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
    ti,
)  # fmt: skip
from tiswarm.compute.neighbor_kernels import list_structure
from tiswarm.localization.joint.force_kernels import pull_robot
from tiswarm.localization.joint.motion_kernels import move_branches, move_robot

SKIN = 2.0
"""How much farther than docks can touch rows of neighbors reach [R]."""
THIN_SKIN = 0.01
"""The same while robots move so fast that farther rows would not serve a second step."""
SMALLEST = 0.1
"""Size of docks in the first step, as a part of their full size. Docks that are solid at once push
each other out of the heap that initialization leaves, faster than friction takes the heat away."""
STALE = -1
"""Age of rows that have to be made anew."""


@ti.func
def grow_old(b, strayed, age: Ref, skin: Ref):
    """Tell whether rows of a block serve one more step, and how far the next ones reach.

    Args:
        b: The block.
        strayed: The farthest that a robot is from its row's place, squared [R^2].
        age, skin: As `take_steps` has them.
    """
    is_new = age[b] == 0
    age[b] = ti.select(strayed > (0.5 * skin[b]) ** 2, STALE, age[b] + 1)
    if is_new:
        skin[b] = ti.select(strayed > (0.25 * SKIN) ** 2, THIN_SKIN, SKIN)


@ti.func
def growth_at(t, growing):
    """Size of the docks in step `t`, as a part of their full size."""
    return ti.min(1.0, ti.max(SMALLEST, (t + 1.0) / growing))


@ti.kernel
def take_steps(
    by_block: ti.template(),
    docks: ti.template(),
    turning: ti.template(),
    own_bits: I32,
    entry_stride: I32,
    capacity: I32,
    near: Float,
    seed: I32,
    until: I32,
    held: I32,
    growing: Float,
    inertia_factor: Float,
    tolerance: Reals2,
    # equations
    structure: Ints1,
    number: Ints1,
    non_overlap: Ints1,
    robust: Reals1,
    contact_start: Ints1,
    partner: Ints1,
    touching: Ints1,
    stretch: Reals1,
    shift: Reals2,
    lever: Reals2,
    variance: Reals1,
    place: Reals2,
    precision: Reals2,
    walk: Reals2,
    yaw_precision: Reals1,
    # branches
    branch: Ints1,
    tree: Ints2,
    branch_weight: Reals1,
    first_branch: Ints1,
    branch_pull: Reals2,
    branch_velocity: Reals2,
    branch_shift: Reals2,
    # neighbors
    table: Ints2,
    begin: Ints1,
    sorted_dock: Ints1,
    sorted_at: Reals1,
    none_start: Ints1,
    none: Ints1,
    row: Ints1,
    row_first: Ints1,
    row_count: Ints1,
    longest: Ints1,
    # state
    arm: Reals3,
    start: Ints1,
    taken: Ints1,
    age: Ints1,
    skin: Reals1,
    listed: Reals1,
    position: Reals2,
    velocity: Reals2,
    force: Reals2,
    mass: Reals1,
    heading: Reals2,
    total: Reals2,
    square_total: Reals1,
):
    """Move every robot, anchors only as far as they float, from the step that was taken last.

    Args:
        by_block: Whether one thread takes all steps of a block, and makes its rows anew when they
            are stale. Else all threads take the next step together, unless rows are stale.
        docks: Docks of a robot.
        turning: Whether any robot turns; no bit of others depends on it.
        own_bits: Bits of a row's entry that are of no use here.
        entry_stride: From one entry to the next.
        capacity: Entries that rows can hold, on average over a block.
        near: How far apart robots whose docks overlap can be [R].
        seed: Of the random numbers.
        until: Step before which to stop.
        held: First step that counts for the averages.
        growing: Steps in which docks grow to their full size.
        inertia_factor: Factor of every mass; 4 halves the steps.
        tolerance: s of each structure at each step [R], shape (S, steps).
        structure: Which one each robot is of, shape (N,).
        number: Join number within its structure, shape (N,).
        non_overlap: Whether the cue is on in its structure, shape (N,).
        robust: One over the square of the loss's width, 0 for none [1], shape (N,).
        contact_start: First contact of each robot, shape (N + 1,).
        partner: The other robot, shape (K,); every contact stands at both its robots.
        touching: Whether it is of the final stance, shape (K,).
        stretch: How much likelier the two robots are for each dock radius more between their
            centers, as a logarithm [R^-1], shape (K,).
        shift: Seen from the robot [R], shape (K, 3).
        lever: Parts of it that turn, the robot's x and y and the other's [R], shape (K, 4).
        variance: Of each contact [R^2], shape (K,).
        place: Where each center is known to be [R], shape (N, 3).
        precision: How well [R^-2], shape (N, 3).
        walk: Part of that place that turns with the robot, x and y to be subtracted [R],
            shape (N, 2).
        yaw_precision: How well yaw is sensed [rad^-2], 0 where robots do not turn, shape (N,).
        branch: That each robot is an own one of, shape (C N,).
        tree: Start and end of each branch's own robots and the branch that it grows out of, all
            three counted within its structure, and along which axes it moves, shape (T, 6).
        branch_weight: Mass of each branch, in masses of its own robots, shape (T,).
        first_branch: Of each block, shape (B + 1,).
        branch_pull: Read and written: pull and mass of each branch, shape (C T, 4).
        branch_velocity: Read and written, shape (C T, 3).
        branch_shift: Scratch, shape (C T, 3).
        table: Where each block's table starts, its buckets and strides, shape (B, 4).
        begin, sorted_dock, sorted_at: Scratch of the tables.
        none_start, none: No neighbors that need be in a row.
        row: Rows of the neighbor list.
        row_first: Where each starts, shape (C N,).
        row_count: Length of each, shape (C N,).
        longest: Written: entries of a block's rows; if too many, it stopped there, shape (B,).
        arm: Read and written: center to dock, world frame [R], shape (C N, docks, 3).
        start: First robot of each block, shape (B + 1,).
        taken: Read and written: steps of a block so far, shape (B,).
        age: Read and written: steps that its rows have served, or STALE, shape (B,).
        skin: Read and written: how much farther than `near` rows reach that are made next [R],
            shape (B,).
        listed: Where robots were as rows were made and, last, their block [R], rows of four.
        position: Read and written [R], shape (C N, 3).
        velocity: Read and written, shape (C N, 3).
        force: Scratch, shape (C N, 3).
        mass: Read and written, shape (C N,).
        heading: Read and written, columns as `force_kernels` names them, shape (C N, 7).
        total: Read and written: sum of positions that are averaged, shape (C N, 3).
        square_total: Read and written: sum of their squares, shape (C N,).
    """
    if ti.static(by_block):
        for i in range(taken.shape[0] * GRAIN):
            if i % GRAIN == 0:
                b = i // GRAIN
                grid = ti.Struct(
                    docks=1, own_bits=own_bits, cutoff=near, near=near,
                    table=table[b, 0], buckets=table[b, 1], stride_y=table[b, 2],
                    stride_z=table[b, 3], slot=start[b], entry_stride=entry_stride,
                )  # fmt: skip
                room = capacity * (start[b + 1] - start[b])
                longest[b] = 0
                while taken[b] < until and longest[b] <= room:
                    t = taken[b]
                    s = tolerance[b % tolerance.shape[0], t]
                    if age[b] == STALE:
                        grid.cutoff = near + skin[b]
                        for r in range(start[b], start[b + 1]):
                            for c in ti.static(range(3)):
                                listed[4 * r + c] = position[r, c]
                        longest[b] = list_structure(
                            grid, 0, start[b], start[b + 1], listed, begin, sorted_dock, sorted_at,
                            none_start, none, row, row_first, row_count,
                            start[b] * capacity + b, room,
                        )  # fmt: skip
                        age[b] = 0
                    if longest[b] <= room:
                        for r in range(start[b], start[b + 1]):
                            pull_robot(
                                grid, docks, turning, r, s, growth_at(t, growing), inertia_factor,
                                non_overlap, robust, contact_start, partner, touching, stretch,
                                shift, lever, variance, place, precision, walk, yaw_precision, arm,
                                row, row_first, row_count, position, velocity, force, mass, heading,
                            )  # fmt: skip
                        move_branches(
                            seed, t, b, s, tree, branch_weight, first_branch, branch_pull,
                            branch_velocity, branch_shift, start, force, mass,
                        )  # fmt: skip
                        strayed = 0.0
                        for r in range(start[b], start[b + 1]):
                            strayed = ti.max(strayed, move_robot(
                                seed, t, r, s, t >= held, turning, number,
                                yaw_precision, branch, branch_shift, arm, listed, position,
                                velocity, force, mass, heading, total, square_total,
                            ))  # fmt: skip
                        grow_old(b, strayed, age, skin)
                        taken[b] = t + 1
    else:
        now = taken[0]
        grid = ti.Struct(own_bits=own_bits, near=near, entry_stride=entry_stride)
        for r in range(row_count.shape[0]):
            s = tolerance[structure[r % structure.shape[0]], now]
            pull_robot(
                grid, docks, turning, r, s, growth_at(now, growing), inertia_factor, non_overlap,
                robust, contact_start, partner, touching, stretch, shift, lever, variance, place,
                precision, walk, yaw_precision, arm, row, row_first, row_count, position, velocity,
                force, mass, heading,
            )  # fmt: skip
        for i in range((start.shape[0] - 1) * GRAIN):
            if i % GRAIN == 0:
                b = i // GRAIN
                s = tolerance[b % tolerance.shape[0], now]
                move_branches(
                    seed, now, b, s, tree, branch_weight, first_branch, branch_pull,
                    branch_velocity, branch_shift, start, force, mass,
                )  # fmt: skip
        strayed = 0.0
        for r in range(row_count.shape[0]):
            s = tolerance[structure[r % structure.shape[0]], now]
            ti.atomic_max(strayed, move_robot(
                seed, now, r, s, now >= held, turning, number, yaw_precision, branch,
                branch_shift, arm, listed, position, velocity, force, mass, heading, total,
                square_total,
            ))  # fmt: skip
        taken[0] = now + 1
        grow_old(0, strayed, age, skin)


@ti.kernel
def note_places(position: Reals2, listed: Reals1):
    """Remember where robots are as their rows are made; arguments as `take_steps` has them."""
    for r, c in ti.ndrange(position.shape[0], 3):
        listed[4 * r + c] = position[r, c]
