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
from tiswarm.report.swarm_view import POSE, SD, Coloring

_OURS = ("error", SD, "sensed force")


def read_colorings(
    given: "str | pd.Series[Any] | Sequence[str | pd.Series[Any]]", robots: Ints
) -> tuple[Coloring, ...]:
    """Read values that color robots.

    Args:
        given: Column of a table, as `FILE:COLUMN`, or a series of pandas whose index has the names
            of robots and whose name is that of the column; or several of these. A unit stands in
            brackets: `charge [V]`.
        robots: Name of each robot, shape (N,).

    Returns:
        Values in the order of the robots. Those without a row or a value are unknown.

    Raises:
        InputError: there is no such column, a row has no robot of these, or a cell is not as the
            first one, a number or a label; names file and line.
    """
    return tuple(
        _coloring(*_named_column(each), robots, is_text=_is_text(each))
        for each in ([given] if isinstance(given, str | pd.Series) else given)
    )


def _named_column(given: "str | pd.Series[Any]") -> tuple[CsvFile, str]:
    """Find the table and the column of values."""
    if isinstance(given, pd.Series):
        name = str(given.name or "value")
        text = given.rename(name).rename_axis("robot").to_csv()
        return CsvFile(Path("series"), text), name
    splits = [(given[:k], given[k + 1 :]) for k, letter in enumerate(given) if letter == ":"]
    if not splits:
        problem = f"{given!r} names no column; write it like values.csv:charge"
        raise InputError(problem, argument="color")
    file, name = next((each for each in splits if Path(each[0]).is_file()), splits[-1])
    return CsvFile(Path(file)), name.strip()


def _is_text(given: "str | pd.Series[Any]") -> bool:
    """Whether a series has labels by its type; tables say so by their cells."""
    kinds = ("string", "categorical")
    return isinstance(given, pd.Series) and pd.api.types.infer_dtype(given) in kinds


def _coloring(table: CsvFile, name: str, robots: Ints, *, is_text: bool) -> Coloring:
    """Take the values of a column by robot."""
    column, first = name, find_column(table.columns, "robot")
    if column not in table.columns:
        column = next((other for other in table.columns if _bare(other) == name), name)
    if not first:
        problem = "no column has numbers of robots; call one robot"
        raise InputError(problem, path=table.path, line=1)
    if column not in table.columns:
        some = ", ".join(other for other in table.columns if other != first)
        problem = f"there is no such column; choose one of {some}"
        raise InputError(problem, path=table.path, line=1, key=name)
    equal = [name for name in table.columns if _bare(name) == _bare(column)]
    if table.columns.count(column) > 1 or (column != name and len(equal) > 1):
        problem = f"{len(equal)} columns are called {_bare(column)}; rename all but one of them"
        raise InputError(problem, path=table.path, line=1, key=name)
    table.drop(table.incomplete([column]))
    place = {robot: n for n, robot in enumerate(robots.tolist())}
    row_of: dict[int, int] = {}
    for row, robot in enumerate(robots_of(table, first).tolist()):
        problem = f"robot {robot} has a row already; keep one" if robot in row_of else ""
        if robot not in place:
            problem = f"there is no robot {robot}; robots are {min(place)} to {max(place)}"
        if problem:
            raise InputError(problem, path=table.path, line=table.line(row), key=first)
        row_of[robot] = row
    label, _, unit = map(str.strip, re.split(r"([\[(])", f"{column}[", maxsplit=1))
    label += f" of {table.path.name}" * (label in _OURS)
    cells, value = table.words(column).tolist(), np.full(len(robots), np.nan)
    words = [*dict.fromkeys(map(str.strip, cells))] if is_text or _are_labels(cells) else []
    if len(words) > len(LABEL_COLORS):
        problem = f"has {len(words)} labels; give numbers, or at most {len(LABEL_COLORS)} labels"
        raise InputError(problem, path=table.path, line=1, key=column)
    found = [words.index(cell.strip()) for cell in cells] if words else table.numbers(column)
    value[[place[robot] for robot in row_of]] = found
    scale = "labels" if words else "joins"
    least = 0.0 if words else float(min(found))
    return Coloring(label, unit.strip("])[ "), value, scale, least, words)


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


def colored(run: RunData, given: Any, name: str | None) -> RunData:  # noqa: ANN401 - as above
    """Color a case, and those of the same structure, by values as `read_colorings` takes them.

    Args:
        run: The run.
        given: The values.
        name: Name of the case; the first of the largest if None.

    Raises:
        InputError: there is no such case, or a table is wrong.
    """
    case = run.choose(name)
    robots = case.columns("robots.csv", ["robot"])[:, 0].astype(np.int64)
    own, pose = read_colorings(given, robots), _poses(case)
    alike = [each for each in run.cases if each.done and each.robots == case.robots]
    alike = [each for each in alike if np.array_equal(_poses(each), pose)]
    return replace(run, user_colorings={each.name: own for each in alike})


def _poses(case: StoredCase) -> Reals:
    return case.columns("robots.csv", POSE)
