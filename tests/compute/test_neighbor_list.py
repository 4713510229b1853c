"""The neighbor list's hash, for swarms of any shape."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tiswarm.compute.neighbor_kernels import LONGEST_RUN
from tiswarm.compute.neighbor_list import FEWEST_BUCKETS, hash_strides, morton_order

SIDE = st.floats(0.0, 1e12)


@given(extent=st.tuples(SIDE, SIDE, SIDE), doublings=st.integers(0, 20))
def test_cells_around_a_dock_never_share_a_bucket(extent, doublings):
    """So no neighbor is counted twice: four runs of cells, to either side along y and z."""
    buckets = FEWEST_BUCKETS << doublings
    stride_y, stride_z = hash_strides(np.array(extent), 2.5, buckets)

    for side_y in (-stride_y, stride_y):
        for side_z in (-stride_z, stride_z):
            first = np.array([0, side_y, side_z, side_y + side_z])
            run = (first[:, None] + np.arange(LONGEST_RUN)) % buckets
            assert len(np.unique(run)) == 4 * LONGEST_RUN


def test_neighbors_along_the_curve_are_neighbors_in_space():
    """Order of the corners of a cube, and structures apart."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    order = morton_order(corner, np.zeros(8, np.int64))
    assert corner[order].tolist() == sorted(corner.tolist(), key=lambda c: c[::-1])
    assert morton_order(corner, np.arange(8)[::-1]).tolist() == list(range(8))[::-1]
