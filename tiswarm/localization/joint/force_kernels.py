"""Forces on a robot in a chain: of contacts, overlaps and measured coordinates. Lengths in R.

At the temperature T = sigma^2 a measurement of variance v has the stiffness sigma^2 / (sigma^2 +
v): a small v is tempered, a large one acts as it is. Docks nearer than D repel with the energy
(D^2 - d^2)^2 / (8 D^2). Near D that is a spring's, (D - d)^2 / 2; at d = 0 it is smooth, with a
curvature of at most 1 in every direction. A spring's force jumps there, and docks that pass through
each other gain energy at every pass. Forces are gathered in a fixed order.

Where a log states a yaw bias, robots turn too: the correction of a robot is the angle by which all
its orientations, and so its docks and its walk, are turned about the vertical through its final
center.
"""

from tiswarm.compute.lang import Ref, Static, ti
from tiswarm.compute.math_kernels import vector_at, with_torque
from tiswarm.localization.joint.arrays import (
    ACROSS,
    CROWD,
    DIRECTION,
    EXTENSION,
    IS_FINAL,
    IS_OWN,
    LENGTH,
    NON_OVERLAP,
    PARTNER,
    PLANE_ROBUST,
    PRECISION,
    ROBUST,
    TOUCH,
    VARIANCE,
    VECTOR,
    WALK,
    YAW_PRECISION,
)
from tiswarm.measurements.rows import SPACING

_MOST_STIFFNESS = 1.2
"""Robots held more stiffly are given the mass to swing no faster: two that hold each other, each
moved by itself and one of them by its branch too, at 2.8 times the square of that frequency. At 4
times steps diverge."""
_OFFSET_STIFFNESS = 2.0
"""Stiffness that an offset counts for, in its own. Robots that offsets hold in all directions at
once swing against each other faster than those that distances hold; with 1, steps heat chains by a
tenth on training structures, with 2 by no more than without offsets."""
_MOST_TURN_STIFFNESS = 0.25
"""The same of turns; less, for a turn and a shift swing together."""
_FORGET = 0.99
"""What is kept of a mass no longer needed, in one step."""
_TINY = 1e-12
_WHOLE = 2.0**44
"""Parts of one in which pushes are counted."""
COS, SIN, YAW, SPIN, TORQUE, INERTIA, TOTAL = range(7)
"""Columns of the table of headings: how far robots have been turned, and how they turn."""


@ti.func
def part_at(table: Ref, row, first):
    """Read three columns of a table, from `first` on, as a vector."""
    return ti.Vector([table[row, first], table[row, first + 1], table[row, first + 2]])


@ti.func
def _push_inside(square_length, slope):
    """Repulsion of docks nearer than D, as a part of their offset; 0 for others.

    Args:
        square_length: Squared distance of the docks [R^2].
        slope: 1 / (2 D^2) [R^-2].
    """
    return ti.max(0.5 - slope * square_length, 0.0)


@ti.func
def _turned(x, y, heading: Ref, r):
    """Turn a horizontal arm as far as copy `r` of a robot has been turned."""
    c, s = heading[r, COS], heading[r, SIN]
    return ti.Vector([c * x - s * y, s * x + c * y, 0.0])


@ti.func
def _pull_of_offset(
    r, partner, slot, apart, arm, turning: Static, square, robust, contacts: Ref, swarm: Ref
):
    """Compute the force of an offset on copy r of a robot, its torque, stiffness and inertia.

    The residual is a vector e, with variances v_k along the measured vector and across it. With
    w_k = sigma^2 + v_k and c^2 = 1 / `robust`, the energy is Cauchy's loss of the sum of squares,
    sigma^2 c^2 / 2 log(1 + sum_k e_k^2 / (c^2 w_k)). The measured vector, and with it the axes,
    turn with the robot that measured it: the force on that robot acts at the partner's dock.

    Args:
        r: Copy of the robot.
        partner: Copy of its partner.
        slot: Entry of the offset.
        apart: From the partner's dock to the robot's [R].
        arm: From the center of the robot to its dock, horizontal part [R].
        turning: Whether any robot turns.
        square: Temperature sigma^2 [R^2].
        robust: One over the squared width of the robust loss [1].
        contacts: Contacts.
        swarm: State of the copies.
    """
    vector = part_at(contacts.level, slot, VECTOR)
    lever = arm
    if ti.static(turning):
        owner = partner
        if contacts.label[slot, IS_OWN] == 1:
            owner, lever = r, arm - apart
        level = _turned(vector[0], vector[1], swarm.heading, owner)
        vector[0], vector[1] = level[0], level[1]
    residual = apart + vector
    along = residual.dot(vector) / vector.norm_sqr() * vector
    across = residual - along
    stiff = square / (square + contacts.value[slot, VARIANCE])
    stiff_across = square / (square + contacts.value[slot, ACROSS])
    torn = stiff * along.norm_sqr() + stiff_across * across.norm_sqr()
    whole = 1.0 / (1.0 + robust * torn / square)
    force = -whole * (stiff * along + stiff_across * across)
    stiffest = _OFFSET_STIFFNESS * whole * ti.max(stiff, stiff_across)
    inertia = stiffest * (lever[0] * lever[0] + lever[1] * lever[1])
    return with_torque(force, lever), stiffest, inertia


@ti.func
def _nearest_docks(
    r, partner, slot, between, docks: Static, turning: Static, contacts: Ref, swarm: Ref
):
    """Find which docks of copy r and its partner touch: those whose distance is nearest to D.

    Of equally near pairs the first is taken.

    Args:
        r: Copy of the robot.
        partner: Copy of its partner.
        slot: Entry of the touch.
        between: From the partner's center to the robot's [R].
        docks: Docks of a robot.
        turning: Whether any robot turns.
        contacts: Contacts.
        swarm: State of the copies.

    Returns:
        From the partner's dock to the robot's, and the arm of the robot's dock [R].
    """
    row = contacts.label[slot, TOUCH]
    nearest, arm = between, between
    least = 1.0 / _TINY
    for k in range(docks):
        own = ti.Vector([contacts.candidates[row, k, c] for c in range(3)])
        if ti.static(turning):
            level = _turned(own[0], own[1], swarm.heading, r)
            own[0], own[1] = level[0], level[1]
        for m in range(docks):
            its = ti.Vector([contacts.candidates[row, m, 3 + c] for c in range(3)])
            if ti.static(turning):
                level = _turned(its[0], its[1], swarm.heading, partner)
                its[0], its[1] = level[0], level[1]
            apart = between + own - its
            off = ti.abs(apart.norm() - contacts.value[slot, LENGTH])
            if off < least:
                least, nearest, arm = off, apart, own
    return nearest, arm


@ti.func
def _pull_of_contacts(
    r,
    i,
    docks: Static,
    turning: Static,
    slope,
    step: Ref,
    robots: Ref,
    contacts: Ref,
    swarm: Ref,
):
    """Sum the forces of the contacts of copy r of robot i, their torque, stiffness and inertia.

    With residual e, w = sigma^2 + v and c^2 = 1 / `robust`, each has the energy of Cauchy's loss,
    sigma^2 c^2 / 2 log(1 + e^2 / (c^2 w)), or sigma^2 e^2 / (2 w) where `robust` is 0. Where docks
    are nearer than D, the force has the factor by which the push of overlaps is less than a
    spring's. The logarithm still holds a robot whose contacts are all outliers. Docks in contact at
    the end do not repel each other as all others do: this function subtracts the push that
    `_push_of_overlaps` gives them.

    Robots in contact at the end push each other apart, since robots extend outward: the farther
    apart their centers would be if their docks just touched, the likelier. This prior has the
    energy -sigma^2 `extension` times that distance, which only the direction between the docks
    decides. The push is perpendicular to the contact: along it, it would lengthen uncertain
    contacts. Where a contact gives way, so does the push.

    The docks of a touch are those that are nearest to D apart at this step.
    """
    square = step.sigma * step.sigma
    base = r - i
    turns, robust = robots.weight[i, YAW_PRECISION] > 0.0, robots.weight[i, ROBUST]
    here = vector_at(swarm.position, r)
    force = with_torque(0.0 * here, here)
    stiffness = 0.0 * here[0]
    inertia = stiffness
    for slot in range(contacts.start[i], contacts.start[i + 1]):
        partner = base + contacts.label[slot, PARTNER]
        between = here - vector_at(swarm.position, partner)
        apart = between + vector_at(contacts.value, slot)
        arm = 0.0 * here
        if ti.static(turning) and turns:
            x, y = contacts.level[slot, 0], contacts.level[slot, 1]
            its_x, its_y = contacts.level[slot, 2], contacts.level[slot, 3]
            arm = _turned(x, y, swarm.heading, r)
            its = _turned(its_x, its_y, swarm.heading, partner)
            apart[0] += arm[0] - its[0] - x + its_x
            apart[1] += arm[1] - its[1] - y + its_y
        if ti.static(contacts.has_touches):
            if contacts.label[slot, TOUCH] >= 0:
                apart, arm = _nearest_docks(
                    r, partner, slot, between, docks, turning, contacts, swarm
                )
                arm[2] = 0.0
        length = ti.max(apart.norm(), _TINY)
        measured = contacts.value[slot, LENGTH]
        residual = length - measured
        width = square + contacts.value[slot, VARIANCE]
        within = width + residual * residual * robust
        inverse = 1.0 / (within * length)  # one division for two
        stiff = square * length * inverse
        inside = _push_inside(length * length, 0.5 / ti.max(measured * measured, _TINY))
        pull = ti.select(residual < 0.0, -inside, residual * within * inverse)
        overlap = contacts.label[slot, IS_FINAL] * _push_inside(length * length, slope)
        if ti.static(contacts.has_offsets):
            if contacts.value[slot, ACROSS] > 0.0:
                held, stiff, lag = _pull_of_offset(
                    r, partner, slot, apart, arm, turning, square, robust, contacts, swarm
                )
                force += held
                inertia += lag
                pull = 0.0
        force -= with_torque((stiff * pull + overlap) * apart, arm)
        if contacts.label[slot, IS_FINAL] == 1:
            trust = width * length * inverse
            gain = contacts.value[slot, EXTENSION]
            held = between + (SPACING / length - 1.0) * apart
            push = trust * square * gain / ti.max(held.norm(), 1.0) * held
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
def _push_of_overlaps(r, docks: Static, slope, grid: Ref, rows: Ref, swarm: Ref):
    """Sum the forces of docks that are too near to copy r, with their stiffness and inertia.

    Integers make the sum independent of the order of a row.
    """
    here = vector_at(swarm.position, r)
    own = ti.Matrix([[swarm.arm[r, k, c] for c in range(3)] for k in range(docks)])
    units = ti.cast(with_torque(0.0 * here, here), ti.i64)
    inertia = ti.i64(0)
    overlaps = 0
    widest = 0.5 / slope  # D^2
    for e in range(rows.count[r]):
        other = rows.entry[rows.first[r] + e * grid.entry_stride] >> (grid.own_bits + 1)
        between = here - vector_at(swarm.position, other)
        if between.norm_sqr() < grid.near * grid.near:
            for m in range(docks):
                its = ti.Vector([swarm.arm[other, m, c] for c in range(3)])
                off = between - its
                for k in ti.static(range(docks)):
                    apart = off + own[k, :]
                    square_length = apart.norm_sqr()
                    if square_length < widest:
                        push = with_torque(_push_inside(square_length, slope) * apart, own[k, :])
                        units += ti.cast(push * _WHOLE, ti.i64)
                        inertia += ti.cast((own[k, 0] ** 2 + own[k, 1] ** 2) * _WHOLE, ti.i64)
                        overlaps += 1
    return (
        ti.cast(units, float) / _WHOLE,
        ti.cast(overlaps, float),
        ti.cast(inertia, float) / _WHOLE,
    )


@ti.func
def _mass_for(needed, before, factor):
    """Mass that a stiffness needs, at least 1, times a factor; one that is too great shrinks."""
    return ti.max(factor * ti.max(1.0, needed), _FORGET * before + (1.0 - _FORGET) * factor)


@ti.func
def pull_robot(
    r, docks: Static, turning: Static, step: Ref, robots: Ref, contacts: Ref,
    priors: Ref, grid: Ref, rows: Ref, swarm: Ref,
):  # fmt: skip
    """Write the force on copy r and the mass that it needs, and both for its turn if it turns.

    A robot that becomes heavier keeps its kinetic energy, not its velocity.
    """
    square = step.sigma * step.sigma
    i = r % robots.label.shape[0]
    width = robots.label[i, NON_OVERLAP] * SPACING * step.growth
    slope = 0.5 / ti.max(width * width, _TINY)
    pull, stiffness, inertia = _pull_of_contacts(
        r, i, docks, turning, slope, step, robots, contacts, swarm
    )
    if robots.label[i, NON_OVERLAP] == 1:
        push, hardness, lag = _push_of_overlaps(r, docks, slope, grid, rows, swarm)
        pull += push
        stiffness += hardness
        inertia += lag
    hold = with_torque(0.0 * vector_at(swarm.position, r), vector_at(swarm.position, r))
    for plane in range(priors.start[i], priors.start[i + 1]):
        walked = 0.0 * vector_at(swarm.position, r)
        if ti.static(turning):
            walk_x, walk_y = priors.plane[plane, WALK], priors.plane[plane, WALK + 1]
            walked = _turned(walk_x, walk_y, swarm.heading, r)
        normal = part_at(priors.plane, plane, DIRECTION)
        off = vector_at(priors.plane, plane) - walked - vector_at(swarm.position, r)
        gap = normal.dot(off)
        precision = priors.plane[plane, PRECISION]
        known = square * precision
        torn = precision * gap * gap * priors.plane[plane, PLANE_ROBUST]  # Cauchy's loss
        stiff = known / (1.0 + known + torn)
        hold += with_torque(stiff * gap * normal, walked)
        stiffness += stiff * priors.plane[plane, CROWD] / 3.0
        inertia += 0.5 * stiff * walked.norm_sqr()  # no less than it is
    for c in ti.static(range(3)):
        swarm.force[r, c] = pull[c] + hold[c]
    before = swarm.mass[r]
    swarm.mass[r] = _mass_for(stiffness / _MOST_STIFFNESS, before, step.inertia_factor)
    slower = ti.sqrt(before / swarm.mass[r])
    for c in ti.static(range(3)):
        swarm.velocity[r, c] *= slower
    if ti.static(turning) and robots.weight[i, YAW_PRECISION] > 0.0:
        stiff = square * robots.weight[i, YAW_PRECISION]
        torque = pull[3] + hold[3] - stiff * swarm.heading[r, YAW]
        swarm.heading[r, TORQUE] = torque
        before = swarm.heading[r, INERTIA]
        needed = (inertia + stiff) / _MOST_TURN_STIFFNESS
        swarm.heading[r, INERTIA] = _mass_for(needed, before, step.inertia_factor)
        swarm.heading[r, SPIN] *= ti.sqrt(before / swarm.heading[r, INERTIA])
