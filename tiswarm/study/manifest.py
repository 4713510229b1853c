"""`manifest.json`: by what, where and in what time a run was computed.

It and what is measured of each case's cost are all of a run that differs from machine to machine
and from time to time.
"""

import importlib.metadata
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import psutil

from tiswarm.compute.backend import Backend
from tiswarm.records.io import write_text
from tiswarm.study.costs import Cost, total
from tiswarm.study.storage import CODE
from tiswarm.version import __version__

FILE = "manifest.json"
LIBRARIES = (
    "matplotlib", "numpy", "open3d", "open3d-cpu", "pandas", "pydantic", "quadrants", "scipy",
    "taichi",
)  # fmt: skip


def describe(backend: Backend, costs: Sequence[Mapping[str, Cost]]) -> dict[str, object]:
    """Gather everything a reader needs to judge or repeat a run; costs are by case and stage."""
    stages, peak_memory_mb = total(costs)
    return {
        "tiswarm": __version__,
        "code": CODE,
        "backend": {key: value for key, value in asdict(backend).items() if key != "cache"},
        "machine": machine(),
        "python": platform.python_version(),
        "libraries": _library_versions(),
        "stages": stages,
        "peak_memory_MB": peak_memory_mb,
    }


def machine() -> dict[str, object]:
    """Processor, cores, memory and system of this machine."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_MB": psutil.virtual_memory().total // 2**20,
    }


def write_manifest(folder: Path, content: dict[str, object]) -> None:
    """Write the manifest, keeping entries of an earlier one that `content` does not name."""
    path = folder / FILE
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
