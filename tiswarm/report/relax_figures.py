"""Draws figures of runs of the engine: throughput by the number of robots, and motion by step."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, joined_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figures that a run of the engine has, by file name."""
    if not run.is_of_engine or not (run.folder / "throughput.csv").is_file():
        return {}
    return {"throughput": draw_throughput, "motion": draw_motion}


def draw_throughput(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw robot steps a second of processor time against robots, a line for each series."""
    gaps = [_ROBOTS, _RATE, _LEAST, _MOST]
    table = run.table("throughput.csv", ["condition"], gaps, after="cases")
    table = table[table[_RATE] > 0.0]
    keys = [key for key in ("condition", *_swept(table)) if table[key].nunique() > 1]
    series = table.assign(of=joined_words(table, keys))
    names = list(dict.fromkeys(series["of"]))
    panels = figure_style.Panels(3.0, 1, 1, max_width=max_width)
    for index, name in enumerate(names[: figure_style.MOST_SERIES]):
        rows = series[series["of"] == name].sort_values(_ROBOTS)
        bars = [rows[_RATE] - rows[_LEAST], rows[_MOST] - rows[_RATE]]
        look: dict[str, Any] = figure_style.marker_style(index)
        panels.first.errorbar(rows[_ROBOTS], rows[_RATE], yerr=bars, label=name, **look)
    figure_style.set_log(panels.first, "x")
    span = float(table[_MOST].max() / table[_LEAST].min()) if len(table) else 1.0
    figure_style.set_log(panels.first, "y", span)
    panels.first.set(xlabel="Robots", ylabel="Robot steps per CPU second [1/s]")
    if len(names) > 1:
        panels.legend(loc="outside upper right")
    omitted = max(len(names) - figure_style.MOST_SERIES, 0)
    return panels.finish(figure_style.omission_note(omitted, "line", "in throughput.csv"), run.note)


def _swept(table: Any) -> list[str]:  # noqa: ANN401 - a data frame
    """List the swept keys but the number of robots, which is an axis."""
    first = list(table.columns[: table.columns.get_loc("cases")])
    return [key for key in first if key not in {"condition", "robots"}]


def draw_motion(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw the longest step against the number of steps, a panel for each point of the sweep."""
    points: dict[str, dict[str, list[Any]]] = {}
    for cases in run.series.values():
        of_point = points.setdefault(cases[0].point, {})
        of_point.setdefault(cases[0].condition, []).extend(cases)
    shown = dict(list(points.items())[:_MOST_PANELS])
    columns = figure_style.columns_of(len(shown))
    height = 0.8 + 1.9 * -(-len(shown) // columns)
    panels = figure_style.Panels(height, len(shown), columns, share="y", max_width=max_width)
    conditions = list(dict.fromkeys(name for of_point in shown.values() for name in of_point))
    for axes, (point, of_point) in panels.paired_with(shown.items()):
        for name, cases in of_point.items():
            tables = [case.columns("moves.csv", ["step", "largest_move_R"]) for case in cases]
            mean = np.mean([table[:, 1] for table in tables], axis=0)
            look = figure_style.line_style(conditions.index(name))
            axes.plot(tables[0][:, 0], np.maximum(mean, 1e-12), label=name, **look)
        figure_style.set_title(axes, point)
    figure_style.set_log(panels.first, "y")
    panels.label_once("Step", "Longest step [R]")
    if len(conditions) > 1:
        panels.legend()
    omitted = len(points) - len(shown)
    return panels.finish(figure_style.omission_note(omitted, "panel", "not drawn"), run.note)
