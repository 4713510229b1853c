"""The doctor names what to install."""

import builtins
import sys

import pytest

from tiswarm.compute import numerics
from tiswarm.parts import doctor
from tiswarm.parts.doctor import draw_test_picture, missing_packages


@pytest.fixture
def bare_machine(monkeypatch):
    """A Linux machine without the libraries of open3d."""
    imported = builtins.__import__

    def refuse(name, *rest, **named):
        if name == "open3d":
            message = "libX11.so.6: cannot open shared object file"
            raise ImportError(message)
        return imported(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", refuse)
    monkeypatch.setattr(doctor.sys, "platform", "linux")
    monkeypatch.setattr(doctor, "_loads", lambda library: library == "libgomp.so.1")
    monkeypatch.setattr(doctor, "find_software_vulkan", lambda: None)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)


def test_missing_libraries_are_named_as_packages(bare_machine):
    """All libraries that cannot be loaded, not only the first."""
    packages = "libx11-6 libgl1 libegl1 libidn2-0 libudev1 libusb-1.0-0"

    for_tests = ["mesa-vulkan-drivers", "gcc", "libc6-dev"]
    assert missing_packages() == packages.split() + for_tests


def test_what_decides_the_last_bits_has_a_line_each():
    """Who compares two machines compares these lines; the manifest of a run has the same."""
    found = {each.subject: each for each in doctor.name_roundings()}

    assert list(found) == [f"numbers by {name}" for name in ("kernels", "numpy", "blas", "libm")]
    assert all(each.works for each in found.values())
    assert [each.detail for each in found.values()] == list(numerics.here())


def test_no_packages_are_named_off_linux(bare_machine, monkeypatch):
    """Wheels for other systems contain these libraries."""
    monkeypatch.setattr(doctor.sys, "platform", "darwin")

    assert missing_packages() == []


@pytest.mark.trial
@pytest.mark.skipif(sys.platform != "linux", reason="wheels for other systems contain the library")
def test_a_machine_without_the_library_of_taichi_gets_the_name_of_its_package(tmp_path, process):
    """A file that is no library stands for it: what to install is said, and nothing else runs."""
    pytest.importorskip("taichi")
    (tmp_path / "libX11.so.6").write_text("broken")
    broken = {"LD_LIBRARY_PATH": str(tmp_path), "TISWARM_BACKEND": "taichi"}

    asked = process("doctor", "--missing-packages", **broken)
    planned = process("run", "tests/tower.yaml", "--plan", **broken)

    assert (asked.returncode, asked.stderr) == (0, "")
    assert asked.stdout.split()[0] == "libx11-6"  # other libraries that load this one follow
    assert (planned.returncode, planned.stdout) == (1, "")
    [line] = planned.stderr.splitlines()
    assert line.startswith("tiswarm: error: taichi cannot be imported: ")
    assert line.endswith("; on Debian, run: apt-get install libx11-6")


def test_the_test_picture_of_our_own_renderer_works():
    """It needs no library beyond the engine's."""
    assert draw_test_picture("taichi").startswith("drew a test picture in ")
