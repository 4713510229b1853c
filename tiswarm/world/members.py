"""What robots keep and say to each other while a structure grows, and what each may know.

A rule may give robots a memory and messages. In every round each robot that has joined acts by what
it senses, remembers and hears from the robots that it touches; what it says is heard a round later.
Numbers said are counted in bytes, once for each contact that they cross.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.compute.math import uniform
from tiswarm.world.choices import ClimbStep

BYTES = 8
"""Bytes of a number that a robot sends."""

LOCAL = frozenset(
    {
        "stance",
        "center",
        "orientation_wxyz",
        "walk",
        "goal",
        "patience",
        "touching",
        "on_ground",
        "called",
        "angle",
        "possible",
        "end",
        "end_orientation_wxyz",
        "visited",
        "end_touching",
        "end_on_ground",
        "end_called",
        "memory",
        "heard",
        "failed",
        "tries",
        "walk_tries",
        "touched_dock",
        "touched_sd",
        "sd",
        "end_sd",
    }
)
"""What a climber knows of itself: it senses what it touches, and what its flips would meet."""


class LocalStep:
    """What climbers of a local rule see: each its own senses, memory, and what it hears.

    It has a part of what a `ClimbStep` has, in the same shapes. Robots that a climber does not
    touch are absent, but for what its flips meet.
    """

    def __init__(self, step: ClimbStep, rows: AnyInts | None = None) -> None:
        """Take what all climbers see, or some of them, shape (m,)."""
        self._step = step
        self._rows = np.arange(len(step.stance)) if rows is None else rows
        self.pivot: AnyInts = step.pivot
        """Dock about which each flip turns, shape (K,)."""
        self.memory: Reals = step.memory[self._rows]
        """Numbers that each robot keeps; those that it writes stay, shape (m, W)."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - arrays of any type
        """Return what each climber knows of itself.

        Raises:
            AttributeError: it does not know that.
        """
        if name not in LOCAL:
            seen = ", ".join(sorted(LOCAL | {"pivot"}))
            problem = f"a climber of a local rule does not know {name}; it knows {seen}"
            raise AttributeError(problem)
        return getattr(self._step, name)[self._rows]

    def uniform(self, stream: str, count: int) -> Reals:
        """Draw numbers in [0, 1), shape (m, count); see `ClimbStep.uniform`."""
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
        self._step.memory[self._rows] = self.memory


class Members:
    """What P robots that have joined see in a round: each its own senses, memory, and messages."""

    def __init__(self, arrays: "MemberArrays", numbers: AnyInts, robots: AnyInts) -> None:
        """Take the arrays of all structures, and which robots act, both of shape (P,)."""
        self._seed = arrays.seed[numbers]
        self._round = arrays.rounds[numbers]
        self._robot = robots
        place = (numbers, robots)
        self.age: AnyInts = arrays.rounds[numbers] - arrays.joined_in[place]
        """Rounds since each joined, shape (P,)."""
        self.goal: Reals = arrays.goal[place]
        """What each climbed toward [R], shape (P, 3)."""
        self.center: Reals = arrays.center[place]
        """Its center [R], shape (P, 3)."""
        self.orientation_wxyz: Reals = arrays.orientation[place]
        """Its orientation, body to world, shape (P, 4)."""
        self.sd: Reals = arrays.sd[place]
        """Standard deviation of its place [R], 0 where robots know the truth, shape (P,)."""
        self.sensed: Reals = arrays.sensed[place]
        """Load that it sensed at the last solve [weight of a dock], shape (P,)."""
        self.on_ground: Bools = arrays.on_ground[place]
        """Whether each of its docks stands on the ground, shape (P, n)."""
        self.memory: Reals = arrays.memory[place]
        """Numbers that it keeps; those that it writes stay, shape (P, W)."""
        row_of = np.full(arrays.memory.shape[:2], -1)
        row_of[place] = np.arange(len(robots))
        structure, *ends = arrays.contacts.T
        row = row_of[structure, ends[0]]
        acts = row >= 0
        self.contacts: AnyInts = np.column_stack([row, *ends[1:]])[acts]
        """Rows (robot of these, its dock, neighbor's number, neighbor's dock), shape (C, 4)."""
        self.heard: Reals = arrays.said[structure, ends[2], ends[3]][acts]
        """Message of the round before that came by each contact, or NaN, shape (C, B)."""
        self.say: Reals = np.full((len(robots), *arrays.said.shape[2:]), np.nan)
        """Message to the docks that touch each of its docks; NaN for none, shape (P, n, B)."""
        self.shape_of = {"memory": self.memory.shape, "say": self.say.shape}
        """Shapes of what robots write."""

    def uniform(self, stream: str, count: int) -> Reals:
        """Draw numbers in [0, 1), shape (P, count), by seed, stream, robot and round alone."""
        draw = (self._round.astype(np.int64) << 16)[:, None] + np.arange(count)
        return uniform(self._seed[:, None], stream, self._robot[:, None], draw)


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
