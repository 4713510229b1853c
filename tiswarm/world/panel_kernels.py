"""Panels: how a kernel finds how the nodes of one large structure move, in a given order.

Elimination is that of `frame_kernels`, but nodes that follow each other and have the same
neighbors left form a panel, and each panel has a front: a dense symmetric matrix of its nodes and
of these neighbors, its rows. A beam is added to the front in which the first of its nodes is
eliminated. What the nodes of a panel take from its rows is its update: it is added to the front
of the panel that has the first of these rows. Panels follow each other so that updates form a
stack (multifrontal method, Duff and Reid, 1983).

A block K_ij of a front is one of `block_kernels`; node i goes before node j.
"""

from typing import NamedTuple

from tiswarm.compute.lang import F64, Columns, Ints1, Ints2, Reals4, Ref, ti
from tiswarm.world.block_kernels import (
    ROW_WIDTH,
    Rows,
    factorize,
    solve_lower,
    solve_rows,
    solve_upper,
    stiffness_row,
    subtract_product,
)
from tiswarm.world.frame_kernels import BeamEnds


class OrderedNode(Columns):
    """Columns of `PanelArrays.node`."""

    RANK = 1
    """Its place in the order of elimination."""
    SEEN = 1
    """Rank of the node that had it among its neighbors last, or -1."""
    BEAM = 1
    """First of its beams whose other node is eliminated later, or -1."""
    FOLLOWING = 1
    """Next node of its panel, or -1."""
    PANEL = 1
    """First panel with this node as its first row, or -1."""
    PLACE = 1
    """Its place in the present front."""


class Panel(Columns):
    """Columns of `PanelArrays.panel`."""

    FIRST = 1
    """Its first node."""
    LAST = 1
    """Its last node."""
    NODES = 1
    """How many nodes it has."""
    ROW = 1
    """Its first row in `PanelArrays.row`."""
    ROWS = 1
    """How many rows it has."""
    PARENT = 1
    """Panel to whose front its update goes, or -1."""
    CHILD = 1
    """First panel whose update goes to its own front, or -1."""
    SIBLING = 1
    """Next panel with the same parent, or -1."""
    BLOCK = 1
    """First of its blocks of the factor."""
    UPDATE = 1
    """First block of its update on the stack."""


class Total(Columns):
    """Columns of `PanelArrays.total`, which say how much room a system needs."""

    PANELS = 1
    ROWS = 1
    """Rows of all panels, and of one node."""
    FACTOR = 1
    """Blocks of the factor."""
    UPDATES = 1
    """Most blocks of updates at any time."""
    FRONT = 1
    """Most blocks between rows of a front."""


class PanelArrays(NamedTuple):
    """Panels of one structure of M nodes and B beams, with room for R rows."""

    node: Ints2
    """Columns of `OrderedNode`, shape (M, 6)."""

    next_beam: Ints1
    """Next beam in the list of the same node, or -1, shape (B,)."""

    panel: Ints2
    """Columns of `Panel`, shape (M, 10)."""

    row: Ints1
    """Nodes that are the rows of panels, in the order of elimination, shape (R,)."""

    sequence: Ints1
    """Panels in the order in which they are eliminated, shape (M,)."""

    total: Ints1
    """Columns of `Total`, shape (5,)."""


class FactorArrays(NamedTuple):
    """Blocks, six rows each, that begin at a multiple of 64 bytes, shape (1, rows, 8)."""

    factor: Rows
    """K_ij, then Z or C', of the nodes i of a panel and all nodes j of its front: those of a j in
    succession."""

    update: Rows
    """Stack of updates: blocks between rows, as in `front`."""

    front: Rows
    """Blocks K_ij between rows i <= j of the present front, those of a j in succession."""

    motion: Rows
    """f of each node; then u, shape (1, M, 8)."""


@ti.func
def _triangle(count):
    """Blocks on and above the diagonal of a matrix of so many rows of blocks."""
    return count * (count + 1) // 2


@ti.func
def _link_beams(arrays: Ref, order: Ref, ends: Ref):
    """Rank nodes, and list beams by the node that is eliminated first."""
    node = ti.static(arrays.node)
    for rank in range(order.shape[0]):
        k = order[rank]
        node[k, OrderedNode.RANK] = rank
        node[k, OrderedNode.SEEN] = -1
        node[k, OrderedNode.BEAM] = -1
        node[k, OrderedNode.FOLLOWING] = -1
        node[k, OrderedNode.PANEL] = -1
    for beam in range(ends.shape[0]):
        a = ends[beam, BeamEnds.NODE_A]
        b = ends[beam, BeamEnds.NODE_B]
        if b >= 0 and node[b, OrderedNode.RANK] < node[a, OrderedNode.RANK]:
            a = b
        arrays.next_beam[beam] = node[a, OrderedNode.BEAM]
        node[a, OrderedNode.BEAM] = beam


@ti.func
def _list_row(arrays: Ref, a, rank, first, count):
    """Append a neighbor to the rows from `first` on, unless it is there; return their number."""
    if arrays.node[a, OrderedNode.SEEN] != rank:
        arrays.node[a, OrderedNode.SEEN] = rank
        if first + count < arrays.row.shape[0]:
            arrays.row[first + count] = a
        count += 1
    return count


@ti.func
def _list_rows(arrays: Ref, ends: Ref, k, first):
    """List the neighbors that a node has when it is eliminated; return how many these are.

    They are those of its beams, and the rows of panels whose first row it is.
    """
    rank = arrays.node[k, OrderedNode.RANK]
    count = 0
    beam = arrays.node[k, OrderedNode.BEAM]
    while beam >= 0:
        if ends[beam, BeamEnds.NODE_B] >= 0:
            a = ends[beam, BeamEnds.NODE_A] + ends[beam, BeamEnds.NODE_B] - k
            count = _list_row(arrays, a, rank, first, count)
        beam = arrays.next_beam[beam]
    child = arrays.node[k, OrderedNode.PANEL]
    while child >= 0:
        row = arrays.panel[child, Panel.ROW]
        for n in range(row + 1, row + arrays.panel[child, Panel.ROWS]):
            count = _list_row(arrays, arrays.row[n], rank, first, count)
        child = arrays.panel[child, Panel.SIBLING]
    return count


@ti.func
def _sort(arrays: Ref, first, count):
    """Sort rows by rank: few are out of place."""
    for n in range(first + 1, first + count):
        a = arrays.row[n]
        place = n
        while (
            place > first
            and arrays.node[arrays.row[place - 1], OrderedNode.RANK]
            > arrays.node[a, OrderedNode.RANK]
        ):
            arrays.row[place] = arrays.row[place - 1]
            place -= 1
        arrays.row[place] = a


@ti.func
def _assign(arrays: Ref, k, first, count, panels):
    """Put a node into a panel that has the same rows but for the node, or into a new one.

    Returns its panel, where `panels` stands for a new one.
    """
    node = ti.static(arrays.node)
    panel = ti.static(arrays.panel)
    p = panels
    child = node[k, OrderedNode.PANEL]
    while child >= 0:
        if panel[child, Panel.ROWS] - 1 == count:
            p = child
        child = panel[child, Panel.SIBLING]
    if p == panels:
        panel[p, Panel.FIRST] = k
        panel[p, Panel.NODES] = 1
        panel[p, Panel.ROW] = first
        panel[p, Panel.ROWS] = count
        panel[p, Panel.CHILD] = -1
        _sort(arrays, first, count)
    else:
        node[panel[p, Panel.LAST], OrderedNode.FOLLOWING] = k
        panel[p, Panel.NODES] = panel[p, Panel.NODES] + 1
        panel[p, Panel.ROW] = panel[p, Panel.ROW] + 1
        panel[p, Panel.ROWS] = panel[p, Panel.ROWS] - 1
    panel[p, Panel.LAST] = k
    panel[p, Panel.PARENT] = -1
    child = node[k, OrderedNode.PANEL]
    while child >= 0:
        following = panel[child, Panel.SIBLING]
        if child != p:
            panel[child, Panel.SIBLING] = panel[p, Panel.CHILD]
            panel[p, Panel.CHILD] = child
            panel[child, Panel.PARENT] = p
        child = following
    if panel[p, Panel.ROWS] > 0:
        next_node = arrays.row[panel[p, Panel.ROW]]
        panel[p, Panel.SIBLING] = node[next_node, OrderedNode.PANEL]
        node[next_node, OrderedNode.PANEL] = p
    return p


@ti.func
def _first_part(panel: Ref, p):
    """Find the panel that is eliminated first of those that a panel waits for."""
    while panel[p, Panel.CHILD] >= 0:
        p = panel[p, Panel.CHILD]
    return p


@ti.func
def _reserve(arrays: Ref, p, stack):
    """Find room for the blocks of a panel; return how many blocks of updates there are then."""
    panel = ti.static(arrays.panel)
    total = ti.static(arrays.total)
    nodes = panel[p, Panel.NODES]
    rows = panel[p, Panel.ROWS]
    panel[p, Panel.BLOCK] = total[Total.FACTOR]
    total[Total.FACTOR] = total[Total.FACTOR] + nodes * (nodes + rows)
    child = panel[p, Panel.CHILD]
    while child >= 0:
        stack -= _triangle(panel[child, Panel.ROWS])
        child = panel[child, Panel.SIBLING]
    panel[p, Panel.UPDATE] = stack
    stack += _triangle(rows)
    total[Total.UPDATES] = ti.max(total[Total.UPDATES], stack)
    total[Total.FRONT] = ti.max(total[Total.FRONT], _triangle(rows))
    return stack


@ti.kernel
def find_panels(
    order: Ints1, ends: Ints2,
    # PanelArrays
    node_out: Ints2, next_beam_out: Ints1, panel_out: Ints2, row_out: Ints1, sequence_out: Ints1,
    total_out: Ints1,
):  # fmt: skip
    """Find the panels of a structure; it stops where rows need more room, and says how much.

    Args:
        order: Nodes in the order of elimination, shape (M,).
        ends: What beams join, columns of `BeamEnds`, shape (B, 4).
    """
    arrays = ti.static(
        PanelArrays(node_out, next_beam_out, panel_out, row_out, sequence_out, total_out)
    )
    panel = ti.static(panel_out)
    for _ in range(1):
        for column in range(Total.TOTAL):
            total_out[column] = 0
        _link_beams(arrays, order, ends)
        panels = 0
        first = 0
        rank = 0
        while rank < order.shape[0] and total_out[Total.ROWS] <= row_out.shape[0]:
            count = _list_rows(arrays, ends, order[rank], first)
            total_out[Total.ROWS] = ti.max(total_out[Total.ROWS], first + count)
            if first + count <= row_out.shape[0]:
                p = _assign(arrays, order[rank], first, count, panels)
                if p == panels:
                    panels += 1
                    first += count
            rank += 1
        step = 0
        stack = 0
        for last in range(panels):
            # Those without rows end a part of the structure: all of its panels come before.
            p = -1
            if panel[last, Panel.ROWS] == 0:
                p = _first_part(panel, last)
            while p >= 0:
                sequence_out[step] = p
                step += 1
                stack = _reserve(arrays, p, stack)
                following = panel[p, Panel.SIBLING]
                if p == last:
                    p = -1
                elif following >= 0:
                    p = _first_part(panel, following)
                else:
                    p = panel[p, Panel.PARENT]
        total_out[Total.PANELS] = panels


@ti.func
def _clear(rows: Ref, first, count):
    """Set rows to 0."""
    for n in range(first, first + count):
        rows[0, n] = ti.Vector.zero(F64, ROW_WIDTH)


@ti.func
def _add_stiffness(rows: Ref, first, stiffness: Ref, part):
    """Add a block of a beam's stiffness to six rows."""
    for i in ti.static(range(6)):
        rows[0, first + i] = rows[0, first + i] + stiffness_row(stiffness, 0, part, i)


@ti.func
def _add_beams(arrays: Ref, work: Ref, ends: Ref, stiffness: Ref, p):
    """Add the beams to a front that nodes of the panel list."""
    nodes = arrays.panel[p, Panel.NODES]
    block = arrays.panel[p, Panel.BLOCK]
    k = arrays.panel[p, Panel.FIRST]
    while k >= 0:
        beam = arrays.node[k, OrderedNode.BEAM]
        while beam >= 0:
            place = ti.Vector([arrays.node[ends[beam, BeamEnds.NODE_A], OrderedNode.PLACE], -1])
            if ends[beam, BeamEnds.NODE_B] >= 0:
                place[1] = arrays.node[ends[beam, BeamEnds.NODE_B], OrderedNode.PLACE]
            # Of K_ab and K_ba one is stored.
            for a, b in ti.static(((0, 0), (0, 1), (1, 0), (1, 1))):
                i = place[a]
                j = place[b]
                part = 4 * beam + 2 * a + b
                if i >= 0 and (i < j or ti.static(a == b)):
                    if i < nodes:
                        _add_stiffness(work.factor, 6 * (block + nodes * j + i), stiffness, part)
                    else:
                        first = 6 * (_triangle(j - nodes) + i - nodes)
                        _add_stiffness(work.front, first, stiffness, part)
            beam = arrays.next_beam[beam]
        k = arrays.node[k, OrderedNode.FOLLOWING]


@ti.func
def _add_updates(arrays: Ref, work: Ref, p):
    """Add the updates to a front that go to it."""
    nodes = arrays.panel[p, Panel.NODES]
    block = arrays.panel[p, Panel.BLOCK]
    child = arrays.panel[p, Panel.CHILD]
    while child >= 0:
        row = arrays.panel[child, Panel.ROW]
        source = 6 * arrays.panel[child, Panel.UPDATE]
        for m in range(arrays.panel[child, Panel.ROWS]):
            j = arrays.node[arrays.row[row + m], OrderedNode.PLACE]
            for n in range(m + 1):
                i = arrays.node[arrays.row[row + n], OrderedNode.PLACE]
                if i < nodes:
                    first = 6 * (block + nodes * j + i)
                    for c in ti.static(range(6)):
                        work.factor[0, first + c] = (
                            work.factor[0, first + c] + work.update[0, source + c]
                        )
                else:
                    first = 6 * (_triangle(j - nodes) + i - nodes)
                    for c in ti.static(range(6)):
                        work.front[0, first + c] = (
                            work.front[0, first + c] + work.update[0, source + c]
                        )
                source += 6
        child = arrays.panel[child, Panel.SIBLING]


@ti.func
def _eliminate(arrays: Ref, work: Ref, p, n, k):
    """Eliminate node k, the n-th of its panel: C' replaces K_kk, y f_k, and Z_a K_ka."""
    factor = ti.static(work.factor)
    motion = ti.static(work.motion)
    nodes = arrays.panel[p, Panel.NODES]
    row = arrays.panel[p, Panel.ROW]
    block = arrays.panel[p, Panel.BLOCK]
    pivot = 6 * (block + nodes * n)
    c = [1.0 * factor[0, pivot + 6 * n + i] for i in range(6)]
    subtract_product(c, factor, 0, pivot, pivot, 6 * n)
    factorize(c)
    y = 1.0 * motion[0, k]
    solve_lower(c, y)
    for i in ti.static(range(6)):
        factor[0, pivot + 6 * n + i] = c[i]
    motion[0, k] = y
    a = arrays.node[k, OrderedNode.FOLLOWING]
    for j in range(n + 1, nodes + arrays.panel[p, Panel.ROWS]):
        if j >= nodes:
            a = arrays.row[row + j - nodes]
        first = 6 * (block + nodes * j)
        z = [1.0 * factor[0, first + 6 * n + i] for i in range(6)]
        subtract_product(z, factor, 0, pivot, first, 6 * n)
        solve_rows(c, z)
        # f_a -= Z_a' y
        load = 1.0 * motion[0, a]
        for i in ti.static(range(6)):
            load = load - y[i] * z[i]
            factor[0, first + 6 * n + i] = z[i]
        motion[0, a] = load
        a = arrays.node[a, OrderedNode.FOLLOWING]


@ti.func
def _put_on_stack(arrays: Ref, work: Ref, p):
    """Put the update of a panel on the stack: K_ab - sum over its nodes of Z_a' Z_b."""
    nodes = arrays.panel[p, Panel.NODES]
    first = 6 * (arrays.panel[p, Panel.BLOCK] + nodes**2)
    target = 6 * arrays.panel[p, Panel.UPDATE]
    source = 0
    for b in range(arrays.panel[p, Panel.ROWS]):
        for a in range(b + 1):
            rest = [1.0 * work.front[0, source + i] for i in range(6)]
            subtract_product(
                rest, work.factor, 0, first + 6 * nodes * a, first + 6 * nodes * b, 6 * nodes
            )
            for i in ti.static(range(6)):
                work.update[0, target + source + i] = rest[i]
            source += 6


@ti.func
def _back(arrays: Ref, work: Ref, p, n, k):
    """Find the motion of node k, the n-th of its panel, from those that were eliminated later."""
    factor = ti.static(work.factor)
    motion = ti.static(work.motion)
    nodes = arrays.panel[p, Panel.NODES]
    block = arrays.panel[p, Panel.BLOCK]
    products = [ti.Vector.zero(F64, ROW_WIDTH) for _ in range(6)]
    a = arrays.node[k, OrderedNode.FOLLOWING]
    for j in range(n + 1, nodes + arrays.panel[p, Panel.ROWS]):
        if j >= nodes:
            a = arrays.row[arrays.panel[p, Panel.ROW] + j - nodes]
        u = motion[0, a]
        first = 6 * (block + nodes * j + n)
        for i in ti.static(range(6)):
            products[i] = products[i] + factor[0, first + i] * u
        a = arrays.node[a, OrderedNode.FOLLOWING]
    # u_k = C^-T (y - sum_a Z_a u_a)
    u = 1.0 * motion[0, k]
    for i in ti.static(range(6)):
        u_i = u[i]
        for j in ti.static(range(6)):
            u_i -= products[i][j]
        u[i] = u_i
    pivot = 6 * (block + nodes * n + n)
    c = [1.0 * factor[0, pivot + i] for i in range(6)]
    solve_upper(c, u)
    motion[0, k] = u


@ti.kernel
def solve_by_panels(
    ends: Ints2, stiffness: Reals4,
    # PanelArrays, as `find_panels` left them
    node_out: Ints2, next_beam: Ints1, panel: Ints2, row: Ints1, sequence: Ints1, total: Ints1,
    # FactorArrays
    factor_out: Rows, update_out: Rows, front_out: Rows, motion_out: Rows,
):  # fmt: skip
    """Find how the nodes of a structure move under the loads in `motion`, and put that there.

    Args:
        ends: What beams join, columns of `BeamEnds`, shape (B, 4).
        stiffness: Of beams, as in `FrameArrays`, shape (1, 4 B, 6, 6).
    """
    arrays = ti.static(PanelArrays(node_out, next_beam, panel, row, sequence, total))
    work = ti.static(FactorArrays(factor_out, update_out, front_out, motion_out))
    for _ in range(1):
        for step in range(total[Total.PANELS]):
            p = sequence[step]
            nodes = panel[p, Panel.NODES]
            rows = panel[p, Panel.ROWS]
            k = panel[p, Panel.FIRST]
            for n in range(nodes):
                node_out[k, OrderedNode.PLACE] = n
                k = node_out[k, OrderedNode.FOLLOWING]
            for n in range(rows):
                node_out[row[panel[p, Panel.ROW] + n], OrderedNode.PLACE] = nodes + n
            _clear(factor_out, 6 * panel[p, Panel.BLOCK], 6 * nodes * (nodes + rows))
            _clear(front_out, 0, 6 * _triangle(rows))
            _add_beams(arrays, work, ends, stiffness, p)
            _add_updates(arrays, work, p)
            k = panel[p, Panel.FIRST]
            for n in range(nodes):
                _eliminate(arrays, work, p, n, k)
                k = node_out[k, OrderedNode.FOLLOWING]
            _put_on_stack(arrays, work, p)
        for back in range(total[Total.PANELS]):
            p = sequence[total[Total.PANELS] - 1 - back]
            # SEEN has served: it leads from a node of the panel to the one before it.
            before = -1
            k = panel[p, Panel.FIRST]
            for _n in range(panel[p, Panel.NODES]):
                node_out[k, OrderedNode.SEEN] = before
                before = k
                k = node_out[k, OrderedNode.FOLLOWING]
            for n in range(panel[p, Panel.NODES]):
                _back(arrays, work, p, panel[p, Panel.NODES] - 1 - n, before)
                before = node_out[before, OrderedNode.SEEN]
