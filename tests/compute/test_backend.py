"""The backend is the one asked for, or an error."""

import json
import math
import os
import subprocess
import sys
import threading
import traceback
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.devices import run_child
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.compute import backend
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import LIBRARIES, ti, variables_hidden
from tiswarm.compute.math_kernels import probe_arithmetic


def test_a_missing_device_is_refused_not_replaced():
    """Metal never exists on Linux; asking for it names the way out."""
    if sys.platform == "darwin":
        pytest.skip("this machine has metal")

    with pytest.raises(EnvironmentTroubleError, match="use cpu"):
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


@pytest.mark.parametrize("shape", [(5,), (2, 3), (4, 0, 3), (2, 3, 4)])
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_arrays_on_a_processor_are_copied_without_kernels(shape, precision, monkeypatch):
    """The library compiles one for each type and number of axes, 10 ms each at every start."""
    allocator = Allocator(backend.start(threads=1, precision=precision), on_host=False)
    kernel = type(probe_arithmetic._primal)  # noqa: SLF001 - the library shows none
    monkeypatch.setattr(kernel, "__call__", lambda *_: pytest.fail("a kernel ran"))
    reals = np.arange(math.prod(shape), dtype=np.float64).reshape(shape) / 3.0
    ints = np.arange(math.prod(shape), dtype=np.int64).reshape(shape)

    real = allocator.upload(reals)
    whole = allocator.upload(ints)
    copied = allocator.reals(*shape)
    allocator.copy(real, copied)
    allocator.refill(real, 2.0 * reals)

    dtype = np.dtype(precision.replace("f", "float"))
    np.testing.assert_array_equal(allocator.download(copied), reals.astype(dtype), strict=True)
    np.testing.assert_array_equal(allocator.download(real), (2.0 * reals).astype(dtype))
    np.testing.assert_array_equal(allocator.download(whole), ints.astype(np.int32), strict=True)


def test_an_array_keeps_no_traceback_of_where_it_was_reserved(monkeypatch):
    """To format one takes longer than to reserve the array; nothing shows it."""
    allocator = Allocator(backend.start(threads=1), on_host=False)
    monkeypatch.setattr(traceback, "extract_stack", lambda: pytest.fail("looked at the stack"))

    array = allocator.reals(3)

    assert array.shape == (3,)


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


@pytest.mark.parametrize(
    ("arch", "threads"), [("abacus", None), ("cpu", 0), ("cpu", -2), ("cpu", 40_000)]
)
def test_nonsense_is_refused(arch, threads):
    """An unknown device, or a number of threads that cannot start, is the user's mistake."""
    with pytest.raises(InputError, match=r"choose one of|give 1 or more|give \d+ at most"):
        backend.start(arch, threads=threads)


@pytest.mark.parametrize(
    ("precision", "way_out"),
    [("float64", "did you mean f64"), ("F64", "did you mean f64"), (64, "did you mean f64"),
     ("double", "choose one of auto, f64, f32"), (None, "choose one of auto, f64, f32")],
)  # fmt: skip
@pytest.mark.parametrize(
    ("begin", "arch"), [(backend.start, "cpu"), (backend.start, "auto"), (backend.choose, "cpu")]
)
def test_a_precision_that_is_mistyped_is_refused(begin, arch, precision, way_out):
    """It is never taken as f32."""
    message = f"precision: unknown precision {precision!r}; {way_out}"
    with pytest.raises(InputError, match=message):
        begin(arch, precision=precision)


def test_starting_twice_is_starting_once():
    """The same settings give the very same running backend; others start anew."""
    first = backend.start(threads=1)

    assert backend.start(threads=1) is first
    assert backend.start(threads=2).threads == 2
    assert backend.start(precision="f32").precision == "f32"


def test_variables_of_the_kernel_library_change_neither_device_nor_arithmetic(monkeypatch):
    """It obeys them over its caller; they stay in place for the caller's own kernels."""
    asked = []
    monkeypatch.setattr("urllib.request.urlopen", lambda *request, **_: asked.append(request))
    for prefix in LIBRARIES.values():
        monkeypatch.setenv(f"{prefix}_ARCH", "vulkan")
        monkeypatch.setenv(f"{prefix}_OPT_LEVEL", "0")
        monkeypatch.setenv(f"{prefix}_OFFLINE_CACHE_CLEANING_POLICY", "nonsense")
        monkeypatch.setenv(f"{prefix}_VISIBLE_DEVICE", "0")
    before, running = dict(os.environ), set(threading.enumerate())

    backend.start(threads=1)

    assert ti.lang.impl.current_cfg().arch == ti.cpu
    assert ti.lang.impl.current_cfg().opt_level == 1
    assert dict(os.environ) == before
    assert {*threading.enumerate()} <= running, "a thread asks for a newer version"
    assert asked == []


def test_a_card_among_several_is_chosen_by_the_variable_of_the_library():
    """No argument names one, so this variable alone is left to the library."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TI_VISIBLE_DEVICE", "1")
        patch.setenv("TI_ARCH", "vulkan")
        with variables_hidden("taichi", {"TI_ENABLE_PYBUF": "0"}):
            seen = {name: value for name, value in os.environ.items() if name[:3] == "TI_"}

    assert seen == {"TI_VISIBLE_DEVICE": "1", "TI_ENABLE_PYBUF": "0"}


@pytest.mark.parametrize("home", [{"HOME": "/proc/nowhere"}, {}])
def test_a_home_that_cannot_be_written_does_no_harm(home):
    """Compiled kernels then go to a folder that is gone afterwards; HOME may even be unset."""
    code = "from tiswarm.compute import backend; print(backend.start().cache)"
    env = {k: v for k, v in os.environ.items() if not k.startswith(("XDG", "TI_", "HOME"))}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env | home, capture_output=True, text=True, check=True
    )

    assert Path(done.stdout.strip()).exists() == (not home)


_STATE = """
import decimal, json, locale, logging, os, random, signal, sys, threading, warnings
import numpy as np, scipy.sparse.linalg, scipy.special, threadpoolctl

def state():
    return {
        "random": random.getstate(), "numpy": str(np.random.get_state()),
        "filters": warnings.filters[:], "show": warnings.showwarning,
        "variables": dict(os.environ), "folder": os.getcwd(), "locale": locale.setlocale(0),
        "signals": [signal.getsignal(each) for each in signal.valid_signals()],
        "errors": np.geterr(), "print": str(np.get_printoptions()), "path": sys.path[:],
        "log": (logging.root.level, logging.root.handlers[:]), "dl": sys.getdlopenflags(),
        "hooks": (sys.excepthook, threading.excepthook, sys.unraisablehook, sys.displayhook),
        "limits": (sys.getrecursionlimit(), sys.getswitchinterval(), sys.get_int_max_str_digits()),
        "streams": (sys.stdin, sys.stdout, sys.stderr), "decimal": str(decimal.getcontext()),
    }

random.seed(7), np.random.seed(7)
before = state()
import tiswarm
tiswarm.localize
from tiswarm.compute import backend
backend.start()
after = state()
print(json.dumps({
    "changed": [name for name in before if before[name] != after[name]],
    "threads": [each["num_threads"] for each in threadpoolctl.threadpool_info()
                if each["user_api"] == "blas"],
}))
"""


def test_a_start_changes_nothing_of_the_process_but_the_threads_of_linear_algebra():
    """Random numbers, warnings and variables are the caller's; BLAS would round otherwise."""
    found = json.loads(run_child(_STATE, OPENBLAS_NUM_THREADS="2"))

    assert found["changed"] == []
    assert {*found["threads"]} == {1}


def test_the_first_use_is_known_by_its_folder(tmp_path):
    """Without stored kernels, the first task compiles; the seal is no kernel."""
    running = replace(backend.current(), cache=str(tmp_path))
    (tmp_path / "seal").touch()

    assert running.is_cold
    (tmp_path / "T0.tic").touch()
    assert not running.is_cold
