"""By which code, on which machine and at which cost a run is computed.

`manifest.json` and the `cost.json` of each case hold everything that differs between machines and
between repetitions; all other files of a run are the same to the byte on one kind of machine.
"""

import importlib.metadata
import platform
import re
import resource
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field

from tiswarm.base.parts import PARTS, names, registered
from tiswarm.base.version import __version__
from tiswarm.compute import machine, numerics
from tiswarm.compute.backend import Backend
from tiswarm.localization import methods
from tiswarm.records.run_folder import Manifest, Spent
from tiswarm.scenario.model import Scenario
from tiswarm.world.growth import grow
from tiswarm.world.history_file import write_history

_NAME = __name__.partition(".")[0]
_IMPORT = re.compile(
    rf"^[ \t]*(?:from ({_NAME}[\w.]*) import (\([^)]*\)|.*)|import ({_NAME}[\w.]*))", re.MULTILINE
)
_FOUND = re.compile(r'\bfind\("(\w+)", (?:"([^"]+)"\))?')
"""A kind, and a name if it is constant, of what is imported by the table of `base.parts`."""

_NAMED = re.compile(rf'"({_NAME}(?:\.\w+)+)(?::\w+)?"')
"""A module as settings of a method name it."""

_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t].*\n|\n)+", re.MULTILINE)
"""Imports that no running code needs."""

_COMPOSES = "tiswarm.study.runner"
"""Module that composes a case of all that computes it."""


def code_digest(
    modules: Iterable[str],
    apart: Mapping[str, Collection[str]] | None = None,
    package: Path = Path(__file__).parents[1],
) -> str:
    """Return twelve hex digits of the source of modules and of all that they import.

    Results of code with another digest may differ. The way line ends are written does not count,
    and neither does a package if an import only names a module in it.

    Args:
        modules: Names of modules.
        apart: Imports that do not count, by importing module: a registry imports all methods, and
            a result needs one.
        package: Folder of the package.
    """
    found: dict[str, Path] = {}
    waiting = sorted(modules)
    while waiting:
        name = waiting.pop()
        file = _file(name, package)
        if name not in found and file is not None:
            found[name] = file
            waiting += _imports(file, package) - {*(apart or {}).get(name, ())}
    total = sha256()
    for name, file in sorted(found.items()):
        text = file.read_bytes().replace(b"\r\n", b"\n")
        total.update(f"{name} {len(text)}\n".encode() + text)
    return total.hexdigest()[:12]


def _imports(file: Path, package: Path) -> frozenset[str]:
    """List the modules of the package that a file imports, within functions too, or registers."""
    text = file.read_text(encoding="utf-8")
    names = {
        place.partition(":")[0]
        for kind, name in _FOUND.findall(text)
        for part, place in PARTS[kind].items()
        if name in {"", part}
    }
    if file != package / "base" / "parts.py":  # the table itself
        names |= {*_NAMED.findall(text)}
    for origin, parts, module in _IMPORT.findall(_TYPES.sub("", text)):
        names |= {module or origin, *(f"{origin}.{part}" for part in re.findall(r"\w+", parts))}
    return frozenset(name for name in names - {_NAME} if _file(name, package) is not None)


def _file(name: str, package: Path) -> Path | None:
    """Find the source of a module or package by its name; None if it is another name."""
    place = package.joinpath(*name.split(".")[1:])
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def plugged(settings: Scenario) -> dict[str, str]:
    """Return what a case names that plug-ins may bring beside its method, by kind."""
    structure, channel = settings.structure, getattr(settings.localization, "channel", "")
    own = {"structure": structure.kind, "rule": structure.rule.name, "channel": channel}
    return {"sensor": settings.sensing.suite, **own}


def case_code(method: str, **used: str) -> str:
    """Return the digest of the code that computes cases of a localization method in this process.

    Other methods do not count, so that an edit of one leaves the cases of the others current. The
    digests of plug-ins that the method and what else is `plugged` are from follow after "+". The
    digest of an unknown method is empty.
    """
    if method not in names("method"):
        return ""
    return "+".join([method_code(method), *_own_digests(method=method, **used)])


def _own_digests(**used: str) -> list[str]:
    """List the digests of plug-ins that names are from, by kind of the name."""
    own = [registered(kind).get(name) for kind, name in used.items()]
    return list(dict.fromkeys(found.plugin.digest for found in own if found))


def is_current(method: str, code: str) -> bool:
    """Whether code of this process computed a case of a method, by the digest in its record."""
    package, *own = code.split("+")
    kinds = ("method", "sensor", "structure", "rule", "channel")
    loaded = {each.plugin.digest for kind in kinds for each in registered(kind).values()}
    its = registered("method").get(method)
    return (
        method in names("method")
        and package == method_code(method)
        and {*own} <= loaded
        and (its is None or its.plugin.digest in own)
    )


@cache
def method_code(method: str) -> str:
    """Return the digest of the code that computes cases of a method, without that of plug-ins."""
    modules = {name: methods.modules(name) for name in PARTS["method"]}
    own = modules.get(method, set())
    others = set().union(*modules.values()) - own
    # Settings name the modules of their methods, and some stand in one file.
    naming = {place.partition(":")[0] for place in PARTS["method"].values()}
    apart = dict.fromkeys({methods.__name__, *naming}, others)
    return code_digest([_COMPOSES, *own], apart)


def structure_code(kind: str, rule: str) -> str:
    """Return the digest of the code that grows and keeps structures, as in `case_code`."""
    return "+".join([growth_code(), *_own_digests(structure=kind, rule=rule)])


@cache
def growth_code() -> str:
    """Return the digest of the code that grows and keeps structures, without that of plug-ins."""
    return code_digest([grow.__module__, write_history.__module__])


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


class Costs(dict[str, dict[str, Cost]]):
    """Costs by case and stage of a batch of cases."""

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
    own = sorted({each.rounding for each in used if each.rounding})
    rounded = [*earlier, *(each.facts for each in own if each.facts not in earlier)]
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
        machine=machine.machine(),
        numerics=tuple(rounded),
        python=platform.python_version(),
        libraries={name: installed[name] for name in _LIBRARIES if name in installed},
        stages={
            name: Spent(wall_s=round(total["wall_s"], 3), cpu_s=round(total["cpu_s"], 3))
            for name, total in stages.items()
        },
        peak_memory_MB=peak,
        cases=len(costs),
    )
