"""What ReactiveBuild's towers were published to do, measured on ours.

A height is that of the highest robot center above the ground [R]; a peak the largest stress in
any contact of a structure [weight of a dock / R^2]; means are over seeds, and fits are to means.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from tiswarm.evaluation.fits import Curve, Form, proportional
from tiswarm.evaluation.grown import FULL, SETTLED, STANDARD, B, F, Grown, J
from tiswarm.evaluation.verdicts import Row, above, at_least, below, within

THRESHOLDS = (1.0, 2.5, 5.0, 10.0, 25.0)
"""F of the towers."""

SWEEP_THRESHOLDS = (2.5, 5.0)
"""F at which B and J were swept."""


def height_over_threshold(grown: Grown) -> Iterator[Row]:
    """Mean height of finished towers over F: affine in sqrt F; exponent from F = 2.5 up."""
    points = grown.swept("tower", F).over(F, "height_R")
    curve = Curve.through(points, Form("F^0.5", np.sqrt))
    yield Row.of_fit("a + b F^0.5", curve, "1.000", at_least(0.97))
    yield Row.of_curve("exponent, F >= 2.5", curve.exponent(2.5), curve, "0.5", within(0.5, 0.75))


def peak_over_threshold(grown: Grown) -> Iterator[Row]:
    """Mean peak of finished towers over F: affine in F; exponent."""
    points = grown.swept("tower", F).over(F, "peak_stress")
    curve = Curve.through(points, Form("F", np.positive))
    yield Row.of_fit("a + b F", curve, "0.999", at_least(0.95))
    yield Row.of_curve("exponent", curve.exponent(), curve, "1", within(0.55, 0.95))


def cross_section(grown: Grown) -> Iterator[Row]:
    """Mean cross-section of finished towers over the distance d from their top: k d^2.

    A cross-section is the number of dock spheres whose centers are within 1 R of a height; see
    `Grown.cross_sections`. The fit has no constant.
    """
    square = Form("d^2", np.square)
    for threshold in (5.0, 10.0):
        sections = grown.swept("tower", **{F: threshold}).cross_sections()
        curve = Curve.through(sections, square, series=f"F = {threshold:g}", by=proportional)
        yield Row.of_fit("k d^2", curve, "0.992", at_least(0.93))


def height_over_robots(grown: Grown) -> Iterator[Row]:
    """Mean height of growing towers over N from 25 up: affine in sqrt N; last over first.

    Bands are for F = 10.
    """
    for threshold in THRESHOLDS:
        curve = _over_robots(grown, threshold, "height_R", Form("N^0.5", np.sqrt))
        standard = threshold == STANDARD[F]
        yield Row.of_fit("a + b N^0.5", curve, "0.983", at_least(0.93) if standard else None)
        yield Row.of_curve(
            "height at N = 100 / at N = 25",
            curve.at(FULL) / curve.at(SETTLED),
            curve,
            "2",
            within(1.25, 1.9) if standard else None,
        )


def peak_over_robots(grown: Grown) -> Iterator[Row]:
    """Mean peak of growing towers over N from 25 up: affine in N."""
    for threshold in THRESHOLDS:
        curve = _over_robots(grown, threshold, "peak_stress", Form("N", np.positive))
        yield Row.of_fit("a + b N", curve, "0.870")


def over_base(column: str, grown: Grown) -> Iterator[Row]:
    """Mean height or peak of finished towers over B: affine in 1 / B."""
    inverse = Form("/ B", np.reciprocal)
    for threshold in SWEEP_THRESHOLDS:
        points = grown.swept("tower", B, **{F: threshold}).over(B, column)
        curve = Curve.through(points, inverse, series=f"F = {threshold:g}")
        yield Row.of_fit("a + b / B", curve, "0.99", at_least(0.93))


def height_over_limit(grown: Grown) -> Iterator[Row]:
    """Mean height of finished towers over J: each step up of J makes them less tall."""
    for curve in _over_limit(grown, "height_R"):
        steps = [after / before for before, after in pairwise(curve.points["mean"])]
        yield Row.of_curve(
            "greatest ratio of height at one J to the J before",
            max(steps, default=np.nan),
            curve,
            "below 1",
            below(1.0),
        )
        few = curve.at(1000.0) / curve.at(5.0)
        yield Row.of_curve("height at J = 1000 / at J = 5", few, curve, "1")


def peak_over_limit(grown: Grown) -> Iterator[Row]:
    """Mean peak of finished towers over J."""
    for curve in _over_limit(grown, "peak_stress"):
        one, many = curve.at(1.0) / curve.at(5.0), curve.at(1000.0) / curve.at(5.0)
        yield Row.of_curve("peak at J = 1 / at J = 5", one, curve, "above 1", above(1.2))
        yield Row.of_curve("peak at J = 1000 / at J = 5", many, curve, "1")


def no_recruitment(grown: Grown) -> Iterator[Row]:
    """Towers at F = 10 whose robots are never called: mean height, and peak over that at J = 5."""
    alone, called = grown.swept("tower", **{J: 0.0}), grown.swept("tower")
    yield Row(
        quantity="height at J = 0 [R]",
        ours=alone.mean("height_R"),
        structures=alone.count,
        band=above(60.0),
    )
    yield Row(
        quantity="peak at J = 0 / at J = 5",
        ours=alone.mean("peak_stress") / called.mean("peak_stress"),
        structures=min(alone.count, called.count),
        band=above(10.0),
    )


def shape(grown: Grown) -> Iterator[Row]:
    """Finished towers at F = 10: mean height, mean rms radius of centers about their centroid."""
    towers = grown.swept("tower")
    for quantity, column, band in (
        ("height [R]", "height_R", within(33.0, 45.0)),
        ("rms radius [R]", "rms_radius_R", within(9.5, 12.0)),
    ):
        ours = towers.mean(column)
        yield Row(quantity=quantity, ours=ours, structures=towers.count, band=band)


def _over_robots(grown: Grown, threshold: float, column: str, form: Form) -> Curve:
    towers = grown.swept("tower", **{F: threshold})
    points = towers.over_robots(column, least=SETTLED)
    return Curve.through(points, form, series=f"F = {threshold:g}")


def _over_limit(grown: Grown, column: str) -> Iterator[Curve]:
    """J from 1 up, for 0 stands for no recruitment at all."""
    for threshold in SWEEP_THRESHOLDS:
        points = grown.swept("tower", J, **{F: threshold}).over(J, column)
        yield Curve.through(points[points["x"] > 0.0], series=f"F = {threshold:g}")
