"""Time of a robot's step against the size of the swarm, one panel a scene."""

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from tiswarm.report.canvas import PAGE_WIDTH, PALETTE, STYLE, new_figure, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = {"f64": "o", "f32": "^", "all": "s"}
LINES = {"f64": "-", "f32": "--", "all": ":"}


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw every engine that was measured, and the streaming bound below them."""
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
        for panel, scene in zip(panels.flat, scenes, strict=False):
            _draw_scene(panel, measured[measured["scene"] == scene])
            panel.set_title(scene)
        for panel in panels[-1]:
            panel.set_xlabel("robots")
        for row in panels:
            row[0].set_ylabel("CPU time of a robot's step [ns]")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper")
        path.write_bytes(png(figure))


def _draw_scene(panel: "Axes", table: pd.DataFrame) -> None:
    libraries = list(dict.fromkeys(name.rpartition("-f")[0] for name in table["engine"]))
    colours = dict(zip(libraries, PALETTE * 2, strict=False))
    for engine, rows in table.groupby("engine", sort=False):
        library, _, kind = str(engine).rpartition("-f")
        kind = "all" if kind.endswith("all") else f"f{kind}"
        style = {"color": colours[library], "linestyle": LINES[kind], "marker": MARKERS[kind]}
        value = "cpu_ns"
        if library == "stream":  # the bytes of a step, without those of lists
            style |= {"color": "0.6", "marker": "none"}
            value = "step_cpu_ns"
        panel.loglog(rows["robots"], rows[value], **style, markersize=3, label=engine)
    panel.grid(visible=True, linewidth=0.3)
