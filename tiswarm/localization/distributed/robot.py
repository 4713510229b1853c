"""One robot: what it holds, what it answers, and how it solves for the robots near it.

A robot reads its own memory and the bytes that it hears. It has no other way to another robot.

1. It joins, and lets the robots that it has rows about know that they share rows. It sends its line
   to the first that it touches. This one passes it on to its keeper: the nearest robot that moved
   it before. Without one that is near it becomes a keeper itself. A base keeps all.
2. The keeper asks robots step by step of "shares a row", unless what it holds of them is current:
   whom they share rows with, where they are, and what they sensed if it does not hold that.
3. It solves, and sends each robot that moved its new place. Who is moved lets all others that hold
   its place know that they hold it no more.
4. After `tenure` joins it solves for no more, and another robot takes over.
5. In a review a message walks along first contacts, from robot to robot and back. Whom it reaches
   solves again for all that it solved for. What hangs on these robots moves as one: otherwise
   those that are not asked would hold a structure that is to shift as a whole.
   Who waits for the return of the message sends it again. A robot that heard of no partner solves
   for itself when it comes.
6. A robot that touches none, and all that hang on it, are a body of their own, in which they know
   where they are. Who touches two bodies joins them: its keeper solves for it in one of them, then
   for the shift of the other as one. A message around lets that one hang on the new robot.

The layers of `online` run on the robots that it holds alone. Rows about others are left out: where
rows of a block have noise in common, that of those which are left stays as it is. Lengths in R,
relative to the anchor.

Settings were chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on.
"""

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.channel import Message, pause
from tiswarm.localization.distributed.local_swarm import LocalSwarm, Solution
from tiswarm.localization.distributed.memory import Record
from tiswarm.localization.distributed.program import ANSWERS, Program
from tiswarm.records.sensing_format import RobotLine

_READS_ALL = ("join", "ask", "answer", "lines", "place")
"""Messages that robots read although they pass by."""

_SIZE = 2
"""Bytes of a number or a length between lines."""

_FARTHEST = 255
"""Contacts up to which a message counts those that it takes."""


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
    walked: int | None = None
    """Robots that a walk has come to, which goes on once this is solved; None without one."""
    is_review: bool = False
    """Whether to solve again for all that the robot solved for."""


class Peer:
    """A robot of a swarm that localizes itself."""

    def __init__(self, program: Program, line: RobotLine) -> None:
        """Begin with what the robot sensed, under its number in join order."""
        self._program = program
        self.number = line.robot
        content = wire.line_bytes(line, program.docks, program.params.bits)
        partners = program.partners(content)
        self.records: dict[int, Record] = {line.robot: Record(content, sharing=partners)}
        self.touching = sorted({other for _, other, _ in line.contacts})
        self.outbox: list[Message] = []
        self._hosts = [self.number]
        if program.params.solver != "joiner":
            self._hosts = [*self.touching, self.number]
        # Robots that moved this one, and contacts to them.
        self._keepers: dict[int, int] = {}
        # The robot that another keeper may have to solve for, and its line.
        self._hosted: tuple[int, bytes] | None = None
        # The robot that this one hangs on, its first contact, and those that hang on this one.
        self._parent = min(self.touching, default=None)
        self._children: set[int] = set()
        # Robots that this one solved for.
        self._kept: set[int] = set()
        # Number of the last walk, when it came here and went on, to whom it is to go, and where
        # it is; -1 if it is not at a robot that hangs on this one.
        self._walk, self._entered, self._went, self._visited = -1, 0, 0, -1
        self._left = list[int]()
        # Times that what the robot waits for was repeated.
        self._tries = 0
        # The shift by which its body joined another one, as it was sent.
        self._joined = b""
        # Robots that rely on hearing of it when this one moves.
        self._watchers: set[int] = set()
        self._search: _Search | None = None
        self._solved, self._annealed = 0, 0
        self.operations = 0.0

    @property
    def place(self) -> wire.Whereabouts | None:
        """Where the robot takes itself to be; None if it does not know."""
        return self.records[self.number].place

    def join(self) -> None:
        """Let robots know that rows are shared; the first of the swarm is the anchor."""
        mine = self.records[self.number]
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
        if message.kind in _READS_ALL:
            return getattr(self, f"_hear_{message.kind}")(message) or message
        if self.number in message.parts:
            getattr(self, f"_hear_{message.kind}")(message)
        return message

    def _hear_moved(self, message: Message) -> None:
        self._of(message.sender).is_current = False

    def _hear_task(self, message: Message) -> None:
        if self._is_busy:
            self._say("full", b"", {message.sender: b""})
        else:
            self._take(message.parts[self.number])

    def _hear_branch(self, message: Message) -> None:
        self._pass_shift(message.common)

    def _hear_shift(self, message: Message) -> None:
        """Move with the robot that this one hangs on."""
        found = wire.read_shift(message.common, self._program.params.bits)
        self._hang_on(message.sender)
        if found.body:
            self._joined = message.common
            self._join_body(self.number, found)
            self._warn(self.number)
        elif self.place is not None and found.keeper != self.number:
            mine = self.records[self.number]
            mine.place = self.place._replace(position=self.place.position + found.shift)
            self._warn(found.keeper)
        self._pass_shift(message.common)

    def _pass_shift(self, content: bytes) -> None:
        """Let robots that hang on this one move, too."""
        parted = wire.read_shift(content, self._program.params.bits).parted
        self._say("shift", content, dict.fromkeys(sorted(self._children - {*parted}), b""))

    def _join_body(self, number: int, found: wire.JointShift) -> None:
        """Move what this robot holds of one to another body, unless it is there."""
        its = self._of(number)
        if its.place is not None and its.body == found.body:
            its.place = wire.Whereabouts(
                its.place.position + found.shift,
                its.place.turn,
                float(np.hypot(its.place.sd, found.sd)),
                found.joined,
            )

    def _hang_on(self, parent: int) -> None:
        """Hang on a robot; what this one hung on before hangs on it then, as its body joined."""
        if parent == self._parent:
            return
        self._children.discard(parent)
        if self._parent is not None:
            self._children.add(self._parent)
        self._parent = parent

    def _hear_lost(self, message: Message) -> None:
        """Repeat the shift for a robot that has not heard of it."""
        if self._joined:
            self._say("shift", self._joined, {message.sender: b""})

    def _hear_hang(self, message: Message) -> None:
        self._hang(message.parts[self.number], message.common)

    def _hang(self, pair: bytes, content: bytes) -> None:
        """Hang on a robot of one body, and let the other body hang on this one."""
        parent, child = wire.read_pair(pair)
        if self._parent != parent:
            self._parent = parent
            self._say("child", b"", {parent: b""})
        self._children.add(child)
        self._joined = content
        self._say("shift", content, {child: b""})

    def _hear_child(self, message: Message) -> None:
        self._children.add(message.sender)

    def review(self) -> None:
        """Send a message around that lets each robot that solved do so again for all it solved for.

        It walks along first contacts, twice: on the first walk robots learn what hangs on whom.
        Who waits for the return of a walk sends it again.
        """
        self._enter(0, self._walk + 1)

    def _hear_walk(self, message: Message) -> None:
        count, walk = wire.read_walk(message.common)
        if walk != self._walk:
            self._hang_on(message.sender)
            if self.records[self.number].body > 0:
                self._say("lost", b"", {message.sender: b""})
            self._enter(count, walk)
        elif message.sender == self._visited:
            self._go_on(count)
        elif message.sender == self._parent:
            self._answer_walk()

    def _answer_walk(self) -> None:
        """Answer the robot that this one hangs on, which has not heard of the walk again."""
        if self._search is not None or self._visited >= 0:
            self._say("walking", b"", {self._parent or 0: b""})
        else:
            self._say_walk(self._went, self._parent)

    def _hear_walking(self, message: Message) -> None:
        if message.sender == self._visited:
            self._tries = 0

    def _enter(self, count: int, walk: int) -> None:
        """Take in a walk that comes to this robot."""
        self._walk, self._entered, self._visited = walk % wire.WALKS, count, -1
        self._left = sorted(self._children)
        if self._is_alone:
            self._begin(self.number, count + 1)
        elif walk % 2 and self._kept:
            self._review(count + 1)
        else:
            self._go_on(count + 1)

    @property
    def _is_alone(self) -> bool:
        """Whether the robot touches others, and has heard of no place among them."""
        return bool(self.touching) and (self.place is None or self.place.body == self.number)

    def _go_on(self, count: int) -> None:
        """Let a walk go to the next robot that hangs on this one, or back."""
        self._went, self._tries = count, 0
        if self._left:
            self._visited = self._left.pop(0)
            self._say_walk(count, self._visited)
            return
        self._visited = -1
        self.records[self.number].span = self._entered, count
        if self._parent is not None:
            self._say_walk(count, self._parent)
        elif self._walk % 2 == 0:
            self._enter(0, self._walk + 1)

    def _say_walk(self, count: int, robot: int | None) -> None:
        if robot is not None:
            self._say("walk", wire.write_walk(count, self._walk), {robot: b""})

    def _review(self, count: int) -> None:
        """Solve again for all that this robot solved for, then let the walk go on."""
        every = dict.fromkeys(self._kept | {self.number}, 0)
        self._search = _Search(self.number, every, walked=count, is_review=True)
        self._search.waiting = self._kept - {self.number}
        if self._search.waiting:
            self._ask(self._search.waiting)
        else:
            self._advance()

    def _hear_place(self, message: Message) -> Message:
        """Take in where robots are, and count the contact to the next one."""
        for number, part in message.parts.items():
            self._hold_place(number, part)
        [contacts] = message.common
        if self.number in message.parts:
            self._follow(message.sender, contacts)
        return message._replace(common=bytes([min(contacts + 1, _FARTHEST)]))

    def _follow(self, keeper: int, contacts: int) -> None:
        """Take note of a robot that moved this one, and let others that hold it know."""
        self._keepers[keeper] = contacts
        self._warn(keeper)
        self._watchers.add(keeper)

    def _warn(self, keeper: int) -> None:
        """Let robots that hold this one know that a keeper has moved it, but for that keeper."""
        others = self._watchers - {keeper}
        self._watchers &= {keeper}
        self._say("moved", b"", dict.fromkeys(sorted(others), b""))

    def _take(self, line: bytes) -> None:
        """Become the keeper of a robot, which sent this line."""
        number = self._program.decoded(line).robot
        self._hold_line(number, line)
        for partner in self._of(number).sharing & self.records.keys():
            self.records[partner].sharing.add(number)
        self._begin(number)
        self._forget()

    @property
    def _exchanges(self) -> bool:
        """Whether candidates travel: who anneals finds other images without them."""
        return not self._program.params.chains

    @property
    def waits(self) -> bool:
        """Whether the robot still waits for something."""
        is_lost = self.place is None and bool(self._hosts)
        return self._search is not None or self._visited >= 0 or is_lost

    def expire(self) -> int:
        """Repeat what has no answer, or go on without; return the rounds to be silent before."""
        search = self._search
        self._tries += 1
        silent = pause(self._tries)
        if search is None and self._visited < 0:
            if self._parent is not None:
                # The first notice may be lost.
                self._say("child", b"", {self._parent: b""})
            self.join()
        elif self._tries > self._program.params.retries:
            silent = 0
            if search is None:
                self._go_on(self._went)
            else:
                search.waiting.clear()
                self._advance()
        elif search is None:
            self._say_walk(self._went, self._visited)
        else:
            self._ask(search.waiting)
        return silent

    def judge(self) -> bool:
        """Judge whether the robot doubts where it is, by what it heard.

        It does if chance does not explain its rows and overlaps, if its standard deviation is
        large, or if it heard of no place relative to the anchor.
        """
        if self.place is None or self.place.body or self.place.sd > ANSWERS.doubtful_sd:
            return True
        return self.records[self.number].is_surprising

    @property
    def joins(self) -> int:
        """Joins that the robot solved."""
        return len(self._kept)

    @property
    def memory(self) -> int:
        """Bytes of what the robot holds."""
        bits = self._program.params.bits or 64
        return sum(
            len(each.line)
            + (wire.NUMBER * (1 + len(each.sharing)) + bits * (6 + each.candidates.size) + 8 + 7)
            // 8
            for each in self.records.values()
        )

    def _say(self, kind: str, common: bytes, parts: dict[int, bytes]) -> None:
        if parts:
            self.outbox.append(Message(kind, self.number, common, parts))

    def _of(self, number: int) -> Record:
        return self.records.setdefault(number, Record())

    def _hear_join(self, message: Message) -> None:
        """Take in that a robot shares rows with others, and see that somebody solves for it."""
        for partner in message.parts.keys() & self.records.keys():
            self.records[partner].sharing.add(message.sender)
        if line := message.parts.get(self.number):
            if self.number == min(o for _, o, _ in self._program.decoded(line).contacts):
                self._children.add(message.sender)
            self._find_keeper(message.sender, line)

    def _find_keeper(self, joiner: int, line: bytes) -> None:
        """Hand the line of a robot to who solves for it."""
        keeper = self._keeper()
        if keeper != self.number:
            self._hosted = joiner, line
            self._say("task", b"", {keeper: line})
        elif self._is_busy:
            self._say("full", b"", {joiner: b""})
        else:
            self._take(line)

    def _hear_full(self, message: Message) -> None:
        """Try the next keeper, or the next robot that this one touches."""
        self._keepers.pop(message.sender, None)
        if self._hosted is not None:
            self._find_keeper(*self._hosted)
        elif self.place is None:
            self.join()

    @property
    def _is_busy(self) -> bool:
        """Whether this robot has solved for as many as it does."""
        params = self._program.params
        return params.solver == "keeper" and self._solved >= params.tenure

    def _keeper(self) -> int:
        """Choose who solves for a robot that touches this one, perhaps this one itself."""
        params = self._program.params
        if params.solver == "base":
            return 0
        near = [
            (contacts, keeper)
            for keeper, contacts in self._keepers.items()
            if contacts <= params.reach and not (keeper == self.number and self._is_busy)
        ]
        return min(near)[1] if near else self.number

    def _begin(self, joiner: int, walked: int | None = None) -> None:
        """Begin to solve for a robot; a walk may go on after that."""
        self._search = _Search(joiner, {joiner: 0}, walked=walked)
        self._advance()

    def _advance(self) -> None:
        """Ask the robots a step farther; solve once there are no more."""
        search = self._search
        params = self._program.params
        while search is not None and not search.waiting:
            hops = 1 if search.is_review else params.hops
            if search.current == hops or not self._widen(search):
                self._search = None
                self._solve(search)
                return
            search.current += 1
            self._tries = 0
            there = {n for n, step in search.step.items() if step == search.current}
            search.waiting = {n for n in there if not self._is_current(n)}
            if search.is_review:
                search.waiting = there - {self.number}
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
        room = self._program.params.asked + 1 - len(search.step)
        if search.is_review:
            room = len(further)
        # The last that joined are the least known.
        chosen = sorted(further, reverse=True)[: max(room, 0)]
        search.step |= dict.fromkeys(chosen, search.current + 1)
        return bool(chosen)

    def _ask(self, robots: Iterable[int]) -> None:
        """Ask robots for what this one does not hold of them."""
        parts = {}
        for number in sorted(robots):
            its = self._of(number)
            asked = wire.Asked(not its.line, self._checksum(number), its.since)
            parts[number] = wire.write_question(asked)
        self._say("ask", b"", parts)

    def _answer(self, asker: int, part: bytes) -> None:
        """Answer what a robot asked."""
        asked, mine = wire.read_question(part), self.records[self.number]
        self._watchers.add(asker)
        answer = wire.Writer(self._program.params.bits)
        is_moved = mine.place is not None and asked.checksum != self._checksum(self.number)
        answer.number(is_moved, 1)
        wire.write_span(answer, mine.span)
        # Robots that joined before this one are in its line.
        since = max(asked.since, self.number + 1)
        wire.write_numbers(answer, (other for other in mine.sharing if other >= since))
        if mine.place is not None and is_moved:
            wire.write_place(answer, mine.place)
            if self._exchanges:
                wire.write_candidates(answer, mine.candidates)
        line = mine.line if asked.wants_line else b""
        self._say("answer", answer.to_bytes() + line, {asker: b""})

    def _hear_answer(self, message: Message) -> None:
        its = self._of(message.sender)
        answer = wire.read_answer(message.common, self._program.params.bits, self._exchanges)
        self._hold_line(message.sender, answer.line)
        its.sharing.update(answer.sharing)
        its.span = answer.span
        if answer.place is not None:
            its.place, its.candidates = answer.place, answer.candidates
        if self.number in message.parts:
            its.is_current = True
            if self._search is not None:
                # Its notice may have come after the question.
                its.since = self._search.joiner
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
            line = self.records[number].line if number in self.records else b""
            asked = wire.read_question(part)
            if asked.wants_line and line:
                found += number.to_bytes(_SIZE, "big") + len(line).to_bytes(_SIZE, "big") + line
                parts[number] = wire.write_question(asked._replace(wants_line=False))
        if found:
            self._say("lines", b"", {message.sender: found})
        return message._replace(parts=parts)

    def _hear_lines(self, message: Message) -> None:
        for lines in message.parts.values():
            part = lines
            while part:
                number, size = (int.from_bytes(part[k : k + _SIZE], "big") for k in (0, _SIZE))
                self._hold_line(number, part[2 * _SIZE :][:size])
                part = part[2 * _SIZE + size :]
        if self._search is not None:
            self._check_off()

    def _hold_line(self, number: int, line: bytes) -> None:
        """Take in what a robot sensed, if anything was sent of it."""
        if line:
            self._of(number).line = line
            self._of(number).sharing |= self._program.partners(line)

    def _check_off(self) -> None:
        """Wait no longer for robots that have answered and whose lines are here."""
        search = self._search
        if search is not None and search.waiting:
            search.waiting -= {n for n in search.answered if self._of(n).line}
            self._advance()

    def _hold_place(self, number: int, part: bytes) -> None:
        answer, its = wire.read_result(part, self._program.params.bits), self._of(number)
        # Bodies join those of lower numbers: who places it in a higher one has not heard of that.
        if answer.place is None or 0 <= its.body < answer.place.body:
            return
        its.place, its.is_surprising = answer.place, answer.is_surprising
        if len(answer.candidates):
            its.candidates = answer.candidates

    def _checksum(self, number: int) -> int:
        """Check what this robot holds of one, against what that holds of itself."""
        its = self._of(number)
        if its.place is None:
            return 0
        text = wire.Writer(self._program.params.bits)
        wire.write_place(text, its.place)
        return zlib.crc32(text.to_bytes()) % int(2**wire.CHECK - 1) + 1

    def _placed(self) -> dict[int, Record]:
        """List the robots whose lines and places are held."""
        return {n: each for n, each in self.records.items() if each.line and each.place is not None}

    def _solve(self, search: _Search) -> None:
        """Solve for a robot with what is held, and send new places."""
        if search.is_review:
            held = self._placed()
            near = {n: each for n, each in held.items() if n in search.step or not n}
            mine = _of_body(near, self.records[self.number].body)
            self._send(self.number, LocalSwarm(self._program, mine).relax(self.number))
        elif search.walked is None:
            self._place(search)
        else:
            self._place_again(search)
        if search.walked is not None:
            self._go_on(search.walked)

    def _place_again(self, search: _Search) -> None:
        """Solve for this robot, which was alone, and move what hangs on it to the body it is in."""
        mine = self.records[self.number]
        before, mine.place = mine.place, None
        self._place(search)
        if before is None or mine.place is None:
            return
        if mine.body == self.number:
            mine.place = before
        else:
            shift = mine.place.position - before.position
            self._joined = wire.write_shift(
                wire.JointShift(
                    self.number, shift, body=before.body, joined=mine.body, sd=mine.place.sd
                ),
                self._program.params.bits,
            )

    def _place(self, search: _Search) -> None:
        """Solve for a robot that joined."""
        joiner = search.joiner
        held = self._placed()
        self._kept.add(joiner)
        near = {n: each for n, each in held.items() if n in search.step or self._is_current(n)}
        near[joiner] = self.records[joiner]
        if 0 in held:
            near[0] = held[0]
        partners = self._program.partners(near[joiner].line) & near.keys()
        bodies = sorted({near[n].body for n in partners})
        mine = _of_body(near, min(bodies, default=0)) | {joiner: near[joiner]}
        swarm = LocalSwarm(self._program, mine)
        if swarm.is_floating(joiner):
            swarm.body = joiner
        anew = near[joiner].place is None
        solved = swarm.solve(joiner, anew=anew, everywhere=self._has_grown(len(near)))
        if swarm.body == joiner:
            solved.places[joiner] = solved.places[joiner]._replace(sd=0.0)
        self._send(joiner, solved)
        if swarm.body and joiner == self.number and self._parent is not None:
            # Who solves for itself sent no line.
            self._say("child", b"", {self._parent: b""})
        for body in bodies[1:]:
            self._close(joiner, near, body)

    def _close(self, joiner: int, near: Mapping[int, Record], body: int) -> None:
        """Let a body join that of a robot which touches both, and solve for those near it."""
        own, other = near[joiner].body, _of_body(near, body)
        line = near[joiner].line
        touching = sorted(o for _, o, _ in self._program.decoded(line).contacts)
        # By radio, messages reach robots that it touched on its way, too.
        ways = [n for n in (*touching, *sorted(self._program.partners(line))) if n in near]
        parent, child = (next(n for n in ways if near[n].body == b) for b in (own, body))
        lost = replace(near[joiner], place=None)
        places = LocalSwarm(self._program, other | {joiner: lost}).places_of(joiner)
        both = LocalSwarm(self._program, _of_body(near, own) | other)
        shift, sd = both.closing(joiner, other.keys(), places)
        content = wire.write_shift(
            wire.JointShift(self.number, shift, body=body, joined=own, sd=sd),
            self._program.params.bits,
        )
        found = wire.read_shift(content, self._program.params.bits)
        for number, its in self.records.items():
            # Who has not heard of it by then is asked again.
            its.is_current &= its.body != body
            self._join_body(number, found)
        at = wire.write_pair(parent, child)
        if joiner == self.number:
            self._hang(at, content)
        else:
            self._say("hang", content, {joiner: at})
        solved = LocalSwarm(self._program, _of_body(near, own)).solve(
            joiner, anew=False, everywhere=True
        )
        self._send(joiner, solved)

    def _send(self, joiner: int, solved: Solution) -> None:
        """Send robots their new places."""
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
            self._hold_place(number, parts[number])
            self._of(number).is_current = True
        if parts.pop(self.number, None):
            self._follow(self.number, 0)
        self._say("place", b"\1", parts)
        self._send_shifts(solved)

    def _send_shifts(self, solved: Solution) -> None:
        """Let branches move as one."""
        for number, shift in solved.along.items():
            its = self._of(number)
            if its.place is not None:
                its.place = its.place._replace(position=its.place.position + shift)
        if self.number in solved.along:
            self._warn(self.number)
        for first, (shift, parted) in solved.shifts.items():
            content = wire.write_shift(
                wire.JointShift(self.number, shift, parted), self._program.params.bits
            )
            if first == self.number:
                self._pass_shift(content)
            else:
                self._say("branch", content, {first: b""})

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
        lines = [n for n, each in self.records.items() if each.line and n != self.number]
        busy = {} if self._search is None else self._search.step
        # Those asked about now are needed.
        beyond = max(len(lines) - self._program.params.robots, 0)
        spare = sorted((n for n in lines if n not in busy), key=self._is_current)
        for number in spare[:beyond]:
            del self.records[number]


def _of_body(near: Mapping[int, Record], body: int) -> dict[int, Record]:
    """Choose robots that are placed relative to a body."""
    return {n: each for n, each in near.items() if each.body == body}
