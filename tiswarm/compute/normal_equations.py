"""Normal equations of least squares: the one place where information is damped and factored.

Information is J^T C^-1 J, with derivatives J and covariance C of the rows. Precision that each
unknown has beside its rows, that of a prior or of a radius of trust, adds to its diagonal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from tiswarm.base.aliases import Ints, Reals


def damped(information: Reals, precision: float | Reals) -> Reals:
    """Add the same precision to all unknowns of each problem.

    Args:
        information: Dense information, shape (..., n, n).
        precision: Precision of each unknown, shape (...).

    Returns:
        Information, shape (..., n, n).
    """
    total: Reals = information + np.asarray(precision)[..., None, None] * np.eye(
        information.shape[-1]
    )
    return total


def solved(information: Reals, slope: Reals) -> Reals:
    """Solve dense normal equations.

    Args:
        information: Information, shape (..., n, n), of full rank.
        slope: Right sides, shape (..., n).

    Returns:
        Unknowns, shape (..., n).

    Raises:
        LinAlgError: an information is singular.
    """
    unknowns = np.linalg.solve(information, slope[..., None])[..., 0]
    return np.asarray(unknowns, np.float64)


def inverted(information: Reals) -> Reals:
    """Invert dense information to the covariance of the unknowns, or back, shape (..., n, n).

    Raises:
        LinAlgError: a matrix is singular.
    """
    return np.asarray(np.linalg.inv(information), np.float64)


_COLUMNS = 64
"""Columns of a dense matrix that are eliminated at once, as LAPACK would choose."""


class Factors(Protocol):
    """Factors L D L^T of symmetric information of n unknowns, with permutations of these."""

    size: int
    """Number of stored entries."""

    @property
    def pivots(self) -> Reals:
        """Eigenvalues of D, shape (n,).

        Their signs count eigenvalues of the information (Sylvester's law of inertia), and their
        product is its determinant.
        """

    def solve(self, slope: Reals) -> Reals:
        """Solve normal equations of right sides, (n,) or (n, k)."""


class SparseFactors:
    """Factors of sparse information, whose pivots are those of the diagonal."""

    def __init__(self, information: csc_array) -> None:
        """Factor information (n, n); errors as of `factored`."""
        self._factors = factored(information)
        self.size = int(self._factors.nnz)

    @property
    def pivots(self) -> Reals:
        """Eigenvalues of D, shape (n,)."""
        return np.asarray(self._factors.U.diagonal())

    def solve(self, slope: Reals) -> Reals:
        """Solve normal equations of right sides, (n,) or (n, k)."""
        return np.asarray(self._factors.solve(slope))


class DenseFactors:
    """Factors of dense information: by Cholesky, or with blocks of one or two pivots.

    Information of a minimum is positive definite. Less a multiple of the identity it may not be:
    then the factors are those of Bunch and Kaufman (1977).
    """

    def __init__(self, information: Reals) -> None:
        """Factor information (n, n), which is overwritten.

        Raises:
            RuntimeError: the information is singular.
        """
        # Their stubs do not know the functions of LAPACK.
        names = ("potrf", "potrs", "sytrf", "sytrs")
        functions: Any = get_lapack_funcs(names, dtype=np.float64)
        cholesky, self._solve_definite, factor, self._solve = functions
        diagonal = information.diagonal().copy()
        # Transposed, rows are the columns that LAPACK expects: nothing is copied.
        factors, is_indefinite = cholesky(information.T, lower=1, clean=0, overwrite_a=1)
        self._factors = factors
        self.size = int(factors.size)
        self._exchange: Ints | None = None
        if not is_indefinite:
            return
        # The other triangle is as it was.
        factors[np.diag_indices(len(factors))] = diagonal
        work = _COLUMNS * max(len(information), 1)
        self._factors, self._exchange, singular = factor(
            factors.T.copy(order="F"), lower=1, lwork=work, overwrite_a=1
        )
        if singular > 0:
            message = "the information is singular"
            raise RuntimeError(message)

    @property
    def pivots(self) -> Reals:
        """Eigenvalues of D, shape (n,)."""
        pivots = np.asarray(self._factors.diagonal(), np.float64).copy()
        if self._exchange is None:
            return np.asarray(pivots**2)
        # Of a block of two pivots both exchanges are negative.
        first = np.flatnonzero(self._exchange < 0)[::2]
        block = np.empty((len(first), 2, 2))
        block[:, 0, 0] = pivots[first]
        block[:, 1, 1] = pivots[first + 1]
        block[:, 1, 0] = self._factors[first + 1, first]
        pivots[np.stack([first, first + 1], axis=1)] = np.linalg.eigvalsh(block, UPLO="L")
        return pivots

    def solve(self, slope: Reals) -> Reals:
        """Solve normal equations of right sides, (n,) or (n, k)."""
        columns = slope.reshape(len(slope), -1)
        if self._exchange is None:
            solved_columns, _ = self._solve_definite(self._factors, columns, lower=1)
        else:
            solved_columns, _ = self._solve(self._factors, self._exchange, columns, lower=1)
        return np.asarray(solved_columns, np.float64).reshape(slope.shape)


_AS_LONG = 50
"""Entries of factors in each column for each iteration that takes as long as factoring does [1]."""

_FEWEST = 40
"""Iterations up to which solutions nearby may need, so that others are factored at once."""

_CLOSE = 1e-5
"""Error of a solution, relative to it, both in standard deviations of the unknowns, at which
iterations end [1]: the last step to a minimum is a tenth of a standard deviation."""

_DELAY = 4
"""Iterations whose gains estimate the squared error before them (Strakos and Tichy 2002)."""


@dataclass
class Nearby:
    """The latest factors of a sequence of problems, each near the one before."""

    factors: Factors | None = None
    """Factors of the latest problem that was factored."""

    unknowns: int = 0
    """Number of its unknowns."""

    damping: float = 0.0
    """Precision of each of them that its information has beside that of rows and priors."""

    def solve(self, product: Callable[[Reals], Reals], slope: Reals) -> Reals | None:
        """Solve normal equations by conjugate gradients that these factors precondition.

        Few iterations lead to the solution itself where information is nearly the same (Hestenes
        and Stiefel 1952).

        Args:
            product: Multiplies unknowns (n,) by the information without `damping`.
            slope: Right side, shape (n,).

        Returns:
            Unknowns, shape (n,). None if the problem should be factored: there are no factors, it
            takes little time, or the information is another one.
        """
        if self.factors is None or len(slope) != self.unknowns:
            return None
        most = self.factors.size // (_AS_LONG * self.unknowns)
        if most < _FEWEST:
            return None
        unknowns = np.zeros_like(slope)
        residual = slope
        direction = preconditioned = self.factors.solve(residual)
        square = float(residual @ preconditioned)
        gains: list[float] = []
        for _ in range(most):
            if square == 0.0 or sum(gains[-_DELAY:]) < _CLOSE**2 * sum(gains[:-_DELAY]):
                return unknowns
            image = product(direction) + self.damping * direction
            curvature = float(direction @ image)
            if square < 0.0 or curvature <= 0.0:  # rounding, where hardly anything is measured
                return None
            length = square / curvature
            gains.append(length * square)
            unknowns = unknowns + length * direction
            residual = residual - length * image
            preconditioned = self.factors.solve(residual)
            before = square
            square = float(residual @ preconditioned)
            direction = preconditioned + square / before * direction
        return None


Pivots = Literal["diagonal", "largest", "any"]
"""Which entries a factorization divides by."""


def factored(information: csc_array, pivots: Pivots = "diagonal") -> SuperLU:
    """Factor sparse, symmetric information, shape (n, n).

    Args:
        information: Information, or the difference of one and a multiple of the identity.
        pivots: By default all pivots are from the diagonal: their signs count eigenvalues
            (Sylvester's law of inertia), and their product is the determinant. With "largest" the
            largest entry of a column is its pivot, which rounds less where information is hardly
            regular. The order of elimination is that of minimum degree in both, which fills in few
            entries. With "any" the matrix is factored as one that is not symmetric.

    Raises:
        RuntimeError: the information is singular.
    """
    if pivots == "any":
        return splu(information)
    return splu(
        information,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0 if pivots == "diagonal" else 1.0,
        options={"SymmetricMode": True},
    )
