"""Motions of robots, of their turns and of subtrees of every chain, in one step.

Motions are Langevin dynamics: each has a mass, keeps a part of its velocity, and is kicked so that
it reaches the temperature sigma^2.
"""

from tiswarm.compute.lang import Ref, Static, ti
from tiswarm.compute.math_kernels import mixed, vector_at
from tiswarm.localization.joint.arrays import MOVES, NUMBER, ORDINAL, PARENT, YAW_PRECISION
from tiswarm.localization.joint.force_kernels import COS, INERTIA, SIN, SPIN, TORQUE, TOTAL, YAW
from tiswarm.localization.virtual_force_kernels import turn_dock

_STEP = 1.0
"""Time step, where a robot held by one equation swings in 2 pi."""
MEMORY = 0.985
"""What friction leaves of a velocity in one step."""
_SUBTREE_KICKS = 2**30
"""Number of the first subtree among those of robots, so that subtrees draw other random numbers."""


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
        turn_dock(turn, r, k, swarm.arm)
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
    for r in range(start + trees.table[n, 0], start + trees.table[n, 1]):
        pull += vector_at(swarm.force, r)
        weight += trees.weight[n] * swarm.mass[r]
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


@ti.func
def move_subtree(k, step: Ref, trees: Ref):
    """Write the shift of copy k of a subtree, without that of the subtrees it grows out of."""
    count = trees.table.shape[0]
    n = k % count
    kick = _kick_of(step.seed, k // count, _SUBTREE_KICKS + trees.table[n, ORDINAL], step.number)
    for c in ti.static(range(3)):
        trees.shift[k, c] = 0.0
        if trees.table[n, MOVES + c] == 1:
            trees.shift[k, c] = _moved(
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
