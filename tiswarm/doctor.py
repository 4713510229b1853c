"""Examines devices and renderers of this machine, and lists missing system packages.

It works without the kernel language, which only the children import that examine devices.
"""

import contextlib
import ctypes
import importlib.util
import io
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from tiswarm.child import child_command
from tiswarm.compute.machine import machine
from tiswarm.params import ARCHS, Arch
from tiswarm.records.terrain import Terrain
from tiswarm.report.render.raycast import TRACERS, draw_scenes, import_open3d
from tiswarm.report.render.scene import Look, Robots, build_scene
from tiswarm.robot import RobotGeometry

_PROBE_SECONDS = 60
_LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libgomp.so.1": "libgomp1",
    "libidn2.so.0": "libidn2-0",
    "libudev.so.1": "libudev1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
"""Shared libraries that `import open3d` loads, and the Debian packages that contain them."""

_TAICHI_LIBRARIES = frozenset({"libX11.so.6"})

_PROBE = """
import sys
from tiswarm import doctor
from tiswarm.errors import TiswarmError
try:
    print(getattr(doctor, sys.argv[1])(sys.argv[2]))
except TiswarmError as error:
    sys.exit(str(error))
"""
"""Calls a function of this module."""


class Finding(NamedTuple):
    """Result of one examination."""

    subject: str
    works: bool
    detail: str


def examine() -> Iterator[Finding]:
    """Examine the machine, the backends and the renderers, one after the other."""
    for name, value in machine().items():
        unit = " MB" if name.endswith("_MB") else ""
        yield Finding(name.replace("_MB", ""), works=True, detail=f"{value}{unit}")
    yield Finding("kernel cache", *_in_child(start_cache, "cpu"))
    for arch in ARCHS:
        yield Finding(f"backend {arch}", *_in_child(start_backend, arch))
    for renderer in TRACERS:
        yield Finding(f"renderer {renderer}", *_in_child(draw_test_picture, renderer))
    if packages := missing_packages():
        detail = f"apt-get install {' '.join(packages)}"
        yield Finding("system packages", works=False, detail=detail)


def _in_child(probe: Callable[[Any], str], name: str) -> tuple[bool, str]:
    """Run a probe in a process of its own, because a bad driver or library may crash it."""
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and code
            child_command(_PROBE, probe.__name__, name),
            capture_output=True, text=True, timeout=_PROBE_SECONDS, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False, f"no answer in {_PROBE_SECONDS} s"
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return done.returncode == 0, said[-1] if said else f"died with status {done.returncode}"


def start_backend(arch: Arch) -> str:
    """Start a backend; return its library and number of threads."""
    from tiswarm.compute import backend  # noqa: PLC0415 - the kernel language

    found = backend.start(arch)
    return f"{found.library}, {found.threads} threads"


def start_cache(arch: Arch) -> str:
    """Start a backend; return the folder of its kernels, or that they were damaged and cleared."""
    from tiswarm.compute import backend  # noqa: PLC0415 - the kernel language

    with contextlib.redirect_stderr(io.StringIO()) as said:
        found = backend.start(arch)
    return said.getvalue().removeprefix("tiswarm: warning: ") or found.cache


def draw_test_picture(renderer: str) -> str:
    """Draw one robot in a small picture; return the time it took in words."""
    begin = time.perf_counter()
    center = np.array([[0.0, 0.0, 1.0]])
    dock = center + RobotGeometry().dock_offset_body[None]
    robots = Robots(center=center, dock=dock, color=np.ones((1, 3)), look=Look(0.45, 0.3, 1.0))
    draw_scenes([build_scene(robots, Terrain()).shrunk(10)], renderer)
    return f"drew a test picture in {time.perf_counter() - begin:.1f} s"


def missing_packages() -> list[str]:
    """List missing Debian packages of taichi and open3d; none on other systems than Linux."""
    if sys.platform != "linux":
        return []
    needed = set(_TAICHI_LIBRARIES) if importlib.util.find_spec("taichi") else set()
    if importlib.util.find_spec("open3d"):
        try:
            import_open3d()
        except (ImportError, OSError):
            needed |= _LIBRARIES.keys()
    return [
        name for library, name in _LIBRARIES.items() if library in needed and not _loads(library)
    ]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
