"""What few structures say about all there could be: means, their certainty, differences."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

LEVEL = 0.95
"""How often an interval holds the true mean."""

FEWEST = 2
"""Values that a spread needs."""

FEWEST_FOR_EXPONENT = 3
"""Different places that a fit of an exponent needs: two always fit."""


def spread(values: NDArray[np.float64]) -> dict[str, float]:
    """Mean, standard deviation and half width of the mean's confidence interval.

    The interval is Student's; NaN stands for what the values are too few for.

    Args:
        values: One number a structure, NaN where it has none, shape (n,).
    """
    known = values[np.isfinite(values)]
    count = len(known)
    mean = float(known.mean()) if count else math.nan
    if count < FEWEST:
        return {"mean": mean, "std": math.nan, "ci95": math.nan}
    std = float(known.std(ddof=1))
    width = float(stdtrit(count - 1, 0.5 + LEVEL / 2.0)) * std / math.sqrt(count)
    return {"mean": mean, "std": std, "ci95": width}


def paired_difference(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> dict[str, float | int]:
    """How much a second condition differs from a first on the same structures.

    Structures differ more than conditions do; differences within each of them tell more than two
    means.

    Args:
        first: One number a structure, NaN where it has none, shape (n,).
        second: The same under another condition, shape (n,).

    Returns:
        The structures that have both, spread of second minus first, in how many the second is
        smaller, and the p-value of Wilcoxon's signed-rank test, NaN where nothing differs.
    """
    difference = second - first
    difference = difference[np.isfinite(difference)]
    p_value = math.nan
    if difference.any():
        from scipy import stats  # noqa: PLC0415 - slow to import

        p_value = float(stats.wilcoxon(difference).pvalue)
    return {
        "structures": len(difference),
        **{f"difference_{name}": value for name, value in spread(difference).items()},
        "smaller": int((difference < 0.0).sum()),
        "wilcoxon_p": p_value,
    }


def power_law_exponent(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Fit p of y ~ x^p by least squares of log y over log x [1].

    Args:
        x: Places, shape (n,).
        y: Values, shape (n,).

    Returns:
        The exponent; NaN with fewer than three different places or a value that is not positive.

    >>> x = np.array([1.0, 4.0, 9.0])
    >>> round(power_law_exponent(x, 7.0 * x**1.5), 9)
    1.5
    """
    if len(np.unique(x)) < FEWEST_FOR_EXPONENT or min(x.min(), y.min()) <= 0.0:
        return math.nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
