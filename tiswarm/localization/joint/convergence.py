"""Which chains converged, which measurements are outliers, and whether to use the estimate.

A chain failed if it put a robot farther away than its contacts reach, or if its kinetic temperature
ran away. The measurements of the best chain that did not fail decide about the estimate: their
chi-square is compared with its count. Lengths in R.
"""

from dataclasses import dataclass

import numpy as np

from tiswarm.aliases import Bools, Reals
from tiswarm.localization.joint.annealing import Annealed
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.settings import CONVERGENCE
from tiswarm.records.estimate import Convergence


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
    missed = squares(problem, annealed)[:, : len(problem.other)]
    # A wrong contact bounds no distance; most chains tear it.
    torn = (missed > CONVERGENCE.outlier_sd**2).mean(axis=0) >= CONVERGENCE.most_chains
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


def judge(problem: Problem, annealed: Annealed, has_failed: Bools, restarted: int) -> Verdict:
    """Choose the chains that count, and decide whether they meet the measurements.

    Args:
        problem: Measurements of the structure.
        annealed: Its chains.
        has_failed: Chains that cannot be right, shape (chains,).
        restarted: How many chains were annealed again.
    """
    test, contacts = CONVERGENCE, len(problem.other)
    missed = squares(problem, annealed)
    sums = np.minimum(missed[:, :contacts], test.capped_sd**2).sum(axis=1)
    candidates = np.where(has_failed.all() | ~has_failed, sums, np.inf)
    best = int(candidates.argmin())
    converged = candidates <= candidates[best] + test.chance_sd * np.sqrt(2.0 * contacts)
    rank = np.argsort(np.argsort(candidates, kind="stable"))
    jury = converged | ((rank < test.jury) & np.isfinite(candidates))
    outlier = (missed[jury] > test.outlier_sd**2).all(axis=0)
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
            misfit_sd=float((chi_square - count) / spread),
            chains=int(converged.sum()),
            restarted=restarted,
        ),
    )
