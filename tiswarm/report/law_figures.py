"""Figures of a run that is held against laws: what came out, and the published forms.

Dots and lines are means over structures, bars and bands one standard deviation. Axes are
stretched so that a published form is a straight line.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tiswarm.report.figure_style import (
    COLUMN_WIDTH,
    PAGE_WIDTH,
    TRUE_BLUE,
    Array,
    add_note,
    new_figure,
)
from tiswarm.report.folder import read_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PEAK = "Peak stress\n[weight of a dock / R²]"
ROBOTS = "Robots N"
TOWER_AXES = ("F [weight of a dock]", "B", "J", ROBOTS)

LOOKS = {
    "F = 1": ("#440154", "o"),
    "F = 2.5": ("#3B528B", "s"),
    "F = 5": ("#21918C", "^"),
    "F = 10": ("#5DB33F", "D"),
    "F = 25": ("#E3A80B", "v"),
}
"""Color and marker of each threshold: from dark to light as F grows, also in grey."""

ONLY = (TRUE_BLUE, "o")
"""Color and marker where there is one series."""

STALLS = {"F = 1": 5.0, "F = 2.5": 17.0, "F = 5": 20.0}
"""N at which cantilevers were published to stall (ReactiveBuild, DARS 2021)."""

LAW_POINTS = "law-points.csv"
Scale = tuple[Callable[[Array], Array], Callable[[Array], Array]]

INVERSE: Scale = (lambda x: -1.0 / np.maximum(x, 0.1), lambda x: -1.0 / x)


class Points(NamedTuple):
    """One series of a law, n points in rising x, as `law-points.csv` has them: shapes (n,)."""

    x: Array
    mean: Array
    std: Array
    """Standard deviation over structures, 0 where there is one."""

    structures: Array
    fitted: Array
    """The published form, NaN where there is none."""

    @property
    def r2(self) -> float:
        """Share of the variance of the means that the published form explains [1], or NaN."""
        spread = float(np.sum((self.mean - self.mean.mean()) ** 2))
        return 1.0 - float(np.sum((self.mean - self.fitted) ** 2)) / spread if spread else np.nan


LawPoints = dict[str, dict[str, Points]]
"""Points by law and series, such as `F = 5`."""


def read_law_points(folder: Path) -> LawPoints:
    """Read the points of every law.

    Raises:
        InputError: the table or a column is missing or damaged.
    """
    columns = list(Points._fields)
    table = read_table(folder / LAW_POINTS, ["law", "series"], columns)
    table = table.fillna({"series": "", "std": 0.0})
    found: LawPoints = {}
    for (law, series), group in table.groupby(["law", "series"], sort=False):
        found.setdefault(str(law), {})[str(series)] = Points(*group[columns].to_numpy().T)
    return found


def _power(exponent: float) -> Scale:
    return lambda x: np.maximum(x, 0.0) ** exponent, lambda x: x ** (1.0 / exponent)


def draw_towers(laws: LawPoints, note: str) -> "Figure":
    """Draw height and peak stress of towers against F, B, J and N."""
    figure = new_figure(PAGE_WIDTH, 4.2)
    panels = figure.subplots(2, 4, sharey="row", squeeze=False)
    for row, (name, label) in enumerate((("height", "Height [R]"), ("peak", PEAK))):
        over_f, over_b, over_j, over_n = panels[row]
        _dots(over_f, laws.get(f"tower {name} over F", {}))
        _dots(over_b, laws.get(f"tower {name} over B", {}))
        _steps(over_j, laws.get(f"tower {name} over J", {}))
        _lines(over_n, laws.get(f"tower {name} over N", {}))
        root = row == 0
        _stretch(over_f, _power(0.5 if root else 1.0), (1, 5, 10, 25), (0.5 if root else -0.5, 28))
        _stretch(over_b, INVERSE, (1.5, 3, 6, 10), (1.35, 13.0))
        _stretch(over_n, _power(0.5 if root else 1.0), (25, 50, 75, 100), (23.0, 103.0))
        over_f.set_ylabel(label)
        over_f.set_ylim(0.0, 1.12 * over_f.get_ylim()[1])  # room for what is written above
        _name_ends(over_n, laws.get(f"tower {name} over N", {}), 0.085)
        forms = ("√F", "1/B", "", "√N") if root else ("F", "1/B", "", "N")
        for axes, form, x in zip(panels[row], forms, TOWER_AXES, strict=True):
            axes.set_xlabel(x)
            _title(axes, form)
    add_note(figure, note)
    return figure


def draw_cross_section(laws: LawPoints, note: str) -> "Figure":
    """Draw how many spheres a tower has at a height, against the distance from its top."""
    figure = new_figure(COLUMN_WIDTH, 2.6)
    axes = figure.add_subplot()
    for series, points in laws.get("tower cross-section", {}).items():
        color, marker = LOOKS.get(series, ONLY)
        below = points.x > 0.0  # the top itself has no place on a logarithmic axis
        x, mean, fitted = points.x[below], points.mean[below], points.fitted[below]
        axes.plot(x, mean, marker, color=color, markersize=3.0, markeredgewidth=0.0, label=series)
        axes.plot(x, fitted, "--", color=color, linewidth=0.9, label=f"k d², R² = {points.r2:.3f}")
    axes.set(
        xscale="log", yscale="log", xlabel="Distance d from the top [R]",
        ylabel="Spheres within 1 R of a height", ylim=(0.7, None),
    )  # fmt: skip
    _plain_ticks(axes)
    _legend(axes, "upper left")
    add_note(figure, note)
    return figure


def draw_cantilevers(laws: LawPoints, note: str) -> "Figure":
    """Draw how far cantilevers reach, against N, and where they were published to stall."""
    figure = new_figure(COLUMN_WIDTH, 2.5)
    axes = figure.add_subplot()
    of_series = laws.get("cantilever reach", {})
    _lines(axes, of_series, band=True)
    open_dots: dict[str, Any] = {"markerfacecolor": "white", "markersize": 5.0, "linestyle": ""}
    for series, stall in STALLS.items():
        if series in of_series:
            color, marker = LOOKS[series]
            there = of_series[series].x == stall
            axes.plot(
                of_series[series].x[there], of_series[series].mean[there],
                marker, color=color, **open_dots,
            )  # fmt: skip
    if of_series:
        axes.plot([], [], "o", color="0.35", label="published stall", **open_dots)
    axes.set(xlabel=ROBOTS, ylabel="Reach beyond the edge [R]", xlim=(0, 100))
    axes.set_ylim(bottom=0.0)
    _name_ends(axes, of_series, 0.055)
    _legend(axes, "upper left")
    add_note(figure, note)
    return figure


def draw_bridges(laws: LawPoints, note: str) -> "Figure":
    """Draw the share of bridges that get across, against the gap, with 95 % intervals."""
    figure = new_figure(COLUMN_WIDTH, 2.4)
    axes = figure.add_subplot()
    for place, (series, points) in enumerate(laws.get("bridge success", {}).items()):
        color, marker = LOOKS.get(series, ONLY)
        x = points.x + 0.3 * (place - 0.5)  # so that bars do not hide each other
        low, high = _wilson(points.mean, points.structures)
        axes.errorbar(
            x, 100.0 * points.mean, 100.0 * np.array([points.mean - low, high - points.mean]),
            fmt=f"{marker}-", color=color, markersize=4.0, markeredgewidth=0.0, elinewidth=0.8,
            label=series, clip_on=False,
        )  # fmt: skip
        axes.set_xticks(points.x)
    axes.set(xlabel="Gap [R]", ylabel="Bridges across with\nfewer than 100 robots [%]")
    axes.set_ylim(0.0, 100.0)
    if laws.get("bridge success"):
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    add_note(figure, note)
    return figure


def draw_chains(laws: LawPoints, note: str) -> "Figure":
    """Draw how deep chains hang, against F, and against N for those of all robots."""
    figure = new_figure(COLUMN_WIDTH * 1.6, 2.5)
    over_f, over_n = figure.subplots(1, 2, sharey=True)
    _dots(over_f, laws.get("chain depth over F", {}))
    _stretch(over_f, _power(0.75), (2.5, 5, 10, 25), (1.5, 28.0))
    over_f.set(xlabel="Threshold F [weight of a dock]", ylabel="Depth below the ground [R]")
    _title(over_f, "F$^{3/4}$")
    of_series = laws.get("chain depth over N", {})
    _lines(over_n, of_series)
    over_n.set(xscale="log", xlabel=f"{ROBOTS} (complete chains)", xlim=(24, 105))
    _title(over_n, "ln N")
    _plain_ticks(over_n, (25, 50, 75, 100))
    over_f.set_ylim(0.0, 1.12 * over_f.get_ylim()[1])
    _name_ends(over_n, of_series, 0.06)
    add_note(figure, note)
    return figure


def _dots(axes: "Axes", of_series: dict[str, Points]) -> None:
    """Draw means with their standard deviation, and the published form dashed."""
    for series, points in of_series.items():
        color, marker = LOOKS.get(series, ONLY)
        r2 = f"R² = {points.r2:.3f}"
        axes.errorbar(
            points.x, points.mean, points.std, fmt=marker, color=color, markersize=3.5,
            markeredgewidth=0.0, elinewidth=0.8, label=f"{series}, {r2}" if series else r2,
        )  # fmt: skip
        axes.plot(points.x, points.fitted, "--", color=color, linewidth=0.9)
    _legend(axes, "upper right" if len(of_series) > 1 else "upper left")


def _steps(axes: "Axes", of_series: dict[str, Points]) -> None:
    """Draw means at places of equal distance, whatever their x."""
    for series, points in of_series.items():
        color, marker = LOOKS.get(series, ONLY)
        places = np.arange(len(points.x))
        axes.errorbar(
            places, points.mean, points.std, fmt=f"{marker}-", color=color, markersize=3.5,
            markeredgewidth=0.0, elinewidth=0.8, linewidth=0.6, label=series,
        )  # fmt: skip
        axes.set_xticks(places, [f"{x:g}" for x in points.x])
    axes.margins(x=0.15)
    _legend(axes, "upper right")


def _lines(axes: "Axes", of_series: dict[str, Points], *, band: bool = False) -> None:
    """Draw means over N as lines, and the published form dashed."""
    for series, points in of_series.items():
        color, _ = LOOKS.get(series, ONLY)
        axes.plot(points.x, points.mean, "-", color=color)
        axes.plot(points.x, points.fitted, "--", color="0.2", linewidth=0.7)
        if band:
            low, high = points.mean - points.std, points.mean + points.std
            axes.fill_between(points.x, low, high, color=color, alpha=0.2, linewidth=0.0)


def _name_ends(axes: "Axes", of_series: dict[str, Points], apart: float) -> None:
    """Write the name of each line at its end, at least a share of the axis apart."""
    bottom, top = axes.get_ylim()
    place = -np.inf
    ended = {series: points for series, points in of_series.items() if len(points.x)}
    for series, points in sorted(ended.items(), key=lambda item: float(item[1].mean[-1])):
        place = max(float(points.mean[-1]), place + apart * (top - bottom))
        axes.annotate(
            series, (float(points.x[-1]), place), (3.0, 0.0), textcoords="offset points",
            color=LOOKS.get(series, ONLY)[0], va="center", fontsize=7.0, annotation_clip=False,
        )  # fmt: skip


def _stretch(
    axes: "Axes", scale: Scale, ticks: tuple[float, ...], limits: tuple[float, float]
) -> None:
    """Stretch the x axis so that a form is a straight line on it."""
    axes.set_xlim(limits)
    axes.set_xscale("function", functions=scale)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlim(limits)


def _plain_ticks(axes: "Axes", ticks: tuple[float, ...] = ()) -> None:
    """Write numbers on logarithmic axes as they are."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    if ticks:
        axes.minorticks_off()
        axes.set_xticks(ticks)


def _title(axes: "Axes", form: str) -> None:
    """Say what the dashed lines are."""
    if form:
        axes.set_title(f"dashed: a + b {form}".replace("b 1/", "b / "), fontsize=7.0, color="0.35")


def _legend(axes: "Axes", place: str) -> None:
    """Name the series, if there are any."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc=place, handlelength=1.4, borderaxespad=0.1, labelspacing=0.3)


def _wilson(share: Array, count: Array) -> tuple[Array, Array]:
    """Interval that holds a true share with 95 % confidence (Wilson 1927)."""
    z = 1.96
    middle = (share + z**2 / (2.0 * count)) / (1.0 + z**2 / count)
    half = np.sqrt(share * (1.0 - share) / count + z**2 / (4.0 * count**2))
    half *= z / (1.0 + z**2 / count)
    return np.minimum(middle - half, share), np.maximum(middle + half, share)


LAW_FIGURES: dict[str, Callable[[LawPoints, str], "Figure"]] = {
    "towers": draw_towers,
    "tower-cross-section": draw_cross_section,
    "cantilever-reach": draw_cantilevers,
    "bridge-success": draw_bridges,
    "chain-depth": draw_chains,
}
"""File name and painter of each figure."""
