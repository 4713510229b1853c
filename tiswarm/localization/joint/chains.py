"""What the chains of a structure say: convergence, outliers, uncertainty and solutions.

A chain failed if it put a robot farther away than its contacts reach, or if its kinetic temperature
ran away. The measurements of the best chain that did not fail decide about the estimate: their
chi-square is compared with its count.

A chain moves about its mean for three reasons: measurements are noisy, they leave directions open,
and the temperature lets them be missed. Only the first two are errors, and make `sd`. Lengths in R.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.joint.settings import ANNEALING, CONVERGENCE, SD_CALIBRATION

_BY_CHAIN = ("mean", "within", "last", "mean_yaw", "last_yaw", "temperature")

_LEAST_CHAINS = 1.5
"""Effective number of chains below which their spread says nothing."""


@dataclass(frozen=True, kw_only=True)
class Annealed:
    """Result of the chains of one structure of N robots."""

    mean: Reals
    """Mean position over the hold of each chain [R], shape (chains, N, 3)."""

    within: Reals
    """Within-chain variance of each position, all axes together [R^2], shape (chains, N)."""

    last: Reals
    """Last position in each chain [R], shape (chains, N, 3)."""

    mean_yaw: Reals
    """Mean yaw correction over the hold of each chain [rad], shape (chains, N)."""

    last_yaw: Reals
    """Last yaw correction in each chain [rad], shape (chains, N)."""

    sigma: float
    """Square root of the end temperature [R]."""

    temperature: Reals
    """Mean kinetic temperature of each chain once docks are grown, relative to its target,
    shape (chains,)."""

    iteration: Ints
    """Steps at which the trace was recorded, shape (K,)."""

    trace: Reals
    """Positions of the first chain then [R], shape (K, N, 3)."""

    yaw_trace: Reals
    """Yaw corrections of the first chain then [rad], shape (K, N)."""

    def joined(self, other: "Annealed") -> "Annealed":
        """Add the chains of others that ended at the same temperature."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in _BY_CHAIN
        }
        return replace(self, **arrays)

    def still(self, position: Reals, yaw: Reals) -> "Annealed":
        """Put chains that do not move in place of these: (K, N, 3) and (K, N)."""
        return replace(
            self, mean=position, last=position, mean_yaw=yaw, last_yaw=yaw,
            within=np.zeros(yaw.shape), temperature=np.ones(len(yaw)),
        )  # fmt: skip

    def with_chains(self, chosen: Bools, other: "Annealed") -> "Annealed":
        """Replace some chains, chosen by an array of shape (chains,), by those of `other`."""
        arrays: dict[str, Any] = {
            name: np.where(
                chosen.reshape(-1, *[1] * (getattr(self, name).ndim - 1)),
                getattr(other, name),
                getattr(self, name),
            )
            for name in _BY_CHAIN
        }
        # Traces are those of the first chain.
        if chosen[0]:
            arrays |= {"trace": other.trace, "yaw_trace": other.yaw_trace}
        return replace(self, **arrays)


def failed(problem: Problem, annealed: Annealed) -> Bools:
    """Find chains that no noise of the measurements explains, shape (chains,)."""
    missed = squares(problem, annealed)[:, : len(problem.variance)]
    # A wrong contact bounds no distance; most chains tear it.
    torn = (missed > CONVERGENCE.outlier_sd**2).mean(axis=0) >= CONVERGENCE.most_chains
    torn = problem.any_of_link(torn)[problem.link]
    # Nothing measures how far a part without the anchor is away: count from its own first robot.
    first = np.unique(problem.part, return_index=True)[1][problem.part]
    distance = np.linalg.norm(annealed.last - annealed.last[:, first], axis=2)
    beyond = (distance > problem.reach(annealed.sigma, ~torn)).any(axis=1)
    is_failed: Bools = beyond | (annealed.temperature > CONVERGENCE.runaway)
    return is_failed


def squares(problem: Problem, annealed: Annealed) -> Reals:
    """Compute the squared residuals of each chain at its end, in variances.

    The variance is that of the measurement and of the temperature together.

    Returns:
        Squares, shape (chains, E).
    """
    residual = problem.rows.residual(annealed.last, annealed.last_yaw)
    square: Reals = residual**2 / (problem.rows.variance() + annealed.sigma**2)
    return square


def deviation(
    problem: Problem,
    mean: Reals,
    within: Reals,
    weight: Reals,
    sigma: float,
) -> Reals:
    """Compute the standard deviation of the weighted mean of chains [R], shape (N,).

    Args:
        problem: Measurements of the structure.
        mean: Mean position of each chain [R], shape (chains, N, 3).
        within: Within-chain variance [R^2], shape (chains, N).
        weight: Weights of the chains, which add up to 1, shape (chains,).
        sigma: Square root of the temperature at which the chains ended [R].
    """
    fit = SD_CALIBRATION
    between = between_chains(mean, weight)
    # Displacements that a robot shares with all others: few chains show them, so they weigh more.
    between += fit.shared * between_chains(_others(mean), weight)
    square = weight @ within + between
    noise = _noise_share(problem.variance)
    thermal = fit.thermal_variance * (1.0 - noise) * sigma**2
    # Where little more is found than the temperature alone causes, it counts for little.
    square *= square / np.maximum(square + thermal, np.finfo(np.float64).tiny)
    power = fit.shared_noise_power * noise
    related = np.sqrt(square) ** (1.0 - power) * (fit.shared_noise_at * sigma) ** power
    sharp = (fit.sharp * (sigma / ANNEALING.warmest) ** fit.sharp_power) ** (1.0 - noise)
    lacking = 1.0 + fit.underdetermined * problem.underdetermination
    sd: Reals = related * sharp * lacking
    sd[0] = 0.0  # the position of the anchor is known
    return sd


def between_chains(mean: Reals, weight: Reals) -> Reals:
    """Compute the mean square error of the mean of chains that are draws like the truth, (N,).

    The mean of n draws is off by (n + 1) / n of their variance; the draws around it show
    (n - 1) / n of that. n is their effective number, 1 / sum of squared weights. Of less than two,
    all chains together show how much they differ.
    """
    chains = 1.0 / (weight**2).sum()
    if chains < _LEAST_CHAINS:
        weight = np.full(len(mean), 1.0 / len(mean))
        chains = float(len(mean))
    position = np.tensordot(weight, mean, 1)
    square: Reals = weight @ ((mean - position) ** 2).sum(axis=2)
    return square * ((chains + 1.0) / (chains - 1.0) if chains > 1.0 else 1.0)


def _others(mean: Reals) -> Reals:
    """Mean position of all robots but the anchor and the robot itself, shape (chains, N, 3)."""
    robots = mean.shape[1]
    total: Reals = mean[:, 1:].sum(axis=1, keepdims=True)
    return (total - mean) / max(robots - 2, 1)


def _noise_share(variance: Reals) -> float:
    """Share of the contacts' variance that is noise, not temperature; 1 without contacts."""
    if not len(variance):
        return 1.0
    return float(np.mean(variance / (variance + ANNEALING.warmest**2)))
