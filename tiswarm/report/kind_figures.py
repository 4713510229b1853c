"""Figures of runs that grow several kinds of structures: a panel or a picture for each kind."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from tiswarm.report.canvas import PAGE_WIDTH, add_note, new_figure
from tiswarm.report.case_figures import (
    add_join_bar,
    draw_positions,
    errors_at,
    last_join,
    scatter_errors,
)
from tiswarm.report.folder import Series

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kinds = dict[str, Series]

MAX_KINDS = 4

GROWS = {
    "tower": ("z_R", "True height [R]"),
    "cantilever": ("x_R", "True distance out from the edge [R]"),
    "bridge": ("x_R", "True distance along the gap [R]"),
    "chain": ("z_R", "True height [R]"),
}
"""Along which column of `robots.csv` a kind of structure grows, and its name."""


def by_kind(series: Series) -> Kinds:
    """Conditions by kind of structure; empty unless all a run sweeps is a few kinds."""
    kinds: Kinds = {}
    for cases in series.values():
        kinds.setdefault(cases[0].kind, {})[cases[0].condition] = cases
    points = {cases[0].point for cases in series.values()}
    few = 1 < len(kinds) == len(points) <= MAX_KINDS
    return kinds if few and set(kinds) <= set(GROWS) else {}


def kind_painters(kinds: Kinds, note: str) -> dict[str, Callable[[], "Figure"]]:
    """By file name, what draws each figure."""
    return {
        "error-along-growth": partial(draw_error_along_growth, kinds, note),
        **{
            f"positions-{kind}": partial(draw_positions, series, note)
            for kind, series in kinds.items()
        },
    }


def draw_error_along_growth(kinds: Kinds, note: str) -> "Figure":
    """Draw each robot's error against how far along the structure it is, by join index.

    Of several conditions the first is drawn.
    """
    figure = new_figure(PAGE_WIDTH, 2.6)
    panels = figure.subplots(1, len(kinds), sharey=True)
    first = {kind: next(iter(series.values())) for kind, series in kinds.items()}
    tables = [errors_at(cases, GROWS[kind][0]) for kind, cases in first.items()]
    for axes, (kind, cases), table in zip(panels, first.items(), tables, strict=True):
        dots = scatter_errors(axes, table, last_join(tables))
        axes.set_xlabel(GROWS[kind][1])
        axes.set_title(f"{kind}, {cases[0].condition}, {len(cases)} structures", fontsize=8.0)
    panels[0].set_ylabel("Error [R]")
    panels[0].set_ylim(bottom=0.0)
    add_join_bar(figure, dots)
    add_note(figure, note)
    return figure
