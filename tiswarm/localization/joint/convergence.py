"""Which chains converged, which contacts are outliers, and whether the estimate can be used.

A chain failed if it put a robot farther away than its contacts reach, or if its kinetic temperature
ran away. The measurements of the best chain that did not fail decide about the estimate: their
chi-square is compared with its count. Lengths in R.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.joint.anneal import Annealed
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.force_kernels import SPACING
from tiswarm.records.estimate import Convergence

CHANCE = 5.0
"""Standard deviations of a chi-square that chance explains. A chain whose chi-square exceeds the
best one's by more is trapped."""
OUTLIER = 5.0
"""A contact that misses by more standard deviations in every converged chain is an outlier."""
JURY = 3
"""Chains at least that must agree on an outlier, where there are so many: a single chain tears
contacts that are right."""
GIVEN_UP = 20.0
"""Standard deviations that one measurement counts for at most in a chi-square: enough that a chain
which gave up a contact that others kept is trapped, not so many that the farthest decides."""
MOST_PER_MEASUREMENT = 3.0
"""Mean square of a measurement's residual, in variances, that the annealer itself explains: chains
are up to 1.3 times as hot as their target, and the best of them is not free of torn contacts."""
MOST_TORN = 0.005
"""Share of contacts, beside outliers, that may miss by as much as these."""
TORN_ANYWAY = 2
"""Such contacts that any structure may have."""
MOST_OUTLIERS = 0.2
"""Share of contacts that can be outliers; where more are, the chains failed."""
MOST_CHAINS = 0.5
"""Share of the chains that must miss a contact before it bounds no distance."""
RUNAWAY = 2.0
"""Kinetic temperature, relative to its target, from which on a chain failed."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the chains of one structure came to."""

    converged: NDArray[np.bool_]
    """Chains whose mean is the estimate, shape (chains,); at least one."""

    outlier: NDArray[np.bool_]
    """Contacts that no converged chain satisfies, nor any of the best few, shape (C,)."""

    convergence: Convergence
    """Convergence of the estimate."""


def failed(known: Equations, annealed: Annealed) -> NDArray[np.bool_]:
    """Find chains that no noise of the measurements explains, shape (chains,)."""
    missed = squares(known, annealed)[0]
    # A wrong contact bounds nothing; most chains give it up.
    given_up = (missed > OUTLIER**2).mean(axis=0) >= MOST_CHAINS
    first = np.unique(known.part, return_index=True)[1][known.part]
    distance = np.linalg.norm(annealed.last - annealed.last[:, first], axis=2)
    beyond = (distance > known.reach(annealed.tolerance, ~given_up)).any(axis=1)
    is_failed: NDArray[np.bool_] = beyond | (annealed.temperature > RUNAWAY)
    return is_failed


def squares(
    known: Equations, annealed: Annealed
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Squared residuals of each chain at its end, in variances.

    The variance is that of the measurement and of the tolerance together.

    Returns:
        Those of the contacts, shape (chains, C), and of all coordinates measured, (chains, K).
    """
    square = annealed.tolerance**2
    gap = known.lengths(annealed.last, annealed.last_yaw) - SPACING
    is_measured = (known.precision > 0.0) & ~known.unobserved
    is_measured[0] = False  # the anchor
    turn = np.exp(1j * annealed.last_yaw) * (known.walk @ [1.0, 1j])
    walked = np.stack([turn.real, turn.imag, np.zeros_like(turn.real)], axis=2)
    away = (annealed.last + walked - known.place)[:, is_measured]
    precision = known.precision[is_measured]
    return gap**2 / (known.variance + square), away**2 * precision / (1.0 + precision * square)


def judge(
    known: Equations, annealed: Annealed, has_failed: NDArray[np.bool_], restarted: int
) -> Verdict:
    """Choose the chains that count, and decide whether they meet the measurements.

    Args:
        known: Measurements of the structure.
        annealed: Its chains.
        has_failed: Chains that cannot be right, shape (chains,).
        restarted: How many chains were annealed again.
    """
    missed, away = squares(known, annealed)
    sums = np.minimum(missed, GIVEN_UP**2).sum(axis=1)
    candidates = np.where(has_failed.all() | ~has_failed, sums, np.inf)
    best = int(candidates.argmin())
    converged = candidates <= candidates[best] + CHANCE * np.sqrt(2.0 * missed.shape[1])
    rank = np.argsort(np.argsort(candidates, kind="stable"))
    jury = converged | ((rank < JURY) & np.isfinite(candidates))
    outlier = (missed[jury] > OUTLIER**2).all(axis=0)
    used = np.concatenate([missed[best, ~outlier], away[best]])
    count = max(len(used), 1)
    chi_square = np.minimum(used, GIVEN_UP**2).sum()
    is_met = chi_square <= MOST_PER_MEASUREMENT * count + CHANCE * np.sqrt(2.0 * count)
    torn = (missed[best, ~outlier] > OUTLIER**2).sum()
    is_whole = torn <= TORN_ANYWAY + MOST_TORN * len(outlier)
    few = outlier.sum() <= MOST_OUTLIERS * len(outlier)
    return Verdict(
        converged=converged,
        outlier=outlier,
        convergence=Convergence(
            converged=bool(is_met and is_whole and few and not has_failed.all()),
            misfit_sd=float((chi_square - count) / np.sqrt(2.0 * count)),
            chains=int(converged.sum()),
            restarted=restarted,
        ),
    )
