"""How far chance takes a chi-square: a sum of squared residuals in variances.

With k degrees of freedom it has the mean k and the variance 2 k. Where a decision must not depend
on the tail of the distribution, as in a ranking, we count standard deviations; where many groups
are tested, the distribution itself says how rare one of them is.
"""

import numpy as np
from scipy.special import chdtrc, chdtri  # scipy.stats would take .3 s to import

from tiswarm.base.aliases import AnyInts, Reals


def chi_square_sd(freedom: float | AnyInts) -> Reals:
    """Return the standard deviation of a chi-square with these degrees of freedom [1]."""
    return np.sqrt(2.0 * freedom)


def chi_square_limit(freedom: float | AnyInts, most_sd: float) -> Reals:
    """Return the chi-square that exceeds its mean by this many standard deviations [1]."""
    return freedom + most_sd * chi_square_sd(freedom)


def chi_square_excess(square: float, freedom: int) -> float:
    """Compute how far a chi-square exceeds its mean, in its standard deviations.

    Args:
        square: The chi-square [1].
        freedom: Its degrees of freedom; without any, its standard deviation counts as that of one.
    """
    return float((square - freedom) / chi_square_sd(max(freedom, 1)))


def chi_square_chance(square: Reals, freedom: AnyInts | Reals) -> Reals:
    """Compute the chance that a chi-square is at least as large.

    Args:
        square: Chi-squares [1], shape (n,); negative ones, which rounding leaves, count as 0.
        freedom: Their degrees of freedom, shape (n,); less than one counts as one.

    Returns:
        Chances [1], shape (n,).
    """
    chance: Reals = chdtrc(np.maximum(freedom, 1), np.maximum(square, 0.0))
    return chance


MEDIAN_SQUARE = float(chdtri(1, 0.5))
"""Median of a chi-square with one degree of freedom [1]."""
