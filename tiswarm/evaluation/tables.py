"""Tables of a case: scores of its estimate, errors by robot and iteration, growth by join."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.aliases import Reals
from tiswarm.errors import InputError
from tiswarm.evaluation import metrics
from tiswarm.measurements.contacts import contact_count, earlier_contact_count, hops
from tiswarm.measurements.cues import measure
from tiswarm.measurements.rigidity import floppy_modes, weld
from tiswarm.records.estimate import HALF_WITHIN, MOST_WITHIN, Estimate
from tiswarm.records.positions import Truth, read_length_unit, read_positions
from tiswarm.records.sensing_log import SensingLog
from tiswarm.robot import RobotGeometry
from tiswarm.world.history import History


def score(
    truth: Truth,
    log: SensingLog,
    estimate: Estimate,
    robot: RobotGeometry,
    *,
    cues: Collection[str],
) -> dict[str, float | int]:
    """Return accuracy measures of an estimate, and properties of the structure that limit them.

    Args:
        truth: True poses.
        log: The measurements behind the estimate.
        estimate: Estimated positions.
        robot: Geometry of a robot, for lengths in rho.
        cues: Cues of the log that the localizer used.
    """
    estimated, true = estimate.position, truth.position
    rmse = metrics.rmse(estimated, true)
    of_contacts = metrics.relative_errors(estimated, true, log.contacts[:, [0, 2]])
    modes = floppy_modes(
        weld(measure(log, cues), true / log.dock_radius, yaw_unknown=estimate.yaw is not None)
    )
    return {
        "robots": log.robot_count,
        "contacts_per_robot": _mean(earlier_contact_count(log)[1:]),
        "rms_radius_R": metrics.rms_radius(true),
        "floppy_modes": np.nan if modes is None else modes,
        "disconnected": int(estimate.disconnected.sum()),
        "sse_R2": metrics.sse(estimated, true),
        "rmse_R": rmse,
        "rmse_rho": rmse / robot.rho,
        "rmse_yaw_aligned_R": metrics.rmse(metrics.yaw_aligned(estimated, true), true),
        "rmse_rigid_aligned_R": metrics.rmse(metrics.rigidly_aligned(estimated, true), true),
        "rmse_per_contact_R": _mean(of_contacts**2) ** 0.5,
        "procrustes_disparity": metrics.procrustes_disparity(estimated, true),
        **_coverage(truth, estimate),
        **_convergence(estimate),
    }


def by_robot(
    truth: Truth, log: SensingLog, estimate: Estimate, sensed_force: Reals
) -> pd.DataFrame:
    """Tabulate each robot in join order: true and estimated pose, errors, contacts and load.

    Args:
        truth: True poses.
        log: Measurements of the robots.
        estimate: Estimated positions.
        sensed_force: Load that each robot senses in its links [weight of a dock], shape (N,).
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
    columns["disconnected"] = estimate.disconnected
    columns["sensed_force"] = sensed_force
    return pd.DataFrame(columns)


def by_iteration(truth: Truth, estimate: Estimate) -> pd.DataFrame:
    """Tabulate each recorded iteration: errors, and the residual of the localizer."""
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


def by_join(history: History) -> pd.DataFrame:
    """Tabulate the growth of a structure: its size and load after each join.

    Mechanics are missing where the structure was not solved after the join.
    """
    position, walks, loads = history.position, history.walks, history.loads
    joined = np.arange(1, len(walks) + 1)
    center_of_mass = np.cumsum(position[:, 0]) / joined
    return pd.DataFrame(
        {
            "robots": joined,
            "height_R": np.maximum.accumulate(position[:, 2]) - history.ground_z,
            "depth_R": history.ground_z - np.minimum.accumulate(position[:, 2]),
            "reach_R": np.maximum.accumulate(position[:, 0]),
            "peak_stress": [s.peak for s in loads],
            "sensed_max": [s.sensed_max for s in loads],
            "calling": [s.calling for s in loads],
            "recruited": np.cumsum([walk.recruited for walk in walks]),
            "flips": [walk.stance_count - 1 for walk in walks],
            "contacts": [len(walk.at_rest(walk.contacts)) for walk in walks],
            "ground_docks": [
                len(walk.at_rest(walk.ground_docks)) + len(walk.at_rest(walk.edge_docks))
                for walk in walks
            ],
            "least_support": [s.least_support for s in loads],
            "overhang_R": center_of_mass - history.terrain.left_edge
            if not history.terrain.is_plane
            else np.nan,
        }
    )


def totals(history: History) -> dict[str, float | int]:
    """Return the size and load of a finished structure."""
    last = history.loads[-1]
    position = history.position
    return {
        "height_R": float(position[:, 2].max() - history.ground_z),
        "reach_R": float(position[:, 0].max()),
        "depth_R": float(history.ground_z - position[:, 2].min()),
        "peak_stress": last.peak,
        "sensed_max": last.sensed_max,
        "recruited": sum(walk.recruited for walk in history.walks),
        "spawns": history.spawns,
        "crossed": int(history.crossed),
    }


def score_files(truth: Path, estimate: Path) -> tuple[str, dict[str, float]]:
    """Compare two tables of positions, matching robots by name.

    Args:
        truth: Table of true positions.
        estimate: Table of estimated positions.

    Returns:
        The length unit of the tables, and accuracy measures by name in that unit.

    Raises:
        InputError: if a table is malformed, in another unit, or lacks a robot of the other.
    """
    unit = read_length_unit(truth)
    names, true = read_positions(truth, length_unit=unit)
    other_names, estimated = read_positions(estimate, length_unit=unit)
    missing = np.setxor1d(names, other_names)
    if len(missing):
        problem = f"robot {missing[0]} is in one of the two tables only; score the same robots"
        raise InputError(problem, path=estimate, key="robot")
    true, estimated = true[names.argsort()], estimated[other_names.argsort()]
    return unit, {
        "RMSE": metrics.rmse(estimated, true),
        "RMSE, yaw and place aligned": metrics.rmse(metrics.yaw_aligned(estimated, true), true),
        "RMSE, rigidly aligned": metrics.rmse(metrics.rigidly_aligned(estimated, true), true),
        "largest error": float(metrics.robot_errors(estimated, true).max()),
        "rms radius of the structure": metrics.rms_radius(true),
        "Procrustes disparity": metrics.procrustes_disparity(estimated, true),
    }


def _coverage(truth: Truth, estimate: Estimate) -> dict[str, float]:
    """Return the shares of robots within their 50 and 90 % intervals, without the anchor."""
    if estimate.sd is None:
        return {}
    error, sd = metrics.robot_errors(estimate.position, truth.position)[1:], estimate.sd[1:]
    return {
        "coverage_50": _mean(error <= HALF_WITHIN * sd),
        "coverage_90": _mean(error <= MOST_WITHIN * sd),
    }


def _convergence(estimate: Estimate) -> dict[str, float | int]:
    """Return the convergence diagnostics; nothing if the method has none."""
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
    """Return the mean; NaN without values."""
    return float(values.mean()) if values.size else float("nan")


def _whole(values: Reals) -> pd.Series:
    """Convert to integers; infinite ones become missing."""
    return pd.Series(values).replace(np.inf, np.nan).astype("Int64")
