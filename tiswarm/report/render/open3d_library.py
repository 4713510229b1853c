"""The library open3d: its import ends the process on some machines, so a child tries it first."""

import contextlib
import ctypes
import platform
import signal
import subprocess
import sys
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tiswarm.base.child import child_command
from tiswarm.compute import kernel_cache, machine

_LONGEST_S = 120.0
"""Time that the import may take, on a slow disk that has not read it before."""

_TRIAL = f"""
import resource
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
from {__name__} import load_open3d
load_open3d()
"""


def import_open3d() -> Any:  # noqa: ANN401 - open3d has no types
    """Import open3d, if it does not end a child of this process that tries to.

    A file beside the compiled kernels notes that it does not: each installation is tried once.

    Raises:
        ImportError: open3d is not installed, lacks a library, or would end this process.
    """
    if "open3d" not in sys.modules:
        try_in_child()
    return load_open3d()


def load_open3d() -> Any:  # noqa: ANN401 - open3d has no types
    """Import open3d, after the library that `libusb_package` brings, where it is installed."""
    with contextlib.suppress(ImportError, OSError):
        import libusb_package  # noqa: PLC0415 - optional

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d


@cache
def try_in_child() -> None:
    """Import open3d in a child, unless one has done it before.

    An import that fails there without a crash may be tried here.

    Raises:
        ImportError: the child crashed, or did not end.
    """
    spec = find_spec("open3d")
    if spec is None or spec.origin is None:
        return
    changed = Path(spec.origin).stat().st_mtime_ns
    key = repr(
        (spec.origin, changed, sys.version, platform.release(), machine.machine()["processor"])
    )
    mark = kernel_cache.find_folder("open3d") / sha256(key.encode()).hexdigest()[:16]
    if mark.exists():
        return
    try:
        status = subprocess.run(  # noqa: S603 - our own interpreter and code
            child_command(_TRIAL), capture_output=True, timeout=_LONGEST_S, check=False
        ).returncode
    except subprocess.TimeoutExpired as error:
        problem = f"its import takes longer than {_LONGEST_S:g} s"
        raise ImportError(problem) from error
    if status < 0:
        raise ImportError(f"its import crashes with {signal.Signals(-status).name}")
    if status == 0:
        with contextlib.suppress(OSError):
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()
