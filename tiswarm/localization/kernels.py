"""Virtual forces and torques on one robot of a structure that grows, Eqs. (1) to (3).

Forces are gathered, never scattered, so runs repeat bit for bit. Lengths in R.
"""

from tiswarm.compute.cell_kernels import bucket_of, cube_of, neighbor_cube
from tiswarm.compute.lang import Ref, ti
from tiswarm.compute.math_kernels import vector_at, vector_in
from tiswarm.engine.kernels import dock_pair_force, parting


@ti.func
def dock_at(position: Ref, dock_offset: Ref, robot, k):
    """Where dock `k` of a robot is thought to be."""
    return vector_at(position, robot) + vector_in(dock_offset, robot, k)


@ti.func
def turn_dock(turn, robot, k, dock_offset: Ref):
    """Turn dock `k` of a robot about the vertical through its center."""
    if turn != 0.0:
        c, s = ti.cos(turn), ti.sin(turn)
        x, y = dock_offset[robot, k, 0], dock_offset[robot, k, 1]
        dock_offset[robot, k, 0] = c * x - s * y
        dock_offset[robot, k, 1] = s * x + c * y


NO_DOCKS = 0
DOCKS_OF_NEIGHBORS = 1
ALL_DOCKS = 2
"""Which docks part that overlap without being connected."""


@ti.func
def law_of(gains: Ref, structure):
    """Read the gains of a structure; see `VirtualForceParams`."""
    return ti.Struct(
        attraction_gain=gains[structure, 0],
        repulsion_gain=gains[structure, 1],
        height_gain=gains[structure, 2],
        initial_offset=gains[structure, 3],
        max_step=gains[structure, 4],
        sweep_gain=gains[structure, 5],
        sweep_repulsion=gains[structure, 6],
        spacing=gains[structure, 7],
        undocked=ti.cast(gains[structure, 8], ti.i32),
        torque_gain=gains[structure, 9],
        hold=gains[structure, 10],
        max_turn=gains[structure, 11],
    )


@ti.func
def is_connected(contact: Ref, first, last, own, robot, k):
    """Whether the contact rows `first` to `last` hold (own dock, robot, dock `k`)."""
    found = False
    for row in range(first, last):
        found = found or (
            contact[row, 0] == own and contact[row, 1] == robot and contact[row, 2] == k
        )
    return found


@ti.func
def touches(contact: Ref, first, last, robot):
    """Whether the contact rows `first` to `last` hold any dock of a robot."""
    found = False
    for row in range(first, last):
        found = found or contact[row, 1] == robot
    return found


@ti.func
def with_torque(force, arm):
    """A force and, as fourth component, its torque about the vertical where it acts at `arm`."""
    return ti.Vector([force[0], force[1], force[2], arm[0] * force[1] - arm[1] * force[0]])


@ti.func
def connected_force(
    law: Ref, robot, base, placed, ramp, taut, contact_start: Ref, contact: Ref, dock_offset: Ref,
    position: Ref,
):  # fmt: skip
    """Sum of Eq. (1) over the robot's contacts with the first `placed` robots, with its torque.

    Where `taut` is 1, docks nearer than D part as firmly as farther ones approach.
    """
    here = vector_at(position, robot)
    force = with_torque(0.0 * here, here)
    for row in range(contact_start[robot], contact_start[robot + 1]):
        if contact[row, 1] < placed:
            own = dock_at(position, dock_offset, robot, contact[row, 0])
            other = dock_at(position, dock_offset, base + contact[row, 1], contact[row, 2])
            pull = dock_pair_force(
                other - own, law.attraction_gain, law.repulsion_gain, law.spacing, ramp
            )
            pull += taut * parting(other - own, law.attraction_gain * ramp, law.spacing)
            force += with_torque(pull, own - here)
    return force


@ti.func
def undocked_force(
    law: Ref, robot, base, structure, ramp, contact_start: Ref, contact: Ref, dock_offset: Ref,
    position: Ref, head: Ref, following: Ref,
):  # fmt: skip
    """Sum of Eq. (2) over docks in the cell list closer than D, but not connected, to the robot's.

    The paper prints the force with a unit vector from the other dock to the robot's own and
    a minus sign, which would pull them together; here it pushes them apart, as the text says.
    """
    docks = dock_offset.shape[1]
    first, last = contact_start[robot], contact_start[robot + 1]
    here = vector_at(position, robot)
    force = with_torque(0.0 * here, here)
    for k in range(docks):
        own = dock_at(position, dock_offset, robot, k)
        cube = cube_of(own, 1.0 / law.spacing)
        for which in range(27):
            item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
            while item >= 0:
                other = item // docks
                offset = dock_at(position, dock_offset, base + other, item % docks) - own
                if offset.norm_sqr() < law.spacing * law.spacing and other != robot - base:
                    if (
                        law.undocked == ALL_DOCKS or touches(contact, first, last, other)
                    ) and not is_connected(contact, first, last, k, other, item % docks):
                        push = dock_pair_force(offset, 0.0, law.repulsion_gain, law.spacing, ramp)
                        force += with_torque(push, own - here)
                item = following[structure, item]
    return force


@ti.func
def virtual_force(
    law: Ref, robot, base, structure, placed, ramp, taut, contact_start: Ref, contact: Ref,
    dock_offset: Ref, flip_height: Ref, position: Ref, head: Ref, following: Ref,
):  # fmt: skip
    """Eqs. (1) to (3) on a robot, from the first `placed` robots of its structure.

    Each force acts at a dock; the fourth component is their torque about the vertical.
    """
    force = connected_force(
        law, robot, base, placed, ramp, taut, contact_start, contact, dock_offset, position
    )
    if law.undocked != NO_DOCKS:
        force += undocked_force(
            law, robot, base, structure, ramp,
            contact_start, contact, dock_offset, position, head, following,
        )  # fmt: skip
    if not ti.math.isnan(flip_height[robot]):
        force[2] += law.height_gain * (flip_height[robot] - position[robot, 2])
    return force
