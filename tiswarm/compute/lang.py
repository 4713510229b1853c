"""The one place that imports the kernel language.

Every kernel file says `from tiswarm.compute.lang import ti`. The language has two
implementations: taichi, and its maintained fork quadrants, which also runs where taichi has no
wheel. The variable TISWARM_BACKEND names one; without it, the first that can be imported is used.

Arrays that belong together form a bundle, a `NamedTuple` that documents each of them. The host
allocates it and spreads it over the arguments of a kernel; the first lines of the kernel bind
them again, inside `ti.static`, and hand the bundle on:

    class Rows(NamedTuple):
        entry: Ints1
        first: Ints1

    @ti.kernel
    def fill(room: I32, entry_out: Ints1, first_out: Ints1):
        rows = ti.static(Rows(entry_out, first_out))
    fill(8, *rows)

Arguments that a kernel writes end in `_out`. A bundle may hold others. Loops of a function that a
kernel calls at its top are shared by all threads, as those that stand there.
"""

import io
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from textwrap import dedent, fill
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.errors import EnvironmentTroubleError

LIBRARIES = {"taichi": "TI", "quadrants": "QD"}
"""The implementations, best first, with the prefix of their environment variables."""

HONOURED = ("VISIBLE_DEVICE",)
"""Variables of the libraries that no argument replaces: which of several Vulkan cards computes."""


@contextmanager
def variables_hidden(library: str, instead: Mapping[str, str]) -> Iterator[None]:
    """Hide a library's variables while it starts, as it obeys them over its arguments.

    Args:
        library: Name of the library.
        instead: Variables to set meanwhile.
    """
    prefix = f"{LIBRARIES[library]}_"
    kept = {prefix + name for name in HONOURED}
    hidden = {name for name in os.environ if name.startswith(prefix)} - kept
    before = {name: os.environ.pop(name, None) for name in hidden.union(instead)}
    os.environ.update(instead)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def load_library() -> tuple[str, Any]:
    """Import the library that is asked for, or the first that can be; return its name and it.

    Raises:
        EnvironmentTroubleError: none is installed, or none can be imported.
    """
    asked = os.environ.get("TISWARM_BACKEND")
    if asked is not None and asked not in LIBRARIES:
        problem = f"TISWARM_BACKEND={asked}: unknown; set it to {' or '.join(LIBRARIES)}"
        raise EnvironmentTroubleError(problem)
    if "HOME" not in os.environ:  # the library aborts the process at import without one
        os.environ["HOME"] = os.path.expanduser("~").replace("~", "/nonexistent")  # noqa: PTH111
    trouble = ""
    flags = sys.getdlopenflags()
    notebook = "0" if sys.stdout is sys.__stdout__ else "1"
    for name in filter(find_spec, LIBRARIES if asked is None else (asked,)):
        silent = {f"ENABLE_{name.upper()}_HEADER_PRINT": "0"}
        silent[f"{LIBRARIES[name]}_ENABLE_PYBUF"] = notebook
        # Below this level it would write to the terminal that it has found a notebook.
        silent[f"{LIBRARIES[name]}_LOG_LEVEL"] = "critical"
        try:
            with (
                redirect_stdout(io.StringIO()),  # a failed import prints; a notebook looks alike
                warnings.catch_warnings(),  # it adds filters of its own
                variables_hidden(name, silent),
            ):
                library = import_module(name)
        except (ImportError, OSError) as error:
            trouble = f"{name} cannot be imported: {' '.join(str(error).split())}"
            sys.setdlopenflags(flags)  # the library leaves its own
        else:
            if trouble:
                sys.stderr.write(f"tiswarm: warning: {trouble}; computing with {name}\n")
            return name, library
    if trouble:
        raise EnvironmentTroubleError(f"{trouble}; on Debian, run: apt-get install libx11-6")
    raise EnvironmentTroubleError(
        f"{asked or ' and '.join(LIBRARIES)} not installed; run: pip install {asked or 'taichi'}"
    )


LIBRARY, ti = load_library()


_places: dict[tuple[str, int, str], str] = {}
"""Names of places in kernels, by file, line and source: each has many nodes, in many calls."""


def _place(context: Any, node: Any) -> str:  # noqa: ANN401 - of the library
    """Name the place of a statement; carets below all of it are a quarter of a kernel's load."""
    line = node.lineno + context.lineno_offset
    key = context.file, line, context.src[node.lineno - 1]
    place = _places.get(key)
    if place is None:
        name = context.func.func.__name__
        place = f'File "{context.file}", line {line}, in {name}:\n{key[2].strip()}\n^\n'
        _places[key] = place
    return place


def _is_in_class(level_of_class_stackframe: int) -> bool:
    """Whether a class defines a function; the library would examine all modules for each."""
    return "__qualname__" in sys._getframe(level_of_class_stackframe - 1).f_locals  # noqa: SLF001


with suppress(AttributeError, ImportError):  # of another version of the library
    _ast = import_module(f"{LIBRARY}.lang.ast.ast_transformer_utils")
    _ast.ASTTransformerContext.get_pos_info = _place
    _kernels: Any = import_module(f"{LIBRARY}.lang.kernel_impl")
    _kernels._inside_class = _is_in_class  # noqa: SLF001
    # What is called in a kernel is read again for each call.
    _kernels.getsourcelines = cache(_kernels.getsourcelines)
    _kernels.getsourcefile = cache(_kernels.getsourcefile)
    _kernels.textwrap = SimpleNamespace(fill=cache(fill), dedent=cache(dedent))
    # Each array would keep a formatted traceback of where it was reserved.
    _arrays: Any = import_module(f"{LIBRARY}.lang._ndarray")
    _arrays.get_traceback = str

if TYPE_CHECKING:
    from dataclasses import dataclass as kernel_struct

    Float = float
    F64 = float
    I32 = int
    Vec3 = Any
    Vec4 = Any
    Ref = Any
    Static = Any
    Reals1 = Any
    Reals2 = Any
    Reals3 = Any
    Reals4 = Any
    Ints1 = Any
    Ints2 = Any
    Ints3 = Any
    Ints4 = Any
    Longs2 = Any
else:
    kernel_struct = ti.dataclass
    Float = float
    F64 = ti.f64
    I32 = ti.i32
    Vec3 = ti.types.vector(3, ti.f64)
    Vec4 = ti.types.vector(4, ti.f64)
    Ref = ti.template()  # a kernel function is lent an array, bundle or struct, not given a copy
    Static = ti.template()  # a value that a kernel is compiled for, anew for each other value

    # Without a dtype an array argument takes what it is given: one source for f32 and f64.
    Reals1, Reals2, Reals3, Reals4 = (ti.types.ndarray(ndim=ndim) for ndim in (1, 2, 3, 4))
    Ints1, Ints2, Ints3, Ints4 = (ti.types.ndarray(dtype=ti.i32, ndim=n) for n in (1, 2, 3, 4))
    Longs2 = ti.types.ndarray(dtype=ti.i64, ndim=2)
    if sys.version_info < (3, 11):  # where the fields of a `NamedTuple` must be callable
        ti.types.ndarray.__call__ = None


def holds_integers(array: Any) -> bool:  # noqa: ANN401 - an argument of a kernel
    """Whether an array argument holds 32-bit integers; to be asked in `ti.static`."""
    return bool(array.get_type().element_type == ti.i32)


DeviceArray = Any
"""Array on the device that a kernel takes; `to_numpy` copies it back."""

GRAIN = 512
"""Iterations of a parallel loop that one thread takes at a time, even if fewer are requested.

A loop over few, long pieces of work runs on one thread unless each piece stands at the start of
that many iterations: `for piece, idle in ti.ndrange(pieces, GRAIN): if idle == 0:`.
"""


class Columns:
    """Columns of a table that a kernel takes, in order; a subclass names each with its width.

    In the subclass, a name stands for the first of its columns, and `TOTAL` for their number. A
    subclass of a subclass appends columns.

    >>> class Plane(Columns):
    ...     POINT = 3
    ...     PRECISION = 1
    >>> Plane.POINT, Plane.PRECISION, Plane.TOTAL
    (0, 3, 4)
    """

    TOTAL: ClassVar[int] = 0
    _widths: ClassVar[dict[str, int]] = {}

    def __init_subclass__(cls) -> None:
        """Turn widths into places."""
        widths = {name: width for name, width in vars(cls).items() if name.isupper()}
        cls._widths = cls._widths | widths
        for name, width in widths.items():
            setattr(cls, name, cls.TOTAL)
            cls.TOTAL += width

    @classmethod
    def pack(cls, **columns: NDArray[Any]) -> NDArray[Any]:
        """Pack columns into a table, shape (rows, widths of those given); the last may be left out.

        Raises:
            ValueError: a column is missing, or has another width than was declared.
        """
        names = [*cls._widths][: len(columns)]
        parts = [np.atleast_2d(columns[name].T).T for name in names if name in columns]
        widths = [cls._widths[name] for name in names]
        if [part.shape[1] for part in parts] != widths:
            raise ValueError(f"columns of {cls.__name__}: {[*columns]}; give {names} of {widths}")
        return np.column_stack(parts)


__all__ = ["kernel_struct"]  # the one name that is imported; all others may be, too
