"""Langevin dynamics of robots, of their turns and of subtrees.

Each has a mass, keeps a part of its velocity, and is kicked so that it reaches the temperature
sigma^2.
"""

from tiswarm.compute.lang import Ref, Static, ti
from tiswarm.compute.math_kernels import mixed, vector_at
from tiswarm.localization.joint.force_kernels import COS, INERTIA, SIN, SPIN, TORQUE, TOTAL, YAW
from tiswarm.localization.virtual_force_kernels import turn_dock

STEP = 1.0
"""Time step, where a robot held by one equation swings in 2 pi."""
MEMORY = 0.985
"""What friction leaves of a velocity in one step."""
SUBTREE_KICKS = 2**30
"""Number of the first subtree among those of robots, so that subtrees draw other random numbers."""


@ti.func
def kick_of(seed, chain, number, t):
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
def moved(velocity: Ref, i, axis, force, mass, sigma, kick):
    """Change a velocity; return how far it leads."""
    heat = sigma * ti.sqrt((1.0 - MEMORY * MEMORY) / mass)
    speed = velocity[i, axis] + STEP * force / mass
    velocity[i, axis] = MEMORY * speed + heat * kick
    return 0.5 * STEP * (speed + velocity[i, axis])


@ti.func
def turn_robot(r, step: Ref, robots: Ref, swarm: Ref):
    """Turn copy r of a robot, its docks with it."""
    count = robots.number.shape[0]
    kick = kick_of(step.seed, r // count, -1 - robots.number[r % count], step.number)[0]
    heading = ti.static(swarm.heading)
    turn = moved(heading, r, SPIN, heading[r, TORQUE], heading[r, INERTIA], step.sigma, kick)
    heading[r, YAW] += turn
    heading[r, COS] = ti.cos(heading[r, YAW])
    heading[r, SIN] = ti.sin(heading[r, YAW])
    for k in range(swarm.arm.shape[1]):
        turn_dock(turn, r, k, swarm.arm)
    if step.is_averaged:
        heading[r, TOTAL] += heading[r, YAW]


@ti.func
def move_subtrees(b, step: Ref, trees: Ref, blocks: Ref, swarm: Ref):
    """Write the shift of every subtree of block b, with that of the subtrees it grows out of.

    A subtree that becomes heavier keeps its kinetic energy.
    """
    first, last = trees.first[b], trees.first[b + 1]
    count = trees.table.shape[0]
    chain = first // count
    start = blocks.start[b]
    for k in range(first, last):
        n = k - chain * count
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
            trees.shift[k, c] = 0.0
    for back in range(1, last - first):
        k = last - back
        parent = first + trees.table[k - chain * count, 2]
        for c in ti.static(range(3)):
            trees.pull[parent, c] += trees.pull[k, c]
    for k in range(first + 1, last):
        n = k - chain * count
        kick = kick_of(step.seed, chain, SUBTREE_KICKS + k - first, step.number)
        for c in ti.static(range(3)):
            trees.shift[k, c] = trees.shift[first + trees.table[n, 2], c]
            if trees.table[n, 3 + c] == 1:
                trees.shift[k, c] += moved(
                    trees.velocity, k, c, trees.pull[k, c], trees.pull[k, 3], step.sigma, kick[c]
                )


@ti.func
def move_robot(
    r, turning: Static, step: Ref, robots: Ref, priors: Ref, trees: Ref, blocks: Ref,
    swarm: Ref,
):  # fmt: skip
    """Move copy r by itself and with its subtree, and turn it if robots turn; anchors stay.

    Returns:
        Its squared distance from where its Verlet row was built.
    """
    i = r % robots.number.shape[0]
    strayed = 0.0 * swarm.mass[r]
    kick = kick_of(step.seed, r // robots.number.shape[0], robots.number[i], step.number)
    for c in ti.static(range(3)):
        if robots.number[i] > 0:
            mass, force = swarm.mass[r], swarm.force[r, c]
            alone = moved(swarm.velocity, r, c, force, mass, step.sigma, kick[c])
            swarm.position[r, c] += alone + trees.shift[trees.of_robot[r], c]
        strayed += (swarm.position[r, c] - blocks.listed[4 * r + c]) ** 2
    if ti.static(turning) and priors.yaw_precision[i] > 0.0:
        turn_robot(r, step, robots, swarm)
    if step.is_averaged:
        for c in ti.static(range(3)):
            swarm.total[r, c] += swarm.position[r, c]
            swarm.square_total[r] += swarm.position[r, c] * swarm.position[r, c]
    return strayed
