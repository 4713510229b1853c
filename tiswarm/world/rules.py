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
from functools import cached_property, partial, wraps
from inspect import isfunction
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.plugins import call_plugin, fault_of_numbers
from tiswarm.base.registry import register
from tiswarm.base.sections import settings_class
from tiswarm.compute.math import uniform
from tiswarm.compute.user_functions import is_kernel_function
from tiswarm.records.terrain import Terrain
from tiswarm.world.climb_kernels import (
    ENDED,
    MAX_TOUCHING,
    RECRUITED,
    WALKING,
    StructureArrays,
)
from tiswarm.world.params import GrowthParams
from tiswarm.world.rule_kernels import FlipArrays, list_flips, sense_ends, settle_walks
from tiswarm.world.walks import Walks

_Slots = NDArray[np.int32]

_DRAW_BITS = 16
"""A climber draws up to two to this number of a stream at a stance."""

STAY = -1
"""A climber's choice to stay where it is."""

_MOST_CALLED = 2**30
"""Largest call of a plug-in."""

_METHODS = ("choose", "score", "call", "spread")

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


class ClimbStep:
    """What climbers that choose see: M of them in S structures, each with K flips.

    A choice is the number of a possible flip, -1 to stay at the current stance, or `back(s)` to
    go back to an earlier stance and stay there. Who stays where it touches no robot is taken away
    and starts again. Arrays of the structures cannot be written: copy them first.
    """

    def __init__(
        self,
        walks: Walks,
        structures: StructureArrays,
        flips: FlipArrays,
        called: _Slots,
        slots: _Slots,
        sensed: Reals,
        present: AnyInts,
    ) -> None:
        """Take the arrays of all slots, and the slots of those who choose, shape (M,)."""
        self._walks = walks
        self._structures = structures
        self._flips = flips
        self._slots = slots
        self.structure: AnyInts = walks.climbers.structure[slots]
        """Structure that each climbs, shape (M,)."""
        self.robot: AnyInts = walks.robot[slots]
        """Robots that started in that structure before it, shape (M,)."""
        self.stance: AnyInts = walks.stances.last[slots]
        """Flips that it has taken: number of its current stance, shape (M,)."""
        self.center: Reals = walks.stances.center[slots, self.stance]
        """Its center [R], shape (M, 3)."""
        self.orientation_wxyz: Reals = walks.stances.orientation[slots, self.stance]
        """Its orientation, body to world, shape (M, 4)."""
        self.touching: AnyInts = walks.stances.touching[slots, self.stance]
        """Docks n i + k that its docks touch, or -1, shape (M, n, MAX_TOUCHING)."""
        self.on_ground: AnyInts = walks.stances.on_ground[slots, self.stance]
        """Whether its docks stand on flat ground, 1, or an edge, 2, else 0, shape (M, n)."""
        self.goal: Reals = walks.climbers.goal[slots]
        """Its goal [R], shape (M, 3)."""
        self.patience: AnyInts = walks.climbers.patience[slots]
        """`structure.climb.patience` of each, shape (M,)."""
        self.called: Bools = called[slots] != 0
        """Whether it touches a dock that passes a call on, shape (M,)."""
        self.angle: Reals = flips.angle[slots]
        """Angle of each flip [rad], negative if backward, 0 if there is none, shape (M, K)."""
        self.possible: Bools = self.angle != 0.0
        """Which flips there are: about an attached dock, and something stops them, (M, K)."""
        self.dock = _read_only(structures.dock)
        """Dock centers of all structures [R], shape (S, n N, 3)."""
        self.relay = _read_only(structures.relay)
        """Call that each dock passes on, shape (S, n N)."""
        self.robot_count = _read_only(structures.robot_count)
        """Robots that have joined; rows of others are meaningless, shape (S,)."""
        self.sensed = _read_only(sensed)
        """Load that each robot sensed at the last solve [weight of a dock], shape (S, N)."""
        self.present: Bools = present != 0
        """Whether each robot has not left again, shape (S, N)."""

    @cached_property
    def walk(self) -> Reals:
        """Centers of its stances up to the current one, then NaN [R], (M, most stances, 3)."""
        centers: Reals = self._walks.stances.center[self._slots, : self.stance.max() + 1]
        centers[np.arange(centers.shape[1]) > self.stance[:, None]] = np.nan
        return centers

    @cached_property
    def pivot(self) -> AnyInts:
        """Dock about which each flip turns, shape (K,)."""
        return np.repeat(np.arange(self._walks.docks), self.angle.shape[1] // self._walks.docks)

    @cached_property
    def end(self) -> Reals:
        """Centers where flips end [R], meaningless where there is none, shape (M, K, 3)."""
        end: Reals = self._flips.center[self._slots]
        return end

    @cached_property
    def end_orientation_wxyz(self) -> Reals:
        """Orientations where flips end, shape (M, K, 4)."""
        orientation: Reals = self._flips.orientation[self._slots]
        return orientation

    @cached_property
    def visited(self) -> Bools:
        """Whether its walk has been where a flip ends, shape (M, K)."""
        visited: Bools = self._flips.visited[self._slots] != 0
        return visited

    @cached_property
    def _ends(self) -> tuple[AnyInts, AnyInts, AnyInts]:
        walks = self._walks
        flips = self._flips
        shape = (*flips.angle.shape, walks.docks)
        touching = np.full((*shape, MAX_TOUCHING), -1, np.int32)
        ground = np.zeros(shape, np.int32)
        called = np.zeros(flips.angle.shape, np.int32)
        structures = self._structures
        sense_ends(
            walks.limits, self._slots, walks.climbers.structure, walks.climbers.dock_offset_body,
            *structures.cells, structures.dock, structures.relay, *flips[:3], touching, ground,
            called, walks.climbers.ground, walks.laws,
        )  # fmt: skip
        return touching[self._slots], ground[self._slots], called[self._slots]

    @property
    def end_touching(self) -> AnyInts:
        """Docks that docks touch where a flip ends, as `touching`, (M, K, n, MAX_TOUCHING)."""
        return self._ends[0]

    @property
    def end_on_ground(self) -> AnyInts:
        """Ground on which docks stand where a flip ends, as `on_ground`, shape (M, K, n)."""
        return self._ends[1]

    @property
    def end_called(self) -> Bools:
        """Whether a dock with a call is touched where a flip ends, shape (M, K)."""
        called: Bools = self._ends[2] != 0
        return called

    def uniform(self, stream: str, count: int) -> Reals:
        """Draw numbers in [0, 1), shape (M, count), by seed, stream, robot and stance alone."""
        draw = (self.stance.astype(np.int64) << _DRAW_BITS)[:, None] + np.arange(count)
        return uniform(self._walks.seed[self._slots, None], stream, self.robot[:, None], draw)

    def back(self, stance: AnyInts | int) -> AnyInts:
        """Return the choice to go back to a stance, 0 up to the current one, and stay there.

        Args:
            stance: That of each climber, shape (M,), or of all.
        """
        return -2 - np.asarray(stance)


def climb_by_choice(
    walks: Walks, structures: StructureArrays, movers: _Slots, sensed: Reals, present: AnyInts
) -> None:
    """Let robots walk on from their first stance as a rule chooses.

    Args:
        walks: Walks of the robots.
        structures: What they climb.
        movers: Slots of the robots that move, shape (M,).
        sensed: Load that each robot sensed at the last solve, shape (S, N).
        present: Whether each robot has not left, shape (S, N).
    """
    stances = walks.stances
    patience = walks.climbers.patience
    climbed = (*structures.cells, structures.dock, structures.relay)
    slot_count = len(patience)
    flip_count = 2 * walks.limits.twists * walks.docks
    flips = FlipArrays(
        angle=np.zeros((slot_count, flip_count)),
        center=np.zeros((slot_count, flip_count, 3)),
        orientation=np.zeros((slot_count, flip_count, 4)),
        visited=np.zeros((slot_count, flip_count), np.int32),
    )
    called = np.zeros(slot_count, np.int32)
    stances.last[movers] = walks.climbers.first_stance[movers]
    walks.state[movers] = WALKING
    walking: AnyInts = movers
    while len(walking):
        list_flips(
            walks.limits, walking, called, walks.state, *climbed, *walks.climbers, *stances, *flips,
            walks.laws,
        )  # fmt: skip
        choice = np.full(len(walking), STAY, np.int32)
        asks = patience[walking] > 0  # others are put where they stay
        if asks.any():
            slots = walking[asks]
            step = ClimbStep(walks, structures, flips, called, slots, sensed, present)
            choice[asks] = walks.rule.choose(step)
        last = stances.last[walking]
        goes = choice >= 0
        stay = np.where(choice < STAY, -2 - choice, last)[~goes]
        stayed = walking[~goes]
        stances.best[stayed] = stay
        stances.stay[stayed] = stay
        recruited = (called[stayed] != 0) & (stay == last[~goes])
        walks.state[stayed] |= np.where(recruited, RECRUITED, ENDED)
        walking = walking[goes]
        last = last[goes]
        flip = choice[goes]
        stances.pivot_dock[walking, last] = flip // (flip_count // walks.docks)
        stances.center[walking, last + 1] = flips.center[walking, flip]
        stances.orientation[walking, last + 1] = flips.orientation[walking, flip]
        stances.last[walking] = last + 1
    if walks.climbers.settles[movers].any():
        settle_walks(walks.limits, movers, *climbed, *walks.climbers, *stances, walks.laws)


def rule(name: str) -> Callable[[_Class], _Class]:
    """Register a class as a rule of growth, which scenarios choose as `structure.rule`.

    Its annotated fields are settings. It has one of these methods:

    - `choose(step)`: the choice of each of M climbers, integers of shape (M,) or one: a flip of
      `step`, -1 to stay, or `step.back(s)` to go back to stance s and stay there.
      `help(type(step))` lists what a step has.
    - `score()`: a function of the kernel language of (center, orientation, goal), to be least in
      place of the distance to the goal; robots do all else as in ReactiveBuild.

    And it may have these, in place of what ReactiveBuild does:

    - `call(sensed, params)`: the call that each robot of a structure makes, integers from 0 up, by
      the loads that they sense [weight of a dock], both of shape (N,).
    - `spread(call, contacts)`: the call that each dock passes on, shape (n N,), by the calls that
      N robots of n docks make. Docks n i + a and n j + b touch if `contacts`, (C, 2), has such a
      row.

    Args:
        name: Name of the rule: words of letters and digits, with "-".

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
        functions = [value for value in vars(rule_class).values() if isfunction(value)]
        if "__dataclass_fields__" not in vars(rule_class):
            rule_class = plain_dataclass(frozen=True, kw_only=True)(rule_class)
        guards: dict[str, Any] = {
            method: _guarded(name, method, getattr(rule_class, method))
            for method in _METHODS
            if hasattr(rule_class, method)
        }
        section: _Class = settings_class("rule", name, rule_class, rule_class, guards)
        register("rule", name, section, next(iter(functions), rule_class))
        return section

    return add


def _guarded(name: str, method: str, inherited: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a method of a plug-in: what it raises or wrongly returns becomes a line."""
    unguarded = inherited
    fault_of = _FAULTS.get(method)
    if isfunction(inherited):  # a rule may derive from another one, whose methods are wrapped
        unguarded = _unguarded.get(inherited, inherited)

    @wraps(unguarded)
    def call(*arguments: Any) -> Any:  # noqa: ANN401 - as the method
        shown = [
            _read_only(argument) if isinstance(argument, np.ndarray) else argument
            for argument in arguments
        ]
        if method == "score":
            return call_plugin(
                "rule",
                name,
                partial(unguarded, *shown),
                _fault_of_score,
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


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view that code of users cannot write: the array is that of the engine."""
    view = array.view()
    view.flags.writeable = False
    return view


def _fault_of_score(returned: object) -> str:
    if is_kernel_function(returned):
        return ""
    return f"{_described(returned)}; return a function that ti.func decorates, and nothing else"


def _fault_of_integers(returned: NDArray[Any]) -> str:
    if returned.dtype.kind in "iu":
        return ""
    is_none = returned.dtype == np.object_ and returned.size > 0 and returned.flat[0] is None
    kind = "None" if is_none else returned.dtype
    return f"{kind}; return integers"


def _fault_of_choice(choice: AnyInts, step: Any) -> str:  # noqa: ANN401 - of a part
    """Say why climbers cannot do what a rule chose; empty if they can."""
    if choice.shape != step.stance.shape:
        return f"shape {choice.shape}; return a choice for each of {len(step.stance)} climbers"
    flips = np.flatnonzero(choice >= 0)
    last = step.possible.shape[1] - 1
    cannot = flips[~step.possible[flips, np.minimum(choice[flips], last)]]
    cannot = np.append(cannot, np.flatnonzero((choice > last) | (choice < step.back(step.stance))))
    if not len(cannot):
        return ""
    m = int(cannot.min())
    return (
        f"{choice[m]} for climber {m}; return a possible flip, {STAY} to stay, or step.back(s) "
        f"for an earlier stance s of its {step.stance[m] + 1}"
    )


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
    "choose": _fault_of_choice,
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
