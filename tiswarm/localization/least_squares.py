"""Least squares by a general optimizer: the reference that other methods are compared with.

All robots move at once. The sum of squares has many minima: from a poor start least squares ends
in a poor one, with robots on the wrong side of their contacts, held there by docks that may not
overlap. Lengths in R.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import csr_array, diags_array, vstack

from tiswarm.aliases import Reals
from tiswarm.localization import virtual_force
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.measurements.contacts import close_docks, disconnected
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.model import Measurements, turned
from tiswarm.measurements.rows import SPACING, Distances
from tiswarm.progress import ignore
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_MARGIN = 1.0
"""Docks this much farther apart than D may come to overlap within a round [R]."""

_SETTLED = 1e-6
"""The rounds end when one lowers the cost by less than this part."""


class Problem:
    """Residuals of measurements in widths, by all centers but the anchor's and by all yaws."""

    def __init__(self, rows: Measurements, anchor: Reals, yaw_sd: float = 0.0) -> None:
        """Weight measurements.

        Args:
            rows: Measurements; a residual counts in units of its own standard deviation.
            anchor: Center of the anchor [R], shape (3,).
            yaw_sd: Standard deviation of a yaw bias [rad]; yaw is solved for unless 0.
        """
        self.rows, self.anchor, self.yaw_sd = rows, anchor, yaw_sd
        self.robots = rows.robots
        self.width = np.sqrt(rows.own_variance + rows.shared_variance)

    def unknowns(self, position: Reals, yaw: Reals) -> Reals:
        """Concatenate the unknowns: coordinates, then turns as arcs at 1 R."""
        return np.concatenate([position[1:].ravel(), yaw if self.yaw_sd else yaw[:0]])

    def poses(self, unknowns: Reals) -> tuple[Reals, Reals]:
        """Split unknowns into positions [R], shape (N, 3), and yaws [rad], shape (N,)."""
        places, yaw = np.split(unknowns, [3 * self.robots - 3])
        position = np.concatenate([self.anchor[None], places.reshape(-1, 3)])
        return position, yaw if self.yaw_sd else np.zeros(self.robots)

    def residuals(self, unknowns: Reals) -> Reals:
        """Compute the residuals in widths, and last those of the yaw biases."""
        position, yaw = self.poses(unknowns)
        prior = yaw / self.yaw_sd if self.yaw_sd else yaw[:0]
        return np.concatenate([self.rows.residual(position, yaw) / self.width, prior])

    def jacobian(self, unknowns: Reals) -> csr_array:
        """Compute the derivatives of the residuals, shape (residuals, unknowns)."""
        position, yaw = self.poses(unknowns)
        weighted = diags_array(1.0 / self.width) @ self.rows.jacobian(position, yaw)
        if not self.yaw_sd:
            return csr_array(weighted[:, 3 : 3 * self.robots])
        scale = np.full(self.robots, 1.0 / self.yaw_sd)
        prior = diags_array(scale, offsets=3 * self.robots - 3, shape=(self.robots, len(unknowns)))
        return csr_array(vstack([csr_array(weighted[:, 3:]), csr_array(prior)]))


Minimize = Callable[[Problem, Reals, LeastSquaresParams], OptimizeResult]
"""A solver: the problem, the unknowns to start from, settings.

Of its result `x`, `cost`, `nfev` and `status` count, as `scipy.optimize.least_squares` has them.
"""


def batch_key(log: SensingLog, params: LeastSquaresParams) -> Hashable:
    """Name what logs must share to be started in one launch."""
    return virtual_force.batch_key(log, params.start)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[LeastSquaresParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures one after the other, started side by side.

    Returns:
        One estimate a log. The residual is the root mean square of distance less D of the
        docks in contact, in the log's unit.
    """
    starts = virtual_force.localize_batch(logs, [p.start for p in params])
    estimates: list[Estimate] = []
    for log, p, start in zip(logs, params, starts, strict=True):
        estimates.append(improve(log, p, start.position))
        on_progress(len(estimates) / len(logs))
    return estimates


def trust_region(problem: Problem, unknowns: Reals, params: LeastSquaresParams) -> OptimizeResult:
    """Minimize the residuals by scipy's trust region reflective method."""
    found: OptimizeResult = least_squares(  # type: ignore[operator]  # the stubs take it for a module
        problem.residuals,
        unknowns,
        jac=problem.jacobian,
        method="trf",
        tr_solver="lsmr",
        loss=params.loss,
        max_nfev=params.evaluations,
    )
    return found


def improve(
    log: SensingLog,
    params: LeastSquaresParams,
    start: Reals,
    *,
    minimize: Minimize = trust_region,
) -> Estimate:
    """Move robots from given positions to a minimum of the weighted residuals.

    Args:
        log: What the swarm sensed.
        params: Settings.
        start: Positions to start from, in the log's unit, shape (N, 3).
        minimize: Solver of each round; benchmarks compare others with scipy's.
    """
    yaw_sd = log.yaw_bias * params.solve_yaw
    yaw: Reals = np.zeros(log.robot_count)
    if yaw_sd:
        positions_only = replace(params, solve_yaw=False)
        start = improve(log, positions_only, start, minimize=minimize).position
    unit = log.dock_radius
    anchor = log.anchor_position / unit
    position: Reals = np.concatenate([anchor[None], start[1:] / unit])
    measured = _measured(log, params)
    poses, iteration, cost = [(position, yaw)], [0], np.inf
    for _ in range(params.rounds if log.robot_count > 1 else 0):
        close = _close(measured, log, params, position, yaw)
        rows = Measurements.gather(
            measured.odometry,
            [measured.distances, *close],
            [measured.places],
            [measured.offsets],
            shared_sd=measured.shared_sd,
        )
        problem = Problem(rows, anchor, yaw_sd)
        found = minimize(problem, problem.unknowns(position, yaw), params)
        position, yaw = problem.poses(found.x)
        poses.append((position, yaw))
        iteration.append(iteration[-1] + found.nfev)
        if found.status > 0 and found.cost >= (1.0 - _SETTLED) * cost:
            break
        cost = found.cost
    contacts = measure(log, ["contacts"], odometry=measured.odometry)
    gaps = [contacts.residual(*pose) for pose in poses]
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit,
        disconnected=disconnected(measured),
        yaw=yaw if yaw_sd else None,
        iteration=np.array(iteration),
        trace=np.array([frame for frame, _ in poses]) * unit,
        residual=np.array([np.sqrt((gap**2).sum() / max(len(gap), 1)) for gap in gaps]) * unit,
    )


def _measured(log: SensingLog, params: LeastSquaresParams) -> Measurements:
    """Measure with the widths of the settings, not with the spawn noise that the log states."""
    noise = None if log.noise is None else replace(log.noise, spawn=None)
    widths = Precision(params.contact_width, params.height_width, params.odometry_width)
    return measure(replace(log, noise=noise), params.cues, precision=widths)


def _close(
    measured: Measurements,
    log: SensingLog,
    params: LeastSquaresParams,
    position: Reals,
    yaw: Reals,
) -> list[Distances]:
    """List docks that do not touch, of different robots, close enough to overlap soon."""
    if "non_overlap" not in params.cues:
        return []
    final = measured.odometry.final
    arm = measured.odometry.arm[final]
    docks = arm.shape[1]
    point = turned(arm.reshape(-1, 3), np.repeat(yaw, docks)).reshape(arm.shape)
    later, own, earlier, its = close_docks(log, position[:, None] + point, SPACING + _MARGIN).T
    return [
        Distances.of(
            final[later], own, final[earlier], its,
            length=SPACING, sd=params.overlap_width, is_hinge=True,
        )
    ]  # fmt: skip
