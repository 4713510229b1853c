"""Forecast of what a run costs, from the sizes in its scenario, and table of what it cost.

The forecast is processor time on one core of a server of 2023, measured on structures of 100 to
90,000 robots.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tiswarm.base.parts import registered
from tiswarm.base.progress import Progress
from tiswarm.evaluation import metrics
from tiswarm.records import measures
from tiswarm.records.frames import read_frame
from tiswarm.records.messages import counted
from tiswarm.scenario.expansion import Case, Group, plan, structure_kind, variants
from tiswarm.scenario.model import Scenario
from tiswarm.study.executors import Execution
from tiswarm.study.provenance import Cost
from tiswarm.study.runner import ROBOTS_AT_ONCE
from tiswarm.study.store import CaseRecord

_START_S = 4.0  # start of a process and its kernels
_CLIMB_S = 1e-3  # growth of a robot without mechanics
_SOLVE_S = {  # solve of the mechanics: at all, for each robot, for each pair of robots
    "flexible": (5e-5, 5e-6, 1.2e-8),
    "rigid": (5e-5, 3e-6, 1.6e-9),  # a third of that in towers, three times in heaps
}
_REST_S = 5e-4  # sensing, evaluation and storage of a robot
_BASE_MB = 270.0  # memory of the program
_ROBOT_MB = 0.1  # memory of each robot of a batch, most of all in `joint`

_HERE = Execution()


class Forecast(NamedTuple):
    """Size of a run, its estimated times on one core [s], and peak memory of a process [MB]."""

    cases: int
    robots: int
    start_s: float
    grow_s: float
    localize_s: float
    rest_s: float
    memory_mb: float

    @property
    def work_s(self) -> float:
        """All but the start [s]."""
        return self.grow_s + self.localize_s + self.rest_s

    def __str__(self) -> str:
        """Write the estimate in one line."""
        total = self.start_s + self.work_s
        return (
            f"{counted(self.cases, 'case')}, {counted(self.robots, 'robot')} in all; estimate: "
            f"{_time(total)} of processor time (start {_time(self.start_s)}, growth "
            f"{_time(self.grow_s)}, localization {_time(self.localize_s)}, scores "
            f"{_time(self.rest_s)}), {self.memory_mb:.0f} MB"
        )


def forecast(scenario: Scenario, execution: Execution = _HERE) -> Forecast:
    """Estimate the cost of a run without its drawings, to a factor of about three; machines differ.

    Each process of `execution` starts once; all parts of a sharded run count.
    """
    points = [(point.settings, len(point.settings.seed_list)) for point in variants(scenario)]
    robots = sum(seeds * settings.robots for settings, seeds in points)
    largest = max(settings.robots for settings, _ in points)
    at_once = max(min(robots, ROBOTS_AT_ONCE), largest)
    grown = {structure_kind(settings): (settings, seeds) for settings, seeds in points}
    return Forecast(
        cases=sum(seeds for _, seeds in points),
        robots=robots,
        start_s=_START_S * (1 + execution.processes),
        grow_s=sum(seeds * _grow_s(settings) for settings, seeds in grown.values()),
        localize_s=sum(seeds * each.localization.seconds(each.robots) for each, seeds in points),
        rest_s=_REST_S * robots,
        memory_mb=_BASE_MB + _ROBOT_MB * at_once,
    )


_SAVED_S = 10.0
"""Least wall time that several processes must save [s]: each has libraries and kernels to load."""


def fewer(scenario: Scenario, execution: Execution, progress: Progress) -> Execution:
    """Compute in this process where several save little time, and say so.

    One process computes a structure, so there are no more processes than structures. All stay where
    a case has a limit of time, or where the code of a plug-in may take any time.
    """
    own = any(map(registered, ("method", "sensor", "structure", "rule")))
    if own or execution.workers in {None, 1} or execution.case_limit_s is not None:
        return execution
    each = [_structure_s(group) for group in plan(scenario).structures]
    many = min(execution.workers or 1, len(each))
    saved_s = sum(each) - max(*each, sum(each) / many, 0.0)
    if many > 1 and saved_s >= _SAVED_S:
        return replace(execution, workers=many)
    why = f"{counted(len(each), 'structure')}, {_time(sum(each))} of work"
    progress.info(f"one process instead of {execution.workers}: {why}; more would save no time")
    return replace(execution, workers=None)


def _structure_s(group: Group) -> float:
    """Estimate the work for a structure under all of its conditions [s]."""
    cases = [case.settings for case in group]
    localize = sum(each.localization.seconds(each.robots) for each in cases)
    return _grow_s(cases[0]) + localize + sum(_REST_S * each.robots for each in cases)


def _grow_s(settings: Scenario) -> float:
    """Estimate the growth of a structure, whose mechanics are solved at every size [s]."""
    n, structure = settings.robots, settings.structure
    once, each, squared = _SOLVE_S[structure.mechanics.model]
    solve = once + each * n / 2.0 + squared * n**2 / 3.0
    believe = _believe_s(settings) if structure.navigate_by == "estimate" else 0.0
    return _CLIMB_S * n + solve * n / structure.solve_every + believe


def _believe_s(settings: Scenario) -> float:
    """Estimate the localization of robots while they build: at each join of one or of all [s]."""
    n, params = settings.robots, settings.localization
    return params.seconds(n) * (1.0 if params.joining else n / 2.0)


def _time(seconds: float) -> str:
    # To two digits, in the largest unit that fits twice.
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


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
    fitted to all points; `slope` is p between a point and the one before, where constant costs
    matter less. The growth of a structure counts once for any number of its conditions. Memory is
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
    column, rows = axis.rpartition(".")[2], []
    for group in structures:
        done = [case for case in group if case.name in records and records[case.name].is_done]
        grown = _together([costs[case.name].get("grow", {}) for case in done])
        built = _built(run / "cases" / done[0].name) if done else {}
        for case in done:
            record = records[case.name]
            point = {key: value for key, value in record.point.items() if key != axis}
            stages = {**costs[case.name], "grow": grown}
            measured = {each.column: record.scores.get(each.column) for each in _SCORES}
            measured |= built | _spent(case, record, stages)
            row = {"series": replace(record, point=point).series, column: AXES[axis](case.settings)}
            rows += [
                row | {"measure": name, "mean": value}
                for name, value in measured.items()
                if value is not None
            ]
    table = pd.DataFrame(rows, columns=["series", "measure", column, "mean"])
    alike = table.groupby(["series", "measure", column], sort=False)["mean"]
    points = alike.agg(mean="mean", least="min", most="max", structures="count").reset_index()
    points = points.sort_values(column, kind="stable")
    parts = [
        _with_powers(part, column) for _, part in points.groupby(["series", "measure"], sort=False)
    ]
    return {"scaling": pd.concat(parts) if parts else _with_powers(points, column)}


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
    found = {
        f"{stage.replace(' ', '_')}_{unit}": number
        for stage, cost in stages.items()
        for unit, number in cost.items()
    }
    known = {stage: cost for stage, cost in stages.items() if cost}
    if not known:
        return found
    for unit in ("cpu_s", "wall_s"):
        found[f"total_{unit}"] = sum(cost[unit] for cost in known.values())
    found["peak_memory_MB"] = max(cost["peak_memory_MB"] for cost in known.values())
    whole = found["total_cpu_s"] or math.nan
    for stage, cost in known.items():
        found[f"{stage.replace(' ', '_')}_share"] = cost["cpu_s"] / whole
    joined = record.scores.get(measures.JOINED.column) or math.nan
    steps = record.scores.get(measures.STEPS.column) or math.nan
    at_once = case.settings.workers or 1
    for stage, name, count in (
        ("total", "structures", 1.0),
        ("grow", "joins", joined),
        ("localize", "robot_steps", joined * steps),
    ):
        for unit in ("wall_s", "cpu_s"):
            if (spent := found.get(f"{stage}_{unit}", 0.0)) > 0.0 and not math.isnan(count):
                rate = f"{name}_per_{unit}"
                found[rate] = count / spent * (at_once if unit == "wall_s" else 1)
    return found


def _together(costs: Sequence[Cost]) -> Cost:
    """Return the cost that cases share."""
    known = [cost for cost in costs if cost]
    peak = max((cost["peak_memory_MB"] for cost in known), default=math.nan)
    times = {unit: sum(cost[unit] for cost in known) for unit in ("wall_s", "cpu_s")}
    return {**times, "peak_memory_MB": peak} if known else {}


def _with_powers(points: pd.DataFrame, column: str) -> pd.DataFrame:
    """Add the columns `exponent` and `slope` to the means of one measure, by ascending number."""
    at, mean = points[column].to_numpy(float), points["mean"].to_numpy(float)
    known = np.log(np.where(mean > 0.0, mean, math.nan))
    slope = np.diff(known, prepend=math.nan) / np.diff(np.log(at), prepend=math.nan)
    return points.assign(exponent=metrics.power_law_exponent(at, mean), slope=slope)
