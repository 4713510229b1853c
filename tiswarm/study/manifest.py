"""`manifest.json`: by what, where and in what time a run was computed.

The only file of a run that differs from machine to machine and from time to time.
"""

import importlib.metadata
import json
import os
import platform
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import psutil

import tiswarm
from tiswarm.compute.backend import Backend
from tiswarm.records.atomic import write_text

LIBRARIES = (
    "matplotlib",
    "numpy",
    "open3d",
    "open3d-cpu",
    "pandas",
    "pydantic",
    "quadrants",
    "scipy",
    "taichi",
)


class Stopwatch:
    """Wall and CPU time of each stage, added up over its visits."""

    def __init__(self) -> None:
        """Start with no stage."""
        self.stages: dict[str, dict[str, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside the block."""
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            spent = self.stages.setdefault(name, {"wall_s": 0.0, "cpu_s": 0.0})
            spent["wall_s"] = round(spent["wall_s"] + time.perf_counter() - wall, 3)
            spent["cpu_s"] = round(spent["cpu_s"] + time.process_time() - cpu, 3)


def describe(backend: Backend, stopwatch: Stopwatch) -> dict[str, object]:
    """Gather everything a reader needs to judge or repeat a run."""
    return {
        "tiswarm": tiswarm.__version__,
        "backend": {key: value for key, value in asdict(backend).items() if key != "cache"},
        "machine": machine(),
        "python": platform.python_version(),
        "libraries": _library_versions(),
        "stages": stopwatch.stages,
        "peak_memory_MB": peak_memory_mb(),
    }


def machine() -> dict[str, object]:
    """Processor, cores, memory and system of this machine."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_MB": psutil.virtual_memory().total // 2**20,
    }


def peak_memory_mb() -> int:
    """Most memory this process has held [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak // (2**20 if sys.platform == "darwin" else 2**10)


def write_manifest(folder: Path, content: dict[str, object]) -> None:
    """Write the manifest, keeping entries of an earlier one that `content` does not name."""
    path = folder / "manifest.json"
    try:
        kept = json.loads(path.read_text())
    except (OSError, ValueError):
        kept = {}
    write_text(path, json.dumps(kept | content, indent=1) + "\n")


def _processor() -> str:
    """Model name of the processor, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _library_versions() -> dict[str, str]:
    """Versions of the libraries that are installed."""
    installed = {dist.name.lower(): dist.version for dist in importlib.metadata.distributions()}
    return {name: installed[name] for name in LIBRARIES if name in installed}
