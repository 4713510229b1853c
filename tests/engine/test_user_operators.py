"""Operators in functions of users: each has Python's value, or is refused."""

import importlib.util
import math
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from tiswarm import relax
from tiswarm.base.errors import InputError
from tiswarm.compute import backend
from tiswarm.compute.lang import ti
from tiswarm.compute.user_functions import mistake_of_user

FORCE = """\
def force(distance):
    x = distance
    y = 2.0 * distance
    n = 3
    k = 2
    m = -2
    z = 0
    b = x > 1.0
    return {}
"""
AT = 1.5
"""Distance at which functions are evaluated."""

POWERS = [
    "n**-1 * x", "n**-2 * x", "n**0 * x", "n**2 * x", "n**k * x", "n**m * x", "(-n) ** 3 * x",
    "(-n) ** k * x", "2**k * x", "2**m * x", "2.0**m * x", "x**2", "x**-2", "x**0.5", "x**k",
    "x**m", "x**-k", "n**0.5 * x", "n**x", "n ** (k - 5) * x", "n ** (n - 3) * x", "k**-n * x",
    "n**True * x", "b**2 * x", "b**m * x", "(x > 1.0) ** -1 * x", "n**-1**2 * x", "-n**-1 * x",
    "(n**-1) ** -1 * x", "pow(n, -1) * x", "pow(x, m)", "n**62 * x", "n**400 * x", "x**400",
    "(-1) ** m * x", "int(x) ** -2 * x", "max(n, k) ** -1 * x", "1 / n**-2 * x",
]  # fmt: skip
TRUTHS = [
    "not x > 5.0", "not x < 5.0", "not x", "not n", "not z", "not not x", "(not x) + 1.0",
    "x and 2.0", "x or 2.0", "0.0 or x", "0.0 and x", "n and x", "n or x", "z and x", "z or x",
    "(n - 3) or x", "x and n", "x > 1.0 and x", "x > 5.0 or x", "x > 1.0 and x < 2.0",
    "x and y and 3.0", "(x - 1.5) or 3.0", "not (x and n)", "1.0 if x else 2.0", "b and n",
    "1.0 if not x else 2.0", "1.0 if x and n else 2.0", "x and not x", "bool(x) * x", "bool(z) + x",
    "None or x", "1 and x", "x and True", "x > 1.0 > 0.5",
]  # fmt: skip
NUMBERS = [
    "-b * x", "~b * x", "~n * x", "(b + b) * x", "(b - (x > 5.0)) * x", "b / 2", "abs(b)",
    "max(b, b) * x", "(x > 1.0) + (x < 2.0)", "n // k * x", "n % k * x", "n // m * x", "n % m * x",
    "-n // k * x", "-n % k * x", "n // -2 * x", "n % -2 * x", "n // 5 + x", "z // n + x", "b // 1",
    "x // n", "-x % n", "n << 2", "n >> 1", "n & k", "ti.Vector([x, y])[k - 1]",
    "ti.Vector([x, y])[m]", "ti.Vector([x, y])[-1]", "ti.Matrix([[x, 0.0], [y, x]])[k - 1, 0]",
]  # fmt: skip
NO_NUMBERS = [
    "n // z + x", "n % z + x", "b // z + x", "n // (n - 3) + x", "x % z", "z**m - z**m",
    "ti.Vector([x, y])[n]", "ti.Vector([x, y])[m - 1]",
]  # fmt: skip
REFUSED = [
    ("n << k", "shifts by bits that are no constant"),
    ("n >> 63", "shifts by bits that are no constant"),
    ("n // 0", "divides by 0"),
    ("ti.raw_div(n, z)", "divides whole numbers by one that may be 0"),
    ("ti.raw_mod(n, z)", "divides whole numbers by one that may be 0"),
    ("ti.cast([x, x], ti.f64)[0]", "converts several numbers at once"),
    ("ti.Vector([x, y])[2]", "index 2 is beyond the 2 entries"),
    ("ti.Vector([x, y]) and x", "`and` and `or` take numbers"),
    ("(w := None) or x", "None is no number"),
    ("x * None", "NoneType"),
]
_number = count()


def written(folder: Path, expression: str):
    """Write a force that returns an expression to a file, and import it."""
    path = folder / f"force_{next(_number)}.py"
    path.write_text(f"import tiswarm\n\nti = tiswarm.ti\n\n\n{FORCE.format(expression)}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.force


def computed(force) -> float:
    """Evaluate a force in a small kernel that counts as one of the package."""
    called, out = ti.func(force), np.zeros(1)

    @ti.kernel
    def evaluate(x: ti.f64, values: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for i in range(1):
            values[i] = ti.cast(called(x), ti.f64)

    evaluate._primal.func.__module__ = "tiswarm.of_a_test"  # noqa: SLF001 - no other way
    evaluate(AT, out)
    return float(out[0])


@pytest.fixture(autouse=True, scope="module")
def _processor():
    """Compute on the processor."""
    backend.start("cpu", threads=1)


@pytest.mark.parametrize("expression", [*POWERS, *TRUTHS, *NUMBERS])
def test_an_operator_has_the_value_of_python(tmp_path, expression):
    """Names may be real, whole or truth values; constants are known before the kernel runs."""
    force = written(tmp_path, expression)

    value = computed(force)

    assert math.isclose(value, float(force(AT)), rel_tol=1e-9), value


@pytest.mark.parametrize("expression", NO_NUMBERS)
def test_what_python_would_refuse_as_it_runs_is_nan(tmp_path, expression):
    """Processors end the process where whole numbers are divided by 0."""
    force = written(tmp_path, expression)

    value = computed(force)

    assert math.isnan(value)
    with pytest.raises((ArithmeticError, IndexError)):
        force(AT)


@pytest.mark.parametrize(("expression", "problem"), REFUSED)
def test_an_operator_that_has_no_value_is_refused_with_its_line(tmp_path, expression, problem):
    """The message names file, line and remedy."""
    force = written(tmp_path, expression)

    with pytest.raises(Exception, match=r".") as caught:
        computed(force)

    mistake = mistake_of_user(caught.value)
    assert problem in str(mistake)
    assert f"{force.__code__.co_filename}:14" in str(mistake)


class Atom:
    """A robot that is one dock."""

    spacing = 1.0
    dock_offset_body = np.zeros((1, 3))


def _small_step(force):
    return 0.01 * force


def _step_of_powers(force):
    n = 100
    return n**-1 * force


def _relaxed(force, integrator=_small_step) -> float:
    place = np.array([[0.0, 0.0, 0.0], [AT, 0.0, 0.0]])
    level = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    result = relax(
        place, level, [], robot=Atom, steps=1, threads=1, force=force, cutoff=3.0,
        integrator=integrator,
    )  # fmt: skip
    return float(result.position[0, 0])


@pytest.mark.parametrize(
    "expression",
    ["n**-1 * x", "not x > 5.0", *(pytest.param(e, marks=pytest.mark.trial) for e in ("n", "b"))],
)
def test_a_force_may_return_any_number(tmp_path, expression):
    """Whole numbers and truth values are pulls, too; so it is of integrators."""
    force = written(tmp_path, expression)

    moved, moved_by_power = _relaxed(force), _relaxed(force, _step_of_powers)

    np.testing.assert_allclose([moved, moved_by_power], 0.01 * float(force(AT)))


@pytest.mark.parametrize(
    ("expression", "problem"),
    [
        ("None", "has to return a vector of three numbers, or a number"),
        ("[x, x]", "has to return a vector of three numbers, or a number"),
        ("n // z", "returned NaN at step 0"),
    ],
)
def test_a_force_that_returns_no_number_is_refused(tmp_path, expression, problem):
    """One line names the function, whatever the kernel made of its value."""
    force = written(tmp_path, expression)

    with pytest.raises(InputError, match=problem):
        _relaxed(force)
