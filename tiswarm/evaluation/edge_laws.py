"""What ReactiveBuild's cantilevers, bridges and chains were published to do, measured on ours.

Reach and depth are those of the farthest robot center: beyond where the edge begins to round off,
and below the flat ground [R]; means are over seeds, and fits are to means.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tiswarm.evaluation.fits import Curve, Form
from tiswarm.evaluation.grown import FULL, SETTLED, F, Grown
from tiswarm.evaluation.verdicts import Row, above, at_least, at_most, below, within

GROWTH = {
    1.0: ("stalls at N = 5", below(1.0)),
    2.5: ("stalls at N = 17", below(1.0)),
    5.0: ("stalls at N = 20", below(2.5)),
    10.0: ("keeps growing", above(2.5)),
    25.0: ("keeps growing", above(6.0)),
}
"""By F of cantilevers: what was published, and how much they should lengthen [R]."""

CROSSING = {
    (2.5, 20.0): None,
    (2.5, 25.0): None,
    (2.5, 30.0): at_most(0.1),
    (10.0, 20.0): at_least(0.9),
    (10.0, 25.0): at_least(0.8),
    (10.0, 30.0): at_least(0.5),
}
"""By F and gap of bridges [R]: the share that should get across."""

CHAIN_THRESHOLDS = (2.5, 5.0, 10.0, 25.0)
"""F of the chains."""


def cantilever_reach(grown: Grown) -> Iterator[Row]:
    """Mean reach of growing cantilevers over N: how far, and how much farther from N = 25 on."""
    for threshold, (published, band) in GROWTH.items():
        points = grown.swept("cantilever", **{F: threshold}).over_robots("reach_R", least=1)
        curve = Curve.through(points, series=f"F = {threshold:g}")
        full = curve.at(FULL)
        gained = full - curve.at(SETTLED)
        yield Row.of_curve("reach gained from N = 25 to 100 [R]", gained, curve, published, band)
        yield Row.of_curve("reach at N = 100 [R]", full, curve)


def cantilever_shape(grown: Grown) -> Iterator[Row]:
    """Finished cantilevers at F = 10: mean rms radius of centers about their centroid."""
    cantilevers = grown.swept("cantilever")
    yield Row(
        quantity="rms radius [R]",
        ours=cantilevers.mean("rms_radius_R"),
        structures=cantilevers.count,
        band=within(8.0, 10.5),
    )


def bridge_success(grown: Grown) -> Iterator[Row]:
    """Share of bridges that join both sides of their gap with fewer than 100 robots."""
    table = grown.structures
    across = (table["crossed"] > 0) & (table["robots"] < FULL)
    judged = replace(grown, structures=table.assign(across=across.astype(np.float64)))
    for (threshold, gap), band in CROSSING.items():
        points = judged.swept("bridge", **{F: threshold}).over("gap", "across")
        curve = Curve.through(points, series=f"F = {threshold:g}")
        yield Row.of_curve(
            f"share across a gap of {gap:g} R",
            curve.at(gap),
            curve,
            "falls with the gap, rises with F",
            band,
        )


def chain_depth_over_threshold(grown: Grown) -> Iterator[Row]:
    """Mean depth of finished chains over F: affine in F^0.75; exponent; robots that joined."""
    chains = grown.swept("chain", F)
    points = chains.over(F, "depth_R")
    curve = Curve.through(points, Form("F^0.75", lambda x: x**0.75))
    yield Row.of_fit("a + b F^0.75", curve)
    yield Row.of_curve("exponent", curve.exponent(), curve, "0.75")
    yield Row(quantity="robots that joined", ours=chains.mean("robots"), structures=chains.count)


def chain_depth_over_robots(grown: Grown) -> Iterator[Row]:
    """Mean depth of growing chains over N from 25 up: affine in log N."""
    for threshold in CHAIN_THRESHOLDS:
        points = grown.swept("chain", **{F: threshold}).over_robots("depth_R", least=SETTLED)
        curve = Curve.through(points, Form("ln N", np.log), series=f"F = {threshold:g}")
        yield Row.of_fit("a + b ln N", curve, "log N")
