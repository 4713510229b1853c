"""Tables of a run as data frames: written whole, read with errors by file, line and column.

Tables of users are read by `records.io.CsvFile`, which names the line of every mistake and imports
no pandas. Tables of a run are our own, and may have a million rows, for which text would take too
much memory. The centers of an estimate at some iterations have the table `trace.csv`.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import Opener, damaged, replacing, run_file, way_back, write_bytes

_GREATEST = 1e12
"""Greatest number of a table: above, sums of squares and pictures lose all digits."""


def write_frame(table: pd.DataFrame, path: Path, *, opened: Opener = replacing) -> None:
    """Write a CSV whose numbers read back to the same bits."""
    with opened(path) as file:
        file.write(table.to_csv(index=False, lineterminator="\n").encode())


def read_frame(
    path: Path,
    words: Sequence[str] = (),
    numbers: Sequence[str] = (),
    *,
    gaps: Sequence[str] = (),
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
        notes: Columns of text that it may have.
        numbers_after: Column that it must have; columns after it are of this kind, `robots` too.
            Those before it have words, unless they are listed.
        empty: Whether the table may have no rows; it then needs no columns of numbers.

    Raises:
        InputError: the table is missing or malformed; names file, line and column.
    """
    run_file(path)
    read: dict[str, Any] = {
        # Only empty cells are unknown: a condition may be called `NA` or `null`.
        "keep_default_na": False, "na_values": [""],
        # The quicker default is wrong in the last bit of half of all numbers.
        "float_precision": "round_trip",
        "low_memory": False,
    }  # fmt: skip
    file = path.absolute()  # pandas takes a folder named ~ for the home of the user
    try:
        found = list(pd.read_csv(file, nrows=0, **read).columns)
        before = found[: found.index(numbers_after)] if numbers_after in found else []
        named = {*before} - {*numbers, *gaps, "robots"} | {*words, *notes}
        table: pd.DataFrame = pd.read_csv(file, dtype=dict.fromkeys(named, str), **read)
    except (OSError, ValueError) as error:
        raise damaged(path, error) from error
    if not isinstance(table.index, pd.RangeIndex):
        raise damaged(path, "rows have more cells than the header")
    columns = [*numbers, *gaps]
    if table.empty and empty:
        table = table.reindex(columns=list(dict.fromkeys([*found, *columns])))
    for column in filter(None, [*words, *columns, numbers_after]):
        if column not in table:
            problem = f"there is no such column; {way_back(path)}"
            raise InputError(problem, path=path, line=1, key=column)
    if table.empty and not empty:
        raise InputError(f"there are no rows; {way_back(path)}", path=path, line=2)
    after = found[found.index(numbers_after) + 1 :] if numbers_after else []
    after = [name for name in after if name not in notes]
    swept = [name for name in found if name == "robots"]
    for column in [*columns, *after, *swept]:
        if table[column].dtype == object:  # as pandas reads True beside an empty cell
            table[column] = table[column].map(_truth_as_number).infer_objects()
        _check_numbers(table[column], path, gaps=column not in numbers)
    return table.copy()  # pandas 3 reads columns into pieces, and warns of more of them


def _check_numbers(cells: pd.Series, path: Path, *, gaps: bool) -> None:
    """Refuse the first cell that is no finite number of a usual size."""
    # `to_numeric` crashes the process on text such as 1e4001234567.
    numbers = cells if pd.api.types.is_numeric_dtype(cells) else cells.map(_as_number)
    is_number = numbers.abs() <= _GREATEST
    wrong = cells[~(is_number | cells.isna()) if gaps else ~is_number]
    if len(wrong):
        cell = wrong.iloc[0]
        text = "an empty cell" if pd.isna(cell) else repr(str(cell)[:40])
        problem = f"{text} is not a number up to {_GREATEST:g}; {way_back(path)}"
        raise InputError(problem, path=path, line=int(wrong.index[0]) + 2, key=str(cells.name))


def _truth_as_number(cell: object) -> object:
    """Replace True by 1 and False by 0."""
    return float(cell) if isinstance(cell, bool) else cell


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
