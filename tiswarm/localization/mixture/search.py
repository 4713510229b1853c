"""The way from chains that began anywhere to an estimate: further annealings, then the mixture."""

from typing import Any

import numpy as np

from tiswarm.localization.chains.annealer import Annealed, anneal
from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.mixture.ends import Fit, Posed, further_starts
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.outliers import without_outlier_robots
from tiswarm.records.estimate import Estimate


def searched(posed: Posed, annealed: Annealed | None = None) -> Estimate:
    """Estimate positions from chains whose starts no estimate chose.

    Args:
        posed: The structure.
        annealed: Its first chains; annealed here if None.
    """
    fit, restarted = _further(posed, _annealed(posed) if annealed is None else annealed)
    return without_outlier_robots(fit, mixed(fit, restarted=restarted))


def _further(posed: Posed, annealed: Annealed) -> tuple[Fit, int]:
    """Anneal as many chains from where ranges fit, if there are any; else those that failed again.

    Such starts unfold what the initial guess has folded. Returns as `_restarted`.
    """
    starts = further_starts(posed)
    if not starts:
        return _restarted(Fit.of(posed, annealed))
    start = np.array([starts[k % len(starts)] for k in range(len(annealed.mean))])
    return Fit.of(posed, annealed.joined(_annealed(posed, start=[start]))), 0


def _restarted(fit: Fit) -> tuple[Fit, int]:
    """Anneal chains that failed again, in ever smaller steps.

    Returns:
        All chains, and how many annealings were repeated.
    """
    restarted = 0
    for attempt in range(1, ANNEALING.restarts + 1):
        if not fit.has_failed.any():
            break
        again = _annealed(fit, halvings=attempt)
        restarted += int(fit.has_failed.sum())
        fit = Fit.of(fit, fit.annealed.with_chains(fit.has_failed, again))
    return fit, restarted


def _annealed(posed: Posed, **options: Any) -> Annealed:  # noqa: ANN401 - those of `anneal`
    return anneal([posed.log], [posed.params], [posed.problem], **options)[0]
