"""`scaling.csv`: how accuracy and cost change with the number of robots."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from tiswarm.evaluation.metrics import power_law_exponent
from tiswarm.study.cases import Case, series_text, structures
from tiswarm.study.costs import Cost
from tiswarm.study.storage import CaseRecord, RunFolder, write_table

FILE = "scaling.csv"
ACCURACY = ("rmse_R", "procrustes_disparity")


def write_scaling(
    folder: RunFolder, cases: Sequence[Case], records: Mapping[str, CaseRecord]
) -> None:
    """Write accuracy, times and memory of each stage against N, and exponents p of N^p.

    `exponent` is fitted to all sizes, `slope` is p from the size before alone: what a computation
    always costs hides how it grows in the former.

    Growth counts once for each structure, whatever the number of its conditions. Memory is that of
    the whole batch a structure was computed in. Runs of one size have no such table.

    Args:
        folder: Where the cases are stored.
        cases: Every case.
        records: By name, what came of each.
    """
    if len({case.settings.robots for case in cases}) < 2:  # noqa: PLR2004 - nothing to compare
        return
    rows = []
    for group in structures(cases):
        done = [case for case in group if records[case.name].scores]
        costs = {case.name: folder.cost(case.name) for case in done}
        grown = _together([cost.get("grow", {}) for cost in costs.values()])
        for case in done:
            measured = _columns({**costs[case.name], "grow": grown})
            scores = {name: records[case.name].scores[name] for name in ACCURACY}
            rows += [
                {
                    "series": _series(case),
                    "robots": case.settings.robots,
                    "measure": name,
                    "mean": value,
                }
                for name, value in (scores | measured).items()
            ]
    table = pd.DataFrame(rows, columns=["series", "measure", "robots", "mean"])
    alike = table.groupby(["series", "measure", "robots"], sort=False, as_index=False)
    points = alike.agg({"mean": "mean"}).sort_values("robots", kind="stable")
    parts = [_with_powers(part) for _, part in points.groupby(["series", "measure"], sort=False)]
    write_table(pd.concat(parts) if parts else _with_powers(points), folder.path / FILE)


def _with_powers(points: pd.DataFrame) -> pd.DataFrame:
    """Add the columns `exponent` and `slope` to the means of one measure, by ascending N."""
    robots, mean = points["robots"].to_numpy(float), points["mean"].to_numpy(float)
    known = np.log(np.where(mean > 0.0, mean, math.nan))
    slope = np.diff(known, prepend=math.nan) / np.diff(np.log(robots), prepend=math.nan)
    return points.assign(exponent=power_law_exponent(robots, mean), slope=slope)


def _together(costs: Sequence[Cost]) -> Cost:
    """Undo the sharing of a cost among cases."""
    known = [cost for cost in costs if cost]
    peak = max((cost["peak_memory_MB"] for cost in known), default=math.nan)
    times = {unit: sum(cost[unit] for cost in known) for unit in ("wall_s", "cpu_s")}
    return {**times, "peak_memory_MB": peak} if known else {}


def _columns(costs: Mapping[str, Cost]) -> dict[str, float]:
    """Name each number after its stage and unit, as `grow_wall_s`."""
    return {
        f"{stage.replace(' ', '_')}_{unit}": value
        for stage, cost in costs.items()
        for unit, value in cost.items()
    }


def _series(case: Case) -> str:
    """What a case has in common with those of other sizes."""
    point = {key: value for key, value in case.variant.point.items() if key != "robots"}
    return series_text(point, case.variant.condition)
