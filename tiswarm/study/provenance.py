"""By which code, on which machine and at which cost a run is computed.

`manifest.json` and the `cost.json` of each case hold everything that differs between machines and
between repetitions; all other files of a run are the same to the byte.
"""

import importlib.metadata
import platform
import resource
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field

from tiswarm.base.version import __version__, code_digest
from tiswarm.compute.backend import Backend
from tiswarm.compute.machine import machine
from tiswarm.localization import registry
from tiswarm.localization.params import JointParams, VirtualForceParams
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest, Spent
from tiswarm.scenario.expansion import variants
from tiswarm.scenario.model import Scenario
from tiswarm.study.cases import ROBOTS_AT_ONCE, structure_kind
from tiswarm.world.growth import grow
from tiswarm.world.history import History

_METHODS = {name: module.__name__ for name, module in registry.METHODS.items()}
_COMPOSES = "tiswarm.study.runner"
"""Module that composes a case of all that computes it."""


@cache
def case_code(method: str) -> str:
    """Return the digest of the code that computes cases of a localization method in this process.

    Other methods do not count, so that an edit of one leaves the cases of the others current. The
    digest of an unknown method is empty.
    """
    if method not in _METHODS:
        return ""
    others = {*_METHODS.values()} - {_METHODS[method]}
    return code_digest([_COMPOSES, _METHODS[method]], {registry.__name__: others})


@cache
def structure_code() -> str:
    """Return the digest of the code that grows and keeps structures in this process."""
    return code_digest([grow.__module__, History.__module__])


@cache
def all_code() -> str:
    """Return the digest of the code that computes cases of any method in this process."""
    return code_digest([_COMPOSES])


_LIBRARIES = (
    "matplotlib", "numpy", "open3d", "open3d-cpu", "pandas", "pydantic", "quadrants", "scipy",
    "taichi",
)  # fmt: skip

_Unit = Annotated[str, Field(pattern="^(wall_s|cpu_s|peak_memory_MB)$")]
Cost = Annotated[Mapping[_Unit, float], Field(min_length=3)]
"""Share of a case in a stage, `wall_s` and `cpu_s`, and `peak_memory_MB` of its whole batch."""


class Costs:
    """Costs of the stages that a batch of cases goes through."""

    def __init__(self) -> None:
        """Start with no stage."""
        self._costs: dict[str, dict[str, Cost]] = {}

    @contextmanager
    def stage(self, name: str, cases: Sequence[str]) -> Iterator[None]:
        """Measure the block as a stage of these cases, who share its cost evenly."""
        with suppress(OSError):  # restarts the peak of memory, on Linux
            Path("/proc/self/clear_refs").write_text("5")
        wall, cpu = time.perf_counter(), time.process_time()
        yield
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        count = max(len(cases), 1)
        share = {"wall_s": wall / count, "cpu_s": cpu / count, "peak_memory_MB": peak_memory_mb()}
        self.add(name, cases, share)

    def add(self, name: str, cases: Sequence[str], share: Cost) -> None:
        """Add a stage with the share of each of these cases."""
        for case in cases:
            self._costs.setdefault(case, {})[name] = share

    def of(self, case: str) -> Mapping[str, Cost]:
        """Return the costs of a case by stage."""
        return self._costs[case]


class Used(NamedTuple):
    """What computed a stage."""

    stage: str
    backend: Backend
    force_error: float = 0.0
    """Largest error of a force by rounding, relative to the largest force [1]."""


def peak_memory_mb() -> int:
    """Return the peak of memory since the stage began; off Linux, since the process began [MB]."""
    with suppress(OSError, ValueError):
        peak = Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]
        return int(peak) // 2**10
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak_bytes // (2**20 if sys.platform == "darwin" else 2**10)


def manifest(used: Collection[Used], costs: Sequence[Mapping[str, Cost]]) -> Manifest:
    """Gather what a reader needs to judge or repeat a run.

    Args:
        used: What computed the stages, at least one.
        costs: Costs by case and stage.
    """
    main = max(used, key=lambda each: (each.backend.on_card, each.force_error)).backend
    devices: dict[str, set[str]] = {}
    for each in used:
        devices.setdefault(each.stage, set()).add(str(each.backend))
    stages: dict[str, dict[str, float]] = {}
    peak = 0
    for name, cost in (item for of_case in costs for item in of_case.items()):
        peak = max(peak, int(cost["peak_memory_MB"]))
        total = stages.setdefault(name, {"wall_s": 0.0, "cpu_s": 0.0})
        for unit in total:
            total[unit] += cost[unit]
    installed = {dist.name.lower(): dist.version for dist in importlib.metadata.distributions()}
    return Manifest(
        tiswarm=__version__,
        code=all_code(),
        backend={
            key: getattr(main, key) for key in ("arch", "card", "threads", "precision", "library")
        },
        devices={stage: " and ".join(sorted(devices[stage])) for stage in sorted(devices)},
        force_error=max((each.force_error for each in used), default=0.0),
        machine=machine(),
        python=platform.python_version(),
        libraries={name: installed[name] for name in _LIBRARIES if name in installed},
        stages={
            name: Spent(wall_s=round(total["wall_s"], 3), cpu_s=round(total["cpu_s"], 3))
            for name, total in stages.items()
        },
        peak_memory_MB=peak,
        cases=len(costs),
    )


# --- forecast --------------------------------------------------------------------------------
# Processor time on one core of a server of 2023, measured on structures of 100 to 90,000 robots.

_START_S = 4.0  # start of the program and its kernels
_CLIMB_S = 1e-3  # growth of a robot without mechanics
_SOLVE_S = {  # solve of the mechanics: at all, for each robot, for each pair of robots
    "flexible": (5e-5, 5e-6, 1.2e-8),
    "rigid": (5e-5, 3e-6, 1.6e-9),  # a third of that in towers, three times in heaps
}
_VIRTUAL_FORCE_S = 1.3e-6  # iteration of a robot
_TOGETHER_S = 4e-7  # step of a robot
_JOINT_S = 8e-7  # step of a robot in one chain
_LEAST_SQUARES_S = 0.01  # localization of a robot
_REST_S = 5e-4  # sensing, evaluation and storage of a robot
_BASE_MB = 270.0  # memory of the program
_ROBOT_MB = 0.05  # memory of each robot of a batch, most of all in `joint`


class Forecast(NamedTuple):
    """Size of a run, its estimated times on one core [s], and peak memory of a process [MB]."""

    cases: int
    robots: int
    grow_s: float
    localize_s: float
    rest_s: float
    memory_mb: float

    def __str__(self) -> str:
        """Write the estimate in one line."""
        total = self.grow_s + self.localize_s + self.rest_s
        return (
            f"{counted(self.cases, 'case')}, {counted(self.robots, 'robot')} in all; estimate: "
            f"{_time(total)} of processor time (growth {_time(self.grow_s)}, localization "
            f"{_time(self.localize_s)}), {self.memory_mb:.0f} MB"
        )


def forecast(scenario: Scenario) -> Forecast:
    """Estimate the cost of a run, to a factor of about three; machines differ."""
    seeds, points = len(scenario.seed_list), [point.settings for point in variants(scenario)]
    robots = seeds * sum(settings.robots for settings in points)
    largest = max(settings.robots for settings in points)
    at_once = max(min(robots, ROBOTS_AT_ONCE), largest)
    grown = {structure_kind(settings): settings for settings in points}
    return Forecast(
        cases=seeds * len(points),
        robots=robots,
        grow_s=seeds * sum(map(_grow_s, grown.values())),
        localize_s=seeds * sum(map(_localize_s, points)),
        rest_s=_START_S + _REST_S * robots,
        memory_mb=_BASE_MB + _ROBOT_MB * at_once,
    )


def _grow_s(settings: Scenario) -> float:
    """Estimate the growth of a structure, whose mechanics are solved at every size [s]."""
    n, structure = settings.robots, settings.structure
    once, each, squared = _SOLVE_S[structure.mechanics.model]
    solve = once + each * n / 2.0 + squared * n**2 / 3.0
    return _CLIMB_S * n + solve * n / structure.solve_every


def _localize_s(settings: Scenario) -> float:
    n, params = settings.robots, settings.localization
    if isinstance(params, VirtualForceParams):
        if params.schedule == "together":
            return _TOGETHER_S * n * params.together.steps
        steps = float(params.iterations)
        if rounds := params.back_propagation:
            after = [*range(rounds.every, n, rounds.every), n]  # so many joins
            steps += rounds.sweeps * sum(min(joins, rounds.recent or n) for joins in after) / n
        return _VIRTUAL_FORCE_S * n * steps
    if isinstance(params, JointParams):
        return _JOINT_S * n * params.chains_for(n) * (params.steps_for(n) + params.hold_steps)
    return _LEAST_SQUARES_S * n


def _time(seconds: float) -> str:
    # To two digits, in the largest unit that fits twice.
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"
