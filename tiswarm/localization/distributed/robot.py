"""One robot: what it does as it hears messages, and as nothing comes.

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

`messages.py` lists the kinds of messages, `tasks.py` what a robot does in several steps, and
`solving.py` what it computes. Lengths in R, relative to the anchor.

Settings were chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from tiswarm.localization.distributed import tasks, wire
from tiswarm.localization.distributed.channel import Message, pause
from tiswarm.localization.distributed.memory import Record
from tiswarm.localization.distributed.messages import (
    KINDS,
    Answer,
    Ask,
    Branch,
    Child,
    Content,
    Full,
    Hang,
    Join,
    Left,
    Lines,
    Lost,
    Moved,
    Place,
    ReturnedWalk,
    ReviewWalk,
    Shift,
    Task,
    Walking,
)
from tiswarm.localization.distributed.state import PeerState
from tiswarm.localization.distributed.waiting import (
    Answers,
    Heard,
    Return,
    Timeout,
    WhenPlaced,
)
from tiswarm.records.error_law import sure_ratio


class Peer(PeerState):
    """A robot of a swarm that localizes itself."""

    @property
    def records(self) -> dict[int, Record]:
        """What it holds of robots, by their numbers, itself included."""
        return self.memory.records

    def join(self) -> None:
        """Let robots know that rows are shared; the first of the swarm is the anchor."""
        if self.number == 0:
            self.record.place = wire.Whereabouts(np.zeros(3), np.zeros(3), 0.0)
        else:
            self.tasks.start(tasks.join(self))

    def review(self) -> None:
        """Send a message around that lets each robot that solved do so again for all it solved for.

        It walks along first contacts, twice: on the first walk robots learn what hangs on whom.
        Who waits for the return of a walk sends it again.
        """
        self.tasks.start(tasks.take_walk(self, 0, self.walk.number + 1))

    def hear(self, message: Message) -> Message:
        """Take in a message, whether it was for this robot or passes by; return what goes on."""
        kind = KINDS[message.kind]
        if self.number not in message.parts and not kind.read_in_passing:
            return message
        passed_on = _HANDLERS[kind](self, message.sender, kind.read(message))
        if passed_on is None:
            return message
        return message._replace(common=passed_on.common, parts=passed_on.parts)

    @property
    def waits(self) -> bool:
        """Whether the robot still waits for something."""
        return self.tasks.next_sort is not None

    def expire(self) -> int:
        """Repeat what has no answer, or go on without; return the rounds to be silent before."""
        sort = self.tasks.next_sort
        if sort is None:
            return 0
        self.tries += 1
        # A robot that waits for a place goes on to its next host each time.
        is_last = sort is not WhenPlaced and self.tries > self.program.params.retries
        silent = 0 if is_last else pause(self.tries)
        self.tasks.wake(sort, Timeout(is_last))
        return silent

    def judge(self) -> bool:
        """Judge whether the robot doubts where it is, by what it heard.

        It does if chance does not explain its rows and overlaps, if it is not within R of its
        position with probability `SURE`, or if it heard of no place relative to the anchor.
        """
        if self.place is None or self.place.body or self.place.sd * sure_ratio() > 1.0:
            return True
        return self.record.is_surprising

    @property
    def joins(self) -> int:
        """Joins that the robot solved."""
        return len(self.kept)

    def take(self, line: bytes) -> None:
        """Become the keeper of a robot, which sent this line."""
        number = self.program.decoded(line).robot
        self.memory.hold_line(number, line)
        self.memory.hold_sharing(number, self.memory.of(number).sharing)
        self.tasks.start(tasks.solve_for(self, number))
        # Those asked about now are needed.
        waiting = self.tasks.answers
        self.memory.forget(() if waiting is None else waiting.near)

    def find_keeper(self, joiner: int, line: bytes) -> None:
        """Hand the line of a robot to who solves for it."""
        keeper = self._nearest_keeper()
        if keeper != self.number:
            self.hosted = joiner, line
            self.say(Task([keeper], line))
        elif self.is_busy:
            self.say(Full([joiner]))
        else:
            self.take(line)

    def _nearest_keeper(self) -> int:
        """Choose who solves for a robot that touches this one, perhaps this one itself."""
        params = self.program.params
        if params.solver == "base":
            return 0
        near = [
            (contacts, keeper)
            for keeper, contacts in self.keepers.items()
            if contacts <= params.reach and not (keeper == self.number and self.is_busy)
        ]
        return min(near)[1] if near else self.number


def _hear_join(robot: Peer, sender: int, join: Join) -> None:
    """Take in that a robot shares rows with others, and see that somebody solves for it."""
    robot.memory.hold_sharing(sender, {*join.to})
    if join.host == robot.number:
        if robot.number == min(robot.program.touched(join.line)):
            robot.children.add(sender)
        robot.find_keeper(sender, join.line)


def _hear_task(robot: Peer, sender: int, task: Task) -> None:
    """Solve for a robot, unless this one has solved for as many as it does."""
    if robot.is_busy:
        robot.say(Full([sender]))
    else:
        robot.take(task.line)


def _hear_full(robot: Peer, sender: int, full: Full) -> None:
    """Try the next keeper, or the next robot that this one touches."""
    robot.keepers.pop(sender, None)
    if robot.hosted is not None:
        robot.find_keeper(*robot.hosted)
    elif robot.place is None:
        robot.tasks.wake(WhenPlaced, Heard(sender, full))


def _hear_ask(robot: Peer, sender: int, ask: Ask) -> Ask | None:
    """Answer a question, or hand out lines as one passes by."""
    if robot.number in ask.to:
        _answer(robot, sender, ask.asked(robot.number))
    elif robot.program.params.channel == "touch":
        return _hand_out(robot, sender, ask)
    return None


def _answer(robot: Peer, asker: int, asked: wire.Asked) -> None:
    """Answer what a robot asked; from then on, let it know as this one moves."""
    robot.watchers.add(asker)
    record = robot.record
    is_moved = asked.checksum != robot.memory.checksum(robot.number)
    # Robots that joined before this one are in its line.
    since = max(asked.since, robot.number + 1)
    content = wire.write_answer(
        record.place if is_moved else None,
        record.candidates if robot.program.exchanges else None,
        record.span,
        [partner for partner in record.sharing if partner >= since],
        robot.program.params.bits,
    )
    line = record.line if asked.wants_line else b""
    robot.say(Answer([asker], content + line))


def _hand_out(robot: Peer, asker: int, ask: Ask) -> Ask:
    """Answer with lines that this robot holds of others that are asked for them.

    Returns:
        The questions that go on.
    """
    lines: dict[int, bytes] = {}
    questions = {**ask.questions}
    for number in ask.questions:
        asked = ask.asked(number)
        line = robot.records[number].line if number in robot.records else b""
        if asked.wants_line and line:
            lines[number] = line
            questions[number] = wire.write_question(asked._replace(wants_line=False))
    if lines:
        robot.say(Lines.of(asker, lines))
    return Ask(ask.to, questions)


def _hear_answer(robot: Peer, sender: int, answer: Answer) -> None:
    """Take in what a robot says of itself; by radio, robots hear what others asked for."""
    robot.memory.hold_answer(sender, answer.content)
    if robot.number in answer.to:
        robot.memory.of(sender).is_current = True
    robot.tasks.wake(Answers, Heard(sender, answer))


def _hear_lines(robot: Peer, sender: int, lines: Lines) -> None:
    """Take in lines of others."""
    for number, line in lines.lines():
        robot.memory.hold_line(number, line)
    robot.tasks.wake(Answers, Heard(sender, lines))


def _hear_place(robot: Peer, sender: int, place: Place) -> Place:
    """Take in where robots are, and count the contact to the next one."""
    for number, result in place.results.items():
        robot.hold_result(number, result)
    if robot.number in place.to:
        robot.follow(sender, place.contacts)
    return place.passed_on()


def _hear_moved(robot: Peer, sender: int, _: Moved) -> None:
    """Ask a robot again before its place is used."""
    robot.memory.of(sender).is_current = False


def _hear_child(robot: Peer, sender: int, _: Child) -> None:
    """Take note that a robot hangs on this one."""
    robot.children.add(sender)


def _hear_walk(robot: Peer, sender: int, walk: ReviewWalk) -> None:
    """Take in a walk that comes; repeat its return where that was not heard.

    What is left of an earlier walk came late: its robots have gone on without it. A walk that comes
    again, or from a second robot, returns at once.
    """
    walked = robot.walk.number
    if walked < 0 or wire.is_earlier(walked, walk.number):
        robot.hang_on(sender)
        if robot.record.body > 0:
            robot.say(Lost([sender]))
        robot.tasks.start(tasks.take_walk(robot, walk.count, walk.number, sender))
    elif walk.number == walked and sender == robot.walk.came_from and robot.is_on_walk:
        robot.say(Walking([sender]))
    elif walk.number == walked:
        robot.say(ReturnedWalk([sender], robot.walk.count, walked))


def _hear_return(robot: Peer, sender: int, walk: ReturnedWalk) -> None:
    """Go on with a walk that returns; nobody answers one that comes late."""
    if walk.number == robot.walk.number and sender == robot.tasks.visited:
        robot.tasks.wake(Return, Heard(sender, walk))


def _hear_walking(robot: Peer, sender: int, _: Walking) -> None:
    """Go on waiting for a walk that has not been lost."""
    if sender == robot.tasks.visited:
        robot.tries = 0


def _hear_branch(robot: Peer, _: int, branch: Branch) -> None:
    """Let what hangs on this robot move, which has moved by its own place."""
    robot.pass_shift(branch.shift)


def _hear_shift(robot: Peer, sender: int, shift: Shift) -> None:
    """Move with the robot that this one hangs on."""
    joint = wire.read_shift(shift.shift, robot.program.params.bits)
    # After losses, or where several join at once, ways from robot to robot may lead back, or to
    # another body, and the shift would go around without end. Who missed it asks for it as a walk
    # comes.
    if shift.shift in robot.shifts or (joint.body and not robot.was_in(joint.body)):
        return
    robot.shifts.add(shift.shift)
    robot.hang_on(sender)
    if joint.body:
        robot.joined = shift.shift
        robot.memory.join_body(robot.number, joint)
        robot.warn(robot.number)
    elif robot.place is not None and joint.keeper != robot.number:
        robot.record.place = robot.place._replace(position=robot.place.position + joint.shift)
        robot.warn(joint.keeper)
    robot.pass_shift(shift.shift)


def _hear_hang(robot: Peer, _: int, hang: Hang) -> None:
    """Hang on one body, and let another one hang on this robot."""
    robot.hang_between(hang.pair, hang.shift)


def _hear_lost(robot: Peer, sender: int, _: Lost) -> None:
    """Repeat the shift for a robot that has not heard of it."""
    if robot.joined:
        robot.say(Shift([sender], robot.joined))


def _hear_left(robot: Peer, _: int, left: Left) -> None:
    """Take note of robots that have left."""
    robot.lose(left.robots)


_HANDLERS: dict[type[Content], Callable[[Peer, int, Any], Content | None]] = {
    Join: _hear_join,
    Task: _hear_task,
    Full: _hear_full,
    Ask: _hear_ask,
    Answer: _hear_answer,
    Lines: _hear_lines,
    Place: _hear_place,
    Moved: _hear_moved,
    Child: _hear_child,
    ReviewWalk: _hear_walk,
    ReturnedWalk: _hear_return,
    Walking: _hear_walking,
    Branch: _hear_branch,
    Shift: _hear_shift,
    Hang: _hear_hang,
    Lost: _hear_lost,
    Left: _hear_left,
}
"""What a robot does as it hears a message of each kind; returns what goes on if that changes."""
