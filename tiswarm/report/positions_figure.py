"""The figure of estimated and true positions in space."""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from tiswarm.report.figure_style import (
    COLUMN_WIDTH,
    ESTIMATE_ORANGE,
    TRUE_BLUE,
    Array,
    add_note,
    dot_area,
    new_figure,
)
from tiswarm.report.folder import Series, read_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D


def draw_positions(series: Series, note: str) -> "Figure":
    """Draw estimated and true positions of the first case in space, joined by thin lines."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # noqa: PLC0415 - slow to import

    case = next(iter(series.values()))[0]
    names = ["x_R", "y_R", "z_R", "x_est_R", "y_est_R", "z_est_R"]
    rows = read_columns(case.folder / "robots.csv", names)
    pairs = rows[np.isfinite(rows).all(axis=1)].reshape(-1, 2, 3)
    figure = new_figure(COLUMN_WIDTH, COLUMN_WIDTH)
    figure.set_layout_engine("none")  # it knows nothing of three dimensions
    axes: Axes3D = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d", computed_zorder=False)
    axes.add_collection3d(Line3DCollection(pairs, colors="0.35", linewidths=0.6))
    area = dot_area(4 * len(pairs))
    for end, color, label in ((0, TRUE_BLUE, "true"), (1, ESTIMATE_ORANGE, "estimated")):
        axes.scatter(
            *pairs[:, end].T, s=area * (2.0, 1.2)[end], color=color, label=label,
            linewidths=0.0, depthshade=False, clip_on=False,
        )  # fmt: skip
    _frame(axes, pairs.reshape(-1, 3))
    figure.legend(
        loc="upper left", title=f"case {case.name}", title_fontsize=7.0, markerscale=1.5,
        alignment="left", borderaxespad=0.2,
    )  # fmt: skip
    add_note(figure, note)
    return figure


def _frame(axes: "Axes3D", points: Array) -> None:
    """Give the three axes one scale and one tick step, and fit the figure around the box."""
    from matplotlib.ticker import MaxNLocator, MultipleLocator

    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    side = np.maximum(high - low, 0.25 * (high - low).max())
    low = (low + high - side) / 2.0
    step = float(np.diff(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0.0, side.max()))[0])
    for axis, name, start, length in zip(
        (axes.xaxis, axes.yaxis, axes.zaxis), "xyz", low, side, strict=True
    ):
        axes.set(**{f"{name}lim": (start, start + length), f"{name}label": f"{name} [R]"})
        axis.set_major_locator(MultipleLocator(step))
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"].update(color="0.85", linewidth=0.4)  # noqa: SLF001 - no public way
    axes.tick_params(labelsize=7.0)
    axes.set_proj_type("ortho")
    axes.view_init(elev=15.0, azim=-60.0)
    axes.set_box_aspect(tuple(side))
    corners = low + side * np.array(list(itertools.product((0, 1), repeat=3)))
    projected = np.column_stack([corners, np.ones(8)]) @ axes.get_proj().T
    extent = np.ptp(projected[:, :2] / projected[:, 3:], axis=0) / axes.viewLim.width
    zoom = min(0.76 / extent[0], 1.1 / extent[1])  # the rest is for labels
    tall = zoom * float(extent[1]) + 0.18
    axes.set_box_aspect(tuple(side), zoom=zoom)
    axes.set_position((0.0, 0.53 - 0.5 / tall, 1.0, 1.0 / tall))
    axes.get_figure().set_size_inches(COLUMN_WIDTH, COLUMN_WIDTH * tall)
    _place_labels(axes, zoom * extent, tall)


def _place_labels(axes: "Axes3D", extent: Array, tall: float) -> None:
    """Keep labels at one distance from the box; Axes3D moves them away as the box grows.

    Args:
        axes: Axes to label.
        extent: Width and height of the box on paper [column widths].
        tall: Height of the figure [column widths].
    """
    for axis, across in ((axes.xaxis, extent[1]), (axes.yaxis, extent[1]), (axes.zaxis, extent[0])):
        moved = 4.0 * across / (1.0 + tall)  # by each point of padding [pt]
        axis.labelpad = 21.0 / moved - 21.0  # Axes3D itself adds 21 and 8
        axis.set_tick_params(pad=8.0 / moved - 8.0)
