"""What a run will take, before it starts: an estimate from costs measured on other runs.

Seconds are processor time on one core of a server of 2023 (measured on structures of 100 to
90,000 robots); how well it is spread over cores differs by stage.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tiswarm.localization.params import JointParams, VirtualForceParams
from tiswarm.records.messages import counted
from tiswarm.scenario import Scenario
from tiswarm.study.cases import ROBOTS_AT_ONCE, Case, structures

START_S = 4.0
"""Start of the program and its kernels."""

CLIMB_S = 1e-3
"""Growth of a robot, but for mechanics."""

SOLVE_S = {"flexible": (1e-3, 3e-5, 2.6e-8), "rigid": (1e-3, 2e-5, 9e-9)}
"""A solve of the mechanics by model: once, for each robot, and for each robot squared."""

VIRTUAL_FORCE_S = 1.3e-6
"""Localization by `virtual-force`, of a robot in an iteration."""

JOINT_S = 8e-7
"""Localization by `joint`, of a robot of a chain in a step."""

LEAST_SQUARES_S = 0.01
"""Localization by `least-squares`, of a robot."""

REST_S = 5e-4
"""Sensing, evaluating and storing a robot."""

BASE_MB, ROBOT_MB, SOLVE_MB = 270.0, 0.02, 3e-7
"""Memory of the program, of each robot that it holds, and of the mechanics of the largest structure
for each of its robots squared."""


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """Size of a run and what it is thought to take; times on one core."""

    cases: int
    """Cases to compute."""

    robots: int
    """Robots in all cases together."""

    grow_s: float
    """Growth of every structure [s]."""

    localize_s: float
    """Localization of every case [s]."""

    rest_s: float
    """Everything else [s]."""

    memory_mb: float
    """Most memory of a process [MB]."""

    def __str__(self) -> str:
        """Say it in a line, as the estimate it is."""
        total = self.grow_s + self.localize_s + self.rest_s
        return (
            f"{counted(self.cases, 'case')}, {counted(self.robots, 'robot')} in all; estimate: "
            f"{_time(total)} of processor time (growth {_time(self.grow_s)}, localization "
            f"{_time(self.localize_s)}), "
            f"{self.memory_mb:.0f} MB"
        )


def forecast(cases: Sequence[Case]) -> Forecast:
    """Estimate what cases will take; within a factor of three or so, and machines differ."""
    once = [group[0].settings for group in structures(cases)]
    robots = [case.settings.robots for case in cases]
    localize = [_localize_s(case.settings) for case in cases]
    grow = [_grow_s(settings) for settings in once]
    at_once = max(min(sum(robots), ROBOTS_AT_ONCE), *robots, 0)
    return Forecast(
        cases=len(cases),
        robots=sum(robots),
        grow_s=sum(grow),
        localize_s=sum(localize),
        rest_s=START_S + REST_S * sum(robots),
        memory_mb=BASE_MB + ROBOT_MB * at_once + SOLVE_MB * max(robots, default=0) ** 2,
    )


def _grow_s(settings: Scenario) -> float:
    """Growth of a structure [s]: its mechanics are solved as robots become more and more."""
    n, structure = settings.robots, settings.structure
    once, each, squared = SOLVE_S[structure.mechanics.model]
    solve = once + each * n / 2.0 + squared * n**2 / 3.0
    return CLIMB_S * n + solve * n / structure.solve_every


def _localize_s(settings: Scenario) -> float:
    """Localization of a structure [s]."""
    n, params = settings.robots, settings.localization
    if isinstance(params, VirtualForceParams):
        steps = float(params.iterations)
        if rounds := params.back_propagation:
            # A robot takes part in those after it joined: half of them on average, and the last.
            steps += rounds.sweeps * (1.0 + max(n / rounds.every, 1.0)) / 2.0
        return VIRTUAL_FORCE_S * n * steps
    if isinstance(params, JointParams):
        return JOINT_S * n * params.chains_for(n) * (params.steps_for(n) + params.hold_steps)
    return LEAST_SQUARES_S * n


def _time(seconds: float) -> str:
    """Round a time to what can be known of it."""
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"
