"""Remembers what the kernel library looks up in source files.

As the library reads a kernel, it writes for each node of the syntax tree where it stands, with the
line of the source, for errors to show. A function that others call is read again for each call. As
a function is declared, the library looks through all modules for the line that declares it. Without
memory, both take a third of the time that stored kernels take to load.
"""

import functools
import linecache
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any


def remember_positions(library: str) -> None:
    """Let a kernel library write each position, and look for each line, once.

    What it writes and finds stays what it was. A library that is arranged otherwise is left as it
    is.
    """
    with suppress(ImportError, AttributeError):
        kernels: Any = import_module(f"{library}.lang.kernel_impl")
        context: Any = kernels.ASTTransformerContext
        context.get_pos_info = _remembering(context.get_pos_info)
        for name in ("getsourcefile", "getsourcelines"):
            setattr(kernels, name, functools.cache(getattr(kernels, name)))
        find, starts = "_inside_class", "_KERNEL_CLASS_STACKFRAME_STMT_RES"
        if hasattr(kernels, find):
            setattr(kernels, find, _finding(getattr(kernels, starts)))


def _remembering(write: Any) -> Any:  # noqa: ANN401 - the library has no types
    """Return a method that writes the position of a node, as `write` does, once."""
    known: dict[tuple[object, ...], str] = {}

    @functools.wraps(write)
    def get_pos_info(self: Any, node: Any) -> str:  # noqa: ANN401
        ends = (node.lineno, node.col_offset, node.end_lineno, node.end_col_offset)
        place = (self.func.func, type(node), *ends)
        text = known.get(place)
        if text is None:
            text = known[place] = write(self, node)
        return text

    return get_pos_info


def _finding(starts: Sequence[re.Pattern[str]]) -> Callable[[int], bool]:
    """Return a function that finds whether a level of the stack declares a class.

    The line that the level has reached begins as one of `starts` then.
    """

    @functools.cache
    def declares(file: str, number: int) -> bool:
        line = linecache.getline(file, number).strip()
        return any(start.match(line) for start in starts)

    def inside_class(level_of_class_stackframe: int) -> bool:
        frame = sys._getframe(level_of_class_stackframe)  # noqa: SLF001 - as the library does
        return declares(frame.f_code.co_filename, frame.f_lineno)

    return inside_class
