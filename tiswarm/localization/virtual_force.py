"""The paper's method, Algorithm 1: robots in join order, each refined by virtual forces.

Where the paper leaves a choice open, ours is a parameter or is stated here: the ramp rises
linearly, alpha_t = t / T, so repulsion acts first and attraction last; a step is capped; a
robot stops after T steps, since the error that the paper's loop tests is unknown to it.
"""

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend
from tiswarm.compute.cells import CellChains
from tiswarm.compute.rotations import dock_offsets
from tiswarm.errors import EnvironmentTroubleError
from tiswarm.localization.kernels import localize_in_join_order
from tiswarm.localization.params import VirtualForceParams
from tiswarm.records.contact_graph import located
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

WORLD_UP = np.array([0.0, 0.0, 1.0])


def batch_key(log: SensingLog, params: VirtualForceParams) -> Hashable:
    """Name what logs must share to be localized in one launch."""
    return (len(log.dock_offset_body), params.iterations, params.trace_every)


def localize_batch(
    logs: Sequence[SensingLog], params: Sequence[VirtualForceParams]
) -> list[Estimate]:
    """Localize structures side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.

    Returns:
        One estimate a log. The residual is the root mean square step of the robots.
    """
    dtype = backend.current().dtype
    iterations, every = params[0].iterations, params[0].trace_every
    frames = np.unique(np.r_[0 : iterations + 1 : every, iterations])
    start = np.cumsum([0, *(log.robot_count for log in logs)]).astype(np.int32)
    contact_start, contact = _contacts_by_joiner(logs)
    chains = CellChains.allocate(
        len(logs), max(log.robot_count for log in logs) * len(logs[0].dock_offset_body)
    )
    position = np.full((start[-1], 3), np.nan, dtype)
    position[start[:-1]] = [log.anchor_position / log.dock_radius for log in logs]
    trace = np.empty((len(frames), start[-1], 3), dtype)
    step_length = np.empty((len(frames), start[-1]), dtype)
    localize_in_join_order(
        iterations,
        every,
        np.array([_gains(p) for p in params], dtype),
        start,
        contact_start,
        contact,
        np.concatenate([_dock_offsets(log) for log in logs]).astype(dtype),
        np.concatenate([_directions(log, p) for log, p in zip(logs, params, strict=True)]).astype(
            dtype
        ),
        np.concatenate([log.flip_height / log.dock_radius for log in logs]).astype(dtype),
        chains.head,
        chains.following,
        position,
        trace,
        step_length,
    )
    if np.isnan(position).any():
        running = backend.current()
        msg = (
            f"backend {running.arch} returned without placing every robot; "
            "its driver is faulty: use --arch cpu"
        )
        raise EnvironmentTroubleError(msg)
    return [
        _estimate(log, frames, trace[:, a:b], step_length[:, a:b])
        for log, a, b in zip(logs, start[:-1], start[1:], strict=True)
    ]


def _gains(params: VirtualForceParams) -> list[float]:
    """Columns of the kernel's `gains`; lengths in R, so D is 2."""
    return [
        params.attraction_gain,
        params.repulsion_gain,
        params.height_gain if params.z_correction else 0.0,
        params.initial_offset,
        params.max_step,
        2.0,
        float(params.undocked_repulsion),
    ]


def _dock_offsets(log: SensingLog) -> NDArray[np.float64]:
    """Centre to dock, world frame [R], shape (N, docks, 3)."""
    return dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)


def _directions(log: SensingLog, params: VirtualForceParams) -> NDArray[np.float64]:
    """Direction of each robot's initial offset, shape (N, 3)."""
    if params.initial_offset_axis == "world":
        return np.tile(WORLD_UP, (log.robot_count, 1))
    return dock_offsets(log.orientation_wxyz, WORLD_UP[None, :])[:, 0]


def _contacts_by_joiner(
    logs: Sequence[SensingLog],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """First row of each robot, shape (N + 1,), and rows (own dock, robot, dock), shape (C, 3)."""
    count = [np.bincount(log.contacts[:, 2], minlength=log.robot_count) for log in logs]
    start = np.cumsum(np.concatenate([[0], *count])).astype(np.int32)
    # Rows of a log are sorted by the joiner, the robot that felt them.
    rows = np.concatenate([log.contacts[:, [3, 0, 1]] for log in logs])
    return start, np.ascontiguousarray(rows, np.int32)


def _estimate(
    log: SensingLog,
    frames: NDArray[np.int64],
    trace: NDArray[np.floating],
    step_length: NDArray[np.floating],
) -> Estimate:
    """Bring one structure's results back to the log's unit."""
    scaled = trace.astype(np.float64) * log.dock_radius
    steps = step_length.astype(np.float64) * log.dock_radius
    return Estimate(
        robot_id=log.robot_id,
        position=scaled[-1],
        located=located(log),
        iteration=frames,
        trace=scaled,
        residual=np.sqrt(np.mean(steps**2, axis=1)),
    )
