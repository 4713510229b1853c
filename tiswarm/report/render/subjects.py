"""What there is to see of a case, read from its tables, and the pictures made of it."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.contacts import hops
from tiswarm.records.io import at_line, numbered_lines
from tiswarm.records.sensing_file import HeaderLine, parse_header, read_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.folder import Case, read_columns
from tiswarm.report.render.build import Look, Robots, Rods, build_scene
from tiswarm.report.render.camera import Array
from tiswarm.report.render.legend import (
    ERROR_COLORS,
    ESTIMATE_ORANGE,
    FORCE_COLORS,
    JOIN_COLORS,
    TRUE_BLUE,
    Keys,
    Legend,
    Scale,
    colors_along,
)
from tiswarm.report.render.scene import Scene

POSITION = ["x_R", "y_R", "z_R"]
POSE = [*POSITION, "qw", "qx", "qy", "qz"]
ESTIMATED_POSE = [
    *(name.replace("_R", "_est_R") for name in POSITION),
    *(f"{name}_sensed" for name in POSE[3:]),
]
RELATED = ["error_R", "sensed_force", "robot"]

TRUE_SIZE = Look(0.45, 0.3, 1.0)
TRUTH_LOOK = Look(0.3, 0.18, 0.72)
ESTIMATE_LOOK = Look(0.45, 0.3, 0.52)
"""Beside TRUTH_LOOK: where both coincide, blue docks on orange arms are seen."""

NODE = Look(0.3, 0.3, 0.6)
"""A robot as a node of a graph: one ball."""

EDGE_RADIUS = 0.16
EDGE_GRAY = (0.45, 0.45, 0.47)


class Picture(NamedTuple):
    """What a picture shows, and what its colors mean."""

    scene: Scene
    legend: Legend


@dataclass(frozen=True, kw_only=True)
class Subject:
    """N robots of a case: where they are, where they are thought to be, what they feel."""

    case: Case
    pose: Array
    """True center [R] and quaternion wxyz, NaN where unknown, shape (N, 7)."""

    estimated_pose: Array
    """The same as it is thought to be, shape (N, 7)."""

    error: Array
    """Distance of the two centers [R], shape (N,)."""

    force: Array
    """What each robot senses in its links [weight of a dock], shape (N,)."""

    robot: NDArray[np.int64]
    """Name of each robot, shape (N,)."""

    @cached_property
    def log(self) -> SensingLog:
        """What the robots sensed; of many robots, slow to read."""
        return read_sensing_log(self.case.folder / "sensing.jsonl")

    @cached_property
    def header(self) -> HeaderLine:
        """What the log says of all robots."""
        path = self.case.folder / "sensing.jsonl"
        number, text = next(numbered_lines(path), (1, ""))
        with at_line(path, number):
            return parse_header(text)

    @property
    def dock_offset_body(self) -> Array:
        """Center to dock, body frame [R], shape (docks, 3)."""
        return np.array(self.header.dock_offsets) / self.header.dock_radius

    @property
    def ground_z(self) -> float | None:
        """Height of the ground [R]; None where there is none."""
        height = self.header.ground_z
        return None if height is None else height / self.header.dock_radius

    @property
    def by_join(self) -> Array:
        """Color of each robot by when it joined, shape (N, 3)."""
        return colors_along(np.linspace(0.0, 1.0, len(self.pose)), JOIN_COLORS)

    def robots(self, pose: Array, color: Array, look: Look) -> Robots:
        """Place the docks of robots of known pose, leaving out the others.

        Args:
            pose: Center [R] and quaternion wxyz of some robots, shape (n, 7).
            color: Red, green, blue of each, shape (n, 3), or of all, shape (3,).
            look: How stout they are.
        """
        known = np.flatnonzero(np.isfinite(pose).all(axis=1))
        center = pose[known, :3]
        dock = center[:, None] + dock_offsets(pose[known, 3:], self.dock_offset_body)
        color = np.broadcast_to(color, (len(pose), 3))[known]
        return Robots(center=center, dock=dock, color=color, look=look)


def read_subject(case: Case) -> Subject:
    """Read what there is to see of a case.

    Raises:
        InputError: where a file of the case is missing or damaged.
    """
    table = read_columns(case.folder / "robots.csv", [*POSE, *ESTIMATED_POSE, *RELATED])
    return Subject(
        case=case,
        pose=table[:, :7],
        estimated_pose=table[:, 7:14],
        error=table[:, 14],
        force=table[:, 15],
        robot=table[:, 16].astype(np.int64),
    )


def build_pictures(case: Case) -> dict[str, Picture]:
    """Build every picture of a case, by its name.

    Raises:
        InputError: where a file of the case is missing or damaged.
    """
    subject = read_subject(case)
    structure = subject.robots(subject.pose, subject.by_join, TRUE_SIZE)
    truth = subject.robots(subject.pose, np.array(TRUE_BLUE), TRUTH_LOOK)
    estimate = subject.robots(subject.estimated_pose, np.array(ESTIMATE_ORANGE), ESTIMATE_LOOK)
    return {
        "structure": Picture(
            build_scene([structure], subject.ground_z), Scale(JOIN_COLORS, "joined first", "last")
        ),
        "sensed-force": _scaled(subject, subject.force, FORCE_COLORS, "senses 0", "dock weights"),
        "truth-and-estimate": Picture(
            build_scene([truth, estimate], subject.ground_z),
            Keys(((TRUE_BLUE, "true"), (ESTIMATE_ORANGE, "estimated"))),
        ),
        "error": _scaled(subject, subject.error, ERROR_COLORS, "error 0", "R"),
        "contact-graph": _contact_graph(subject),
    }


def _scaled(subject: Subject, value: Array, colors: Array, low: str, unit: str) -> Picture:
    """Color the structure by a number of each robot, from zero to the greatest."""
    greatest = max(np.nanmax(value, initial=0.0), 1e-9)
    color = colors_along(np.nan_to_num(value) / greatest, colors)
    robots = subject.robots(subject.pose, color, TRUE_SIZE)
    legend = Scale(colors, low, f"{greatest:.3g} {unit}")
    return Picture(build_scene([robots], subject.ground_z), legend)


def _contact_graph(subject: Subject) -> Picture:
    """Show robots as balls, colored by hops from the anchor, and contacts as rods."""
    away = hops(subject.log, np.zeros(1, np.int64))[0]
    farthest = max(np.max(away, initial=1.0, where=np.isfinite(away)), 1.0)
    color = colors_along(np.minimum(away / farthest, 1.0), JOIN_COLORS)
    center = subject.pose[:, :3]
    nodes = Robots(center=center, dock=center[:, None], color=color, look=NODE)
    ends = center[subject.log.contacts[:, [0, 2]]]
    rods = Rods(start=ends[:, 0], end=ends[:, 1], radius=EDGE_RADIUS, color=EDGE_GRAY)
    legend = Scale(JOIN_COLORS, "anchor", f"{farthest:.0f} contacts away")
    return Picture(build_scene([nodes], None, rods=rods), legend)
