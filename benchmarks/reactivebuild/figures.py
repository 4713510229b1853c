"""Figures of the laws: our means beside the published forms.

Dots and lines are means over structures; bars and bands are one standard deviation. A dashed line
is the published form, fitted to the means. Axes are scaled to make it straight.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.reactivebuild.curves import Array, Curve
from benchmarks.reactivebuild.laws import STALL_ROBOTS, LawCurves
from tiswarm.report.figure_style import (
    COLUMN_WIDTH,
    PAGE_WIDTH,
    STYLE,
    TRUE_BLUE,
    label_plainly,
    new_figure,
    png,
)

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
"""Color and marker of each threshold: lighter with larger F, also in grey."""

ONLY = (TRUE_BLUE, "o")
"""Color and marker of a law with one series."""

Scale = tuple[Callable[[Array], Array], Callable[[Array], Array]]
"""Scale of an axis, and its inverse."""

INVERSE: Scale = (lambda x: -1.0 / np.maximum(x, 0.1), lambda x: -1.0 / x)


def draw_figures(curves: LawCurves, folder: Path) -> list[Path]:
    """Draw every figure into a folder as PNG; return the files."""
    from matplotlib import style

    some = {
        law: {series: curve for series, curve in of_series.items() if len(curve.points)}
        for law, of_series in curves.items()
    }
    written = [folder / f"{name}.png" for name in FIGURES]
    for path in written:
        with style.context(["default", STYLE]):
            path.write_bytes(png(FIGURES[path.stem](some)))
    return written


def _values(curve: Curve, *columns: str) -> list[Array]:
    """Return columns of the points; the standard deviation of one structure becomes 0."""
    points = curve.points.fillna({"std": 0.0})
    return [points[column].to_numpy(np.float64) for column in columns]


def _power(exponent: float) -> Scale:
    return lambda x: np.maximum(x, 0.0) ** exponent, lambda x: x ** (1.0 / exponent)


def draw_towers(curves: LawCurves) -> "Figure":
    """Draw height and peak stress of towers against F, B, J and N."""
    figure = new_figure(PAGE_WIDTH, 4.2)
    panels = figure.subplots(2, 4, sharey="row", squeeze=False)
    for row, (name, label) in enumerate((("height", "Height [R]"), ("peak", PEAK))):
        over_f, over_b, over_j, over_n = panels[row]
        _dots(over_f, curves.get(f"tower {name} over F", {}))
        _dots(over_b, curves.get(f"tower {name} over B", {}))
        _steps(over_j, curves.get(f"tower {name} over J", {}))
        _lines(over_n, curves.get(f"tower {name} over N", {}))
        root = row == 0
        _stretch(over_f, _power(0.5 if root else 1.0), (1, 5, 10, 25), (0.5 if root else -0.5, 28))
        _stretch(over_b, INVERSE, (1.5, 3, 6, 10), (1.35, 13.0))
        _stretch(over_n, _power(0.5 if root else 1.0), (25, 50, 75, 100), (23.0, 103.0))
        over_f.set_ylabel(label)
        over_f.set_ylim(0.0, 1.12 * over_f.get_ylim()[1])  # room for what is written above
        _name_ends(over_n, curves.get(f"tower {name} over N", {}), 0.085)
        forms = ("√F", "1/B", "", "√N") if root else ("F", "1/B", "", "N")
        for axes, form, x in zip(panels[row], forms, TOWER_AXES, strict=True):
            axes.set_xlabel(x)
            _title(axes, form)
    return figure


def draw_cross_section(curves: LawCurves) -> "Figure":
    """Draw the cross-section of towers against the distance from their top."""
    figure = new_figure(COLUMN_WIDTH, 2.6)
    axes = figure.add_subplot()
    for series, curve in curves.get("tower cross-section", {}).items():
        color, marker = LOOKS.get(series, ONLY)
        # A logarithmic axis has no place for the top itself.
        x, mean, fitted = (values[1:] for values in _values(curve, "x", "mean", "fitted"))
        axes.plot(x, mean, marker, color=color, markersize=3.0, markeredgewidth=0.0, label=series)
        axes.plot(x, fitted, "--", color=color, linewidth=0.9, label=f"k d², R² = {curve.r2:.3f}")
    axes.set(
        xscale="log", yscale="log", xlabel="Distance d from the top [R]",
        ylabel="Spheres within 1 R of a height", ylim=(0.7, None),
    )  # fmt: skip
    _plain_ticks(axes)
    _legend(axes, "upper left")
    return figure


def draw_cantilevers(curves: LawCurves) -> "Figure":
    """Draw the reach of cantilevers against N, and mark the published stalls."""
    figure = new_figure(COLUMN_WIDTH, 2.5)
    axes = figure.add_subplot()
    of_series = curves.get("cantilever reach", {})
    _lines(axes, of_series, band=True)
    open_dots: dict[str, Any] = {"markerfacecolor": "white", "markersize": 5.0, "linestyle": ""}
    for threshold, stall in STALL_ROBOTS.items():
        series = f"F = {threshold:g}"
        if series in of_series:
            color, marker = LOOKS[series]
            axes.plot(stall, of_series[series].at(stall), marker, color=color, **open_dots)
    if of_series:
        axes.plot([], [], "o", color="0.35", label="published stall", **open_dots)
    axes.set(xlabel=ROBOTS, ylabel="Reach beyond the edge [R]", xlim=(0, 100))
    axes.set_ylim(bottom=0.0)
    _name_ends(axes, of_series, 0.055)
    _legend(axes, "upper left")
    return figure


def draw_bridges(curves: LawCurves) -> "Figure":
    """Draw the share of bridges that cross a gap, with 95 % intervals."""
    figure = new_figure(COLUMN_WIDTH, 2.4)
    axes = figure.add_subplot()
    for place, (series, curve) in enumerate(curves.get("bridge success", {}).items()):
        color, marker = LOOKS.get(series, ONLY)
        gap, share, count = _values(curve, "x", "mean", "structures")
        x = gap + 0.3 * (place - 0.5)  # bars side by side do not hide each other
        low, high = _wilson(share, count)
        axes.errorbar(
            x, 100.0 * share, 100.0 * np.array([share - low, high - share]),
            fmt=f"{marker}-", color=color, markersize=4.0, markeredgewidth=0.0, elinewidth=0.8,
            label=series, clip_on=False,
        )  # fmt: skip
        axes.set_xticks(gap)
    axes.set(xlabel="Gap [R]", ylabel="Bridges across with\nfewer than 100 robots [%]")
    axes.set_ylim(0.0, 100.0)
    if curves.get("bridge success"):
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


def draw_chains(curves: LawCurves) -> "Figure":
    """Draw the depth of chains against F, and against N for complete chains."""
    figure = new_figure(COLUMN_WIDTH * 1.6, 2.5)
    over_f, over_n = figure.subplots(1, 2, sharey=True)
    _dots(over_f, curves.get("chain depth over F", {}))
    _stretch(over_f, _power(0.75), (2.5, 5, 10, 25), (1.5, 28.0))
    over_f.set(xlabel="Threshold F [weight of a dock]", ylabel="Depth below the ground [R]")
    _title(over_f, "F^0.75")
    of_series = curves.get("chain depth over N", {})
    _lines(over_n, of_series)
    over_n.set(xscale="log", xlabel=f"{ROBOTS} (complete chains)", xlim=(24, 105))
    _title(over_n, "ln N")
    _plain_ticks(over_n, (25, 50, 75, 100))
    over_f.set_ylim(0.0, 1.12 * over_f.get_ylim()[1])
    _name_ends(over_n, of_series, 0.06)
    return figure


def _dots(axes: "Axes", of_series: dict[str, Curve]) -> None:
    """Draw means with their standard deviation, and the published form dashed."""
    for series, curve in of_series.items():
        color, marker = LOOKS.get(series, ONLY)
        x, mean, std, fitted = _values(curve, "x", "mean", "std", "fitted")
        r2 = f"R² = {curve.r2:.3f}"
        axes.errorbar(
            x, mean, std, fmt=marker, color=color, markersize=3.5,
            markeredgewidth=0.0, elinewidth=0.8, label=f"{series}, {r2}" if series else r2,
        )  # fmt: skip
        axes.plot(x, fitted, "--", color=color, linewidth=0.9)
    _legend(axes, "upper right" if len(of_series) > 1 else "upper left")


def _steps(axes: "Axes", of_series: dict[str, Curve]) -> None:
    """Draw means at equal distances along the axis."""
    for series, curve in of_series.items():
        color, marker = LOOKS.get(series, ONLY)
        x, mean, std = _values(curve, "x", "mean", "std")
        places = np.arange(len(x))
        axes.errorbar(
            places, mean, std, fmt=f"{marker}-", color=color, markersize=3.5,
            markeredgewidth=0.0, elinewidth=0.8, linewidth=0.6, label=series,
        )  # fmt: skip
        axes.set_xticks(places, [f"{value:g}" for value in x])
    axes.margins(x=0.15)
    _legend(axes, "upper right")


def _lines(axes: "Axes", of_series: dict[str, Curve], *, band: bool = False) -> None:
    """Draw means over N as lines, and the published form dashed."""
    for series, curve in of_series.items():
        color, _ = LOOKS.get(series, ONLY)
        x, mean, std, fitted = _values(curve, "x", "mean", "std", "fitted")
        axes.plot(x, mean, "-", color=color)
        axes.plot(x, fitted, "--", color="0.2", linewidth=0.7)
        if band:
            axes.fill_between(x, mean - std, mean + std, color=color, alpha=0.2, linewidth=0.0)


def _name_ends(axes: "Axes", of_series: dict[str, Curve], apart: float) -> None:
    """Write the name of each line at its end, names at least a share of the axis apart."""
    bottom, top = axes.get_ylim()
    place = -np.inf
    ends = {series: curve.points.iloc[-1] for series, curve in of_series.items()}
    for series, end in sorted(ends.items(), key=lambda item: float(item[1]["mean"])):
        place = max(float(end["mean"]), place + apart * (top - bottom))
        axes.annotate(
            series, (float(end["x"]), place), (3.0, 0.0), textcoords="offset points",
            color=LOOKS.get(series, ONLY)[0], va="center", fontsize=7.0, annotation_clip=False,
        )  # fmt: skip


def _stretch(
    axes: "Axes", scale: Scale, ticks: tuple[float, ...], limits: tuple[float, float]
) -> None:
    """Scale the x axis to make a form a straight line."""
    axes.set_xlim(limits)
    axes.set_xscale("function", functions=scale)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlim(limits)


def _plain_ticks(axes: "Axes", ticks: tuple[float, ...] = ()) -> None:
    """Write plain numbers on logarithmic axes, not powers of ten."""
    for axis in (axes.xaxis, axes.yaxis):
        label_plainly(axis)
    if ticks:
        axes.minorticks_off()
        axes.set_xticks(ticks)


def _title(axes: "Axes", form: str) -> None:
    """Name the form of the dashed lines."""
    if form:
        axes.set_title(f"dashed: a + b {form}".replace("b 1/", "b / "), fontsize=7.0, color="0.35")


def _legend(axes: "Axes", place: str) -> None:
    """Name the series, if any."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc=place, handlelength=1.4, borderaxespad=0.1, labelspacing=0.3)


def _wilson(share: Array, count: Array) -> tuple[Array, Array]:
    """Return the 95 % confidence interval of a share (Wilson 1927)."""
    z = 1.96
    middle = (share + z**2 / (2.0 * count)) / (1.0 + z**2 / count)
    half = np.sqrt(share * (1.0 - share) / count + z**2 / (4.0 * count**2))
    half *= z / (1.0 + z**2 / count)
    return np.minimum(middle - half, share), np.maximum(middle + half, share)


FIGURES: dict[str, Callable[[LawCurves], "Figure"]] = {
    "towers": draw_towers,
    "tower-cross-section": draw_cross_section,
    "cantilever-reach": draw_cantilevers,
    "bridge-success": draw_bridges,
    "chain-depth": draw_chains,
}
"""File name and painter of each figure."""

CAPTIONS = {
    "towers": "Height and peak stress of towers against threshold F, growth B and largest call J, "
    "and against the number of robots N. Bars are one standard deviation.",
    "tower-cross-section": "Spheres of a tower that a horizontal layer cuts, against the distance "
    "from its top.",
    "cantilever-reach": "Reach of cantilevers beyond the edge, against the number of robots. "
    "Hollow markers are the published ends of growth.",
    "bridge-success": "Share of bridges that cross a gap, with 95 % CI (Wilson).",
    "chain-depth": "Depth of chains below the ground, against threshold F and, of complete chains, "
    "against the number of robots. Bars are one standard deviation.",
}
"""What each figure shows."""
