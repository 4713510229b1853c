"""The 3D pictures of a case: what they show, their legends, and their files."""

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tiswarm.aliases import Ints
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.contacts import hops
from tiswarm.progress import Progress
from tiswarm.records.io import at_line, numbered_lines, write_bytes
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
    rgb,
)
from tiswarm.report.render.raycast import draw_scenes
from tiswarm.report.render.scene import Array, Look, Robots, Rods, Scene, build_scene
from tiswarm.report.run_data import Case, RunData

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

# --- legend [pixels] ---

LEGEND_MARGIN = 18
LEGEND_HEIGHT = 62
FONT = 26
INK = (40, 40, 40)
BAR_LENGTH = 200


@dataclass(frozen=True)
class Keys:
    """A legend of single colors (hex) and their meanings."""

    entries: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Scale:
    """A legend of a range of colors (hex) and the meanings of its ends."""

    colors: tuple[str, ...]
    low: str
    high: str


Legend = Keys | Scale


class Picture(NamedTuple):
    """A scene and the meaning of its colors."""

    scene: Scene
    legend: Legend


@dataclass(frozen=True, kw_only=True)
class CaseView:
    """N robots of a case: true and estimated poses, errors and forces."""

    case: Case
    pose: Array
    """True center [R] and quaternion wxyz, NaN where unknown, shape (N, 7)."""

    estimated_pose: Array
    """Estimated center [R] and sensed quaternion wxyz, NaN where unknown, shape (N, 7)."""

    error: Array
    """Distance between true and estimated center [R], shape (N,)."""

    force: Array
    """Force that each robot senses in its links [weight of a dock], shape (N,)."""

    robot: Ints
    """Id of each robot, shape (N,)."""

    @cached_property
    def log(self) -> SensingLog:
        """The sensing log; slow to read for many robots."""
        return read_sensing_log(self.case.folder / "sensing.jsonl")

    @cached_property
    def header(self) -> HeaderLine:
        """The first line of the sensing log."""
        path = self.case.folder / "sensing.jsonl"
        number, text = next(numbered_lines(path), (1, ""))
        with at_line(path, number):
            return parse_header(text)

    @property
    def dock_offset_body(self) -> Array:
        """Vectors from center to dock, body frame [R], shape (docks, 3)."""
        return np.array(self.header.dock_offsets) / self.header.dock_radius

    @property
    def ground_z(self) -> float | None:
        """Height of the ground [R]; None where there is none."""
        height = self.header.ground_z
        return None if height is None else height / self.header.dock_radius

    @property
    def color_by_join(self) -> Array:
        """Color of each robot by its join index, shape (N, 3)."""
        return colors_along(np.linspace(0.0, 1.0, len(self.pose)), JOIN_COLORS)

    def robots(self, pose: Array, color: Array, look: Look) -> Robots:
        """Place the docks of the robots whose pose is known, and leave out the others.

        Args:
            pose: Center [R] and quaternion wxyz, shape (N, 7).
            color: Red, green, blue of each robot, shape (N, 3), or of all, shape (3,).
            look: Radii of the robots' parts.
        """
        known = np.flatnonzero(np.isfinite(pose).all(axis=1))
        center = pose[known, :3]
        dock = center[:, None] + dock_offsets(pose[known, 3:], self.dock_offset_body)
        color = np.broadcast_to(color, (len(pose), 3))[known]
        return Robots(center=center, dock=dock, color=color, look=look)


def read_case_view(case: Case) -> CaseView:
    """Read the poses, errors and forces of a case.

    Raises:
        InputError: a file of the case is missing or damaged.
    """
    table = case.columns("robots.csv", [*POSE, *ESTIMATED_POSE, *RELATED])
    return CaseView(
        case=case,
        pose=table[:, :7],
        estimated_pose=table[:, 7:14],
        error=table[:, 14],
        force=table[:, 15],
        robot=table[:, 16].astype(np.int64),
    )


def build_pictures(case: Case) -> dict[str, Picture]:
    """Build every picture of a case, by name.

    Raises:
        InputError: a file of the case is missing or damaged.
    """
    view = read_case_view(case)
    structure = view.robots(view.pose, view.color_by_join, TRUE_SIZE)
    truth = view.robots(view.pose, rgb(TRUE_BLUE), TRUTH_LOOK)
    estimate = view.robots(view.estimated_pose, rgb(ESTIMATE_ORANGE), ESTIMATE_LOOK)
    return {
        "structure": Picture(
            build_scene([structure], view.ground_z),
            Scale(JOIN_COLORS, "join index  0", f"{len(view.pose) - 1}"),
        ),
        "sensed-force": _scaled(view, view.force, FORCE_COLORS, "sensed force [dock weights]"),
        "truth-and-estimate": Picture(
            build_scene([truth, estimate], view.ground_z),
            Keys(((TRUE_BLUE, "true"), (ESTIMATE_ORANGE, "estimated"))),
        ),
        "error": _scaled(view, view.error, ERROR_COLORS, "error [R]"),
        "contact-graph": _contact_graph(view),
    }


def _scaled(view: CaseView, value: Array, colors: tuple[str, ...], title: str) -> Picture:
    """Color the structure by a value of each robot, from zero to the greatest."""
    greatest = max(np.nanmax(value, initial=0.0), 1e-9)
    color = colors_along(np.nan_to_num(value) / greatest, colors)
    robots = view.robots(view.pose, color, TRUE_SIZE)
    legend = Scale(colors, f"{title}  0", f"{greatest:.3g}")
    return Picture(build_scene([robots], view.ground_z), legend)


def _contact_graph(view: CaseView) -> Picture:
    """Draw robots as balls, colored by hops from the anchor, and contacts as rods."""
    away = hops(view.log, np.zeros(1, np.int64))[0]
    farthest = max(np.max(away, initial=1.0, where=np.isfinite(away)), 1.0)
    color = colors_along(np.minimum(away / farthest, 1.0), JOIN_COLORS)
    center = view.pose[:, :3]
    nodes = Robots(center=center, dock=center[:, None], color=color, look=NODE)
    ends = center[view.log.contacts[:, [0, 2]]]
    rods = Rods(start=ends[:, 0], end=ends[:, 1], radius=EDGE_RADIUS, color=EDGE_GRAY)
    legend = Scale(JOIN_COLORS, "hops from the anchor  0", f"{farthest:.0f}")
    return Picture(build_scene([nodes], None, rods=rods), legend)


def add_legend(picture: Image.Image, legend: Legend) -> Image.Image:
    """Add a white band with a legend above a picture."""
    whole = Image.new("RGB", (picture.width, picture.height + LEGEND_HEIGHT), "white")
    whole.paste(picture, (0, LEGEND_HEIGHT))
    pen = ImageDraw.Draw(whole)
    font = ImageFont.load_default(FONT)
    left = float(LEGEND_MARGIN)
    if isinstance(legend, Scale):
        pen.text((left, LEGEND_MARGIN), legend.low, INK, font)
        left += pen.textlength(f"{legend.low} ", font)
        bar = colors_along(np.linspace(0.0, 1.0, BAR_LENGTH), legend.colors)
        for x, color in enumerate((255.0 * bar).round().astype(int).tolist()):
            pen.line((left + x, LEGEND_MARGIN + 6, left + x, LEGEND_MARGIN + 26), tuple(color))
        pen.text((left + BAR_LENGTH, LEGEND_MARGIN), f" {legend.high}", INK, font)
        return whole
    for color, text in legend.entries:
        pen.ellipse((left, LEGEND_MARGIN, left + 24, LEGEND_MARGIN + 24), fill=color)
        pen.text((left + 34, LEGEND_MARGIN + 12), text, INK, font, anchor="lm")
        left += 70 + pen.textlength(text, font)
    return whole


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """A picture file."""

    path: Path
    renderer: str
    reason: str
    """Why a better renderer failed; empty if none did."""


def render_run(
    run: RunData, *, progress: Progress, renderer: str | None = None, case: str | None = None
) -> list[Rendered]:
    """Draw every picture of one case of a run into `renders/`.

    Args:
        run: The run.
        progress: Receives progress.
        renderer: Name of the renderer; the best that works if None.
        case: Name of the case, which file names then contain; the first of the largest if None.

    Raises:
        InputError: the renderer or the case is unknown, or the run is damaged.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """
    planned = build_pictures(run.choose(case))
    suffix = "" if case is None else f"-{case}"
    pictures, used, reason = draw_scenes([plan.scene for plan in planned.values()], renderer)
    progress.info(f"drawn by {used}" + (f" ({reason})" if reason else ""))
    place = run.subfolder("renders")
    drawn = []
    for (name, plan), picture in zip(planned.items(), pictures, strict=True):
        stream = io.BytesIO()
        add_legend(Image.fromarray(picture), plan.legend).save(stream, format="PNG")
        path = place / f"{name}{suffix}.png"
        write_bytes(path, stream.getvalue())
        progress.info(f"renders/{path.name}")
        drawn.append(Rendered(path=path, renderer=used, reason=reason))
    return drawn
