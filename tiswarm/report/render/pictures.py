"""The 3D pictures of a case: what they show, their legends, and their files."""

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tiswarm.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.errors import InputError
from tiswarm.measurements.contacts import hops
from tiswarm.progress import Progress
from tiswarm.records.io import MAX_LOG_BYTES, at_line, numbered_lines, run_file, write_bytes
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_format import HeaderLine, parse_header
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figure_style import (
    ERROR_COLORS,
    ESTIMATE_ORANGE,
    FORCE_COLORS,
    JOIN_COLORS,
    TRUE_BLUE,
    colors_along,
    colors_from_zero,
    rgb,
)
from tiswarm.report.render.raycast import draw_scenes
from tiswarm.report.render.scene import Look, Robots, Scene, build_scene
from tiswarm.report.run_data import Case, RunData

POSE = ["x_R", "y_R", "z_R", "qw", "qx", "qy", "qz"]
_ESTIMATED_POSE = [
    *("x_est_R", "y_est_R", "z_est_R"),
    *("qw_sensed", "qx_sensed", "qy_sensed", "qz_sensed"),
]

TRUE_SIZE = Look(0.45, 0.3, 1.0)
_TRUTH_LOOK = Look(0.3, 0.18, 0.72)
_ESTIMATE_LOOK = Look(0.45, 0.3, 0.52)  # where both coincide, blue docks on orange arms are seen
_NODE = Look(0.3, 0.3, 0.6)  # a robot as a node of a graph: one ball

_LEGEND_HEIGHT, _BAR_LENGTH = 62, 200  # of a legend, and of its bar of colors [pixels]
_INK = (40, 40, 40)


Keys = tuple[tuple[str, str], ...]
"""A legend of single colors (hex), each with its meaning."""


class Scale(NamedTuple):
    """A legend of a range of colors (hex) and the meanings of its ends."""

    colors: tuple[str, ...]
    low: str
    high: str


class Picture(NamedTuple):
    """A scene and the meaning of its colors."""

    scene: Scene
    legend: Keys | Scale


@dataclass(frozen=True)
class CaseView:
    """N robots of a case: true and estimated poses, errors and forces."""

    case: Case
    pose: Reals  # true center [R] and quaternion wxyz, NaN where unknown, shape (N, 7)
    estimated_pose: Reals  # estimated center [R] and sensed quaternion, as `pose`, shape (N, 7)
    error: Reals  # distance between true and estimated center [R], shape (N,)
    force: Reals  # force that each robot senses in its links [weight of a dock], shape (N,)
    robot: Ints  # id of each robot, shape (N,)

    @property
    def _log_file(self) -> Path:
        return run_file(self.case.folder / "sensing.jsonl", MAX_LOG_BYTES)

    @cached_property
    def log(self) -> SensingLog:
        """The sensing log; slow to read for many robots."""
        log, robots = read_sensing_log(self._log_file), len(self.pose)
        if log.robot_count != robots:
            problem = f"has {robots} robots, the log {log.robot_count}; run the scenario again"
            raise InputError(problem, path=self.case.folder / "robots.csv", line=robots + 2)
        return log

    @cached_property
    def header(self) -> HeaderLine:
        """The first line of the sensing log."""
        path = self._log_file
        number, text = next(numbered_lines(path), (1, ""))
        with at_line(path, number):
            return parse_header(text)

    @property
    def dock_offset_body(self) -> Reals:
        """Vectors from center to dock, body frame [R], shape (docks, 3)."""
        return np.array(self.header.dock_offsets) / self.header.dock_radius

    @property
    def ground_z(self) -> float | None:
        """Height of the ground [R]; None where there is none."""
        height = self.header.ground_z
        return None if height is None else height / self.header.dock_radius

    @property
    def color_by_join(self) -> Reals:
        """Color of each robot by its join index, shape (N, 3)."""
        return colors_along(np.linspace(0.0, 1.0, len(self.pose)), JOIN_COLORS)

    def robots(self, pose: Reals, color: Reals, look: Look) -> Robots:
        """Place the docks of the robots whose pose (N, 7) is known, and leave out the others.

        `color` is red, green, blue of each robot, shape (N, 3), or of all, shape (3,).
        """
        known = np.flatnonzero(np.isfinite(pose).all(axis=1))
        center = pose[known, :3]
        dock = center[:, None] + dock_offsets(pose[known, 3:], self.dock_offset_body)
        color = np.broadcast_to(color, (len(pose), 3))[known]
        return Robots(center=center, dock=dock, color=color, look=look)


def read_case_view(case: Case) -> CaseView:
    """Read the poses, errors and forces of a case."""
    gaps = [*_ESTIMATED_POSE, "error_R", "sensed_force"]
    table = case.columns("robots.csv", [*POSE, *gaps, "robot"], gaps=gaps)
    pose, estimated, rest = np.split(table, [7, 14], axis=1)
    error, force, robot = rest.T
    return CaseView(case, pose, estimated, error, force, robot.astype(np.int64))


def build_pictures(case: Case) -> dict[str, Picture]:
    """Build every picture of a case, by name."""
    view = read_case_view(case)
    structure = view.robots(view.pose, view.color_by_join, TRUE_SIZE)
    by_join = Scale(JOIN_COLORS, "join index  0", f"{len(view.pose) - 1}")
    truth = view.robots(view.pose, rgb(TRUE_BLUE), _TRUTH_LOOK)
    estimate = view.robots(view.estimated_pose, rgb(ESTIMATE_ORANGE), _ESTIMATE_LOOK)
    both = ((TRUE_BLUE, "true"), (ESTIMATE_ORANGE, "estimated"))
    return {
        "structure": Picture(build_scene([structure], view.ground_z), by_join),
        "sensed-force": _scaled(view, view.force, FORCE_COLORS, "sensed force [dock weights]"),
        "truth-and-estimate": Picture(build_scene([truth, estimate], view.ground_z), both),
        "error": _scaled(view, view.error, ERROR_COLORS, "error [R]"),
        "contact-graph": _contact_graph(view),
    }


def _scaled(view: CaseView, value: Reals, colors: tuple[str, ...], title: str) -> Picture:
    """Color the structure by a value of each robot, from zero to the greatest."""
    color, greatest = colors_from_zero(value, colors)
    robots = view.robots(view.pose, color, TRUE_SIZE)
    legend = Scale(colors, f"{title}  0", f"{greatest:.3g}")
    return Picture(build_scene([robots], view.ground_z), legend)


def _contact_graph(view: CaseView) -> Picture:
    """Draw robots as balls, colored by hops from the anchor, and contacts as rods."""
    away = hops(view.log, np.zeros(1, np.int64))[0]
    farthest = max(np.max(away, initial=1.0, where=np.isfinite(away)), 1.0)
    color = colors_along(np.minimum(away / farthest, 1.0), JOIN_COLORS)
    center = view.pose[:, :3]
    nodes = Robots(center=center, dock=center[:, None], color=color, look=_NODE)
    scene = build_scene([nodes], None, rods=center[view.log.contacts[:, [0, 2]]])
    return Picture(scene, Scale(JOIN_COLORS, "hops from the anchor  0", f"{farthest:.0f}"))


def add_legend(picture: Image.Image, legend: Keys | Scale) -> Image.Image:
    """Add a white band with a legend above a picture."""
    whole = Image.new("RGB", (picture.width, picture.height + _LEGEND_HEIGHT), "white")
    whole.paste(picture, (0, _LEGEND_HEIGHT))
    pen = ImageDraw.Draw(whole)
    font = ImageFont.load_default(26)
    left, top = 18.0, 18
    if isinstance(legend, Scale):
        pen.text((left, top), legend.low, _INK, font)
        left += pen.textlength(f"{legend.low} ", font)
        bar = colors_along(np.linspace(0.0, 1.0, _BAR_LENGTH), legend.colors)
        for x, color in enumerate((255.0 * bar).round().astype(int).tolist()):
            pen.line((left + x, top + 6, left + x, top + 26), tuple(color))
        pen.text((left + _BAR_LENGTH, top), f" {legend.high}", _INK, font)
        return whole
    for key, text in legend:
        pen.ellipse((left, top, left + 24, top + 24), fill=key)
        pen.text((left + 34, top + 12), text, _INK, font, anchor="lm")
        left += 70 + pen.textlength(text, font)
    return whole


class Rendered(NamedTuple):
    """A picture file."""

    path: Path
    renderer: str
    reason: str  # why a better renderer failed; empty if none did


def render_run(
    run: RunData, *, progress: Progress, renderer: str | None = None, case: str | None = None
) -> list[Rendered]:
    """Draw every picture of one case of a run into `renders/`.

    The best renderer that works draws the first of the largest cases, unless they are named. File
    names contain the name of the case if it is given.

    Raises:
        InputError: the renderer or the case is unknown, or the run is damaged.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """
    planned = build_pictures(run.choose(case))
    suffix = "" if case is None else f"-{case}"
    pictures, used, reason = draw_scenes([plan.scene for plan in planned.values()], renderer)
    progress.info(f"drawn by {used}" + (f" ({reason})" if reason else ""))
    drawn = []
    for (name, plan), picture in zip(planned.items(), pictures, strict=True):
        stream = io.BytesIO()
        add_legend(Image.fromarray(picture), plan.legend).save(stream, format="PNG")
        path = run.subfolder("renders") / f"{name}{suffix}.png"
        write_bytes(path, stream.getvalue())
        progress.info(f"renders/{path.name}")
        drawn.append(Rendered(path=path, renderer=used, reason=reason))
    return drawn
