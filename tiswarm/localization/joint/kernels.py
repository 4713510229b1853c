"""Steps of every robot of every chain: forces, then motions, then the age of the Verlet rows.

`take_steps` is for processors; `card_kernels` has the kernel of graphics cards.
"""

from tiswarm.compute import neighbor_kernels as neighbors
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
from tiswarm.compute.neighbor_kernels import (
    Cells,
    ConnectedDocks,
    Rows,
    begin_structure,
    fits,
    list_structure,
)
from tiswarm.localization.joint.arrays import (
    AGE,
    IS_THIN,
    STALE,
    TAKEN,
    TREE,
    TREE_END,
    Blocks,
    Contacts,
    Copies,
    MeasuredColumns,
    Robots,
    Step,
    Subtrees,
    variant_of,
)
from tiswarm.localization.joint.force_kernels import pull_robot
from tiswarm.localization.joint.motion_kernels import (
    gather_pulls,
    move_robot,
    move_subtree,
    pull_subtree,
    spread_shifts,
)

SKIN = 2.0
"""Reach of Verlet rows beyond the distance at which docks can touch [R]."""
THIN_SKIN = 0.01
"""Skin while robots move too fast for longer rows to serve two steps [R]."""


@ti.func
def _skin_of(b, blocks: Ref):
    """Read the skin of rows of block b that are built next, or that were built last [R]."""
    return ti.select(blocks.progress[b, IS_THIN] == 1, THIN_SKIN, SKIN)


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
    is_new = blocks.progress[b, AGE] == 0
    blocks.progress[b, AGE] = ti.select(is_stale, STALE, blocks.progress[b, AGE] + 1)
    if is_new:
        blocks.progress[b, IS_THIN] = ti.cast(has_fast, ti.i32)
    blocks.progress[b, TAKEN] += 1


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
    for r in range(span.first, span.end):
        pull_robot(r, variant, step, measured, grid, rows, swarm)
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
    docks: Static, traits: Static, near: Float, seed: I32, until: I32, hold: I32, schedule: Reals2,
    robot_label: Ints2, robot_weight: Reals2,  # Robots
    contact_label: Ints2, contact_value: Reals2, candidates: Reals3,  # Contacts
    plane: Reals2,
    subtree: Ints2, subtree_motion_out: Reals2,  # Subtrees
    structure_out: Ints2,
    begin_out: Ints1, sorted_dock_out: Ints1, sorted_place_out: Reals1,  # Cells
    none: Ints1,
    entry_out: Ints1, row_first_out: Ints1, row_count_out: Ints1,  # Rows
    arm_out: Reals3, position_out: Reals2, motion_out: Reals2, heading_out: Reals2,
    total_out: Reals2,  # Copies
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
        hold: First step that counts for the averages.
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
    swarm = ti.static(Copies(arm_out, position_out, motion_out, heading_out, total_out))
    blocks = ti.static(Blocks(progress_out, listed_out))
    if ti.static(variant.by_block):
        for i in range(progress_out.shape[0] * GRAIN):
            if i % GRAIN == 0:
                b = i // GRAIN
                span = ti.Struct(
                    block=b, block_end=b + 1, first=structure_out[b, neighbors.FIRST],
                    end=structure_out[b, neighbors.END], tree=progress_out[b, TREE],
                    tree_end=progress_out[b, TREE_END],
                )  # fmt: skip
                grid = ti.Struct(
                    docks=1, own_bits=0, cutoff=near, near=near, entry_stride=1, slot=span.first,
                    table=structure_out[b, neighbors.TABLE],
                    buckets=structure_out[b, neighbors.BUCKETS],
                    stride_y=structure_out[b, neighbors.STRIDE_Y],
                    stride_z=structure_out[b, neighbors.STRIDE_Z],
                )  # fmt: skip
                begin_structure(b, structure_out)
                while progress_out[b, TAKEN] < until and fits(b, structure_out):
                    if progress_out[b, AGE] == STALE:
                        grid.cutoff = near + _skin_of(b, blocks)
                        for r in range(span.first, span.end):
                            for c in ti.static(range(3)):
                                listed_out[4 * r + c] = position_out[r, c]
                        list_structure(
                            grid, b, 0, listed_out, cells, connections, rows, structure_out
                        )
                        progress_out[b, AGE] = 0
                    if fits(b, structure_out):
                        step = ti.static(Step(progress_out[b, TAKEN], seed, hold, schedule))
                        farthest = _take_step(
                            span, variant, step, measured, trees, grid, rows, blocks, swarm
                        )
                        is_stale = is_beyond_rows(farthest, b, blocks)
                        end_step(b, is_stale, is_fast(farthest), blocks)
    else:
        t = progress_out[0, TAKEN]
        goes = ti.cast(progress_out[0, AGE] != STALE and t < until, ti.i32)
        # Computed here, the bounds of loops need no launch before each loop.
        span = ti.Struct(
            block=0, block_end=goes * progress_out.shape[0], first=0,
            end=goes * row_count_out.shape[0], tree=0, tree_end=goes * subtree_motion_out.shape[0],
        )  # fmt: skip
        grid = ti.Struct(own_bits=0, near=near, entry_stride=1)
        step = ti.static(Step(t, seed, hold, schedule))
        farthest = _take_step(span, variant, step, measured, trees, grid, rows, blocks, swarm)
        if goes == 1:
            end_step(0, is_beyond_rows(farthest, 0, blocks), is_fast(farthest), blocks)


@ti.kernel
def note_places(position: Reals2, listed_out: Reals1):
    """Write down where robots are as their rows are built."""
    for r, c in ti.ndrange(position.shape[0], 3):
        listed_out[4 * r + c] = position[r, c]
