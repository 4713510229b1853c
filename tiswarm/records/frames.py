"""Tables of a run as data frames: written whole, read with errors by file, line and column.

Tables of users are read by `records.io.CsvFile`, which names the line of every mistake and imports
no pandas. Tables of a run are our own, and may have a million rows, for which text would take too
much memory. The centers of an estimate at some iterations have the table `trace.csv`.
"""

import math
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import Opener, damaged, replacing, run_file, way_back, write_bytes

GREATEST = 1e12
"""Greatest number of a table: above, sums of squares and pictures lose all digits."""

_KEPT_B = 1_000_000
"""Size of files that stay in memory as tables: figures, page and sentences read the same ones."""


def write_frame(table: pd.DataFrame, path: Path, *, opened: Opener = replacing) -> None:
    """Write a CSV whose numbers read back to the same bits."""
    with opened(path) as file:
        file.write(table.to_csv(index=False, lineterminator="\n").encode())


_FORMULA = re.compile(r"[=+\-@\t\r]")
"""How cells begin that spreadsheets compute."""


def csv_text(table: pd.DataFrame) -> str:
    """Write a table for people as CSV.

    Spreadsheets compute words that begin like a formula: an apostrophe before them makes them text.
    Numbers stay as they are, with every bit.
    """
    written = table.copy()
    for place, (_, cells) in enumerate(table.items()):
        if not pd.api.types.is_numeric_dtype(cells):
            written.isetitem(place, cells.map(_not_computed).to_numpy())
    heading = [str(_not_computed(name)) for name in table]
    return written.to_csv(index=False, header=heading, lineterminator="\n")


def _not_computed(cell: object) -> object:
    """Put an apostrophe before a text that spreadsheets would compute; numbers stay."""
    if not isinstance(cell, str) or not _FORMULA.match(cell):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def read_frame(
    path: Path,
    words: Sequence[str] = (),
    numbers: Sequence[str] = (),
    *,
    gaps: Sequence[str] = (),
    optional: Sequence[str] = (),
    notes: Sequence[str] = (),
    numbers_after: str = "",
    empty: bool = False,
) -> pd.DataFrame:
    """Read a table of a run.

    Args:
        path: CSV file.
        words: Columns of text that the table must have; an empty cell is NaN.
        numbers: Columns of numbers that it must have, without an empty cell.
        gaps: Columns of numbers that it must have, where an empty cell is NaN.
        optional: Columns of numbers that it may have, where an empty cell is NaN.
        notes: Columns of text that it may have.
        numbers_after: Column that it must have; columns after it are of this kind, `robots` too.
            Those before it have words, unless they are listed.
        empty: Whether the table may have no rows; it then needs no columns of numbers.

    Raises:
        InputError: the table is missing or malformed; names file, line and column.
    """
    run_file(path)
    try:
        header = list(_stored(path, None).columns)
        before = header[: header.index(numbers_after)] if numbers_after in header else []
        named = {*before} - {*numbers, *gaps, "robots"} | {*words, *notes}
        # A copy is the caller's own, in one piece: pandas 3 warns of columns that it read apart.
        table = _stored(path, frozenset(named)).copy()
    except (OSError, ValueError) as error:
        raise damaged(path, error) from error
    if not isinstance(table.index, pd.RangeIndex):
        raise damaged(path, "rows have more cells than the header")
    columns = [*numbers, *gaps, *(name for name in optional if name in table)]
    if table.empty and empty:
        table = table.reindex(columns=list(dict.fromkeys([*header, *columns])))
    for column in filter(None, [*words, *columns, numbers_after]):
        if column not in table:
            problem = f"there is no such column; {way_back(path)}"
            raise InputError(problem, path=path, line=1, key=column)
    if table.empty and not empty:
        raise InputError(f"there are no rows; {way_back(path)}", path=path, line=2)
    after = header[header.index(numbers_after) + 1 :] if numbers_after else []
    after = [name for name in after if name not in notes]
    swept = [name for name in header if name == "robots"]
    _check_numbers(table, [*columns, *after, *swept], path, complete=numbers)
    return table


def _stored(path: Path, words: frozenset[str] | None) -> pd.DataFrame:
    """Parse a CSV, or return what was parsed of a small one since it was written."""
    file = path.absolute()  # pandas takes a folder named ~ for the home of the user
    state = file.stat()
    parse = _parsed if state.st_size <= _KEPT_B else _parsed.__wrapped__
    return parse(file, (state.st_ino, state.st_mtime_ns, state.st_size), words)


@lru_cache(maxsize=64)
def _parsed(
    file: Path,
    version: tuple[int, ...],  # noqa: ARG001 - a file that has changed is read again
    words: frozenset[str] | None,
) -> pd.DataFrame:
    """Read a CSV with some columns of text; its header alone if they are None."""
    return pd.read_csv(
        file,
        nrows=0 if words is None else None,
        dtype=dict.fromkeys(words or (), str),
        # Only empty cells are unknown: a condition may be called `NA` or `null`.
        keep_default_na=False,
        na_values=[""],
        # The quicker default is wrong in the last bit of half of all numbers.
        float_precision="round_trip",
        low_memory=False,
    )


def _are_usual(table: pd.DataFrame, *, gaps: bool = True) -> bool:
    """Whether all cells are numbers of a usual size, or unknown where they may be."""
    if not all(kind.kind in "biuf" for kind in table.dtypes):
        return False
    size = np.abs(table.to_numpy(float))
    return bool(((size <= GREATEST) | (np.isnan(size) & gaps)).all())


def _check_numbers(
    table: pd.DataFrame, columns: Sequence[str], path: Path, *, complete: Sequence[str]
) -> None:
    """Turn truth into numbers, and refuse the first cell that is no number of a usual size.

    Cells may be unknown but in the columns `complete`.
    """
    for column in columns:
        if table[column].dtype == object:  # as pandas reads True beside an empty cell
            cells = table[column].map(lambda cell: float(cell) if isinstance(cell, bool) else cell)
            table[column] = cells.infer_objects()
    if not (_are_usual(table[[*columns]]) and _are_usual(table[[*complete]], gaps=False)):
        for column in columns:  # where it is takes a hundred times as long
            _check_column(table[column], path, gaps=column not in complete)


def _check_column(cells: pd.Series, path: Path, *, gaps: bool) -> None:
    """Refuse the first cell that is no finite number of a usual size."""
    # `to_numeric` crashes the process on text such as 1e4001234567.
    numbers = cells if pd.api.types.is_numeric_dtype(cells) else cells.map(_as_number)
    is_number = numbers.abs() <= GREATEST
    wrong = cells[~(is_number | cells.isna()) if gaps else ~is_number]
    if len(wrong):
        cell = wrong.iloc[0]
        text = "an empty cell" if pd.isna(cell) else repr(str(cell)[:40])
        problem = f"{text} is not a number up to {GREATEST:g}; {way_back(path)}"
        raise InputError(problem, path=path, line=int(wrong.index[0]) + 2, key=str(cells.name))


def _as_number(cell: object) -> float:
    """Read a cell as a number; NaN where it is none."""
    try:
        return float(str(cell)) if "_" not in str(cell) else math.nan
    except ValueError:
        return math.nan


MOST_ROBOTS = 1_000
"""Robots of an estimate beyond which no trace is stored: it would outgrow the log."""

_MOST_FRAMES = 24
_DIGITS = 3  # decimals of a coordinate
_TRACE = ["iteration", "robot", "x_R", "y_R", "z_R"]


class EstimateTrace(NamedTuple):
    """Centers of N robots at K iterations."""

    iteration: Ints  # ascending, shape (K,)
    center: Reals  # shape (K, N, 3)


def thinned(estimate: Estimate) -> EstimateTrace | None:
    """Take a few iterations of an estimate in its unit, the last one too; None if it has no two."""
    frames = len(estimate.trace)
    if frames < 2 or len(estimate.robot_id) > MOST_ROBOTS:  # noqa: PLR2004 - no motion
        return None
    kept = np.linspace(0, frames - 1, min(frames, _MOST_FRAMES)).round().astype(int)
    return EstimateTrace(estimate.iteration[kept], estimate.trace[kept])


def write_trace(path: Path, estimate: Estimate) -> None:
    """Write a row for each iteration and robot [R]; nothing if there is no motion to show."""
    trace = thinned(estimate)
    if trace is None:
        return
    lines = [",".join(_TRACE)]
    for iteration, center in zip(trace.iteration.tolist(), trace.center.tolist(), strict=True):
        for robot, (x, y, z) in zip(estimate.robot_id.tolist(), center, strict=True):
            lines.append(f"{iteration},{robot},{x:.{_DIGITS}f},{y:.{_DIGITS}f},{z:.{_DIGITS}f}")
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def read_trace(path: Path, robots: int) -> EstimateTrace | None:
    """Read the trace of an estimate of N robots [R]; None if none was stored.

    Raises:
        InputError: the table is damaged.
    """
    if not path.exists():
        return None
    table = read_frame(path, numbers=_TRACE)[_TRACE].to_numpy(float)
    if len(table) % robots or len(table) < 2 * robots:
        raise damaged(path, f"its {len(table)} rows are no iterations of {robots} robots")
    frames = table.reshape(-1, robots, len(_TRACE))
    return EstimateTrace(frames[:, 0, 0].astype(np.int64), frames[:, :, 2:])
