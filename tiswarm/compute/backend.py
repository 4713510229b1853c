"""Start of the compute backend, its device, precision and threads, and arrays on it.

Parallel stages (steps of a whole swarm, the annealing of `joint`) run on the device that a user
chooses. All others run on the processor in f64: they walk along few chains of dependent steps, in
which a card is slower, and need functions that some cards lack in f64. One backend runs at a time,
so a stage first calls `device` or `processor`.

A device that is not there is an error, never a silent change of device.

A process has one program of the kernel library. `ti.init` and `ti.reset` end the one that runs and
free its arrays, no matter who calls them. A fork copies a program without its threads, and what
uses the copy waits for them for ever.
"""

import atexit
import contextlib
import ctypes
import io
import os
import sys
import threading
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, Protocol, get_args

import numpy as np
import psutil
import scipy.linalg.blas
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tiswarm.base.errors import EnvironmentTroubleError, InputError, did_you_mean
from tiswarm.base.params import ARCHS, AnyArch, AnyPrecision, Arch, Precision
from tiswarm.base.process import naming_shortage, require_address_space
from tiswarm.compute import dlpack, kernel_cache, machine, python_numbers
from tiswarm.compute.dlpack import ExportedArray
from tiswarm.compute.lang import LIBRARIES, LIBRARY, DeviceArray, ti, variables_hidden
from tiswarm.compute.math_kernels import probe_arithmetic

_PROGRAM = "prog" if LIBRARY == "taichi" else "_prog"
"""Where the library's record of a program has the program itself; it has None after its end."""

_TYPES = {ti.i32: np.int32, ti.i64: np.int64, ti.f32: np.float32, ti.f64: np.float64}
"""Types on the host of the library's types."""

_QUIET = {"TI_SKIP_VERSION_CHECK": "ON"}
"""Variables while a program starts: taichi would ask a server of its makers for a newer version."""

_turn = threading.RLock()
_cache: Path | None = None
"""Folder of compiled kernels of our program; None where we started none."""
_runtime: "weakref.ref[Any] | None" = None
"""The library's record of our program, another for each program; None while it starts or ends."""
_is_orphan = False
"""Whether this process was forked while our program ran."""


@contextlib.contextmanager
def exclusive() -> Iterator[None]:
    """Let one thread at a time compute; the library compiles and starts for one alone."""
    with _turn:
        yield


def is_running() -> bool:
    """Whether our program runs.

    Raises:
        EnvironmentTroubleError: somebody else's runs, or this process is a fork.
    """
    if _is_orphan:
        raise EnvironmentTroubleError(
            "this process was forked after tiswarm had computed, and kernels do not survive that; "
            'start processes by spawn, as multiprocessing.get_context("spawn") does'
        )
    if _program_of(ti.lang.impl.get_runtime()) is None:
        return False
    if not _is_ours():
        others = (name for name in LIBRARIES if name != LIBRARY and find_spec(name))
        ways_out = ["call its reset() first", "run tiswarm in a process of its own"]
        ways_out += [f"set TISWARM_BACKEND={name}" for name in others]
        raise EnvironmentTroubleError(
            f"another program of {LIBRARY} runs in this process, and tiswarm would end it; "
            f"{' or '.join(ways_out)}"
        )
    return _runtime is not None


def _is_ours() -> bool:
    """Whether the program that runs, or whose start or end was interrupted, is ours."""
    runtime = ti.lang.impl.get_runtime()
    return _cache is not None and (_runtime is None or _runtime() is runtime)


def _start_program(cache: Path, **options: Any) -> None:  # noqa: ANN401 - the library's own
    """Start our program, where none runs. Nothing else may call `ti.init`.

    Args:
        cache: Folder of compiled kernels, which is cleared if it is damaged.
        options: Those of `ti.init`.
    """
    global _runtime, _cache  # noqa: PLW0603 - the library itself is one per process
    with kernel_cache.sealed(cache):
        pass  # finds damage before the library reads it
    _cache = cache
    _runtime = None
    atexit.register(end, rescues=False)
    with (
        contextlib.redirect_stdout(io.StringIO()),
        _float_state_kept(),
        variables_hidden(LIBRARY, _QUIET),
    ):
        ti.init(offline_cache=True, offline_cache_file_path=str(cache), **options)
    python_numbers.install()
    _runtime = weakref.ref(ti.lang.impl.get_runtime(), lambda _: kernel_cache.seal(cache))


class Rescued(Protocol):
    """What reads its arrays from the device before our program ends and frees them."""

    def read(self) -> None:
        """Copy to the host what is on the device alone."""


_rescued: "weakref.WeakSet[Rescued]" = weakref.WeakSet()


def rescue(held: Rescued) -> None:
    """Let what holds arrays read them before our program ends."""
    _rescued.add(held)


def end(*, rescues: bool = True) -> None:
    """End our program, even if it only started in part; nothing of others is ended.

    The library writes its new kernels now, not later without a seal.

    Args:
        rescues: Whether what `rescue` registered is read before.
    """
    global _runtime, _cache  # noqa: PLW0603
    has_arrays = _started and _cache and _is_ours()
    if rescues and has_arrays and _program_of(ti.lang.impl.get_runtime()) is not None:
        for held in tuple(_rescued):
            held.read()
    _rescued.clear()
    if _cache and _is_ours():
        _runtime = None  # else it would seal within the seal
        with kernel_cache.sealed(_cache):
            ti.reset()
    _cache = None


class Array(ti.ScalarNdarray):  # type: ignore[misc]  # it has no types
    """An array of our program, which frees nothing after the program has ended.

    The library's own would be freed by its address, where an array of another program may lie.
    """

    def __init__(self, dtype: Any, shape: tuple[int, ...]) -> None:  # noqa: ANN401
        """Reserve an array of the type and shape."""
        self.runtime = weakref.ref(ti.lang.impl.get_runtime())
        super().__init__(dtype, shape)

    def __del__(self) -> None:
        """Free the array."""
        runtime = self.runtime()
        if runtime is not None and _program_of(runtime) is not None:
            super().__del__()


def _address_of(array: Array) -> int:
    """Return where the memory of an array of our program begins."""
    program = _program_of(ti.lang.impl.get_runtime())
    address: int = program.get_ndarray_data_ptr_as_int(array.arr)
    return address


def _program_of(runtime: Any) -> Any:  # noqa: ANN401 - the library has no types
    return vars(runtime)[_PROGRAM]


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


def _abandon() -> None:
    """Leave our program alone in the child of a fork, which has none of its threads."""
    global _turn, _runtime, _cache, _is_orphan  # noqa: PLW0603
    _turn = threading.RLock()  # a thread that the child lacks may have had its turn
    if not _is_ours():
        return
    record = vars(ti.lang.impl.get_runtime())
    if record[_PROGRAM] is not None:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(record[_PROGRAM]))  # its end would wait
    record[_PROGRAM] = None
    _runtime = None
    _cache = None
    _is_orphan = True


os.register_at_fork(after_in_child=_abandon)


_START_MB = 1550
"""Address space of a start and a small run; a gigabyte of it is never used."""
_THREAD_MB = 10
"""Address space of each thread."""
_MOST_THREADS = 1024
"""Threads that any machine starts; where one of 40,000 cannot start, the library waits for ever."""
_BLOCKS = 8
"""Blocks of threads for each multiprocessor in a loop; more wait for their turn."""
_ROUNDINGS = 32
"""Largest error of a force, in roundings of the largest coordinate. Rounding a million robots to
float32 alone, with float64 from there on, causes an error of 17."""


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

    card: str
    """Name of the graphics card; empty for a processor, or where the driver does not say."""

    cache: str
    """Folder of compiled kernels."""

    def __str__(self) -> str:
        """Name the device, its card if known, and the precision."""
        return f"{self.arch}{f' ({self.card})' if self.card else ''} in {self.precision}"

    @property
    def on_card(self) -> bool:
        """Whether a graphics card computes."""
        return self.arch != "cpu"

    @property
    def is_cold(self) -> bool:
        """Whether no compiled kernels are stored, so that what needs one compiles it first."""
        return not any(Path(self.cache).rglob("*.*"))

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """NumPy type of the precision."""
        return np.float64 if self.precision == "f64" else np.float32

    def force_error(self, farthest: float) -> float:
        """Bound the error of forces by rounding, relative to the largest force [1].

        Args:
            farthest: Largest coordinate [R].
        """
        return float(_ROUNDINGS * np.finfo(self.dtype).eps * (farthest + 1.0))

    def require_memory(self, needed: float, robots: int) -> None:
        """Refuse what does not fit into memory, if it is known how much of it is free.

        Args:
            needed: Memory that the robots need [B].
            robots: Number of robots, for the message.

        Raises:
            EnvironmentTroubleError: less is free.
        """
        free = None
        if not self.on_card:
            free = psutil.virtual_memory().available
        elif self.arch == "cuda":
            free = machine.free_cuda_memory()
        if free is not None and needed > free:
            raise EnvironmentTroubleError(
                f"{robots} robots need about {needed / 1e9:.1f} GB of memory and {free / 1e9:.1f} "
                f"GB of {self.arch} are free; use precision f32, fewer robots or a larger machine"
            )


class _Choice(NamedTuple):
    """Device of parallel stages."""

    arch: Arch = "cpu"
    threads: int | None = None
    precision: AnyPrecision = "auto"


class _Chosen(threading.local):
    """What each thread chose, so that a thread does not change the device of another's call."""

    choice = _Choice()


_chosen = _Chosen()
_started: Backend | None = None


def available_threads() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def choose(
    arch: Arch = "cpu", *, threads: int | None = None, precision: AnyPrecision = "auto"
) -> None:
    """Choose the device of parallel stages, which starts with the first of them.

    Args:
        arch: Device.
        threads: CPU threads of all stages; all that this process may use if None.
        precision: Real type of the parallel stages' own arithmetic; `auto` takes f64 on processors
            and on cards that compute it at half the rate of f32, else f32.

    Raises:
        InputError: the device or the precision is unknown, or the thread count below 1.
    """
    _chosen.choice = _checked(arch, threads, precision)


def start(
    arch: AnyArch = "cpu", *, threads: int | None = None, precision: AnyPrecision = "auto"
) -> Backend:
    """Choose the device of parallel stages and start it; arguments as for `choose`.

    `auto` takes the first device of CUDA, Metal and Vulkan that works, else the processor. It
    takes no software that stands in for a card.

    Raises:
        InputError: the device or the precision is unknown, or the thread count below 1.
        EnvironmentTroubleError: the machine lacks the device, the precision or the memory.
    """
    if arch != "auto":
        choice = _checked(arch, threads, precision)
        running = _run(choice)
        _chosen.choice = choice
        return running
    card = machine.find_card("vulkan")
    has_vulkan = card is not None and not card.is_software
    candidates: tuple[Arch, ...] = ("cuda", "metal", "vulkan")
    for candidate in candidates if has_vulkan else candidates[:2]:
        with contextlib.suppress(EnvironmentTroubleError):
            return start(candidate, threads=threads, precision=precision)
    return start("cpu", threads=threads, precision=precision)


def device() -> Backend:
    """Start the device of parallel stages, unless it runs.

    Raises:
        EnvironmentTroubleError: the machine lacks the device, the precision or the memory.
    """
    return _run(_chosen.choice)


def processor() -> Backend:
    """Start the processor in f64, unless it runs: the device of all other stages.

    Raises:
        EnvironmentTroubleError: the machine lacks the memory.
    """
    return _run(_Choice(threads=_chosen.choice.threads))


def _checked(arch: Arch, threads: int | None, precision: AnyPrecision) -> _Choice:
    if arch not in ARCHS:
        choices = ", ".join([*ARCHS, "auto"])
        raise InputError(f"unknown backend {arch!r}; choose one of {choices}", argument="arch")
    if threads is not None and threads < 1:
        raise InputError(f"{threads} threads cannot compute; give 1 or more", argument="threads")
    most = max(_MOST_THREADS, available_threads())
    if threads is not None and threads > most:
        raise InputError(f"{threads} threads are too many; give {most} at most", argument="threads")
    precisions = get_args(AnyPrecision)
    if precision not in precisions:
        meant = did_you_mean(precision, precisions) or f"; choose one of {', '.join(precisions)}"
        raise InputError(f"unknown precision {precision!r}{meant}", argument="precision")
    return _Choice(arch, threads, precision)


@exclusive()
def _run(choice: _Choice) -> Backend:
    """Start a backend, or do nothing where the very same one runs."""
    global _started  # noqa: PLW0603 - the kernel library itself is one per process
    arch = choice.arch
    card = machine.find_card(arch)
    precision: Precision = "f64" if arch == "cpu" or (card and card.has_fast_f64) else "f32"
    if choice.precision != "auto":
        precision = choice.precision
    count = choice.threads or available_threads()
    if is_running():
        wanted = (arch, count, precision)
        if _started and (_started.arch, _started.threads, _started.precision) == wanted:
            return _started
    elif _started:
        sys.stderr.write(
            f"tiswarm: warning: a reset() of {LIBRARY} ended kernels; starting them anew\n"
        )
    require_address_space(_START_MB + _THREAD_MB * count)
    # Linear algebra with threads of its own would fight the kernels' and round differently.
    threadpool_limits(1, user_api="blas")
    # Each library takes its buffer by this; where memory ran out it would wait for it for ever.
    for solve in (np.linalg.solve, scipy.linalg.blas.dtrsv):  # type: ignore[attr-defined]
        solve(np.eye(2), np.ones(2))
    end()
    _started = None  # a start that fails may leave nothing running
    library = f"{LIBRARY} {'.'.join(map(str, ti.__version__))}"
    cache = kernel_cache.find_folder(library.replace(" ", "-"))
    try:
        _init(arch, count, precision, cache, blocks=_BLOCKS * card.multiprocessors if card else 0)
        _probe(arch, precision)
    except BaseException:  # also an interrupt
        end()  # seals the kernels of the probe
        raise
    _started = Backend(
        arch=arch, threads=count, precision=precision, library=library,
        card=card.name if card else "", cache=str(cache),
    )  # fmt: skip
    return _started


def current() -> Backend:
    """Return the running backend, starting the device of parallel stages where none runs."""
    return _started if _started and is_running() else device()


def _init(arch: Arch, threads: int, precision: Precision, cache: Path, *, blocks: int) -> None:
    """Start the library's program, and check what came of it."""
    wanted = getattr(ti, arch)
    real = ti.f64 if precision == "f64" else ti.f32
    options = {
        "default_fp": real,
        "enable_fallback": False,
        "cpu_max_num_threads": threads,
        "fast_math": False,  # it would drop NaN checks and change bits
        "cfg_optimization": False,  # it takes most of compiling, and LLVM does the same
        "debug": os.environ.get("TISWARM_DEBUG") == "1",
        "saturating_grid_dim": blocks,  # of threads in a loop, on CUDA; 0 leaves it to the library
    }
    try:
        with naming_shortage():
            _start_program(cache, arch=wanted, log_level=ti.CRITICAL, **options)
    except RuntimeError as error:
        problem = f"device {arch} is not on this machine; use cpu, or one that tiswarm doctor lists"
        raise EnvironmentTroubleError(problem) from error
    running = ti.lang.impl.current_cfg()
    if running.arch != wanted or running.default_fp != real:
        problem = f"asked for {arch} in {precision}, got {running.arch}; use cpu"
        raise EnvironmentTroubleError(problem)


def faulty_driver() -> EnvironmentTroubleError:
    """Return the error of a device that did not do a kernel's work."""
    return EnvironmentTroubleError(
        f"backend {current().arch} returned without placing every robot; "
        "its driver is faulty: use --arch cpu"
    )


def _probe(arch: Arch, precision: Precision) -> None:
    """Refuse a device that computes nothing, or in float32 where float64 is wanted."""
    real: type[np.floating[Any]] = np.float64 if precision == "f64" else np.float32
    value = np.linspace(0.1, 3.0, 16, dtype=real)
    expected = value + value
    try:
        with naming_shortage():
            probe_arithmetic(value)
        computes = np.allclose(value, expected, rtol=8 * np.finfo(real).eps, atol=0.0)
    except RuntimeError:
        computes = False
    if not computes:
        raise EnvironmentTroubleError(
            f"backend {arch} does not compute in {precision}; use --arch cpu"
            f"{'' if precision == 'f32' else ', or precision auto'}"
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
        return Allocator(self.running, on_host=not self.running.on_card)

    def reals(self, *shape: int) -> DeviceArray:
        """Reserve an array of real numbers."""
        if self.on_host:
            return np.empty(shape, self.running.dtype)
        return Array(ti.f64 if self.running.precision == "f64" else ti.f32, shape)

    def ints(self, *shape: int) -> DeviceArray:
        """Reserve an array of integers."""
        return np.empty(shape, np.int32) if self.on_host else Array(ti.i32, shape)

    def dtype_of(self, array: DeviceArray) -> np.dtype[Any]:
        """Return the type that an array of reals or integers has on the host."""
        if self.on_host:
            of_host: np.dtype[Any] = array.dtype
            return of_host
        return np.dtype(np.int32 if array.dtype == ti.i32 else self.running.dtype)

    def longs(self, *shape: int) -> DeviceArray:
        """Reserve an array of integers of 64 bits."""
        return np.empty(shape, np.int64) if self.on_host else Array(ti.i64, shape)

    def upload(self, values: NDArray[Any]) -> DeviceArray:
        """Copy an array, in the precision of the backend if its numbers are real."""
        integer = np.issubdtype(values.dtype, np.integer)
        array = self.ints(*values.shape) if integer else self.reals(*values.shape)
        self.refill(array, values)
        return array

    def refill(self, array: DeviceArray, values: NDArray[Any]) -> None:
        """Copy values into an array that is there; reserving one takes a millisecond."""
        if not self.running.on_card:
            self._in_memory(array)[...] = values
        else:
            real = array.dtype != ti.i32
            array.from_numpy(np.array(values, self.running.dtype if real else np.int32, order="C"))

    def copy(self, source: DeviceArray, target: DeviceArray) -> None:
        """Copy an array of ours into another of the same shape."""
        if not self.running.on_card:
            self._in_memory(target)[...] = self._in_memory(source)
        else:
            target.copy_from(source)

    def export(self, array: DeviceArray) -> ExportedArray:
        """Return an array of real numbers on a card of CUDA, or on the processor, for DLPack.

        It ends with the device, as all arrays do.
        """
        ti.sync()  # who takes it may read at once
        address = _address_of(array)
        device = dlpack.CUDA if self.running.on_card else dlpack.CPU
        return ExportedArray(address, tuple(array.shape), self.dtype_of(array), device, array)

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Copy an array back to the host."""
        if not self.running.on_card:
            return self._in_memory(array).copy()
        values: NDArray[Any] = array.to_numpy()
        return values

    def _in_memory(self, array: DeviceArray) -> NDArray[Any]:
        """Return an array on the processor as it lies there, while our program runs.

        The library copies arrays by kernels, each compiled for a type and a number of axes.
        """
        if self.on_host:
            of_host: NDArray[Any] = array
            return of_host
        ti.sync()  # kernels may still write to it
        address = _address_of(array)
        dtype = np.dtype(_TYPES[array.dtype])
        size = dtype.itemsize * int(np.prod(array.shape))
        memory = memoryview((ctypes.c_char * size).from_address(address))
        return np.ndarray(array.shape, dtype, memory)
