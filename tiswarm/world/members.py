"""What robots keep and say to each other while a structure grows, and what each may know.

A rule may give robots a memory and messages. In every round each robot that has joined acts by what
it senses, remembers and hears from the robots that it touches; what it says is heard a round later.
Numbers said are counted in bytes, once for each contact that they cross.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.compute.math import uniform
from tiswarm.world.choices import ClimbStep, Rewritable, attributes_of, rewrite

BYTES = 8
"""Bytes of a number that a robot sends."""

LOCAL: Mapping[str, str] = {
    "stance": "Flips that each has taken: number of its current stance, shape (M,).",
    "center": "Its center [R], shape (M, 3).",
    "orientation_wxyz": "Its orientation, body to world, shape (M, 4).",
    "goal": "What it climbs toward [R], shape (M, 3).",
    "patience": "`structure.climb.patience` of each, shape (M,).",
    "walk": "Centers of its stances up to the current one, then NaN [R], (M, most stances, 3).",
    "walk_tries": "Flips tried by the time it came to each stance of `walk`, (M, most stances).",
    "tries": "Flips that it has tried so far, failed ones included, shape (M,).",
    "touching": "Docks n i + k that its docks touch, or -1, shape (M, n, MAX_TOUCHING).",
    "on_ground": "Ground below its docks: flat 1, an edge 2, else 0, shape (M, n).",
    "called": "Whether it touches a dock that passes a call on, shape (M,).",
    "touched_dock": "Center of the dock that each dock touches [R], or NaN, shape (M, n, 3).",
    "touched_sd": "Standard deviation of the place of the robot that a dock touches [R], (M, n).",
    "sd": "Standard deviation of its place, over all three axes [R], shape (M,).",
    "heard": "Last message of the dock that each dock touches, or NaN, shape (M, n, B).",
    "angle": "Angle of each flip [rad], negative if backward, 0 if there is none, shape (M, K).",
    "possible": "Which flips there are, shape (M, K).",
    "failed": "Which flips it has tried in vain from its stance, shape (M, K).",
    "visited": "Whether its walk has been where a flip ends, shape (M, K).",
    "end": "Centers where flips end [R], meaningless where there is none, shape (M, K, 3).",
    "end_orientation_wxyz": "Orientations where flips end, shape (M, K, 4).",
    "end_sd": "Standard deviation of the place where each flip ends [R], shape (M, K).",
    "end_touching": "As `touching`, where flips end, shape (M, K, n, MAX_TOUCHING).",
    "end_on_ground": "As `on_ground`, where flips end, shape (M, K, n).",
    "end_called": "Whether a dock with a call is touched where a flip ends, shape (M, K).",
}
"""What a climber knows of itself, with its memory: it senses what it touches, and what its flips
would meet."""


JOINED: Mapping[str, str] = {
    "robot": "Its number, by which `contacts` of others name it: robots that joined before, (P,).",
    "age": "Rounds since each joined, shape (P,).",
    "goal": "What each climbed toward [R], shape (P, 3).",
    "center": "Its center [R], shape (P, 3).",
    "orientation_wxyz": "Its orientation, body to world, shape (P, 4).",
    "sd": "Standard deviation of its place [R], 0 where robots know the truth, shape (P,).",
    "sensed": "Load that it sensed at the last solve [weight of a dock], shape (P,).",
    "on_ground": "Whether each of its docks stands on the ground, shape (P, n).",
    "contacts": "Rows (robot of these, its dock, neighbor's number, neighbor's dock), (C, 4).",
    "heard": "Message of the round before that came by each contact, or NaN, shape (C, B).",
}
"""What a robot that has joined knows of itself, with its memory, and what it may say."""


class LocalStep(Rewritable):
    """What M climbers of a local rule see, each with K flips about n docks.

    Each has its own senses, memory, and what it hears: a part of what a `ClimbStep` has, in the
    same shapes. Robots that a climber does not touch are absent, but for what its flips meet. It
    writes `memory`, and says nothing: only robots that have joined send messages.
    """

    _writable = ("memory",)

    def __init__(self, step: ClimbStep, rows: AnyInts | None = None) -> None:
        """Take what all climbers see, or some of them, shape (m,)."""
        self._step = step
        self._rows = np.arange(len(step.stance)) if rows is None else rows
        self._memory: Reals = step.memory[self._rows]

    @property
    def memory(self) -> Reals:
        """Numbers that each robot keeps, 0 as it starts; those that it writes stay, (M, W)."""
        return self._memory

    @memory.setter
    def memory(self, values: Reals) -> None:
        rewrite(self._memory, values, "step.memory")

    @property
    def pivot(self) -> AnyInts:
        """Dock about which each flip turns, shape (K,)."""
        return self._step.pivot

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - arrays of any type
        """Refuse what a climber does not know.

        Raises:
            AttributeError: always.
        """
        if name.startswith("__"):
            raise AttributeError(name)
        seen = ", ".join(attributes_of(self))
        problem = f"a climber of a local rule does not know {name}; it knows {seen}"
        raise AttributeError(problem)

    def uniform(self, stream: str, count: int) -> Reals:
        """Draw numbers in [0, 1), shape (M, count); see `ClimbStep.uniform`."""
        return self._step.uniform(stream, count)[self._rows]

    def back(self, stance: AnyInts | int) -> AnyInts:
        """Return the choice to go back to a stance; see `ClimbStep.back`."""
        return self._step.back(stance)

    @property
    def wait(self) -> int:
        """The choice to wait; see `ClimbStep.wait`."""
        return self._step.wait

    def remember(self) -> None:
        """Keep what rows of the memory were set to."""
        self._step.memory[self._rows] = self._memory


def _of_climbers(name: str, meaning: str) -> property:
    """Return a property of a `LocalStep`: the rows of its climbers."""

    def rows(step: LocalStep) -> Any:  # noqa: ANN401 - arrays of any type
        return getattr(step._step, name)[step._rows]  # noqa: SLF001 - of this module

    return property(rows, doc=meaning)


for _name, _meaning in LOCAL.items():
    setattr(LocalStep, _name, _of_climbers(_name, _meaning))


class Members(Rewritable):
    """What P robots that have joined see in a round: each its own senses, memory, and messages.

    Robots have n docks, and C contacts with each other. They write `memory` and `say`.
    """

    _writable = ("memory", "say")

    def __init__(self, arrays: "MemberArrays", numbers: AnyInts, robots: AnyInts) -> None:
        """Take the arrays of all structures, and which robots act, both of shape (P,)."""
        self._seed = arrays.seed[numbers]
        self._round = arrays.rounds[numbers]
        self._robot = robots
        place = (numbers, robots)
        self._age: AnyInts = arrays.rounds[numbers] - arrays.joined_in[place]
        self._goal: Reals = arrays.goal[place]
        self._center: Reals = arrays.center[place]
        self._orientation_wxyz: Reals = arrays.orientation[place]
        self._sd: Reals = arrays.sd[place]
        self._sensed: Reals = arrays.sensed[place]
        self._on_ground: Bools = arrays.on_ground[place]
        self._memory: Reals = arrays.memory[place]
        row_of = np.full(arrays.memory.shape[:2], -1)
        row_of[place] = np.arange(len(robots))
        structure, *ends = arrays.contacts.T
        row = row_of[structure, ends[0]]
        acts = row >= 0
        self._contacts: AnyInts = np.column_stack([row, *ends[1:]])[acts]
        self._heard: Reals = arrays.said[structure, ends[2], ends[3]][acts]
        self._say: Reals = np.full((len(robots), *arrays.said.shape[2:]), np.nan)

    @property
    def memory(self) -> Reals:
        """Numbers that it keeps, as it took them along; those that it writes stay, shape (P, W)."""
        return self._memory

    @memory.setter
    def memory(self, values: Reals) -> None:
        rewrite(self._memory, values, "members.memory")

    @property
    def say(self) -> Reals:
        """Message to all docks that touch each of its docks; NaN for nothing, shape (P, n, B)."""
        return self._say

    @say.setter
    def say(self, values: Reals) -> None:
        rewrite(self._say, values, "members.say")

    def alone(self, row: int) -> "Members":
        """Return a copy of what one of the robots sees: a round in which no other robot acts."""
        one = Members.__new__(Members)
        by_contact = self._contacts[:, 0] == row
        for name, values in vars(self).items():
            of_one = values[row : row + 1]
            if name in {"_contacts", "_heard"}:
                of_one = values[by_contact]
            setattr(one, name, of_one.copy())
        one._contacts[:, 0] = 0  # noqa: SLF001 - of this class
        return one

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - arrays of any type
        """Refuse what a robot does not know.

        Raises:
            AttributeError: always.
        """
        if name.startswith("__"):
            raise AttributeError(name)
        seen = ", ".join(attributes_of(self))
        raise AttributeError(f"a robot that has joined does not know {name}; it knows {seen}")

    def uniform(self, stream: str, count: int) -> Reals:
        """Draw numbers in [0, 1), shape (P, count), by seed, stream, robot and round alone."""
        draw = (self._round.astype(np.int64) << 16)[:, None] + np.arange(count)
        return uniform(self._seed[:, None], stream, self._robot[:, None], draw)


def _of_members(name: str, meaning: str) -> property:
    """Return a property of `Members`."""
    return property(lambda members: getattr(members, f"_{name}"), doc=meaning)


for _name, _meaning in JOINED.items():
    setattr(Members, _name, _of_members(_name, _meaning))


class MemberArrays:
    """State of the robots of S structures with room for N robots of n docks each."""

    def __init__(self, rule: Any, *, structures: int, robots: int, slots: int, docks: int) -> None:  # noqa: ANN401
        """Reserve room for what a rule lets robots keep and say."""
        shape = (structures, robots)
        words = int(getattr(rule, "memory", 0))
        said = int(getattr(rule, "message", 0))
        self.seed = np.zeros(structures, np.uint64)
        self.rounds = np.zeros(structures, np.int64)
        self.joined_in = np.zeros(shape, np.int64)
        self.goal = np.zeros((*shape, 3))
        self.center = np.zeros((*shape, 3))
        self.orientation = np.zeros((*shape, 4))
        self.sd = np.zeros(shape)
        self.sensed = np.zeros(shape)
        self.on_ground = np.zeros((*shape, docks), np.bool_)
        self.memory = np.zeros((*shape, words))
        self.memory_of_climber = np.zeros((slots, words))
        self.said = np.full((*shape, docks, said), np.nan)
        self.sent = np.zeros(shape, np.int64)
        """Bytes that each robot has sent, shape (S, N)."""
        self.contacts: Ints = np.empty((0, 5), np.int64)
        """Rows (structure, robot, dock, robot, dock), both ways, of those that act."""

    def clear(self, structures: AnyInts, seeds: Sequence[int]) -> None:
        """Forget all of structures, shape (n,), which begin anew from seeds."""
        self.seed[structures] = seeds
        self.rounds[structures] = 0
        self.memory[structures] = 0.0
        self.said[structures] = np.nan
        self.sent[structures] = 0
        self.on_ground[structures] = False

    def act(self, act: Callable[[Members], object], numbers: AnyInts, present: Bools) -> Bools:
        """Let robots of some structures act, once.

        Args:
            act: What a robot does; returns who leaves, shape (P,), or None.
            numbers: Structures, shape (k,).
            present: Whether each robot is there, shape (S, N).

        Returns:
            Who leaves, shape (S, N).
        """
        among = np.zeros_like(present)
        among[numbers] = present[numbers]
        structure, robot = np.nonzero(among)
        members = Members(self, structure, robot)
        leaving = np.zeros_like(present)
        chosen = act(members)
        if chosen is not None:
            leaving[structure, robot] = np.asarray(chosen)
        self.memory[structure, robot] = members.memory
        self.said[structure, robot] = members.say
        row, dock, *_ = members.contacts.T
        crossing = np.isfinite(members.say[row, dock]).sum(axis=1)
        np.add.at(self.sent, (structure[row], robot[row]), BYTES * crossing)
        self.rounds[numbers] += 1
        return leaving
