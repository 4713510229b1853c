"""Steps of every robot of every chain: forces, then motions, then the age of the Verlet rows.

Motions are Langevin dynamics: each has a mass, keeps a part of its velocity, and is kicked so that
it reaches the temperature sigma^2. Robots move, their turns, and subtrees.

`take_steps` is for processors; `card_kernels` has the kernel of graphics cards.
"""

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
from tiswarm.compute.math_kernels import kick_of, part_at
from tiswarm.compute.neighbor_kernels import (
    Cells,
    ConnectedDocks,
    Rows,
    StructureTable,
    begin_structure,
    fits,
    list_structure,
)
from tiswarm.localization.chains.arrays import (
    STALE,
    BlockProgress,
    Blocks,
    BodyMotion,
    Contacts,
    Copies,
    Heading,
    MeasuredColumns,
    Moments,
    OverlapSums,
    RobotLabel,
    Robots,
    RobotWeight,
    Step,
    SubtreeLabel,
    SubtreeMotion,
    Subtrees,
    variant_of,
)
from tiswarm.localization.chains.force_kernels import pull_robot, push_docks, sigma_of

MEMORY = 0.985
"""What friction leaves of a velocity in one step [1]: a friction of 0.015 in a unit of time."""
_SUBTREE_KICKS = 2**30
"""Number of the first subtree among those of robots, so that subtrees draw other random numbers."""


@ti.func
def _heat_of(sigma, mobility):
    """Compute the size of the kicks that keep a temperature, s = sigma sqrt((1 - a^2) / m)."""
    return sigma * ti.sqrt((1.0 - MEMORY * MEMORY) * mobility)


@ti.func
def _thermostat(table: Ref, i, column, force, mobility, kick):
    """Change a velocity, a column of a table, by any force; return how far it leads.

    A step of the force, half a step of motion, friction with a kick that keeps the temperature, and
    the other half of the motion: the splitting BAOAB of Langevin dynamics (Leimkuhler and Matthews
    2013), whose two half steps of the force between motions are one. Where forces are linear, its
    positions have the variance of the temperature exactly, however long a stable step is. Robots,
    their turns and subtrees all move so. `mobility` is 1 / m. In a unit of time, the step h is 1,
    and a robot held by one equation swings in 2 pi.
    """
    # v' = v + F h / m
    speed = table[i, column] + force * mobility
    # v <- a v' + s xi, s = sigma sqrt((1 - a^2) / m): `kick` is s xi
    kept = MEMORY * speed + kick
    table[i, column] = kept
    # x = h (v' + v) / 2
    return 0.5 * (speed + kept)


@ti.func
def _turn_robot(r, step: Ref, robots: Ref, swarm: Ref):
    """Turn copy r of a robot, its docks with it."""
    count = robots.label.shape[0]
    kick = kick_of(
        step.seed, r // count, -1 - robots.label[r % count, RobotLabel.NUMBER], step.number
    )[0]
    heading = ti.static(swarm.heading)
    mobility = 1.0 / heading[r, Heading.INERTIA]
    kick *= _heat_of(sigma_of(r % count, step, robots), mobility)
    turn = _thermostat(heading, r, Heading.SPIN, heading[r, Heading.TORQUE], mobility, kick)
    yaw = heading[r, Heading.YAW] + turn
    heading[r, Heading.YAW] = yaw
    heading[r, Heading.COS] = ti.cos(yaw)
    heading[r, Heading.SIN] = ti.sin(yaw)
    c = ti.cos(turn)
    s = ti.sin(turn)
    for k in range(swarm.arm.shape[1]):
        x = swarm.arm[r, k, 0]
        y = swarm.arm[r, k, 1]
        swarm.arm[r, k, 0] = c * x - s * y
        swarm.arm[r, k, 1] = s * x + c * y
    if step.number >= step.hold:
        heading[r, Heading.SUM] = heading[r, Heading.SUM] + yaw


@ti.func
def pull_subtree(k, robots, trees: Ref, swarm: Ref):
    """Write the force on the own robots of copy k of a subtree, and the mass of the subtree.

    A subtree that becomes heavier keeps its kinetic energy.
    """
    n = k % trees.table.shape[0]
    start = k // trees.table.shape[0] * robots
    pull = 0.0 * part_at(swarm.motion, start, BodyMotion.FORCE)
    mass = 0.0 * pull[0]
    for r in range(
        start + trees.table[n, SubtreeLabel.OWN], start + trees.table[n, SubtreeLabel.OWN_END]
    ):
        pull += part_at(swarm.motion, r, BodyMotion.FORCE)
        mass += trees.motion[k, SubtreeMotion.WEIGHT] * swarm.motion[r, BodyMotion.MASS]
    note_pull(k, pull, mass, trees)


@ti.func
def note_pull(k, pull, mass, trees: Ref):
    """Write the force on copy k of a subtree, and its mass; velocities shrink as this grows."""
    slower = ti.sqrt(trees.motion[k, BodyMotion.MASS] / mass)
    trees.motion[k, BodyMotion.MASS] = mass
    for c in ti.static(range(3)):
        trees.motion[k, BodyMotion.FORCE + c] = pull[c]
        trees.motion[k, BodyMotion.VELOCITY + c] = slower * trees.motion[k, BodyMotion.VELOCITY + c]


@ti.func
def gather_pulls(b, blocks: Ref, trees: Ref):
    """Add to the force on each subtree of block b those on all that grow out of it."""
    count = trees.table.shape[0]
    first = blocks.progress[b, BlockProgress.TREE]
    last = blocks.progress[b, BlockProgress.TREE_END]
    chain = first // count
    for back in range(1, last - first):
        k = last - back
        parent = chain * count + trees.table[k - chain * count, SubtreeLabel.PARENT]
        for c in ti.static(range(BodyMotion.FORCE, BodyMotion.FORCE + 3)):
            trees.motion[parent, c] = trees.motion[parent, c] + trees.motion[k, c]


@ti.func
def move_subtree(k, on_card: Static, step: Ref, robots: Ref, trees: Ref):
    """Write the shift of copy k of a subtree, without that of the subtrees it grows out of.

    `gather_shifts` follows on cards, `spread_shifts` on processors.

    Args:
        k: Copy of the subtree.
        on_card: Whether `gather_shifts` follows.
        step: The step.
        robots: Robots.
        trees: Subtrees.
    """
    count = trees.table.shape[0]
    n = k % count
    kick = kick_of(
        step.seed, k // count, _SUBTREE_KICKS + trees.table[n, SubtreeLabel.ORDINAL], step.number
    )
    motion, shift = ti.static(
        trees.motion, SubtreeMotion.OWN_SHIFT if on_card else SubtreeMotion.SHIFT
    )
    mobility = 1.0 / motion[k, BodyMotion.MASS]
    kick *= _heat_of(sigma_of(trees.table[n, SubtreeLabel.OWN], step, robots), mobility)
    for c in ti.static(range(3)):
        motion[k, shift + c] = 0.0
        if trees.table[n, SubtreeLabel.MOVES + c] == 1:
            force = motion[k, BodyMotion.FORCE + c]
            motion[k, shift + c] = _thermostat(
                motion, k, BodyMotion.VELOCITY + c, force, mobility, kick[c]
            )


@ti.func
def spread_shifts(b, blocks: Ref, trees: Ref):
    """Add to the shift of each subtree of block b that of the subtree it grows out of."""
    count = trees.table.shape[0]
    first = blocks.progress[b, BlockProgress.TREE]
    last = blocks.progress[b, BlockProgress.TREE_END]
    chain = first // count
    for k in range(first + 1, last):
        parent = chain * count + trees.table[k - chain * count, SubtreeLabel.PARENT]
        for c in ti.static(range(SubtreeMotion.SHIFT, SubtreeMotion.SHIFT + 3)):
            trees.motion[k, c] = trees.motion[k, c] + trees.motion[parent, c]


@ti.func
def move_robot(r, variant: Static, step: Ref, robots: Ref, trees: Ref, blocks: Ref, swarm: Ref):
    """Move copy r by itself and with its subtree, and turn it if robots turn; anchors stay.

    Where the step counts for the averages, the position is added to their sums.

    Returns:
        Its squared distance from where its Verlet row was built.
    """
    motion, position = ti.static(swarm.motion, swarm.position)
    count = robots.label.shape[0]
    i = r % count
    chain = r // count
    strayed = 0.0 * motion[r, BodyMotion.MASS]
    if robots.label[i, RobotLabel.MOVES] == 1:
        number = robots.label[i, RobotLabel.NUMBER]
        kick = kick_of(step.seed, chain, number, step.number)
        mobility = 1.0 / motion[r, BodyMotion.MASS]
        kick *= _heat_of(sigma_of(i, step, robots), mobility)
        k = chain * trees.table.shape[0] + robots.label[i, RobotLabel.SUBTREE]
        for c in ti.static(range(3)):
            force = motion[r, BodyMotion.FORCE + c]
            alone = _thermostat(motion, r, BodyMotion.VELOCITY + c, force, mobility, kick[c])
            shift = alone + trees.motion[k, SubtreeMotion.SHIFT + c]
            position[r, c] = position[r, c] + shift
            strayed += (position[r, c] - blocks.listed[4 * r + c]) ** 2
    if ti.static(variant.turning) and robots.weight[i, RobotWeight.YAW_PRECISION] > 0.0:
        _turn_robot(r, step, robots, swarm)
    if step.number >= step.hold:
        square = swarm.total[r, Moments.SQUARE]
        for c in ti.static(range(3)):
            swarm.total[r, c] = swarm.total[r, c] + position[r, c]
            square += position[r, c] * position[r, c]
        swarm.total[r, Moments.SQUARE] = square
    return strayed


SKIN = 2.0
"""Reach of Verlet rows beyond the distance at which docks can touch [R]."""
THIN_SKIN = 0.01
"""Skin while robots move too fast for longer rows to serve two steps [R]."""


@ti.func
def _skin_of(b, blocks: Ref):
    """Read the skin of rows of block b that are built next, or that were built last [R]."""
    return ti.select(blocks.progress[b, BlockProgress.IS_THIN] == 1, THIN_SKIN, SKIN)


@ti.func
def is_beyond_rows(strayed, b, blocks: Ref):
    """Whether rows are stale for a robot that went so far from where they were built [R^2]."""
    return strayed > (0.5 * _skin_of(b, blocks)) ** 2


@ti.func
def is_fast(strayed):
    """Whether thick rows would serve few steps for a robot that went so far in one [R^2]."""
    return strayed > (0.25 * SKIN) ** 2


@ti.func
def end_step(b, is_stale, has_fast, blocks: Ref):
    """Count a step, and decide whether rows serve one more, and how far the next ones reach."""
    is_new = blocks.progress[b, BlockProgress.AGE] == 0
    blocks.progress[b, BlockProgress.AGE] = ti.select(
        is_stale, STALE, blocks.progress[b, BlockProgress.AGE] + 1
    )
    if is_new:
        blocks.progress[b, BlockProgress.IS_THIN] = ti.cast(has_fast, ti.i32)
    blocks.progress[b, BlockProgress.TAKEN] += 1


@ti.func
def _take_step(
    span: Ref, variant: Static, step: Ref, measured: Ref, trees: Ref, grid: Ref, rows: Ref,
    blocks: Ref, swarm: Ref,
):  # fmt: skip
    """Take one step of some blocks that stand in a row in memory.

    At the top of a kernel, all threads share each of these loops; within a loop of the kernel, one
    thread runs them all.

    Args:
        span: Struct of the first block, the one after the last, and the same of copies of robots
            and of subtrees.
        variant: What this is compiled for.
        step: The step.
        measured: All that is known of robots.
        trees: Subtrees.
        grid: Struct of `neighbor_kernels`, with `near`, the largest distance of robots whose docks
            overlap [R].
        rows: Verlet rows.
        blocks: Progress of the blocks.
        swarm: State of the copies.

    Returns:
        The largest squared distance of a robot from where its row was built [R^2].
    """
    if ti.static(variant.by_block):
        for r in range(span.first, span.end):
            for c in ti.static(range(OverlapSums.TOTAL)):
                swarm.overlap[r, c] = ti.i64(0)
        for r in range(span.first, span.end):
            push_docks(r, variant, step, measured.robots, grid, rows, swarm)
    for r in range(span.first, span.end):
        if ti.static(not variant.by_block):
            push_docks(r, variant, step, measured.robots, grid, rows, swarm)
        pull_robot(r, variant, step, measured, swarm)
    for k in range(span.tree, span.tree_end):
        pull_subtree(k, measured.robots.label.shape[0], trees, swarm)
    # These sums are few additions: one thread does a block's.
    stride = ti.static(1 if variant.by_block else GRAIN)
    for i in range(span.block * stride, span.block_end * stride):
        if i % stride == 0:
            gather_pulls(i // stride, blocks, trees)
    for k in range(span.tree, span.tree_end):
        move_subtree(k, False, step, measured.robots, trees)
    for i in range(span.block * stride, span.block_end * stride):
        if i % stride == 0:
            spread_shifts(i // stride, blocks, trees)
    farthest = 0.0
    for r in range(span.first, span.end):
        strayed = move_robot(r, variant, step, measured.robots, trees, blocks, swarm)
        ti.atomic_max(farthest, strayed)
    return farthest


@ti.kernel
def take_steps(
    docks: Static, traits: Static, near: Float, seed: I32, until: I32, schedule: Reals2,
    robot_label: Ints2, robot_weight: Reals2,  # Robots
    contact_label: Ints2, contact_value: Reals2, candidates: Reals3,  # Contacts
    plane: Reals2,
    subtree: Ints2, subtree_motion_out: Reals2,  # Subtrees
    structure_out: Ints2,
    begin_out: Ints1, sorted_dock_out: Ints1, sorted_place_out: Ints1,  # Cells
    none: Ints1,
    entry_out: Ints1, row_first_out: Ints1, row_count_out: Ints1,  # Rows
    arm_out: Reals3, position_out: Reals2, motion_out: Reals2, heading_out: Reals2,
    total_out: Reals2, overlap_out: Longs2,  # Copies
    progress_out: Ints2, listed_out: Reals1,  # Blocks
):  # fmt: skip
    """Move every robot but the anchors on a processor, from the step that was taken last.

    By block, until all steps are taken or the rows of a block do not fit; else one step.

    Args:
        docks: Docks of a robot.
        traits: What else this is compiled for.
        near: Largest distance of robots whose docks overlap [R].
        seed: Seed of the random numbers.
        until: Step before which to stop.
        schedule: As `Step` describes it.
        plane: As `MeasuredColumns` describes it.
        structure_out: Blocks, or the whole swarm, as structures of `neighbor_kernels`.
        none: Zeros, one a copy and one more: no entry of a row is a connected dock.
    """
    variant = ti.static(variant_of(docks, traits))
    robots = ti.static(Robots(robot_label, robot_weight))
    contacts = ti.static(Contacts(contact_label, contact_value, candidates))
    measured = ti.static(MeasuredColumns(robots, contacts, plane))
    trees = ti.static(Subtrees(subtree, subtree_motion_out))
    cells = ti.static(Cells(begin_out, sorted_dock_out, sorted_place_out))
    connections = ti.static(ConnectedDocks(none, none))
    rows = ti.static(Rows(entry_out, row_first_out, row_count_out))
    swarm = ti.static(Copies(
        arm_out, position_out, motion_out, heading_out, total_out, overlap_out
    ))  # fmt: skip
    blocks = ti.static(Blocks(progress_out, listed_out))
    if ti.static(variant.by_block):
        for i in range(progress_out.shape[0] * GRAIN):
            if i % GRAIN == 0:
                b = i // GRAIN
                span = ti.Struct(
                    block=b, block_end=b + 1, first=structure_out[b, StructureTable.FIRST],
                    end=structure_out[b, StructureTable.END],
                    tree=progress_out[b, BlockProgress.TREE],
                    tree_end=progress_out[b, BlockProgress.TREE_END],
                )  # fmt: skip
                grid = ti.Struct(
                    docks=1, own_bits=0, earlier=0, cutoff=near, near=near, entry_stride=1,
                    slot=span.first, table=structure_out[b, StructureTable.TABLE],
                    buckets=structure_out[b, StructureTable.BUCKETS],
                    stride_y=structure_out[b, StructureTable.STRIDE_Y],
                    stride_z=structure_out[b, StructureTable.STRIDE_Z],
                )  # fmt: skip
                begin_structure(b, structure_out)
                while progress_out[b, BlockProgress.TAKEN] < until and fits(b, structure_out):
                    if progress_out[b, BlockProgress.AGE] == STALE:
                        grid.cutoff = near + _skin_of(b, blocks)
                        for r in range(span.first, span.end):
                            for c in ti.static(range(3)):
                                listed_out[4 * r + c] = position_out[r, c]
                        list_structure(
                            grid, b, 0, listed_out, cells, connections, rows, structure_out
                        )
                        progress_out[b, BlockProgress.AGE] = 0
                    if fits(b, structure_out):
                        t = progress_out[b, BlockProgress.TAKEN]
                        hold = progress_out[b, BlockProgress.HOLD]
                        step = ti.static(Step(t, seed, hold, schedule))
                        farthest = _take_step(
                            span, variant, step, measured, trees, grid, rows, blocks, swarm
                        )
                        is_stale = is_beyond_rows(farthest, b, blocks)
                        end_step(b, is_stale, is_fast(farthest), blocks)
    else:
        t = progress_out[0, BlockProgress.TAKEN]
        goes = ti.cast(progress_out[0, BlockProgress.AGE] != STALE and t < until, ti.i32)
        # Computed here, the bounds of loops need no launch before each loop.
        span = ti.Struct(
            block=0, block_end=goes * progress_out.shape[0], first=0,
            end=goes * row_count_out.shape[0], tree=0, tree_end=goes * subtree_motion_out.shape[0],
        )  # fmt: skip
        grid = ti.Struct(own_bits=0, near=near, entry_stride=1)
        step = ti.static(Step(t, seed, progress_out[0, BlockProgress.HOLD], schedule))
        farthest = _take_step(span, variant, step, measured, trees, grid, rows, blocks, swarm)
        if goes == 1:
            end_step(0, is_beyond_rows(farthest, 0, blocks), is_fast(farthest), blocks)


@ti.kernel
def note_places(position: Reals2, listed_out: Reals1):
    """Write down where robots are as their rows are built."""
    for r, c in ti.ndrange(position.shape[0], 3):
        listed_out[4 * r + c] = position[r, c]
