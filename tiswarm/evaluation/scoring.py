"""Two tables of positions held against each other, whoever made them."""

from pathlib import Path

import numpy as np

from tiswarm.errors import InputError
from tiswarm.evaluation import metrics
from tiswarm.records.positions import read_length_unit, read_positions


def score_files(truth: Path, estimate: Path) -> tuple[str, dict[str, float]]:
    """Score an estimate against a truth, robot by robot of the same name.

    Returns:
        The unit of length, and by measure its value in that unit; NaN where there is no shape.

    Raises:
        InputError: a table is malformed, in another unit, or lacks a robot of the other.
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
