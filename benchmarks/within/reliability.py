"""Compares P(error < x) with how often it is right, with 95 % intervals over logs."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from benchmarks.within.law import usable, weights
from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.records.error_law import ERRORS, SURE

DISTANCES = (0.5, 1.0, 2.0)
"""Distances x of P(error < x) [R]."""

BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Edges of the bins of stated probabilities [1]."""

_RESAMPLES = 1000
_GRID = np.geomspace(0.02, 60.0, 120)
"""Distances over which the continuous ranked probability score is summed [R]."""


def tables(errors: pd.DataFrame) -> Mapping[str, pd.DataFrame]:
    """Tabulate what robots with a stated probability of 95 % do, reliability, and CRPS."""
    return {
        "said": _said(errors),
        "reliability": _reliability(errors),
        "crps": _crps(errors),
    }


def groups(errors: pd.DataFrame) -> Mapping[str, pd.DataFrame]:
    """Part errors by set, those with a lie aside."""
    is_lie = errors["lie"] != "none"
    parts = {
        "all without a lie": errors[~is_lie],
        "all with a lie": errors[is_lie],
    }
    names = errors["set"] + np.where(is_lie, ", " + errors["lie"], "")
    return parts | {name: errors[names == name] for name in sorted(set(names))}


def _probability(errors: pd.DataFrame, distance: float) -> Reals:
    """State P(error < distance) of each robot; NaN of guesses, as `Estimate.within` does."""
    with np.errstate(divide="ignore"):
        stated = ERRORS.probability(distance / errors["sd_R"].to_numpy(np.float64))
    return np.where(errors["is_guess"], np.nan, stated)


def _log_index(errors: pd.DataFrame) -> tuple[AnyInts, int]:
    """Number the logs of rows, shape (rows,), and count them."""
    number = errors.groupby(["set", "number"], sort=True).ngroup().to_numpy()
    return number, int(number.max()) + 1


def _sums(log: AnyInts, value: Reals | Bools, logs: int) -> Reals:
    """Sum values of rows by log, shape (logs,)."""
    return np.bincount(log, value, logs).astype(np.float64)


def interval(numerator: Reals, denominator: Reals) -> tuple[float, float]:
    """Bootstrap a ratio of sums over logs, shape (logs,) each: its 95 % interval."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(numerator), (_RESAMPLES, len(numerator)))
    below = denominator[drawn].sum(axis=1)
    ratio = numerator[drawn].sum(axis=1)[below > 0] / below[below > 0]
    if not len(ratio):
        return np.nan, np.nan
    low, high = np.percentile(ratio, [2.5, 97.5])
    return float(low), float(high)


def share(errors: pd.DataFrame, is_counted: Bools, is_of: Bools, digits: int = 1) -> str:
    """Write a share of robots in percent with its interval over logs: "1.2 (0.3 to 2.5)"."""
    if not is_of.any():
        return "-"
    log, logs = _log_index(errors)
    counted = _sums(log, is_counted & is_of, logs)
    total = _sums(log, is_of, logs)
    low, high = interval(counted, total)
    value = counted.sum() / total.sum()
    return f"{100 * value:.{digits}f} ({100 * low:.{digits}f} to {100 * high:.{digits}f})"


def _rows(errors: pd.DataFrame, row: Callable[[pd.DataFrame], dict[str, object]]) -> pd.DataFrame:
    """Make a row for each group and method."""
    rows = []
    for name, group in groups(errors).items():
        for method, part in group.groupby("method", sort=False):
            rows.append({"logs": name, "method": method, **row(part)})
    return pd.DataFrame(rows)


def _said(errors: pd.DataFrame) -> pd.DataFrame:
    """Tabulate the share of robots that are said to be within x, and how many of them are not."""

    def row(part: pd.DataFrame) -> dict[str, object]:
        cells: dict[str, object] = {
            "count": part.groupby(["set", "number"]).ngroups,
            "robots": len(part),
            "guesses [%]": f"{100 * part['is_guess'].mean():.0f}",
        }
        for distance in DISTANCES:
            said = _probability(part, distance) >= SURE
            off = part["error_R"].to_numpy() >= distance
            cells[f"said within {distance:g} R [%]"] = f"{100 * said.mean():.0f}"
            cells[f"of these off [%], {distance:g} R"] = share(part, off, said)
        return cells

    return _rows(errors, row)


def _reliability(errors: pd.DataFrame) -> pd.DataFrame:
    """Tabulate by bins of the stated probability how often robots are within x."""
    rows = []
    is_lie = (errors["lie"] != "none").to_numpy()
    for name, part in (("no", errors[~is_lie]), ("yes", errors[is_lie])):
        for method, of_method in part.groupby("method", sort=False):
            for distance in DISTANCES:
                stated = _probability(of_method, distance)
                bins = np.digitize(stated, BINS[1:-1])
                is_within = of_method["error_R"].to_numpy() < distance
                row = {"lie": name, "method": method, "x [R]": f"{distance:g}"}
                for k in range(len(BINS) - 1):
                    chosen = (bins == k) & np.isfinite(stated)
                    text = "-"
                    if chosen.any():
                        mean = 100 * stated[chosen].mean()
                        text = f"{mean:.0f}: {share(of_method, is_within, chosen, 0)}"
                    row[f"{BINS[k]:g} to {BINS[k + 1]:g}"] = text
                rows.append(row)
    return pd.DataFrame(rows)


def _crps(errors: pd.DataFrame) -> pd.DataFrame:
    """Tabulate the mean continuous ranked probability score of the error of robots [R].

    Compared are the law of error / sd, a normal error along three axes with the sd, and the
    distribution of all errors of the group, which knows nothing of single robots.
    """
    from scipy.stats import chi  # noqa: PLC0415 - slow to import

    def row(part: pd.DataFrame) -> dict[str, object]:
        used = usable(part)
        if used.empty:
            return {}
        weight = weights(used)
        error = used["error_R"].to_numpy(np.float64)[:, None]
        sd = used["sd_R"].to_numpy(np.float64)[:, None]
        laws = {
            "law": ERRORS.probability(_GRID / sd),
            "normal": chi.cdf(np.sqrt(3.0) * _GRID / sd, 3),
            "climatology": ((error <= _GRID) * weight[:, None]).sum(axis=0)[None],
        }
        log, logs = _log_index(used)
        cells: dict[str, object] = {}
        width = np.diff([0.0, *_GRID])
        for name, law in laws.items():
            score = ((law - (error <= _GRID)) ** 2 * width).sum(axis=1)
            low, high = interval(_sums(log, score * weight, logs), _sums(log, weight, logs))
            cells[f"CRPS, {name} [R]"] = f"{(score * weight).sum():.3f} ({low:.3f} to {high:.3f})"
        return cells

    return _rows(errors, row)
