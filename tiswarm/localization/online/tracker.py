"""Estimates the positions of all robots while they join.

A join measures the rows of the new robot alone, places it where they fit best, and solves for the
robots near it. If its rows still miss, robots nearby try other places that their own rows allow.
The whole structure is annealed, from where it is, once it has grown by a tenth. Lengths inside are
in R, and relative to the anchor.
"""

from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute import backend, program
from tiswarm.localization.assessment import assess, rms
from tiswarm.localization.joint.problem import pose_problem
from tiswarm.localization.online.annealing import annealed_estimate, reannealed
from tiswarm.localization.online.blocks import Block, block_of
from tiswarm.localization.online.configuration import Configuration
from tiswarm.localization.online.layers import LocalLayers
from tiswarm.localization.online.lines import (
    entries,
    named,
    refuse_header,
    refuse_line,
    standing,
    without,
)
from tiswarm.localization.online.neighborhood import Neighborhood
from tiswarm.localization.online.settings import (
    TIMES,
)
from tiswarm.localization.params import LocalizationParams, OnlineParams
from tiswarm.localization.registry import centered, uncentered
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_builder import SensingLogBuilder
from tiswarm.records.sensing_format import Line, RobotLine, line_text, parse_header, parse_robot
from tiswarm.records.sensing_log import SensingLog

_AXES = 3
_MOVED = 1e-3
"""Shift from which on a robot has moved [R]."""


class Change(NamedTuple):
    """What the line of one robot changed: K robots moved, the one that joined among them."""

    robot: Ints
    """Names of the robots that moved, in join order, shape (K,)."""

    position: Reals
    """Their centers now [log unit], shape (K, 3)."""

    moved: Reals
    """How far each moved [log unit], NaN for one that joined, shape (K,)."""

    sd: Reals
    """Standard deviation of each position now [log unit], shape (K,)."""

    annealed: bool
    """Whether the whole structure was annealed."""


class Tracker:
    """Estimates the positions of all robots while they join.

    The same lines give the same bytes, at any number of threads.
    """

    def __init__(self, header: Line, params: LocalizationParams | None = None) -> None:
        """Prepare for robots to join.

        Args:
            header: First line of a sensing file.
            params: Settings of `online`; its defaults if None.

        Raises:
            InputError: the header is malformed, or it states what a tracker cannot solve for.
        """
        chosen = OnlineParams() if params is None else params
        if not isinstance(chosen, OnlineParams):
            raise InputError(
                f"{chosen.method} needs the log of all robots; localize it once they have joined"
            )
        head = parse_header(line_text(header))
        refuse_header(head)
        self._params, self._head = chosen, head
        self._unit, self._anchor = head.dock_radius, np.array(head.anchor_position)
        self._lines: dict[int, RobotLine] = {}
        self._start()

    def _start(self) -> None:
        """Begin without robots."""
        self._builder = SensingLogBuilder(self._head)
        self._index: dict[int, int] = {}
        self._layers = LocalLayers(len(self._head.dock_offsets), self._params)
        self._annealed_at = 1

    @property
    def log(self) -> SensingLog:
        """The sensing log of the robots so far."""
        return self._builder.log()

    @property
    def names(self) -> Ints:
        """Names of the robots, in join order, shape (n,)."""
        return np.array(list(self._index), np.int64)

    @property
    def positions(self) -> Reals:
        """Estimated centers in join order [log unit], shape (n, 3)."""
        moved: Reals = self._layers.mean * self._unit + self._anchor
        return moved

    @property
    def sd(self) -> Reals:
        """Standard deviation of each position [log unit], shape (n,)."""
        scaled: Reals = self._layers.sd * self._unit
        return scaled

    @program.exclusive()
    def join(self, robot: Line) -> Change:
        """Add the next robot; the first one is the anchor.

        Args:
            robot: Its line of a sensing file.

        Raises:
            InputError: the line is malformed, or says what a tracker cannot use. The robot leaves
                no trace then.
        """
        line = parse_robot(line_text(robot))
        refuse_line(line)
        before = self._layers.mean
        annealed = self._join(line)
        return self._change(before, annealed=annealed)

    @program.exclusive()
    def update(self, robot: Line) -> Change:
        """Replace the line of a robot that has joined, as after it has sensed more.

        Args:
            robot: Its new line, which names robots that joined before it, as the first one did.

        Raises:
            InputError: the line is malformed, or no such robot has joined. Nothing changes then.
        """
        line = parse_robot(line_text(robot))
        refuse_line(line)
        self._require(line.robot)
        before = self._layers.mean
        self._rebuild({**self._lines, line.robot: line}, {line.robot})
        annealed = self._settle([self._index[line.robot]])
        return self._change(before, annealed=annealed)

    @program.exclusive()
    def leave(self, robot: int) -> Change:
        """Remove a robot, with all that later robots sensed of it.

        Args:
            robot: Its name.

        Returns:
            Who moved of those that stay.

        Raises:
            InputError: no such robot has joined, or it is the anchor. Nothing changes then.
        """
        self._require(robot)
        number = self._index[robot]
        if number == 0:
            raise InputError("the anchor holds all others; start anew from another one")
        stay = {name: line for name, line in self._lines.items() if name != robot}
        lines = {name: without(line, robot) for name, line in stay.items()}
        changed = {name for name in stay if lines[name] is not stay[name]}
        before = np.delete(self._layers.mean, number, axis=0)
        self._rebuild(lines, changed)
        annealed = self._settle([self._index[name] for name in sorted(changed)])
        return self._change(before, annealed=annealed)

    def _require(self, robot: int) -> None:
        if robot not in self._index:
            raise InputError(f"robot {robot} has not joined; join it first", key="robot")

    def neighborhood(self, robots: Ints) -> Neighborhood:
        """Gather the cost of some robots, ascending by join order, all others where they are."""
        return self._layers.neighborhood(robots)

    @program.exclusive()
    def estimate(self, *, final: bool = False) -> Estimate:
        """Return the estimate of all robots, with verdicts.

        Later joins do not depend on this call.

        Args:
            final: Whether to anneal the structure first and to look for several solutions, as
                `joint` does; else it is the present state.

        Raises:
            InputError: no robot has joined.
        """
        if not self._index:
            raise InputError("no robot has joined; join the anchor first")
        backend.processor()
        whole = self.log
        log = centered(whole)
        found = (
            annealed_estimate(log, self._params, self._layers.state)
            if final
            else self._present(log)
        )
        return uncentered(found, whole)

    def _present(self, log: SensingLog) -> Estimate:
        """Make an estimate of the present state, relative to the anchor."""
        problem = pose_problem(log, self._params)
        position, sd = self._layers.mean, self._layers.sd
        verdicts = assess(log, self._params.cues, position, is_guess=problem.untied, sd=sd)
        gap = problem.residual(position, np.zeros(len(position)))
        return Estimate(
            robot_id=log.robot_id,
            position=position * self._unit,
            disconnected=problem.untied,
            sd=sd * self._unit,
            **verdicts._asdict(),
            iteration=np.array([len(position)]),
            trace=position[None] * self._unit,
            residual=rms(gap[None]) * self._unit,
        )

    def _join(self, line: RobotLine) -> bool:
        """Add a checked robot, and solve for what is near; return whether all was annealed."""
        # A line that is refused here or in the builder leaves no trace.
        block = self._measured(line)
        number = len(self._index)
        self._builder.add(line)
        backend.processor()
        self._index[line.robot] = number
        self._lines[line.robot] = line
        self._layers.append(block, self._touching(line))
        if number == 0:
            return False
        return self._settle([number], self._layers.place(number))

    def _settle(self, numbers: list[int], places: Reals | None = None) -> bool:
        """Solve for what is near some robots; anneal all where that is due, and say whether."""
        backend.processor()
        surprised = [self._layers.solve_near(number, places) for number in numbers]
        # As growth is relative, annealing costs each robot the same in the mean.
        grown = len(self._index) / self._annealed_at - 1.0
        least = TIMES.surprised_growth if any(surprised) else self._params.anneal_growth
        if len(self._index) < TIMES.fewest or grown < least:
            return False
        self._annealed_at = len(self._index)
        log = centered(self.log)
        found = reannealed(log, self._params, self._layers.state)
        self._layers.state, self._layers.shift, self._layers.sd = found
        is_small = len(self._index) <= TIMES.searched
        if is_small and any(surprised) and any(map(self._layers.is_surprising, numbers)):
            found = reannealed(log, self._params, self._layers.state, anew=True)
            self._layers.state, self._layers.shift, self._layers.sd = found
        return True

    def _measured(self, line: RobotLine) -> Block:
        """Measure the rows of a robot, in a log where all others only stand."""
        mentioned = {other for entry in entries(line) for other in named(entry)}
        earlier = {self._index[name] for name in mentioned if name in self._index}
        own = self._index.get(line.robot, len(self._index))
        members = sorted(earlier | {0}) if own else []
        names = list(self._index)
        builder = SensingLogBuilder(self._head)
        for member in members:
            builder.add(standing(self._lines[names[member]]))
        builder.add(line)
        every = np.array([*members, own], np.int64)
        return block_of(centered(builder.log()), self._params, every)

    def _rebuild(self, lines: dict[int, RobotLine], changed: AbstractSet[int]) -> None:
        """Take other lines, and measure those of some robots anew; positions stay.

        An InputError leaves everything as it was.
        """
        builder = SensingLogBuilder(self._head)
        for line in lines.values():
            builder.add(line)
        # Nothing has changed so far: the builder refuses what is wrong.
        kept = {name: self._index[name] for name in lines}
        before, annealed_at = self._layers, self._annealed_at
        self._start()
        self._builder, self._lines, self._annealed_at = builder, lines, annealed_at
        self._index = {name: number for number, name in enumerate(kept)}
        renumbered = np.zeros(len(before.blocks), np.int64)
        old = np.array(list(kept.values()))
        renumbered[old] = np.arange(len(old))
        now = self._layers
        for name, number in kept.items():
            block = before.blocks[number]
            block = replace(block, members=renumbered[block.members])
            block = self._measured(lines[name]) if name in changed else block
            now.append(block, self._touching(lines[name]))
        now.places = [before.places[number] for number in kept.values()]
        now.state = Configuration(*(each[old] for each in before.state))
        now.shift, now.sd = before.shift[old], before.sd[old]

    def _touching(self, line: RobotLine) -> set[tuple[int, int, int]]:
        """List the docks of a robot in contact, as `append` takes them."""
        return {(dock, self._index[other], its) for dock, other, its in line.contacts}

    def _change(self, before: Reals, *, annealed: bool) -> Change:
        """Say who moved since these positions, shape (n, 3)."""
        known = len(before)
        moved = np.full(len(self._layers.sd), np.nan)
        moved[:known] = np.linalg.norm(self._layers.mean[:known] - before, axis=1)
        # NaN, of a robot that joined, counts as moved.
        chosen = ~(moved <= _MOVED)
        return Change(
            robot=self.names[chosen],
            position=self.positions[chosen],
            moved=moved[chosen] * self._unit,
            sd=self.sd[chosen],
            annealed=annealed,
        )
