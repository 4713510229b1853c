"""Growth by code of users: rules of growth, and kinds of structures.

A rule sees all climbers of all structures at once: kernels list what each touches and which flips
it may take, and the rule chooses for all.

    @tiswarm.rule("random")
    class Random:
        def choose(self, step):  # M climbers with K flips each
            wish = step.uniform("flip", step.possible.shape[1])
            return np.where(step.possible, wish, -1.0).argmax(axis=1)

    @tiswarm.structure("leaning")
    class Leaning(TowerParams):
        def goal(self, side):
            return np.array([20.0, 0.0, self.goal_height])
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass as plain_dataclass
from functools import partial, wraps
from inspect import isfunction
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.plugins import call_plugin, fault_of_numbers
from tiswarm.base.registry import register
from tiswarm.base.sections import settings_class
from tiswarm.compute.user_functions import is_kernel_function
from tiswarm.records.terrain import Terrain
from tiswarm.world.choices import fault_of_choice, read_only
from tiswarm.world.members import Members
from tiswarm.world.params import GrowthParams
from tiswarm.world.walks import asked_settings

_MOST_CALLED = 2**30
"""Largest call of a plug-in."""

_METHODS = ("choose", "score", "call", "spread", "act")

_SIZES = ("memory", "message", "rounds_after")
"""Attributes of a rule that are numbers from 0 up."""

_MOST = 2**20
"""Largest of these."""

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_SHAPES: Mapping[str, Callable[..., tuple[int, ...]]] = {
    "goal": lambda _side: (3,),
    "behind": lambda _side, docks: (len(docks),),
    "start": lambda _side, _rim, _draw: (2,),
    "spread": lambda count, _behind: (count, 2),
}
"""By method of a kind, the shape of what it returns for its arguments."""

_FARTHEST = 1e6
"""Largest length that a method of a plug-in may return [R]."""

_Kind = TypeVar("_Kind", bound=GrowthParams)

_Class = TypeVar("_Class", bound=type)


def rule(name: str, *, local: bool = False) -> Callable[[_Class], _Class]:
    """Register a class as a rule of growth, which scenarios choose as `structure.rule`.

    Its annotated fields are settings. It has one of these methods:

    - `choose(step)`: the choice of each of M climbers, integers of shape (M,) or one: a flip of
      `step`, -1 to stay, or `step.back(s)` to go back to stance s and stay there.
      `help(type(step))` lists what a step has.
    - `score()`: a function of the kernel language of (center, orientation, goal), to be least in
      place of the distance to the goal; robots do all else as in ReactiveBuild. Further arguments
      are names of settings, whose values then change without compiling again.

    And it may have these, in place of what ReactiveBuild does:

    - `call(sensed, params)`: the call that each robot of a structure makes, integers from 0 up, by
      the loads that they sense [weight of a dock], both of shape (N,).
    - `act(members)`: what robots that have joined do in each round: what they write to their
      memory, say, and whether they leave, truth values of shape (P,), or None for nobody;
      `help(tiswarm.world.members.Members)` lists what they have.
    - `spread(call, contacts)`: the call that each dock passes on, shape (n N,), by the calls that
      N robots of n docks make. Docks n i + a and n j + b touch if `contacts`, (C, 2), has such a
      row.

    These plain attributes, or settings, are numbers: `memory` that a robot keeps, those of a
    `message`, and the rounds in which robots act when the structure is complete, `rounds_after`.

    Args:
        name: Name of the rule: words of letters and digits, with "-".
        local: Whether climbers see what they touch, remember and hear alone, a `LocalStep`.

    Raises:
        InputError: the name is taken or invalid, the class lacks a method, or a field cannot be
            checked.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} names no rule; use words like my-rule")

    def add(settings: _Class) -> _Class:
        rule_class: Any = settings
        if hasattr(rule_class, "choose") == hasattr(rule_class, "score"):
            raise InputError(f"{name} should have choose or score, one of the two; define it")
        fault = _fault_of_sizes(rule_class)
        if fault:
            raise InputError(f"{name}: {fault}")
        functions = [value for value in vars(rule_class).values() if isfunction(value)]
        if "__dataclass_fields__" not in vars(rule_class):
            rule_class = plain_dataclass(frozen=True, kw_only=True)(rule_class)
        if any(size in rule_class.__dataclass_fields__ for size in _SIZES):
            check = getattr(rule_class, "__post_init__", None)
            rule_class.__post_init__ = _with_checked_sizes(check)
        guards: dict[str, Any] = {
            method: _guarded(name, method, getattr(rule_class, method))
            for method in _METHODS
            if hasattr(rule_class, method)
        }
        guards["is_local"] = local
        section: _Class = settings_class("rule", name, rule_class, rule_class, guards)
        register("rule", name, section, next(iter(functions), rule_class))
        return section

    return add


def _fault_of_sizes(rule: object) -> str:
    """Say which number of a rule, a class or settings, is wrong; empty if none is."""
    for name in _SIZES:
        size = getattr(rule, name, 0)
        if isinstance(size, bool) or not isinstance(size, int) or not 0 <= size <= _MOST:
            return f"{name} is {size!r}; write a whole number from 0 to {_MOST}"
    return ""


def _with_checked_sizes(check: Callable[[Any], None] | None) -> Callable[[Any], None]:
    """Return what checks settings of a rule: its numbers, after what its class checks itself."""

    def check_all(settings: Any) -> None:  # noqa: ANN401 - of any class
        if check is not None:
            check(settings)
        fault = _fault_of_sizes(settings)
        if fault:
            raise ValueError(fault)

    return check_all


def _hint_of_sizes(rule: object, error: BaseException) -> str:
    """Say how many numbers robots keep and say, where code reached beyond an array."""
    memory, message, _ = (int(getattr(rule, name, 0)) for name in _SIZES)
    if not isinstance(error, IndexError | ValueError) or not memory + message:
        return ""
    return f"; the rule has memory = {memory} and message = {message}"


def _guarded(name: str, method: str, inherited: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a method of a plug-in: what it raises or wrongly returns becomes a line."""
    unguarded = inherited
    fault_of = _FAULTS.get(method)
    if isfunction(inherited):  # a rule may derive from another one, whose methods are wrapped
        unguarded = _unguarded.get(inherited, inherited)

    @wraps(unguarded)
    def call(*arguments: Any) -> Any:  # noqa: ANN401 - as the method
        shown = [
            read_only(argument) if isinstance(argument, np.ndarray) else argument
            for argument in arguments
        ]
        if method == "act":
            members = arguments[1]
            return call_plugin(
                "rule",
                name,
                partial(unguarded, *shown),
                partial(_fault_of_leaving, members),
                method=method,
                repeats=unguarded,
                owner=arguments[0],
                hint=partial(_hint_of_sizes, arguments[0]),
            )
        if method == "score":
            return call_plugin(
                "rule",
                name,
                partial(unguarded, *shown),
                partial(_fault_of_score, arguments[0]),
                method=method,
                repeats=unguarded,
                owner=arguments[0],
            )

        def integers() -> NDArray[Any]:
            returned = np.asarray(unguarded(*shown))
            if method == "choose" and not returned.ndim:  # one choice of all
                return np.full(arguments[1].stance.shape, returned)
            return returned

        def fault(returned: NDArray[Any]) -> str:
            wrong_type = _fault_of_integers(returned)
            if wrong_type or fault_of is None:
                return wrong_type
            return fault_of(returned, *arguments[1:])

        choices = call_plugin(
            "rule",
            name,
            integers,
            fault,
            method=method,
            repeats=unguarded,
            owner=arguments[0],
            hint=partial(_hint_of_sizes, arguments[0]),
        )
        return choices.astype(np.int32)

    _unguarded[call] = unguarded
    return call


_unguarded: WeakKeyDictionary[Callable[..., Any], Callable[..., Any]] = WeakKeyDictionary()
"""Methods of users by the functions that `_guarded` made of them."""


def _described(value: object) -> str:
    """Name what a method returned in place of a function of the kernel language."""
    name = getattr(value, "__name__", "")
    return f"{name}, a function of Python" if name else f"a {type(value).__name__}"


def _fault_of_leaving(members: Members, returned: object) -> str:
    nobody = np.zeros(len(members.age), np.bool_)
    leaves: NDArray[Any] = np.asarray(nobody if returned is None else returned)
    if leaves.dtype.kind != "b" or leaves.shape != members.age.shape:
        have = f"{leaves.dtype} of shape {leaves.shape}"
        return f"{have}; return True for each of {len(members.age)} robots that leaves, or None"
    if np.isinf(members.say).any():
        return "a message with an infinite number; say finite ones, or NaN for nothing"
    return ""


def _fault_of_score(settings: object, returned: object) -> str:
    if not is_kernel_function(returned):
        return f"{_described(returned)}; return a function that ti.func decorates, and nothing else"
    for name in asked_settings(returned):
        if not isinstance(getattr(settings, name, None), int | float):
            return (
                f"a function that asks for {name}, which is no setting of the rule with a number; "
                f"its arguments are center, orientation, goal, and settings"
            )
    return ""


def _fault_of_integers(returned: NDArray[Any]) -> str:
    if returned.dtype.kind in "iu":
        return ""
    is_none = returned.dtype == np.object_ and returned.size > 0 and returned.flat[0] is None
    kind = "None" if is_none else returned.dtype
    return f"{kind}; return integers"


def _fault_of_calls(call: AnyInts, sensed: Reals, _params: object) -> str:
    if call.shape != sensed.shape:
        return f"shape {call.shape}; return a call for each of {len(sensed)} robots"
    return _fault_of_values(call)


def _fault_of_spread(spread: AnyInts, call: AnyInts, _contacts: AnyInts) -> str:
    if spread.ndim != 1 or len(spread) % len(call) or not len(spread):
        return f"shape {spread.shape}; return a call for each dock of {len(call)} robots"
    return _fault_of_values(spread)


def _fault_of_values(call: AnyInts) -> str:
    is_call = (call >= 0) & (call <= _MOST_CALLED)
    return "" if is_call.all() else f"a call of {call[~is_call][0]}; return 0 to {_MOST_CALLED}"


_FAULTS: dict[str, Callable[..., str]] = {
    "choose": fault_of_choice,
    "call": _fault_of_calls,
    "spread": _fault_of_spread,
}
"""By method, what says why its integers are wrong, of these and of its arguments."""


def structure(name: str) -> Callable[[type[_Kind]], type[_Kind]]:
    """Register a class as a kind of structure, which scenarios choose as `structure.kind`.

    It derives from one of this package's kinds, such as `TowerParams`, from `EdgeParams` or from
    `GrowthParams`. Its annotated fields are keys of scenarios. It may replace the property
    `terrain` and these methods, whose lengths are in R; `side` is 0 if robots come from one side.

    - `goal(side)`: what robots climb toward, shape (3,).
    - `behind(side, docks)`: how far docks of shape (n, 3) are behind the edge, shape (n,).
    - `start(side, rim, draw)`: where a robot starts, shape (2,). `rim` is how far the farthest dock
      is behind, `draw` two random numbers in [0, 1).
    - `spread(count, behind)`: places of anchors given by their number, shape (count, 2).

    Args:
        name: Name of the kind: words of letters and digits, with "-".

    Raises:
        InputError: the name is taken or invalid, the class lacks a method, or a field cannot be
            checked.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} names no kind of structure; use words like my-structure")

    def add(settings: type[_Kind]) -> type[_Kind]:
        if not (isinstance(settings, type) and issubclass(settings, GrowthParams)):
            problem = f"{name}: {settings!r} is no kind of structure; derive it from TowerParams"
            raise InputError(problem)
        _name_default_terrain(settings)
        lacking = [method for method in _SHAPES if not hasattr(settings, method)]
        if not hasattr(settings, "default_terrain"):
            lacking.insert(0, "terrain")
        if lacking:
            problem = f"{name} lacks {', '.join(lacking)}; define it, or derive from TowerParams"
            raise InputError(problem)
        functions = [value for value in vars(settings).values() if isfunction(value)]
        source = next(iter(functions), settings)  # a class of a session has no file
        if "__dataclass_fields__" not in vars(settings):
            settings = plain_dataclass(frozen=True, kw_only=True)(settings)
        guards: dict[str, object] = {method: _checked(name, settings, method) for method in _SHAPES}
        guards["default_terrain"] = property(partial(_ground, name, settings))
        kind: type[_Kind] = settings_class("structure", name, settings, settings, guards)
        register("structure", name, kind, source)
        return kind

    return add


def _name_default_terrain(settings: type[Any]) -> None:
    """Let the `terrain` of a plug-in's class be the default of the key of that name."""
    for base in settings.__mro__:
        terrain = vars(base).get("terrain")
        if terrain is not None:
            setattr(base, "default_terrain", terrain)  # noqa: B010 - of any class
            delattr(base, "terrain")
            return


def _checked(name: str, settings: type[Any], method: str) -> Callable[..., Any]:
    """Wrap a method of a plug-in: what it raises or wrongly returns becomes a line."""
    unchecked = getattr(settings, method)

    @wraps(unchecked)
    def call(self: GrowthParams, *arguments: Any) -> Any:  # noqa: ANN401 - as the method
        shape = _SHAPES[method](*arguments)

        def lengths() -> NDArray[Any]:
            return np.asarray(unchecked(self, *arguments))

        def fault(returned: NDArray[Any]) -> str:
            return _fault_of_lengths(returned, shape)

        numbers = call_plugin(
            "structure",
            name,
            lengths,
            fault,
            method=method,
            repeats=unchecked,
            owner=self,
        )
        return numbers.astype(np.float64)

    return call


def _fault_of_lengths(returned: NDArray[Any], shape: tuple[int, ...]) -> str:
    if returned.shape != shape:
        kind = "None" if returned.tolist() is None else f"shape {returned.shape}"
        return f"{kind}; return numbers of shape {shape}"
    fault = fault_of_numbers(returned, _FARTHEST, f"within {_FARTHEST:g} R")
    return f"numbers that are {fault}; correct them" if fault else ""


def _ground(name: str, settings: type[Any], of: GrowthParams) -> Terrain:
    """Return the terrain of a plug-in's structure."""

    def plain_value(_: GrowthParams) -> object:
        return settings.default_terrain

    unchecked = getattr(settings.default_terrain, "fget", plain_value)
    terrain: Terrain = call_plugin(
        "structure",
        name,
        partial(unchecked, of),
        _fault_of_terrain,
        method="terrain",
        repeats=unchecked,
        owner=of,
    )
    return terrain


def _fault_of_terrain(returned: object) -> str:
    if type(returned) is Terrain:
        return ""
    fault = f"{type(returned).__name__}; return a Terrain"
    if isinstance(returned, Terrain):  # kernels know the ground by the fields of Terrain alone
        fault += " itself: robots would not notice what a class derived from it changes"
    return fault
