"""Whole numbers of a unit hold a swarm, as finely as they can."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import vectors
from tiswarm.engine.stepping import Places

LARGEST = 2.0**29
"""Half of the box around a swarm at first, in units."""


@given(
    centers=st.lists(vectors, min_size=1, max_size=5),
    power=st.floats(0.0, 4.0),
    height=st.floats(-1e3, 1e3) | st.just(np.nan),
    reach=st.floats(1.0, 10.0),
    spacing=st.floats(0.5, 4.0),
)
def test_the_unit_is_the_finest_that_holds_all_robots(centers, power, height, reach, spacing):
    """Their heights, too, with a margin; half of it would hold too little."""
    center = 10.0**power * np.array(centers)

    places = Places.choose(center, np.array([height]), reach=reach, spacing=spacing)

    known = center[:, 2] if np.isnan(height) else np.append(center[:, 2], height)
    half = max(np.ptp(center[:, 0]), np.ptp(center[:, 1]), np.ptp(known)) / 2.0
    half = max(half + reach, 2.0 * reach, 32.0 * spacing)
    assert np.log2(places.unit) % 1.0 == 0.0
    room = LARGEST * places.unit
    assert (1.0 - 1e-12) * half <= room < (2.0 + 1e-12) * half  # the logarithm is rounded
    numbers = places.to_numbers(center, places.origin)
    assert np.abs(numbers).max() <= LARGEST
    np.testing.assert_allclose(places.to_lengths(numbers), center, atol=0.5 * places.unit)


@pytest.mark.parametrize("spacing", [0.5, 2.0])
def test_a_hundredth_of_d_is_resolved(spacing):
    """By the unit in f32, and by the rounding of a coordinate in f64."""
    fine, coarse = (
        Places(origin=np.zeros(3), unit=share * spacing, spacing=spacing)
        for share in (0.009, 0.011)
    )
    real = Places(origin=np.zeros(3), unit=None, spacing=spacing)
    limit = 0.01 * spacing / np.finfo(np.float64).eps

    assert fine.is_resolved(1.0)
    assert not coarse.is_resolved(1.0)
    assert real.is_resolved(-0.9 * limit)
    assert not real.is_resolved(-1.1 * limit)
    assert not real.is_resolved(np.nan)
