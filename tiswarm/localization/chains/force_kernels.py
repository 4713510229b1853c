"""Forces on a robot in a chain: of contacts, overlaps and measured coordinates. Lengths in R.

At the temperature T = sigma^2 a measurement of variance v has the stiffness sigma^2 / (sigma^2 +
v): a small v is tempered, a large one acts as it is. Docks nearer than D repel with the energy
(D^2 - d^2)^2 / (8 D^2). Near D that is a spring's, (D - d)^2 / 2; at d = 0 it is smooth, with a
curvature of at most 1 in every direction. A spring's force jumps there, and docks that pass through
each other gain energy at every pass. Forces are gathered in a fixed order.

An entry of the contacts measures a distance, or an offset with its direction; the docks of a touch
are those that are nearest to D apart at this step. Contacts at final stances have a prior, too,
that robots extend outward.

Where a log states a yaw bias, robots turn too: the correction of a robot is the angle by which all
its orientations, and so its docks and its walk, are turned about the vertical through its final
center.
"""

from tiswarm.compute.lang import Ref, Static, ti
from tiswarm.compute.math_kernels import part_at, vector_at, with_torque
from tiswarm.localization.chains.arrays import (
    BodyMotion,
    Heading,
    LinkLabel,
    LinkValue,
    OverlapSums,
    PlaneValue,
    RobotLabel,
    RobotWeight,
)
from tiswarm.measurements.model import SPACING

_OFFSET_STIFFNESS = 2.0
"""Stiffness that an offset counts for, in its own. Robots that offsets hold in all directions at
once swing against each other faster than those that distances hold; with 1, steps heat chains by a
tenth on training structures, with 2 by no more than without offsets."""
TINY = 1e-12
"""Lengths, and their squares, are no less than this where they divide [R]."""


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
    c = heading[r, Heading.COS]
    s = heading[r, Heading.SIN]
    return ti.Vector([c * x - s * y, s * x + c * y, 0.0])


@ti.func
def _pull_of_offset(
    r, partner, slot, apart, arm, turning: Static, square, robust, contacts: Ref, swarm: Ref
):
    """Compute the force of an offset on copy r of a robot, its torque, stiffness and inertia.

    The residual is a vector e, with variances v_k along the measured vector and across it. With
    w_k = sigma^2 + v_k and c^2 = 1 / `robust`, the energy is Cauchy's loss of the sum of squares,

        sigma^2 c^2 / 2 log(1 + sum_k e_k^2 / (c^2 w_k)).

    The measured vector, and with it the axes, turn with the robot that measured it: the force on
    that robot acts at the partner's dock.

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

    Returns:
        Force with its torque, stiffness and inertia.
    """
    vector = part_at(contacts.value, slot, LinkValue.VECTOR)
    lever = arm
    if ti.static(turning):
        owner = partner
        if contacts.label[slot, LinkLabel.IS_OWN] == 1:
            owner = r
            lever = arm - apart
        level = turned(vector[0], vector[1], swarm.heading, owner)
        vector[0] = level[0]
        vector[1] = level[1]
    # e = a + m, in two parts: (e m) m / m^2, and what is left
    residual = apart + vector
    along = residual.dot(vector) / vector.norm_sqr() * vector
    across = residual - along
    # stiffness along and across, sigma^2 / w_k
    stiff = square / (square + contacts.value[slot, LinkValue.VARIANCE])
    stiff_across = square / (square + contacts.value[slot, LinkValue.ACROSS])
    # F = -sum_k (sigma^2 / w_k) e_k / (1 + sum_k e_k^2 / (c^2 w_k))
    torn = stiff * along.norm_sqr() + stiff_across * across.norm_sqr()
    whole = 1.0 / (1.0 + robust * torn / square)
    force = -whole * (stiff * along + stiff_across * across)
    stiffest = _OFFSET_STIFFNESS * whole * ti.max(stiff, stiff_across)
    inertia = stiffest * (lever[0] * lever[0] + lever[1] * lever[1])
    return with_torque(force, lever), stiffest, inertia


@ti.func
def _nearest_docks(r, partner, slot, between, variant: Static, contacts: Ref, swarm: Ref):
    """Find which docks of copy r and its partner touch: those whose distance is nearest to D.

    Of equally near pairs the first is taken.

    Args:
        r: Copy of the robot.
        partner: Copy of its partner.
        slot: Entry of the touch.
        between: From the partner's center to the robot's [R].
        variant: What this is compiled for.
        contacts: Contacts.
        swarm: State of the copies.

    Returns:
        From the partner's dock to the robot's, and the horizontal arm of the robot's dock [R].
    """
    row = contacts.label[slot, LinkLabel.TOUCH]
    nearest = between
    arm = between
    least = 1.0 / TINY
    for k in range(variant.docks):
        own_arm = ti.Vector([contacts.candidates[row, k, c] for c in range(3)])
        if ti.static(variant.turning):
            level = turned(own_arm[0], own_arm[1], swarm.heading, r)
            own_arm[0] = level[0]
            own_arm[1] = level[1]
        for m in range(variant.docks):
            partner_arm = ti.Vector([contacts.candidates[row, m, 3 + c] for c in range(3)])
            if ti.static(variant.turning):
                level = turned(partner_arm[0], partner_arm[1], swarm.heading, partner)
                partner_arm[0] = level[0]
                partner_arm[1] = level[1]
            apart = between + own_arm - partner_arm
            off = ti.abs(apart.norm() - contacts.value[slot, LinkValue.LENGTH])
            if off < least:
                least = off
                nearest = apart
                arm = own_arm
    arm[2] = 0.0
    return nearest, arm


@ti.func
def _docks_of(r, partner, slot, between, turns, variant: Static, contacts: Ref, swarm: Ref):
    """Find the offset of the docks of an entry, and the robot's arm.

    Docks of a touch are unknown: `_nearest_docks` chooses them.

    Args:
        r: Copy of the robot.
        partner: Copy of its partner.
        slot: Entry.
        between: From the partner's center to the robot's [R].
        turns: Whether the robot turns.
        variant: What this is compiled for.
        contacts: Contacts.
        swarm: State of the copies.

    Returns:
        From the partner's dock to the robot's, and the horizontal arm of the robot's dock, 0 if it
        does not turn [R].
    """
    apart = between + part_at(contacts.value, slot, LinkValue.ARMS)
    arm = 0.0 * between
    if ti.static(variant.turning) and turns:
        x = contacts.value[slot, LinkValue.LEVERS]
        y = contacts.value[slot, LinkValue.LEVERS + 1]
        partner_x = contacts.value[slot, LinkValue.LEVERS + 2]
        partner_y = contacts.value[slot, LinkValue.LEVERS + 3]
        arm = turned(x, y, swarm.heading, r)
        partner_arm = turned(partner_x, partner_y, swarm.heading, partner)
        apart[0] += arm[0] - partner_arm[0] - x + partner_x
        apart[1] += arm[1] - partner_arm[1] - y + partner_y
    if ti.static(variant.has_touches):
        if contacts.label[slot, LinkLabel.TOUCH] >= 0:
            apart, arm = _nearest_docks(r, partner, slot, between, variant, contacts, swarm)
    return apart, arm


@ti.func
def _pull_of_distance(slot, length, square, robust, contacts: Ref):
    """Compute how a measured distance pulls docks that are so far apart.

    With residual e, w = sigma^2 + v and c^2 = 1 / `robust`, it has the energy of Cauchy's loss,

        sigma^2 c^2 / 2 log(1 + e^2 / (c^2 w)), or sigma^2 e^2 / (2 w) where `robust` is 0.

    Where docks are nearer than D, the force has the factor by which the push of overlaps is less
    than a spring's. The logarithm still holds a robot whose contacts are all outliers.

    Returns:
        Stiffness; pull for a stiffness of 1, as a part of the offset of the docks; the share of a
        force that acts although the distance gives way, w / (w + e^2 / c^2); and 1 / `length`.
    """
    measured = contacts.value[slot, LinkValue.LENGTH]
    residual = length - measured
    width = square + contacts.value[slot, LinkValue.VARIANCE]
    # w + e^2 / c^2, with w = sigma^2 + v
    within = width + residual * residual * robust
    inverse = 1.0 / (within * length)  # one division for three
    # stiffness k, sigma^2 / (w + e^2 / c^2)
    stiff = square * length * inverse
    inside = push_inside(length * length, 0.5 / ti.max(measured * measured, TINY))
    # pull, e / d, or that of an overlap
    pull = ti.select(residual < 0.0, -inside, residual * within * inverse)
    return stiff, pull, width * length * inverse, within * inverse


@ti.func
def _push_of_extension(between, apart, arm, length, inverse, pushed):
    """Compute the force that parts robots in contact at the end, with its torque.

    Robots extend outward: the farther apart their centers would be if their docks just touched, the
    likelier. This prior has the energy -sigma^2 `extension` times that distance, which only the
    direction between the docks decides. The push is perpendicular to the contact: along it, it
    would lengthen uncertain contacts. Where a contact gives way, so does the push.

    Args:
        between: From the partner's center to the robot's [R].
        apart: From the partner's dock to the robot's [R].
        arm: Horizontal arm of the robot's dock [R].
        length: Distance of the docks [R].
        inverse: 1 / `length` [R^-1].
        pushed: Size of the push, sigma^2 `extension` as far as the contact holds [R].
    """
    # h = b + l a, l = D / d - 1: from center to center if the docks just touched
    lacking = SPACING * inverse - 1.0
    # Its square needs no component of it, which would wait for 1 / d.
    along = between.dot(apart)
    square = between.norm_sqr() + lacking * (2.0 * along + lacking * length * length)
    size = pushed / ti.sqrt(ti.max(square, 1.0))
    # F = p - (p a) a / a^2, perpendicular to the contact, with p along h; so is b for h
    across = size * ti.min(SPACING * inverse, 1.0) * (between - along * inverse * inverse * apart)
    # The turn of an arm turns `apart`, and would move h were it not for the contact.
    push = with_torque(across - size * (between + lacking * apart), arm)
    return ti.Vector([across[0], across[1], across[2], push[3]])


@ti.func
def pull_of_contacts(r, i, slope, square, variant: Static, robots: Ref, contacts: Ref, swarm: Ref):
    """Sum the forces of the contacts of copy r of robot i, their torque, stiffness and inertia.

    Docks in contact at the end do not repel each other as all others do: this function subtracts
    the push that `push_docks` gives them.

    Args:
        r: Copy of the robot.
        i: The robot.
        slope: 1 / (2 D^2) of overlaps [R^-2].
        square: Temperature sigma^2 [R^2].
        variant: What this is compiled for.
        robots: Robots.
        contacts: Contacts.
        swarm: State of the copies.
    """
    base = r - i
    turns = robots.weight[i, RobotWeight.YAW_PRECISION] > 0.0
    robust = robots.weight[i, RobotWeight.ROBUST]
    center = vector_at(swarm.position, r)
    force = with_torque(0.0 * center, center)
    stiffness = 0.0 * center[0]
    inertia = stiffness
    for slot in range(robots.label[i, RobotLabel.CONTACT], robots.label[i, RobotLabel.CONTACT_END]):
        partner = base + contacts.label[slot, LinkLabel.PARTNER]
        between = center - vector_at(swarm.position, partner)
        apart, arm = _docks_of(r, partner, slot, between, turns, variant, contacts, swarm)
        length = ti.max(apart.norm(), TINY)
        stiff, pull, trust, inverse = _pull_of_distance(slot, length, square, robust, contacts)
        overlap = contacts.label[slot, LinkLabel.IS_FINAL] * push_inside(length * length, slope)
        if ti.static(variant.has_offsets):
            if contacts.value[slot, LinkValue.ACROSS] > 0.0:
                held, stiff, lag = _pull_of_offset(
                    r, partner, slot, apart, arm, variant.turning, square, robust, contacts, swarm
                )
                force += held
                inertia += lag
                pull = 0.0
        force -= with_torque((stiff * pull + overlap) * apart, arm)
        if contacts.label[slot, LinkLabel.IS_FINAL] == 1:
            pushed = trust * square * contacts.value[slot, LinkValue.EXTENSION]
            force += _push_of_extension(between, apart, arm, length, inverse, pushed)
        stiff -= ti.select(overlap > 0.0, 1.0, 0.0)
        stiffness += stiff
        inertia += stiff * arm.norm_sqr()
    return force, stiffness, inertia


MOST_STIFFNESS = 1.2
"""Robots held more stiffly are given the mass to swing no faster: two that hold each other, each
moved by itself and one of them by its branch too, at 2.8 times the square of that frequency. At 4
times steps diverge, and from 3 on, a third of a turn a step, docks that pass through each other
gain energy at every pass."""
_MOST_TURN_STIFFNESS = 0.25
"""Robots whose turns are held more stiffly are given the inertia to swing no faster. It is less
than for shifts: a turn and a shift swing together."""
_FORGET = 0.99
"""What is kept of a mass no longer needed, in one step."""
_WHOLE = 2.0**44
"""Parts of one in which pushes are counted."""


@ti.func
def sigma_of(i, step: Ref, robots: Ref):
    """Read the square root of the temperature of robot i in a step [R]."""
    return step.schedule[robots.label[i, RobotLabel.STRUCTURE], step.number]


@ti.func
def _slope_of(i, step: Ref, robots: Ref):
    """Compute how the push of overlaps of robot i falls in a step, 1 / (2 D^2) [R^-2]."""
    growth = step.schedule[step.schedule.shape[0] - 1, step.number]
    width = robots.label[i, RobotLabel.NON_OVERLAP] * SPACING * growth
    return 0.5 / ti.max(width * width, TINY)


@ti.func
def _is_there(robot, variant: Static, robots: Ref):
    """Whether a robot's docks are in the way of others: not if it has left."""
    is_present = 1
    if ti.static(variant.has_gone):
        is_present = robots.label[robot, RobotLabel.NON_OVERLAP]
    return is_present == 1


@ti.func
def _push_of_pair(between, arms, partner, slope, variant: Static, swarm: Ref):
    """Sum the forces between the docks of a robot and of another one that are too near.

    Integers make sums of pairs independent of their order. Seen from the other robot, `between` and
    all forces have the opposite sign and the same bits. `arms` are the arms of the first one's
    docks, `slope` is 1 / (2 D^2).

    Returns:
        Columns of `OverlapSums` of the first robot, then torque and inertia of the other one.
    """
    docks = ti.static(variant.docks)
    sums = ti.Vector([ti.i64(0) for _ in range(OverlapSums.TOTAL + 2)])
    widest = 0.5 / slope  # D^2
    for m in range(docks):
        partner_arm = ti.Vector([swarm.arm[partner, m, c] for c in range(3)])
        is_close = False
        for k in ti.static(range(docks)):
            is_close |= (between + (arms[k, :] - partner_arm)).norm_sqr() < widest
        if is_close:
            for k in ti.static(range(docks)):
                apart = between + (arms[k, :] - partner_arm)
                square_length = apart.norm_sqr()
                if square_length < widest:
                    push = push_inside(square_length, slope) * apart
                    acting = with_torque(push, arms[k, :])
                    opposite = with_torque(-push, partner_arm)
                    for c in ti.static(range(4)):
                        sums[c] += ti.cast(acting[c] * _WHOLE, ti.i64)
                    lag = arms[k, 0] ** 2 + arms[k, 1] ** 2
                    partner_lag = partner_arm[0] ** 2 + partner_arm[1] ** 2
                    sums[OverlapSums.INERTIA] += ti.cast(lag * _WHOLE, ti.i64)
                    sums[OverlapSums.COUNT] += 1
                    sums[OverlapSums.TOTAL] += ti.cast(opposite[3] * _WHOLE, ti.i64)
                    sums[OverlapSums.TOTAL + 1] += ti.cast(partner_lag * _WHOLE, ti.i64)
    return sums


@ti.func
def push_docks(r, variant: Static, step: Ref, robots: Ref, grid: Ref, rows: Ref, swarm: Ref):
    """Sum the forces between docks of copy r and others that are too near.

    Where one thread moves a block, rows list later copies only, and sums are added to both copies.
    """
    overlap, docks = ti.static(swarm.overlap, variant.docks)
    i = r % robots.label.shape[0]
    total = ti.Vector([ti.i64(0) for _ in range(OverlapSums.TOTAL)])
    if robots.label[i, RobotLabel.NON_OVERLAP] == 1:
        center = vector_at(swarm.position, r)
        slope = _slope_of(i, step, robots)
        arms = ti.Matrix([[swarm.arm[r, k, c] for c in range(3)] for k in range(docks)])
        for e in range(rows.count[r]):
            partner = rows.entry[rows.first[r] + e * grid.entry_stride] >> (grid.own_bits + 1)
            between = center - vector_at(swarm.position, partner)
            is_near = between.norm_sqr() < grid.near * grid.near
            if is_near and _is_there(partner - r + i, variant, robots):
                sums = _push_of_pair(between, arms, partner, slope, variant, swarm)
                for c in ti.static(range(OverlapSums.TOTAL)):
                    total[c] += sums[c]
                if ti.static(variant.by_block):
                    if sums[OverlapSums.COUNT] > 0:
                        opposite = [-sums[0], -sums[1], -sums[2], sums[6], sums[7], sums[5]]
                        for c in ti.static(range(OverlapSums.TOTAL)):
                            overlap[partner, c] = overlap[partner, c] + opposite[c]
    for c in ti.static(range(OverlapSums.TOTAL)):
        # No `+=`: it would be atomic.
        overlap[r, c] = total[c] + (overlap[r, c] if ti.static(variant.by_block) else 0)


@ti.func
def _mass_for(needed, before, factor):
    """Mass that a stiffness needs, at least 1, times a factor; one that is too great shrinks."""
    return ti.max(factor * ti.max(1.0, needed), _FORGET * before + (1.0 - _FORGET) * factor)


@ti.func
def _hold_of_planes(r, i, square, stiffness, inertia, variant: Static, measured: Ref, swarm: Ref):
    """Sum the forces and torques of the planes of copy r of robot i; add to stiffness and inertia.

    With gap g, precision p, w = sigma^2 + 1 / p and c^2 = 1 / `PlaneValue.ROBUST`, each has the
    energy of Cauchy's loss, sigma^2 c^2 / 2 log(1 + g^2 / (c^2 w)).
    """
    center = vector_at(swarm.position, r)
    plane = ti.static(measured.plane)
    hold = with_torque(0.0 * center, center)
    for p in range(
        measured.robots.label[i, RobotLabel.PLANE], measured.robots.label[i, RobotLabel.PLANE_END]
    ):
        walked = 0.0 * center
        if ti.static(variant.turning):
            walked = turned(
                plane[p, PlaneValue.WALK], plane[p, PlaneValue.WALK + 1], swarm.heading, r
            )
        normal = part_at(plane, p, PlaneValue.DIRECTION)
        gap = normal.dot(part_at(plane, p, PlaneValue.POINT) - walked - center)
        # stiffness k, sigma^2 p / (1 + sigma^2 p + p g^2 / c^2)
        information = square * plane[p, PlaneValue.PRECISION]
        torn = plane[p, PlaneValue.PRECISION] * gap * gap * plane[p, PlaneValue.ROBUST]
        stiff = information / (1.0 + information + torn)
        # force along the normal, k g n
        hold += with_torque(stiff * gap * normal, walked)
        stiffness += stiff * plane[p, PlaneValue.CROWD] / 3.0
        inertia += 0.5 * stiff * walked.norm_sqr()  # no less than it is
    return hold, stiffness, inertia


@ti.func
def pull_robot(r, variant: Static, step: Ref, measured: Ref, swarm: Ref):
    """Write the force on copy r and the mass that it needs, and both for its turn if it turns.

    A robot that becomes heavier keeps its kinetic energy, not its velocity. One that neither moves
    nor turns is left as it is.
    """
    i = r % measured.robots.label.shape[0]
    goes = measured.robots.label[i, RobotLabel.MOVES] == 1
    if ti.static(variant.turning):
        goes = True  # anchors turn, too
    if goes:
        _pull_robot(r, i, variant, step, measured, swarm)


@ti.func
def _pull_robot(r, i, variant: Static, step: Ref, measured: Ref, swarm: Ref):
    """Do what `pull_robot` does for copy r of robot i."""
    robots = ti.static(measured.robots)
    motion, heading = ti.static(swarm.motion, swarm.heading)
    sigma = sigma_of(i, step, robots)
    square = sigma * sigma
    slope = _slope_of(i, step, robots)
    pull, stiffness, inertia = pull_of_contacts(
        r, i, slope, square, variant, robots, measured.contacts, swarm
    )
    if robots.label[i, RobotLabel.NON_OVERLAP] == 1:
        for c in ti.static(range(4)):
            pull[c] += ti.cast(swarm.overlap[r, c], float) / _WHOLE
        inertia += ti.cast(swarm.overlap[r, OverlapSums.INERTIA], float) / _WHOLE
        stiffness += ti.cast(swarm.overlap[r, OverlapSums.COUNT], float)
    hold, stiffness, inertia = _hold_of_planes(
        r, i, square, stiffness, inertia, variant, measured, swarm
    )
    for c in ti.static(range(3)):
        motion[r, BodyMotion.FORCE + c] = pull[c] + hold[c]
    # v <- v sqrt(m / m'), so that m v^2 is kept
    before = motion[r, BodyMotion.MASS]
    lightest = robots.weight[i, RobotWeight.LIGHTEST]
    motion[r, BodyMotion.MASS] = _mass_for(stiffness / MOST_STIFFNESS, before, lightest)
    slower = ti.sqrt(before / motion[r, BodyMotion.MASS])
    for c in ti.static(range(3)):
        motion[r, BodyMotion.VELOCITY + c] = slower * motion[r, BodyMotion.VELOCITY + c]
    if ti.static(variant.turning) and robots.weight[i, RobotWeight.YAW_PRECISION] > 0.0:
        stiff = square * robots.weight[i, RobotWeight.YAW_PRECISION]
        torque = pull[3] + hold[3] - stiff * heading[r, Heading.YAW]
        heading[r, Heading.TORQUE] = torque
        before = heading[r, Heading.INERTIA]
        heading[r, Heading.INERTIA] = _mass_for(
            (inertia + stiff) / _MOST_TURN_STIFFNESS, before, lightest
        )
        heading[r, Heading.SPIN] = heading[r, Heading.SPIN] * ti.sqrt(
            before / heading[r, Heading.INERTIA]
        )
