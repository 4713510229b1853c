"""Forecast of what a run costs, from the sizes in its scenario.

The forecast is processor time on one core of a server of 2023, measured on structures of 100 to
90,000 robots.
"""

from dataclasses import replace
from typing import NamedTuple

from tiswarm.base.progress import Progress
from tiswarm.base.registry import registered
from tiswarm.records.messages import counted
from tiswarm.scenario.expansion import Group, plan, structure_kind, variants
from tiswarm.scenario.model import Scenario
from tiswarm.study.executors import Execution
from tiswarm.study.runner import ROBOTS_AT_ONCE

_START_S = 4.0  # start of a process and its kernels
_CLIMB_S = 1e-3  # growth of a robot without mechanics
_SOLVE_S = {  # solve of the mechanics: at all, for each robot, for each pair of robots
    "flexible": (5e-5, 5e-6, 1.2e-8),
    "rigid": (5e-5, 3e-6, 1.6e-9),  # a third of that in towers, three times in heaps
}
_REST_S = 5e-4  # sensing, evaluation and storage of a robot
_BASE_MB = 270.0  # memory of the program
_ROBOT_MB = 0.1  # memory of each robot of a batch, most of all in `joint`

_IN_THIS_PROCESS = Execution()


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


def forecast(scenario: Scenario, execution: Execution = _IN_THIS_PROCESS) -> Forecast:
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
        localize_s=sum(seeds * _localize_s(settings) for settings, seeds in points),
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
    has_plugins = any(map(registered, ("method", "sensor", "structure", "rule")))
    if has_plugins or execution.workers in {None, 1} or execution.case_limit_s is not None:
        return execution
    works_s = [_structure_s(group) for group in plan(scenario).structures]
    total_s = sum(works_s)
    workers = min(execution.workers or 1, len(works_s))
    saved_s = total_s - max(*works_s, total_s / workers, 0.0)
    if workers > 1 and saved_s >= _SAVED_S:
        return replace(execution, workers=workers)
    why = f"{counted(len(works_s), 'structure')}, {_time(total_s)} of work"
    progress.info(f"one process instead of {execution.workers}: {why}; more would save no time")
    return replace(execution, workers=None)


def _structure_s(group: Group) -> float:
    """Estimate the work for a structure under all of its conditions [s]."""
    cases = [case.settings for case in group]
    localize_s = sum(_localize_s(settings) for settings in cases)
    rest_s = sum(_REST_S * settings.robots for settings in cases)
    return _grow_s(cases[0]) + localize_s + rest_s


def _localize_s(settings: Scenario) -> float:
    """Estimate the localization of the robots of a structure [s]."""
    return settings.localization.seconds(settings.robots)


def _grow_s(settings: Scenario) -> float:
    """Estimate the growth of a structure, whose mechanics are solved at every size [s]."""
    n = settings.robots
    structure = settings.structure
    if settings.localization.runs_engine:
        return 0.0
    constant, linear, quadratic = _SOLVE_S[structure.mechanics.model]
    solve = constant + linear * n / 2.0 + quadratic * n**2 / 3.0
    believe = _believe_s(settings) if structure.navigate_by == "estimate" else 0.0
    return _CLIMB_S * n + solve * n / structure.solve_every + believe


def _believe_s(settings: Scenario) -> float:
    """Estimate the localization of robots while they build: at each join of one or of all [s]."""
    n = settings.robots
    params = settings.localization
    return params.seconds(n) * (1.0 if params.joining else n / 2.0)


def _time(seconds: float) -> str:
    # To two digits, in the largest unit that fits twice.
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"
