"""The way of an estimate: its centers at some iterations, and their table `trace.csv`."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.records.estimate import Estimate
from tiswarm.records.frames import read_frame
from tiswarm.records.io import damaged, write_bytes

MOST_ROBOTS = 1_000
"""Robots of an estimate beyond which no trace is stored: it would outgrow the log."""

_MOST_FRAMES = 24
_DIGITS = 3  # decimals of a coordinate
_COLUMNS = ["iteration", "robot", "x_R", "y_R", "z_R"]


class EstimateTrace(NamedTuple):
    """Centers of N robots at K iterations."""

    iteration: Ints  # ascending, shape (K,)
    center: Reals  # shape (K, N, 3)


def thinned(estimate: Estimate) -> EstimateTrace | None:
    """Take a few iterations of an estimate in its unit, the last one too; None if it has no two."""
    frames = len(estimate.trace)
    if frames < 2 or len(estimate.robot_id) > MOST_ROBOTS:  # noqa: PLR2004 - no motion
        return None
    kept = np.linspace(0, frames - 1, min(frames, _MOST_FRAMES)).round().astype(int)
    return EstimateTrace(estimate.iteration[kept], estimate.trace[kept])


def write_trace(path: Path, estimate: Estimate) -> None:
    """Write a row for each iteration and robot [R]; nothing if there is no motion to show."""
    trace = thinned(estimate)
    if trace is None:
        return
    lines = [",".join(_COLUMNS)]
    for iteration, center in zip(trace.iteration.tolist(), trace.center.tolist(), strict=True):
        for robot, (x, y, z) in zip(estimate.robot_id.tolist(), center, strict=True):
            lines.append(f"{iteration},{robot},{x:.{_DIGITS}f},{y:.{_DIGITS}f},{z:.{_DIGITS}f}")
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def read_trace(path: Path, robots: int) -> EstimateTrace | None:
    """Read the trace of an estimate of N robots [R]; None if none was stored.

    Raises:
        InputError: the table is damaged.
    """
    if not path.exists():
        return None
    table = read_frame(path, numbers=_COLUMNS)[_COLUMNS].to_numpy(float)
    if len(table) % robots or len(table) < 2 * robots:
        raise damaged(path, f"its {len(table)} rows are no iterations of {robots} robots")
    frames = table.reshape(-1, robots, len(_COLUMNS))
    return EstimateTrace(frames[:, 0, 0].astype(np.int64), frames[:, :, 2:])
