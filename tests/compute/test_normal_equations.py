"""Information is damped, solved and factored as dense matrices say."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from tiswarm.compute.normal_equations import Pivots, damped, factored, inverted, solved

RANDOM = np.random.default_rng(7)
JACOBIAN = RANDOM.normal(size=(5, 12, 4))
INFORMATION = JACOBIAN.swapaxes(1, 2) @ JACOBIAN
SLOPE = RANDOM.normal(size=(5, 4))


def test_precision_adds_to_the_diagonal_of_each_problem() -> None:
    """Off the diagonal nothing changes."""
    precision = np.arange(1.0, 6.0)

    change = damped(INFORMATION, precision) - INFORMATION

    expected = precision[:, None, None] * np.eye(4)
    assert np.allclose(change, expected, atol=1e-12)


def test_solutions_and_inverses_meet_the_equations() -> None:
    """Every problem of a batch is solved by itself."""
    unknowns = solved(INFORMATION, SLOPE)

    covariance = inverted(INFORMATION)

    assert np.allclose((INFORMATION @ unknowns[..., None])[..., 0], SLOPE)
    assert np.allclose((covariance @ SLOPE[..., None])[..., 0], unknowns)


@pytest.mark.parametrize("pivots", ["diagonal", "largest", "any"])
def test_sparse_factors_solve_what_dense_ones_do(pivots: Pivots) -> None:
    """The choice of pivots changes no solution beyond rounding."""
    sparse = csc_array(INFORMATION[0])

    unknowns = factored(sparse, pivots).solve(SLOPE[0])

    assert np.allclose(unknowns, solved(INFORMATION[0], SLOPE[0]))


def test_pivots_of_the_diagonal_count_negative_eigenvalues() -> None:
    """By Sylvester's law of inertia, a shift below two eigenvalues leaves two that are positive."""
    values = np.linalg.eigvalsh(INFORMATION[0])
    shift = values[1:3].mean()

    pivots = factored(csc_array(INFORMATION[0] - shift * np.eye(4))).U.diagonal()

    assert (pivots > 0.0).sum() == 2
