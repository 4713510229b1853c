"""The doctor names what to install."""

import builtins
import sys

import pytest

from tiswarm.app import doctor
from tiswarm.app.doctor import draw_test_picture, examine_backend, missing_packages
from tiswarm.base.params import ARCHS
from tiswarm.compute import backend, machine, numerics


@pytest.fixture
def bare_machine(monkeypatch):
    """A Linux machine without the libraries of open3d."""
    imported = builtins.__import__

    def refuse(name, *rest, **named):
        if name == "open3d":
            message = "libX11.so.6: cannot open shared object file"
            raise ImportError(message)
        return imported(name, *rest, **named)

    monkeypatch.delitem(sys.modules, "open3d", raising=False)
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
    *found, cache = doctor.name_kernels()

    libraries = ("kernels", "numpy", "blas", "libm")
    assert [each.subject for each in found] == [f"numbers by {name}" for name in libraries]
    assert all(each.works for each in [*found, cache])
    assert [each.detail for each in found] == list(numerics.current())
    assert (cache.subject, cache.detail) == ("kernel cache", backend.current().cache)


def test_a_device_without_a_driver_starts_no_process(bare_machine, monkeypatch):
    """A process that tries a device imports the kernel language, which takes a second each."""
    tried = []
    monkeypatch.setattr(doctor, "_in_child", lambda probe, name: tried.append(name) or (True, "{}"))
    monkeypatch.setattr(doctor, "_loads", lambda library: library == "libvulkan.so.1")

    found = {each.subject: each.works for each in doctor.examine()}

    assert [name for name in tried if name in ARCHS] == ["cpu", "cpu", "vulkan"]
    assert [found[f"backend {arch}"] for arch in ARCHS] == [arch in tried for arch in ARCHS]


def test_software_for_a_card_starts_and_is_not_timed(monkeypatch):
    """It compiles the kernels of a swarm for a minute, and nobody should compute with it."""
    software = machine.Card(name="llvmpipe", driver="Vulkan 1.3", is_software=True)
    monkeypatch.setattr(doctor.machine, "find_card", lambda _arch: software)
    monkeypatch.setattr(doctor, "try_backend", pytest.fail)

    assert examine_backend("cpu").endswith("starts, but is software; --arch cpu is faster")


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
