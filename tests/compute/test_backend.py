"""The backend is the one asked for, or an error."""

import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.compute import backend
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import LIBRARY, ti
from tiswarm.compute.math_kernels import probe_arithmetic


def test_a_missing_device_is_refused_not_replaced():
    """Metal never exists on Linux; asking for it names the way out."""
    if sys.platform == "darwin":
        pytest.skip("this machine has metal")

    with pytest.raises(EnvironmentTroubleError, match="use --arch cpu"):
        backend.start("metal")


def test_an_array_frees_nothing_after_its_program_has_ended(monkeypatch):
    """The library frees by address, where an array of the next program may lie."""
    freed = []
    monkeypatch.setattr(ti.ScalarNdarray, "__del__", lambda array: freed.append(array.shape))
    backend.start(threads=1)
    arrays = [Allocator(backend.current(), on_host=False).reals(length) for length in (7, 8)]

    arrays.pop()
    backend.start(threads=2)
    arrays.pop()

    assert freed == [(8,)]


def test_a_start_that_failed_is_not_taken_for_running():
    """Kernels still run after a device was refused, even if the refusal stopped another."""
    backend.start()
    with pytest.raises(EnvironmentTroubleError):
        backend.start("metal")
    value = np.ones(3)

    backend.current()
    probe_arithmetic(value)

    np.testing.assert_allclose(value, 2.0)


def test_a_start_leaves_the_arithmetic_of_python_alone():
    """The kernel library makes subnormal numbers 0, in a notebook and its later threads too."""
    smallest, largest = float("1e-310"), float("1e308")

    backend.start(threads=1)
    backend.start(threads=2)

    assert smallest / 2.0 == 5e-311
    assert math.hypot(largest, largest) == math.sqrt(2.0) * largest
    with ThreadPoolExecutor() as pool:
        assert pool.submit(lambda: smallest / 2.0).result() == 5e-311


@pytest.mark.parametrize(("arch", "threads"), [("abacus", None), ("cpu", 0), ("cpu", -2)])
def test_nonsense_is_refused(arch, threads):
    """An unknown device or a thread count below one is the user's mistake."""
    with pytest.raises(InputError, match=r"choose one of|give 1 or more"):
        backend.start(arch, threads=threads)


def test_starting_twice_is_starting_once():
    """The same settings give the very same running backend; others start anew."""
    first = backend.start(threads=1)

    assert backend.start(threads=1) is first
    assert backend.start(threads=2).threads == 2
    assert backend.start(precision="f32").precision == "f32"


def test_environment_variables_cannot_change_the_backend_unseen():
    """Taichi obeys a variable over its caller, which is noticed; quadrants does not."""
    code = (
        "from tiswarm.compute import backend\n"
        "backend.start()\n"
        "from tiswarm.compute.lang import ti\n"
        "print(ti.lang.impl.current_cfg().arch == ti.cpu)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"TI_ARCH": "vulkan", "QD_ARCH": "vulkan"},
        capture_output=True,
        text=True,
        check=False,
    )

    assert "EnvironmentTroubleError" in done.stderr or done.stdout == "True\n"
    assert LIBRARY != "taichi" or done.returncode == 1


@pytest.mark.parametrize("home", [{"HOME": "/proc/nowhere"}, {}])
def test_a_home_that_cannot_be_written_does_no_harm(home):
    """Compiled kernels then go to a folder that is gone afterwards; HOME may even be unset."""
    code = "from tiswarm.compute import backend; print(backend.start().cache)"
    env = {k: v for k, v in os.environ.items() if not k.startswith(("XDG", "TI_", "HOME"))}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env | home, capture_output=True, text=True, check=True
    )

    assert Path(done.stdout.strip()).exists() == (not home)


def test_linear_algebra_has_one_thread_whatever_is_loaded_later():
    """NumPy and SciPy bring a library each; threads of their own would round differently."""
    code = (
        "from tiswarm.compute import backend; backend.start()\n"
        "import scipy.linalg, scipy.sparse.linalg, threadpoolctl\n"
        "print({each['num_threads'] for each in threadpoolctl.threadpool_info()"
        " if each['user_api'] == 'blas'})"
    )
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )

    assert done.stdout.splitlines()[-1] == "{1}"


def test_the_first_use_is_known_by_its_folder(tmp_path):
    """Without stored kernels, the first task compiles; the seal is no kernel."""
    running = replace(backend.current(), cache=str(tmp_path))
    (tmp_path / "seal").touch()

    assert running.is_cold
    (tmp_path / "T0.tic").touch()
    assert not running.is_cold
