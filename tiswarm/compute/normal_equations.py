"""Normal equations of least squares: the one place where information is damped and factored.

Information is J^T C^-1 J, with derivatives J and covariance C of the rows. Precision that each
unknown has beside its rows, that of a prior or of a radius of trust, adds to its diagonal.
"""

from typing import Literal

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from tiswarm.base.aliases import Reals


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
