"""The machine that this process runs on."""

import os
import platform
from contextlib import suppress
from pathlib import Path

import psutil


def machine() -> dict[str, str | int | None]:
    """Return system, processor, cores and memory of this machine."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_MB": psutil.virtual_memory().total // 2**20,
    }


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
        return platform.machine()
    return platform.processor()
