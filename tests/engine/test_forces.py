"""Eq. (1) between two docks, against the equation written out slowly, and its laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests import oracle
from tests.strategies import rotations, vectors
from tiswarm.compute.lang import Reals1, Reals2, ti
from tiswarm.engine.kernels import dock_pair_force

GAINS = (0.5, 0.3)
SPACING = 2.0


@ti.kernel
def _pair_force(offset: Reals2, gains: Reals1, ramp: float, force: Reals2):
    for i in range(offset.shape[0]):
        apart = ti.Vector([offset[i, 0], offset[i, 1], offset[i, 2]])
        pull = dock_pair_force(apart, gains[0], gains[1], gains[2], ramp)
        for c in ti.static(range(3)):
            force[i, c] = pull[c]


def _force(offset, ramp):
    force = np.empty((1, 3))
    _pair_force(np.array([offset]), np.array([*GAINS, SPACING]), ramp, force)
    return force[0]


@pytest.mark.parametrize("distance", [0.5, 1.9, 2.0, 2.1, 5.0])
@pytest.mark.parametrize("ramp", [0.0, 0.4, 1.0])
def test_force_matches_equation_1(distance, ramp):
    """The kernel agrees with Eq. (1) on both sides of the spacing."""
    offset = distance * np.array([1.0, 2.0, 2.0]) / 3.0

    actual = _force(offset, ramp)

    expected = oracle.dock_pair_force(offset, *GAINS, SPACING, ramp)
    np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-15)


@given(offset=vectors, ramp=st.floats(0, 1))
def test_pair_forces_cancel(offset, ramp):
    """Two docks push each other equally hard, even where they coincide."""
    there, back = _force(offset, ramp), _force(-offset, ramp)

    assert np.isfinite(there).all()
    np.testing.assert_array_equal(there, -back)


@given(offset=vectors, turn=rotations, ramp=st.floats(0, 1))
def test_force_turns_with_the_world(offset, turn, ramp):
    """Rotating the offset rotates the force."""
    rotation = Rotation.from_quat(turn, scalar_first=True)

    turned = _force(rotation.apply(offset), ramp)

    np.testing.assert_allclose(turned, rotation.apply(_force(offset, ramp)), atol=1e-11)


@given(offset=vectors, ramp=st.floats(0, 0.99))
def test_overlapping_docks_part_and_distant_ones_meet(offset, ramp):
    """The force points away from a dock closer than D and toward one farther than D."""
    distance = np.linalg.norm(offset)
    if distance < 1e-3 or abs(distance - SPACING) < 1e-3:
        return
    along = _force(offset, ramp) @ offset

    assert along < 0 if distance < SPACING else along >= 0
