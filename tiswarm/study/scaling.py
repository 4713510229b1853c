"""`scaling.csv`: accuracy and cost of a run against the number of robots."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from tiswarm.evaluation.metrics import power_law_exponent
from tiswarm.study.cases import Group
from tiswarm.study.provenance import Cost
from tiswarm.study.store import CaseRecord

_SCALED = ("rmse_R", "procrustes_disparity")


def scaling(
    structures: Sequence[Group],
    records: Mapping[str, CaseRecord],
    costs: Mapping[str, Mapping[str, Cost]],
) -> pd.DataFrame:
    """Tabulate accuracy, times and memory of each stage against N, with exponents p of N^p.

    `exponent` is fitted to all sizes; `slope` is p between a size and the one before, where
    constant costs matter less. The growth of a structure counts once for any number of its
    conditions. Memory is that of the whole batch that a structure was computed in.

    Args:
        structures: Cases by the structure that they share, small ones first.
        records: Records of stored cases by name.
        costs: Costs of these cases by name and stage.
    """
    rows = []
    for group in structures:
        done = [case for case in group if case.name in records and records[case.name].is_done]
        grown = _together([costs[case.name].get("grow", {}) for case in done])
        for case in done:
            record = records[case.name]
            point = {key: value for key, value in record.point.items() if key != "robots"}
            measured = {name: record.scores[name] for name in _SCALED}
            for stage, cost in {**costs[case.name], "grow": grown}.items():
                measured |= {f"{stage.replace(' ', '_')}_{unit}": n for unit, n in cost.items()}
            row = {"series": replace(record, point=point).series, "robots": case.settings.robots}
            rows += [row | {"measure": name, "mean": value} for name, value in measured.items()]
    table = pd.DataFrame(rows, columns=["series", "measure", "robots", "mean"])
    alike = table.groupby(["series", "measure", "robots"], sort=False, as_index=False)
    points = alike.agg({"mean": "mean"}).sort_values("robots", kind="stable")
    parts = [_with_powers(part) for _, part in points.groupby(["series", "measure"], sort=False)]
    return pd.concat(parts) if parts else _with_powers(points)


def _together(costs: Sequence[Cost]) -> Cost:
    """Return the cost that cases share."""
    known = [cost for cost in costs if cost]
    peak = max((cost["peak_memory_MB"] for cost in known), default=math.nan)
    times = {unit: sum(cost[unit] for cost in known) for unit in ("wall_s", "cpu_s")}
    return {**times, "peak_memory_MB": peak} if known else {}


def _with_powers(points: pd.DataFrame) -> pd.DataFrame:
    """Add the columns `exponent` and `slope` to the means of one measure, by ascending N."""
    robots, mean = points["robots"].to_numpy(float), points["mean"].to_numpy(float)
    known = np.log(np.where(mean > 0.0, mean, math.nan))
    slope = np.diff(known, prepend=math.nan) / np.diff(np.log(robots), prepend=math.nan)
    return points.assign(exponent=power_law_exponent(robots, mean), slope=slope)
