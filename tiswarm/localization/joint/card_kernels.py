"""Steps of every robot of every chain on a graphics card; `kernels` has those of processors.

A card takes several steps a launch, and no thread does more than a few hundred additions. A
reduction of real numbers would be a loop of compare-and-swap in every warp: one robot at most
writes a flag instead, as in `tiswarm.engine.kernels.step_robots`.
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
    Static,
    ti,
)  # fmt: skip
from tiswarm.compute.neighbor_kernels import Rows
from tiswarm.localization.joint.arrays import (
    AGE,
    HAS_STRAYED,
    IS_FAST,
    STALE,
    TAKEN,
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
from tiswarm.localization.joint.kernels import end_step, is_beyond_rows, is_fast
from tiswarm.localization.joint.motion_kernels import (
    RUN,
    add_up,
    count_pull,
    gather_shifts,
    move_robot,
    move_subtree,
    pull_branch,
)

STEPS_A_LAUNCH = 2
"""A launch takes as long as several steps."""


@ti.kernel
def take_steps_on_card(
    docks: Static, traits: Static, near: Float, seed: I32, until: I32, hold: I32, schedule: Reals2,
    robot_label: Ints2, robot_weight: Reals2,  # Robots
    contact_label: Ints2, contact_value: Reals2, candidates: Reals3,  # Contacts
    plane: Reals2,
    subtree: Ints2, subtree_motion_out: Reals2,  # Subtrees
    sums_out: Longs2,
    entry_stride: I32, entry: Ints1, row_first: Ints1, row_count: Ints1,  # Rows
    arm_out: Reals3, position_out: Reals2, motion_out: Reals2, heading_out: Reals2,
    total_out: Reals2,  # Copies
    progress_out: Ints2, listed: Reals1,  # Blocks
):  # fmt: skip
    """Move every robot but the anchors a few times, until rows are stale.

    Args:
        docks: First argument of `tiswarm.localization.joint.kernels.take_steps`.
        sums_out: Forces and masses of copies, added up run by run in parts of one, and then sums of
            runs; `motion_kernels` says how. Shape (`sum_rows(C N)`, 4).
        entry_stride: From one entry of a row to the next.
    """
    variant = ti.static(variant_of(docks, traits))
    robots = ti.static(Robots(robot_label, robot_weight))
    contacts = ti.static(Contacts(contact_label, contact_value, candidates))
    measured = ti.static(MeasuredColumns(robots, contacts, plane))
    trees = ti.static(Subtrees(subtree, subtree_motion_out))
    rows = ti.static(Rows(entry, row_first, row_count))
    swarm = ti.static(Copies(arm_out, position_out, motion_out, heading_out, total_out))
    blocks = ti.static(Blocks(progress_out, listed))
    grid = ti.Struct(own_bits=0, near=near, entry_stride=entry_stride)
    for _ in ti.static(range(STEPS_A_LAUNCH)):
        t = progress_out[0, TAKEN]
        step = ti.static(Step(t, seed, hold, schedule))
        goes = progress_out[0, AGE] != STALE and t < until
        # Computed here, the bounds of loops need no launch before each loop.
        copies = ti.select(goes, row_count.shape[0], 0)
        subtrees = ti.select(goes, subtree_motion_out.shape[0], 0)
        runs = (copies + RUN - 1) // RUN
        groups = (runs + RUN - 1) // RUN
        for r in range(copies):
            pull_robot(r, variant, step, measured, grid, rows, swarm)
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
        progress_out[0, HAS_STRAYED] = 0
        progress_out[0, IS_FAST] = 0
        for r in range(copies):
            strayed = move_robot(r, variant, step, robots, trees, blocks, swarm)
            if is_beyond_rows(strayed, 0, blocks):
                progress_out[0, HAS_STRAYED] = 1
            if is_fast(strayed):
                progress_out[0, IS_FAST] = 1
        if goes:
            is_stale = progress_out[0, HAS_STRAYED] == 1
            end_step(0, is_stale, progress_out[0, IS_FAST] == 1, blocks)
