"""The figure of `scaling.csv`: accuracy and cost against the number of robots."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tiswarm.report.figure_style import PAGE_WIDTH, PALETTE, add_note, new_figure
from tiswarm.report.folder import read_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FILE = "scaling.csv"
PANELS = {
    "rmse_R": "RMSE [R]",
    "procrustes_disparity": "Procrustes disparity",
    "grow_cpu_s": "Growth, processor time [s]",
    "localize_cpu_s": "Localization, processor time [s]",
    "localize_wall_s": "Localization, wall time [s]",
    "localize_peak_memory_MB": "Localization, peak memory [MB]",
}
COLUMNS = ["series", "measure", "robots", "mean", "exponent", "slope"]
MARKERS = "osD^vPX"
THOUSAND = 1000


def has_scaling(folder: Path) -> bool:
    """Whether a run has structures of several sizes."""
    return (folder / FILE).is_file()


def draw_scaling(folder: Path, note: str) -> "Figure":
    """Draw means over structures against N on logarithmic axes; p is the exponent of N^p.

    That of all sizes is followed by that of the two largest.

    Raises:
        InputError: where the table is damaged.
    """
    table = read_table(folder / FILE, COLUMNS)
    figure = new_figure(PAGE_WIDTH, 4.4)
    names = list(dict.fromkeys(table["series"]))
    for axes, (measure, label) in zip(figure.subplots(2, 3).flat, PANELS.items(), strict=True):
        rows = table[table["measure"] == measure]
        for place, name in enumerate(names):
            part = rows[(rows["series"] == name) & (rows["mean"] > 0.0)]
            axes.plot(
                part["robots"],
                part["mean"],
                f"{MARKERS[place % len(MARKERS)]}-",
                color=PALETTE[place % len(PALETTE)],
                markersize=3.0,
                label=name + _powers(part),
            )
        axes.set(xscale="log", xlabel="Robots N", ylabel=label)
        sizes = sorted(set(table["robots"]))
        axes.set_xticks(sizes, [f"{n:g}" if n < THOUSAND else f"{n / THOUSAND:g}k" for n in sizes])
        axes.minorticks_off()
        if not measure.endswith("_MB"):
            _show_decades(axes, rows["mean"])
        if len(rows):
            axes.legend(fontsize=5.5, loc="upper left")
    add_note(figure, note)
    return figure


def _powers(part: "pd.DataFrame") -> str:
    """Exponents of a series as a label says them."""
    if part.empty or pd.isna(part["exponent"].iloc[0]):
        return ""
    return f": p = {part['exponent'].iloc[0]:.2f}, {part['slope'].iloc[-1]:.2f} at the end"


def _show_decades(axes: "Axes", means: "pd.Series[float]") -> None:
    """Make the y axis logarithmic, from one power of ten to another, with room for a legend."""
    positive = means[means > 0.0]
    if len(positive):
        low, high = np.floor(np.log10(positive.min())), np.ceil(np.log10(positive.max()))
        above = max(1.0, np.ceil((high - low) / 3.5))
        axes.set(yscale="log", ylim=(10.0**low, 10.0 ** (high + above)))
