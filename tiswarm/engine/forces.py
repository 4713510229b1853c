"""Forces and integrators of a user: functions of the kernel language, which the engine compiles.

A function asks for what it needs by the names of its arguments. A force may ask for FORCE, an
integrator for INTEGRATOR. All other arguments are numbers, which the caller gives for each call or
for each step. Kernels are compiled for functions, not for numbers.
"""

import inspect
import warnings
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property, partial
from numbers import Integral, Real
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tiswarm.base.aliases import (
    Array,
    Gain,
    Length,
    Parameters,
    PerRobot,
    PerStep,
    Reals,
    UserFunction,
)
from tiswarm.base.errors import InputError, did_you_mean, warn
from tiswarm.base.params import AnyArch, AnyPrecision
from tiswarm.base.robot import Robot
from tiswarm.compute import backend
from tiswarm.compute.lang import LIBRARIES, LIBRARY, Ref, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.compute.user_functions import (
    is_of_library,
    mistake_of_user,
    problem_of,
    reads,
    undecorated,
)
from tiswarm.engine import kernels
from tiswarm.engine.kernels import (
    FREE,
    GUIDED,
    NAN_OF_FORCE,
    NAN_OF_STEP,
    Dynamics,
    Numbers,
    is_vector,
)
from tiswarm.engine.relax import PreparedSwarm, RelaxResult, StepOptions

FORCE = ("offset", "distance", "connected", "spacing")
"""What a force may ask for; the guide to the engine explains it."""
INTEGRATOR = (
    "force", "position", "last_step", "mobility", "noise", "last_noise", "robot", "step", "spacing",
)  # fmt: skip
"""What an integrator may ask for."""
_WEIGHTED = ("ramp", "attraction", "repulsion", "parting")
"""Numbers that the ramp makes."""
_LARGEST_SEED = 2**31 - 1
_MOST_STEPS = 2**31 - 1


# Quoted types are named by `help`, which would spell them out.
def relax(
    position: Array,
    orientation_wxyz: Array,
    contacts: Array,
    *,
    robot: "Robot",
    steps: int,
    attraction_gain: Gain = None,
    repulsion_gain: Gain = None,
    ramp: PerStep = None,
    height: PerRobot = None,
    height_gain: float = 0.0,
    max_step: Length = None,
    force: UserFunction = None,
    integrator: UserFunction = None,
    parameters: Parameters = None,
    cutoff: Length = None,
    mobility: PerRobot = None,
    seed: int = 0,
    first_step: int = 0,
    last_step: PerRobot = None,
    structure: PerRobot = None,
    precision: "AnyPrecision" = "auto",
    arch: "AnyArch" = "cpu",
    threads: int | None = None,
) -> "Relaxed":
    """Take steps of the whole swarm under Eqs. (1)-(3), or a force of yours, all robots at once.

    The bytes of the result depend on the arguments alone, not on threads.

    >>> from tiswarm.base.robot import RobotGeometry
    >>> places, level = [[0, 0, 0], [6, 0, 0]], [[1, 0, 0, 0]] * 2
    >>> gains = {"attraction_gain": 0.1, "repulsion_gain": 0.1, "ramp": 1.0}
    >>> result = relax(places, level, [[0, 0, 1, 0]], robot=RobotGeometry(), steps=50, **gains)
    >>> result.position[:, 0].round(3).tolist()  # connected docks touch at a distance of D = 2
    [2.0, 4.0]
    >>> result.resume(steps=10).taken  # goes on from there
    60

    Args:
        position: Centers, shape (N, 3).
        orientation_wxyz: Body to world, unit quaternions, kept throughout, shape (N, 4).
        contacts: Connected docks, rows of (robot i, dock, robot j, dock), shape (C, 4).
        robot: Where docks are on a robot, and D; its unit of length is that of all lengths here.
        steps: T.
        attraction_gain: A of Eq. (1) [1].
        repulsion_gain: B of Eqs. (1) and (2) [length^-3].
        ramp: alpha, the share of attraction, 0 to 1: one number, or one a step.
        height: Height that each robot is pulled toward, NaN for none, shape (N,).
        height_gain: k_z of Eq. (3) [1].
        max_step: Longest step of a robot; None for no limit.
        force: Function in place of Eqs. (1) and (2), which needs neither gains nor ramp. Its
            arguments are names of `offset`, `distance`, `connected` and `spacing`, and of numbers.
            It returns a vector, or its length toward the other dock.
        integrator: Function that returns the step of a robot, a vector; the force itself if None.
            Its arguments are names of `force`, `position`, `last_step`, `mobility`, `noise`,
            `last_noise`, `robot`, `step` and `spacing`, and of numbers.
        parameters: Numbers that the two functions ask for, each one number, or one a step. They may
            also ask for `ramp`, and with gains for `attraction` A alpha and `repulsion`
            B (1 - alpha).
        cutoff: Distance at which your force between unconnected docks ends; D if None.
        mobility: Step along each axis for a force of 1 [1], shape (N, 3); 0 fixes a coordinate.
        seed: Seed of the noise that an integrator asks for. A second call with the same seed
            repeats the noise: `resume` of the result goes on.
        first_step: Number of the first step, `taken` of an earlier result to continue its noise.
        last_step: Last step of each robot before, that of the earlier result, shape (N, 3); zero if
            None.
        structure: Number of each robot's structure, shape (N,); robots of different structures
            never interact. None for one structure.
        precision: f32 takes three quarters of the memory, rounds the more the larger the swarm,
            and is slower on processors; `auto` as for `tiswarm.compute.backend.choose`.
        arch: Device; it computes there or an error is raised. `auto` takes a card if one works.
        threads: CPU threads; all that this process may use if None.

    Raises:
        InputError: an argument makes no sense, a function does not compile, or forces diverge.
        EnvironmentTroubleError: the machine lacks the device or the memory.
    """
    arguments = dict(locals())
    to_move = _STEPPED & arguments.keys()
    swarm = MovingSwarm(**{name: arguments[name] for name in arguments.keys() - to_move})
    result = swarm.relax(**{name: arguments[name] for name in to_move})
    makes_noise = not {"noise", "last_noise"}.isdisjoint(_arguments(integrator))
    repeats = makes_noise and _repeats(position, seed, first_step)
    return Relaxed(
        **_fields(result), arguments=arguments, swarm=swarm,
        noise=(-1 if repeats else seed) if makes_noise else None,
    )  # fmt: skip


def _fields(result: RelaxResult) -> dict[str, Any]:
    """Return the fields of a result by name, without what was read of it."""
    return {of_result.name: getattr(result, of_result.name) for of_result in fields(RelaxResult)}


_STEPPED = StepOptions.names() | {"steps", "first_step", "last_step"}
"""Arguments of `relax` that are those of steps; all others are those of a swarm."""
_ends: dict[int, int] = {}
"""Seeds of noise by the identity of positions where steps ended, while those are kept; -1 where a
warning has been given."""


def _repeats(position: ArrayLike, seed: int, first_step: int) -> bool:
    """Whether steps repeat the noise of those before; warn once in a chain of calls."""
    seed_before = _ends.get(id(position))
    if first_step != 0 or seed_before not in (seed, -1):
        return False
    if seed_before == seed:
        warn(
            "these steps begin where others of the same seed ended, and repeat their noise; go on "
            "by `resume` of the result, or give first_step"
        )
    return True


@dataclass(frozen=True, kw_only=True)
class Relaxed(RelaxResult):
    """What `tiswarm.relax` returns: robots that stay on the device and can go on.

    DLPack hands their positions to other libraries: `numpy.from_dlpack(result)`.
    """

    arguments: Mapping[str, Any] = field(repr=False)
    """Arguments of the call by name."""

    swarm: "MovingSwarm | None" = field(default=None, repr=False)
    """The robots on the device, to take further steps there; None in a copy of a result."""

    noise: int | None = field(default=None, repr=False)
    """Seed of noise that a call from these positions would repeat, -1 after a warning; or None."""

    @cached_property
    def position(self) -> Reals:
        """Centers, in the caller's order, shape (N, 3)."""
        position = self.state.position.copy()
        if self.noise is not None:
            _ends[id(position)] = self.noise
            weakref.finalize(position, _ends.pop, id(position), None)
        return position

    def resume(self, *, steps: int | None = None, **changes: Any) -> "Relaxed":  # noqa: ANN401
        """Take further steps from where the robots are: noise, steps and their numbers go on.

        Robots that are still on the device stay there, unless other robots are asked for.

        Args:
            steps: Number of steps; as many as before if None.
            changes: Arguments of `tiswarm.relax` that differ from those before.

        Raises:
            InputError: as of `tiswarm.relax`.
        """
        steps = self.arguments["steps"] if steps is None else steps
        arguments = {**self.arguments, **changes, "steps": steps}
        swarm = self.swarm
        if swarm is None or not swarm.is_there or not changes.keys() <= StepOptions.names():
            goes_on = {
                "position": self.position, "first_step": self.taken, "last_step": self.last_step,
            }  # fmt: skip
            return relax(**{**arguments, **goes_on, **changes})
        of_steps = StepOptions.names() & arguments.keys()
        options = {name: arguments[name] for name in of_steps}
        result = swarm.relax(steps=steps, state=self.state, **options)
        noise = None if self.noise is None else arguments["seed"]
        return Relaxed(**_fields(result), arguments=arguments, swarm=swarm, noise=noise)

    def __dlpack__(self, **options: Any) -> object:  # noqa: ANN401 - those of the protocol
        """Return positions as a DLPack capsule; they stay where they are as long as it is used."""
        return self.state.export().__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        """Return the type and number of the device, as DLPack counts them."""
        return self.state.export().__dlpack_device__()

    def __getstate__(self) -> dict[str, Any]:
        """Copy the robots to another process or object without their device."""
        return {**vars(self), "swarm": None}


class MovingSwarm(PreparedSwarm):
    """A swarm on the device that moves by functions of a user, again and again.

    Arguments are those of `tiswarm.relax`: those of a swarm to make it, and the others to `relax`
    it, where `resume=True` goes on from where the robots are.
    """

    @backend.exclusive()
    def __init__(
        self,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        force: Callable[..., Any] | None = None,
        integrator: Callable[..., Any] | None = None,
        cutoff: float | None = None,
        mobility: ArrayLike | None = None,
        **options: Any,  # noqa: ANN401 - those of `PreparedSwarm`
    ) -> None:
        """Check the functions and the robots, and copy these to the device."""
        if cutoff is not None and force is None:
            problem = f"{cutoff} is no reach of a force of yours; give force, too"
            raise InputError(problem, argument="cutoff")
        if cutoff is not None and not (isinstance(cutoff, Real) and 0.0 < cutoff < np.inf):
            raise InputError(f"{cutoff!r} is no distance; give one above 0", argument="cutoff")
        robot = options.get("robot")
        if not (hasattr(robot, "spacing") and hasattr(robot, "dock_offset_body")):
            problem = f"{robot!r} has no spacing and dock_offset_body; give a RobotGeometry"
            raise InputError(problem, argument="robot")
        self._choose = partial(_chosen, force, integrator, is_guided=mobility is not None)
        self.law = self._choose()
        super().__init__(
            position, orientation_wxyz, contacts, dynamics=self.law.dynamics, cutoff=cutoff,
            mobility=mobility, **options,
        )  # fmt: skip

    @contextmanager
    def _taking(
        self, steps: int, options: StepOptions, start: Mapping[str, Any]
    ) -> Iterator[Reals]:
        """Check the functions and numbers of steps, and name the function that fails."""
        numbers = self._checked(steps, options)
        self._refuse_wrong_start(steps, start)
        with self._functions_named(), super()._taking(steps, numbers, start) as table:
            yield table

    def _checked(self, steps: int, options: StepOptions) -> StepOptions:
        """Check what steps need, and add the numbers of the functions that have defaults."""
        if not isinstance(steps, Integral) or steps < 0:
            problem = f"{steps!r} is no number of steps; give a whole number, 0 or more"
            raise InputError(problem, argument="steps")
        seed = options.seed
        if not (isinstance(seed, Integral) and 0 <= seed <= _LARGEST_SEED):
            raise InputError(
                f"{seed!r} is not 0 to {_LARGEST_SEED}, whole; correct it", argument="seed"
            )
        self._follow_functions()
        numbers = self.law.numbers(dict(options.parameters or {}), steps)
        gains = {name: getattr(options, f"{name}_gain") for name in FREE.names}
        for name, gain in gains.items():
            if gain is not None and self.dynamics.has_force and not self.law.askers.get(name):
                problem = f"your force does not ask for {name}; leave the gain out"
                raise InputError(problem, argument=f"{name}_gain")
        for name, asker in self.law.askers.items():
            lacks = options.ramp is None or gains.get(name, 0.0) is None
            if name in _WEIGHTED and name not in numbers and lacks:
                remedy = f"{name}_gain and ramp" if name in gains else "ramp"
                if asker is None:
                    remedy += ", or a force of yours"
                raise _error(f"needs {name}; give {remedy}", asker)
        return replace(options, parameters=numbers)

    @contextmanager
    def _functions_named(self) -> Iterator[None]:
        """Name the function that fails, or that returned NaN."""
        self.moves = np.zeros(0)
        try:
            with _mistakes_named(self.law):
                yield
        finally:  # a robot that NaN would move stays, so that steps may end well
            self._refuse_nan()

    def _refuse_wrong_start(self, steps: int, start: Mapping[str, Any]) -> None:
        """Refuse steps that would not go on from those that their number says were taken."""
        first = start.get("first_step", 0)
        last = start.get("last_step")
        if start.get("state") is not None and (first or last is not None):
            problem = "steps of a swarm that resumes are numbered on; leave it out"
            raise InputError(problem, argument="first_step" if first else "last_step")
        if not isinstance(first, Integral) or not 0 <= int(first) <= _MOST_STEPS:
            problem = f"{first!r} is no number of a step; give a whole number, 0 or more"
            raise InputError(problem, argument="first_step")
        asks = self.dynamics.has_integrator and "last_step" in self.dynamics.asks
        if first and asks and last is None:
            problem = "the integrator asks for the step before; give last_step of the result, too"
            raise InputError(problem, argument="first_step")
        taken = self.start(**start).taken
        if taken + steps > _MOST_STEPS:
            problem = f"steps are numbered up to {_MOST_STEPS}; take fewer, or begin at 0"
            raise InputError(problem, argument="steps")

    def _follow_functions(self) -> None:
        """Compile the functions anew if what they read has changed since the last call."""
        self.law = self._choose()
        self.dynamics = self.law.dynamics
        if self.stepper is not None:
            self.stepper.dynamics = self.dynamics

    def _refuse_nan(self) -> None:
        """Name the function that returned NaN, unless the forces diverged before."""
        lost = np.argwhere(np.isclose(self.moves[:, None], np.sqrt([NAN_OF_FORCE, NAN_OF_STEP])))
        for step, which in lost[:1]:
            start = self.begin
            if start.places.is_resolved(self.moves[:step]):
                self.state = self.before
                # A force is the first function, an integrator the last.
                function = self.law.functions[-which]
                kind = ("force", "integrator")[which]
                code = function.__code__
                problem = (
                    f"{kind} `{function.__name__}` returned NaN at step {start.taken + step}; "
                    "guard it against 0 / 0 and roots of negative numbers"
                )
                path = Path(code.co_filename)
                raise InputError(problem, path=path, line=code.co_firstlineno) from None


class _Law(NamedTuple):
    """A force and an integrator of a user, or of the engine."""

    dynamics: Dynamics
    functions: tuple[FunctionType, ...]
    """Those of the user."""

    askers: dict[str, FunctionType | None]
    """By number, the function that asks for it; None for one of the engine."""

    defaults: dict[str, float]
    """Numbers that the caller may leave out."""

    def numbers(self, parameters: dict[str, ArrayLike], steps: int) -> dict[str, ArrayLike]:
        """Check parameters, and add defaults.

        Raises:
            InputError: a function lacks a number, or none asks for it, or it is none.
        """
        for name, value in parameters.items():
            if name not in self.askers:
                meant = did_you_mean(name, self.askers) or "; leave it out"
                problem = f"neither force nor integrator has an argument {name}{meant}"
                raise InputError(problem, argument="parameters")
            try:
                is_finite = np.isfinite(np.broadcast_to(np.asarray(value, float), steps)).all()
            except (TypeError, ValueError):
                problem = (
                    f"{name} is no number and no {steps} numbers, one a step; give one of these"
                )
                raise InputError(problem, argument="parameters") from None
            if not is_finite:
                raise InputError(f"{name} is not finite; correct it", argument="parameters")
        numbers = {**self.defaults, **parameters}
        for name, asker in self.askers.items():
            if asker is not None and name not in numbers and name not in _WEIGHTED:
                raise _error(f"needs {name}; give it in `parameters`", asker)
        return numbers


def _chosen(
    force: Callable[..., Any] | None, integrator: Callable[..., Any] | None, *, is_guided: bool
) -> _Law:
    """Choose functions of the engine in place of those that are not given."""
    ours = GUIDED if is_guided else FREE
    if force is None and integrator is None:
        return _Law(ours, (), dict.fromkeys(ours.names), {})
    pull = None if force is None else _checked(force, "force", FORCE)
    move = None if integrator is None else _checked(integrator, "integrator", INTEGRATOR)
    read_values = tuple(reads(function) for function in (pull, move) if function)
    return _compiled(pull, move, ours, read_values)


@cache  # kernels are compiled anew for each new function, and for each change of what it reads
def _compiled(
    force: FunctionType | None,
    integrator: FunctionType | None,
    ours: Dynamics,
    _reads: tuple[object, ...],
) -> _Law:
    """Make functions callable by kernels."""
    # Those of the engine read the first columns.
    is_ours = force is None or (integrator is None and bool(ours.asks))
    askers: dict[str, FunctionType | None] = dict.fromkeys(ours.names if is_ours else ())
    defaults: dict[str, float] = {}
    asks = set() if integrator is not None else set(ours.asks)
    for function, engine_names in ((force, FORCE), (integrator, INTEGRATOR)):
        for name, argument in _arguments(function).items():
            if name in engine_names:
                asks.update(_ARRAYS.get(name, ()))
                continue
            askers[name] = askers.get(name) or function
            if argument.default is not argument.empty:
                defaults.setdefault(name, argument.default)
    if force is not None:  # the columns of the engine's force are there, but unused
        unused = [name for name in FREE.names if name in askers and askers[name] is None]
        defaults |= dict.fromkeys([*unused, "parting"] if unused else [], 0.0)
    names = tuple(askers)
    dynamics = Dynamics(
        ours.pull if force is None else _caller("force", force, names),
        ours.integrate if integrator is None else _caller("integrator", integrator, names),
        names,
        is_cut=force is not None,
        asks=tuple(sorted(asks)),
        has_force=force is not None,
        has_integrator=integrator is not None,
    )
    return _Law(dynamics, tuple(f for f in (force, integrator) if f), askers, defaults)


_ARRAYS = {
    "last_step": ("last_step",), "mobility": ("mobility",), "noise": ("number",),
    "last_noise": ("number",), "robot": ("number",), "step": ("number",),
}  # fmt: skip
"""Fields of `SwarmState` that a name needs."""


def _arguments(function: Callable[..., Any] | None) -> Mapping[str, inspect.Parameter]:
    return {} if function is None else inspect.signature(function).parameters


def _caller(kind: str, function: FunctionType, names: tuple[str, ...]) -> object:
    """Return a function as `Dynamics` have it, which calls that of a user."""
    # Kernels would refuse annotations that are no types of theirs.
    bare = FunctionType(
        function.__code__, function.__globals__, function.__name__, None, function.__closure__
    )
    called = ti.func(bare)
    argument_names = tuple(_arguments(function))
    count = Numbers.TOTAL + len(names)

    def evaluate(of_engine: Mapping[str, Callable[[], object]], *number: object) -> tuple[object]:
        columns = dict(zip(names, number[Numbers.TOTAL :], strict=True))
        computed: dict[str, Callable[[], object]] = {
            **of_engine,
            "spacing": lambda: number[Numbers.SPACING],
        }
        value = called(*[computed[n]() if n in computed else columns[n] for n in argument_names])
        is_scalar = isinstance(value, (Real, ti.lang.expr.Expr)) and not is_vector(value)
        is_three = is_vector(value) and tuple(value.get_shape()) == (3,)
        if not (is_three or (is_scalar and kind == "force")):
            alternative = ", or a number" if kind == "force" else ""
            problem = f"{function.__name__} has to return a vector of three numbers{alternative}"
            raise ValueError(problem)
        return (value,)

    def pull(offset, distance, connected, number):  # noqa: ANN001, ANN202 - of kernels
        return ti.static(
            evaluate(_of_pair(offset, distance, connected), *[number[c] for c in range(count)])
        )[0]

    def integrate(force, center, robot, t, unit, robots: Ref, number):  # noqa: ANN001, ANN202
        return ti.static(
            evaluate(
                _of_motion(
                    force, center, robot, t, unit, robots, [number[c] for c in range(count)]
                ),
                *[number[c] for c in range(count)],
            )
        )[0]

    return ti.func(pull if kind == "force" else integrate)


def _of_pair(
    offset: object, distance: object, connected: object
) -> dict[str, Callable[[], object]]:
    """Return by name what a force may ask for."""
    return {
        "offset": lambda: offset,
        "distance": lambda: distance,
        "connected": lambda: connected,
    }


def _of_motion(
    force: object,
    center: object,
    robot: Any,  # noqa: ANN401 - an expression of a kernel, as the two below
    t: Any,  # noqa: ANN401
    unit: object,
    robots: Any,  # noqa: ANN401
    number: list[object],
) -> dict[str, Callable[[], object]]:
    """Return by name what computes what an integrator may ask for."""
    origin = number[Numbers.ORIGIN : Numbers.ORIGIN + 3]
    return {
        "force": lambda: force,
        "position": lambda: kernels.place_of(center, unit, *origin, robots),
        "last_step": lambda: vector_at(robots.last_step, robot),
        "mobility": lambda: vector_at(robots.mobility, robot),
        "noise": lambda: kernels.noise_of(robots, robot, t),
        "last_noise": lambda: kernels.noise_of(robots, robot, t - 1),
        "robot": lambda: kernels.number_of(robots, 2 + robot),
        "step": lambda: kernels.number_of(robots, 1) + t,
    }


def _checked(
    function: Callable[..., Any], kind: str, engine_names: tuple[str, ...]
) -> FunctionType:
    """Return the function that a decorator may hide."""
    bare = undecorated(function)
    if not isinstance(bare, FunctionType) or bare.__name__ == "<lambda>":
        raise InputError(f"{function!r} is no function; define one by def", argument=kind)
    others = [name for name in LIBRARIES if hasattr(function, f"_is_{name}_function")]
    if others not in ([], [LIBRARY]):
        problem = f"is a function of {others[0]}, but {LIBRARY} computes; use tiswarm.ti"
        raise _error(problem, bare)
    for name, argument in _arguments(bare).items():
        if argument.kind is not argument.POSITIONAL_OR_KEYWORD:
            raise _error(f"takes {argument}; name each argument", bare)
        if name in {*FORCE, *INTEGRATOR} - {*engine_names}:
            asker = "an integrator" if kind == "force" else "a force"
            raise _error(f"cannot ask for {name}; only {asker} can", bare)
    try:
        inspect.getsource(bare)
    except (OSError, TypeError):
        raise _error("has no source to compile; define it in a file or a cell", bare) from None
    return bare


def _error(problem: str, function: FunctionType | None, line: int | None = None) -> InputError:
    """Return an error of a function, with its place if it is the user's."""
    if function is None:
        return InputError(f"the force of the paper {problem}")
    code = function.__code__
    problem = f"{function.__name__} {problem}"
    return InputError(problem, path=Path(code.co_filename), line=line or code.co_firstlineno)


@contextmanager
def _mistakes_named(law: _Law) -> Iterator[None]:
    """Say in a line what is wrong in a user's function, and where, if it does not compile."""
    try:
        with warnings.catch_warnings():
            if law.functions:  # the library warns of each function that `ti.func` does not decorate
                warnings.simplefilter("ignore", SyntaxWarning)
            yield
    except Exception as error:
        if not (is_of_library(error) and law.functions):
            raise
        mistake = mistake_of_user(error)
        if mistake is not None:
            raise mistake from error
        problem = problem_of(error)
        names = " or ".join(f.__name__ for f in law.functions)
        problem = f"does not compile: {problem}; correct {names}"
        wrong = [f for f in law.functions if f"{f.__name__} has to return" in problem]
        raise _error(problem, (wrong or law.functions)[0]) from error
