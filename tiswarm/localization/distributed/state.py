"""The state of a robot: what it holds, what it hangs on, who solves, and what it is to send."""

from collections.abc import Collection
from dataclasses import dataclass, field

from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.channel import Message
from tiswarm.localization.distributed.memory import Memory
from tiswarm.localization.distributed.messages import Child, Content, Left, Moved, Shift
from tiswarm.localization.distributed.program import Program
from tiswarm.localization.distributed.waiting import Tasks, WhenPlaced
from tiswarm.records.sensing_format import RobotLine


@dataclass
class WalkState:
    """Where the last walk of a review that came to a robot is."""

    number: int = -1
    """Number of the walk; -1 before the first one."""

    came_from: int | None = None
    """Robot that it came from, to which it returns; None at the anchor."""

    entered: int = 0
    """Robots that it had come to as it came here."""

    count: int = 0
    """Robots that it had come to as it went on from here."""

    unvisited: list[int] = field(default_factory=list)
    """Robots that hang on this one, to which it is still to go."""


class PeerState:
    """What a robot of a swarm that localizes itself holds and remembers."""

    def __init__(self, program: Program, line: RobotLine) -> None:
        """Begin with what the robot sensed, under its number in join order."""
        self.program = program
        self.number = line.robot
        content = wire.line_bytes(line, program.docks, program.params.bits)
        self.memory = Memory(program, self.number, content)
        self.record = self.memory.of(self.number)
        """What it holds of itself."""
        self.touching = sorted({robot for _, robot, _ in line.contacts})
        self.outbox: list[Message] = []
        self.tasks = Tasks()
        self.tries = 0
        """Times that what the robot waits for was repeated."""
        self.operations = 0.0

        self.parent = min(self.touching, default=None)
        """The robot that this one hangs on, its first contact."""
        self.children: set[int] = set()
        """Robots that hang on this one."""
        self.walk = WalkState()
        self.joined = b""
        """The shift by which its body joined another one, as it was sent."""
        self.shifts: set[bytes] = set()
        """Shifts that it has heard since a walk last came, as they were sent."""
        self.bodies: set[int] = set()
        """Bodies in which it has had a place."""

        self.keepers: dict[int, int] = {}
        """Robots that moved this one, and contacts to them."""
        self.watchers: set[int] = set()
        """Robots that rely on hearing of it when this one moves."""
        self.hosted: tuple[int, bytes] | None = None
        """The robot that another keeper may have to solve for, and its line.

        It stays when that robot is placed: every `Full` that a host hears answers its last task.
        """
        self.kept: set[int] = set()
        """Robots that this one solved for."""
        self.solved = 0
        """Joins that it solved."""
        self.annealed = 0
        """Joins that it had solved as it last annealed all robots that it holds."""

    @property
    def place(self) -> wire.Whereabouts | None:
        """Where the robot takes itself to be; None if it does not know."""
        return self.record.place

    @property
    def is_alone(self) -> bool:
        """Whether the robot touches others, and has heard of no place among them."""
        return bool(self.touching) and (self.place is None or self.place.body == self.number)

    @property
    def is_busy(self) -> bool:
        """Whether this robot has solved for as many as it does."""
        params = self.program.params
        return params.solver == "keeper" and self.solved >= params.tenure

    def say(self, content: Content) -> None:
        """Send a message, if it has a receiver."""
        if content.parts:
            self.outbox.append(content.message(self.number))

    def hold_result(self, number: int, packed: bytes) -> None:
        """Take in where a robot is; this one waits for its place no more."""
        self.memory.hold_result(number, packed)
        if number == self.number:
            self.bodies.add(self.record.body)
            self.tasks.wake(WhenPlaced, None)

    def was_in(self, body: int) -> bool:
        """Return whether the robot has had a place in a body, or has none in any."""
        return body in self.bodies or self.place is None

    def follow(self, keeper: int, contacts: int) -> None:
        """Take note of a robot that moved this one, and let others that hold it know."""
        self.keepers[keeper] = contacts
        self.warn(keeper)
        self.watchers.add(keeper)

    def warn(self, keeper: int) -> None:
        """Let robots that hold this one know that a keeper has moved it, but for that keeper."""
        warned = self.watchers - {keeper}
        self.watchers &= {keeper}
        self.say(Moved(sorted(warned)))

    def lose(self, robots: Collection[int]) -> None:
        """Take note that robots have left: none of them is asked, visited or heard any more.

        Who hung on one of them hangs on the next robot that it touches, unless its body has joined
        another one: there ways from robot to robot may lead back to it. Then no walk comes to it.
        """
        for number in robots:
            self.memory.hold_leaver(number)
            self.keepers.pop(number, None)
        self.watchers.difference_update(robots)
        self.children.difference_update(robots)
        self.kept.difference_update(robots)
        self.walk.unvisited = [child for child in self.walk.unvisited if child not in robots]
        if self.parent is None or not self.memory.has_left(self.parent):
            return
        remaining = [robot for robot in self.touching if not self.memory.has_left(robot)]
        self.parent = None
        if remaining and not self.joined:
            self.parent = remaining[0]
            self.say(Child([self.parent]))

    def announce(self, robots: Collection[int], receivers: Collection[int]) -> None:
        """Let robots know that some which this one touched have left."""
        self.lose(robots)
        self.say(Left(receivers, robots))

    @property
    def is_on_walk(self) -> bool:
        """Whether a walk that came here has not returned yet."""
        return self.tasks.answers is not None or self.tasks.visited is not None

    def hang_on(self, parent: int) -> None:
        """Hang on a robot; what this one hung on before hangs on it then, as its body joined.

        The first robot of a body hung on none of that body, and the anchor hangs on nobody.
        """
        if self.number == 0 or parent == self.parent:
            return
        self.children.discard(parent)
        if self.parent is not None and self.record.body != self.number:
            self.children.add(self.parent)
        self.parent = parent

    def hang_between(self, pair: bytes, shift: bytes) -> None:
        """Hang on a robot of one body, and let the other body hang on this one."""
        parent, child = wire.read_pair(pair)
        if self.parent != parent:
            self.parent = parent
            self.say(Child([parent]))
        self.children.add(child)
        self.joined = shift
        self.say(Shift([child], shift))

    def pass_shift(self, shift: bytes) -> None:
        """Let robots that hang on this one move, too."""
        parted = wire.read_shift(shift, self.program.params.bits).parted
        self.say(Shift(sorted(self.children - {*parted}), shift))
