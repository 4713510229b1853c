"""Elimination by panels solves what a dense solver does."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests import frames
from tiswarm.compute import backend
from tiswarm.world.frame_kernels import GROUND, NO_DOCK
from tiswarm.world.panels import PanelSolver

SIDE = 6

SOLVER = PanelSolver()
"""One for all examples: what it has reserved for one system, it uses again for others."""


def _random_beams(rng, nodes, count):
    """Beams between random nodes, one from each node to the ground, and random stiffnesses."""
    ends = np.full((nodes + count, 4), NO_DOCK, np.int32)
    ends[:nodes, 0] = rng.permutation(nodes)
    ends[:nodes, 1] = GROUND
    for beam in range(nodes, nodes + count):
        ends[beam, :2] = rng.choice(nodes, 2, replace=False)
    root = rng.normal(size=(nodes + count, 2 * SIDE, 2 * SIDE))
    return ends, root @ root.swapaxes(1, 2) + np.eye(2 * SIDE)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32), nodes=st.integers(1, 40), degree=st.floats(0.0, 8.0))
@example(seed=0, nodes=40, degree=60.0)
@example(seed=0, nodes=25, degree=1.5)
def test_motion_is_that_of_a_dense_solver(seed, nodes, degree):
    """Graphs from no beams to all, some in pieces, some joined twice, in any order."""
    rng = np.random.default_rng(seed)
    count = round(degree * nodes / 2) if nodes > 1 else 0
    ends, stiffness = _random_beams(rng, nodes, count)
    load = rng.normal(size=(nodes, SIDE))
    parts = stiffness.reshape(-1, 2, SIDE, 2, SIDE).swapaxes(2, 3).reshape(-1, SIDE, SIDE)
    order = rng.permutation(nodes).astype(np.int32)
    backend.processor()

    motion = SOLVER.solve(order, ends, np.ascontiguousarray(parts), frames.in_rows(load))[:, :SIDE]

    matrix = np.zeros((nodes, SIDE, nodes, SIDE))
    for (a, b, *_), beam in zip(ends, stiffness.reshape(-1, 2, SIDE, 2, SIDE), strict=True):
        joined = [(0, a)] if b == GROUND else [(0, a), (1, b)]
        for i, row in joined:
            for j, column in joined:
                matrix[row, :, column] += beam[i, :, j]
    matrix = matrix.reshape(SIDE * nodes, SIDE * nodes)
    expected = np.linalg.solve(matrix, load.ravel()).reshape(nodes, SIDE)
    # Residuals of the two are some units in the last place of the greatest number.
    tolerance = 1e-13 * np.linalg.cond(matrix) * np.abs(expected).max()
    np.testing.assert_allclose(motion, expected, rtol=0.0, atol=tolerance)


def test_what_nothing_holds_is_no_number():
    """A pivot that is not positive gives NaN for all nodes of its part, and for no others."""
    ends, stiffness = _random_beams(np.random.default_rng(1), 4, 2)
    ends[4:, :2] = [[0, 1], [2, 3]]
    parts = stiffness.reshape(-1, 2, SIDE, 2, SIDE).swapaxes(2, 3).reshape(-1, SIDE, SIDE)
    beam = {int(node): number for number, node in enumerate(ends[:4, 0])}
    for node in (0, 1):
        parts[4 * beam[node]] = -1e3 * np.eye(SIDE)
    backend.processor()

    order = np.arange(4, dtype=np.int32)
    load = frames.in_rows(np.ones((4, SIDE)))
    motion = SOLVER.solve(order, ends, np.ascontiguousarray(parts), load)[:, :SIDE]

    assert np.isnan(motion[:2]).all()
    assert np.isfinite(motion[2:]).all()
