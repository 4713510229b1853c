"""What pictures, pages and exports show: the robots of a case, or of a log and its estimate.

That includes the part of the ground around them, and the data of a page's 3D view.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import MOST_WITHIN, WITHIN, Estimate
from tiswarm.records.frames import EstimateTrace, read_frame, read_trace, thinned
from tiswarm.records.io import MAX_LOG_BYTES, at_line, digest, numbered_lines, run_file, way_back
from tiswarm.records.measures import RMSE
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_format import HeaderLine, parse_header
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.surface import SURFACE_FILE, GroundSurface, read_surface
from tiswarm.records.terrain import EDGE_RADIUS, NO_EDGE, Terrain
from tiswarm.report.figure_style import JOIN_COLORS, colors_along
from tiswarm.report.run_data import RunData, StoredCase

_GONE = ("left", "fell")
"""What happened to robots that are no longer there, as `robots.csv` names it."""

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


SD = "sd"
"""Label of the coloring by standard deviation, which is also the size of the spheres."""


MARGIN_LABEL = "margin"
"""Label of the coloring by margin."""

_SAFE_MARGIN = 10.0
"""Margin from which robots have one color: none of their contacts is the next to break."""

Ground = Terrain | GroundSurface
"""Ground that can be shown."""


class Coloring(NamedTuple):
    """A quantity that colors robots; pages add hops and the join index."""

    label: str
    unit: str  # may be empty
    value: Reals  # NaN where unknown; of words, places in their list; shape (N,)
    scale: str = "errors"  # of `SCALES`
    least: float = 0.0  # value of the first color of the scale
    words: Sequence[str] = ()  # labels of robots; empty where values are numbers
    most: float | None = None  # value of the last color, also of greater ones; None: the greatest
    logarithmic: bool = False  # whether equal ratios are equal steps of color
    meaning: str = ""  # what the label means, for legends
    gray: str = "unknown"  # what robots without a value are

    @property
    def title(self) -> str:
        """Label with unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def last(self) -> float:
        """Value of the last color of the scale."""
        if self.most is not None:
            return self.most
        return max(float(np.nanmax(self.value, initial=self.least)), self.least + 1e-9)

    @property
    def share(self) -> Reals:
        """Place of each robot's number on the scale, 0 to 1; NaN where unknown, shape (N,)."""
        if self.logarithmic:
            place = np.log(np.maximum(self.value, self.least) / self.least)
            share = place / math.log(self.last / self.least)
        else:
            share = (self.value - self.least) / (self.last - self.least)
        return np.clip(share, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class SwarmView:
    """N robots: true and estimated poses, and values that color them; NaN where unknown."""

    name: str
    robot: Ints  # id of each robot, shape (N,)
    pose: Reals  # true center [R] and quaternion wxyz, shape (N, 7)
    estimated_pose: Reals  # estimated center [R] and sensed quaternion, shape (N, 7)
    error: Reals  # distance between true and estimated center [R], shape (N,)
    force: Reals  # force that each robot senses in its links [weight of a dock], shape (N,)
    margin: Reals  # strength over load of each robot's weakest contact [1], shape (N,)
    sd: Reals  # standard deviation of the estimated position [R], shape (N,)
    dock_offset_body: Reals  # vectors from center to dock, body frame [R], shape (docks, 3)
    terrain: Ground | None  # the ground; None where there is none
    stood: Reals  # pose in which each robot last stood, also if it left, shape (N, 7)
    read_log: Callable[[], SensingLog]  # slow for many robots
    read_trace: Callable[[], EstimateTrace | None] = lambda: None  # centers by iteration [R]
    read_loads: Callable[[], pd.DataFrame | None] = lambda: None  # of contacts, `loads.csv`
    progress: Progress = field(default_factory=Progress)  # what exports the view reports to it
    user_colorings: Sequence[Coloring] = ()  # values of the user
    further_colorings: Sequence[Coloring] = ()  # values that structures do not have
    is_of_engine: bool = False  # whether it is a swarm that grew no structure
    within: Reals | None = None  # probability of being `near` the estimated position [1], (N,)
    near: str = "1 R"  # a distance, in words

    @cached_property
    def log(self) -> SensingLog:
        """The sensing log."""
        return self.read_log()

    @property
    def has_truth(self) -> bool:
        """Whether the true poses are known."""
        return bool(np.isfinite(self.pose).all(axis=1).any())

    @property
    def has_estimate(self) -> bool:
        """Whether any robot has an estimate."""
        return bool(np.isfinite(self.estimated_pose).all(axis=1).any())

    @property
    def poses(self) -> dict[str, Reals]:
        """True poses, `structure`, and those that are estimated, `estimate`, if they are known."""
        estimate = (
            {} if self.has_truth and not self.has_estimate else {"estimate": self.estimated_pose}
        )
        return ({"structure": self.pose} if self.has_truth else {}) | estimate

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
    def colorings(self) -> list[Coloring]:
        """What is known to color robots: values of the user, then ours; lengths in the log's unit.

        The first one is what exports show beside the join index.
        """
        size = self.log.dock_radius
        unit = self.log.length_unit
        colorings = [
            *self.user_colorings,
            *self.further_colorings,
            Coloring("error", unit, size * self.error),
            Coloring(SD, unit, size * self.sd),
            Coloring("sensed force", "dock weights", self.force, "forces"),
            self.margin_coloring,
        ]
        return [coloring for coloring in colorings if np.isfinite(coloring.value).any()]

    @property
    def page_colorings(self) -> list[Coloring]:
        """What pages offer: `colorings`, and before the sd the probability that follows from it.

        So a page without a truth opens on it: robots that are surely near are pale.
        """
        offered = self.colorings
        if self.within is None or not np.isfinite(self.within).any():
            return offered
        probability = Coloring(
            f"within {self.near}",
            "%",
            100.0 * self.within,
            "margins",
            most=100.0,
            meaning="probability",
            gray="guess",
        )
        labels = [coloring.label for coloring in offered]
        place = labels.index(SD) if SD in labels else len(offered)
        return [*offered[:place], probability, *offered[place:]]

    @property
    def margin_coloring(self) -> Coloring:
        """Margins, from those of contacts about to break to those with a tenth of their load.

        Infinite margins, of robots whose contacts have no load, have no color.
        """
        return Coloring(
            MARGIN_LABEL,
            "",
            np.where(np.isfinite(self.margin), self.margin, np.nan),
            "margins",
            least=1.0,
            most=_SAFE_MARGIN,
            logarithmic=True,
            meaning="weakest contact: strength / load",
            gray="no load",
        )

    @property
    def color_by_join(self) -> Reals:
        """Color of each robot by its join index, shape (N, 3)."""
        return colors_along(np.linspace(0.0, 1.0, len(self.pose)), JOIN_COLORS)

    def robots(self, pose: Reals, color: Reals, look: Look) -> DrawnRobots:
        """Place the docks of the robots whose pose (N, 7) is known, and leave out the others.

        `color` is red, green, blue of each robot, shape (N, 3), or of all, shape (3,).
        """
        placed = np.flatnonzero(np.isfinite(pose).all(axis=1))
        center = pose[placed, :3]
        dock = center[:, None] + dock_offsets(pose[placed, 3:], self.dock_offset_body)
        color = np.broadcast_to(color, (len(pose), 3))[placed]
        return DrawnRobots(center=center, dock=dock, color=color, look=look)


_logs: WeakValueDictionary[str, SensingLog] = WeakValueDictionary()
"""Logs in use by the digest of their files: conditions of a seed have equal ones."""


def read_case_view(case: StoredCase) -> SwarmView:
    """Read the poses, errors and forces of a case; without an estimate, those of its structure."""
    if case.is_of_engine:
        return _read_swarm_view(case)
    estimated_names = [*_ESTIMATED_POSE, "error_R"]
    further = ["sensed_force", "margin"]
    if case.has_estimate:
        gaps = [*estimated_names, "sensed_force"]
        names = [*POSE, *estimated_names, *further, "robot"]
        table = case.columns("robots.csv", names, gaps=gaps, optional=["margin"])
        sd, within, is_gone = _spread(case, len(table))
    else:
        names = [*POSE, *further, "robot"]
        measured = case.columns("robots.csv", names, gaps=["sensed_force"], optional=["margin"])
        table = np.insert(measured, [len(POSE)] * len(estimated_names), np.nan, axis=1)
        sd = within = np.full(len(table), np.nan)
        is_gone = _lost(case)
    stood = table[:, :7].copy()
    table[is_gone, :-1] = np.nan  # robots that left are not shown
    pose, estimated, rest = np.split(table, [7, 14], axis=1)
    error, force, margin, robot = rest.T
    path = run_file(case.folder / "sensing.jsonl", MAX_LOG_BYTES)
    number, text = next(numbered_lines(path), (1, ""))
    with at_line(path, number):
        header = parse_header(text)

    def read_log() -> SensingLog:
        content = digest(path)
        log = _logs.get(content) or _logs.setdefault(content, read_sensing_log(path))
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
        margin=margin,
        sd=sd,
        stood=stood,
        dock_offset_body=np.array(header.dock_offsets) / header.dock_radius,
        terrain=_case_ground(case, header),
        read_log=read_log,
        read_trace=lambda: _read_trace(case, len(robot)),
        read_loads=lambda: read_loads(case),
        user_colorings=case.user_colorings,
        within=within,
    )


_MOST_MOVING = 1000
"""Robots of a swarm up to which a page plays its steps."""


def _read_swarm_view(case: StoredCase) -> SwarmView:
    """Read the last poses of a run of the engine, its contacts and its trajectory."""
    values = {"moved": "moved_R", "overlap": "overlap_R"}
    table = case.columns("robots.csv", [*POSE, *values.values(), "robot"])
    pose = table[:, : len(POSE)]
    robot = table[:, -1].astype(np.int64)
    names = ["robot", "dock", "other_robot", "other_dock"]
    contacts = case.columns("contacts.csv", names, empty=True).astype(np.int32)
    unknown = np.full((len(robot), len(POSE)), np.nan)
    docks = case.columns("docks.csv", ["x_R", "y_R", "z_R"])
    log = SensingLog(
        robot_id=robot,
        dock_radius=1.0,
        dock_offset_body=docks,
        anchor_position=pose[0, :3],
        orientation_wxyz=pose[:, 3:],
        contacts=contacts,
        flip_height=np.full(len(robot), np.nan),
        spawn_position=np.full((len(robot), 3), np.nan),
    )
    colorings = [
        Coloring(label, "R", table[:, column])
        for column, label in enumerate(values, start=len(POSE))
    ]
    return SwarmView(
        name=case.name,
        robot=robot,
        pose=pose,
        estimated_pose=unknown,
        error=unknown[:, 0],
        force=unknown[:, 0],
        sd=unknown[:, 0],
        margin=unknown[:, 0],
        stood=pose,
        dock_offset_body=docks,
        terrain=None,
        read_log=lambda: log,
        read_trace=lambda: _read_trajectory(case, len(robot)),
        user_colorings=case.user_colorings,
        further_colorings=colorings,
        is_of_engine=True,
    )


def _read_trajectory(case: StoredCase, robots: int) -> EstimateTrace | None:
    """Read the trajectory of a swarm; None where it has not all robots, or too many."""
    path = case.folder / "trajectory.csv"
    if not path.exists() or robots > _MOST_MOVING:
        return None
    table = case.columns(path.name, ["step", "robot", "x_R", "y_R", "z_R"])
    steps = np.unique(table[:, 0])
    if len(table) != len(steps) * robots:
        return None
    return EstimateTrace(steps.astype(np.int64), table[:, 2:].reshape(-1, robots, 3))


def _read_trace(case: StoredCase, robots: int) -> EstimateTrace | None:
    """Read the centers of a case by iteration; None without an estimate."""
    return read_trace(case.folder / "trace.csv", robots) if case.has_estimate else None


def _lost(case: StoredCase) -> Bools:
    """Read which robots of a case without an estimate left or fell, shape (N,)."""
    table = read_frame(case.folder / "robots.csv", notes=["lost"])
    lost = table.get("lost", pd.Series("", table.index))
    is_gone: Bools = lost.isin(_GONE).to_numpy()
    return is_gone


def read_loads(case: StoredCase) -> pd.DataFrame | None:
    """Read the loads of contacts of a case; None where docks hold any load."""
    path = case.folder / "loads.csv"
    if not os.path.lexists(path):
        return None
    table = read_frame(
        path,
        ["neighbor"],
        ["robot", "dock"],
        gaps=["neighbor_dock", "margin"],
        numbers_after="neighbor_dock",
        empty=True,
    )
    dock = table["neighbor_dock"]
    wrong = dock[dock.notna() & (dock % 1.0 != 0.0)]
    if len(wrong):
        problem = f"{wrong.iloc[0]:g} is no dock; {way_back(path)}"
        raise InputError(problem, path=path, line=int(wrong.index[0]) + 2, key="neighbor_dock")
    return table.assign(neighbor_dock=dock.astype("Int64"))


def _case_ground(case: StoredCase, header: HeaderLine) -> Ground | None:
    """Return the ground of a case, in R."""
    surface = case.folder / SURFACE_FILE
    if surface.is_file():
        return read_surface(surface)
    if header.ground_z is None:
        return None
    return Terrain(
        ground_z=header.ground_z / header.dock_radius,
        left_edge=case.left_edge,
        right_edge=case.right_edge,
    )


def _spread(case: StoredCase, robots: int) -> tuple[Reals, Reals, Bools]:
    """Read the sd [R] and probability to be near of robots that stay, and who has left.

    The sd is NaN of robots that nothing ties to the anchor, and both are NaN of those that left.
    """
    path = case.folder / "estimate.csv"
    table = read_frame(path)
    names = ["sd_R", f"{WITHIN}1R"]
    if any(name in table for name in (*names, "gone")) and len(table) != robots:
        problem = f"has {len(table)} robots, robots.csv {robots}; run the scenario again"
        raise InputError(problem, path=path, line=len(table) + 2)
    is_gone = np.broadcast_to(table.get("gone") == "yes", robots)
    if "sd_R" not in table:
        unknown = np.full(robots, np.nan)
        return unknown, unknown, is_gone
    sd, within = case.columns(path.name, names, gaps=names, optional=names[1:]).T
    is_unknown = (table.get("known") == "disconnected") | is_gone
    return np.where(is_unknown, np.nan, sd), np.where(is_gone, np.nan, within), is_gone


def view_log(
    log: SensingLog,
    estimate: Estimate,
    true: Reals | None = None,
    *,
    name: str = "",
    user_colorings: Sequence[Coloring] = (),
) -> SwarmView:
    """Show a log and its estimate.

    Args:
        log: The sensing log.
        estimate: Estimate of its robots.
        true: True centers [log unit], shape (N, 3), or None where unknown; robots are drawn there
            with the orientation that they sensed, or that connections imply.
        name: Name of the estimate.
        user_colorings: Values of the user that color robots.
    """
    gone = np.where(log.is_gone, np.nan, 0.0)[:, None]  # robots that left are not shown
    unknown = np.full((log.robot_count, 3), np.nan)
    unit = log.dock_radius
    turned = with_orientations(log).orientation_wxyz
    stood = np.column_stack([(estimate.position if true is None else true) / unit, turned])
    turned = turned + gone
    estimated = estimate.position / unit + gone
    center = unknown if true is None else true / unit + gone
    trace = thinned(estimate)
    trace = trace and trace._replace(center=trace.center / unit)
    within = estimate.within(estimate.near_distance)
    return SwarmView(
        name=name,
        robot=log.robot_id,
        pose=np.column_stack([center, turned]),
        estimated_pose=np.column_stack([estimated, turned]),
        error=np.linalg.norm(estimated - center, axis=1),
        force=unknown[:, 0],
        margin=unknown[:, 0],
        sd=unknown[:, 0] if estimate.sd is None else estimate.sd / unit + gone[:, 0],
        stood=stood,
        dock_offset_body=log.dock_offset_body / unit,
        terrain=None if log.ground_z is None else Terrain(ground_z=log.ground_z / unit),
        read_log=lambda: log,
        read_trace=lambda: trace,
        user_colorings=user_colorings,
        within=None if within is None else within + gone[:, 0],
        near=estimate.near,
    )


_STANDING = 0.1  # gap to the ground below which a dock stands on it [R]
_AROUND = 3.0  # ground shown beside the docks [R]
_BEHIND = 7.0  # ground shown behind an edge where no dock stands [R]
_ARC = 8  # faces of a rounded edge
_SURFACE_CORNERS = 48  # most corners of uneven ground along x or y in the view of a page


class Slab(NamedTuple):
    """A piece of a slab: flat from x = `rear` to x = `edge`, and rounded beyond the edge [R]."""

    rear: float
    edge: float
    low_y: float
    high_y: float
    top: float  # height of its flat top; it is 2 `EDGE_RADIUS` thick

    @property
    def outward(self) -> float:
        """1 if the edge is at the right of the piece, -1 if it is at the left."""
        return 1.0 if self.edge > self.rear else -1.0


def standing_docks(terrain: Ground, dock: Reals) -> Reals:
    """Choose the docks, shape (n, 3), that stand on flat ground; none on other ground."""
    if isinstance(terrain, GroundSurface):
        return dock[:0]
    beyond = (dock[:, 0] > terrain.left_edge) & (dock[:, 0] < terrain.right_edge)
    height = dock[:, 2] - 1.0 - terrain.ground_z
    standing: Reals = dock[(np.abs(height) < _STANDING) & ~beyond]
    return standing


def shown_slabs(terrain: Ground, dock: Reals) -> list[Slab]:
    """Cut a piece off each slab that reaches around the docks, shape (n, 3); none off others."""
    if isinstance(terrain, GroundSurface) or terrain.is_plane:
        return []
    standing = standing_docks(terrain, dock)[:, 0]
    low_y = dock[:, 1].min() - _AROUND
    high_y = dock[:, 1].max() + _AROUND
    slabs = []
    for edge, outward in ((terrain.left_edge, 1.0), (terrain.right_edge, -1.0)):
        if edge < NO_EDGE:
            behind = float(np.max(outward * (edge - standing), initial=_BEHIND - _AROUND))
            rear = edge - outward * (behind + _AROUND)
            slabs.append(Slab(rear, edge, float(low_y), float(high_y), terrain.ground_z))
    return slabs


def ground_pieces(terrain: Ground, dock: Reals) -> list[Reals]:
    """Cover each piece of ground around docks, shape (n, 3), with faces of four corners [R].

    Returns:
        Corners, counterclockwise as seen from above the ground, each of shape (faces, 4, 3). A
        plane has one face if a dock stands on it, and no piece otherwise.
    """
    if isinstance(terrain, GroundSurface):
        return [terrain.thinned(_SURFACE_CORNERS).faces()]
    slabs = shown_slabs(terrain, dock)
    if slabs:
        return [_faces(slab) for slab in slabs]
    standing = standing_docks(terrain, dock)[:, :2]
    if not len(standing):
        return []
    x_low, y_low = standing.min(axis=0) - _AROUND
    x_high, y_high = standing.max(axis=0) + _AROUND
    z = terrain.ground_z
    corners = [[x_low, y_low, z], [x_high, y_low, z], [x_high, y_high, z], [x_low, y_high, z]]
    return [np.array([corners])]


def _faces(slab: Slab) -> Reals:
    """Cover a piece of a slab with faces; it is open at its rear."""
    angle = np.linspace(0.5 * np.pi, -0.5 * np.pi, _ARC + 1)
    x = np.array([slab.rear, *(slab.edge + slab.outward * EDGE_RADIUS * np.cos(angle)), slab.rear])
    z = slab.top - EDGE_RADIUS + EDGE_RADIUS * np.array([1.0, *np.sin(angle), -1.0])
    front, back = (np.column_stack([x, np.full(len(x), y), z]) for y in (slab.low_y, slab.high_y))
    outline = np.stack([front[:-1], front[1:], back[1:], back[:-1]], axis=1)
    half = len(x) // 2  # a side is cut into faces from the top to the underside
    sides = [
        np.stack([below[:half], below[1 : half + 1], above[1 : half + 1], above[:half]], axis=1)
        for below, above in ((front[::-1], front), (back, back[::-1]))
    ]
    faces: Reals = np.concatenate([outline, *sides])
    return faces if slab.outward > 0.0 else faces[:, ::-1]


_MOST_CASES = 48  # in the view
MOST_ROBOTS = 100_000
"""Robots in the view, in all cases together."""

ALGORITHM_1 = ("virtual-force", "distributed algorithm-1")
"""Methods, as `summary.csv` names them, that are the paper's Algorithm 1."""

_DIGITS = 4  # decimals of positions
_TRACE_DIGITS = 2  # decimals of positions in motion
_MOST_PLACES = 100_000  # positions in motion, in all cases together


class View(NamedTuple):
    """The cases of the 3D view."""

    data: dict[str, Any]  # as `space_data` returns it; `compared` if it starts with two cases
    title: str
    choice: str  # what the menu offers
    note: str
    robots: str = "estimated"  # the robots that colorings color
    frames: str = "iterations"  # what the page plays beside joins

    @property
    def has_truth(self) -> bool:
        """Whether a case has true poses."""
        return any(case["true"] for case in self.data["cases"])

    @property
    def has_sd(self) -> bool:
        """Whether a case has standard deviations, which spheres show."""
        return any(color["label"] == SD for case in self.data["cases"] for color in case["colors"])


def build_view(run: RunData) -> View | None:
    """Take the first case of each series, within the limits; None if no case is done.

    The view opens on the first two. Cases that values of the user color are before others.
    """
    shown: list[dict[str, Any]] = []
    notes = []
    first = first_series(run)
    is_grid = len({cases[0].point for cases in run.series.values()}) < len(run.series)
    is_grid = is_grid and all(cases[0].condition for cases in run.series.values())
    series = [*first, *(name for name in run.series if name not in first)]
    cases = [max(run.series[name], key=lambda case: bool(case.user_colorings)) for name in series]
    for case in sorted(cases, key=lambda case: not case.user_colorings)[:_MOST_CASES]:
        seed = case.name.partition("-")[0]
        condition = case.condition if is_grid else case.series or case.name
        view = replace(read_case_view(case), name=f"{condition}, seed {seed}")
        data = view_data(view, view.page_colorings)
        data |= {"point": case.point if is_grid else "", "condition": condition}
        if sum(len(case_data["robot"]) for case_data in [*shown, data]) > MOST_ROBOTS:
            break
        if data["robot"]:
            positions = sum(_moving_positions(case_data) for case_data in [*shown, data])
            shown.append(data if positions <= _MOST_PLACES else {**data, "trace": None})
        if len(view.robot) > MOST_ROBOTS:
            notes = [f"It contains the first {MOST_ROBOTS} of {len(view.robot)} robots."]
    if not shown:
        return None
    done = sum(case.done for case in run.cases)
    if len(shown) < done:
        notes.insert(0, f"The view contains {len(shown)} of {done} cases.")
    return View(
        data=space_data(view.dock_offset_body, shown) | {"compared": True},
        title=_title_of(run),
        choice="Condition" if is_grid else "Case",
        note=" ".join(notes),
        robots="robots" if run.has_structures_alone else "estimated",
        frames="steps" if run.is_of_engine else "iterations",
    )


def _title_of(run: RunData) -> str:
    if run.is_of_engine:
        return "Swarms"
    return "Structures" if run.has_structures_alone else "True and estimated positions"


def first_series(run: RunData) -> list[str]:
    """Choose the series of the greatest interest: the least mean RMSE, and Algorithm 1.

    Both are of the first point of the sweep that Algorithm 1 localizes; of the first point where
    it localizes none, and then the other series is that with the next least RMSE.
    """
    if RMSE.column not in run.summary:
        return []
    error = run.summary.groupby("series", sort=False)[RMSE.column].mean()
    first_cases = {
        name: cases[0] for name, cases in run.series.items() if math.isfinite(error[name])
    }
    rivals = [name for name, case in first_cases.items() if case.method in ALGORITHM_1]
    if not first_cases:
        return []
    point = first_cases[next(iter([*rivals, *first_cases]))].point
    of_point = [name for name, case in first_cases.items() if case.point == point]
    ranked = sorted(of_point, key=lambda name: error[name])
    compared = [name for name in rivals if name in ranked[1:]] or ranked[1:]
    return [*ranked[:1], *compared[:1]]


def _moving_positions(data: dict[str, Any]) -> int:
    """Count the positions in motion of a case."""
    return len(data["robot"]) * len(data["trace"]["iteration"]) if data["trace"] else 0


def space_data(
    offset: Reals, cases: Sequence[dict[str, Any]], *, radius: float = 1.0, unit: str = "R"
) -> dict[str, Any]:
    """Gather the data of the 3D view.

    Args:
        offset: Vectors from center to dock, body frame [R], shape (docks, 3).
        cases: Cases as `view_data` returns them.
        radius: R in the unit of the labels.
        unit: Unit of the labels along the axes.
    """
    return {
        "offsets": _rounded(offset),
        "cases": cases,
        "radius": radius,
        "unit": unit,
        "score": "RMSE" if any(case["true"] for case in cases) else "",
        "sphere": MOST_WITHIN,  # radius of a sphere [sd]
    }


def view_data(view: SwarmView, colorings: Sequence[Coloring] = ()) -> dict[str, Any]:
    """List what the 3D view needs of the robots that have an estimate, the first ones if too many.

    Without a true pose, the lists of true centers and turns are empty. A structure without an
    estimate is shown in its place.
    """
    shown = view.estimated_pose if view.has_estimate else view.best_pose
    located = np.flatnonzero(np.isfinite(shown).all(axis=1))[:MOST_ROBOTS]
    estimated = shown[located]
    true = view.pose[located]
    if not (view.has_estimate and np.isfinite(true).all()):
        true = true[:0]
    return {
        "name": view.name,
        "robot": view.robot[located].tolist(),
        "true": _rounded(true[:, :3]),
        "turn": _rounded(true[:, 3:]),
        "estimate": _rounded(estimated[:, :3]),
        "sensed": _rounded(estimated[:, 3:]),
        "colors": [
            coloring._asdict() | {"value": [_value(v) for v in coloring.value[located].tolist()]}
            for coloring in colorings
            if np.isfinite(coloring.value[located]).any()
        ],
        "contacts": _contacts(view, located),
        "ground": _ground(view, true if len(true) else estimated),
        "trace": _trace(view, located),
    }


def _rounded(values: Reals) -> list[Any]:
    rounded: list[Any] = values.round(_DIGITS).tolist()
    return rounded


def _value(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.4g}")


def _contacts(view: SwarmView, robots: Ints) -> list[list[int]]:
    """List contacts of known robots: their places in the list, and a dock of each."""
    index = np.full(len(view.robot), -1)
    index[robots] = np.arange(len(robots))
    contacts = view.log.contacts.copy()
    contacts[:, [0, 2]] = index[contacts[:, [0, 2]]]
    listed: list[list[int]] = contacts[(contacts >= 0).all(axis=1)].tolist()
    return listed


def _trace(view: SwarmView, robots: Ints) -> dict[str, list[Any]] | None:
    """List the centers of known robots at some iterations; None where none are stored."""
    trace = view.read_trace()
    if trace is None:
        return None
    center = trace.center[:, robots].round(_TRACE_DIGITS).tolist()
    return {"iteration": trace.iteration.tolist(), "center": center}


def _ground(view: SwarmView, pose: Reals) -> list[Any]:
    """List the pieces of ground around robots, each a list of faces with four corners [R]."""
    if view.terrain is None or not len(pose):
        return []
    dock = pose[:, None, :3] + dock_offsets(pose[:, 3:], view.dock_offset_body)
    return [_rounded(faces) for faces in ground_pieces(view.terrain, dock.reshape(-1, 3))]
