"""The swarm step: every robot at once, moved by the forces on its docks.

    F_i = sum over connected docks of Eq. (1)
        + sum over other docks of other robots nearer than D of Eq. (2)
        + k_z (h_i - z_i) along z, Eq. (3)
    p_i <- p_i + F_i, no farther than the longest step

Equations as in `tiswarm.engine.kernels`. Other `Dynamics` replace all but Eq. (3) and the cap.
Lengths in the unit of the robot's spacing D.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

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
class RelaxResult:
    """Where the robots came to rest, or are on the way."""

    position: Reals
    """Centers, in the caller's order, shape (N, 3)."""

    last_step: Reals
    """Last step of each robot if its integrator asks for it, else zero, shape (N, 3)."""

    largest_move: Reals
    """Longest step of any robot, by step, shape (steps,)."""

    taken: int
    """Steps taken, those of calls before included: the number of the next one."""

    list_builds: int
    """How often rows of neighbors were made, in the structure that needed it most."""

    precision: Precision
    """Floating-point type that the device computed in."""

    force_error: float
    """Largest error of a force by rounding [1]: relative to the largest force, or to that of two
    docks D / 2 from touching, connected or not, where that is larger."""


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

    taken: int
    """Steps taken, those before a first one that has a number included."""

    before: RelaxState
    """The robots before the last steps that were read."""

    begin: RelaxState
    """The robots where these steps began."""

    moves: Reals
    """Longest steps of the last call, even if it diverged."""

    _state: RelaxState | None
    """The robots, None where they are on the device alone."""

    _is_on_device: bool
    """Whether the device has the robots as they are."""

    _farthest: float
    """No coordinate of a robot on the device is larger than this."""

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
        self.first = RelaxState(
            places=self._choose_places(),
            position=swarm.position,
            last_step=np.zeros(swarm.position.shape),
        )
        self.stepper = None
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
    def state(self) -> RelaxState:
        """The robots after the last call, copied from the device where they are not yet."""
        if self._state is None and self.stepper is not None:
            self._refuse_other_device(self.stepper)
            self._state = self.stepper.state(self.taken)
        return self._state or self.first

    @state.setter
    def state(self, state: RelaxState) -> None:
        self._state = state
        self.taken = state.taken
        self._is_on_device = False

    @property
    def position(self) -> Reals:
        """Centers after the last call, as the caller numbers robots, shape (N, 3)."""
        return self.state.position.copy()

    @backend.exclusive()
    def relax(
        self,
        *,
        steps: int,
        attraction_gain: float | None = None,
        repulsion_gain: float | None = None,
        ramp: ArrayLike | None = None,
        height_gain: float = 0.0,
        max_step: float | None = None,
        parting_gain: float = 0.0,
        momentum: float = 0.0,
        parameters: Mapping[str, ArrayLike] | None = None,
        seed: int = 0,
        resume: bool = False,
        first_step: int = 0,
        last_step: ArrayLike | None = None,
    ) -> RelaxResult:
        """Take steps from where the robots were at first, or, to `resume`, where they are.

        Steps from where the robots were at first have the numbers from `first_step` on, and follow
        the `last_step` of each robot, shape (N, 3).

        In a guided swarm connected docks nearer than D part by a spring of stiffness `parting_gain`
        times the ramp [1], and a robot takes the share `momentum` of its last step again [1].
        `parameters` are further numbers that dynamics ask for, each one, or one a step.
        """
        numbers = self._numbers(
            steps, ramp=ramp, attraction_gain=attraction_gain, repulsion_gain=repulsion_gain,
            height_gain=height_gain, max_step=max_step, parting_gain=parting_gain,
            momentum=momentum, parameters=parameters,
        )  # fmt: skip
        state = self.start(resume=resume, first_step=first_step, last_step=last_step)
        return self._taken_from(state, numbers, seed)

    @backend.exclusive()
    def step(
        self,
        steps: int = 1,
        *,
        attraction_gain: float | None = None,
        repulsion_gain: float | None = None,
        ramp: ArrayLike | None = None,
        height_gain: float = 0.0,
        max_step: float | None = None,
        parting_gain: float = 0.0,
        momentum: float = 0.0,
        parameters: Mapping[str, ArrayLike] | None = None,
        seed: int = 0,
    ) -> None:
        """Take steps from where the robots are, and leave them on the device.

        `position` and `state` copy them from there once they are asked for. Arguments are those of
        `relax`. Steps are the same to the bit, however they are shared out among calls.
        """
        numbers = self._numbers(
            steps, ramp=ramp, attraction_gain=attraction_gain, repulsion_gain=repulsion_gain,
            height_gain=height_gain, max_step=max_step, parting_gain=parting_gain,
            momentum=momentum, parameters=parameters,
        )  # fmt: skip
        if steps == 0:
            return
        stepper = self.stepper
        if stepper is None or stepper.by_structure or not self._is_on_device:
            self._taken_from(self.state, numbers, seed)
            return
        self._refuse_other_device(stepper)
        moves, _ = stepper.go_on(numbers, self.taken, seed)
        farthest = self._farthest + float(moves.sum())
        if stepper.places.were_left(moves) or not stepper.places.is_resolved(farthest):
            # Beyond its numbers, or diverged: take the steps again from the host, or refuse them.
            self.state = stepper.state(self.taken, before=True)
            self._taken_from(self.state, numbers, seed)
            return
        self.moves = moves
        self.taken += steps
        self._state = None
        self._farthest = farthest

    def _taken_from(self, state: RelaxState, numbers: Reals, seed: int) -> RelaxResult:
        """Take a step from a state for each row of numbers, and read where the robots are then."""
        self.before = self.state
        self.begin = state
        steps = len(numbers)
        stepper = self.stepper
        if steps == 0 or stepper is None:
            self.state = replace(state, taken=state.taken + steps)
            return self._result(np.zeros(steps), 0, np.abs(state.position).max(initial=0.0))
        self._refuse_other_device(stepper)
        self._is_on_device = False
        while True:
            moves, builds = stepper.take_steps(state, numbers, seed)
            self.moves = moves
            if not state.places.were_left(moves):
                break
            # Whole numbers ran out: take the same steps again, in a larger unit.
            state = state.coarser()
            if not state.places.is_resolved(state.position):
                raise InputError(f"{_DIVERGED}, or use precision f64")
        end = stepper.state(state.taken + steps)
        farthest = _farthest(state.position, end.position, moves)
        if not end.places.is_resolved(farthest):
            raise InputError(_DIVERGED)
        self.state = end
        self._is_on_device = True
        self._farthest = float(np.abs(end.position).max())
        return self._result(moves, builds, farthest)

    def _refuse_other_device(self, stepper: Stepper) -> None:
        """Refuse to go on where another device started meanwhile.

        Arrays of a single thread are on the host, and outlast the device.
        """
        if backend.current() is not self.running and not stepper.by_structure:
            raise InputError("another device started, which freed the swarm; prepare it again")

    def start(
        self, *, resume: bool = False, first_step: int = 0, last_step: ArrayLike | None = None
    ) -> RelaxState:
        """Return the state that `relax` starts from; arguments are those of `relax`."""
        if resume:
            return self.state
        if last_step is None:
            return replace(self.first, taken=first_step)
        step = np.asarray(last_step, np.float64)
        if step.shape != self.first.position.shape or not np.isfinite(step).all():
            shape = self.first.position.shape
            problem = f"shape {step.shape}, or not finite; give steps of robots of shape {shape}"
            raise InputError(problem, argument="last_step")
        return replace(self.first, taken=first_step, last_step=step)

    def _numbers(
        self,
        steps: int,
        *,
        attraction_gain: float | None,
        repulsion_gain: float | None,
        ramp: ArrayLike | None,
        height_gain: float,
        max_step: float | None,
        parting_gain: float,
        momentum: float,
        parameters: Mapping[str, ArrayLike] | None,
    ) -> Reals:
        """Check and tabulate the numbers of each step, shape (steps, columns)."""
        limit = _NO_LIMIT if max_step is None else max_step
        gains = attraction_gain or 0.0, repulsion_gain or 0.0, height_gain
        if not (all(0.0 <= gain <= _LARGEST_GAIN for gain in gains) and limit >= 0.0):
            raise InputError(
                f"gains must be 0 to {_LARGEST_GAIN:g}, and the longest step 0 or more, "
                f"not {gains} and {limit:g}"
            )
        shared = {"height_gain": height_gain, "max_step": limit, "momentum": momentum}
        weighted = self._weighted(
            ramp, steps,
            attraction=attraction_gain, repulsion=repulsion_gain, parting=parting_gain,
        )  # fmt: skip
        return self._tabulate({**shared, **weighted, **(parameters or {})}, steps)

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

    def _result(self, moves: Reals, builds: int, farthest: float) -> RelaxResult:
        """Describe the state after a call; `farthest` is the largest coordinate on the way."""
        places = self.state.places
        if places.unit is not None:
            # Center and dock are rounded: as coarse as real numbers in f32 so far from the origin.
            farthest = float(2.0 * places.unit / np.finfo(np.float32).eps)
        return RelaxResult(
            position=self.state.position.copy(),
            last_step=self.state.last_step.copy(),
            largest_move=moves,
            taken=self.state.taken,
            list_builds=builds,
            precision=self.running.precision,
            force_error=self.running.force_error(2.0 * farthest / self.swarm.spacing),
        )


def _farthest(start: Reals, end: Reals, moves: Reals) -> float:
    """Bound the largest coordinate on the way from start to end, by the longest step of each."""
    # No robot is farther from either end of the way than the steps between allow.
    way = np.concatenate([[0.0], np.cumsum(moves)])
    return float(np.minimum(np.abs(start).max() + way, np.abs(end).max() + way[-1] - way).max())
