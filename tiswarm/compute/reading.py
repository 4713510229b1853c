"""Lets the kernel library read the kernels of this package in less time.

A start from compiled kernels reads each of them anew, to look it up. taichi draws the lines of
every expression meanwhile, in case of an error; quadrants has each drawn once. Each time a kernel
or a function of kernels is declared, both search all modules for the source of Python's importer,
to find out whether it is a class that declares them. Kernels of others are read as ever.
"""

import sys
from pathlib import Path
from typing import Any

_PACKAGE = str(Path(__file__).resolve().parents[1])
_FRAMES_BETWEEN = 1


def read_quickly(library: Any) -> None:  # noqa: ANN401 - it has no types
    """Replace two functions of the library, as far as this version has them."""
    kernels = library.lang.kernel_impl
    if asked := getattr(kernels, "_inside_class", None):
        kernels._inside_class = _inside_class(asked)  # noqa: SLF001
    context: Any = getattr(library.lang.ast.ast_transformer_utils, "ASTTransformerContext", None)
    if drawn := getattr(context, "get_pos_info", None):
        context.get_pos_info = _position(drawn)


def _inside_class(asked: Any) -> Any:  # noqa: ANN401
    """Answer at once where a module declares a kernel: Python's importer called it then."""

    def inside_class(level_of_class_stackframe: int) -> bool:
        caller = sys._getframe(level_of_class_stackframe)  # noqa: SLF001
        if caller.f_code.co_filename.startswith("<frozen importlib"):
            return False
        return bool(asked(level_of_class_stackframe + _FRAMES_BETWEEN))

    return inside_class


def _position(drawn: Any) -> Any:  # noqa: ANN401
    """Name file and line alone, but in an error, which has its lines as before."""

    def position(self: Any, node: Any) -> str:  # noqa: ANN401
        if self.raised or not str(self.file).startswith(_PACKAGE):
            return str(drawn(self, node))
        line = node.lineno + self.lineno_offset
        return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n'

    return position
