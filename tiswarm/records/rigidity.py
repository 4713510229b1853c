"""What a log leaves free: motions of the robots that no contact would notice."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.rotations import dock_offsets
from tiswarm.records.sensing_log import SensingLog

MAX_ROBOTS = 400
"""Beyond this many robots the dense rank is too slow; the count is then given as NaN."""


def rigidity_matrix(
    position: NDArray[np.float64], log: SensingLog, *, height_known: bool
) -> NDArray[np.float64]:
    """Derivative of everything sensed with respect to every position but the anchor's.

    With orientations known, a contact of docks is one equation: the distance of the two is
    D. A dock on the ground is one more, and so is a known height.

    Args:
        position: Centres at which to linearise, shape (N, 3).
        log: What was sensed.
        height_known: Whether heights from flips count.

    Returns:
        One row an equation, shape (equations, 3 N - 3).
    """
    offset = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    i, a, j, b = log.contacts.T
    apart = (position[j] + offset[j, b]) - (position[i] + offset[i, a])
    unit = apart / np.linalg.norm(apart, axis=1, keepdims=True)
    upright = log.ground_docks[:, 0]
    if height_known:
        upright = np.r_[upright, np.flatnonzero(np.isfinite(log.flip_height))]
    matrix = np.zeros((len(i) + len(upright), log.robot_count, 3))
    row = np.arange(len(i))
    matrix[row, i] = -unit
    matrix[row, j] = unit
    matrix[len(i) + np.arange(len(upright)), upright, 2] = 1.0
    return matrix[:, 1:].reshape(len(matrix), -1)


def floppy_modes(position: NDArray[np.float64], log: SensingLog, *, height_known: bool) -> float:
    """Count the independent motions that change nothing sensed; NaN where it is too dear.

    Arguments as for `rigidity_matrix`.
    """
    if log.robot_count > MAX_ROBOTS:
        return float("nan")
    matrix = rigidity_matrix(position, log, height_known=height_known)
    rank = np.linalg.matrix_rank(matrix, tol=1e-8)
    return float(matrix.shape[1] - rank)
