"""Grades what an estimate says against the truth, and sums grades up with 95 % intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from benchmarks.estimates.sets import Case
from benchmarks.logs.grade import ALIKE, HONEST, claims
from benchmarks.logs.limit import known_robots, optimum
from tiswarm.base.aliases import Bools, Reals
from tiswarm.evaluation.metrics import robot_errors
from tiswarm.measurements.verdicts import says_open
from tiswarm.records.estimate import HALF_WITHIN, MOST_WITHIN, Estimate
from tiswarm.records.sensing_log import SensingLog

FAR_SD = 5.0
"""Error beyond which a position is wrong, in its sd [1]."""

MOSTLY = 0.8
"""Share of robots in their 90 % spheres from which on an estimate is right in spite of a lie."""

SETTLED, MOST_CALLS = 1e-3, 40
"""Longest step of a determined robot at the optimum [dock radii], and calls of the optimizer."""

_LEAST_DETERMINED = 3


@dataclass(frozen=True, kw_only=True)
class Bound:
    """What a log determines, and how well; the same for all methods."""

    tied: Bools
    """Robots that measurements tie to the anchor, without those of `is_beacon`, shape (N,)."""

    determined: Bools
    """Those of them that no floppy motion shifts at the truth, shape (N,)."""

    optimum_rmse: float
    """RMSE of determined robots at the least cost nearest to the truth [dock radii]; NaN where
    hardly a robot is determined."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """How one method did on one log."""

    set: str
    number: int
    method: str
    kind: str
    lie: str
    robots: int
    refused: str = ""
    """Why the method cannot use the log."""

    trusted: bool = False
    """Whether both verdicts are good, or the method has none."""

    testable: bool = True
    """Whether the log could be found not consistent."""

    says_open: bool = False
    """Whether the verdict says that measurements do not determine where most robots are."""

    silent: bool = False
    """Trusted, with fewer than 60 % of the robots in their 90 % spheres."""

    beyond: bool = False
    """Trusted, with a robot farther than 5 sd from where it truly is."""

    said_or_right: bool = True
    """Not trusted, or at least 80 % of the robots are in their 90 % spheres."""

    tied: int = 0
    """Robots that measurements tie to the anchor, without beacons."""

    claimed: int = 0
    """Those of them whose positions the method claims to know, to their sd."""

    nees: float = np.nan
    """Mean square error of these robots in variances [1]."""

    within_50: float = np.nan
    """Share of these robots in their 50 % spheres [1]."""

    within_90: float = np.nan
    """Share of these robots in their 90 % spheres [1]."""

    rmse: float = np.nan
    """Root mean square error of robots that measurements tie to the anchor [dock radii]."""

    over_optimum: float = np.nan
    """RMSE of determined robots over `Bound.optimum_rmse`, 0.01 R added to both squares [1]."""

    cpu_s: float = np.nan
    """Processor time [s]."""


def bound(case: Case) -> Bound:
    """Find what a log determines, and minimize the cost from the truth."""
    log, truth = case.log, case.truth
    known, _ = known_robots(log, truth, "known")
    tied, determined = (robots & ~is_beacon(log) for robots in known)
    least = np.nan
    if determined.sum() >= _LEAST_DETERMINED:
        place = optimum(log, truth, determined, settled=SETTLED, calls=MOST_CALLS)
        off = robot_errors(place, truth)[determined]
        least = float(np.sqrt(np.mean(off**2))) / log.dock_radius
    return Bound(tied=tied, determined=determined, optimum_rmse=least)


def is_beacon(log: SensingLog) -> Bools:
    """Find the anchor, and robots with fixes in all directions, shape (N,)."""
    span = np.zeros((log.robot_count, 3, 3))
    normal = log.fixes[:, 1:4]
    np.add.at(span, log.fixes[:, 0].astype(np.int64), normal[:, :, None] * normal[:, None])
    found: Bools = np.linalg.matrix_rank(span) == len(span[0])
    found[0] = True
    return found


def grade(
    case: Case, limits: Bound, estimate: Estimate, *, name: str, number: int, method: str,
    cpu_s: float,
) -> Grade:  # fmt: skip
    """Grade an estimate of a log.

    Args:
        case: The log with its truth.
        limits: What the log determines.
        estimate: The estimate.
        name: Name of the set.
        number: Number of the log in it.
        method: Name of the method.
        cpu_s: Processor time [s].
    """
    log, verdicts = case.log, estimate.convergence
    placed = as_claimed(log, estimate, case.truth)
    off = robot_errors(placed, case.truth) / log.dock_radius
    claimed = claims(estimate) & limits.tied
    trusted = verdicts is None or verdicts.trusted
    scores: dict[str, float] = {}
    if estimate.sd is not None and claimed.any():
        sd = estimate.sd[claimed] / log.dock_radius
        error = off[claimed]
        scores = {
            "nees": float(np.mean(error**2 / (sd**2 + ALIKE**2))),
            "within_50": float(np.mean(error <= HALF_WITHIN * sd + ALIKE)),
            "within_90": float(np.mean(error <= MOST_WITHIN * sd + ALIKE)),
        }
    worst = float((error - FAR_SD * sd).max()) if scores else 0.0
    within = scores.get("within_90", 1.0)
    determined = off[limits.determined]
    over = np.nan
    if np.isfinite(limits.optimum_rmse):
        over = float(
            np.hypot(np.sqrt(np.mean(determined**2)), ALIKE) / np.hypot(limits.optimum_rmse, ALIKE)
        )
    return Grade(
        set=name,
        number=number,
        method=method,
        kind=case.kind,
        lie=case.lie,
        robots=log.robot_count,
        trusted=trusted,
        testable=verdicts is None or verdicts.testable,
        says_open=says_open(estimate),
        silent=trusted and within < HONEST,
        beyond=trusted and worst > ALIKE,
        said_or_right=not trusted or within >= MOSTLY,
        tied=int(limits.tied.sum()),
        claimed=int(claimed.sum()),
        rmse=float(np.sqrt(np.mean(off[limits.tied] ** 2))) if limits.tied.any() else np.nan,
        over_optimum=over,
        cpu_s=cpu_s,
        **scores,
    )


def as_claimed(log: SensingLog, estimate: Estimate, truth: Reals) -> Reals:
    """Move an estimate by the motions that it calls arbitrary, nearest to the truth.

    "rotation" is about the anchor, "axis" about the line through the anchors, or the vertical
    through one alone, and "hand" a mirror image.

    Returns:
        Centers [log unit], shape (N, 3).
    """
    free, anchor = estimate.free_frame, log.anchor_position
    here, there = estimate.position - anchor, truth - anchor
    if not free:
        return estimate.position
    known = there[is_beacon(log) & there.any(axis=1)]
    axis = known[0] / np.linalg.norm(known[0]) if len(known) else np.array([0.0, 0.0, 1.0])
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    images = [here]
    if "hand" in free:
        images.append(here - 2.0 * np.outer(here @ across, across))
    if "rotation" in free:
        images = [_turn(image, there).apply(image) for image in images]
    elif "axis" in free:
        images = [_about(axis, image, there).apply(image) for image in images]
    return anchor + min(images, key=lambda image: float(((image - there) ** 2).sum()))


def _turn(here: Reals, there: Reals) -> Rotation:
    u, _, vt = np.linalg.svd(there.T @ here)
    return Rotation.from_matrix(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _about(axis: Reals, here: Reals, there: Reals) -> Rotation:
    sine = float((np.cross(here, there) @ axis).sum())
    along = np.outer(here @ axis, axis)
    cosine = float(((here - along) * there).sum())
    return Rotation.from_rotvec(np.arctan2(sine, cosine) * axis)


def share(count: int, total: int) -> str:
    """Write a count and its share with Wilson's 95 % interval: "15 (10 %, 6-16)"."""
    if not total:
        return str(count)
    ends = binomtest(count, total).proportion_ci(method="wilson")
    return f"{count} ({100 * count / total:.0f} %, {100 * ends.low:.0f}-{100 * ends.high:.0f})"


def _said(grades: pd.DataFrame) -> str:
    """Count the estimates whose verdicts say that most robots are not determined."""
    return f"{int(grades['says_open'].sum())} of {len(grades)}"


def summary(grades: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Sum grades up, a row for each combination of the columns `by`.

    Shares of silent logs and of those beyond 5 sd are of trusted logs; NEES and shares in spheres
    are means over trusted logs.
    """
    rows = []
    for key, every in grades.groupby(list(by), sort=False):
        own = every[every["refused"] == ""]
        trusted = own[own["trusted"]]
        rows.append(
            {
                **dict(zip(by, key, strict=True)),
                "logs": len(own),
                "trusted": len(trusted),
                "untestable": int((~trusted["testable"]).sum()),
                "claimed": trusted["claimed"].sum() / max(trusted["tied"].sum(), 1),
                "silent": share(int(trusted["silent"].sum()), len(trusted)),
                "open_of_silent": _said(trusted[trusted["silent"]]),
                "open_of_others": _said(trusted[~trusted["silent"]]),
                "beyond_5_sd": share(int(trusted["beyond"].sum()), len(trusted)),
                "said_or_right": share(int(own["said_or_right"].sum()), len(own)),
                "nees": trusted["nees"].dropna().mean(),
                "within_50": trusted["within_50"].dropna().mean(),
                "within_90": trusted["within_90"].dropna().mean(),
                "median_R": own["rmse"].dropna().median(),
                "mean_R": own["rmse"].dropna().mean(),
                "over_optimum": own["over_optimum"].dropna().median(),
                "cpu_s": own["cpu_s"].mean(),
            }
        )
    return pd.DataFrame(rows)
