"""The published laws of ReactiveBuild's structures, and the numbers that compare ours with them.

Published values are those of Swissler and Rubenstein, ReactiveBuild (DARS 2021). A number of a
correct reimplementation lies in its band; a number without a band is only reported.

Heights are those of the highest robot center above the ground [R]. Reach and depth are those of
the farthest robot center: beyond the start of the edge's curve, and below the flat ground [R]. A
peak is the largest stress in any contact of a structure [weight of a dock / R^2]. A cross-section
is the number of dock spheres with centers within 1 R of a height.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
import pandas as pd

from benchmarks.reactivebuild.curves import Curve, Form
from benchmarks.reactivebuild.structures import FULL, B, F, J, Structures

_T = TypeVar("_T")

IN_BAND = "in band"
OUT_OF_BAND = "out of band"
REPORTED = "reported"
NOT_MEASURED = "not measured"

SETTLED = 25
"""N from which on growth follows the published laws of N."""

STALL_ROBOTS = {1.0: 5, 2.5: 17, 5.0: 20}
"""By F: published N at which cantilevers stall."""


class Band(NamedTuple):
    """The range in which a number should lie."""

    text: str
    contains: Callable[[float], bool]


def within(least: float, most: float) -> Band:
    """Allow the numbers from `least` to `most`, both included."""
    return Band(f"{least:g} to {most:g}", lambda value: least <= value <= most)


def at_least(least: float) -> Band:
    """Allow `least` and larger numbers."""
    return Band(f">= {least:g}", lambda value: value >= least)


def at_most(most: float) -> Band:
    """Allow `most` and smaller numbers."""
    return Band(f"<= {most:g}", lambda value: value <= most)


def above(least: float) -> Band:
    """Allow numbers larger than `least`."""
    return Band(f"> {least:g}", lambda value: value > least)


def below(most: float) -> Band:
    """Allow numbers smaller than `most`."""
    return Band(f"< {most:g}", lambda value: value < most)


Bands = Band | Mapping[float, Band] | None
"""A band, a band by F, or none."""


class Number(NamedTuple):
    """A number read off a curve, its published value and its band."""

    quantity: str
    """What is measured, with its unit; {form} stands for the form of the law."""

    measure: Callable[[Curve], float]
    """How to compute it; NaN if the structures do not determine it."""

    published: str | Mapping[float, str] = ""
    """Published value, by F if it differs."""

    band: Bands = None
    """Band, by F if it differs."""


class Row(NamedTuple):
    """One row of the scorecard."""

    law: str
    quantity: str
    published: str
    ours: float
    band: Band | None
    structures: int
    """Structures behind the number; those of the setting with the fewest, if it needs several."""

    curve: Curve | None = None
    """Curve that the number was read off."""

    @property
    def verdict(self) -> str:
        """Whether the number lies in its band."""
        if math.isnan(self.ours):
            return NOT_MEASURED
        if self.band is None:
            return REPORTED
        return IN_BAND if self.band.contains(self.ours) else OUT_OF_BAND


@dataclass(frozen=True)
class Law:
    """A law of the mean of y over x, for structures of one kind."""

    name: str
    kind: str
    x: str
    """A setting, `robots` or `distance`; see `Structures.means`."""

    y: str
    _: KW_ONLY
    form: Form | None = None
    """Published form of y over x."""

    numbers: tuple[Number, ...]

    thresholds: tuple[float, ...] = ()
    """F of each series; empty: one series, at the standard F or over all F."""

    least: float = 0.0
    """Smallest x."""

    def rows(self, structures: Structures) -> Iterator[Row]:
        """Measure every number of the law."""
        for threshold in self.thresholds or (None,):
            fixed = {} if threshold is None else {F: threshold}
            points = structures.of(self.kind, self.x, **fixed).means(self.x, self.y)
            series = "" if threshold is None else f"F = {threshold:g}"
            curve = Curve.through(points[points["x"] >= self.least], self.form, series)
            for quantity, measure, published, band in self.numbers:
                said = quantity.format(form=self.form.text if self.form else "")
                yield Row(
                    self.name,
                    f"{said}, {series}" if series else said,
                    _of_series(published, threshold) or "",
                    measure(curve),
                    _of_series(band, threshold),
                    curve.structures,
                    curve,
                )


@dataclass(frozen=True)
class Mean:
    """A law of the mean of y alone, or of its ratio to the mean at the standard settings."""

    name: str
    kind: str
    y: str
    quantity: str
    band: Band | None = None
    _: KW_ONLY
    over: tuple[str, ...] = ()
    """Settings over which structures are averaged too."""

    settings: Mapping[str, float] = field(default_factory=dict)
    """Settings that are not the standard ones."""

    is_ratio: bool = False

    def rows(self, structures: Structures) -> Iterator[Row]:
        """Measure the mean."""
        chosen = structures.of(self.kind, *self.over, **self.settings)
        ours, count = chosen.mean(self.y), len(chosen.totals)
        if self.is_ratio:
            standard = structures.of(self.kind)
            ours, count = ours / standard.mean(self.y), min(count, len(standard.totals))
        yield Row(self.name, self.quantity, "", ours, self.band, count)


def r2(published: str = "", band: Bands = None) -> Number:
    """Measure how well the published form fits the means."""
    return Number("R2 of {form}", lambda curve: curve.r2, published, band)


def exponent(published: str, band: Bands = None, *, least: float = 0.0) -> Number:
    """Measure p of y ~ x^p for x from `least` up."""
    quantity = f"exponent, F >= {least:g}" if least else "exponent"
    return Number(quantity, lambda curve: curve.exponent(least), published, band)


def ratio(
    y: str, x: str, first: float, second: float, published: str, band: Bands = None
) -> Number:
    """Measure the ratio of the means at two places."""
    quantity = f"{y} at {x} = {first:g} / at {x} = {second:g}"
    return Number(quantity, lambda curve: curve.at(first) / curve.at(second), published, band)


def share_across(gap: float, bands: Mapping[float, Band]) -> Number:
    """Measure the share of bridges across a gap [R]."""
    published = "falls with the gap, rises with F"
    return Number(f"share across a gap of {gap:g} R", lambda curve: curve.at(gap), published, bands)


def _largest_step(curve: Curve) -> float:
    steps = [after / before for before, after in pairwise(curve.points["mean"])]
    return max(steps, default=math.nan)


def _gained_reach(curve: Curve) -> float:
    return curve.at(FULL) - curve.at(SETTLED)


THRESHOLDS = (1.0, 2.5, 5.0, 10.0, 25.0)
"""F of towers, cantilevers and chains."""

SWEPT_THRESHOLDS = (2.5, 5.0)
"""F at which B and J were swept."""

GROWTH = {threshold: f"stalls at N = {robots}" for threshold, robots in STALL_ROBOTS.items()} | {
    10.0: "keeps growing",
    25.0: "keeps growing",
}
"""By F: published growth of cantilevers."""

LAWS: tuple[Law | Mean, ...] = (
    Law(
        "tower height over F", "tower", F, "height_R",
        form=Form("F^0.5", np.sqrt),
        numbers=(
            r2("1.000", at_least(0.97)),
            exponent("0.5", within(0.5, 0.75), least=2.5),
        ),
    ),
    Law(
        "tower peak over F", "tower", F, "peak_stress",
        form=Form("F", np.positive),
        numbers=(r2("0.999", at_least(0.95)), exponent("1", within(0.55, 0.95))),
    ),
    Law(
        "tower cross-section", "tower", "distance", "",
        form=Form("d^2", np.square, has_constant=False),
        thresholds=(5.0, 10.0),
        numbers=(r2("0.992", at_least(0.93)),),
    ),
    Law(
        "tower height over N", "tower", "robots", "height_R",
        form=Form("N^0.5", np.sqrt),
        thresholds=THRESHOLDS,
        least=SETTLED,
        numbers=(
            r2("0.983", {10.0: at_least(0.93)}),
            ratio("height", "N", FULL, SETTLED, "2", {10.0: within(1.25, 1.9)}),
        ),
    ),
    Law(
        "tower peak over N", "tower", "robots", "peak_stress",
        form=Form("N", np.positive),
        thresholds=THRESHOLDS,
        least=SETTLED,
        numbers=(r2("0.870"),),
    ),
    Law(
        "tower height over B", "tower", B, "height_R",
        form=Form("/ B", np.reciprocal),
        thresholds=SWEPT_THRESHOLDS,
        numbers=(r2("0.99", at_least(0.93)),),
    ),
    Law(
        "tower peak over B", "tower", B, "peak_stress",
        form=Form("/ B", np.reciprocal),
        thresholds=SWEPT_THRESHOLDS,
        numbers=(r2("0.99", at_least(0.93)),),
    ),
    Law(
        "tower height over J", "tower", J, "height_R",
        thresholds=SWEPT_THRESHOLDS,
        least=1.0,  # J = 0 switches recruitment off, which is a law of its own
        numbers=(
            Number(
                "greatest ratio of height at one J to the J before",
                _largest_step, "below 1", below(1.0),
            ),
            ratio("height", "J", 1000.0, 5.0, "1"),
        ),
    ),
    Law(
        "tower peak over J", "tower", J, "peak_stress",
        thresholds=SWEPT_THRESHOLDS,
        least=1.0,
        numbers=(
            ratio("peak", "J", 1.0, 5.0, "above 1", above(1.2)),
            ratio("peak", "J", 1000.0, 5.0, "1"),
        ),
    ),
    Mean(
        "tower without recruitment", "tower", "height_R", "height at J = 0 [R]", above(60.0),
        settings={J: 0.0},
    ),
    Mean(
        "tower without recruitment", "tower", "peak_stress", "peak at J = 0 / at J = 5",
        above(10.0), settings={J: 0.0}, is_ratio=True,
    ),
    Mean("tower shape", "tower", "height_R", "height [R]", within(33.0, 45.0)),
    Mean("tower shape", "tower", "rms_radius_R", "rms radius [R]", within(9.5, 12.0)),
    Law(
        "cantilever reach", "cantilever", "robots", "reach_R",
        thresholds=THRESHOLDS,
        least=1.0,
        numbers=(
            Number(
                f"reach gained from N = {SETTLED} to {FULL} [R]", _gained_reach, GROWTH,
                {
                    1.0: below(1.0), 2.5: below(1.0), 5.0: below(2.5),
                    10.0: above(2.5), 25.0: above(6.0),
                },
            ),
            Number(f"reach at N = {FULL} [R]", lambda curve: curve.at(FULL)),
        ),
    ),
    Mean("cantilever shape", "cantilever", "rms_radius_R", "rms radius [R]", within(8.0, 10.5)),
    Law(
        "bridge success", "bridge", "gap", f"(crossed > 0) & (robots < {FULL})",
        thresholds=(2.5, 10.0),
        numbers=(
            share_across(20.0, {10.0: at_least(0.9)}),
            share_across(25.0, {10.0: at_least(0.8)}),
            share_across(30.0, {2.5: at_most(0.1), 10.0: at_least(0.5)}),
        ),
    ),
    Law(
        "chain depth over F", "chain", F, "depth_R",
        form=Form("F^0.75", lambda x: x**0.75),
        numbers=(r2(), exponent("0.75")),
    ),
    Mean("chain depth over F", "chain", "robots", "robots that joined", over=(F,)),
    Law(
        "chain depth over N", "chain", "robots", "depth_R",
        form=Form("ln N", np.log),
        thresholds=THRESHOLDS[1:],
        least=SETTLED,
        numbers=(r2("log N"),),
    ),
)  # fmt: skip
"""Every law, in the order of the scorecard."""

LawCurves = dict[str, dict[str, Curve]]
"""Curves by law and series, such as F = 5."""


def measure(structures: Structures) -> list[Row]:
    """Measure every number of every law.

    Args:
        structures: Structures at the standard settings and over the published sweeps. The numbers
            of settings that are missing are NaN.
    """
    return [row for law in LAWS for row in law.rows(structures)]


def scorecard(rows: list[Row]) -> pd.DataFrame:
    """List the numbers of the laws with their published values, bands and verdicts."""
    return pd.DataFrame(
        [
            {
                "law": row.law,
                "quantity": row.quantity,
                "published": row.published,
                "ours": row.ours,
                "fit": row.curve.formula if row.curve else "",
                "r2": row.curve.r2 if row.curve else math.nan,
                "band": row.band.text if row.band else "",
                "verdict": row.verdict,
                "structures": row.structures,
            }
            for row in rows
        ]
    )


def curves_of(rows: list[Row]) -> LawCurves:
    """Collect the curves behind the numbers."""
    found: LawCurves = {}
    for row in rows:
        if row.curve:
            found.setdefault(row.law, {})[row.curve.series] = row.curve
    return found


def law_points(curves: LawCurves) -> pd.DataFrame:
    """List the points of all curves: law, series, x, mean, std, structures, fitted."""
    points = [
        curve.points.assign(law=law, series=series)
        for law, of_series in curves.items()
        for series, curve in of_series.items()
    ]
    return pd.concat(points)[["law", "series", "x", "mean", "std", "structures", "fitted"]]


def count_verdicts(table: pd.DataFrame) -> str:
    """Say how many numbers of a scorecard are in band."""
    verdicts = table["verdict"].value_counts()
    reported, missing = (int(verdicts.get(verdict, 0)) for verdict in (REPORTED, NOT_MEASURED))
    judged = len(table) - reported - missing
    missed = f", {missing} not measured" if missing else ""
    return f"{verdicts.get(IN_BAND, 0)} of {judged} in band, {reported} reported{missed}"


def _of_series(value: _T | Mapping[float, _T] | None, threshold: float | None) -> _T | None:
    """Return the value itself, or the one at a threshold if it differs by threshold."""
    return value.get(threshold or math.nan) if isinstance(value, Mapping) else value
