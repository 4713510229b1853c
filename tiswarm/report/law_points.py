"""Reads `law-points.csv`: means over structures, and the published forms fitted to them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiswarm.errors import InputError

Array = NDArray[np.float64]

FILE = "law-points.csv"
COLUMNS = ["x", "mean", "std", "structures", "fitted"]


@dataclass(frozen=True, kw_only=True)
class Points:
    """One series of a law, n points in rising x."""

    x: Array
    """Where, shape (n,)."""

    mean: Array
    """Mean over structures, shape (n,)."""

    std: Array
    """Their standard deviation, 0 where there is one structure, shape (n,)."""

    structures: Array
    """Their number, shape (n,)."""

    fitted: Array
    """The published form, NaN where there is none, shape (n,)."""

    @property
    def r2(self) -> float:
        """Share of the variance of the means that the published form explains [1], or NaN."""
        spread = float(np.sum((self.mean - self.mean.mean()) ** 2))
        return 1.0 - float(np.sum((self.mean - self.fitted) ** 2)) / spread if spread else np.nan


LawPoints = dict[str, dict[str, Points]]
"""Points by law and series, such as `F = 5`."""


def has_laws(folder: Path) -> bool:
    """Whether a run was held against laws."""
    return (folder / FILE).is_file()


def read_law_points(folder: Path) -> LawPoints:
    """Read the points of every law.

    Raises:
        InputError: the table or a column is missing or damaged.
    """
    import pandas as pd  # noqa: PLC0415 - slow to import

    path = folder / FILE
    try:
        table = pd.read_csv(path, keep_default_na=False, na_values={name: [""] for name in COLUMNS})
        table[COLUMNS] = table[COLUMNS].astype(np.float64)
        groups = table.groupby(["law", "series"], sort=False)
    except (OSError, ValueError, KeyError) as error:
        problem = f"cannot be read: {error}; run the scenario again to restore it"
        raise InputError(problem, path=path) from error
    found: LawPoints = {}
    for (law, series), group in groups:
        x, mean, std, structures, fitted = group[COLUMNS].to_numpy().T
        points = Points(
            x=x, mean=mean, std=np.nan_to_num(std), structures=structures, fitted=fitted
        )
        found.setdefault(str(law), {})[str(series)] = points
    return found
