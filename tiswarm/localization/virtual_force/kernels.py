"""Algorithm 1 as one launch, with or without back-propagation, and the arrays that it reads.

Structures are independent and run in parallel; within one, robots follow each other in join order.
Forces are gathered, never scattered, so runs repeat bit for bit. Lengths in R.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from tiswarm.compute.lang import GRAIN, I32, Ints1, Ints2, Reals1, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import vector_at, vector_in
from tiswarm.compute.neighbor_kernels import CellList, cube_of, first_item, link, relink
from tiswarm.engine.kernels import capped, dock_pair_force, parting

NO_DOCKS = 0
DOCKS_OF_NEIGHBORS = 1
ALL_DOCKS = 2
"""Docks that repel each other where they overlap without being connected."""


class VirtualForceGains(NamedTuple):
    """Columns of the kernel's `gains`; see `VirtualForceParams`."""

    attraction_gain: float
    """A of Eq. (1) [1]."""

    repulsion_gain: float
    """B of Eqs. (1) and (2) [R^-3]."""

    height_gain: float
    """k_z of Eq. (3) [1]."""

    initial_offset: float
    """Distance of a robot from the mean of its earlier neighbors at first [R]."""

    max_step: float
    """Longest step of a robot [R]."""

    sweep_gain: float
    """Share of a step that a robot takes in back-propagation [1]."""

    sweep_repulsion: float
    """Share of repulsion with which back-propagation begins [1]."""

    spacing: float
    """D: distance between the centers of two docks that touch [R]."""

    undocked: float
    """NO_DOCKS, DOCKS_OF_NEIGHBORS or ALL_DOCKS."""

    height_last: float
    """1 where Eq. (3) is a step of its own, after that of the docks."""

    stop_error: float
    """Misfit of a robot below which it stops [R]."""


class LogArrays(NamedTuple):
    """Logs of N robots of all structures, end to end."""

    contact_start: Ints1
    """First contact row of each robot, shape (N + 1,)."""

    contact: Ints2
    """Rows of (own dock, other robot within the structure, its dock), shape (2 C, 3)."""

    initial_direction: Reals2
    """Unit vector of the initial offset, shape (N, 3)."""

    height: Reals1
    """Measured height of each center [R], NaN where unknown, shape (N,)."""

    is_planar: Ints1
    """Whether each robot stays at the anchor's y, shape (N,)."""

    is_gone: Ints1
    """Whether each robot has left, so that its docks are in nobody's way, shape (N,)."""

    is_anchor: Ints1
    """Whether the position of each robot is known, so that it stays there, shape (N,)."""


class PlacedRobots(NamedTuple):
    """Estimated positions of N robots."""

    dock_offset: Reals3
    """Center to dock, world frame [R], shape (N, docks, 3)."""

    position: Reals2
    """Centers [R], shape (N, 3); those of anchors and of robots placed before are read."""


class Trace(NamedTuple):
    """Recorded frames, F in all."""

    position: Reals3
    """Centers at each frame [R], shape (F, N, 3)."""

    step_length: Reals2
    """Last step before each frame [R], shape (F, N)."""

    steps: Ints1
    """Steps of each robot before the next one joined and in rounds, shape (N,)."""

    @classmethod
    def allocate(cls, frames: int, robots: int, dtype: DTypeLike) -> "Trace":
        """Reserve a trace of so many frames and robots."""
        return cls(
            np.empty((frames, robots, 3), dtype),
            np.empty((frames, robots), dtype),
            np.empty(robots, np.int32),
        )


@ti.func
def _gains_of(gains: Ref, structure):
    """Read the gains of a structure, columns in the order of `VirtualForceGains`."""
    return ti.Struct(
        {name: gains[structure, c] for c, name in ti.static(enumerate(VirtualForceGains._fields))}
    )


@ti.func
def _dock_at(robots: Ref, robot, k):
    """Compute where dock `k` of a robot is estimated to be."""
    return vector_at(robots.position, robot) + vector_in(robots.dock_offset, robot, k)


@ti.func
def _connected_force(
    gains: Ref, robot, base, placed, ramp, attract_inward, measured: Ref, robots: Ref
):
    """Sum Eq. (1) over the robot's contacts with the first `placed` robots.

    Where `attract_inward` is 1, attraction also parts docks nearer than D.
    """
    force = 0.0 * vector_at(robots.position, robot)
    for row in range(measured.contact_start[robot], measured.contact_start[robot + 1]):
        partner = measured.contact[row, 1]
        if partner < placed:
            dock = _dock_at(robots, robot, measured.contact[row, 0])
            partner_dock = _dock_at(robots, base + partner, measured.contact[row, 2])
            offset = partner_dock - dock
            pull = dock_pair_force(
                offset, gains.attraction_gain, gains.repulsion_gain, gains.spacing, ramp
            )
            stiffness = gains.attraction_gain * ramp
            pull += attract_inward * parting(offset, stiffness, gains.spacing)
            force += pull
    return force


@ti.func
def _undocked_force(
    gains: Ref, robot, base, structure, ramp, measured: Ref, robots: Ref, cells: Ref
):
    """Sum Eq. (2) over listed docks closer than D, but not connected, to the robot's.

    The paper prints the force with a unit vector from the other dock to the robot's own and
    a minus sign, which would pull them together; here it pushes them apart, as the text says.
    """
    docks = robots.dock_offset.shape[1]
    first = measured.contact_start[robot]
    last = measured.contact_start[robot + 1]
    force = 0.0 * vector_at(robots.position, robot)
    for k in range(docks):
        dock = _dock_at(robots, robot, k)
        cube = cube_of(dock, 1.0 / gains.spacing)
        for which in range(27):
            item = first_item(cells, structure, cube, which)
            while item >= 0:
                neighbor = item // docks
                offset = _dock_at(robots, base + neighbor, item % docks) - dock
                if offset.norm_sqr() < gains.spacing * gains.spacing and neighbor != robot - base:
                    repels = gains.undocked == ALL_DOCKS
                    connected = False
                    for row in range(first, last):
                        if measured.contact[row, 1] == neighbor:
                            repels = True
                            pair = measured.contact[row, 0] == k
                            connected |= pair and measured.contact[row, 2] == item % docks
                    if repels and not connected:
                        push = dock_pair_force(
                            offset, 0.0, gains.repulsion_gain, gains.spacing, ramp
                        )
                        force += push
                item = cells.following[structure, item]
    return force


@ti.func
def _virtual_force(
    gains: Ref, robot, base, structure, placed, ramp, attract_inward, measured: Ref, robots: Ref,
    cells: Ref,
):  # fmt: skip
    """Sum Eqs. (1) to (3) on a robot, from the first `placed` robots of its structure."""
    force = _connected_force(gains, robot, base, placed, ramp, attract_inward, measured, robots)
    if gains.undocked != NO_DOCKS and measured.is_gone[robot] == 0:
        force += _undocked_force(gains, robot, base, structure, ramp, measured, robots, cells)
    if gains.height_last == 0.0:
        force[2] += gains.height_gain * _height_missing(measured, robot, robots.position[robot, 2])
    if measured.is_planar[robot]:
        force[1] = 0.0
    return force


@ti.func
def _height_missing(measured: Ref, robot, z):
    """Compute how far below its measured height a robot is at `z`; 0 where that is unknown."""
    missing = measured.height[robot] - z
    return ti.select(ti.math.isnan(missing), 0.0, missing)


@ti.func
def _misfit(gains: Ref, robot, base, measured: Ref, robots: Ref):
    """Root mean square of what a robot misses: D by its contacts with earlier ones, its height.

    Infinite where it measures neither.
    """
    total = 0.0 * robots.position[robot, 2]
    count = 0
    for row in range(measured.contact_start[robot], measured.contact_start[robot + 1]):
        partner = measured.contact[row, 1]
        if partner < robot - base:
            dock = _dock_at(robots, robot, measured.contact[row, 0])
            partner_dock = _dock_at(robots, base + partner, measured.contact[row, 2])
            total += ((partner_dock - dock).norm() - gains.spacing) ** 2
            count += 1
    if not ti.math.isnan(measured.height[robot]):
        total += _height_missing(measured, robot, robots.position[robot, 2]) ** 2
        count += 1
    return ti.select(count > 0, ti.sqrt(total / ti.max(count, 1)), ti.math.inf)


@ti.func
def _initial_position(gains: Ref, robot, base, measured: Ref, robots: Ref):
    """Average the earlier neighbors, each counted once, and add the offset of Algorithm 1.

    A robot that touches no earlier one starts from the first anchor instead.
    """
    total = 0.0 * vector_at(robots.position, base)
    count = 0
    first = measured.contact_start[robot]
    for row in range(first, measured.contact_start[robot + 1]):
        partner = measured.contact[row, 1]
        counted = partner >= robot - base
        for earlier in range(first, row):
            counted = counted or measured.contact[earlier, 1] == partner
        if not counted:
            total += vector_at(robots.position, base + partner)
            count += 1
    if count == 0:
        total = vector_at(robots.position, base)
        count = 1
    offset = vector_at(measured.initial_direction, robot)
    place = total / count + gains.initial_offset * offset
    if measured.is_planar[robot]:
        place[1] = robots.position[base, 1]
    return place


@ti.func
def _write_position(robots: Ref, robot, place):
    for c in ti.static(range(3)):
        robots.position[robot, c] = place[c]


@ti.func
def _record(trace: Ref, frame, robot, place, moved):
    """Write a robot's estimated center in a frame, and the length of its last step."""
    for c in ti.static(range(3)):
        trace.position[frame, robot, c] = place[c]
    trace.step_length[frame, robot] = moved


@ti.func
def _step_of(gains: Ref, robot, force, share, measured: Ref, robots: Ref):
    """Step by a share of a force, no farther than the longest step; then lift, if that is last."""
    step = capped(share * force, gains.max_step)
    if gains.height_last == 1.0:
        missing = _height_missing(measured, robot, robots.position[robot, 2] + step[2])
        step[2] += share * gains.height_gain * missing
    return step


@ti.func
def _docks_in_cells(robot, measured: Ref, robots: Ref):
    """Count the docks of a robot that are in the cell list: none of a robot that has left."""
    return (1 - measured.is_gone[robot]) * robots.dock_offset.shape[1]


@ti.func
def _move(gains: Ref, robot, base, structure, step, measured: Ref, robots: Ref, cells: Ref):
    """Let a robot that has been placed take a step, its docks in the cell list with it."""
    docks = robots.dock_offset.shape[1]
    # As rounded, so that docks are found again.
    center = vector_at(robots.position, robot) + step
    for k in range(_docks_in_cells(robot, measured, robots)):
        item = (robot - base) * docks + k
        old = cube_of(_dock_at(robots, robot, k), 1.0 / gains.spacing)
        new = cube_of(center + vector_in(robots.dock_offset, robot, k), 1.0 / gains.spacing)
        relink(cells, structure, item, old, new)
    _write_position(robots, robot, center)


@ti.kernel
def localize_in_join_order(
    iterations: I32, sweep_every: I32, sweeps: I32, recent: I32, trace_every: I32,
    gains_table: Reals2, start: Ints1, placed_before: Ints1,
    # LogArrays
    contact_start: Ints1, contact: Ints2, initial_direction: Reals2, height: Reals1,
    is_planar: Ints1, is_gone: Ints1, is_anchor: Ints1,
    head_out: Ints2, following_out: Ints2,  # CellList of the robots placed before
    dock_offset: Reals3, position_out: Reals2,  # PlacedRobots
    trace_position_out: Reals3, step_length_out: Reals2, steps_out: Ints1,  # Trace
):  # fmt: skip
    """Place each robot by its contacts with those that joined before it, Algorithm 1.

    In back-propagation, robots that have been placed step one after the other, in join
    order, each by its contacts with all others; the next one sees where it went. Attraction then
    also parts docks: at the end of its ramp Eq. (1) alone would let them stay too near.

    Args:
        iterations: T, refinement steps of each robot.
        sweep_every: Joins between two rounds of back-propagation; the last join has one too.
        sweeps: Steps of every robot in a round, 0 without back-propagation.
        recent: Robots that a round moves, those that joined last.
        trace_every: Steps between recorded frames: those of T from the start on, then those of
            the last round.
        gains_table: One row a structure, columns as in `VirtualForceGains`, shape (S, 11).
        start: First robot of each structure, shape (S + 1,).
        placed_before: Robots of each structure that have been placed already, shape (S,).
    """
    measured = ti.static(
        LogArrays(contact_start, contact, initial_direction, height, is_planar, is_gone, is_anchor)
    )
    cells = ti.static(CellList(head_out, following_out))
    robots = ti.static(PlacedRobots(dock_offset, position_out))
    trace = ti.static(Trace(trace_position_out, step_length_out, steps_out))
    for s, idle in ti.ndrange(start.shape[0] - 1, GRAIN):
        if idle == 0:
            gains = _gains_of(gains_table, s)
            base = start[s]
            for robot in range(base + placed_before[s], start[s + 1]):
                center = vector_at(position_out, robot)
                if is_anchor[robot] == 0:
                    center = _initial_position(gains, robot, base, measured, robots)
                moved = 0.0
                frame = 0
                taken = 0
                is_moving = is_anchor[robot] == 0
                for t in range(iterations + 1):
                    _write_position(robots, robot, center)
                    if t % trace_every == 0 or t == iterations:
                        _record(trace, frame, robot, center, moved)
                        frame += 1
                    if gains.stop_error > 0.0 and is_moving and taken > 0:
                        misfit = _misfit(gains, robot, base, measured, robots)
                        is_moving = misfit >= gains.stop_error
                    moved = 0.0
                    if is_moving and t < iterations:
                        taken += 1
                        force = _virtual_force(
                            gains, robot, base, s, robot - base, (t + 1.0) / iterations, 0.0,
                            measured, robots, cells,
                        )  # fmt: skip
                        step = _step_of(gains, robot, force, 1.0, measured, robots)
                        moved = step.norm()
                        center += step
                steps_out[robot] = taken
                for k in range(_docks_in_cells(robot, measured, robots)):
                    item = (robot - base) * dock_offset.shape[1] + k
                    link(cells, s, item, cube_of(_dock_at(robots, robot, k), 1.0 / gains.spacing))
                placed = robot - base + 1
                if placed % sweep_every == 0 or robot == start[s + 1] - 1:
                    for sweep in range(sweeps):
                        remaining = 1.0 - (sweep + 1.0) / sweeps
                        ramp = 1.0 - gains.sweep_repulsion * remaining
                        for j in range(ti.max(base, base + placed - recent), base + placed):
                            force = _virtual_force(
                                gains, j, base, s, placed, ramp, 1.0, measured, robots, cells
                            )
                            share = ti.select(is_anchor[j] == 0, gains.sweep_gain, 0.0)
                            step = _step_of(gains, j, force, share, measured, robots)
                            _move(gains, j, base, s, step, measured, robots, cells)
                            moved_to = vector_at(position_out, j)
                            _record(trace, frame + sweep // trace_every, j, moved_to, step.norm())
                            steps_out[j] += 1 - is_anchor[j]
