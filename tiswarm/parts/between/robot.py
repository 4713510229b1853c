"""One robot: what it holds, what it answers, and how it solves for the robots near it.

A robot reads its own memory and the bytes that it hears. It has no other way to another robot.

1. It joins, and lets the robots that it has rows about know that they share rows. It sends its line
   to the first that it touches. This one passes it on to its keeper: the nearest robot that moved
   it before. Without one that is near it becomes a keeper itself. A base keeps all.
2. The keeper asks robots step by step of "shares a row", unless what it holds of them is current:
   whom they share rows with, where they are, and what they sensed if it does not hold that.
3. It solves, and sends each robot that moved its new place. Who is moved lets all others that hold
   its place know that they hold it no more.

The layers of `online` run on the robots that it holds alone. Rows about others are left out: where
rows of a block have noise in common, that of those which are left stays as it is. Lengths in R,
relative to the anchor.

Settings were chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on.
"""

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.chains.annealer import Annealer
from tiswarm.localization.chains.problem import Planes, fewest_contacts
from tiswarm.localization.chains.views import (
    ANNEALING,
    ChainView,
    Links,
    cooled,
    find_subtrees,
)
from tiswarm.localization.cost import EXTENSION, ROBUST_SD
from tiswarm.localization.cost.cost import State, weights
from tiswarm.measurements.odometry import CENTER
from tiswarm.parts.between import DistributedParams, wire
from tiswarm.parts.between.channel import Message
from tiswarm.parts.online import CANDIDATES, NEIGHBORS
from tiswarm.parts.online.kernels import (
    COORDINATE,
    OFFSET,
    BlockStart,
    RowLabel,
    RowValue,
    Table,
)
from tiswarm.parts.online.layers import Joiner, LocalLayers, measured
from tiswarm.parts.online.neighborhood import Block, NearCost
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import LISTS

_AXES = 3
_TEMPERED = 4.0
"""Divisor of costs by which ends of chains weigh in standard deviations [1]: few chains meet few of
the likely minima. Chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on."""


@dataclass(frozen=True, kw_only=True)
class AnswerSettings:
    """What is worth a message."""

    moved: float = 0.02
    """Shift from which on a robot hears where it is now [R]."""

    turned: float = 0.2
    """Turn from which on it does [standard deviations]."""

    doubtful_sd: float = 1.0
    """Standard deviation from which on a robot doubts its position: half a dock diameter [R]."""

    stays_sd: float = 0.05
    """Standard deviation of each coordinate of a robot whose other rows are not here: the robots
    that solved for it know more of it [R]."""


ANSWERS = AnswerSettings()

OF_ROW = 40
"""Operations for the residual of a row and its derivatives [1]."""
OF_PAIR = 10
"""Operations to find whether two robots are near [1]."""
_LEVEL = [1.0, 0.0, 0.0, 0.0]

_SIZE = 2
"""Bytes of a number or a length between lines."""

_FARTHEST = 255
"""Contacts up to which a message counts those that it takes."""


@dataclass
class Known:
    """What a robot holds of one robot, itself included."""

    line: bytes = b""
    """What it sensed, as sent; empty if unknown."""

    place: wire.Whereabouts | None = None
    """Where it is; None if unknown."""

    candidates: Reals = field(default_factory=lambda: np.empty((0, _AXES)))
    """Where else it may be, relative to the mean of those it shares rows with [R], (k, 3)."""

    sharing: set[int] = field(default_factory=set)
    """Robots that are known to share rows with it."""

    is_surprising: bool = False
    """Whether chance does not explain its rows and overlaps, as the one that solved for it says."""

    is_current: bool = False
    """Whether it lets the robot that holds this know as it moves."""


@dataclass(frozen=True, eq=False)
class Program:
    """What every robot is programmed with; it says nothing of other robots."""

    params: DistributedParams
    header: HeaderLine
    """First line of a sensing file."""

    @property
    def docks(self) -> int:
        """Docks of a robot."""
        return len(self.header.dock_offsets)

    def decoded(self, line: bytes) -> RobotLine:
        """Read a line as it was sent."""
        return _decoded(line, self.docks, self.params.bits)

    def partners(self, line: bytes) -> set[int]:
        """List the robots that a line has rows about."""
        entry = self.decoded(line)
        return {
            item[key.robot]
            for stance in (entry, *(entry.stances or []))
            for name, key in LISTS.items()
            if key.robot is not None
            for item in getattr(stance, name) or []
        }


class Solved(NamedTuple):
    """What a robot found out."""

    places: Mapping[int, wire.Whereabouts]
    """Places of robots that moved, and of the one that was solved for, by number."""

    surprising: set[int]
    """Those of them whose rows and overlaps chance does not explain."""

    candidates: Reals
    """As in `Known`, of the one that was solved for."""

    operations: float
    """Additions and multiplications that it took, about."""


@lru_cache(maxsize=20_000)
def _decoded(line: bytes, docks: int, bits: int | None) -> RobotLine:
    return wire.read_line(line, docks, bits)


class LocalSwarm:
    """The robots that one robot holds lines of, numbered anew in join order; 0 is the anchor."""

    def __init__(self, program: Program, known: Mapping[int, Known]) -> None:
        """Measure the rows of robots among each other, and put them where they are known to be."""
        held = {n: each for n, each in known.items() if each.line}
        self.numbers: Ints = np.array(sorted({0, *held}), np.int64)
        self._index = {number: k for k, number in enumerate(self.numbers.tolist())}
        self._program, self._params = program, _precise(program, known)
        self.layers = LocalLayers(program.docks, self._params)
        position, turn, sd = (np.zeros((len(held) + 1, _AXES)) for _ in range(3))
        for number, k in self._index.items():
            each = held.get(number, Known())
            lines = {n: other.line for n, other in held.items()}
            # A robot whose other rows are not here is held by where it is.
            is_whole = each.place is None or each.sharing <= held.keys()
            block = self._block(number, lines, None if is_whole or not number else each.place)
            self.layers.append(Joiner(block, self._touching(program, each.line)))
            self.layers.places[k] = each.candidates
            if each.place is not None:
                position[k], turn[k], sd[k, 0] = each.place
        count = len(self.numbers)
        self.layers.state = State(position[:count], turn[:count])
        self.layers.sd = sd[:count, 0]

    def solve(self, number: int, *, anew: bool, everywhere: bool = False) -> Solved:
        """Solve for a robot and those near it.

        Args:
            number: The robot.
            anew: Whether to look for its place among all that its rows allow.
            everywhere: Whether to anneal all robots.
        """
        layers, k = self.layers, self._index[number]
        before = State(*(each.copy() for each in layers.state))
        # A robot that has a place keeps it, unless those near it move.
        layers.solve_near(k, layers.place(k) if anew else None)
        if self._program.params.chains:
            moving = np.arange(len(self.numbers)) if everywhere else self.layers.near(k)
            found = annealed(layers, moving, self._program.params, number)
            layers.state, layers.sd[moving] = found.state, found.sd
        state = layers.state
        apart = np.linalg.norm(state.position - before.position, axis=1)
        turned = np.linalg.norm(state.turn - before.turn, axis=1)
        # Who sends exact numbers sends all of them.
        least = 0.0 if self._program.params.bits is None else 1.0
        has_moved = (apart > least * ANSWERS.moved) | (turned > least * ANSWERS.turned)
        has_moved[k] = True
        moved = np.flatnonzero(has_moved)
        number_of = self.numbers[moved].tolist()
        places = [
            wire.Whereabouts(state.position[j].copy(), state.turn[j].copy(), float(layers.sd[j]))
            for j in moved.tolist()
        ]
        surprising = layers.surprising(moved)
        return Solved(
            dict(zip(number_of, places, strict=True)),
            {n for n, is_surprise in zip(number_of, surprising, strict=True) if is_surprise},
            layers.places[k],
            self._operations(k, anew=anew),
        )

    def _operations(self, k: int, *, anew: bool) -> float:
        """Count what a search for candidates, linear problems and chains take, about."""
        params, near = self._program.params, self.layers.near(k)
        own, rows = len(self.layers.blocks[k]), [len(self.layers.blocks[j]) for j in near.tolist()]
        search = CANDIDATES.starts * CANDIDATES.rounds * OF_ROW * own**2 if anew else 0
        linear = sum(OF_ROW * m**2 for m in rows) + (2 * _AXES * len(near)) ** 3 / 3
        step = OF_ROW * 2 * sum(rows) + OF_PAIR * len(near) * len(self.numbers)
        rounds = NEIGHBORS.rounds * (1 + params.chains)
        return float(search + rounds * linear + params.chains * params.steps * step)

    def _block(
        self, number: int, lines: Mapping[int, bytes], stays: wire.Whereabouts | None
    ) -> Block:
        """Measure the rows of a robot about those that are held, and where it stays, if it does."""
        members = [0]
        if number:
            others = self._program.partners(lines[number]) & lines.keys()
            members = [*sorted(others | {0}), number]
        place = None if stays is None else tuple(stays.position.tolist())
        sent = tuple(lines.get(each, b"") for each in members)
        block = _measured(self._program, self._params, sent, place)
        return replace(block, members=np.array([self._index[n] for n in members]))

    def _touching(self, program: Program, line: bytes) -> set[tuple[int, int, int]]:
        """List docks of a robot in contact with those of robots that are held."""
        if not line:
            return set()
        rows = program.decoded(line).contacts
        return {
            (dock, self._index[other], its) for dock, other, its in rows if other in self._index
        }


def _precise(program: Program, known: Mapping[int, Known]) -> DistributedParams:
    """Return the settings for layers, in which rounding of what was sent counts as noise."""
    params = program.params
    places = [each.place.position for each in known.values() if each.place is not None]
    farthest = float(np.abs(places).max()) if places else 1.0
    rounding = wire.rounding_sd(farthest, params.bits)
    return replace(
        params,
        contact_sd=float(np.hypot(params.contact_sd, rounding)),
        height_sd=float(np.hypot(params.height_sd, rounding)),
    )


def _held(line: RobotLine, center: Reals, unit: float) -> RobotLine:
    """Add to a line that the robot is where it is [log unit]."""
    axes = np.eye(_AXES)
    fixes = [(*axis.tolist(), float(axis @ center), ANSWERS.stays_sd * unit) for axis in axes]
    return line.model_copy(update={"fixes": [*(line.fixes or []), *fixes]})


_ANCHOR = RobotLine.model_validate({"robot": -1, "orientation_wxyz": _LEVEL, "contacts": []})
"""An anchor that nothing is known about but its place: what robots sensed of it is left out."""


@lru_cache(maxsize=20_000)
def _measured(
    program: Program,
    params: DistributedParams,
    lines: tuple[bytes, ...],
    stays: tuple[float, ...] | None,
) -> Block:
    """Measure the rows of a robot about others, which stand.

    Args:
        program: Of every robot.
        params: Settings of the layers.
        lines: Of the robots that it names and are held, and of itself, in join order; the first is
            the anchor's, empty if nothing is known about it.
        stays: Where the robot stays [R]; None if it may move.
    """
    # The second version knows fixes, by which robots are held.
    head = program.header.model_copy(update={"version": 2})
    robots = [program.decoded(line) if line else _ANCHOR for line in lines]
    if stays is not None:
        center = np.array(stays) * head.dock_radius + head.anchor_position
        robots[-1] = _held(robots[-1], center, head.dock_radius)
    builder = SensingLogBuilder(head, of_some=True)
    for robot in robots:
        builder.add(robot)
    return measured(*builder.log_of(len(robots) - 1), params).block


@dataclass
class _Search:
    """What a robot that solves has asked so far."""

    joiner: int
    step: dict[int, int]
    """Steps of "shares a row" to each robot that it knows to be near."""
    current: int = 0
    """Robots within so many steps have answered."""
    waiting: set[int] = field(default_factory=set)
    answered: set[int] = field(default_factory=set)
    attempt: int = 0


class Peer:
    """A robot of a swarm that localizes itself."""

    def __init__(self, program: Program, line: RobotLine) -> None:
        """Begin with what the robot sensed, under its number in join order."""
        self._program = program
        self.number = line.robot
        content = wire.line_bytes(line, program.docks, program.params.bits)
        partners = program.partners(content)
        self.known: dict[int, Known] = {line.robot: Known(content, sharing=partners)}
        self.touching = sorted({other for _, other, _ in line.contacts})
        self.outbox: list[Message] = []
        self._hosts = [self.number]
        if program.params.solver != "joiner":
            self._hosts = [*self.touching, self.number]
        # Robots that moved this one, and contacts to them.
        self._keepers: dict[int, int] = {}
        # Robots that rely on hearing of it when this one moves.
        self._watchers: set[int] = set()
        self._search: _Search | None = None
        self._solved, self._annealed = 0, 0
        self.operations = 0.0

    @property
    def place(self) -> wire.Whereabouts | None:
        """Where the robot takes itself to be; None if it does not know."""
        return self.known[self.number].place

    def join(self) -> None:
        """Let robots know that rows are shared; the first of the swarm is the anchor."""
        mine = self.known[self.number]
        if self.number == 0:
            mine.place = wire.Whereabouts(np.zeros(3), np.zeros(3), 0.0)
            return
        host = self._hosts.pop(0)
        # Who has been named knows that it shares rows; who solves has to know the rows.
        parts = dict.fromkeys(sorted(self._program.partners(mine.line) - {host}), b"")
        if host == self.number:
            self._say("join", b"", parts)
            self._begin(host)
        else:
            self._say("join", b"", parts | {host: mine.line})

    def hear(self, message: Message) -> Message:
        """Take in a message, whether it was for this robot or passes by; return what goes on."""
        if message.kind == "join":
            self._hear_join(message)
        elif message.kind == "ask":
            return self._hear_ask(message)
        elif message.kind == "answer":
            self._hear_answer(message)
        elif message.kind == "lines":
            for part in message.parts.values():
                self._hear_lines(part)
        elif message.kind == "moved" and self.number in message.parts:
            self._of(message.sender).is_current = False
        elif message.kind == "task" and self.number in message.parts:
            self._take(message.parts[self.number])
        elif message.kind == "place":
            return self._hear_places(message)
        return message

    def _hear_places(self, message: Message) -> Message:
        """Take in where robots are, and count the contact to the next one."""
        for number, part in message.parts.items():
            self._hear_place(number, part)
        [contacts] = message.common
        if self.number in message.parts:
            self._follow(message.sender, contacts)
        return message._replace(common=bytes([min(contacts + 1, _FARTHEST)]))

    def _follow(self, keeper: int, contacts: int) -> None:
        """Take note of a robot that moved this one, and let others that hold it know."""
        self._keepers[keeper] = contacts
        others = self._watchers - {keeper}
        self._watchers = {keeper}
        self._say("moved", b"", dict.fromkeys(sorted(others), b""))

    def _take(self, line: bytes) -> None:
        """Become the keeper of a robot, which sent this line."""
        number = self._program.decoded(line).robot
        joiner = self._of(number)
        joiner.line = line
        joiner.sharing |= self._program.partners(line)
        for partner in joiner.sharing & self.known.keys():
            self.known[partner].sharing.add(number)
        self._begin(number)
        self._forget()

    @property
    def _exchanges(self) -> bool:
        """Whether candidates travel: who anneals finds other images without them."""
        return not self._program.params.chains

    @property
    def waits(self) -> bool:
        """Whether the robot still waits for something."""
        return self._search is not None or (self.place is None and bool(self._hosts))

    def expire(self) -> None:
        """Go on although nothing more was heard."""
        search = self._search
        if search is None:
            self.join()
        elif search.attempt < self._program.params.retries:
            search.attempt += 1
            self._ask(search.waiting)
        else:
            search.waiting.clear()
            self._advance()

    def judge(self) -> bool:
        """Judge whether the robot doubts where it is, by what it heard.

        It does if chance does not explain its rows and overlaps, if its standard deviation is
        large, or if it heard of no place.
        """
        if self.place is None or self.place.sd > ANSWERS.doubtful_sd:
            return True
        return self.known[self.number].is_surprising

    @property
    def memory(self) -> int:
        """Bytes of what the robot holds."""
        bits = self._program.params.bits or 64
        return sum(
            len(each.line)
            + (wire.NUMBER * (1 + len(each.sharing)) + bits * (6 + each.candidates.size) + 8 + 7)
            // 8
            for each in self.known.values()
        )

    def _say(self, kind: str, common: bytes, parts: dict[int, bytes]) -> None:
        if parts:
            self.outbox.append(Message(kind, self.number, common, parts))

    def _of(self, number: int) -> Known:
        return self.known.setdefault(number, Known())

    def _hear_join(self, message: Message) -> None:
        """Take in that a robot shares rows with others, and see that somebody solves for it."""
        for partner in message.parts.keys() & self.known.keys():
            self.known[partner].sharing.add(message.sender)
        if line := message.parts.get(self.number):
            keeper = self._keeper()
            if keeper == self.number:
                self._take(line)
            else:
                self._say("task", b"", {keeper: line})

    def _keeper(self) -> int:
        """Choose who solves for a robot that touches this one, perhaps this one itself."""
        params = self._program.params
        if params.solver == "base":
            return 0
        contacts, keeper = min(
            ((contacts, keeper) for keeper, contacts in self._keepers.items()), default=(0, 0)
        )
        return keeper if 0 < contacts <= params.reach else self.number

    def _begin(self, joiner: int) -> None:
        """Begin to solve for a robot."""
        self._search = _Search(joiner, {joiner: 0})
        self._advance()

    def _advance(self) -> None:
        """Ask the robots a step farther; solve once there are no more."""
        search = self._search
        params = self._program.params
        while search is not None and not search.waiting:
            if search.current == params.hops or not self._widen(search):
                self._search = None
                self._solve(search)
                return
            search.current += 1
            search.attempt = 0
            there = {n for n, step in search.step.items() if step == search.current}
            search.waiting = {n for n in there if not self._is_current(n)}
            if search.waiting:
                self._ask(search.waiting)

    def _is_current(self, number: int) -> bool:
        """Judge whether nothing is to be asked of a robot: it lets this one know as it moves."""
        its = self._of(number)
        return number == self.number or (its.is_current and bool(its.line))

    def _widen(self, search: _Search) -> bool:
        """Number the robots a step farther; return whether there are any."""
        last = [n for n, step in search.step.items() if step == search.current]
        further = {other for n in last for other in self._of(n).sharing} - search.step.keys()
        room = self._program.params.robots - len(search.step)
        # The last that joined are the least known.
        chosen = sorted(further, reverse=True)[: max(room, 0)]
        search.step |= dict.fromkeys(chosen, search.current + 1)
        return bool(chosen)

    def _ask(self, robots: Iterable[int]) -> None:
        """Ask robots for what this one does not hold of them."""
        parts = {}
        for number in sorted(robots):
            parts[number] = wire.asking(not self._of(number).line, self._checksum(number))
        self._say("ask", b"", parts)

    def _answer(self, asker: int, part: bytes) -> None:
        """Answer what a robot asked."""
        asked, mine = wire.Reader(part, None), self.known[self.number]
        wants_line, held = asked.number(1), asked.number(wire.CHECK)
        self._watchers.add(asker)
        head = self._head() if held != self._checksum(self.number) else b"\0"
        line = mine.line if wants_line else b""
        self._say("answer", len(head).to_bytes(_SIZE, "big") + head + line, {asker: b""})

    def _head(self) -> bytes:
        """Write with whom this robot shares rows, and where it is."""
        mine = self.known[self.number]
        answer = wire.Writer(self._program.params.bits)
        answer.number(1, 1)
        answer.number(mine.place is not None, 1)
        wire.write_numbers(answer, mine.sharing)
        if mine.place is not None:
            wire.write_place(answer, mine.place)
            if self._exchanges:
                wire.write_candidates(answer, mine.candidates)
        return answer.to_bytes()

    def _hear_answer(self, message: Message) -> None:
        length, content = int.from_bytes(message.common[:_SIZE], "big"), message.common[_SIZE:]
        its = self._of(message.sender)
        its.line = content[length:] or its.line
        answer = wire.read_answer(content[:length], self._program.params.bits, self._exchanges)
        if answer.is_new:
            its.sharing, its.place = {*answer.sharing}, answer.place or its.place
            its.candidates = answer.candidates
        if self.number in message.parts:
            its.is_current = True
        # By radio, robots hear answers that others asked for.
        if self._search is not None:
            self._search.answered.add(message.sender)
            self._check_off()

    def _hear_ask(self, message: Message) -> Message:
        """Answer a question, or hand out lines as one passes by."""
        if self.number in message.parts:
            self._answer(message.sender, message.parts[self.number])
        elif self._program.params.channel == "touch":
            return self._hand_out(message)
        return message

    def _hand_out(self, message: Message) -> Message:
        """Answer with lines that this robot holds of others that are asked for them."""
        found, parts = b"", {**message.parts}
        for number, part in message.parts.items():
            line = self.known[number].line if number in self.known else b""
            asked = wire.Reader(part, None)
            if asked.number(1) and line:
                found += number.to_bytes(_SIZE, "big") + len(line).to_bytes(_SIZE, "big") + line
                parts[number] = wire.asking(0, asked.number(wire.CHECK))
        if found:
            self._say("lines", b"", {message.sender: found})
        return message._replace(parts=parts)

    def _hear_lines(self, part: bytes) -> None:
        while part:
            number, size = (int.from_bytes(part[k : k + _SIZE], "big") for k in (0, _SIZE))
            self._of(number).line, part = part[2 * _SIZE :][:size], part[2 * _SIZE + size :]
        if self._search is not None:
            self._check_off()

    def _check_off(self) -> None:
        """Wait no longer for robots that have answered and whose lines are here."""
        search = self._search
        if search is not None and search.waiting:
            search.waiting -= {n for n in search.answered if self._of(n).line}
            self._advance()

    def _hear_place(self, number: int, part: bytes) -> None:
        answer, its = wire.read_result(part, self._program.params.bits), self._of(number)
        its.place, its.is_surprising = answer.place, answer.is_surprising
        if len(answer.candidates):
            its.candidates = answer.candidates

    def _checksum(self, number: int) -> int:
        """Check what this robot holds of one, against what that holds of itself."""
        its = self._of(number)
        if its.place is None:
            return 0
        text = wire.Writer(self._program.params.bits)
        wire.write_numbers(text, its.sharing)
        wire.write_place(text, its.place)
        return zlib.crc32(text.to_bytes()) % int(2**wire.CHECK - 1) + 1

    def _placed(self) -> dict[int, Known]:
        """List the robots whose lines and places are held."""
        return {n: each for n, each in self.known.items() if each.line and each.place is not None}

    def _solve(self, search: _Search) -> None:
        """Solve for a robot with what is held, and send new places."""
        joiner = search.joiner
        held = self._placed()
        near = {n: each for n, each in held.items() if n in search.step or self._is_current(n)}
        near[joiner] = self.known[joiner]
        if 0 in held:
            near[0] = held[0]
        solved = LocalSwarm(self._program, near).solve(
            joiner, anew=near[joiner].place is None, everywhere=self._has_grown(len(near))
        )
        # Thinking costs a robot energy, too.
        self.operations += solved.operations
        parts = {}
        for number, place in solved.places.items():
            part = wire.Writer(self._program.params.bits)
            part.number(number == joiner and self._exchanges, 1)
            part.number(number in solved.surprising, 1)
            wire.write_place(part, place)
            if number == joiner and self._exchanges:
                wire.write_candidates(part, solved.candidates)
            parts[number] = part.to_bytes()
            # The robot holds what others hear, rounded as it is.
            self._hear_place(number, parts[number])
            self._of(number).is_current = True
        if parts.pop(self.number, None):
            self._follow(self.number, 0)
        self._say("place", b"\1", parts)

    def _has_grown(self, robots: int) -> bool:
        """Count one more robot solved for, and judge whether all that are held are due."""
        self._solved += 1
        is_due = self._solved - self._annealed >= self._program.params.growth * robots
        if is_due:
            self._annealed = self._solved
        return is_due

    def _forget(self) -> None:
        """Drop lines beyond as many as there is room for.

        Those that are not current go first, then those of the robots heard of first.
        """
        lines = [n for n, each in self.known.items() if each.line and n != self.number]
        busy = {} if self._search is None else self._search.step
        # Those asked about now are needed.
        beyond = max(len(lines) - self._program.params.robots, 0)
        spare = sorted((n for n in lines if n not in busy), key=self._is_current)
        for number in spare[:beyond]:
            del self.known[number]


class NearAnnealed(NamedTuple):
    """The best of several chains, for the K robots that moved."""

    state: State
    """All robots."""

    sd: Reals
    """Standard deviation of each position, over the chains too [R], shape (K,)."""


def annealed(
    layers: LocalLayers, moving: Ints, params: DistributedParams, number: int
) -> NearAnnealed:
    """Anneal some robots from where they are, and keep the likeliest end.

    Args:
        layers: The robots that are held.
        moving: Those that may move, ascending, shape (K,).
        params: Settings.
        number: Number of the robot that is solved for, which kicks depend on.
    """
    problem = layers.neighborhood(moving)
    begin, turn = layers.state[:2]
    view = view_near(layers, moving, problem, params)
    seed = (params.seed * 4_099 + number) % 2**31
    [chains] = Annealer([view], seed=seed, hold=1, is_short=True).run(frames=2)
    starts = [State(each.copy(), turn.copy()) for each in (begin, *chains.last)]
    found = [problem.refine(start) for start in starts]
    reach = problem.shapes.reach
    score = np.array([each[1].cost - _gain(layers, moving, each[0], reach) for each in found])
    best = int(score.argmin())
    state, linear = found[best]
    # Ends that are nearly as likely as the best one make its position uncertain.
    weight = weights(score, _TEMPERED)
    away = [((each.position - state.position)[moving] ** 2).sum(axis=1) for each, _ in found]
    spread = weight @ np.array(away)
    return NearAnnealed(state, np.sqrt(linear.sd() ** 2 + spread))


def _gain(layers: LocalLayers, moving: Ints, state: State, reach: float) -> float:
    """Compute what some robots gain by their extension [1], up to the reach of a contact [R]."""
    total = 0.0
    for k in moving.tolist():
        partners = layers.blocks[k].partners
        if len(partners):
            apart = np.linalg.norm(state.position[partners] - state.position[k], axis=1)
            # Beyond its reach a contact would give way, and the robot would gain by that.
            total += 2.0 * EXTENSION * float(np.minimum(apart, reach).mean())
    return total


def view_near(
    layers: LocalLayers, moving: Ints, problem: NearCost, params: DistributedParams
) -> ChainView:
    """Describe what a robot heard as chains see it; turns of orientations are noise here."""
    begin, robots = layers.state.position, len(layers.blocks)
    shapes, table = problem.shapes, problem.table
    moves = np.isin(np.arange(robots), moving[moving > 0])
    robust = ROBUST_SD**-2 * params.robust
    links = _links_of(layers.blocks_about(moving), table, robots)
    planes = _planes_of(table)
    # A subtree moves if all its robots do, and nothing measures where they are.
    stops = planes.along(robots) | ~moves[:, None]
    return ChainView(
        arm=shapes.arm,
        begin=np.tile(begin, (params.chains, 1, 1)),
        moves=moves,
        repels=params.non_overlap & ~np.isin(np.arange(robots), [*shapes.gone]),
        sigma=cooled(params.start_sigma, ANNEALING.coldest, params.steps, 1),
        robust=robust,
        yaw_precision=0.0,
        links=links,
        planes=planes,
        plane_robust=np.full(len(planes.robot), robust),
        forest=find_subtrees(
            np.column_stack([links.robot, links.other]), np.zeros(1, np.int64), robots
        ),
        stops=stops,
    )


def _links_of(blocks: list[Block], table: Table, robots: int) -> Links:
    """Lay out the pairs of some blocks, which are those of the table."""
    count = np.diff(table.block[:, BlockStart.ROW])
    first = np.repeat(table.block[:-1, BlockStart.MEMBERS], count)
    row = np.arange(len(first)) - np.repeat(table.block[:-1, BlockStart.ROW], count)
    kind = table.number[:, RowLabel.KIND]
    is_pair = kind != COORDINATE
    begins = (table.number[:, RowLabel.FIRST] == row)[is_pair]
    at = np.flatnonzero(is_pair)[begins]
    tables = [each for b in blocks for each in (b.rows.distances, b.rows.offsets)]
    final = np.repeat(
        [b.rows.odometry.final[-1] for b in blocks for _ in range(2)],
        [len(each.stance) for each in tables],
    )
    stance = np.concatenate([each.stance for each in tables])
    dock = np.concatenate([each.dock for each in tables])
    is_final = ((stance == final) & (dock != CENTER))[begins]
    is_offset = kind[at] == OFFSET
    vector = np.zeros((len(at), _AXES))
    vector[is_offset] = np.concatenate([b.rows.offsets.vector[::_AXES] for b in blocks])
    real = table.real[at]
    total = np.bincount(np.cumsum(begins) - 1, table.real[is_pair, RowValue.VARIANCE], len(at))
    robot = table.member[first[at]].astype(np.int64)
    other = table.member[first[at] + table.number[at, RowLabel.MEMBER]].astype(np.int64)
    share = is_final / fewest_contacts(np.column_stack([robot, other]), is_final, robots)
    return Links(
        robot=robot,
        other=other,
        is_final=is_final,
        is_offset=is_offset,
        is_touch=np.zeros(len(at), np.bool_),
        arms=real[:, RowValue.ARM : RowValue.TAIL]
        - real[:, RowValue.OTHER_ARM : RowValue.VALUE]
        - vector,
        length=real[:, RowValue.VALUE],
        variance=real[:, RowValue.VARIANCE],
        across=np.where(is_offset, 0.5 * (total - real[:, RowValue.VARIANCE]), 0.0),
        extension=np.where(is_offset, 0.0, EXTENSION * share),
        levers=np.zeros((len(at), 4)),
        vector=vector,
        candidates=np.empty((0, blocks[0].arm.shape[0], 2 * _AXES)),
    )


def _planes_of(table: Table) -> Planes:
    """Turn the coordinates of a table into planes."""
    at = np.flatnonzero(table.number[:, RowLabel.KIND] == COORDINATE)
    own = np.repeat(
        table.member[table.block[:-1, BlockStart.MEMBERS]], np.diff(table.block[:, BlockStart.ROW])
    )
    real = table.real[at]
    direction = real[:, RowValue.AXIS : RowValue.ARM]
    value = real[:, RowValue.VALUE] - (direction * real[:, RowValue.ARM : RowValue.TAIL]).sum(
        axis=1
    )
    return Planes(
        robot=own[at].astype(np.int64),
        direction=direction,
        point=direction * value[:, None],
        walk=np.zeros((len(at), 2)),
        precision=1.0 / real[:, RowValue.VARIANCE],
    )
