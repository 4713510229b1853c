"""The chance of a chi-square is that of the distribution, and its excess counts in its widths."""

import numpy as np
import pytest
from scipy import stats

from tiswarm.compute.chi_square import (
    MEDIAN_SQUARE,
    chi_square_chance,
    chi_square_excess,
    chi_square_limit,
    chi_square_sd,
)


@pytest.mark.parametrize("freedom", [1, 7, 400])
def test_the_sd_of_a_chi_square_is_that_of_its_distribution(freedom: int) -> None:
    """SciPy's distribution has this standard deviation and this median."""
    distribution = stats.chi2(freedom)

    sd = chi_square_sd(freedom)

    assert sd == pytest.approx(distribution.std(), rel=1e-12)
    assert pytest.approx(stats.chi2(1).median(), rel=1e-12) == MEDIAN_SQUARE


@pytest.mark.parametrize("freedom", [1, 12, 3000])
@pytest.mark.parametrize("most_sd", [2.0, 5.0])
def test_a_limit_is_exceeded_by_as_many_sd_as_it_allows(freedom: int, most_sd: float) -> None:
    """The limit and the excess are inverses of each other."""
    limit = chi_square_limit(freedom, most_sd)

    excess = chi_square_excess(float(limit), freedom)

    assert excess == pytest.approx(most_sd, rel=1e-9)


def test_a_chi_square_without_degrees_of_freedom_has_a_finite_excess() -> None:
    """Zero squares of zero rows are no misfit, and one square is that of a single row."""
    assert chi_square_excess(0.0, 0) == 0.0
    assert chi_square_excess(1.0, 0) == pytest.approx(2.0**-0.5)


def test_the_chance_is_the_tail_of_the_distribution() -> None:
    """Negative squares count as 0, and less than one degree of freedom as one."""
    square = np.array([-1.0, 0.0, 3.0, 40.0, 40.0])
    freedom = np.array([3.0, 3.0, 0.5, 12.5, 1.0])

    chance = chi_square_chance(square, freedom)

    tail = stats.chi2.sf(np.maximum(square, 0.0), np.maximum(freedom, 1.0))
    assert np.allclose(chance, tail, rtol=1e-10, atol=0.0)
