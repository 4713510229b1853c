"""Random numbers depend on their four arguments and on nothing else."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tiswarm.compute.lang import Reals2, ti
from tiswarm.compute.math import normal, uniform
from tiswarm.compute.math_kernels import mixed

whole = st.integers(0, 2**40)


@given(seed=whole, robot=whole, draw=whole)
def test_a_number_does_not_depend_on_company(seed, robot, draw):
    """Asked alone or in a table, the same arguments give the same number."""
    alone = uniform(seed, "spawn", robot, draw)
    table = uniform(seed, "spawn", [[robot], [robot + 1]], [draw + 5, draw])

    assert table.shape == (2, 2)
    assert table[0, 1] == alone


def test_every_argument_matters():
    """Neighbouring seeds, streams, robots and draws are different numbers."""
    numbers = [
        uniform(seed, stream, robot, draw).item()
        for seed in (0, 1)
        for stream in ("spawn", "orientation")
        for robot in (0, 1)
        for draw in (0, 1)
    ]

    assert len(set(numbers)) == 16


def test_numbers_are_uniform_and_normal():
    """Kolmogorov and Smirnov find nothing odd, along robots and along draws."""
    along = np.arange(20_000)
    for robot, draw in ((along, 0), (0, along)):
        even = uniform(3, "spawn", robot, draw)

        assert stats.kstest(even, "uniform").pvalue > 1e-3
        assert stats.kstest(normal(3, "spawn", robot, draw), "norm").pvalue > 1e-3
        assert abs(np.corrcoef(even[1:], even[:-1])[0, 1]) < 0.03


@ti.kernel
def _mix(table: Reals2):
    for i, j in ti.ndrange(table.shape[0], table.shape[1]):
        table[i, j] = ti.cast(mixed(mixed(ti.cast(i, ti.u64)) ^ ti.cast(j, ti.u64)), ti.f64)


def test_kernels_mix_well():
    """Chained hashes of small numbers are uniform, and neighbors have nothing in common."""
    table = np.empty((150, 150))

    _mix(table)

    unit = table / 2.0**32
    assert stats.kstest(unit.ravel(), "uniform").pvalue > 1e-3
    for shift in ((0, 1), (1, 0), (1, 1)):
        moved = np.roll(unit, shift, axis=(0, 1))
        assert abs(np.corrcoef(unit.ravel(), moved.ravel())[0, 1]) < 0.03
