"""Ground by functions of users: the distance from a point to it.

@tiswarm.terrain("waves")
@ti.func
def waves(point):
    return (point[2] - ti.sin(point[0])) / 1.5
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from inspect import isfunction
from typing import Any, TypeVar

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.base.plugins import call_plugin
from tiswarm.base.registry import register
from tiswarm.base.sections import settings_class, settings_object
from tiswarm.compute.user_functions import is_kernel_function, reads, undecorated
from tiswarm.world.ground.bodies import UserParams

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")

_Form = TypeVar("_Form")

_functions: dict[tuple[object, ...], Any] = {}
"""Functions by what they read; the same one where it reads the same, so kernels compile once."""


def terrain(name: str, *, lipschitz: float = 1.0) -> Callable[[_Form], _Form]:
    """Register ground, which scenarios choose as the `kind` of a body of `structure.terrain`.

    What is decorated is a function of the kernel language, which `ti.func` decorates: from a point
    [R] to the distance to the ground [R], negative inside. It should be true up to 3 R from the
    surface, for docks rest where it is their radius; farther away it may be less. A class instead
    has annotated fields, which are keys of the body, and a method `distance`, which returns such a
    function. Its `__post_init__` may raise ValueError for values that it cannot take. Points are in
    the body's frame.

    Args:
        name: Name of the ground: words of letters and digits, with "-".
        lipschitz: Largest change of the distance over that of the point, 1 of a true distance.

    Raises:
        InputError: the name is taken or invalid, or this is neither such a function nor such a
            class.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} names no ground; use words like my-hill")
    if not (np.isfinite(lipschitz) and lipschitz >= 1.0):
        raise InputError(f"lipschitz of {lipschitz!r} for {name}; give 1 or more")

    def add(form: _Form) -> _Form:
        settings: Any = form
        namespace: dict[str, Any] = {"lipschitz": float(lipschitz)}
        if isinstance(form, type):
            if not isfunction(vars(form).get("distance")):
                raise InputError(f"{name} lacks distance; define it")
            source: Any = vars(form)["distance"]
            if "__dataclass_fields__" not in vars(form):
                settings = dataclass(frozen=True, kw_only=True)(form)
            namespace["function"] = _guarded(name, settings)
        elif is_kernel_function(form):
            source = undecorated(form)
            settings = None
            namespace["function"] = lambda _self: _kept(form)
        else:
            raise InputError(
                f"{name} is no function that ti.func decorates, nor a class; decorate it"
            )
        section = settings_class("terrain", name, settings, UserParams, namespace)
        register("terrain", name, section, source)
        return form

    return add


def _guarded(name: str, settings: type[Any]) -> Callable[[Any], Any]:
    """Wrap the method of a plug-in's class that returns its function."""

    def function(body: Any) -> Any:  # noqa: ANN401 - of the kernel language
        ground = settings_object("terrain", body, settings)
        returned = call_plugin(
            "terrain",
            name,
            ground.distance,
            _fault,
            method="distance",
            repeats=settings.distance,
            owner=ground,
        )
        return _kept(returned)

    return function


def _fault(returned: object) -> str:
    if is_kernel_function(returned):
        return ""
    kind = getattr(returned, "__name__", type(returned).__name__)
    return f"{kind}; return a function that ti.func decorates, and nothing else"


def _kept(function: Any) -> Any:  # noqa: ANN401 - of the kernel language
    """Return the first function that reads the same."""
    return _functions.setdefault(reads(undecorated(function)), function)
