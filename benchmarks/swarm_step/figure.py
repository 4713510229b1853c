"""The figure: CPU time of a robot's step against the number of robots, one panel for each scene."""

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from benchmarks.swarm_step.engines.registry import ENGINES
from tiswarm.report.figure_style import PAGE_WIDTH, PALETTE, STYLE, label_plainly, new_figure, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

MARKERS = {"f64": "o", "f32": "^", "all": "s", "call": "D"}
LINES = {"f64": "-", "f32": "--", "all": ":", "call": "-."}


def _library(engine: str) -> str:
    return engine.partition("-f")[0]


LIBRARIES = list(dict.fromkeys(map(_library, ENGINES)))


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw every measured engine, and the streaming bound."""
    import matplotlib as mpl

    if "cpu_ns" not in table:
        return
    measured = table.dropna(subset=["cpu_ns"])
    scenes = list(measured["scene"].unique())
    with mpl.rc_context(STYLE):
        width = PAGE_WIDTH if len(scenes) > 1 else 0.7 * PAGE_WIDTH
        across = min(len(scenes), 2)
        down = -(-len(scenes) // across)
        figure = new_figure(width, 2.6 * down + 0.6)
        panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
        shown = {}
        for panel, scene in zip(panels.flat, scenes, strict=False):
            shown |= _draw_scene(panel, measured[measured["scene"] == scene])
            panel.set_title(scene)
        for panel in panels[-1]:
            panel.set_xlabel("robots")
        for row in panels:
            row[0].set_ylabel("CPU time of a robot's step [ns]")
        in_order = [engine for engine in ENGINES if engine in shown]
        handles = [shown[engine] for engine in in_order]
        figure.legend(handles, in_order, loc="outside right upper", handlelength=3.5)
        path.write_bytes(png(figure))


def _draw_scene(panel: "Axes", table: pd.DataFrame) -> dict[str, "Line2D"]:
    """Draw one line for each engine; return the lines by engine."""
    lines = {}
    for engine, rows in table.groupby("engine", sort=False):
        library, kind = _library(str(engine)), str(engine).rpartition("-")[2]
        number = LIBRARIES.index(library)
        style = {"linestyle": LINES[kind], "marker": MARKERS[kind], "markersize": 3.5}
        style["color"] = PALETTE[number % len(PALETTE)]
        if number >= len(PALETTE):
            style["markerfacecolor"] = "white"
        value = "cpu_ns"
        if library == "stream":  # the bytes of a step, without those of lists
            style |= {"color": "0.6", "marker": "none"}
            value = "step_cpu_ns"
        lines[str(engine)] = panel.loglog(rows["robots"], rows[value], **style)[0]
    for axis in (panel.xaxis, panel.yaxis):
        label_plainly(axis)
    panel.grid(visible=True, linewidth=0.3)
    return lines
