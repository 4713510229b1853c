"""Functions of users that kernels call: what decorates them, and all that they read.

A kernel has the values of names outside a function that these had as it was traced. `reads` returns
all of them, so that a change is noticed and the kernel is traced anew.
"""

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.compute.lang import LIBRARY, ti

_PACKAGE = __name__.partition(".")[0]


def is_of_user(function: object) -> bool:
    """Whether a function is neither of this package nor of the library."""
    root = str(getattr(function, "__module__", "")).partition(".")[0]
    return root not in {_PACKAGE, LIBRARY}


def is_kernel_function(function: object) -> bool:
    """Whether `ti.func` of the library decorates a function, and nothing above it."""
    is_marked = hasattr(function, f"_is_{LIBRARY}_function")
    if not isinstance(function, FunctionType):
        return is_marked
    # Other decorators copy the mark of `ti.func`, but their code is not the library's.
    return is_marked and function.__globals__["__name__"].partition(".")[0] == LIBRARY


def undecorated(function: Any) -> Any:  # noqa: ANN401 - anything that a user gives
    """Return the function below `ti.func`, or the function itself.

    Raises:
        InputError: another decorator changes what the function does.
    """
    while hasattr(function, "__wrapped__"):
        if not is_kernel_function(function):
            inner = inspect.unwrap(function)
            name = getattr(inner, "__name__", repr(inner))
            decorator = getattr(function, "__code__", None)
            place = (
                ""
                if decorator is None
                else f" (its code begins in line {decorator.co_firstlineno})"
            )
            raise InputError(
                f"a decorator{place} changes {name}, and kernels would leave that out; "
                f"compute it inside {name}, without the decorator",
                path=_file_of(inner),
                line=_line_of(inner),
            )
        function = function.__wrapped__
    return function


def _file_of(function: object) -> Path | None:
    code = getattr(function, "__code__", None)
    return None if code is None else Path(code.co_filename)


def _line_of(function: object) -> int | None:
    code = getattr(function, "__code__", None)
    return None if code is None else int(code.co_firstlineno)


@dataclasses.dataclass(frozen=True, eq=False)
class _Same:
    """An object that equals itself alone; kept, so that no other object takes its place."""

    value: object

    def __eq__(self, other: object) -> bool:
        """Compare identities."""
        return isinstance(other, _Same) and other.value is self.value

    def __hash__(self) -> int:
        """Hash the identity."""
        return id(self.value)


def reads(function: FunctionType) -> tuple[object, ...]:
    """Return what a kernel compiles of a function: its code, and all values that it reads.

    Values are those of names outside the function, of attributes of these, and of functions that it
    calls, recursively. What is returned is hashable, and equal only if all of this is.
    """
    return _reads(function, ())


def _reads(function: FunctionType, above: tuple[CodeType, ...]) -> tuple[object, ...]:
    code = function.__code__
    if code in above:  # functions that call each other
        return (code.co_name,)
    within = (*above, code)
    values = [(chain, _value_of(value, within)) for chain, value in _outside_values(function)]
    defaults = _value_of([function.__defaults__, function.__kwdefaults__], within)
    return (code.co_filename, code, defaults, *values)


def _outside_values(function: FunctionType) -> Iterator[tuple[tuple[str, ...], object]]:
    """Yield names outside a function, with attributes as far as they lead, and their values."""
    names = dict(function.__globals__)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            names[name] = cell.cell_contents
        except ValueError:  # not assigned yet
            names.pop(name, None)
    for chain in _chains(function.__code__):
        if chain[0] not in names:
            continue
        value = names[chain[0]]
        for attribute in chain[1:]:
            try:
                value = getattr(value, attribute)
            except Exception:  # noqa: BLE001 - properties of users
                break
        yield chain, value


@cache
def _chains(code: CodeType) -> tuple[tuple[str, ...], ...]:
    """List the names outside a function that it uses, each with the attributes that follow it."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(code)))
    except (OSError, TypeError, SyntaxError):  # it cannot be compiled either
        return ()
    local = {*code.co_varnames, *code.co_cellvars}
    chains = set()
    for node in ast.walk(tree):
        attributes: list[str] = []
        base: ast.AST = node
        while isinstance(base, ast.Attribute):
            attributes.insert(0, base.attr)
            base = base.value
        if isinstance(base, ast.Name) and base.id not in local:
            chains.add((base.id, *attributes))
    return tuple(sorted(chains))


def _value_of(value: Any, above: tuple[CodeType, ...]) -> object:  # noqa: ANN401
    """Return something hashable that is equal only for an equal value."""
    content: object = _Same(value)
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        content = repr(value)  # 0.0 equals -0.0, and NaN nothing
    elif isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        content = (str(value.dtype), value.shape, value.tobytes())
    elif isinstance(value, ti.Matrix):
        content = _value_of(value.to_list(), above)
    elif isinstance(value, list | tuple):
        content = tuple(_value_of(entry, above) for entry in value)
    elif isinstance(value, dict):
        content = tuple((_value_of(k, above), _value_of(v, above)) for k, v in value.items())
    elif _is_record(value):
        content = _value_of(vars(value), above)
    elif callable(value):
        inner = undecorated(value) if is_kernel_function(value) else value
        if isinstance(inner, FunctionType) and is_of_user(inner):
            content = _reads(inner, above)
    return type(value), content


def _is_record(value: object) -> bool:
    """Whether an object is no more than its attributes."""
    is_data = dataclasses.is_dataclass(value) and not isinstance(value, type)
    return isinstance(value, SimpleNamespace) or (is_data and hasattr(value, "__dict__"))


_PLACE = re.compile(r'File "(.*?)", line (\d+), in (.*):$', re.MULTILINE)
_MARK = re.compile(r"^[ ~]*\^[ ~^]*$", re.MULTILINE)


def is_of_library(error: BaseException) -> bool:
    """Whether the library raised an error, or the rules for functions of users."""
    return any(base.__module__.partition(".")[0] == LIBRARY for base in type(error).__mro__)


def problem_of(error: BaseException) -> str:
    """Return what is wrong, in a line, of an error of the library."""
    text = str(error)
    lines = _MARK.split(text)[-1].strip().splitlines()
    # Where Python raised an error, its last line says which.
    return " ".join(lines[-1:] if "Traceback" in text else lines).strip(".")


def mistake_of_user(error: BaseException) -> InputError | None:
    """Return an error of the library with the file and line of a user's function, if it has any."""
    for file, line, name in reversed(_PLACE.findall(str(error))):
        if not Path(file).is_relative_to(Path(__file__).parents[1]):
            problem = f"{name}: {problem_of(error)}; correct it"
            return InputError(problem, path=Path(file), line=int(line))
    return None
