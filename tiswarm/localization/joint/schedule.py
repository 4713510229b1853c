"""How an annealing cools: the tolerance at each step, which is its temperature too. Lengths in R.

The colder the end, the better are solutions told apart that miss equations by little. But the less
do chains stray over what nothing tells, so they average less of it; and noise leaves nothing to be
told apart.
"""

import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.joint.equations import Equations
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
