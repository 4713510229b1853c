"""Information is damped, solved and factored as dense matrices say."""

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csc_array

from tiswarm.base.aliases import Reals
from tiswarm.compute import normal_equations
from tiswarm.compute.normal_equations import (
    DenseFactors,
    Nearby,
    Pivots,
    SparseFactors,
    damped,
    factored,
    inverted,
    solved,
)

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


@pytest.mark.parametrize("shift", [0.0, 1.5])
@pytest.mark.parametrize("factor", [lambda dense: SparseFactors(csc_array(dense)), DenseFactors])
def test_factors_have_the_inertia_and_determinant_of_information(factor, shift: float) -> None:
    """Also where blocks of two pivots have eigenvalues of both signs."""
    information = INFORMATION[0] - shift * np.linalg.eigvalsh(INFORMATION[0])[1] * np.eye(4)
    information[[0, 1], [0, 1]] *= 1e-6 if shift else 1.0
    values = np.linalg.eigvalsh(information)
    right = np.column_stack([SLOPE[0], SLOPE[1]])

    factors = factor(information.copy())

    assert (factors.pivots > 0.0).sum() == (values > 0.0).sum()
    assert np.prod(factors.pivots) == pytest.approx(np.prod(values))
    assert np.allclose(information @ factors.solve(right), right)
    assert np.allclose(information @ factors.solve(SLOPE[0]), SLOPE[0])


@pytest.mark.parametrize("factor", [lambda dense: SparseFactors(csc_array(dense)), DenseFactors])
def test_singular_information_is_refused(factor) -> None:
    """A solution would be infinite."""
    with pytest.raises(RuntimeError, match="singular"):
        factor(np.zeros((2, 2)))


def iterated(near: float, unknowns: int = 1200) -> tuple[Any, ...]:
    """Solve with factors of information that differs by some share of each row's weight."""
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(2 * unknowns, unknowns))
    weight = np.exp(rng.normal(0.0, 2.0, 2 * unknowns))
    slope = rng.normal(size=unknowns)
    information = (rows.T * weight) @ rows
    other = (rows.T * (weight * np.exp(near * rng.normal(size=2 * unknowns)))) @ rows
    products = []

    def product(unknown: Reals) -> Reals:
        products.append(unknown)
        return np.asarray(information @ unknown, np.float64)

    nearby = Nearby(DenseFactors(other.copy()), unknowns)
    return nearby.solve(product, slope), np.linalg.solve(information, slope), information, products


def test_factors_of_information_nearby_lead_to_the_solution(monkeypatch) -> None:
    """Nearer ones in fewer iterations."""
    monkeypatch.setattr(normal_equations, "_AS_LONG", 20)  # as of more unknowns
    counts = []
    for near in (0.0, 0.1, 0.2):
        solution, expected, information, products = iterated(near)
        counts.append(len(products))

        error = solution - expected
        # Squares in standard deviations of the unknowns; what ends iterations is an estimate.
        off = np.sqrt(error @ information @ error / (expected @ information @ expected))
        assert off < 1e-4

    assert counts[0] < counts[1] < counts[2]


def test_factors_that_are_far_away_solve_nothing(monkeypatch) -> None:
    """Neither do those of other unknowns, or of few: a factorization takes less time."""
    monkeypatch.setattr(normal_equations, "_AS_LONG", 20)
    assert iterated(5.0)[0] is None
    assert iterated(0.0, 100)[0] is None
    assert Nearby().solve(np.asarray, np.ones(2000)) is None
