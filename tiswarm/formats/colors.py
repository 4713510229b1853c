"""Values of robots from tables of a user, which color robots in views, pictures and exports."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.formats.columns import find_column, robots_of
from tiswarm.records.io import CsvFile
from tiswarm.report.figure_style import LABEL_COLORS
from tiswarm.report.run_data import RunData, StoredCase
from tiswarm.report.swarm_view import MARGIN_LABEL, POSE, SD, Coloring

_LABELS_OF_VIEWS = ("error", SD, "sensed force", MARGIN_LABEL)


def read_colorings(
    sources: "str | pd.Series[Any] | Sequence[str | pd.Series[Any]]", robots: Ints
) -> tuple[Coloring, ...]:
    """Read values that color robots.

    Args:
        sources: Column of a table, as `FILE:COLUMN`, or a series of pandas whose index has names
            of robots and whose name is that of the column; or several. A unit stands in
            brackets: `charge [V]`.
        robots: Name of each robot, shape (N,).

    Returns:
        Values in the order of the robots. Those without a row or a value are unknown.

    Raises:
        InputError: there is no such column, a row has no robot of these, or a cell is not as the
            first one, a number or a label; names file and line.
    """
    return tuple(
        _coloring(*_named_column(source), robots, is_text=_is_text(source))
        for source in ([sources] if isinstance(sources, str | pd.Series) else sources)
    )


def _named_column(source: "str | pd.Series[Any]") -> tuple[CsvFile, str]:
    """Find the table and the column of values."""
    if isinstance(source, pd.Series):
        name = str(source.name or "value")
        text = source.rename(name).rename_axis("robot").to_csv()
        return CsvFile(Path("series"), text), name
    splits = [(source[:k], source[k + 1 :]) for k, letter in enumerate(source) if letter == ":"]
    if not splits:
        problem = f"{source!r} names no column; write it like values.csv:charge"
        raise InputError(problem, argument="color")
    file, name = next((split for split in splits if Path(split[0]).is_file()), splits[-1])
    return CsvFile(Path(file)), name.strip()


def _is_text(source: "str | pd.Series[Any]") -> bool:
    """Whether a series has labels by its type; tables say so by their cells."""
    kinds = ("string", "categorical")
    return isinstance(source, pd.Series) and pd.api.types.infer_dtype(source) in kinds


def _coloring(table: CsvFile, name: str, robots: Ints, *, is_text: bool) -> Coloring:
    """Take the values of a column by robot."""
    robot_column = find_column(table.columns, "robot")
    if not robot_column:
        problem = "no column has numbers of robots; call one robot"
        raise InputError(problem, path=table.path, line=1)
    column = _column_called(name, table, robot_column)
    table.drop(table.incomplete([column]))
    places = _places_of_rows(table, robot_column, robots)
    label, _, unit = re.split(r"([\[(])", f"{column}[", maxsplit=1)
    label = label.strip()
    unit = unit.strip().strip("])[ ")
    if label in _LABELS_OF_VIEWS:
        label += f" of {table.path.name}"
    cells: list[str] = table.words(column).tolist()
    words: list[str] = []
    if is_text or _are_labels(cells):
        words = [*dict.fromkeys(cell.strip() for cell in cells)]
    if len(words) > len(LABEL_COLORS):
        problem = f"has {len(words)} labels; give numbers, or at most {len(LABEL_COLORS)} labels"
        raise InputError(problem, path=table.path, line=1, key=column)
    value = np.full(len(robots), np.nan)
    if words:
        value[places] = [words.index(cell.strip()) for cell in cells]
        return Coloring(label, unit, value, "labels", 0.0, words)
    numbers = table.numbers(column)
    value[places] = numbers
    return Coloring(label, unit, value, "joins", float(min(numbers)))


def _column_called(name: str, table: CsvFile, robot_column: str) -> str:
    """Find a column by its name, with its unit or without.

    Raises:
        InputError: there is none, or there are several.
    """
    column = name
    if name not in table.columns:
        column = next((heading for heading in table.columns if _bare(heading) == name), name)
    if column not in table.columns:
        listed = ", ".join(heading for heading in table.columns if heading != robot_column)
        problem = f"there is no such column; choose one of {listed}"
        raise InputError(problem, path=table.path, line=1, key=name)
    equal = [heading for heading in table.columns if _bare(heading) == _bare(column)]
    if table.columns.count(column) > 1 or (column != name and len(equal) > 1):
        problem = f"{len(equal)} columns are called {_bare(column)}; rename all but one of them"
        raise InputError(problem, path=table.path, line=1, key=name)
    return column


def _places_of_rows(table: CsvFile, robot_column: str, robots: Ints) -> list[int]:
    """List the place of each row's robot among all robots.

    Raises:
        InputError: there is no such robot, or it has two rows.
    """
    place_of = {robot: n for n, robot in enumerate(robots.tolist())}
    row_of: dict[int, int] = {}
    for row, robot in enumerate(robots_of(table, robot_column).tolist()):
        problem = f"robot {robot} has a row already; keep one" if robot in row_of else ""
        if robot not in place_of:
            problem = f"there is no robot {robot}; robots are {min(place_of)} to {max(place_of)}"
        if problem:
            raise InputError(problem, path=table.path, line=table.line(row), key=robot_column)
        row_of[robot] = row
    return [place_of[robot] for robot in row_of]


def _bare(column: str) -> str:
    """Return the name of a column without its unit."""
    return re.sub(r"\s*[\[(].*", "", column)


_NUMBER = re.compile(r"[-+]?(\d+[.,]?|\d*[.,](\d+))(e[-+]?\d+)?", re.IGNORECASE)
_CODE = re.compile(r"[-+]?0\d+|[-+]?\d{16,}")
"""Digits that are no number, or that a real number of 64 bits would round."""


def _are_labels(cells: Sequence[str]) -> bool:
    """Whether cells of a column are labels: words, dates, codes such as 01, versions such as 1.10.

    Digits are a label where a number would not keep them. Zeros at their end count if not all cells
    have as many decimals, which programs write otherwise.
    """
    texts = [cell.strip() for cell in cells]
    if not _NUMBER.fullmatch(texts[0]) or any(_CODE.fullmatch(text) for text in texts):
        return True
    numbers = [match for match in map(_NUMBER.fullmatch, texts) if match]
    decimals = [match[2] or "" for match in numbers]
    is_padded = any(len(digits) > 1 and digits.endswith("0") for digits in decimals)
    return is_padded and len({len(digits) for digits in decimals}) > 1


def colored(run: RunData, sources: Any, name: str | None) -> RunData:  # noqa: ANN401 - as above
    """Color a case, and those of the same structure, by values as `read_colorings` takes them.

    Args:
        run: The run.
        sources: The values.
        name: Name of the case; the first of the largest if None.

    Raises:
        InputError: there is no such case, or a table is wrong.
    """
    case = run.choose(name)
    robots = case.columns("robots.csv", ["robot"])[:, 0].astype(np.int64)
    colorings = read_colorings(sources, robots)
    pose = _poses(case)
    of_this_size = [stored for stored in run.cases if stored.done and stored.robots == case.robots]
    names = [stored.name for stored in of_this_size if np.array_equal(_poses(stored), pose)]
    return replace(run, user_colorings=dict.fromkeys(names, colorings))


def _poses(case: StoredCase) -> Reals:
    return case.columns("robots.csv", POSE)
