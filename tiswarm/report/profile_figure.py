"""The figure of `profiles.csv`: what errors go along with."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from tiswarm.report.canvas import PAGE_WIDTH, PALETTE, add_note, new_figure
from tiswarm.report.folder import read_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE = "profiles.csv"
PANELS = {
    "join": "Join",
    "height_R": "True height [R]",
    "hops_from_anchor": "Contacts from the anchor",
    "contacts": "Contacts of the robot",
    "hops_apart": "Contacts between two robots",
}
LINE_STYLES = ("-", "--", ":")
MOST_POINTS = 4
"""Points of a sweep that have a figure each."""


def profile_painters(folder: Path, note: str) -> dict[str, Callable[[], "Figure"]]:
    """By file name, what draws the profiles of a run: a figure for each of a few sweep points.

    Of many points, or of none, all conditions share a figure; without the table there is none.

    Raises:
        InputError: where the table is damaged.
    """
    if not (folder / FILE).is_file():
        return {}
    table = read_table(folder / FILE, ["by"])
    if "rmse_R" not in table:  # no case was finished
        return {}
    swept = list(table.columns[1 : table.columns.get_loc("by")])
    points = dict(list(table.groupby(swept, sort=False))) if swept else {}
    if not 1 < len(points) <= MOST_POINTS:
        return {"profiles": partial(draw_profiles, table, note)}
    return {
        f"profiles-{_slug(point)}": partial(draw_profiles, part.drop(columns=swept), note)
        for point, part in points.items()
    }


def draw_profiles(table: pd.DataFrame, note: str) -> "Figure":
    """Draw RMSE against join, height, hops and contacts, and relative RMSE against hops apart.

    Args:
        table: Rows of `profiles.csv`.
        note: What to say below.
    """
    swept = list(table.columns[: table.columns.get_loc("by")])
    figure = new_figure(PAGE_WIDTH, 3.6 + 0.28 * max(0, len(table[swept].drop_duplicates()) - 10))
    panels = figure.subplots(2, 3).flat
    for axes, (name, label) in zip(panels, PANELS.items(), strict=False):
        part = table[table["by"] == name]
        for place, (series, rows) in enumerate(part.groupby(swept, sort=False)):
            axes.plot(
                (rows["low"] + rows["high"]) / 2.0,
                rows["rmse_R"],
                LINE_STYLES[place // len(PALETTE) % len(LINE_STYLES)],
                color=PALETTE[place % len(PALETTE)],
                label=", ".join(map(str, reversed(series))),
                marker="o",
                markersize=2.5,
            )
        axes.set(xlabel=label, ylabel="RMSE [R]")
        axes.set_ylim(bottom=0.0)
    axes.set(xscale="log", ylabel="Relative RMSE [R]")
    ticks = sorted(set(part["low"]))
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    last = figure.axes[-1]
    last.set_axis_off()
    last.legend(*axes.get_legend_handles_labels(), loc="center left")
    add_note(figure, note)
    return figure


def _slug(point: object) -> str:
    """A file name for values of the sweep."""
    values = point if isinstance(point, tuple) else (point,)
    return re.sub(r"[^A-Za-z0-9.]+", "-", "-".join(map(str, values))).strip("-")
