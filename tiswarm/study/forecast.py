"""Forecast of what a run costs, from the sizes in its scenario.

Times are processor time on one core of a server of 2023, measured on structures of 100 to 90,000
robots.
"""

from typing import NamedTuple

from tiswarm.localization import settings as methods
from tiswarm.records.messages import counted
from tiswarm.scenario.expansion import variants
from tiswarm.scenario.model import Scenario
from tiswarm.study.cases import structure_kind
from tiswarm.study.executors import Execution
from tiswarm.study.runner import ROBOTS_AT_ONCE

_START_S = 4.0  # start of a process and its kernels
_CLIMB_S = 1e-3  # growth of a robot without mechanics
_SOLVE_S = {  # solve of the mechanics: at all, for each robot, for each pair of robots
    "flexible": (5e-5, 5e-6, 1.2e-8),
    "rigid": (5e-5, 3e-6, 1.6e-9),  # a third of that in towers, three times in heaps
}
_VIRTUAL_FORCE_S = 1.3e-6  # iteration of a robot
_TOGETHER_S = 4e-7  # step of a robot
_JOINT_S = 8e-7  # step of a robot in one chain
_LEAST_SQUARES_S = 0.01  # localization of a robot
_ONLINE_S = 0.07  # join of a robot
_PEER_S = 0.01  # join of a robot by messages, without annealing
_PEER_STEP_S = 8e-6, 1e-7  # step of one chain of it: at all, for each robot
_SENDING_S = 1.5e-3  # messages of a robot in Algorithm 1
_REST_S = 5e-4  # sensing, evaluation and storage of a robot
_BASE_MB = 270.0  # memory of the program
_ROBOT_MB = 0.05  # memory of each robot of a batch, most of all in `joint`

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

    def __str__(self) -> str:
        """Write the estimate in one line."""
        total = self.start_s + self.grow_s + self.localize_s + self.rest_s
        return (
            f"{counted(self.cases, 'case')}, {counted(self.robots, 'robot')} in all; estimate: "
            f"{_time(total)} of processor time (start {_time(self.start_s)}, growth "
            f"{_time(self.grow_s)}, localization {_time(self.localize_s)}), {self.memory_mb:.0f} MB"
        )


def forecast(scenario: Scenario, execution: Execution = _HERE) -> Forecast:
    """Estimate the cost of a run without its drawings, to a factor of about three; machines differ.

    Each process of `execution` starts once; all parts of a sharded run count.
    """
    seeds, points = len(scenario.seed_list), [point.settings for point in variants(scenario)]
    robots = seeds * sum(settings.robots for settings in points)
    largest = max(settings.robots for settings in points)
    at_once = max(min(robots, ROBOTS_AT_ONCE), largest)
    grown = {structure_kind(settings): settings for settings in points}
    return Forecast(
        cases=seeds * len(points),
        robots=robots,
        start_s=_START_S * (1 + execution.processes),
        grow_s=seeds * sum(map(_grow_s, grown.values())),
        localize_s=seeds * sum(map(_localize_s, points)),
        rest_s=_REST_S * robots,
        memory_mb=_BASE_MB + _ROBOT_MB * at_once,
    )


def _grow_s(settings: Scenario) -> float:
    """Estimate the growth of a structure, whose mechanics are solved at every size [s]."""
    n, structure = settings.robots, settings.structure
    once, each, squared = _SOLVE_S[structure.mechanics.model]
    solve = once + each * n / 2.0 + squared * n**2 / 3.0
    believe = _believe_s(settings) if structure.navigate_by == "estimate" else 0.0
    return _CLIMB_S * n + solve * n / structure.solve_every + believe


def _believe_s(settings: Scenario) -> float:
    """Estimate the localization of robots while they build: at each join of one or of all [s]."""
    params = settings.localization
    is_one = isinstance(params, methods.OnlineParams)
    if isinstance(params, methods.VirtualForceParams):
        is_one = params.schedule == "join-order" and params.back_propagation is None
    return _localize_s(settings) * (1.0 if is_one else settings.robots / 2.0)


def _localize_s(settings: Scenario) -> float:
    n, params = settings.robots, settings.localization
    if isinstance(params, methods.VirtualForceParams):
        if params.schedule == "together":
            return _TOGETHER_S * n * params.together.steps
        return _VIRTUAL_FORCE_S * n * (params.iterations + _sweeps(params.back_propagation, n))
    if isinstance(params, methods.JointParams):
        return _JOINT_S * n * params.chains_for(n) * (params.steps_for(n) + params.hold_steps)
    if isinstance(params, methods.OnlineParams):
        return _ONLINE_S * n
    if isinstance(params, methods.DistributedParams):
        return _distributed_s(params, n)
    return _LEAST_SQUARES_S * n


def _distributed_s(params: methods.DistributedParams, n: int) -> float:
    """Estimate the localization of n robots by what they send each other [s]."""
    if params.scheme == "algorithm-1":
        steps = methods.VirtualForceParams().iterations + _sweeps(params.back_propagation, n)
        return n * (_SENDING_S + _VIRTUAL_FORCE_S * steps)
    once, each = _PEER_STEP_S
    return n * (_PEER_S + params.chains * params.steps * (once + each * n))


def _sweeps(rounds: methods.BackPropagation | None, n: int) -> float:
    """Return the steps of a robot in all rounds of back-propagation, in the mean of n robots."""
    if rounds is None:
        return 0.0
    after = [*range(rounds.every, n, rounds.every), n]  # so many joins
    moved = sum(min(joins, rounds.recent or n) for joins in after)
    return float(rounds.sweeps * moved / n)


def _time(seconds: float) -> str:
    # To two digits, in the largest unit that fits twice.
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"
