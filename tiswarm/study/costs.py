"""What computing costs: wall and CPU time and peak memory of each stage, shared by its cases."""

import resource
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

Cost = Mapping[str, float]
"""`wall_s` and `cpu_s`, a case's share of them, and `peak_memory_MB`, that of its whole batch."""

_STATUS = Path("/proc/self/status")
_FORGET_PEAK = Path("/proc/self/clear_refs"), "5"


class Costs:
    """Costs of the stages that a batch of cases goes through."""

    def __init__(self) -> None:
        """Start with no stage."""
        self._costs: dict[str, dict[str, Cost]] = {}

    @contextmanager
    def stage(self, name: str, cases: Sequence[str]) -> Iterator[None]:
        """Measure what happens inside the block and share it among the cases.

        Args:
            name: Name of the stage.
            cases: Names of the cases that go through it together.
        """
        _forget_peak()
        wall, cpu = time.perf_counter(), time.process_time()
        yield
        spent = {
            "wall_s": (time.perf_counter() - wall) / max(len(cases), 1),
            "cpu_s": (time.process_time() - cpu) / max(len(cases), 1),
            "peak_memory_MB": peak_memory_mb(),
        }
        self.paid(name, cases, spent)

    def paid(self, name: str, cases: Sequence[str], share: Cost) -> None:
        """Take down what a stage has cost each of these cases in an earlier run."""
        for case in cases:
            self._costs.setdefault(case, {})[name] = share

    def of(self, case: str) -> Mapping[str, Cost]:
        """Costs of a case by stage."""
        return self._costs[case]


def total(costs: Sequence[Mapping[str, Cost]]) -> tuple[dict[str, dict[str, float]], int]:
    """Add up times by stage; return them and the largest peak of memory [MB]."""
    stages: dict[str, dict[str, float]] = {}
    peak = 0
    for of_case in costs:
        for name, cost in of_case.items():
            spent = stages.setdefault(name, {"wall_s": 0.0, "cpu_s": 0.0})
            for unit in spent:
                spent[unit] += cost[unit]
            peak = max(peak, int(cost["peak_memory_MB"]))
    rounded = {
        name: {unit: round(value, 3) for unit, value in spent.items()}
        for name, spent in stages.items()
    }
    return rounded, peak


def peak_memory_mb() -> int:
    """Most memory held since the stage began on Linux, since the process began elsewhere [MB]."""
    with suppress(OSError, ValueError):
        peak = _STATUS.read_text().partition("VmHWM:")[2].split()[0]
        return int(peak) // 2**10
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak_bytes // (2**20 if sys.platform == "darwin" else 2**10)


def _forget_peak() -> None:
    """Let the peak of memory start again from what is held now, where the system can."""
    path, order = _FORGET_PEAK
    with suppress(OSError):
        path.write_text(order)
