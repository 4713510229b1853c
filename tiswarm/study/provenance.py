"""By which code, on which machine and at which cost a run is computed.

`manifest.json` and the `cost.json` of each case hold everything that differs between machines and
between repetitions; all other files of a run are the same to the byte on one kind of machine.
"""

import importlib.metadata
import platform
import resource
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field

from tiswarm.base.registry import names, registered
from tiswarm.base.version import __version__
from tiswarm.compute import machine, numerics
from tiswarm.compute.backend import Backend
from tiswarm.records.run_folder import Manifest, Spent
from tiswarm.scenario.model import Scenario

_SHOWING = {"__main__", "api", "app", "cli", "formats", "report"}
"""Rooms and modules that compute no results: they ask for them, show them, or bring logs in."""


@cache
def package_code() -> str:
    """Return twelve hex digits of the source of all rooms that compute results.

    Results of code with another digest may differ. The way line ends are written does not count.
    """
    package = Path(__file__).parents[1]
    total = sha256()
    for file in sorted(package.rglob("*.py")):
        name = file.relative_to(package)
        # Scenarios that are shipped come with scripts: a link in a checkout, a folder elsewhere.
        is_of_scenarios = name.parts[:2] == ("scenario", "files")
        if name.with_suffix("").parts[0] not in _SHOWING and not is_of_scenarios:
            text = file.read_bytes().replace(b"\r\n", b"\n")
            total.update(f"{name.as_posix()} {len(text)}\n".encode() + text)
    return total.hexdigest()[:12]


_OF_METHODS = ("channel", "force", "integrator")
"""Kinds of the registry that settings of methods name."""


def plugged(settings: Scenario) -> dict[str, str]:
    """Return what a case names that plug-ins may bring beside its method, by kind."""
    structure = settings.structure
    return {
        "sensor": settings.sensing.suite,
        "structure": structure.kind,
        "rule": structure.rule.name,
        **{name: getattr(settings.localization, name, "") for name in _OF_METHODS},
    }


def case_code(method: str, **used: str) -> str:
    """Return the digest of the code that computes cases of a localization method in this process.

    The digests of plug-ins that the method and what else is `plugged` are from follow after "+".
    The digest of an unknown method is empty.
    """
    if method not in names("method"):
        return ""
    return "+".join([package_code(), *_plugin_digests(method=method, **used)])


def _plugin_digests(**used: str) -> list[str]:
    """List the digests of plug-ins that names are from, by kind of the name."""
    entries = [registered(kind).get(name) for kind, name in used.items()]
    return list(dict.fromkeys(entry.plugin.digest for entry in entries if entry))


def is_current(method: str, code: str) -> bool:
    """Whether code of this process computed a case of a method, by the digest in its record."""
    package, *plugins = code.split("+")
    kinds = ("method", "sensor", "structure", "rule", *_OF_METHODS)
    loaded = {entry.plugin.digest for kind in kinds for entry in registered(kind).values()}
    entry = registered("method").get(method)
    return (
        method in names("method")
        and package == package_code()
        and {*plugins} <= loaded
        and (entry is None or entry.plugin.digest in plugins)
    )


def structure_code(kind: str, rule: str) -> str:
    """Return the digest of the code that grows and keeps structures, as in `case_code`."""
    return "+".join([package_code(), *_plugin_digests(structure=kind, rule=rule)])


_LIBRARIES = (
    "matplotlib",
    "numpy",
    "open3d",
    "open3d-cpu",
    "pandas",
    "pydantic",
    "pymetis",
    "quadrants",
    "scipy",
    "taichi",
)

_Unit = Annotated[str, Field(pattern="^(wall_s|cpu_s|peak_memory_MB)$")]
Cost = Annotated[Mapping[_Unit, float], Field(min_length=3)]
"""Share of a case in a stage, `wall_s` and `cpu_s`, and `peak_memory_MB` of its whole batch."""


class Costs(dict[str, dict[str, Cost]]):
    """Costs by case and stage of a batch of cases."""

    @contextmanager
    def stage(self, name: str, cases: Sequence[str]) -> Iterator[None]:
        """Measure the block as a stage of these cases, who share its cost evenly."""
        with suppress(OSError):  # restarts the peak of memory, on Linux
            Path("/proc/self/clear_refs").write_text("5")
        start_wall_s = time.perf_counter()
        start_cpu_s = time.process_time()
        yield
        wall_s = time.perf_counter() - start_wall_s
        cpu_s = time.process_time() - start_cpu_s
        count = max(len(cases), 1)
        share = {
            "wall_s": wall_s / count,
            "cpu_s": cpu_s / count,
            "peak_memory_MB": peak_memory_mb(),
        }
        self.add(name, cases, share)

    def add(self, name: str, cases: Sequence[str], share: Cost) -> None:
        """Add a stage with the share of each of these cases."""
        for case in cases:
            self.setdefault(case, {})[name] = share


class Used(NamedTuple):
    """What computed a stage."""

    stage: str
    backend: Backend
    force_error: float = 0.0
    """Largest error of a force by rounding, relative to the largest force [1]."""

    rounding: numerics.Numerics | None = None
    """What rounded its numbers; None where that is unknown."""


def peak_memory_mb() -> int:
    """Return the peak of memory since the stage began; off Linux, since the process began [MB]."""
    with suppress(OSError, ValueError):
        peak = Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]
        return int(peak) // 2**10
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak_bytes // (2**20 if sys.platform == "darwin" else 2**10)


def manifest(
    used: Collection[Used],
    costs: Sequence[Mapping[str, Cost]],
    earlier: Sequence[Mapping[str, str]] = (),
) -> Manifest:
    """Gather what a reader needs to judge or repeat a run.

    Args:
        used: What computed the stages, at least one.
        costs: Costs by case and stage.
        earlier: What rounded numbers of cases that were stored before.
    """
    roundings = sorted({stage.rounding for stage in used if stage.rounding})
    new_facts = [rounding.facts for rounding in roundings if rounding.facts not in earlier]
    main = max(used, key=lambda stage: (stage.backend.on_card, stage.force_error)).backend
    devices: dict[str, set[str]] = {}
    for stage in used:
        devices.setdefault(stage.stage, set()).add(str(stage.backend))
    stages: dict[str, dict[str, float]] = {}
    peak = 0
    for name, cost in (item for of_case in costs for item in of_case.items()):
        peak = max(peak, int(cost["peak_memory_MB"]))
        total = stages.setdefault(name, {"wall_s": 0.0, "cpu_s": 0.0})
        for unit in total:
            total[unit] += cost[unit]
    return Manifest(
        tiswarm=__version__,
        code=package_code(),
        backend={
            key: getattr(main, key) for key in ("arch", "card", "threads", "precision", "library")
        },
        devices={name: " and ".join(sorted(devices[name])) for name in sorted(devices)},
        force_error=max((stage.force_error for stage in used), default=0.0),
        machine=machine.machine(),
        numerics=(*earlier, *new_facts),
        python=platform.python_version(),
        libraries=dict(_installed()),
        stages={
            name: Spent(wall_s=round(total["wall_s"], 3), cpu_s=round(total["cpu_s"], 3))
            for name, total in stages.items()
        },
        peak_memory_MB=peak,
        cases=len(costs),
    )


def _installed() -> Iterator[tuple[str, str]]:
    """List the versions of the libraries that are installed."""
    for name in _LIBRARIES:
        try:
            yield name, importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
