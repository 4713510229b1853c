"""Virtual forces between docks, and Algorithm 1 as one launch.

A force is the step of a robot's centre in one iteration [R]; it is gathered, never
scattered, so runs repeat bit for bit. Offsets point from the robot's own dock to the other
one: a positive magnitude pulls toward it. Lengths in R.
"""

from tiswarm.compute.cells import bucket_of, cube_of, link, neighbor_cube
from tiswarm.compute.dialect import (
    GRAIN,
    I32,
    Float,
    Ints1,
    Ints2,
    Reals1,
    Reals2,
    Reals3,
    kernel_struct,
    ti,
)


@ti.func
def dock_pair_force(offset, attraction_gain, repulsion_gain, spacing, ramp):
    """Force on a dock whose connected partner lies at `offset`, Eq. (1).

    With d = |offset|, u = offset / d, spacing D and ramp a:

        F =  A a (d - D) u            if d > D
        F = -B (1 - a) (d - D)^4 u    otherwise

    Docks that coincide have no direction to part in, and feel no force.
    """
    distance = offset.norm()
    gap = distance - spacing
    pull = attraction_gain * ramp * gap
    if gap <= 0.0:
        pull = -repulsion_gain * (1.0 - ramp) * gap * gap * gap * gap
    force = 0.0 * offset
    if distance > 0.0:
        force = pull / distance * offset
    return force


@ti.func
def capped(step, max_step):
    """The same step, or one of length `max_step` in its direction where it is longer."""
    length = step.norm()
    scale = ti.select(length > max_step, max_step / length, 1.0)
    return step * scale


@ti.func
def vector_at(array: ti.template(), i):
    """Row of an (n, 3) array."""
    return ti.Vector([array[i, 0], array[i, 1], array[i, 2]])


@ti.func
def dock_at(position: ti.template(), dock_offset: ti.template(), robot, k):
    """Where dock `k` of a robot is thought to be."""
    offset = ti.Vector(
        [dock_offset[robot, k, 0], dock_offset[robot, k, 1], dock_offset[robot, k, 2]]
    )
    return vector_at(position, robot) + offset


@ti.func
def is_connected(contact: ti.template(), first, last, own, robot, k):
    """Whether the contact rows `first` to `last` hold (own dock, robot, dock `k`)."""
    found = False
    for row in range(first, last):
        found = found or (
            contact[row, 0] == own and contact[row, 1] == robot and contact[row, 2] == k
        )
    return found


@ti.func
def connected_force(
    law: ti.template(),
    robot,
    base,
    ramp,
    contact_start: ti.template(),
    contact: ti.template(),
    dock_offset: ti.template(),
    position: ti.template(),
):
    """Sum of Eq. (1) over the robot's contacts with earlier robots."""
    force = 0.0 * vector_at(position, robot)
    for row in range(contact_start[robot], contact_start[robot + 1]):
        own = dock_at(position, dock_offset, robot, contact[row, 0])
        other = dock_at(position, dock_offset, base + contact[row, 1], contact[row, 2])
        force += dock_pair_force(
            other - own, law.attraction_gain, law.repulsion_gain, law.spacing, ramp
        )
    return force


@ti.func
def undocked_force(
    law: ti.template(),
    robot,
    base,
    structure,
    ramp,
    contact_start: ti.template(),
    contact: ti.template(),
    dock_offset: ti.template(),
    position: ti.template(),
    head: ti.template(),
    following: ti.template(),
):
    """Sum of Eq. (2) over all docks closer than D that are not connected to the robot's.

    The paper prints the force with a unit vector from the other dock to the robot's own and
    a minus sign, which would pull them together; here it pushes them apart, as the text says.
    """
    docks = dock_offset.shape[1]
    force = 0.0 * vector_at(position, robot)
    for k in range(docks):
        own = dock_at(position, dock_offset, robot, k)
        cube = cube_of(own, 1.0 / law.spacing)
        for which in range(27):
            item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
            while item >= 0:
                other = item // docks
                offset = dock_at(position, dock_offset, base + other, item % docks) - own
                if offset.norm_sqr() < law.spacing * law.spacing and not is_connected(
                    contact, contact_start[robot], contact_start[robot + 1], k, other, item % docks
                ):
                    force += dock_pair_force(offset, 0.0, law.repulsion_gain, law.spacing, ramp)
                item = following[structure, item]
    return force


@ti.func
def initial_position(
    law: ti.template(),
    robot,
    base,
    contact_start: ti.template(),
    contact: ti.template(),
    initial_direction: ti.template(),
    position: ti.template(),
):
    """Mean of the earlier neighbours, each counted once, plus the offset of Algorithm 1.

    A robot that touches no earlier one starts from the anchor instead.
    """
    total = 0.0 * vector_at(position, base)
    count = 0
    first = contact_start[robot]
    for row in range(first, contact_start[robot + 1]):
        counted = False
        for earlier in range(first, row):
            counted = counted or contact[earlier, 1] == contact[row, 1]
        if not counted:
            total += vector_at(position, base + contact[row, 1])
            count += 1
    if count == 0:
        total = vector_at(position, base)
        count = 1
    return total / count + law.initial_offset * vector_at(initial_direction, robot)


@kernel_struct
class VirtualForceLaw:
    """Gains of one structure; see `VirtualForceParams`."""

    attraction_gain: Float
    repulsion_gain: Float
    height_gain: Float
    initial_offset: Float
    max_step: Float
    spacing: Float
    undocked: I32


@ti.func
def law_of(gains: ti.template(), structure):
    """Read the gains of a structure; columns as `VirtualForceLaw` lists them."""
    return VirtualForceLaw(
        attraction_gain=gains[structure, 0],
        repulsion_gain=gains[structure, 1],
        height_gain=gains[structure, 2],
        initial_offset=gains[structure, 3],
        max_step=gains[structure, 4],
        spacing=gains[structure, 5],
        undocked=ti.cast(gains[structure, 6], ti.i32),
    )


@ti.kernel
def localize_in_join_order(
    iterations: I32,
    trace_every: I32,
    gains: Reals2,
    # logs, end to end
    start: Ints1,
    contact_start: Ints1,
    contact: Ints2,
    dock_offset: Reals3,
    initial_direction: Reals2,
    flip_height: Reals1,
    # scratch
    head: Ints2,
    following: Ints2,
    # out
    position: Reals2,
    trace: Reals3,
    step_length: Reals2,
):
    """Algorithm 1: place each robot by its contacts with those that joined before it.

    Structures are independent and run in parallel; within one, robots follow each other.

    Args:
        iterations: T, refinement steps of each robot.
        trace_every: Steps between recorded frames; frame 0 is the start, the last frame T.
        gains: One row a structure, columns as in `VirtualForceLaw`, shape (S, 7).
        start: First robot of each structure, shape (S + 1,).
        contact_start: First contact row of each robot, shape (N + 1,).
        contact: Rows of (own dock, earlier robot within the structure, its dock), shape (C, 3).
        dock_offset: Centre to dock, world frame [R], shape (N, docks, 3).
        initial_direction: Unit vector of the initial offset, shape (N, 3).
        flip_height: Height from the flips [R], NaN where unknown, shape (N,).
        head: Cell lists, empty, shape (S, buckets).
        following: Cell lists, empty, shape (S, most docks).
        position: Anchors are read, the rest written [R], shape (N, 3).
        trace: Written: position at each frame [R], shape (F, N, 3).
        step_length: Written: last step before each frame [R], shape (F, N).
    """
    for i in range((start.shape[0] - 1) * GRAIN):
        if i % GRAIN == 0:
            s = i // GRAIN
            law = law_of(gains, s)
            base = start[s]
            for robot in range(base, start[s + 1]):
                here = vector_at(position, robot)
                if robot > base:
                    here = initial_position(
                        law, robot, base, contact_start, contact, initial_direction, position
                    )
                moved = 0.0
                frame = 0
                for t in range(iterations + 1):
                    for c in ti.static(range(3)):
                        position[robot, c] = here[c]
                    if t % trace_every == 0 or t == iterations:
                        for c in ti.static(range(3)):
                            trace[frame, robot, c] = here[c]
                        step_length[frame, robot] = moved
                        frame += 1
                    if robot > base and t < iterations:
                        ramp = (t + 1.0) / iterations
                        force = connected_force(
                            law, robot, base, ramp, contact_start, contact, dock_offset, position
                        )
                        if law.undocked:
                            force += undocked_force(
                                law, robot, base, s, ramp,
                                contact_start, contact, dock_offset, position, head, following,
                            )  # fmt: skip
                        if not ti.math.isnan(flip_height[robot]):
                            force[2] += law.height_gain * (flip_height[robot] - here[2])
                        step = capped(force, law.max_step)
                        moved = step.norm()
                        here += step
                for k in range(dock_offset.shape[1]):
                    item = (robot - base) * dock_offset.shape[1] + k
                    point = dock_at(position, dock_offset, robot, k)
                    link(head, following, s, item, cube_of(point, 1.0 / law.spacing))
