"""Curves through means: how well a published form fits, and which exponent would."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST = 3
"""A fit of two numbers through fewer points than this says nothing."""


class Form(NamedTuple):
    """What a published law is linear in."""

    name: str
    """How it is written, such as F^0.5."""

    of: Callable[[Array], Array]


class Fit(NamedTuple):
    """A form fitted to some points by least squares."""

    text: str
    """The fitted formula; empty where there are too few points."""

    r2: float
    """Share of the variance about the mean that it explains, at most 1 [1]; NaN likewise."""

    fitted: Array
    """Its values where the points are."""


def affine(x: Array, y: Array, form: Form) -> Fit:
    """Fit y = a + b form(x) to values at places, each of shape (n,)."""
    shape = form.of(x)
    if len(np.unique(shape)) < FEWEST:
        return _unfit(y)
    slope, intercept = np.polyfit(shape, y, 1)
    fitted: Array = intercept + slope * shape
    return Fit(f"{intercept:.3g} + {slope:.3g} {form.name}", _r2(y, fitted), fitted)


def proportional(x: Array, y: Array, form: Form) -> Fit:
    """Fit y = k form(x), which has no constant; so R2 may be negative. Arguments as above."""
    shape = form.of(x)
    if len(np.unique(shape)) < FEWEST:
        return _unfit(y)
    factor = float(shape @ y) / float(shape @ shape)
    fitted: Array = factor * shape
    return Fit(f"{factor:.3g} {form.name}", _r2(y, fitted), fitted)


def exponent(x: Array, y: Array) -> float:
    """Fit p of y ~ x^p, least squares of log y over log x [1]; NaN where that cannot be."""
    if len(np.unique(x)) < FEWEST or min(x.min(), y.min()) <= 0.0:
        return math.nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Means over structures, and the form fitted to them."""

    series: str
    """What the structures have in common, such as F = 5; empty where there is one series."""

    points: pd.DataFrame
    """Columns x, mean, std and structures, the number of them."""

    fit: Fit

    @classmethod
    def through(
        cls,
        points: pd.DataFrame,
        form: Form | None = None,
        *,
        series: str = "",
        by: Callable[[Array, Array, Form], Fit] = affine,
    ) -> "Curve":
        """Fit a form to the means of a table of points; without a form there is no fit."""
        x, mean = points["x"].to_numpy(np.float64), points["mean"].to_numpy(np.float64)
        return cls(series=series, points=points, fit=by(x, mean, form) if form else _unfit(mean))

    def at(self, x: float) -> float:
        """Mean at a place; NaN where there is none."""
        found = self.points.loc[self.points["x"] == x, "mean"]
        return float(found.iloc[0]) if len(found) else math.nan

    def exponent(self, least: float = 0.0) -> float:
        """Exponent of the means over x, for x from `least` up."""
        points = self.points[self.points["x"] >= least]
        if points.empty:
            return math.nan
        return exponent(points["x"].to_numpy(np.float64), points["mean"].to_numpy(np.float64))

    @property
    def structures(self) -> int:
        """Structures behind the point with the fewest."""
        return int(self.points["structures"].min()) if len(self.points) else 0


def _unfit(y: Array) -> Fit:
    return Fit("", math.nan, np.full(len(y), math.nan))


def _r2(y: Array, fitted: Array) -> float:
    spread = float(np.sum((y - y.mean()) ** 2))
    return 1.0 - float(np.sum((y - fitted) ** 2)) / spread if spread else math.nan
