"""The figure of `profiles.csv`: what errors go along with."""

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from tiswarm.errors import InputError
from tiswarm.report.canvas import PAGE_WIDTH, PALETTE, add_note, new_figure

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
COLUMNS = ["by", "low", "high", "rmse_R"]


def has_profiles(folder: Path) -> bool:
    """Whether a run tells its errors by what robots have in common."""
    return (folder / FILE).is_file()


def draw_profiles(folder: Path, note: str) -> "Figure":
    """Draw RMSE against join, height, hops and contacts, and relative RMSE against hops apart.

    Raises:
        InputError: where the table is damaged.
    """
    table = _read(folder / FILE)
    swept = list(table.columns[: table.columns.get_loc("by")])
    figure = new_figure(PAGE_WIDTH, 3.6)
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


def _read(path: Path) -> pd.DataFrame:
    try:
        table = pd.read_csv(path)
        table[COLUMNS]
    except (OSError, ValueError, KeyError) as error:
        problem = f"cannot be read: {error}; run `tiswarm report` to restore it"
        raise InputError(problem, path=path) from error
    return table
