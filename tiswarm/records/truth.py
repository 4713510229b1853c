"""Where the robots really are. No localizer may import this module."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True poses of N robots, in join order."""

    robot_id: NDArray[np.int64]
    """Name of each robot, shape (N,)."""

    position: NDArray[np.float64]
    """Centers [R], shape (N, 3)."""

    orientation_wxyz: NDArray[np.float64]
    """Body to world, unit quaternion, shape (N, 4)."""
