"""What decides the last bits of all numbers: compiled kernels, numpy, BLAS and libm.

Each of them chooses its code by the features of the processor. Where all choose alike, runs give
the same bytes. Six hex digits in parentheses are a digest of computed values: they differ where
values do, even under equal names.
"""

import math
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import DTypeLike, NDArray
from threadpoolctl import threadpool_info

from tiswarm.base.aliases import Reals
from tiswarm.compute.lang import LIBRARY, ti

_FEATURES = ("fma", "avx2", "avx512f")
"""Features of x86 that change how compilers round."""

_LONGEST = 64
"""Bytes of the longest vectors."""

_VALUES = 256
_SIZE = 48
_DIGITS = 6


class Numerics(NamedTuple):
    """The libraries that round numbers, and the code that each chooses on a processor."""

    kernels: str
    """Compiler of kernels, and the processor that it compiles for."""

    numpy: str
    """Version of numpy, and the latest instructions that it uses."""

    blas: str
    """Linear algebra of numpy and scipy, with the family of processors that it has chosen."""

    libm: str
    """Library of elementary functions."""

    @property
    def key(self) -> str:
        """Digest of all four, eight hex digits."""
        return sha256(repr((*self,)).encode()).hexdigest()[:8]

    @property
    def facts(self) -> dict[str, str]:
        """Key and libraries, as a manifest lists them."""
        return {"key": self.key, **self._asdict()}


@cache
def current() -> Numerics:
    """Examine what rounds numbers in this process."""
    latest = (simd_features() or ["baseline"])[-1]
    libc = " ".join(platform.libc_ver()).strip() or platform.system()
    return Numerics(
        kernels=f"{LIBRARY} {version(LIBRARY)}, {_llvm()} for {_target()}",
        numpy=f"{np.__version__}, {latest} ({_digest(*_by_numpy())})",
        blas=f"{_blas()} ({_digest(*_by_blas())})",
        libm=f"{libc} ({_digest(*_by_libm())})",
    )


def difference(recorded: Mapping[str, str]) -> str:
    """Name what another machine, or this one at another time, rounded numbers by, and what here."""
    differences = []
    for name, library in current()._asdict().items():
        recorded_library = recorded.get(name, library)
        if recorded_library != library:
            differences.append(f"{name} {recorded_library}, here {library}")
    return "; ".join(differences)


def _llvm() -> str:
    support = getattr(ti._lib.core, "get_llvm_target_support", None)  # noqa: SLF001
    return f"LLVM {support()}" if support else "LLVM"


def _target() -> str:
    """Name the processor as LLVM distinguishes them: by vendor, family, model and features."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
        entries = (line.partition(":") for line in lines)
        facts = {key.strip(): value.strip() for key, _, value in entries}
        if "vendor_id" in facts:
            family = facts.get("cpu family")
            names = [facts["vendor_id"], "family", family, "model", facts.get("model")]
            flags = {*facts.get("flags", "").split()}
            return " ".join(filter(None, [*names, *(n for n in _FEATURES if n in flags)]))
    return platform.processor() or platform.machine()


def simd_features() -> list[str]:
    """List instructions for which numpy has code of its own and which it uses, the latest last."""
    # A build without code of its own for any has no such entry.
    return list(np.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", []))


def _blas() -> str:
    """Name the kernels of BLAS that numpy and scipy loaded."""
    by_owner: dict[str, list[str]] = {"numpy": [], "scipy": [], "": []}
    for pool in threadpool_info():
        if pool["user_api"] != "blas":
            continue
        owners = (name for name in by_owner if name and f"{name}.libs" in pool["filepath"])
        owner = next(owners, "")
        parts = [owner, pool["internal_api"], pool["version"], pool.get("architecture")]
        by_owner[owner].append(" ".join(str(part) for part in parts if part))
    # Other packages of this process may have loaded one of their own, which rounds nothing here.
    named = sorted(by_owner["numpy"] + by_owner["scipy"]) or sorted(by_owner[""])
    return ", ".join(named) or "unknown"


def _fixed(rows: int, columns: int) -> Reals:
    """Return a matrix of fixed numbers in (-1, 1), exact on all machines."""
    number = np.arange(1, rows * columns + 1, dtype=np.int64)
    return ((number * 2654435761) % 2**32 / 2.0**31 - 1.0).reshape(rows, columns)


def _by_libm() -> list[float]:
    one = [math.exp, math.log1p, math.sin, math.cos, math.tan, math.atan, math.sinh]
    values = 0.99 * _fixed(1, _VALUES)[0]
    return [f(x) for x in values.tolist() for f in one] + [
        math.pow(2.5, x) for x in values.tolist()
    ]


def _by_numpy() -> list[object]:
    values = 0.99 * _fixed(_VALUES, 3)
    one = (np.exp, np.log1p, np.sin, np.cos, np.tan, np.arctan, np.sqrt)
    return [
        *(f(np.abs(values)) for f in one),
        values.sum(axis=0),
        np.einsum("ij,ij->i", values, values),
    ]


def _by_blas() -> list[object]:
    matrix = _fixed(_SIZE, _SIZE)
    square = matrix @ matrix.T + np.eye(_SIZE)
    solved = np.linalg.solve(square, matrix)
    return [square, solved, np.linalg.eigvalsh(square), scipy.linalg.cholesky(square)]


def _digest(*values: object) -> str:
    flat = np.concatenate([np.ravel(np.asarray(value, np.float64)) for value in values])
    return sha256(flat.tobytes()).hexdigest()[:_DIGITS]


@contextmanager
def fast_arithmetic(*, ignores_nan: bool) -> Iterator[None]:
    """Let kernels that are compiled within reorder sums, if they may ignore NaN, too.

    Sums over neighbors are then vectorized. Their bits do not depend on the number of threads,
    but may differ between kinds of processors.
    """
    config = ti.lang.impl.current_cfg()
    config.fast_math = ignores_nan
    config.cfg_optimization = True
    try:
        yield
    finally:
        config.fast_math = False
        config.cfg_optimization = False


@contextmanager
def optimized_by_llvm() -> Iterator[None]:
    """Let LLVM alone optimize kernels that are compiled within.

    The kernel library's own optimization takes four fifths of the time to compile a long kernel.
    Where kernels check bounds, it stays: it removes repeated checks, which slow LLVM down.
    """
    config = ti.lang.impl.current_cfg()
    config.advanced_optimization = config.debug
    try:
        yield
    finally:
        config.advanced_optimization = True


@contextmanager
def native_vectors() -> Iterator[None]:
    """Let kernels that are compiled within keep vectors in registers of their size.

    Else each number of a vector is one variable, and loops over rows take four times as long.
    Operations on numbers are the same, and so are bits. Vectors in arrays have to begin at a
    multiple of their size, see `aligned_zeros`; `a = a - b` stands for `a -= b`, which the library
    cannot translate.
    """
    config = ti.lang.impl.current_cfg()
    config.real_matrix_scalarize = False
    try:
        yield
    finally:
        config.real_matrix_scalarize = True


def aligned_zeros(*shape: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Reserve an array of zeros that begins at a multiple of the size of any vector."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    room = np.zeros(size + _LONGEST, np.uint8)
    first = -room.ctypes.data % _LONGEST
    return room[first : first + size].view(dtype).reshape(shape)
