"""Grades estimates of logs by the limits of these, and sums grades of a method up."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Bools, Reals
from tiswarm.evaluation.metrics import rigidly_aligned, rmse, robot_errors
from tiswarm.records.estimate import MOST_WITHIN, Estimate
from tiswarm.records.intervals import mean_std_ci95

ALIKE = 0.01
"""Errors that small count as equal, in dock radii: of a log without noise the limit is 0."""

HONEST = 0.6
"""Share of robots in their 90 % spheres from which on an estimate without a warning is right. Less
than 0.9, since robots of a structure share errors."""

FAR_OFF = 10.0
"""Error over the limit from which on an estimate without a warning is wrong, if no `sd` says."""

HALF = 0.5
"""Share of robots that are floppy from which on a log is open, or a method claims nothing."""


class Known(NamedTuple):
    """What a log determines of N robots, at the truth."""

    tied: Bools
    """Robots that measurements tie to the anchor, shape (N,)."""

    determined: Bools
    """Those that no floppy motion shifts but one of the whole structure, shape (N,)."""


@dataclass(frozen=True, kw_only=True)
class Bound:
    """What can be known from one log; a row of `limits.csv`."""

    log: str
    group: str
    about: str
    unit: str
    """Unit of lengths of the log."""

    dock_radius: float
    """In that unit."""

    robots: int
    tied: int
    """Robots that measurements tie to the anchor; no error counts of others."""

    floppy: int
    """Motions within the structure that no measurement resists, except that docks must not overlap.
    """

    images: int
    """Configurations that fit what was sensed as well as the truth does."""

    determined: int
    """Tied robots that no floppy motion shifts at the truth."""

    limit: float
    """RMSE of these robots at the least cost nearest to the truth [unit]."""

    frame: Literal["known", "free"]
    """Whether measurements say where the structure stands, or its shape alone."""

    @property
    def is_open(self) -> bool:
        """Whether no method gets to the limit, but by chance.

        There are several configurations, or floppy motions shift more than half of the robots.
        """
        return self.images > 1 or self.determined < HALF * self.robots


@dataclass(frozen=True, kw_only=True)
class Grade:
    """How one method did on one log."""

    method: str
    log: str
    group: str
    rmse: float
    """Root mean square error of tied robots [dock radii]; NaN if the method cannot use the log."""

    over_limit: float
    """Error of determined robots over the limit, `ALIKE` added to both squares [1]; NaN for logs
    that are open."""

    within_90: float
    """Share of tied robots in their 90 % spheres, of those that the method claims to know [1]; NaN
    where there are none, or the method states no `sd`."""

    verdict: str
    """`trusted`, `warned`; `none` if the method has no verdicts; else why it cannot use the log."""

    silent: bool
    """Whether it is wrong and does not say so."""

    cpu_s: float
    """Processor time [s]; NaN if somebody else ran the method."""


def error(estimate: Reals, truth: Reals, frame: Literal["known", "free"]) -> float:
    """Compute the RMSE of centers, shape (N, 3).

    In a `free` frame, it is that of the shape: after the best rotation and translation, of the
    estimate or its mirror image.
    """
    if frame == "known":
        return rmse(estimate, truth)
    mirrored = estimate * [1.0, 1.0, -1.0]
    return min(rmse(rigidly_aligned(each, truth), truth) for each in (estimate, mirrored))


def grade(
    method: str, bound: Bound, estimate: Estimate, truth: Reals, known: Known, cpu_s: float
) -> Grade:
    """Grade an estimate.

    Args:
        method: Name of the method.
        bound: What can be known from the log.
        estimate: The estimate.
        truth: True centers [log unit], shape (N, 3).
        known: Robots that the log ties and determines.
        cpu_s: Processor time [s].
    """
    tied, determined = known
    missed = error(estimate.position[tied], truth[tied], bound.frame)
    least = ALIKE * bound.dock_radius
    some = determined if determined.any() else tied
    of_determined = error(estimate.position[some], truth[some], bound.frame)
    over = float(np.hypot(of_determined, least) / np.hypot(bound.limit, least))
    within = np.nan
    has_spheres = estimate.sd is not None and bound.frame == "known"
    claimed = claims(estimate) & tied
    claimed[0] = False
    if estimate.sd is not None and has_spheres and claimed.any():
        off = robot_errors(estimate.position, truth)[claimed]
        within = float((off <= MOST_WITHIN * estimate.sd[claimed] + least).mean())
    verdicts = estimate.convergence
    trusted = verdicts is None or verdicts.trusted
    is_wrong = within < HONEST
    if not has_spheres:
        is_wrong = over > FAR_OFF and not bound.is_open and _claims_most(estimate)
    return Grade(
        method=method,
        log=bound.log,
        group=bound.group,
        rmse=missed / bound.dock_radius,
        over_limit=np.nan if bound.is_open else over,
        within_90=within,
        verdict="none" if verdicts is None else "trusted" if trusted else "warned",
        silent=trusted and is_wrong,
        cpu_s=cpu_s,
    )


def claims(estimate: Estimate) -> Bools:
    """Find the robots whose positions an estimate claims to know, to their sd, shape (N,).

    Those are neither disconnected nor of a method that did not locate them, and their sd is finite.
    """
    known = ~estimate.disconnected
    if estimate.located is not None:
        known = known & estimate.located
    return known if estimate.sd is None else known & np.isfinite(estimate.sd)


def _claims_most(estimate: Estimate) -> bool:
    """Judge whether an estimate calls at most half of the positions floppy."""
    seen = estimate.observability
    return seen is None or seen.floppy is None or float(seen.floppy.mean()) <= HALF


def refused(method: str, bound: Bound, why: str) -> Grade:
    """Grade a method that cannot use a log."""
    nan = float("nan")
    return Grade(
        method=method, log=bound.log, group=bound.group, rmse=nan, over_limit=nan, within_90=nan,
        verdict=why, silent=False, cpu_s=nan,
    )  # fmt: skip


def summary(grades: pd.DataFrame) -> pd.DataFrame:
    """Sum up each method, in the order of the grades.

    Errors over limits are averaged as geometric means, with 95 % confidence intervals over logs;
    `open_R` is the geometric mean of the errors on logs that are open [dock radii].
    """
    rows = []
    for method, own in grades.groupby("method", sort=False):
        used = own[own["rmse"].notna()]
        known = used[used["over_limit"].notna()]
        mean = mean_std_ci95(np.log(known["over_limit"].to_numpy(np.float64)))
        unknown = used[used["over_limit"].isna()]["rmse"].to_numpy(np.float64)
        rows.append(
            {
                "method": method,
                "logs": len(used),
                "over_limit": np.exp(mean["mean"]),
                "from": np.exp(mean["mean"] - mean["ci95"]),
                "to": np.exp(mean["mean"] + mean["ci95"]),
                "open_R": np.exp(np.log(np.hypot(unknown, ALIKE)).mean()) if unknown.size else None,
                "warned": int((used["verdict"] == "warned").sum()),
                "silent": int(used["silent"].sum()),
                "cpu_s": used["cpu_s"].sum(min_count=1),
            }
        )
    return pd.DataFrame(rows)
