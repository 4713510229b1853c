"""Compares what a method states with exact posteriors of small logs, of 8 to 12 robots.

    python -m benchmarks.estimates.posterior --logs 60
    python -m benchmarks.estimates.posterior --logs 50 --training    # to fit constants on

`tests/oracle_posterior.py` draws from the posterior, in two independent runs a log. --out has a
row a robot, and the table of means. It continues where it stopped.

A continuous ranked probability score judges a stated law of the distance between the true center
and the estimate by the one that there was. `law` is the law of error / sd with the sd of the method
(`tiswarm.records.error_law`), `normal` a normal error of this sd along three axes, and `exact` the
distances of the draws from their mean.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import tiswarm
from benchmarks.estimates.sets import TRAINING, small
from benchmarks.within.reliability import interval
from tests.oracle_posterior import Posterior, posterior
from tiswarm.base.aliases import Reals
from tiswarm.compute import backend
from tiswarm.records.error_law import ERRORS

GRID = np.geomspace(0.02, 60.0, 120)
"""Distances over which a score is summed [R]."""

SPHERE = 1.6
"""Radius of a 90 % sphere [sd]."""

_RESAMPLES = 1000


class RobotRow(NamedTuple):
    """One robot of a log, as a method and the exact posterior state it. Lengths in R."""

    number: int
    kind: str
    robot: int
    error_R: float  # noqa: N815 - a column with its unit
    sd_R: float  # noqa: N815 - a column with its unit
    crps_law_R: float  # noqa: N815 - a column with its unit
    crps_normal_R: float  # noqa: N815 - a column with its unit
    exact_error_R: float  # noqa: N815 - a column with its unit
    exact_sd_R: float  # noqa: N815 - a column with its unit
    crps_exact_R: float  # noqa: N815 - a column with its unit
    one_run_sd_R: float  # noqa: N815 - a column with its unit
    other_run_sd_R: float  # noqa: N815 - a column with its unit
    runs_apart_R: float  # noqa: N815 - a column with its unit
    method_cpu_s: float
    exact_cpu_s: float


def score(stated: Reals, error: Reals) -> Reals:
    """Compute continuous ranked probability scores [R], shape (n,).

    Args:
        stated: Probabilities that errors are below the distances of `GRID`, shape (n, distances).
        error: Errors that there are [R], shape (n,).
    """
    width = np.diff([0.0, *GRID])
    total: Reals = ((stated - (error[:, None] <= GRID)) ** 2 * width).sum(axis=1)
    return total


def of_draws(distance: Reals, weight: Reals) -> Reals:
    """Sum the weights of draws below each distance of `GRID`, shape (n, distances).

    Args:
        distance: Distances of k draws [R], shape (k, n).
        weight: Their weights, which add up to 1, shape (k,).
    """
    rows = []
    for of_robot in distance.T:
        order = np.argsort(of_robot)
        reached = np.concatenate([[0.0], np.cumsum(weight[order])])
        rows.append(reached[np.searchsorted(of_robot[order], GRID, side="right")])
    return np.array(rows)


def compared(number: int, method: str) -> Iterator[RobotRow]:
    """Localize a log by a method, draw from its posterior, and compare robot by robot."""
    from scipy.stats import chi  # noqa: PLC0415 - slow to import

    case = small(number)
    unit = case.log.dock_radius
    truth = case.truth / unit
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # verdicts do not matter
        estimate = tiswarm.localize(case.log, method, threads=1)
    method_s = time.process_time() - begun
    begun = time.process_time()
    first = posterior(case.log, seed=0)
    second = posterior(case.log, seed=1)
    exact_s = time.process_time() - begun
    exact = Posterior.of_both(first, second)
    if estimate.sd is None:
        message = f"{method} states no sd"
        raise SystemExit(message)
    sd = estimate.sd / unit
    error = np.linalg.norm(estimate.position / unit - truth, axis=1)
    exact_error = np.linalg.norm(exact.mean - truth, axis=1)
    apart = np.linalg.norm(first.mean - second.mean, axis=1)
    moving = slice(1, None)
    ratio = GRID / sd[moving, None]
    laws = [
        score(ERRORS.probability(ratio), error[moving]),
        score(chi.cdf(np.sqrt(3.0) * ratio, 3), error[moving]),
        score(of_draws(exact.distances(exact.mean), exact.weight)[moving], exact_error[moving]),
    ]
    columns = [
        error[moving], sd[moving], laws[0], laws[1], exact_error[moving], exact.sd[moving],
        laws[2], first.sd[moving], second.sd[moving], apart[moving],
    ]  # fmt: skip
    for robot, values in enumerate(np.array(columns).T.tolist(), start=1):
        yield RobotRow._make([number, case.kind, robot, *values, method_s, exact_s])


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Tabulate means over logs, with 95 % intervals by a bootstrap of logs."""
    logs = table.groupby("number")

    def by_log(values: Reals) -> Reals:
        return pd.Series(values).groupby(table["number"].to_numpy()).mean().to_numpy(np.float64)

    def mean_square(column: str) -> Reals:
        return by_log(table[column].to_numpy(np.float64) ** 2)

    def of_ratio(upper: Reals, lower: Reals, form: Callable[[float], float] = float) -> str:
        low, high = interval(upper, lower)
        return _text(form(upper.sum() / lower.sum()), form(low), form(high))

    ratio = (table["sd_R"] / table["exact_sd_R"]).to_numpy(np.float64)
    of_log = pd.Series(ratio).groupby(table["number"].to_numpy()).median().to_numpy(np.float64)
    runs = (table["one_run_sd_R"] / table["other_run_sd_R"]).to_numpy(np.float64)
    exact = by_log(table["crps_exact_R"].to_numpy(np.float64))
    law = by_log(table["crps_law_R"].to_numpy(np.float64))
    normal = by_log(table["crps_normal_R"].to_numpy(np.float64))
    is_inside = table["error_R"] < SPHERE * table["sd_R"]
    is_inside_exact = table["exact_error_R"] < SPHERE * table["exact_sd_R"]
    rows = {
        "logs": f"{logs.ngroups}",
        "robots": f"{len(table)}",
        "sd / exact sd, median of logs": _median_text(of_log),
        "sd / exact sd, 10 to 90 % of robots": "{:.2f} to {:.2f}".format(
            *np.quantile(ratio, [0.1, 0.9])
        ),
        "error / exact error, root mean square": of_ratio(
            mean_square("error_R"), mean_square("exact_error_R"), np.sqrt
        ),
        "robots in 90 % spheres [%]": f"{100 * is_inside.mean():.0f}",
        "the same, exact [%]": f"{100 * is_inside_exact.mean():.0f}",
        "CRPS, exact [R]": f"{exact.mean():.3f}",
        "CRPS, law [R]": f"{law.mean():.3f}",
        "CRPS, law / exact": of_ratio(law, exact),
        "CRPS, normal [R]": f"{normal.mean():.3f}",
        "CRPS, normal / exact": of_ratio(normal, exact),
        "sd of two exact runs, 10 to 90 % of robots": "{:.2f} to {:.2f}".format(
            *np.quantile(runs, [0.1, 0.9])
        ),
        "CPU s, method": f"{logs['method_cpu_s'].first().mean():.1f}",
        "CPU s, exact, two runs": f"{logs['exact_cpu_s'].first().mean():.1f}",
    }
    return pd.DataFrame({"quantity": [*rows], "value": [*rows.values()]})


def _median_text(values: Reals) -> str:
    """Write a median with its 95 % interval by a bootstrap."""
    rng = np.random.default_rng(0)
    drawn = np.median(values[rng.integers(0, len(values), (_RESAMPLES, len(values)))], axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return _text(float(np.median(values)), float(low), float(high))


def _text(value: float, low: float, high: float) -> str:
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def main() -> int:
    """Compare logs that are not in the table yet, and print the means."""
    options = _options()
    backend.start(threads=1)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f"{options.method}.csv"
    table = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=RobotRow._fields)
    first = options.first + TRAINING * options.training
    for number in range(first, first + options.logs):
        if (table["number"] == number).any():
            continue
        rows = pd.DataFrame([*compared(number, options.method)])
        table = pd.concat([table, rows], ignore_index=True) if len(table) else rows
        table.to_csv(path, index=False, float_format="%.6g")
    total = summary(table)
    total.to_csv(options.out / f"{options.method}-summary.csv", index=False)
    print(total.to_string(index=False))
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimates.posterior",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--logs", type=int, default=60, metavar="N", help="number of logs")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first log")
    parser.add_argument("--method", default="joint", help="a method that states an sd")
    parser.add_argument("--training", action="store_true", help="logs to fit constants on")
    parser.add_argument("--out", type=Path, default=Path("reports/posterior"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
