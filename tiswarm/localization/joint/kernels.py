"""Steps of every robot of every chain: forces, then motions, then the age of the Verlet rows."""

from tiswarm.compute.lang import (
    GRAIN,
    I32,
    Float,
    Ints1,
    Ints2,
    Longs2,
    Reals1,
    Reals2,
    Reals3,
    Ref,
    Static,
    ti,
)  # fmt: skip
from tiswarm.compute.neighbor_kernels import Connections, Rows, list_structure
from tiswarm.compute.sorting_kernels import Cells
from tiswarm.localization.joint.arrays import (
    STRUCTURE,
    Blocks,
    Contacts,
    Priors,
    Robots,
    Step,
    Subtrees,
    Swarm,
)  # fmt: skip
from tiswarm.localization.joint.force_kernels import pull_robot
from tiswarm.localization.joint.motion_kernels import (
    RUN,
    add_up,
    count_pull,
    gather_pulls,
    gather_shifts,
    move_robot,
    move_subtree,
    pull_branch,
    pull_subtree,
    spread_shifts,
)

SKIN = 2.0
"""Reach of Verlet rows beyond the distance at which docks can touch [R]."""
THIN_SKIN = 0.01
"""Skin while robots move too fast for longer rows to serve two steps [R]."""
_SMALLEST = 0.1
"""Size of docks in the first step, as a part of their full size. Docks that are solid at once push
each other out of the initial heap faster than friction takes the heat away."""
STALE = -1
"""Age of rows that have to be built anew."""
STEPS_A_LAUNCH = 2
"""On cards, where a launch takes as long as several steps."""


@ti.func
def _is_beyond_rows(strayed, b, blocks: Ref):
    """Whether rows are stale for a robot that went so far from where they were built [R^2]."""
    return strayed > (0.5 * blocks.skin[b]) ** 2


@ti.func
def _is_fast(strayed):
    """Whether thick rows would serve few steps for a robot that went so far in one [R^2]."""
    return strayed > (0.25 * SKIN) ** 2


@ti.func
def _grow_old(b, is_stale, is_fast, blocks: Ref):
    """Decide whether the rows of block b serve one more step, and how far the next ones reach."""
    is_new = blocks.age[b] == 0
    blocks.age[b] = ti.select(is_stale, STALE, blocks.age[b] + 1)
    if is_new:
        blocks.skin[b] = ti.select(is_fast, THIN_SKIN, SKIN)


@ti.func
def _growth_at(t, growing):
    """Size of the docks in step `t`, as a part of their full size."""
    return ti.min(1.0, ti.max(_SMALLEST, (t + 1.0) / growing))


@ti.kernel
def take_steps(
    on_card: Static,
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
    robot_label: Ints2,
    robot_weight: Reals2,
    # Contacts
    contact_start: Ints1,
    contact_label: Ints2,
    contact_value: Reals2,
    contact_level: Reals2,
    has_offsets: Static,
    candidates: Reals3,
    has_touches: Static,
    # Priors
    plane_start: Ints1,
    plane: Reals2,
    # Subtrees
    subtree: Ints1,
    subtree_table: Ints2,
    subtree_weight: Reals1,
    first_subtree: Ints1,
    subtree_pull: Reals2,
    subtree_velocity: Reals2,
    subtree_shift: Reals2,
    subtree_sums: Longs2,
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
    strayed: Ints1,
):
    """Move every robot but the anchors, from the step that was taken last.

    Graphics cards take several steps, until rows are stale.

    Args:
        on_card: Whether a graphics card computes; reductions are flags there, as in
            `tiswarm.engine.kernels.step_robots`.
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
        robot_label: First array of `Robots`, whose others follow; then come those of `Contacts`,
            `Priors` and `Subtrees`.
        table: Where each block's table starts, its buckets and strides, shape (B, 4); `Cells` and
            `Connections` follow.
        longest: Written: entries of a block's rows; if too many, it stopped there, shape (B,).
        entry: First array of `Rows`; those of `Swarm` and `Blocks` follow.
    """
    robots = ti.static(Robots(robot_label, robot_weight))
    contacts = ti.static(
        Contacts(
            contact_start, contact_label, contact_value, contact_level, has_offsets, candidates,
            has_touches,
        )
    )  # fmt: skip
    priors = ti.static(Priors(plane_start, plane))
    trees = ti.static(
        Subtrees(
            subtree, subtree_table, subtree_weight, first_subtree, subtree_pull, subtree_velocity,
            subtree_shift, subtree_sums,
        )
    )  # fmt: skip
    cells = ti.static(Cells(begin, sorted_dock, sorted_place))
    connections = ti.static(Connections(none_start, none))
    rows = ti.static(Rows(entry, row_first, row_count))
    swarm = ti.static(Swarm(arm, position, velocity, force, mass, heading, total, square_total))
    blocks = ti.static(Blocks(block_start, taken, age, skin, listed, strayed))
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
                    growth = _growth_at(t, growing)
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
                        for k in range(first_subtree[b], first_subtree[b + 1]):
                            pull_subtree(k, robot_label.shape[0], trees, swarm)
                        gather_pulls(b, trees)
                        for k in range(first_subtree[b], first_subtree[b + 1]):
                            move_subtree(k, 0, step, trees)
                        spread_shifts(b, trees)
                        farthest = 0.0
                        for r in range(start, end):
                            distance = move_robot(r, turning, step, robots, trees, blocks, swarm)
                            farthest = ti.max(farthest, distance)
                        is_stale = _is_beyond_rows(farthest, b, blocks)
                        _grow_old(b, is_stale, _is_fast(farthest), blocks)
                        taken[b] = t + 1
    else:
        grid = ti.Struct(own_bits=own_bits, near=near, entry_stride=entry_stride)
        for _ in ti.static(range(STEPS_A_LAUNCH if on_card else 1)):
            t = taken[0]
            growth = _growth_at(t, growing)
            is_averaged = t >= hold
            goes = age[0] != STALE and t < until
            # Computed here, the bounds of loops need no launch before each loop.
            copies = ti.select(goes, row_count.shape[0], 0)
            subtrees = ti.select(goes, subtree_shift.shape[0], 0)
            threads = taken.shape[0] * GRAIN
            runs = (copies + RUN - 1) // RUN
            groups = (runs + RUN - 1) // RUN
            for r in range(copies):
                s = sigma[robot_label[r % robot_label.shape[0], STRUCTURE], t]
                step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
                pull_robot(r, docks, turning, step, robots, contacts, priors, grid, rows, swarm)
                if ti.static(on_card):
                    count_pull(r, subtree_sums, swarm)
            if ti.static(on_card):
                for run in range(runs):
                    add_up(run, 0, copies, subtree_sums)
                for group in range(groups):
                    add_up(group, copies, copies + runs, subtree_sums)
            else:
                for k in range(subtrees):
                    pull_subtree(k, robot_label.shape[0], trees, swarm)
                # These sums are few additions: one thread does a block's.
                for i in range(threads):
                    if i % GRAIN == 0:
                        gather_pulls(i // GRAIN, trees)
            for k in range(subtrees):
                own = subtree_table[k % subtree_table.shape[0], 0]
                s = sigma[robot_label[own, STRUCTURE], t]
                step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
                if ti.static(on_card):
                    pull_branch(k, robot_label.shape[0], trees, swarm)
                move_subtree(k, 3 if on_card else 0, step, trees)
            if ti.static(on_card):
                for k in range(subtrees):
                    gather_shifts(k, trees)
            else:
                for i in range(threads):
                    if i % GRAIN == 0:
                        spread_shifts(i // GRAIN, trees)
            farthest = 0.0
            strayed[0] = 0
            strayed[1] = 0
            for r in range(copies):
                s = sigma[robot_label[r % robot_label.shape[0], STRUCTURE], t]
                step = ti.static(Step(t, s, growth, inertia_factor, seed, is_averaged))
                distance = move_robot(r, turning, step, robots, trees, blocks, swarm)
                if ti.static(on_card):
                    if _is_beyond_rows(distance, 0, blocks):
                        strayed[0] = 1
                    if _is_fast(distance):
                        strayed[1] = 1
                else:
                    ti.atomic_max(farthest, distance)
            if goes:
                taken[0] = t + 1
                is_stale = _is_beyond_rows(farthest, 0, blocks) or strayed[0] == 1
                _grow_old(0, is_stale, _is_fast(farthest) or strayed[1] == 1, blocks)


@ti.kernel
def note_places(position: Reals2, listed: Reals1):
    """Write down where robots are as their rows are built."""
    for r, c in ti.ndrange(position.shape[0], 3):
        listed[4 * r + c] = position[r, c]
