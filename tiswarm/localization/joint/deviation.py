"""How far off an estimate may be, from what chains of it do: the calibration of `sd`.

A chain strays from its mean for three reasons: equations are noisy, they leave places open, and
the annealer tolerates that they are missed. Errors have the first two alone. All numbers here were
fitted on training structures of ReactiveBuild's rules; see `docs/accuracy.md`.
"""

import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.schedule import WARM

TOLERATED = 40.0
"""Square of how far the tolerance alone makes a robot stray, in squares of the tolerance."""
FREE = 0.61
"""Standard deviations of an error in one of a chain, where equations have no noise."""
FREE_COLD = 0.15
"""Power of the tolerance, relative to the warmest, that these go with."""
RELATED = 0.193
RELATED_AT = 11.4
"""Power by which deviations below so many tolerances are raised, and greater ones lowered, where
equations are nothing but noise: noise of a walk's early stances is in many of them at once, which
chains do not know."""
UNSETTLED = 1.0
"""By how much errors are greater where there are no equations at all, relatively: of what nothing
says chains see less than there is."""
SHARED = 4.0
"""Weight of what a robot shares with all others, beside its own. Few contacts, those of the anchor,
decide where all of a structure is; chains agree on that more often than they are right."""


def deviation(
    known: Equations,
    mean: NDArray[np.float64],
    spread: NDArray[np.float64],
    sound: NDArray[np.bool_],
    tolerance: float,
) -> NDArray[np.float64]:
    """Standard deviation of the mean of the sound chains, in dock radii, shape (N,).

    Args:
        known: What the chains were annealed by.
        mean: Mean position of each chain [R], shape (chains, N, 3).
        spread: Mean square distance from it [R^2], shape (chains, N).
        sound: Chains whose mean is the estimate, shape (chains,).
        tolerance: Tolerance at which the chains ended [R].
    """
    differing = disagreement(mean, sound) + SHARED * disagreement(_others(mean), sound)
    square = spread[sound].mean(axis=0) + differing
    noise = _noise_share(known.variance)
    tolerated = TOLERATED * (1.0 - noise) * tolerance**2
    square *= square / np.maximum(square + tolerated, np.finfo(np.float64).tiny)
    power = RELATED * noise
    related = np.sqrt(square) ** (1.0 - power) * (RELATED_AT * tolerance) ** power
    free = (FREE * (tolerance / WARM) ** FREE_COLD) ** (1.0 - noise)
    sd: NDArray[np.float64] = related * free * (1.0 + UNSETTLED * known.shortage)
    sd[0] = 0.0  # the anchor's place is known
    return sd


def disagreement(mean: NDArray[np.float64], sound: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Mean square by which the truth is off the mean of chains that are draws like it, shape (N,).

    The mean of n draws is off by (n + 1) / n of their variance, of which they show (n - 1) / n
    around it. Of one sound chain only the others tell how much chains differ.
    """
    position = mean[sound].mean(axis=0)
    chains = np.count_nonzero(sound)
    drawn = mean[sound] if chains > 1 else mean
    square: NDArray[np.float64] = ((drawn - position) ** 2).sum(axis=2).mean(axis=0)
    return square * ((chains + 1.0) / (chains - 1.0) if chains > 1 else 1.0)


def _others(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean position of all robots but the anchor and the robot itself, shape (chains, N, 3)."""
    robots = mean.shape[1]
    total: NDArray[np.float64] = mean[:, 1:].sum(axis=1, keepdims=True)
    return (total - mean) / max(robots - 2, 1)


def _noise_share(variance: NDArray[np.float64]) -> float:
    """Part of the contacts' variance that is noise, not the warmest tolerance; 1 without any."""
    return float(np.mean(variance / (variance + WARM**2))) if len(variance) else 1.0
