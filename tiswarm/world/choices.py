"""Climbs that are steered flip by flip, by a rule in Python or from outside.

Kernels list what each climber touches and which flips it may take; a rule or a
caller chooses for all climbers of all structures at once.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.compute.math import uniform
from tiswarm.world.climb_kernels import (
    ENDED,
    MAX_TOUCHING,
    RECRUITED,
    WALKING,
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
"""A climber draws up to two to this number of a stream at a stance."""

STAY = -1
"""A climber's choice to stay where it is."""

WAIT = int(np.iinfo(np.int32).min)
"""A climber's choice to wait at its stance until the next round."""


class ClimbStep:
    """What climbers that choose see: M of them in S structures, each with K flips.

    A choice is the number of a possible flip, -1 to stay at the current stance, `back(s)` to
    go back to an earlier stance and stay there, or `wait` to stand there for a round. Who stays
    where it touches no robot is taken away and starts again. Arrays of the structures cannot be
    written: copy them first.
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
        memory: Reals,
        said: Reals,
    ) -> None:
        """Take the arrays of all slots, and the slots of those who choose, shape (M,)."""
        self._said = said
        self.memory: Reals = memory[slots]
        """Numbers that each robot keeps, `memory` of the rule; those written stay, (M, W)."""
        self._walks = walks
        self._structures = structures
        self._flips = flips
        self._slots = slots
        self.structure: AnyInts = walks.climbers.structure[slots]
        """Structure that each climbs, shape (M,)."""
        self.slot: AnyInts = slots
        """Which of the structures' movers each is, all those of a structure in a row, (M,)."""
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
        self.patience: AnyInts = walks.climbers.manner[slots, Manner.PATIENCE]
        """`structure.climb.patience` of each, shape (M,)."""
        self.called: Bools = called[slots] != 0
        """Whether it touches a dock that passes a call on, shape (M,)."""
        self.angle: Reals = flips.angle[slots]
        """Angle of each flip [rad], negative if backward, 0 if there is none, shape (M, K)."""
        self.possible: Bools = self.angle != 0.0
        """Which flips there are: about an attached dock, and something stops them, (M, K)."""
        self.dock = read_only(structures.dock)
        """Dock centers of all structures [R], shape (S, n N, 3)."""
        self.relay = read_only(structures.relay)
        """Call that each dock passes on, shape (S, n N)."""
        self.robot_count = read_only(structures.robot_count)
        """Robots that have joined; rows of others are meaningless, shape (S,)."""
        self.sensed = read_only(sensed)
        """Load that each robot sensed at the last solve [weight of a dock], shape (S, N)."""
        self.present: Bools = present != 0
        """Whether each robot has not left again, shape (S, N)."""

    @cached_property
    def walk(self) -> Reals:
        """Centers of its stances up to the current one, then NaN [R], (M, most stances, 3)."""
        centers: Reals = self._walks.stances.center[self._slots, : self.stance.max(initial=0) + 1]
        centers[np.arange(centers.shape[1]) > self.stance[:, None]] = np.nan
        return centers

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
        """Draw numbers in [0, 1), shape (M, count), by seed, stream, robot and stance alone."""
        draw = (self.stance.astype(np.int64) << _DRAW_BITS)[:, None] + np.arange(count)
        return uniform(self._walks.seed[self._slots, None], stream, self.robot[:, None], draw)

    def for_kernels(self) -> tuple[Walks, StructureArrays, FlipArrays]:
        """Return the arrays of the engine, by slot: for kernels, which do not write them."""
        return self._walks, self._structures, self._flips

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
        sensed: Reals,
        present: AnyInts,
        memory: Reals,
        said: Reals,
    ) -> None:
        """Reserve room for the flips of all slots.

        Args:
            walks: Walks of the robots.
            structures: What they climb.
            sensed: Load that each robot sensed at the last solve, shape (S, N).
            present: Whether each robot has not left, shape (S, N).
            memory: What climbers keep, shape (slots, W).
            said: What each dock of those that have joined said last, shape (S, N, n, B).
        """
        self._memory = memory
        self._said = said
        self._walks = walks
        self._structures = structures
        self._sensed = sensed
        self._present = present
        slots = len(walks.climbers.manner)
        self._flip_count = 2 * walks.limits.twists * walks.docks
        self._flips = FlipArrays(
            angle=np.zeros((slots, self._flip_count)),
            center=np.zeros((slots, self._flip_count, 3)),
            orientation=np.zeros((slots, self._flip_count, 4)),
            visited=np.zeros((slots, self._flip_count), np.int32),
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
        walks.stances.last[slots] = walks.climbers.first_stance[slots]
        walks.state[slots] = WALKING
        self.is_walking[slots] = True
        self._is_listed[slots] = False
        self.waits[slots] = False

    def observe(self) -> ClimbStep:
        """List what all that walk may choose; those that are put stay where they start."""
        walks = self._walks
        # What stands around a climber stays as it is while the climber walks: others' flips hold.
        arrived = np.flatnonzero(self.is_walking & ~self._is_listed).astype(np.int32)
        list_flips(
            walks.limits, arrived, self._met, *self._climbed, *walks.climbers,
            *walks.stances, *self._flips, walks.laws,
        )  # fmt: skip
        walks.state[arrived] |= self._met[arrived, StanceColumn.OVERFLOW]
        self._is_listed[arrived] = True
        put = arrived[walks.climbers.manner[arrived, Manner.PATIENCE] == 0]
        self._stay(put, walks.stances.last[put])
        self._asked = np.flatnonzero(self.is_walking).astype(np.int32)
        self._step = ClimbStep(
            walks,
            self._structures,
            self._flips,
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
        walking = self._asked[goes]
        stance = last[goes]
        flip = choice[goes]
        flips_a_dock = self._flip_count // self._walks.docks
        stances.pivot_dock[walking, stance] = flip // flips_a_dock
        stances.center[walking, stance + 1] = self._flips.center[walking, flip]
        stances.orientation[walking, stance + 1] = self._flips.orientation[walking, flip]
        stances.last[walking] = stance + 1
        self._is_listed[walking] = False

    def settle(self, movers: _Slots) -> None:
        """Let those of robots that have stayed turn which settle."""
        walks = self._walks
        if walks.climbers.manner[movers, Manner.SETTLES].any():
            settle_walks(
                walks.limits, movers, *self._climbed, *walks.climbers, *walks.stances, walks.laws
            )

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


def reactive_build(step: ClimbStep) -> AnyInts:
    """Choose as ReactiveBuild does: stay where called, or where the walk came nearest to the goal.

    Args:
        step: What climbers see.

    Returns:
        The choice of each climber, shape (M,).
    """
    walked = np.linalg.norm(step.walk - step.goal[:, None], axis=-1)
    best = np.nanargmin(walked, axis=1)
    is_new = step.possible & ~step.visited
    distance = np.where(is_new, np.linalg.norm(step.end - step.goal[:, None], axis=-1), np.inf)
    goes = ~step.called & (step.stance - best < step.patience) & is_new.any(axis=1)
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
