"""Functions of users in kernels: they compute what Python computes, or are refused.

In Python a name may stand for a whole number first and for a real one later. The kernel language
gives a name the type of its first value, and cuts what is assigned to it later. So where a function
of a user assigns a real number to a whole one, its kernel is traced again, with the name real from
its first value on. Where the number has to stay whole, the line is an error. Whole numbers have 64
bits there, on processors and on the cards of CUDA and AMD.

Operators have the values of Python. Where the library would end the process, a value is NaN or the
line is an error: negative powers of whole numbers, division by 0, truth values of real numbers,
None, indices beyond a vector. So is `assert`, which kernels leave out.

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

_divided = ti.raw_div
"""Division of whole numbers that rounds toward 0, as the library has it."""

_MOST_BITS = 62
"""Greatest shift of a whole number: the result has 64 bits, one of them for the sign."""

_MOST_EXPONENT = 4
"""Greatest exponent of a power that stays whole: that of a number up to 55,000 has 64 bits."""


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
    _replace(transformer, "build_Assert", _refused_assert)
    _replace(_library("impl"), "subscript", _subscript)
    _replace(transformer, "build_Subscript", _read_entry)
    prefix = "ti" if hasattr(_library("impl"), "ti_bool") else "qd"  # in later forks
    _replace(_library("impl"), f"{prefix}_bool", _truth_of)
    _replace(_library("impl"), "expr_init", _variable)
    for name, hook in _OPERATORS.items():
        before = getattr(_library("ops"), name)
        _replace(_library("ops"), name, hook)
        if getattr(ti, name, None) is before:  # a second name of the same function
            setattr(ti, name, getattr(_library("ops"), name))
    if LIBRARY == "taichi":
        utilities = _library("ast.ast_transformer_utils")
        kernels = _library("kernel_impl")
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
    before = _trace
    _trace = trace
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
    # The library ends the process where a kernel computes with truth values.
    return _as_real(value) if is_outermost else value


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
        value = ti.cast(value, _whole_type())
        node.ptr = value  # type: ignore[attr-defined]
    return value


def _subscript(
    original: Callable[..., Any], builder: _Foreign, value: _Foreign, *indices: _Foreign
) -> _Foreign:
    """Return an entry; indices have 32 bits, and are in the range of a vector or matrix."""
    if _is_of_user():
        if _is_tensor(value) and len(indices) == len(value.get_shape()):
            pairs = zip(indices, value.get_shape(), strict=True)
            indices = tuple(
                _index_inside(index, size) if isinstance(index, int) or _is_whole(index) else index
                for index, size in pairs
            )
        is_variable = any(isinstance(index, ti.lang.expr.Expr) for index in indices)
        indices = tuple(
            ti.cast(index, ti.i32)
            if _is_long(index) or (is_variable and type(index) is int)
            else index
            for index in indices
        )
    return original(builder, value, *indices)


def _read_entry(original: Callable[..., Any], context: _Foreign, node: ast.Subscript) -> _Foreign:
    """Read an entry of a vector or matrix: NaN where a variable index is out of its range."""
    entry = original(context, node)
    holder: _Foreign = node.value
    if not (isinstance(node.ctx, ast.Load) and _is_of_user() and _is_tensor(holder.ptr)):
        return entry
    index: _Foreign = node.slice
    indices = index.ptr if isinstance(index.ptr, list | tuple) else (index.ptr,)
    for number, size in zip(indices, holder.ptr.get_shape(), strict=False):
        if isinstance(number, ti.lang.expr.Expr) and _is_real(entry):
            is_inside = (number >= -size) & (number < size)
            entry = ti.select(is_inside, entry, ti.math.nan)
    node.ptr = entry  # type: ignore[attr-defined]
    return entry


def _is_tensor(value: _Foreign) -> bool:
    return isinstance(value, ti.lang.expr.Expr) and value.is_tensor()


def _index_inside(index: _Foreign, size: int) -> _Foreign:
    """Return an index of an entry; negative ones count from the end, as in Python."""
    if not isinstance(index, int):
        from_start = index + ti.select(index < 0, size, 0)
        return ti.max(0, ti.min(size - 1, from_start))
    if not -size <= index < size:
        raise _RefusalError(f"index {index} is beyond the {size} entries")
    return index % size


def _floor_division(
    original: Callable[..., Any], dividend: _Foreign, divisor: _Foreign
) -> _Foreign:
    """Round a quotient down; the library rounds that of whole constants toward 0.

    A divisor that is known only as the kernel runs may be 0, at which processors end the process.
    The quotient is real there, and NaN for 0.
    """
    if not _are_whole_of_user(dividend, divisor):
        return original(dividend, divisor)
    dividend = _counted(dividend)
    divisor = _counted(divisor)
    if isinstance(divisor, int):
        return _rounded_down(dividend, _nonzero(divisor))
    # The least whole number has no negative: processors end the process there, too.
    is_unsafe = (divisor == 0) | (divisor == -1)
    quotient = _rounded_down(dividend, ti.select(is_unsafe, 1, divisor))
    real = ti.cast(quotient, _real_type()) * ti.select(divisor == -1, -1.0, 1.0)
    return ti.select(divisor == 0, ti.math.nan, real)


def _nonzero(divisor: int) -> int:
    if divisor == 0:
        raise _RefusalError("divides by 0; divide by another number")
    return divisor


def _rounded_down(dividend: _Foreign, divisor: _Foreign) -> _Foreign:
    """Divide whole numbers, at least one not a constant, and round down."""
    quotient = _divided(dividend, divisor)
    rest = dividend - quotient * divisor
    is_between = (rest != 0) & ((rest < 0) != (divisor < 0))
    return quotient - ti.select(is_between, 1, 0)


def _remainder(original: Callable[..., Any], dividend: _Foreign, divisor: _Foreign) -> _Foreign:
    """Return the remainder of `_floor_division`."""
    if not _are_whole_of_user(dividend, divisor):
        return original(dividend, divisor)
    dividend = _counted(dividend)
    divisor = _counted(divisor)
    return dividend - divisor * (dividend // divisor)


def _are_whole_of_user(*numbers: _Foreign) -> bool:
    """Whether a function of a user computes with whole numbers, at least one not a constant."""
    variable = [number for number in numbers if not isinstance(number, int)]
    return _is_of_user() and bool(variable) and all(map(_is_whole, variable))


def _as_real(value: _Foreign) -> _Foreign:
    """Return what a function of a user returned as a real number, or as a vector of such."""
    if isinstance(value, bool | int | np.bool_):
        return float(value)
    is_real = _is_real(value) or not isinstance(value, ti.lang.expr.Expr)
    return value if is_real else ti.cast(value, _real_type())


def _is_of_user() -> bool:
    """Whether a function of a user is being traced."""
    return _trace is not None and bool(_trace.calls) and _trace.calls[-1][0] >= 0


def _counted(value: _Foreign) -> _Foreign:
    """Return a truth value as the whole number 0 or 1, and others as they are."""
    if isinstance(value, bool | np.bool_):
        return int(value)
    return ti.cast(value, _whole_type()) if _is_truth(value) else value


def _is_truth(value: _Foreign) -> bool:
    """Whether a value of a kernel is true or false, or a vector of such."""
    return isinstance(value, ti.lang.expr.Expr) and bool(_element_type(value) == ti.u1)


def _of_numbers(original: Callable[..., Any], *operands: _Foreign) -> _Foreign:
    """Compute with truth values as with numbers; the library has one bit for them."""
    if _is_of_user():
        operands = tuple(map(_counted, operands))
    return original(*operands)


def _power(original: Callable[..., Any], base: _Foreign, exponent: _Foreign) -> _Foreign:
    """Raise a number to a power; that of whole numbers is real where it may be a fraction."""
    if not _is_of_user():
        return original(base, exponent)
    base = _counted(base)
    exponent = _counted(exponent)
    if not _is_whole_exponent(exponent) and _are_whole_of_user(base, exponent):
        # The library ends the process for a negative exponent.
        base = float(base) if isinstance(base, int) else ti.cast(base, _real_type())
    return original(base, exponent)


def _is_whole_exponent(exponent: _Foreign) -> bool:
    """Whether the power of a whole number is whole, and has 64 bits."""
    return isinstance(exponent, int) and 0 <= exponent <= _MOST_EXPONENT


def _shifted(original: Callable[..., Any], value: _Foreign, bits: _Foreign) -> _Foreign:
    """Shift a whole number by a constant; of other numbers of bits the library makes noise."""
    if not _is_of_user():
        return original(value, bits)
    if not (isinstance(bits, int) and 0 <= bits <= _MOST_BITS):
        problem = f"shifts by bits that are no constant from 0 to {_MOST_BITS}; use a power of 2"
        raise _RefusalError(problem)
    return original(_counted(value), int(bits))


def _negation(original: Callable[..., Any], value: _Foreign) -> _Foreign:
    """Compute `not`; the library has none of real numbers."""
    return value == 0.0 if _is_of_user() and _is_real_scalar(value) else original(value)


def _is_real_scalar(value: _Foreign) -> bool:
    return isinstance(value, ti.lang.expr.Expr) and _is_real_type(_scalar_type(value))


def _conjunction(original: Callable[..., Any], first: _Foreign, second: _Foreign) -> _Foreign:
    """Compute `and`, which is one of the two values."""
    if not _is_of_user() or _are_truths(first, second):
        return original(first, second)
    return _either(first, second, first)


def _disjunction(original: Callable[..., Any], first: _Foreign, second: _Foreign) -> _Foreign:
    """Compute `or`, which is one of the two values."""
    if not _is_of_user() or _are_truths(first, second):
        return original(first, second)
    return _either(first, first, second)


def _are_truths(*values: _Foreign) -> bool:
    return all(isinstance(value, bool | np.bool_) or _is_truth(value) for value in values)


def _either(condition: _Foreign, value: _Foreign, otherwise: _Foreign) -> _Foreign:
    """Choose a value by whether a condition is true; the result has the type of both."""
    if not isinstance(condition, ti.lang.expr.Expr):
        return value if condition else otherwise
    for choice in (condition, value, otherwise):
        if not isinstance(choice, bool | int | float) and _scalar_type(choice) is None:
            raise _RefusalError("`and` and `or` take numbers; compare lengths of vectors")
    if not _are_truths(value, otherwise):
        kind = _real_type() if _is_real(value) or _is_real(otherwise) else _whole_type()
        value, otherwise = (ti.cast(choice, kind) for choice in (value, otherwise))
    return _library("ops").ifte(condition, value, otherwise)


def _variable(original: Callable[..., Any], value: _Foreign) -> _Foreign:
    """Make a variable; of None the library makes one without a type, and ends the process."""
    if value is None and _is_of_user():
        raise _RefusalError("None is no number; give a number")
    return original(value)


def _truth_of(original: Callable[..., Any], value: _Foreign) -> _Foreign:
    """Compute `bool` of a number; the library ends the process at that of a real one."""
    return value != 0.0 if _is_of_user() and _is_real_scalar(value) else original(value)


def _raw_divided(original: Callable[..., Any], dividend: _Foreign, divisor: _Foreign) -> _Foreign:
    """Divide as processors do, unless they would end the process at a divisor of 0."""
    if _are_whole_of_user(dividend, divisor) and not isinstance(divisor, int):
        problem = "divides whole numbers by one that may be 0; use // or %, or a constant"
        raise _RefusalError(problem)
    return original(dividend, divisor)


def _cast(original: Callable[..., Any], value: _Foreign, kind: _Foreign) -> _Foreign:
    """Convert a number; to a truth value as `_truth_of`."""
    if _is_of_user() and isinstance(value, list | tuple):
        raise _RefusalError("converts several numbers at once; convert each, or a vector")
    if _is_of_user() and kind in (bool, ti.u1) and _is_real_scalar(value):
        return value != 0.0
    return original(value, kind)


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
    built = original(context, node)
    if _number_of_call(context) < 0:
        return built
    operand: _Foreign = node.value
    target: _Foreign = node.target
    is_real = _makes_real(type(node.op).__name__, operand.ptr)
    _require_room(context, node.target, target.ptr, 0.5 if is_real else operand.ptr)
    return built


def _makes_real(operation: str, operand: _Foreign) -> bool:
    """Whether an operation makes a whole number real."""
    if operation == "Pow":
        return not _is_whole_exponent(operand)
    if operation in ("FloorDiv", "Mod"):
        return not isinstance(operand, int)
    return operation == "Div"


def _checked_range(original: Callable[..., Any], context: _Foreign, node: ast.For) -> _Foreign:
    """Loop over a range, unless its ends are real."""
    if _number_of_call(context) < 0:
        return original(context, node)
    with warnings.catch_warnings():  # of whole numbers of 64 bits
        warnings.filterwarnings("ignore", "Casting range_for boundary values")
        built = original(context, node)
    loop: _Foreign = node.iter
    for end in loop.args:
        if _is_real(end.ptr):
            raise _RefusalError(
                f"{ast.unparse(end)} is real, and ends a range; use int({ast.unparse(end)})"
            )
    return built


def _refused_assert(original: Callable[..., Any], context: _Foreign, node: ast.Assert) -> _Foreign:
    """Refuse `assert`, which kernels leave out unless the library debugs."""
    if _number_of_call(context) < 0:
        return original(context, node)
    raise _RefusalError(
        "assert is left out of kernels; check parameters before the call, or return ti.math.nan "
        f"unless {ast.unparse(node.test)}"
    )


def _checked_return(original: Callable[..., Any], context: _Foreign, node: ast.Return) -> _Foreign:
    """Return a value, unless an annotation would cut it."""
    built = original(context, node)
    if _number_of_call(context) >= 0 and node.value is not None and context.func.return_type:
        value: _Foreign = node.value
        whole = [_is_whole_type(kind) for kind in _sequence(context.func.return_type)]
        real = [_is_real(number) for number in _sequence(value.ptr)]
        if any(w and r for w, r in zip(whole, real, strict=False)):
            problem = "the return value is whole by its annotation, but real; annotate float"
            raise _RefusalError(problem)
    return built


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


_OPERATORS: dict[str, Callable[..., Any]] = {
    "floordiv": _floor_division,
    "mod": _remainder,
    "pow": _power,
    "logical_not": _negation,
    "logical_and": _conjunction,
    "logical_or": _disjunction,
    "raw_div": _raw_divided,
    "raw_mod": _raw_divided,
    "cast": _cast,
    **dict.fromkeys(["bit_shl", "bit_sar", "bit_shr"], _shifted),
    **dict.fromkeys(
        ["add", "sub", "mul", "truediv", "neg", "bit_not", "abs", "max", "min"], _of_numbers
    ),
}
"""Hooks of the library's operators, by name."""
