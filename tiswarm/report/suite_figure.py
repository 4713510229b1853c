"""Draws the figure of sensor suites: price against error."""

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.aliases import Reals
from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.figure_style import PAGE_WIDTH, fit_axis, marker_style, new_panels, shortened
from tiswarm.report.run_data import RunData, swept_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PRICE, _ERROR, _HALF = "usd_100", "rmse_R_mean", "rmse_R_ci95"
_CHEAPEST = 200.0  # price up to which the axis is linear: some sensors cost nothing [USD]
_MOST_PANELS = 4
_LABEL_HEIGHT = 0.028  # least distance of labels [share of the panel's height]
_LABEL_RIGHT = 0.014  # distance of labels from their markers [share of the panel's width]


def draw_suites(run: RunData) -> "Figure":
    """Draw RMSE of all robots against the price of 100 robots, a marker for each suite and way.

    Each point of a sweep has a panel.
    """
    gaps = ["cases", _PRICE, _ERROR, _HALF]
    table = run.table("suites.csv", ["condition", "suite", "way"], gaps, after="cases")
    table = table[table["cases"] > 0]
    swept = [name for name in swept_words(table) if name not in {"condition", "suite", "way"}]
    swept.remove("needs")
    points = [*table.groupby(swept, sort=False)] if swept else [((), table)]
    shown = points[:_MOST_PANELS]
    ways = list(dict.fromkeys(table["way"]))
    columns = min(2, len(shown))
    figure, panels = new_panels(
        PAGE_WIDTH, 0.6 + 4.4 * -(-len(shown) // columns), len(shown), columns, share="xy"
    )
    fit_axis(panels[0], "y", table[_ERROR].to_numpy(float))
    panels[0].set_xscale("symlog", linthresh=_CHEAPEST, linscale=0.4)
    panels[0].set_xlim(-0.3 * _CHEAPEST, 6.0 * table[_PRICE].max())
    panels[0].set_ylim(top=1.6 * (table[_ERROR] + table[_HALF].fillna(0.0)).max())
    for axes, (point, rows) in zip(panels, shown, strict=True):
        _draw_panel(axes, rows, ways)
        title = ", ".join(f"{key}={value}" for key, value in zip(swept, point, strict=True))
        axes.set_title(shortened(title), fontsize=8.0)
        axes.set_xlabel("Price of 100 robots [USD]")
    panels[0].set_ylabel("RMSE of all robots [R]")
    number = counted(int(table["cases"].max()), "structure")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4,
        title=f"mean and 95 % CI, {number}", title_fontsize=7.0,
    )  # fmt: skip
    left = len(points) - len(shown)
    more = f"{counted(left, 'more sweep point')} in suites.csv" if left else ""
    figure_style.add_note(figure, more, run.note)
    return figure


def _draw_panel(axes: "Axes", rows: pd.DataFrame, ways: list[str]) -> None:
    """Draw a marker for each suite and way, and the name of the suite beside it."""
    price, error = rows[_PRICE].to_numpy(float), rows[_ERROR].to_numpy(float)
    for place, way in enumerate(ways):
        mine = (rows["way"] == way).to_numpy()
        axes.errorbar(
            price[mine], error[mine], yerr=rows.loc[mine, _HALF].fillna(0.0), label=way,
            linestyle="", markersize=4.0, elinewidth=0.6, **marker_style(place),
        )  # fmt: skip
    to_panel = axes.transScale + axes.transLimits
    anchor = to_panel.transform(np.column_stack([price, error]))
    colors = [marker_style(ways.index(way))["color"] for way in rows["way"]]
    for name, color, marker, y in zip(rows["suite"], colors, anchor, _apart(anchor), strict=True):
        x = marker[0] + _LABEL_RIGHT
        axes.annotate(
            name, marker, (x, y), xycoords="axes fraction", textcoords="axes fraction",
            fontsize=5.5, va="center", color=color,
            arrowprops={"arrowstyle": "-", "linewidth": 0.3, "color": color, "shrinkA": 0.0},
        )  # fmt: skip


def _apart(anchor: Reals) -> Reals:
    """Compute heights of labels that do not hide those of the same price, shape (n,).

    Both are in shares of the panel; labels stay as near to their markers as their order allows.
    """
    height: Reals = anchor[:, 1].copy()
    for x in np.unique(anchor[:, 0]):
        mine = np.flatnonzero(anchor[:, 0] == x)
        mine = mine[np.argsort(anchor[mine, 1], kind="stable")]
        step = _LABEL_HEIGHT * np.arange(len(mine))
        height[mine] = _isotonic(anchor[mine, 1] - step) + step
    return height


def _isotonic(values: Reals) -> Reals:
    """Find the ascending values nearest to some values, by least squares."""
    from scipy.optimize import isotonic_regression  # noqa: PLC0415 - slow to import

    found: Reals = isotonic_regression(values).x
    return found
