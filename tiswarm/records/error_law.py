"""The law of error / sd: how far robots are from their estimated positions, in standard deviations.

A chi law of a free number of dimensions is the core, as of normal errors along one to three axes. A
second part, as of a Student law with one degree of freedom, is the heavy tail: robots whose `sd` is
wrong, since a measurement or its stated noise is.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from tiswarm.base.aliases import Reals

SURE = 0.95
"""Probability from which on an estimate says that a robot is within a distance [1]."""

_GREATEST = 1e12
"""Ratio of error and sd beyond which no robot is [1]."""

_HALVINGS = 100


@dataclass(frozen=True, kw_only=True)
class ErrorLaw:
    """Mixture of two laws of the ratio of error and sd, an error being a distance in space."""

    width: float
    """Root mean square ratio of the core [1]."""

    dimensions: float
    """Degrees of freedom of the chi law of both parts [1]."""

    tail_share: float
    """Share of the tail in the mixture [1]."""

    tail_width: float
    """Ratio that scales the tail [1]."""

    def probability(self, ratio: Reals) -> Reals:
        """Compute the probability that error / sd is below ratios of any shape [1]."""
        from scipy.special import betainc, gammainc  # noqa: PLC0415 - slow to import

        freedom = 0.5 * self.dimensions
        core = gammainc(freedom, freedom * (ratio / self.width) ** 2)
        # Of great ratios the share would be 1 - 1e-16: its complement has more digits.
        beyond = betainc(
            0.5, freedom, 1.0 / (1.0 + self.dimensions * (ratio / self.tail_width) ** 2)
        )
        below: Reals = core - self.tail_share * (core - (1.0 - beyond))
        return below

    def ratio(self, probability: float) -> float:
        """Compute the ratio below which error / sd is with a probability, from 0 to below 1 [1]."""
        low, high = 0.0, _GREATEST
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if float(self.probability(np.array(middle))) < probability:
                low = middle
            else:
                high = middle
        return high


ERRORS = ErrorLaw(width=0.9, dimensions=1.3, tail_share=0.12, tail_width=1.2)
"""The law of all methods, to two digits: fitted by `benchmarks.within` on training logs alone. The
record is `docs/fits/errors.json`; `docs/accuracy.md` has how it does on others."""


@cache
def sure_ratio() -> float:
    """Compute the distance in which a robot is with probability `SURE`, in its sd [1]."""
    return ERRORS.ratio(SURE)
