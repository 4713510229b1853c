"""Climbs that are steered flip by flip, by a rule in Python or from outside.

Kernels list what each climber touches and which flips it may take; a rule or a
caller chooses for all climbers of all structures at once. Climbers that go by beliefs
see where they believe themselves, other docks and the ends of their flips to be. What a
flip meets, and so whether it fails, is as docks truly are.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.compute.math import uniform
from tiswarm.world.belief_kernels import (
    BelievedWalks,
    note_planned_docks,
    plan_flips,
)
from tiswarm.world.climb_kernels import (
    ENDED,
    MAX_TOUCHING,
    RECRUITED,
    WALKING,
    BelievedDocks,
    Manner,
    StructureArrays,
)
from tiswarm.world.rule_kernels import (
    FlipArrays,
    StanceColumn,
    list_flips,
    sense_ends,
    settle_walks,
)
from tiswarm.world.walks import Walks

_Slots = NDArray[np.int32]

_DRAW_BITS = 16
"""A climber draws up to two to this number of a stream for each try."""

STAY = -1
"""A climber's choice to stay where it is."""

WAIT = int(np.iinfo(np.int32).min)
"""A climber's choice to wait at its stance until the next round."""


class Sight(NamedTuple):
    """What climbers go by: places as they believe them, or the true ones where they know these."""

    flips: FlipArrays
    """Flips, and where they end."""

    walks: BelievedWalks
    """Stances of their walks."""

    docks: BelievedDocks
    """Docks of robots that have joined."""

    sd: Reals
    """Standard deviation of the place of each robot [R], shape (S, N)."""

    ends: FlipArrays
    """Flips, and where they end among `obstacles`, as far as a climber knows."""

    obstacles: BelievedDocks
    """Docks that flips meet, as far as a climber knows."""


class Failures(NamedTuple):
    """Flips that climbers tried in vain, by slot."""

    has_failed: Bools
    """Whether each flip was tried from the current stance, shape (slots, K)."""

    failed_count: NDArray[np.int32]
    """How many were tried from each stance, shape (slots, stances)."""


class Rewritable:
    """What a rule sees: it writes some arrays, and finds nothing by another name."""

    _writable: tuple[str, ...] = ()

    def __setattr__(self, name: str, value: object) -> None:
        """Write an array.

        Raises:
            AttributeError: a rule does not write that.
        """
        if not (name.startswith("_") or name in self._writable):
            written = " and ".join(self._writable)
            problem = f"{name} cannot be written; a rule writes {written} alone: copy others first"
            raise AttributeError(problem)
        super().__setattr__(name, value)


def attributes_of(seen: object) -> list[str]:
    """List what an object shows to a rule, without its methods."""
    kind = type(seen)
    names = {*vars(seen), *(name for name in dir(kind) if not callable(getattr(kind, name)))}
    return sorted(name for name in names if not name.startswith("_"))


def rewrite(array: Reals, values: object, name: str) -> None:
    """Put values in place of those of an array.

    Raises:
        ValueError: they are no numbers of its shape.
    """
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        numbers = np.empty((0, 0))
    if numbers.shape != array.shape:
        shape = np.shape(values) if isinstance(values, np.ndarray | list | tuple) else "none"
        raise ValueError(f"{name} of shape {shape}; write numbers of shape {array.shape}")
    array[:] = numbers


class ClimbStep:
    """What climbers that choose see: M of them in S structures, each with K flips.

    A choice is the number of a possible flip, -1 to stay at the current stance, `back(s)` to
    go back to an earlier stance and stay there, or `wait` to stand there for a round. Who stays
    where it touches no robot is taken away and starts again. Arrays of the structures cannot be
    written: copy them first.

    Where robots build by estimates, all places are those that they believe. A flip that truly meets
    nothing, or ends where the climber has been, fails: the climber stands where it stood, and
    chooses again.

    Beside what is listed below it has `structure`, `slot`, `robot`, `stance` and `patience`, (M,);
    `center` and `goal` [R], (M, 3), `orientation_wxyz`, (M, 4); `touching`, (M, n, MAX_TOUCHING),
    `on_ground`, (M, n), `called`, (M,); `angle` [rad], `possible` and `failed`, (M, K). Of all
    structures it has `dock` [R], (S, n N, 3), `relay`, (S, n N), `robot_count`, (S,), and `sensed`
    [weight of a dock], `present` and `robot_sd` [R], (S, N).
    """

    def __init__(
        self,
        walks: Walks,
        structures: StructureArrays,
        sight: Sight,
        failures: Failures,
        called: _Slots,
        slots: _Slots,
        sensed: Reals,
        present: AnyInts,
        memory: Reals,
        said: Reals,
    ) -> None:
        """Take the arrays of all slots, and the slots of those who choose, shape (M,)."""
        self._said = said
        self._sight = sight
        self._failures = failures
        self._memory: Reals = memory[slots]
        self._walks = walks
        self._structures = structures
        self._slots = slots
        self.structure: AnyInts = walks.climbers.structure[slots]
        """Structure that each climbs, shape (M,)."""
        self.slot: AnyInts = slots
        """Which of the structures' movers each is, all those of a structure in a row, (M,)."""
        self.robot: AnyInts = walks.robot[slots]
        """Robots that started in that structure before it, shape (M,)."""
        self.stance: AnyInts = walks.stances.last[slots]
        """Flips that it has taken: number of its current stance, shape (M,)."""
        self.center: Reals = sight.walks.center[slots, self.stance]
        """Its center [R], shape (M, 3)."""
        self.orientation_wxyz: Reals = sight.walks.orientation[slots, self.stance]
        """Its orientation, body to world, shape (M, 4)."""
        self.touching: AnyInts = walks.stances.touching[slots, self.stance]
        """Docks n i + k that its docks touch, or -1, shape (M, n, MAX_TOUCHING)."""
        self.on_ground: AnyInts = walks.stances.on_ground[slots, self.stance]
        """Whether its docks stand on flat ground, 1, or an edge, 2, else 0, shape (M, n)."""
        self.goal: Reals = walks.climbers.goal[slots]
        """Its goal [R], shape (M, 3)."""
        self.patience: AnyInts = walks.climbers.manner[slots, Manner.PATIENCE]
        """`structure.climb.patience` of each, shape (M,)."""
        self.called: Bools = called[slots] != 0
        """Whether it touches a dock that passes a call on, shape (M,)."""
        self.angle: Reals = sight.flips.angle[slots]
        """Angle of each flip [rad], negative if backward, 0 if there is none, shape (M, K)."""
        self.possible: Bools = self.angle != 0.0
        """Which flips there are: about an attached dock, and something stops them, (M, K)."""
        self.failed: Bools = failures.has_failed[slots]
        """Which flips it has tried in vain from its stance; they are not possible, shape (M, K)."""
        self.dock = read_only(sight.docks.dock)
        """Dock centers of all structures [R], shape (S, n N, 3)."""
        self.robot_sd = read_only(sight.sd)
        """Standard deviation of the place of each robot that has joined, over all three axes [R],
        0 where robots know the truth, NaN if unknown, shape (S, N)."""
        self.relay = read_only(structures.relay)
        """Call that each dock passes on, shape (S, n N)."""
        self.robot_count = read_only(structures.robot_count)
        """Robots that have joined; rows of others are meaningless, shape (S,)."""
        self.sensed = read_only(sensed)
        """Load that each robot sensed at the last solve [weight of a dock], shape (S, N)."""
        self.present: Bools = present != 0
        """Whether each robot has not left again, shape (S, N)."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - arrays of any type
        """Refuse what a step does not have.

        Raises:
            AttributeError: always.
        """
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(f"a step has no {name}; it has {', '.join(attributes_of(self))}")

    @property
    def memory(self) -> Reals:
        """Numbers that each robot keeps, `memory` of the rule; those written stay, (M, W)."""
        return self._memory

    @memory.setter
    def memory(self, values: Reals) -> None:
        rewrite(self._memory, values, "step.memory")

    @cached_property
    def walk(self) -> Reals:
        """Centers of its stances up to the current one, then NaN [R], (M, most stances, 3)."""
        centers: Reals = self._sight.walks.center[self._slots, : self._most_stances]
        centers[np.arange(centers.shape[1]) > self.stance[:, None]] = np.nan
        return centers

    @cached_property
    def tries(self) -> AnyInts:
        """Flips that it has tried: those taken and those that failed, shape (M,)."""
        failed = self._failures.failed_count[self._slots, : self._most_stances]
        tries: AnyInts = self.stance + failed.sum(axis=1)
        return tries

    @cached_property
    def walk_tries(self) -> AnyInts:
        """Flips that it had tried when it came to each stance of `walk`, (M, most stances)."""
        failed = self._failures.failed_count[self._slots, : self._most_stances]
        before: AnyInts = np.cumsum(failed, axis=1) - failed + np.arange(failed.shape[1])
        return before

    @property
    def _most_stances(self) -> int:
        """Most stances of a walk up to the current one."""
        return int(self.stance.max(initial=0)) + 1

    @cached_property
    def touched_dock(self) -> Reals:
        """Center of the dock that each of its docks touches [R], or NaN, shape (M, n, 3)."""
        item = self.touching[:, :, 0]
        center = self.dock[self.structure[:, None], np.maximum(item, 0)]
        return np.where((item >= 0)[:, :, None], center, np.nan)

    @cached_property
    def touched_sd(self) -> Reals:
        """Standard deviation of the place of the robot that each dock touches [R], or NaN, (M, n).

        It is that of `robot_sd`.
        """
        item = self.touching[:, :, 0]
        sd = self.robot_sd[self.structure[:, None], np.maximum(item, 0) // self._walks.docks]
        return np.where(item >= 0, sd, np.nan)

    @cached_property
    def sd(self) -> Reals:
        """Standard deviation of its place: that of the robot from which it takes it [R], (M,).

        That is a robot that it touches, else the one that it touched last; 0 before.
        """
        return self._sd_by_dock[:, 0]

    @cached_property
    def end_sd(self) -> Reals:
        """Standard deviation of the place where each flip ends, as `sd` [R], shape (M, K).

        The place is taken from the robot that the pivot touches, where it touches one.
        """
        return self._sd_by_dock[:, self.pivot]

    @cached_property
    def _sd_by_dock(self) -> Reals:
        """Standard deviation of the robot from which a place is taken, by pivot [R], (M, n)."""
        source = self._walks.sources(self._slots, self.stance)
        sd = self.robot_sd[self.structure[:, None], np.maximum(source, 0)]
        return np.where(source >= 0, sd, 0.0)

    @cached_property
    def pivot(self) -> AnyInts:
        """Dock about which each flip turns, shape (K,)."""
        return np.repeat(np.arange(self._walks.docks), self.angle.shape[1] // self._walks.docks)

    @cached_property
    def heard(self) -> Reals:
        """Last message of the dock that each dock touches, or NaN, shape (M, n, B)."""
        docks = self._walks.docks
        robot, dock = np.divmod(np.maximum(self.touching[:, :, 0], 0), docks)
        heard = self._said[self.structure[:, None], robot, dock]
        return np.where((self.touching[:, :, 0] >= 0)[:, :, None], heard, np.nan)

    @cached_property
    def end(self) -> Reals:
        """Centers where flips end [R], meaningless where there is none, shape (M, K, 3)."""
        end: Reals = self._sight.flips.center[self._slots]
        return end

    @cached_property
    def end_orientation_wxyz(self) -> Reals:
        """Orientations where flips end, shape (M, K, 4)."""
        orientation: Reals = self._sight.flips.orientation[self._slots]
        return orientation

    @cached_property
    def visited(self) -> Bools:
        """Whether its walk has been where a flip ends, shape (M, K)."""
        visited: Bools = self._sight.flips.visited[self._slots] != 0
        return visited

    @cached_property
    def _ends(self) -> tuple[AnyInts, AnyInts, AnyInts]:
        walks = self._walks
        flips = self._sight.ends
        docks = self._sight.obstacles
        shape = (*flips.angle.shape, walks.docks)
        touching = np.full((*shape, MAX_TOUCHING), -1, np.int32)
        ground = np.zeros(shape, np.int32)
        called = np.zeros(flips.angle.shape, np.int32)
        sense_ends(
            walks.limits, self._slots, walks.climbers.structure, walks.climbers.dock_offset_body,
            *docks.cells, docks.dock, self._structures.relay, *flips[:3], touching, ground,
            called, walks.climbers.ground, walks.climbers.of_structure, walks.laws,
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
        """Draw numbers in [0, 1), shape (M, count), by seed, stream, robot and `tries` alone."""
        draw = (self.tries.astype(np.int64) << _DRAW_BITS)[:, None] + np.arange(count)
        return uniform(self._walks.seed[self._slots, None], stream, self.robot[:, None], draw)

    def for_kernels(self) -> tuple[Walks, StructureArrays, Sight, Failures]:
        """Return the arrays of the engine, by slot: for kernels, which do not write them."""
        return self._walks, self._structures, self._sight, self._failures

    @property
    def by_belief(self) -> bool:
        """Whether climbers go by places that they believe."""
        return bool(self._walks.limits.by_belief)

    @property
    def wait(self) -> int:
        """The choice to stand at the current stance until the next round."""
        return WAIT

    def back(self, stance: AnyInts | int) -> AnyInts:
        """Return the choice to go back to a stance, 0 up to the current one, and stay there.

        Args:
            stance: That of each climber, shape (M,), or of all.
        """
        return -2 - np.asarray(stance)


class ChoiceClimb:
    """Robots that climb by choices: those that still walk, and the flips that they may take."""

    def __init__(
        self,
        walks: Walks,
        structures: StructureArrays,
        believed: BelievedDocks,
        sd: Reals,
        sensed: Reals,
        present: AnyInts,
        memory: Reals,
        said: Reals,
        *,
        is_local: bool,
    ) -> None:
        """Reserve room for the flips of all slots.

        Args:
            walks: Walks of the robots.
            structures: What they climb.
            believed: Where robots believe the docks of these.
            sd: Standard deviation of the place of each robot [R], shape (S, N).
            sensed: Load that each robot sensed at the last solve, shape (S, N).
            present: Whether each robot has not left, shape (S, N).
            memory: What climbers keep, shape (slots, W).
            said: What each dock of those that have joined said last, shape (S, N, n, B).
            is_local: Whether robots know only what those that they touch believe.
        """
        self._memory = memory
        self._said = said
        self._walks = walks
        self._structures = structures
        self._sensed = sensed
        self._present = present
        slots, stances = walks.stances.pivot_dock.shape
        self._flip_count = 2 * len(walks.climbers.twist) * walks.docks
        self._flips = _room_for_flips(slots, self._flip_count)
        self._by_belief = bool(walks.limits.by_belief)
        planned_flips = self._flips
        if self._by_belief:
            planned_flips = _room_for_flips(slots, self._flip_count)
        ends = planned_flips
        obstacles = believed
        if is_local:
            ends = self._flips
            obstacles = BelievedDocks(structures.cells, structures.dock)
        self._is_local = is_local
        self._sight = Sight(planned_flips, walks.believed, believed, sd, ends, obstacles)
        self._planned = np.zeros((slots, stances if self._by_belief else 0, 4))
        """Orientations in which flips of walks were planned to end, shape (slots, stances, 4)."""
        self._unbelieved = np.zeros(slots, np.int32)
        """First stance of each walk that is to be believed anew, shape (slots,)."""
        self._failures = Failures(
            np.zeros((slots, self._flip_count), np.bool_), np.zeros((slots, stances), np.int32)
        )
        self._met = np.zeros((slots, StanceColumn.TOTAL), np.int32)
        self.waits = np.zeros(slots, np.bool_)
        """Whether the robot in each slot waits for the next round, shape (slots,)."""
        self.is_walking = np.zeros(slots, np.bool_)
        """Whether the robot in each slot has not stayed yet, shape (slots,)."""
        self._is_listed = np.zeros(slots, np.bool_)
        """Whether the flips of the robot in each slot are those of its last stance, (slots,)."""
        self._asked: _Slots = np.empty(0, np.int32)
        self._step: ClimbStep | None = None

    def begin(self, slots: _Slots) -> None:
        """Let robots walk on from their first stance."""
        walks = self._walks
        first_stance = walks.climbers.first_stance[slots]
        walks.stances.last[slots] = first_stance
        walks.state[slots] = WALKING
        # Docks may be believed elsewhere than in the round before.
        self._unbelieved[slots] = 0
        failed_count = self._failures.failed_count
        is_to_come = np.arange(failed_count.shape[1]) >= first_stance[:, None]
        failed_count[slots] = np.where(is_to_come, 0, failed_count[slots])
        self._failures.has_failed[slots] = False
        self.is_walking[slots] = True
        self._is_listed[slots] = False
        self.waits[slots] = False

    def observe(self) -> ClimbStep:
        """List what all that walk may choose; those that are put stay where they start."""
        walks = self._walks
        # What stands around a climber stays as it is while the climber walks: others' flips hold.
        arrived = np.flatnonzero(self.is_walking & ~self._is_listed).astype(np.int32)
        list_flips(
            walks.limits_by_truth, arrived, self._met, *self._climbed, *walks.climbers,
            *walks.stances, *self._flips, walks.laws,
        )  # fmt: skip
        if self._by_belief:
            self._plan(arrived)
        walks.state[arrived] |= self._met[arrived, StanceColumn.OVERFLOW]
        self._is_listed[arrived] = True
        put = arrived[walks.climbers.manner[arrived, Manner.PATIENCE] == 0]
        self._stay(put, walks.stances.last[put])
        self._asked = np.flatnonzero(self.is_walking).astype(np.int32)
        self._step = ClimbStep(
            walks,
            self._structures,
            self._sight,
            self._failures,
            self._met[:, StanceColumn.CALLED],
            self._asked,
            self._sensed,
            self._present,
            self._memory,
            self._said,
        )
        return self._step

    def take(self, choice: AnyInts) -> None:
        """Let those that were listed last do what was chosen, shape (M,)."""
        stances = self._walks.stances
        if self._step is not None:
            self._memory[self._asked] = self._step.memory
        last = stances.last[self._asked]
        goes = choice >= 0
        waits = choice == WAIT
        stay = np.where(waits | (choice == STAY), last, -2 - choice)
        self._stay(self._asked[~goes], stay[~goes])
        self.waits[self._asked[waits]] = True
        fails = self._fails(self._asked[goes], choice[goes])
        self._fail(self._asked[goes][fails], choice[goes][fails])
        walking = self._asked[goes][~fails]
        stance = last[goes][~fails]
        flip = choice[goes][~fails]
        flips_a_dock = self._flip_count // self._walks.docks
        stances.pivot_dock[walking, stance] = flip // flips_a_dock
        stances.center[walking, stance + 1] = self._flips.center[walking, flip]
        stances.orientation[walking, stance + 1] = self._flips.orientation[walking, flip]
        stances.last[walking] = stance + 1
        self._failures.has_failed[walking] = False
        if self._by_belief:
            self._planned[walking, stance] = self._sight.flips.orientation[walking, flip]
        self._is_listed[walking] = False

    def _fails(self, slots: _Slots, flip: AnyInts) -> Bools:
        """Whether flips that climbers take fail, shape (n,); none does where they know the truth.

        Such a flip meets nothing, leads into a zone, or ends where the climber has been and did not
        plan to be.
        """
        is_revisit = self._flips.visited[slots, flip] > self._sight.flips.visited[slots, flip]
        fails: Bools = (self._flips.angle[slots, flip] == 0.0) | is_revisit
        return fails

    def _fail(self, slots: _Slots, flip: AnyInts) -> None:
        """Let flips of climbers, shape (n,), fail: these stand where they stood."""
        self._failures.has_failed[slots, flip] = True
        self._failures.failed_count[slots, self._walks.stances.last[slots]] += 1
        self._sight.flips.angle[slots, flip] = 0.0
        self._stop_after_most_flips(slots)

    def _stop_after_most_flips(self, slots: _Slots) -> None:
        """Leave no flip to climbers that have tried as many as a walk has room for."""
        stances = self._walks.stances
        tries = stances.last[slots] + self._failures.failed_count[slots].sum(axis=1)
        # One stance is kept for settling.
        self._sight.flips.angle[slots[tries + 2 >= stances.center.shape[1]]] = 0.0

    def _plan(self, arrived: _Slots) -> None:
        """List what climbers believe: where they are, and where their flips end."""
        walks = self._walks
        climbers = walks.climbers
        stances = walks.stances
        plans = self._sight.flips
        believed = self._sight.docks
        walks.believe(self._structures, believed, arrived, self._unbelieved, stances.last)
        self._unbelieved[arrived] = stances.last[arrived] + 1
        plan_flips(
            walks.limits, self._is_local, arrived, *self._structures.cells, self._structures.dock,
            *believed.cells, believed.dock, walks.turn, climbers.structure,
            climbers.dock_offset_body, climbers.twist, climbers.near, climbers.ground,
            climbers.of_structure, stances.center, stances.orientation,
            stances.touching, stances.on_ground, stances.last, *plans, walks.laws,
        )  # fmt: skip
        self._stop_after_most_flips(arrived)

    def end(self, movers: _Slots) -> None:
        """End the round of robots that have stayed: those turn that settle, and plans are noted."""
        walks = self._walks
        if self._by_belief:
            self._note_plans(movers)
        if walks.climbers.manner[movers, Manner.SETTLES].any():
            settle_walks(
                walks.limits, movers, *self._climbed, *walks.climbers, *walks.stances, walks.laws
            )

    def _note_plans(self, movers: _Slots) -> None:
        """Note which flips of walks failed, and where the others were planned to end."""
        walks = self._walks
        climbers = walks.climbers
        stances = walks.stances
        believed = self._sight.docks
        walks.flips[movers, :, 1] = self._failures.failed_count[movers]
        note_planned_docks(
            walks.limits, movers, self._structures.dock, *believed.cells, believed.dock,
            walks.turn, climbers.structure, climbers.first_stance, climbers.dock_offset_body,
            climbers.of_structure, stances.center, stances.orientation, stances.touching,
            stances.last, stances.pivot_dock, self._planned, walks.flips,
        )  # fmt: skip

    @property
    def _climbed(self) -> tuple[NDArray[np.generic], ...]:
        """What kernels take of the structures."""
        structures = self._structures
        return (*structures.cells, structures.dock, structures.relay)

    def _stay(self, slots: _Slots, stance: AnyInts) -> None:
        """End the walks of robots, which stay at some stance, shape (n,)."""
        walks = self._walks
        walks.stances.best[slots] = stance
        walks.stances.stay[slots] = stance
        recruited = (self._met[slots, StanceColumn.CALLED] != 0) & (
            stance == walks.stances.last[slots]
        )
        walks.state[slots] |= np.where(recruited, RECRUITED, ENDED)
        self.is_walking[slots] = False


def _room_for_flips(slots: int, flips: int) -> FlipArrays:
    """Reserve room for the flips of robots, so many for each slot."""
    return FlipArrays(
        angle=np.zeros((slots, flips)),
        center=np.zeros((slots, flips, 3)),
        orientation=np.zeros((slots, flips, 4)),
        visited=np.zeros((slots, flips), np.int32),
    )


def reactive_build(step: ClimbStep) -> AnyInts:
    """Choose as ReactiveBuild does: stay where called, or where the walk came nearest to the goal.

    Args:
        step: What climbers see.

    Returns:
        The choice of each climber, shape (M,).
    """
    walked = np.linalg.norm(step.walk - step.goal[:, None], axis=-1)
    best = np.nanargmin(walked, axis=1)
    since_best = step.tries - step.walk_tries[np.arange(len(best)), best]
    is_new = step.possible & ~step.visited
    distance = np.where(is_new, np.linalg.norm(step.end - step.goal[:, None], axis=-1), np.inf)
    goes = ~step.called & (since_best < step.patience) & is_new.any(axis=1)
    stay = step.back(np.where(step.called, step.stance, best))
    return np.where(goes, distance.argmin(axis=1), stay)


def fault_of_choice(choice: AnyInts, step: ClimbStep) -> str:
    """Say why climbers cannot do what was chosen, integers; empty if they can."""
    if choice.shape != step.stance.shape:
        return f"shape {choice.shape}; return a choice for each of {len(step.stance)} climbers"
    flips = np.flatnonzero(choice >= 0)
    last = step.possible.shape[1] - 1
    cannot = flips[~step.possible[flips, np.minimum(choice[flips], last)]]
    is_too_low = (choice < step.back(step.stance)) & (choice != WAIT)
    cannot = np.append(cannot, np.flatnonzero((choice > last) | is_too_low))
    if not len(cannot):
        return ""
    m = int(cannot.min())
    return (
        f"{choice[m]} for climber {m}; return a possible flip, {STAY} to stay, step.wait, or "
        f"step.back(s) for an earlier stance s of its {step.stance[m] + 1}"
    )


def read_only(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a view that code of users cannot write: the array is that of the engine."""
    view = array.view()
    view.flags.writeable = False
    return view
