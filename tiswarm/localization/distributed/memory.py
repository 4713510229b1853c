"""What a robot holds of robots, itself included."""

import zlib
from collections.abc import Collection, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.program import Program
from tiswarm.measurements.equations import AXES


@dataclass
class Record:
    """What a robot holds of one robot, itself included."""

    line: bytes = b""
    """What it sensed, as sent; empty if unknown."""

    place: wire.Whereabouts | None = None
    """Where it is; None if unknown."""

    candidates: Reals = field(default_factory=lambda: np.empty((0, AXES)))
    """Where else it may be, relative to the mean of those it shares rows with [R], (k, 3)."""

    sharing: set[int] = field(default_factory=set)
    """Robots that are known to share rows with it."""

    span: tuple[int, int] | None = None
    """When the last walk came to the robot, and left it: those between hang on it."""

    since: int = 0
    """Robot that joined as it was asked last; it has said who shares rows with it until then."""

    is_surprising: bool = False
    """Whether chance does not explain its rows and overlaps, as the one that solved for it says."""

    is_current: bool = False
    """Whether it lets the robot that holds this know as it moves."""

    is_gone: bool = False
    """Whether it has left, as the robot that holds this sensed or heard: it answers no more."""

    @property
    def body(self) -> int:
        """First robot of the body in which it is placed; -1 if it is not."""
        return -1 if self.place is None else self.place.body


class Memory:
    """What a robot holds of robots by their numbers, and what its program makes of it."""

    def __init__(self, program: Program, number: int, line: bytes) -> None:
        """Begin with what the robot of this number sensed."""
        self._program = program
        self._number = number
        self.records = {number: Record(line, sharing=program.partners(line))}
        self._gone: set[int] = set()

    def of(self, number: int) -> Record:
        """Return what is held of a robot; what was not is empty, and held from then on."""
        return self.records.setdefault(number, Record(is_gone=number in self._gone))

    def has_left(self, number: int) -> bool:
        """Whether this robot knows that one has left."""
        return number in self._gone

    def hold_leaver(self, number: int) -> None:
        """Take in that a robot has left; what is held of it stays."""
        self._gone.add(number)
        if number in self.records:
            self.records[number].is_gone = True

    def hold_line(self, number: int, line: bytes) -> None:
        """Take in what a robot sensed, if anything was sent of it."""
        if line:
            record = self.of(number)
            record.line = line
            record.sharing |= self._program.partners(line)

    def hold_sharing(self, sender: int, partners: AbstractSet[int]) -> None:
        """Take in that a robot shares rows with some, of those that are held."""
        for partner in partners & self.records.keys():
            self.records[partner].sharing.add(sender)

    def hold_answer(self, sender: int, content: bytes) -> None:
        """Take in what a robot says of itself."""
        record = self.of(sender)
        answer = wire.read_answer(content, self._program.params.bits, self._program.exchanges)
        self.hold_line(sender, answer.line)
        record.sharing.update(answer.sharing)
        record.span = answer.span
        if answer.place is not None:
            record.place = answer.place
            record.candidates = answer.candidates

    def hold_result(self, number: int, packed: bytes) -> None:
        """Take in where a robot is, as one that solved says."""
        result = wire.read_result(packed, self._program.params.bits)
        record = self.of(number)
        # Bodies join those of lower numbers: who places it in a higher one has not heard of that.
        if result.place is None or 0 <= record.body < result.place.body:
            return
        record.place = result.place
        record.is_surprising = result.is_surprising
        if len(result.candidates):
            record.candidates = result.candidates

    def join_body(self, number: int, joint: wire.JointShift) -> None:
        """Move what is held of a robot to another body, unless it is there."""
        record = self.of(number)
        place = record.place
        if place is not None and place.body == joint.body:
            record.place = wire.Whereabouts(
                place.position + joint.shift,
                place.turn,
                float(np.hypot(place.sd, joint.sd)),
                joint.joined,
            )

    def question(self, number: int) -> wire.Asked:
        """Ask a robot for what is not held of it."""
        record = self.of(number)
        return wire.Asked(not record.line, self.checksum(number), record.since)

    def checksum(self, number: int) -> int:
        """Check the place that is held of a robot, against what that one holds; 0 without one."""
        place = self.of(number).place
        if place is None:
            return 0
        text = wire.Writer(self._program.params.bits)
        wire.write_place(text, place)
        return zlib.crc32(text.to_bytes()) % int(2**wire.CHECK - 1) + 1

    def is_current(self, number: int) -> bool:
        """Judge whether nothing is to be asked of a robot: it lets this one know as it moves."""
        record = self.of(number)
        is_held = record.is_current or record.is_gone
        return number == self._number or (is_held and bool(record.line))

    def placed(self) -> dict[int, Record]:
        """List the robots whose lines and places are held."""
        return {
            n: record
            for n, record in self.records.items()
            if record.line and record.place is not None
        }

    def forget(self, needed: Collection[int]) -> None:
        """Drop lines beyond as many as there is room for.

        Those that are not current go first, then those of the robots heard of first.
        """
        lines = [n for n, record in self.records.items() if record.line and n != self._number]
        beyond = max(len(lines) - self._program.params.robots, 0)
        spare = sorted((n for n in lines if n not in needed), key=self.is_current)
        for number in spare[:beyond]:
            del self.records[number]

    @property
    def size(self) -> int:
        """Bytes of what is held."""
        bits = self._program.params.bits or 64
        return sum(
            len(record.line)
            + (
                wire.NUMBER * (1 + len(record.sharing))
                + bits * (6 + record.candidates.size)
                + 8
                + 7
            )
            // 8
            for record in self.records.values()
        )


def of_body(records: Mapping[int, Record], body: int) -> dict[int, Record]:
    """Choose robots that are placed relative to a body."""
    return {n: record for n, record in records.items() if record.body == body}
