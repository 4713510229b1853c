"""How far chance takes a chi-square: a sum of squared residuals in variances.

With k degrees of freedom it has the mean k and the variance 2 k. Where a decision must not depend
on the tail of the distribution, as in a ranking, we count standard deviations; where many groups
are tested, the distribution itself says how rare one of them is.
"""

from typing import overload

import numpy as np
from scipy.special import bdtrc, chdtrc, chdtri  # scipy.stats would take .3 s to import

from tiswarm.base.aliases import AnyInts, Reals


@overload
def chi_square_sd(freedom: int) -> float: ...
@overload
def chi_square_sd(freedom: AnyInts) -> Reals: ...
def chi_square_sd(freedom: int | AnyInts) -> float | Reals:
    """Return the standard deviation of a chi-square with these degrees of freedom [1]."""
    sd: float | Reals = np.sqrt(2.0 * freedom)
    return sd


@overload
def chi_square_limit(freedom: int, most_sd: float) -> float: ...
@overload
def chi_square_limit(freedom: AnyInts, most_sd: float) -> Reals: ...
def chi_square_limit(freedom: int | AnyInts, most_sd: float) -> float | Reals:
    """Return the chi-square that exceeds its mean by this many standard deviations [1]."""
    limit: float | Reals = np.add(freedom, most_sd * chi_square_sd(freedom))
    return limit


def chi_square_excess(square: float, freedom: int) -> float:
    """Compute how far a chi-square exceeds its mean, in its standard deviations.

    Args:
        square: The chi-square [1].
        freedom: Its degrees of freedom; without any, its standard deviation counts as that of one.
    """
    return float((square - freedom) / chi_square_sd(max(freedom, 1)))


def chi_square_chance(square: Reals | AnyInts, freedom: AnyInts | Reals) -> Reals:
    """Compute the chance that a chi-square is at least as large.

    Args:
        square: Chi-squares [1], shape (n,); negative ones, which rounding leaves, count as 0.
        freedom: Their degrees of freedom, shape (n,); less than one counts as one.

    Returns:
        Chances [1], shape (n,).
    """
    chance: Reals = chdtrc(np.maximum(freedom, 1), np.maximum(square, 0.0))
    return chance


def binomial_chance(count: int, trials: int, rate: float) -> float:
    """Compute the chance that at least `count` of some trials succeed.

    Args:
        count: Successes, at least 1.
        trials: Trials.
        rate: Chance of one success [1].
    """
    return float(bdtrc(count - 1, trials, rate))


MEDIAN_SQUARE = float(chdtri(1, 0.5))
"""Median of a chi-square with one degree of freedom [1]."""
