"""The cost of configurations, and steps to its minima: generalized nonlinear least squares.

`Cost` says when a step counts. `WholeCost`, of all unknowns of a log, solves sparse matrices;
`NearCost`, of some robots, all others as they are, sums dense ones in a kernel.

The cost of a configuration is its chi-square: squared residuals of all measurements in variances,
under a robust loss where asked for, squared overlaps of docks, and priors. Residuals are functions
of positions p, turns w by which each sensed orientation is wrong, yaw corrections b, and errors s
that all measurements of a source share. Levenberg-Marquardt steps on all of them are generalized
least squares: turns of final stances, which are in what other robots sensed too, are unknowns
beside p, b and s; turns of earlier stances make the covariance of what one robot sensed. Where
orientations were chained, their turns have no prior of their own: connections are rows, too.
Lengths in R.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.compute.normal_equations import Nearby
from tiswarm.localization.cost import OVERLAP_SD
from tiswarm.localization.cost.linear import NOMINAL, Linear, LinearRows
from tiswarm.localization.cost.walk_noise import WalkNoise, WalkRows
from tiswarm.measurements import equations
from tiswarm.measurements.contacts import close_docks, overlaps
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING, Measurements, are_known
from tiswarm.measurements.odometry import Connections
from tiswarm.records.sensing_log import SensingLog

HINGE_SD = 1.0
"""Standard deviation of the offset of two robots in contact along each axis, where only what their
docks can reach is known [R]."""

STRAIN_SD = 0.35
"""Standard deviation of the strain that the offsets of all robots in contact share [1]: how far
they extend is known of no structure that measurements leave open. Fitted on training logs."""

SETTLED = 0.01
"""Change of the cost below which rounds end [1]."""

_MARGIN = 1.0
"""Docks this much farther apart than D may come to overlap on the way [R]."""

_LONGEST_STEP = 0.5
"""Longest step of a robot in a round, in R and in the median of measured distances [1]."""

_LONGEST_TURN = 0.3
"""Longest turn in a round of a robot whose orientation is hardly known [rad]."""

_FALLING = 0.3
"""Share of the cost by which a round must lower it for more rounds than asked for [1]."""

_SMALLER = 0.4
"""Radius within which a step is trusted, relative to one that raised the cost [1]."""

_LEAST_RADIUS = 1e-4
"""Radius of trust below which no smaller step is tried [R]."""

_AXIS: Ints = np.arange(AXES)
"""Numbers of the coordinates of a vector among those of a robot."""
_NO_ROWS = LinearRows(*(np.empty(0, kind) for kind in (float, int, int, float, float)))
NOTHING: Reals = np.empty(0)
_NO_PAIRS: Ints = np.empty((0, 2), np.int64)


class State(NamedTuple):
    """All that residuals depend on; of some robots alone, only positions and turns."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    turn: Reals
    """Error of each final orientation beside yaw, as a rotation vector in standard deviations,
    shape (N, 3)."""

    earlier: Reals = NOTHING
    """Error of each orientation before the final ones, as a rotation vector in standard deviations,
    shape (M, 3)."""

    yaw: Reals = NOTHING
    """Yaw corrections [rad], shape (N,)."""

    shared: Reals = NOTHING
    """Error of each source of measurements, in standard deviations, shape (K,)."""


class Solvable(Protocol):
    """A cost near a state."""

    cost: float


L = TypeVar("L", bound=Solvable)


class Cost(ABC, Generic[L]):
    """A cost of configurations whose robots and errors are unknown, all or some."""

    most_rounds: int = 30
    """Rounds at most, where the cost still falls fast."""

    widest: float = np.inf
    """Radius within which a step is trusted at first [R]."""

    least_reduction: float = -np.inf
    """Reduction of the cost that the linear problem must predict for a step to be tried [1]."""

    @abstractmethod
    def linearized(self, state: State) -> L:
        """Linearize the cost at a state, which is where priors of positions are."""

    @abstractmethod
    def moved(self, state: State, linear: L, radius: float) -> tuple[State, float]:
        """Go to where the cost, linearized at a state, is least.

        Steps of robots much beyond a radius [R] are damped, and none is too long to be trusted.

        Returns:
            The state there, and the predicted reduction of the cost [1].
        """

    def refine(self, state: State, rounds: int | None = None) -> tuple[State, L]:
        """Take Levenberg-Marquardt steps to a minimum of the cost.

        Args:
            state: Where to begin.
            rounds: Rounds; more if the cost still falls fast. As many as there may be if None.

        Returns:
            The best state, and the cost linearized there.
        """
        linear = self.linearized(state)
        if rounds is None:
            rounds = self.most_rounds
        if not rounds:
            return state, linear
        radius = self.widest
        actual_reduction = np.inf
        for count in range(self.most_rounds):
            if count >= rounds and actual_reduction < _FALLING * linear.cost:
                break
            trial_state, predicted_reduction = self.moved(state, linear, radius)
            if predicted_reduction < self.least_reduction:
                break
            trial_linear = self.linearized(trial_state)
            # We accept a step by the sign of its actual reduction alone. Its ratio to the predicted
            # one, the usual step quality, says little here: a robust loss falls by less than the
            # squares that it is linearized to, and docks that come to overlap on the way raise the
            # cost by terms that the linear problem does not have. A rise below `SETTLED` is one of
            # rounding, or of these terms, near the minimum; a step that rises more led uphill, and
            # the linear problem is trusted in a smaller region.
            if trial_linear.cost > linear.cost + SETTLED:
                longest = np.linalg.norm(trial_state.position - state.position, axis=1).max()
                radius = _SMALLER * min(radius, float(longest))
                if radius < _LEAST_RADIUS:
                    break
                continue
            actual_reduction = linear.cost - trial_linear.cost
            state = trial_state
            linear = trial_linear
            radius = min(radius / _SMALLER, self.widest)
            if actual_reduction < SETTLED:
                break
        return state, linear


def shortened(step: Reals, most: float, length: Reals | None = None) -> Reals:
    """Shorten steps (n, 3) whose lengths (n,), if not their own, are beyond the most."""
    far = np.linalg.norm(step, axis=1) if length is None else length
    short: Reals = step * (most / np.maximum(far, most))[:, None]
    return short


def boltzmann_weights(cost: Reals, temperature: float = 1.0) -> Reals:
    """Weigh configurations by their Boltzmann factors, exp(-cost / (2 T)).

    Args:
        cost: Their costs [1], shape (k,).
        temperature: T, by which costs are divided [1].

    Returns:
        Weights that add up to 1, shape (k,).
    """
    weight = np.exp(-0.5 * (cost - cost.min()) / temperature)
    total: Reals = weight / weight.sum()
    return total


def moments(weight: Reals, position: Reals) -> tuple[Reals, Reals]:
    """Compute the mean of weighted configurations, and their mean square distance from it.

    Args:
        weight: Weights that add up to 1, shape (k,).
        position: Centers [R], shape (k, ..., 3).

    Returns:
        The mean [R], shape (..., 3), and the squares [R^2], shape (...).
    """
    mean: Reals = np.asarray(np.tensordot(weight, position, 1), np.float64)
    square: Reals = weight @ ((position - mean) ** 2).sum(axis=-1)
    return mean, square


def grouped(order: Ints, agrees: Callable[[int, list[int]], Bools]) -> list[list[int]]:
    """Group items, each with the first one before it that it is like.

    Args:
        order: Items, shape (k,).
        agrees: Judges which of the first items of groups an item is like.

    Returns:
        Items of each group, in this order.
    """
    groups: list[list[int]] = []
    for item in order.tolist():
        same = np.flatnonzero(agrees(item, [group[0] for group in groups]))
        if len(same):
            groups[same[0]].append(item)
        else:
            groups.append([item])
    return groups


class WholeCost(Cost[Linear]):
    """The cost of configurations of N robots with E measurements of K sources.

    Unknowns are shifts (3 N), turns of final stances (3 N), yaw (N), and errors of sources (K),
    U in all. Those that nothing moves are left out of matrices; F are free.
    """

    def __init__(
        self,
        log: SensingLog,
        rows: Measurements,
        *,
        yaw_precision: float = 0.0,
        links: Connections | None = None,
        robust_sd: float | None = None,
        non_overlap: bool = True,
        are_independent: bool = False,
        further_variance: Reals | float = 0.0,
        hinged: Ints = _NO_PAIRS,
        moves: Bools | None = None,
        nearby: Nearby | None = None,
    ) -> None:
        """Gather what does not change with the state.

        Args:
            log: What was sensed.
            rows: Measurements whose docks are known.
            yaw_precision: Precision of a bias of yaw that is solved for [rad^-2], 0 if none is.
            links: What the orientations were chained by.
            robust_sd: Width of Cauchy's loss in standard deviations; squares count if None.
            non_overlap: Whether docks that do not touch must not overlap.
            are_independent: Whether errors of orientations count as noise of each row, as the
                annealer takes them, which is quicker.
            further_variance: Variance of rows but known ones beside their noise [R^2], (E,).
            hinged: Pairs of robots whose offset is known to `HINGE_SD` as well, shape (n, 2).
            moves: Robots that move; all others are constants, and rows of robots without a row
                about one that moves do not count. All if None, shape (N,).
            nearby: Factors of like costs, by which this one is solved; of itself alone if None.
        """
        self.nearby = nearby or Nearby()
        self.robust_sd = robust_sd
        self.non_overlap = non_overlap
        self.hinged = hinged
        self.moving = np.ones(rows.robots, np.bool_) if moves is None else moves
        of_moving = np.bincount(
            rows.robot[: len(rows.neighbor)], self.moving[rows.neighbor], rows.robots
        )
        rows = rows.select((self.moving | (of_moving > 0.0))[rows.robot])
        self.log = log
        self.rows = rows
        self.walks = rows.odometry
        self.links = links
        variance = rows.variance()
        self.is_known = are_known(variance, len(rows.neighbor))
        further_variance = np.where(self.is_known, 0.0, further_variance)
        # Beside a large error of a source, a small one of the row's own is lost to rounding.
        unshared = np.maximum(variance - rows.shared_variance, rows.own_variance)
        self.further_variance = further_variance
        self.variance = unshared + further_variance
        self.own_variance = self.variance
        if not are_independent:
            self.own_variance = rows.own_variance + further_variance
        # Each arm has one part that a final orientation turns: the last one, that of its own stance
        # where this is the final one.
        self.owner = np.concatenate([rows.robot, rows.neighbor])
        self.row = np.concatenate([np.arange(len(rows)), np.arange(len(rows.neighbor))])
        self.stance = rows.stance
        self.is_walked = rows.is_walked
        self.part = rows.first_parts()
        self.is_earlier = self.walks.is_earlier
        self._turn_sd = self.walks.axis_sd
        is_noisy: Bools = self._turn_sd.max(axis=1) > 0.0
        if are_independent:
            is_noisy = np.zeros_like(is_noisy)
        self.of_final = np.flatnonzero(is_noisy[self.walks.final[self.owner]])
        related = np.flatnonzero(self.is_walked & is_noisy[self.stance])
        self._related = WalkRows(related, rows.robot, self.stance, self.walks)
        self._no_noise = WalkNoise.none(self._related)
        self.reach = float(np.median(rows.distances.length)) if len(rows.distances.length) else 1.0
        self._listed: Reals = np.full_like(self.walks.arm[self.walks.final], np.inf)
        self._docks: Ints = np.empty((0, 4), np.int64)
        self.resensed: Reals | float = 0.0
        """What is added to each residual, so that rows measure something else [R], shape (E,)."""
        size = (rows.robots, 3)
        self.prior_mean = State(
            np.zeros(size),
            np.zeros(size),
            np.zeros((int(self.is_earlier.sum()), 3)),
            np.zeros(rows.robots),
            np.zeros(len(rows.shared_sd)),
        )
        """Means of the priors of all unknowns; that of positions is where each round begins."""
        self._number_unknowns(yaw_precision)

    def _number_unknowns(self, yaw_precision: float) -> None:
        """Set priors of all unknowns, columns of free ones, and places of derivatives."""
        rows = self.rows
        robots = self.rows.robots
        turns = np.zeros(3 * robots)
        turns[(3 * self.owner[self.of_final, None] + _AXIS).ravel()] = 1.0
        if self.links is not None:
            turns[np.repeat(self.links.is_chained, 3)] *= NOMINAL
        sources = np.bincount(rows.source[rows.source >= 0], minlength=len(rows.shared_sd)) > 0
        yaws = np.full(robots, yaw_precision)
        self.precision = np.concatenate([0.0 * turns, turns, yaws, sources.astype(np.float64)])
        """Precision of the prior of each unknown, shape (U,)."""
        is_free = self.precision > 0.0
        # Shifts have no prior of their own, and are free all the same.
        is_free[3 : 3 * robots] = True  # the anchor stays
        is_free[: 6 * robots] &= np.tile(np.repeat(self.moving, 3), 2)
        is_free[6 * robots : 7 * robots] &= self.moving
        self.free = np.flatnonzero(is_free)
        self.column = np.where(is_free, np.cumsum(is_free) - 1, -1)
        self.has_turns = bool(len(self.of_final) or len(self._related.rows) or yaw_precision)
        every = np.arange(len(rows))
        pairs = np.arange(len(rows.neighbor))
        with_source = np.flatnonzero(rows.source >= 0)
        final = self.of_final
        self.of_yaw = np.arange(len(self.row) if yaw_precision else 0)
        self.of_axis = np.arange(len(rows.distances.stance), len(rows.neighbor))[
            : None if yaw_precision else 0
        ]
        place = [
            (every, 3 * rows.robot[:, None] + _AXIS),
            (pairs, 3 * rows.neighbor[:, None] + _AXIS),
            (self.row[final], 3 * (robots + self.owner[final, None]) + _AXIS),
            (self.row[self.of_yaw], 6 * robots + self.owner[self.of_yaw, None]),
            (self.of_axis, 6 * robots + rows.robot[self.of_axis, None]),
            (with_source, 7 * robots + rows.source[with_source, None]),
        ]
        row = np.concatenate([np.repeat(row, c.shape[1]) for row, c in place])
        column = self.column[np.concatenate([unknown.ravel() for _, unknown in place])]
        self.moves = np.flatnonzero(column >= 0)
        self.row_of = row[self.moves]
        self.column_of = column[self.moves]
        self.of_source = rows.shared_sd[rows.source[with_source]]

    def held(self, prior: Reals) -> "WholeCost":
        """Add a prior of positions around where each round begins.

        It bounds variances and steps, and does not move the minimum.

        Args:
            prior: Its width [R], shape (N,).
        """
        cost = copy(self)
        cost.precision = self.precision.copy()
        cost.precision[: 3 * len(prior)] = np.repeat(prior**-2, 3)
        return cost

    def simulated(self, truth: State, number: int) -> "WholeCost":
        """Draw what would have been sensed if a state were true: all errors are new, as stated.

        The structure and its docks stay as the state has them, so that they overlap no more than
        there: sensed orientations change, and with them the means of the priors of turns.

        Args:
            truth: The state, which is not changed.
            number: Which of many independent draws.
        """

        def drawn(what: str, shape: tuple[int, ...]) -> Reals:
            every = np.arange(int(np.prod(shape)))
            return normal(number, f"simulated {what}", every, 0).reshape(shape)

        robots = self.rows.robots
        cost = copy(self)
        has_prior = self.precision[3 * robots : 6 * robots].reshape(-1, 3) > NOMINAL
        yaw_precision = self.precision[6 * robots : 7 * robots]
        yaw_sd = np.zeros(robots)
        np.divide(1.0, np.sqrt(yaw_precision), out=yaw_sd, where=yaw_precision > 0.0)
        cost.prior_mean = State(
            np.zeros_like(truth.position),
            np.where(has_prior, truth.turn - drawn("turns", truth.turn.shape), 0.0),
            truth.earlier - drawn("earlier turns", truth.earlier.shape),
            truth.yaw - yaw_sd * drawn("yaws", truth.yaw.shape),
            truth.shared - drawn("sources", truth.shared.shape),
        )
        if self.links is not None:
            turn = truth.turn * self._turn_sd[self.walks.final]
            exact = turn[self.links.robot] - turn[self.links.neighbor]
            error = self.links.sd * drawn("connections", exact.shape)
            cost.links = self.links._replace(residual=exact + error)
        own_sd = np.sqrt(np.maximum(self.own_variance - self.further_variance, 0.0))
        cost.resensed = 0.0
        linear = cost.linearized(truth)
        exact_residual = linear.residual[: len(self.rows)]
        away = truth.earlier - cost.prior_mean.earlier
        exact_residual[self._related.rows] += linear.noise.errors(away[:, :, None])[:, 0]
        cost.resensed = own_sd * drawn("rows", (len(self.rows),)) - exact_residual
        return cost

    def at(self, position: Reals, yaw: Reals, *turns: Reals) -> State:
        """Return a state; errors are 0, but for turns of final and of earlier stances if given."""
        size = len(position), int(self.is_earlier.sum())
        every: list[Reals] = [*turns, *(np.zeros((n, 3)) for n in size[len(turns) :])]
        return State(position, every[0], every[1], yaw, np.zeros(len(self.rows.shared_sd)))

    def _close_docks(self, point: Reals) -> Ints:
        """List docks at points (N, docks, 3) that do not touch, with all that overlap, (n, 4).

        A list serves until docks have moved half the margin: then others may overlap.
        """
        far = np.linalg.norm(point - self._listed, axis=2).max(initial=0.0)
        if self.non_overlap and far > 0.5 * _MARGIN:
            docks = close_docks(self.log, point, SPACING + _MARGIN)
            self._listed = point
            self._docks = docks[self.moving[docks[:, [0, 2]]].any(axis=1)]
        return self._docks

    def linearized(self, state: State) -> Linear:
        """Linearize the cost at a state, which is where priors of positions are."""
        rows, part, reached = self._turned(state)
        residual, direction = rows.linearized(state.position)
        noise = self._no_noise
        final = np.empty((0, 3))
        yaw: Reals = np.empty(0)
        turning: Reals = np.empty(0)
        if self.has_turns:
            last = np.where(self.is_walked[:, None], reached[self.walks.final[rows.robot]], part)
            sd = self._turn_sd[self.walks.final[self.owner[self.of_final]]]
            ends = np.concatenate([last, -rows.neighbor_arm])[self.of_final]
            final = _by_turns(direction[self.row[self.of_final]], ends) * sd
        if len(self.of_yaw):
            arms = np.concatenate([rows.arm, -rows.neighbor_arm])
            yaw = -_by_turns(direction[self.row], arms)[:, 2]
        if len(self._related.rows):
            noise = self._noise(direction, part, reached)
            away = state.earlier - self.prior_mean.earlier
            residual[self._related.rows] -= noise.errors(away[:, :, None])[:, 0]
        if len(self.of_axis):  # the axes of offsets turn with the robot, too
            apart = rows.vectors(state.position)[self.of_axis]
            turning = _by_turns(direction[self.of_axis], apart)[:, 2]
        values = [
            direction, -direction[: len(self.rows.neighbor)], final, yaw, turning, self.of_source
        ]  # fmt: skip
        if len(self.of_source):
            residual += np.append(self.rows.shared_sd * state.shared, 0.0)[self.rows.source]
        residual += self.resensed
        own_variance, excess = self._robust(residual)
        value = np.concatenate([values_of.ravel() for values_of in values])[self.moves]
        tables = [
            LinearRows(residual, self.row_of, self.column_of, value, own_variance),
            self._overlaps(state),
        ]
        if self.links is not None:
            tables.append(self._links_of(state, self.links))
        if len(self.hinged):
            tables.append(self._hinges(self.hinged))
        mean = self.prior_mean
        off = (
            np.zeros_like(state.position),
            state.turn - mean.turn,
            state.yaw - mean.yaw,
            state.shared - mean.shared,
        )
        return Linear(
            tables=tables,
            noise=noise,
            column=self.column,
            precision=self.precision[self.free],
            off=np.concatenate([part.ravel() for part in off])[self.free],
            excess=excess,
            moves=self.moving & (np.arange(self.rows.robots) > 0),
            nearby=self.nearby,
        )

    def _noise(self, direction: Reals, part: Reals, reached: Reals) -> WalkNoise:
        """Derive rows of earlier stances by turns of these.

        Args:
            direction: Derivative of each row by the center of its robot, shape (E, 3).
            part: Part of its arm that its own stance turns [R], shape (E, 3).
            reached: From the dock held by at each stance to the one that it was reached on [R],
                shape (S, 3).
        """
        rows = self._related.rows
        turn = _by_turns(direction[rows], part[rows]) * self._turn_sd[self.stance[rows]]
        along = (np.broadcast_to(axis, reached.shape) for axis in np.eye(AXES))
        shift = np.stack([_by_turns(axis, reached) * self._turn_sd for axis in along], axis=1)
        shift[self.walks.final] = 0.0
        return WalkNoise(self._related, direction[rows], turn, shift)

    def _turned(self, state: State) -> tuple[Measurements, Reals, Reals]:
        """Turn all arms as a state says.

        Returns:
            Rows with these arms, the part of each arm that its own stance turns [R], shape (E, 3),
            and vectors `reached` of all stances [R], shape (S, 3).
        """
        walks = self.walks
        if not self.has_turns:
            return self.rows, self.part, walks.reached
        turn = np.empty((len(self.is_earlier), 3))
        turn[walks.final] = state.turn
        turn[self.is_earlier] = state.earlier
        turning = Rotation.from_rotvec(-turn * self._turn_sd)
        if state.yaw.any():
            yaw = np.array([0.0, 0.0, 1.0]) * state.yaw[walks.owner, None]
            turning *= Rotation.from_rotvec(yaw)
        reached = turning.apply(walks.reached)
        part = turning[self.stance].apply(self.part)
        neighbor_arm = turning[walks.final[self.rows.neighbor]].apply(self.rows.neighbor_arm)
        rows = replace(
            self.rows,
            offsets=self.rows.offsets._replace(axis=self.rows.axes(state.yaw)),
            arm=part + walks.sums_of_later(reached)[self.stance],
            neighbor_arm=neighbor_arm,
        )
        return rows, part, reached

    def _robust(self, residual: Reals) -> tuple[Reals, Reals]:
        """Widen what is missed by far, so that squares have the slope of Cauchy's loss.

        Returns:
            Own variance of each measurement [R^2], and the loss beyond these squares, (E,) both.
        """
        if self.robust_sd is None:
            return self.own_variance, np.zeros(len(residual))
        # Iteratively reweighted least squares: with its variance multiplied by 1 + t, a square has
        # the slope of the loss at this residual, and so the linear problem leads to a minimum of
        # the loss. The square itself is smaller than the loss; the rest is a constant of the step.
        square = self.robust_sd**2
        missed = self._missed(residual, square)
        excess = equations.loss_beyond(missed, np.log1p(missed), square)
        offset = self.rows.vector_rows
        excess[offset] /= 3.0
        return self.own_variance + self.variance * missed, excess

    def losses(self, residual: Reals) -> Reals:
        """Compute the loss of each measurement [1], that of a vector in each of its rows.

        Args:
            residual: Residuals [R], shape (E,).
        """
        if self.robust_sd is None:
            return self._missed(residual, 1.0)
        square = self.robust_sd**2
        return np.asarray(square * np.log1p(self._missed(residual, square)))

    def _missed(self, residual: Reals, square: float) -> Reals:
        """Divide squared residuals by a square of variances, 0 of what is known, shape (E,)."""
        missed: Reals = residual**2 / (square * self.variance)
        missed[self.is_known] = 0.0
        # The three rows of a vector give way together: they are one measurement.
        offset = self.rows.vector_rows
        missed[offset] = np.repeat(missed[offset].reshape(-1, 3).sum(axis=1), 3)
        return missed

    def _docks_at(self, state: State) -> Reals:
        """Arms of all docks at the end [R], shape (N, docks, 3)."""
        arm = self.rows.docks(state.yaw if state.yaw.any() else None)
        if len(self.of_final):
            turn = -state.turn * self._turn_sd[self.walks.final]
            every = np.repeat(turn, arm.shape[1], axis=0)
            arm = Rotation.from_rotvec(every).apply(arm.reshape(-1, 3)).reshape(arm.shape)
        return arm

    def _overlaps(self, state: State) -> LinearRows:
        """Compute the overlaps of docks that do not touch, and their derivatives."""
        arm = self._docks_at(state)
        point = state.position[:, None] + arm
        docks, depth, direction = overlaps(point, self._close_docks(point))
        if not len(docks):
            return _NO_ROWS
        later, later_dock, earlier, earlier_dock = docks.T
        robot = np.concatenate([later, earlier])
        pull = np.concatenate([direction, -direction])
        arms = np.concatenate([arm[later, later_dock], arm[earlier, earlier_dock]])
        across = _by_turns(pull, arms)
        turn = across * self._turn_sd[self.walks.final][robot]
        robots = self.rows.robots
        column = np.concatenate(
            [
                3 * robot[:, None] + _AXIS,
                3 * (robots + robot[:, None]) + _AXIS,
                6 * robots + robot[:, None],
            ],
            axis=1,
        )
        return self._rows_of(
            -depth,
            np.repeat(np.tile(np.arange(len(docks)), 2), column.shape[1]),
            column.ravel(),
            np.concatenate([pull, turn, -across[:, 2:]], axis=1).ravel(),
            np.full(len(docks), OVERLAP_SD**2),
        )

    def _links_of(self, state: State, links: Connections) -> LinearRows:
        """Compute residuals of connections [rad], and their derivatives by turns of final stances.

        Args:
            state: Where to linearize.
            links: Connections, Q of them, with three rows each.
        """
        sd = self._turn_sd[self.walks.final]
        turn = state.turn * sd
        ends = np.stack([links.robot, links.neighbor])
        residual = links.residual - turn[links.robot] + turn[links.neighbor]
        slope = np.stack([-sd[links.robot], sd[links.neighbor]])
        return self._differences(residual, self.rows.robots + ends, slope, links.sd)

    def _hinges(self, pair: Ints) -> LinearRows:
        """Hold the offsets of pairs of robots where they are, along each axis."""
        slope = np.broadcast_to([[[1.0]], [[-1.0]]], (2, len(pair), 3))
        return self._differences(np.zeros((len(pair), 3)), pair.T, slope, HINGE_SD)

    def _differences(self, residual: Reals, ends: Ints, slope: Reals, sd: float) -> LinearRows:
        """Make rows about two triples of unknowns each, given by their numbers (2, n)."""
        column = 3 * ends[:, :, None] + _AXIS
        row = np.tile(np.arange(residual.size), 2)
        variance = np.full(residual.size, sd**2)
        return self._rows_of(residual.ravel(), row, column.ravel(), slope.ravel(), variance)

    def _rows_of(
        self, residual: Reals, row: Ints, unknown: Ints, value: Reals, variance: Reals
    ) -> LinearRows:
        """Leave out derivatives by unknowns that stay, such as the anchor's place."""
        column = self.column[unknown]
        moves = column >= 0
        return LinearRows(residual, row[moves], column[moves], value[moves], variance)

    def open_variance(self, position: Reals, yaw: Reals, *, part: float = 1.0) -> Reals:
        """Compute the mean square error of positions where robots in contact are hinges, (N,).

        Args:
            position: Centers [R], shape (N, 3).
            yaw: Yaw corrections [rad], shape (N,).
            part: Part that counts of what hinges leave open each by itself [1].
        """
        linear = self.linearized(self.at(position, yaw))
        one, two = self.hinged.T
        strained = linear.shifts_by(STRAIN_SD * (position[one] - position[two]).ravel())
        return np.asarray(part * linear.variance() + (strained**2).sum(axis=1))

    def moved(self, state: State, linear: Linear, radius: float) -> tuple[State, float]:
        """Go to where the cost, linearized at a state, is least: one step of all unknowns.

        Returns:
            The state there, and the predicted reduction of the cost [1].
        """
        free, earlier = linear.step(radius)
        step = np.zeros(len(self.precision))
        step[self.free] = free
        count = state.position.size
        shift, turn, yaw, shared = np.split(step, [count, 2 * count, 2 * count + count // 3])
        turn = turn.reshape(-1, 3)
        wide = self.walks.wide
        # Residuals are linear in turns only while these are small. The prior of an orientation that
        # is hardly known does not keep them small, and a full step could lead to the minimum of
        # another orientation: such turns are shortened, and the next rounds go on from there.
        angle = np.linalg.norm(turn[wide] * self.walks.turn_sd[self.walks.final[wide], :1], axis=1)
        turn[wide] = shortened(turn[wide], min(radius, _LONGEST_TURN), angle)
        shift = shortened(shift.reshape(-1, 3), _LONGEST_STEP * max(1.0, self.reach))
        moved = State(
            state.position + shift,
            state.turn + turn,
            self.prior_mean.earlier + earlier.reshape(-1, 3),
            state.yaw + yaw,
            state.shared + shared,
        )
        # The cost falls by g^T H^-1 g up to its quadratic minimum, with slope g and information H.
        return moved, float(-linear.slope @ free)


def _by_turns(direction: Reals, arm: Reals) -> Reals:
    """Compute derivatives by turns that undo those of arms (n, 3), shape (n, 3)."""
    parts = map(equations.components, (direction, arm))
    return np.stack(equations.slope_by_turn(*parts), axis=-1)
