"""Growth: robots spawn, climb toward the goal and stay, until a structure is complete.

Structures grow side by side, in rounds. In a round every structure stands still while its
movers climb, all at once; then they join one after the other. A mover whose walk passes what
has just joined goes on from there in the next round, so nobody walks through anybody; only
calls for help reach those who climb together a round late. A seed grows the same structure in
any company and on any number of threads.

After the joins of a round robots may leave or die. Those that reach the ground only by way of
robots that left fall, and count as gone, too; robots that climb and have touched one of them are
spawned again. Then the structure's mechanics are solved anew, and where docks have a strength,
contacts that bear too much break (`strength.py`). Robots under great load call others
to their aid (`walks.py`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.base.progress import Advance, Watch, ignore
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets, uniform
from tiswarm.compute.neighbor_kernels import CellList
from tiswarm.world.choices import ChoiceClimb, ClimbStep
from tiswarm.world.climb_kernels import BelievedDocks, StructureArrays, list_docks
from tiswarm.world.ground.solid import SolidGround
from tiswarm.world.history import DIED, FELL, LEFT, History, Walk
from tiswarm.world.mechanics import ContactLoads, Frames, LoadSummary, StructureFailure, parts
from tiswarm.world.members import LocalStep, MemberArrays
from tiswarm.world.params import (
    ClimbParams,
    ReactiveBuild,
    RecruitParams,
    StructureParams,
    anchor_places,
    sides_of_bodies,
    structure_ground,
    structure_zones,
)
from tiswarm.world.strength import StrengthParams
from tiswarm.world.walks import Belief, Spawn, Turn, Walks, climb_limits, note_belief, recruit

_MAX_TRIES = 64
"""Places drawn for one robot before its spawn counts as blocked."""
_DRAWN = 64
"""Robots whose first place is drawn at once: a draw of one costs as much."""


def grow(
    params: StructureParams,
    *,
    robots: int,
    seeds: Sequence[int],
    robot: RobotGeometry,
    believe: "Believe | None" = None,
    turn: Turn | None = None,
    on_progress: Advance = ignore,
    watch: Watch = ignore,
) -> list[History]:
    """Grow one structure for each seed.

    Args:
        params: Kind of structure, its goal, how robots climb and when they call for help.
        robots: Robots in each structure.
        seeds: One seed a structure.
        robot: The robots' shape.
        believe: What robots that have joined believe; called after each round with the structures
            that grew. None where all know the truth.
        turn: By how much orientations that robots sense as they climb are wrong, if they believe;
            None for not at all.
        on_progress: Called after each round with the number of robots that joined in it.
        watch: Called after each round with all structures, which it only reads.

    Returns:
        One history a seed, in that order. Where growth ended early its `ended` says why, and
        what had grown is kept.
    """
    return grow_each(
        [params] * len(seeds),
        robots=robots,
        seeds=seeds,
        robot=robot,
        believe=believe,
        turn=turn,
        on_progress=on_progress,
        watch=watch,
    )


@backend.exclusive()
def grow_each(
    params: Sequence[StructureParams],
    *,
    robots: int,
    seeds: Sequence[int],
    robot: RobotGeometry,
    believe: "Believe | None" = None,
    turn: Turn | None = None,
    on_progress: Advance = ignore,
    watch: Watch = ignore,
) -> list[History]:
    """Grow structures side by side, each with settings and a seed of its own.

    Each is the one that `grow` grows of these settings and this seed.

    Args:
        params: Settings of each structure, all with the same `batch_key`.
        robots: As for `grow`.
        seeds: Seed of each structure.
        robot: As for `grow`.
        believe: As for `grow`.
        turn: As for `grow`.
        on_progress: As for `grow`.
        watch: As for `grow`.

    Returns:
        One history a structure, in that order.
    """
    backend.processor()
    batch = GrowthBatch(params, robots, seeds, robot, believe, turn)
    rule = params[0].rule

    def report(joined: float) -> None:
        on_progress(joined)
        watch(batch.structures)

    if hasattr(rule, "choose"):
        steered = SteeredGrowth(batch, together=True, on_progress=report)
        while not steered.is_over.all():
            steered.step(chosen_by(rule, steered.observe()))
    else:
        while len(movers := batch.spawn(batch.numbers)):
            batch.walks.climb_by_score(batch.arrays, batch.believed, movers)
            report(batch.end_round(movers, np.unique(batch.structure_of[movers])))
        batch.act_on(batch.numbers)
    return batch.histories(batch.numbers)


_OWN_CLIMB = ("patience", "settle", "max_spawns")
"""Settings of `climb` that structures of a batch may have of their own."""

_OWN_CALLS = ("force_threshold", "recruit_base", "recruit_limit")
"""Settings of when robots call for help that they may have of their own, too."""


def batch_key(params: StructureParams) -> str:
    """Return what structures share that `grow_each` may grow side by side, as a text.

    It is all but when robots call for help, and how long they climb.
    """
    calls = {name: getattr(RecruitParams(), name) for name in _OWN_CALLS}
    climb = {name: getattr(ClimbParams(), name) for name in _OWN_CLIMB}
    return repr(replace(params, **calls, climb=replace(params.climb, **climb)))


def shared_settings(params: StructureParams) -> dict[str, object]:
    """Return the settings that all structures of a batch share, by dotted key."""
    names = ("plane", "movers", "mechanics", "terrain", "no_entry", "navigate_by")
    shared = {name: getattr(params, name) for name in names}
    climb = {f"climb.{name}": value for name, value in vars(params.climb).items()}
    for name in _OWN_CLIMB:
        del climb[f"climb.{name}"]
    return {**shared, **climb, "rule": params.rule.name}


class SteeredGrowth:
    """Growth by choices from outside: each structure goes on at its own pace, or all together."""

    def __init__(
        self, batch: "GrowthBatch", *, together: bool = False, on_progress: Advance = ignore
    ) -> None:
        """Let the first robots start.

        Args:
            batch: Structures without robots.
            together: Whether rounds of all structures end together, which takes fewer launches of
                kernels on many threads; what grows is the same.
            on_progress: Called after rounds with the number of robots that joined in them.
        """
        self._batch = batch
        self._together = together
        self._on_progress = on_progress
        self._climb = ChoiceClimb(
            batch.walks,
            batch.arrays,
            batch.believed,
            batch.sd,
            batch.sensed,
            batch.present,
            batch.members.memory_of_climber,
            batch.members.said,
            is_local=getattr(batch.rule, "is_local", False),
        )
        self._step: ClimbStep | None = None
        self.is_over = np.zeros(len(batch.structures), np.bool_)
        """Whether each structure is complete, or ended early, shape (S,)."""
        self._begin(batch.numbers)

    def observe(self) -> ClimbStep:
        """List the climbers that may choose now, M of them; none in structures that are over."""
        while self._step is None:
            step = self._climb.observe()
            if not self._end_rounds():
                self._step = step
        return self._step

    def observe_again(self) -> ClimbStep:
        """List the climbers of `observe` anew, as the structures are now."""
        self.observe()
        self._step = self._climb.observe()
        return self._step

    def step(self, choice: AnyInts) -> None:
        """Let the climbers of `observe` do what was chosen, shape (M,).

        Where all climbers of a structure stay, they join one after the other, the mechanics are
        solved, and the next ones start.
        """
        self.observe()
        self._climb.take(choice)
        self._step = None
        self._end_rounds()

    def reset(
        self, numbers: AnyInts, seeds: Sequence[int], params: Sequence[StructureParams]
    ) -> None:
        """Let structures, shape (n,), begin anew, each from a seed."""
        self._climb.is_walking[self._batch.reset(numbers, seeds, params)] = False
        self.is_over[numbers] = False
        self._step = None
        self._begin(numbers)

    def _begin(self, numbers: AnyInts) -> None:
        """Let robots start, or walk on, in structures where nobody walks."""
        batch = self._batch
        movers = batch.spawn(numbers)
        self._climb.begin(movers)
        complete = np.setdiff1d(numbers, batch.structure_of[movers])
        batch.act_on(complete)
        self.is_over[complete] = True

    def _end_rounds(self) -> bool:
        """End the round where all climbers have stayed, and begin the next one; whether any did."""
        batch = self._batch
        walks = np.zeros(len(self.is_over), np.bool_)
        walks[batch.structure_of[self._climb.is_walking]] = True
        ends = ~walks & ~self.is_over
        if not ends.any() or (self._together and walks.any()):
            return False
        movers = np.flatnonzero(batch.moving & ends[batch.structure_of]).astype(np.int32)
        self._climb.end(movers)
        numbers = np.flatnonzero(ends)
        self._on_progress(batch.end_round(movers, numbers, self._climb.waits))
        self._begin(numbers)
        return True


def chosen_by(rule: Any, step: ClimbStep) -> AnyInts:  # noqa: ANN401 - settings of any rule
    """Let a rule choose for all climbers, each by what it knows itself if the rule is local."""
    if not getattr(rule, "is_local", False):
        return np.asarray(rule.choose(step))
    local = LocalStep(step)
    choice: AnyInts = rule.choose(local)
    local.remember()
    return choice


class GrowthBatch:
    """Structures that grow side by side and the robots that climb them, `movers` slots each."""

    def __init__(
        self,
        params: Sequence[StructureParams],
        robots: int,
        seeds: Sequence[int],
        robot: RobotGeometry,
        believe: "Believe | None",
        turn: Turn | None,
    ) -> None:
        """Reserve room for structures of so many robots.

        Args:
            params: Settings of each structure; those that `shared_settings` lists are those of all.
            robots: Robots in each structure.
            seeds: Seed of each structure.
            robot: The robots' shape.
            believe: As `grow` has it.
            turn: As `grow` has it.
        """
        self.robots = robots
        self.believe = believe
        self.rule = params[0].rule
        self.loses = any(of.may_lose for of in params)
        self.turn = turn
        robot = params[0].robot(robot)
        self.robot = robot
        self.ground = structure_ground(params[0])
        count = len(seeds)
        self.numbers = np.arange(count)
        docks = robot.dock_count * robots
        self.frames = Frames(
            params[0].mechanics, docks=robot.dock_count, robots=robots, structures=count
        )
        self.structures = [
            GrowingStructure(s, seed, of_structure, robot, self.frames)
            for s, (seed, of_structure) in enumerate(zip(seeds, params, strict=True))
        ]
        self.arrays = StructureArrays(
            cells=CellList.allocate(count, docks),
            dock=np.zeros((count, docks, 3)),
            relay=np.zeros((count, docks), np.int32),
            robot_count=np.zeros(count, np.int32),
        )
        self.sd = np.zeros((count, robots))
        """Standard deviation of the place that each robot believes [R], shape (S, N)."""
        self.believed = BelievedDocks(self.arrays.cells, self.arrays.dock)
        if believe:
            self.believed = BelievedDocks(CellList.allocate(count, docks), 0.0 * self.arrays.dock)
        movers = min(params[0].movers, robots)
        self.structure_of = np.repeat(np.arange(count, dtype=np.int32), movers)
        by_belief = believe is not None
        limits, limits_by_truth = (
            climb_limits(params[0].climb, robot, self.ground, by_belief=goes_by)
            for goes_by in (by_belief, False)
        )
        self.walks = Walks(self.structure_of, limits, limits_by_truth, params, robot, seeds)
        self.moving = np.zeros(len(self.structure_of), np.bool_)
        self.call = np.zeros((count, robots), np.int32)
        self.rounds = np.zeros(count, np.int32)
        self.present = np.ones((count, robots), np.int32)
        self.leaves = np.zeros((count, robots), np.bool_)
        """Robots that are to leave at the end of the round, if they may, shape (S, N)."""
        self.members = MemberArrays(
            self.rule,
            structures=count,
            robots=robots,
            slots=len(self.structure_of),
            docks=robot.dock_count,
        )
        self.members.seed[:] = seeds
        self.members.sd = self.sd
        self.mute = np.zeros((count, robots), np.bool_)
        self.sensed = np.zeros((count, robots))

    def reset(
        self, numbers: AnyInts, seeds: Sequence[int], params: Sequence[StructureParams]
    ) -> Bools:
        """Let structures, shape (n,), begin anew, without robots.

        Returns:
            Whether each slot is one of theirs, shape (slots,).
        """
        self.frames.clear(numbers)
        for number, seed, of_structure in zip(numbers.tolist(), seeds, params, strict=True):
            self.structures[number] = GrowingStructure(
                number, seed, of_structure, self.robot, self.frames
            )
        self.arrays.robot_count[numbers] = 0
        self.arrays.cells.head[numbers] = -1
        self.believed.cells.head[numbers] = -1
        self.sd[numbers] = 0.0
        self.arrays.relay[numbers] = 0
        self.call[numbers] = 0
        self.sensed[numbers] = 0.0
        self.present[numbers] = 1
        self.mute[numbers] = False
        self.rounds[numbers] = 0
        self.leaves[numbers] = False
        self.members.clear(numbers, seeds)
        self.walks.restart(numbers, seeds, params)
        slots: Bools = np.isin(self.structure_of, numbers)
        self.moving[slots] = False
        return slots

    def spawn(self, numbers: AnyInts) -> NDArray[np.int32]:
        """Fill the free slots of unfinished structures, shape (n,).

        Returns:
            Slots whose robots climb in these structures now, shape (M,).
        """
        is_due = np.zeros(len(self.structures), np.bool_)
        is_due[numbers] = True
        due_slots = is_due[self.structure_of]
        climbing = np.bincount(self.structure_of[self.moving], minlength=len(self.structures))
        free = np.flatnonzero(~self.moving & due_slots)
        # Within a structure robots start one after the other.
        structure = self.structure_of[free]
        turn = np.arange(len(free)) - np.searchsorted(structure, structure)
        for due in range(turn.max(initial=-1) + 1):
            self._fill(free[turn == due], climbing)
        return np.flatnonzero(self.moving & due_slots).astype(np.int32)

    def _fill(self, slots: AnyInts, climbing: AnyInts) -> None:
        """Let a robot start in each of some slots of different structures, if one is due."""
        starts: dict[int, DueStart] = {}
        for slot in slots.tolist():
            structure = self.structures[self.structure_of[slot]]
            climbing_count = climbing[structure.number]
            is_complete = len(structure.walks) + climbing_count >= self.robots
            # Founders come one by one, since they found what the others climb.
            is_crowded = structure.founding and climbing_count > 0
            if not (is_crowded or structure.ended or is_complete):
                starts[slot] = structure.start(self.arrays.dock[structure.number])
        for slot, spawn in self._place(starts).items():
            structure = self.structures[self.structure_of[slot]]
            self.walks.start(slot, spawn)
            self.members.memory_of_climber[slot] = 0.0
            if self.turn:
                number = len(structure.walks) + int(climbing[structure.number])
                turns = self.walks.turn[slot]
                turns[:] = self.turn(structure.seed, number, len(turns))
            self.moving[slot] = True
            climbing[structure.number] += 1

    def _place(self, starts: "dict[int, DueStart]") -> dict[int, Spawn]:
        """Draw places of robots, by slot, until nothing stands there; end growth if all are taken.

        On uneven ground, robots of all structures come down in one call, which costs less.
        """
        spawns: dict[int, Spawn] = {}
        waiting = dict(starts)
        for trial in range(_MAX_TRIES):
            if not waiting:
                break
            poses = {}
            for slot, start in waiting.items():
                poses[slot] = self.structures[self.structure_of[slot]].pose(start, trial)
            if isinstance(self.ground, SolidGround):
                self._put_down(list(poses.values()), self.ground)
            for slot, (center, orientation) in poses.items():
                structure = self.structures[self.structure_of[slot]]
                if structure.is_free(center, orientation):
                    spawns[slot] = structure.spawn(waiting.pop(slot), center, orientation)
        for slot in waiting:
            self.structures[self.structure_of[slot]].note_crowd()
        return spawns

    def _put_down(self, poses: Sequence[tuple[Reals, Reals]], ground: SolidGround) -> None:
        """Let robots, each a center [R] and an orientation, come down until a dock touches ground.

        Heights of their centers are minus infinity where there is no ground.
        """
        center = np.array([place for place, _ in poses])
        orientation = np.array([turn for _, turn in poses])
        arm = dock_offsets(orientation, self.robot.dock_offset_body)
        level = ground.levels(center[:, :2], arm, self.robot.dock_radius)
        for (place, _), height in zip(poses, level, strict=True):
            place[2] = height

    def histories(self, numbers: AnyInts) -> list[History]:
        """Return the histories of some structures, shape (k,)."""
        histories = []
        for number in numbers:
            history = self.structures[number].history()
            if self.members.said.shape[-1]:
                sent = self.members.sent[number, : len(history.walks)]
                history = replace(history, sent=sent.copy())
            histories.append(history)
        return histories

    def act_on(self, numbers: AnyInts) -> None:
        """Let robots of complete structures, shape (k,), act for the rounds that the rule asks."""
        if not hasattr(self.rule, "act"):
            return
        acting = np.array([n for n in numbers if self.structures[n].walks], np.int64)
        for _ in range(int(getattr(self.rule, "rounds_after", 0)) if len(acting) else 0):
            self.rounds[acting] += 1
            self._act(acting, [])

    def end_round(
        self, movers: NDArray[np.int32], numbers: AnyInts, waits: Bools | None = None
    ) -> int:
        """Let all movers of some structures join that can, and robots that have joined act.

        Args:
            movers: Slots of the robots that climbed, shape (M,).
            numbers: Structures whose round ends, shape (k,).
            waits: Whether the robot in each slot waits for the next round, shape (slots,).

        Returns:
            How many joined.
        """
        walks = self.walks
        walks.refuse_overlaps(movers)
        climbed = self.structure_of[movers]
        is_waiting = np.zeros(len(movers), np.bool_) if waits is None else waits[movers]
        wants = np.zeros(len(self.structure_of), np.int32)
        founding = np.zeros(len(self.structures), np.bool_)
        founding[numbers] = [self.structures[number].founding for number in numbers]
        touching = walks.stances.touching[movers, walks.stances.stay[movers], :, 0].max(axis=1) >= 0
        wants[movers] = (touching | founding[climbed]) & ~is_waiting
        walks.join(self.arrays, movers, wants)
        # A walk that an earlier join disturbed goes on from its first stance that changed.
        joined = walks.joined[movers] >= 0
        disturbed = walks.disturbed[movers]
        goes_on = ~joined & ((disturbed > 0) | (is_waiting & (disturbed < 0)))
        self.moving[movers] = goes_on
        first_stance = np.where(disturbed < 0, walks.stances.last[movers], disturbed)
        walks.climbers.first_stance[movers[goes_on]] = first_stance[goes_on]
        joiners = movers[joined]
        rounds = self.rounds[self.structure_of[joiners]]
        walk_of = dict(zip(joiners.tolist(), walks.walks(joiners, rounds), strict=True))
        if hasattr(self.rule, "act"):
            self._admit_members(joiners)
        for slot in movers[~goes_on].tolist():
            structure = self.structures[self.structure_of[slot]]
            if slot in walk_of:
                structure.join(walk_of[slot], self.arrays.dock[structure.number])
            elif not wants[slot]:
                structure.turn_away()
        for number in np.setdiff1d(climbed[is_waiting], climbed[joined]):
            self.structures[number].wait()
        self.rounds[numbers] += 1
        grown = [self.structures[s] for s in np.unique(climbed[joined])]
        self._act(numbers, grown)
        has_ended = np.zeros(len(self.structures), np.bool_)
        has_ended[numbers] = [bool(self.structures[number].ended) for number in numbers]
        self.moving &= ~has_ended[self.structure_of]
        if self.believe and grown:
            self._update_beliefs(grown, self.believe)
        return int(joined.sum())

    def _admit_members(self, slots: NDArray[np.int32]) -> None:
        """Let robots that join, shape (k,), keep their memory, and what they believe so far."""
        members = self.members
        walks = self.walks
        number = self.structure_of[slots]
        place = (number, walks.joined[slots])
        stay = walks.stances.stay[slots]
        walks.believe(self.arrays, self.believed, slots, walks.stances.stay, walks.stances.stay)
        source = walks.sources(slots, stay)[:, 0]
        members.memory[place] = members.memory_of_climber[slots]
        members.joined_in[place] = members.rounds[number]
        members.goal[place] = walks.climbers.goal[slots]
        members.center[place] = walks.believed.center[slots, stay]
        members.orientation[place] = walks.believed.orientation[slots, stay]
        members.on_ground[place] = walks.stances.on_ground[slots, stay] != 0
        self.sd[place] = np.where(source >= 0, self.sd[number, source], 0.0)

    def _let_members_act(self, numbers: AnyInts) -> None:
        """Let the robots of some structures act by the rule, and note who leaves."""
        if not hasattr(self.rule, "act"):
            return
        members = self.members
        members.sensed[:] = self.sensed
        numbers = np.asarray(numbers)
        docks = self.walks.docks
        joints = self.frames.joints(numbers)
        ends = np.concatenate([joints, joints[:, ::-1]])
        place, dock = np.divmod(ends, self.robots * docks)
        robot, which = np.divmod(dock, docks)
        members.contacts = np.column_stack(
            [numbers[place[:, 0]], robot[:, 0], which[:, 0], robot[:, 1], which[:, 1]]
        )
        is_here = self.present != 0
        is_here &= np.arange(self.robots) < self.arrays.robot_count[:, None]
        self.leaves |= members.act(self.rule.act, numbers, is_here)

    def _act(self, numbers: AnyInts, grown: "Sequence[GrowingStructure]") -> None:
        """Let robots act, leave or die, then solve the structures that changed."""
        for number in numbers:
            self.structures[number].round = int(self.rounds[number]) - 1
        self._let_members_act(numbers)
        leavers = [self.structures[number] for number in numbers if self.leaves[number].any()]
        lost = [structure for structure in leavers if structure.leave(self.leaves)]
        if self.loses:
            lost += [structure for structure in grown if structure.lose()]
        self.leaves[numbers] = False
        self.loses |= len(lost) > 0
        self._list_remaining(lost)
        changed = {structure.number: structure for structure in (*grown, *lost)}
        due = [n for n, structure in changed.items() if structure.is_due(self.robots)]
        self.frames.solve(due)
        self._break([number for number in due if self.structures[number].params.strength])
        for number in due:
            self.structures[number].note_loads()
            call = self.structures[number].call
            sensed = self.structures[number].sensed
            self.call[number, : len(call)] = call
            self.sensed[number, : len(sensed)] = sensed
        self._pass_calls_on([*changed.values()])

    def _pass_calls_on(self, grown: "Sequence[GrowingStructure]") -> None:
        """Spread the calls of structures that grew."""
        # Structures share no contacts: one relay serves all that have the same rule.
        waiting = [structure.number for structure in grown]
        while waiting:
            rule = self.structures[waiting[0]].params.rule
            numbers = np.array([n for n in waiting if self.structures[n].params.rule == rule])
            waiting = [n for n in waiting if self.structures[n].params.rule != rule]
            call = self.call[numbers].ravel()
            mute = self.mute[numbers].ravel() if self.loses else None
            relayed = self.walks.pass_on(rule, call, self.frames.joints(numbers), mute)
            self.arrays.relay[numbers] = relayed.reshape(len(numbers), -1)

    def _break(self, due: Sequence[int]) -> None:
        """Break contacts that bear too much: the worst of each structure, until all hold."""
        torn = set[int]()
        breaking = [number for number in due if self.structures[number].break_worst()]
        while breaking:
            torn |= {*breaking}
            self.frames.solve([n for n in breaking if not self.structures[n].has_fallen])
            breaking = [n for n in breaking if self.structures[n].break_worst()]
        self._list_remaining([self.structures[number] for number in sorted(torn)])

    def _list_remaining(self, lost: "Sequence[GrowingStructure]") -> None:
        """List anew the robots of structures that lost some; climbers on these start again."""
        for structure in lost:
            number = structure.number
            present = ~self.frames.gone[number]
            self.present[number] = present
            self.mute[number] = ~structure.alive
            for slot in np.flatnonzero(self.moving & (self.structure_of == number)):
                self.moving[slot] = present[self.walks.touched(slot)].all()
        self._list(lost, *self.arrays.cells, self.arrays.dock)
        if self.believe:
            self._list(lost, *self.believed.cells, self.believed.dock)

    def _list(self, structures: "Sequence[GrowingStructure]", *docks: NDArray[Any]) -> None:
        """List anew the docks of some structures, given as in `BelievedDocks`."""
        if not structures:
            return
        chosen = np.array([structure.number for structure in structures], np.int32)
        dock_count = self.walks.docks * self.arrays.robot_count
        backend.processor()
        list_docks(self.walks.limits.inverse_edge, chosen, dock_count, self.present, *docks)

    def _update_beliefs(self, grown: "Sequence[GrowingStructure]", believe: "Believe") -> None:
        """Put the robots of structures that grew where they believe to be from now on."""
        cells, dock = self.believed
        for structure, belief in zip(grown, believe(grown), strict=True):
            offset = dock_offsets(belief.orientation_wxyz, self.robot.dock_offset_body)
            docks = (belief.center[:, None] + offset).reshape(-1, 3)
            joined = (structure.number, slice(len(belief.center)))
            dock[structure.number, : len(docks)] = docks
            self.sd[joined] = belief.sd
            self.members.center[joined] = belief.center
            self.members.orientation[joined] = belief.orientation_wxyz
            true = self.arrays.dock[structure.number, : len(docks)]
            error = (docks - true).reshape(-1, self.walks.docks, 3).mean(axis=1)
            note_belief(structure.walks, structure.history().contacts, error, belief.sent)
        self._list(grown, *cells, dock)


class DueStart(NamedTuple):
    """A robot that is to start in a structure, wherever there is room."""

    robot: int
    """Robots that started in the structure before."""

    side: int
    """Side that it comes from."""

    rim: float
    """Distance behind the edge, or from a tower's axis, beyond which it starts [R]."""

    anchor_place: Reals | None
    """Place of an anchor [R], shape (2,); None for all others."""

    patience: int
    """Steps without a new best with which it gives up."""

    settles: bool
    """Whether it turns, where it stays, until a third dock touches."""


Believe = Callable[[Sequence["GrowingStructure"]], Sequence[Belief]]
"""Returns what the robots of structures that have grown so far believe."""


class GrowingStructure:
    """One growing structure: who has joined, its loads, and the next spawn."""

    def __init__(
        self, number: int, seed: int, params: StructureParams, robot: RobotGeometry, frames: Frames
    ) -> None:
        self.number = number
        self.seed = seed
        self.params = params
        self.robot = robot
        self.frames = frames
        self.terrain = structure_ground(params)
        self.zones = structure_zones(params)
        self.side_of_body: dict[int, int] = {}
        if isinstance(self.terrain, SolidGround) and params.sides > 1:
            self.side_of_body = sides_of_bodies(params, robot)
        self.docks = robot.dock_count
        self.dock_offset_body = robot.dock_offset_body
        self.lowest = self.dock_offset_body[:, 2].min()
        self.level = self.terrain.ground_z + robot.dock_radius
        # A robot's center that is farther than this from a dock does not touch it.
        self.extent = robot.extent
        self.clearance = self.extent + robot.spacing
        self.leads = params.spawn_behind == "leading"
        self.anchors = anchor_places(params, robot)
        self.walks: list[Walk] = []
        self.loads: list[LoadSummary] = []
        self.sides: list[int] = []
        self.sides_of_feet: list[set[int]] = []
        self.sensed: Reals = np.empty(0)
        self.call: NDArray[np.int32] = np.empty(0, np.int32)
        self.alive = np.ones(frames.gone.shape[1], np.bool_)  # those to come are, too
        self.departures: list[tuple[int, int, int]] = []
        self.departure_rounds: list[int] = []
        self.round = 0  # in which robots act, leave and fall
        self.broken: list[tuple[int, int, int]] = []  # docks, and joins before
        self.has_fallen = False
        self.drawn = 0  # joins after which a departure has been drawn
        self.unsolved = 0  # joins since the mechanics were solved last
        self.spawned = 0
        self.rejected = 0  # robots in a row that found no place
        self.waited = 0  # rounds in a row in which robots waited and none joined
        self.crossed = False
        self.ended = ""
        self._forget()

    @property
    def founding(self) -> bool:
        """Whether the next robot may stay without touching another."""
        return len(self.walks) < self.params.founder_count

    def start(self, docks: Reals) -> DueStart:
        """Say how the next robot starts.

        Draws depend on the seed and the number of robots spawned before alone.

        Args:
            docks: Dock centers [R], those that have joined first, shape (n, 3).
        """
        self._survey(docks)
        params = self.params
        climb = params.climb
        joined = len(self.walks)
        index = self.spawned
        self.spawned += 1
        anchor_place = None
        if joined < len(self.anchors):
            anchor_place = self.anchors[joined]
        side = index % params.sides
        if self.founding:
            side = joined % params.sides
        rim = 0.0
        if self.walks:
            rim = max(0.0, self.rim[side] + self.robot.dock_radius)
        patience = 0
        settles = False
        if anchor_place is None:
            patience = climb.patience
            if climb.settle > 0.0 and not params.plane:
                settles = bool(uniform(self.seed, "settle", index, 0) < climb.settle)
        return DueStart(index, side, rim, anchor_place, patience, settles)

    def pose(self, start: DueStart, trial: int) -> tuple[Reals, Reals]:
        """Put a robot on its lowest docks, or upright on one in a plane, turned at random.

        Returns:
            Center [R], shape (3,), and orientation, body to world, shape (4,). On uneven ground the
            height of the center is not known yet.
        """
        draw = self._draw(start.robot, trial)
        if start.anchor_place is None:
            x, y = self.params.start(start.side, start.rim, draw[:2])
        else:
            x, y = start.anchor_place
        half = np.pi * draw[2]
        place = np.array([x, y, self.level])
        body = self.dock_offset_body
        if not self.params.plane:
            place[2] -= self.lowest
            return place, np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
        orientation = np.array([np.cos(half), 0.0, np.sin(half), 0.0])
        arm = dock_offsets(orientation[None], body)[0]
        return place - arm[arm[:, 2].argmin()], orientation

    def spawn(self, start: DueStart, center: Reals, orientation: Reals) -> Spawn:
        """Let a robot start at a free place [R], shape (3,), with an orientation, shape (4,)."""
        return Spawn(
            center=center,
            orientation_wxyz=orientation,
            goal=self.params.goal(start.side),
            patience=start.patience,
            settles=start.settles,
            robot=start.robot,
        )

    def note_crowd(self) -> None:
        """End growth, for all places drawn for a robot were taken."""
        joined = len(self.walks)
        self.ended = f"no free place to spawn robot {joined}; raise structure.spawn_max"

    def _draw(self, robot: int, trial: int) -> Reals:
        """Draw three numbers, which depend on no other draw; robots come one after the other."""
        if trial == robot % _DRAWN == 0:
            robots = robot + np.arange(_DRAWN)[:, None]
            self.first_draws = uniform(self.seed, "spawn", robots, np.arange(3))
        # Numbered by robot and trial: no draw depends on how many others were made.
        draw: Reals = self.first_draws[robot % _DRAWN]
        if trial:
            draw = uniform(self.seed, "spawn", robot, 3 * trial + np.arange(3))
        return draw

    def _survey(self, docks: Reals) -> None:
        """Note where the robots stand that have joined since the last spawn."""
        surveyed = self.surveyed // self.docks
        if surveyed == len(self.walks):
            return
        is_gone = self.frames.gone[self.number, surveyed : len(self.walks)]
        is_new = np.repeat(~is_gone, self.docks)
        new = docks[self.surveyed : self.docks * len(self.walks)][is_new]
        if not len(new):
            return
        skipped = 0
        if self.params.spawn_behind == "placed":
            skipped = max(0, self.docks * self.params.anchor_count - self.surveyed)
        self.surveyed += len(is_new)
        for side, rim in enumerate(self.rim):
            behind = [rim, *self.params.behind(side, new[skipped:]).tolist()]
            if self.leads:
                self.rim[side] = min(behind)
            else:
                self.rim[side] = max(behind)
        # Robots spawn on the ground: docks higher than they are stand in nobody's way.
        is_low = np.abs(new[:, 2] - self.level) <= self.clearance + self.extent
        if isinstance(self.terrain, SolidGround):
            is_low[:] = True  # ground of any height may be below them
        for dock in new[is_low]:
            # A grid as wide as the clearance: all that is near lies in one of nine squares.
            self.low_docks.setdefault(self._square(dock), []).append(dock)

    def _forget(self) -> None:
        """Forget where robots stand, to survey those that are left."""
        self.surveyed = 0
        first_rim = np.inf if self.leads else -self.robot.dock_radius
        self.rim = [first_rim for _ in range(self.params.sides)]
        self.low_docks: dict[tuple[int, int], list[Reals]] = {}

    def is_free(self, center: Reals, orientation: Reals) -> bool:
        """Whether a robot may be put somewhere: on ground, in no zone, and touching no dock."""
        if not np.isfinite(center[2]):
            return False
        if self.zones is not None:
            dock = center + dock_offsets(orientation[None], self.dock_offset_body)[0]
            if self.zones.depth(dock, self.robot.dock_radius).max() > 0.0:
                return False
        x, y = self._square(center)
        squares = [(x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        near = [dock for square in squares for dock in self.low_docks.get(square, ())]
        return not near or bool(
            np.linalg.norm(np.array(near) - center, axis=1).min() > self.clearance
        )

    def _square(self, place: Reals) -> tuple[int, int]:
        """Square of the ground below a place; its side is the clearance."""
        return int(place[0] // self.clearance), int(place[1] // self.clearance)

    def wait(self) -> None:
        """Count a round in which robots waited and none joined; end growth after too many."""
        self.waited += 1
        if self.waited >= self.params.climb.max_spawns:
            problem = f"robots waited for {self.waited} rounds, and none joined"
            self.ended = f"{problem}; raise structure.climb.max_spawns, or let them stay"

    def turn_away(self) -> None:
        """Count a robot that found no place; end growth after too many in a row."""
        self.rejected += 1
        if self.rejected >= self.params.climb.max_spawns:
            rule = self.params.rule
            fix = f"correct the rule {rule.name}"
            if isinstance(rule, ReactiveBuild):
                fix = "move the goal"
            problem = f"{self.rejected} robots in a row reached no other robot"
            self.ended = f"{problem}; raise structure.climb.max_spawns or {fix}"

    def join(self, walk: Walk, docks: Reals) -> None:
        """Make a robot part of the structure; `docks` are the structure's [R], shape (n, 3)."""
        j = len(self.walks)
        self.rejected = 0
        self.waited = 0
        self.walks.append(walk)
        joining_dock, touched_robot, touched_dock = walk.at_rest(walk.contacts).T
        ends = [self.docks * touched_robot + touched_dock, self.docks * j + joining_dock]
        contacts = np.array(ends).T
        feet = np.concatenate([walk.ground_docks, walk.edge_docks])
        standing = self.docks * j + walk.at_rest(feet)[:, 0]
        self.frames.join(
            self.number,
            walk.center[-1],
            docks[self.docks * j : self.docks * (j + 1)],
            contacts,
            standing,
            self.terrain.foot(docks[standing]) if len(standing) else docks[:0],
        )
        self.unsolved += 1
        self.loads.append(LoadSummary())
        if self.params.sides > 1:
            touched = {self.sides[i] for i in touched_robot}
            of_feet = self._sides_at(docks[standing])
            self.sides_of_feet.append(of_feet)
            touched |= of_feet
            # A robot counts for the left side if it touches both; the gap is bridged then.
            self.sides.append(min(touched))
            if len(touched) > 1:
                self.crossed = True
                self.ended = f"the gap is bridged by {j + 1} robots"

    def _sides_at(self, docks: Reals) -> set[int]:
        """List the sides whose ground docks stand on, shape (n, 3)."""
        if isinstance(self.terrain, SolidGround):
            bodies = self.terrain.body_at(docks).tolist() if len(docks) else []
            return {self.side_of_body[body] for body in bodies if body in self.side_of_body}
        return {int(x > 0.5 * self.terrain.right_edge) for x in docks[:, 0]}

    def lose(self) -> bool:
        """Let robots leave or die, by a draw for each new joiner; return whether any did."""
        params = self.params.departures
        joined = len(self.walks)
        departures_before = len(self.departures)
        drawn = self.drawn
        self.drawn = joined
        if params is None or self.ended:
            return False
        event = LEFT if params.kind == "leave" else DIED
        for joiner in range(drawn, joined):
            able = np.flatnonzero(self.alive[:joined])
            robot = params.drawn(self.seed, joiner, able[able >= self.params.founder_count])
            if robot is not None:
                self.alive[robot] = False
                self._note_departures([robot], event)
        if len(self.departures) == departures_before:
            return False
        self._part(is_leaving=params.kind == "leave")
        return True

    def leave(self, leaves: Bools) -> bool:
        """Let robots leave of their own accord, shape (S, N); return whether any did.

        Founders stay, and so do robots that have died.
        """
        joined = len(self.walks)
        leavers = np.flatnonzero(leaves[self.number, :joined] & self.alive[:joined])
        leavers = leavers[leavers >= self.params.founder_count]
        self._note_departures(leavers.tolist(), LEFT)
        self.alive[leavers] = False
        if len(leavers):
            self._part(is_leaving=True)
        return len(leavers) > 0

    def _note_departures(self, robots: Sequence[int], event: int) -> None:
        """Note that robots left, fell or died in this round."""
        self.departures += [(robot, len(self.walks), event) for robot in robots]
        self.departure_rounds += [self.round for _ in robots]

    def _part(self, *, is_leaving: bool) -> None:
        """Take robots that have left, and those that nothing holds without them, away."""
        joined = len(self.walks)
        if is_leaving:
            fallen = np.flatnonzero(self.alive[:joined] & ~self.history().is_held)
            self._note_departures(fallen.tolist(), FELL)
            self.alive[fallen] = False
            gone = [robot for robot, _, event in self.departures if event != DIED]
            self.frames.remove(self.number, np.unique(gone))
            self._forget()
        self.unsolved += self.params.solve_every  # the mechanics are due

    def break_worst(self) -> bool:
        """Break the contact that is farthest over its strength, and let robots fall.

        Returns:
            Whether one broke; the mechanics are due then, unless the whole structure fell.
        """
        strength = self.params.strength
        if strength is None or self.has_fallen or self.frames.has_fallen(self.number):
            return False
        ends, loads = self.frames.contact_loads(self.number)
        used = self._used(strength, ends, loads)
        if not (used > 1.0).any():
            return False
        worst = int(np.argmax(used))
        self.broken.append((int(ends[worst, 0]), int(ends[worst, 1]), len(self.walks)))
        self.frames.part(self.number, ends[worst])
        self._let_fall(np.delete(ends, worst, axis=0))
        return True

    def _used(self, strength: StrengthParams, ends: AnyInts, loads: ContactLoads) -> Reals:
        """Return the load of each contact in parts of its strength [1], 0 of feet that rest."""
        used = strength.used(self.seed, ends, loads, self.docks)
        if self.frames.rests:
            used[ends[:, 1] < 0] = 0.0
        return used

    def _let_fall(self, ends: AnyInts) -> None:
        """Let robots fall that no contact, rows of (dock, dock or -1), ties to the ground."""
        joined = len(self.walks)
        robots = np.where(ends < 0, joined, ends // self.docks)  # the ground comes after all robots
        part = parts(robots, joined + 1)
        falls = (part[:joined] != part[joined]) & ~self.frames.gone[self.number, :joined]
        if falls[: self.params.anchor_count].any():
            self.has_fallen = True
            self.ended = f"the structure fell once robot {joined - 1} had joined"
        falls[: self.params.anchor_count] = False  # places that all know: anchors stay there
        fallen = np.flatnonzero(falls)
        self._note_departures(fallen.tolist(), FELL)
        self.alive[fallen] = False
        if len(fallen):
            self.frames.remove(self.number, fallen)
            self._forget()
        if self.params.sides > 1:
            self._renew_sides(robots)

    def _renew_sides(self, pairs: AnyInts) -> None:
        """Find which sides the parts of a torn bridge reach, and whether one still joins both.

        Args:
            pairs: Robots that touch, or the ground as a robot after all others, shape (C, 2).
        """
        joined = len(self.walks)
        stands = pairs[:, 1] == joined
        part = parts(pairs[~stands], joined)
        sides_of_part: dict[int, set[int]] = {}
        for robot in np.unique(pairs[stands, 0]).tolist():
            sides_of_part.setdefault(int(part[robot]), set()).update(self.sides_of_feet[robot])
        self.sides = [min(sides_of_part.get(int(number), {0})) for number in part]
        is_bridged = any(len(sides) > 1 for sides in sides_of_part.values())
        if self.crossed and not is_bridged:
            self.crossed = False
            self.ended = ""

    def is_due(self, robots: int) -> bool:
        """Whether its mechanics are due; in any case at the last join, that of so many robots."""
        is_last = len(self.walks) == robots or bool(self.ended)
        return is_last or self.unsolved >= self.params.solve_every

    def note_loads(self) -> None:
        """Note what the last solve of its mechanics found, and who calls for help."""
        loads = None
        if not self.has_fallen:
            try:
                loads = self.frames.loads(self.number)
            except StructureFailure as failure:
                self.ended = str(failure)
                self.crossed = False
        if loads is None:
            self.sensed = np.full(len(self.walks), np.nan)
            self.call = np.zeros(len(self.walks), np.int32)
            return
        self.unsolved = 0
        alive = self.alive[: len(loads.sensed)]
        self.sensed = np.where(alive, loads.sensed, np.nan)
        call = getattr(self.params.rule, "call", recruit)
        self.call = call(np.where(alive, loads.sensed, 0.0), self.params)
        self.loads[-1] = LoadSummary(
            peak=loads.peak,
            sensed_max=float(np.fmax.reduce(self.sensed)),
            calling=int(np.count_nonzero(self.call)),
            least_support=float((-loads.ground_force @ self.frames.down).min(initial=np.inf)),
            imbalance=loads.imbalance,
        )

    def _loaded(self) -> tuple[NDArray[np.int32], Reals]:
        """Return contacts with their loads as in `History`; none unless the last join is solved."""
        if self.unsolved or self.has_fallen:
            return np.empty((0, 4), np.int32), np.empty((0, 6))
        ends, loads = self.frames.contact_loads(self.number)
        used = np.full(len(ends), np.nan)
        if self.params.strength is not None:
            used[:] = self._used(self.params.strength, ends, loads)
        return self._named(ends), np.column_stack([*loads, used])

    def _named(self, ends: AnyInts) -> NDArray[np.int32]:
        """Name ends of contacts, rows of (dock, dock or -1), by robot and dock, shape (C, 4)."""
        robot, dock = np.divmod(ends, self.docks)
        dock[ends < 0] = -1
        named: NDArray[np.int32] = np.column_stack([robot, dock])[:, [0, 2, 1, 3]].astype(np.int32)
        return named

    def history(self) -> History:
        """Return the history of the structure."""
        broken = np.array(self.broken, np.int32).reshape(-1, 3)
        loaded_contacts, contact_load = self._loaded()
        return History(
            seed=self.seed,
            robot=self.robot,
            terrain=self.terrain,
            walks=tuple(self.walks),
            anchors=self.params.anchor_count,
            spawns=self.spawned,
            loads=tuple(self.loads),
            sensed=self.sensed,
            broken=np.column_stack([self._named(broken[:, :2]), broken[:, 2]]),
            loaded_contacts=loaded_contacts,
            contact_load=contact_load,
            departures=np.array(self.departures, np.int32).reshape(-1, 3),
            departure_round=np.array(self.departure_rounds, np.int32),
            may_lose=self.params.may_lose,
            crossed=self.crossed,
            ended=self.ended,
            stability=self.frames.stability[self.number],
        )
