"""Accuracy of estimated positions, Eqs. (4) to (7) of the paper, statistics and error profiles.

The absolute position error (the translation part of the absolute pose error, APE) is that of each
robot in the world frame. The relative position error (RPE) is that of one robot as seen from
another. The alignments accept any number of robots in any arrangement: if points on a line or in
one place do not determine a rotation, they choose one of the best.

`estimate` and `truth` are the estimated and true centers of N robots [R], shape (N, 3).
"""

import math
import warnings

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from tiswarm.base.aliases import AnyInts, Ints, Reals
from tiswarm.measurements.contacts import hops
from tiswarm.records.estimate import Estimate
from tiswarm.records.intervals import mean_std_ci95
from tiswarm.records.measures import FEWEST, RMSE
from tiswarm.records.positions import Truth
from tiswarm.records.sensing_log import SensingLog


def robot_errors(estimate: Reals, truth: Reals) -> Reals:
    """Return the absolute position error of each robot [R], shape (N,).

    >>> robot_errors(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3)))
    array([5.])
    """
    return np.asarray(np.linalg.norm(estimate - truth, axis=1))


def relative_errors(estimate: Reals, truth: Reals, pairs: AnyInts) -> Reals:
    """Return the relative position error of each pair of robots [R], shape (P,).

    `pairs` are indices of two robots each, shape (P, 2).

    >>> shift = np.array([[2.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    >>> relative_errors(shift, np.zeros((2, 3)), np.array([[0, 1]]))
    array([0.])
    """
    off = estimate - truth
    return np.asarray(np.linalg.norm(off[pairs[:, 1]] - off[pairs[:, 0]], axis=1))


def sse(estimate: Reals, truth: Reals) -> float:
    """Return the sum of squared position errors [R^2], Eq. (4).

    >>> sse(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3)))
    25.0
    """
    return float(np.sum((estimate - truth) ** 2))


def rmse(estimate: Reals, truth: Reals) -> float:
    """Return the root mean square position error (RMSE) [R], Eq. (5).

    >>> rmse(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3)))
    5.0
    """
    return float(np.sqrt(sse(estimate, truth) / len(truth)))


def rms_radius(position: Reals) -> float:
    """Return the root mean square distance of N centers from their centroid [R].

    >>> rms_radius(np.array([[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    2.0
    """
    return float(np.sqrt(np.mean(np.sum((position - position.mean(axis=0)) ** 2, axis=1))))


def yaw_aligned(estimate: Reals, truth: Reals) -> Reals:
    """Align the estimate with the truth by yaw and translation, in the least-squares sense.

    Robots that sense gravity do not know their common yaw and position; this alignment removes
    errors of these four degrees of freedom only.

    >>> truth = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 1.0]])
    >>> turned = np.array([[5.0, 0.0, 0.0], [5.0, 2.0, 1.0]])
    >>> bool(np.allclose(yaw_aligned(turned, truth), truth))
    True
    """
    mean = estimate.mean(axis=0)
    e_x, e_y, _ = (estimate - mean).T
    t_x, t_y, _ = (truth - truth.mean(axis=0)).T
    yaw = math.atan2(float(e_x @ t_y - e_y @ t_x), float(e_x @ t_x + e_y @ t_y))
    turn = Rotation.from_euler("z", yaw)
    return np.asarray(turn.apply(estimate - mean) + truth.mean(axis=0))


def rigidly_aligned(estimate: Reals, truth: Reals) -> Reals:
    """Align the estimate with the truth by rotation and translation, Eq. (6).

    This is the Kabsch algorithm: Procrustes analysis without scaling and reflection.

    >>> truth = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    >>> lying = np.array([[5.0, 0.0, 0.0], [7.0, 0.0, 0.0]])
    >>> bool(np.allclose(rigidly_aligned(lying, truth), truth))
    True
    """
    mean = estimate.mean(axis=0)
    if len(truth) == 1:
        return truth.copy()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Optimal rotation is not uniquely")
        rotation, _ = Rotation.align_vectors(truth - truth.mean(axis=0), estimate - mean)
    return np.asarray(rotation.apply(estimate - mean) + truth.mean(axis=0))


def procrustes_disparity(estimate: Reals, truth: Reals) -> float:
    """Return the Procrustes disparity: squared error after rigid alignment, Eq. (7) [1].

    It is relative to the squared extent of the truth; zero means congruent. Unlike
    `scipy.spatial.procrustes`, the alignment neither rescales nor reflects. So the disparity is
    not bounded by 1, contrary to the paper: an estimate of twice the true size scores 1, of
    three times 4. It is NaN if all true centers coincide.

    >>> tower = np.array([[0, 0, 0], [0, 0, 2], [0, 1, 4], [1, 0, 6]], dtype=float)
    >>> procrustes_disparity(tower + 5.0, tower) < 1e-12
    True
    >>> round(procrustes_disparity(3.0 * tower, tower), 6)
    4.0
    """
    spread = float(np.sum((truth - truth.mean(axis=0)) ** 2))
    if spread == 0.0:
        return math.nan
    return sse(rigidly_aligned(estimate, truth), truth) / spread


def least_and_most(values: Reals) -> dict[str, float]:
    """Return the least and the greatest of the values that are finite, shape (n,); NaN of none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return {"least": math.nan, "most": math.nan}
    return {"least": float(finite.min()), "most": float(finite.max())}


def paired_difference(first: Reals, second: Reals) -> dict[str, float | int]:
    """Compare two conditions on the same structures, pair by pair.

    Structures differ more than conditions do, so paired differences are more certain than the
    difference of two means. There is one number for each structure, NaN if none, shape (n,).

    Returns:
        Number of pairs; mean, std and ci95 of second minus first; pairs in which the second is
        smaller, and larger; p-value of Wilcoxon's signed-rank test, NaN if no pair differs or
        there are fewer than `FEWEST`.

    >>> paired_difference(np.array([1.0, 2.0, 5.0]), np.array([0.5, 1.5, 4.5]))["smaller"]
    3
    """
    difference = second - first
    difference = difference[np.isfinite(difference)]
    p_value = math.nan
    if len(difference) >= FEWEST and difference.any():
        from scipy import stats  # noqa: PLC0415 - slow to import

        p_value = float(stats.wilcoxon(difference).pvalue)
    return {
        "structures": len(difference),
        **{f"difference_{name}": value for name, value in mean_std_ci95(difference).items()},
        "smaller": int((difference < 0.0).sum()),
        "larger": int((difference > 0.0).sum()),
        "wilcoxon_p": p_value,
    }


def power_law(x: Reals, y: Reals) -> tuple[float, float]:
    """Fit p of y ~ x^p by least squares of log y over log x [1], both of shape (n,).

    Returns:
        p, and the half width of its 95 % confidence interval by Student's t, if residuals of log y
        are independent and equally wide. Both are NaN with fewer than three different places, or a
        value that is not positive.

    >>> x = np.array([1.0, 4.0, 9.0])
    >>> [round(number, 9) for number in power_law(x, 7.0 * x**1.5)]
    [1.5, 0.0]
    """
    if len(np.unique(x)) < 3 or min(x.min(), y.min()) <= 0.0:  # noqa: PLR2004 - two fit exactly
        return math.nan, math.nan
    across = np.log(x) - np.log(x).mean()
    up = np.log(y) - np.log(y).mean()
    slope = across @ up / (across @ across)
    freedom = len(x) - 2
    variance = np.sum((up - slope * across) ** 2) / freedom / (across @ across)
    return float(slope), float(stdtrit(freedom, 0.975) * np.sqrt(variance))


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
        pairs = np.argwhere((apart == count) & ~log.is_gone & ~log.is_gone[start, None])
        pairs[:, 0] = start[pairs[:, 0]]
        if len(pairs):
            error = relative_errors(estimate.position, truth.position, pairs)
            rows.append({"hops_apart": count, "pairs": len(pairs), **_statistics(error)})
    return pd.DataFrame(rows, columns=["hops_apart", "pairs", "mean_error_R", RMSE.column])


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
    profiles = [_ranges(robots, name) for name in (*_COUNTS, "height_R")]
    return pd.concat(profiles, ignore_index=True)


def relative_profile(relative: pd.DataFrame) -> pd.DataFrame:
    """Combine rows of `relative.csv` of any number of structures, weighted by their pairs.

    Returns:
        Columns by, low, high, count (of pairs), mean_error_R, rmse_R.
    """
    rows = []
    for apart, group in relative.groupby("hops_apart"):
        pairs = group["pairs"].sum()
        weight = group["pairs"] / pairs
        mean = (weight * group["mean_error_R"]).sum()
        rmse = np.sqrt((weight * group[RMSE.column] ** 2).sum())
        row = {"by": "hops_apart", "low": apart, "high": apart, "count": pairs}
        rows.append(row | {"mean_error_R": mean, RMSE.column: rmse})
    return pd.DataFrame(rows)


def _ranges(robots: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return a row for each range of a variable that is not empty."""
    rows_with_error = robots[[name, "error_R"]].dropna()
    value = rows_with_error[name].to_numpy(np.float64)
    least = value.min()
    most = value.max()
    if name in _COUNTS:
        width = -(-(most - least + 1.0) // BINS)
        last = width - 1.0
    else:
        width = last = (most - least) / BINS
    range_index = np.zeros(len(value)) if width == 0.0 else (value - least) // width
    range_index = np.minimum(range_index, BINS - 1)
    rows = []
    for index, errors in rows_with_error["error_R"].groupby(range_index):
        p10, p90 = np.quantile(errors, [0.1, 0.9]).tolist()
        rows.append(
            {
                "by": name,
                "low": least + index * width,
                "high": min(least + index * width + last, most),
                "count": len(errors),
                **_statistics(errors.to_numpy()),
                "p10_R": p10,
                "p90_R": p90,
            }
        )
    return pd.DataFrame(rows)


def _statistics(error: Reals) -> dict[str, float]:
    return {"mean_error_R": float(error.mean()), RMSE.column: float(np.sqrt(np.mean(error**2)))}


def earlier_contact_count(log: SensingLog) -> Ints:
    """Count the contacts of each robot with robots that joined before it, shape (N,).

    Their mean over all robots but the anchor is what "contacts per robot" means: the equations
    that a robot has for its three unknowns when it joins.
    """
    return np.bincount(log.contacts[:, 2], minlength=log.robot_count)
