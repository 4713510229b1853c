"""Means over structures with their confidence intervals."""

import math

import numpy as np
from scipy.special import stdtrit

from tiswarm.base.aliases import Reals
from tiswarm.records.measures import FEWEST, Measure


def mean_std_ci95(values: Reals) -> dict[str, float]:
    """Return mean, standard deviation and half width of the 95 % confidence interval of the mean.

    There is one value for each structure, NaN if it has none, shape (n,). The interval is
    Student's, of `FEWEST` values or more. A result that needs more values is NaN.

    >>> mean_std_ci95(np.array([1.0, 2.0, 3.0, math.nan]))["std"]
    1.0
    """
    finite = values[np.isfinite(values)]
    count = len(finite)
    mean = float(finite.mean()) if count else math.nan
    std = float(finite.std(ddof=1)) if count > 1 else math.nan
    is_enough = count >= FEWEST
    width = float(stdtrit(count - 1, 0.975)) * std / math.sqrt(count) if is_enough else math.nan
    return {"mean": mean, "std": std, "ci95": width}


_NORMAL_975 = 1.959964
"""Quantile of the normal distribution [standard deviations]."""


def share_ci95(values: Reals) -> dict[str, float]:
    """Return the ends of Wilson's 95 % confidence interval of a share of structures, from 0 to 1.

    There is one value for each structure, 0 or 1, NaN if it has none, shape (n,). Wilson, JASA 22
    (1927), 209-212.

    >>> {name: round(end, 3) for name, end in share_ci95(np.ones(64)).items()}
    {'ci95_low': 0.943, 'ci95_high': 1.0}
    """
    finite = values[np.isfinite(values)]
    count = float(len(finite))
    if not count:
        return {"ci95_low": math.nan, "ci95_high": math.nan}
    share = float(finite.mean())
    square = _NORMAL_975**2 / count
    center = (share + 0.5 * square) / (1.0 + square)
    half = math.sqrt(square * (share * (1.0 - share) + 0.25 * square)) / (1.0 + square)
    return {"ci95_low": max(0.0, center - half), "ci95_high": min(1.0, center + half)}


def mean_share_ci95(values: Reals) -> dict[str, float]:
    """Return the ends of Student's 95 % confidence interval of a mean share, cut off at 0 and 1.

    There is one share for each structure, such as that of its robots that are located, NaN if it
    has none, shape (n,). Wilson's interval is not for these: n structures with all robots located
    are many robots, not n of n. Fewer than `FEWEST` values have no interval: NaN.

    >>> [round(end, 3) for end in mean_share_ci95(np.array([0.9, 0.95, 1, 1, 1])).values()]
    [0.914, 1.0]
    """
    statistics = mean_std_ci95(values)
    mean, half = statistics["mean"], statistics["ci95"]
    if math.isnan(half):
        return {"ci95_low": math.nan, "ci95_high": math.nan}
    return {"ci95_low": max(0.0, mean - half), "ci95_high": min(1.0, mean + half)}


def ends_of(measure: Measure, values: Reals) -> dict[str, float]:
    """Return the ends of the 95 % confidence interval of the mean of a share, by its kind.

    There is one value for each structure, NaN if it has none, shape (n,).
    """
    return share_ci95(values) if measure.is_yes_or_no else mean_share_ci95(values)
