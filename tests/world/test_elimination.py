"""Elimination over a graph solves what a dense solver does."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests import frames
from tiswarm.compute import backend
from tiswarm.compute.lang import Ints1, Ints2, Ints3, ti
from tiswarm.compute.numerics import aligned_zeros, native_vectors
from tiswarm.world.block_kernels import ROW_WIDTH, Blocks, Rows
from tiswarm.world.frame_kernels import (
    EliminationArrays,
    HalfEdge,
    Node,
    NodeList,
    clear,
    edge_between,
    solve,
)
from tiswarm.world.mechanics import Frames, MechanicsParams

SIDE = 6
FORCES = ("sensed", "contact_stress", "ground_stress", "ground_force")


@ti.kernel
def _solve_one(
    pairs: Ints2, coupling: Blocks, diagonal: Blocks, has_room_out: Ints1,
    node_out: Ints3, order_out: Ints3, half_out: Ints3, block_count_out: Ints1, block_out: Blocks,
    panel_out: Rows, motion_out: Rows,
):  # fmt: skip
    work = ti.static(EliminationArrays(
        node_out, order_out, half_out, block_count_out, block_out, panel_out, motion_out
    ))  # fmt: skip
    for _ in range(1):
        clear(work, 0, diagonal.shape[1])
        for a in range(diagonal.shape[1]):
            for i in ti.static(range(SIDE)):
                block_out[0, a, i] = diagonal[0, a, i]
        for p in range(pairs.shape[0]):
            edge = edge_between(work, 0, pairs[p, 0], pairs[p, 1])
            for i in ti.static(range(SIDE)):
                block_out[0, edge, i] = block_out[0, edge, i] + coupling[0, p, i]
        has_room_out[0] = ti.cast(solve(work, 0, diagonal.shape[1]), ti.i32)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32), nodes=st.integers(1, 40), degree=st.floats(0.0, 8.0))
@example(seed=0, nodes=40, degree=60.0)
def test_motion_is_that_of_a_dense_solver(seed, nodes, degree):
    """Graphs from no edges to all, some in pieces, some edges given twice.

    Where nearly all nodes are neighbors, more of them go together than a group holds.
    """
    rng = np.random.default_rng(seed)
    count = round(degree * nodes / 2) if nodes > 1 else 0
    pairs = np.sort([rng.choice(nodes, 2, replace=False) for _ in range(count)], axis=-1)
    pairs = pairs.reshape(-1, 2).astype(np.int32)
    coupling = rng.normal(size=(count, SIDE, SIDE))
    dense = np.zeros((nodes, nodes, SIDE, SIDE))
    for (a, b), each in zip(pairs, coupling, strict=True):
        dense[a, b] += each
        dense[b, a] += each.T
    dense[np.arange(nodes), np.arange(nodes)] = 50.0 * np.eye(SIDE) * (1.0 + degree)
    load, blocks = rng.normal(size=(nodes, SIDE)), nodes * (nodes + 1) // 2
    work = EliminationArrays(
        node=np.empty((1, nodes, Node.TOTAL), np.int32),
        order=np.empty((1, nodes + 1, NodeList.TOTAL), np.int32),
        half=np.empty((1, 2 * blocks, HalfEdge.TOTAL), np.int32),
        block_count=np.zeros(1, np.int32),
        block=aligned_zeros(1, blocks, SIDE, ROW_WIDTH),
        panel=aligned_zeros(1, SIDE * nodes, ROW_WIDTH),
        motion=frames.in_rows(load[None]),
    )
    has_room = np.zeros(1, np.int32)
    diagonal = frames.in_rows(dense[np.arange(nodes), np.arange(nodes)][None])
    backend.processor()

    with native_vectors():
        _solve_one(pairs, frames.in_rows(coupling[None]), diagonal, has_room, *work)

    matrix = dense.swapaxes(1, 2).reshape(SIDE * nodes, SIDE * nodes)
    expected = np.linalg.solve(matrix, load.ravel()).reshape(nodes, SIDE)
    assert has_room[0]
    np.testing.assert_allclose(work.motion[0, :, :SIDE], expected, rtol=0.0, atol=1e-12)


def _filled(structures, params, *, cramped=False):
    """Frames of some structures, with room for no edge and one beam where asked."""
    robots = max(len(each.center) for each in structures)
    built = Frames(params, docks=3, robots=robots, structures=len(structures))
    if cramped:
        nodes = built.work.motion.shape[1]
        built.work = built.work._replace(
            half=np.empty((len(structures), 2 * nodes, HalfEdge.TOTAL), np.int32),
            block=aligned_zeros(len(structures), nodes, SIDE, ROW_WIDTH),
        )
        few = {name: getattr(built.frame, name)[:, :1] for name in ("ends", "span")}
        built.frame = built.frame._replace(**few, stiffness=built.frame.stiffness[:, :4])
    for number, structure in enumerate(structures):
        for j in range(len(structure.center)):
            frames.join(built, number, structure, j)
    built.solve(range(len(structures)))
    return built


@pytest.mark.parametrize("model", ["flexible", "rigid"])
def test_room_and_company_change_no_bit(towers, cantilevers, model):
    """Arrays grow where they are too small, and structures in one batch are independent."""
    params = MechanicsParams(model=model)
    structures = [frames.grown(history, 12) for history in (*towers, *cantilevers)]

    together = _filled(structures, params, cramped=True)

    for number, structure in enumerate(structures):
        alone = _filled([structure], params).loads(0)
        for name in FORCES:
            found = getattr(together.loads(number), name)
            np.testing.assert_array_equal(found, getattr(alone, name))
