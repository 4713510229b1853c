"""Forces on a robot in a chain, at a tolerance s: from contacts, overlaps and known places.

Stiffness, mass and temperature are those of an equation that may be missed by s: an equation of
variance v has stiffness s^2 / (s^2 + v) at temperature s^2, so a small v is tempered and a large
one is as soft as it is. Docks that are nearer than D repel with the energy
(D^2 - d^2)^2 / (8 D^2), which near D is that of a spring, (D - d)^2 / 2, and smooth at d = 0: its
curvature is at most 1 in every direction. A spring's force jumps there, and docks that pass through
each other gain energy at every pass. Copy r of robot i of N, one a chain, is number c N + i. Forces
are gathered in a fixed order. Lengths in R.

Where a log states a yaw bias, robots turn too: a robot's correction is the angle by which all that
its orientations say, its docks and its whole walk, is turned about the vertical through its final
center.
"""

from tiswarm.compute.lang import Ref, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.localization.kernels import with_torque

SPACING = 2.0
MOST_STIFFNESS = 1.2
"""Robots held more stiffly are given the mass to swing no faster: two that hold each other, each
moved by itself and one of them by its branch too, at 2.8 times the square of that frequency. At 4
times steps diverge."""
MOST_TURN_STIFFNESS = 0.25
"""The same of turns; less, for a turn and a shift swing together."""
FORGET = 0.99
"""What is kept of a mass no longer needed, in one step."""
TINY = 1e-12
WHOLE = 2.0**44
"""Parts of one in which pushes are counted."""
COS, SIN, YAW, SPIN, TORQUE, INERTIA, TOTAL = range(7)
"""Columns of the table of headings: how far robots have been turned, and how they turn."""


@ti.func
def push_inside(square_length, slope):
    """Repulsion of docks nearer than D, as a part of their offset; 0 for others.

    Args:
        square_length: Squared distance of the docks [R^2].
        slope: 1 / (2 D^2) [R^-2].
    """
    return ti.max(0.5 - slope * square_length, 0.0)


@ti.func
def turned(x, y, heading: Ref, r):
    """Turn a horizontal arm as far as copy `r` of a robot has been turned."""
    c, s = heading[r, COS], heading[r, SIN]
    return ti.Vector([c * x - s * y, s * x + c * y, 0.0])


@ti.func
def pull_of_contacts(
    square, slope, robust, turning: ti.template(), turns, robot, base, contact_start: Ref,
    partner: Ref, touching: Ref, stretch: Ref, shift: Ref, lever: Ref, variance: Ref, position: Ref,
    heading: Ref,
):  # fmt: skip
    """Sum of the forces of a robot's contacts with its torque, of their stiffness and its inertia.

    With r the residual, w = s^2 + v and c^2 = 1 / `robust`, each has the energy of Cauchy's loss,
    s^2 c^2 / 2 log(1 + r^2 / (c^2 w)), or s^2 r^2 / (2 w) where `robust` is 0; where docks are
    nearer than D, its force has the factor by which the push of overlaps is less than a spring's.
    The logarithm still holds a robot whose contacts are all in doubt. Docks in contact at the end
    do not repel each other as all others do: this function subtracts the push that
    `push_of_overlaps` gives them.

    Robots in contact at the end push each other apart, for they are likelier the farther apart
    their centers would be if their docks just touched: energy -s^2 `stretch` times that distance,
    which only the direction between the docks decides. So the push is across it, lest it draw out
    contacts that little is known of; as far as a contact gives way, so does the push.
    """
    here = vector_at(position, base + robot)
    force = with_torque(0.0 * here, here)
    stiffness = 0.0 * here[0]
    inertia = stiffness
    for slot in range(contact_start[robot], contact_start[robot + 1]):
        between = here - vector_at(position, base + partner[slot])
        apart = between + vector_at(shift, slot)
        arm = 0.0 * here
        if ti.static(turning) and turns:
            arm = turned(lever[slot, 0], lever[slot, 1], heading, base + robot)
            its = turned(lever[slot, 2], lever[slot, 3], heading, base + partner[slot])
            apart[0] += arm[0] - its[0] - lever[slot, 0] + lever[slot, 2]
            apart[1] += arm[1] - its[1] - lever[slot, 1] + lever[slot, 3]
        length = ti.max(apart.norm(), TINY)
        residual = length - SPACING
        within = square + variance[slot] + residual * residual * robust
        inverse = 1.0 / (within * length)  # one division for two
        stiff = square * length * inverse
        inside = push_inside(length * length, 0.5 / SPACING**2)
        pull = ti.select(residual < 0.0, -inside, residual * within * inverse)
        overlap = touching[slot] * push_inside(length * length, slope)
        force -= with_torque((stiff * pull + overlap) * apart, arm)
        if touching[slot] == 1:
            trust = (square + variance[slot]) * length * inverse
            held = between + (SPACING / length - 1.0) * apart
            push = trust * square * stretch[slot] / ti.max(held.norm(), 1.0) * held
            across = push - push.dot(apart) / (length * length) * apart
            across *= SPACING / ti.max(length, SPACING)
            # The turn of an arm turns `apart`, and would move `held` were it not for the contact.
            force += with_torque(across, arm) - with_torque(push, arm)
            force += with_torque(push, 0.0 * arm)
        stiff -= ti.select(overlap > 0.0, 1.0, 0.0)
        stiffness += stiff
        inertia += stiff * arm.norm_sqr()
    return force, stiffness, inertia


@ti.func
def push_of_overlaps(
    grid: Ref, docks: ti.template(), r, slope, first, entries, arm: Ref, row: Ref, position: Ref,
):  # fmt: skip
    """Sum of the forces of docks that are too near, of their stiffness and inertia.

    Whole numbers make the sum independent of the order of a row.
    """
    here = vector_at(position, r)
    own = ti.Matrix([[arm[r, k, c] for c in range(3)] for k in range(docks)])
    units = ti.cast(with_torque(0.0 * here, here), ti.i64)
    inertia = ti.i64(0)
    overlaps = 0
    widest = 0.5 / slope  # D^2
    for e in range(entries):
        other = row[first + e * grid.entry_stride] >> (grid.own_bits + 1)
        between = here - vector_at(position, other)
        if between.norm_sqr() < grid.near * grid.near:
            for m in range(docks):
                off = between - ti.Vector([arm[other, m, 0], arm[other, m, 1], arm[other, m, 2]])
                for k in ti.static(range(docks)):
                    apart = off + own[k, :]
                    square_length = apart.norm_sqr()
                    if square_length < widest:
                        push = with_torque(push_inside(square_length, slope) * apart, own[k, :])
                        units += ti.cast(push * WHOLE, ti.i64)
                        inertia += ti.cast((own[k, 0] ** 2 + own[k, 1] ** 2) * WHOLE, ti.i64)
                        overlaps += 1
    return ti.cast(units, float) / WHOLE, ti.cast(overlaps, float), ti.cast(inertia, float) / WHOLE


@ti.func
def mass_for(needed, before, factor):
    """Mass that a stiffness needs, at least 1, times a factor; one that is too great shrinks."""
    return ti.max(factor * ti.max(1.0, needed), FORGET * before + (1.0 - FORGET) * factor)


@ti.func
def pull_robot(
    grid: Ref, docks: ti.template(), turning: ti.template(), r, tolerance, growth, inertia_factor,
    non_overlap: Ref, robust: Ref, contact_start: Ref, partner: Ref, touching: Ref, stretch: Ref,
    shift: Ref, lever: Ref, variance: Ref, place: Ref, precision: Ref, walk: Ref,
    yaw_precision: Ref, arm: Ref, row: Ref, row_first: Ref, row_count: Ref, position: Ref,
    velocity: Ref, force: Ref, mass: Ref, heading: Ref,
):  # fmt: skip
    """Write the force on a robot and the mass that it needs, and both for its turn if it turns.

    A robot that becomes heavier keeps its kinetic energy, not its velocity.
    """
    square = tolerance * tolerance
    i = r % non_overlap.shape[0]
    turns = yaw_precision[i] > 0.0
    width = non_overlap[i] * SPACING * growth
    slope = 0.5 / ti.max(width * width, TINY)
    pull, stiffness, inertia = pull_of_contacts(
        square, slope, robust[i], turning, turns, i, r - i, contact_start, partner,
        touching, stretch, shift, lever, variance, position, heading,
    )  # fmt: skip
    if non_overlap[i] == 1:
        push, hardness, lag = push_of_overlaps(
            grid, docks, r, slope, row_first[r], row_count[r], arm, row, position
        )
        pull += push
        stiffness += hardness
        inertia += lag
    walked = 0.0 * vector_at(position, r)
    if ti.static(turning):
        walked = turned(walk[i, 0], walk[i, 1], heading, r)
    hold = vector_at(place, i) - walked - vector_at(position, r)
    for c in ti.static(range(3)):
        known = square * precision[i, c]
        stiff = known / (1.0 + known)
        hold[c] *= stiff
        force[r, c] = pull[c] + hold[c]
        stiffness += stiff / 3.0
        inertia += 0.5 * stiff * walked.norm_sqr()  # no less than it is
    before = mass[r]
    mass[r] = mass_for(stiffness / MOST_STIFFNESS, before, inertia_factor)
    slower = ti.sqrt(before / mass[r])
    for c in ti.static(range(3)):
        velocity[r, c] *= slower
    if ti.static(turning) and turns:
        stiff = square * yaw_precision[i]
        torque = pull[3] + with_torque(hold, walked)[3] - stiff * heading[r, YAW]
        heading[r, TORQUE] = torque
        before = heading[r, INERTIA]
        needed = (inertia + stiff) / MOST_TURN_STIFFNESS
        heading[r, INERTIA] = mass_for(needed, before, inertia_factor)
        heading[r, SPIN] *= ti.sqrt(before / heading[r, INERTIA])
