"""Bands that measured numbers should lie in, and what is said of those that do or do not."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from tiswarm.evaluation.fits import Curve

IN_BAND = "in band"
OUT_OF_BAND = "out of band"
REPORTED = "reported"
NOT_MEASURED = "not measured"


class Band(NamedTuple):
    """Where a number should lie, in words and as a test."""

    text: str
    holds: Callable[[float], bool]


def within(least: float, most: float) -> Band:
    """From one number to another, both allowed."""
    return Band(f"{least:g} to {most:g}", lambda value: least <= value <= most)


def at_least(least: float) -> Band:
    """No less than a number."""
    return Band(f">= {least:g}", lambda value: value >= least)


def at_most(most: float) -> Band:
    """No more than a number."""
    return Band(f"<= {most:g}", lambda value: value <= most)


def above(least: float) -> Band:
    """More than a number."""
    return Band(f"> {least:g}", lambda value: value > least)


def below(most: float) -> Band:
    """Less than a number."""
    return Band(f"< {most:g}", lambda value: value < most)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One number that a law is held to."""

    quantity: str
    """What is measured, with its unit."""

    ours: float
    """What came out; NaN where what has grown does not tell."""

    structures: int
    """Structures it rests on; of several settings, those of the setting with the fewest."""

    published: str = ""
    """What ReactiveBuild was published to do, as far as it was."""

    band: Band | None = None
    """Where it should lie; None for a number that is only reported."""

    curve: Curve | None = None
    """Means it was taken from, with the published form fitted to them."""

    @classmethod
    def of_fit(
        cls, form: str, curve: Curve, published: str = "", band: Band | None = None
    ) -> "Row":
        """How well a form fits the means of a curve."""
        return cls.of_curve(f"R2 of {form}", curve.fit.r2, curve, published, band)

    @classmethod
    def of_curve(
        cls, quantity: str, ours: float, curve: Curve, published: str = "", band: Band | None = None
    ) -> "Row":
        """A number read off a curve."""
        return cls(
            quantity=f"{quantity}, {curve.series}" if curve.series else quantity,
            ours=ours,
            structures=curve.structures,
            published=published,
            band=band,
            curve=curve,
        )

    @property
    def verdict(self) -> str:
        """Whether it lies where it should."""
        if math.isnan(self.ours):
            return NOT_MEASURED
        if self.band is None:
            return REPORTED
        return IN_BAND if self.band.holds(self.ours) else OUT_OF_BAND
