"""Accuracy of estimated positions, Eqs. (4) to (7) of the paper.

The alignments take any number of robots in any arrangement: where points on a line, or in one
place, leave a turn open, any turn fits equally well and one of them is taken.
"""

import math
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def robot_errors(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each robot's estimate from its true place [R], shape (N,).

    Args:
        estimate: Estimated centers [R], shape (N, 3).
        truth: True centers [R], shape (N, 3).
    """
    distance: NDArray[np.float64] = np.linalg.norm(estimate - truth, axis=1)
    return distance


def sse(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Sum of squared errors [R^2], Eq. (4); arguments as for `robot_errors`."""
    return float(np.sum((estimate - truth) ** 2))


def rmse(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Root mean square error [R], Eq. (5); arguments as for `robot_errors`."""
    return float(np.sqrt(sse(estimate, truth) / len(truth)))


def rms_radius(position: NDArray[np.float64]) -> float:
    """Root mean square distance of N centers from their centroid [R]."""
    return float(np.sqrt(np.mean(np.sum((position - position.mean(axis=0)) ** 2, axis=1))))


def yaw_aligned(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn the estimate about the vertical and shift it onto the truth, the best way there is.

    What remains is what robots that feel gravity can be blamed for. Arguments and result as for
    `rigidly_aligned`.
    """
    mean = estimate.mean(axis=0)
    (e_x, e_y, _), (t_x, t_y, _) = (estimate - mean).T, (truth - truth.mean(axis=0)).T
    yaw = math.atan2(float(e_x @ t_y - e_y @ t_x), float(e_x @ t_x + e_y @ t_y))
    turn = Rotation.from_euler("z", yaw)
    aligned: NDArray[np.float64] = turn.apply(estimate - mean) + truth.mean(axis=0)
    return aligned


def rigidly_aligned(
    estimate: NDArray[np.float64], truth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn and shift the estimate onto the truth, Eq. (6): no scaling, no reflection.

    Args:
        estimate: Estimated centers [R], shape (N, 3).
        truth: True centers [R], shape (N, 3).

    Returns:
        The moved estimate [R], shape (N, 3).
    """
    mean = estimate.mean(axis=0)
    if len(truth) == 1:
        return truth.copy()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Optimal rotation is not uniquely")
        rotation, _ = Rotation.align_vectors(truth - truth.mean(axis=0), estimate - mean)
    aligned: NDArray[np.float64] = rotation.apply(estimate - mean) + truth.mean(axis=0)
    return aligned


def procrustes_disparity(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Share of the shape left unexplained after a rigid alignment, Eq. (7) [1].

    Zero means congruent. Unlike `scipy.spatial.procrustes` this neither rescales nor
    reflects, so there is no upper bound of 1, whatever the paper says: an estimate twice
    the true size scores 1, three times scores 4. NaN where all true centers coincide, for then
    there is no shape.

    Args:
        estimate: Estimated centers [R], shape (N, 3).
        truth: True centers [R], shape (N, 3).

    >>> tower = np.array([[0, 0, 0], [0, 0, 2], [0, 1, 4], [1, 0, 6]], dtype=float)
    >>> procrustes_disparity(tower + 5.0, tower) < 1e-12
    True
    >>> round(procrustes_disparity(3.0 * tower, tower), 6)
    4.0
    """
    spread = float(np.sum((truth - truth.mean(axis=0)) ** 2))
    if spread == 0.0:
        return math.nan
    return sse(rigidly_aligned(estimate, truth), truth) / spread
