"""Arrays and kernels evaluate the same equations."""

import math

import numpy as np
import pytest

from tiswarm.compute import backend
from tiswarm.compute.lang import I32, Ints1, Reals1, Reals2, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.measurements import equations

missed_distance = ti.func(equations.missed_distance)
missed_along = ti.func(equations.missed_along)
slope_by_turn = ti.func(equations.slope_by_turn)
loss_beyond = ti.func(equations.loss_beyond)

pytestmark = pytest.mark.checked


@ti.kernel
def evaluate(size: I32, first: Reals2, second: Reals2, number: Reals1, hinge: Ints1, out: Reals2):
    """Evaluate all equations for each row."""
    for i in range(size):
        a, b = vector_at(first, i), vector_at(second, i)
        out[i, 0], out[i, 1] = missed_distance(a, number[i], hinge[i] == 1)
        out[i, 2] = missed_along(a, b, number[i])
        turn = slope_by_turn(a, b)
        for c in ti.static(range(3)):
            out[i, 3 + c] = turn[c]
        out[i, 6] = loss_beyond(number[i], ti.log(1.0 + number[i]), 9.0)


@pytest.fixture(scope="module")
def rows():
    """Vectors, one of them 0, numbers, and which rows are hinges."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 200, 3))
    first[0] = 0.0
    return first, second, 2.0 * rng.random(200), rng.integers(0, 2, 200, np.int32)


def test_kernels_and_arrays_agree(rows):
    """One function serves both, to rounding."""
    first, second, number, hinge = rows
    out = np.empty((len(number), 7))
    with backend.exclusive():
        backend.device()
        evaluate(len(number), first, second, number, hinge, out)
    a, b = first.T, second.T

    found = [
        *equations.missed_distance(a, number, hinge == 1),
        equations.missed_along(a, b, number),
        *equations.slope_by_turn(a, b),
        equations.loss_beyond(number, np.log1p(number), 9.0),
    ]

    np.testing.assert_allclose(out, np.column_stack(found), rtol=0.0, atol=1e-12)


def test_a_distance_is_missed_along_the_line_between_its_ends(rows):
    """Open hinges and points that coincide have no direction; a hinge is missed if too short."""
    first, _, number, hinge = rows

    residual, slope = equations.missed_distance(first.T, number, hinge == 1)

    for k, (apart, length) in enumerate(zip(first.tolist(), number.tolist(), strict=True)):
        away = math.hypot(*apart)
        is_open = hinge[k] == 1 and away >= length
        assert residual[k] == pytest.approx(0.0 if is_open else away - length, abs=1e-12)
        direction = [0.0] * 3 if is_open or not away else [part / away for part in apart]
        assert slope[k] * first[k] == pytest.approx(direction, abs=1e-12)


def test_a_turn_moves_the_end_of_an_arm(rows):
    """By the derivative of d . (R(-w) a) by w, at no turn: a difference shows it."""
    direction, arm, _, _ = rows
    small = 1e-6

    slope = np.array(equations.slope_by_turn(direction.T, arm.T))

    for axis in range(3):
        moved = -small * np.cross(np.eye(3)[axis], arm)
        expected = (direction * moved).sum(axis=1) / small
        np.testing.assert_allclose(slope[axis], expected, atol=1e-9)


def test_the_square_and_the_loss_beyond_it_are_cauchys_loss():
    """With t the squared miss in widths, squares of e^2 / v (1 + t) lack the rest."""
    missed = np.array([0.0, 0.3, 5.0, 1e3])

    beyond = equations.loss_beyond(missed, np.log1p(missed), 9.0)

    square = 9.0 * missed / (1.0 + missed)
    np.testing.assert_allclose(square + beyond, 9.0 * np.log1p(missed), rtol=1e-12)
