"""The swarm step: every robot at once, moved by the forces on its docks.

    F_i = sum over connected docks of Eq. (1)
        + sum over other docks of other robots nearer than D of Eq. (2)
        + k_z (h_i - z_i) along z, Eq. (3)
    p_i <- p_i + F_i, no farther than the longest step

Equations as in `tiswarm.engine.kernels`. Other `Dynamics` replace all but Eq. (3) and the cap.
Lengths in the unit of the robot's spacing D.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.params import AnyArch, AnyPrecision, Precision
from tiswarm.base.robot import Robot
from tiswarm.compute import backend
from tiswarm.compute.backend import Backend
from tiswarm.engine.kernels import FREE, GUIDED, Dynamics, Numbers
from tiswarm.engine.stepping import Places, RelaxState, Stepper, Swarm

SMALL = 2_000
"""Most robots of a structure that one thread relaxes by itself, without a pause."""
_DIVERGED = "the forces diverged; lower the gains or give max_step"
_NO_LIMIT = 1e30
_LARGEST_GAIN = 1e12


@dataclass(frozen=True, kw_only=True)
class StepOptions:
    """What a call of several steps may be given: all arguments but their number and their start."""

    attraction_gain: float | None = None
    """A of Eq. (1) [1]."""

    repulsion_gain: float | None = None
    """B of Eqs. (1) and (2) [length^-3]."""

    ramp: ArrayLike | None = None
    """alpha, the share of attraction, 0 to 1: one number, or one a step."""

    height_gain: float = 0.0
    """k_z of Eq. (3) [1]."""

    max_step: float | None = None
    """Longest step of a robot; None for no limit."""

    parting_gain: float = 0.0
    """Stiffness of the spring that parts connected docks of a guided swarm, times the ramp [1]."""

    momentum: float = 0.0
    """Share of its last step that a robot of a guided swarm takes again [1]."""

    parameters: Mapping[str, ArrayLike] | None = None
    """Further numbers that dynamics ask for, each one, or one a step."""

    seed: int = 0
    """Seed of the noise that an integrator asks for."""

    @classmethod
    def names(cls) -> frozenset[str]:
        """Return the names of all options."""
        return frozenset(option.name for option in fields(cls))


@dataclass(frozen=True, kw_only=True)
class RelaxResult:
    """Where the robots came to rest, or are on the way.

    They stay on the device: `position`, `last_step` and `force_error` are copied or computed once
    they are read. What moves the same robots later does not change them.
    """

    state: RelaxState = field(repr=False)
    """The robots after the last step."""

    begin: RelaxState = field(repr=False)
    """The robots before the first step."""

    largest_move: Reals
    """Longest step of any robot, by step, shape (steps,)."""

    list_builds: int
    """How often rows of neighbors were made, in the structure that needed it most."""

    running: Backend = field(repr=False)
    """What computed."""

    spacing: float = field(repr=False)
    """D."""

    bounds_error: bool = field(default=True, repr=False)
    """Whether the error of forces has a bound, as those of the engine have."""

    @cached_property
    def position(self) -> Reals:
        """Centers, in the caller's order, shape (N, 3)."""
        return self.state.position.copy()

    @cached_property
    def last_step(self) -> Reals:
        """Last step of each robot if its integrator asks for it, else zero, shape (N, 3)."""
        return self.state.last_step.copy()

    @property
    def taken(self) -> int:
        """Steps taken, those of calls before included: the number of the next one."""
        return self.state.taken

    @property
    def precision(self) -> Precision:
        """Floating-point type that the device computed in."""
        return self.running.precision

    @cached_property
    def force_error(self) -> float:
        """Largest error of a force by rounding [1], NaN for forces of users.

        It is relative to the largest force, or to that of two docks D / 2 from touching, connected
        or not, where that is larger.
        """
        if not self.bounds_error:
            return np.nan
        unit = self.state.places.unit
        if unit is not None:
            # Center and dock are rounded: as coarse as real numbers in f32 so far from the origin.
            farthest = float(2.0 * unit / np.finfo(np.float32).eps)
        else:
            farthest = _farthest(self.begin, self.state, self.largest_move)
        return self.running.force_error(2.0 * farthest / self.spacing)


class PreparedSwarm:
    """A swarm on the device, to be relaxed again and again; arguments as for `tiswarm.relax`.

    A guided swarm has inertia and a mobility of each robot m, and its connected docks part where
    they are nearer than D:

        step <- momentum * step + m F, no longer than the longest step
    """

    swarm: Swarm
    """The robots as the caller numbers them, where they are at first."""

    running: Backend
    """What computes."""

    dynamics: Dynamics
    """How they move."""

    cutoff: float
    """Where forces of unconnected docks end."""

    stepper: Stepper | None
    """Their arrays on the device; None without robots."""

    first: RelaxState
    """The robots at rest, where they are at first."""

    state: RelaxState
    """The robots after the last call."""

    begin: RelaxState
    """The robots where these steps began."""

    before: RelaxState
    """The robots before the last call."""

    moves: Reals
    """Longest steps of the last call, even if it diverged."""

    @backend.exclusive()
    def __init__(
        self,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        robot: Robot,
        height: ArrayLike | None = None,
        mobility: ArrayLike | None = None,
        dynamics: Dynamics | None = None,
        cutoff: float | None = None,
        structure: ArrayLike | None = None,
        precision: AnyPrecision = "auto",
        arch: AnyArch = "cpu",
        threads: int | None = None,
        running: Backend | None = None,
    ) -> None:
        """Check the robots, renumber them and copy them to the device.

        A `mobility`, the step of each robot along each axis for a force of 1 [1], shape (N, 3),
        makes the swarm guided; 0 fixes a coordinate. `dynamics` replace those of free and guided
        swarms, and `cutoff` D. `running` is a backend that runs already.
        """
        swarm = Swarm.check(
            position, orientation_wxyz, contacts, robot=robot, height=height, mobility=mobility,
            structure=structure,
        )  # fmt: skip
        self.swarm = swarm
        self.cutoff = swarm.spacing if cutoff is None else cutoff
        self.dynamics = dynamics or (FREE if mobility is None else GUIDED)
        if running is None:
            running = backend.start(arch, threads=threads, precision=precision)
        self.running = running
        self.first = RelaxState(self._choose_places(), 0, position=swarm.position)
        self.stepper = None
        self.moves = np.zeros(0)
        self.begin = self.before = self.state = self.first
        if len(swarm.position):
            largest = np.bincount(swarm.structure).max()
            self.stepper = Stepper(
                swarm, running, self.first.places, self.dynamics, cutoff=self.cutoff,
                by_structure=not running.on_card and bool(largest <= SMALL),
            )  # fmt: skip

    def _choose_places(self) -> Places:
        """Choose what numbers centers have, as long as the swarm does not outgrow them."""
        swarm = self.swarm
        precision = self.running.precision
        places = Places(origin=np.zeros(3), unit=None, spacing=swarm.spacing)
        if precision == "f32" and len(swarm.position):
            places = Places.choose(
                swarm.position, swarm.height, reach=swarm.reach, spacing=swarm.spacing
            )
        if not places.is_resolved(swarm.position):
            way_out = ", or use precision f64" if precision == "f32" else ""
            raise InputError(
                f"a robot {np.abs(swarm.position).max():.3g} from the origin is beyond what "
                f"{precision} resolves; bring robots nearer together{way_out}"
            )
        return places

    @property
    def position(self) -> Reals:
        """Centers after the last call, as the caller numbers robots, shape (N, 3)."""
        return self.state.position.copy()

    @property
    def is_there(self) -> bool:
        """Whether the swarm can go on: no other device started meanwhile."""
        return self.stepper is None or self.stepper.is_there

    @property
    def taken(self) -> int:
        """Steps taken, those before a first one that has a number included."""
        return self.state.taken

    @backend.exclusive()
    def relax(
        self,
        *,
        steps: int,
        resume: bool = False,
        state: RelaxState | None = None,
        first_step: int = 0,
        last_step: ArrayLike | None = None,
        **options: Any,  # noqa: ANN401 - those of `StepOptions`
    ) -> RelaxResult:
        """Take steps from where the robots were at first, or, to `resume`, where they are.

        They also go on from a `state` that earlier steps left. Steps from where the robots were at
        first have the numbers from `first_step` on, and follow the `last_step` of each robot,
        shape (N, 3). All other arguments are `StepOptions`.
        """
        start: dict[str, Any] = {
            "state": self.state if resume else state, "first_step": first_step,
            "last_step": last_step,
        }  # fmt: skip
        with self._taking(steps, StepOptions(**options), start) as numbers:
            begin = self.start(**start)
            builds = self._take(begin, numbers, goes_on=False, seed=options.get("seed", 0))
        return RelaxResult(
            state=self.state, begin=begin, largest_move=self.moves, list_builds=builds,
            running=self.running, spacing=self.swarm.spacing, bounds_error=not self.dynamics.is_cut,
        )  # fmt: skip

    @backend.exclusive()
    def step(self, steps: int = 1, **options: Any) -> None:  # noqa: ANN401 - `StepOptions`
        """Take steps from where the robots are, by rows of neighbors that serve until stale.

        Arguments are `StepOptions`. On a whole swarm, steps are the same to the bit, however they
        are shared out among calls.
        """
        with self._taking(steps, StepOptions(**options), {"state": self.state}) as numbers:
            if steps:
                self._take(self.state, numbers, goes_on=True, seed=options.get("seed", 0))

    @contextmanager
    def _taking(
        self, steps: int, options: StepOptions, _start: Mapping[str, Any]
    ) -> Iterator[Reals]:
        """Check and tabulate the numbers of steps, which are then taken.

        Args:
            steps: Number of steps.
            options: Numbers of the call.
            _start: Where steps begin: arguments of `start`.
        """
        yield self._numbers(steps, options)

    def _take(self, state: RelaxState, numbers: Reals, *, goes_on: bool, seed: int) -> int:
        """Take a step from a state for each row of numbers; return how often rows were made."""
        self.before = self.state
        self.begin = state
        steps = len(numbers)
        stepper = self.stepper
        if steps == 0 or stepper is None:
            self.moves = np.zeros(steps)
            self.state = state.numbered(state.taken + steps)
            return 0
        stepper.refuse_other_device()
        while True:
            arrays, moves, builds = stepper.take_steps(state, numbers, seed, goes_on=goes_on)
            self.moves = moves
            if not state.places.were_left(moves):
                break
            # Whole numbers ran out: take the same steps again, in a larger unit.
            state = state.coarser()
            if not state.places.is_resolved(state.bound):
                raise InputError(f"{_DIVERGED}, or use precision f64")
        bound = state.bound + float(moves.sum())
        end = RelaxState(state.places, state.taken + steps, arrays=arrays, bound=bound)
        if not end.places.is_resolved(bound):
            if not end.places.is_resolved(_farthest(state, end, moves)):
                raise InputError(_DIVERGED)
            end.bound = end.farthest
        self.state = end
        return builds

    def start(
        self,
        *,
        state: RelaxState | None = None,
        first_step: int = 0,
        last_step: ArrayLike | None = None,
    ) -> RelaxState:
        """Return the state that steps start from; arguments are those of `relax`."""
        if state is not None:
            return state
        if last_step is None:  # the robots at first are on the device already, if they took a step
            return self.first.numbered(first_step) if first_step else self.first
        step = np.asarray(last_step, np.float64)
        position = self.first.position
        if step.shape != position.shape or not np.isfinite(step).all():
            problem = (
                f"shape {step.shape}, or not finite; give steps of robots of shape {position.shape}"
            )
            raise InputError(problem, argument="last_step")
        return RelaxState(self.first.places, first_step, position=position, last_step=step)

    def _numbers(self, steps: int, options: StepOptions) -> Reals:
        """Check and tabulate the numbers of each step, shape (steps, columns)."""
        limit = _NO_LIMIT if options.max_step is None else options.max_step
        attraction, repulsion = options.attraction_gain, options.repulsion_gain
        gains = attraction or 0.0, repulsion or 0.0, options.height_gain
        if not (all(0.0 <= gain <= _LARGEST_GAIN for gain in gains) and limit >= 0.0):
            raise InputError(
                f"gains must be 0 to {_LARGEST_GAIN:g}, and the longest step 0 or more, "
                f"not {gains} and {limit:g}"
            )
        weighted = self._weighted(
            options.ramp, steps,
            attraction=attraction, repulsion=repulsion, parting=options.parting_gain,
        )  # fmt: skip
        numbers = {
            "height_gain": options.height_gain, "max_step": limit, "momentum": options.momentum,
            **weighted, **(options.parameters or {}),
        }  # fmt: skip
        return self._tabulate(numbers, steps)

    def _weighted(
        self, ramp: ArrayLike | None, steps: int, **gains: float | None
    ) -> dict[str, ArrayLike]:
        """Weight the gains that are given by the ramp, if there is one."""
        ramps = np.asarray(0.0 if ramp is None else ramp, np.float64)
        if steps < 0 or ramps.shape not in {(), (steps,)}:
            raise InputError(
                f"ramp of shape {ramps.shape}; give one number, or one for each of {steps} steps"
            )
        # Rounded first: the shares add up to 1, and what is left of 1 has few digits in f32.
        real = self.running.dtype
        weighted: dict[str, ArrayLike] = {"ramp": ramps}
        for name, gain in gains.items():
            if gain is not None:
                share = 1.0 - ramps if name == "repulsion" else ramps
                weighted[name] = share.astype(real) * real(gain)
        return {} if ramp is None else weighted

    def _tabulate(self, columns: Mapping[str, ArrayLike], steps: int) -> Reals:
        """Tabulate `Numbers` and those of the dynamics, shape (steps, columns)."""
        names = self.dynamics.names
        numbers: Reals = np.zeros((steps, Numbers.TOTAL + len(names)))
        numbers[:, Numbers.SPACING] = self.swarm.spacing
        numbers[:, Numbers.CUTOFF] = self.cutoff
        numbers[:, Numbers.HEIGHT_GAIN] = columns["height_gain"]
        numbers[:, Numbers.MAX_STEP] = columns["max_step"]
        for column, name in enumerate(names, Numbers.TOTAL):
            if name not in columns:
                raise InputError(f"forces need {name}; give {name}_gain and ramp")
            numbers[:, column] = columns[name]
        return numbers


def _farthest(begin: RelaxState, end: RelaxState, moves: Reals) -> float:
    """Bound the largest coordinate on the way between states, by the longest step of each."""
    # No robot is farther from either end of the way than the steps between allow.
    way = np.concatenate([[0.0], np.cumsum(moves)])
    return float(np.minimum(begin.farthest + way, end.farthest + way[-1] - way).max())
