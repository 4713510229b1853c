"""Devices to test: software Vulkan, which needs no graphics card, or a card that a variable names.

`TISWARM_TEST_ARCH=cuda pytest tests/compute/test_devices.py` tests that of this machine.
"""

import os
import shutil
from importlib.util import find_spec

import pytest

from tests.runs import python
from tiswarm.app.doctor import find_software_vulkan

ARCH = os.environ.get("TISWARM_TEST_ARCH", "vulkan")
LIBRARIES = [name for name in ("taichi", "quadrants") if find_spec(name)]
"""Kernel languages that are installed."""


def require(found: object, packages: str) -> None:
    """Fail a test for want of system packages where the set-up could have installed them."""
    if not found:
        could_install = shutil.which("apt-get") and os.geteuid() == 0
        (pytest.fail if could_install else pytest.skip)(f"run: apt-get install {packages}")


def device_environment(library: str) -> dict[str, str]:
    """Return variables of a process on the device; software Vulkan is the only card in its own."""
    if "TISWARM_TEST_ARCH" in os.environ:
        return {"TISWARM_BACKEND": library}
    driver = find_software_vulkan()
    require(driver, "mesa-vulkan-drivers")
    return {"VK_ICD_FILENAMES": str(driver), "TISWARM_BACKEND": library}


def run_child(code: str, *arguments: str, **variables: str) -> str:
    """Run code in a process without bounds checks; return what it prints."""
    done = python("-c", code, *arguments, **variables)
    assert done.returncode == 0, done.stderr
    return done.stdout
