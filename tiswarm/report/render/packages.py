"""Knows which system packages open3d needs, and which of them this machine lacks."""

import ctypes
import importlib.metadata
import importlib.util
import os
import platform
import sys
from pathlib import Path

LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libgomp.so.1": "libgomp1",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libvulkan.so.1": "libvulkan1",
}
"""Shared libraries and the Debian packages that hold them."""

SINCE_VULKAN = frozenset({"libusb-1.0.so.0", "libvulkan.so.1"})
"""Needed by open3d 0.20 and later."""

BEFORE_VULKAN = frozenset({"libgomp.so.1"})
"""Needed by open3d 0.19 and earlier."""

VULKAN_DRIVERS = "mesa-vulkan-drivers"
DRIVER_FOLDERS = ("/usr/share/vulkan", "/usr/local/share/vulkan", "/etc/vulkan")


def missing_packages() -> list[str]:
    """Name the Debian packages that open3d needs to be imported and to draw; none off Linux."""
    if sys.platform != "linux":
        return []
    vulkan = _open3d_version() >= (0, 20)
    skipped = BEFORE_VULKAN if vulkan else SINCE_VULKAN
    if importlib.util.find_spec("libusb_package"):  # a PyPI package that brings the library
        skipped |= {"libusb-1.0.so.0"}
    missing = [
        package
        for library, package in LIBRARIES.items()
        if library not in skipped and not _loads(library)
    ]
    return [*missing, VULKAN_DRIVERS] if vulkan and not _has_vulkan_driver() else missing


def installation_advice() -> list[str]:
    """Say what to install for open3d to work: at most one line."""
    if importlib.util.find_spec("open3d") is None:
        small = sys.platform == "linux" and platform.machine() == "x86_64"
        return [f"pip install open3d{'-cpu' if small else ''}"]
    packages = missing_packages()
    return [f"apt-get install {' '.join(packages)}"] if packages else []


def _open3d_version() -> tuple[int, ...]:
    """Read the installed version, or assume a recent one."""
    for name in ("open3d-cpu", "open3d"):
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
        return tuple(int(part) for part in version.split(".")[:2])
    return (0, 20)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _has_vulkan_driver() -> bool:
    if os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES"):
        return True
    return any(any(Path(folder, "icd.d").glob("*.json")) for folder in DRIVER_FOLDERS)
