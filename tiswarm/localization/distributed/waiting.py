"""Tasks of a robot: coroutines that wait for what robots send, or for time to pass.

A task is a generator. It yields what it waits for, and goes on with what came of that: the content
of a message with its sender, or a `Timeout`. A robot waits for one thing of each sort at a time:
once a task begins to wait for answers, the one that waited for answers before is dropped.
"""

import math
from collections.abc import Collection, Generator
from dataclasses import dataclass

from tiswarm.localization.distributed.messages import Content


@dataclass(frozen=True)
class Answers:
    """Wait for answers to questions."""

    near: Collection[int]
    """Robots that the task needs: their lines are not to be dropped."""


@dataclass(frozen=True)
class Return:
    """Wait until a walk returns."""

    child: int
    """Robot that it is with."""


@dataclass(frozen=True)
class WhenPlaced:
    """Wait for a place."""


@dataclass(frozen=True)
class Heard:
    """A message came that the task waits for."""

    sender: int
    content: Content


@dataclass(frozen=True)
class Timeout:
    """Nothing came."""

    is_last: bool
    """Whether to go on without: what the task waits for was repeated as often as it may be."""


Wait = Answers | Return | WhenPlaced
Event = Heard | Timeout | None
Task = Generator[Wait, Event, None]
"""What a robot does in several steps."""


class Tasks:
    """The tasks of a robot that wait, at most one for each sort of wait."""

    def __init__(self) -> None:
        """Begin without tasks."""
        self._waiting: dict[type[Wait], tuple[Wait, Task]] = {}

    def start(self, task: Task) -> None:
        """Run a task until it waits or ends."""
        self._resume(task, None)

    def wake(self, sort: type[Wait], event: Event) -> None:
        """Let the task that waits for something go on, if there is one."""
        if sort in self._waiting:
            _, task = self._waiting.pop(sort)
            self._resume(task, event)

    def drop(self, sort: type[Wait]) -> None:
        """Drop the task that waits for something, if there is one."""
        if sort in self._waiting:
            _, task = self._waiting.pop(sort)
            task.close()

    @property
    def answers(self) -> Answers | None:
        """What the task that waits for answers needs."""
        wait, _ = self._waiting.get(Answers, (None, None))
        return wait if isinstance(wait, Answers) else None

    @property
    def visited(self) -> int | None:
        """Robot from which a walk is to return."""
        wait, _ = self._waiting.get(Return, (None, None))
        return wait.child if isinstance(wait, Return) else None

    @property
    def next_sort(self) -> type[Wait] | None:
        """Sort of wait whose time runs out first: answers, then a walk, then a place."""
        return next((sort for sort in (Answers, Return, WhenPlaced) if sort in self._waiting), None)

    @property
    def next_wait(self) -> Wait | None:
        """The wait whose time runs out first."""
        sort = self.next_sort
        return None if sort is None else self._waiting[sort][0]

    def _resume(self, task: Task, event: Event) -> None:
        try:
            wait = next(task) if event is None else task.send(event)
        except StopIteration:
            return
        self.drop(type(wait))
        self._waiting[type(wait)] = wait, task


class Timers:
    """When robots go on without what they wait for: after some rounds, or as nothing can come."""

    def __init__(self, rounds: int | None) -> None:
        """Begin without robots that wait.

        Args:
            rounds: Rounds for which a robot waits; None if it does until nothing can come.
        """
        self._rounds = rounds
        self._due: dict[int, tuple[Wait, int]] = {}

    def set(self, robot: int, wait: Wait | None, now: int) -> None:
        """Let the time of a robot begin as it begins to wait, and end as it waits for nothing.

        Args:
            robot: Its number.
            wait: What it waits for whose time runs out first.
            now: Number of the round.
        """
        last, _ = self._due.get(robot, (None, 0))
        if wait is None or self._rounds is None:
            self._due.pop(robot, None)
        elif wait is not last:
            self._due[robot] = wait, now + self._rounds

    @property
    def first(self) -> float:
        """Number of the round in which the time of a robot runs out first; infinity if of none."""
        return min((due for _, due in self._due.values()), default=math.inf)

    def has_run_out(self, robot: int, now: int) -> bool:
        """Return whether the time of a robot that waits is over; without timers it is."""
        return self._rounds is None or self._due[robot][1] <= now
