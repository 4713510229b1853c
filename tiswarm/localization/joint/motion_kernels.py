"""Motions of robots, of their turns and of subtrees of every chain, in one step.

Motions are Langevin dynamics: each has a mass, keeps a part of its velocity, and is kicked so that
it reaches the temperature sigma^2.

On processors one thread a block adds forces along the branches. On cards, no thread does more than
a few hundred additions: the robots that move with a subtree stand in a row, so that the force on it
is a difference of two sums over all robots before a place.
"""

from tiswarm.compute.lang import Ref, Static, ti
from tiswarm.compute.math_kernels import mixed, vector_at
from tiswarm.localization.joint.arrays import (
    END,
    MOVES,
    NUMBER,
    ORDINAL,
    OWN_END,
    PARENT,
    YAW_PRECISION,
)
from tiswarm.localization.joint.force_kernels import COS, INERTIA, SIN, SPIN, TORQUE, TOTAL, YAW

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
def _kick_of(seed, chain, number, t):
    """Three numbers of mean 0 and variance 1, a hash of seed, chain, robot and step."""
    key = mixed(mixed(ti.cast(seed, ti.u64)) ^ ti.cast(chain, ti.u64))
    key = mixed(mixed(key ^ ti.cast(number, ti.u64)) ^ ti.cast(t, ti.u64))
    spread = 3.4641016151377544  # of a uniform number: the square root of 12
    kick = ti.Vector([0.0, 0.0, 0.0])
    for axis in ti.static(range(3)):
        bits = (key >> ti.u64(10 * axis)) & ti.u64(1023)
        kick[axis] = spread * ((ti.cast(bits, float) + 0.5) / 1024.0 - 0.5)
    return kick


@ti.func
def _moved(velocity: Ref, i, axis, force, mass, sigma, kick):
    """Change a velocity; return how far it leads."""
    heat = sigma * ti.sqrt((1.0 - MEMORY * MEMORY) / mass)
    speed = velocity[i, axis] + _STEP * force / mass
    velocity[i, axis] = MEMORY * speed + heat * kick
    return 0.5 * _STEP * (speed + velocity[i, axis])


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
    kick = _kick_of(step.seed, r // count, -1 - robots.label[r % count, NUMBER], step.number)[0]
    heading = ti.static(swarm.heading)
    turn = _moved(heading, r, SPIN, heading[r, TORQUE], heading[r, INERTIA], step.sigma, kick)
    heading[r, YAW] += turn
    heading[r, COS] = ti.cos(heading[r, YAW])
    heading[r, SIN] = ti.sin(heading[r, YAW])
    for k in range(swarm.arm.shape[1]):
        _turn_dock(turn, r, k, swarm.arm)
    if step.is_averaged:
        heading[r, TOTAL] += heading[r, YAW]


@ti.func
def pull_subtree(k, robots, trees: Ref, swarm: Ref):
    """Write the force on the own robots of copy k of a subtree, and the mass of the subtree.

    A subtree that becomes heavier keeps its kinetic energy.
    """
    n = k % trees.table.shape[0]
    start = k // trees.table.shape[0] * robots
    pull = 0.0 * vector_at(swarm.force, start)
    weight = 0.0 * pull[0]
    for r in range(start + trees.table[n, 0], start + trees.table[n, OWN_END]):
        pull += vector_at(swarm.force, r)
        weight += trees.weight[n] * swarm.mass[r]
    _note_pull(k, pull, weight, trees)


@ti.func
def _note_pull(k, pull, weight, trees: Ref):
    """Write the force on copy k of a subtree, and its mass; velocities shrink as this grows."""
    lighter = ti.sqrt(trees.pull[k, 3] / weight)
    trees.pull[k, 3] = weight
    for c in ti.static(range(3)):
        trees.pull[k, c] = pull[c]
        trees.velocity[k, c] *= lighter


@ti.func
def gather_pulls(b, trees: Ref):
    """Add to the force on each subtree of block b those on all that grow out of it."""
    count = trees.table.shape[0]
    first, last = trees.first[b], trees.first[b + 1]
    chain = first // count
    for back in range(1, last - first):
        k = last - back
        parent = chain * count + trees.table[k - chain * count, PARENT]
        for c in ti.static(range(3)):
            trees.pull[parent, c] += trees.pull[k, c]


def sum_rows(copies: int) -> int:
    """Count the rows of `Subtrees.sums`: one a copy of a robot, a run, and a run of runs."""
    runs = -(-copies // RUN)
    return copies + runs - (-runs // RUN)


@ti.func
def count_pull(r, sums: Ref, swarm: Ref):
    """Write the force on copy r of a robot and its mass, in parts of one, to be added up."""
    for c in ti.static(range(3)):
        sums[r, c] = ti.cast(_PARTS * swarm.force[r, c], ti.i64)
    sums[r, 3] = ti.cast(_PARTS * swarm.mass[r], ti.i64)


@ti.func
def add_up(run, first, last, sums: Ref):
    """Replace each row of a run by the sum of the run up to it, and write the last one.

    Args:
        run: Number of the run.
        first: First row of all runs.
        last: Row after their last one, and that of the sum of run 0.
        sums: Rows of `Subtrees.sums`.
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
    copies = swarm.mass.shape[0]
    runs = (copies + RUN - 1) // RUN
    total = _sum_before(b, 0, sums) - _sum_before(a, 0, sums)
    total += _sum_before(b // RUN, copies, sums) - _sum_before(a // RUN, copies, sums)
    for group in range(a // (RUN * RUN), b // (RUN * RUN)):
        total += ti.Vector([sums[copies + runs + group, c] for c in range(4)])
    return ti.cast(total, float) / _PARTS


@ti.func
def pull_branch(k, robots, trees: Ref, swarm: Ref):
    """Write the force on all robots that move with copy k of a subtree, and its mass."""
    n = k % trees.table.shape[0]
    start = k // trees.table.shape[0] * robots
    first = start + trees.table[n, 0]
    own = _sum_between(first, start + trees.table[n, OWN_END], trees.sums, swarm)
    every = _sum_between(first, start + trees.table[n, END], trees.sums, swarm)
    _note_pull(k, every, trees.weight[n] * own[3], trees)


@ti.func
def gather_shifts(k, trees: Ref):
    """Add to the shift of copy k of a subtree those of all that it grows out of."""
    count = trees.table.shape[0]
    chain = k // count
    n = k % count
    shift = ti.Vector([trees.shift[k, 3 + c] for c in range(3)])
    while trees.table[n, PARENT] != n:
        n = trees.table[n, PARENT]
        shift += ti.Vector([trees.shift[chain * count + n, 3 + c] for c in range(3)])
    for c in ti.static(range(3)):
        trees.shift[k, c] = shift[c]


@ti.func
def move_subtree(k, column: Static, step: Ref, trees: Ref):
    """Write the shift of copy k of a subtree, without that of the subtrees it grows out of.

    Args:
        k: Copy of the subtree.
        column: First column of `Subtrees.shift` to write.
        step: The step.
        trees: Subtrees.
    """
    count = trees.table.shape[0]
    n = k % count
    kick = _kick_of(step.seed, k // count, _SUBTREE_KICKS + trees.table[n, ORDINAL], step.number)
    for c in ti.static(range(3)):
        trees.shift[k, column + c] = 0.0
        if trees.table[n, MOVES + c] == 1:
            trees.shift[k, column + c] = _moved(
                trees.velocity, k, c, trees.pull[k, c], trees.pull[k, 3], step.sigma, kick[c]
            )


@ti.func
def spread_shifts(b, trees: Ref):
    """Add to the shift of each subtree of block b that of the subtree it grows out of."""
    count = trees.table.shape[0]
    first, last = trees.first[b], trees.first[b + 1]
    chain = first // count
    for k in range(first + 1, last):
        parent = chain * count + trees.table[k - chain * count, PARENT]
        for c in ti.static(range(3)):
            trees.shift[k, c] += trees.shift[parent, c]


@ti.func
def move_robot(r, turning: Static, step: Ref, robots: Ref, trees: Ref, blocks: Ref, swarm: Ref):
    """Move copy r by itself and with its subtree, and turn it if robots turn; anchors stay.

    Returns:
        Its squared distance from where its Verlet row was built.
    """
    i = r % robots.label.shape[0]
    strayed = 0.0 * swarm.mass[r]
    number = robots.label[i, NUMBER]
    kick = _kick_of(step.seed, r // robots.label.shape[0], number, step.number)
    for c in ti.static(range(3)):
        if number > 0:
            mass, force = swarm.mass[r], swarm.force[r, c]
            alone = _moved(swarm.velocity, r, c, force, mass, step.sigma, kick[c])
            swarm.position[r, c] += alone + trees.shift[trees.of_robot[r], c]
        strayed += (swarm.position[r, c] - blocks.listed[4 * r + c]) ** 2
    if ti.static(turning) and robots.weight[i, YAW_PRECISION] > 0.0:
        _turn_robot(r, step, robots, swarm)
    if step.is_averaged:
        for c in ti.static(range(3)):
            swarm.total[r, c] += swarm.position[r, c]
            swarm.square_total[r] += swarm.position[r, c] * swarm.position[r, c]
    return strayed
