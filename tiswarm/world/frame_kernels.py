"""Frames: how a kernel finds the forces in structures of beams at rest."""

from typing import NamedTuple

from tiswarm.compute.lang import F64, GRAIN, I32, Ints1, Ints3, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import vector_in
from tiswarm.world.elimination_kernels import EliminationArrays, clear, edge_between, solve

NODE_A, NODE_B, DOCK_A, DOCK_B = range(4)
"""Columns of a beam: nodes that its ends move with, and docks that it joins, if it is a contact."""
GROUND, NO_DOCK = -1, -2
_Z = 2


class FrameArrays(NamedTuple):
    """Frames of S structures with room for M nodes, B beams, and N robots of n docks each."""

    node_count: Ints1
    """Nodes in use, shape (S,)."""

    beam_count: Ints1
    """Beams in use, shape (S,)."""

    ends: Ints3
    """What each beam joins, columns NODE_A to DOCK_B, shape (S, B, 4)."""

    stiffness: Reals3
    """Of each beam between its nodes, a 12 x 12 matrix row by row, shape (S, B, 144)."""

    span: Reals3
    """First to second end of each beam [R], shape (S, B, 3)."""

    arm: Reals3
    """Center to dock [R], shape (S, n N, 3)."""

    weight: Reals3
    """Force and moment of the weight on each node, shape (S, M, 6)."""


class LoadArrays(NamedTuple):
    """Loads that follow; sizes as in `FrameArrays`."""

    acting: Reals3
    """Force and moment of contacts and weight on each dock, shape (S, n N, 6)."""

    support: Reals3
    """Force of the second dock, or the ground, on the first of each contact, shape (S, B, 3)."""

    stress: Reals2
    """Largest von Mises stress in a section of each contact, shape (S, B)."""

    sensed: Reals2
    """Load that each robot senses, shape (S, N)."""


@ti.func
def _assemble(frame: Ref, work: Ref, s):
    """Add up the beams' stiffnesses."""
    clear(work, s, frame.node_count[s])
    for a, c in ti.ndrange(frame.node_count[s], 6):
        work.motion[s, a, c] = frame.weight[s, a, c]
    for beam in range(frame.beam_count[s]):
        a, b = frame.ends[s, beam, NODE_A], frame.ends[s, beam, NODE_B]
        for i, j in ti.ndrange(6, 6):
            work.block[s, a, 6 * i + j] += frame.stiffness[s, beam, 12 * i + j]
        if b >= 0:
            edge = edge_between(work, s, a, b)
            # The block has the rows of the lower node.
            start = 6 if a < b else 72
            for i, j in ti.ndrange(6, 6):
                place, value = 6 * i + j, 12 * i + j
                work.block[s, b, place] += frame.stiffness[s, beam, 78 + value]
                if edge >= 0:
                    work.block[s, edge, place] += frame.stiffness[s, beam, start + value]


@ti.func
def _split(vector, axis):
    """Sizes of the parts along and across an axis."""
    along = vector.dot(axis)
    return ti.abs(along), (vector - along * axis).norm()


@ti.func
def _contact_loads(frame: Ref, loads: Ref, motion: Ref, s, beam, is_rigid, radius):
    """Find the forces that a contact puts on its docks, and its largest stress.

    The stress at the rim is the square root of sigma^2 + 3 tau^2, with sigma from axial force
    and bending and tau from shear and torsion. The section is halfway between two docks, and at
    the ground.
    """
    a, b = frame.ends[s, beam, NODE_A], frame.ends[s, beam, NODE_B]
    both = ti.Vector.zero(F64, 12)
    for j in range(6):
        moved = motion[s, a, j]
        both += moved * ti.Vector([frame.stiffness[s, beam, 12 * i + j] for i in range(12)])
    if b >= 0:
        for j in range(6):
            moved = motion[s, b, j]
            both += moved * ti.Vector([frame.stiffness[s, beam, 12 * i + 6 + j] for i in range(12)])
    span = vector_in(frame.span, s, beam)
    for end in ti.static(range(2)):
        dock = frame.ends[s, beam, DOCK_A + end]
        if dock >= 0:
            force = ti.Vector([both[6 * end + c] for c in range(3)])
            moment = ti.Vector([both[6 * end + 3 + c] for c in range(3)])
            if is_rigid:
                moment -= vector_in(frame.arm, s, dock).cross(force)
            for c in ti.static(range(3)):
                loads.acting[s, dock, c] -= force[c]
                loads.acting[s, dock, 3 + c] -= moment[c]
            if ti.static(end == 0):
                section = span if b < 0 else 0.5 * span
                axis = span.normalized()
                pull, shear = _split(force, axis)
                torque, bend = _split(moment - section.cross(force), axis)
                area = ti.math.pi * radius**2
                modulus = 0.25 * ti.math.pi * radius**3
                sigma = pull / area + bend / modulus
                tau = 4.0 / 3.0 * shear / area + torque / (2.0 * modulus)
                loads.stress[s, beam] = ti.sqrt(sigma**2 + 3.0 * tau**2)
                for c in ti.static(range(3)):
                    loads.support[s, beam, c] = -force[c]


@ti.func
def _sense(frame: Ref, loads: Ref, s, robot, docks):
    """Find the mean over a robot's links of |axial force| + |bending moment|."""
    total = 0.0
    for dock in range(docks * robot, docks * (robot + 1)):
        link = vector_in(frame.arm, s, dock).normalized()
        force = vector_in(loads.acting, s, dock)
        moment = ti.Vector([loads.acting[s, dock, 3 + c] for c in range(3)])
        axial, _ = _split(force, link)
        _, bending = _split(moment, link)
        total += axial + bending
    loads.sensed[s, robot] = total / docks


@ti.kernel
def find_loads(
    is_rigid: I32, radius: F64, robots: Ints1, due: Ints1,
    # FrameArrays
    node_count: Ints1, beam_count: Ints1, ends: Ints3, stiffness: Reals3, span: Reals3,
    arm: Reals3, weight: Reals3,
    # EliminationArrays
    node_out: Ints3, order_out: Ints3, half_out: Ints3, block_count_out: Ints1, block_out: Reals3,
    motion_out: Reals3,
    # LoadArrays
    acting_out: Reals3, support_out: Reals3, stress_out: Reals2, sensed_out: Reals2,
):  # fmt: skip
    """Find how structures move under their weight, and the loads in them.

    Args:
        is_rigid: Whether nodes are robots; else a robot's nodes are its center and its docks.
        radius: Of the beams [R].
        robots: Robots of each structure, shape (S,).
        due: Structures to solve, shape (n,).
    """
    frame = ti.static(FrameArrays(node_count, beam_count, ends, stiffness, span, arm, weight))
    work = ti.static(
        EliminationArrays(node_out, order_out, half_out, block_count_out, block_out, motion_out)
    )
    loads = ti.static(LoadArrays(acting_out, support_out, stress_out, sensed_out))
    for n, idle in ti.ndrange(due.shape[0], GRAIN):
        if idle == 0:
            s = due[n]
            docks = arm.shape[1] // sensed_out.shape[1]
            _assemble(frame, work, s)
            if solve(work, s, node_count[s]):
                for dock in range(docks * robots[s]):
                    for c in ti.static(range(6)):
                        acting_out[s, dock, c] = -1.0 if ti.static(c == _Z) else 0.0
                for beam in range(beam_count[s]):
                    if ends[s, beam, DOCK_A] >= 0:
                        _contact_loads(frame, loads, motion_out, s, beam, is_rigid, radius)
                for robot in range(robots[s]):
                    _sense(frame, loads, s, robot, docks)
