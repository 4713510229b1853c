"""Langevin dynamics: how robots and branches of them move, at a tolerance s, and robots turn.

Whatever moves has a mass, keeps a part of its velocity and is kicked so that it comes to the
temperature s^2. Copies of robots, blocks and branches are as `joint.kernels` has them.
"""

from tiswarm.compute.lang import Ref, ti
from tiswarm.compute.math_kernels import mixed, vector_at
from tiswarm.localization.joint.force_kernels import COS, INERTIA, SIN, SPIN, TORQUE, TOTAL, YAW
from tiswarm.localization.kernels import turn_dock

STEP = 1.0
"""Time step, where a robot held by one equation swings in 2 pi."""
MEMORY = 0.985
"""What friction leaves of a velocity in one step."""
BRANCH_KICKS = 2**30
"""Where the numbers of branches start among those of robots, for random numbers of their own."""


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
def moved(velocity: Ref, i, axis, force, mass, tolerance, kick):
    """Change a velocity; return how far it leads."""
    heat = tolerance * ti.sqrt((1.0 - MEMORY * MEMORY) / mass)
    speed = velocity[i, axis] + STEP * force / mass
    velocity[i, axis] = MEMORY * speed + heat * kick
    return 0.5 * STEP * (speed + velocity[i, axis])


@ti.func
def turn_robot(seed, t, r, tolerance, averaged, number: Ref, arm: Ref, heading: Ref):
    """Turn a robot, its docks with it."""
    kick = kick_of(seed, r // number.shape[0], -1 - number[r % number.shape[0]], t)[0]
    turn = moved(heading, r, SPIN, heading[r, TORQUE], heading[r, INERTIA], tolerance, kick)
    heading[r, YAW] += turn
    heading[r, COS] = ti.cos(heading[r, YAW])
    heading[r, SIN] = ti.sin(heading[r, YAW])
    for k in range(arm.shape[1]):
        turn_dock(turn, r, k, arm)
    if averaged:
        heading[r, TOTAL] += heading[r, YAW]


@ti.func
def move_branches(
    seed, t, b, tolerance, tree: Ref, branch_weight: Ref, first_branch: Ref, branch_pull: Ref,
    branch_velocity: Ref, branch_shift: Ref, start: Ref, force: Ref, mass: Ref,
):  # fmt: skip
    """Write how far every branch of a block is shifted, with those that it grows out of.

    A branch that becomes heavier keeps its kinetic energy.
    """
    first, last = first_branch[b], first_branch[b + 1]
    chain = first // tree.shape[0]
    for k in range(first, last):
        n = k - chain * tree.shape[0]
        pull = 0.0 * vector_at(force, start[b])
        weight = 0.0 * pull[0]
        for r in range(start[b] + tree[n, 0], start[b] + tree[n, 1]):
            pull += vector_at(force, r)
            weight += branch_weight[n] * mass[r]
        lighter = ti.sqrt(branch_pull[k, 3] / weight)
        branch_pull[k, 3] = weight
        for c in ti.static(range(3)):
            branch_pull[k, c] = pull[c]
            branch_velocity[k, c] *= lighter
            branch_shift[k, c] = 0.0
    for back in range(1, last - first):
        k = last - back
        parent = first + tree[k - chain * tree.shape[0], 2]
        for c in ti.static(range(3)):
            branch_pull[parent, c] += branch_pull[k, c]
    for k in range(first + 1, last):
        n = k - chain * tree.shape[0]
        kick = kick_of(seed, chain, BRANCH_KICKS + k - first, t)
        for c in ti.static(range(3)):
            branch_shift[k, c] = branch_shift[first + tree[n, 2], c]
            if tree[n, 3 + c] == 1:
                branch_shift[k, c] += moved(
                    branch_velocity, k, c, branch_pull[k, c], branch_pull[k, 3], tolerance, kick[c]
                )


@ti.func
def move_robot(
    seed, t, r, tolerance, averaged, turning: ti.template(), number: Ref, yaw_precision: Ref,
    branch: Ref, branch_shift: Ref, arm: Ref, listed: Ref, position: Ref, velocity: Ref, force: Ref,
    mass: Ref, heading: Ref, total: Ref, square_total: Ref,
):  # fmt: skip
    """Move a robot by itself and with its branch, and turn it if robots turn; anchors stay.

    Returns:
        Its squared distance from its row's place.
    """
    i = r % number.shape[0]
    strayed = 0.0 * mass[r]
    kick = kick_of(seed, r // number.shape[0], number[i], t)
    for c in ti.static(range(3)):
        if number[i] > 0:
            alone = moved(velocity, r, c, force[r, c], mass[r], tolerance, kick[c])
            position[r, c] += alone + branch_shift[branch[r], c]
        strayed += (position[r, c] - listed[4 * r + c]) ** 2
    if ti.static(turning) and yaw_precision[i] > 0.0:
        turn_robot(seed, t, r, tolerance, averaged, number, arm, heading)
    if averaged:
        for c in ti.static(range(3)):
            total[r, c] += position[r, c]
            square_total[r] += position[r, c] * position[r, c]
    return strayed
