"""Panels, legend, note, colors and file formats of all figures; pictures and page share colors."""

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError, require_name
from tiswarm.records.intervals import ends_of, mean_std_ci95
from tiswarm.records.measures import FEWEST, Measure
from tiswarm.records.messages import counted
from tiswarm.records.outputs import NEW, Outputs

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.backend_bases import FigureCanvasBase
    from matplotlib.figure import Figure


_Item = TypeVar("_Item")


class Caption(NamedTuple):
    """What a figure shows, in sentences."""

    text: str
    """What is drawn."""

    intervals: str = ""
    """What shows the confidence intervals, which few structures do not have."""

    reading: str = ""
    """How to read it, after these."""

    def words(self, *, few: bool) -> str:
        """Join the sentences; those of few structures without that on intervals."""
        intervals = "" if few else self.intervals
        return " ".join(filter(None, [self.text, intervals, self.reading]))


TRUE_BLUE = "#0072B2"
ESTIMATE_ORANGE = "#E69F00"
JOIN_COLORS = (
    "#482475",
    "#414487",
    "#355F8D",
    "#2A788E",
    "#21918D",
    "#22A884",
    "#44BF70",
    "#7AD151",
    "#BDDF26",
    "#FDE725",
)
"""The viridis scale without its darkest end, from the first robot to the last."""

FORCE_COLORS = ("#A6B8CC", "#E8CC9E", "#F29454", "#D64233", "#870826")
"""From no force to the greatest: pale gray-blue over orange to dark red."""

ERROR_COLORS = ("#FCF0C3", "#F9B64C", "#E4572E", "#8C0D2F")
"""From no error to the greatest: cream over orange to dark red."""

MARGIN_COLORS = ERROR_COLORS[::-1]
"""From contacts about to break, dark red, to those that bear far less than they can. No color in
between resembles the gray of robots without load."""

LABEL_COLORS = (
    *("#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#0072B2", "#8C6D46"),
)
"""Colors of labels, such as kinds of robots, on light and dark ground."""

UNKNOWN_GRAY = "#9AA3AD"
"""Color of robots without a value."""

SCALES: Mapping[str, tuple[str, ...]] = {
    "errors": ERROR_COLORS,
    "forces": FORCE_COLORS,
    "joins": JOIN_COLORS,
    "labels": LABEL_COLORS,
    "margins": MARGIN_COLORS,
}
"""Scales of colors, by the names that pages give them."""

PALETTE = (TRUE_BLUE, ESTIMATE_ORANGE, "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
"""Colors that color-blind readers can distinguish (Okabe and Ito)."""

COLUMN_WIDTH = 3.5
"""Width of a column of a paper [inch]."""

PAGE_WIDTH = 7.0
"""Width of a page of a paper [inch]."""

ONLY_SERIES = "mean"
"""Label of the markers of a series without a name; in a legend, they are what its title says."""

VIEWS = {"from the side": (0, 2), "from above": (0, 1)}
"""Axes of each view of positions, across and upward."""

TEXT_SIZE = 7.0
"""Size of all letters [pt]."""

LINE_WIDTH = 1.0
"""Width of lines of data [pt]."""

MOST_SERIES = 8
"""Lines or kinds of markers in a panel at most."""

_DASHES: Sequence[Any] = ("-", (0, (5, 1)), (0, (3, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
_WIDTHS = (1.0, 40.0)  # widths of a figure [inch]
_PLACES = 6  # digits to which axes have the same place in every process [share of the figure]
_LONG_LABEL = 26  # letters of a row's label beyond which a narrow figure wraps it
_LEGEND_LINE = 0.14  # height of a line of text in a legend [inch]
_LEGEND_MARK = 0.5  # width of a marker in a legend [inch]
_LEGEND_LETTER = 0.055  # width of a letter in a legend [inch]
_NOTE_LINE = 0.115  # height of a line of a note [inch]
_LETTER = 0.58  # width of a letter, as a share of its size
_MANY_PANELS = 4  # panels with common axes beyond which two fit into a row of a column
_EXACT = (1e-3, 1e4)  # numbers of an axis that have no power of ten
_MOST_LINEAR = 12.0  # greatest ratio of values that a linear axis shows well
_FEW_STEPS = 6.0  # ratio below which 1, 2 and 5 are too few labels
_MOST_LABELS = 60.0  # greatest ratio with three labels a decade

STYLE: dict[Any, Any] = {
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.labelsize": TEXT_SIZE,
    "axes.titlesize": TEXT_SIZE,
    "font.size": TEXT_SIZE,
    "legend.fontsize": TEXT_SIZE,
    "legend.frameon": False,
    "legend.title_fontsize": TEXT_SIZE,
    "lines.linewidth": LINE_WIDTH,
    "lines.markersize": 3.0,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "tiswarm",
    "text.parse_math": False,  # names of users may have any letter
    "xtick.labelsize": TEXT_SIZE,
    "xtick.major.width": 0.6,
    "ytick.labelsize": TEXT_SIZE,
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


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure of a size [inch] with a constrained layout."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=300, layout="constrained")


class Drawable(Protocol):
    """What draws a figure of a run."""

    def draw(
        self, width: float | None = None, panels: Sequence[str] = (), series: Sequence[str] = ()
    ) -> "Figure":
        """Draw the figure at a width [inch], with some of its panels and series."""


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A figure: panels, and the one painter that draws each of them on given axes.

    Pages, papers and users choose width, panels and series; the look of a series stays the same.
    """

    panels: Sequence[str]
    """Names of the panels in their order."""

    paint: Callable[["Axes", str, Sequence[str]], None]
    """Draws the panel of a name with the series of some names on axes."""

    complete: "Callable[[Panels], Iterable[str]]"
    """Adds the legend and what panels have in common; returns notes below the figure."""

    series: Sequence[str] = ()
    """Names of the series, which panels draw in the order of their looks."""

    settle: "Callable[[Panels], None] | None" = None
    """Adds what keeps apart on paper, such as names beside markers, once panels have their size."""

    columns: int = 3
    """Most panels in a row of a page."""

    row_height: float = 2.0
    """Height of a row of panels [inch]."""

    head_height: float = 0.3
    """Height of legend and notes [inch]."""

    share: str = ""
    """Axes that panels have in common, such as "xy"."""

    alone: float = COLUMN_WIDTH
    """Width of a panel alone [inch]."""

    def draw(
        self, width: float | None = None, panels: Sequence[str] = (), series: Sequence[str] = ()
    ) -> "Figure":
        """Draw the figure.

        Args:
            width: Width [inch]; that of a page, or of one panel alone, if None.
            panels: Names of panels; all if empty.
            series: Names of series; all if empty.

        Raises:
            InputError: the width is none, or there is no panel or series of a name.
        """
        from matplotlib import style

        shown = _chosen(self.panels, panels, "panels")
        if width is not None and not _WIDTHS[0] <= width <= _WIDTHS[1]:
            problem = f"{width} is no width in inches; give one from {_WIDTHS[0]} to {_WIDTHS[1]}"
            raise InputError(problem, argument="width")
        with style.context(["default", STYLE]):
            grid = Panels(self, shown, _chosen(self.series, series, "series"), width)
            for axes, name in grid.paired_with(shown):
                self.paint(axes, name, grid.series)
            figure = grid.finish(*self.complete(grid))
            if self.settle is not None:
                lay_out(figure)
                self.settle(grid)
            return figure

    def paint_panel(self, axes: "Axes", panel: str, series: Sequence[str] = ()) -> None:
        """Draw one panel on axes of matplotlib.

        Raises:
            InputError: there is no panel or series of a name.
        """
        (name,) = _chosen(self.panels, [panel], "panel")
        self.paint(axes, name, _chosen(self.series, series, "series"))


def _chosen(names: Sequence[str], chosen: Sequence[str], argument: str) -> list[str]:
    """Return some names in their order; all if none is chosen."""
    if chosen and not names:
        problem = f"this figure has no {argument} to choose from; leave it out"
        raise InputError(problem, argument=argument)
    for name in chosen:
        require_name(name, names, argument)
    return [name for name in names if name in chosen or not chosen]


class Panels:
    """The panels of a figure as it is drawn, with their axis labels, one legend and one note."""

    def __init__(
        self, drawing: Drawing, names: Sequence[str], series: Sequence[str], width: float | None
    ) -> None:
        """Make a figure with panels of some names.

        Panels keep their size as far as they can in a narrow figure, which has more rows.

        Args:
            drawing: The figure.
            names: Names of the panels.
            series: Names of the series that they show.
            width: Width of the figure [inch]; None for its own.
        """
        self.names = names
        self.series = series
        count = len(names)
        if width is None:
            width = drawing.alone if count == 1 else PAGE_WIDTH
        columns = min(count, drawing.columns)
        if width < PAGE_WIDTH and count > 1:
            fitting = 2 if drawing.share and count > _MANY_PANELS else 1
            columns = min(count, max(fitting, int(drawing.columns * width / PAGE_WIDTH)))
        rows = -(-count // columns)
        self.figure = new_figure(width, drawing.head_height + rows * drawing.row_height)
        grid = self.figure.subplots(
            rows, columns, sharex="x" in drawing.share, sharey="y" in drawing.share, squeeze=False
        ).ravel()
        for unused in grid[count:]:
            unused.set_axis_off()
        for lowest in grid[max(0, count - columns) : count]:
            lowest.tick_params(labelbottom=True)  # above an unused place, too
        self.axes: list[Axes] = list(grid[:count])

    @property
    def first(self) -> "Axes":
        """The first panel, whose limits others may share."""
        return self.axes[0]

    def paired_with(self, items: Iterable[_Item]) -> "Iterator[tuple[Axes, _Item]]":
        """Pair each panel with what it shows."""
        return zip(self.axes, items, strict=True)

    def label_left(self, label: str) -> None:
        """Label the vertical axis of the first panel of each row."""
        for axes in self.axes:
            spec = axes.get_subplotspec()
            if spec is not None and spec.is_first_col():
                axes.set_ylabel(label)

    def label_once(self, x: str = "", y: str = "") -> None:
        """Label axes beside all panels, where these share them."""
        for label, write in ((x, self.figure.supxlabel), (y, self.figure.supylabel)):
            if label:
                write(label, fontsize=TEXT_SIZE)

    def entries(self) -> "dict[str, Artist]":
        """Gather what a legend of all panels lists, by label in the order of drawing."""
        return {label: artist for axes in self.axes for label, artist in entries_of(axes).items()}

    def legend(
        self,
        title: str = "",
        entries: "Mapping[str, Artist] | None" = None,
        *,
        structures: int = 0,
        loc: str = "outside upper center",
    ) -> None:
        """Add a legend on top, in as many columns as fit, and enlarge the figure by further lines.

        Args:
            title: What the markers mean.
            entries: Artists by label; by default those of the first panel.
            structures: Structures behind each marker, which the title states unless 0.
            loc: Place.
        """
        entries = entries_of(self.first) if entries is None else entries
        if structures:
            title = f"{title}, {counted(structures, 'structure')}".removeprefix(", ")
        if ONLY_SERIES in entries and title:
            entries = {
                title if label == ONLY_SERIES else label: entries[label] for label in entries
            }
            title = ""
        width, height = map(float, self.figure.get_size_inches())
        columns = legend_columns([*entries], width)
        title = _filled(title, width, TEXT_SIZE)
        if columns == 1:
            entries = {
                _filled(label, width - _LEGEND_MARK, TEXT_SIZE): artist
                for label, artist in entries.items()
            }
        lines = -(-len(entries) // columns) + "".join([title, *entries]).count("\n")
        self.figure.set_size_inches(width, height + _LEGEND_LINE * max(0, lines - 1))
        self.figure.legend(
            entries.values(),
            entries.keys(),
            loc=loc,
            ncols=columns,
            title=title or None,
        )

    def finish(self, *notes: str) -> "Figure":
        """Write small lines below the figure, at the right, unless all are empty; return it."""
        note = "; ".join(filter(None, notes))
        if note:
            width, height = map(float, self.figure.get_size_inches())
            note = _filled(note, width, TEXT_SIZE)
            room = _NOTE_LINE * (1 + note.count("\n")) / height
            engine: Any = self.figure.get_layout_engine()
            engine.set(rect=(0.0, room, 1.0, 1.0 - room))
            self.figure.text(0.995, 0.0, note, color="0.35", ha="right", va="bottom")
        return self.figure


def columns_of(count: int) -> int:
    """Return how many of some panels stand in a row."""
    return 2 if count == 4 else min(3, count)  # noqa: PLR2004 - a square


def is_narrow(figure: "Figure") -> bool:
    """Whether a figure is as wide as a column of a paper, or less."""
    return float(figure.get_size_inches()[0]) <= COLUMN_WIDTH


def label_rows(axes: "Axes", names: Sequence[str]) -> None:
    """Name the rows of a panel, 0, 1, ...; a narrow figure breaks long names into lines."""
    figure: Any = axes.figure
    if is_narrow(figure):
        names = [fill(name, _LONG_LABEL) for name in names]
    axes.set_yticks(np.arange(len(names)), names)


def set_title(axes: "Axes", title: str) -> None:
    """Write the title of a panel in as many lines as it needs."""
    spec = axes.get_subplotspec()
    columns = 1 if spec is None else spec.get_gridspec().ncols
    figure: Any = axes.figure
    width = float(figure.get_size_inches()[0]) / columns
    axes.set_title(_filled(title, width, TEXT_SIZE))


def _filled(text: str, width: float, size: float) -> str:
    """Break a text into lines of a width [inch] for letters of a size [pt]."""
    letters = max(1, int(width * 72.0 / (_LETTER * size)))
    return "\n".join(fill(line, letters) for line in text.split("\n"))


def line_style(index: int) -> dict[str, Any]:
    """Choose color and dashes of the line at a place among others.

    Later lines have longer gaps, so that one remains visible beneath the next.
    """
    turn, color = divmod(index, len(PALETTE))
    return {"color": PALETTE[color], "linestyle": _DASHES[(color + turn) % len(_DASHES)]}


def marker_style(index: int) -> dict[str, Any]:
    """Choose color and marker of the points at a place among others.

    A color that repeats has another marker.
    """
    turn, color = divmod(index, len(PALETTE))
    return {"color": PALETTE[color], "marker": "osD^vPX"[(color + turn) % 7]}


def dot_style(index: int, size: float = 3.5) -> dict[str, Any]:
    """Choose the look of points without a line, of a size [pt]."""
    return {**marker_style(index), "linestyle": "", "markersize": size}


def half_width(values: "pd.Series[float]") -> float:
    """Return half of the 95 % confidence interval of a mean; 0 of few values."""
    return float(np.nan_to_num(mean_std_ci95(np.asarray(values, np.float64))["ci95"]))


def bar_of(values: "pd.Series[float]", measure: Measure) -> tuple[float, float]:
    """Return how far the 95 % interval of the mean of a measure extends below and above it.

    Both are 0 of few structures.
    """
    if not measure.is_share:
        half = half_width(values)
        return half, half
    mean = values.mean()
    low, high = ends_of(measure, np.asarray(values, np.float64)).values()
    return (mean - low, high - mean) if values.count() >= FEWEST else (0.0, 0.0)


def mean_words(cases: "pd.Series[int]") -> str:
    """Name what markers and bars show of so many structures: few have no interval.

    >>> import pandas as pd
    >>> mean_words(pd.Series([2, 2])), mean_words(pd.Series([4, 25])), mean_words(pd.Series([1]))
    ('mean over 2 structures', 'mean and 95 % interval, 4 to 25 structures', '1 structure')
    """
    least = int(cases.min())
    most = int(cases.max())
    count = counted(most, "structure") if least == most else f"{least} to {most} structures"
    if most >= FEWEST:
        return f"mean and 95 % interval, {count}"
    return f"mean over {count}" if most > 1 else count


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
    bounds: Any = getattr(axes, f"set_{which}lim")
    positive = values[values > 0.0]
    span = float(positive.max() / positive.min()) if len(positive) else 1.0
    if span <= _MOST_LINEAR:
        bounds(0.0, None)
        return
    set_log(axes, which, span, nonpositive=nonpositive)
    if others is not None:
        positive = np.concatenate([positive, others[others > 0.0]])
    bounds(0.6 * positive.min(), None)


def set_log(axes: "Axes", which: str, span: float = np.inf, *, nonpositive: str = "mask") -> None:
    """Make the axis x or y logarithmic, with labels in plain text.

    Args:
        axes: Panel.
        which: "x" or "y".
        span: Ratio of the values that are drawn; three labels a decade where it is small.
        nonpositive: Whether what is not positive is left out ("mask"), or at the end ("clip").
    """
    from matplotlib.ticker import LogLocator, NullLocator

    getattr(axes, f"set_{which}scale")("log", nonpositive=nonpositive)
    axis: Axis = getattr(axes, f"{which}axis")
    few = span < _MOST_LABELS
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0) if span < _FEW_STEPS else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=steps if few else (1.0,)))
    # Each tick costs 2 ms of a layout: two between powers of ten show the scale.
    axis.set_minor_locator(NullLocator() if few else LogLocator(subs=(2.0, 5.0)))
    label_plainly(axis)


def label_plainly(axis: "Axis") -> None:
    """Write the numbers of an axis as text: matplotlib writes powers of ten as formulas."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(FuncFormatter(lambda value, _: plain_number(value)))
    axis.set_minor_formatter(NullFormatter())


def plain_number(value: float) -> str:
    """Write a number with at most six digits, large and small ones with a power of ten.

    >>> [plain_number(value) for value in (0.05, 1000, 1e5, 2e-4, 0)]
    ['0.05', '1000', '10⁵', '2·10⁻⁴', '0']
    """
    if value == 0.0 or _EXACT[0] <= abs(value) < _EXACT[1]:
        return f"{value:g}"
    digits, _, power = f"{value:e}".partition("e")
    raised = str(int(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    factor = f"{float(digits):g}"
    return f"10{raised}" if factor == "1" else f"{factor}·10{raised}"


def entries_of(axes: "Axes") -> "dict[str, Artist]":
    """Gather what the legend of a panel lists, by label in the order of drawing."""
    handles, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


def omission_note(count: int, noun: str, remark: str) -> str:
    """Write a note on what a figure lacks, and a remark on it; empty if it lacks nothing.

    >>> omission_note(2, "row", "in table.csv")
    '2 more rows in table.csv'
    """
    return f"{counted(count, f'more {noun}')} {remark}" if count else ""


def legend_columns(names: Sequence[str], width: float, max_columns: int = 4) -> int:
    """Return how many columns of a legend fit into a width [inch]."""
    for columns in range(min(max_columns, len(names)), 1, -1):
        longest = [max(map(len, group)) for group in np.array_split([*names], columns)]
        if columns * _LEGEND_MARK + _LEGEND_LETTER * sum(longest) <= width:
            return columns
    return 1


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


ENCODERS = {".png": png, ".pdf": pdf}
"""What encodes a figure, by the end of the file's name."""


def write(path: Path, draw: Callable[[], "Figure"], outputs: Outputs = NEW) -> None:
    """Draw a figure in our style, and write it in the format that its name ends in.

    Raises:
        InputError: the name ends in no format, or the file exists and is to stay.
    """
    from matplotlib import style

    if path.suffix not in ENCODERS:
        listed = " or ".join(ENCODERS)
        raise InputError(f"{path.name!r} should end in {listed}; rename it", argument="out")
    with style.context(["default", STYLE]):
        data = ENCODERS[path.suffix](draw())
    outputs.write(path, data)


def _encoded(
    figure: "Figure", canvas: "type[FigureCanvasBase]", form: str, metadata: dict[str, None]
) -> bytes:
    """Encode a figure that is laid out once; `savefig` would draw it once more before."""
    from matplotlib import style

    lay_out(figure)
    stream = io.BytesIO()
    canvas_before = figure.canvas
    with style.context(["default", STYLE]):  # also names clip paths, and writes letters as text
        getattr(canvas(figure), f"print_{form}")(stream, metadata=metadata)
    figure.set_canvas(canvas_before)
    return stream.getvalue()


def lay_out(figure: "Figure") -> None:
    """Place the panels of a figure for good; a second call changes nothing.

    The layout's solver orders variables by where they are in memory, so its last digits vary, and
    SVG names clip paths by them.
    """
    engine: Any = figure.get_layout_engine()
    engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        x, y, width, height = np.round(axes.get_position(original=True).bounds, _PLACES)
        axes.set_position((x, y, width, height))
