"""Forces and integrators that scenarios choose by name; those of a user register here.

A function asks for what it needs by the names of its arguments, as `tiswarm.engine.forces`
explains. All others are numbers, `localization.parameters` of a scenario:

    @tiswarm.force("spring")
    def spring(distance, connected, spacing, stiffness=0.1):
        return ti.select(connected, stiffness * (distance - spacing), 0.0)
"""

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeVar

from tiswarm.base.errors import InputError
from tiswarm.base.registry import get, register
from tiswarm.compute.lang import ti
from tiswarm.engine.forces import FORCE, INTEGRATOR

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_Function = TypeVar("_Function", bound=Callable[..., Any])


def contact(attraction_gain: float = 0.05, repulsion_gain: float = 0.04, ramp: float = 0.5) -> None:
    """Stand for Eqs. (1) and (2), which the engine has itself; `in_place_of` leaves it out."""


def first_order() -> None:
    """Stand for steps that are the force itself; `in_place_of` leaves it out."""


# Functions of the kernel language have no types.
def lennard_jones(offset, epsilon=1.0, sigma=2.0):  # noqa: ANN001, ANN201
    """Return the slope of 4 epsilon ((sigma / r)^12 - (sigma / r)^6), as a vector."""
    inverse = 1.0 / offset.norm_sqr()
    power = (sigma * sigma * inverse) ** 3
    return 24.0 * epsilon * (power - 2.0 * power * power) * inverse * offset


def verlet(force, last_step, dt=0.005):  # noqa: ANN001, ANN201
    """Return the step of Verlet for a mass of 1."""
    return last_step + dt * dt * force


def langevin(  # noqa: ANN201
    force,  # noqa: ANN001
    last_step,  # noqa: ANN001
    noise,  # noqa: ANN001
    last_noise,  # noqa: ANN001
    friction=1.0,  # noqa: ANN001
    temperature=1.0,  # noqa: ANN001
    dt=0.005,  # noqa: ANN001
):
    """Return the step of Langevin dynamics for a mass of 1, by Groenbech-Jensen and Farago."""
    share = 1.0 / (1.0 + 0.5 * friction * dt)
    kick = ti.sqrt(0.5 * friction * temperature * dt) * (noise + last_noise)
    kept = (1.0 - 0.5 * friction * dt) * share * last_step
    return kept + share * dt * (dt * force + kick)


def force(name: str) -> Callable[[_Function], _Function]:
    """Register a function of the kernel language as a force of scenarios.

    Args:
        name: Name in scenarios, `localization: {method: relax, force: NAME}`: words of letters and
            digits, with "-".

    Raises:
        InputError: the name is taken or invalid.
    """
    return _register("force", name)


def integrator(name: str) -> Callable[[_Function], _Function]:
    """Register a function of the kernel language as an integrator of scenarios.

    Args:
        name: Name in scenarios, `localization: {method: relax, integrator: NAME}`: words of letters
            and digits, with "-".

    Raises:
        InputError: the name is taken or invalid.
    """
    return _register("integrator", name)


def _register(kind: Literal["force", "integrator"], name: str) -> Callable[[_Function], _Function]:
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} names no {kind}; use words like my-{kind}")

    def add(function: _Function) -> _Function:
        register(kind, name, function, function)
        return function

    return add


def in_place_of(kind: Literal["force", "integrator"], name: str) -> Callable[..., Any] | None:
    """Return a force or an integrator by its name, None for that of the engine itself."""
    function: Callable[..., Any] = get(kind, name)
    return None if function in {contact, first_order} else function


def numbers_of(force_name: str, integrator_name: str) -> Mapping[str, float | None]:
    """Return the numbers that a force and an integrator ask for, with defaults; None if none."""
    numbers: dict[str, float | None] = {}
    chosen: tuple[tuple[Literal["force", "integrator"], str, tuple[str, ...]], ...] = (
        ("force", force_name, FORCE),
        ("integrator", integrator_name, INTEGRATOR),
    )
    for kind, name, of_engine in chosen:
        for argument in inspect.signature(get(kind, name)).parameters.values():
            if argument.name in of_engine:
                continue
            default = None if argument.default is argument.empty else float(argument.default)
            if numbers.get(argument.name) is None:
                numbers[argument.name] = default
    return numbers
