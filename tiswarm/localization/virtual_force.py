"""The paper's method, Algorithm 1: robots in join order, each refined by virtual forces.

Where the paper leaves a choice open, ours is a parameter or is stated here: the ramp rises
linearly, alpha_t = t / T, so repulsion acts first and attraction last; a step is capped; a
robot stops after T steps, since the error that the paper's loop tests is unknown to it. Of
back-propagation the paper says no more than that it would follow every ten joins, of a virtual
torque that it would align yaw by dock geometry and neighbors.
"""

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend
from tiswarm.compute.cell_kernels import CellChains
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.join_order_kernels import localize_in_join_order
from tiswarm.localization.kernels import ALL_DOCKS, DOCKS_OF_NEIGHBORS, NO_DOCKS
from tiswarm.localization.params import BackPropagation, VirtualForceParams, VirtualTorque
from tiswarm.measurements.contacts import disconnected
from tiswarm.measurements.cues import measure
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog, SensingNoise

WORLD_UP = np.array([0.0, 0.0, 1.0])
NO_SWEEPS = BackPropagation(sweeps=0)
NO_TORQUE = VirtualTorque(gain=0.0)


def batch_key(log: SensingLog, params: VirtualForceParams) -> Hashable:
    """Name what logs must share to be localized in one launch."""
    rounds = params.back_propagation or NO_SWEEPS
    schedule = (params.iterations, params.trace_every, rounds.every, rounds.sweeps)
    return (len(log.dock_offset_body), *schedule)


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
    rounds = params[0].back_propagation or NO_SWEEPS
    frames = np.r_[
        0:iterations:every, iterations, iterations + np.r_[every : rounds.sweeps : every]
    ]
    if rounds.sweeps:
        frames = np.r_[frames, iterations + rounds.sweeps]
    start = np.cumsum([0, *(log.robot_count for log in logs)]).astype(np.int32)
    contact_start, contact = _contacts_by_robot(logs)
    chains = CellChains.allocate(
        len(logs), max(log.robot_count for log in logs) * len(logs[0].dock_offset_body)
    )
    position = np.full((start[-1], 3), np.nan, dtype)
    position[start[:-1]] = [log.anchor_position / log.dock_radius for log in logs]
    yaw = np.zeros(start[-1], dtype)
    trace = np.empty((len(frames), start[-1], 3), dtype)
    step_length = np.empty((len(frames), start[-1]), dtype)
    both = list(zip(logs, params, strict=True))
    localize_in_join_order(
        iterations, rounds.every, rounds.sweeps, every,
        np.array([gains(p, log.noise) for log, p in both], dtype),
        start, np.zeros(len(logs), np.int32), contact_start, contact,
        np.concatenate([_dock_offsets(log) for log in logs]).astype(dtype),
        np.concatenate([directions(log.orientation_wxyz, p) for log, p in both]).astype(dtype),
        np.concatenate([log.flip_height / log.dock_radius for log in logs]).astype(dtype),
        chains.head, chains.following, yaw, position, trace, step_length,
    )  # fmt: skip
    check_placed(position)
    estimates = []
    for (log, p), a, b in zip(both, start[:-1], start[1:], strict=True):
        turned = yaw[a:b] if torque_of(p, log.noise).gain else None
        estimates.append(_estimate(log, frames, trace[:, a:b], step_length[:, a:b], turned))
    return estimates


def check_placed(position: NDArray[np.floating]) -> None:
    """Refuse positions that a kernel has not written.

    Raises:
        EnvironmentTroubleError: there are some.
    """
    if np.isnan(position).any():
        raise backend.faulty_driver()


def torque_of(params: VirtualForceParams, noise: SensingNoise | None) -> VirtualTorque:
    """Say how robots turn, if they do: where yaw is not known to be biased, their senses stand."""
    is_biased = noise is not None and noise.yaw_bias_deg
    return params.virtual_torque or NO_TORQUE if is_biased else NO_TORQUE


def gains(params: VirtualForceParams, noise: SensingNoise | None) -> list[float]:
    """Columns of the kernel's `gains`; lengths in R, so D is 2."""
    rounds, torque = params.back_propagation or NO_SWEEPS, torque_of(params, noise)
    yaw = 1.0 if noise is None else np.radians(np.hypot(noise.yaw_deg, noise.yaw_bias_deg or 0.0))
    undocked = DOCKS_OF_NEIGHBORS if params.neighbor_repulsion else NO_DOCKS
    return [
        params.attraction_gain,
        params.repulsion_gain,
        params.height_gain if params.z_correction else 0.0,
        params.initial_offset,
        params.max_step,
        rounds.gain,
        rounds.repulsion_share,
        2.0,
        float(ALL_DOCKS if params.undocked_repulsion else undocked),
        torque.gain,
        params.attraction_gain * (torque.tolerance / yaw) ** 2 if torque.gain else 0.0,
        np.radians(torque.max_turn_deg),
    ]


def _dock_offsets(log: SensingLog) -> NDArray[np.float64]:
    """Center to dock, world frame [R], shape (N, docks, 3)."""
    return dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)


def directions(
    orientation_wxyz: NDArray[np.float64], params: VirtualForceParams
) -> NDArray[np.float64]:
    """Direction of each robot's initial offset, shape (N, 3)."""
    if params.initial_offset_axis == "world":
        return np.tile(WORLD_UP, (len(orientation_wxyz), 1))
    return dock_offsets(orientation_wxyz, WORLD_UP[None, :])[:, 0]


def _contacts_by_robot(
    logs: Sequence[SensingLog],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """First row of each robot, shape (N + 1,), and rows (own dock, robot, dock), shape (2 C, 3)."""
    seen = [np.concatenate([log.contacts[:, [2, 3, 0, 1]], log.contacts]) for log in logs]
    # Earlier robots come first, in the order in which the joiner felt them.
    seen = [rows[np.argsort(rows[:, 0], kind="stable")] for rows in seen]
    count = [
        np.bincount(rows[:, 0], minlength=log.robot_count)
        for log, rows in zip(logs, seen, strict=True)
    ]
    start = np.cumsum(np.concatenate([[0], *count])).astype(np.int32)
    return start, np.ascontiguousarray(np.concatenate(seen)[:, 1:], np.int32)


def _estimate(
    log: SensingLog,
    frames: NDArray[np.int64],
    trace: NDArray[np.floating],
    step_length: NDArray[np.floating],
    yaw: NDArray[np.floating] | None,
) -> Estimate:
    """Bring one structure's results back to the log's unit."""
    scaled = trace.astype(np.float64) * log.dock_radius
    steps = step_length.astype(np.float64) * log.dock_radius
    return Estimate(
        robot_id=log.robot_id,
        position=scaled[-1],
        disconnected=disconnected(measure(log, ["contacts"])),
        yaw=None if yaw is None else yaw.astype(np.float64),
        iteration=frames,
        trace=scaled,
        residual=np.sqrt(np.mean(steps**2, axis=1)),
    )
