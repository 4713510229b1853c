"""Frames: how a kernel finds the forces in structures of beams at rest.

It solves a sparse system of 6 x 6 blocks by elimination over a graph. Nodes of 6 unknowns are
eliminated one after the other, always one of the fewest neighbors that are left (minimum degree).
With K the matrix of those that are left, C C' = K_kk the Cholesky factorization of the pivot's
block, and a and b neighbors of k,

    Z_a = C^-1 K_ka,    y = C^-1 f_k,    K_ab -= Z_a' Z_b,    f_a -= Z_a' y,

which joins all neighbors of k to each other. Nodes that have the same neighbors left go together.
Then, in reverse, u_k = C^-T (y - sum_a Z_a u_a).
A matrix that is not positive definite gives NaN (George and Liu, Computer Solution of Large Sparse
Positive Definite Systems, 1981).

Functions write `a[i] = a[i] + b` where one thread alone adds: `a[i] += b` is atomic, which takes
many times as long.
"""

from typing import NamedTuple

from tiswarm.compute.lang import (
    F64,
    GRAIN,
    I32,
    Columns,
    Ints1,
    Ints2,
    Ints3,
    Reals2,
    Reals3,
    Reals4,
    Ref,
    ti,
)
from tiswarm.compute.math_kernels import vector_in
from tiswarm.world.block_kernels import (
    ROW_WIDTH,
    Blocks,
    Rows,
    factorize,
    solve_lower,
    solve_rows,
    solve_upper,
    stiffness_row,
    subtract_product,
)


class Node(Columns):
    """Columns of `EliminationArrays.node`."""

    FIRST = 1
    """First half-edge of the node."""
    DEGREE = 1
    """Its neighbors that are left, or ELIMINATED."""
    PREVIOUS = 1
    """Node before it in the list of those of its degree, or -1."""
    FOLLOWING = 1
    """Node after it in that list, or -1."""
    MARKED_BY = 1
    MARK = 1
    """Node that marked it as a neighbor last, or -1, and the half-edge by which that did."""
    PLACE = 1
    """Its place in the panel of the group that is its neighbor."""


class NodeList(Columns):
    """Columns of `EliminationArrays.order`."""

    LEAST = 1
    """First node of those with as many neighbors as the row says, or -1."""
    PIVOT = 1
    """Node that was eliminated in the step that the row says."""
    NEAR = 1
    """Neighbors of the last pivot, one a row."""


class HalfEdge(Columns):
    """Columns of `EliminationArrays.half`."""

    NEXT = 1
    """Next half-edge of its node, or -1."""
    TARGET = 1
    """Node at its far end."""


ELIMINATED = -1
"""Degree of a node that was eliminated."""
GROUP = 16
"""Most nodes that are eliminated together."""


class EliminationArrays(NamedTuple):
    """S systems with room for M nodes and L blocks: those of the nodes, then those of edges."""

    node: Ints3
    """Columns of `Node`, shape (S, M, 7)."""

    order: Ints3
    """Columns of `NodeList`, whose rows are no nodes, shape (S, M + 1, 3)."""

    half: Ints3
    """Columns of `HalfEdge`; the edge with block e has 2 e and 2 e + 1, shape (S, 2 L, 2)."""

    block_count: Ints1
    """Blocks that the elimination needed so far; it stops where they exceed L, shape (S,)."""

    block: Blocks
    """K_aa, then C'; K_ab, a < b, then Z, shape (S, L, 6, 8)."""

    panel: Rows
    """Scratch: rows of Z of each node of a group, those for one neighbor in succession,
    shape (S, 6 M, 8)."""

    motion: Rows
    """f of each node; then u, shape (S, M, 8)."""


@ti.func
def _clear_block(work: Ref, s, place):
    """Set a block to 0."""
    for i in ti.static(range(6)):
        work.block[s, place, i] = ti.Vector.zero(F64, ROW_WIDTH)


@ti.func
def clear(work: Ref, s, nodes):
    """Start a system of so many nodes that nothing joins; `motion` is left as it is."""
    work.block_count[s] = nodes
    for a in range(nodes):
        work.node[s, a, Node.FIRST] = -1
        work.node[s, a, Node.DEGREE] = 0
        work.node[s, a, Node.MARKED_BY] = -1
        _clear_block(work, s, a)


@ti.func
def edge_between(work: Ref, s, a, b):
    """Find the block of the edge between two nodes, or add it; return -1 without room."""
    half = work.node[s, a, Node.FIRST]
    while half >= 0 and work.half[s, half, HalfEdge.TARGET] != b:
        half = work.half[s, half, HalfEdge.NEXT]
    edge = half // 2
    if half < 0:
        edge = _add_edge(work, s, a, b)
    return edge


@ti.func
def _add_edge(work: Ref, s, a, b):
    """Join two nodes; return the block of the edge, or -1 without room."""
    edge = work.block_count[s]
    half = 2 * edge
    work.block_count[s] = edge + 1
    if edge >= work.block.shape[1]:
        edge = -1
    else:
        _clear_block(work, s, edge)
        for source, target, direction in ti.static(((a, b, 0), (b, a, 1))):
            work.half[s, half + direction, HalfEdge.TARGET] = target
            work.half[s, half + direction, HalfEdge.NEXT] = work.node[s, source, Node.FIRST]
            work.node[s, source, Node.FIRST] = half + direction
            work.node[s, source, Node.DEGREE] = work.node[s, source, Node.DEGREE] + 1
    return edge


@ti.func
def _enter(work: Ref, s, a):
    """Put a node in front of those of its degree."""
    node = ti.static(work.node)
    degree = node[s, a, Node.DEGREE]
    first = work.order[s, degree, NodeList.LEAST]
    node[s, a, Node.PREVIOUS] = -1
    node[s, a, Node.FOLLOWING] = first
    if first >= 0:
        node[s, first, Node.PREVIOUS] = a
    work.order[s, degree, NodeList.LEAST] = a


@ti.func
def _leave(work: Ref, s, a):
    """Take a node out from those of its degree."""
    node = ti.static(work.node)
    previous = node[s, a, Node.PREVIOUS]
    following = node[s, a, Node.FOLLOWING]
    if previous >= 0:
        node[s, previous, Node.FOLLOWING] = following
    else:
        work.order[s, node[s, a, Node.DEGREE], NodeList.LEAST] = following
    if following >= 0:
        node[s, following, Node.PREVIOUS] = previous


@ti.func
def _mark_neighbors(work: Ref, s, a):
    """Mark the neighbors of `a`, and drop those that were eliminated."""
    before = -1
    half = work.node[s, a, Node.FIRST]
    while half >= 0:
        neighbor = work.half[s, half, HalfEdge.TARGET]
        following = work.half[s, half, HalfEdge.NEXT]
        if work.node[s, neighbor, Node.DEGREE] != ELIMINATED:
            work.node[s, neighbor, Node.MARKED_BY] = a
            work.node[s, neighbor, Node.MARK] = half
            before = half
        elif before < 0:
            work.node[s, a, Node.FIRST] = following
        else:
            work.half[s, before, HalfEdge.NEXT] = following
        half = following


@ti.func
def _join_neighbors(work: Ref, s, k):
    """Take `k` out, and join its neighbors to each other; return how many these are."""
    _leave(work, s, k)
    work.node[s, k, Node.DEGREE] = ELIMINATED
    near = 0
    half = work.node[s, k, Node.FIRST]
    while half >= 0:
        a = work.half[s, half, HalfEdge.TARGET]
        _leave(work, s, a)
        work.node[s, a, Node.DEGREE] = work.node[s, a, Node.DEGREE] - 1
        work.node[s, a, Node.PLACE] = near
        work.order[s, near, NodeList.NEAR] = a
        near += 1
        half = work.half[s, half, HalfEdge.NEXT]
    for n in range(near):
        a = work.order[s, n, NodeList.NEAR]
        _mark_neighbors(work, s, a)
        for m in range(near):
            b = work.order[s, m, NodeList.NEAR]
            if a < b and work.node[s, b, Node.MARKED_BY] != a:
                _add_edge(work, s, a, b)
    return near


@ti.func
def _transposed(work: Ref, s, place):
    """Read the columns of a block as rows."""
    b = ti.static(work.block)
    return [
        ti.Vector([
            b[s, place, 0][j], b[s, place, 1][j], b[s, place, 2][j],
            b[s, place, 3][j], b[s, place, 4][j], b[s, place, 5][j], 0.0, 0.0,
        ])
        for j in range(6)
    ]  # fmt: skip


@ti.func
def _eliminate(work: Ref, s, k, before, width):
    """Eliminate node `k`: C' replaces its block, y its load in `motion`, and Z_a those of edges.

    `before` nodes of its group went before it, and the panel has `width` blocks a neighbor.
    """
    block = ti.static(work.block)
    panel = ti.static(work.panel)
    motion = ti.static(work.motion)
    pivot_row = 6 * width * work.node[s, k, Node.PLACE]
    # The lower triangle gives the factor. Rounding makes the upper one of rigid robots differ.
    c = _transposed(work, s, k)
    subtract_product(c, panel, s, pivot_row, pivot_row, 6 * before)
    factorize(c)
    y = 1.0 * motion[s, k]
    solve_lower(c, y)
    for i in ti.static(range(6)):
        block[s, k, i] = c[i]
    motion[s, k] = y
    half = work.node[s, k, Node.FIRST]
    while half >= 0:
        a = work.half[s, half, HalfEdge.TARGET]
        edge = half // 2
        row = 6 * width * work.node[s, a, Node.PLACE]
        z = [1.0 * block[s, edge, i] for i in range(6)]
        if a < k:  # the block is that of the lower number, K_ak = K_ka'
            turned = _transposed(work, s, edge)
            for i in ti.static(range(6)):
                z[i] = turned[i]
        subtract_product(z, panel, s, pivot_row, row, 6 * before)
        solve_rows(c, z)
        # f_a -= Z_a' y
        load = 1.0 * motion[s, a]
        for i in ti.static(range(6)):
            load = load - y[i] * z[i]
            block[s, edge, i] = z[i]
            panel[s, row + 6 * before + i] = z[i]
        motion[s, a] = load
        half = work.half[s, half, HalfEdge.NEXT]


@ti.func
def _eliminate_group(work: Ref, s, k, step, near):
    """Eliminate `k`, then those of its neighbors that have no others; return how many these were.

    All have the same neighbors left, so that what they take from a block is subtracted at once.
    """
    width = ti.min(GROUP, work.panel.shape[1] // (6 * ti.max(near, 1)))
    count = 0
    neighbors = 0
    while k >= 0:
        work.order[s, step + count, NodeList.PIVOT] = k
        work.node[s, k, Node.DEGREE] = ELIMINATED
        _mark_neighbors(work, s, k)
        _eliminate(work, s, k, count, width)
        count += 1
        neighbors = 0
        half = work.node[s, k, Node.FIRST]
        k = -1
        while half >= 0:
            a = work.half[s, half, HalfEdge.TARGET]
            work.order[s, neighbors, NodeList.NEAR] = a
            neighbors += 1
            if count < width and work.node[s, a, Node.DEGREE] == near - 1:
                k = a
            half = work.half[s, half, HalfEdge.NEXT]
    for n in range(neighbors):
        a = work.order[s, n, NodeList.NEAR]
        _mark_neighbors(work, s, a)
        row_a = 6 * width * work.node[s, a, Node.PLACE]
        # K_ab -= sum over the group of Z_a' Z_b
        for m in range(neighbors):
            b = work.order[s, m, NodeList.NEAR]
            if a <= b:
                target = a if a == b else work.node[s, b, Node.MARK] // 2
                row_b = 6 * width * work.node[s, b, Node.PLACE]
                rest = [1.0 * work.block[s, target, i] for i in range(6)]
                subtract_product(rest, work.panel, s, row_a, row_b, 6 * count)
                for i in ti.static(range(6)):
                    work.block[s, target, i] = rest[i]
        work.node[s, a, Node.DEGREE] = work.node[s, a, Node.DEGREE] - count + 1
        _enter(work, s, a)
    return count


@ti.func
def _list_by_degree(work: Ref, s, nodes):
    """Put all nodes in front of those of their degrees."""
    for degree in range(nodes + 1):
        work.order[s, degree, NodeList.LEAST] = -1
    for a in range(nodes):
        _enter(work, s, a)


@ti.func
def _strip(work: Ref, s, nodes, most):
    """Take nodes of at most `most` neighbors out of a graph, and list them, without numbers.

    What is left is the core; the search ends early without room for its edges.
    """
    _list_by_degree(work, s, nodes)
    least = 0
    step = 0
    while least <= most and step < nodes and work.block_count[s] <= work.block.shape[1]:
        k = work.order[s, least, NodeList.LEAST]
        if k < 0:
            least += 1
        else:
            work.order[s, step, NodeList.PIVOT] = k
            step += 1
            for n in range(_join_neighbors(work, s, k)):
                _enter(work, s, work.order[s, n, NodeList.NEAR])
            least = ti.max(least - 1, 0)


@ti.func
def _back(work: Ref, s, k):
    """Find the motion of `k` from those that were eliminated later."""
    # u_k = C^-T (y - sum_a Z_a u_a)
    rest = 1.0 * work.motion[s, k]
    half = work.node[s, k, Node.FIRST]
    while half >= 0:
        moved = work.motion[s, work.half[s, half, HalfEdge.TARGET]]
        for i in ti.static(range(6)):
            product = work.block[s, half // 2, i] * moved
            for j in ti.static(range(6)):
                rest[i] = rest[i] - product[j]
        half = work.half[s, half, HalfEdge.NEXT]
    c = [1.0 * work.block[s, k, i] for i in range(6)]
    solve_upper(c, rest)
    work.motion[s, k] = rest


@ti.func
def solve(work: Ref, s, nodes):
    """Solve a system; return whether there was room for the edges."""
    _list_by_degree(work, s, nodes)
    least = 0
    step = 0
    while step < nodes:
        while work.order[s, least, NodeList.LEAST] < 0:
            least += 1
        k = work.order[s, least, NodeList.LEAST]
        near = _join_neighbors(work, s, k)
        if work.block_count[s] > work.block.shape[1]:
            break
        count = _eliminate_group(work, s, k, step, near)
        step += count
        # Neighbors lose no more than the group, so that the least degree falls by no more.
        least = ti.max(least - count, 0)
    has_room = work.block_count[s] <= work.block.shape[1]
    if has_room:
        for back in range(nodes):
            _back(work, s, work.order[s, nodes - 1 - back, NodeList.PIVOT])
    return has_room


@ti.func
def solve_again(work: Ref, s, nodes):
    """Solve a system that `solve` has eliminated for the loads that `motion` has now."""
    for step in range(nodes):
        k = work.order[s, step, NodeList.PIVOT]
        c = [1.0 * work.block[s, k, i] for i in range(6)]
        y = 1.0 * work.motion[s, k]
        solve_lower(c, y)
        work.motion[s, k] = y
        # f_a -= Z_a' y
        half = work.node[s, k, Node.FIRST]
        while half >= 0:
            a = work.half[s, half, HalfEdge.TARGET]
            load = 1.0 * work.motion[s, a]
            for i in ti.static(range(6)):
                load = load - y[i] * work.block[s, half // 2, i]
            work.motion[s, a] = load
            half = work.half[s, half, HalfEdge.NEXT]
    for back in range(nodes):
        _back(work, s, work.order[s, nodes - 1 - back, NodeList.PIVOT])


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


GROUND = -1
"""Second end of a beam that stands on the ground, in place of a node or dock."""
NO_DOCK = -2
"""End of a link, which joins the parts of one robot, in place of a dock."""


class FrameArrays(NamedTuple):
    """Frames of S structures with room for M nodes, B beams, and N robots of n docks each."""

    node_count: Ints1
    """Nodes in use, shape (S,)."""

    beam_count: Ints1
    """Beams in use, shape (S,)."""

    ends: Ints3
    """What each beam joins, columns of `BeamEnds`, shape (S, B, 4)."""

    stiffness: Reals4
    """Of each beam between its nodes: K_aa, K_ab, K_ba, K_bb, shape (S, 4 B, 6, 6)."""

    span: Reals3
    """First to second end of each beam [R], shape (S, B, 3)."""

    arm: Reals3
    """Center to dock [R], shape (S, n N, 3)."""

    weight: Rows
    """Force and moment of the weight on each node, shape (S, M, 8)."""

    slip: Reals3
    """By how much the ground under each dock has moved: a foot that rests on it opens and slides
    so, and one that is held has none [R], shape (S, n N, 3)."""


class ContactSection(Columns):
    """Columns of the loads in the section of a contact."""

    AXIAL = 1
    """Pull along it, negative where docks press."""
    SHEAR = 1
    """Force across it."""
    BENDING = 1
    """Moment that bends it."""
    TORSION = 1
    """Moment about it."""


class LoadArrays(NamedTuple):
    """Loads that follow; sizes as in `FrameArrays`."""

    acting: Rows
    """Force and moment of contacts and weight on each dock, shape (S, n N, 8)."""

    support: Reals3
    """Force of the second dock, or the ground, on the first of each contact, shape (S, B, 3)."""

    stress: Reals2
    """Largest von Mises stress in a section of each contact, shape (S, B)."""

    section: Reals3
    """Loads in that section, columns of `ContactSection`, shape (S, B, 4)."""

    sensed: Reals2
    """Load that each robot senses, shape (S, N)."""


@ti.kernel
def strip_to_core(
    most: I32, due: Ints1, node_count: Ints1, beam_count: Ints1, ends: Ints3,
    # EliminationArrays
    node_out: Ints3, order_out: Ints3, half_out: Ints3, block_count_out: Ints1, block_out: Blocks,
    panel_out: Rows, motion_out: Rows,
):  # fmt: skip
    """List nodes of few neighbors, by minimum degree, and leave the graph of the others.

    Args:
        most: Most neighbors that they may have when it is their turn.
        due: Structures, shape (n,).
        node_count, beam_count, ends: As in `FrameArrays`.
    """
    work = ti.static(
        EliminationArrays(
            node_out, order_out, half_out, block_count_out, block_out, panel_out, motion_out
        )
    )
    for n, idle in ti.ndrange(due.shape[0], GRAIN):
        if idle == 0:
            s = due[n]
            clear(work, s, node_count[s])
            for beam in range(beam_count[s]):
                a = ends[s, beam, BeamEnds.NODE_A]
                b = ends[s, beam, BeamEnds.NODE_B]
                if b >= 0:
                    edge_between(work, s, a, b)
            _strip(work, s, node_count[s], most)


@ti.func
def _assemble(frame: Ref, work: Ref, s):
    """Add up the beams' stiffnesses."""
    clear(work, s, frame.node_count[s])
    for a in range(frame.node_count[s]):
        work.motion[s, a] = frame.weight[s, a]
    for beam in range(frame.beam_count[s]):
        a = frame.ends[s, beam, BeamEnds.NODE_A]
        b = frame.ends[s, beam, BeamEnds.NODE_B]
        edge = -1
        if b >= 0:
            edge = edge_between(work, s, a, b)
        # The block of an edge has the rows of the lower node.
        block = ti.Vector([a, b, edge])
        part = ti.Vector([0, 3, 1 if a < b else 2])
        for n in range(3):
            if block[n] >= 0:
                for i in ti.static(range(6)):
                    row = stiffness_row(frame.stiffness, s, 4 * beam + part[n], i)
                    work.block[s, block[n], i] = work.block[s, block[n], i] + row
        if b < 0:
            slip = vector_in(frame.slip, s, frame.ends[s, beam, BeamEnds.DOCK_A])
            load = 1.0 * work.motion[s, a]
            for i in ti.static(range(6)):
                for c in ti.static(range(3)):
                    load[i] = load[i] - slip[c] * frame.stiffness[s, 4 * beam + 1, i, c]
            work.motion[s, a] = load


@ti.func
def _split(vector, axis):
    """Sizes of the parts along and across an axis."""
    along = vector.dot(axis)
    return ti.abs(along), (vector - along * axis).norm()


@ti.func
def _end_load(frame: Ref, motion: Ref, s, beam, end):
    """Find force and moment on an end of a beam: K times how both ends, or the ground, move."""
    load = ti.Vector.zero(F64, ROW_WIDTH)
    for moving in range(2):
        node = frame.ends[s, beam, BeamEnds.NODE_A + moving]
        part = 4 * beam + 2 * end + moving
        moved = ti.Vector.zero(F64, ROW_WIDTH)
        if node >= 0:
            moved = motion[s, node]
        else:
            slip = vector_in(frame.slip, s, frame.ends[s, beam, BeamEnds.DOCK_A])
            for c in ti.static(range(3)):
                moved[c] = slip[c]
        for i in ti.static(range(6)):
            for j in ti.static(range(6)):
                load[i] += moved[j] * frame.stiffness[s, part, i, j]
    return load


@ti.func
def _contact_loads(frame: Ref, loads: Ref, motion: Ref, s, beam, is_rigid, radius):
    """Find the forces that a contact puts on its docks, and its largest stress.

    The stress at the rim is the square root of sigma^2 + 3 tau^2, with sigma from axial force
    and bending and tau from shear and torsion. The section is halfway between two docks, and at
    the ground.
    """
    span = vector_in(frame.span, s, beam)
    is_foot = frame.ends[s, beam, BeamEnds.NODE_B] < 0
    for end in range(2):
        dock = frame.ends[s, beam, BeamEnds.DOCK_A + end]
        if dock >= 0:
            load = _end_load(frame, motion, s, beam, end)
            force = ti.Vector([load[c] for c in range(3)])
            moment = ti.Vector([load[3 + c] for c in range(3)])
            if is_rigid:
                moment = moment - vector_in(frame.arm, s, dock).cross(force)
            acting = 1.0 * loads.acting[s, dock]
            for c in ti.static(range(3)):
                acting[c] = acting[c] - force[c]
                acting[3 + c] = acting[3 + c] - moment[c]
            loads.acting[s, dock] = acting
            if end == 0:
                section = span if is_foot else 0.5 * span
                axis = span.normalized()
                pull, shear = _split(force, axis)
                torque, bend = _split(moment - section.cross(force), axis)
                area = ti.math.pi * radius**2
                modulus = 0.25 * ti.math.pi * radius**3
                sigma = pull / area + bend / modulus
                tau = 4.0 / 3.0 * shear / area + torque / (2.0 * modulus)
                loads.stress[s, beam] = ti.sqrt(sigma**2 + 3.0 * tau**2)
                loads.section[s, beam, ContactSection.AXIAL] = -force.dot(axis)
                loads.section[s, beam, ContactSection.SHEAR] = shear
                loads.section[s, beam, ContactSection.BENDING] = bend
                loads.section[s, beam, ContactSection.TORSION] = torque
                for c in ti.static(range(3)):
                    loads.support[s, beam, c] = -force[c]


@ti.func
def _sense(frame: Ref, loads: Ref, s, robot, docks):
    """Find the mean over a robot's links of |axial force| + |bending moment|."""
    total = 0.0
    for dock in range(docks * robot, docks * (robot + 1)):
        link = vector_in(frame.arm, s, dock).normalized()
        acting = loads.acting[s, dock]
        axial, _ = _split(ti.Vector([acting[c] for c in range(3)]), link)
        _, bending = _split(ti.Vector([acting[3 + c] for c in range(3)]), link)
        total += axial + bending
    loads.sensed[s, robot] = total / docks


@ti.kernel
def find_loads(
    radius: F64, gravity_x: F64, gravity_y: F64, gravity_z: F64, robots: Ints1, due: Ints1,
    is_solved: I32,
    # FrameArrays
    node_count: Ints1, beam_count: Ints1, ends: Ints3, stiffness: Reals4, span: Reals3,
    arm: Reals3, weight: Rows, slip: Reals3,
    # EliminationArrays
    node_out: Ints3, order_out: Ints3, half_out: Ints3, block_count_out: Ints1, block_out: Blocks,
    panel_out: Rows, motion_out: Rows,
    # LoadArrays
    acting_out: Rows, support_out: Reals3, stress_out: Reals2, section_out: Reals3,
    sensed_out: Reals2,
):  # fmt: skip
    """Find how structures move under their weight, and the loads in them.

    Args:
        radius: Of the beams [R].
        gravity_x, gravity_y, gravity_z: Weight of a dock.
        robots: Robots of each structure, shape (S,).
        due: Structures to solve, shape (n,).
        is_solved: Whether `motion` has how they move already.
    """
    frame = ti.static(FrameArrays(node_count, beam_count, ends, stiffness, span, arm, weight, slip))
    work = ti.static(
        EliminationArrays(
            node_out, order_out, half_out, block_count_out, block_out, panel_out, motion_out
        )
    )
    loads = ti.static(LoadArrays(acting_out, support_out, stress_out, section_out, sensed_out))
    for n, idle in ti.ndrange(due.shape[0], GRAIN):
        if idle == 0:
            s = due[n]
            docks = arm.shape[1] // sensed_out.shape[1]
            is_rigid = weight.shape[1] == sensed_out.shape[1]  # a robot is one node
            has_motion = is_solved
            if not is_solved:
                _assemble(frame, work, s)
                has_motion = ti.cast(solve(work, s, node_count[s]), ti.i32)
            if has_motion:
                for dock in range(docks * robots[s]):
                    acting_out[s, dock] = ti.Vector(
                        [gravity_x, gravity_y, gravity_z, 0.0, 0.0, 0.0, 0.0, 0.0], F64
                    )
                for beam in range(beam_count[s]):
                    if ends[s, beam, BeamEnds.DOCK_A] >= 0:
                        _contact_loads(frame, loads, motion_out, s, beam, is_rigid, radius)
                for robot in range(robots[s]):
                    _sense(frame, loads, s, robot, docks)


@ti.kernel
def find_foot_stiffness(
    due: Ints1, foot_count: Ints1, foot: Ints2,
    # FrameArrays
    node_count: Ints1, beam_count: Ints1, ends: Ints3, stiffness: Reals4, span: Reals3,
    arm: Reals3, weight: Rows, slip: Reals3,
    # EliminationArrays, as `find_loads` left them
    node_out: Ints3, order_out: Ints3, half_out: Ints3, block_count_out: Ints1, block_out: Blocks,
    panel_out: Rows, motion_out: Rows,
    # output
    response_out: Reals3,
):  # fmt: skip
    """Find the forces of the ground on all feet from a slip of 1 R of the ground under each.

    Args:
        due: Structures that `find_loads` has solved, shape (n,).
        foot_count: Feet of each of them, shape (n,).
        foot: Their beams to the ground, shape (n, F).
        response_out: Force at foot g along axis i is in row 3 g + i, the slip at foot h along axis
            j in column 3 h + j, shape (n, 3 F, 3 F).
    """
    frame = ti.static(FrameArrays(node_count, beam_count, ends, stiffness, span, arm, weight, slip))
    work = ti.static(
        EliminationArrays(
            node_out, order_out, half_out, block_count_out, block_out, panel_out, motion_out
        )
    )
    for n, idle in ti.ndrange(due.shape[0], GRAIN):
        if idle == 0:
            s = due[n]
            for column in range(3 * foot_count[n]):
                moved = foot[n, column // 3]
                for a in range(node_count[s]):
                    motion_out[s, a] = ti.Vector.zero(F64, ROW_WIDTH)
                # The ground moves by a unit vector; K_ab times it loads the foot's node.
                at = frame.ends[s, moved, BeamEnds.NODE_A]
                for c in ti.static(range(3)):
                    if column % 3 == c:
                        for i in ti.static(range(6)):
                            motion_out[s, at][i] = -frame.stiffness[s, 4 * moved + 1, i, c]
                solve_again(work, s, node_count[s])
                for g in range(foot_count[n]):
                    beam = foot[n, g]
                    motion = motion_out[s, frame.ends[s, beam, BeamEnds.NODE_A]]
                    for i in ti.static(range(3)):
                        force = 0.0
                        for j in ti.static(range(6)):
                            force += frame.stiffness[s, 4 * beam + 2, i, j] * motion[j]
                        for c in ti.static(range(3)):
                            if beam == moved and column % 3 == c:
                                force += frame.stiffness[s, 4 * beam + 3, i, c]
                        response_out[n, 3 * g + i, column] = force
