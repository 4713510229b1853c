"""The method `online`: estimates the positions of all robots while they join.

A join measures the rows of the new robot alone, places it where they fit best, and solves for the
robots near it. If its rows still miss, robots nearby try other places that their own rows allow.
The structure is annealed, from where it is, once it has grown by a tenth; a large one where lines
have changed. Lengths inside are in R, and relative to the anchor.

A log is fed to a tracker robot by robot, as if they joined now. The trace has a frame after some
joins. Robots that have not joined by then stand where they are placed as they join: the first frame
is the error at joining, the last one that of the final answer.

A stream is answered line by line. Each line of the input has one answer. Nothing is stored: the
same lines give the same answers, byte for byte, so a stream that was stopped is fed again from its
header on.
"""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.compute import backend
from tiswarm.compute.math import normal
from tiswarm.localization import methods
from tiswarm.localization.chains.annealer import Annealer
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import place_disconnected, set_apart, view_of
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import State, WholeCost, moments
from tiswarm.localization.cost.linear import Linear
from tiswarm.localization.methods import centered, uncentered
from tiswarm.localization.mixture import CONVERGENCE, REFINEMENT
from tiswarm.localization.mixture.assessment import Assessment, assess
from tiswarm.localization.mixture.ends import Fit, Posed, ranked
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.outliers import without_outlier_robots
from tiswarm.localization.mixture.verdict import extent, rms
from tiswarm.localization.online.layers import (
    Joiner,
    LocalLayers,
    measured,
    refuse_header,
    refuse_line,
    turns_at,
)
from tiswarm.localization.online.neighborhood import NearCost
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS, TIMES, OnlineParams
from tiswarm.localization.settings import ChiSquareParams, JointParams, MethodParams
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import Measurements
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import at_line, decode
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import SensingLogBuilder, lines_of
from tiswarm.records.sensing_format import (
    HeaderLine,
    Line,
    RobotLine,
    parse_header,
    parse_line,
    parse_robot,
)
from tiswarm.records.sensing_log import SensingLog

_MOVED = 1e-3
"""Shift from which on a robot has moved [R]."""

_SURER = 5e-3
"""Change of a standard deviation, relative to what was last said, that is said [1]."""

_COST_TOLERANCE = 1.0
"""Difference of costs up to which two solutions fit equally well [1]."""

_ANNEALER = ("chains", "steps", "hold_steps", "start_sigma")
"""Settings that annealings from the present estimate take from those of `online`."""

_FRAMES = 24
"""Frames of the trace at most, beside the last."""

_DIGITS = 6
"""Decimals of lengths in an answer."""


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
    """Whether the structure was annealed; a large one, where lines have changed."""


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
        self._unit = head.dock_radius
        self._anchor = np.array(head.anchor_position)
        self._builder = SensingLogBuilder(head)
        self._layers = LocalLayers(len(head.dock_offsets), chosen)
        self._annealed_at = 1
        self._solved: set[int] = set()  # robots solved for since then
        self._outliers: set[int] = set()  # robots whose rows even a search did not explain
        self._said: Reals = np.empty(0)  # standard deviations [R]

    @property
    def header(self) -> HeaderLine:
        """First line of the log."""
        return self._builder.header

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
        if entry.event == "replace":
            return self._updated(entry)
        return self._joined(entry)

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
        if final:
            estimate = annealed_estimate(log, self._params, self._layers.state)
        else:
            estimate = self._present(log)
        return uncentered(estimate, whole)

    def _present(self, log: SensingLog) -> Estimate:
        """Make an estimate of the present state, relative to the anchor."""
        problem = pose_problem(log, self._params)
        position = self._layers.mean
        sd = self._layers.sd
        verdicts = assess(log, self._params.used_cues, position, is_guess=problem.untied, sd=sd)
        verdicts = self._challenged(log, verdicts, ~problem.untied)
        gap = problem.residual(position, np.zeros(len(position)))
        return Estimate(
            robot_id=log.robot_id,
            position=position * self._unit,
            **verdicts.fields(problem.untied, self._unit),
            iteration=np.array([len(position)]),
            trace=position[None] * self._unit,
            residual=rms(gap[None]) * self._unit,
        )

    def _challenged(self, log: SensingLog, verdicts: Assessment, is_tied: Bools) -> Assessment:
        """Search a small structure without a start before a good verdict on where it is.

        Robots whose rows fit at several places may all fit in the wrong ones, and no chi-square
        says so.
        """
        is_ambiguous = any(len(places) > 1 for places in self._layers.places)
        is_small = len(self._builder.numbers) <= TIMES.searched
        if not (is_ambiguous and is_small and verdicts.convergence.converged):
            return verdicts
        away = elsewhere(log, self._params, self._layers.mean, self._layers.sd) & is_tied
        if not away.any():
            return verdicts
        return verdicts.doubted(f"a search puts {counted(int(away.sum()), 'robot')} elsewhere")

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
        """Add a checked robot, and solve for what is near; return whether chains annealed it."""
        # A line that is refused leaves no trace.
        self._builder.add(line)
        backend.processor()
        number = self._builder.numbers[line.robot]
        self._layers.append(self._measured(number))
        if number == 0:
            return False
        return self._settle([number], self._layers.place(number))

    def _settle(self, numbers: list[int], places: Reals | None = None) -> bool:
        """Solve for what is near some robots; anneal all where that is due, and say whether."""
        surprised = [self._layers.solve_near(number, places) for number in numbers]
        self._solved.update(numbers)
        # As growth is relative, annealing costs each robot the same in the mean.
        grown = len(self._builder.numbers) / self._annealed_at - 1.0
        least = TIMES.surprised_growth if any(surprised) else self._params.anneal_growth
        if len(self._builder.numbers) < TIMES.fewest or grown < least:
            self._widen(numbers)
            return False
        self._annealed_at = len(self._builder.numbers)
        log = centered(self.log)
        annealed = reannealed(log, self._params, self._layers.state, moves=self._due())
        self._layers.state, self._layers.shift, self._layers.sd = annealed
        self._solved.clear()
        is_small = len(self._builder.numbers) <= TIMES.searched
        if is_small and self._surprising() - self._outliers:
            annealed = reannealed(log, self._params, self._layers.state, anew=True)
            self._layers.state, self._layers.shift, self._layers.sd = annealed
        # What a search has left is wrong in itself: no later join asks for another search.
        self._outliers = set()
        if is_small:
            self._outliers = self._surprising()
        return True

    def _widen(self, numbers: list[int]) -> None:
        """Set the sd of robots near some that are free to turn."""
        for number in numbers:
            loose = self._layers.loose_near(number)
            if len(loose):
                rows = pose_problem(centered(self.log), self._params).rows
                self._layers.widen(rows, number, loose)

    def _due(self) -> Bools:
        """Find the robots to anneal: what is known of them has changed, shape (n,).

        These are the robots that joined while the structure grew by twice as much as annealing
        waits for, those with a new line, and all that share a row with one of them.
        """
        robots = len(self._builder.numbers)
        since = int(robots / (1.0 + self._params.anneal_growth) ** 2)
        if robots <= TIMES.whole:
            since = 0
        changed = self._solved.union(range(since, robots))
        moves = np.zeros(robots, np.bool_)
        moves[[*self._layers.with_partners(changed)]] = True
        return moves

    def _surprising(self) -> set[int]:
        """Find the robots whose rows chance does not explain."""
        robots = np.arange(len(self._builder.numbers))
        return {*np.flatnonzero(self._layers.surprising(robots)).tolist()}

    def _measured(self, number: int) -> Joiner:
        """Measure the rows of a robot."""
        return measured(*self._builder.log_of(number), self._params)

    def _measured_anew(self, changed: AbstractSet[int], solved: list[int]) -> bool:
        """Measure the rows of some robots anew, and solve for what is near some of them.

        Positions are where they were before; return whether chains annealed them.
        """
        backend.processor()
        anew = {number: self._measured(number) for number in changed}
        self._layers = self._layers.with_other(anew)
        for number in solved:
            # Where it may be by fewer or other rows; without partners, anywhere.
            self._layers.places[number] = np.empty((0, AXES))
            self._layers.place(number)
        return self._settle(solved)

    def _change(self, before: Reals, *, annealed: bool) -> Change:
        """Say who moved since these positions, shape (n, 3), or is surer than was said."""
        sd = self._layers.sd
        moved = np.full(len(sd), np.nan)
        moved[: len(before)] = np.linalg.norm(self._layers.mean[: len(before)] - before, axis=1)
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


def reannealed(
    log: SensingLog,
    params: OnlineParams,
    state: State,
    *,
    moves: Bools | None = None,
    anew: bool = False,
) -> tuple[State, Reals, Reals]:
    """Anneal a structure of N robots from where it is, and keep the best minimum.

    Args:
        log: What was sensed; the anchor is at the origin.
        params: Settings.
        state: Where robots are.
        moves: Robots that chains move, while others stay; all if None, shape (N,).
        anew: Whether to anneal it from the starts of `joint`, too.

    Returns:
        The state, which is near the present one if no chain found a better one; the shift from
        there to the mean of all likely ends of chains [R], shape (N, 3); and the standard deviation
        of that [R], shape (N,).
    """
    fit = fitted(log, params, state, moves)
    problem = fit.problem
    ends = ranked(fit)
    robust_sd = ROBUST_SD if params.robust else None
    yaw = np.zeros(log.robot_count)
    best = int(ends.cost.argmin())
    cost = fit.cost(problem.rows, robust_sd=robust_sd)
    # Chains may all end higher than where they began, which is near a minimum already.
    minima = [
        # Turns of earlier stances follow from those of final ones in a step.
        cost.refine(cost.at(set_apart(problem, state.position), yaw, state.turn), 0),
        cost.refine(cost.at(ends.position[best], yaw, state.turn), TIMES.rounds),
    ]
    if anew:
        start = _searched(log, params).solutions[0].position / log.dock_radius
        minima.append(cost.refine(cost.at(start, yaw), TIMES.rounds))
    best_state, best_linear = min(minima, key=lambda minimum: minimum[1].cost)
    # Robots that stayed give way in a step that all take.
    whole = WholeCost(log, problem.rows, robust_sd=robust_sd, non_overlap=params.cues.non_overlap)
    settled = whole.at(best_state.position, yaw, best_state.turn, best_state.earlier)
    linear = whole.linearized(settled)
    within = linear.variance(draws=TIMES.draws)  # its factors serve the step, too
    within = np.minimum(within, extent(settled.position) ** 2)
    trial, _ = whole.moved(settled, linear, np.inf)
    if whole.linearized(trial).cost <= linear.cost:
        settled = trial
    placed, square = place_disconnected(settled.position[None], problem)
    # Ends are minima of a cost whose errors are independent: where they are is not where the cost
    # is least, but where they differ, several places are likely.
    annealed_state, annealed_linear = minima[1]
    apart = ends.position - ends.position[best] + annealed_state.position - best_state.position
    apart[np.linalg.norm(apart, axis=2) <= np.sqrt(within)] = 0.0
    mean, between = moments(ends.weight, apart)
    # Chains that ended far above the best minimum say nothing about it.
    counts = ~problem.untied & (annealed_linear.cost <= best_linear.cost + CANDIDATES.likely)
    shift = np.where(counts[:, None], mean, 0.0)
    square = within + np.where(counts, between, square[0])
    if problem.rows.is_central.any():
        square = _with_turns(linear, problem.rows, placed[0], shift, square)
    return State(placed[0], settled.turn), shift, np.sqrt(square)


def _with_turns(
    linear: Linear, rows: Measurements, position: Reals, shift: Reals, square: Reals
) -> Reals:
    """Replace the variance of robots that turn freely: a circle is far from its tangent.

    Args:
        linear: Cost near the state.
        rows: Measurements.
        position: Where robots are [R], shape (N, 3).
        shift: From there to the mean of likely states [R], shape (N, 3).
        square: Variance of each position [R^2], shape (N,).
    """
    loose = _loose(linear, position)
    if not len(loose):
        return square
    turns = turns_at(rows, position, loose)
    if not turns:
        return square
    turned = turns.off(position, position + shift)
    variance_without_turns = linear.variance(turns.motions(position), TIMES.draws)
    return np.where(turned > 0.0, turned + variance_without_turns, square)


def _loose(linear: Linear, position: Reals) -> Ints:
    """Find robots at centers (N, 3) that ranges may leave free to turn, ascending, shape (k,).

    Errors do not excite a motion that nothing resists. The inverse of the information, times random
    numbers, is large along it: the variance of a motion that is resisted.
    """
    draw = np.zeros((len(linear.precision), TIMES.draws))
    coordinate = np.arange(linear.shifts)[:, None]
    draw[: linear.shifts] = normal(0, "loose", coordinate, np.arange(TIMES.draws))
    shift = linear.undamped.solve(draw)[: linear.shifts].reshape(-1, AXES, TIMES.draws)
    variance = np.sqrt((shift**2).sum(axis=1).mean(axis=1))
    far = extent(position)[linear.moves]
    loose: Ints = np.flatnonzero(linear.moves)[variance >= (NEIGHBORS.loose * far) ** 2]
    return loose


def annealed_estimate(log: SensingLog, params: OnlineParams, state: State) -> Estimate:
    """Anneal a structure from where it is, and mix the chains as `joint` does; as `reannealed`.

    The present state counts as one more end. An estimate that is not to be trusted, or whose
    outliers alone tie robots to the world, gives way to that of `joint`, if that is trusted and
    fits no worse.
    """
    fit = fitted(log, params, state)
    chains = fit.annealed
    # A chain that stays is as warm as the others.
    stays = chains.still(set_apart(fit.problem, state.position)[None], chains.last_yaw[:1])
    stays = replace(stays, within=chains.within.mean(axis=0, keepdims=True))
    fit = Fit.of(fit, chains.joined(stays))
    estimate = without_outlier_robots(fit, mixed(fit))
    is_whole = not (estimate.disconnected & ~fit.problem.untied).any()
    if estimate.convergence is None or (estimate.convergence.trusted and is_whole):
        return estimate
    searched = _searched(log, params)
    is_trusted = searched.convergence is not None and searched.convergence.trusted
    if is_trusted and _cost_of(searched, fit) <= _cost_of(estimate, fit) + _COST_TOLERANCE:
        return searched
    return estimate


def _cost_of(estimate: Estimate, posed: Posed) -> float:
    """Compute the least cost near the likeliest solution of an estimate."""
    robust_sd = ROBUST_SD if posed.params.robust else None
    position = estimate.solutions[0].position / posed.log.dock_radius
    cost = posed.cost(posed.problem.rows, robust_sd=robust_sd)
    start = cost.at(set_apart(posed.problem, position), np.zeros(len(position)))
    _, linear = cost.refine(start, REFINEMENT.rounds)
    return linear.cost


def elsewhere(log: SensingLog, params: OnlineParams, position: Reals, sd: Reals) -> Bools:
    """Find robots that a search from no present estimate puts elsewhere, shape (N,).

    Args:
        log: What was sensed; the anchor is at the origin.
        params: Settings.
        position: Where robots are [R], shape (N, 3).
        sd: Standard deviation of each position [R], shape (N,).
    """
    allowed = np.maximum(CONVERGENCE.outlier_sd * sd, CANDIDATES.distinct)
    share = np.zeros(log.robot_count)
    for solution in _searched(log, params).solutions:
        away = np.linalg.norm(solution.position / log.dock_radius - position, axis=1)
        share += np.where(away > allowed, solution.weight, 0.0)
    return share > CANDIDATES.rival


def _searched(log: SensingLog, params: OnlineParams) -> Estimate:
    """Localize as `joint` does, whose chains know nothing of the present estimate."""
    names = [field.name for field in fields(ChiSquareParams)]
    cold = JointParams(**{name: getattr(params, name) for name in names})
    return methods.localize_batch([log], [cold])[0]


def fitted(log: SensingLog, params: OnlineParams, state: State, moves: Bools | None = None) -> Fit:
    """Anneal a structure from where it is, or the robots of it that move."""
    names = [*(field.name for field in fields(ChiSquareParams)), *_ANNEALER]
    warm = JointParams(**{name: getattr(params, name) for name in names})
    problem = pose_problem(log, warm)
    if moves is not None:
        problem = replace(problem, moves=moves)
    # All chains begin at one place; their kicks differ.
    start = np.tile(set_apart(problem, state.position), (warm.chains_for(log.robot_count), 1, 1))
    views = [view_of(log, warm, problem, start)]
    annealer = Annealer(views, seed=warm.seed, hold=warm.hold_steps, is_short=True)
    [chains] = annealer.run()
    return Fit.of(Posed(log, warm, problem), chains)


def localize(
    log: SensingLog, params: OnlineParams, on_progress: Callable[[float], None] = ignore
) -> Estimate:
    """Let the robots of a log join one after the other.

    Returns:
        The final answer of the tracker. An iteration of the trace is a number of joins. The
        residual is as for `joint`.

    Raises:
        InputError: orientations were chained by connections; robots share errors then.
    """
    if log.orientation_sd is not None and len(log.connections):
        shared = "robots share errors of orientations that were chained; choose method joint"
        raise InputError(shared, key="connections")
    header, robots = lines_of(log)
    tracker = Tracker(header, params)
    framed = np.unique(np.linspace(1, len(robots), _FRAMES).astype(np.int64))
    at_join = np.empty((len(robots), 3))
    frames = []
    for count, line in enumerate(robots, start=1):
        tracker.join(line)
        for robot in log.robot_id[log.gone[log.left_after == count]].tolist():
            tracker.leave(robot)
        at_join[count - 1] = tracker.positions[-1]
        if count in framed:
            frames.append(tracker.positions)
        on_progress(count / len(robots))
    estimate = tracker.estimate(final=True)
    trace = np.array([[*frame, *at_join[len(frame) :]] for frame in [*frames, estimate.position]])
    problem = pose_problem(log, params)
    gap = problem.residual(trace / log.dock_radius, np.zeros(trace.shape[:2]))
    last = len(robots) + 1  # the final answer comes after all joins
    return replace(
        estimate,
        at_join=at_join,
        iteration=np.append(framed, last),
        trace=trace,
        residual=rms(gap) * log.dock_radius,
    )


def follow(
    lines: Iterable[tuple[int, bytes]],
    name: Path,
    *,
    params: OnlineParams | None = None,
    on_answer: Callable[[str], object],
    on_refused: Callable[[str], None],
) -> Tracker:
    """Track the robots of a stream to its end.

    Args:
        lines: Lines with their numbers, the header first, as `log_lines` yields them.
        name: Name of the input in messages.
        params: Settings of `online`; its defaults if None.
        on_answer: Called with the answer of each line, a JSON object that ends in a newline, before
            the next line is read.
        on_refused: Called with the mistake of a line that is skipped, and where lines are missing
            at the end.

    Raises:
        InputError: the header is malformed, or the input cannot be read.
    """
    tracker: Tracker | None = None
    number = 0
    for number, raw in lines:
        if tracker is None:
            with at_line(name, number):
                tracker = Tracker(decode(raw, name, number), params)
            answer: dict[str, object] = {"line": number, "robots": 0}
        else:
            answer = _answered(tracker, number, raw.rstrip(b"\r\n"), name, on_refused)
        on_answer(f"{json.dumps(answer)}\n")
    if tracker is None:
        raise InputError("the input is empty; start it with a header line", path=name, line=1)
    try:
        with at_line(name, 1):
            tracker.header.require_lines(number - 1)
    except InputError as mistake:
        on_refused(str(mistake))
    return tracker


def _answered(
    tracker: Tracker, number: int, raw: bytes, name: Path, on_refused: Callable[[str], None]
) -> dict[str, object]:
    """Take a line, and say what changed; or say why the line is refused."""
    try:
        with at_line(name, number):
            change = tracker.take(decode(raw, name, number))
    except InputError as mistake:
        on_refused(f"{mistake}; skipped")
        return {"line": number, "refused": ": ".join(filter(None, (mistake.key, mistake.problem)))}
    return {"line": number, "robots": len(tracker.names), **_changed(change)}


def _changed(change: Change) -> dict[str, object]:
    """Write a change as JSON values; a robot that joined has null in place of a way."""
    columns = zip(
        change.robot.tolist(),
        change.position.tolist(),
        change.moved.tolist(),
        change.sd.tolist(),
        strict=True,
    )
    return {
        "annealed": change.annealed,
        "moved": [
            {
                "robot": robot,
                "position": [round(part, _DIGITS) for part in position],
                "moved": None if math.isnan(moved) else round(moved, _DIGITS),
                "sd": round(sd, _DIGITS),
            }
            for robot, position, moved, sd in columns
        ],
    }
