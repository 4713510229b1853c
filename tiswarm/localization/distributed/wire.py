"""Messages as bytes: what robots say to each other, and how many bits it takes.

| message | content |
|---|---|
| `line` | what a robot sensed: its orientations, the docks it flipped about, contacts, ground |
| `place` | where a robot is: position, turn of its final orientation, standard deviation |
| `candidates` | other places that its rows allow |
| `numbers` | which robots share rows with it |

Robots ask for these, and answer; one that solved says of others where they are.

A coordinate is rounded to one of 2^bits values within a range, a power of two, that the message
states. Lengths in R, relative to the anchor.
"""

import json
import math
from collections.abc import Collection, Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.measurements.equations import AXES
from tiswarm.records.sensing_format import RobotLine, StanceEntry
from tiswarm.records.sensing_log import LISTS

NUMBER = 12
"""Bits of a robot's number."""

MOST_ROBOTS = 2**NUMBER
"""Robots that have a number."""

COUNT = 8
"""Bits of a count."""

CHECK = 15
"""Bits of the checksum by which a robot knows that what another one holds of it is current."""

_WALK = 3
"""Bits of a walk's number."""

WALKS: int = 2**_WALK
"""Walks after which numbers begin anew; even ones are of first walks of a review."""

_ANGLE = 10
"""Bits of a part of a quaternion that suffice: the step is a tenth of a degree."""

_TURN = 8
"""Bits of a turn that suffice: the step is a 16th of a standard deviation."""

_RANGE = 5
"""Bits of the power of two that limits coordinates."""

_SD = 8
"""Bits of a standard deviation."""

_LEAST_SD = 1e-3
"""Least standard deviation that is sent [R]; steps up to the greatest are logarithmic."""

_MOST_SD = 1e3
"""Greatest standard deviation that is sent [R]."""

_MOST_TURN = 8.0
"""Range of turns [standard deviations]."""

_EXACT = 64
"""Bits of a number that is not rounded."""

_CORNER = 1.0 / math.sqrt(2.0)
"""Range of the three smaller parts of a unit quaternion."""

_PLAIN = ("contacts", "ground_docks")
"""Lists of a stance that have a code of their own; all others are sent as text."""

_NO_CANDIDATES: Reals = np.empty((0, AXES))


class Whereabouts(NamedTuple):
    """Where a robot is, as it and others know it."""

    position: Reals
    """Center [R], shape (3,)."""

    turn: Reals
    """Error of its final orientation [standard deviations], shape (3,)."""

    sd: float
    """Standard deviation of the position [R]."""

    body: int = 0
    """First robot of the body that the position is relative to: all robots that rows connect. The
    anchor's is 0."""


def pose_bytes(bits: int | None, *, with_orientation: bool) -> int:
    """Count the bytes of a robot's position, and of its orientation."""
    size = bits or _EXACT
    count = _RANGE + AXES * size
    if with_orientation:
        count += (AXES + 1) * size if bits is None else 2 + AXES * size
    return -(-count // 8)


class Writer:
    """Packs numbers into bytes."""

    def __init__(self, bits: int | None) -> None:
        """Begin; each real number takes so many bits, and is exact if None."""
        self.bits = bits
        self._value = 1
        self._length = 0

    def number(self, value: int, bits: int) -> None:
        """Append a whole number of so many bits."""
        self._value = self._value << bits | value
        self._length += bits

    def reals(self, values: Iterable[float], limit: float, bits: int | None = None) -> None:
        """Append numbers from -limit to limit, of so many bits; those beyond are cut."""
        bits = bits or self.bits
        for value in values:
            if bits is None:
                self.number(int(np.float64(value).view(np.uint64)), _EXACT)
            else:
                self.number(_level(value, limit, bits), bits)

    def lengths(self, values: Iterable[float]) -> None:
        """Append lengths [R] with the range that they are in."""
        every = [float(value) for value in values]
        power = max(math.ceil(math.log2(max(max(map(abs, every), default=0.0), 1.0))), 0)
        self.number(power, _RANGE)
        self.reals(every, 2.0**power)

    def to_bytes(self) -> bytes:
        """Fill the last byte with zeros."""
        spare = -self._length % 8
        whole = (self._value << spare) ^ 1 << (self._length + spare)
        return whole.to_bytes((self._length + spare) // 8, "big")


class Reader:
    """Takes numbers from bytes, in the order in which they were packed."""

    def __init__(self, content: bytes, bits: int | None) -> None:
        """Begin; each real number takes so many bits, and is exact if None."""
        self.bits = bits
        self._value = int.from_bytes(content, "big")
        self._unread = 8 * len(content)  # bits

    def number(self, bits: int) -> int:
        """Take a whole number of so many bits."""
        self._unread -= bits
        return self._value >> self._unread & (1 << bits) - 1

    @property
    def rest(self) -> bytes:
        """Bytes after the one that was read last."""
        whole = self._unread // 8
        return (self._value & (1 << 8 * whole) - 1).to_bytes(whole, "big")

    def reals(self, count: int, limit: float, bits: int | None = None) -> Reals:
        """Take numbers from -limit to limit, shape (count,)."""
        bits = bits or self.bits
        if bits is None:
            exact = [self.number(_EXACT) for _ in range(count)]
            return np.array(exact, np.uint64).view(np.float64)
        levels = [self.number(bits) for _ in range(count)]
        return np.array(levels, np.float64) * step(limit, bits) - limit

    def lengths(self, count: int) -> Reals:
        """Take lengths [R], shape (count,)."""
        return self.reals(count, 2.0 ** self.number(_RANGE))


def step(limit: float, bits: int) -> float:
    """Distance of neighboring values among 2^bits from -limit to limit."""
    return 2.0 * limit / float(2**bits - 1)


def _fewer(bits: int | None, enough: int) -> int | None:
    """Choose the bits of an angle, whose noise is far above the step of a length."""
    return None if bits is None else min(bits, max(enough, bits // 2))


def _level(value: float, limit: float, bits: int) -> int:
    return round((min(max(value, -limit), limit) + limit) / step(limit, bits))


def rounding_sd(farthest: float, bits: int | None) -> float:
    """Standard deviation that rounding gives a coordinate at most so far from the anchor [R]."""
    if bits is None:
        return 0.0
    limit = 2.0 ** math.ceil(math.log2(max(farthest, 1.0)))
    return step(limit, bits) / math.sqrt(12.0)


def write_place(to: Writer, place: Whereabouts) -> None:
    """Append where a robot is."""
    to.lengths(place.position)
    to.reals(place.turn, _MOST_TURN, _fewer(to.bits, _TURN))
    _write_sd(to, place.sd)
    _write_if(to, place.body)


def read_place(source: Reader) -> Whereabouts:
    """Take where a robot is."""
    position, turn = (
        source.lengths(AXES),
        source.reals(AXES, _MOST_TURN, _fewer(source.bits, _TURN)),
    )
    return Whereabouts(position, turn, _read_sd(source), _read_if(source))


def _write_sd(to: Writer, sd: float) -> None:
    """Append a standard deviation [R]."""
    if to.bits is None:
        to.reals([sd], 1.0)
        return
    share = math.log(max(sd, _LEAST_SD) / _LEAST_SD) / math.log(_MOST_SD / _LEAST_SD)
    to.number(round(min(share, 1.0) * (2**_SD - 1)), _SD)


def _read_sd(source: Reader) -> float:
    if source.bits is None:
        return float(source.reals(1, 1.0)[0])
    return float(_LEAST_SD * (_MOST_SD / _LEAST_SD) ** (source.number(_SD) / (2**_SD - 1)))


def _write_if(to: Writer, number: int) -> None:
    """Append a robot's number; the anchor's takes one bit."""
    to.number(number > 0, 1)
    if number:
        to.number(number, NUMBER)


def _read_if(source: Reader) -> int:
    return source.number(NUMBER) if source.number(1) else 0


class JointShift(NamedTuple):
    """By how much robots that hang on one move."""

    keeper: int
    """Robot that computed it."""

    shift: Reals
    """Shift [R], shape (3,)."""

    parted: Collection[int] = ()
    """Robots that do not take part, nor those that hang on them."""

    body: int = 0
    """Body that joins another one by this; 0 where none does."""

    joined: int = 0
    """The other body."""

    sd: float = 0.0
    """Standard deviation of the shift, where bodies join [R]."""


def write_shift(shift: JointShift, bits: int | None) -> bytes:
    """Write by how much robots move."""
    to = Writer(bits)
    to.number(shift.keeper, NUMBER)
    to.lengths(shift.shift)
    write_numbers(to, shift.parted)
    _write_if(to, shift.body)
    if shift.body:
        _write_if(to, shift.joined)
        _write_sd(to, shift.sd)
    return to.to_bytes()


def read_shift(content: bytes, bits: int | None) -> JointShift:
    """Read what `write_shift` wrote."""
    source = Reader(content, bits)
    shift = JointShift(source.number(NUMBER), source.lengths(AXES), read_numbers(source))
    body = _read_if(source)
    if not body:
        return shift
    return shift._replace(body=body, joined=_read_if(source), sd=_read_sd(source))


def rounded(shift: Reals, bits: int | None) -> Reals:
    """Round a shift as it is sent [R]."""
    return read_shift(write_shift(JointShift(0, shift), bits), bits).shift


def write_pair(first: int, second: int) -> bytes:
    """Write two numbers of robots."""
    to = Writer(None)
    to.number(first, NUMBER)
    to.number(second, NUMBER)
    return to.to_bytes()


def read_pair(content: bytes) -> tuple[int, int]:
    """Read what `write_pair` wrote."""
    source = Reader(content, None)
    return source.number(NUMBER), source.number(NUMBER)


def write_walk(count: int, walk: int) -> bytes:
    """Write how many robots a walk has come to, and its number."""
    to = Writer(None)
    to.number(count, NUMBER + 1)
    to.number(walk, _WALK)
    return to.to_bytes()


def read_walk(content: bytes) -> tuple[int, int]:
    """Read what `write_walk` wrote."""
    source = Reader(content, None)
    return source.number(NUMBER + 1), source.number(_WALK)


def is_earlier(walk: int, last: int) -> bool:
    """Return whether a walk began before the last one, by numbers that begin anew (RFC 1982)."""
    behind = (last - walk) % WALKS
    return 0 < behind < WALKS // 2


def write_span(to: Writer, span: tuple[int, int] | None) -> None:
    """Append when a walk came to a robot, and left it, if one did."""
    to.number(span is not None, 1)
    for count in span or ():
        to.number(count, NUMBER + 1)


def read_span(source: Reader) -> tuple[int, int] | None:
    """Take what `write_span` wrote."""
    if not source.number(1):
        return None
    return source.number(NUMBER + 1), source.number(NUMBER + 1)


def write_candidates(to: Writer, places: Reals) -> None:
    """Append places that rows of a robot allow [R], shape (k, 3)."""
    to.number(len(places), COUNT)
    to.lengths(places.ravel())


def read_candidates(source: Reader) -> Reals:
    """Take places that rows of a robot allow [R], shape (k, 3)."""
    count = source.number(COUNT)
    return source.lengths(AXES * count).reshape(count, AXES)


def write_numbers(to: Writer, numbers: Iterable[int]) -> None:
    """Append numbers of robots, fewer than 256."""
    written = sorted(numbers)[-(2**COUNT - 1) :]
    to.number(len(written), COUNT)
    for number in written:
        to.number(number, NUMBER)


def read_numbers(source: Reader) -> list[int]:
    """Take numbers of robots, ascending."""
    return [source.number(NUMBER) for _ in range(source.number(COUNT))]


def line_bytes(line: RobotLine, docks: int, bits: int | None) -> bytes:
    """Write what a robot of so many docks sensed."""
    to = Writer(bits)
    to.number(line.robot, NUMBER)
    to.number(line.flip_height is not None, 1)
    if line.flip_height is not None:
        to.lengths([line.flip_height])
    stances = line.stances or []
    to.number(line.stances is not None, 1)
    to.number(len(stances), NUMBER)
    stays: list[list[int]] = []
    every: list[RobotLine | StanceEntry] = [*stances, line]
    for entry in every:
        _write_stance(to, entry, docks, stays)
        if isinstance(entry, StanceEntry):
            to.number(entry.pivot_dock, _dock_bits(docks))
            stays = [item for item in sorted(entry.contacts) if item[0] == entry.pivot_dock]
    more = _others(line)
    to.number(bool(more), 1)
    if more:
        text = json.dumps(more, separators=(",", ":")).encode()
        to.number(len(text), 2 * COUNT)
        for byte in text:
            to.number(byte, 8)
    return to.to_bytes()


def read_line(content: bytes, docks: int, bits: int | None) -> RobotLine:
    """Read what `line_bytes` wrote."""
    source = Reader(content, bits)
    entries: dict[str, object] = {"robot": source.number(NUMBER)}
    if source.number(1):
        entries["flip_height"] = float(source.lengths(1)[0])
    has_stances, count = source.number(1), source.number(NUMBER)
    stances: list[dict[str, Any]] = []
    stays: list[list[int]] = []
    for _ in range(count):
        stance = _read_stance(source, docks, stays)
        pivot = stance["pivot_dock"] = source.number(_dock_bits(docks))
        stays = [item for item in stance["contacts"] if item[0] == pivot]
        stances.append(stance)
    entries |= _read_stance(source, docks, stays)
    if has_stances:
        entries["stances"] = stances
    if source.number(1):
        text = bytes(source.number(8) for _ in range(source.number(2 * COUNT)))
        more = json.loads(text)
        for stance, lists in zip(stances, more.pop("stances", []), strict=False):
            stance.update(lists)
        entries |= more
    return RobotLine.model_validate(entries)


def _others(line: RobotLine) -> dict[str, object]:
    """Gather what a line says beside orientations, contacts and the ground."""
    names = [key for key in LISTS if key not in _PLAIN]

    def lists(entry: RobotLine | StanceEntry) -> dict[str, object]:
        return {key: getattr(entry, key) for key in names if getattr(entry, key)}

    entries = lists(line)
    if line.spawn_position is not None:
        entries["spawn_position"] = line.spawn_position
    earlier = [lists(entry) for entry in line.stances or []]
    if any(earlier):
        entries["stances"] = earlier
    return entries


def _dock_bits(docks: int) -> int:
    return max((docks - 1).bit_length(), 1)


def _write_stance(
    to: Writer, entry: RobotLine | StanceEntry, docks: int, stays: list[list[int]]
) -> None:
    """Write orientation, contacts and ground of a stance.

    Args:
        to: Where to.
        entry: The stance; its robot has a compass.
        docks: Docks of a robot.
        stays: Contacts of the dock that the robot flipped about, which most often still are.
    """
    if entry.orientation_wxyz is None:
        raise ValueError("a robot without a compass has no line")
    parts = np.array(entry.orientation_wxyz)
    if to.bits is None:
        to.reals(parts, 1.0)
    else:
        # q and -q are one rotation: the largest part is made positive, and follows from the others.
        largest = int(np.abs(parts).argmax())
        to.number(largest, 2)
        smaller = np.delete(parts * np.copysign(1.0, parts[largest]), largest)
        to.reals(smaller, _CORNER, _fewer(to.bits, _ANGLE))
    contacts = sorted(entry.contacts)
    for contact in stays:
        to.number(contact in contacts, 1)
    fresh = [contact for contact in contacts if contact not in stays]
    to.number(len(fresh), COUNT)
    for dock, neighbor, neighbor_dock in fresh:
        to.number(dock, _dock_bits(docks))
        to.number(neighbor, NUMBER)
        to.number(neighbor_dock, _dock_bits(docks))
    ground = entry.ground_docks or []
    for dock in range(docks):
        to.number(dock in ground, 1)


def _read_stance(source: Reader, docks: int, stays: list[list[int]]) -> dict[str, Any]:
    if source.bits is None:
        parts = source.reals(AXES + 1, 1.0)
    else:
        largest = source.number(2)
        smaller = source.reals(AXES, _CORNER, _fewer(source.bits, _ANGLE))
        rest = math.sqrt(max(1.0 - float(smaller @ smaller), 0.0))
        parts = np.insert(smaller, largest, rest)
        parts /= np.linalg.norm(parts)
    contacts = [item for item in stays if source.number(1)]
    size = _dock_bits(docks)
    contacts += [
        [source.number(size), source.number(NUMBER), source.number(size)]
        for _ in range(source.number(COUNT))
    ]
    ground = [dock for dock in range(docks) if source.number(1)]
    return {
        "orientation_wxyz": parts.tolist(),
        "contacts": sorted(contacts),
        "ground_docks": ground,
    }


class AnswerContent(NamedTuple):
    """What a robot says of itself, or one that solved says of it."""

    sharing: tuple[int, ...]
    place: Whereabouts | None
    candidates: Reals
    line: bytes
    span: tuple[int, int] | None
    is_surprising: bool


class Asked(NamedTuple):
    """What is asked of a robot."""

    wants_line: bool
    checksum: int
    """Of its place as the one that asks holds it; 0 if it holds none."""
    since: int
    """Robot that joined as it was asked last: it says which have joined since."""


def write_question(question: Asked) -> bytes:
    """Write what is asked of a robot."""
    part = Writer(None)
    part.number(question.wants_line, 1)
    part.number(question.checksum, CHECK)
    part.number(question.since, NUMBER)
    return part.to_bytes()


def read_question(part: bytes) -> Asked:
    """Read what is asked of a robot."""
    asked = Reader(part, None)
    return Asked(asked.number(1) == 1, asked.number(CHECK), asked.number(NUMBER))


def write_answer(
    place: Whereabouts | None,
    candidates: Reals | None,
    span: tuple[int, int] | None,
    sharing: Iterable[int],
    bits: int | None,
) -> bytes:
    """Write what a robot says of itself, without its line; candidates follow a place only."""
    to = Writer(bits)
    to.number(place is not None, 1)
    write_span(to, span)
    write_numbers(to, sharing)
    if place is not None:
        write_place(to, place)
        if candidates is not None:
            write_candidates(to, candidates)
    return to.to_bytes()


def write_result(
    place: Whereabouts, candidates: Reals | None, bits: int | None, *, is_surprising: bool
) -> bytes:
    """Write where a robot is, with places that its rows allow if they are to travel."""
    to = Writer(bits)
    to.number(candidates is not None, 1)
    to.number(is_surprising, 1)
    write_place(to, place)
    if candidates is not None:
        write_candidates(to, candidates)
    return to.to_bytes()


@lru_cache(maxsize=20_000)
def read_answer(content: bytes, bits: int | None, with_candidates: bool) -> AnswerContent:  # noqa: FBT001
    """Read what a robot says of itself."""
    answer = Reader(content, bits)
    is_placed, span = answer.number(1), read_span(answer)
    sharing = tuple(read_numbers(answer))
    place = read_place(answer) if is_placed else None
    candidates = read_candidates(answer) if is_placed and with_candidates else _NO_CANDIDATES
    return AnswerContent(sharing, place, candidates, answer.rest, span, is_surprising=False)


@lru_cache(maxsize=20_000)
def read_result(content: bytes, bits: int | None) -> AnswerContent:
    """Read what one that solved says of a robot."""
    answer = Reader(content, bits)
    has_candidates, is_surprising = answer.number(1), answer.number(1) == 1
    place = read_place(answer)
    candidates = read_candidates(answer) if has_candidates else _NO_CANDIDATES
    return AnswerContent(
        sharing=(),
        place=place,
        candidates=candidates,
        line=b"",
        span=None,
        is_surprising=is_surprising,
    )
