"""The robots of a swarm and the channel between them: whose turn it is, and what it all cost."""

from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.assessment import assess, rms
from tiswarm.localization.distributed.channel import Channel, Message
from tiswarm.localization.distributed.local import Program
from tiswarm.localization.distributed.robot import Peer
from tiswarm.localization.joint.problem import pose_problem
from tiswarm.localization.params import DistributedParams
from tiswarm.records.estimate import Convergence, Estimate
from tiswarm.records.sensing_format import RobotLine
from tiswarm.records.sensing_log import SensingLog

_MOST_TURNS = 1000
"""Times that robots go on without an answer after a join, before the next one joins."""


class PeerSwarm:
    """Robots that join one by one. Nothing here looks into one for the sake of another."""

    def __init__(self, header: str, params: DistributedParams, robots: int) -> None:
        """Begin without robots; so many will join, and all are programmed alike."""
        self._program = Program(params, header)
        self.channel = Channel(params, robots, self._hear)
        self.robots: list[Peer] = []
        self._memory = np.zeros(robots, np.int64)
        self._at_join = np.zeros((robots, 3))

    def join(self, line: RobotLine) -> None:
        """Let the next robot join, and all go on until none waits for an answer."""
        robot = Peer(self._program, line)
        self.robots.append(robot)
        self.channel.join({*robot.touching})
        robot.join()
        self._send(robot)
        self.channel.settle()
        for _ in range(_MOST_TURNS):
            waiting = [each for each in self.robots if each.waits]
            if not waiting:
                break
            # Nothing is under way, so no answer will come.
            for each in waiting:
                each.expire()
                self._send(each)
            self.channel.settle()
        self._at_join[robot.number] = self._positions()[-1]
        # Memory counts at its fullest.
        memory = [each.memory for each in self.robots]
        self._memory[: len(memory)] = np.maximum(self._memory[: len(memory)], memory)

    def _hear(self, number: int, message: Message) -> Message:
        """Give a robot a message, send what it answers, and return what it passes on."""
        robot = self.robots[number]
        passed = robot.hear(message)
        self._send(robot)
        return passed

    def _send(self, robot: Peer) -> None:
        while robot.outbox:
            self.channel.send(robot.outbox.pop(0))

    def _positions(self) -> Reals:
        """List where the robots take themselves to be; at the anchor if they do not know."""
        places = [robot.place for robot in self.robots]
        return np.array([np.zeros(3) if place is None else place.position for place in places])

    def estimate(self, log: SensingLog) -> Estimate:
        """Gather what each robot knows of itself."""
        position, channel = self._positions(), self.channel
        lost = np.array([robot.place is None for robot in self.robots], np.bool_)
        doubtful: Bools = np.array([robot.judge() for robot in self.robots], np.bool_)
        params, unit = self._program.params, log.dock_radius
        problem = pose_problem(log, params)
        sd = np.array([0.0 if r.place is None else r.place.sd for r in self.robots])
        sd[lost] = np.linalg.norm(position, axis=1).max(initial=0.0)
        gap = problem.residual(position[None], np.zeros((1, len(position))))
        is_guess = problem.untied | lost
        verdicts = assess(log, params.cues, position, is_guess=is_guess, sd=sd)._asdict()
        verdicts["convergence"] = self._verdict(verdicts["convergence"], int(doubtful.sum()))
        return Estimate(
            robot_id=log.robot_id,
            position=position * unit,
            disconnected=is_guess,
            sd=sd * unit,
            **verdicts,
            iteration=np.array([len(position)]),
            trace=position[None] * unit,
            at_join=self._at_join * unit,
            residual=rms(gap) * unit,
            doubtful=doubtful,
            traffic=channel.traffic(
                self._memory, np.array([robot.operations for robot in self.robots])
            ),
        )

    def _verdict(self, found: Convergence, doubtful: int) -> Convergence:
        """Say why the search is not to be relied on; whether noise explains rows stands."""
        if len(self.robots) == 1:
            return found
        reason = "robots search near each other only, and many at once may be in a mirror image"
        if not self._program.params.chains:
            reason = "no robot annealed those near it, and any may be in a mirror image"
        if doubtful:
            reason = f"{doubtful} of {len(self.robots)} robots doubt their positions"
        return replace(found, converged=False, reason=reason)
