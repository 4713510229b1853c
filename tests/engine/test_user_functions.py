"""Functions of users in kernels compute what Python computes, follow what they read, or refuse."""

# ruff: noqa: B007, D103, F841, PERF401, RET504, S311, SIM108 - functions as users may write them

import functools
import inspect
import random
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm import relax
from tiswarm.base.errors import InputError
from tiswarm.compute.lang import ti
from tiswarm.engine.forces import MovingSwarm

# --- whole numbers ---------------------------------------------------------------------------


def conditional(x):
    pull = 0
    if x > 1.0:
        pull = 0.5 * (x - 1.0)
    return pull


def added(x):
    total = 0
    total += x
    return total


def replaced(x):
    weight = 1
    weight = 0.5 * x
    return weight


def divided(x):
    n = 100
    while n > 1:
        n /= 3
    return n * x


def rooted(x):
    side = 2
    side **= 0.5
    return side * x


def chained(x):
    first = second = third = 0
    first += x
    second = first / 2
    third -= 3 * second
    return first + 10 * second + 100 * third


def unpacked(x):
    a, b = 0, 1
    for _ in range(5):
        a, b = b, a + b * x
    return a


def named_within(x):
    total = 1
    if (double := 2 * x) > 1:
        total *= double
    return total


def in_branches(x):
    outer = 0
    if x > 1:
        inner = 1
        if x > 1.2:
            inner = inner * 0.3
        outer = inner
    return outer


def bisected(x):
    low = 0
    high = 4
    while high - low > 1e-3:
        middle = (low + high) / 2
        if middle * middle < x:
            low = middle
        else:
            high = middle
    return low


def truth(x):
    is_far = False
    is_far = 0.5 * x
    return is_far


def counted_truth(x):
    n = x > 1.0
    n += 5
    return n * x


def large_product(x):
    n = 100000
    return n * n * 1e-10 * x


def factorial(x):
    product = 1
    for i in range(1, 16):
        product *= i
    return x / product


def powers_of_counter(x):
    total = 0
    for i in range(300):
        total += i * i * i * i
    return total * x


def copied_counter(x):
    total = 0
    for i in range(3):
        n = i
        n += 100000
        n *= n
        total += n
    return total * x


def collatz(x):
    n = 27
    steps = 0
    while n != 1:
        if n % 2 == 0:
            n = n // 2
        else:
            n = 3 * n + 1
        steps += 1
    return steps * x


def negative_division(x):
    n = -7
    return (n % 3) * x + n // 2


def negative_remainder(x):
    m = 7
    m %= -4
    m //= 2
    return m * x


def indexed(x):
    weights = ti.Vector([1.0, 2.0, 4.0])
    total = 0
    for i in range(3):
        total += weights[i] * x
        k = (i + 1) % 3
        total -= weights[k] * i
    return total


def listed(x):
    pair = [0, 0]
    pair[1] = x
    return pair[0] + pair[1]


@ti.func
def add_to(n, x):
    n += x
    return n


def by_a_helper(x):
    return add_to(1, x) + add_to(1, 2) * 10


by_a_helper.in_python = lambda x: 1 + x + 30

COMPARED = [
    conditional, added, replaced, divided, rooted, chained, unpacked, named_within, in_branches,
    bisected, truth, counted_truth, large_product, factorial, powers_of_counter, copied_counter,
    collatz, negative_division, negative_remainder, indexed, listed, by_a_helper,
]  # fmt: skip
KERNEL_FUNCTIONS = [ti.func(function) for function in COMPARED]


class Atom:
    """A robot that is one dock."""

    spacing = 1.0
    dock_offset_body = np.zeros((1, 3))


DISTANCE = 1.5
PAIR = {
    "position": [[0.0, 0.0, 0.0], [DISTANCE, 0.0, 0.0]],
    "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
    "contacts": [],
    "robot": Atom,
    "cutoff": 3.0,
}


def as_is(force):
    """Step by the force."""
    return force


def pull_of(force, **options):
    """Return what a force does to a robot at the origin, shape (3,)."""
    return relax(**PAIR, steps=1, force=force, integrator=as_is, **options).position[0]


def chosen(distance, which):
    """Compute one of the functions above: one kernel for all."""
    pull = 0
    for number, function in ti.static(enumerate(KERNEL_FUNCTIONS)):
        if which == number:
            pull = function(distance)
    return pull


@pytest.mark.parametrize("number", range(len(COMPARED)), ids=lambda n: COMPARED[n].__name__)
def test_a_function_computes_what_python_computes(number):
    """Numbers that begin whole, large ones, and negative ones in divisions."""
    function = getattr(COMPARED[number], "in_python", COMPARED[number])

    pull = pull_of(chosen, parameters={"which": number})

    assert pull[0] == pytest.approx(function(DISTANCE), rel=1e-12)


def summed(distance):
    total = ti.Vector([0, 0, 0])
    total += ti.Vector([distance, 0.5, 0.25])
    total[1] -= distance
    return total


def test_a_vector_of_whole_numbers_becomes_real():
    """As a whole, and entry by entry."""
    pull = pull_of(summed)

    np.testing.assert_allclose(pull, [1.5, -1.0, 0.25], rtol=1e-12)


def whole_drift(force, noise, step):
    drift = 0
    drift += 0.25 * step
    return force + ti.Vector([drift, 0, 0]) + 0 * noise


def test_an_integrator_computes_what_python_computes():
    """Its numbers become real, too."""
    end = relax(**PAIR, steps=4, force=no_pull, integrator=whole_drift).position

    assert end[0, 0] == pytest.approx(0.25 * (1 + 2 + 3))


def no_pull(distance):
    return 0 * distance


def as_counter(distance):
    for i in range(2):
        i = 0.5 * distance  # noqa: PLW2901 - as users may
    return distance


def as_index(distance):
    place = 0
    first = ti.Vector([1.0, 2.0])[place]
    place = distance
    return first + place


def as_end(distance):
    count = 3
    total = 0
    for i in range(count):
        total += i
    count = 0.5 * distance
    return total + count


def in_a_record(distance):
    record = ti.Struct(total=0)
    record.total += distance
    return record.total


def annotated(distance):
    total: int = 0.5 * distance
    return total


@ti.func
def rounded(distance) -> ti.i32:
    return distance  # cut


def by_annotation(distance):
    return rounded(distance)


@pytest.mark.parametrize(
    ("function", "line", "problem"),
    [
        (as_counter, "i = 0.5", "i is whole, but gets a real number; use another name"),
        (as_index, "[place]", "indices must be integers"),
        (as_end, "range(count)", r"count is real, and ends a range; use int\(count\)"),
        (in_a_record, "record.total +=", "record.total is whole, but gets a real number"),
        (annotated, "total: int", "total is whole by its annotation, but gets a real number"),
        (by_annotation, "# cut", "the return value is whole by its annotation, but real"),
    ],
)
def test_a_number_that_has_to_stay_whole_is_refused_with_its_line(function, line, problem):
    """A counter, an index, and types that the user wrote."""
    text = Path(__file__).read_text().splitlines()
    number = next(n for n, content in enumerate(text, 1) if line in content)

    with pytest.raises(InputError, match=problem) as caught:
        pull_of(function)

    assert str(caught.value).startswith(f"{__file__}:{number}: ")


# --- what Python runs once -------------------------------------------------------------------


def of_python(x):
    """Return early: nothing that a kernel could do."""
    if x > 5.0:
        return 1.0
    return x


def calls_python(distance):
    return of_python(distance)


def draws(distance):
    return distance * np.random.normal()  # noqa: NPY002 - as users may


def draws_too(distance):
    return distance * random.random()


def draws_in_kernels(distance):
    return distance * ti.random()  # noqa: TID251 - as users may


GENERATOR = np.random.default_rng(1)


def draws_from_a_generator(distance):
    return distance * GENERATOR.normal()


def squared(function):
    """Square what a function returns."""

    @functools.wraps(function)
    def of_square(x):
        return function(x) ** 2

    return of_square


@squared
@ti.func
def twice(x):
    return 2.0 * x


def calls_decorated(distance):
    return twice(distance)


@pytest.mark.parametrize(
    ("function", "problem"),
    [
        (calls_python, "of_python is no kernel function; decorate it with ti.func"),
        (calls_decorated, "twice is decorated; leave all decorators but ti.func out"),
        (draws, r"np\.random\.normal does not repeat; ask for noise"),
        (draws_too, r"random\.random does not repeat; ask for noise"),
        (draws_in_kernels, r"ti\.random does not repeat; ask for noise"),
        (draws_from_a_generator, r"GENERATOR\.normal does not repeat; ask for noise"),
    ],
)
def test_what_python_would_run_once_is_refused(function, problem):
    """Its branches would all be taken, and its random numbers would be one for all calls."""
    with pytest.raises(InputError, match=f"^{__file__}:.*{problem}"):
        pull_of(function)


def asserts(distance):
    assert distance > 5.0, "too near"
    return distance


@ti.func
def asserts_too(distance):
    if distance > 1.0:
        assert False  # noqa: B011, PT015 - as users may
    return distance


def calls_what_asserts(distance):
    return asserts_too(distance)


@pytest.mark.parametrize(
    ("function", "line", "condition"),
    [
        (asserts, 'assert distance > 5.0, "too near"', "distance > 5.0"),
        (calls_what_asserts, "assert False  #", "False"),
    ],
)
def test_an_assertion_that_a_kernel_would_leave_out_is_refused(function, line, condition):
    """Kernels have assertions only where the library debugs; elsewhere they would never fail."""
    text = Path(__file__).read_text().splitlines()
    number = next(n for n, content in enumerate(text, 1) if line in content)
    problem = f"assert is left out of kernels; .* unless {condition}"

    with pytest.raises(InputError, match=f"^{__file__}:{number}: .*{problem}"):
        pull_of(function)


# --- decorators ------------------------------------------------------------------------------


def decorated_force(distance):
    return distance - 1.0


def decorated_step(force):
    return force


def remembered(function):
    """Return the same function in a shell."""

    @functools.wraps(function)
    def shell(*values):
        return function(*values)

    return shell


@pytest.mark.parametrize(
    "decorator", [squared, remembered, functools.lru_cache, lambda f: squared(ti.func(f))]
)
@pytest.mark.parametrize("kind", ["force", "integrator"])
def test_a_decorator_that_a_kernel_would_leave_out_is_refused(decorator, kind):
    """The line is that of the function."""
    functions = {"force": no_pull, "integrator": as_is}
    function = {"force": decorated_force, "integrator": decorated_step}[kind]
    line = inspect.getsourcelines(function)[1]

    with pytest.raises(InputError, match=r"a decorator.* changes decorated_") as caught:
        relax(**PAIR, steps=1, **functions | {kind: decorator(function)})

    assert str(caught.value).startswith(f"{__file__}:{line}: ")


# --- what functions read ---------------------------------------------------------------------

STIFFNESS = 1.0
SETTINGS = SimpleNamespace(stiffness=1.0)
TABLE = [1.0, 2.0]
ARRAY = np.array([1.0, 2.0])


@ti.func
def helper(x):
    return STIFFNESS * x


def by_global(distance):
    return STIFFNESS * distance


def by_attribute(distance):
    return SETTINGS.stiffness * distance


def by_entry(distance):
    return TABLE[0] * distance


def by_array(distance):
    return ARRAY[0] * distance


def by_called(distance):
    return helper(distance)


@pytest.mark.parametrize(
    ("force", "change"),
    [
        (by_global, lambda value: globals().update(STIFFNESS=value)),
        (by_called, lambda value: globals().update(STIFFNESS=value)),
        (by_attribute, lambda value: setattr(SETTINGS, "stiffness", value)),
        (by_entry, lambda value: TABLE.__setitem__(0, value)),
        (by_array, lambda value: ARRAY.__setitem__(0, value)),
    ],
)
def test_a_force_follows_what_it_reads(force, change):
    """Also in a swarm that is kept, and back to the first value."""
    swarm = MovingSwarm(**PAIR, force=force, integrator=as_is)
    try:
        pulls, kept = [], []
        for value in (1.0, 2.0, 1.0):
            change(value)
            pulls.append(pull_of(force)[0])
            kept.append(swarm.relax(steps=1).position[0, 0])
    finally:
        change(1.0)

    assert pulls == kept == [DISTANCE, 2.0 * DISTANCE, DISTANCE]


def test_a_force_follows_a_helper_that_is_defined_again(monkeypatch):
    """As when a cell of a notebook is run again."""

    @ti.func
    def again(x):
        return 3.0 * x

    before = pull_of(by_called)[0]
    monkeypatch.setitem(globals(), "helper", again)
    after = pull_of(by_called)[0]

    assert (before, after) == (DISTANCE, 3.0 * DISTANCE)


def test_a_force_follows_a_variable_of_the_function_around_it():
    """And the type of a number: 1 and 1.0 are equal, yet may compute differently."""
    factor = 1

    def by_cell(distance):
        return factor * distance

    pulls = []
    for factor in (1, 2.5, True):
        pulls.append(pull_of(by_cell)[0])

    assert pulls == [DISTANCE, 2.5 * DISTANCE, DISTANCE]


def test_what_a_force_does_not_read_compiles_nothing_anew(monkeypatch):
    """Names of arguments that stand outside, too, and what others read."""
    swarm = MovingSwarm(**PAIR, force=by_global, integrator=as_is)

    monkeypatch.setitem(globals(), "distance", 7.0)
    monkeypatch.setattr(SETTINGS, "stiffness", 5.0)

    assert MovingSwarm(**PAIR, force=by_global, integrator=as_is).dynamics == swarm.dynamics
