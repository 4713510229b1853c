"""The robots of a swarm and the channel between them: whose turn it is, and what it all cost."""

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.assessment import rms
from tiswarm.localization.distributed.channel import Channel, Message
from tiswarm.localization.distributed.local import Program
from tiswarm.localization.distributed.robot import Robot
from tiswarm.localization.joint.problem import pose_problem
from tiswarm.localization.params import DistributedParams
from tiswarm.records.estimate import Convergence, Estimate, Traffic
from tiswarm.records.sensing_format import RobotLine
from tiswarm.records.sensing_log import SensingLog

_MOST_TURNS = 1000
"""Times that robots go on without an answer after a join, before the next one joins."""


class Swarm:
    """Robots that join one by one. Nothing here looks into one for the sake of another."""

    def __init__(self, header: str, params: DistributedParams, robots: int) -> None:
        """Begin without robots; so many will join, and all are programmed alike."""
        self._program = Program(params, header)
        self.channel = Channel(params, robots, self._hear)
        self.robots: list[Robot] = []
        self._memory = np.zeros(robots, np.int64)
        self._at_join = np.zeros((robots, 3))

    def join(self, line: RobotLine) -> None:
        """Let the next robot join, and all go on until none waits for an answer."""
        robot = Robot(self._program, line)
        self.robots.append(robot)
        self.channel.join({*robot.touching})
        robot.join()
        self._send(robot)
        self.channel.settle()
        for _ in range(_MOST_TURNS):
            waiting = [each for each in self.robots if each.waits]
            if not waiting:
                break
            # Nothing is under way: whoever still waits has waited long enough.
            for each in waiting:
                each.expire()
                self._send(each)
            self.channel.settle()
        self._at_join[robot.number] = self._positions()[-1]
        memory = [each.memory for each in self.robots]
        self._memory[: len(memory)] = np.maximum(self._memory[: len(memory)], memory)

    def _hear(self, number: int, message: Message) -> Message:
        """Give a robot a message, send what it answers, and return what it passes on."""
        robot = self.robots[number]
        passed = robot.hear(message)
        self._send(robot)
        return passed

    def _send(self, robot: Robot) -> None:
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
        problem = pose_problem(log, self._program.params)
        sd = np.array([0.0 if r.place is None else r.place.sd for r in self.robots])
        sd[lost] = np.linalg.norm(position, axis=1).max() if len(position) else 0.0
        unit = log.dock_radius
        gap = problem.residual(position[None], np.zeros((1, len(position))))
        return Estimate(
            robot_id=log.robot_id,
            position=position * unit,
            disconnected=problem.untied,
            sd=sd * unit,
            convergence=_verdict(doubtful),
            iteration=np.array([len(position)]),
            trace=position[None] * unit,
            at_join=self._at_join * unit,
            residual=rms(gap) * unit,
            doubtful=doubtful,
            traffic=Traffic(
                sent=channel.sent,
                heard=channel.heard,
                messages=channel.messages,
                memory=self._memory,
                operations=np.array([robot.operations for robot in self.robots], np.float64),
                rounds=channel.rounds,
            ),
        )


def _verdict(doubtful: Bools) -> Convergence:
    """Sum up what the robots say of themselves."""
    count = int(doubtful.sum())
    reason = f"{count} of {len(doubtful)} robots doubt their positions" if count else ""
    return Convergence(
        converged=not count,
        consistent=not count,
        misfit_sd=0.0,
        reason=reason,
        chains=1,
        restarted=0,
    )
