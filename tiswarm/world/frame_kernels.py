"""Frames: how a kernel finds the forces in structures of beams at rest.

It solves a sparse system of 6 x 6 blocks by elimination over a graph. Nodes of 6 unknowns are
eliminated one after the other, always one of the fewest neighbors that are left (minimum degree).
With K the matrix of those that are left, C C' = K_kk the Cholesky factorization of the pivot's
block, and a and b neighbors of k,

    Z_a = C^-1 K_ka,    y = C^-1 f_k,    K_ab -= Z_a' Z_b,    f_a -= Z_a' y,

which joins all neighbors of k to each other. Then, in reverse, u_k = C^-T (y - sum_a Z_a u_a).
A matrix that is not positive definite gives NaN (George and Liu, Computer Solution of Large Sparse
Positive Definite Systems, 1981).
"""

from typing import NamedTuple

from tiswarm.compute.lang import F64, GRAIN, I32, Columns, Ints1, Ints3, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import vector_in


class Node(Columns):
    """Columns of `EliminationArrays.node`."""

    FIRST = 1
    """First half-edge of the node."""
    DEGREE = 1
    """Its neighbors that are left."""
    LEFT = 1
    """Node before it in the list of those of its degree, or -1."""
    RIGHT = 1
    """Node after it in that list, or -1."""
    MARKED_BY = 1
    """Node that marked it as a neighbor last, or -1."""
    MARK = 1
    """Half-edge by which that node did."""


class NodeList(Columns):
    """Columns of `EliminationArrays.order`."""

    LEAST = 1
    """First node of those with as many neighbors as the row says, or -1."""
    PIVOT = 1
    """Node that was eliminated in the step that the row says."""
    NEAR = 1
    """Half-edges to the neighbors of the pivot, one a row."""


class HalfEdge(Columns):
    """Columns of `EliminationArrays.half`."""

    NEXT = 1
    """Next half-edge of its node, or -1."""
    OTHER = 1
    """Node at the other end."""


class EliminationArrays(NamedTuple):
    """S systems with room for M nodes and L blocks: those of the nodes, then those of edges."""

    node: Ints3
    """Columns of `Node`, shape (S, M, 6)."""

    order: Ints3
    """Columns of `NodeList`, whose rows are no nodes, shape (S, M + 1, 3)."""

    half: Ints3
    """Columns of `HalfEdge`; the edge with block e has 2 e and 2 e + 1, shape (S, 2 L, 2)."""

    block_count: Ints1
    """Blocks that the elimination needed so far; it stops where they exceed L, shape (S,)."""

    block: Reals3
    """Row by row: K_aa, then C; K_ab, a < b, then Z, shape (S, L, 36)."""

    motion: Reals3
    """f of each node; then u, shape (S, M, 6)."""


@ti.func
def clear(work: Ref, s, nodes):
    """Start a system of so many nodes that nothing joins; `motion` is left as it is."""
    work.block_count[s] = nodes
    for a in range(nodes):
        work.node[s, a, Node.FIRST] = -1
        work.node[s, a, Node.DEGREE] = 0
        work.node[s, a, Node.MARKED_BY] = -1
        for c in range(36):
            work.block[s, a, c] = 0.0


@ti.func
def edge_between(work: Ref, s, a, b):
    """Find the block of the edge between two nodes, or add it; return -1 without room."""
    half = work.node[s, a, Node.FIRST]
    while half >= 0 and work.half[s, half, HalfEdge.OTHER] != b:
        half = work.half[s, half, HalfEdge.NEXT]
    if half < 0:
        half = _add_edge(work, s, a, b)
    return half // 2 if half >= 0 else -1


@ti.func
def _add_edge(work: Ref, s, a, b):
    """Join two nodes; return the half-edge of `a`, or -1 without room."""
    edge = work.block_count[s]
    work.block_count[s] += 1
    half = -1
    if edge < work.block.shape[1]:
        half = 2 * edge
        for c in range(36):
            work.block[s, edge, c] = 0.0
        work.half[s, half, HalfEdge.OTHER] = b
        work.half[s, half, HalfEdge.NEXT] = work.node[s, a, Node.FIRST]
        work.node[s, a, Node.FIRST] = half
        work.half[s, half + 1, HalfEdge.OTHER] = a
        work.half[s, half + 1, HalfEdge.NEXT] = work.node[s, b, Node.FIRST]
        work.node[s, b, Node.FIRST] = half + 1
        work.node[s, a, Node.DEGREE] += 1
        work.node[s, b, Node.DEGREE] += 1
    return half


@ti.func
def _enter(work: Ref, s, a):
    """Put a node in front of those of its degree."""
    node = ti.static(work.node)
    degree = node[s, a, Node.DEGREE]
    first = work.order[s, degree, NodeList.LEAST]
    node[s, a, Node.LEFT] = -1
    node[s, a, Node.RIGHT] = first
    if first >= 0:
        node[s, first, Node.LEFT] = a
    work.order[s, degree, NodeList.LEAST] = a


@ti.func
def _leave(work: Ref, s, a, degree):
    """Take a node out from those of a degree."""
    node = ti.static(work.node)
    left, right = node[s, a, Node.LEFT], node[s, a, Node.RIGHT]
    if left >= 0:
        node[s, left, Node.RIGHT] = right
    else:
        work.order[s, degree, NodeList.LEAST] = right
    if right >= 0:
        node[s, right, Node.LEFT] = left


@ti.func
def _eliminate(work: Ref, s, k):
    """Eliminate node `k`: C replaces its block, y its load in `motion`, and Z_a those of edges.

    Returns:
        Its neighbors; `order` lists the half-edges to them.
    """
    # C C' = K_kk: C_ij = (K_ij - sum_c C_ic C_jc) / C_jj, or the square root of that for i = j
    for j in range(6):
        for i in range(j, 6):
            value = work.block[s, k, 6 * i + j]
            for c in range(j):
                value -= work.block[s, k, 6 * i + c] * work.block[s, k, 6 * j + c]
            if i > j:
                value /= work.block[s, k, 7 * j]
            else:
                # NaN also where rounding makes a pivot 0.
                value = ti.sqrt(value) if value > 0.0 else ti.math.nan
            work.block[s, k, 6 * i + j] = value
    # y = C^-1 f_k, row by row
    for i in range(6):
        value = work.motion[s, k, i]
        for c in range(i):
            value -= work.block[s, k, 6 * i + c] * work.motion[s, k, c]
        work.motion[s, k, i] = value / work.block[s, k, 7 * i]
    near = 0
    half = work.node[s, k, Node.FIRST]
    while half >= 0:
        work.order[s, near, NodeList.NEAR] = half
        near += 1
        a, edge = work.half[s, half, HalfEdge.OTHER], half // 2
        _leave(work, s, a, work.node[s, a, Node.DEGREE])
        work.node[s, a, Node.DEGREE] -= 1
        _forward(work, s, k, a, edge)
        half = work.half[s, half, HalfEdge.NEXT]
    return near


@ti.func
def _forward(work: Ref, s, k, a, edge):
    """Replace K_ka by Z_a, and subtract Z_a' y."""
    # The block is that of the lower number, K_ak = K_ka' where that is a.
    if a < k:
        for i in range(6):
            for j in range(i):
                upper, lower = work.block[s, edge, 6 * j + i], work.block[s, edge, 6 * i + j]
                work.block[s, edge, 6 * i + j] = upper
                work.block[s, edge, 6 * j + i] = lower
    # Z_a = C^-1 K_ka, row by row, and f_a -= Z_a' y
    for i in range(6):
        row = ti.Vector([work.block[s, edge, 6 * i + j] for j in range(6)])
        for c in range(i):
            row -= work.block[s, k, 6 * i + c] * ti.Vector(
                [work.block[s, edge, 6 * c + j] for j in range(6)]
            )
        row /= work.block[s, k, 7 * i]
        for j in ti.static(range(6)):
            work.block[s, edge, 6 * i + j] = row[j]
            work.motion[s, a, j] -= row[j] * work.motion[s, k, i]


@ti.func
def _subtract(block: Ref, s, target, one, other):
    """Subtract Z_one' Z_other from a block."""
    for i in range(6):
        row = ti.Vector([block[s, target, 6 * i + j] for j in range(6)])
        for c in ti.static(range(6)):
            factor = block[s, one, 6 * c + i]
            row -= factor * ti.Vector([block[s, other, 6 * c + j] for j in range(6)])
        for j in ti.static(range(6)):
            block[s, target, 6 * i + j] = row[j]


@ti.func
def _join_neighbors(work: Ref, s, k, near):
    """Subtract Z_a' Z_b for all pairs of neighbors of `k`, each with itself too."""
    for n in range(near):
        from_k = work.order[s, n, NodeList.NEAR]
        a = work.half[s, from_k, HalfEdge.OTHER]
        # Mark the neighbors of `a`, and drop `k` from them.
        before = -1
        half = work.node[s, a, Node.FIRST]
        while half >= 0:
            other, following = work.half[s, half, HalfEdge.OTHER], work.half[s, half, HalfEdge.NEXT]
            if other != k:
                work.node[s, other, Node.MARKED_BY] = a
                work.node[s, other, Node.MARK] = half
                before = half
            elif before < 0:
                work.node[s, a, Node.FIRST] = following
            else:
                work.half[s, before, HalfEdge.NEXT] = following
            half = following
        for m in range(near):
            to_b = work.order[s, m, NodeList.NEAR]
            b = work.half[s, to_b, HalfEdge.OTHER]
            if a <= b:
                half = work.node[s, b, Node.MARK]
                if a == b:
                    half = 2 * a
                elif work.node[s, b, Node.MARKED_BY] != a:
                    half = _add_edge(work, s, a, b)
                # K_ab -= Z_a' Z_b
                if half >= 0:
                    _subtract(work.block, s, half // 2, from_k // 2, to_b // 2)


@ti.func
def _back(work: Ref, s, k):
    """Find the motion of `k` from those that were eliminated later."""
    # y - sum_a Z_a u_a
    rest = ti.Vector([work.motion[s, k, i] for i in range(6)])
    half = work.node[s, k, Node.FIRST]
    while half >= 0:
        a, edge = work.half[s, half, HalfEdge.OTHER], half // 2
        for j in range(6):
            moved = work.motion[s, a, j]
            rest -= moved * ti.Vector([work.block[s, edge, 6 * i + j] for i in range(6)])
        half = work.half[s, half, HalfEdge.NEXT]
    for c in ti.static(range(6)):
        work.motion[s, k, c] = rest[c]
    # u_k = C^-T of that, from the last row to the first
    for back in range(6):
        i = 5 - back
        value = work.motion[s, k, i]
        for c in range(i + 1, 6):
            value -= work.block[s, k, 6 * c + i] * work.motion[s, k, c]
        work.motion[s, k, i] = value / work.block[s, k, 7 * i]


@ti.func
def solve(work: Ref, s, nodes):
    """Solve a system; return whether there was room for the edges."""
    for degree in range(nodes + 1):
        work.order[s, degree, NodeList.LEAST] = -1
    for a in range(nodes):
        _enter(work, s, a)
    least = 0
    for step in range(nodes):
        if work.block_count[s] <= work.block.shape[1]:
            while work.order[s, least, NodeList.LEAST] < 0:
                least += 1
            k = work.order[s, least, NodeList.LEAST]
            work.order[s, step, NodeList.PIVOT] = k
            _leave(work, s, k, least)
            near = _eliminate(work, s, k)
            _join_neighbors(work, s, k, near)
            for n in range(near):
                _enter(work, s, work.half[s, work.order[s, n, NodeList.NEAR], HalfEdge.OTHER])
            # Neighbors lose no more than the pivot, so that the least degree falls by one at most.
            least = ti.max(least - 1, 0)
    has_room = work.block_count[s] <= work.block.shape[1]
    if has_room:
        for step in range(nodes):
            _back(work, s, work.order[s, nodes - 1 - step, NodeList.PIVOT])
    return has_room


class BeamEnds(Columns):
    """Columns of `FrameArrays.ends`."""

    NODE_A = 1
    """Node that the first end moves with."""
    NODE_B = 1
    """Node that the second end moves with, or GROUND."""
    DOCK_A = 1
    """Dock that a contact joins at its first end, or NO_DOCK."""
    DOCK_B = 1
    """Dock that it joins at its second end, GROUND or NO_DOCK."""


GROUND, NO_DOCK = -1, -2
_Z = 2


class FrameArrays(NamedTuple):
    """Frames of S structures with room for M nodes, B beams, and N robots of n docks each."""

    node_count: Ints1
    """Nodes in use, shape (S,)."""

    beam_count: Ints1
    """Beams in use, shape (S,)."""

    ends: Ints3
    """What each beam joins, columns of `BeamEnds`, shape (S, B, 4)."""

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
        a, b = frame.ends[s, beam, BeamEnds.NODE_A], frame.ends[s, beam, BeamEnds.NODE_B]
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
    a, b = frame.ends[s, beam, BeamEnds.NODE_A], frame.ends[s, beam, BeamEnds.NODE_B]
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
        dock = frame.ends[s, beam, BeamEnds.DOCK_A + end]
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
                    if ends[s, beam, BeamEnds.DOCK_A] >= 0:
                        _contact_loads(frame, loads, motion_out, s, beam, is_rigid, radius)
                for robot in range(robots[s]):
                    _sense(frame, loads, s, robot, docks)
