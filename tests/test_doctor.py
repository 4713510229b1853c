"""The doctor names what to install."""

import builtins

import pytest

from tiswarm import doctor
from tiswarm.doctor import draw_test_picture, missing_packages


@pytest.fixture
def bare_machine(monkeypatch):
    """A Linux machine without the libraries of open3d."""
    imported = builtins.__import__

    def refuse(name, *rest):
        if name == "open3d":
            message = "libX11.so.6: cannot open shared object file"
            raise ImportError(message)
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)
    monkeypatch.setattr(doctor.sys, "platform", "linux")
    monkeypatch.setattr(doctor, "_loads", lambda library: library == "libgomp.so.1")


def test_missing_libraries_are_named_as_packages(bare_machine):
    """All libraries that cannot be loaded, not only the first."""
    packages = "libx11-6 libgl1 libegl1 libidn2-0 libudev1 libusb-1.0-0"

    assert missing_packages() == packages.split()


def test_no_packages_are_named_off_linux(bare_machine, monkeypatch):
    """Wheels for other systems contain these libraries."""
    monkeypatch.setattr(doctor.sys, "platform", "darwin")

    assert missing_packages() == []


def test_the_test_picture_of_our_own_renderer_works():
    """It needs no library beyond the engine's."""
    assert draw_test_picture("taichi").startswith("drew a test picture in ")
