"""The figures of a run, by file name."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.progress import Progress
from tiswarm.records.io import write_bytes
from tiswarm.report.case_figures import (
    by_kind,
    draw_convergence,
    draw_error_against_height,
    draw_error_along_growth,
)
from tiswarm.report.figure_style import STYLE, pdf, png
from tiswarm.report.folder import Series, has_table, read_cases, subfolder
from tiswarm.report.positions_figure import draw_positions
from tiswarm.report.scaling_figure import draw_scaling, has_scaling
from tiswarm.report.table_figures import draw_accuracy, profile_painters

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_figures(folder: Path, progress: Progress, *, vector: bool = False) -> list[Path]:
    """Draw every figure of a run into `figures/`, as PNG and, if wanted, as vector PDF too.

    Cases that failed are left out, and a note on each figure says how many. A figure that an
    earlier call drew and that the run no longer has is removed; a PDF that is there is redrawn.

    Returns:
        The files written; empty where no case is done.

    Raises:
        InputError: where the folder holds no run or a table is damaged.
    """
    from matplotlib import style

    cases = read_cases(folder)
    series: Series = {}
    for case in cases:
        if case.done:
            series.setdefault(case.series, []).append(case)
    if not series:
        progress.info("no figures: no case is done")
        _remove_others(folder / "figures", [])
        return []
    failed = sum(not case.done for case in cases)
    note = f"{failed} of {len(cases)} cases failed and are left out" if failed else ""
    place = subfolder(folder, "figures")
    written = []
    for name, draw in _painters(folder, series, note).items():
        with style.context(["default", STYLE]):
            figure = draw()
            for suffix, encode in (("png", png), ("pdf", pdf)):
                path = place / f"{name}.{suffix}"
                if suffix == "png" or vector or path.exists():
                    write_bytes(path, encode(figure))
                    progress.info(f"figures/{path.name}")
                    written.append(path)
    _remove_others(place, written)
    return written


def _remove_others(place: Path, written: list[Path]) -> None:
    for path in {*place.glob("*.png"), *place.glob("*.pdf")} - set(written):
        path.unlink()


def _painters(folder: Path, series: Series, note: str) -> dict[str, Callable[[], "Figure"]]:
    """By file name, what draws each figure that a run has."""
    painters: dict[str, Callable[[], Figure]] = {
        name: partial(draw, series, note) for name, draw in FIGURES.items()
    }
    if kinds := by_kind(series):
        painters = {
            "convergence": painters["convergence"],
            "error-along-growth": partial(draw_error_along_growth, kinds, note),
        }
        for kind, of_kind in kinds.items():
            painters[f"positions-{kind}"] = partial(draw_positions, of_kind, note)
    if has_scaling(folder):
        painters["scaling"] = partial(draw_scaling, folder, note)
    if has_table(folder, "table.csv"):
        painters["accuracy"] = partial(draw_accuracy, folder, note)
    return painters | profile_painters(folder, note)


FIGURES: dict[str, Callable[[Series, str], "Figure"]] = {
    "convergence": draw_convergence,
    "error-against-height": draw_error_against_height,
    "positions": draw_positions,
}
"""File name and painter of each figure."""
