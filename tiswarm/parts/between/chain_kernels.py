"""Chains of annealing whose robots each move by their own forces. Lengths in R.

A chain has a view: where it takes each robot to be. At the temperature sigma^2 a row of variance
v has the stiffness sigma^2 / (sigma^2 + v + e^2 / 9), so that a row missed by far gives way, and
docks that do not touch repel with stiffness 1. Motions are Langevin dynamics: a robot keeps a part
of its velocity, and kicks keep it at the temperature.
"""

from typing import NamedTuple

from tiswarm.compute.lang import GRAIN, I32, Ints1, Ints2, Reals1, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import kick_of, vector_at
from tiswarm.localization.chains.force_kernels import MOST_STIFFNESS
from tiswarm.localization.chains.kernels import MEMORY
from tiswarm.measurements.model import SPACING

_TINY = 1e-9
"""Least distance of docks that a force has a direction for [R]."""

_ROBUST = 1.0 / 9.0
"""One over the squared width of the robust loss [1]."""


class ChainRows(NamedTuple):
    """E rows of K robots; a row of two robots is listed by each of them."""

    start: Ints1
    """First row of each robot, shape (K + 1,)."""

    partner: Ints1
    """The other robot, -1 if there is none, shape (E,)."""

    arm: Reals2
    """What is added to the robot's center less the partner's [R], shape (E, 3)."""

    axis: Reals2
    """Unit vector along which a coordinate is measured; 0 for a distance, shape (E, 3)."""

    value: Reals2
    """Measured distance or coordinate [R], variance [R^2], and gain by extension [R^-1], (E, 3)."""


class ChainDocks(NamedTuple):
    """Docks of K robots, and which of them touch."""

    offset: Reals3
    """Center to dock [R], shape (K, docks, 3)."""

    start: Ints1
    """First contact of each robot, shape (K + 1,)."""

    contact: Ints2
    """Own dock, other robot and its dock, shape (C, 3)."""


@ti.func
def _seen(view: Ref, v, j):
    return ti.Vector([view[v, j, 0], view[v, j, 1], view[v, j, 2]])


@ti.func
def _touches(docks: Ref, i, k, j, m):
    """Judge whether dock k of robot i touches dock m of robot j."""
    found = False
    for c in range(docks.start[i], docks.start[i + 1]):
        row = docks.contact[c, 0] == k and docks.contact[c, 1] == j
        found = found or (row and docks.contact[c, 2] == m)
    return found


@ti.func
def _pull_of_rows(v, i, here, square, rows: Ref, view: Ref):
    """Sum the forces of the rows of robot i, and their stiffness."""
    force = 0.0 * here
    stiffness = 0.0 * here[0]
    for e in range(rows.start[i], rows.start[i + 1]):
        apart = here + vector_at(rows.arm, e)
        between = 0.0 * here
        partner = rows.partner[e]
        if partner >= 0:
            between = here - _seen(view, v, partner)
            apart = between + vector_at(rows.arm, e)
        way = vector_at(rows.axis, e)
        length = way.dot(apart)
        if way.norm_sqr() == 0.0:
            length = ti.max(apart.norm(), _TINY)
            way = apart / length
        missed = length - rows.value[e, 0]
        stiff = square / (square + rows.value[e, 1] + _ROBUST * missed * missed)
        force -= stiff * missed * way
        # Where a row gives way, so does the push outward.
        push = stiff * square * rows.value[e, 2]
        force += push * between / ti.max(between.norm(), 1.0)
        stiffness += stiff
    return force, stiffness


@ti.func
def _push_of_docks(v, i, here, robots, reach, docks: Ref, view: Ref):
    """Sum the forces of docks that overlap but do not touch, and their stiffness."""
    force = 0.0 * here
    stiffness = 0.0 * here[0]
    for j in range(robots):
        between = here - _seen(view, v, j)
        if j != i and between.norm_sqr() < reach * reach:
            for k in range(docks.offset.shape[1]):
                for m in range(docks.offset.shape[1]):
                    apart = between
                    for c in ti.static(range(3)):
                        apart[c] += docks.offset[i, k, c] - docks.offset[j, m, c]
                    square = apart.norm_sqr()
                    if square < SPACING * SPACING and not _touches(docks, i, k, j, m):
                        # the energy (D^2 - d^2)^2 / (8 D^2)
                        force += 0.5 * (1.0 - square / (SPACING * SPACING)) * apart
                        stiffness += 1.0
    return force, stiffness


@ti.func
def _force_on(v, i, here, robots, reach, square, rows: Ref, docks: Ref, view: Ref):
    """Compute the force on robot i in view v, and the mass that it needs."""
    pull, held = _pull_of_rows(v, i, here, square, rows, view)
    push, pressed = _push_of_docks(v, i, here, robots, reach, docks, view)
    return pull + push, ti.max(1.0, (held + pressed) / MOST_STIFFNESS)


@ti.func
def _moved(sigma, force, mass, kick, speed):
    """Change a velocity; return it, and how far it leads in a step."""
    fast = speed + force / mass
    slow = MEMORY * fast + sigma * ti.sqrt((1.0 - MEMORY * MEMORY) / mass) * kick
    return slow, 0.5 * (fast + slow)


@ti.kernel
def anneal_near(
    seed: I32, reach: ti.f64, schedule: Reals1, moves: Ints1,
    start: Ints1, partner: Ints1, arm: Reals2, axis: Reals2, value: Reals2,  # ChainRows
    offset: Reals3, touch_start: Ints1, contact: Ints2,  # ChainDocks
    view_out: Reals3, speed_out: Reals3, step_out: Reals3,
):  # fmt: skip
    """Let one robot anneal those near it in several chains, each with a view of its own.

    Args:
        seed: Seed of the kicks.
        reach: Distance of centers below which docks may overlap [R].
        schedule: sigma at each step [R].
        moves: Whether each robot moves, shape (K,).
        view_out: Where robots begin, and end, in each chain [R], shape (chains, K, 3).
        speed_out: Velocities, 0, shape (chains, K, 3).
        step_out: Room for a step, shape (chains, K, 3).
    """
    rows = ti.static(ChainRows(start, partner, arm, axis, value))
    docks = ti.static(ChainDocks(offset, touch_start, contact))
    for c, idle in ti.ndrange(view_out.shape[0], GRAIN):
        if idle == 0:
            for t in range(schedule.shape[0]):
                sigma = schedule[t]
                for i in range(moves.shape[0]):
                    if moves[i] == 1:
                        here = _seen(view_out, c, i)
                        force, mass = _force_on(
                            c, i, here, moves.shape[0], reach, sigma * sigma, rows, docks, view_out
                        )
                        kick = kick_of(seed, c, i, t)
                        speed = _seen(speed_out, c, i)
                        slow, way = _moved(sigma, force, mass, kick, speed)
                        for a in ti.static(range(3)):
                            speed_out[c, i, a] = slow[a]
                            step_out[c, i, a] = way[a]
                # All move at once: the next step sees where each went.
                for i in range(moves.shape[0]):
                    if moves[i] == 1:
                        for a in ti.static(range(3)):
                            view_out[c, i, a] += step_out[c, i, a]
