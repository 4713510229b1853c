"""Forces on a robot in a chain, at a tolerance s: from contacts, overlaps and known places.

Stiffness, mass and temperature are those of an equation that may be missed by s: an equation of
variance v has stiffness s^2 / (s^2 + v) at temperature s^2, so a small v is tempered and a large
one is as soft as it is. Copy r of robot i of N, one a chain, is number c N + i. Forces are
gathered in a fixed order. Lengths in R.
"""

from tiswarm.compute.dialect import ti
from tiswarm.compute.kernels import vector_at

SPACING = 2.0
MOST_STIFFNESS = 4.0
"""Robots held more stiffly are given the mass to swing no faster."""
FORGET = 0.99
"""What is kept of a mass no longer needed, in one step."""
TINY = 1e-12


@ti.func
def pull_of_contacts(
    square,
    solid,
    robust,
    robot,
    base,
    contact_start: ti.template(),
    partner: ti.template(),
    touching: ti.template(),
    shift: ti.template(),
    variance: ti.template(),
    position: ti.template(),
):
    """Sum of the forces of a robot's contacts, and of their stiffness.

    With r the residual, w = s^2 + v and c^2 = 1 / `robust`, each has the energy of Cauchy's loss,
    s^2 c^2 / 2 log(1 + r^2 / (c^2 w)), or s^2 r^2 / (2 w) where `robust` is 0. The logarithm still
    holds a robot whose contacts are all in doubt. Docks in contact at the end do not push each
    other apart as all others do; what these are given by mistake is taken back.
    """
    here = vector_at(position, base + robot)
    force = 0.0 * here
    stiffness = 0.0 * here[0]
    for slot in range(contact_start[robot], contact_start[robot + 1]):
        apart = here + vector_at(shift, slot) - vector_at(position, base + partner[slot])
        length = ti.max(apart.norm(), TINY)
        residual = length - SPACING
        within = square + variance[slot] + residual * residual * robust
        inverse = 1.0 / (within * length)  # one division for two
        stiff = square * length * inverse
        if residual < 0.0:
            stiff -= solid * touching[slot]
        force -= stiff * residual * within * inverse * apart
        stiffness += stiff
    return force, stiffness


@ti.func
def push_of_overlaps(
    grid: ti.template(),
    r,
    base,
    first,
    entries,
    arm: ti.template(),
    row: ti.template(),
    position: ti.template(),
):
    """Sum of the forces of docks that overlap, and of their stiffness."""
    here = vector_at(position, r)
    force = 0.0 * here
    stiffness = 0.0 * here[0]
    for e in range(entries):
        other = row[first + e * grid.entry_stride] >> (grid.own_bits + 1)
        between = here - vector_at(position, other)
        if between.norm_sqr() < grid.near * grid.near:
            for k in range(arm.shape[1]):
                for m in range(arm.shape[1]):
                    apart = between
                    for c in ti.static(range(3)):
                        apart[c] += arm[r - base, k, c] - arm[other - base, m, c]
                    if apart.norm_sqr() < SPACING * SPACING:
                        length = ti.max(apart.norm(), TINY)
                        force += (SPACING - length) / length * apart
                        stiffness += 1.0
    return force, stiffness


@ti.func
def pull_robot(
    grid: ti.template(),
    r,
    tolerance,
    non_overlap: ti.template(),
    robust: ti.template(),
    contact_start: ti.template(),
    partner: ti.template(),
    touching: ti.template(),
    shift: ti.template(),
    variance: ti.template(),
    place: ti.template(),
    precision: ti.template(),
    arm: ti.template(),
    row: ti.template(),
    row_first: ti.template(),
    row_count: ti.template(),
    position: ti.template(),
    force: ti.template(),
    mass: ti.template(),
):
    """Write the force on a robot, and the mass that it needs."""
    square = tolerance * tolerance
    i = r % non_overlap.shape[0]
    pull, stiffness = pull_of_contacts(
        square, non_overlap[i], robust[i], i, r - i, contact_start, partner, touching, shift,
        variance, position,
    )  # fmt: skip
    if non_overlap[i] == 1:
        push, hardness = push_of_overlaps(
            grid, r, r - i, row_first[r], row_count[r], arm, row, position
        )
        pull += push
        stiffness += hardness
    for c in ti.static(range(3)):
        known = square * precision[i, c]
        stiff = known / (1.0 + known)
        force[r, c] = pull[c] + stiff * (place[i, c] - position[r, c])
        stiffness += stiff / 3.0
    mass[r] = ti.max(1.0, stiffness / MOST_STIFFNESS, FORGET * mass[r] + (1.0 - FORGET))
