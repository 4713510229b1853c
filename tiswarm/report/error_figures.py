"""Draws the errors of robots: by iteration, and along the structure."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.registry import names
from tiswarm.records.measures import RMSE
from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, Series, StoredCase
from tiswarm.report.series import SEPARATOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_MAX_PANELS = 9
_MANY_TIMES = 4.0  # ratio of iterations from which the axis is logarithmic
_MAX_POINTS = 20_000  # points drawn in one panel: a fixed random choice where there are more
_MOST_VECTORS = 2_000  # points in all panels that an SVG has one by one
_MAX_KINDS = 4
_LOW_AND_MIDDLE = (0.05, 0.5)  # quantiles of errors that an axis must show apart
_OTHERS = {"color": "0.75", "linewidth": 0.7}  # look of lines beyond the colors that there are
_TITLE_LINE = 0.14  # height of a line of a title [inch]

_HEIGHT = ("z_R", "True height [R]")
_GROWS = {
    "tower": _HEIGHT,
    "cantilever": ("x_R", "True distance out from the edge [R]"),
    "bridge": ("x_R", "True distance along the gap [R]"),
    "chain": _HEIGHT,
}
"""By kind of structure, the column of `robots.csv` along which it grows, and the axis label."""


CAPTIONS = {
    "convergence": figure_style.Caption(
        "RMSE against iteration: mean over the structures, a panel for each method "
        "and point of the sweep. Best and worst have a band of one standard "
        "deviation; of many conditions, the first, best and worst have a color. A "
        "flat end shows that more iterations would not help.",
    ),
    "error-against-height": figure_style.Caption(
        "Error of each robot against its true height, a panel for each condition. A "
        "dot is a robot; its color is its join index, the order in which robots "
        "joined. Dots on the lower edge of a logarithmic axis have this error or "
        "less.",
    ),
    "error-along-growth": figure_style.Caption(
        "Error of each robot against its place along the structure, a panel for each "
        "kind of structure or condition. A dot is a robot; its color is its join "
        "index, the order in which robots joined. Dots on the lower edge of a "
        "logarithmic axis have this error or less.",
    ),
}
"""What the figures show, by file name."""


def painters(run: RunData) -> dict[str, figure_style.Drawable]:
    """List the figures of errors that a run has, by file name."""
    if not run.localized:
        return {}
    convergence = {"convergence": convergence_drawing(run)}
    kinds = _first_by_kind(run.localized)
    if kinds:
        return {**convergence, "error-along-growth": _kinds_drawing(run, kinds)}
    upward = all(_growth_axis(cases) == _HEIGHT for cases in run.localized.values())
    name = "error-against-height" if upward else "error-along-growth"
    return {**convergence, name: errors_drawing(run)}


def convergence_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of RMSE against iteration.

    Each point of a sweep has a panel for each method, since iterations of methods cost different
    times, with a line for each condition.
    """
    points = _by_point(run.localized)
    panels_of = {_title(key, traces): traces for key, traces in points.items()}
    shown = dict(list(panels_of.items())[:_MAX_PANELS])
    names = _legible(points)
    seeds = max(map(len, run.localized.values()))
    hidden = sum(len(traces) - len(_most_telling(traces, names)) for traces in shown.values())

    def paint(axes: "Axes", title: str, series: Sequence[str]) -> None:
        traces = _most_telling(shown[title], names)
        if len(series) < len(names):
            traces = {name: trace for name, trace in traces.items() if name in series}
        draw_convergence(axes, traces, names)
        figure_style.set_title(axes, title)

    def complete(panels: figure_style.Panels) -> list[str]:
        lines = [np.asarray(line.get_ydata(), float) for axes in panels.axes for line in axes.lines]
        values = np.concatenate([np.empty(0), *lines])
        panels.first.set_ylim(top=1.05 * values.max(initial=0.0) or 1.0)
        ends = np.array([line[-1] for line in lines])
        figure_style.fit_axis(panels.first, "y", ends, others=values)
        panels.label_once(y=RMSE.axis)
        words = "mean; best and worst ± 1 sd" if seeds > 1 else ""
        panels.legend(words, panels.entries(), structures=seeds)
        return [
            figure_style.omission_note(len(panels_of) - len(shown), "panel", "not drawn"),
            figure_style.omission_note(hidden, "line", "not drawn"),
            run.note,
        ]

    return figure_style.Drawing(
        panels=list(shown), series=names, paint=paint, complete=complete,
        columns=figure_style.columns_of(len(shown)), row_height=1.9, head_height=0.8, share="y",
    )  # fmt: skip


def _title(key: tuple[str, str], traces: Mapping[str, object]) -> str:
    """Name a panel by its point of the sweep and method, or by its only condition."""
    point, method = key
    name = next(iter(traces)) if method and len(traces) == 1 else method
    return ", ".join(filter(None, [point, name]))


_Trace = tuple[Reals, Reals]
"""Iterations, and RMSE of each case at these, as `_traces` returns them."""

_Panels = dict[tuple[str, str], dict[str, _Trace]]
"""Traces of each panel by condition, by point and method; a word that all share is empty."""


def _legible(points: _Panels) -> list[str]:
    """List the conditions that have a color each: all, or of too many the first, best and worst.

    Best and worst of each method are the means of the last RMSE over all points.
    """
    names = list(dict.fromkeys(name for of_point in points.values() for name in of_point))
    if len(names) <= len(figure_style.PALETTE):
        return names
    chosen = {names[0]}
    for method in dict.fromkeys(method for _, method in points):
        ends: dict[str, list[float]] = {}
        for (_, panel_method), of_point in points.items():
            if panel_method != method:
                continue
            for name, (_, rmse) in of_point.items():
                ends.setdefault(name, []).extend(rmse[:, -1])
        order = sorted(ends, key=lambda name: float(np.mean(ends[name])))
        chosen |= {*order[:1], *order[-1:]}
    return [name for name in names if name in chosen]


def _most_telling(traces: dict[str, _Trace], names: list[str]) -> dict[str, _Trace]:
    """Keep the traces that have a color, and as many others as a panel has room for."""
    others = [name for name in traces if name not in names]
    count = figure_style.MOST_SERIES - (len(traces) - len(others))
    kept = {*names, *others[: max(count, 0)]}
    return {name: trace for name, trace in traces.items() if name in kept}


def _by_point(series: Series) -> _Panels:
    """Group traces by sweep point and method; by method alone if each point has one condition.

    Methods without iterations are left out, unless there are no others.
    """
    methods = {cases[0].method for cases in series.values()}
    alone = len({cases[0].point for cases in series.values()}) == len(series)
    points: _Panels = {}
    for name, cases in series.items():
        point = "" if alone else cases[0].point
        method = cases[0].method if len(methods) > 1 else ""
        trace = _traces(cases)
        if trace[0].size:
            condition = name if alone else cases[0].condition or name
            points.setdefault((point, method), {})[condition] = trace
    moving = {
        key: of_point
        for key, of_point in points.items()
        if any(iteration.size > 1 for iteration, _ in of_point.values())
    }
    return moving or points or {("", ""): {}}


def draw_convergence(axes: "Axes", traces: "Mapping[str, _Trace]", names: list[str]) -> None:
    """Draw the mean of each trace, colored by its place in `names`.

    Of those named, the best and the worst have bands. Others are thin and gray, and have one entry
    in a legend.
    """
    from matplotlib.ticker import MaxNLocator

    named = [name for name in traces if name in names]
    order = sorted(named, key=lambda name: float(traces[name][1][:, -1].mean()))
    banded = {*order[:1], *order[-1:]}
    for name, (iteration, rmse) in sorted(traces.items(), key=lambda item: item[0] in names):
        is_named = name in names
        look = figure_style.line_style(names.index(name)) if is_named else dict(_OTHERS)
        mean = rmse.mean(axis=0)
        axes.plot(iteration, mean, label=name if is_named else "others", **look)
        sd = rmse.std(axis=0)
        if name in banded and sd.any():
            axes.fill_between(
                iteration, mean - sd, mean + sd, color=look["color"], alpha=0.15, linewidth=0.0
            )
    axes.set_xlabel("Iteration")
    axes.margins(x=0.0)
    ends = [float(np.max(line.get_xdata())) for line in axes.lines]
    if max(ends, default=0.0) > _MANY_TIMES * min(ends, default=0.0) > 0.0:
        figure_style.set_log(axes, "x")
    else:  # the number at the end would touch the 0 of the next panel
        axes.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))


def _traces(cases: list[StoredCase]) -> tuple[Reals, Reals]:
    """Interpolate each case's RMSE on common iterations; a case that ended keeps its last value."""
    names = ["iteration", RMSE.column]
    tables = [case.columns("convergence.csv", names, empty=True) for case in cases]
    tables = [table for table in tables if len(table)]
    iteration = np.unique(np.concatenate([np.empty(0), *(table[:, 0] for table in tables)]))
    return iteration, np.array([np.interp(iteration, *table.T) for table in tables])


def errors_drawing(run: RunData) -> figure_style.Drawing:
    """Compose the figure of each robot's error against its place along the structure.

    Each series has a panel. Of many series, the first conditions of all sweep points are drawn.
    """
    listed = list(run.localized.items())
    if len(listed) > _MAX_PANELS:
        conditions = list(dict.fromkeys(cases[0].condition for _, cases in listed))
        listed.sort(key=lambda item: conditions.index(item[1][0].condition))
    listed = listed[:_MAX_PANELS]
    pairs = len({cases[0].point for cases in run.localized.values()}) == 2 or len(listed) == 4  # noqa: PLR2004
    columns = 2 if pairs else min(3, len(listed))
    shown = dict(listed[: _MAX_PANELS // columns * columns])
    lines = max(name.count(", ") for name in shown)
    omitted = len(run.localized) - len(shown)
    titles = {name: name.replace(SEPARATOR, "\n") for name in shown}
    return _scatter_drawing(
        run, shown, titles, columns=columns, row_height=1.8 + _TITLE_LINE * lines,
        note=f"{omitted} more series not shown" if omitted else "",
    )  # fmt: skip


def _kinds_drawing(run: RunData, kinds: Series) -> figure_style.Drawing:
    """Compose the figure of the first condition of each kind of structure."""
    titles = {
        kind: f"{kind}, {cases[0].condition}, {counted(len(cases), 'structure')}"
        for kind, cases in kinds.items()
    }
    return _scatter_drawing(run, kinds, titles, columns=len(kinds), row_height=2.3, note="")


def _scatter_drawing(
    run: RunData,
    cases_of: Series,
    titles: Mapping[str, str],
    *,
    columns: int,
    row_height: float,
    note: str,
) -> figure_style.Drawing:
    """Compose panels of errors, of the cases of each name."""
    growth_axes = {name: _growth_axis(cases) for name, cases in cases_of.items()}
    is_one_axis = len({*growth_axes.values()}) == 1
    tables = {name: _errors_at(cases, growth_axes[name][0]) for name, cases in cases_of.items()}
    scale = _scale(list(tables.values()))

    def paint(axes: "Axes", name: str, series: Sequence[str]) -> None:  # noqa: ARG001 - one in each
        draw_errors(axes, tables[name], scale)
        axes.set_xlabel("" if is_one_axis else growth_axes[name][1])
        figure_style.set_title(axes, titles[name])

    def complete(panels: figure_style.Panels) -> list[str]:
        if is_one_axis:
            panels.label_once(next(iter(growth_axes.values()))[1])
        panels.label_left("Error [R]")
        _add_color_bar(panels, scale)
        many = [name for name in panels.names if len(tables[name]) > _MAX_POINTS]
        drawn = [f"{name}: {_MAX_POINTS} of {len(tables[name])} robots drawn" for name in many]
        return [run.note, *drawn, note]

    return figure_style.Drawing(
        panels=list(cases_of), paint=paint, complete=complete, columns=columns,
        row_height=row_height, head_height=0.5, share="xy" if is_one_axis else "y",
    )  # fmt: skip


def _first_by_kind(series: Series) -> Series:
    """Take the first series of each kind of structure; none unless a run sweeps a few kinds."""
    kinds: Series = {}
    for cases in series.values():
        kinds.setdefault(cases[0].kind, cases)
    points = {cases[0].point for cases in series.values()}
    few = 1 < len(kinds) == len(points) <= _MAX_KINDS
    return kinds if few and kinds.keys() <= {*names("structure")} else {}


def _growth_axis(cases: list[StoredCase]) -> tuple[str, str]:
    """Return the column along which structures of a series grow, and the axis label."""
    return _GROWS.get(cases[0].kind, _HEIGHT)


def _errors_at(cases: list[StoredCase], column: str) -> Reals:
    """Gather a column, error and join index of all robots with an error, shape (robots, 3)."""
    names = [column, "error_R"]
    tables = [case.columns("robots.csv", names, gaps=names) for case in cases]
    table = np.concatenate([np.column_stack([t, np.arange(len(t))]) for t in tables])
    finite: Reals = table[np.isfinite(table).all(axis=1)]
    return finite


class _Scale(NamedTuple):
    """What panels of errors have in common."""

    last: float  # greatest join index
    typical: Reals  # errors whose differences have to be seen [R]
    top: float  # greatest error [R]
    is_dense: bool  # whether there are too many dots for an SVG


def _scale(tables: list[Reals]) -> _Scale:
    """Choose the axes of panels from tables of `_errors_at`."""
    errors = [table[:, 1] for table in tables if len(table)]
    drawn = sum(min(len(table), _MAX_POINTS) for table in tables)
    return _Scale(
        last=max(1.0, *(float(table[:, 2].max(initial=0.0)) for table in tables)),
        typical=np.concatenate([[0.0], *(np.quantile(error, _LOW_AND_MIDDLE) for error in errors)]),
        top=max((float(error.max()) for error in errors), default=0.0),
        is_dense=drawn > _MOST_VECTORS,
    )


def _join_colors() -> Any:  # noqa: ANN401 - a map of matplotlib
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("join", figure_style.JOIN_COLORS)


def draw_errors(axes: "Axes", table: Reals, scale: _Scale) -> None:
    """Draw the error of each robot, colored by its join index.

    Where methods differ much, the axis of errors is logarithmic; less is drawn at its lower edge.

    Args:
        axes: Panel.
        table: Place along the structure [R], error [R] and join index, shape (robots, 3).
        scale: What the panels of the figure have in common.
    """
    figure_style.fit_axis(axes, "y", scale.typical)
    low = axes.get_ylim()[0]
    axes.set_ylim(low, (1.3 if low > 0.0 else 1.05) * scale.top or 1.0)
    x, y, join = np.random.default_rng(0).permutation(table)[:_MAX_POINTS].T
    axes.scatter(
        x,
        np.maximum(y, low),
        c=join,
        s=float(np.clip(9000.0 / max(len(x), 1), 1.0, 12.0)),
        cmap=_join_colors(),
        vmin=0.0,
        vmax=scale.last,
        linewidths=0.0,
        clip_on=False,
        rasterized=scale.is_dense,
    )


def _add_color_bar(panels: figure_style.Panels, scale: _Scale) -> None:
    """Add the bar of join indices: above narrow figures, else at the right."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    figure = panels.figure
    count = len(panels.axes)
    look: dict[str, Any] = {"aspect": 25 * -(-count // 3)}
    if figure_style.is_narrow(figure):
        look = {"aspect": 40, "location": "top"}
    colors = ScalarMappable(Normalize(0.0, scale.last), _join_colors())
    bar: Any = figure.colorbar(colors, ax=figure.axes, label="Join index", pad=0.02, **look)
    bar.locator = MaxNLocator("auto", integer=True)
    bar.ax.spines["outline"].set_visible(False)
