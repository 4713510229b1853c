"""Draws figures of robots: what they send, errors as they join, and a scored estimate."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.records.measures import RMSE, RMSE_AT_JOIN, SENT
from tiswarm.records.messages import counted
from tiswarm.records.outputs import Outputs
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, StoredCase

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MOST_PANELS = 9
_SENT = SENT.column
_ERROR = RMSE.column
_TICKS = {"x": (1.0, 3.0), "y": (1.0, 2.0, 5.0)}
_CLEAR = 4.5
"""Distance of a name from markers at which it is easy to read [pt]."""
_DIRECTIONS = 12
"""Directions from its marker in which a name is tried."""
_RINGS = 8
"""Distances from its marker at which a name is tried in each direction."""
_LABEL = figure_style.TEXT_SIZE
_LINE_STEP = 1.2  # distance of the lines of a label, in parts of its letters
_LONGEST_LINE = 32  # letters of a label beyond which it goes on in another line
"""Height of a name [pt]."""
_LETTER = 4.0
"""Width of a letter of a name [pt]."""
_TICK_ROOM = 24.0
"""Room of a number along the horizontal axis [pt]."""


CAPTIONS = {
    "joining": figure_style.Caption(
        "RMSE of the robots that joined last, as many as a quarter of the smallest "
        "structure, against the number of robots by then. Lines are conditions; "
        "methods that place robots as they join have a second, dashed line for the "
        "same robots once all have joined.",
    ),
    "traffic": figure_style.Caption(
        "RMSE against the bytes that a robot sends in the mean, those that it passes "
        "on for others included, both logarithmic. A gray line joins the conditions "
        "that no other beats in both. They have names, and so have the first "
        "conditions of the scenario; others are gray. Horizontal lines are conditions "
        "that have the log of all robots in one place.",
        intervals="Bars and bands are 95 % CI.",
        reading="Farther left and lower is better.",
    ),
    "sd": figure_style.Caption(
        "True structure, each robot colored by the standard deviation of its position "
        "that the method reports. It should resemble the errors.",
    ),
    "color": figure_style.Caption(
        "True structure, each robot colored by a column of a table of yours; gray "
        "robots have no value.",
    ),
    "contact-graph": figure_style.Caption(
        "Contacts: each ball is a robot, colored by its hops from an anchor, and each "
        "rod joins two robots in contact.",
    ),
    "error": figure_style.Caption(
        "True structure, each robot colored by the error of its estimated position.",
    ),
    "best-and-weakest": figure_style.Caption(
        "One true structure, each robot colored by the error of its estimated position, by the "
        "condition that errs least there and by the one that errs most.",
    ),
    "growth": figure_style.Caption(
        "Growth of the structure, colored by join index, the order in which robots joined.",
    ),
    "sensed-force": figure_style.Caption(
        "True structure, each robot colored by the force that it senses in its links, "
        "in weights of a dock.",
    ),
    "margin": figure_style.Caption(
        "True structure, each robot colored by its margin, the strength of its weakest contact "
        "over the load of that contact, on a logarithmic scale. The contacts of dark red robots "
        "are the next to break.",
    ),
    "sizes": figure_style.Caption(
        "Structures of every size at one scale, each robot colored by its error.",
    ),
    "structure": figure_style.Caption(
        "True structure, colored by join index, the order in which robots joined.",
    ),
    "truth-and-estimate": figure_style.Caption(
        "Estimated robots, orange, and true robots, translucent blue, where they are "
        "more than 0.3 R apart. If most are, balls stand for robots, and rods join "
        "true and estimated centers.",
    ),
}
"""What these figures and 3D pictures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figures that a run has, by file name."""
    return {**_joining_painters(run), **_traffic_painters(run)}


def _traffic_painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figure by file name, if robots of some case sent each other anything."""
    sent = run.summary.get(_SENT)
    return {"traffic": traffic_drawing(run)} if sent is not None and sent.notna().any() else {}


def traffic_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of RMSE against the bytes that a robot sends.

    Each point of the sweep has a panel. Names have those conditions that no other beats in both,
    joined by a line, and as many others as there is room for, in the order of the scenario; the
    rest is gray.
    """
    done = run.summary[run.summary["status"] == "done"]
    titles = done["point"].where(done["point"].fillna("") != "", done["kind"]).astype(str)
    points = list(dict.fromkeys(titles))
    shown = points[:_MOST_PANELS]
    cases_of = {title: done[titles == title] for title in shown}
    fronts = {title: _front(cases) for title, cases in cases_of.items()}
    names = _named(done, list(fronts.values()))
    others = {*done["condition"]} - {*names}

    def paint(axes: "Axes", title: str, series: Sequence[str]) -> None:
        chosen = {name: names.index(name) for name in series}
        draw_traffic(axes, cases_of[title], fronts[title], chosen)
        if others and len(series) == len(names):
            _draw_others(axes, cases_of[title], others)
        figure_style.set_title(axes, title)
        axes.set_xlabel(SENT.axis)

    def complete(panels: figure_style.Panels) -> list[str]:
        panels.label_left(RMSE.axis)
        _set_scale(panels.first)
        unnamed = {text: artist for text, artist in panels.entries().items() if text not in names}
        if unnamed:
            panels.legend(entries=unnamed)
        return [
            figure_style.omission_note(len(points) - len(shown), "panel", "not drawn"),
            run.note,
        ]

    def settle(panels: figure_style.Panels) -> None:
        for axes in panels.axes:
            _space_ticks(axes)
            _name_markers(axes, names)

    columns = figure_style.columns_of(len(shown))
    return figure_style.Drawing(
        panels=shown, series=names, paint=paint, complete=complete, settle=settle,
        columns=columns, row_height=6.0 / columns if columns > 1 else 3.0, head_height=0.7,
        share="xy", alone=figure_style.PAGE_WIDTH,
    )  # fmt: skip


def draw_traffic(
    axes: "Axes",
    cases: pd.DataFrame,
    front: Mapping[str, tuple[float, float]],
    series: Mapping[str, int],
) -> None:
    """Draw RMSE against the bytes that a robot sends, a marker for each condition.

    Args:
        axes: Panel.
        cases: Cases of one point of the sweep.
        front: Bytes and RMSE of the conditions that no other beats in both.
        series: Places of the conditions to draw, which set their looks, by name.
    """
    axes.plot(*np.array(list(front.values())).reshape(-1, 2).T, color="0.8", linewidth=0.8)
    for name, index in series.items():
        _draw_condition(axes, cases[cases["condition"] == name], name, index)


def _draw_others(axes: "Axes", cases: pd.DataFrame, names: Collection[str]) -> None:
    """Draw conditions without names in gray."""
    means = cases[cases["condition"].isin(names)].groupby("condition")[[_SENT, _ERROR]].mean()
    look: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 2.5, "color": "0.7"}
    axes.plot(means[_SENT], means[_ERROR], label=counted(len(names), "other condition"), **look)


def _named(done: pd.DataFrame, fronts: Sequence[Mapping[str, object]]) -> list[str]:
    """Choose the conditions that have names, in the order of the scenario."""
    conditions = list(dict.fromkeys(done["condition"]))
    silent = done.groupby("condition", sort=False)[_SENT].count() == 0
    # The first one that sends is the default that others are changes of.
    first = [name for name in conditions if not silent[name]][:1]
    beaten_by_none = [name for name in conditions if any(name in front for front in fronts)]
    order = dict.fromkeys([*first, *beaten_by_none, *silent[silent].index, *conditions])
    chosen = [*order][: figure_style.MOST_SERIES]
    return [name for name in conditions if name in chosen]


def _front(cases: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """List mean bytes and RMSE of conditions that no other beats in both, by ascending bytes."""
    means = cases.groupby("condition", sort=False)[[_SENT, _ERROR]].mean().dropna()
    means = means.sort_values([_SENT, _ERROR], kind="stable")
    least = means[_ERROR].cummin()
    front = means[(means[_ERROR] == least) & ~least.duplicated()]
    return {str(name): (row.iloc[0], row.iloc[1]) for name, row in front.iterrows()}


def _space_ticks(axes: "Axes") -> None:
    """Number decades alone where there is no room for more numbers."""
    from matplotlib.ticker import LogLocator

    low, high = axes.get_xlim()
    room = axes.get_window_extent().width * 72.0 / axes.figure.dpi / np.log10(high / low)
    if room < _TICK_ROOM * len(_TICKS["x"]):
        axes.xaxis.set_major_locator(LogLocator())


def _name_markers(axes: "Axes", names: Sequence[str]) -> None:
    """Write the name of each condition beside its marker or line."""
    from matplotlib.container import ErrorbarContainer

    handles, labels = axes.get_legend_handles_labels()
    drawn: list[tuple[Any, str]] = [
        (handle[0] if isinstance(handle, tuple) else handle, label)
        for handle, label in zip(handles, labels, strict=True)
        if label in names
    ]
    if not drawn:
        return
    box = axes.get_window_extent()
    points_per_pixel = 72.0 / axes.figure.dpi
    low, high = np.array([[box.x0, box.y0], [box.x1, box.y1]]) * points_per_pixel
    paper = axes.transData.transform
    points = np.array([paper(line.get_xydata()[0]) for line, _ in drawn]) * points_per_pixel
    markers = [
        paper(line.get_xydata()) for line in axes.lines if line.get_marker() not in ("", "None")
    ]
    dots = np.concatenate([np.empty((0, 2)), *markers]) * points_per_pixel
    is_line = np.array([len(line.get_xydata()) > 1 for line, _ in drawn])
    # A line is named at its left end.
    points[is_line, 0] = low[0]
    texts = [fill(label, _LONGEST_LINE, break_on_hyphens=False) for _, label in drawn]
    sizes = np.array([_size(text) for text in texts])
    middle = np.column_stack([np.full(is_line.sum(), low[0]), points[is_line, 1]])
    bars = [
        paper(ends) * points_per_pixel
        for handle in handles
        if isinstance(handle, ErrorbarContainer)
        for lines in handle[2]
        for ends in lines.get_segments()
    ]
    boxes = [
        *((at, (0.5 * _CLEAR, 0.5 * _CLEAR)) for at in dots),
        *((at, (high[0] - low[0], 0.5)) for at in middle),
        *((ends.mean(axis=0), np.abs(ends[1] - ends[0]) / 2.0 + 0.5) for ends in bars),
    ]
    taken = np.array(boxes).reshape(-1, 2, 2)
    offsets = label_offsets(points, sizes, np.array([low, high]), taken)
    anchors = axes.transData.inverted().transform(points / points_per_pixel)
    for (marker, _), text, at, offset in zip(drawn, texts, anchors, offsets, strict=True):
        axes.annotate(
            text,
            at,
            offset,
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=_LABEL,
            arrowprops={
                "arrowstyle": "-",
                "linewidth": 0.4,
                "color": marker.get_color(),
                "shrinkA": 0.0,
                "shrinkB": 2.0,
            },
        )


def _size(text: str) -> tuple[float, float]:
    """Return about how wide and high a label of one or more lines is [pt]."""
    lines = text.split("\n")
    return _LETTER * max(map(len, lines)), _LABEL * (1.0 + _LINE_STEP * (len(lines) - 1))


def label_offsets(points: Reals, sizes: Reals, panel: Reals, taken: Reals) -> Reals:
    """Choose where to write beside each of some points, apart from what is there and other labels.

    Args:
        points: Points on paper [pt], shape (K, 2).
        sizes: Widths and heights of labels [pt], shape (K, 2).
        panel: Left lower and right upper corner of the panel [pt], shape (2, 2).
        taken: Centers and half widths of boxes with something in them [pt], shape (M, 2, 2).

    Returns:
        Offset of the center of each label from its point [pt], shape (K, 2).
    """
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = np.arange(_RINGS)[:, None, None]
    chosen = np.empty_like(points)
    for k, (point, size) in enumerate(zip(points, sizes, strict=True)):
        half = 0.5 * size
        # A label starts at the edge of its marker, in any direction.
        offsets = (around * (half + _CLEAR) + ring * around * _LABEL).reshape(-1, 2)
        centers = point + offsets
        gap = np.abs(centers[:, None] - taken[:, 0]) - (half + taken[:, 1])
        crossed = (gap.prod(axis=2) * (gap < 0.0).all(axis=2)).sum(axis=1)
        beyond = np.maximum(panel[0] - centers + half, 0.0) + np.maximum(
            centers + half - panel[1], 0.0
        )
        # The nearest place that is clear, or the clearest one.
        best = int((crossed + size.sum() * beyond.sum(axis=1)).argmin())
        chosen[k] = offsets[best]
        taken = np.concatenate([taken, [[centers[best], half]]])
    return chosen


def _draw_condition(axes: "Axes", cases: pd.DataFrame, name: str, index: int) -> None:
    """Draw the mean of a condition with its 95 % CI: a marker, or a line if nobody sends."""
    if cases.empty:
        return
    mean = float(cases[_ERROR].mean())
    half = figure_style.half_width(cases[_ERROR])
    if cases[_SENT].isna().all():
        look = figure_style.line_style(index)
        axes.axhline(mean, label=name, **look)
        axes.axhspan(max(mean - half, 0.5 * mean), mean + half, alpha=0.12, color=look["color"])
        return
    across = [
        [min(figure_style.half_width(cases[_SENT]), 0.5 * cases[_SENT].mean())],
        [figure_style.half_width(cases[_SENT])],
    ]
    up = [[min(half, 0.5 * mean)], [half]]
    look = {**figure_style.dot_style(index, 3.0), "elinewidth": 0.6}
    axes.errorbar(cases[_SENT].mean(), mean, xerr=across, yerr=up, label=name, **look)


def _set_scale(axes: "Axes") -> None:
    """Make both axes logarithmic, with numbers enough to read them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log")
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        axis.set_major_locator(LogLocator(subs=_TICKS[name]))
        axis.set_minor_formatter(NullFormatter())
        axis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))


def _short(value: float) -> str:
    """Write a number of an axis, thousands as k."""
    return f"{value / 1000.0:g}k" if value >= 1000.0 else f"{value:g}"  # noqa: PLR2004 - a thousand


_SCORE = RMSE_AT_JOIN.column
_COLUMN = "error_at_join_R"
_SHARE = 4
"""The robots that joined last are one in so many of the smallest structure."""


def _joining_painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figure by file name, if a run has structures of several sizes, and such errors."""
    sizes = {case.robots for cases in run.localized.values() for case in cases}
    return {"joining": joining_drawing(run)} if len(sizes) > 1 and _at_join(run) else {}


def joining_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of the RMSE of the last robots against the number of robots by then.

    Each kind of structure has a panel, with a line for each condition.
    """
    done = [case for cases in run.localized.values() for case in cases]
    kinds = list(dict.fromkeys(case.kind for case in done))
    names = list(dict.fromkeys(case.condition for case in done))
    sizes = sorted({case.robots for case in done})
    online = _at_join(run)
    last = max(sizes[0] // _SHARE, 1)

    def paint(axes: "Axes", kind: str, series: Sequence[str]) -> None:
        for name in series:
            cases = [case for case in done if (case.kind, case.condition) == (kind, name)]
            joins = any(case.name in online for case in cases)
            draw_joining(axes, cases, sizes, last, name, names.index(name), joins=joins)
        axes.set(xlabel="Robots by then", title=kind, xticks=sizes)

    def complete(panels: figure_style.Panels) -> list[str]:
        panels.label_left(f"RMSE of the last {last} robots [R]")
        drawn = [line.get_ydata() for axes in panels.axes for line in axes.lines]
        figure_style.fit_axis(panels.first, "y", np.concatenate([np.empty(0), *drawn]))
        panels.legend()
        return [run.note]

    return figure_style.Drawing(
        panels=kinds, series=names, paint=paint, complete=complete, columns=len(kinds),
        row_height=2.6, head_height=0.6, share="y",
    )  # fmt: skip


def draw_joining(
    axes: "Axes",
    cases: list[StoredCase],
    sizes: Sequence[int],
    last: int,
    name: str,
    index: int,
    *,
    joins: bool,
) -> None:
    """Draw the RMSE of the last robots against the number of robots by then.

    Of a method that places robots as they join, it is the error then; a dashed line is that once
    all robots have joined.

    Args:
        axes: Panel.
        cases: Cases of a kind of structure and a condition.
        sizes: Numbers of robots.
        last: How many robots are the last ones.
        name: Name of the condition.
        index: Its place among all, which sets its look.
        joins: Whether its method places robots as they join.
    """
    look = {**figure_style.marker_style(index), "markersize": 3.0}
    column = _COLUMN if joins else "error_R"
    line = [_rms(cases, size, size, column, last) for size in sizes]
    axes.plot(sizes, line, label=f"{name}, as they join" if joins else name, **look)
    if joins:
        later = [_rms(cases, sizes[-1], size, "error_R", last) for size in sizes]
        axes.plot(sizes, later, label=f"{name}, later", linestyle="--", **look)


def _at_join(run: RunData) -> set[str]:
    """Name the cases that have errors of robots as they joined."""
    if _SCORE not in run.summary:
        return set()
    return set(run.summary.loc[run.summary[_SCORE].notna(), "case"])


def _rms(cases: list[StoredCase], size: int, until: int, column: str, last: int) -> float:
    """Compute the RMSE of some robots before one, in all structures of a size [R]."""
    tables: list[Reals] = [
        case.columns("robots.csv", [column]) for case in cases if case.robots == size
    ]
    error = np.concatenate([np.empty((0, 1)), *(table[until - last : until] for table in tables)])
    return float(np.sqrt((error**2).mean())) if error.size else float("nan")


_SCORE_HEIGHT = 5.2
"""Height of the figure [inch]."""

_MOST_MARKS = 300
"""Robots up to which each error has a mark, and positions have large ones."""


def write_score(
    path: Path,
    true: Reals,
    estimated: Reals,
    errors: Mapping[str, Reals],
    unit: str,
    outputs: Outputs,
) -> None:
    """Write the figure of a score as `figure_style.write` does; arguments of `draw_score`."""
    figure_style.write(path, lambda: draw_score(true, estimated, errors, unit), outputs)


def draw_score(true: Reals, estimated: Reals, errors: Mapping[str, Reals], unit: str) -> "Figure":
    """Draw errors along the join order, and truth and estimate seen from two sides.

    Args:
        true: True centers in join order [unit], shape (N, 3).
        estimated: Estimated centers [unit], shape (N, 3).
        errors: Errors of the robots [unit] by the way of alignment, each of shape (N,).
        unit: Unit of lengths.
    """
    figure = figure_style.new_figure(figure_style.PAGE_WIDTH, _SCORE_HEIGHT)
    grid = figure.add_gridspec(2, len(figure_style.VIEWS), height_ratios=[1, 2])
    _draw_errors(figure.add_subplot(grid[0, :]), errors, unit)
    for column, (title, view) in enumerate(figure_style.VIEWS.items()):
        axes = figure.add_subplot(grid[1, column])
        _draw_view(axes, true[:, view], estimated[:, view])
        across, upward = (f"{'xyz'[axis]} [{unit}]" for axis in view)
        axes.set(xlabel=across, ylabel=upward, title=title)
    return figure


def _draw_errors(axes: "Axes", errors: Mapping[str, Reals], unit: str) -> None:
    """Draw the error of each robot, with the RMSE."""
    for color, (name, error) in zip(
        (figure_style.ESTIMATE_ORANGE, figure_style.TRUE_BLUE), errors.items(), strict=True
    ):
        mark = "." if len(error) <= _MOST_MARKS else ""
        label = f"{name}: RMSE {np.sqrt((error**2).mean()):.3g} {unit}"
        axes.plot(error, marker=mark, color=color, linewidth=0.8, label=label)
    axes.set(xlabel="robot, in join order", ylabel=f"error [{unit}]")
    axes.set_ylim(0.0, None)
    axes.margins(x=0.01)
    axes.legend(loc="upper left")


def _draw_view(axes: "Axes", true: Reals, estimated: Reals) -> None:
    """Draw true positions with lines to the estimated ones, both of shape (N, 2)."""
    size = 3.0 if len(true) <= _MOST_MARKS else 1.0
    ends = np.stack([true, estimated, np.full_like(true, np.nan)], axis=1).reshape(-1, 2)
    axes.plot(*ends.T, color="0.55", linewidth=0.6, label="error")
    for position, color, name in (
        (true, figure_style.TRUE_BLUE, "truth"),
        (estimated, figure_style.ESTIMATE_ORANGE, "estimate"),
    ):
        axes.plot(*position.T, "o", color=color, markersize=size, linestyle="", label=name)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best")
