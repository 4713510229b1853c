"""Draws the errors of robots: by iteration, and along the structure."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.registry import names
from tiswarm.records.measures import RMSE
from tiswarm.records.messages import counted
from tiswarm.report import figure_style
from tiswarm.report.run_data import RunData, Series, StoredCase

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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


def painters(run: RunData) -> dict[str, figure_style.Painter]:
    """List the figures of errors that a run has, by file name."""
    if not run.localized:
        return {}
    if _first_by_kind(run.localized):
        return {"convergence": draw_convergence, "error-along-growth": _draw_error_along_growth}
    upward = all(_growth_axis(cases) == _HEIGHT for cases in run.localized.values())
    name = "error-against-height" if upward else "error-along-growth"
    return {"convergence": draw_convergence, name: draw_errors}


def draw_convergence(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw RMSE against iteration, mean over seeds; best and worst with a standard deviation.

    Each point of a sweep has a panel for each method, since iterations of methods cost different
    times, with a line for each condition.
    """
    points = _by_point(run.localized)
    shown = dict(list(points.items())[:_MAX_PANELS])
    seeds = max(map(len, run.localized.values()))
    columns = figure_style.columns_of(len(shown))
    rows = -(-len(shown) // columns)
    width = figure_style.COLUMN_WIDTH if columns == 1 else figure_style.PAGE_WIDTH
    panels = figure_style.Panels(
        0.8 + 1.9 * rows, len(shown), columns, width=width, share="y", max_width=max_width
    )
    legend: dict[str, Artist] = {}
    names = _legible(shown)
    top = 0.0
    hidden = 0
    for axes, ((point, method), of_point) in panels.paired_with(shown.items()):
        drawn = _most_telling(of_point, names)
        hidden += len(of_point) - len(drawn)
        top = max(top, _plot_convergence(axes, drawn, names))
        name = next(iter(of_point)) if method and len(of_point) == 1 else method
        figure_style.set_title(axes, ", ".join(filter(None, [point, name])))
        legend |= {str(line.get_label()): line for line in axes.lines}
    lines = [np.asarray(line.get_ydata(), float) for axes in panels.axes for line in axes.lines]
    ends = np.array([line[-1] for line in lines])
    panels.first.set_ylim(top=1.05 * top or 1.0)
    figure_style.fit_axis(panels.first, "y", ends, others=np.concatenate([np.empty(0), *lines]))
    panels.label_once(y=RMSE.axis)
    panels.legend("mean; best and worst ± 1 sd" if seeds > 1 else "", legend, structures=seeds)
    return panels.finish(
        figure_style.omission_note(len(points) - len(shown), "panel", "not drawn"),
        figure_style.omission_note(hidden, "line", "not drawn"),
        run.note,
    )


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


def _plot_convergence(axes: "Axes", traces: dict[str, _Trace], names: list[str]) -> float:
    """Draw the mean of each trace, colored by its place in `names`; returns the top [R].

    Of those named, the best and the worst have bands. Others are thin and gray, and have one entry
    in a legend.
    """
    top = 0.0
    named = [name for name in traces if name in names]
    order = sorted(named, key=lambda name: float(traces[name][1][:, -1].mean()))
    banded = {*order[:1], *order[-1:]}
    for name, (iteration, rmse) in sorted(traces.items(), key=lambda item: item[0] in names):
        is_named = name in names
        look = figure_style.line_style(names.index(name)) if is_named else dict(_OTHERS)
        mean = rmse.mean(axis=0)
        axes.plot(iteration, mean, label=name if is_named else "others", **look)
        upper = mean
        if name in banded:
            sd = rmse.std(axis=0)
            upper = mean + sd
            if sd.any():
                axes.fill_between(
                    iteration, mean - sd, upper, color=look["color"], alpha=0.2, linewidth=0.0
                )
        top = max(top, float(upper.max()))
    axes.set_xlabel("Iteration")
    axes.margins(x=0.0)
    ends = [float(np.max(line.get_xdata())) for line in axes.lines]
    if max(ends, default=0.0) > _MANY_TIMES * min(ends, default=0.0) > 0.0:
        figure_style.set_log(axes, "x")
    return top


def _traces(cases: list[StoredCase]) -> tuple[Reals, Reals]:
    """Interpolate each case's RMSE on common iterations; a case that ended keeps its last value."""
    names = ["iteration", RMSE.column]
    tables = [case.columns("convergence.csv", names, empty=True) for case in cases]
    tables = [table for table in tables if len(table)]
    iteration = np.unique(np.concatenate([np.empty(0), *(table[:, 0] for table in tables)]))
    return iteration, np.array([np.interp(iteration, *table.T) for table in tables])


def draw_errors(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw each robot's error against its place along the structure, colored by its join index.

    Each series has a panel. Of many series, the first conditions of all sweep points are drawn.
    """
    shown = list(run.localized.items())
    if len(shown) > _MAX_PANELS:
        conditions = list(dict.fromkeys(cases[0].condition for _, cases in shown))
        shown.sort(key=lambda item: conditions.index(item[1][0].condition))
    shown = shown[:_MAX_PANELS]
    pairs = len({cases[0].point for cases in run.localized.values()}) == 2 or len(shown) == 4  # noqa: PLR2004
    columns = 2 if pairs else min(3, len(shown))
    shown = shown[: _MAX_PANELS // columns * columns]
    rows = -(-len(shown) // columns)
    width = figure_style.COLUMN_WIDTH if columns == 1 else 1.2 + 2.0 * columns
    lines = max(name.count(", ") for name, _ in shown)
    height = 0.5 + (2.0 + _TITLE_LINE * lines) * rows
    growth_axes = [_growth_axis(cases) for _, cases in shown]
    is_one_axis = len(set(growth_axes)) == 1
    share = "xy" if is_one_axis else "y"
    panels = figure_style.Panels(
        height, len(shown), columns, width=width, share=share, max_width=max_width
    )
    tables = [
        _errors_at(cases, axis[0]) for (_, cases), axis in zip(shown, growth_axes, strict=True)
    ]
    _scatter(panels, tables)
    notes = [run.note]
    for axes, ((name, _), table) in panels.paired_with(zip(shown, tables, strict=True)):
        if len(table) > _MAX_POINTS:
            notes.append(f"{name}: {_MAX_POINTS} of {len(table)} robots drawn")
        figure_style.set_title(axes, name.replace(", ", ",\n"), 7.0)
    panels.label_once(growth_axes[0][1] if is_one_axis else "", "Error [R]")
    for axes, (_, label) in panels.paired_with(growth_axes):
        axes.set_xlabel("" if is_one_axis else label)
    if len(shown) < len(run.localized):
        notes.append(f"{len(run.localized) - len(shown)} more series not shown")
    return panels.finish(*notes)


def _draw_error_along_growth(run: RunData, max_width: float = np.inf) -> "Figure":
    """Draw each robot's error against its place along the structure, colored by its join index.

    Each kind of structure has a panel with the first condition.
    """
    kinds = _first_by_kind(run.localized)
    panels = figure_style.Panels(2.6, len(kinds), len(kinds), share="y", max_width=max_width)
    _scatter(panels, [_errors_at(cases, _growth_axis(cases)[0]) for cases in kinds.values()])
    for axes, (kind, cases) in panels.paired_with(kinds.items()):
        axes.set_xlabel(_growth_axis(cases)[1])
        many = counted(len(cases), "structure")
        figure_style.set_title(axes, f"{kind}, {cases[0].condition}, {many}")
    panels.label_left("Error [R]")
    return panels.finish(run.note)


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


def _scatter(panels: figure_style.Panels, tables: list[Reals]) -> None:
    """Draw a table of `_errors_at` in each panel, colored by join index.

    Where methods differ much, the axis of errors is logarithmic; less is drawn at its lower edge.
    """
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.ticker import MaxNLocator

    last = max(1.0, *(float(table[:, 2].max(initial=0.0)) for table in tables))
    colors = LinearSegmentedColormap.from_list("join", figure_style.JOIN_COLORS)
    errors = [table[:, 1] for table in tables if len(table)]
    typical = np.concatenate([[0.0], *(np.quantile(error, _LOW_AND_MIDDLE) for error in errors)])
    figure_style.fit_axis(panels.first, "y", typical)
    low = panels.first.get_ylim()[0]
    many = sum(min(len(table), _MAX_POINTS) for table in tables) > _MOST_VECTORS
    top = 0.0
    for axes, table in panels.paired_with(tables):
        x, y, join = np.random.default_rng(0).permutation(table)[:_MAX_POINTS].T
        area = float(np.clip(9000.0 / max(len(x), 1), 1.0, 12.0))
        dots = axes.scatter(
            x,
            np.maximum(y, low),
            c=join,
            s=area,
            cmap=colors,
            vmin=0.0,
            vmax=last,
            linewidths=0.0,
            clip_on=False,
            rasterized=many,
        )
        top = max(top, float(y.max(initial=0.0)))
    panels.first.set_ylim(low, (1.3 if low > 0.0 else 1.05) * top or 1.0)
    figure = panels.figure
    count = len(panels.axes)
    look: dict[str, Any] = {"aspect": 25 * -(-count // 3)}
    if figure_style.is_narrow(figure) and count > 1:
        look = {"aspect": 40, "location": "top"}
    bar: Any = figure.colorbar(dots, ax=figure.axes, label="Join index", pad=0.02, **look)
    bar.locator = MaxNLocator("auto", integer=True)
    bar.ax.spines["outline"].set_visible(False)
