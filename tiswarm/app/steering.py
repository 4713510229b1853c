"""Growth that a caller steers: choices in, observations out, each structure at its own pace.

growth = tiswarm.Growth("bridge", robots=60, seeds=range(64), settings={"climb.patience": patience})
while not growth.is_over.all():
    growth.step(tiswarm.reactive_build(growth.observe()))
growth.swarms().table
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from tiswarm.app.navigation import Believer, Navigation
from tiswarm.app.results import File, Section
from tiswarm.app.swarms import GrownStructure, Swarms, growth_scenario
from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.base.errors import InputError, did_you_mean
from tiswarm.base.plugins import load_plugins
from tiswarm.compute import backend
from tiswarm.records.messages import shown
from tiswarm.study.navigation import navigate
from tiswarm.world.choices import ClimbStep, fault_of_choice, read_only
from tiswarm.world.growth import GrowthBatch, SteeredGrowth, shared_settings
from tiswarm.world.history_file import LARGEST_SEED
from tiswarm.world.params import StructureParams


class StepOutcome(NamedTuple):
    """What a step changed in S structures."""

    joined: Ints
    """Robots that joined, shape (S,)."""

    lost: Ints
    """Robots that left, fell or died, shape (S,)."""

    is_over: Bools
    """Whether each structure is complete, or ended early, shape (S,)."""


class Growth:
    """S structures of up to N robots that grow by choices of the caller.

    Robots start, climb flip by flip as `step` says, join where they stay, and make calls for
    help by their settings. A structure does not wait for others. What grows depends on its seed,
    settings and choices alone: not on other structures, nor on the number of threads.
    """

    def __init__(
        self,
        structure: Section = "tower",
        robots: int = 100,
        seeds: int | Sequence[int] = 1,
        *,
        settings: Mapping[str, ArrayLike] | None = None,
        robot: Section | None = None,
        navigate_by: str | None = None,
        belief_error: Section | None = None,
        believe: Section | Believer | None = None,
        sensing: Mapping[str, object] | None = None,
        threads: int | None = None,
        plugins: Sequence[File] = (),
    ) -> None:
        """Let the first robots start.

        Args:
            structure: Kind of structure, as `tiswarm.grow` takes it.
            robots: Robots in each structure, N.
            seeds: Seeds, one structure each, or their number: 0, 1, ... A seed may occur often.
            settings: Keys of the structure with a value for each of S structures, or one for all,
                such as `{"force_threshold": [5.0, 10.0], "climb.patience": 16}`.
            robot: Shape of the robots; FireAntV3 if None.
            navigate_by: What robots build by, as `tiswarm.grow` takes it, like the next three.
            belief_error: Error of the places that robots believe.
            believe: By what robots estimate where they are: a method, or a function of their log.
            sensing: What robots that do not know the truth sense, and with which noise.
            threads: CPU threads; all that this process may use if None.
            plugins: Python files that register structures, rules and grounds.

        Raises:
            InputError: an argument has a mistake.
        """
        load_plugins(plugins)
        navigation = Navigation(
            navigate_by=navigate_by, belief_error=belief_error, believe=believe, sensing=sensing
        )
        self._scenario = growth_scenario(structure, robots, 1, robot=robot, navigation=navigation)
        self._seeds = _seeds(seeds)
        numbers = np.arange(len(self._seeds))
        self._params = self._with_settings(
            [self._scenario.structure] * len(numbers), numbers, settings
        )
        backend.choose(threads=threads)
        backend.processor()
        self._batch = GrowthBatch(
            self._params,
            robots,
            self._seeds,
            self._scenario.robot,
            **navigate(self._scenario, navigation.place),
        )
        self._steered = SteeredGrowth(self._batch)

    def __len__(self) -> int:
        """S."""
        return len(self._seeds)

    @backend.exclusive()
    def observe(self) -> ClimbStep:
        """List the climbers that may choose now: M of them, none of structures that are over.

        `help(type(growth.observe()))` says what it has.
        """
        backend.processor()
        return self._steered.observe()

    @backend.exclusive()
    def step(self, choices: ArrayLike, *, leave: ArrayLike | None = None) -> StepOutcome:
        """Let climbers do what was chosen.

        Args:
            choices: For each of the M climbers of `observe`, the number of a possible flip, -1 to
                stay, `step.back(s)` to go back to stance s and stay there, or `step.wait` to stand
                there until the next round; integers, shape (M,).
            leave: Robots that leave when the round of their structure ends, shape (S, N); nobody if
                None. Founders stay.

        Raises:
            InputError: a climber cannot do what was chosen; nothing has changed then.
        """
        observed = self.observe()
        chosen = np.asarray(choices)
        if chosen.dtype.kind not in "iu" and chosen.size:
            raise InputError(f"choices are {chosen.dtype}; give integers", argument="choices")
        chosen = chosen.astype(np.int64)
        fault = fault_of_choice(chosen, observed)
        if fault:
            raise InputError(f"choices are {fault}", argument="choices")
        if leave is not None:
            leavers = np.asarray(leave)
            if leavers.dtype.kind != "b" or leavers.shape != self._batch.leaves.shape:
                problem = f"is {leavers.dtype} of shape {leavers.shape}; give truth values of shape"
                raise InputError(f"{problem} {self._batch.leaves.shape}", argument="leave")
            self._batch.leaves |= leavers
        joined = self.robot_count
        present = self.present.sum(axis=1)
        self._steered.step(chosen.astype(np.int32))
        new = self.robot_count - joined
        lost = present + new - self.present.sum(axis=1)
        return StepOutcome(new, lost, self.is_over)

    @backend.exclusive()
    def reset(
        self,
        numbers: ArrayLike | None = None,
        *,
        seeds: ArrayLike | None = None,
        settings: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Let structures begin anew.

        Args:
            numbers: Structures, shape (n,); all if None.
            seeds: Their seeds, shape (n,); as before if None.
            settings: Settings to change, with a value for each of them, or one for all.

        Raises:
            InputError: an argument has a mistake.
        """
        chosen = np.arange(len(self)) if numbers is None else np.atleast_1d(np.asarray(numbers))
        if chosen.dtype.kind not in "iu" or not np.isin(chosen, np.arange(len(self))).all():
            problem = f"{shown(numbers)} are no structures; give numbers from 0 to {len(self) - 1}"
            raise InputError(problem, argument="numbers")
        new_seeds = [self._seeds[number] for number in chosen]
        if seeds is not None:
            new_seeds = _seeds(np.broadcast_to(np.asarray(seeds), chosen.shape).tolist())
        params = self._with_settings([self._params[n] for n in chosen], chosen, settings)
        if not len(chosen):
            return
        backend.processor()
        for number, seed, of_structure in zip(chosen.tolist(), new_seeds, params, strict=True):
            self._seeds[number] = seed
            self._params[number] = of_structure
        self._steered.reset(chosen, new_seeds, params)

    @property
    def dock(self) -> Reals:
        """True dock centers of robots that have joined, in join order [R], shape (S, N, n, 3).

        Rows of other robots are meaningless. The array cannot be written, and changes as robots
        join: copy it first.
        """
        docks: Any = read_only(self._batch.arrays.dock)
        by_robot: Reals = docks.reshape(len(self), -1, self._batch.robot.dock_count, 3)
        return by_robot

    @property
    def seeds(self) -> Ints:
        """Seed of each structure, shape (S,)."""
        return np.array(self._seeds)

    @property
    def is_over(self) -> Bools:
        """Whether each structure is complete, or ended early, shape (S,)."""
        self.observe()  # robots that are put join without a choice
        return self._steered.is_over.copy()

    @property
    def ended(self) -> list[str]:
        """Reason why each structure ended early; empty where it did not."""
        return [structure.ended for structure in self._batch.structures]

    @property
    def crossed(self) -> Bools:
        """Whether the robots of each structure join both sides of a gap, shape (S,)."""
        return np.array([structure.crossed for structure in self._batch.structures])

    @property
    def robot_count(self) -> Ints:
        """Robots that have joined each structure, those that left again included, shape (S,)."""
        count: Ints = self._batch.arrays.robot_count.astype(np.int64)
        return count

    @property
    def present(self) -> Bools:
        """Whether each robot has joined and not left again, shape (S, N)."""
        is_here: Bools = self._batch.present != 0
        is_here &= np.arange(is_here.shape[1]) < self._batch.arrays.robot_count[:, None]
        return is_here

    def swarms(self, numbers: ArrayLike | None = None) -> Swarms:
        """Return structures as they are now, with all that `tiswarm.grow` returns.

        Args:
            numbers: Structures of equal settings, shape (n,); all if None.

        Raises:
            InputError: their settings differ, or no robot has joined one.
        """
        self.observe()
        chosen = (
            range(len(self)) if numbers is None else np.atleast_1d(np.asarray(numbers)).tolist()
        )
        params = [self._params[number] for number in chosen]
        if any(of_structure != params[0] for of_structure in params):
            problem = "structures of different settings do not go together; ask for those of one"
            raise InputError(problem, argument="numbers")
        histories = self._batch.histories(np.array(chosen))
        for history in histories:
            if not history.walks:
                raise InputError(f"seed {history.seed}: no robot joined: {history.ended}")
        seeds = [history.seed for history in histories]
        scenario = replace(self._scenario, structure=params[0], seeds=tuple(dict.fromkeys(seeds)))
        return Swarms([GrownStructure.of(history, scenario) for history in histories], scenario)

    def _with_settings(
        self,
        params: Sequence[StructureParams],
        numbers: AnyInts,
        settings: Mapping[str, ArrayLike] | None,
    ) -> list[StructureParams]:
        """Return the settings of some structures with others put in.

        Raises:
            InputError: a value has a mistake, or has to be the same for all structures.
        """
        changed = [*params]
        for key, given in (settings or {}).items():
            values = np.asarray(given)
            if values.shape not in {(), (len(numbers),)}:
                problem = f"shape {values.shape}; give one value, or {len(numbers)}"
                raise InputError(problem, key=f"structure.{key}")
            of_each = np.broadcast_to(values, (len(numbers),)).tolist()
            changed = [
                _changed(of, key.split("."), value, key)
                for of, value in zip(changed, of_each, strict=True)
            ]
        shared = shared_settings(self._scenario.structure)
        for of_structure in changed:
            for name, value in shared_settings(of_structure).items():
                if value != shared[name]:
                    problem = "is the same for all structures of a growth; grow them apart"
                    raise InputError(problem, key=f"structure.{name}")
        return changed


def _changed(settings: Any, path: Sequence[str], value: object, key: str) -> Any:  # noqa: ANN401
    """Return settings with one of them, or of a section of them, replaced.

    Raises:
        InputError: there is no such setting, or the value is wrong.
    """
    name, *deeper = path
    names = [entry.name for entry in fields(settings)] if is_dataclass(settings) else []
    if name not in names:
        raise InputError(f"no such setting{did_you_mean(name, names)}", key=f"structure.{key}")
    if deeper:
        value = _changed(getattr(settings, name), deeper, value, key)
    try:
        return replace(settings, **{name: value})
    except ValidationError as error:
        problem = error.errors()[0]["msg"]
        raise InputError(
            f"{shown(value)}: {problem}; correct it", key=f"structure.{key}"
        ) from error


def _seeds(given: int | Sequence[int]) -> list[int]:
    """List seeds; one may occur often.

    Raises:
        InputError: they are no seeds.
    """
    seeds = [*range(given)] if isinstance(given, int) else [*given]
    are_seeds = all(isinstance(seed, int | np.integer) for seed in seeds)
    if not seeds or not are_seeds or not all(0 <= seed <= LARGEST_SEED for seed in seeds):
        problem = f"{shown(given)} are no seeds; give whole numbers from 0 up, or their number"
        raise InputError(problem, argument="seeds")
    return [int(seed) for seed in seeds]
