"""Examines devices and renderers of this machine, and lists missing system packages.

It works without the kernel language, which only the children import that examine devices.
"""

import contextlib
import ctypes
import importlib.util
import io
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.params import ARCHS, Arch
from tiswarm.base.process import child_command
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import machine
from tiswarm.report.pictures import raycast

_PROBE_SECONDS = 60
_ROBOTS = 10_000
"""Robots of the run that examines a device."""
_STEPS = 20
"""Steps of that run."""
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

_DRIVERS = {"cuda": "libcuda.so.1", "vulkan": "libvulkan.so.1"}
"""Shared libraries that devices need on Linux."""

_TAICHI_LIBRARIES = frozenset({"libX11.so.6"})

_PROBE = """
import atexit, gc, sys
from tiswarm.app import doctor
from tiswarm.base.errors import TiswarmError
atexit.register(gc.freeze)
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
    for name, value in machine.machine().items():
        unit = " MB" if name.endswith("_MB") else ""
        yield Finding(name.replace("_MB", ""), works=True, detail=f"{value}{unit}")
    yield from name_kernels()
    for arch in ARCHS:
        if _lacks_driver(arch):
            yield Finding(f"backend {arch}", works=False, detail="no driver; use --arch cpu")
        else:
            yield Finding(f"backend {arch}", *_in_child(examine_backend, arch))
    for renderer in raycast.TRACERS:
        yield Finding(f"renderer {renderer}", *_in_child(draw_test_picture, renderer))
    packages = missing_packages()
    if packages:
        detail = f"apt-get install {' '.join(packages)}"
        yield Finding("system packages", works=False, detail=detail)


def name_kernels() -> Iterator[Finding]:
    """Name what decides the last bits of numbers, and the folder of kernels, in a line each."""
    works, said = _in_child(examine_kernels, "cpu")
    for name, text in (json.loads(said) if works else {"kernels": said}).items():
        yield Finding(name, works, text)


def examine_kernels(arch: Arch) -> str:
    """Return what decides the last bits of numbers, and the folder of kernels, as JSON."""
    numbers = json.loads(name_numerics(arch))
    details = {f"numbers by {name}": text for name, text in numbers.items()}
    details["kernel cache"] = start_cache(arch)
    return json.dumps(details)


def name_numerics(_arch: Arch) -> str:
    """Return what decides the last bits of numbers, as JSON."""
    from tiswarm.compute import numerics  # noqa: PLC0415 - the kernel language

    return json.dumps(numerics.current()._asdict())


def _lacks_driver(arch: Arch) -> bool:
    """Whether a device cannot work, as this system has no driver of it."""
    if arch == "metal":
        return sys.platform != "darwin"
    return sys.platform == "linux" and arch in _DRIVERS and not _loads(_DRIVERS[arch])


def _in_child(probe: Callable[[Any], str], name: str) -> tuple[bool, str]:
    """Run a probe in a process of its own, because a bad driver or library may crash it."""
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and code
            child_command(_PROBE, probe.__name__, name),
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer in {_PROBE_SECONDS} s"
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return done.returncode == 0, said[-1] if said else f"died with status {done.returncode}"


def try_backend(arch: Arch) -> str:
    """Let a swarm disperse on a device; return its library, precision and speed.

    Raises:
        EnvironmentTroubleError: the machine lacks the device, or robots move otherwise than on the
            processor in f64.
    """
    from tiswarm.compute import backend  # noqa: PLC0415 - the kernel language
    from tiswarm.engine.relax import PreparedSwarm, RelaxResult  # noqa: PLC0415

    robot = RobotGeometry()
    side = robot.spacing * (3.0 * _ROBOTS) ** (1.0 / 3.0)
    position = side * np.random.default_rng(0).random((_ROBOTS, 3))
    level = np.tile([1.0, 0.0, 0.0, 0.0], (_ROBOTS, 1))

    def disperse(swarm: PreparedSwarm) -> RelaxResult:
        return swarm.relax(
            attraction_gain=0.0, repulsion_gain=0.04, ramp=0.0, steps=_STEPS, max_step=0.02
        )

    running = backend.start(arch)
    swarm = PreparedSwarm(position, level, [], robot=robot, arch=arch)
    disperse(swarm)  # compiles the kernels
    begin = time.perf_counter()
    result = disperse(swarm)
    step_ns = 1e9 * (time.perf_counter() - begin) / (_ROBOTS * _STEPS)
    if arch != "cpu":
        reference = disperse(PreparedSwarm(position, level, [], robot=robot))
        if not np.abs(result.position - reference.position).max() <= _STEPS * result.force_error:
            raise EnvironmentTroubleError("moves robots otherwise than the processor does")
    speed = f"{step_ns:.0f} ns a step of a robot, {_ROBOTS:,} robots"
    return f"{running.library}, {running}, {running.threads} threads: {speed}"


def examine_backend(arch: Arch) -> str:
    """Try a device; software that stands in for a card only starts, as it is slower than `cpu`.

    Raises:
        EnvironmentTroubleError: as for `try_backend`.
    """
    card = machine.find_card(arch)
    if not card or not card.is_software:
        return try_backend(arch)
    from tiswarm.compute import backend  # noqa: PLC0415 - the kernel language

    running = backend.start(arch)
    return f"{running.library}, {running}: starts, but is software; --arch cpu is faster"


def start_cache(arch: Arch) -> str:
    """Start a backend; return the folder of its kernels, or that they were damaged and cleared."""
    from tiswarm.compute import backend  # noqa: PLC0415 - the kernel language

    with contextlib.redirect_stderr(io.StringIO()) as said:
        running = backend.start(arch)
    return said.getvalue().removeprefix("tiswarm: warning: ") or running.cache


def draw_test_picture(renderer: str) -> str:
    """Draw one robot in a small picture; return the time it took in words."""
    return raycast.draw_test_picture(renderer)


def missing_packages() -> list[str]:
    """List missing Debian packages of taichi and open3d; none on other systems than Linux.

    Developers also need software Vulkan, on which tests run the kernels of graphics cards, and a
    compiler of C for a stub of CUDA's driver.
    """
    if sys.platform != "linux":
        return []
    needed = set(_TAICHI_LIBRARIES) if importlib.util.find_spec("taichi") else set()
    if importlib.util.find_spec("open3d"):
        try:
            raycast.import_open3d()
        except (ImportError, OSError):
            needed |= _LIBRARIES.keys()
    missing = [
        name for library, name in _LIBRARIES.items() if library in needed and not _loads(library)
    ]
    if importlib.util.find_spec("pytest"):
        missing += [] if find_software_vulkan() else ["mesa-vulkan-drivers"]
        missing += [] if shutil.which("cc") else ["gcc", "libc6-dev"]
    return missing


def find_software_vulkan() -> Path | None:
    """Find the manifest of Mesa's Vulkan driver that needs no graphics card."""
    folders = ("/usr/share", "/usr/local/share", "/etc")
    manifests = [
        path for folder in folders for path in Path(folder).glob("vulkan/icd.d/lvp_icd*.json")
    ]
    return max(manifests, default=None)  # that of 64 bits, if there is one of 32 beside


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
