"""What a keeper does once answers are there: solve, send places, and join bodies."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.local_swarm import LocalSolution, LocalSwarm
from tiswarm.localization.distributed.memory import Record, of_body
from tiswarm.localization.distributed.messages import Branch, Child, Hang, Place
from tiswarm.localization.distributed.state import PeerState


def place_joiner(robot: PeerState, joiner: int, near: Collection[int]) -> None:
    """Solve for a robot that joined, send places, and join bodies that it touches.

    Args:
        robot: The keeper.
        joiner: The robot to solve for.
        near: Robots that were asked.
    """
    memory = robot.memory
    placed = memory.placed()
    robot.kept.add(joiner)
    records = {n: record for n, record in placed.items() if n in near or memory.is_current(n)}
    records[joiner] = memory.records[joiner]
    if 0 in placed:
        records[0] = placed[0]
    partners = robot.program.partners(records[joiner].line) & records.keys()
    bodies = sorted({records[n].body for n in partners})
    of_first = of_body(records, min(bodies, default=0)) | {joiner: records[joiner]}
    swarm = LocalSwarm(robot.program, of_first)
    if swarm.is_floating(joiner):
        swarm.body = joiner
    anew = records[joiner].place is None
    solution = swarm.solve(joiner, anew=anew, everywhere=_has_grown(robot, len(records)))
    if swarm.body == joiner:
        solution.places[joiner] = solution.places[joiner]._replace(sd=0.0)
    send_solution(robot, joiner, solution)
    if swarm.body and joiner == robot.number and robot.parent is not None:
        # Who solves for itself sent no line.
        robot.say(Child([robot.parent]))
    for body in bodies[1:]:
        merge_bodies(robot, joiner, records, body)


def _has_grown(robot: PeerState, robots: int) -> bool:
    """Count one more robot solved for, and judge whether all that are held are due."""
    robot.solved += 1
    is_due = robot.solved - robot.annealed >= robot.program.params.growth * robots
    if is_due:
        robot.annealed = robot.solved
    return is_due


def place_itself_again(robot: PeerState, near: Collection[int]) -> None:
    """Solve for this robot, which was alone, and move what hangs on it to the body it is in."""
    record = robot.record
    before = record.place
    record.place = None
    place_joiner(robot, robot.number, near)
    after = record.place
    if before is None or after is None:
        return
    if after.body == robot.number:
        record.place = before
    else:
        joint = wire.JointShift(
            robot.number,
            after.position - before.position,
            body=before.body,
            joined=after.body,
            sd=after.sd,
        )
        robot.joined = wire.write_shift(joint, robot.program.params.bits)


def relax_near(robot: PeerState, near: Collection[int]) -> None:
    """Solve again for robots that this one solved for, and let what hangs on them move as one."""
    placed = robot.memory.placed()
    records = {n: record for n, record in placed.items() if n in near or not n}
    swarm = LocalSwarm(robot.program, of_body(records, robot.record.body))
    send_solution(robot, robot.number, swarm.relax(robot.number))


def merge_bodies(robot: PeerState, joiner: int, records: Mapping[int, Record], body: int) -> None:
    """Let a body join that of a robot which touches both, and solve for those near it.

    Nobody confirms the shift: a robot that has not heard of it asks for it, with `Lost`, once a
    walk comes to it.

    Args:
        robot: The keeper.
        joiner: The robot that touches both, placed in its body.
        records: Robots near it, in both bodies.
        body: The body that is to join that of the joiner.
    """
    program, memory = robot.program, robot.memory
    stays = records[joiner].body
    moving = of_body(records, body)
    line = records[joiner].line
    # By radio, messages reach robots that it touched on its way, too.
    partners = (*program.touched(line), *sorted(program.partners(line)))
    reached = [n for n in partners if n in records and not records[n].is_gone]
    parent = next((n for n in reached if records[n].body == stays), None)
    child = next((n for n in reached if records[n].body == body), None)
    if parent is None or child is None:  # who tied one of the bodies to the robot has left
        return
    unplaced = replace(records[joiner], place=None)
    places = LocalSwarm(program, moving | {joiner: unplaced}).places_of(joiner)
    both = LocalSwarm(program, of_body(records, stays) | moving)
    shift, sd = both.closing(joiner, moving.keys(), places)
    packed = wire.write_shift(
        wire.JointShift(robot.number, shift, body=body, joined=stays, sd=sd), program.params.bits
    )
    # The keeper moves robots by the shift that they hear, rounded as it is.
    joint = wire.read_shift(packed, program.params.bits)
    for number, record in memory.records.items():
        # Who has not heard of it by then is asked again.
        record.is_current &= record.body != body
        memory.join_body(number, joint)
    pair = wire.write_pair(parent, child)
    if joiner == robot.number:
        robot.hang_between(pair, packed)
    else:
        robot.say(Hang([joiner], packed, pair))
    merged = LocalSwarm(program, of_body(records, stays))
    send_solution(robot, joiner, merged.solve(joiner, anew=False, everywhere=True))


def send_solution(robot: PeerState, joiner: int, solution: LocalSolution) -> None:
    """Send robots their new places, and shifts to branches."""
    # Thinking costs a robot energy, too.
    robot.operations += solution.operations
    results = {}
    for number, place in solution.places.items():
        with_candidates = number == joiner and robot.program.exchanges
        results[number] = wire.write_result(
            place,
            solution.candidates if with_candidates else None,
            robot.program.params.bits,
            is_surprising=number in solution.surprising,
        )
        # The robot holds what others hear, rounded as it is.
        robot.hold_result(number, results[number])
        robot.memory.of(number).is_current = True
    if results.pop(robot.number, None):
        robot.follow(robot.number, 0)
    robot.say(Place.of(results))
    _send_shifts(robot, solution)


def _send_shifts(robot: PeerState, solution: LocalSolution) -> None:
    """Let branches move as one."""
    for number, shift in solution.along.items():
        record = robot.memory.of(number)
        if record.place is not None:
            record.place = record.place._replace(position=record.place.position + shift)
    if robot.number in solution.along:
        robot.warn(robot.number)
    for first, (shift, parted) in solution.shifts.items():
        packed = wire.write_shift(
            wire.JointShift(robot.number, shift, parted), robot.program.params.bits
        )
        if first == robot.number:
            robot.pass_shift(packed)
        else:
            robot.say(Branch([first], packed))
