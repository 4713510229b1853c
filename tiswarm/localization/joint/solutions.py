"""Which solutions chains found."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.records.estimate import Solution


def distinct(
    position: NDArray[np.float64],
    residual: NDArray[np.float64],
    residual_sd: NDArray[np.float64],
    width: float,
) -> tuple[Solution, ...]:
    """Tell chains apart that put some robot more than the width of a dock elsewhere.

    Beyond that robots could have changed places. A chain goes with the best that it agrees with.

    Args:
        position: Centers in each chain, in the log's unit, shape (chains, N, 3).
        residual: Residual of each, in the log's unit, shape (chains,).
        residual_sd: The same in standard deviations, shape (chains,).
        width: Width of a dock, in the log's unit.
    """
    found: list[list[int]] = []
    for chain in np.argsort(residual, kind="stable").tolist():
        for alike in found:
            if np.linalg.norm(position[chain] - position[alike[0]], axis=1).max() <= width:
                alike.append(chain)
                break
        else:
            found.append([chain])
    return tuple(
        Solution(
            chains=len(alike),
            residual=float(residual[alike[0]]),
            residual_sd=float(residual_sd[alike[0]]),
            position=position[alike[0]],
        )
        for alike in found
    )
