"""Draws the figure of robots that localize themselves: what they send, and how much they err."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.report import figure_style
from tiswarm.report.figure_style import PAGE_WIDTH, line_style, marker_style, new_panels
from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SENT, _ERROR = "sent_B", "rmse_R"
_TICKS = (1.0, 2.0, 5.0)
_NORMAL_95 = 1.96


def traffic_painters(run: RunData) -> dict[str, Callable[[RunData], "Figure"]]:
    """List the figure by file name, if robots of some case sent each other anything."""
    sent = run.summary.get(_SENT)
    return {"traffic": draw_traffic} if sent is not None and sent.notna().any() else {}


def draw_traffic(run: RunData) -> "Figure":
    """Draw RMSE against the bytes that a robot sends, a panel for each kind and size."""
    done = run.summary[run.summary["status"] == "done"]
    groups = [*done.groupby(["kind", "robots"], sort=False)]
    names = list(dict.fromkeys(done["condition"]))
    columns = min(len(groups), 2)
    rows = -(-len(groups) // columns)
    figure, panels = new_panels(PAGE_WIDTH, 1.0 + 3.0 * rows, len(groups), columns, share="xy")
    for axes, ((kind, robots), cases) in zip(panels, groups, strict=True):
        for place, name in enumerate(names):
            _draw_condition(axes, cases[cases["condition"] == name], name, place)
        axes.set_title(f"{kind}, {robots} robots")
        axes.set_xlabel("Sent by a robot [B]")
    panels[0].set_ylabel("RMSE [R]")
    _set_scale(panels[0])
    handles = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4)
    figure_style.add_note(figure, run.note)
    return figure


def _draw_condition(axes: "Axes", cases: pd.DataFrame, name: str, place: int) -> None:
    """Draw the mean of a condition with its 95 % CI: a marker, or a line if nobody sends."""
    if cases.empty:
        return
    mean, half = float(cases[_ERROR].mean()), _half(cases[_ERROR])
    if cases[_SENT].isna().all():
        look = line_style(place)
        axes.axhline(mean, label=name, **look)
        axes.axhspan(max(mean - half, 0.5 * mean), mean + half, alpha=0.12, color=look["color"])
        return
    across = [[min(_half(cases[_SENT]), 0.5 * cases[_SENT].mean())], [_half(cases[_SENT])]]
    up = [[min(half, 0.5 * mean)], [half]]
    look = {**marker_style(place), "linestyle": "", "markersize": 4.0}
    axes.errorbar(cases[_SENT].mean(), mean, xerr=across, yerr=up, label=name, **look)


def _half(values: "pd.Series[float]") -> float:
    """Half of the 95 % confidence interval of a mean; 0 for a single value."""
    return 0.0 if len(values) < 2 else _NORMAL_95 * float(values.std()) / np.sqrt(len(values))  # noqa: PLR2004


def _set_scale(axes: "Axes") -> None:
    """Make both axes logarithmic, with numbers enough to read them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=_TICKS))
        axis.set_minor_formatter(NullFormatter())
        axis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))


def _short(value: float) -> str:
    """Write a number of an axis, thousands as k."""
    return f"{value / 1000.0:g}k" if value >= 1000.0 else f"{value:g}"  # noqa: PLR2004 - a thousand
