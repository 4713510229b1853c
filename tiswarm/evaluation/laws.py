"""The laws that ReactiveBuild's structures were published to follow, and ours held against them.

Published numbers are those of Swissler and Rubenstein, ReactiveBuild (DARS 2021). A band says
where the numbers of a sound rebuild lie; a number without a band is only reported. What exactly
is measured, each law's function says.
"""

from collections.abc import Callable, Iterator
from functools import partial

import pandas as pd

from tiswarm.evaluation import edge_laws, tower_laws
from tiswarm.evaluation.grown import Grown
from tiswarm.evaluation.verdicts import Row

Law = Callable[[Grown], Iterator[Row]]

LAWS: dict[str, Law] = {
    "tower height over F": tower_laws.height_over_threshold,
    "tower peak over F": tower_laws.peak_over_threshold,
    "tower cross-section": tower_laws.cross_section,
    "tower height over N": tower_laws.height_over_robots,
    "tower peak over N": tower_laws.peak_over_robots,
    "tower height over B": partial(tower_laws.over_base, "height_R"),
    "tower peak over B": partial(tower_laws.over_base, "peak_stress"),
    "tower height over J": tower_laws.height_over_limit,
    "tower peak over J": tower_laws.peak_over_limit,
    "tower without recruitment": tower_laws.no_recruitment,
    "tower shape": tower_laws.shape,
    "cantilever reach": edge_laws.cantilever_reach,
    "cantilever shape": edge_laws.cantilever_shape,
    "bridge success": edge_laws.bridge_success,
    "chain depth over F": edge_laws.chain_depth_over_threshold,
    "chain depth over N": edge_laws.chain_depth_over_robots,
}
"""Every law, by name, in the order of the scorecard."""


def scorecard(grown: Grown) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Hold structures against every law.

    Args:
        grown: Structures at the standard settings and over the published sweeps. Laws for which
            some are missing are not measured.

    Returns:
        The scorecard, one row a number, and the points behind it, one row a mean: the law and
        its series, x, mean, std, structures, and the published form fitted.
    """
    rows = [(law, row) for law, measure in LAWS.items() for row in measure(grown)]
    curves = {(law, row.curve.series): row.curve for law, row in rows if row.curve}
    points = [
        curve.points.assign(fitted=curve.fit.fitted, law=law, series=series)
        for (law, series), curve in curves.items()
    ]
    columns = ["law", "series", "x", "mean", "std", "structures", "fitted"]
    return pd.DataFrame([_cells(law, row) for law, row in rows]), pd.concat(points)[columns]


def _cells(law: str, row: Row) -> dict[str, object]:
    fit = row.curve.fit if row.curve else None
    return {
        "law": law,
        "quantity": row.quantity,
        "published": row.published,
        "ours": row.ours,
        "fit": fit.text if fit else "",
        "r2": fit.r2 if fit else None,
        "band": row.band.text if row.band else "",
        "verdict": row.verdict,
        "structures": row.structures,
    }
