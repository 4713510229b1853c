"""Fits the law of error / sd to the errors of training logs."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from tiswarm.base.aliases import Reals
from tiswarm.records.error_law import ErrorLaw

EDGES: Reals = np.geomspace(0.1, 30.0, 58).astype(np.float64)
"""Ratios of error and sd that part the bins of the likelihood, a bin before and one after them [1].

Errors of logs without noise are far below sd, those of wrong beacons thousands of sd: how far they
are beyond these edges changes no decision.
"""

QUANTILES = (0.1, 0.25, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99)

_STARTS = [
    ErrorLaw(width=0.85, dimensions=1.5, tail_share=share, tail_width=wide)
    for share in (0.02, 0.1)
    for wide in (1.5, 5.0)
]
_LEAST = 1e-9


def usable(table: pd.DataFrame) -> pd.DataFrame:
    """Select robots whose error is a matter of `sd`: no guesses, and none without an sd."""
    return table[(table["sd_R"] > 0.0) & ~table["is_guess"]]


def weights(table: pd.DataFrame) -> Reals:
    """Weigh robots so that all estimates count alike: those of a structure share errors."""
    count = table.groupby(["set", "number", "method"])["robot"].transform("size")
    weight = 1.0 / count.to_numpy(np.float64)
    weight /= weight.sum()
    return weight


def fitted(table: pd.DataFrame) -> dict[str, Any]:
    """Fit the law by maximum likelihood, and record it.

    Args:
        table: Errors of training logs, columns as `errors.COLUMNS`.
    """
    used = usable(table)
    ratio = (used["error_R"] / used["sd_R"]).to_numpy(np.float64)
    weight = weights(used)
    share, _ = np.histogram(ratio, [0.0, *EDGES, np.inf], weights=weight)
    ends = [_maximized(start, share) for start in _STARTS]
    loss, law = min(ends, key=itemgetter(0))
    chosen = ErrorLaw(**{name: float(f"{value:.2g}") for name, value in asdict(law).items()})
    estimates = used[["set", "number", "method"]].drop_duplicates()
    return {
        "estimates": estimates.groupby("method").size().to_dict(),
        "robots": used.groupby("method").size().to_dict(),
        "training_numbers": [int(used["number"].min()), int(used["number"].max())],
        "loss": round(loss, 5),
        "loss_of_chosen": round(_loss(chosen, share), 5),
        "best": asdict(law),
        "chosen": asdict(chosen),
        "quantiles": {
            f"{p:g}": {"law": round(chosen.ratio(p), 3), "observed": round(observed, 3)}
            for p, observed in zip(QUANTILES, _quantiles(ratio, weight), strict=True)
        },
    }


def _maximized(start: ErrorLaw, share: Reals) -> tuple[float, ErrorLaw]:
    """Maximize the likelihood from a law on; return the loss and the law."""
    end = minimize(  # type: ignore[call-overload]
        lambda values: _loss(_law(values), share),
        _values(start).tolist(),
        method="Nelder-Mead",
        options={"maxiter": 5000, "maxfev": 5000},
    )
    return float(end.fun), _law(end.x)


def _values(law: ErrorLaw) -> Reals:
    """List the parameters of a law so that all numbers are valid."""
    share = law.tail_share
    positive = replace(law, tail_share=share / (1.0 - share))
    return np.log([*asdict(positive).values()])


def _law(values: Reals) -> ErrorLaw:
    law = ErrorLaw(**dict(zip(ErrorLaw.__dataclass_fields__, np.exp(values).tolist(), strict=True)))
    return replace(law, tail_share=law.tail_share / (1.0 + law.tail_share))


def _loss(law: ErrorLaw, share: Reals) -> float:
    """Compute the negative mean log likelihood of bins; `share` is that of robots, shape (B,)."""
    chance = np.diff([0.0, *law.probability(EDGES), 1.0])
    return float(-(share * np.log(np.maximum(chance, _LEAST))).sum())


def _quantiles(ratio: Reals, weight: Reals) -> Sequence[float]:
    order = np.argsort(ratio, kind="stable")
    reached = np.cumsum(weight[order])
    index = np.minimum(np.searchsorted(reached, QUANTILES), len(order) - 1)
    quantiles: list[float] = ratio[order][index].tolist()
    return quantiles
