"""Random numbers depend on their four arguments alone; rotations are those of scipy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from tiswarm.compute.lang import Reals2, ti
from tiswarm.compute.math import normal, uniform
from tiswarm.compute.math_kernels import mixed, rotate
from tiswarm.world.climb_kernels import axis_rotation, quaternion_product

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


@ti.kernel
def _turn(first: Reals2, second: Reals2, vector: Reals2):
    """Compose with `first` a turn by the length of a vector about it, into `second`; turn that."""
    for k in range(first.shape[0]):
        p = ti.Vector([first[k, c] for c in range(4)])
        v = ti.Vector([vector[k, c] for c in range(3)])
        composed = quaternion_product(p, axis_rotation(v / v.norm(), v.norm()))
        turned = rotate(composed, v + ti.Vector([1.0, 2.0, 3.0]))
        for c in ti.static(range(4)):
            second[k, c] = composed[c]
        for c in ti.static(range(3)):
            vector[k, c] = turned[c]


def test_kernels_compose_and_apply_rotations():
    """In any directions: flips of robots that stand level are about special axes."""
    draw = np.random.default_rng(0)
    first, vector = Rotation.from_rotvec(draw.normal(size=(20, 3))), draw.normal(size=(20, 3))
    wxyz, composed, turned = first.as_quat(scalar_first=True), np.empty((20, 4)), vector.copy()

    _turn(wxyz, composed, turned)

    expected = first * Rotation.from_rotvec(vector)
    found = Rotation.from_quat(composed, scalar_first=True)
    np.testing.assert_allclose((found * expected.inv()).magnitude(), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(composed, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(turned, expected.apply(vector + np.arange(1.0, 4.0)), atol=1e-12)
