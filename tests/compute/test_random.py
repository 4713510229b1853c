"""Random numbers depend on their four arguments and on nothing else."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tiswarm.compute import random

whole = st.integers(0, 2**40)


@given(seed=whole, robot=whole, draw=whole)
def test_a_number_does_not_depend_on_company(seed, robot, draw):
    """Asked alone or in a table, the same arguments give the same number."""
    alone = random.uniform(seed, "spawn", robot, draw)
    table = random.uniform(seed, "spawn", [[robot], [robot + 1]], [draw + 5, draw])

    assert table.shape == (2, 2)
    assert table[0, 1] == alone


def test_every_argument_matters():
    """Neighbouring seeds, streams, robots and draws are different numbers."""
    numbers = [
        random.uniform(seed, stream, robot, draw).item()
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
        uniform = random.uniform(3, "spawn", robot, draw)
        normal = random.normal(3, "spawn", robot, draw)

        assert stats.kstest(uniform, "uniform").pvalue > 1e-3
        assert stats.kstest(normal, "norm").pvalue > 1e-3
        assert abs(np.corrcoef(uniform[1:], uniform[:-1])[0, 1]) < 0.03
