"""Motions of robots, of their turns and of subtrees of every chain, in one step.

Motions are Langevin dynamics: each has a mass, keeps a part of its velocity, and is kicked so that
it reaches the temperature sigma^2.

On processors one thread a block adds forces along the branches. On cards, no thread does more than
a few hundred additions: the robots that move with a subtree stand in a row, so that the force on it
is a difference of two sums over all robots before a place.
"""

from tiswarm.compute.lang import Ref, Static, ti
from tiswarm.compute.math_kernels import kick_of, part_at
from tiswarm.localization.joint.arrays import (
    COS,
    END,
    FORCE,
    INERTIA,
    MASS,
    MOVES,
    NUMBER,
    ORDINAL,
    OWN,
    OWN_END,
    OWN_SHIFT,
    PARENT,
    SHIFT,
    SIN,
    SPIN,
    SQUARE,
    SUBTREE,
    TORQUE,
    TOTAL,
    TREE,
    TREE_END,
    VELOCITY,
    WEIGHT,
    YAW,
    YAW_PRECISION,
)
from tiswarm.localization.joint.force_kernels import sigma_of

_STEP = 1.0
"""Time step, where a robot held by one equation swings in 2 pi."""
MEMORY = 0.985
"""What friction leaves of a velocity in one step."""
_SUBTREE_KICKS = 2**30
"""Number of the first subtree among those of robots, so that subtrees draw other random numbers."""
RUN = 64
"""Rows that one thread of a card adds up."""
_PARTS = 2.0**36
"""Parts of one in which cards count forces and masses, so that no sum depends on the order. The
force on a subtree is off by 2^-36 R for each of its robots at most, and right below 2^27 R."""


@ti.func
def _moved(table: Ref, i, column, force, mass, sigma, kick):
    """Change a velocity, a column of a table; return how far it leads."""
    # s = sigma sqrt((1 - a^2) / m)
    heat = sigma * ti.sqrt((1.0 - MEMORY * MEMORY) / mass)
    # v' = v + F h / m
    speed = table[i, column] + _STEP * force / mass
    # v <- a v' + s xi
    table[i, column] = MEMORY * speed + heat * kick
    # x = h (v' + v) / 2
    return 0.5 * _STEP * (speed + table[i, column])


@ti.func
def _turn_dock(turn, r, k, arm: Ref):
    """Turn dock `k` of copy r of a robot about the vertical through its center."""
    if turn != 0.0:
        c, s = ti.cos(turn), ti.sin(turn)
        x, y = arm[r, k, 0], arm[r, k, 1]
        arm[r, k, 0] = c * x - s * y
        arm[r, k, 1] = s * x + c * y


@ti.func
def _turn_robot(r, step: Ref, robots: Ref, swarm: Ref):
    """Turn copy r of a robot, its docks with it."""
    count = robots.label.shape[0]
    kick = kick_of(step.seed, r // count, -1 - robots.label[r % count, NUMBER], step.number)[0]
    heading = ti.static(swarm.heading)
    sigma = sigma_of(r % count, step, robots)
    turn = _moved(heading, r, SPIN, heading[r, TORQUE], heading[r, INERTIA], sigma, kick)
    heading[r, YAW] += turn
    heading[r, COS] = ti.cos(heading[r, YAW])
    heading[r, SIN] = ti.sin(heading[r, YAW])
    for k in range(swarm.arm.shape[1]):
        _turn_dock(turn, r, k, swarm.arm)
    if step.number >= step.hold:
        heading[r, TOTAL] += heading[r, YAW]


@ti.func
def pull_subtree(k, robots, trees: Ref, swarm: Ref):
    """Write the force on the own robots of copy k of a subtree, and the mass of the subtree.

    A subtree that becomes heavier keeps its kinetic energy.
    """
    n = k % trees.table.shape[0]
    start = k // trees.table.shape[0] * robots
    pull = 0.0 * part_at(swarm.motion, start, FORCE)
    mass = 0.0 * pull[0]
    for r in range(start + trees.table[n, OWN], start + trees.table[n, OWN_END]):
        pull += part_at(swarm.motion, r, FORCE)
        mass += trees.motion[k, WEIGHT] * swarm.motion[r, MASS]
    _note_pull(k, pull, mass, trees)


@ti.func
def _note_pull(k, pull, mass, trees: Ref):
    """Write the force on copy k of a subtree, and its mass; velocities shrink as this grows."""
    lighter = ti.sqrt(trees.motion[k, MASS] / mass)
    trees.motion[k, MASS] = mass
    for c in ti.static(range(3)):
        trees.motion[k, FORCE + c] = pull[c]
        trees.motion[k, VELOCITY + c] *= lighter


@ti.func
def gather_pulls(b, blocks: Ref, trees: Ref):
    """Add to the force on each subtree of block b those on all that grow out of it."""
    count = trees.table.shape[0]
    first, last = blocks.progress[b, TREE], blocks.progress[b, TREE_END]
    chain = first // count
    for back in range(1, last - first):
        k = last - back
        parent = chain * count + trees.table[k - chain * count, PARENT]
        for c in ti.static(range(3)):
            trees.motion[parent, FORCE + c] += trees.motion[k, FORCE + c]


def sum_rows(copies: int) -> int:
    """Count the rows of sums on a card: one a copy of a robot, a run, and a run of runs."""
    runs = -(-copies // RUN)
    return copies + runs - (-runs // RUN)


@ti.func
def count_pull(r, sums: Ref, swarm: Ref):
    """Write the force on copy r of a robot and its mass, in parts of one, to be added up."""
    for c in ti.static(range(3)):
        sums[r, c] = ti.cast(_PARTS * swarm.motion[r, FORCE + c], ti.i64)
    sums[r, 3] = ti.cast(_PARTS * swarm.motion[r, MASS], ti.i64)


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
    first = start + trees.table[n, OWN]
    own = _sum_between(first, start + trees.table[n, OWN_END], sums, swarm)
    every = _sum_between(first, start + trees.table[n, END], sums, swarm)
    _note_pull(k, every, trees.motion[k, WEIGHT] * own[3], trees)


@ti.func
def gather_shifts(k, trees: Ref):
    """Add to the shift of copy k of a subtree those of all that it grows out of."""
    count = trees.table.shape[0]
    chain = k // count
    n = k % count
    shift = part_at(trees.motion, k, OWN_SHIFT)
    while trees.table[n, PARENT] != n:
        n = trees.table[n, PARENT]
        shift += part_at(trees.motion, chain * count + n, OWN_SHIFT)
    for c in ti.static(range(3)):
        trees.motion[k, SHIFT + c] = shift[c]


@ti.func
def move_subtree(k, on_card: Static, step: Ref, robots: Ref, trees: Ref):
    """Write the shift of copy k of a subtree, without that of the subtrees it grows out of.

    Args:
        k: Copy of the subtree.
        on_card: Whether `gather_shifts` follows, not `spread_shifts`.
        step: The step.
        robots: Robots.
        trees: Subtrees.
    """
    count = trees.table.shape[0]
    n = k % count
    kick = kick_of(step.seed, k // count, _SUBTREE_KICKS + trees.table[n, ORDINAL], step.number)
    motion, shift = ti.static(trees.motion, OWN_SHIFT if on_card else SHIFT)
    sigma = sigma_of(trees.table[n, OWN], step, robots)
    for c in ti.static(range(3)):
        motion[k, shift + c] = 0.0
        if trees.table[n, MOVES + c] == 1:
            force, mass = motion[k, FORCE + c], motion[k, MASS]
            motion[k, shift + c] = _moved(motion, k, VELOCITY + c, force, mass, sigma, kick[c])


@ti.func
def spread_shifts(b, blocks: Ref, trees: Ref):
    """Add to the shift of each subtree of block b that of the subtree it grows out of."""
    count = trees.table.shape[0]
    first, last = blocks.progress[b, TREE], blocks.progress[b, TREE_END]
    chain = first // count
    for k in range(first + 1, last):
        parent = chain * count + trees.table[k - chain * count, PARENT]
        for c in ti.static(range(3)):
            trees.motion[k, SHIFT + c] += trees.motion[parent, SHIFT + c]


@ti.func
def move_robot(r, variant: Static, step: Ref, robots: Ref, trees: Ref, blocks: Ref, swarm: Ref):
    """Move copy r by itself and with its subtree, and turn it if robots turn; anchors stay.

    Returns:
        Its squared distance from where its Verlet row was built.
    """
    motion, position = ti.static(swarm.motion, swarm.position)
    count = robots.label.shape[0]
    i, chain = r % count, r // count
    strayed = 0.0 * motion[r, MASS]
    number = robots.label[i, NUMBER]
    kick = kick_of(step.seed, chain, number, step.number)
    sigma = sigma_of(i, step, robots)
    k = chain * trees.table.shape[0] + robots.label[i, SUBTREE]
    for c in ti.static(range(3)):
        if number > 0:
            force, mass = motion[r, FORCE + c], motion[r, MASS]
            alone = _moved(motion, r, VELOCITY + c, force, mass, sigma, kick[c])
            position[r, c] += alone + trees.motion[k, SHIFT + c]
        strayed += (position[r, c] - blocks.listed[4 * r + c]) ** 2
    if ti.static(variant.turning) and robots.weight[i, YAW_PRECISION] > 0.0:
        _turn_robot(r, step, robots, swarm)
    if step.number >= step.hold:
        for c in ti.static(range(3)):
            swarm.total[r, c] += position[r, c]
            swarm.total[r, SQUARE] += position[r, c] * position[r, c]
    return strayed
