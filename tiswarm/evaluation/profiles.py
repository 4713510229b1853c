"""Where in a structure errors are large, and how they grow from robot to robot."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.measurements.contacts import hops
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import Truth
from tiswarm.records.sensing_log import SensingLog

WHOLE = ("join", "hops_from_anchor", "contacts")
"""What errors are told by that is counted."""

HEIGHT = "height_R"
BINS = 10
"""Most ranges that a quantity is cut into."""

HOPS_APART = (1, 2, 4, 8, 16, 32, 64)
PAIRS_LOOKED_AT = 2_000_000
"""Of larger swarms, pairs that start at every so many robots only, to bound time and memory."""


def relative_errors(
    estimate: NDArray[np.float64], truth: NDArray[np.float64], pairs: NDArray[np.integer]
) -> NDArray[np.float64]:
    """How far each robot's estimate is off as seen from another's [R], shape (P,).

    Args:
        estimate: Estimated centers [R], shape (N, 3).
        truth: True centers [R], shape (N, 3).
        pairs: Two robots each, shape (P, 2).
    """
    off = estimate - truth
    distance: NDArray[np.float64] = np.linalg.norm(off[pairs[:, 1]] - off[pairs[:, 0]], axis=1)
    return distance


def by_hops_apart(truth: Truth, log: SensingLog, estimate: Estimate) -> pd.DataFrame:
    """One row a number of contacts between two robots: relative errors of all pairs so far apart.

    A chain of contacts that adds up errors shows as growth with the number.
    """
    start = np.arange(0, log.robot_count, max(1, log.robot_count**2 // PAIRS_LOOKED_AT))
    apart = hops(log, start)
    rows = []
    for count in HOPS_APART:
        pairs = np.argwhere(apart == count)
        pairs[:, 0] = start[pairs[:, 0]]
        if len(pairs):
            error = relative_errors(estimate.position, truth.position, pairs)
            rows.append({"hops_apart": count, "pairs": len(pairs), **_statistics(error)})
    return pd.DataFrame(rows, columns=["hops_apart", "pairs", "mean_error_R", "rmse_R"])


def error_profile(robots: pd.DataFrame) -> pd.DataFrame:
    """Errors by join, height, hops from the anchor and contacts, each cut into ranges.

    Args:
        robots: Rows of `robots.csv`, of any number of structures, with the column `join`.

    Returns:
        Columns by, low, high (both ends included), count (of robots), mean_error_R and rmse_R.
    """
    robots = robots.assign(**{HEIGHT: robots["z_R"]})
    parts = [_ranges(robots, name) for name in (*WHOLE, HEIGHT)]
    return pd.concat(parts, ignore_index=True)


def relative_profile(relative: pd.DataFrame) -> pd.DataFrame:
    """Relative errors by hops apart, in the columns of `error_profile`; counts are of pairs.

    Args:
        relative: Rows of `relative.csv`, of any number of structures.
    """
    rows = []
    for count, part in relative.groupby("hops_apart"):
        weight = part["pairs"] / part["pairs"].sum()
        rows.append(
            {
                "by": "hops_apart",
                "low": count,
                "high": count,
                "count": part["pairs"].sum(),
                "mean_error_R": (weight * part["mean_error_R"]).sum(),
                "rmse_R": np.sqrt((weight * part["rmse_R"] ** 2).sum()),
            }
        )
    return pd.DataFrame(rows)


def _ranges(robots: pd.DataFrame, name: str) -> pd.DataFrame:
    """Rows of one quantity's ranges, empty ones left out."""
    known = robots[[name, "error_R"]].dropna()
    value = known[name].to_numpy(np.float64)
    least, most = value.min(), value.max()
    if name in WHOLE:
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
        }
        for where, part in known["error_R"].groupby(place)
    ]
    return pd.DataFrame(rows)


def _statistics(error: NDArray[np.float64]) -> dict[str, float]:
    return {"mean_error_R": float(error.mean()), "rmse_R": float(np.sqrt(np.mean(error**2)))}
