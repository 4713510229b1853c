"""Draws the figures of tables: accuracy, profiles, scaling, and the comparison of runs."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tiswarm.progress import Progress
from tiswarm.records.io import write_bytes
from tiswarm.report.figure_style import (
    MARKERS,
    PAGE_WIDTH,
    PALETTE,
    STYLE,
    add_note,
    line_style,
    new_figure,
    panel_grid,
    png,
    shortened,
)
from tiswarm.report.run_data import RunData, read_table, swept_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURES = {
    "rmse_R": ("RMSE [R]", "paper_rmse_radii"),
    "procrustes_disparity": ("Procrustes disparity", "paper_procrustes_disparity"),
}
"""By measure, what stands below its axis, and its published counterpart."""

MOST_ROWS = 60
MOST_COLUMNS = 4
LEGEND_MARK, LEGEND_LETTER = 0.5, 0.055
"""Width of an entry's marker with the space around it, and of a letter [inch]."""

PROFILED = {
    "join": "Join",
    "height_R": "True height [R]",
    "hops_from_anchor": "Contacts from the anchor",
    "contacts": "Contacts of the robot",
    "hops_apart": "Contacts between two robots",
}
MOST_POINTS = 4
"""Points of a sweep that have a figure of profiles each."""

SCALING_PANELS = {
    "rmse_R": "RMSE [R]",
    "procrustes_disparity": "Procrustes disparity",
    "grow_cpu_s": "Growth, processor time [s]",
    "localize_cpu_s": "Localization, processor time [s]",
    "localize_wall_s": "Localization, wall time [s]",
    "localize_peak_memory_MB": "Localization, peak memory [MB]",
}
SCALING_COLUMNS = ["series", "measure", "robots", "mean", "exponent", "slope"]
THOUSAND = 1000


def draw_accuracy(run: RunData) -> "Figure":
    """Draw means over structures with 95 % confidence intervals, a row a condition.

    Points of the sweep share a row and differ in color and marker. Open markers are published
    numbers, whose unit of length is not defined.

    Raises:
        InputError: where the table is damaged.
    """
    published = [column for _, column in MEASURES.values()]
    table = run.table("table.csv", ["condition", "cases", *published])
    told = [f"{name}=" + table[name].astype(str) for name in swept_columns(table)[1:]]
    points = pd.Series([shortened(", ".join(point)) for point in zip(*told, strict=True)])
    points = points if told else pd.Series("", table.index)
    names = list(dict.fromkeys(table["condition"]))
    shown = list(dict.fromkeys(points))[: max(1, MOST_ROWS // len(names))]
    figure = new_figure(PAGE_WIDTH, 0.9 + 0.12 * len(names) * (1 + len(shown)))
    panels = panel_grid(figure, len(MEASURES), len(MEASURES), sharey=True)
    for axes, (measure, (_, counterpart)) in zip(panels, MEASURES.items(), strict=True):
        for index, point in enumerate(shown):
            rows = table[points == point].set_index("condition").reindex(names)
            place = np.arange(len(names)) + (index - 0.5 * (len(shown) - 1)) / (1 + len(shown))
            look: dict[str, Any] = {
                "color": PALETTE[index % len(PALETTE)], "marker": MARKERS[index % len(MARKERS)],
                "linestyle": "", "markersize": 3.5,
            }  # fmt: skip
            spread = rows[f"{measure}_ci95"].fillna(0.0)
            axes.errorbar(
                rows[f"{measure}_mean"], place, xerr=spread, label=point or "mean", **look
            )
            axes.plot(rows[counterpart], place, markerfacecolor="white", **look)
    _finish_rows(panels, names)
    if table[published].notna().any(axis=None):
        panels[0].plot(
            [], [], "o", color="0.35", markerfacecolor="white", markersize=3.5,
            label="published (robot radii)",
        )  # fmt: skip
    if len(shown) > 1:
        handles, labels = panels[0].get_legend_handles_labels()
        width = LEGEND_MARK + LEGEND_LETTER * max(map(len, labels))
        columns = max(1, min(MOST_COLUMNS, int(PAGE_WIDTH / width)))
        figure.legend(handles, labels, loc="outside upper right", ncols=columns)
    left = len(set(points)) - len(shown)
    notes = [f"{left} more points are in table.csv" if left else "", run.note]
    add_note(figure, "; ".join(text for text in notes if text))
    return figure


def draw_comparison(folder: Path, progress: Progress) -> Path:
    """Draw `comparison.png` beside the table that it shows."""
    from matplotlib import style

    path = folder / "comparison.png"
    with style.context(["default", STYLE]):
        write_bytes(path, png(comparison_figure(read_table(folder / "comparison.csv"))))
    progress.info(path.name)
    return path


def comparison_figure(table: pd.DataFrame) -> "Figure":
    """Draw the mean of each row with its confidence interval, one color a run."""
    shown = table.head(MOST_ROWS)
    swept = swept_columns(table)[1:]
    labels = [
        ", ".join(str(row[name]) for name in reversed(swept) if not pd.isna(row[name]))
        for row in shown.to_dict("records")
    ]
    figure = new_figure(PAGE_WIDTH, 0.9 + 0.17 * len(shown))
    panels = panel_grid(figure, len(MEASURES), len(MEASURES), sharey=True)
    for axes, name in zip(panels, MEASURES, strict=True):
        for index, run in enumerate(shown["run"].unique()):
            rows = (shown["run"] == run).to_numpy()
            axes.errorbar(
                shown.loc[rows, f"{name}_mean"], np.flatnonzero(rows),
                xerr=shown.loc[rows, f"{name}_ci95"].fillna(0.0), fmt="o", markersize=3.5,
                color=PALETTE[index % len(PALETTE)], label=run, linewidth=1.0,
            )  # fmt: skip
    _finish_rows(panels, labels)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    note = "mean and 95 % confidence interval"
    if len(shown) < len(table):
        note += f"; {len(table) - len(shown)} more rows are in comparison.csv"
    add_note(figure, note)
    return figure


def _finish_rows(panels: "list[Axes]", names: Sequence[str]) -> None:
    """Name the rows, from the top, and what is drawn in each panel."""
    for axes, (label, _) in zip(panels, MEASURES.values(), strict=True):
        axes.set_xlabel(label)
        axes.set_xlim(left=0.0)
        axes.grid(axis="y", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
    panels[0].set_yticks(np.arange(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)


def profile_painters(run: RunData) -> dict[str, Callable[[RunData], "Figure"]]:
    """By file name, what draws the profiles of a run: a figure for each of a few sweep points.

    Of many points, or of none, all conditions share a figure; without the table there is none.

    Raises:
        InputError: where the table is damaged.
    """
    table = run.table("profiles.csv", optional=True)
    if "rmse_R" not in table:  # no case was finished
        return {}
    swept = swept_columns(table, before="by")[1:]
    points = dict(list(table.groupby(swept, sort=False))) if swept else {}
    if not 1 < len(points) <= MOST_POINTS:
        return {"profiles": partial(draw_profiles, table=table)}
    return {
        f"profiles-{_slug(point)}": partial(draw_profiles, table=part.drop(columns=swept))
        for point, part in points.items()
    }


def draw_profiles(run: RunData, table: pd.DataFrame) -> "Figure":
    """Draw RMSE against join, height, hops and contacts, and relative RMSE against hops apart."""
    swept = swept_columns(table, before="by")
    figure = new_figure(PAGE_WIDTH, 3.6 + 0.28 * max(0, len(table[swept].drop_duplicates()) - 10))
    panels = panel_grid(figure, len(PROFILED), 3)
    for axes, (name, label) in zip(panels, PROFILED.items(), strict=True):
        part = table[table["by"] == name]
        for place, (series, rows) in enumerate(part.groupby(swept, sort=False)):
            axes.plot(
                (rows["low"] + rows["high"]) / 2.0, rows["rmse_R"], marker="o", markersize=2.5,
                label=", ".join(map(str, reversed(series))), **line_style(place),
            )  # fmt: skip
        axes.set(xlabel=label, ylabel="RMSE [R]")
        axes.set_ylim(bottom=0.0)
    axes.set(xscale="log", ylabel="Relative RMSE [R]")
    ticks = sorted(set(part["low"]))
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    figure.axes[-1].legend(*axes.get_legend_handles_labels(), loc="center left")
    add_note(figure, run.note)
    return figure


def _slug(point: object) -> str:
    """A file name for values of the sweep."""
    values = point if isinstance(point, tuple) else (point,)
    return re.sub(r"[^A-Za-z0-9.]+", "-", "-".join(map(str, values))).strip("-")


def draw_scaling(run: RunData) -> "Figure":
    """Draw means over structures against N on logarithmic axes; p is the exponent of N^p.

    That of all sizes is followed by that of the two largest.

    Raises:
        InputError: where the table is damaged.
    """
    table = run.table("scaling.csv", SCALING_COLUMNS)
    figure = new_figure(PAGE_WIDTH, 4.4)
    names = list(dict.fromkeys(table["series"]))
    for axes, (measure, label) in zip(
        figure.subplots(2, 3).flat, SCALING_PANELS.items(), strict=True
    ):
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
    add_note(figure, run.note)
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
