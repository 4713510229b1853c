"""Reads the tables that a run left in its folder."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiswarm.errors import EnvironmentTroubleError, InputError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row of `summary.csv`."""

    name: str
    """Name of its folder."""

    folder: Path
    done: bool
    condition: str = ""

    series: str = ""
    """Point of the sweep and condition, which cases of other seeds share."""

    point: str = ""
    """Values of the sweep, which cases of other seeds and conditions share; may be empty."""

    kind: str = ""
    """Kind of its structure."""

    robots: int = 0
    """Robots of its structure, if they are known."""


Series = dict[str, list[Case]]
"""Cases that are done, by series."""


def read_cases(folder: Path) -> list[Case]:
    """Read the cases of a run in the order of `summary.csv`.

    Raises:
        InputError: the folder holds no run.
    """
    path = folder / "summary.csv"
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [
                Case(
                    name=row["case"],
                    folder=folder / "cases" / row["case"],
                    done=row["status"] == "done",
                    condition=row.get("condition") or "",
                    series=row.get("series") or "",
                    point=row.get("point") or "",
                    kind=row.get("kind") or "",
                    robots=int(float(row.get("robots") or 0)),
                )
                for row in csv.DictReader(file)
            ]
    except (OSError, KeyError, ValueError, csv.Error) as error:
        problem = "holds no summary of a run; name a folder that `tiswarm run` made"
        raise InputError(problem, path=folder) from error


def choose_case(cases: list[Case], name: str | None, folder: Path) -> Case:
    """Find a case that is done by its name; the first of those with most robots if None.

    Raises:
        InputError: there is none.
    """
    done = [case for case in cases if case.done]
    found = done if name is None else [case for case in done if case.name == name]
    if found:
        return max(found, key=lambda case: case.robots)
    if not done:
        msg = "no case of this run is done; there is nothing to show"
        raise InputError(msg, path=folder)
    msg = f"no case {name!r} is done; choose one of {', '.join(case.name for case in done[:9])}"
    raise InputError(msg, path=folder, key="--case")


def read_table(
    path: Path, columns: Sequence[str] = (), numbers: Sequence[str] = ()
) -> "pd.DataFrame":
    """Read a table.

    Args:
        path: Where it is.
        columns: Columns that it must have.
        numbers: Columns that it must have and that hold numbers; what is empty is NaN.

    Raises:
        InputError: the table or a column is missing or damaged.
    """
    import pandas as pd  # noqa: PLC0415 - slow to import

    try:
        table = pd.read_csv(path).astype(dict.fromkeys(numbers, float))
        table[list(columns)]
    except (OSError, ValueError, KeyError) as error:
        problem = f"cannot be read: {error}; run the scenario again to restore it"
        raise InputError(problem, path=path) from error
    return table


def has_table(folder: Path, name: str) -> bool:
    """Whether a run has a table that not every run has."""
    return (folder / name).is_file()


def swept_columns(table: "pd.DataFrame", *, before: str = "cases") -> list[str]:
    """Columns that tell rows of a table apart: the condition and what is swept."""
    return list(table.columns[: table.columns.get_loc(before)])


def read_columns(path: Path, names: list[str]) -> NDArray[np.float64]:
    """Read columns of numbers as `read_table` does, shape (rows, names)."""
    return read_table(path, numbers=names)[names].to_numpy()


def subfolder(folder: Path, name: str) -> Path:
    """Make a folder for pictures within a run, or find it there.

    Raises:
        EnvironmentTroubleError: the run's folder is not writable.
    """
    place = folder / name
    try:
        place.mkdir(exist_ok=True)
    except OSError as error:
        problem = f"{place}: cannot be made: {error.strerror}; check the rights of its folder"
        raise EnvironmentTroubleError(problem) from error
    return place
