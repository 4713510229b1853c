"""Draws the figures of rounds, grades, profiles and scaling, and of what robots build.

Most have a curve for each condition or point; those of navigation have rows.
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from os.path import commonprefix
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.records.measures import (
    BELIEF_SENT,
    BUILT_FOR,
    CROSSED,
    FLIPS_AS_PLANNED,
    HEIGHT,
    MAIN,
    REACH,
    RMSE,
    STEPS,
)
from tiswarm.records.messages import counted, three_digits
from tiswarm.records.run_folder import LABEL
from tiswarm.report import figure_style
from tiswarm.report.run_data import (
    RunData,
    joined_words,
    stated_conditions,
    stated_scenario,
    with_points,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FEWEST_ROBOTS = 5  # robots below which a point of a profile is open
_MOST_POINTS = 4  # most points of a sweep that have a figure or panel each
_SMALL = "hops_from_anchor"  # what small panels show
_SMALL_COLUMNS = 4  # panels in a row, of many series
_MOST_SMALL = 32  # panels in all, of many series

_SERIES = ["point", "condition"]

PROFILED = {
    "join": "Join index",
    "height_R": "True height [R]",
    "hops_from_anchor": "Hops from the anchor",
    "contacts": "Contacts of the robot",
    "hops_apart": "Hops between two robots",
}
_GROWN = {
    HEIGHT.column: HEIGHT.axis,
    "makespan_flips": "Time to build [flips]",
    "sensed_max": "Largest load [dock weights]",
}
_RATES = {
    "robot_steps_per_cpu_s": "Robot steps per CPU s",
    "peak_memory_MB": "Process, peak memory [MB]",
}
SCALING_PANELS = {
    **{measure.column: measure.axis for measure in MAIN},
    **_GROWN,
    "grow_cpu_s": "Growth, CPU time [s]",
    "localize_cpu_s": "Localization, CPU time [s]",
    **_RATES,
}
"""Panels of `figures/scaling.png` by measure, against the number of robots."""

_TIMES = {
    "grow_wall_s": "Growth, wall time [s]",
    "localize_wall_s": "Localization, wall time [s]",
    "total_wall_s": "All stages, wall time [s]",
    "structures_per_wall_s": "Structures per s",
    "total_cpu_s": "All stages, CPU time [s]",
    "peak_memory_MB": _RATES["peak_memory_MB"],
}
_AXES: Mapping[str, tuple[str, str, Mapping[str, str]]] = {
    "robots": ("Robots N", "N", SCALING_PANELS),
    "threads": ("CPU threads", "T", _TIMES),
    "workers": ("Processes", "P", _TIMES),
    "movers": (
        "Robots that climb at once",
        "M",
        {
            **_GROWN,
            "growth_rounds": "Time to build [rounds]",
            "flips": "All flips",
            "grow_cpu_s": SCALING_PANELS["grow_cpu_s"],
        },
    ),
}
"""By column of `scaling.csv`, its label, its symbol and the panels against it."""


CAPTIONS = {
    "back-propagation": figure_style.Caption(
        "RMSE against the steps that a robot takes, in the mean over all robots: a "
        "dot for each interval between two rounds, stated in joins, and a line for "
        "rounds that move equally many robots. Horizontal lines are conditions "
        "without rounds.",
        intervals="Bars and bands are 95 % CI.",
    ),
    "building": figure_style.Caption(
        "What robots build that navigate by the truth, or by what each condition "
        "estimates as they join. A flip is as planned if the robot then touches the "
        "one that it meant to reach. Bytes are those that robots send for their "
        "estimates, if they do.",
        intervals="Bars are 95 % CI.",
    ),
    "grades": figure_style.Caption(
        "RMSE by grade: conditions that differ in one number share a panel, and each "
        "point of the sweep has a line. The dashed line is the first condition "
        "without a grade.",
        intervals="Bars are 95 % CI.",
    ),
    "profiles": figure_style.Caption(
        "RMSE of robots that are alike: by join index (order of joining), true "
        "height, hops (contacts on the shortest way to an anchor) and number of "
        "contacts. Bands of the best and the worst series cover the errors of 80 % of "
        "these robots. Numbers above count the robots of a point; hollow dots stand "
        "for few. Relative RMSE is the error of the vector between two robots. Of "
        "many series, each has a small panel with RMSE by hops alone.",
    ),
    "scaling": figure_style.Caption(
        "Accuracy, size, time to build and cost against the number of robots N (or of "
        "threads, processes or climbing robots), on logarithmic axes, unless they "
        "begin at 0. Numbers above state the power of N that fits all sizes, and the "
        "last two. Bands of the best and the worst series cover all structures. A "
        "round of growth takes as long as its longest walk.",
    ),
}
"""What the figures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figures that a run has, by file name."""
    sizes: dict[str, figure_style.Painter] = {"scaling": draw_scaling} if run.sweeps_robots else {}
    rounds: dict[str, figure_style.Painter] = (
        {"back-propagation": draw_rounds} if compares_rounds(run) else {}
    )
    return {
        **sizes,
        **rounds,
        **_grade_painters(run),
        **_profile_painters(run),
        **_building_painters(run),
    }


def compares_rounds(run: RunData) -> bool:
    """Whether conditions of a run have rounds of back-propagation at several intervals."""
    table = run.table("table.csv", ["condition"], [], after="cases", optional=True)
    if "round_every" not in table:
        return False
    return len(set(table.groupby("condition")["round_every"].first().dropna())) > 1


def draw_rounds(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw RMSE against steps per robot, for rounds of back-propagation at several intervals.

    A line joins rounds that move equally many robots by equally many steps. A condition without
    rounds is a horizontal line. Each point of a sweep has a panel.
    """
    numbers = ["cases", RMSE.mean, RMSE.ci95, STEPS.mean]
    numbers += ["round_every", "round_recent", "round_sweeps"]
    table = run.table("table.csv", ["condition"], numbers, after="cases")
    points = [*with_points(table).groupby("point", sort=False)]
    shown = points[:_MOST_POINTS]
    one_length = len(set(table["round_sweeps"].dropna())) == 1
    height = 0.6 + 3.2 * -(-len(shown) // 2)
    panels = figure_style.Panels(height, len(shown), 2, share="x", max_width=max_width)
    for axes, (point, point_rows) in panels.paired_with(shown):
        has_rounds = point_rows["round_every"].notna()
        levels = point_rows.loc[~has_rounds, ["condition", RMSE.mean, RMSE.ci95]]
        for index, level in enumerate(levels.itertuples(index=False)):
            _draw_level(axes, *level, at_right=index % 2 == 0)
        rounds = point_rows[has_rounds].fillna({"round_recent": np.inf})
        families = rounds.groupby(["round_sweeps", "round_recent"], sort=False)
        for index, ((sweeps, recent), family) in enumerate(families):
            name = f"last {recent:g}" if np.isfinite(recent) else "all"
            name += "" if one_length else f", {sweeps:g} steps"
            _draw_family(axes, family, {"label": name, **figure_style.marker_style(index)})
        figure_style.set_title(axes, point)
        axes.set_xlabel(STEPS.axis)
        axes.set_ylim(bottom=0.0)
    steps = table.loc[table["round_every"].notna(), STEPS.mean]
    panels.label_left(RMSE.axis)
    figure_style.set_log(panels.first, "x", 2.0 * steps.max() / steps.min())
    panels.first.set_xlim(0.7 * steps.min(), 1.4 * steps.max())
    words = f"robots moved in a round; {figure_style.mean_words(table['cases'])}"
    panels.legend(words, structures=int(table["cases"].max()))
    more = figure_style.omission_note(len(points) - len(shown), "sweep point", "in table.csv")
    return panels.finish("numbers: joins between two rounds", more, run.note)


def _draw_family(axes: "Axes", family: pd.DataFrame, look: Mapping[str, Any]) -> None:
    """Draw a line through rounds at several intervals, with the joins between two."""
    line = family.sort_values(STEPS.mean)
    steps = line[STEPS.mean]
    rmse = line[RMSE.mean]
    for x, y, joins in zip(steps, rmse, line["round_every"], strict=True):
        axes.annotate(
            f"{joins:g}",
            (x, y),
            (2.0, 2.0),
            textcoords="offset points",
            fontsize=5.5,
            color=look["color"],
        )
    axes.errorbar(
        steps,
        rmse,
        yerr=line[RMSE.ci95].fillna(0.0),
        markersize=3.0,
        linewidth=1.0,
        elinewidth=0.4,
        **look,
    )


def _draw_level(axes: "Axes", name: str, mean: float, half: float, *, at_right: bool) -> None:
    """Draw a mean and its confidence interval across a panel, with its name at one end."""
    axes.axhline(mean, color="0.35", linewidth=0.8, linestyle="--")
    if half > 0.0:  # not NaN
        axes.axhspan(mean - half, mean + half, color="0.35", alpha=0.15, linewidth=0.0)
    axes.annotate(
        f"{name}, {three_digits(mean)} R",
        (float(at_right), mean),
        (0.0, 1.5),
        fontsize=6.0,
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        color="0.35",
        ha="right" if at_right else "left",
        bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 0.5},
    )


def _profile_painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the profile figures of a run by file name: one for each of a few sweep points.

    All series share a figure if there are many points, or no sweep.
    """
    numbers = ["low", "high", RMSE.column, "p10_R", "p90_R"]
    table = run.table("profiles.csv", ["condition", "by"], numbers, after="by", optional=True)
    if table.empty:  # no case was finished
        return {}
    table = with_points(table, before="by")
    points = dict(list(table.groupby("point", sort=False)))
    if not 1 < len(points) <= _MOST_POINTS:
        return {"profiles": partial(_draw_profiles, table=table)}
    painters: dict[str, figure_style.Painter] = {}
    for point, point_rows in points.items():
        slug = re.sub(r"[^A-Za-z0-9.]+", "-", str(point)).strip("-")
        painters[f"profiles-{slug}"] = partial(_draw_profiles, table=point_rows.assign(point=""))
    return painters


def _draw_profiles(run: RunData, max_width: float = np.inf, *, table: pd.DataFrame) -> "Figure":
    """Draw RMSE against join, height, hops and contacts, and relative RMSE against hops.

    Bands of the best and the worst series cover the errors of most robots of a range, 10 % to 90 %.
    Small numbers count the robots, or pairs, of each point in the first series. Points of few are
    open, and not connected.
    """
    many = table["count"] >= _FEWEST_ROBOTS
    table = table.assign(at=(table["low"] + table["high"]) / 2.0, many=many | (not many.any()))
    if len(table[_SERIES].drop_duplicates()) > len(figure_style.PALETTE):
        return _draw_small_profiles(run, table, max_width)
    panels = figure_style.Panels(3.6, len(PROFILED), 3, max_width=max_width)
    means = table.groupby(_SERIES)[RMSE.column].mean()
    bands: set[Any] = {means.idxmin(), means.idxmax()}
    for axes, (name, label) in panels.paired_with(PROFILED.items()):
        variable_rows = table[table["by"] == name]
        for index, (series, rows) in enumerate(variable_rows.groupby(_SERIES, sort=False)):
            look = figure_style.line_style(index)
            _draw_series(axes, rows, ", ".join(filter(None, map(str, series))), look)
            if series in bands:
                _draw_band(axes, rows[rows["many"]], look["color"])
            if index == 0:
                _count(axes, rows["at"], rows["count"])
        axes.set(xlabel=label, ylabel=RMSE.axis)
        rmse = variable_rows[RMSE.column].to_numpy(float)
        figure_style.fit_axis(axes, "y", rmse[variable_rows["many"]], others=rmse)
    figure_style.set_log(axes, "x")
    axes.set_ylabel("Relative RMSE [R]")
    ticks = sorted(set(variable_rows["low"]))
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    unused = panels.figure.axes[-1]
    if unused in panels.axes:
        panels.legend(entries=figure_style.entries_of(axes))
    else:
        unused.legend(*axes.get_legend_handles_labels(), loc="center left")
    opened = "" if table["many"].all() else f"open: fewer than {_FEWEST_ROBOTS}"
    return panels.finish("above: robots or pairs of a point", opened, run.note)


def _draw_series(axes: "Axes", rows: pd.DataFrame, label: str, look: Mapping[str, Any]) -> None:
    """Draw the RMSE of a series: a line through points of many robots, and open points of few."""
    many = rows[rows["many"]]
    few = rows[~rows["many"]]
    axes.plot(many["at"], many[RMSE.column], marker="o", markersize=2.5, label=label, **look)
    opened = {**look, "linestyle": "", "markerfacecolor": "white", "markeredgewidth": 0.6}
    axes.plot(few["at"], few[RMSE.column], marker="o", markersize=2.5, **opened)


def _draw_band(axes: "Axes", rows: pd.DataFrame, color: str) -> None:
    """Draw the 10 % and 90 % quantiles of the errors of a series, if these are known."""
    if rows["p90_R"].notna().any():
        low = rows["p10_R"].to_numpy(float)
        high = rows["p90_R"].to_numpy(float)
        axes.fill_between(rows["at"], low, high, color=color, alpha=0.15, linewidth=0.0)


def _draw_small_profiles(run: RunData, table: pd.DataFrame, max_width: float) -> "Figure":
    """Draw RMSE against hops for more series than colors: a panel for each.

    Series of a sweep point share its panel, if there are few. In gray behind each panel are the
    series of the first, to compare with.
    """
    hop_rows = table[table["by"] == _SMALL]
    if len({*hop_rows["point"]}) == 1 or hop_rows["condition"].nunique() > len(
        figure_style.PALETTE
    ):
        names = joined_words(hop_rows, _SERIES)
        hop_rows = hop_rows.assign(point=names, condition="RMSE")
    hop_rows = hop_rows[hop_rows["many"] | ~hop_rows.groupby("point")["many"].transform("any")]
    panels_of = dict(list(hop_rows.groupby("point", sort=False)))
    shown = dict(list(panels_of.items())[:_MOST_SMALL])
    height = 0.6 + 1.15 * -(-len(shown) // _SMALL_COLUMNS)
    panels = figure_style.Panels(
        height, len(shown), _SMALL_COLUMNS, share="xy", max_width=max_width
    )
    first = next(iter(shown.values()))
    for axes, (point, rows) in panels.paired_with(shown.items()):
        for _, line in first.groupby("condition", sort=False):
            axes.plot(line["at"], line[RMSE.column], color="0.8", linewidth=1.0)
        for index, (condition, line) in enumerate(rows.groupby("condition", sort=False)):
            look: dict[str, Any] = {"color": figure_style.PALETTE[index], "markersize": 2.0}
            axes.plot(line["at"], line[RMSE.column], "o-", linewidth=1.0, label=condition, **look)
        figure_style.set_title(axes, str(point), 6.5)
    figure_style.fit_axis(panels.first, "y", hop_rows[RMSE.column].to_numpy(float))
    panels.label_once(PROFILED[_SMALL], RMSE.axis)
    if len(figure_style.entries_of(panels.first)) > 1:
        panels.legend()
    more = figure_style.omission_note(len(panels_of) - len(shown), "sweep point", "in profiles.csv")
    return panels.finish("gray: first panel", more, run.note)


def _count(axes: "Axes", positions: "pd.Series[float]", counts: "pd.Series[float]") -> None:
    """Write the number of robots or pairs of each point above a panel."""
    for x, count in zip(positions, counts, strict=True):
        text = f"{count:g}" if count < 1e4 else f"{count / 1e3:.0f}k"  # noqa: PLR2004 - k
        axes.annotate(
            text,
            (x, 1.0),
            (0.0, 2.0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=4.5,
            color="0.35",
            ha="center",
        )


_MOST_POWERS = 4  # that a panel states


def draw_scaling(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw means over structures against the number of robots N on logarithmic axes.

    Panels state the power of N fitted to all sizes, and to the two largest, if there are few. Bands
    of the best and the worst series cover all structures. Where all series are equal, one gray line
    stands for all. Threads, workers or movers take the place of N in a study of these.
    """
    table = run.table("scaling.csv", ["series", "measure"], ["mean"], after="measure")
    column = str(table.columns[2])
    label, symbol, panels_of = _AXES[column]
    numbers = sorted(set(table[column]))
    ticks = [f"{n:g}" if n < 1000 else f"{n / 1000:g}k" for n in numbers]  # noqa: PLR2004 - k
    series = list(dict.fromkeys(table["series"]))
    names = series[: figure_style.MOST_SERIES]
    table = table[table["series"].isin(names) & (table["mean"] > 0.0)]
    shown = _built_for(
        run, {m: text for m, text in panels_of.items() if m in set(table["measure"])}
    )
    panels = figure_style.Panels(2.2 * -(-len(shown) // 3), len(shown), 3, max_width=max_width)
    legend: dict[str, Any] = {}
    for axes, (measure, text) in panels.paired_with(shown.items()):
        rows = table[table["measure"] == measure]
        _draw_powers(axes, rows, names, legend, (column, symbol))
        figure_style.set_log(axes, "x")
        axes.set(xlabel=label, ylabel=text)
        axes.set_xticks(numbers, ticks)
        axes.minorticks_off()
        if measure.endswith("_MB"):
            axes.set_ylim(0.0, 1.1 * rows["mean"].max())
        else:
            span = float(rows["mean"].max() / rows["mean"].min()) if len(rows) else 1.0
            figure_style.set_log(axes, "y", 2.0 * span)
    entries = {name: legend[name] for name in (*names, "all series") if name in legend}
    panels.legend(entries=entries, loc="outside upper right")
    powers = f"powers of {symbol} are fitted to all points, then to the two largest"
    if len(names) > _MOST_POWERS:
        powers += f"; where more than {_MOST_POWERS}, in scaling.csv"
    if not table["exponent"].notna().any():
        powers = ""
    more = figure_style.omission_note(len(series) - len(names), "sweep point", "in scaling.csv")
    return panels.finish(powers, more, run.note)


def _built_for(run: RunData, panels: Mapping[str, str]) -> dict[str, str]:
    """Show the reach of cantilevers and the depth of chains in place of the height of towers."""
    structure = stated_scenario(run.folder).get("structure") or {}
    aim = BUILT_FOR.get(str(structure.get("kind")), HEIGHT)
    aims = {HEIGHT.column: (aim.column, aim.axis)}
    return dict(aims.get(measure, (measure, text)) for measure, text in panels.items())


def _draw_powers(
    axes: "Axes",
    rows: pd.DataFrame,
    names: list[str],
    legend: dict[str, Any],
    against: tuple[str, str],
) -> None:
    """Draw the series of a measure with their powers, and add their lines to a legend."""
    column, symbol = against
    rows_by_series = {name: rows[rows["series"] == name] for name in names}
    means = {tuple(series_rows["mean"]) for series_rows in rows_by_series.values()}
    one_for_all = len(means) == 1 < len(rows_by_series)
    drawn = {"all series": rows_by_series[names[0]]} if one_for_all else rows_by_series
    ranked = sorted(
        (n for n, p in drawn.items() if len(p)), key=lambda n: drawn[n]["mean"].iloc[-1]
    )
    powers: dict[str, Any] = {}
    for index, (name, series_rows) in enumerate(drawn.items()):
        if series_rows.empty:  # a method that states no steps, for example
            continue
        look = {
            **figure_style.marker_style(index),
            "linewidth": figure_style.line_style(index)["linewidth"],
        }
        if one_for_all:
            look["color"] = "0.4"
        (legend[name],) = axes.plot(
            series_rows[column], series_rows["mean"], markersize=3.0, **look
        )
        if name in {*ranked[:1], *ranked[-1:]} and "least" in series_rows:
            axes.fill_between(
                series_rows[column],
                series_rows["least"],
                series_rows["most"],
                color=look["color"],
                alpha=0.15,
                lw=0.0,
            )
        powers[_powers(series_rows, symbol)] = look[
            "color"
        ]  # equal series are drawn over each other
    powers.pop("", None)
    for index, (text, color) in enumerate(powers.items() if len(powers) <= _MOST_POWERS else ()):
        axes.annotate(
            text,
            (0.0, 1.0),
            (3.0, 3.0 + 8.0 * index),
            color=color,
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize=6.0,
        )


def _powers(series_rows: "pd.DataFrame", symbol: str) -> str:
    """Write the powers of a number that fit a series."""
    if series_rows.empty or pd.isna(series_rows["exponent"].iloc[0]):
        return ""
    exponent = series_rows["exponent"].iloc[0]
    last_slope = series_rows["slope"].iloc[-1]
    return f"{symbol}^{exponent:.2f}, last {symbol}^{last_slope:.2f}"


_FEWEST_GRADES = 3
_UNITS = {
    "_deg": "deg",
    "_noise": "R",
    "loss": "share of messages",
    **dict.fromkeys(["mute", "deaf", "drift", "stuck"], "share of robots"),
}
"""Units by the ends of keys."""


def _grade_painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figure of graded conditions by file name, if a run has some.

    Rounds of back-propagation have a figure of their own.
    """
    if run.has_structures_alone or not (run.folder / "table.csv").is_file():
        return {}
    table = run.table("table.csv", ["condition"], [], after="cases")
    has_rounds = table.get("round_every", pd.Series(dtype=float)).notna().any()
    return {} if has_rounds or not _families(run, table) else {"grades": draw_grades}


def draw_grades(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw RMSE against the number in which conditions differ that else agree.

    They share a panel, in which each point of the sweep has a line. A dashed line in its color is
    the first condition that belongs to no panel.
    """
    table = run.table("table.csv", ["condition"], ["cases", RMSE.mean, RMSE.ci95], after="cases")
    table = table[table[RMSE.mean].notna()]
    families = _families(run, table)
    table = with_points(table)
    points = list(dict.fromkeys(table["point"]))
    shown = points[: figure_style.MOST_SERIES]
    graded = {name for family in families for name in family.names.values()}
    plain = next((name for name in table["condition"] if name not in graded), "")
    columns = figure_style.columns_of(len(families))
    height = 0.6 + 2.1 * -(-len(families) // columns)
    panels = figure_style.Panels(height, len(families), columns, share="y", max_width=max_width)
    for axes, family in panels.paired_with(families):
        low = min(family.names)
        high = max(family.names)
        if low > 0.0:
            figure_style.set_log(axes, "x")
            margin = (high / low) ** 0.05
            axes.set_xlim(low / margin, high * margin)  # dashed lines would widen it to 1
        for index, point in enumerate(shown):
            rows = table[table["point"] == point].set_index("condition")
            look = {
                "label": point or "mean",
                **figure_style.marker_style(index),
            }
            _draw_line(axes, rows, family.names, look)
            if plain in rows.index:
                axes.axhline(float(rows.loc[plain, RMSE.mean]), **_dashed(look))
        figure_style.set_title(axes, family.title)
        axes.set_xlabel(_meaning(family.keys))
        axes.set_xticks([*family.names], [f"{grade:g}" for grade in family.names])
        axes.minorticks_off()
    means = table.loc[table["condition"].isin(graded | {plain}), RMSE.mean].to_numpy(float)
    figure_style.fit_axis(panels.first, "y", means, nonpositive="clip")
    panels.label_once(y=RMSE.axis)
    level = f"; dashed: {plain}" if plain else ""
    number = counted(int(table["cases"].max()), "structure")
    panels.legend(f"{figure_style.mean_words(table['cases'])}, {number}{level}")
    return panels.finish(
        figure_style.omission_note(len(points) - len(shown), "sweep point", "in table.csv"),
        run.note,
    )


class _Family(NamedTuple):
    """Conditions that differ in one number."""

    title: str
    keys: Sequence[str]  # settings that have the number
    names: Mapping[float, str]  # of the conditions, by the number, ascending


def _families(run: RunData, table: pd.DataFrame) -> list[_Family]:
    """Gather conditions that set the same keys, and among these one number that differs."""
    stated = {
        run.labels.conditions.get(name, name): entries
        for name, entries in stated_conditions(run.folder).items()
    }
    conditions_by_keys: dict[tuple[str, ...], dict[str, dict[str, Any]]] = {}
    for name in dict.fromkeys(table["condition"]):
        entries = stated.get(name)
        if entries:
            conditions_by_keys.setdefault(tuple(sorted({*entries} - {LABEL})), {})[name] = entries
    families = []
    for keys, members in conditions_by_keys.items():
        varied = [
            key for key in keys if len({repr(entries[key]) for entries in members.values()}) > 1
        ]
        grades: dict[float, str] = {}
        for name, entries in members.items():
            values = [entries[key] for key in varied]
            if {*map(type, values)} <= {int, float} and len({*values}) == 1:
                grades[values[0]] = name
        if len(grades) == len(members) >= _FEWEST_GRADES:
            title = commonprefix([*members]).rstrip("-_ (.0123456789")  # noqa: RUF071 - no paths
            families.append(_Family(title, varied, dict(sorted(grades.items()))))
    return families


def _meaning(keys: Sequence[str]) -> str:
    """Name settings, with the unit that their names state."""
    words = " = ".join(key.split(".")[-1].removesuffix("_deg").replace("_", " ") for key in keys)
    units = [unit for end, unit in _UNITS.items() if any(key.endswith(end) for key in keys)]
    return f"{words} [{units[0]}]" if units else words


def _draw_line(
    axes: "Axes", rows: pd.DataFrame, grades: Mapping[float, str], look: dict[str, Any]
) -> None:
    """Draw the means of graded conditions with their intervals."""
    graded = rows.reindex([*grades.values()])
    half = graded[RMSE.ci95].fillna(0.0)
    axes.errorbar([*grades], graded[RMSE.mean], yerr=half, markersize=3.0, elinewidth=0.6, **look)


def _dashed(look: dict[str, Any]) -> dict[str, Any]:
    return {"color": look["color"], "linestyle": "--", "linewidth": 0.8}


_BY = "structure.navigate_by"
_PANELS = {
    HEIGHT: ("tower", "Tower height [R]"),
    REACH: ("cantilever", "Cantilever reach [R]"),
    CROSSED: ("bridge", "Bridges closed [1]"),
    FLIPS_AS_PLANNED: ("", "Flips as planned [1]"),
    BELIEF_SENT: ("", "Sent by a robot [kB]"),
}
"""By measure: the kind of structure that a panel shows, all if empty; its axis."""


def _building_painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figure by file name, if some robots of a run navigate by estimates."""
    planned = run.summary.get(FLIPS_AS_PLANNED.column)
    return {"building": draw_building} if planned is not None and planned.notna().any() else {}


def draw_building(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw what robots build, and what they send for it, with a row for what they navigate by.

    A marker is the mean of a kind of structure with its 95 % confidence interval.
    """
    done = run.summary[run.summary["status"] == "done"]
    rows = done.assign(structure=_structures(done), by=_navigation(done))
    rows[BELIEF_SENT.column] = rows.get(BELIEF_SENT.column, np.nan) / 1e3
    rows = rows.drop_duplicates(["by", "structure", "seed"])  # conditions may share structures
    names = list(dict.fromkeys(rows["by"]))
    kinds = list(dict.fromkeys(rows["structure"]))
    shown = {
        measure.column: panel
        for measure, panel in _PANELS.items()
        if _of_kind(rows, panel[0])[measure.column].any()
    }
    columns = min(len(shown), 3)
    height = (0.9 + len(names) * (0.16 + 0.07 * len(kinds))) * -(-len(shown) // columns)
    panels = figure_style.Panels(height, len(shown), columns, share="y", max_width=max_width)
    for axes, (column, (kind, label)) in panels.paired_with(shown.items()):
        _draw_panel(axes, _of_kind(rows, kind), column, names, kinds)
        axes.set_xlabel(label)
        top = axes.get_xlim()[1]
        axes.set_xlim(-0.03 * top, 1.03 * top)  # markers at the ends are whole
    figure_style.label_rows(panels.first, names)
    panels.first.invert_yaxis()
    structures = int(rows.groupby(["by", "structure"]).size().max())
    entries = panels.entries()
    words = figure_style.mean_words(rows.groupby(["by", "structure"]).size())
    panels.legend(words, entries, structures=structures, loc="outside upper right")
    return panels.finish(run.note)


def _navigation(done: pd.DataFrame) -> "pd.Series[str]":
    """Name what the robots of each case go by: the truth, or the estimates of a condition.

    Errors of beliefs are points of a sweep.
    """
    if _BY not in done and done["point"].nunique() > _structures(done).nunique():
        return done["series"]
    by = done.get(_BY, pd.Series("estimate", done.index))
    return done["condition"].where(by != "truth", "the truth")


def _structures(done: pd.DataFrame) -> "pd.Series[str]":
    """Name the structure of each case: its kind, and of a bridge its span."""
    span = done.get("right_edge_R", pd.Series(np.nan, done.index))
    words = [f", {x:g} R" if np.isfinite(x) else "" for x in span]
    return done["kind"] + pd.Series(words, done.index)


def _of_kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    return rows[rows["kind"] == kind] if kind else rows


def _draw_panel(
    axes: "Axes", rows: pd.DataFrame, column: str, names: list[str], kinds: list[str]
) -> None:
    """Draw the mean of a column for each name, a marker for each kind of structure."""
    shown_kinds = [kind for kind in kinds if kind in {*rows["structure"]}]
    for lane, kind in enumerate(shown_kinds):
        kind_rows = rows[rows["structure"] == kind]
        kind_index = kinds.index(kind)
        statistics = (
            kind_rows.groupby("by")[column].agg(["mean", figure_style.half_width]).reindex(names)
        )
        y = np.arange(len(names)) + 0.16 * (lane - 0.5 * (len(shown_kinds) - 1))
        if statistics["mean"].notna().any():
            half = statistics["half_width"]
            axes.errorbar(
                statistics["mean"], y, xerr=half, label=kind, **figure_style.dot_style(kind_index)
            )
