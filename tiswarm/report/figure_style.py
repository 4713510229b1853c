"""What all figures share: colors, sizes, and how one becomes a file."""

import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

TRUE_BLUE = "#0072B2"
ESTIMATE_ORANGE = "#E69F00"
PALETTE = (TRUE_BLUE, ESTIMATE_ORANGE, "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
"""Colors that stay apart for color-blind readers (Okabe and Ito)."""

LINE_STYLES = ("-", "--", ":")
MARKERS = "osD^vPX"
COLUMN_WIDTH = 3.5
"""Width of a paper's column [inch]."""

PAGE_WIDTH = 7.0
"""Width of a paper's page [inch]."""

NOTE_HEIGHT = 0.1
"""Room for a note below a figure [inch]."""

DPI = 300
"""Dots per inch."""

STYLE: dict[Any, Any] = {
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 8.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "pdf.fonttype": 42,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure of a size [inch] that lays itself out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def panel_grid(
    figure: "Figure", count: int, columns: int, *, sharex: bool = False, sharey: bool = False
) -> "list[Axes]":
    """Make so many panels in rows of so many columns."""
    rows = -(-count // columns)
    grid = figure.subplots(rows, columns, sharex=sharex, sharey=sharey, squeeze=False).ravel()
    for unused in grid[count:]:
        unused.set_axis_off()
    return list(grid[:count])


def line_style(place: int) -> dict[str, Any]:
    """Color and dashes of the line at a place among others."""
    dashes = LINE_STYLES[place // len(PALETTE) % len(LINE_STYLES)]
    return {"color": PALETTE[place % len(PALETTE)], "linestyle": dashes}


def dot_area(count: int) -> float:
    """Shrink dots as they get many, so that a cloud stays a cloud [pt^2]."""
    return float(np.clip(9000.0 / max(count, 1), 1.0, 12.0))


def shortened(name: str) -> str:
    """Name of a point of a sweep without the sections of its keys, as `tower, settle=true`."""
    return re.sub(r"(?:[a-z_]+\.)+(?=[a-z_]+=)", "", name.replace("structure.kind=", ""))


def add_note(figure: "Figure", note: str) -> None:
    """Write a small line into the lower right corner, below everything else."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    if not note:
        return
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        line = NOTE_HEIGHT / float(figure.get_size_inches()[1])
        engine.set(rect=(0.0, line, 1.0, 1.0 - line))
    figure.text(0.995, 0.0, note, fontsize=5.5, color="0.35", ha="right", va="bottom")


def png(figure: "Figure") -> bytes:
    """Encode a figure in bytes that depend on nothing but what it shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stream = io.BytesIO()
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def pdf(figure: "Figure") -> bytes:
    """Encode a figure as vectors, in bytes that depend on nothing but what it shows."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    stream = io.BytesIO()
    canvas: Any = FigureCanvasPdf(figure)
    canvas.print_pdf(stream, metadata={"CreationDate": None, "Creator": None, "Producer": None})
    return stream.getvalue()
