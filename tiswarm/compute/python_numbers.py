"""Functions of users in kernels: they compute what Python computes, or are refused.

In Python a name may stand for a whole number first and for a real one later. The kernel language
gives a name the type of its first value, and cuts what is assigned to it later. So where a function
of a user assigns a real number to a whole one, its kernel is traced again, with the name real from
its first value on. Where the number has to stay whole, the line is an error. Whole numbers have 64
bits there, on processors and on the cards of CUDA and AMD.

A function without the decorator `ti.func` is run once, by Python, as the kernel is traced. There
each `if` on a number of the kernel would be true. So a call of one is an error, too, and so is one
of a random generator, which would draw one number for all calls of the kernel.

All of this holds for what kernels of this package call; kernels of others are traced as the library
does it.
"""

import ast
import functools
import inspect
import random
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from types import BuiltinMethodType, FunctionType, MethodType
from typing import Any

import numpy as np

from tiswarm.compute.lang import LIBRARY, ti
from tiswarm.compute.user_functions import is_kernel_function, is_of_user

_Foreign = Any
"""An object of the library, or a value that it handles; the library has no types."""

_REAL_OPERATIONS = ("Div",)
"""Operations of augmented assignments whose result is real for whole numbers, too."""


@dataclass
class _KernelTrace:
    """The trace of a kernel of this package."""

    wider: dict[tuple[int, str], Any] = field(default_factory=dict)
    """Types of names from their first value on, by the number of the function's call and name."""

    later: dict[tuple[int, str], Any] = field(default_factory=dict)
    """Types that names turned out to need."""

    calls: list[tuple[int, _Foreign]] = field(default_factory=list)
    """Functions that are being traced, outermost first: number of the call, and the function as the
    library has it. The number is -1 for a function that is no user's."""

    count: int = 0
    """Calls of functions of users so far."""


_trace: _KernelTrace | None = None
"""The trace that goes on; None between traces, and for kernels of others."""


def _library(module: str) -> _Foreign:
    return import_module(f"{LIBRARY}.lang.{module}")


def _named(module: str, name: str) -> _Foreign:
    return getattr(_library(module), LIBRARY.capitalize() + name)


_CompilationError: type[Exception] = _named("exception", "CompilationError")


class _RefusalError(_CompilationError):  # type: ignore[misc, valid-type]
    """A line of a user that cannot be computed as Python does."""


class _WiderNamesError(_CompilationError):  # type: ignore[misc, valid-type]
    """The kernel has to be traced again, with wider types of names."""


@cache
def install() -> None:
    """Let the library trace functions of users so, from now on."""
    transformer = _library("ast.ast_transformer").ASTTransformer
    _replace(transformer, "build_Name", _read_name)
    _replace(transformer, "build_assign_basic", _checked_assignment)
    _replace(transformer, "build_assign_annotated", _checked_annotation)
    _replace(transformer, "build_AugAssign", _checked_augmented)
    _replace(transformer, "build_Return", _checked_return)
    _replace(transformer, "build_range_for", _checked_range)
    _replace(_library("impl"), "subscript", _subscript)
    _replace(_library("ops"), "floordiv", _floor_division)
    _replace(_library("ops"), "mod", _remainder)
    if LIBRARY == "taichi":
        utilities, kernels = _library("ast.ast_transformer_utils"), _library("kernel_impl")
        _replace(utilities.ASTTransformerContext, "create_variable", _created)
        _replace(kernels.Func, "__call__", _called)
        _replace(kernels.Kernel, "materialize", _materialized)
        _replace(transformer, "warn_if_is_external_func", _checked_call)
    else:
        utilities = _library("ast.ast_transformer_utils")
        caller = _library("ast.ast_transformers.call_transformer").CallTransformer
        _replace(utilities.ASTTransformerFuncContext, "create_variable", _created)
        _replace(_library("func").Func, "__call__", _called)
        _replace(_library("kernel").Kernel, "materialize", _materialized)
        _replace(caller, "_warn_if_is_external_func", _checked_call)


def _replace(owner: object, name: str, hook: Callable[..., Any]) -> None:
    """Put a hook, which takes the original first, in place of a method of the library."""
    original = getattr(owner, name)
    is_static = isinstance(vars(owner)[name], staticmethod)

    @functools.wraps(original)
    def replaced(*arguments: _Foreign, **options: _Foreign) -> _Foreign:
        return hook(original, *arguments, **options)

    setattr(owner, name, staticmethod(replaced) if is_static else replaced)


def _materialized(
    original: Callable[..., Any], kernel: _Foreign, *arguments: _Foreign, **options: _Foreign
) -> _Foreign:
    """Trace a kernel, and again as long as names of users need wider types."""
    global _trace  # noqa: PLW0603 - the library traces one kernel at a time
    if is_of_user(kernel.func):
        return original(kernel, *arguments, **options)
    trace = _KernelTrace()
    before, _trace = _trace, trace
    try:
        while True:
            try:
                return original(kernel, *arguments, **options)
            except _WiderNamesError:
                # Each trace makes types wider, so this ends.
                trace = _KernelTrace(wider=trace.wider | trace.later)
                _trace = trace
            except _CompilationError as error:
                real = {name for (_, name), kind in trace.wider.items() if _is_real_type(kind)}
                if not real or isinstance(error, _RefusalError):
                    raise
                names = ", ".join(sorted(real))
                text = str(error).rstrip(".\n ")
                raise type(error)(f"{text} (a real number is assigned to {names})") from None
    finally:
        _trace = before


def _called(
    original: Callable[..., Any], function: _Foreign, *arguments: _Foreign, **options: _Foreign
) -> _Foreign:
    """Trace a function that a kernel calls."""
    trace = _trace
    if trace is None:
        return original(function, *arguments, **options)
    if not is_of_user(function.func):
        trace.calls.append((-1, function))
        try:
            return original(function, *arguments, **options)
        finally:
            trace.calls.pop()
    _check_arguments(function, arguments, options)
    is_outermost = all(number < 0 for number, _ in trace.calls)
    trace.calls.append((trace.count, function))
    trace.count += 1
    try:
        with _long_whole_numbers():
            value = original(function, *arguments, **options)
    finally:
        trace.calls.pop()
    if is_outermost and trace.later:
        raise _WiderNamesError
    return value


@contextmanager
def _long_whole_numbers() -> Iterator[None]:
    """Give whole numbers 64 bits: products overflow 32 where Python's do not."""
    runtime = _library("impl").get_runtime()
    before = runtime.default_ip
    runtime.default_ip = _whole_type()
    try:
        yield
    finally:
        runtime.default_ip = before


def _whole_type() -> _Foreign:
    """Return the type of whole numbers in functions of users: not each card has 64 bits."""
    arch = ti.lang.impl.current_cfg().arch
    return ti.i64 if arch in (ti.x64, ti.arm64, ti.cuda, ti.amdgpu) else ti.i32


def _real_type() -> _Foreign:
    return _library("impl").get_runtime().default_fp


def _number_of_call(context: _Foreign) -> int:
    """Return the number of the call of a user's function that a context is of, or -1."""
    if _trace is None or not _trace.calls:
        return -1
    number, function = _trace.calls[-1]
    return number if context.func is function else -1


def _created(
    original: Callable[..., Any], context: _Foreign, name: str, variable: _Foreign
) -> None:
    """Create a variable, of the type that it needs later."""
    kind = None if _trace is None else _trace.wider.get((_number_of_call(context), name))
    original(context, name, variable if kind is None else _converted(variable, kind))


def _read_name(original: Callable[..., Any], context: _Foreign, node: ast.Name) -> _Foreign:
    """Read a name; whole numbers of 32 bits, such as counters of loops, have 64 from there on."""
    value = original(context, node)
    if isinstance(node.ctx, ast.Load) and _number_of_call(context) >= 0 and _is_short(value):
        node.ptr = value = ti.cast(value, _whole_type())  # type: ignore[attr-defined]
    return value


def _subscript(
    original: Callable[..., Any], builder: _Foreign, value: _Foreign, *indices: _Foreign
) -> _Foreign:
    """Return an entry; indices have 32 bits."""
    if _trace is not None and _trace.calls and _trace.calls[-1][0] >= 0:
        indices = tuple(ti.cast(i, ti.i32) if _is_long(i) else i for i in indices)
    return original(builder, value, *indices)


def _floor_division(
    original: Callable[..., Any], dividend: _Foreign, divisor: _Foreign
) -> _Foreign:
    """Round a quotient down; the library rounds that of whole constants toward 0."""
    if not _are_whole_of_user(dividend, divisor):
        return original(dividend, divisor)
    quotient = ti.raw_div(dividend, divisor)
    rest = dividend - quotient * divisor
    is_between = (rest != 0) & ((rest < 0) != (divisor < 0))
    return quotient - ti.select(is_between, 1, 0)


def _remainder(original: Callable[..., Any], dividend: _Foreign, divisor: _Foreign) -> _Foreign:
    """Return the remainder of `_floor_division`."""
    if not _are_whole_of_user(dividend, divisor):
        return original(dividend, divisor)
    return dividend - divisor * (dividend // divisor)


def _are_whole_of_user(dividend: _Foreign, divisor: _Foreign) -> bool:
    """Whether a function of a user divides whole numbers, at least one not a constant."""
    if _trace is None or not _trace.calls or _trace.calls[-1][0] < 0:
        return False
    numbers = [n for n in (dividend, divisor) if not isinstance(n, int)]
    return bool(numbers) and all(_is_whole(number) for number in numbers)


def _checked_assignment(
    original: Callable[..., Any],
    context: _Foreign,
    target: ast.expr,
    value: _Foreign,
    *options: _Foreign,
) -> _Foreign:
    """Assign a value, and note a number that needs a wider type for it."""
    variable = original(context, target, value, *options)
    if _number_of_call(context) >= 0:
        _require_room(context, target, variable, value)
    return variable


def _checked_annotation(
    original: Callable[..., Any],
    context: _Foreign,
    target: ast.expr,
    value: _Foreign,
    is_static: _Foreign,
    annotation: _Foreign,
) -> _Foreign:
    """Assign a value to a name with a type."""
    if _number_of_call(context) >= 0:
        if annotation in (int, bool, float):  # of Python, which the library takes for numbers
            annotation = _python_types()[annotation]
        if _is_whole_type(annotation) and _is_real(value):
            name = ast.unparse(target)
            problem = f"{name} is whole by its annotation, but gets a real number; annotate float"
            raise _RefusalError(problem)
    return original(context, target, value, is_static, annotation)


def _python_types() -> dict[type, Any]:
    return {int: _whole_type(), bool: ti.u1, float: _real_type()}


def _checked_augmented(
    original: Callable[..., Any], context: _Foreign, node: ast.AugAssign
) -> _Foreign:
    """Assign what an operation returns, as `_checked_assignment`."""
    found = original(context, node)
    if _number_of_call(context) < 0:
        return found
    operand: _Foreign = node.value
    target: _Foreign = node.target
    is_real = type(node.op).__name__ in _REAL_OPERATIONS
    _require_room(context, node.target, target.ptr, 0.5 if is_real else operand.ptr)
    return found


def _checked_range(original: Callable[..., Any], context: _Foreign, node: ast.For) -> _Foreign:
    """Loop over a range, unless its ends are real."""
    if _number_of_call(context) < 0:
        return original(context, node)
    with warnings.catch_warnings():  # of whole numbers of 64 bits
        warnings.filterwarnings("ignore", "Casting range_for boundary values")
        found = original(context, node)
    loop: _Foreign = node.iter
    for end in loop.args:
        if _is_real(end.ptr):
            raise _RefusalError(
                f"{ast.unparse(end)} is real, and ends a range; use int({ast.unparse(end)})"
            )
    return found


def _checked_return(original: Callable[..., Any], context: _Foreign, node: ast.Return) -> _Foreign:
    """Return a value, unless an annotation would cut it."""
    found = original(context, node)
    if _number_of_call(context) >= 0 and node.value is not None and context.func.return_type:
        value: _Foreign = node.value
        whole = [_is_whole_type(kind) for kind in _sequence(context.func.return_type)]
        real = [_is_real(number) for number in _sequence(value.ptr)]
        if any(w and r for w, r in zip(whole, real, strict=False)):
            problem = "the return value is whole by its annotation, but real; annotate float"
            raise _RefusalError(problem)
    return found


def _check_arguments(
    function: _Foreign, arguments: tuple[Any, ...], options: dict[str, Any]
) -> None:
    """Refuse a real number for an argument that an annotation makes whole."""
    parameters = inspect.signature(function.func).parameters
    for name, value in [*zip(parameters, arguments, strict=False), *options.items()]:
        if name in parameters and _is_whole_type(parameters[name].annotation) and _is_real(value):
            problem = f"{name} of {function.func.__name__} is whole by its annotation, but gets a "
            raise _RefusalError(f"{problem}real number; annotate float")


def _checked_call(original: Callable[..., Any], context: _Foreign, node: ast.Call) -> None:
    """Refuse calls of what Python would run only once, as the kernel is traced."""
    if _number_of_call(context) < 0 or context.is_in_static_scope():
        original(context, node)
        return
    called: _Foreign = node.func
    name = ast.unparse(node.func)
    function = called.ptr
    if _draws(function):
        raise _RefusalError(
            f"{name} does not repeat; ask for noise as an argument, or give numbers in parameters"
        )
    values = [argument.ptr for argument in node.args]  # type: ignore[attr-defined]
    values += [option.value.ptr for option in node.keywords]  # type: ignore[attr-defined]
    takes_numbers = any(_holds_number(value) for value in values)
    is_python = isinstance(function, FunctionType | MethodType) and is_of_user(function)
    if is_python and takes_numbers and not is_kernel_function(function):
        if hasattr(function, "__wrapped__"):
            raise _RefusalError(f"{name} is decorated; leave all decorators but ti.func out")
        raise _RefusalError(f"{name} is no kernel function; decorate it with ti.func")
    if getattr(function, "__name__", "").startswith("atomic_"):
        _require_room(context, node.args[0], values[0], values[-1])
    original(context, node)


def _draws(function: object) -> bool:
    """Whether a function is of a random generator."""
    if any(function is vars(ti)[name] for name in ("random", "randn")):
        return True
    generators = (np.random.RandomState, np.random.Generator, random.Random)
    if isinstance(function, BuiltinMethodType | MethodType):
        return isinstance(function.__self__, generators)
    module = str(getattr(function, "__module__", ""))
    return module == "random" or module.startswith("numpy.random")


def _require_room(context: _Foreign, target: ast.expr, variable: _Foreign, value: _Foreign) -> None:
    """Note that a name of a user's function needs a wider type than that of its first value.

    Raises:
        _RefusalError: it cannot have one, and would cut a real number.
    """
    if _trace is None or not _is_whole(variable):
        return
    is_real = _is_real(value)
    if not (is_real or (_is_narrow(variable) and not _is_narrow(value))):
        return
    base: _Foreign = target
    while isinstance(base, ast.Subscript | ast.Attribute):
        base = base.value
    name = (_number_of_call(context), getattr(base, "id", ""))
    kind = _real_type() if is_real else _whole_type()
    if context.is_var_declared(name[1]) and _trace.wider.get(name) != kind:
        _trace.later[name] = (
            kind if _trace.later.get(name) in (None, _whole_type()) else _real_type()
        )
    elif is_real:
        text = ast.unparse(target)
        raise _RefusalError(f"{text} is whole, but gets a real number; use another name")


def _holds_number(value: object) -> bool:
    """Whether a value has a number that is known only as the kernel runs."""
    if isinstance(value, list | tuple):
        return any(_holds_number(entry) for entry in value)
    return isinstance(value, ti.lang.expr.Expr | ti.Matrix)


def _sequence(value: _Foreign) -> Iterable[Any]:
    return value if isinstance(value, list | tuple) else (value,)


def _element_type(number: _Foreign) -> _Foreign:
    """Return the type of a number, or of those of a vector; None if it is neither."""
    kind = number.ptr.get_rvalue_type()
    if number.is_tensor():
        return number.element_type()
    return None if number.ptr.is_struct() else kind


def _is_whole_type(kind: object) -> bool:
    integers = ti.types.primitive_types.integer_types
    return any(kind is integer or kind == integer for integer in integers)


def _is_real_type(kind: object) -> bool:
    reals = ti.types.primitive_types.real_types
    return any(kind is real or kind == real for real in reals)


def _is_whole(value: _Foreign) -> bool:
    """Whether a value of a kernel is whole, or a vector of whole numbers."""
    return isinstance(value, ti.lang.expr.Expr) and _is_whole_type(_element_type(value))


def _is_short(value: _Foreign) -> bool:
    """Whether a value of a kernel is a whole number of 32 bits, not of a type for bits."""
    return bool(_whole_type() != ti.i32 and _scalar_type(value) == ti.i32)


def _is_long(value: _Foreign) -> bool:
    """Whether a value of a kernel is a whole number of 64 bits."""
    return bool(_scalar_type(value) == ti.i64)


def _scalar_type(value: _Foreign) -> _Foreign:
    """Return the type of a number of a kernel; None for other values."""
    is_scalar = isinstance(value, ti.lang.expr.Expr) and not value.is_tensor()
    return _element_type(value) if is_scalar else None


def _is_narrow(value: _Foreign) -> bool:
    """Whether a value is a truth value, or has 32 bits; numbers of Python are wide."""
    if isinstance(value, bool):
        return True
    is_number = isinstance(value, ti.lang.expr.Expr)
    return is_number and bool(_element_type(value) in (ti.u1, ti.i32))


def _is_real(value: _Foreign) -> bool:
    """Whether a value is real, or holds a real number."""
    if isinstance(value, list | tuple):
        return any(_is_real(entry) for entry in value)
    if isinstance(value, ti.lang.expr.Expr):
        return _is_real_type(_element_type(value))
    return isinstance(value, float | np.floating)


def _converted(value: _Foreign, kind: _Foreign) -> _Foreign:
    """Return a new variable with a value of another type, where it is whole."""
    if isinstance(value, list | tuple):
        return type(value)(_converted(entry, kind) for entry in value)
    return _library("impl").expr_init(ti.cast(value, kind)) if _is_whole(value) else value
