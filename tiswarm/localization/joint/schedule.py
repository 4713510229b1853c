"""How an annealing cools: the tolerance at each step, which is its temperature too. Lengths in R.

The colder the end, the better are solutions told apart that miss equations by little. But the less
do chains stray over what nothing tells, so they average less of it; and noise leaves nothing to be
told apart.
"""

import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.motion_kernels import MEMORY
from tiswarm.localization.params import JointParams

COLD = 0.01
"""Tolerance at the end where equations tell all, and tell it sharply."""
WARM = 0.025
"""The most at the end, where they do not."""
LACKING = 0.05
"""Shortage of equations at which no more than that is of use."""


def end_tolerance(known: Equations, params: JointParams) -> float:
    """Tolerance at which to end, of one structure."""
    if params.end_tolerance is not None:
        return params.end_tolerance
    noise = float(np.sqrt(np.median(known.variance))) if len(known.variance) else WARM
    lacking = COLD + (WARM - COLD) * known.shortage / LACKING
    return min(max(lacking, noise), WARM)


def cooled(begin: float, end: float, steps: int, holding: int) -> NDArray[np.float64]:
    """Tolerance of each step, shape (steps + holding,): ever less by the same factor, then held."""
    falling = begin * (end / begin) ** (np.arange(steps) / steps)
    return np.concatenate([falling, np.full(holding, end)])


def thermostat(tolerance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of m v^2 that friction and kicks give a free robot, at each step.

    It lags behind the square of the tolerance: a step keeps a part of the velocity.

    Args:
        tolerance: Of each step [R], shape (..., steps).

    Returns:
        The mean of m v^2 for each coordinate [R^2], shape (..., steps).
    """
    target = tolerance**2
    for step in range(1, target.shape[-1]):
        target[..., step] *= 1.0 - MEMORY**2
        target[..., step] += MEMORY**2 * target[..., step - 1]
    return target
