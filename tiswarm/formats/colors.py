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
        _coloring(*_named_column(each), robots)
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


def _coloring(table: CsvFile, name: str, robots: Ints) -> Coloring:
    """Take the values of a column by robot."""
    bare = {re.sub(r"\s*[\[(].*", "", column): column for column in table.columns}
    column, first = bare.get(name, name), find_column(table.columns, "robot")
    if not first:
        problem = "no column has numbers of robots; call one robot"
        raise InputError(problem, path=table.path, line=1)
    if column not in table.columns:
        some = ", ".join(other for other in table.columns if other != first)
        problem = f"there is no such column; choose one of {some}"
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
    is_number = re.fullmatch(r"\s*[-+]?[.,]?\d.*", cells[0])
    words = [] if is_number else [*dict.fromkeys(map(str.strip, cells))]
    if len(words) > len(LABEL_COLORS):
        problem = f"has {len(words)} labels; give numbers, or at most {len(LABEL_COLORS)} labels"
        raise InputError(problem, path=table.path, line=1, key=column)
    found = [words.index(cell.strip()) for cell in cells] if words else table.numbers(column)
    value[[place[robot] for robot in row_of]] = found
    scale = "labels" if words else "joins"
    least = 0.0 if words else float(min(found))
    return Coloring(label, unit.strip("])[ "), value, scale, least, words)


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
    return replace(run, own={each.name: own for each in alike})


def _poses(case: StoredCase) -> Reals:
    return case.columns("robots.csv", POSE)
