"""Reads `law-points.csv`: means over structures, and the published forms fitted to them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.folder import read_table

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
    table = read_table(folder / FILE, ["law", "series"], COLUMNS).fillna({"series": ""})
    found: LawPoints = {}
    for (law, series), group in table.groupby(["law", "series"], sort=False):
        x, mean, std, structures, fitted = group[COLUMNS].to_numpy().T
        points = Points(
            x=x, mean=mean, std=np.nan_to_num(std), structures=structures, fitted=fitted
        )
        found.setdefault(str(law), {})[str(series)] = points
    return found
