"""Figures of cases: convergence, error against height, estimated against true positions."""

import itertools
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.canvas import (
    COLUMN_WIDTH,
    ESTIMATE_ORANGE,
    PAGE_WIDTH,
    PALETTE,
    TRUE_BLUE,
    add_note,
    new_figure,
    shortened,
)
from tiswarm.report.folder import Case, Series, read_columns

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

Array = NDArray[np.float64]

LINE_STYLES = ("-", "--", ":")
MAX_PANELS = 9
LEGEND_LINE = 0.14
"""Height of a line of a legend or title [inch]."""

MAX_POINTS = 20_000
"""Points drawn in one panel; of more, a fixed random choice."""


def draw_convergence(series: Series, note: str) -> "Figure":
    """Draw RMSE against iteration: mean over seeds, and a band of one standard deviation.

    Each point of a sweep has its panel with a line for each condition.
    """
    points = _by_point(series)
    shown = dict(list(points.items())[:MAX_PANELS])
    names = list(dict.fromkeys(name for of_point in shown.values() for name in of_point))
    columns = 2 if len(shown) == 4 else min(3, len(shown))  # noqa: PLR2004 - a square
    rows, in_line = -(-len(shown) // columns), 2 if columns == 1 else 4
    figure = new_figure(
        COLUMN_WIDTH if columns == 1 else PAGE_WIDTH,
        0.8 + 1.9 * rows + LEGEND_LINE * (len(names) // in_line),
    )
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    legend: dict[str, Artist] = {}
    top = 0.0
    for axes, (title, of_point) in zip(panels.flat, shown.items(), strict=False):
        top = max(top, _plot_convergence(axes, of_point, names))
        axes.set_title(title, fontsize=8.0)
        legend |= {str(line.get_label()): line for line in axes.lines}
    for axes in panels.flat[len(shown) :]:
        axes.set_axis_off()
    panels.flat[0].set_ylim(0.0, 1.05 * top or 1.0)
    figure.supylabel("RMSE [R]", fontsize=8.0)
    seeds = max(map(len, series.values()))
    figure.legend(
        legend.values(), legend.keys(), loc="outside upper center", ncols=in_line,
        title=f"mean ± std, {seeds} structures" if seeds > 1 else "1 structure", title_fontsize=7.0,
    )  # fmt: skip
    left = len(points) - len(shown)
    add_note(figure, "; ".join(filter(None, [f"{left} more points not shown" * (left > 0), note])))
    return figure


def _by_point(series: Series) -> dict[str, Series]:
    """Conditions by point of the sweep; all in one where points have one condition each."""
    points: dict[str, Series] = {}
    for name, cases in series.items():
        points.setdefault(shortened(cases[0].point), {})[cases[0].condition or name] = cases
    if len(points) == len(series) > 1:
        return {"": {shortened(name): cases for name, cases in series.items()}}
    return points


def _plot_convergence(axes: "Axes", series: Series, names: list[str]) -> float:
    """Draw mean and band of each series; returns how high they reach [R].

    Args:
        axes: Where to draw.
        series: Cases by name.
        names: All names, which have a color each.
    """
    top = 0.0
    for name, cases in series.items():
        index = names.index(name)
        color = PALETTE[index % len(PALETTE)]
        style = LINE_STYLES[index // len(PALETTE) % len(LINE_STYLES)]
        iteration, rmse = _traces(cases)
        if not iteration.size:
            continue
        mean, spread = rmse.mean(axis=0), rmse.std(axis=0)
        axes.plot(iteration, mean, style, color=color, label=name)
        axes.fill_between(
            iteration, mean - spread, mean + spread, color=color, alpha=0.2, linewidth=0.0
        )
        top = max(top, float((mean + spread).max()))
    axes.set_xlabel("Iteration")
    axes.margins(x=0.0)
    return top


def _traces(cases: list[Case]) -> tuple[Array, Array]:
    """Put every case's RMSE on one axis of iterations; a case that ended early holds its last."""
    names = ["iteration", "rmse_R"]
    tables = [read_columns(case.folder / "convergence.csv", names) for case in cases]
    tables = [table for table in tables if len(table)]
    if not tables:
        return np.empty(0), np.empty((0, 0))
    iteration = np.unique(np.concatenate([table[:, 0] for table in tables]))
    return iteration, np.array([np.interp(iteration, *table.T) for table in tables])


def draw_error_against_height(series: Series, note: str) -> "Figure":
    """Draw each robot's error against its true height, colored by when it joined."""
    shown = list(series.items())[:MAX_PANELS]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    width = COLUMN_WIDTH if columns == 1 else 1.2 + 2.0 * columns
    lines = max(name.count(", ") for name, _ in shown)
    figure = new_figure(width, 0.5 + (2.0 + LEGEND_LINE * lines) * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    tables = [errors_at(cases, "z_R") for _, cases in shown]
    notes = [note] if note else []
    for axes, (name, _), table in zip(panels.flat, shown, tables, strict=False):
        dots = scatter_errors(axes, table, last_join(tables))
        if len(table) > MAX_POINTS:
            notes.append(f"{name}: {MAX_POINTS} of {len(table)} robots drawn")
        axes.set_title(shortened(name).replace(", ", ",\n"), fontsize=7.0)
    for axes in panels.flat[len(shown) :]:
        axes.set_axis_off()
    panels.flat[0].set_ylim(bottom=0.0)
    figure.supxlabel("True height [R]", fontsize=8.0)
    figure.supylabel("Error [R]", fontsize=8.0)
    add_join_bar(figure, dots)
    if len(shown) < len(series):
        notes.append(f"{len(series) - len(shown)} more conditions are not shown")
    add_note(figure, "; ".join(notes))
    return figure


def errors_at(cases: list[Case], column: str) -> Array:
    """Gather a column, error and join index of every located robot, shape (robots, 3)."""
    tables = []
    for case in cases:
        values = read_columns(case.folder / "robots.csv", [column, "error_R"])
        tables.append(np.column_stack([values, np.arange(len(values))]))
    table = np.concatenate(tables)
    return np.asarray(table[np.isfinite(table).all(axis=1)])


def last_join(tables: list[Array]) -> float:
    """Greatest join index of several tables of errors."""
    return max(1.0, *(float(table[:, 2].max(initial=0.0)) for table in tables))


def scatter_errors(axes: "Axes", table: Array, last: float) -> "PathCollection":
    """Draw rows of `errors_at`, colored by join index; of very many, some."""
    points = np.random.default_rng(0).permutation(table)[:MAX_POINTS]
    return axes.scatter(
        points[:, 0], points[:, 1], c=points[:, 2], s=_dot_area(len(points)),
        cmap="viridis", vmin=0.0, vmax=last, linewidths=0.0, clip_on=False,
    )  # fmt: skip


def add_join_bar(figure: "Figure", dots: "PathCollection") -> None:
    """Say which color is which join index."""
    bar = figure.colorbar(dots, ax=figure.axes, label="Join index", aspect=25, pad=0.02)
    bar.ax.spines["outline"].set_visible(False)


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
    area = _dot_area(4 * len(pairs))
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


def _dot_area(count: int) -> float:
    """Shrink dots as they get many, so that a cloud stays a cloud [pt^2]."""
    return float(np.clip(9000.0 / max(count, 1), 1.0, 12.0))
