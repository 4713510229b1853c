"""The table `scaling.csv`: accuracy, size, time to build and costs against numbers of robots."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from tiswarm.evaluation import metrics
from tiswarm.records import measures
from tiswarm.records.frames import read_frame
from tiswarm.records.intervals import mean_std_ci95
from tiswarm.scenario.expansion import Case, Group
from tiswarm.study.provenance import Cost
from tiswarm.study.store import CaseRecord

AXES = {
    "robots": lambda settings: settings.robots,
    "threads": lambda settings: settings.threads,
    "workers": lambda settings: settings.workers,
    "structure.movers": lambda settings: settings.structure.movers,
}
"""Swept keys against which `scaling.csv` tabulates: the first with more than one value."""

_SCORES = (*measures.MAIN, measures.HEIGHT, measures.REACH, measures.DEPTH, measures.SENSED_MAX)


def scaling(
    run: Path,
    structures: Sequence[Group],
    records: Mapping[str, CaseRecord],
    costs: Mapping[str, Mapping[str, Cost]],
) -> dict[str, pd.DataFrame]:
    """Tabulate accuracy, size, time to build and costs against N, with exponents p of N^p.

    Where all structures have the same N, threads, workers or movers take its place. `exponent` is
    fitted to all structures, `exponent_ci95` is the half width of its confidence interval; `slope`
    is p between the means of a point and the one before, where constant costs matter less. The
    growth of a structure counts once for any number of its conditions. Memory is
    that of the whole batch that a structure was computed in.

    Args:
        run: Folder of the run.
        structures: Cases by the structure that they share, small ones first.
        records: Records of stored cases by name.
        costs: Costs of these cases by name and stage.

    Returns:
        `scaling` and its table; empty if the cases differ in none of these numbers.
    """
    cases = [case for group in structures for case in group]
    axis = next((key for key in AXES if len({AXES[key](c.settings) for c in cases}) > 1), "")
    if not axis:
        return {}
    column = axis.rpartition(".")[2]
    rows = []
    for group in structures:
        done = [case for case in group if case.name in records and records[case.name].is_done]
        grown = _together([costs[case.name].get("grow", {}) for case in done])
        built = _built(run / "cases" / done[0].name) if done else {}
        for case in done:
            record = records[case.name]
            point = {key: value for key, value in record.point.items() if key != axis}
            stages = {**costs[case.name], "grow": grown}
            measured = {score.column: record.scores.get(score.column) for score in _SCORES}
            measured |= built | _spent(case, record, stages)
            row = {"series": replace(record, point=point).series, column: AXES[axis](case.settings)}
            rows += [
                row | {"measure": name, "mean": value}
                for name, value in measured.items()
                if value is not None
            ]
    table = pd.DataFrame(rows, columns=["series", "measure", column, "mean"])
    curves = [
        _with_powers(values, column)
        for _, values in table.groupby(["series", "measure"], sort=False)
    ]
    return {"scaling": pd.concat(curves) if curves else _with_powers(table, column)}


def _built(case: Path) -> dict[str, float]:
    """Return the time to build a structure, in flips and in rounds.

    A robot that climbs alone takes all flips one after the other. Robots of a round climb at the
    same time, and the round takes as long as the longest of their walks.
    """
    grown = read_frame(case / "growth.csv", numbers=["flips", "round"])
    of_rounds = grown.groupby("round")["flips"].max()
    return {
        "flips": float(grown["flips"].sum()),
        "growth_rounds": float(len(of_rounds)),
        "makespan_flips": float(of_rounds.sum()),
    }


def _spent(case: Case, record: CaseRecord, stages: Mapping[str, Cost]) -> dict[str, float]:
    """Return times and memory of the stages of a case, their shares, and throughput.

    Workers compute structures at the same time.
    """
    columns = {
        f"{stage.replace(' ', '_')}_{unit}": number
        for stage, cost in stages.items()
        for unit, number in cost.items()
    }
    measured = {stage: cost for stage, cost in stages.items() if cost}
    if not measured:
        return columns
    for unit in ("cpu_s", "wall_s"):
        columns[f"total_{unit}"] = sum(cost[unit] for cost in measured.values())
    columns["peak_memory_MB"] = max(cost["peak_memory_MB"] for cost in measured.values())
    whole = columns["total_cpu_s"] or math.nan
    for stage, cost in measured.items():
        columns[f"{stage.replace(' ', '_')}_share"] = cost["cpu_s"] / whole
    joined = record.scores.get(measures.JOINED.column) or math.nan
    steps = record.scores.get(measures.STEPS.column) or math.nan
    at_once = case.settings.workers or 1
    for stage, name, count in (
        ("total", "structures", 1.0),
        ("grow", "joins", joined),
        ("localize", "robot_steps", joined * steps),
    ):
        for unit in ("wall_s", "cpu_s"):
            spent = columns.get(f"{stage}_{unit}", 0.0)
            if spent > 0.0 and not math.isnan(count):
                rate = f"{name}_per_{unit}"
                columns[rate] = count / spent * (at_once if unit == "wall_s" else 1)
    return columns


def _together(costs: Sequence[Cost]) -> Cost:
    """Return the cost that cases share."""
    measured = [cost for cost in costs if cost]
    peak = max((cost["peak_memory_MB"] for cost in measured), default=math.nan)
    times = {unit: sum(cost[unit] for cost in measured) for unit in ("wall_s", "cpu_s")}
    return {**times, "peak_memory_MB": peak} if measured else {}


def _with_powers(values: pd.DataFrame, column: str) -> pd.DataFrame:
    """Average one measure of a series by ascending number, and add its power of the number.

    Args:
        values: A row for each structure, with its number in `column` and its value in `mean`.
        column: Column of the number.
    """
    means = values.groupby(["series", "measure", column], sort=False)["mean"]
    points = means.agg(
        mean="mean", least="min", most="max", ci95=_half_width, structures="count"
    ).reset_index()
    points = points.sort_values(column, kind="stable")
    at = points[column].to_numpy(float)
    mean = points["mean"].to_numpy(float)
    log_mean = np.log(np.where(mean > 0.0, mean, math.nan))
    slope = np.diff(log_mean, prepend=math.nan) / np.diff(np.log(at), prepend=math.nan)
    finite = values[values["mean"].notna()]
    exponent, half = math.nan, math.nan
    if len(finite):
        exponent, half = metrics.power_law(
            finite[column].to_numpy(float), finite["mean"].to_numpy(float)
        )
    return points.assign(exponent=exponent, exponent_ci95=half, slope=slope)


def _half_width(values: "pd.Series[float]") -> float:
    """Return the half width of the 95 % confidence interval of a mean; NaN of few values."""
    return mean_std_ci95(np.asarray(values, np.float64))["ci95"]
