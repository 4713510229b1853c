"""Estimates the positions of all robots while they join.

A join measures the rows of the new robot alone, places it where they fit best, and solves for the
robots near it. If its rows still miss, robots nearby try other places that their own rows allow.
The whole structure is annealed, from where it is, once it has grown by a tenth. Lengths inside are
in R, and relative to the anchor.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute import backend
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.neighborhood import NearCost
from tiswarm.localization.methods import centered, uncentered
from tiswarm.localization.mixture.verdict import Assessment, assess, rms
from tiswarm.localization.settings import MethodParams
from tiswarm.parts.online.annealing import annealed_estimate, elsewhere, reannealed
from tiswarm.parts.online.layers import (
    Joiner,
    LocalLayers,
    measured,
    refuse_header,
    refuse_line,
)
from tiswarm.parts.online.settings import TIMES, OnlineParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import (
    HeaderLine,
    Line,
    RobotLine,
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

    def __init__(self, header: Line | HeaderLine, params: MethodParams | None = None) -> None:
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
        head = parse_header(header)
        refuse_header(head)
        self._params = chosen
        self._unit, self._anchor = head.dock_radius, np.array(head.anchor_position)
        self._builder = SensingLogBuilder(head)
        self._layers = LocalLayers(len(head.dock_offsets), chosen)
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
        return np.array([*self._builder.numbers], np.int64)

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
        entry = parse_line(line, self._builder.header)
        if entry.event == "leave":
            return self.leave(entry.robot)
        if entry.event == "release":
            return self.release(entry.robot, entry.contacts)
        return self._updated(entry) if entry.event == "replace" else self._joined(entry)

    @backend.exclusive()
    def join(self, robot: Line | RobotLine) -> Change:
        """Add the next robot; the first one is the anchor.

        Args:
            robot: Its line of a sensing file.

        Raises:
            InputError: the line is malformed, or says what a tracker cannot use. The robot leaves
                no trace then.
        """
        return self._joined(parse_robot(robot))

    @backend.exclusive()
    def update(self, robot: Line | RobotLine) -> Change:
        """Replace the line of a robot that has joined, as after it has sensed more.

        Args:
            robot: Its new line, which names robots that joined before it, as the first one did.

        Raises:
            InputError: the line is malformed, or no such robot is there. Nothing changes then.
        """
        return self._updated(parse_robot(robot))

    @backend.exclusive()
    def leave(self, robot: int) -> Change:
        """Mark a robot as gone. What was sensed of it stays; later robots may stand in its place.

        Args:
            robot: Its name.

        Raises:
            InputError: no such robot is there, or it is the anchor. Nothing changes then.
        """
        self._builder.leave(robot)
        self._layers.gone.add(self._builder.numbers[robot])
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
        # The later of two robots has sensed that they touch.
        number = self._builder.numbers
        owners = {max(number[robot], number[name]) for _, name, _ in contacts}
        annealed = self._measured_anew(owners, sorted(owners))
        return self._change(before, annealed=annealed)

    def neighborhood(self, robots: Ints) -> NearCost:
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
        if not self._builder.numbers:
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
        is_small = len(self._builder.numbers) <= TIMES.searched
        if not (is_ambiguous and is_small and found.convergence.converged):
            return found
        away = elsewhere(log, self._params, self._layers.mean, self._layers.sd) & is_tied
        if not away.any():
            return found
        return found.doubted(f"a search puts {counted(int(away.sum()), 'robot')} elsewhere")

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
        number = self._builder.numbers[line.robot]
        # Blocks of later robots know which way its docks point.
        about = [k for k, block in enumerate(self._layers.blocks) if number in block.members]
        annealed = self._measured_anew({number, *about}, [number])
        return self._change(before, annealed=annealed)

    def _join(self, line: RobotLine) -> bool:
        """Add a checked robot, and solve for what is near; return whether all was annealed."""
        # A line that is refused leaves no trace.
        self._builder.add(line)
        number = self._builder.numbers[line.robot]
        self._layers.append(self._measured(number))
        if number == 0:
            return False
        return self._settle([number], self._layers.place(number))

    def _settle(self, numbers: list[int], places: Reals | None = None) -> bool:
        """Solve for what is near some robots; anneal all where that is due, and say whether."""
        backend.processor()
        surprised = [self._layers.solve_near(number, places) for number in numbers]
        # As growth is relative, annealing costs each robot the same in the mean.
        grown = len(self._builder.numbers) / self._annealed_at - 1.0
        least = TIMES.surprised_growth if any(surprised) else self._params.anneal_growth
        if len(self._builder.numbers) < TIMES.fewest or grown < least:
            return False
        self._annealed_at = len(self._builder.numbers)
        log = centered(self.log)
        found = reannealed(log, self._params, self._layers.state)
        self._layers.state, self._layers.shift, self._layers.sd = found
        is_small = len(self._builder.numbers) <= TIMES.searched
        if is_small and self._surprising() - self._outliers:
            found = reannealed(log, self._params, self._layers.state, anew=True)
            self._layers.state, self._layers.shift, self._layers.sd = found
        # What a search has left is wrong in itself: no later join asks for another search.
        self._outliers = self._surprising() if is_small else set()
        return True

    def _surprising(self) -> set[int]:
        """Find the robots whose rows chance does not explain."""
        every = np.arange(len(self._builder.numbers))
        return {*np.flatnonzero(self._layers.surprising(every)).tolist()}

    def _measured(self, number: int) -> Joiner:
        """Measure the rows of a robot."""
        return measured(*self._builder.log_of(number), self._params)

    def _measured_anew(self, changed: AbstractSet[int], solved: list[int]) -> bool:
        """Measure the rows of some robots anew, and solve for what is near some of them.

        Positions are where they were before; return whether all robots were annealed.
        """
        anew = {number: self._measured(number) for number in changed}
        self._layers = self._layers.with_other(anew)
        for number in solved:
            # Where it may be by fewer or other rows; without partners, anywhere.
            self._layers.places[number] = np.empty((0, _AXES))
            self._layers.place(number)
        return self._settle(solved)

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
