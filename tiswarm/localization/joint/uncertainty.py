"""How uncertain an estimate is: `sd` from the variance within and between chains.

A chain moves about its mean for three reasons: measurements are noisy, they leave directions open,
and the temperature lets them be missed. Only the first two are errors. Lengths in R.
"""

import numpy as np

from tiswarm.aliases import Bools, Reals
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.settings import CALIBRATION, SCHEDULE
from tiswarm.records.estimate import Solution


def deviation(
    problem: Problem,
    mean: Reals,
    within: Reals,
    converged: Bools,
    sigma: float,
) -> Reals:
    """Compute the standard deviation of the mean of the converged chains [R], shape (N,).

    Args:
        problem: Measurements of the structure.
        mean: Mean position of each chain [R], shape (chains, N, 3).
        within: Within-chain variance [R^2], shape (chains, N).
        converged: Chains whose mean is the estimate, shape (chains,).
        sigma: Square root of the temperature at which the chains ended [R].
    """
    fit = CALIBRATION
    between = between_chains(mean, converged)
    between += fit.shared * between_chains(_others(mean), converged)
    square = within[converged].mean(axis=0) + between
    noise = _noise_share(problem.variance)
    thermal = fit.thermal_variance * (1.0 - noise) * sigma**2
    square *= square / np.maximum(square + thermal, np.finfo(np.float64).tiny)
    power = fit.shared_noise_power * noise
    related = np.sqrt(square) ** (1.0 - power) * (fit.shared_noise_at * sigma) ** power
    sharp = (fit.sharp * (sigma / SCHEDULE.warmest) ** fit.sharp_power) ** (1.0 - noise)
    lacking = 1.0 + fit.underdetermined * problem.underdetermination
    sd: Reals = related * sharp * lacking
    sd[0] = 0.0  # the position of the anchor is known
    return sd


def between_chains(mean: Reals, converged: Bools) -> Reals:
    """Compute the mean square error of the mean of chains that are draws like the truth, (N,).

    The mean of n draws is off by (n + 1) / n of their variance; the draws around it show
    (n - 1) / n of that. If one chain alone converged, the others show how much chains differ.
    """
    position = mean[converged].mean(axis=0)
    chains = np.count_nonzero(converged)
    drawn = mean[converged] if chains > 1 else mean
    square: Reals = ((drawn - position) ** 2).sum(axis=2).mean(axis=0)
    return square * ((chains + 1.0) / (chains - 1.0) if chains > 1 else 1.0)


def _others(mean: Reals) -> Reals:
    """Mean position of all robots but the anchor and the robot itself, shape (chains, N, 3)."""
    robots = mean.shape[1]
    total: Reals = mean[:, 1:].sum(axis=1, keepdims=True)
    return (total - mean) / max(robots - 2, 1)


def _noise_share(variance: Reals) -> float:
    """Share of the contacts' variance that is noise, not temperature; 1 without contacts."""
    if not len(variance):
        return 1.0
    return float(np.mean(variance / (variance + SCHEDULE.warmest**2)))


def distinct(
    position: Reals,
    residual: Reals,
    residual_sd: Reals,
    width: float,
) -> tuple[Solution, ...]:
    """Group chains into solutions that differ by more than the width of a dock at some robot.

    Beyond that distance robots could have changed places. A chain belongs to the solution of least
    residual that it agrees with.

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
