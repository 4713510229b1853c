"""Draws figures of runs of the engine: throughput by the number of robots, and motion by step."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, joined_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROBOTS = "robot_count"
_RATE = "robot_steps_per_cpu_s"
_LEAST = "least_per_cpu_s"
_MOST = "most_per_cpu_s"
_MOST_PANELS = 9

CAPTIONS = {
    "throughput": figure_style.Caption(
        "Steps of a robot in a second of processor time, neighbor lists included, against the "
        "number of robots, on logarithmic axes. Bars reach from the slowest to the fastest case. "
        "Times depend on the machine and on what else it does.",
    ),
    "motion": figure_style.Caption(
        "Longest step of a robot against the number of steps, in the mean over the swarms, a panel "
        "for each number of robots and point of the sweep. A swarm that settles comes to rest.",
    ),
    "swarm": figure_style.Caption(
        "Robots after the last step, colored by their numbers, which follow the lattice where they "
        "started."
    ),
    "moved": figure_style.Caption(
        "Robots after the last step, each colored by how far it is from where it started."
    ),
    "overlap": figure_style.Caption(
        "Robots after the last step, each colored by how much nearer than touching one of its "
        "docks is to a dock that it is not connected to."
    ),
}
"""What these figures and 3D pictures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figures that a run of the engine has, by file name."""
    if not run.is_of_engine or not (run.folder / "throughput.csv").is_file():
        return {}
    return {"throughput": throughput_drawing(run), "motion": motion_drawing(run)}


def throughput_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of robot steps a second of processor time against robots."""
    gaps = [_ROBOTS, _RATE, _LEAST, _MOST]
    table = run.table("throughput.csv", ["condition"], gaps, after="cases")
    table = table[table[_RATE] > 0.0]
    keys = [key for key in ("condition", *_swept(table)) if table[key].nunique() > 1]
    table = table.assign(of=joined_words(table, keys))
    names = list(dict.fromkeys(table["of"]))

    def paint(axes: "Axes", panel: str, series: Sequence[str]) -> None:  # noqa: ARG001 - one panel
        draw_throughput(axes, table, series)

    def complete(panels: figure_style.Panels) -> list[str]:
        if len(names) > 1:
            panels.legend(loc="outside upper right")
        omitted = max(len(names) - figure_style.MOST_SERIES, 0)
        return [figure_style.omission_note(omitted, "line", "in throughput.csv"), run.note]

    return figure_style.Drawing(
        panels=[_RATE], series=names[: figure_style.MOST_SERIES], paint=paint, complete=complete,
        row_height=2.4, alone=figure_style.PAGE_WIDTH,
    )  # fmt: skip


def draw_throughput(axes: "Axes", table: Any, series: Sequence[str]) -> None:  # noqa: ANN401
    """Draw robot steps a second of processor time against robots, a line for each series.

    Args:
        axes: Panel.
        table: `throughput.csv`, a data frame, with the column `of`, the series of a row.
        series: Names of the series to draw.
    """
    looks = list(dict.fromkeys(table["of"]))
    for name in series:
        rows = table[table["of"] == name].sort_values(_ROBOTS)
        bars = [rows[_RATE] - rows[_LEAST], rows[_MOST] - rows[_RATE]]
        look: dict[str, Any] = figure_style.marker_style(looks.index(name))
        axes.errorbar(rows[_ROBOTS], rows[_RATE], yerr=bars, label=name, **look)
    figure_style.set_log(axes, "x")
    span = float(table[_MOST].max() / table[_LEAST].min()) if len(table) else 1.0
    figure_style.set_log(axes, "y", span)
    axes.set(xlabel="Robots", ylabel="Robot steps per CPU second [1/s]")


def _swept(table: Any) -> list[str]:  # noqa: ANN401 - a data frame
    """List the swept keys but the number of robots, which is an axis."""
    first = list(table.columns[: table.columns.get_loc("cases")])
    return [key for key in first if key not in {"condition", "robots"}]


def motion_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of the longest step, a panel for each point of the sweep."""
    points: dict[str, dict[str, list[Any]]] = {}
    for cases in run.series.values():
        of_point = points.setdefault(cases[0].point, {})
        of_point.setdefault(cases[0].condition, []).extend(cases)
    shown = dict(list(points.items())[:_MOST_PANELS])
    conditions = list(dict.fromkeys(name for of_point in shown.values() for name in of_point))

    def paint(axes: "Axes", point: str, series: Sequence[str]) -> None:
        for name in series:
            if name in shown[point]:
                look = figure_style.line_style(conditions.index(name))
                draw_motion(axes, shown[point][name], {"label": name, **look})
        figure_style.set_title(axes, point)

    def complete(panels: figure_style.Panels) -> list[str]:
        figure_style.set_log(panels.first, "y")
        panels.label_once("Step", "Longest step [R]")
        if len(conditions) > 1:
            panels.legend()
        omitted = len(points) - len(shown)
        return [figure_style.omission_note(omitted, "panel", "not drawn"), run.note]

    return figure_style.Drawing(
        panels=list(shown), series=conditions, paint=paint, complete=complete,
        columns=figure_style.columns_of(len(shown)), row_height=1.9, head_height=0.8, share="y",
    )  # fmt: skip


def draw_motion(axes: "Axes", cases: Sequence[Any], look: Mapping[str, Any]) -> None:
    """Draw the longest step of a robot against the number of steps, in the mean over cases."""
    tables = [case.columns("moves.csv", ["step", "largest_move_R"]) for case in cases]
    mean = np.mean([table[:, 1] for table in tables], axis=0)
    axes.plot(tables[0][:, 0], np.maximum(mean, 1e-12), **look)
