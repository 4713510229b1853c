"""One step of Langevin dynamics of every robot of every chain, and tidy rows of neighbors.

The swarm is C copies, one a chain, of N robots: those of all structures, end to end. Copy r of
robot i is number c N + i. Stiffness, mass and temperature are those of an equation that may be
missed by the tolerance s: an equation of variance v has stiffness s^2 / (s^2 + v) at temperature
s^2, so a small v is tempered and a large one is as soft as it is. Forces are gathered in a fixed
order. Lengths in R.
"""

from tiswarm.compute.dialect import I32, Float, Ints1, Reals1, Reals2, Reals3, ti
from tiswarm.compute.kernels import vector_at
from tiswarm.compute.random import mixed

SPACING = 2.0
STEP = 0.5
"""Time step, where a robot held by one equation swings in 2 pi."""
MEMORY = 0.985
"""What friction leaves of a velocity in one step."""
MOST_STIFFNESS = 4.0
"""Robots held more stiffly are given the mass to swing no faster."""
FORGET = 0.99
"""What is kept of a mass no longer needed, in one step."""
TINY = 1e-12


@ti.func
def pull_of_contacts(
    square,
    robust,
    robot,
    base,
    contact_start: ti.template(),
    partner: ti.template(),
    shift: ti.template(),
    variance: ti.template(),
    position: ti.template(),
):
    """Sum of the forces of a robot's contacts, and of their stiffness.

    With r the residual, w = s^2 + v and c^2 = 1 / `robust`, each has the energy of Cauchy's loss,
    s^2 c^2 / 2 log(1 + r^2 / (c^2 w)), or s^2 r^2 / (2 w) where `robust` is 0. The logarithm still
    holds a robot whose contacts are all in doubt.
    """
    here = vector_at(position, base + robot)
    force = 0.0 * here
    stiffness = 0.0 * here[0]
    for slot in range(contact_start[robot], contact_start[robot + 1]):
        apart = here + vector_at(shift, slot) - vector_at(position, base + partner[slot])
        length = ti.max(apart.norm(), TINY)
        residual = length - SPACING
        within = square + variance[slot]
        trust = 1.0 / (1.0 + residual * residual * robust / within)
        stiff = square / within * trust
        force -= stiff * residual / length * apart
        stiffness += stiff
    return force, stiffness


@ti.func
def push_of_overlaps(
    docks,
    own_bits,
    robot,
    first,
    entries,
    entry_stride,
    row: ti.template(),
    dock: ti.template(),
):
    """Sum of the forces of docks that overlap without being in contact, and of their stiffness."""
    force = 0.0 * ti.Vector([dock[0, 0, 0], 0.0, 0.0])
    stiffness = 0.0 * dock[0, 0, 0]
    flag = 1 << own_bits
    for e in range(entries):
        entry = row[first + e * entry_stride]
        own = robot * docks + (entry & (flag - 1))
        other = entry >> (own_bits + 1)
        apart = ti.Vector(
            [
                dock[0, own, 0] - dock[0, other, 0],
                dock[0, own, 1] - dock[0, other, 1],
                dock[0, own, 2] - dock[0, other, 2],
            ]
        )
        if (entry & flag) == 0 and apart.norm_sqr() < SPACING * SPACING:
            length = ti.max(apart.norm(), TINY)
            force += (SPACING - length) / length * apart
            stiffness += 1.0
    return force, stiffness


@ti.func
def kick_of(seed, chain, number, t):
    """Three numbers of mean 0 and variance 1, a hash of seed, chain, robot and step."""
    key = mixed(mixed(ti.cast(seed, ti.u64)) ^ ti.cast(chain, ti.u64))
    key = mixed(key ^ ti.cast(number, ti.u64))
    key = mixed(key ^ ti.cast(t, ti.u64))
    spread = 3.4641016151377544  # of a uniform number: the square root of 12
    kick = ti.Vector([0.0, 0.0, 0.0])
    for axis in ti.static(range(3)):
        bits = mixed(key ^ ti.u64(axis))
        kick[axis] = spread * ((ti.cast(bits, float) + 0.5) * 2.0**-32 - 0.5)
    return kick


@ti.kernel
def take_step(
    docks: I32,
    own_bits: I32,
    robot_stride: I32,
    entry_stride: I32,
    seed: I32,
    t: I32,
    tolerance: Float,
    averaged: I32,
    # equations
    number: Ints1,
    non_overlap: Ints1,
    robust: Reals1,
    contact_start: Ints1,
    partner: Ints1,
    shift: Reals2,
    variance: Reals1,
    place: Reals2,
    precision: Reals2,
    arm: Reals3,
    # neighbors
    row: Ints1,
    row_count: Ints1,
    # state
    position: Reals2,
    velocity: Reals2,
    force: Reals2,
    mass: Reals1,
    dock: Reals3,
    total: Reals2,
    square_total: Reals1,
):
    """Move every robot but the anchors once, at the temperature of a tolerance.

    Args:
        docks: Docks of a robot.
        own_bits: Bits of a row's entry that number the robot's own dock.
        robot_stride: From one row to the next.
        entry_stride: From one entry to the next.
        seed: Of the random numbers.
        t: Which step.
        tolerance: s [R].
        averaged: Whether the step counts for the averages.
        number: Join number within its structure, shape (N,).
        non_overlap: Whether the cue is on in its structure, shape (N,).
        robust: One over the square of the loss's width, 0 for none [1], shape (N,).
        contact_start: First contact of each robot, shape (N + 1,).
        partner: The other robot, shape (K,); every contact stands at both its robots.
        shift: Seen from the robot [R], shape (K, 3).
        variance: Of each contact [R^2], shape (K,).
        place: Where each centre is known to be [R], shape (N, 3).
        precision: How well [R^-2], shape (N, 3).
        arm: Centre to dock, world frame [R], shape (N, docks, 3).
        row: Rows of the neighbor list.
        row_count: Length of each, shape (C N,).
        position: Read and written [R], shape (C N, 3).
        velocity: Read and written, shape (C N, 3).
        force: Scratch, shape (C N, 3).
        mass: Read and written, shape (C N,).
        dock: Read and written: places of docks, last the copy of the structure, (1, M, 4).
        total: Read and written: sum of positions that are averaged, shape (C N, 3).
        square_total: Read and written: sum of their squares, shape (C N,).
    """
    square = tolerance * tolerance
    for r in range(row_count.shape[0]):
        i = r % number.shape[0]
        pull, stiffness = pull_of_contacts(
            square, robust[i], i, r - i, contact_start, partner, shift, variance, position
        )
        if non_overlap[i] == 1:
            push, hardness = push_of_overlaps(
                docks, own_bits, r, r * robot_stride, row_count[r], entry_stride, row, dock
            )
            pull += push
            stiffness += hardness
        for c in ti.static(range(3)):
            known = square * precision[i, c]
            stiff = known / (1.0 + known)
            force[r, c] = pull[c] + stiff * (place[i, c] - position[r, c])
            stiffness += stiff / 3.0
        mass[r] = ti.max(1.0, stiffness / MOST_STIFFNESS, FORGET * mass[r] + (1.0 - FORGET))
    for r in range(row_count.shape[0]):
        i = r % number.shape[0]
        if number[i] > 0:
            heat = ti.sqrt((1.0 - MEMORY * MEMORY) * square / mass[r])
            kick = kick_of(seed, r // number.shape[0], number[i], t)
            for c in ti.static(range(3)):
                speed = velocity[r, c] + STEP * force[r, c] / mass[r]
                velocity[r, c] = MEMORY * speed + heat * kick[c]
                position[r, c] += 0.5 * STEP * (speed + velocity[r, c])
            for k in range(docks):
                for c in ti.static(range(3)):
                    dock[0, r * docks + k, c] = position[r, c] + arm[i, k, c]
        if averaged == 1:
            for c in ti.static(range(3)):
                total[r, c] += position[r, c]
                square_total[r] += position[r, c] * position[r, c]


@ti.kernel
def sort_rows(robot_stride: I32, entry_stride: I32, row: Ints1, row_count: Ints1):
    """Sort the entries of each row, so that sums do not depend on the layout of the table."""
    for r in range(row_count.shape[0]):
        first = r * robot_stride
        for e in range(1, row_count[r]):
            entry = row[first + e * entry_stride]
            to = e
            while to > 0 and row[first + ti.max(to - 1, 0) * entry_stride] > entry:
                row[first + to * entry_stride] = row[first + (to - 1) * entry_stride]
                to -= 1
            row[first + to * entry_stride] = entry
