"""How messages travel: from robot to robot by touch, or by radio to those in reach.

A message has parts, each for one robot. It goes along contacts, or by radio from robot to robot in
reach, by the ways that `routes.py` knows or learns; where ways part, each branch carries the parts
of the robots behind it. By radio one transmission reaches all robots, or those that measured a
range between them. Who passes a message on takes it in, and so does who is in reach of a radio that
reaches all. Transmissions take a round and `delay` more. Who was to receive one acknowledges it;
without an answer it is sent again, after pauses that double: they outlast bursts of loss. Which are
heard is decided by the channel of the settings, for all of a round at once.

Losses and the order of events depend on the seed and on numbers of messages and robots alone.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.registry import get
from tiswarm.compute.math import uniform
from tiswarm.localization.distributed import routes
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.distributed.wire import MOST_ROBOTS
from tiswarm.records.sensing_format import RobotLine

HEADER = 4
"""Bytes before the parts of a message: its kind, sender, number and length."""

ADDRESS = 2
"""Bytes before each part: its robot, and the length of the part."""

ACKNOWLEDGMENT = 3
"""Bytes of an acknowledgment: the number of the message and its robot."""


def pause(attempt: int) -> int:
    """Choose for how many rounds to be silent before a transmission or a question is repeated.

    Args:
        attempt: Number of the repetition, from 1.
    """
    return int(2 ** min(attempt, _LONGEST)) - 1


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


_LONGEST = 10
"""Times that a pause doubles at most."""

Hear = Callable[[int, Message], Message]
"""Gives a robot a message, with those parts of it that passed by; returns what it passes on."""


@dataclass
class _Hop:
    """A transmission under way."""

    serial: int
    """Number by which chance decides about it."""

    origin: int
    """Number of the message."""

    message: Message
    sender: int
    """Peer that transmits."""

    way: routes.Way
    """Way of the message."""

    next: Mapping[int, set[int]]
    """Robots that are to hear this transmission, each with those that it is to reach by them."""

    attempt: int = 0
    acknowledged: set[int] = field(default_factory=set)

    @property
    def waited(self) -> list[int]:
        """Robots that have not acknowledged it."""
        return [number for number in self.next if number not in self.acknowledged]

    def transmitted(self) -> tuple[Message, int]:
        """Return the message with the parts that still have to be heard, and its bytes."""
        receivers = {number for listener in self.waited for number in self.next[listener]}
        parts = {number: part for number, part in self.message.parts.items() if number in receivers}
        size = HEADER + len(self.message.common) + sum(ADDRESS + len(p) for p in parts.values())
        return self.message._replace(parts=parts), size


def reached(line: RobotLine, params: DistributedParams) -> set[int]:
    """List earlier robots that one touches, or by a radio of limited reach measured a range to."""
    numbers = {neighbor for _, neighbor, _ in line.contacts}
    if params.radio_reach is not None and line.ranges:
        numbers |= {int(row[0]) for row in line.ranges}
    return numbers


class Channel:
    """The swarm's channel, with what each robot sent and heard."""

    def __init__(self, params: DistributedParams, hear: Hear) -> None:
        """Begin without robots.

        Args:
            params: Settings.
            hear: Called with each robot that hears a message.
        """
        self._params = params
        self._hear = hear
        self._hears: Any = get("channel", params.channel)(params)
        self._is_radio = params.channel != "touch"
        self._reaches_all = self._is_radio and params.radio_reach is None
        self._air: list[_Hop] = []
        self._links: list[set[int]] = []
        self._present: list[int] = []
        self._routes = routes.of(params.routes, self._links)
        self._degree: list[int] = []
        self._events: dict[int, list[tuple[int, Callable[[], None]]]] = {}
        self._round = 0
        self._serial = 0
        self._drawn = 0
        self.sent: list[int] = []
        """Bytes that each robot transmitted, by its number."""
        self.heard: list[int] = []
        """Bytes that each robot heard."""
        self.messages: list[int] = []
        """Transmissions of each robot."""
        self._had: dict[tuple[int, int], set[int]] = {}
        """By message and robot that heard it, the receivers whose parts came with it."""

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
        """Rounds in which a message was under way, or a robot paused to repeat one."""
        return self._round

    def join(self, touching: set[int]) -> None:
        """Add the next robot, with those that it touches, or by radio is in reach of."""
        number = len(self._links)
        self._present.append(number)
        self._links.append(set(touching))
        self._degree.append(len(touching))
        for count in (self.sent, self.heard, self.messages):
            count.append(0)
        for neighbor in touching:
            self._links[neighbor].add(number)
            self._degree[neighbor] += 1

    @property
    def present(self) -> list[int]:
        """Robots that have joined and not left, ascending."""
        return [*self._present]

    def leave(self, robots: Collection[int]) -> list[int]:
        """Take robots away: from now on they neither send nor hear.

        Returns:
            Robots that touched one of them, or were in its reach, and remain, ascending.
        """
        touched: set[int] = set()
        for number in robots:
            self._present.remove(number)
            touched |= self._links[number]
            for neighbor in self._links[number]:
                self._links[neighbor].discard(number)
            self._links[number] = set()
        return sorted(touched.intersection(self._present))

    def send(self, message: Message, after: int = 0) -> None:
        """Send a message after some silent rounds; parts of robots out of reach are lost."""
        origin = self._next_serial()
        receivers = {*message.parts}
        way = self._way(origin, message.sender, receivers)
        self._transmit(_Hop(origin, origin, message, message.sender, way, {}), receivers, after)

    @property
    def memory(self) -> Ints:
        """Bytes in which each robot holds the ways that it has learned, shape (N,)."""
        return self._routes.memory

    def wait(self, rounds: int) -> None:
        """Let rounds pass in which nothing is under way."""
        self._round += rounds

    def settle(self) -> None:
        """Let rounds pass until no message is under way."""
        while self.is_busy:
            self.step()

    def step(self) -> None:
        """Let a round pass."""
        self._round += 1
        due = self._events.pop(self._round, [])
        # Events of a round come in an order of chance.
        for _, event in sorted(due, key=itemgetter(0)):
            event()
        self._deliver()
        if not self.is_busy:
            # No message comes again.
            self._had.clear()

    @property
    def is_busy(self) -> bool:
        """Whether a message is under way, or will be sent after silent rounds."""
        return bool(self._events)

    @property
    def degree(self) -> Ints:
        """Robots that each one has touched, or by radio was in reach of, shape (N,)."""
        return np.array(self._degree, np.int64)

    def broadcast(self, size: int, times: int = 1, *, by_all: bool = True) -> None:
        """Count messages of so many bytes of each robot to all others, without letting them pass.

        Of repeated ones, the mean counts. By touch each robot hears all others through one contact;
        where not all pass messages on, it hears those that it touches. By radio it hears those in
        reach.
        """
        if self._is_radio:
            self._count_by_radio(self._present, size, times)
            return
        for source in self._present:
            children = {source: sorted(self._links[source])}
            if by_all:
                children = routes.tree(self._links, source, {*self._present})
            for sender, after in children.items():
                self._count_by_touch(sender, after, size, times)

    def transmit(self, senders: Iterable[int], size: int) -> dict[int, list[int]]:
        """Let robots transmit so many bytes each in one round by radio, and return who hears each.

        Nobody acknowledges or repeats them.
        """
        self._round += 1
        hops = []
        for sender in senders:
            serial = self._next_serial()
            pose = Message("pose", sender, b"", {})
            hops.append(_Hop(serial, serial, pose, sender, routes.KnownWay({}), {}))
        heard = self._heard(hops, [self._in_reach(hop) for hop in hops], [size for _ in hops])
        for hop, listeners in zip(hops, heard, strict=True):
            self.sent[hop.sender] += size
            self.messages[hop.sender] += 1
            for listener in listeners:
                self.heard[listener] += size
        return {hop.sender: listeners for hop, listeners in zip(hops, heard, strict=True)}

    def ask(self, robot: int, size: int) -> None:
        """Count a message of so many bytes of a robot to all in reach of its radio."""
        self._count_by_radio([robot], size, 1)

    def answer(self, robot: int, size: int, *, by_all: bool = False) -> None:
        """Count messages of so many bytes to a robot, one of each that it touches or hears.

        Only where all answer, those do that a radio without limits reaches.
        """
        senders = sorted(self._links[robot])
        if by_all and self._reaches_all:
            senders = [number for number in self._present if number != robot]
        if self._is_radio:
            self._count_by_radio(senders, size, 1)
            return
        for sender in senders:
            self._count_by_touch(sender, [robot], size, 1)

    def _count_by_radio(self, senders: list[int], size: int, times: int) -> None:
        """Count transmissions of some robots, which all in reach hear."""
        sending = {*senders}
        for number in self._present:
            sends = number in sending
            self.sent[number] += sends * times * size
            self.messages[number] += sends * times
            hears = len(senders) - sends
            if not self._reaches_all:
                hears = len(self._links[number] & sending)
            self.heard[number] += times * size * hears

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
        for receiver in receivers:
            self.heard[receiver] += round(tries * got * size)
            self.sent[receiver] += round(tries * got * ACKNOWLEDGMENT)

    def _way(self, origin: int, sender: int, receivers: set[int]) -> routes.Way:
        """Find the way of a message; where a radio reaches all, it is one transmission."""
        if self._reaches_all:
            children = sorted(receivers & {*self._present} - {sender})
            return routes.KnownWay({sender: children} if children else {})
        return self._routes.way(origin, sender, receivers)

    def _next_serial(self) -> int:
        self._serial += 1
        return self._serial - 1

    def _transmit(self, hop: _Hop, receivers: set[int], after: int = 0) -> None:
        """Let a robot pass a message on towards its receivers, after silent rounds.

        Args:
            hop: The transmission by which it heard the message, with the robot as its sender.
            receivers: Robots that the message is to reach from there.
            after: Silent rounds.
        """
        onward = hop.way.onward(hop.sender, receivers)
        if not onward:
            return
        # By touch, each contact has a transmission of its own.
        transmissions = [onward]
        if not self._is_radio:
            transmissions = [{child: reached_by_it} for child, reached_by_it in onward.items()]
        for next_ones in transmissions:
            serial = hop.origin if hop.way.meets_once else self._next_serial()
            self._begin(replace(hop, serial=serial, next=next_ones), after)

    def _begin(self, hop: _Hop, after: int) -> None:
        """Let a transmission begin in the next round, after silent ones."""

        def transmit() -> None:
            self._air.append(hop)

        self._later(after, transmit)

    def _deliver(self) -> None:
        """Let robots hear what is transmitted in a round; repeat what nobody acknowledged."""
        hops = self._air
        self._air = []
        sent = [hop.transmitted() for hop in hops]
        sizes = [size for _, size in sent]
        heard = self._heard(hops, [self._in_reach(hop) for hop in hops], sizes)
        waited = [
            [listener for listener in of_hop if listener in hop.waited]
            for hop, of_hop in zip(hops, heard, strict=True)
        ]
        answered = self._heard(hops, waited, [])
        for k, (hop, (message, size)) in enumerate(zip(hops, sent, strict=True)):
            self.sent[hop.sender] += size
            self.messages[hop.sender] += 1
            for listener in heard[k]:
                self.heard[listener] += size
                self._receive(hop, listener, message)
            # An acknowledgment may be lost, too: the message comes twice then, and counts twice.
            for listener in waited[k]:
                self.sent[listener] += ACKNOWLEDGMENT
            self.heard[hop.sender] += ACKNOWLEDGMENT * len(answered[k])
            hop.acknowledged.update(answered[k])
            hop.attempt += 1
            if hop.waited and hop.attempt <= self._params.retries:
                self._begin(hop, self._params.delay + pause(hop.attempt))

    def _receive(self, hop: _Hop, listener: int, message: Message) -> None:
        """Let a robot take in what of a message has not come to it before."""
        carried = hop.next.get(listener, {listener} if self._reaches_all else set())
        had = self._had.setdefault((hop.origin, listener), set())
        new = carried - had
        if not new:
            return
        repeated = carried & had
        had |= new
        if repeated:
            parts = {n: part for n, part in message.parts.items() if n not in repeated}
            message = message._replace(parts=parts)
        self._later(self._params.delay, partial(self._arrive, hop, listener, message, new))

    def _in_reach(self, hop: _Hop) -> list[int]:
        """List the robots that may hear a transmission."""
        if not self._is_radio:
            return hop.waited
        if self._reaches_all:
            return [number for number in self._present if number != hop.sender]
        return sorted(self._links[hop.sender])

    def _heard(
        self, hops: Sequence[_Hop], reached: Sequence[Sequence[int]], sizes: Sequence[int]
    ) -> list[list[int]]:
        """Let the channel decide which robots hear transmissions.

        Args:
            hops: The transmissions of a round.
            reached: By transmission, the robots that may hear it.
            sizes: Bytes of each; none of acknowledgments, which those robots send.
        """
        of = np.repeat(np.arange(len(hops)), [len(listeners) for listeners in reached])
        if not len(of):
            return [[] for _ in hops]
        serial, sender, attempt = np.array([(h.serial, h.sender, h.attempt) for h in hops])[of].T
        listener = np.array([number for listeners in reached for number in listeners])
        is_answer = not sizes
        seed = self._params.seed
        draw = 2 * attempt + is_answer
        key = serial * MOST_ROBOTS
        loss_draw = uniform(seed, "loss", key + listener, draw)
        slot_draw = uniform(seed, "slot", key + sender, draw)
        ends = (sender, listener)
        size = np.full(len(of), ACKNOWLEDGMENT)
        if is_answer:
            ends = (listener, sender)
        else:
            size[:] = np.array(sizes)[of]
        heard = self._hears(self._round, *ends, size, loss_draw, slot_draw, is_answer)
        return [listener[heard & (of == k)].tolist() for k in range(len(hops))]

    def _arrive(self, hop: _Hop, robot: int, message: Message, receivers: set[int]) -> None:
        hop.way.learn(robot, hop.sender)
        message = self._hear(robot, message)
        passed = _Hop(hop.serial, hop.origin, message, robot, hop.way, {})
        self._transmit(passed, receivers - {robot})

    def _later(self, delay: int, event: Callable[[], None]) -> None:
        """Let something happen after the next round and a delay."""
        order = 0
        if self._params.loss or self._params.delay or self._params.slots:
            order = int(2**32 * uniform(self._params.seed, "order", self._drawn, 0)[()])
        self._drawn += 1
        self._events.setdefault(self._round + 1 + delay, []).append((order, event))
