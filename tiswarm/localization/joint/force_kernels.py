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
from tiswarm.compute.math_kernels import part_at, vector_at, with_torque
from tiswarm.localization.joint.arrays import (
    CROWD,
    DIRECTION,
    FORCE,
    INERTIA,
    LIGHTEST,
    MASS,
    NON_OVERLAP,
    PLANE,
    PLANE_END,
    PLANE_ROBUST,
    POINT,
    PRECISION,
    SPIN,
    STRUCTURE,
    TORQUE,
    VELOCITY,
    WALK,
    YAW,
    YAW_PRECISION,
)
from tiswarm.localization.joint.contact_kernels import TINY, pull_of_contacts, push_inside, turned
from tiswarm.measurements.model import SPACING

MOST_STIFFNESS = 1.2
"""Robots held more stiffly are given the mass to swing no faster: two that hold each other, each
moved by itself and one of them by its branch too, at 2.8 times the square of that frequency. At 4
times steps diverge."""
_MOST_TURN_STIFFNESS = 0.25
"""The same of turns; less, for a turn and a shift swing together."""
_FORGET = 0.99
"""What is kept of a mass no longer needed, in one step."""
_WHOLE = 2.0**44
"""Parts of one in which pushes are counted."""


@ti.func
def sigma_of(i, step: Ref, robots: Ref):
    """Read the square root of the temperature of robot i in a step [R]."""
    return step.schedule[robots.label[i, STRUCTURE], step.number]


@ti.func
def _is_there(robot, variant: Static, robots: Ref):
    """Whether a robot's docks are in the way of others: not if it has left."""
    there = 1
    if ti.static(variant.has_gone):
        there = robots.label[robot, NON_OVERLAP]
    return there == 1


@ti.func
def _push_of_overlaps(r, i, variant: Static, slope, robots: Ref, grid: Ref, rows: Ref, swarm: Ref):
    """Sum the forces of docks that are too near to copy r, with their stiffness and inertia.

    Integers make the sum independent of the order of a row.
    """
    docks = ti.static(variant.docks)
    here = vector_at(swarm.position, r)
    own = ti.Matrix([[swarm.arm[r, k, c] for c in range(3)] for k in range(docks)])
    units = ti.cast(with_torque(0.0 * here, here), ti.i64)
    inertia = ti.i64(0)
    overlaps = 0
    widest = 0.5 / slope  # D^2
    for e in range(rows.count[r]):
        other = rows.entry[rows.first[r] + e * grid.entry_stride] >> (grid.own_bits + 1)
        between = here - vector_at(swarm.position, other)
        is_near = between.norm_sqr() < grid.near * grid.near
        if is_near and _is_there(other - r + i, variant, robots):
            for m in range(docks):
                its = ti.Vector([swarm.arm[other, m, c] for c in range(3)])
                off = between - its
                for k in ti.static(range(docks)):
                    apart = off + own[k, :]
                    square_length = apart.norm_sqr()
                    if square_length < widest:
                        push = with_torque(push_inside(square_length, slope) * apart, own[k, :])
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
def _hold_of_planes(r, i, square, stiffness, inertia, variant: Static, measured: Ref, swarm: Ref):
    """Sum the forces and torques of the planes of copy r of robot i; add to stiffness and inertia.

    With gap g, precision p, w = sigma^2 + 1 / p and c^2 = 1 / `PLANE_ROBUST`, each has the energy
    of Cauchy's loss, sigma^2 c^2 / 2 log(1 + g^2 / (c^2 w)).
    """
    here = vector_at(swarm.position, r)
    plane = ti.static(measured.plane)
    hold = with_torque(0.0 * here, here)
    for p in range(measured.robots.label[i, PLANE], measured.robots.label[i, PLANE_END]):
        walked = 0.0 * here
        if ti.static(variant.turning):
            walked = turned(plane[p, WALK], plane[p, WALK + 1], swarm.heading, r)
        normal = part_at(plane, p, DIRECTION)
        gap = normal.dot(part_at(plane, p, POINT) - walked - here)
        # stiffness k, sigma^2 p / (1 + sigma^2 p + p g^2 / c^2)
        known = square * plane[p, PRECISION]
        torn = plane[p, PRECISION] * gap * gap * plane[p, PLANE_ROBUST]
        stiff = known / (1.0 + known + torn)
        # force along the normal, k g n
        hold += with_torque(stiff * gap * normal, walked)
        stiffness += stiff * plane[p, CROWD] / 3.0
        inertia += 0.5 * stiff * walked.norm_sqr()  # no less than it is
    return hold, stiffness, inertia


@ti.func
def pull_robot(r, variant: Static, step: Ref, measured: Ref, grid: Ref, rows: Ref, swarm: Ref):
    """Write the force on copy r and the mass that it needs, and both for its turn if it turns.

    A robot that becomes heavier keeps its kinetic energy, not its velocity.
    """
    robots = ti.static(measured.robots)
    motion, heading = ti.static(swarm.motion, swarm.heading)
    i = r % robots.label.shape[0]
    sigma = sigma_of(i, step, robots)
    square = sigma * sigma
    growth = step.schedule[step.schedule.shape[0] - 1, step.number]
    width = robots.label[i, NON_OVERLAP] * SPACING * growth
    slope = 0.5 / ti.max(width * width, TINY)
    pull, stiffness, inertia = pull_of_contacts(
        r, i, slope, square, variant, robots, measured.contacts, swarm
    )
    if robots.label[i, NON_OVERLAP] == 1:
        push, hardness, lag = _push_of_overlaps(r, i, variant, slope, robots, grid, rows, swarm)
        pull += push
        stiffness += hardness
        inertia += lag
    hold, stiffness, inertia = _hold_of_planes(
        r, i, square, stiffness, inertia, variant, measured, swarm
    )
    for c in ti.static(range(3)):
        motion[r, FORCE + c] = pull[c] + hold[c]
    # v <- v sqrt(m / m'), so that m v^2 is kept
    before, lightest = motion[r, MASS], robots.weight[i, LIGHTEST]
    motion[r, MASS] = _mass_for(stiffness / MOST_STIFFNESS, before, lightest)
    slower = ti.sqrt(before / motion[r, MASS])
    for c in ti.static(range(3)):
        motion[r, VELOCITY + c] *= slower
    if ti.static(variant.turning) and robots.weight[i, YAW_PRECISION] > 0.0:
        stiff = square * robots.weight[i, YAW_PRECISION]
        torque = pull[3] + hold[3] - stiff * heading[r, YAW]
        heading[r, TORQUE] = torque
        before = heading[r, INERTIA]
        heading[r, INERTIA] = _mass_for((inertia + stiff) / _MOST_TURN_STIFFNESS, before, lightest)
        heading[r, SPIN] *= ti.sqrt(before / heading[r, INERTIA])
