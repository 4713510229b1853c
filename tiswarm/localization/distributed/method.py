"""The method `distributed`: robots localize by what they send each other.

By default several robots solve, each for those that join within `reach` of it.

The log is cut into lines, one for each robot; from then on a robot has its own line, and what it
hears. Under `touch` robots in contact at the end, as the log has it, hear each other.

Algorithm 1 of the paper runs between robots, too: what it sends, beside the estimate of
`virtual-force`. A robot that joins needs the poses of those that it touches, and for undocked
repulsion of all near it: the paper's minimal global channel, on which robots "periodically
broadcast an estimated pose proxy (e.g., center and dock position)". Without that repulsion, those
that it touches answer it. In a round of back-propagation each robot sends its position after each
of its steps. By touch, robots pass on what they hear.

By a radio that loses transmissions, a robot that joins asks again for poses that it has not heard:
of those that it touches, or with `poses: asked` of all that answer, up to `retries` times. Then it
goes without.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.localization import methods
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.distributed.channel import HEADER, Channel, Message, pause, reached
from tiswarm.localization.distributed.local_swarm import with_fix
from tiswarm.localization.distributed.program import Program
from tiswarm.localization.distributed.robot import Peer
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.distributed.waiting import Timers
from tiswarm.localization.distributed.wire import MOST_ROBOTS, NUMBER, pose_bytes
from tiswarm.localization.mixture.assessment import assess
from tiswarm.localization.mixture.verdict import rms
from tiswarm.localization.online.layers import refuse_header, refuse_line
from tiswarm.localization.settings import BackPropagation, VirtualForceParams
from tiswarm.measurements.contacts import contact_count, disconnected
from tiswarm.measurements.cues import measure
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import lines_of
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import KNOWN_SD, LISTS, SensingLog

_OF_OTHERS = {"stances": None} | {
    name: None for name, key in LISTS.items() if key.robot is not None
}
"""What a line says of other robots, which Algorithm 1 does not use but for contacts."""

_MOST_TURNS = 1000
"""Times, for each robot, that some go on without an answer after a join, before the next joins."""

_OF_DISTANCE = 8
"""Operations for the distance of two docks [1]."""

_OF_FORCE = 30
"""Operations for the force between them [1]."""


@dataclass(frozen=True, kw_only=True)
class SwarmSolution:
    """What N robots know of themselves, and what that took. Lengths in R, from the anchor."""

    position: Reals
    """Where each robot takes itself to be; at the anchor if it does not know, shape (N, 3)."""

    at_join: Reals
    """Position that each robot took itself to have as it joined, shape (N, 3)."""

    sd: Reals
    """Standard deviation of each position, as its robot knows it, shape (N,)."""

    lost: Bools
    """Robots that do not know where they are relative to the anchor, shape (N,)."""

    doubtful: Bools
    """Robots that doubt where they are, shape (N,)."""

    traffic: dict[str, Reals]
    """As in `Estimate.traffic`."""

    steps: int
    """Number of joins."""

    reason: str
    """Why the search is not to be relied on."""


def estimate_of(log: SensingLog, params: DistributedParams, solution: SwarmSolution) -> Estimate:
    """Make an estimate of what robots know, with the verdicts that their rows allow."""
    position = solution.position
    unit = log.dock_radius
    problem = pose_problem(log, params)
    sd = solution.sd.copy()
    sd[solution.lost] = np.linalg.norm(position, axis=1).max(initial=0.0)
    gap = problem.residual(position[None], np.zeros((1, len(position))))
    is_guess = problem.untied | solution.lost
    verdicts = assess(log, params.used_cues, position, is_guess=is_guess, sd=sd)
    robots = len(solution.doubtful)
    doubtful = int(solution.doubtful.sum())
    if robots > 1:
        reason = solution.reason
        if doubtful:
            reason = f"{doubtful} of {robots} robots doubt their positions"
        verdicts = verdicts.doubted(reason)
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit,
        **verdicts.fields(is_guess, unit),
        iteration=np.array([solution.steps]),
        trace=position[None] * unit,
        at_join=solution.at_join * unit,
        residual=rms(gap) * unit,
        doubtful=solution.doubtful,
        traffic=solution.traffic,
    )


def localize(
    log: SensingLog, params: DistributedParams, on_progress: Callable[[float], None] = ignore
) -> Estimate:
    """Let the robots of a log join one after the other.

    Returns:
        The estimate, with what robots sent each other.

    Raises:
        InputError: the log has what robots cannot send, or more robots than have numbers.
    """
    if log.robot_count > MOST_ROBOTS:
        problem = f"distributed numbers up to {MOST_ROBOTS} robots; choose method joint"
        raise InputError(problem)
    # Robots go by their numbers in join order.
    numbered = replace(log, robot_id=np.arange(log.robot_count))
    head, lines = lines_of(numbered)
    refuse_header(head)
    for line in lines:
        refuse_line(line)
    if params.scheme == "algorithm-1":
        return algorithm_1(log, head, lines, params)
    swarm = PeerSwarm(head, params)
    for line in lines:
        swarm.join(line)
        swarm.leave(_leavers(log, line.robot + 1))
        on_progress((line.robot + 1) / len(lines))
    swarm.settle()
    if params.solver == "keeper":
        for _ in range(params.reviews):
            swarm.review()
    return estimate_of(log, params, swarm.solution())


def _leavers(log: SensingLog, joined: int) -> list[int]:
    """List the robots that left when so many had joined, by their numbers in join order."""
    leavers: list[int] = log.gone[log.left_after == joined].tolist()
    return leavers


class PeerSwarm:
    """Robots that join one by one. Nothing here looks into one for the sake of another."""

    def __init__(self, header: HeaderLine, params: DistributedParams) -> None:
        """Begin without robots; all are programmed alike."""
        self._program = Program(params, header)
        self.channel = Channel(params, self._hear)
        self.robots: list[Peer] = []
        self._timers = Timers(params.timer)
        self._memory: Ints = np.zeros(0, np.int64)
        self._at_join: list[Reals] = []

    def join(self, line: RobotLine) -> None:
        """Let the next robot join, and all go on until none waits, or for `join_rounds`.

        Args:
            line: What it sensed; robots go by their numbers in join order.
        """
        params = self._program.params
        robot = Peer(self._program, line if params.ranges else _without_ranges(line))
        self.robots.append(robot)
        self._memory = np.append(self._memory, 0)
        self.channel.join(reached(line, params))
        robot.join()
        self._send(robot)
        self.settle(self.channel.rounds + (params.join_rounds or math.inf))
        self._at_join.append(self._centers()[-1])

    def leave(self, robots: Sequence[int]) -> None:
        """Let robots leave: who touched them lets all that it reaches know.

        Those that left know no more than they knew by then.
        """
        touched = self.channel.leave(robots)
        for number in robots:
            self._timers.set(number, None, self.channel.rounds)
        for number in touched:
            witness = self.robots[number]
            # One message serves all that it reaches.
            if not all(witness.memory.has_left(leaver) for leaver in robots):
                witness.announce(robots, [n for n in self.channel.present if n != number])
                self._send(witness)
                self.settle()

    def review(self) -> None:
        """Let all robots that solved do so again, one after the other."""
        self.robots[0].review()
        self._send(self.robots[0])
        self.settle()

    def settle(self, until: float = math.inf) -> None:
        """Let messages pass until no robot waits for an answer, or so many rounds have passed."""
        channel, timers = self.channel, self._timers
        for _ in range(_MOST_TURNS * len(self.robots)):
            while channel.is_busy and channel.rounds < min(until, timers.first):
                channel.step()
            waiting = [self.robots[n] for n in channel.present if self.robots[n].waits]
            if not waiting or channel.rounds >= until:
                break
            if timers.first < math.inf:
                # The rounds up to the next timer pass in silence.
                channel.wait(round(min(until, timers.first)) - channel.rounds)
            # Without timers nothing is under way by now, so no answer will come.
            for robot in waiting:
                if timers.has_run_out(robot.number, channel.rounds):
                    self._send(robot, robot.expire())
        # Memory counts at its fullest.
        held = np.array([robot.memory.size for robot in self.robots]) + self.channel.memory
        self._memory = np.maximum(self._memory, held)

    @property
    def positions(self) -> Reals:
        """Centers as each robot estimates its own, in join order [log unit], shape (n, 3)."""
        head = self._program.header
        positions: Reals = self._centers() * head.dock_radius + head.anchor_position
        return positions

    @property
    def sent(self) -> Ints:
        """Bytes that each robot has sent so far, shape (n,)."""
        return np.array(self.channel.sent, np.int64)

    @property
    def sd(self) -> Reals:
        """Standard deviation of where each robot takes itself to be [log unit], shape (n,).

        NaN where it does not know.
        """
        places = [robot.place for robot in self.robots]
        sd = np.array([np.nan if place is None else place.sd for place in places])
        scaled: Reals = sd * self._program.header.dock_radius
        return scaled

    def _hear(self, number: int, message: Message) -> Message:
        """Give a robot a message, send what it answers, and return what it passes on."""
        robot = self.robots[number]
        passed = robot.hear(message)
        self._send(robot)
        return passed

    def _send(self, robot: Peer, silent: int = 0) -> None:
        """Send what a robot has to say, after some silent rounds."""
        while robot.outbox:
            self.channel.send(robot.outbox.pop(0), silent)
        self._timers.set(robot.number, robot.tasks.next_wait, self.channel.rounds + silent)

    def _centers(self) -> Reals:
        """List where the robots take themselves to be; at the anchor if they do not know."""
        places = [robot.place for robot in self.robots]
        centers = [np.zeros(3) if place is None else place.position for place in places]
        return np.array(centers).reshape(-1, 3)

    def solution(self) -> SwarmSolution:
        """Gather what each robot knows of itself."""
        robots = self.robots
        reason = "robots search near each other only, and many at once may be in a mirror image"
        if not self._program.params.chains:
            reason = "no robot annealed those near it, and any may be in a mirror image"
        operations = np.array([robot.operations for robot in robots])
        return SwarmSolution(
            position=self._centers(),
            at_join=np.array(self._at_join),
            sd=np.array([0.0 if robot.place is None else robot.place.sd for robot in robots]),
            lost=np.array([not robot.place or robot.place.body > 0 for robot in robots], np.bool_),
            doubtful=np.array([robot.judge() for robot in robots], np.bool_),
            traffic={
                **self.channel.traffic(self._memory, operations),
                "joins": np.array([robot.joins for robot in robots], np.float64),
            },
            steps=len(robots),
            reason=reason,
        )


def _without_ranges(line: RobotLine) -> RobotLine:
    """Leave out the ranges of a line, which robots then neither use nor send."""
    none = {"ranges": None}
    stances = [stance.model_copy(update=none) for stance in line.stances or []]
    return line.model_copy(update={**none, "stances": stances or line.stances})


class PublishedSwarm:
    """Robots that Algorithm 1 places as they join, with the bytes that they send for that."""

    def __init__(self, header: HeaderLine, params: DistributedParams) -> None:
        """Begin without robots."""
        places = methods.joining(params.published)
        assert places is not None  # noqa: S101 - settings that move robots later are refused
        # The second version knows fixes, by which robots are where they were heard to be.
        head = header.model_copy(update={"version": 2})
        self._swarm_of = partial(places, head, params.published)
        self._placed = self._swarm_of()
        self._unit = header.dock_radius
        self._params = params
        self._lines: list[RobotLine] = []
        self._positions: list[Reals] = []
        self.channel = Channel(params, lambda _, message: message)
        self.heard: list[set[int]] = []
        """Robots whose poses each one heard as it joined."""

    def join(self, line: RobotLine) -> None:
        """Place the next robot, once it has heard the poses that it needs."""
        earlier = {*range(len(self._lines))}
        self.channel.join(reached(line, self._params))
        if self._params.misses_poses:
            touching = {neighbor for _, neighbor, _ in line.contacts}
            self.heard.append(_hear_poses(self.channel, touching, self._params))
            self._positions.append(self._alone(line, {0, *self.heard[-1]} & earlier))
        else:
            _send_poses(self.channel, self._params)
            self._positions.append(self._placed.join(line))
        self._lines.append(line)

    def _alone(self, line: RobotLine, heard: set[int]) -> Reals:
        """Place a robot among those that it heard, which are where they say [log unit], (3,)."""
        swarm = self._swarm_of(capacity=len(heard) + 1)
        for number in sorted(heard):
            pose = self._lines[number].model_copy(update={**_OF_OTHERS, "contacts": []})
            swarm.join(with_fix(pose, self._positions[number], KNOWN_SD * self._unit))
        contacts = [contact for contact in line.contacts if contact[1] in heard]
        center: Reals = swarm.join(line.model_copy(update={**_OF_OTHERS, "contacts": contacts}))
        return center

    @property
    def positions(self) -> Reals:
        """Estimated centers in join order [log unit], shape (n, 3)."""
        return np.array(self._positions).reshape(-1, 3)

    @property
    def sent(self) -> Ints:
        """Bytes that each robot has sent so far, shape (n,)."""
        return np.array(self.channel.sent, np.int64)


def _hear_poses(channel: Channel, touching: set[int], params: DistributedParams) -> set[int]:
    """Let robots send poses that the last one to join may miss; it asks again for some.

    Returns:
        Robots whose poses it hears.
    """
    joiner = len(channel.sent) - 1
    pose = HEADER + pose_bytes(params.bits, with_orientation=True)
    asks_all = params.undocked_repulsion and params.poses == "asked"

    def heard_of(senders: Iterable[int]) -> set[int]:
        return {sender for sender, by in channel.transmit(senders, pose).items() if joiner in by}

    heard: set[int] = set()
    if not asks_all:
        heard = heard_of(channel.present if params.undocked_repulsion else sorted(touching))
    for attempt in range(1 - asks_all, params.retries + 1):
        missing = touching - heard
        if not (asks_all or missing):
            break
        channel.wait(pause(attempt) if attempt else 0)
        # A question names those that need not answer, or those that are to.
        named = len(heard if asks_all else missing)
        question = HEADER + -(-NUMBER * named // 8)
        asked = {*channel.transmit([joiner], question)[joiner]}
        fresh = heard_of(sorted(asked - heard if asks_all else asked & missing))
        heard |= fresh
        if not fresh and touching <= heard:
            break
    return heard


def _send_poses(channel: Channel, params: DistributedParams) -> None:
    """Count the poses that robots send as the last one joins: all, or those that it reaches."""
    pose = HEADER + pose_bytes(params.bits, with_orientation=True)
    joiner = len(channel.sent) - 1
    if params.undocked_repulsion and params.poses != "asked":
        channel.broadcast(pose)
        return
    if params.undocked_repulsion:
        channel.ask(joiner, HEADER)
    channel.answer(joiner, pose, by_all=params.undocked_repulsion)


def algorithm_1(
    log: SensingLog, head: HeaderLine, lines: Sequence[RobotLine], params: DistributedParams
) -> Estimate:
    """Localize a log by Algorithm 1, and count what robots send.

    Args:
        log: Sensing log of N robots.
        head: Its first line.
        lines: Their lines, under their numbers in join order.
        params: Settings.

    Returns:
        The estimate without rounding, with the traffic of the channel. Robots do not judge for
        themselves.
    """
    if params.misses_poses:
        return _with_losses(log, head, lines, params)
    settings = params.published
    [estimate] = methods.localize_batch([log], [settings])
    robots = log.robot_count
    channel = Channel(params, lambda _, message: message)
    pose = HEADER + pose_bytes(params.bits, with_orientation=True)
    moved = HEADER + pose_bytes(params.bits, with_orientation=False)
    rounds = params.back_propagation
    for number, line in enumerate(lines):
        channel.join(reached(line, params))
        if params.poses != "once" or not params.undocked_repulsion or number == robots - 1:
            _send_poses(channel, params)
        channel.leave(_leavers(log, number + 1))
        if rounds is not None and _follows(rounds, number + 1, robots):
            channel.broadcast(moved, rounds.sweeps, by_all=params.undocked_repulsion)
    hears_all = params.undocked_repulsion and params.radio_reach is None
    heard_of = np.full(robots, robots) if hears_all else 1 + channel.degree
    memory = heard_of * (pose - HEADER)
    traffic = channel.traffic(memory, _operations(log, settings, estimate.steps))
    return replace(estimate, traffic=traffic)


def _with_losses(
    log: SensingLog, head: HeaderLine, lines: Sequence[RobotLine], params: DistributedParams
) -> Estimate:
    """Localize a log by Algorithm 1, each robot by the poses that it hears."""
    swarm = PublishedSwarm(head, params)
    for line in lines:
        swarm.join(line)
        swarm.channel.leave(_leavers(log, line.robot + 1))
    settings = params.published
    position = swarm.positions
    rows = measure(log, ["contacts", "anchors"])
    untied = disconnected(rows)
    gap = rows.residual(position / log.dock_radius)
    verdicts = assess(log, settings.used_cues, position / log.dock_radius, is_guess=untied)
    pose = pose_bytes(params.bits, with_orientation=True)
    memory = np.array([1 + len(heard) for heard in swarm.heard]) * pose
    return Estimate(
        robot_id=log.robot_id,
        position=position,
        **verdicts.fields(untied, log.dock_radius),
        iteration=np.array([len(lines)]),
        trace=position[None],
        residual=rms(gap[None]) * log.dock_radius,
        traffic=swarm.channel.traffic(memory, _operations(log, settings, None)),
    )


def _follows(rounds: BackPropagation, joined: int, robots: int) -> bool:
    """Judge whether a round follows a join."""
    return joined % rounds.every == 0 or joined == robots


def _operations(log: SensingLog, params: VirtualForceParams, steps: Ints | None) -> Reals:
    """Count the operations of each robot, shape (N,); for Eq. (2) it looks at all docks."""
    taken = steps
    if taken is None:
        taken = np.full(log.robot_count, params.iterations)
    docks = len(log.dock_offset_body)
    # Only robots that have joined before are heard.
    pairs = docks**2 * np.arange(log.robot_count) * params.undocked_repulsion
    per_step = _OF_DISTANCE * pairs + _OF_FORCE * contact_count(log)
    return np.asarray(taken * per_step, np.float64)
