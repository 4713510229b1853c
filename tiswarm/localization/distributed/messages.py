"""The kinds of messages between robots: what each one says, and to whom.

| message | from, to | says |
|---|---|---|
| `Join` | new robot, robots that its line names | we share rows; its line, to its host |
| `Task` | host, keeper | the line of a robot to solve for |
| `Full` | keeper, host; or host, new robot | I solve for no more |
| `Ask` | keeper, robots near | who shares rows with you, where are you, what did you sense |
| `Answer` | robot near, keeper | that |
| `Lines` | robot on the way, keeper | lines of robots that are asked for them |
| `Place` | keeper, robots that it solved for | where you are |
| `Moved` | robot, those that hold its place | what you hold is not current |
| `Child` | robot, the one that it hangs on | I hang on you |
| `ReviewWalk` | robot, the next of a review | the review comes to you, or returns |
| `Walking` | robot, the one that it hangs on | the walk is still with me |
| `Branch` | keeper, first robot of a branch | you and what hangs on you move |
| `Shift` | robot, those that hang on it | move with me |
| `Hang` | keeper, robot that touches two bodies | a robot to hang on, one that hangs on you |
| `Lost` | robot of another body, parent | repeat the shift of my body |
| `Left` | robot that touched some that left, all others | these robots have left |

A channel carries each as a `Message`: content for all who hear it, and a part for each receiver.
Places and shifts stay packed where robots pass them on: a number that is rounded twice may change.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.channel import Message

_SIZE = 2
"""Bytes of a number or a length between lines."""

_FARTHEST = 255
"""Contacts up to which a message counts those that it takes."""


@dataclass(frozen=True)
class Content:
    """What a message says, by default nothing but its kind."""

    kind: ClassVar[str]
    """Name of the kind, as channels count it."""

    read_in_passing: ClassVar[bool] = False
    """Whether robots read it although it is for others."""

    to: Collection[int]
    """Robots that receive it, in the order of its parts; those behind the reader where it is
    passed on."""

    @property
    def common(self) -> bytes:
        """Content for all who hear it."""
        return b""

    @property
    def parts(self) -> Mapping[int, bytes]:
        """Content for each receiver, by its number."""
        return dict.fromkeys(self.to, b"")

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        return cls(message.parts.keys())

    def message(self, sender: int) -> Message:
        """Pack it for a channel."""
        return Message(self.kind, sender, self.common, self.parts)


class Moved(Content):
    """What the receivers hold of the sender is not current any more."""

    kind = "moved"


class Full(Content):
    """The sender solves for no more robots."""

    kind = "full"


class Lost(Content):
    """The sender is in a body of its own still: it asks for the shift by which this body joined."""

    kind = "lost"


class Child(Content):
    """The sender hangs on the receiver."""

    kind = "child"


class Walking(Content):
    """A walk is still with the sender, or with a robot that hangs on it."""

    kind = "walking"


@dataclass(frozen=True)
class Join(Content):
    """The sender shares rows with the receivers; its host has to see that it is solved for."""

    kind = "join"
    read_in_passing = True

    host: int | None
    """Robot that receives the line; None without one."""

    line: bytes
    """What the sender sensed, for the host."""

    @property
    def parts(self) -> Mapping[int, bytes]:
        """The line for the host, nothing for all others."""
        of_host = {} if self.host is None else {self.host: self.line}
        return dict.fromkeys(self.to, b"") | of_host

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        parts = message.parts
        host = next((number for number, part in parts.items() if part), None)
        return cls(parts.keys(), host, b"" if host is None else parts[host])


@dataclass(frozen=True)
class Task(Content):
    """The receiver is to solve for a robot."""

    kind = "task"

    line: bytes
    """What the robot sensed."""

    @property
    def parts(self) -> Mapping[int, bytes]:
        """The line."""
        return dict.fromkeys(self.to, self.line)

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        [line] = message.parts.values()
        return cls(message.parts.keys(), line)


@dataclass(frozen=True)
class Ask(Content):
    """The sender solves, and asks for what it does not hold of the receivers."""

    kind = "ask"
    read_in_passing = True

    questions: Mapping[int, bytes]
    """By receiver, what is asked of it, packed as `wire.Asked`."""

    @property
    def parts(self) -> Mapping[int, bytes]:
        """The questions."""
        return self.questions

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        return cls(message.parts.keys(), message.parts)

    @classmethod
    def of(cls, asked: Mapping[int, wire.Asked]) -> Self:
        """Ask robots, by their numbers."""
        return cls(asked.keys(), {n: wire.write_question(one) for n, one in asked.items()})

    def asked(self, number: int) -> wire.Asked:
        """Read what is asked of one of the receivers."""
        return wire.read_question(self.questions[number])


@dataclass(frozen=True)
class Answer(Content):
    """What a robot says of itself to one that asked."""

    kind = "answer"
    read_in_passing = True

    content: bytes
    """Packed as `wire.AnswerContent`."""

    @property
    def common(self) -> bytes:
        """The answer: robots that pass it on take it in."""
        return self.content

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        return cls(message.parts.keys(), message.common)


@dataclass(frozen=True)
class Lines(Content):
    """Lines of robots that the receiver asks for them, from one on the way that holds them."""

    kind = "lines"
    read_in_passing = True

    packed: Collection[bytes]
    """Lines with their robots and lengths, for each receiver."""

    @property
    def parts(self) -> Mapping[int, bytes]:
        """The lines."""
        return dict(zip(self.to, self.packed, strict=True))

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        return cls(message.parts.keys(), message.parts.values())

    @classmethod
    def of(cls, receiver: int, lines: Mapping[int, bytes]) -> Self:
        """Pack lines, by their robots."""
        packed = b"".join(
            number.to_bytes(_SIZE, "big") + len(line).to_bytes(_SIZE, "big") + line
            for number, line in lines.items()
        )
        return cls([receiver], [packed])

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield robots with their lines."""
        for packed in self.packed:
            rest = packed
            while rest:
                number = int.from_bytes(rest[:_SIZE], "big")
                size = int.from_bytes(rest[_SIZE : 2 * _SIZE], "big")
                yield number, rest[2 * _SIZE :][:size]
                rest = rest[2 * _SIZE + size :]


@dataclass(frozen=True)
class Place(Content):
    """Where the receivers are, from the keeper that moved them."""

    kind = "place"
    read_in_passing = True

    results: Mapping[int, bytes]
    """By receiver, its place, packed as `wire.read_result` reads it."""

    contacts: int = 1
    """Contacts that the message has taken, the next one included."""

    @property
    def common(self) -> bytes:
        """The count of contacts."""
        return bytes([self.contacts])

    @property
    def parts(self) -> Mapping[int, bytes]:
        """The places."""
        return self.results

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        [contacts] = message.common
        return cls(message.parts.keys(), message.parts, contacts)

    @classmethod
    def of(cls, results: Mapping[int, bytes]) -> Self:
        """Send places, by their robots."""
        return cls(results.keys(), results)

    def passed_on(self) -> Self:
        """Count the contact to the next robot."""
        return type(self)(self.to, self.results, min(self.contacts + 1, _FARTHEST))


@dataclass(frozen=True)
class _Walk(Content):
    """A walk of a review."""

    count: int
    """Robots that the walk has come to."""

    number: int
    """Number of the walk, modulo `wire.WALKS`; even ones are the first of a review."""

    @property
    def common(self) -> bytes:
        """Count and number."""
        return wire.write_walk(self.count, self.number)

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        return cls(message.parts.keys(), *wire.read_walk(message.common))


@dataclass(frozen=True)
class ReviewWalk(_Walk):
    """A walk of a review comes to a robot that hangs on the sender."""

    kind = "walk"


@dataclass(frozen=True)
class ReturnedWalk(_Walk):
    """A walk of a review returns to the robot that it came from."""

    kind = "return"


@dataclass(frozen=True)
class _OfShift(Content):
    """A shift of several robots."""

    shift: bytes
    """Packed as `wire.JointShift`."""

    @property
    def common(self) -> bytes:
        """The shift."""
        return self.shift

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        return cls(message.parts.keys(), message.common)


@dataclass(frozen=True)
class Left(Content):
    """Robots that the sender touched have left, with those that fell with them."""

    kind = "left"

    robots: Collection[int]
    """Numbers of those that left."""

    @property
    def common(self) -> bytes:
        """Their numbers."""
        return b"".join(number.to_bytes(_SIZE, "big") for number in self.robots)

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        packed = message.common
        starts = range(0, len(packed), _SIZE)
        robots = [int.from_bytes(packed[start : start + _SIZE], "big") for start in starts]
        return cls(message.parts.keys(), robots)


class Branch(_OfShift):
    """All that hang on the receiver move as one."""

    kind = "branch"


class Shift(_OfShift):
    """The receivers hang on the sender, and move with it."""

    kind = "shift"


@dataclass(frozen=True)
class Hang(_OfShift):
    """The receiver touches two bodies, and one is to hang on it."""

    kind = "hang"

    pair: bytes
    """Robot of one body that it is to hang on, and robot of the other that is to hang on it."""

    @property
    def parts(self) -> Mapping[int, bytes]:
        """The two robots."""
        return dict.fromkeys(self.to, self.pair)

    @classmethod
    def read(cls, message: Message) -> Self:
        """Read what a message says."""
        [pair] = message.parts.values()
        return cls(message.parts.keys(), message.common, pair)


KINDS: dict[str, type[Content]] = {
    kind.kind: kind
    for kind in (
        Join,
        Task,
        Full,
        Ask,
        Answer,
        Lines,
        Place,
        Moved,
        Child,
        ReviewWalk,
        ReturnedWalk,
        Walking,
        Branch,
        Shift,
        Hang,
        Lost,
        Left,
    )
}
"""Kinds of messages by their names."""
