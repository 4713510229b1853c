"""How messages travel: by radio to all robots, or by touch from robot to robot.

A message has parts, each for one robot. By touch it takes shortest ways along contacts; where ways
part, each branch carries the parts of the robots behind it. By radio one transmission reaches all
robots. Who passes a message on, or is in reach of it, hears it. Transmissions take a round and
`delay` more. Who was to receive one acknowledges it; without an answer it is sent again.

Losses and the order of events depend on the seed and on numbers of messages and robots alone.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import uniform
from tiswarm.parts.between import DistributedParams
from tiswarm.parts.between.wire import MOST_ROBOTS

HEADER = 4
"""Bytes before the parts of a message: its kind, sender, number and length."""

ADDRESS = 2
"""Bytes before each part: its robot, and the length of the part."""

ACKNOWLEDGMENT = 3
"""Bytes of an acknowledgment: the number of the message and its robot."""


class Message(NamedTuple):
    """What a robot sends."""

    kind: str
    """Name of what it is about."""

    sender: int
    """Number of the robot."""

    common: bytes
    """Content for all who hear it."""

    parts: Mapping[int, bytes]
    """Content for each receiver, by its number."""


Hear = Callable[[int, Message], Message]
"""Gives a robot a message, with those parts of it that passed by; returns what it passes on."""


@dataclass
class _Hop:
    """A transmission under way."""

    serial: int
    """Number of the message."""

    message: Message
    sender: int
    """Peer that transmits."""

    tree: Mapping[int, list[int]]
    """By robot, those that it passes the message on to."""

    next: list[int]
    """Robots that are to hear this transmission."""

    attempt: int = 0
    acknowledged: set[int] = field(default_factory=set)


class Channel:
    """The swarm's channel, with what each robot sent and heard."""

    def __init__(self, params: DistributedParams, hear: Hear) -> None:
        """Begin without robots.

        Args:
            params: Settings.
            hear: Called with each robot that hears a message.
        """
        self._params, self._hear = params, hear
        self._links: list[set[int]] = []
        self._events: dict[int, list[tuple[int, Callable[[], None]]]] = {}
        self._round, self._serial, self._drawn = 0, 0, 0
        self.sent: list[int] = []
        """Bytes that each robot transmitted, by its number."""
        self.heard: list[int] = []
        """Bytes that each robot heard."""
        self.messages: list[int] = []
        """Transmissions of each robot."""
        self._had: set[tuple[int, int]] = set()

    def traffic(self, memory: Ints, operations: Reals) -> dict[str, Reals]:
        """List what localization cost each robot, as `Estimate.traffic` has it."""
        counted = {
            "sent": self.sent,
            "heard": self.heard,
            "messages": self.messages,
            "memory": memory,
            "operations": operations,
            "rounds": np.full(len(self.sent), self.rounds),
        }
        return {name: np.asarray(count, np.float64) for name, count in counted.items()}

    @property
    def rounds(self) -> int:
        """Rounds in which a message was under way."""
        return self._round

    def join(self, touching: set[int]) -> None:
        """Add the next robot, with those that it touches."""
        number = len(self._links)
        self._links.append(set(touching))
        for count in (self.sent, self.heard, self.messages):
            count.append(0)
        for other in touching:
            self._links[other].add(number)

    def send(self, message: Message) -> None:
        """Send a message from now on; parts of robots out of reach are lost."""
        tree = self._tree(message.sender, {*message.parts})
        if self._params.channel == "radio" or message.sender in tree:
            self._transmit(self._serial, message, message.sender, tree)
        self._serial += 1

    def settle(self) -> None:
        """Let rounds pass until no message is under way."""
        while self._events:
            self._round += 1
            due = self._events.pop(self._round, [])
            # Events of a round come in an order of chance.
            for _, event in sorted(due, key=lambda each: each[0]):
                event()

    @property
    def degree(self) -> Ints:
        """Robots that each one touches, shape (N,)."""
        return np.array([len(touching) for touching in self._links], np.int64)

    def broadcast(self, size: int, times: int = 1, *, by_all: bool = True) -> None:
        """Count messages of so many bytes of each robot to all others, without letting them pass.

        Of repeated ones, the mean counts. By touch each robot hears all others through one contact;
        where not all pass messages on, it hears those that it touches.
        """
        robots = range(len(self._links))
        if self._params.channel == "radio":
            self._count_by_radio([*robots], size, times)
            return
        for source in robots:
            tree = {source: sorted(self._links[source])}
            if by_all:
                tree = self._tree(source, {*robots})
            for sender, after in tree.items():
                self._count_by_touch(sender, after, size, times)

    def answer(self, robot: int, size: int) -> None:
        """Count messages of so many bytes to a robot, one of each that it touches."""
        senders = sorted(self._links[robot])
        if self._params.channel == "radio":
            self._count_by_radio(senders, size, 1)
            return
        for sender in senders:
            self._count_by_touch(sender, [robot], size, 1)

    def _count_by_radio(self, senders: list[int], size: int, times: int) -> None:
        """Count transmissions of some robots, which all others hear."""
        got = 1.0 - self._params.loss
        for number in range(len(self._links)):
            sends = number in senders
            self.sent[number] += sends * times * size
            self.messages[number] += sends * times
            self.heard[number] += round(times * got * size * (len(senders) - sends))

    def _count_by_touch(self, sender: int, receivers: list[int], size: int, times: int) -> None:
        """Count transmissions of a robot to each of some others, with repetitions in the mean."""
        got = 1.0 - self._params.loss
        # A transmission is repeated unless both it and its acknowledgment were heard.
        failed = 1.0 - got**2
        tries = times * sum(failed**k for k in range(self._params.retries + 1))
        count = len(receivers)
        self.sent[sender] += round(tries * count * size)
        self.heard[sender] += round(tries * got**2 * count * ACKNOWLEDGMENT)
        self.messages[sender] += round(tries * count)
        for other in receivers:
            self.heard[other] += round(tries * got * size)
            self.sent[other] += round(tries * got * ACKNOWLEDGMENT)

    def _tree(self, root: int, targets: set[int]) -> dict[int, list[int]]:
        """Find ways to some robots: by robot, whom it passes a message on to."""
        if self._params.channel == "radio":
            there = sorted(target for target in targets if target < len(self._links))
            return {root: there} if there else {}
        before: dict[int, int] = {root: root}
        queue, left = deque([root]), {*targets} - {root}
        while queue and left:
            here = queue.popleft()
            for other in sorted(self._links[here]):
                if other not in before:
                    before[other] = here
                    left.discard(other)
                    queue.append(other)
        tree: dict[int, list[int]] = {}
        for target in sorted(targets & before.keys() - {root}):
            here = target
            while here != root and here not in tree.get(before[here], []):
                tree.setdefault(before[here], []).append(here)
                here = before[here]
        return tree

    def _behind(self, robot: int, tree: Mapping[int, list[int]]) -> set[int]:
        """List a robot and all to which it passes a message on."""
        found, queue = {robot}, [robot]
        while queue:
            after = tree.get(queue.pop(), [])
            found.update(after)
            queue += after
        return found

    def _transmit(
        self, serial: int, message: Message, sender: int, tree: Mapping[int, list[int]]
    ) -> None:
        """Let a robot pass a message on to those after it in the tree."""
        after = tree.get(sender, [])
        if self._params.channel == "radio":
            self._at_once(_Hop(serial, message, sender, tree, after))
            return
        for other in after:
            behind = self._behind(other, tree)
            parts = {number: part for number, part in message.parts.items() if number in behind}
            self._at_once(_Hop(serial, message._replace(parts=parts), sender, tree, [other]))

    def _at_once(self, hop: _Hop) -> None:
        self._later(0, lambda: self._attempt(hop))

    def _attempt(self, hop: _Hop) -> None:
        """Transmit once; try again later unless all have acknowledged it."""
        message, radio = hop.message, self._params.channel == "radio"
        waited = [number for number in hop.next if number not in hop.acknowledged]
        parts = message.parts
        if radio:
            parts = {number: parts[number] for number in waited}
        size = HEADER + len(message.common) + sum(ADDRESS + len(part) for part in parts.values())
        self.sent[hop.sender] += size
        self.messages[hop.sender] += 1
        reached = range(len(self._links)) if radio else waited
        for other in reached:
            if other == hop.sender or self._is_lost(hop, other, 0):
                continue
            self.heard[other] += size
            if (hop.serial, other) not in self._had:
                self._had.add((hop.serial, other))
                arrived = message._replace(parts=parts)
                self._later(self._params.delay, partial(self._arrive, hop, other, arrived))
            # An acknowledgment may be lost, too: the message comes twice then, and counts twice.
            if other in waited:
                self.sent[other] += ACKNOWLEDGMENT
                if not self._is_lost(hop, other, 1):
                    self.heard[hop.sender] += ACKNOWLEDGMENT
                    hop.acknowledged.add(other)
        hop.attempt += 1
        left = [number for number in hop.next if number not in hop.acknowledged]
        if left and hop.attempt <= self._params.retries:
            self._later(self._params.delay, lambda: self._attempt(hop))

    def _arrive(self, hop: _Hop, robot: int, message: Message) -> None:
        message = self._hear(robot, message)
        if self._params.channel == "touch":
            self._transmit(hop.serial, message, robot, hop.tree)

    def _later(self, delay: int, event: Callable[[], None]) -> None:
        """Let something happen after the next round and a delay."""
        order = 0
        if self._params.loss or self._params.delay:
            order = int(2**32 * uniform(self._params.seed, "order", self._drawn, 0)[()])
        self._drawn += 1
        self._events.setdefault(self._round + 1 + delay, []).append((order, event))

    def _is_lost(self, hop: _Hop, robot: int, answer: int) -> bool:
        """Draw whether a transmission to a robot is lost, or its acknowledgment."""
        if not self._params.loss:
            return False
        draw = 2 * hop.attempt + answer
        key = hop.serial * MOST_ROBOTS + robot
        return bool(uniform(self._params.seed, "loss", key, draw)[()] < self._params.loss)
