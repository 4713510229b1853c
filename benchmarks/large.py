"""Draws size, share beyond the crowd, and peak stress of large structures against N.

    tiswarm run scenarios/large-structures.yaml --no-pictures
    python -m benchmarks.results reports/large-structures-* --write
    python -m benchmarks.large

The figure is of `docs/results.csv`: the scenario large-structures, by its law and by the defaults.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks import result_texts, statements
from benchmarks.results import read_results
from tiswarm.report.figure_style import PAGE_WIDTH, STYLE, new_figure, png

if TYPE_CHECKING:
    from matplotlib.axis import Axis

FILE = Path("docs/images/large-structures.png")

_LOOKS = {
    ("tower", True): ("#0072B2", "o", "-", "tower by the law"),
    ("tower", False): ("#0072B2", "o", "--", "tower by the defaults, a heap"),
    ("cantilever", True): ("#D55E00", "s", "-", "cantilever by the law"),
    ("cantilever", False): ("#D55E00", "s", "--", "cantilever by the defaults, a heap"),
}
"""Color, marker, line and name of each series, by kind and whether it is of the law."""


def draw(results: result_texts.Results) -> bytes:
    """Draw three panels against the number of robots, and return a PNG."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(PAGE_WIDTH, 2.9)
        sizes, shares, peaks = figure.subplots(1, 3)
        for (kind, by_law), (color, marker, line, name) in _LOOKS.items():
            points = {
                robots: point
                for of_kind, robots in statements.LARGE
                if of_kind == kind
                and (point := statements.large_point(kind, robots, by_law=by_law))
            }
            for axes, measure, factor in (
                (sizes, statements.LARGE_SIZES[kind], 1.0),
                (shares, statements.LARGE_SHARES[kind], 100.0),
                (peaks, "peak_stress", 1.0),
            ):
                means = [statements.of_large(results, p, measure).mean for p in points.values()]
                axes.plot(
                    [*points], [factor * mean for mean in means],
                    color=color, marker=marker, linestyle=line, markersize=4.0, label=name,
                    markerfacecolor=color if by_law else "white",
                )  # fmt: skip
        sizes.set(xscale="log", yscale="log", ylabel="Height, or reach beyond the edge [R]")
        shares.set(
            xscale="log", ylim=(0.0, 100.0), ylabel="Robots above 20 R, or beyond the edge [%]"
        )
        peaks.set(xscale="log", yscale="log", ylabel="Peak stress of a dock [W / R²]")
        for axes in (sizes, shares, peaks):
            axes.set_xlabel("Robots N")
            _tick(axes.xaxis, (300, 1_000, 3_000, 10_000))
        _tick(sizes.yaxis, (30, 100, 300, 600))
        _tick(peaks.yaxis, (300, 1_000, 3_000, 10_000, 30_000))
        figure.legend(*sizes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return png(figure)


def _tick(axis: "Axis", ticks: Sequence[int]) -> None:
    """Write plain numbers on a logarithmic axis."""
    axis.set_ticks(ticks, [f"{tick:,}" for tick in ticks])
    axis.set_ticks([], minor=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the figure; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.large",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=FILE, help="its file")
    options = parser.parse_args(arguments)
    options.out.write_bytes(draw(result_texts.Results(read_results())))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
