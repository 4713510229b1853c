"""Curves: means over structures at each x, and the published form fitted to them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.evaluation.metrics import power_law

Array = NDArray[np.float64]

FEWEST_POINTS = 3
"""Fewest points that a fit of two coefficients can be judged by."""


class Form(NamedTuple):
    """The published shape of a law: y = a + b f(x), or y = k f(x)."""

    name: str
    """How f is written, such as F^0.5."""

    of: Callable[[Array], Array]
    """f itself."""

    has_constant: bool = True
    """Whether y = a + b f(x)."""

    @property
    def text(self) -> str:
        """The form with its coefficients, such as a + b F^0.5."""
        return f"a + b {self.name}" if self.has_constant else f"k {self.name}"


class Fit(NamedTuple):
    """A form fitted to points by least squares."""

    formula: str
    """The fitted formula; empty with too few points."""

    r2: float
    """Coefficient of determination, at most 1 [1]; NaN with too few points."""

    fitted: Array
    """Values of the formula at the points, shape (n,)."""


def fit(x: Array, y: Array, form: Form | None) -> Fit:
    """Fit a form to n points by least squares.

    Without a constant in the form, R2 can be negative.

    Args:
        x: Places of the points, shape (n,).
        y: Values of the points, shape (n,).
        form: What to fit; None fits nothing.

    >>> x = np.array([1.0, 4.0, 9.0])
    >>> fit(x, 3.0 + 2.0 * np.sqrt(x), Form("x^0.5", np.sqrt)).formula
    '3 + 2 x^0.5'
    """
    shape = form.of(x) if form else x
    if form is None or len(np.unique(shape)) < FEWEST_POINTS:
        return Fit("", math.nan, np.full(len(y), math.nan))
    if form.has_constant:
        slope, intercept = np.polyfit(shape, y, 1)
        fitted: Array = intercept + slope * shape
        formula = f"{intercept:.3g} + {slope:.3g} {form.name}"
    else:
        factor = float(shape @ y) / float(shape @ shape)
        fitted = factor * shape
        formula = f"{factor:.3g} {form.name}"
    variation = float(np.sum((y - y.mean()) ** 2))
    r2 = 1.0 - float(np.sum((y - fitted) ** 2)) / variation if variation else math.nan
    return Fit(formula, r2, fitted)


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One series of a law: means over structures, and the form fitted to them."""

    series: str
    """The setting that the structures share, such as F = 5; empty with one series."""

    points: pd.DataFrame
    """Columns x, mean, std, structures, fitted; x ascends."""

    formula: str
    """The fitted formula; empty without a fit."""

    r2: float
    """Coefficient of determination of the fit [1]; NaN without a fit."""

    @classmethod
    def through(cls, points: pd.DataFrame, form: Form | None = None, series: str = "") -> "Curve":
        """Fit a form to the means of a table with the columns x, mean, std, structures."""
        x, mean = points["x"].to_numpy(np.float64), points["mean"].to_numpy(np.float64)
        formula, r2, fitted = fit(x, mean, form)
        return cls(series=series, points=points.assign(fitted=fitted), formula=formula, r2=r2)

    def at(self, x: float) -> float:
        """Return the mean at x; NaN without a point there."""
        found = self.points.loc[self.points["x"] == x, "mean"]
        return float(found.iloc[0]) if len(found) else math.nan

    def exponent(self, least: float = 0.0) -> float:
        """Fit p of mean ~ x^p to the points with x >= `least` [1]; NaN with too few points."""
        points = self.points[self.points["x"] >= least].astype(np.float64)
        return power_law(points["x"].to_numpy(), points["mean"].to_numpy())[0]

    @property
    def structures(self) -> int:
        """Number of structures behind the point with the fewest."""
        return int(self.points["structures"].min()) if len(self.points) else 0
