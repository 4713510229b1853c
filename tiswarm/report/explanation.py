"""How the measurements of one robot narrow its place: as lines, and as a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.advice.placement import narrow
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted, three_digits
from tiswarm.records.outputs import Outputs
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report import figure_style
from tiswarm.report.figure_style import (
    COLUMN_WIDTH,
    ESTIMATE_ORANGE,
    PAGE_WIDTH,
    TRUE_BLUE,
    new_figure,
)
from tiswarm.report.page import Shown, show_drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ENOUGH = 2
"""Docks of earlier robots to touch that make a robot worth explaining."""


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """The places that a robot may have after each of its measurements."""

    robot: int
    """Name of the robot."""

    places: Mapping[str, Reals]
    """By measurement, the first one first, places of the center that remain [R], shape (n, 3)."""

    spread: Mapping[str, float]
    """By measurement, the rms distance of these places from their mean [log unit]."""

    unit: str
    """Length unit of the log."""

    center: Reals
    """Estimated center of the robot [R], shape (3,)."""

    docks: Reals
    """Estimated docks of the robots that joined earlier [R], shape (n, 3)."""

    radius: float
    """R in the log's unit."""

    def __str__(self) -> str:
        """Give a line for each measurement."""
        lines = [
            f"{name:<28} {three_digits(spread):>8} {self.unit}"
            for name, spread in self.spread.items()
        ]
        return "\n".join([f"robot {self.robot}: spread of the places that remain", *lines])

    def draw(self, out: Path, *, overwrite: bool = False) -> Path:
        """Draw the places that remain after each measurement; return the picture.

        Raises:
            InputError: the file exists, and `overwrite` does not say to replace it.
        """
        outputs = Outputs(overwrite=overwrite)
        figure_style.write(out, lambda: draw_placement(self._placement()), outputs)
        return out

    def show(self, why: str = "") -> Shown:
        """Draw the same for a page; `why` says why this robot is shown, if nobody chose it."""
        caption = (
            f"How the measurements of robot {self.robot} narrow its place: blue points are places "
            "that remain after one more measurement, numbers their rms distance from their mean. "
            "The cross is the estimate. Gray circles are docks of robots that joined earlier, "
            "where they are estimated."
        )
        if why:
            caption += f" {why} tiswarm view --explain ROBOT shows any robot."
        return show_placement(f"explain-{self.robot}.svg", self._placement(), caption)

    def _placement(self) -> "Placement":
        panels = [
            Stage(f"{name}\n{three_digits(self.spread[name])} {self.unit}", places)
            for name, places in self.places.items()
        ]
        return Placement(panels, self.center, self.docks, self.radius, self.unit)


def explain(log: SensingLog, estimate: Estimate, robot: int) -> Explanation:
    """Narrow the places of a robot by its measurements.

    Args:
        log: What was sensed.
        estimate: Estimate of its robots.
        robot: Name of a robot in the log.

    Raises:
        InputError: there is no such robot, it is the anchor, or it touches none that joined
            earlier.
    """
    rows = np.flatnonzero(log.robot_id == robot)
    if not len(rows):
        problem = f"there is no robot {robot}; choose one of the {log.robot_count} of the log"
        raise InputError(problem, argument="explain")
    index = int(rows[0])
    position = estimate.position / log.dock_radius
    log = with_orientations(log)
    arms = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    steps = narrow(log, index, position)
    return Explanation(
        robot=robot,
        places={step.name: step.places for step in steps},
        spread={step.name: step.spread * log.dock_radius for step in steps},
        unit=log.length_unit,
        center=position[index],
        docks=(position[:index, None] + arms[:index]).reshape(-1, 3),
        radius=log.dock_radius,
    )


def show(log: SensingLog, estimate: Estimate, robots: Sequence[int] = ()) -> list[Shown]:
    """Draw for a page the explanations of some robots by name, or of one if none is named.

    There is none if no robot touches an earlier one. Else that is the one with the largest standard
    deviation of those that touch two or more docks of earlier robots, or one if none touches more;
    without standard deviations, the one that touches most.
    """
    if robots:
        return [explain(log, estimate, robot).show() for robot in robots]
    touched = np.bincount(log.contacts[:, 2], minlength=log.robot_count) * ~log.is_gone
    least = min(_ENOUGH, int(touched.max()))
    if not least:
        return []
    more = " or more" if least == _ENOUGH else ""
    which = f"Of the robots that touch {counted(least, 'dock')}{more} of earlier robots"
    sd = np.full(log.robot_count, np.nan) if estimate.sd is None else estimate.sd
    candidate = np.isfinite(sd) & ~estimate.disconnected & (touched >= least)
    if candidate.any():
        index = int(np.argmax(np.where(candidate, sd, -1.0)))
        why = f"{which}, this one has the largest standard deviation, "
        why += f"{three_digits(sd[index])} {log.length_unit}."
    else:
        index = int(np.argmax(touched))
        why = f"No robot touches more docks of earlier robots than this one, {touched[index]}."
    return [explain(log, estimate, int(log.robot_id[index])).show(why)]


_MOST_POINTS = 3_000
_MARGIN = 1.0
_MOST_COLUMNS = 8
_BARS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # lengths of the scale bar [R]
_LONGEST_BAR = 0.4  # of the width of a panel
_PAGE_DPI = 150  # of the points of a figure on a page


class Stage(NamedTuple):
    """What one more measurement leaves."""

    title: str
    places: Reals
    """Places that remain [R], shape (n, 3)."""


class Placement(NamedTuple):
    """Places of a robot by measurement, and what is around them."""

    panels: Sequence[Stage]
    """One for each measurement, the first one first."""

    center: Reals
    """Where the robot was estimated to be [R], shape (3,)."""

    docks: Reals
    """Centers of the docks of robots that joined earlier [R], shape (n, 3)."""

    radius: float = 1.0
    """R in the log's unit."""

    unit: str = "R"
    """The log's unit."""


def show_placement(file: str, placement: Placement, caption: str) -> Shown:
    """Draw the figure for a page, in columns and, for narrow screens, in rows."""
    from matplotlib import style

    with style.context(["default", figure_style.STYLE]):
        figures = [draw_placement(placement, in_rows=rows) for rows in (False, True)]
        for figure in figures:
            figure.set_dpi(_PAGE_DPI)
        wide, narrow = map(figure_style.svg, figures)
    return show_drawing(file, caption, wide, narrow)


def draw_placement(placement: Placement, *, in_rows: bool = False) -> "Figure":
    """Draw the places that remain after each measurement, seen from two sides.

    Measurements are columns, or rows of a figure as wide as a column of a paper.
    """
    panels = placement.panels[:_MOST_COLUMNS]
    figure, grid = _grid(len(panels), in_rows=in_rows)
    middle = panels[0].places.mean(axis=0)
    half = abs(panels[0].places - middle).max() + _MARGIN
    near = placement.docks[(abs(placement.docks - middle) <= half + 1.0).all(axis=1)]
    limits = np.column_stack([middle - half, middle + half])
    for panel, views in zip(panels, grid, strict=True):
        for axes, view in zip(views, figure_style.VIEWS.values(), strict=True):
            _draw(axes, panel.places[:, view], placement.center[[*view]], near[:, view])
            axes.set(xlim=limits[view[0]], ylim=limits[view[1]], aspect="equal")
            axes.set_xticks([])
            axes.set_yticks([])
        title = panel.title.replace(" of ", "\nof ")
        if in_rows:
            views[0].set_ylabel(title, fontsize=6.0, parse_math=False)
        else:
            views[0].set_title(title, fontsize=7.0, parse_math=False)
    for axes, title in zip(grid[0], figure_style.VIEWS, strict=True):
        if in_rows:
            axes.set_title(title, fontsize=7.0)
        else:
            axes.set_ylabel(title)
    _add_scale(grid[0][-1], limits, placement)
    return figure


def _grid(panels: int, *, in_rows: bool) -> "tuple[Figure, list[list[Axes]]]":
    """Make a figure and its axes: for each panel, one for each view."""
    views = len(figure_style.VIEWS)
    if in_rows:
        figure = new_figure(COLUMN_WIDTH, 0.3 + panels * (COLUMN_WIDTH - 0.4) / views)
        return figure, [[*row] for row in figure.subplots(panels, views, squeeze=False)]
    figure = new_figure(PAGE_WIDTH, 0.6 + views * PAGE_WIDTH / max(panels, 4))
    return figure, [[*column] for column in figure.subplots(views, panels, squeeze=False).T]


def _add_scale(axes: "Axes", limits: Reals, placement: Placement) -> None:
    """Add a bar of a round number of R below a panel, with its length in the log's unit too."""
    size = float(limits[0, 1] - limits[0, 0])
    length = max(step for step in _BARS if step <= max(_LONGEST_BAR * size, _BARS[0]))
    text = f"{length:g} R"
    if placement.unit != "R":
        text += f" = {three_digits(length * placement.radius)} {placement.unit}"
    start, low = limits[list(figure_style.VIEWS.values())[-1], 0] + 0.04 * size
    axes.plot([start, start + length], [low, low], color="black", linewidth=1.5, gid="scale")
    axes.text(start, low + 0.03 * size, text, fontsize=6.0, parse_math=False)


def _draw(axes: "Axes", places: Reals, center: Reals, docks: Reals) -> None:
    """Draw docks as circles, remaining places as points, and the estimate, all in one plane."""
    from matplotlib.collections import EllipseCollection

    size = np.full(len(docks), 2.0)
    circles = EllipseCollection(
        size,
        size,
        np.zeros(len(docks)),
        units="xy",
        offsets=docks,
        offset_transform=axes.transData,
        facecolor=(0.5, 0.5, 0.5, 0.15),
        edgecolor=(0.5, 0.5, 0.5, 0.5),
        linewidth=0.3,
        rasterized=True,
    )
    axes.add_collection(circles)
    drawn = np.random.default_rng(0).permutation(places)[:_MOST_POINTS]
    area = float(np.clip(2000.0 / max(len(drawn), 1), 0.5, 6.0))
    x, y = drawn.T
    axes.scatter(x, y, s=area, color=TRUE_BLUE, linewidths=0.0, rasterized=True)
    axes.plot(*center, "+", color=ESTIMATE_ORANGE, markersize=6.0)
