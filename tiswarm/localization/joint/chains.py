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

from tiswarm.aliases import Bools, Ints, Reals
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.settings import AnnealSchedule, ConvergenceTest, SdCalibration
from tiswarm.records.estimate import Convergence, Solution


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

    def with_chains(self, chosen: Bools, other: "Annealed") -> "Annealed":
        """Replace some chains, chosen by an array of shape (chains,), by those of `other`."""
        arrays: dict[str, Any] = {
            name: np.where(
                chosen.reshape(-1, *[1] * (getattr(self, name).ndim - 1)),
                getattr(other, name),
                getattr(self, name),
            )
            for name in ("mean", "within", "last", "mean_yaw", "last_yaw", "temperature")
        }
        if chosen[0]:
            arrays |= {"trace": other.trace, "yaw_trace": other.yaw_trace}
        return replace(self, **arrays)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Judgment of the chains of one structure."""

    converged: Bools
    """Chains whose mean is the estimate, shape (chains,); at least one."""

    outlier: Bools
    """Measurements that every converged chain misses, and each of the best few, shape (E,)."""

    convergence: Convergence
    """Convergence of the estimate."""


def failed(problem: Problem, annealed: Annealed) -> Bools:
    """Find chains that no noise of the measurements explains, shape (chains,)."""
    missed = squares(problem, annealed)[:, : len(problem.variance)]
    # A wrong contact bounds no distance; most chains tear it.
    torn = (missed > ConvergenceTest.outlier_sd**2).mean(axis=0) >= ConvergenceTest.most_chains
    torn = problem.any_of_link(torn)[problem.link]
    first = np.unique(problem.part, return_index=True)[1][problem.part]
    distance = np.linalg.norm(annealed.last - annealed.last[:, first], axis=2)
    beyond = (distance > problem.reach(annealed.sigma, ~torn)).any(axis=1)
    is_failed: Bools = beyond | (annealed.temperature > ConvergenceTest.runaway)
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


def judge(problem: Problem, annealed: Annealed, has_failed: Bools, restarted: int) -> Verdict:
    """Choose the chains that count, and decide whether they meet the measurements.

    Args:
        problem: Measurements of the structure.
        annealed: Its chains.
        has_failed: Chains that cannot be right, shape (chains,).
        restarted: How many chains were annealed again.
    """
    test, contacts = ConvergenceTest, len(problem.variance)
    missed = squares(problem, annealed)
    sums = np.minimum(missed[:, :contacts], test.capped_sd**2).sum(axis=1)
    candidates = np.where(has_failed.all() | ~has_failed, sums, np.inf)
    best = int(candidates.argmin())
    converged = candidates <= candidates[best] + test.chance_sd * np.sqrt(2.0 * contacts)
    rank = np.argsort(np.argsort(candidates, kind="stable"))
    jury = converged | ((rank < test.jury) & np.isfinite(candidates))
    outlier = (missed[jury] > test.outlier_sd**2).all(axis=0)
    outlier[:contacts] = problem.any_of_link(outlier[:contacts])
    used = missed[best, ~outlier]
    count = max(len(used), 1)
    spread = np.sqrt(2.0 * count)
    chi_square = np.minimum(used, test.capped_sd**2).sum()
    is_met = chi_square <= test.most_per_measurement * count + test.chance_sd * spread
    torn = (missed[best, :contacts][~outlier[:contacts]] > test.outlier_sd**2).sum()
    is_whole = torn <= test.torn_anyway + test.most_torn * contacts
    few = outlier[:contacts].sum() <= test.most_outliers * contacts
    return Verdict(
        converged=converged,
        outlier=outlier,
        convergence=Convergence(
            converged=bool(is_met and is_whole and few and not has_failed.all()),
            consistent=True,
            misfit_sd=float((chi_square - count) / spread),
            chains=int(converged.sum()),
            restarted=restarted,
        ),
    )


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
    fit = SdCalibration
    between = between_chains(mean, converged)
    between += fit.shared * between_chains(_others(mean), converged)
    square = within[converged].mean(axis=0) + between
    noise = _noise_share(problem.variance)
    thermal = fit.thermal_variance * (1.0 - noise) * sigma**2
    square *= square / np.maximum(square + thermal, np.finfo(np.float64).tiny)
    power = fit.shared_noise_power * noise
    related = np.sqrt(square) ** (1.0 - power) * (fit.shared_noise_at * sigma) ** power
    sharp = (fit.sharp * (sigma / AnnealSchedule.warmest) ** fit.sharp_power) ** (1.0 - noise)
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
    return float(np.mean(variance / (variance + AnnealSchedule.warmest**2)))


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
            weight=len(alike) / len(position),
            chi_square=float("nan"),
            chains=len(alike),
            residual=float(residual[alike[0]]),
            residual_sd=float(residual_sd[alike[0]]),
            position=position[alike[0]],
        )
        for alike in found
    )
