"""Want of memory is an error in one line, never a wrong reason, a crash or a hang."""

import errno
import os
import resource
import subprocess
import sys
import textwrap
import weakref

import numpy as np
import psutil
import pytest

from tiswarm.base.errors import EnvironmentTroubleError, InputError, OutOfMemoryError
from tiswarm.base.process import naming_shortage
from tiswarm.cli import main
from tiswarm.compute import backend
from tiswarm.compute.lang import ti

KERNELS = "[host_memory_pool.cpp:allocate_raw_memory@62] Virtual memory allocation (777 B) failed."


@pytest.fixture
def limit_address_space(monkeypatch):
    """Return a function that sets what `ulimit -v` reports [MB]."""

    def limit(megabytes: int) -> None:
        monkeypatch.setattr(resource, "getrlimit", lambda _: (megabytes * 2**20, -1))

    return limit


@pytest.fixture
def call(monkeypatch):
    """Return a function that calls `tiswarm` in this process and returns its exit status."""

    def run(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["tiswarm", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code

    return run


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("std::bad_alloc"),
        MemoryError(),
        RuntimeError(KERNELS),
        RuntimeError("CUDA Error CUDA_ERROR_OUT_OF_MEMORY: out of memory while calling mem_alloc"),
        OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
    ],
)
def test_all_libraries_run_out_of_memory_by_one_error(error):
    """Each library reports it in its own way."""
    with pytest.raises(OutOfMemoryError, match=r"^memory ran out: .+; .+--plan"), naming_shortage():
        raise error


@pytest.mark.parametrize(
    "error", [RuntimeError("illegal memory access"), OSError(errno.ENOENT, "")]
)
def test_other_errors_stay_what_they_are(error):
    """A fault of a kernel is no want of memory."""
    with pytest.raises(type(error)) as raised, naming_shortage():
        raise error

    assert raised.value is error


def test_arrays_of_what_failed_are_freed():
    """The rest of a run needs their memory, even while somebody keeps the error."""
    arrays = []

    def compute():
        array = np.zeros(3)
        arrays.append(weakref.ref(array))
        raise MemoryError

    with pytest.raises(OutOfMemoryError) as kept, naming_shortage():
        compute()

    assert kept.value
    assert arrays[0]() is None


def test_the_command_line_names_what_did_not_fit(call, monkeypatch, capsys):
    """NumPy says how much memory an array needs; that is the need."""

    def allocate(*_, **__):
        np.empty(2**50)

    monkeypatch.setattr(sys.modules["tiswarm.cli.options"], "app", allocate)

    assert call("localize") == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("tiswarm: error: memory ran out: Unable to allocate 8.00 PiB")


def test_a_command_is_refused_where_its_libraries_do_not_fit(call, limit_address_space, capsys):
    """They hang or abort half-loaded; the help still works."""
    limit_address_space(500)

    assert call("check", "tests/tower.yaml") == 1
    [line] = capsys.readouterr().err.splitlines()
    assert "ulimit -v allows 500 MB of address space, but the start takes" in line
    assert call("--help") == 0


def test_a_limit_is_named_rather_than_the_device_blamed(limit_address_space):
    """The start reserves far more address space than memory."""
    limit_address_space(1500)

    with pytest.raises(EnvironmentTroubleError, match=r"ulimit -v allows 1500 MB") as raised:
        backend.start(threads=1)

    assert not isinstance(raised.value, (InputError, OutOfMemoryError))


def test_a_start_without_memory_does_not_blame_the_device(monkeypatch):
    """Other things than a limit can use up the memory."""

    def fail(**_):
        raise RuntimeError(KERNELS)

    monkeypatch.setattr(ti, "init", fail)

    with pytest.raises(OutOfMemoryError, match=r"allocation \(777 B\) failed;"):
        backend.start(threads=1)


def test_the_kernel_library_says_nothing_beside_its_error(capfd):
    """Its own line, and two empty ones, would come before ours."""
    allocator = backend.Allocator(backend.current(), on_host=False)
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = psutil.Process().memory_info().vms

    resource.setrlimit(resource.RLIMIT_AS, (used + 2**28, before[1]))
    try:
        with pytest.raises(OutOfMemoryError, match=r" \(1600000000 B\) failed;"), naming_shortage():
            allocator.reals(200_000_000)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)

    assert capfd.readouterr().err == ""


@pytest.mark.trial
def test_linear_algebra_does_not_wait_for_memory_for_ever():
    """OpenBLAS tries again and again to reserve its buffer where it got none before."""
    code = """
        import resource, psutil
        import numpy as np
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu
        from tiswarm.compute import backend
        backend.start(threads=1)
        left = psutil.Process().memory_info().vms + 2**23
        resource.setrlimit(resource.RLIMIT_AS, (left, left))
        splu(csc_array(np.tri(200).T @ np.tri(200))).solve(np.ones(200))
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], timeout=200, check=False)

    assert done.returncode == 0
