"""The program of the kernel library: whose it is, and whose turn it is to use it.

A process has one program. `ti.init` and `ti.reset` end the one that runs and free its arrays, no
matter who calls them. A fork copies a program without its threads, and what uses the copy waits
for them for ever.
"""

import atexit
import contextlib
import ctypes
import io
import os
import threading
import weakref
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.compute import kernel_cache
from tiswarm.compute.lang import LIBRARIES, LIBRARY, ti, variables_hidden

_PROGRAM = "prog" if LIBRARY == "taichi" else "_prog"
"""Where the library's record of a program has the program itself; it has None after its end."""

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


def start(cache: Path, **options: Any) -> None:  # noqa: ANN401 - the library's own
    """Start our program, where none runs. Nothing else may call `ti.init`.

    Args:
        cache: Folder of compiled kernels, which is cleared if it is damaged.
        options: Those of `ti.init`.
    """
    global _runtime, _cache  # noqa: PLW0603 - the library itself is one per process
    with kernel_cache.sealed(cache):
        pass  # finds damage before the library reads it
    _cache, _runtime = cache, None
    atexit.register(end)
    with (
        contextlib.redirect_stdout(io.StringIO()),
        _float_state_kept(),
        variables_hidden(LIBRARY, _QUIET),
    ):
        ti.init(offline_cache=True, offline_cache_file_path=str(cache), **options)
    _runtime = weakref.ref(ti.lang.impl.get_runtime(), lambda _: kernel_cache.seal(cache))


def end() -> None:
    """End our program, even if it only started in part; nothing of others is ended.

    The library writes its new kernels now, not later without a seal.
    """
    global _runtime, _cache  # noqa: PLW0603
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
    record[_PROGRAM], _runtime, _cache, _is_orphan = None, None, None, True


os.register_at_fork(after_in_child=_abandon)
