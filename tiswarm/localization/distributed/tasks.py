"""The tasks of a robot that wait for what robots send: each is a coroutine that reads as it runs.

| task | waits for |
|---|---|
| `join` | the place of the robot, from a keeper |
| `solve_for` | answers of the robots near the one that is solved for |
| `take_walk` | the return of the walk, from each robot that hangs on this one |
| `review` | answers of the robots that this one solved for, and of those near them |

What has no answer is repeated, and after `retries` times a task goes on without.
"""

from collections.abc import Collection, Generator

from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.messages import (
    Answer,
    Ask,
    Child,
    Join,
    ReturnedWalk,
    ReviewWalk,
)
from tiswarm.localization.distributed.solving import (
    place_itself_again,
    place_joiner,
    relax_near,
)
from tiswarm.localization.distributed.state import PeerState
from tiswarm.localization.distributed.waiting import (
    Answers,
    Event,
    Heard,
    Return,
    Task,
    Timeout,
    Wait,
    WhenPlaced,
)


def join(robot: PeerState) -> Task:
    """Let robots know that rows are shared, and try host after host; solve itself at last."""
    line = robot.record.line
    hosts = [] if robot.program.params.solver == "joiner" else robot.touching
    for host in hosts:
        # Who has been named knows that it shares rows; who solves has to know the rows.
        named = sorted(robot.program.partners(line) - {host})
        robot.say(Join(named, host, line))
        event = yield WhenPlaced()
        if robot.place is not None:
            return
        if isinstance(event, Timeout) and robot.parent is not None:
            # The first notice may be lost.
            robot.say(Child([robot.parent]))
    robot.say(Join(sorted(robot.program.partners(line) - {robot.number}), None, b""))
    yield from solve_for(robot, robot.number)


def solve_for(robot: PeerState, joiner: int) -> Task:
    """Ask robots near one that joined what they know, and solve for it."""
    near = yield from _ask_near(robot, joiner)
    place_joiner(robot, joiner, near)


def review(robot: PeerState) -> Task:
    """Solve again for all that this robot solved for, with what shares rows with them."""
    robot.tasks.drop(Answers)
    answered: set[int] = set()
    kept = robot.kept | {robot.number}
    yield from _await_answers(robot, robot.number, kept, robot.kept - {robot.number}, answered)
    further = _farther(robot, kept, kept)
    near = kept | further
    if further:
        robot.tries = 0
        yield from _await_answers(robot, robot.number, near, further, answered)
    relax_near(robot, near)


def take_walk(robot: PeerState, count: int, number: int, came_from: int | None = None) -> Task:
    """Take in a walk that comes to this robot, let it visit what hangs on it, and send it back.

    The first walk of a review lets robots learn what hangs on them, and robots that are alone solve
    for themselves. On the second one all that solved do so again. A walk may come while this robot
    still solves for the last one: what is left to visit is then of the walk that came last.

    Args:
        robot: The robot.
        count: Robots that the walk has come to before.
        number: Number of the walk; even ones are the first of a review.
        came_from: Robot that it came from; None at the anchor, where it begins.
    """
    robot.tasks.drop(Return)
    walk = robot.walk
    walk.number = number % wire.WALKS
    walk.came_from = came_from
    robot.shifts.clear()
    walk.entered = count
    walk.unvisited = sorted(robot.children)
    count += 1
    if robot.is_alone:
        near = yield from _ask_near(robot, robot.number)
        place_itself_again(robot, near)
    elif number % 2 and robot.kept:
        yield from review(robot)
    _walk_on(robot, count)
    while walk.unvisited:
        count = yield from _visit(robot, walk.unvisited.pop(0))
        _walk_on(robot, count)
    robot.tasks.drop(Return)
    robot.record.span = walk.entered, count
    if walk.came_from is not None:
        robot.say(ReturnedWalk([walk.came_from], count, walk.number))
    elif walk.number % 2 == 0:
        yield from take_walk(robot, 0, walk.number + 1)


def _walk_on(robot: PeerState, count: int) -> None:
    """Take note that a walk goes on from here."""
    robot.walk.count = count
    robot.tries = 0


def _visit(robot: PeerState, child: int) -> Generator[Wait, Event, int]:
    """Send the walk to a robot that hangs on this one, and wait until it returns.

    Returns:
        Robots that the walk has come to then.
    """
    while True:
        robot.say(ReviewWalk([child], robot.walk.count, robot.walk.number))
        event = yield Return(child)
        if isinstance(event, Heard) and isinstance(event.content, ReturnedWalk):
            return event.content.count
        if isinstance(event, Timeout) and event.is_last:
            return robot.walk.count


def _ask_near(robot: PeerState, joiner: int) -> Generator[Wait, Event, set[int]]:
    """Ask robots step by step of "shares a row", up to `hops`, unless they are current.

    Returns:
        The robots that are known to be near, the one to solve for included.
    """
    robot.tasks.drop(Answers)
    params = robot.program.params
    near = {joiner}
    last = {joiner}
    answered: set[int] = set()
    for _ in range(params.hops):
        # The last that joined are the least known.
        room = max(params.asked + 1 - len(near), 0)
        last = {*sorted(_farther(robot, last, near), reverse=True)[:room]}
        if not last:
            break
        near |= last
        robot.tries = 0
        asked = {n for n in last if not robot.memory.is_current(n)}
        yield from _await_answers(robot, joiner, near, asked, answered)
    return near


def _farther(robot: PeerState, last: Collection[int], near: set[int]) -> set[int]:
    """List the robots that share rows with the last ones, and are not near yet."""
    return {n for robot_near in last for n in robot.memory.of(robot_near).sharing} - near


def _await_answers(
    robot: PeerState,
    joiner: int,
    near: Collection[int],
    asked: Collection[int],
    answered: set[int],
) -> Task:
    """Ask robots for what is not held of them, until all have answered or time has run out.

    Args:
        robot: The robot that asks.
        joiner: Robot that it solves for: those asked say who joined up to it.
        near: Robots whose lines are needed.
        asked: Robots to ask.
        answered: Robots that answered since the task began, also to others; more are added.
    """
    waiting = {n for n in asked if not robot.memory.has_left(n)}
    if waiting:
        _ask(robot, waiting)
    while waiting:
        event = yield Answers(near)
        if isinstance(event, Timeout):
            if event.is_last:
                return
            _ask(robot, waiting)
        elif isinstance(event, Heard):
            if isinstance(event.content, Answer):
                answered.add(event.sender)
                if robot.number in event.content.to:
                    # Its notice may have come after the question.
                    robot.memory.of(event.sender).since = joiner
            waiting -= {n for n in answered if robot.memory.of(n).line}


def _ask(robot: PeerState, numbers: Collection[int]) -> None:
    robot.say(Ask.of({n: robot.memory.question(n) for n in sorted(numbers)}))
