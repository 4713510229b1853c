"""Start of the compute backend, its device, precision and threads, and arrays on it.

Nothing else may call `ti.init`. A device that is not there is an error, never a silent
change of device.
"""

import atexit
import contextlib
import ctypes
import gc
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg.blas
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tiswarm.compute import kernel_cache
from tiswarm.compute.lang import LIBRARY, DeviceArray, ti
from tiswarm.compute.math_kernels import probe_arithmetic
from tiswarm.errors import EnvironmentTroubleError, InputError
from tiswarm.memory import naming_shortage, require_address_space
from tiswarm.params import ARCHS, Arch, Precision

_START_MB, _THREAD_MB = 1550, 10
"""Address space of a start and a small run, and of each thread; a gigabyte of it is never used."""


@dataclass(frozen=True, kw_only=True)
class Backend:
    """Device, library and precision that run the kernels."""

    arch: Arch
    """Device."""

    threads: int
    """Threads that a CPU kernel may use."""

    precision: Precision
    """Type of a kernel's own real numbers."""

    library: str
    """Kernel library and its version."""

    cache: str
    """Folder of compiled kernels."""

    @property
    def is_cold(self) -> bool:
        """Whether no compiled kernels are stored, so that what needs one compiles it first."""
        return not any(Path(self.cache).glob("*.*"))

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """NumPy type of the precision."""
        return np.float64 if self.precision == "f64" else np.float32


_started: Backend | None = None


def available_threads() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def start(
    arch: Arch = "cpu", *, threads: int | None = None, precision: Precision = "f64"
) -> Backend:
    """Start the backend, or do nothing where the very same one is running.

    Args:
        arch: Device; it is started or an error is raised.
        threads: CPU threads; all that this process may use if None.
        precision: Real type of the kernels' own arithmetic.

    Raises:
        InputError: the device is unknown or the thread count below 1.
        EnvironmentTroubleError: the machine lacks the device, the precision or the memory.
    """
    global _started  # noqa: PLW0603 - the kernel library itself is one per process
    if arch not in ARCHS:
        choices = ", ".join(ARCHS)
        raise InputError(f"unknown backend {arch!r}; choose one of {choices}", argument="arch")
    if threads is not None and threads < 1:
        raise InputError(f"{threads} threads cannot compute; give 1 or more", argument="threads")
    count = threads or available_threads()
    wanted = (arch, count, precision)
    if _started and (_started.arch, _started.threads, _started.precision) == wanted:
        return _started
    require_address_space(_START_MB + _THREAD_MB * count)
    # Linear algebra with threads of its own would fight the kernels' and round differently.
    threadpool_limits(1, user_api="blas")
    # Each library takes its buffer by this; where memory ran out it would wait for it for ever.
    for solve in (np.linalg.solve, scipy.linalg.blas.dtrsv):  # type: ignore[attr-defined]
        solve(np.eye(2), np.ones(2))
    gc.collect()  # an array let go later is freed by its address, where another may lie by then
    _stop()
    library = f"{LIBRARY} {'.'.join(map(str, ti.__version__))}"
    cache = kernel_cache.find_folder(library.replace(" ", "-"))
    with kernel_cache.sealed(cache):
        pass  # finds damage before the library reads it
    atexit.register(_stop)
    _init(arch, count, precision, cache)
    started = Backend(
        arch=arch, threads=count, precision=precision, library=library, cache=str(cache)
    )
    _check_arithmetic(started)
    _started = started
    return started


def _stop() -> None:
    """End what is running; the library writes its new kernels now, not later without a seal."""
    global _started  # noqa: PLW0603
    if _started:
        with kernel_cache.sealed(Path(_started.cache)):
            _started = None  # a start that fails may leave nothing running
            ti.reset()


def current() -> Backend:
    """Return the running backend, starting the default one where none runs."""
    return _started or start()


@contextlib.contextmanager
def fast_arithmetic() -> Iterator[None]:
    """Let kernels that are compiled within reorder sums and ignore NaN.

    Sums over neighbors are then vectorized. Their bits do not depend on the number of threads,
    but may differ between kinds of processors.
    """
    config = ti.lang.impl.current_cfg()
    config.fast_math = True
    try:
        yield
    finally:
        config.fast_math = False


def _init(arch: Arch, threads: int, precision: Precision, cache: Path) -> None:
    """Call the library's own start-up, quietly, and check what came of it."""
    wanted = getattr(ti, arch)
    real = ti.f64 if precision == "f64" else ti.f32
    options = {
        "default_fp": real,
        "enable_fallback": False,
        "cpu_max_num_threads": threads,
        "fast_math": False,  # it would drop NaN checks and change bits
        "offline_cache": True,
        "offline_cache_file_path": str(cache),
        "debug": os.environ.get("TISWARM_DEBUG") == "1",
    }
    try:
        with contextlib.redirect_stdout(io.StringIO()), _float_state_kept(), naming_shortage():
            ti.init(arch=wanted, log_level=ti.CRITICAL, **options)
    except RuntimeError as error:
        raise EnvironmentTroubleError(
            f"backend {arch} is not available on this machine; use --arch cpu"
        ) from error
    running = ti.lang.impl.current_cfg()
    if running.arch != wanted or running.default_fp != real:
        raise EnvironmentTroubleError(
            f"asked for {arch} in {precision}, got {running.arch}; unset TI_* variables"
        )


@contextlib.contextmanager
def _float_state_kept() -> Iterator[None]:
    """Undo that `ti.init` makes subnormal results 0, which would hold for all of Python.

    The kernels' own threads, which it starts, keep that state. Without POSIX nothing is undone.
    """
    math = ctypes.CDLL(None) if os.name == "posix" else None
    state = ctypes.create_string_buffer(256)  # at least the size of any system's fenv_t
    if math:
        math.fegetenv(state)
    try:
        yield
    finally:
        if math:
            math.fesetenv(state)


def faulty_driver() -> EnvironmentTroubleError:
    """Return the error of a device that did not do a kernel's work."""
    return EnvironmentTroubleError(
        f"backend {current().arch} returned without placing every robot; "
        "its driver is faulty: use --arch cpu"
    )


def _check_arithmetic(backend: Backend) -> None:
    """Refuse a device that takes float64 and computes in float32, or lacks its functions."""
    expected = np.linspace(0.1, 3.0, 16, dtype=backend.dtype)
    value = expected.copy()
    try:
        with naming_shortage():
            probe_arithmetic(value)
        resolution = 8 * np.finfo(backend.dtype).eps
        computes = np.allclose(value, expected, rtol=resolution, atol=0.0)
    except RuntimeError:
        computes = False
    if not computes:
        raise EnvironmentTroubleError(
            f"backend {backend.arch} does not compute in {backend.precision}; use --arch cpu, "
            "or --precision f32 where structures need not be grown"
        )


@dataclass(frozen=True)
class Allocator:
    """Where arrays are reserved, and in which precision.

    A kernel starts sooner with arrays on the device, but these take longer to make: few starts
    are quicker with arrays on the host.
    """

    running: Backend

    on_host: bool
    """Whether arrays are NumPy's; the device is a CPU then."""

    def for_few_launches(self) -> "Allocator":
        """Return the allocator for arrays that few launches use."""
        return Allocator(self.running, on_host=self.running.arch == "cpu")

    def reals(self, *shape: int) -> DeviceArray:
        """Reserve an array of real numbers."""
        if self.on_host:
            return np.empty(shape, self.running.dtype)
        return ti.ndarray(ti.f64 if self.running.precision == "f64" else ti.f32, shape)

    def ints(self, *shape: int) -> DeviceArray:
        """Reserve an array of integers."""
        return np.empty(shape, np.int32) if self.on_host else ti.ndarray(ti.i32, shape)

    def upload(self, values: NDArray[Any]) -> DeviceArray:
        """Copy an array, in the precision of the backend if its numbers are real."""
        integer = np.issubdtype(values.dtype, np.integer)
        array = self.ints(*values.shape) if integer else self.reals(*values.shape)
        self.refill(array, values)
        return array

    def refill(self, array: DeviceArray, values: NDArray[Any]) -> None:
        """Copy values into an array that is there; reserving one takes a millisecond."""
        if self.on_host:
            array[...] = values
        else:
            real = array.dtype != ti.i32
            array.from_numpy(np.array(values, self.running.dtype if real else np.int32, order="C"))

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Copy an array back to the host."""
        values: NDArray[Any] = array.copy() if self.on_host else array.to_numpy()
        return values
