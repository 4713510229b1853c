"""What pictures, pages and exports show: the robots of a case, or of a log and its estimate."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import Estimate
from tiswarm.records.frames import EstimateTrace, read_frame, read_trace, thinned
from tiswarm.records.io import MAX_LOG_BYTES, at_line, numbered_lines, run_file
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_format import parse_header
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.terrain import Terrain
from tiswarm.report.figure_style import JOIN_COLORS, colors_along
from tiswarm.report.run_data import StoredCase

POSE = ["x_R", "y_R", "z_R", "qw", "qx", "qy", "qz"]
_ESTIMATED_POSE = [
    *("x_est_R", "y_est_R", "z_est_R"),
    *("qw_sensed", "qx_sensed", "qy_sensed", "qz_sensed"),
]


@dataclass(frozen=True)
class Look:
    """Radii of a robot's parts [R]."""

    hub: float
    arm: float
    dock: float


@dataclass(frozen=True, kw_only=True)
class DrawnRobots:
    """N robots to draw."""

    center: Reals  # centers [R], shape (N, 3)
    dock: Reals  # dock centers [R], shape (N, docks, 3)
    color: Reals  # red, green, blue of each robot, 0 to 1, shape (N, 3)
    look: Look


@dataclass(frozen=True, kw_only=True)
class SwarmView:
    """N robots: true and estimated poses, and values that color them; NaN where unknown."""

    name: str
    robot: Ints  # id of each robot, shape (N,)
    pose: Reals  # true center [R] and quaternion wxyz, shape (N, 7)
    estimated_pose: Reals  # estimated center [R] and sensed quaternion, shape (N, 7)
    error: Reals  # distance between true and estimated center [R], shape (N,)
    force: Reals  # force that each robot senses in its links [weight of a dock], shape (N,)
    sd: Reals  # standard deviation of the estimated position [R], shape (N,)
    dock_offset_body: Reals  # vectors from center to dock, body frame [R], shape (docks, 3)
    terrain: Terrain | None  # the ground; None where there is none
    read_log: Callable[[], SensingLog]  # slow for many robots
    read_trace: Callable[[], EstimateTrace | None] = lambda: None  # centers by iteration [R]

    @cached_property
    def log(self) -> SensingLog:
        """The sensing log."""
        return self.read_log()

    @property
    def has_truth(self) -> bool:
        """Whether the true poses are known."""
        return bool(np.isfinite(self.pose).all())

    @property
    def best_pose(self) -> Reals:
        """True poses, or the estimated ones where the truth is unknown, shape (N, 7)."""
        return self.pose if self.has_truth else self.estimated_pose

    @property
    def origin(self) -> Reals:
        """Place of the anchor [R], near which float32 resolves lengths well, shape (3,)."""
        origin: Reals = self.log.anchor_position / self.log.dock_radius
        return origin

    def from_origin(self, pose: Reals) -> Reals:
        """Return poses (N, 7) with centers relative to the origin."""
        return pose - np.pad(self.origin, (0, 4))

    @property
    def color_by_join(self) -> Reals:
        """Color of each robot by its join index, shape (N, 3)."""
        return colors_along(np.linspace(0.0, 1.0, len(self.pose)), JOIN_COLORS)

    def robots(self, pose: Reals, color: Reals, look: Look) -> DrawnRobots:
        """Place the docks of the robots whose pose (N, 7) is known, and leave out the others.

        `color` is red, green, blue of each robot, shape (N, 3), or of all, shape (3,).
        """
        known = np.flatnonzero(np.isfinite(pose).all(axis=1))
        center = pose[known, :3]
        dock = center[:, None] + dock_offsets(pose[known, 3:], self.dock_offset_body)
        color = np.broadcast_to(color, (len(pose), 3))[known]
        return DrawnRobots(center=center, dock=dock, color=color, look=look)


def read_case_view(case: StoredCase) -> SwarmView:
    """Read the poses, errors and forces of a case."""
    gaps = [*_ESTIMATED_POSE, "error_R", "sensed_force"]
    table = case.columns("robots.csv", [*POSE, *gaps, "robot"], gaps=gaps)
    pose, estimated, rest = np.split(table, [7, 14], axis=1)
    error, force, robot = rest.T
    path = run_file(case.folder / "sensing.jsonl", MAX_LOG_BYTES)
    number, text = next(numbered_lines(path), (1, ""))
    with at_line(path, number):
        header = parse_header(text)

    def read_log() -> SensingLog:
        log = read_sensing_log(path)
        if log.robot_count != len(robot):
            problem = f"has {len(robot)} robots, the log {log.robot_count}; run the scenario again"
            raise InputError(problem, path=case.folder / "robots.csv", line=len(robot) + 2)
        return log

    return SwarmView(
        name=case.name,
        robot=robot.astype(np.int64),
        pose=pose,
        estimated_pose=estimated,
        error=error,
        force=force,
        sd=_standard_deviation(case, len(robot)),
        dock_offset_body=np.array(header.dock_offsets) / header.dock_radius,
        terrain=None
        if header.ground_z is None
        else Terrain(
            ground_z=header.ground_z / header.dock_radius,
            left_edge=case.left_edge,
            right_edge=case.right_edge,
        ),
        read_log=read_log,
        read_trace=lambda: read_trace(case.folder / "trace.csv", len(robot)),
    )


def _standard_deviation(case: StoredCase, robots: int) -> Reals:
    """Read the standard deviations of robots that are tied to the anchor [R], NaN of others."""
    path = case.folder / "estimate.csv"
    table = read_frame(path)
    if "sd_R" not in table:
        return np.full(robots, np.nan)
    if len(table) != robots:
        problem = f"has {len(table)} robots, robots.csv {robots}; run the scenario again"
        raise InputError(problem, path=path, line=len(table) + 2)
    sd = case.columns(path.name, ["sd_R"], gaps=["sd_R"])[:, 0]
    return np.where(table.get("known") == "disconnected", np.nan, sd)


def view_log(
    log: SensingLog, estimate: Estimate, true: Reals | None = None, *, name: str = ""
) -> SwarmView:
    """Show a log and its estimate.

    Args:
        log: The sensing log.
        estimate: Estimate of its robots.
        true: True centers [log unit], shape (N, 3), or None where unknown; robots are drawn there
            with the orientation that they sensed, or that connections imply.
        name: Name of the estimate.
    """
    turned = with_orientations(log).orientation_wxyz
    unknown, unit = np.full((log.robot_count, 3), np.nan), log.dock_radius
    place, center = estimate.position / unit, unknown if true is None else true / unit
    trace = thinned(estimate)
    if trace is not None:
        trace = trace._replace(center=trace.center / unit)
    return SwarmView(
        name=name,
        robot=log.robot_id,
        pose=np.column_stack([center, turned]),
        estimated_pose=np.column_stack([place, turned]),
        error=np.linalg.norm(place - center, axis=1),
        force=unknown[:, 0],
        sd=unknown[:, 0] if estimate.sd is None else estimate.sd / unit,
        dock_offset_body=log.dock_offset_body / unit,
        terrain=None if log.ground_z is None else Terrain(ground_z=log.ground_z / unit),
        read_log=lambda: log,
        read_trace=lambda: trace,
    )
