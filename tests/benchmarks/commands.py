"""Calls the commands of benchmarks in processes of their own."""

import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]


def call(name, *arguments):
    """Call `python -m benchmarks.NAME`, without bounds checks in kernels."""
    return subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *map(str, arguments)],
        cwd=REPOSITORY,
        env={key: value for key, value in os.environ.items() if key != "TISWARM_DEBUG"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
