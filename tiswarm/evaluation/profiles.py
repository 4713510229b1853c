"""Error profiles: position errors by variables of the robots, and relative errors by hops."""

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.evaluation.metrics import relative_errors
from tiswarm.measurements.contacts import hops
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import Truth
from tiswarm.records.sensing_log import SensingLog

BINS = 10
"""Largest number of ranges of a variable."""

_COUNTS = ("join", "hops_from_anchor", "contacts")  # variables that are whole numbers
_HOPS_APART = (1, 2, 4, 8, 16, 32, 64)
_MOST_PAIRS = 2_000_000  # to bound time and memory; larger swarms are subsampled


def by_hops_apart(truth: Truth, log: SensingLog, estimate: Estimate) -> pd.DataFrame:
    """Tabulate relative position errors of pairs of robots by the hops between them.

    If errors add up along contacts, the relative error grows with the hops.

    Returns:
        Columns hops_apart, pairs, mean_error_R, rmse_R.
    """
    start = np.arange(0, log.robot_count, max(1, log.robot_count**2 // _MOST_PAIRS))
    apart = hops(log, start)
    rows = []
    for count in _HOPS_APART:
        pairs = np.argwhere(apart == count)
        pairs[:, 0] = start[pairs[:, 0]]
        if len(pairs):
            error = relative_errors(estimate.position, truth.position, pairs)
            rows.append({"hops_apart": count, "pairs": len(pairs), **_statistics(error)})
    return pd.DataFrame(rows, columns=["hops_apart", "pairs", "mean_error_R", "rmse_R"])


def error_profile(robots: pd.DataFrame) -> pd.DataFrame:
    """Tabulate position errors by join, height, hops from the anchor and contacts, in ranges.

    Args:
        robots: Rows of `robots.csv` of any number of structures, with a column `join`.

    Returns:
        Columns by, low, high (both ends included), count (of robots), mean_error_R, rmse_R, and
        the 10 % and 90 % quantiles p10_R and p90_R.

    >>> robots = pd.DataFrame({"join": [0, 1], "z_R": [1.0, 3.0], "error_R": [0.0, 2.0]})
    >>> profile = error_profile(robots.assign(hops_from_anchor=[0, 1], contacts=1))
    >>> profile.loc[profile["by"] == "join", "rmse_R"].tolist()
    [0.0, 2.0]
    """
    robots = robots.assign(height_R=robots["z_R"])
    parts = [_ranges(robots, name) for name in (*_COUNTS, "height_R")]
    return pd.concat(parts, ignore_index=True)


def relative_profile(relative: pd.DataFrame) -> pd.DataFrame:
    """Combine rows of `relative.csv` of any number of structures, weighted by their pairs.

    Returns:
        Columns by, low, high, count (of pairs), mean_error_R, rmse_R.
    """
    rows = []
    for apart, part in relative.groupby("hops_apart"):
        pairs = part["pairs"].sum()
        weight = part["pairs"] / pairs
        mean = (weight * part["mean_error_R"]).sum()
        rmse = np.sqrt((weight * part["rmse_R"] ** 2).sum())
        row = {"by": "hops_apart", "low": apart, "high": apart, "count": pairs}
        rows.append(row | {"mean_error_R": mean, "rmse_R": rmse})
    return pd.DataFrame(rows)


def _ranges(robots: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return a row for each range of a variable that is not empty."""
    known = robots[[name, "error_R"]].dropna()
    value = known[name].to_numpy(np.float64)
    least, most = value.min(), value.max()
    if name in _COUNTS:
        width = -(-(most - least + 1.0) // BINS)
        last = width - 1.0
    else:
        width = last = (most - least) / BINS
    place = np.zeros(len(value)) if width == 0.0 else (value - least) // width
    place = np.minimum(place, BINS - 1)
    rows = [
        {
            "by": name,
            "low": least + where * width,
            "high": min(least + where * width + last, most),
            "count": len(part),
            **_statistics(part.to_numpy()),
            **dict(zip(("p10_R", "p90_R"), np.quantile(part, [0.1, 0.9]).tolist(), strict=True)),
        }
        for where, part in known["error_R"].groupby(place)
    ]
    return pd.DataFrame(rows)


def _statistics(error: Reals) -> dict[str, float]:
    return {"mean_error_R": float(error.mean()), "rmse_R": float(np.sqrt(np.mean(error**2)))}
