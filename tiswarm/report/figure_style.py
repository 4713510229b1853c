"""Colors, sizes and file formats that all figures share; renders and the page use these colors."""

import io
import re
from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.records.messages import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import FigureCanvasBase
    from matplotlib.figure import Figure

TRUE_BLUE = "#0072B2"
ESTIMATE_ORANGE = "#E69F00"
JOIN_COLORS = (
    "#482475", "#414487", "#355F8D", "#2A788E", "#21918D", "#22A884", "#44BF70", "#7AD151",
    "#BDDF26", "#FDE725",
)  # fmt: skip
"""The viridis scale without its darkest end, from the first robot to the last."""

FORCE_COLORS = ("#A6B8CC", "#E8CC9E", "#F29454", "#D64233", "#870826")
"""From no force to the greatest: pale gray-blue over orange to dark red."""

ERROR_COLORS = ("#FCF0C3", "#F9B64C", "#E4572E", "#8C0D2F")
"""From no error to the greatest: cream over orange to dark red."""

PALETTE = (TRUE_BLUE, ESTIMATE_ORANGE, "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
"""Colors that color-blind readers can distinguish (Okabe and Ito)."""

COLUMN_WIDTH, PAGE_WIDTH = 3.5, 7.0
"""Widths of a column and of a page of a paper [inch]."""

STACKED = "-stacked"
"""End of the name of an SVG whose panels are one below the other."""

MOST_BANDS = 5
"""Lines in a panel beyond which bands would hide each other."""

_PLACES = 6  # digits to which axes have the same place in every process [share of the figure]
_LONG_LABEL = 20  # letters of a row's label beyond which a stacked figure wraps it
_LEGEND_LINE = 0.14  # height of a line of text in a legend [inch]
_LEGEND_MARK, _LEGEND_LETTER = 0.5, 0.055  # widths of marker and letter in a legend [inch]
_MOST_LINEAR = 12.0  # greatest ratio of values that a linear axis shows well
_MOST_LABELS = 60.0  # greatest ratio with three labels a decade

STYLE: dict[Any, Any] = {
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 8.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "tiswarm",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}


def rgb(color: str) -> Reals:
    """Split a color such as #0072B2 into red, green and blue, 0 to 1, shape (3,)."""
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0


def colors_along(share: NDArray[np.floating], colors: Sequence[str]) -> Reals:
    """Interpolate colors at places from 0 to 1 along a range, shape (n, 3)."""
    stops = np.linspace(0.0, 1.0, len(colors))
    channels = np.array([rgb(color) for color in colors]).T
    return np.column_stack([np.interp(share, stops, channel) for channel in channels])


def colors_from_zero(values: Reals, colors: Sequence[str]) -> tuple[Reals, float]:
    """Color values from zero to the greatest, shape (n, 3); returns the greatest too."""
    greatest = max(float(np.nanmax(values, initial=0.0)), 1e-9)
    return colors_along(np.nan_to_num(values) / greatest, colors), greatest


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure of a size [inch] with a constrained layout."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=300, layout="constrained")


def new_panels(
    width: float, height: float, count: int, columns: int, *, share: str = ""
) -> "tuple[Figure, list[Axes]]":
    """Make a figure of a size [inch] with `count` panels, `columns` in a row.

    Panels have the axes named in `share`, such as "xy", in common.
    """
    figure = new_figure(width, height)
    x, y, rows = "x" in share, "y" in share, -(-count // columns)
    grid = figure.subplots(rows, columns, sharex=x, sharey=y, squeeze=False).ravel()
    for unused in grid[count:]:
        unused.set_axis_off()
    for lowest in grid[max(0, count - columns) : count]:
        lowest.tick_params(labelbottom=True)  # above an unused place, too
    return figure, list(grid[:count])


def line_style(place: int) -> dict[str, Any]:
    """Choose color, dashes and width of the line at a place among others.

    Lines become thinner, so that one remains visible beneath the next.
    """
    dashes = ("-", "--", ":")[place // len(PALETTE) % 3]
    width = max(0.8, 2.2 - 0.25 * place)
    return {"color": PALETTE[place % len(PALETTE)], "linestyle": dashes, "linewidth": width}


def marker_style(place: int) -> dict[str, Any]:
    """Choose color and marker of the points at a place among others.

    A color that repeats has another marker.
    """
    turn, color = divmod(place, len(PALETTE))
    return {"color": PALETTE[color], "marker": "osD^vPX"[(color + turn) % 7]}


def fit_axis(
    axes: "Axes",
    which: str,
    values: Reals,
    *,
    others: Reals | None = None,
    nonpositive: str = "mask",
) -> None:
    """Start the axis x or y at zero, or make it logarithmic where that would crush values onto 0.

    All points have to be drawn before, so that the axis ends beyond them.

    Args:
        axes: Panel.
        which: "x" or "y".
        values: Values whose differences have to be seen.
        others: Further values that have to be within the axis.
        nonpositive: Whether a logarithmic axis leaves out what is not positive ("mask"), or has it
            at its end ("clip").
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis: Any = getattr(axes, f"{which}axis")
    bounds: Any = getattr(axes, f"set_{which}lim")
    positive = values[values > 0.0]
    span = float(positive.max() / positive.min()) if len(positive) else 1.0
    if span <= _MOST_LINEAR:
        bounds(0.0, None)
        return
    getattr(axes, f"set_{which}scale")("log", nonpositive=nonpositive)
    every = positive if others is None else np.concatenate([positive, others[others > 0.0]])
    bounds(0.6 * every.min(), None)
    if span < _MOST_LABELS:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def shortened(name: str) -> str:
    """Shorten the name of a sweep point to `tower, settle=1.0`: drop the sections of keys.

    >>> shortened("structure={kind: tower, anchor: 5.0},no-z")
    'tower, anchor: 5.0,no-z'
    """
    name = re.sub(r"structure=\{kind: ([^{}]*)\}", r"\1", name.replace("structure.kind=", ""))
    return re.sub(r"(?:[a-z_]+\.)+(?=[a-z_]+=)", "", name)


def add_note(figure: "Figure", *notes: str) -> None:
    """Write a small line below the figure, at the right, unless all notes are empty."""
    note = "; ".join(filter(None, notes))
    if not note:
        return
    _leave_room(figure)
    figure.text(0.995, 0.0, note, fontsize=5.5, color="0.35", ha="right", va="bottom")


def _leave_room(figure: "Figure") -> None:
    """Leave a line of 0.1 inch below the panels for a note."""
    line = 0.1 / float(figure.get_size_inches()[1])
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0.0, line, 1.0, 1.0 - line))


def add_key(
    figure: "Figure", axes: "Axes", words: str, structures: int, loc: str = "outside upper center"
) -> None:
    """Add the legend of the lines of a panel, under what they mean and the number of structures."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc=loc, ncols=4,
        title=f"{words}, {counted(structures, 'structure')}", title_fontsize=7.0,
    )  # fmt: skip


def left_out(points: int, file: str) -> str:
    """Write a note on the sweep points that a figure lacks; empty if it has all."""
    return f"{counted(points, 'more sweep point')} in {file}" if points else ""


def stack(figure: "Figure") -> None:
    """Arrange the panels of a figure one below the other, as wide as a column of a paper.

    Each panel gets the numbers of its own axes, and legends get as many columns as fit.
    """
    panels = [axes for axes in figure.axes if axes.axison and axes.get_subplotspec()]
    rows = {spec.rowspan.start for axes in panels if (spec := axes.get_subplotspec())}
    height = float(figure.get_size_inches()[1]) / len(rows) * len(panels)
    grid = figure.add_gridspec(len(panels), 1)
    for place, axes in enumerate(panels):
        axes.set_subplotspec(grid[place])
        axes.tick_params(labelbottom=True, labelleft=True)
        if any(len(label.get_text()) > _LONG_LABEL for label in axes.get_yticklabels()):
            labels = [fill(label.get_text(), _LONG_LABEL) for label in axes.get_yticklabels()]
            axes.set_yticks(axes.get_yticks(), labels)
    unused = [axes for axes in figure.axes if not axes.axison]
    height += _LEGEND_LINE * _restack_legends(figure, unused)
    for axes in unused:
        axes.remove()
    figure.set_size_inches(COLUMN_WIDTH, height)
    figure.set_layout_engine("constrained")
    if any(text.get_position()[1] == 0.0 for text in figure.texts):
        _leave_room(figure)


def _restack_legends(figure: "Figure", unused: "Sequence[Axes]") -> int:
    """Put the legends of a figure and its unused panels on top; returns their lines."""
    legends = [*figure.legends, *filter(None, (axes.get_legend() for axes in unused))]
    drawn: dict[str, Any] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        drawn |= dict(zip(labels, handles, strict=True))
    lines = 0
    for legend in legends:
        names = [text.get_text() for text in legend.get_texts()]
        columns = legend_columns(names, COLUMN_WIDTH)
        lines += -(-len(names) // columns)
        copies: Any = zip(names, legend.legend_handles, strict=True)
        legend.remove()
        figure.legend(
            [drawn.get(name, copy) for name, copy in copies], names, ncols=columns,
            loc="outside upper center", title=legend.get_title().get_text() or None,
            title_fontsize=7.0,
        )  # fmt: skip
    return lines


def legend_columns(names: Sequence[str], width: float, most: int = 4) -> int:
    """Return how many columns of a legend fit into a width [inch]."""
    column = _LEGEND_MARK + _LEGEND_LETTER * max(map(len, names), default=0)
    return max(1, min(most, int(width / column)))


def png(figure: "Figure") -> bytes:
    """Encode a figure as PNG; equal figures give equal bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return _encoded(figure, FigureCanvasAgg, "png", {"Software": None})


def pdf(figure: "Figure") -> bytes:
    """Encode a figure as vectors (PDF); equal figures give equal bytes."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    unset = {"CreationDate": None, "Creator": None, "Producer": None}
    return _encoded(figure, FigureCanvasPdf, "pdf", unset)


def svg(figure: "Figure") -> bytes:
    """Encode a figure as SVG whose letters are text; equal figures give equal bytes."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    unset = dict.fromkeys(["Creator", "Date", "Format", "Type"])
    return _encoded(figure, FigureCanvasSVG, "svg", unset)


def _encoded(
    figure: "Figure", canvas: "type[FigureCanvasBase]", form: str, metadata: dict[str, None]
) -> bytes:
    """Lay out a figure once, and encode it; `savefig` would draw it once more before.

    The layout's solver orders variables by where they are in memory, so its last digits vary, and
    SVG names clip paths by them.
    """
    engine: Any = figure.get_layout_engine()
    engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = np.round(axes.get_position(original=True).bounds, _PLACES)
        axes.set_position((left, bottom, width, height))
        axes.set_in_layout(True)  # again, for a figure that is stacked afterwards
    stream, before = io.BytesIO(), figure.canvas
    getattr(canvas(figure), f"print_{form}")(stream, metadata=metadata)
    figure.set_canvas(before)
    return stream.getvalue()
