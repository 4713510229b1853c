"""The robots of a swarm and the channel between them: whose turn it is, and what it all cost."""

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.parts.between.channel import Channel, Message
from tiswarm.parts.between.conclusion import Found
from tiswarm.parts.between.local import Program
from tiswarm.parts.between.robot import Peer
from tiswarm.records.sensing_format import RobotLine

_MOST_TURNS = 1000
"""Times that robots go on without an answer after a join, before the next one joins."""


class PeerSwarm:
    """Robots that join one by one. Nothing here looks into one for the sake of another."""

    def __init__(self, program: Program, robots: int) -> None:
        """Begin without robots; so many will join, and all are programmed alike."""
        self._program = program
        self.channel = Channel(program.params, robots, self._hear)
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

    def found(self) -> Found:
        """Gather what each robot knows of itself."""
        robots = self.robots
        reason = "robots search near each other only, and many at once may be in a mirror image"
        if not self._program.params.chains:
            reason = "no robot annealed those near it, and any may be in a mirror image"
        operations = np.array([robot.operations for robot in robots])
        return Found(
            position=self._positions(),
            at_join=self._at_join,
            sd=np.array([0.0 if robot.place is None else robot.place.sd for robot in robots]),
            lost=np.array([robot.place is None for robot in robots], np.bool_),
            doubtful=np.array([robot.judge() for robot in robots], np.bool_),
            traffic=self.channel.traffic(self._memory, operations),
            steps=len(robots),
            reason=reason,
        )
