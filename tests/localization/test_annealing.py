"""Annealings end as cold as what is known of a structure is worth."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiswarm.localization.chains.annealer import thermostat
from tiswarm.localization.chains.kernels import MEMORY
from tiswarm.localization.chains.views import ANNEALING, cooled, end_sigma
from tiswarm.localization.settings import JointParams

DEFAULTS = JointParams()
COLDEST, WARMEST = ANNEALING.coldest, ANNEALING.warmest
LACKING = ANNEALING.underdetermined


def _end(shortage=0.0, sd=1e-9, contacts=5, params=DEFAULTS):
    variance = np.full(contacts, sd**2)
    return end_sigma(SimpleNamespace(underdetermination=shortage, variance=variance), params)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(1e-6, 10.0), st.floats(1e-6, 10.0))
def test_the_less_is_known_the_warmer_annealings_end(less, more, sharp, blunt):
    """And never colder than equations that suffice are worth, nor warmer than others can use."""
    less, more = sorted((less, more))
    sharp, blunt = sorted((sharp, blunt))

    assert COLDEST <= _end(less, sharp) <= _end(more, blunt) <= WARMEST


def test_annealings_end_cold_only_where_equations_are_many_and_sharp():
    """Too few of them, or blunt ones, or none, and what nothing tells is left room."""
    assert _end() == COLDEST
    assert _end(shortage=LACKING / 2.0) == pytest.approx((COLDEST + WARMEST) / 2.0)
    assert _end(sd=0.02) == pytest.approx(0.02)
    assert _end(shortage=2.0 * LACKING) == _end(sd=1.0) == _end(contacts=0) == WARMEST


def test_a_tolerance_that_is_asked_for_is_kept():
    """However much is known."""
    params = JointParams(end_sigma=0.3)

    assert _end(params=params) == _end(shortage=0.5, params=params) == 0.3


def test_tolerances_fall_by_the_same_factor_and_are_held():
    """As long as was asked for."""
    tolerance = cooled(0.6, 0.01, 100, 20)

    assert tolerance[0] == 0.6
    np.testing.assert_allclose(tolerance[1:100] / tolerance[:99], (0.01 / 0.6) ** 0.01)
    np.testing.assert_array_equal(tolerance[100:], np.full(20, 0.01))


def test_the_thermostat_lags_behind_a_tolerance_that_falls():
    """By the exact factor of a friction that takes a part of the energy; held, it is reached."""
    kept = MEMORY**2
    steps = np.arange(2000)
    falling = 0.6 * 0.995**steps

    target = thermostat(np.array([falling, np.full(2000, 0.3)]))

    ratio = target[0, 500:] / falling[500:] ** 2
    np.testing.assert_allclose(ratio, (1.0 - kept) / (1.0 - kept / 0.995**2), rtol=1e-3)
    np.testing.assert_allclose(target[1], 0.3**2)
