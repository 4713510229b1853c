"""Algorithm 1 as one launch, with or without back-propagation.

Structures are independent and run in parallel; within one, robots follow each other.
"""

from tiswarm.compute.cell_kernels import cube_of, link, relink
from tiswarm.compute.lang import GRAIN, I32, Ints1, Ints2, Reals1, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.engine.kernels import capped
from tiswarm.localization.kernels import dock_at, law_of, turn_dock, virtual_force


@ti.func
def initial_position(
    law: Ref, robot, base, contact_start: Ref, contact: Ref, initial_direction: Ref, position: Ref
):
    """Mean of the earlier neighbors, each counted once, plus the offset of Algorithm 1.

    A robot that touches no earlier one starts from the anchor instead.
    """
    total = 0.0 * vector_at(position, base)
    count = 0
    first = contact_start[robot]
    for row in range(first, contact_start[robot + 1]):
        counted = contact[row, 1] >= robot - base
        for earlier in range(first, row):
            counted = counted or contact[earlier, 1] == contact[row, 1]
        if not counted:
            total += vector_at(position, base + contact[row, 1])
            count += 1
    if count == 0:
        total = vector_at(position, base)
        count = 1
    return total / count + law.initial_offset * vector_at(initial_direction, robot)


@ti.func
def write_row(array: Ref, i, vector):
    """Write a row of an (n, 3) array."""
    for c in ti.static(range(3)):
        array[i, c] = vector[c]


@ti.func
def record(trace: Ref, step_length: Ref, frame, robot, place, moved):
    """Write where a robot is thought to be in a frame, and how far it came in the last step."""
    for c in ti.static(range(3)):
        trace[frame, robot, c] = place[c]
    step_length[frame, robot] = moved


@ti.func
def step_of(law: Ref, force, gain):
    """How far a robot goes by a share of the force on it, no farther than it may."""
    return capped(gain * ti.Vector([force[0], force[1], force[2]]), law.max_step)


@ti.func
def turn_of(law: Ref, torque, gain, turned):
    """How far a robot turns [rad]: by the virtual torque, and back to what it senses.

    Args:
        law: Gains of the structure.
        torque: Of the forces at its docks.
        gain: Share of it to follow.
        turned: How far it has been turned from what it senses.
    """
    pace = gain * law.torque_gain
    turn = pace * (torque - law.hold * turned) / (1.0 + pace * law.hold)
    return ti.min(ti.max(turn, -law.max_turn), law.max_turn)


@ti.func
def move(
    law: Ref, robot, base, structure, step, turn, dock_offset: Ref, yaw: Ref, position: Ref,
    head: Ref, following: Ref,
):  # fmt: skip
    """Let a robot that has been placed take a step, its docks in the cell list with it."""
    for k in range(dock_offset.shape[1]):
        item = (robot - base) * dock_offset.shape[1] + k
        old = cube_of(dock_at(position, dock_offset, robot, k), 1.0 / law.spacing)
        turn_dock(turn, robot, k, dock_offset)
        new = cube_of(dock_at(position, dock_offset, robot, k) + step, 1.0 / law.spacing)
        relink(head, following, structure, item, old, new)
    yaw[robot] += turn
    write_row(position, robot, vector_at(position, robot) + step)


@ti.kernel
def localize_in_join_order(
    iterations: I32, sweep_every: I32, sweeps: I32, trace_every: I32, gains: Reals2,
    # logs, end to end
    start: Ints1, placed_before: Ints1, contact_start: Ints1, contact: Ints2, dock_offset: Reals3,
    initial_direction: Reals2, flip_height: Reals1,
    # scratch
    head: Ints2, following: Ints2,
    # out
    yaw: Reals1, position: Reals2, trace: Reals3, step_length: Reals2,
):  # fmt: skip
    """Place each robot by its contacts with those that joined before it, Algorithm 1.

    In back-propagation, all robots that have been placed step one after the other, in join
    order, each by its contacts with all others; the next one sees where it went. Contacts are
    taut then: what Eq. (1) has left at the end of its ramp, attraction, lets docks stay too near.

    Args:
        iterations: T, refinement steps of each robot.
        sweep_every: Joins between two rounds of back-propagation; the last join has one too.
        sweeps: Steps of every robot in a round, 0 without back-propagation.
        trace_every: Steps between recorded frames: those of T from the start on, then those of
            the last round.
        gains: One row a structure, columns as `law_of` reads them, shape (S, 12).
        start: First robot of each structure, shape (S + 1,).
        placed_before: Robots of each structure that have been placed already, shape (S,).
        contact_start: First contact row of each robot, shape (N + 1,).
        contact: Rows of (own dock, other robot within the structure, its dock), shape (2 C, 3).
        dock_offset: Center to dock, world frame [R], turned with the robots, shape (N, docks, 3).
        initial_direction: Unit vector of the initial offset, shape (N, 3).
        flip_height: Height from the flips [R], NaN where unknown, shape (N,).
        head: Cell lists of the robots placed before, shape (S, buckets).
        following: Likewise, shape (S, most docks).
        yaw: Read and written: how far each robot has been turned [rad], shape (N,).
        position: Those of anchors and of robots placed before are read, the rest written [R],
            shape (N, 3).
        trace: Written: position at each frame [R], shape (F, N, 3).
        step_length: Written: last step before each frame [R], shape (F, N).
    """
    for i in range((start.shape[0] - 1) * GRAIN):
        if i % GRAIN == 0:
            s = i // GRAIN
            law = law_of(gains, s)
            base = start[s]
            for robot in range(base + placed_before[s], start[s + 1]):
                here = vector_at(position, robot)
                if robot > base:
                    here = initial_position(
                        law, robot, base, contact_start, contact, initial_direction, position
                    )
                moved = 0.0
                frame = 0
                for t in range(iterations + 1):
                    write_row(position, robot, here)
                    if t % trace_every == 0 or t == iterations:
                        record(trace, step_length, frame, robot, here, moved)
                        frame += 1
                    if robot > base and t < iterations:
                        force = virtual_force(
                            law, robot, base, s, robot - base, (t + 1.0) / iterations, 0.0,
                            contact_start, contact, dock_offset, flip_height, position,
                            head, following,
                        )  # fmt: skip
                        step = step_of(law, force, 1.0)
                        turn = turn_of(law, force[3], 1.0, yaw[robot])
                        moved = step.norm()
                        here += step
                        yaw[robot] += turn
                        for k in range(dock_offset.shape[1]):
                            turn_dock(turn, robot, k, dock_offset)
                for k in range(dock_offset.shape[1]):
                    item = (robot - base) * dock_offset.shape[1] + k
                    point = dock_at(position, dock_offset, robot, k)
                    link(head, following, s, item, cube_of(point, 1.0 / law.spacing))
                placed = robot - base + 1
                if placed % sweep_every == 0 or robot == start[s + 1] - 1:
                    for sweep in range(sweeps):
                        left = 1.0 - (sweep + 1.0) / sweeps
                        ramp = 1.0 - law.sweep_repulsion * left
                        for j in range(base, base + placed):
                            force = virtual_force(
                                law, j, base, s, placed, ramp, 1.0,
                                contact_start, contact, dock_offset, flip_height, position,
                                head, following,
                            )  # fmt: skip
                            step = step_of(law, force, ti.select(j > base, law.sweep_gain, 0.0))
                            turn = turn_of(law, force[3], law.sweep_gain, yaw[j])
                            move(
                                law, j, base, s, step, turn,
                                dock_offset, yaw, position, head, following,
                            )  # fmt: skip
                            there = vector_at(position, j)
                            seen = frame + sweep // trace_every
                            record(trace, step_length, seen, j, there, step.norm())
