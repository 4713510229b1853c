"""Estimates the positions of all robots while they join.

A join measures the rows of the new robot alone, places it where they fit best, and solves for the
robots near it. If its rows still miss, robots nearby try other places that their own rows allow.
The whole structure is annealed, from where it is, once it has grown by a tenth. Lengths inside are
in R, and relative to the anchor.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute import backend
from tiswarm.localization.chains.problem import chosen_rows, pose_problem
from tiswarm.localization.cost.neighborhood import Block, Neighborhood, block_of
from tiswarm.localization.methods import centered, uncentered
from tiswarm.localization.mixture.verdict import Assessment, assess, rms
from tiswarm.localization.settings import LocalizationParams, OnlineParams
from tiswarm.measurements.odometry import Odometry
from tiswarm.parts.online.annealing import annealed_estimate, elsewhere, reannealed
from tiswarm.parts.online.layers import LocalLayers
from tiswarm.parts.online.lines import (
    mentioned,
    refuse_header,
    refuse_line,
    released,
    standing,
)
from tiswarm.parts.online.settings import TIMES
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import (
    Line,
    RobotLine,
    line_text,
    parse_header,
    parse_line,
    parse_robot,
)
from tiswarm.records.sensing_log import SensingLog

_AXES = 3
_MOVED = 1e-3
"""Shift from which on a robot has moved [R]."""

_SURER = 5e-3
"""Change of a standard deviation, relative to what was last said, that is said [1]."""


class Change(NamedTuple):
    """What the line of one robot changed: K robots, the one that joined among them."""

    robot: Ints
    """Names of the robots that moved, or are more or less certain, in join order, shape (K,)."""

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

    The same lines give the same bytes, at any number of threads of one machine.
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
        self._builder = SensingLogBuilder(self._head)
        self._index: dict[int, int] = {}
        self._layers = LocalLayers(len(self._head.dock_offsets), self._params)
        self._annealed_at = 1
        self._outliers: set[int] = set()  # robots whose rows even a search did not explain
        self._said: Reals = np.empty(0)  # standard deviations [R]

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

    @property
    def gone(self) -> Ints:
        """Names of the robots that have left, in join order, shape (G,)."""
        return self.names[sorted(self._layers.gone)]

    @backend.exclusive()
    def take(self, line: Line) -> Change:
        """Take the next line of a sensing file: a robot that joins, or an event.

        Raises:
            InputError: as for `join`, `update`, `leave` and `release`. Nothing changes then.
        """
        entry = parse_line(line_text(line), self._head)
        if entry.event == "leave":
            return self.leave(entry.robot)
        if entry.event == "release":
            return self.release(entry.robot, entry.contacts)
        return self._updated(entry) if entry.event == "replace" else self._joined(entry)

    @backend.exclusive()
    def join(self, robot: Line) -> Change:
        """Add the next robot; the first one is the anchor.

        Args:
            robot: Its line of a sensing file.

        Raises:
            InputError: the line is malformed, or says what a tracker cannot use. The robot leaves
                no trace then.
        """
        return self._joined(parse_robot(line_text(robot)))

    @backend.exclusive()
    def update(self, robot: Line) -> Change:
        """Replace the line of a robot that has joined, as after it has sensed more.

        Args:
            robot: Its new line, which names robots that joined before it, as the first one did.

        Raises:
            InputError: the line is malformed, or no such robot is there. Nothing changes then.
        """
        return self._updated(parse_robot(line_text(robot)))

    @backend.exclusive()
    def leave(self, robot: int) -> Change:
        """Mark a robot as gone. What was sensed of it stays; later robots may stand in its place.

        Args:
            robot: Its name.

        Raises:
            InputError: no such robot is there, or it is the anchor. Nothing changes then.
        """
        self._builder.leave(robot)
        self._layers.gone.add(self._index[robot])
        return self._change(self._layers.mean, annealed=False)

    @backend.exclusive()
    def release(self, robot: int, contacts: Sequence[tuple[int | None, int, int | None]]) -> Change:
        """Drop contacts that a robot has let go of.

        Args:
            robot: Its name.
            contacts: Rows of (own dock, name of the other robot, its dock).

        Raises:
            InputError: the two do not touch so, or one of them is not there. Nothing changes then.
        """
        before = self._layers.mean
        self._builder.release(robot, contacts)
        owners = []
        for own, name, its in contacts:
            contact, owner = (own, name, its), robot
            if self._index[name] > self._index[robot]:
                contact, owner = (its, robot, own), name
            self._lines[owner] = released(self._lines[owner], contact)
            owners.append(self._index[owner])
        annealed = self._measured_anew({*owners}, sorted({*owners}))
        return self._change(before, annealed=annealed)

    def neighborhood(self, robots: Ints) -> Neighborhood:
        """Gather the cost of some robots, ascending by join order, all others where they are."""
        return self._layers.neighborhood(robots)

    @backend.exclusive()
    def estimate(self, *, final: bool = False) -> Estimate:
        """Return the estimate of all robots, with verdicts.

        Later joins do not depend on this call. Each call searches structures of up to 30 robots
        anew, half a second, where mirror images are possible.

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
        verdicts = self._challenged(log, verdicts, ~problem.untied)
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

    def _challenged(self, log: SensingLog, found: Assessment, is_tied: Bools) -> Assessment:
        """Search a small structure without a start before a good verdict on where it is.

        Robots whose rows fit at several places may all fit in the wrong ones, and no chi-square
        says so.
        """
        is_ambiguous = any(len(places) > 1 for places in self._layers.places)
        is_small = len(self._index) <= TIMES.searched
        if not (is_ambiguous and is_small and found.convergence.converged):
            return found
        away = elsewhere(log, self._params, self._layers.mean, self._layers.sd) & is_tied
        if not away.any():
            return found
        reason = f"a search puts {counted(int(away.sum()), 'robot')} elsewhere"
        verdict = replace(found.convergence, converged=False, reason=reason)
        return found._replace(convergence=verdict, outlier_contacts=None, outlier_places=None)

    def _joined(self, line: RobotLine) -> Change:
        """Add a robot, and solve for what is near."""
        refuse_line(line)
        before = self._layers.mean
        annealed = self._join(line)
        return self._change(before, annealed=annealed)

    def _updated(self, line: RobotLine) -> Change:
        """Take a new line of a robot, and solve for what is near."""
        refuse_line(line)
        before = self._layers.mean
        # The builder refuses what is wrong before anything changes.
        self._builder.replace(line)
        self._lines[line.robot] = line
        number = self._index[line.robot]
        # Blocks of later robots know which way its docks point.
        about = [k for k, block in enumerate(self._layers.blocks) if number in block.members]
        annealed = self._measured_anew({number, *about}, [number])
        return self._change(before, annealed=annealed)

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
        if is_small and self._surprising() - self._outliers:
            found = reannealed(log, self._params, self._layers.state, anew=True)
            self._layers.state, self._layers.shift, self._layers.sd = found
        # What a search has left is wrong in itself: no later join asks for another search.
        self._outliers = self._surprising() if is_small else set()
        return True

    def _surprising(self) -> set[int]:
        """Find the robots whose rows chance does not explain."""
        every = np.arange(len(self._index))
        return {*np.flatnonzero(self._layers.surprising(every)).tolist()}

    def _measured(self, line: RobotLine) -> Block:
        """Measure the rows of a robot, in a log where all others only stand."""
        earlier = {self._index[name] for name in mentioned(line) if name in self._index}
        own = self._index.get(line.robot, len(self._index))
        members = sorted(earlier | {0}) if own else []
        names = list(self._index)
        builder = SensingLogBuilder(self._head)
        for member in members:
            builder.add(standing(self._lines[names[member]]))
        builder.add(line)
        every = np.array([*members, own], np.int64)
        log = centered(builder.log())
        return block_of(chosen_rows(log, self._params, Odometry(log))[0], every)

    def _measured_anew(self, changed: AbstractSet[int], solved: list[int]) -> bool:
        """Measure the rows of some robots anew, and solve for what is near some of them.

        Positions are where they were before; return whether all robots were annealed.
        """
        before = self._layers
        self._layers = LocalLayers(len(self._head.dock_offsets), self._params)
        for number, line in enumerate(self._lines.values()):
            block = self._measured(line) if number in changed else before.blocks[number]
            self._layers.append(block, self._touching(line))
        self._layers.places, self._layers.state = before.places, before.state
        self._layers.shift, self._layers.sd = before.shift, before.sd
        self._layers.gone.update(before.gone)
        for number in solved:
            # Where it may be by fewer or other rows; without partners, anywhere.
            self._layers.places[number] = np.empty((0, _AXES))
            self._layers.place(number)
        return self._settle(solved)

    def _touching(self, line: RobotLine) -> set[tuple[int, int, int]]:
        """List the docks of a robot in contact, as `append` takes them."""
        return {(dock, self._index[other], its) for dock, other, its in line.contacts}

    def _change(self, before: Reals, *, annealed: bool) -> Change:
        """Say who moved since these positions, shape (n, 3), or is surer than was said."""
        known, sd = len(before), self._layers.sd
        moved = np.full(len(sd), np.nan)
        moved[:known] = np.linalg.norm(self._layers.mean[:known] - before, axis=1)
        said = np.append(self._said, sd[len(self._said) :])
        # NaN, of a robot that joined, counts as moved.
        chosen = ~(moved <= _MOVED) | (np.abs(sd - said) > _SURER * said)
        self._said = np.where(chosen, sd, said)
        return Change(
            robot=self.names[chosen],
            position=self.positions[chosen],
            moved=moved[chosen] * self._unit,
            sd=self.sd[chosen],
            annealed=annealed,
        )
