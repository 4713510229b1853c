"""An estimate held against the truth: by robot, by iteration, and in one row."""

from collections.abc import Collection

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.evaluation import metrics
from tiswarm.evaluation.profiles import relative_errors
from tiswarm.measurements.contacts import contact_count, earlier_contact_count, hops
from tiswarm.measurements.linear import equations
from tiswarm.measurements.rigidity import floppy_modes, weld
from tiswarm.records.estimate import HALF_WITHIN, MOST_WITHIN, Estimate
from tiswarm.records.positions import Truth
from tiswarm.records.sensing_log import SensingLog
from tiswarm.robot import RobotGeometry


def score(
    truth: Truth,
    log: SensingLog,
    estimate: Estimate,
    robot: RobotGeometry,
    *,
    cues: Collection[str],
) -> dict[str, float | int]:
    """Score one estimate, beside what decides how good it can be."""
    estimated, true = estimate.position, truth.position
    rmse = metrics.rmse(estimated, true)
    turning = estimate.yaw is not None
    modes = floppy_modes(weld(equations(true, log, cues, turning=turning)))
    return {
        "robots": log.robot_count,
        "contacts_per_robot": _mean(earlier_contact_count(log)[1:]),
        "rms_radius_R": metrics.rms_radius(true),
        "floppy_modes": np.nan if modes is None else modes,
        "unlocated": int((~estimate.located).sum()),
        "sse_R2": metrics.sse(estimated, true),
        "rmse_R": rmse,
        "rmse_rho": rmse / robot.rho,
        "rmse_yaw_aligned_R": metrics.rmse(metrics.yaw_aligned(estimated, true), true),
        "rmse_rigid_aligned_R": metrics.rmse(metrics.rigidly_aligned(estimated, true), true),
        "rmse_per_contact_R": _mean(relative_errors(estimated, true, log.contacts[:, [0, 2]]) ** 2)
        ** 0.5,
        "procrustes_disparity": metrics.procrustes_disparity(estimated, true),
        **_coverage(truth, estimate),
        **_convergence(estimate),
    }


def by_robot(
    truth: Truth, log: SensingLog, estimate: Estimate, sensed_force: NDArray[np.float64]
) -> pd.DataFrame:
    """One row a robot, in join order: true and estimated pose, error, what it touches and bears.

    Args:
        truth: Where the robots are.
        log: What they sensed.
        estimate: Where they are thought to be.
        sensed_force: What each feels in its links [weight of a dock], shape (N,).
    """
    columns: dict[str, object] = {"robot": truth.robot_id}
    columns |= dict(zip(("x_R", "y_R", "z_R"), truth.position.T, strict=True))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), truth.orientation_wxyz.T, strict=True))
    columns |= dict(zip(("x_est_R", "y_est_R", "z_est_R"), estimate.position.T, strict=True))
    sensed = ("qw_sensed", "qx_sensed", "qy_sensed", "qz_sensed")
    columns |= dict(zip(sensed, log.orientation_wxyz.T, strict=True))
    for name, aligned in (
        ("error_R", estimate.position),
        ("error_yaw_aligned_R", metrics.yaw_aligned(estimate.position, truth.position)),
        ("error_rigid_aligned_R", metrics.rigidly_aligned(estimate.position, truth.position)),
    ):
        columns[name] = metrics.robot_errors(aligned, truth.position)
    columns["contacts"] = contact_count(log)
    columns["hops_from_anchor"] = _whole(hops(log, np.zeros(1, np.int64))[0])
    columns["ground_docks"] = np.bincount(log.ground_docks[:, 0], minlength=log.robot_count)
    columns["flip_height_R"] = log.flip_height
    columns["located"] = estimate.located
    columns["sensed_force"] = sensed_force
    return pd.DataFrame(columns)


def by_iteration(truth: Truth, estimate: Estimate) -> pd.DataFrame:
    """One row a recorded iteration: errors and the residual that the localizer itself saw."""
    return pd.DataFrame(
        [
            {
                "iteration": iteration,
                "sse_R2": metrics.sse(frame, truth.position),
                "rmse_R": metrics.rmse(frame, truth.position),
                "procrustes_disparity": metrics.procrustes_disparity(frame, truth.position),
                "residual_R": residual,
            }
            for iteration, frame, residual in zip(
                estimate.iteration, estimate.trace, estimate.residual, strict=True
            )
        ]
    )


def _coverage(truth: Truth, estimate: Estimate) -> dict[str, float]:
    """Parts of the robots within their 50 and 90 % intervals, the anchor aside."""
    if estimate.sd is None:
        return {}
    error, sd = metrics.robot_errors(estimate.position, truth.position)[1:], estimate.sd[1:]
    return {
        "coverage_50": _mean(error <= HALF_WITHIN * sd),
        "coverage_90": _mean(error <= MOST_WITHIN * sd),
    }


def _convergence(estimate: Estimate) -> dict[str, float | int]:
    """Scores of the method's convergence; none where the method does not judge it."""
    found = estimate.convergence
    if found is None:
        return {}
    return {
        "converged": found.converged,
        "misfit_sd": found.misfit_sd,
        "chains": found.chains,
        "restarted_chains": found.restarted,
    }


def _mean(values: NDArray[np.generic]) -> float:
    """Mean; NaN where there is nothing to average."""
    return float(values.mean()) if values.size else float("nan")


def _whole(values: NDArray[np.float64]) -> pd.Series:
    """Whole numbers as such; empty where there is none."""
    return pd.Series(values).replace(np.inf, np.nan).astype("Int64")
