"""A chained cell list finds what a search through everything finds."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tiswarm.compute.lang import Ints1, Ints2, Reals2, ti
from tiswarm.compute.neighbor_kernels import CellList, cube_of, first_item, link, relink


@ti.kernel
def _count_near(
    before: Reals2, point: Reals2, reach: float, head: Ints2, following: Ints2, count: Ints1
):
    cells = ti.static(CellList(head, following))
    ti.loop_config(serialize=True)
    for i in range(point.shape[0]):
        here = ti.Vector([before[i, 0], before[i, 1], before[i, 2]])
        link(cells, 0, i, cube_of(here, 1.0 / reach))
    ti.loop_config(serialize=True)
    for i in range(point.shape[0]):
        old = ti.Vector([before[i, 0], before[i, 1], before[i, 2]])
        new = ti.Vector([point[i, 0], point[i, 1], point[i, 2]])
        relink(cells, 0, i, cube_of(old, 1.0 / reach), cube_of(new, 1.0 / reach))
    for i in range(point.shape[0]):
        here = ti.Vector([point[i, 0], point[i, 1], point[i, 2]])
        for which in range(27):
            item = first_item(cells, 0, cube_of(here, 1.0 / reach), which)
            while item >= 0:
                other = ti.Vector([point[item, 0], point[item, 1], point[item, 2]])
                if (other - here).norm() < reach:
                    count[i] += 1
                item = following[0, item]


@given(
    seed=st.integers(0, 1000),
    size=st.integers(1, 300),
    stretch=st.sampled_from([(5.0, 5.0, 5.0), (1e4, 1.0, 1.0), (1e5, 1e5, 1e5), (0.0, 0.0, 9.0)]),
)
def test_nothing_is_missed_or_found_twice(seed, size, stretch):
    """Dense, tall, far and negative places, points that coincide and points that have moved."""
    rng = np.random.default_rng(seed)
    point = (rng.random((size, 3)) - 0.5) * stretch
    point[size // 2] = point[0]
    moved = point + rng.normal(scale=2.0, size=point.shape)
    cells = CellList.allocate(1, size)
    count = np.zeros(size, np.int32)

    _count_near(moved, point, 1.5, *cells, count)

    apart = np.linalg.norm(point[:, None] - point[None], axis=2)
    np.testing.assert_array_equal(count, (apart < 1.5).sum(axis=1))
