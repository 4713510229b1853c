"""An estimate held against the truth: by robot, by iteration, and in one row."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.evaluation import metrics
from tiswarm.records.contact_graph import contact_count, earlier_contact_count
from tiswarm.records.estimate import Estimate
from tiswarm.records.rigidity import floppy_modes
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.truth import Truth
from tiswarm.robot import RobotGeometry


def score(
    truth: Truth, log: SensingLog, estimate: Estimate, robot: RobotGeometry, *, height_known: bool
) -> dict[str, float | int]:
    """Score one estimate, beside what decides how good it can be.

    Args:
        truth: Where the robots are.
        log: What they sensed.
        estimate: Where they are thought to be.
        robot: Their shape; an RMSE is also given in units of its rho.
        height_known: Whether the localizer used the heights, which leaves fewer floppy modes.
    """
    rmse = metrics.rmse(estimate.position, truth.position)
    return {
        "robots": log.robot_count,
        "contacts_per_robot": float(earlier_contact_count(log)[1:].mean()),
        "rms_radius_R": metrics.rms_radius(truth.position),
        "floppy_modes": floppy_modes(truth.position, log, height_known=height_known),
        "sse_R2": metrics.sse(estimate.position, truth.position),
        "rmse_R": rmse,
        "rmse_rho": rmse / robot.rho,
        "procrustes_disparity": metrics.procrustes_disparity(estimate.position, truth.position),
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
    columns["error_R"] = metrics.robot_errors(estimate.position, truth.position)
    columns["contacts"] = contact_count(log)
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
