"""Steps of every robot of every chain on a graphics card; `kernels` has those of processors.

A card takes several steps a launch, and no thread does more than a few hundred additions. A
reduction of real numbers would be a loop of compare-and-swap in every warp: one robot at most
writes a flag instead, as in `tiswarm.engine.kernels.step_robots`.

On processors one thread a block adds forces along the branches. On cards the robots that move with
a subtree stand in a row, so that the force on it is a difference of two sums over all robots before
a place.
"""

from tiswarm.compute.lang import (
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
)
from tiswarm.compute.math_kernels import part_at
from tiswarm.compute.neighbor_kernels import Rows
from tiswarm.localization.chains.arrays import (
    STALE,
    BlockProgress,
    Blocks,
    BodyMotion,
    Contacts,
    Copies,
    MeasuredColumns,
    Robots,
    Step,
    SubtreeLabel,
    SubtreeMotion,
    Subtrees,
    variant_of,
)
from tiswarm.localization.chains.force_kernels import pull_robot, push_docks
from tiswarm.localization.chains.kernels import (
    end_step,
    is_beyond_rows,
    is_fast,
    move_robot,
    move_subtree,
    note_pull,
)

STEPS_A_LAUNCH = 2
"""A launch takes as long as several steps."""
RUN = 64
"""Rows that one thread of a card adds up."""
_PARTS = 2.0**36
"""Parts of one in which cards count forces and masses, so that no sum depends on the order. The
force on a subtree is off by 2^-36 R for each of its robots at most, and right below 2^27 R."""


def sum_rows(copies: int) -> int:
    """Count the rows of sums on a card: one a copy of a robot, a run, and a run of runs."""
    runs = -(-copies // RUN)
    return copies + runs - (-runs // RUN)


@ti.func
def count_pull(r, sums: Ref, swarm: Ref):
    """Write the force on copy r of a robot and its mass, in parts of one, to be added up."""
    for c in ti.static(range(3)):
        sums[r, c] = ti.cast(_PARTS * swarm.motion[r, BodyMotion.FORCE + c], ti.i64)
    sums[r, 3] = ti.cast(_PARTS * swarm.motion[r, BodyMotion.MASS], ti.i64)


@ti.func
def add_up(run, first, last, sums: Ref):
    """Replace each row of a run by the sum of the run up to it, and write the last one.

    Args:
        run: Number of the run.
        first: First row of all runs.
        last: Row after their last one, and that of the sum of run 0.
        sums: Rows as `sum_rows` counts them.
    """
    total = ti.Vector([ti.i64(0) for _ in range(4)])
    for row in range(first + RUN * run, ti.min(first + RUN * (run + 1), last)):
        for c in ti.static(range(4)):
            total[c] += sums[row, c]
            sums[row, c] = total[c]
    for c in ti.static(range(4)):
        sums[last + run, c] = total[c]


@ti.func
def _sum_before(i, first, sums: Ref):
    """Sum the rows of a run before the i-th row from `first`."""
    total = ti.Vector([ti.i64(0) for _ in range(4)])
    if i % RUN > 0:
        total = ti.Vector([sums[first + i - 1, c] for c in range(4)])
    return total


@ti.func
def _sum_between(a, b, sums: Ref, swarm: Ref):
    """Sum the forces on copies a to b - 1 of robots, and their masses."""
    copies = swarm.motion.shape[0]
    runs = (copies + RUN - 1) // RUN
    total = _sum_before(b, 0, sums) - _sum_before(a, 0, sums)
    total += _sum_before(b // RUN, copies, sums) - _sum_before(a // RUN, copies, sums)
    for group in range(a // (RUN * RUN), b // (RUN * RUN)):
        total += ti.Vector([sums[copies + runs + group, c] for c in range(4)])
    return ti.cast(total, float) / _PARTS


@ti.func
def pull_branch(k, robots, sums: Ref, trees: Ref, swarm: Ref):
    """Write the force on all robots that move with copy k of a subtree, and its mass."""
    n = k % trees.table.shape[0]
    start = k // trees.table.shape[0] * robots
    first = start + trees.table[n, SubtreeLabel.OWN]
    of_own = _sum_between(first, start + trees.table[n, SubtreeLabel.OWN_END], sums, swarm)
    of_all = _sum_between(first, start + trees.table[n, SubtreeLabel.END], sums, swarm)
    note_pull(k, of_all, trees.motion[k, SubtreeMotion.WEIGHT] * of_own[3], trees)


@ti.func
def gather_shifts(k, trees: Ref):
    """Add to the shift of copy k of a subtree those of all that it grows out of."""
    count = trees.table.shape[0]
    chain = k // count
    n = k % count
    shift = part_at(trees.motion, k, SubtreeMotion.OWN_SHIFT)
    while trees.table[n, SubtreeLabel.PARENT] != n:
        n = trees.table[n, SubtreeLabel.PARENT]
        shift += part_at(trees.motion, chain * count + n, SubtreeMotion.OWN_SHIFT)
    for c in ti.static(range(3)):
        trees.motion[k, SubtreeMotion.SHIFT + c] = shift[c]


@ti.kernel
def take_steps_on_card(
    docks: Static, traits: Static, near: Float, seed: I32, until: I32, schedule: Reals2,
    robot_label: Ints2, robot_weight: Reals2,  # Robots
    contact_label: Ints2, contact_value: Reals2, candidates: Reals3,  # Contacts
    plane: Reals2,
    subtree: Ints2, subtree_motion_out: Reals2,  # Subtrees
    sums_out: Longs2,
    entry_stride: I32, entry: Ints1, row_first: Ints1, row_count: Ints1,  # Rows
    arm_out: Reals3, position_out: Reals2, motion_out: Reals2, heading_out: Reals2,
    total_out: Reals2, overlap_out: Longs2,  # Copies
    progress_out: Ints2, listed: Reals1,  # Blocks
):  # fmt: skip
    """Move every robot but the anchors a few times, until rows are stale.

    Args:
        docks: First argument of `tiswarm.localization.chains.kernels.take_steps`.
        sums_out: Forces and masses of copies, added up run by run in parts of one, and then sums of
            runs. Shape (`sum_rows(C N)`, 4).
        entry_stride: From one entry of a row to the next.
    """
    variant = ti.static(variant_of(docks, traits))
    robots = ti.static(Robots(robot_label, robot_weight))
    contacts = ti.static(Contacts(contact_label, contact_value, candidates))
    measured = ti.static(MeasuredColumns(robots, contacts, plane))
    trees = ti.static(Subtrees(subtree, subtree_motion_out))
    rows = ti.static(Rows(entry, row_first, row_count))
    swarm = ti.static(Copies(
        arm_out, position_out, motion_out, heading_out, total_out, overlap_out
    ))  # fmt: skip
    blocks = ti.static(Blocks(progress_out, listed))
    grid = ti.Struct(own_bits=0, near=near, entry_stride=entry_stride)
    for _ in ti.static(range(STEPS_A_LAUNCH)):
        t = progress_out[0, BlockProgress.TAKEN]
        step = ti.static(Step(t, seed, progress_out[0, BlockProgress.HOLD], schedule))
        goes = progress_out[0, BlockProgress.AGE] != STALE and t < until
        # Computed here, the bounds of loops need no launch before each loop.
        copies = ti.select(goes, row_count.shape[0], 0)
        subtrees = ti.select(goes, subtree_motion_out.shape[0], 0)
        runs = (copies + RUN - 1) // RUN
        groups = (runs + RUN - 1) // RUN
        for r in range(copies):
            push_docks(r, variant, step, robots, grid, rows, swarm)
            pull_robot(r, variant, step, measured, swarm)
            count_pull(r, sums_out, swarm)
        for run in range(runs):
            add_up(run, 0, copies, sums_out)
        for group in range(groups):
            add_up(group, copies, copies + runs, sums_out)
        for k in range(subtrees):
            pull_branch(k, robot_label.shape[0], sums_out, trees, swarm)
            move_subtree(k, True, step, robots, trees)
        for k in range(subtrees):
            gather_shifts(k, trees)
        progress_out[0, BlockProgress.HAS_STRAYED] = 0
        progress_out[0, BlockProgress.IS_FAST] = 0
        for r in range(copies):
            strayed = move_robot(r, variant, step, robots, trees, blocks, swarm)
            if is_beyond_rows(strayed, 0, blocks):
                progress_out[0, BlockProgress.HAS_STRAYED] = 1
            if is_fast(strayed):
                progress_out[0, BlockProgress.IS_FAST] = 1
        if goes:
            is_stale = progress_out[0, BlockProgress.HAS_STRAYED] == 1
            end_step(0, is_stale, progress_out[0, BlockProgress.IS_FAST] == 1, blocks)
