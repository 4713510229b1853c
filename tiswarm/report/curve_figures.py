"""Draws the figures of rounds, grades, profiles and scaling, and of what robots build.

Most have a curve for each condition or point; those of navigation have rows. A function
`draw_...(axes, data, panel, series)` draws one panel; `figure_style.Drawing` arranges panels.
"""

import re
from collections.abc import Mapping, Sequence
from os.path import commonprefix
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.records.measures import (
    BELIEF_SENT,
    BUILT_FOR,
    CROSSED,
    FEWEST,
    FLIPS_AS_PLANNED,
    HEIGHT,
    MAIN,
    REACH,
    RMSE,
    STEPS,
    Measure,
)
from tiswarm.records.messages import counted, three_digits
from tiswarm.records.run_folder import LABEL
from tiswarm.report import figure_style
from tiswarm.report.page_tables import power_words
from tiswarm.report.run_data import (
    RunData,
    joined_words,
    stated_conditions,
    stated_scenario,
    with_points,
)
from tiswarm.report.series import joined

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        "RMSE by grade: conditions that differ in one "
        "number share a panel, and each point of the sweep has a line. The dashed line is the "
        "first condition without a grade.",
        intervals="Bars are 95 % CI.",
    ),
    "profiles": figure_style.Caption(
        "RMSE of robots with equal values of a quantity: join index (order of joining), true "
        "height, hops (contacts on the shortest way to an anchor) and number of "
        "contacts. Bands of the best and the worst series cover the errors of 80 % of "
        "these robots; hollow dots stand for few robots. Relative RMSE is the error of the "
        "vector between two robots. A study of many series has a small panel of each, with "
        "RMSE by hops alone.",
    ),
    "scaling": figure_style.Caption(
        "Accuracy, size, time to build and cost against the number of robots N (or of "
        "threads, processes or climbing robots), on logarithmic axes. p is the power of N "
        "that fits all sizes, with its 95 % confidence interval. A round of growth takes as "
        "long as its longest walk.",
    ),
}
"""What the figures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figures that a run has, by file name."""
    drawings: dict[str, figure_style.Drawable] = {}
    if run.sweeps_robots:
        drawings["scaling"] = scaling_drawing(run)
    if compares_rounds(run):
        drawings["back-propagation"] = rounds_drawing(run)
    return {
        **drawings,
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


def rounds_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of RMSE against steps per robot, for rounds at several intervals.

    Each point of a sweep has a panel, and rounds that move equally many robots are a series.
    """
    numbers = ["cases", RMSE.mean, RMSE.ci95, STEPS.mean]
    numbers += ["round_every", "round_recent", "round_sweeps"]
    table = with_points(run.table("table.csv", ["condition"], numbers, after="cases"))
    points = list(dict.fromkeys(table["point"]))
    one_length = len(set(table["round_sweeps"].dropna())) == 1
    steps = table.loc[table["round_every"].notna(), STEPS.mean]
    table["family"] = [
        _family_name(sweeps, recent, one_length=one_length)
        for sweeps, recent in zip(table["round_sweeps"], table["round_recent"], strict=True)
    ]
    families = list(dict.fromkeys(table["family"].loc[table["round_every"].notna()]))

    def paint(axes: "Axes", point: str, series: Sequence[str]) -> None:
        draw_rounds(axes, table, point, series)

    def complete(panels: figure_style.Panels) -> list[str]:
        panels.label_left(RMSE.axis)
        figure_style.set_log(panels.first, "x", 2.0 * steps.max() / steps.min())
        panels.first.set_xlim(0.7 * steps.min(), 1.4 * steps.max())
        words = f"robots moved in a round; {figure_style.mean_words(table['cases'])}"
        panels.legend(words)
        more = figure_style.omission_note(
            max(len(points) - _MOST_POINTS, 0), "sweep point", "in table.csv"
        )
        return ["numbers: joins between two rounds", more, run.note]

    return figure_style.Drawing(
        panels=points[:_MOST_POINTS], series=families, paint=paint, complete=complete,
        columns=2, row_height=3.0, head_height=0.6, share="x",
    )  # fmt: skip


def _family_name(sweeps: float, recent: float, *, one_length: bool) -> str:
    """Name rounds by the robots that they move, and by their steps where these differ."""
    name = f"last {recent:g}" if np.isfinite(recent) else "all"
    return name if one_length else joined([name, f"{sweeps:g} steps"])


def draw_rounds(axes: "Axes", table: pd.DataFrame, point: str, families: Sequence[str]) -> None:
    """Draw RMSE against steps per robot at a point of the sweep.

    A line joins rounds that move equally many robots by equally many steps. A condition without
    rounds is a horizontal line.
    """
    rows = table[table["point"] == point]
    has_rounds = rows["round_every"].notna()
    levels = rows.loc[~has_rounds, ["condition", RMSE.mean, RMSE.ci95]]
    for index, level in enumerate(levels.itertuples(index=False)):
        _draw_level(axes, *level, at_right=index % 2 == 0)
    looks = list(dict.fromkeys(table.loc[table["round_every"].notna(), "family"]))
    for name in families:
        family = rows[has_rounds & (rows["family"] == name)]
        look = {"label": name, **figure_style.marker_style(looks.index(name))}
        _draw_family(axes, family, look)
    figure_style.set_title(axes, point)
    axes.set_xlabel(STEPS.axis)
    axes.set_ylim(bottom=0.0)


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
            color=look["color"],
        )
    axes.errorbar(
        steps,
        rmse,
        yerr=line[RMSE.ci95].fillna(0.0),
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
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        color="0.35",
        ha="right" if at_right else "left",
        bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 0.5},
    )


def _profile_painters(run: RunData) -> dict[str, figure_style.Drawable]:
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
        return {"profiles": _profiles_drawing(run, table)}
    drawings: dict[str, figure_style.Drawable] = {}
    for point, point_rows in points.items():
        slug = re.sub(r"[^A-Za-z0-9.]+", "-", str(point)).strip("-")
        drawings[f"profiles-{slug}"] = _profiles_drawing(run, point_rows.assign(point=""))
    return drawings


def _profiles_drawing(run: RunData, table: pd.DataFrame) -> figure_style.Drawing:
    """Compose the figure of RMSE against join, height, hops and contacts, and relative RMSE."""
    many = table["count"] >= _FEWEST_ROBOTS
    table = table.assign(
        at=(table["low"] + table["high"]) / 2.0,
        many=many | (not many.any()),
        series=joined_words(table, _SERIES),
    )
    names = list(dict.fromkeys(table["series"]))
    if len(names) > len(figure_style.PALETTE):
        return _small_profiles_drawing(run, table)

    def paint(axes: "Axes", variable: str, series: Sequence[str]) -> None:
        draw_profile(axes, table, variable, series)

    def complete(panels: figure_style.Panels) -> list[str]:
        if len(names) > 1:
            panels.legend()
        opened = "" if table["many"].all() else f"open: fewer than {_FEWEST_ROBOTS} robots"
        return [opened, run.note]

    return figure_style.Drawing(
        panels=list(PROFILED), series=names, paint=paint, complete=complete, row_height=1.7
    )


def draw_profile(axes: "Axes", table: pd.DataFrame, variable: str, series: Sequence[str]) -> None:
    """Draw RMSE against a variable of robots, or relative RMSE against the hops between two.

    Bands of the best and the worst series cover the errors of most robots of a range, 10 % to 90 %.
    Points of few robots are open, and not connected.

    Args:
        axes: Panel.
        table: `profiles.csv` with columns `at`, the middle of a range, `many` and `series`.
        variable: Name in PROFILED.
        series: Names of the series to draw.
    """
    names = list(dict.fromkeys(table["series"]))
    means = table[table["series"].isin(series)].groupby("series")[RMSE.column].mean()
    bands = {means.idxmin(), means.idxmax()} if len(means) else set()
    rows = table[(table["by"] == variable) & table["series"].isin(series)]
    for name in series:
        line = rows[rows["series"] == name]
        look = figure_style.line_style(names.index(name))
        _draw_series(axes, line, name, look)
        if name in bands:
            _draw_band(axes, line[line["many"]], look["color"])
    axes.set(xlabel=PROFILED[variable], ylabel=RMSE.axis)
    rmse = rows[RMSE.column].to_numpy(float)
    figure_style.fit_axis(axes, "y", rmse[rows["many"]], others=rmse)
    if variable == "hops_apart":
        figure_style.set_log(axes, "x")
        axes.set_ylabel("Relative RMSE [R]")
        ticks = sorted(set(rows["low"]))
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()


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


def _small_profiles_drawing(run: RunData, table: pd.DataFrame) -> figure_style.Drawing:
    """Compose the figure of RMSE against hops for more series than colors: a panel for each.

    Series of a sweep point share its panel, if there are few. In gray behind each panel are the
    series of the first, to compare with.
    """
    rows = table[table["by"] == _SMALL]
    one_point = len({*rows["point"]}) == 1
    if one_point or rows["condition"].nunique() > len(figure_style.PALETTE):
        rows = rows.assign(point=rows["series"], condition="RMSE")
    rows = rows[rows["many"] | ~rows.groupby("point")["many"].transform("any")]
    points = list(dict.fromkeys(rows["point"]))
    names = list(dict.fromkeys(rows["condition"]))

    def paint(axes: "Axes", point: str, series: Sequence[str]) -> None:
        for _, line in rows[rows["point"] == points[0]].groupby("condition", sort=False):
            axes.plot(line["at"], line[RMSE.column], color="0.8")
        for name in series:
            line = rows[(rows["point"] == point) & (rows["condition"] == name)]
            color = figure_style.PALETTE[names.index(name)]
            axes.plot(line["at"], line[RMSE.column], "o-", label=name, color=color, markersize=2.0)
        figure_style.set_title(axes, point)

    def complete(panels: figure_style.Panels) -> list[str]:
        figure_style.fit_axis(panels.first, "y", rows[RMSE.column].to_numpy(float))
        panels.label_once(PROFILED[_SMALL], RMSE.axis)
        if len(names) > 1:
            panels.legend()
        omitted = max(len(points) - _MOST_SMALL, 0)
        more = figure_style.omission_note(omitted, "sweep point", "in profiles.csv")
        return ["gray: first panel", more, run.note]

    return figure_style.Drawing(
        panels=points[:_MOST_SMALL], series=names, paint=paint, complete=complete,
        columns=_SMALL_COLUMNS, row_height=1.25, head_height=0.6, share="xy",
    )  # fmt: skip


_MOST_POWERS = 4  # that a panel states
_TICK_ROOM = 0.16  # least distance of two sizes that both have a number [share of the axis]


def scaling_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of means over structures against the number of robots N.

    Threads, workers or movers take the place of N in a study of these.
    """
    table = run.table("scaling.csv", ["series", "measure"], ["mean"], after="measure")
    column = str(table.columns[2])
    series = list(dict.fromkeys(table["series"]))
    names = series[: figure_style.MOST_SERIES]
    table = table[table["series"].isin(names) & (table["mean"] > 0.0)]
    of_axis = _AXES[column][2]
    labels = _built_for(run, {m: text for m, text in of_axis.items() if m in {*table["measure"]}})

    def paint(axes: "Axes", measure: str, shown: Sequence[str]) -> None:
        draw_scaling(axes, table, measure, shown)
        axes.set_ylabel(labels[measure])

    def complete(panels: figure_style.Panels) -> list[str]:
        shown = table[table["measure"].isin(panels.names)]
        entries = panels.entries()
        panels.legend(_band_words(shown), {n: entries[n] for n in names if n in entries})
        symbol = _AXES[column][1]
        powers = "" if not shown["exponent"].notna().any() else f"p: power of {symbol}, 95 % CI"
        if powers and len(panels.series) > _MOST_POWERS:
            powers = f"powers of {symbol} in scaling.csv"
        gray = any(_is_one_for_all(shown, measure, panels.series) for measure in panels.names)
        more = figure_style.omission_note(len(series) - len(names), "series", "in scaling.csv")
        return [powers, "gray: all series" if gray else "", more, run.note]

    return figure_style.Drawing(
        panels=list(labels), series=names, paint=paint, complete=complete, row_height=2.2
    )


def _band_words(table: pd.DataFrame) -> str:
    """Say what lines and bands of a figure are, and of how many structures."""
    if "structures" not in table:
        return "mean"
    least, most = int(table["structures"].min()), int(table["structures"].max())
    count = counted(most, "structure") if least == most else f"{least} to {most} structures"
    if least >= FEWEST:
        return f"mean and 95 % interval, {count}"
    return f"mean, least and greatest, {count}" if most > 1 else ""


def draw_scaling(
    axes: "Axes", table: pd.DataFrame, measure: str, series: Sequence[str] = ()
) -> None:
    """Draw a measure against the number of robots on logarithmic axes, with powers of N.

    Where all series are equal, one gray line stands for all.

    Args:
        axes: Panel.
        table: `scaling.csv`; its third column is the number of robots, or what takes its place.
        measure: Measure to draw.
        series: Names of the series to draw; all if empty.
    """
    column = str(table.columns[2])
    label, _, _ = _AXES[column]
    names = list(dict.fromkeys(table["series"]))
    shown = series or names
    is_one = _is_one_for_all(table, measure, shown)
    powers: dict[str, str] = {}
    values = []
    for name in shown[:1] if is_one else shown:
        rows = table[(table["measure"] == measure) & (table["series"] == name)]
        if rows.empty:  # a method that states no steps, for example
            continue
        look = {**figure_style.marker_style(names.index(name)), "label": name}
        if is_one:
            look |= {"color": "0.4", "label": "_all"}
        axes.plot(rows[column], rows["mean"], **look)
        low, high = _band(rows)
        axes.fill_between(rows[column], low, high, color=look["color"], alpha=0.15, linewidth=0.0)
        powers[_power(rows)] = look["color"]  # equal series are drawn over each other
        values.append(rows["mean"].to_numpy(float))
    powers.pop("", None)
    drawn = np.concatenate([np.empty(0), *values])
    figure_style.set_log(axes, "y", 2.0 * drawn.max() / drawn.min() if len(drawn) else 1.0)
    axes.set_xlabel(label)
    _number_sizes(axes, sorted({*table[column].astype(float)}))
    for index, (text, color) in enumerate(powers.items() if len(powers) <= _MOST_POWERS else ()):
        axes.annotate(
            text,
            (0.0, 1.0),
            (2.0, 2.0 + 1.2 * figure_style.TEXT_SIZE * index),
            color=color,
            xycoords="axes fraction",
            textcoords="offset points",
        )


def _band(rows: pd.DataFrame) -> tuple["pd.Series[float]", "pd.Series[float]"]:
    """Return the ends of the band of a series: its intervals, or of few structures the range."""
    mean = rows["mean"]
    if "ci95" in rows and rows["ci95"].notna().all():
        low = (mean - rows["ci95"]).clip(lower=rows["least"])  # a logarithmic axis has no zero
        return low, mean + rows["ci95"]
    return rows.get("least", mean), rows.get("most", mean)


def _is_one_for_all(table: pd.DataFrame, measure: str, series: Sequence[str]) -> bool:
    """Whether several series have the same values, as those of the growth that they share."""
    rows = table[table["measure"] == measure]
    values = {tuple(rows.loc[rows["series"] == name, "mean"]) for name in series}
    return len(values) == 1 < len(series)


def _power(rows: pd.DataFrame) -> str:
    """Write the power of a number that fits a series; empty without an interval."""
    exponent = float(rows["exponent"].iloc[0])
    half = float(rows["exponent_ci95"].iloc[0]) if "exponent_ci95" in rows else np.nan
    text = power_words(exponent, half).replace("-", "\N{MINUS SIGN}")
    return f"p = {text}" if text else ""


def _number_sizes(axes: "Axes", numbers: Sequence[float]) -> None:
    """Number the horizontal, logarithmic axis by the sizes themselves where there is room."""
    span = numbers[-1] / numbers[0]
    figure_style.set_log(axes, "x", span)
    gaps = np.diff(np.log(numbers)) / np.log(span) if span > 1.0 else np.ones(1)
    if gaps.min(initial=1.0) >= _TICK_ROOM:
        texts = [f"{n:g}" if n < 1000 else f"{n / 1000:g}k" for n in numbers]  # noqa: PLR2004 - k
        axes.set_xticks(numbers, texts)
        axes.minorticks_off()


def _built_for(run: RunData, panels: Mapping[str, str]) -> dict[str, str]:
    """Show the reach of cantilevers and the depth of chains in place of the height of towers."""
    structure = stated_scenario(run.folder).get("structure") or {}
    aim = BUILT_FOR.get(str(structure.get("kind")), HEIGHT)
    aims = {HEIGHT.column: (aim.column, aim.axis)}
    return dict(aims.get(measure, (measure, text)) for measure, text in panels.items())


_FEWEST_GRADES = 3
_UNITS = {
    "_deg": "deg",
    "_noise": "R",
    "stop_error": "R",
    "loss": "share of messages",
    **dict.fromkeys(["mute", "deaf", "drift", "stuck"], "share of robots"),
}
"""Units by the ends of keys."""


def _grade_painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figure of graded conditions by file name, if a run has some.

    Rounds of back-propagation have a figure of their own.
    """
    if run.has_structures_alone or not (run.folder / "table.csv").is_file():
        return {}
    table = run.table("table.csv", ["condition"], [], after="cases")
    has_rounds = table.get("round_every", pd.Series(dtype=float)).notna().any()
    return {} if has_rounds or not _families(run, table) else {"grades": grades_drawing(run)}


def grades_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of errors against the number in which conditions differ that else agree.

    They share a panel, in which each point of the sweep has a line.
    """
    table = run.table("table.csv", ["condition"], ["cases", RMSE.mean, RMSE.ci95], after="cases")
    table = table[table[RMSE.mean].notna()]
    families = {family.title: family for family in _families(run, table)}
    table = with_points(table)
    points = list(dict.fromkeys(table["point"]))
    graded = {name for family in families.values() for name in family.names.values()}
    plain = next((name for name in table["condition"] if name not in graded), "")

    def paint(axes: "Axes", title: str, series: Sequence[str]) -> None:
        draw_grades(axes, table, families[title], series, plain)

    def complete(panels: figure_style.Panels) -> list[str]:
        means = table.loc[table["condition"].isin(graded | {plain}), RMSE.mean].to_numpy(float)
        figure_style.fit_axis(panels.first, "y", means, nonpositive="clip")
        panels.label_once(y=RMSE.axis)
        level = f"; dashed: {plain}" if plain else ""
        panels.legend(f"{figure_style.mean_words(table['cases'])}{level}")
        omitted = max(len(points) - figure_style.MOST_SERIES, 0)
        return [figure_style.omission_note(omitted, "sweep point", "in table.csv"), run.note]

    return figure_style.Drawing(
        panels=list(families), series=points[: figure_style.MOST_SERIES], paint=paint,
        complete=complete, columns=figure_style.columns_of(len(families)), row_height=2.1,
        head_height=0.6, share="y",
    )  # fmt: skip


def draw_grades(
    axes: "Axes",
    table: pd.DataFrame,
    family: "_Family",
    points: Sequence[str],
    plain: str,
) -> None:
    """Draw RMSE against the number of a family of conditions, a line for each point.

    A dashed line in its color is the condition `plain`, which belongs to no family.
    """
    low = min(family.names)
    high = max(family.names)
    if low > 0.0:
        figure_style.set_log(axes, "x")
        margin = (high / low) ** 0.05
        axes.set_xlim(low / margin, high * margin)  # dashed lines would widen it to 1
    looks = list(dict.fromkeys(table["point"]))
    for point in points:
        rows = table[table["point"] == point].set_index("condition")
        look = {
            "label": point or figure_style.ONLY_SERIES,
            **figure_style.marker_style(looks.index(point)),
        }
        _draw_line(axes, rows, family.names, look)
        if plain in rows.index:
            axes.axhline(rows[RMSE.mean][plain], **_dashed(look))
    figure_style.set_title(axes, family.title)
    axes.set_xlabel(_meaning(family.keys))
    axes.set_xticks([*family.names], [f"{grade:g}" for grade in family.names])
    axes.minorticks_off()


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
    """Draw the mean RMSE of graded conditions with its intervals."""
    graded = rows.reindex([*grades.values()])
    half = graded[RMSE.ci95].fillna(0.0)
    axes.errorbar([*grades], graded[RMSE.mean], yerr=half, elinewidth=0.6, **look)


def _dashed(look: dict[str, Any]) -> dict[str, Any]:
    return {"color": look["color"], "linestyle": "--", "linewidth": 0.8}


_BY = "structure.navigate_by"
_PANELS = {
    HEIGHT: ("tower", "Tower height [R]"),
    REACH: ("cantilever", "Cantilever reach [R]"),
    CROSSED: ("bridge", CROSSED.axis),
    FLIPS_AS_PLANNED: ("", FLIPS_AS_PLANNED.axis),
    BELIEF_SENT: ("", "Sent by a robot [kB]"),
}
"""By measure: the kind of structure that a panel shows, all if empty; its axis."""


def _building_painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figure by file name, if some robots of a run navigate by estimates."""
    planned = run.summary.get(FLIPS_AS_PLANNED.column)
    if planned is None or not planned.notna().any():
        return {}
    return {"building": building_drawing(run)}


def building_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of what robots build, and what they send for it.

    A row is what they navigate by.
    """
    done = run.summary[run.summary["status"] == "done"]
    rows = done.assign(structure=_structures(done), by=_navigation(done))
    rows[BELIEF_SENT.column] = rows.get(BELIEF_SENT.column, np.nan) / 1e3
    rows = rows.drop_duplicates(["by", "structure", "seed"])  # conditions may share structures
    names = list(dict.fromkeys(rows["by"]))
    kinds = list(dict.fromkeys(rows["structure"]))
    measures = {
        measure.column: measure
        for measure, (kind, _) in _PANELS.items()
        if _of_kind(rows, kind)[measure.column].any()
    }
    sizes = rows.groupby(["by", "structure"]).size()
    looks = {kind: figure_style.dot_style(index) for index, kind in enumerate(kinds)}

    def paint(axes: "Axes", column: str, series: Sequence[str]) -> None:
        kind, label = _PANELS[measures[column]]
        shown = _of_kind(rows, kind)
        draw_building(axes, shown, measures[column], names, looks, series)
        axes.set_xlabel(label)
        top = axes.get_xlim()[1]
        axes.set_xlim(-0.03 * top, 1.03 * top)  # markers at the ends are whole

    def complete(panels: figure_style.Panels) -> list[str]:
        figure_style.label_rows(panels.first, names)
        panels.first.invert_yaxis()
        panels.legend(figure_style.mean_words(sizes), panels.entries())
        return [run.note]

    return figure_style.Drawing(
        panels=list(measures), series=kinds, paint=paint, complete=complete,
        columns=min(len(measures), 3), row_height=0.6 + len(names) * (0.16 + 0.09 * len(kinds)),
        head_height=0.4, share="y",
    )  # fmt: skip


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
    words = [f" over {x:g} R" if np.isfinite(x) else "" for x in span]
    return done["kind"] + pd.Series(words, done.index)


def _of_kind(rows: pd.DataFrame, kind: str) -> pd.DataFrame:
    return rows[rows["kind"] == kind] if kind else rows


def draw_building(
    axes: "Axes",
    rows: pd.DataFrame,
    measure: Measure,
    names: Sequence[str],
    looks: Mapping[str, Mapping[str, Any]],
    kinds: Sequence[str],
) -> None:
    """Draw the mean of a measure of structures with its 95 % confidence interval.

    Args:
        axes: Panel.
        rows: Cases with the columns `by`, what robots navigate by, and `structure`, its kind.
        measure: Measure, whose intervals are those of its kind.
        names: What robots navigate by, a row each.
        looks: Look of the markers of each kind.
        kinds: Kinds of structures to draw.
    """
    shown = [kind for kind in kinds if kind in {*rows["structure"]}]
    for lane, kind in enumerate(shown):
        values = rows[rows["structure"] == kind].groupby("by")[measure.column]
        means = values.mean().reindex(list(names))
        if not means.notna().any():
            continue
        bars = np.array([_bar(values, name, measure) for name in names]).T
        y = np.arange(len(names)) + 0.16 * (lane - 0.5 * (len(shown) - 1))
        axes.errorbar(means, y, xerr=bars, label=kind, **looks[kind])


def _bar(values: Any, name: str, measure: Measure) -> tuple[float, float]:  # noqa: ANN401
    """Return how far the interval of a group of values extends below and above its mean."""
    if name not in values.groups:
        return 0.0, 0.0
    return figure_style.bar_of(values.get_group(name), measure)
