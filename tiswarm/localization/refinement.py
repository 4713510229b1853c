"""The least cost of all measurements near given positions: generalized nonlinear least squares.

The cost of a configuration is its chi-square: squared residuals of all measurements in variances,
under a robust loss where asked for, squared overlaps of docks, and priors. Residuals are functions
of positions p, yaw corrections b, and turns w, by which each sensed orientation is wrong.
Levenberg-Marquardt steps on all of them are generalized least squares: turns of final stances,
which are in what other robots sensed too, are unknowns beside p and b; turns of earlier stances
make the covariance of what one robot sensed. Where orientations were chained, their turns have no
prior of their own: connections are measurements, too. Lengths in R.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, hstack
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

from tiswarm.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.measurements.contacts import close_docks
from tiswarm.measurements.model import Measurements, turned
from tiswarm.measurements.orientations import Connections
from tiswarm.measurements.rows import SPACING
from tiswarm.records.sensing_log import SensingLog

OVERLAP_SD = 0.05
"""Overlap of two docks that counts like a measurement missed by one standard deviation [R]."""

SETTLED = 0.01
"""Change of the cost below which rounds end [1]."""

_MARGIN = 1.0
"""Docks this much farther apart than D may come to overlap on the way [R]."""

_UNKNOWN = 1e-6
"""Precision of a turn that connections alone constrain, in its own standard deviations."""

_DRAWS = 64
"""Draws of all errors from which the variance of the result is computed."""

_LONGEST_STEP = 0.5
"""Longest step of a robot in a round [R]."""

_SMALLER, _LEAST_RADIUS = 0.4, 1e-4
"""Radius within which a step is trusted, relative to one that raised the cost [1], and the least
radius [R]."""

_FLOPPY = 1e-9
"""Information, relative to the largest one, below which nothing determines a motion."""

_LEAST_DAMPING = 1e-12
"""Precision, relative to the largest one, that stops motions that no measurement resists."""


class State(NamedTuple):
    """All that residuals depend on."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (N,)."""

    turn: Reals
    """Error of each sensed orientation beside that, as a rotation vector in standard deviations,
    shape (S, 3)."""


class Cost:
    """The cost of configurations of N robots with E measurements."""

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
                annealer takes them: quicker, and all that serves where yaw biases are noise.
            further_variance: Variance of rows beside their noise [R^2], shape (E,).
        """
        self.log, self.rows, self.walks, self.links = log, rows, rows.odometry, links
        self.robust_sd, self.non_overlap = robust_sd, non_overlap
        self.variance = rows.variance() + further_variance
        self.own_variance = (
            self.variance if are_independent else rows.own_variance + further_variance
        )
        own, its = rows.noisy_arms()
        self.is_own = np.repeat([True, False], [len(own[0]), len(its[0])])
        self.row, self.stance = (np.concatenate([own[k], its[k]]) for k in (0, 1))
        self.arm = np.concatenate([own[2], its[2]])
        self.sd = self.walks.turn_sd[:, [0, 0, 1]][self.stance]
        self.owner = self.walks.owner[self.stance]
        self.is_earlier = ~np.isin(np.arange(len(self.walks.owner)), self.walks.final)
        is_noisy = self.sd.any(axis=1) & (not are_independent)
        is_earlier = self.is_earlier[self.stance]
        self.of_final = np.flatnonzero(is_noisy & ~is_earlier)
        self.of_earlier = np.flatnonzero(is_noisy & is_earlier)
        self.earlier = np.cumsum(self.is_earlier)[self.stance[self.of_earlier]] - 1
        robots, turns = rows.robots, np.ones(3 * rows.robots)
        if links is not None:
            turns[np.repeat(links.is_chained, 3)] = _UNKNOWN
        turns *= bool(len(self.of_final))
        self.precision = np.concatenate(
            [np.zeros(3 * robots), turns, np.full(robots, yaw_precision)]
        )
        """Precision of the prior of each shift, turn and yaw."""
        self.turns = self.precision[3 * robots :]
        self.docks = np.empty((0, 4), np.int64)

    def refine(
        self, start: tuple[Reals, Reals], rounds: int, prior: Reals | None = None
    ) -> tuple[State, "Linear"]:
        """Take Levenberg-Marquardt steps to a minimum of the cost.

        Args:
            start: Positions [R], shape (N, 3), and yaw corrections [rad], shape (N,).
            rounds: Rounds at most.
            prior: Width of a prior around the start [R], shape (N,); none if None.

        Returns:
            The best state, and the cost linearized there.
        """
        begin = state = State(*start, np.zeros((len(self.is_earlier), 3)))
        precision = self.precision.copy()
        if prior is not None:
            precision[: 3 * len(prior)] = np.repeat(prior**-2, 3)
        if self.non_overlap:
            point = state.position[:, None] + self._docks_at(state.yaw)
            self.docks = close_docks(self.log, point, SPACING + _MARGIN)
        linear = self.linearized(state, begin, precision)
        radius = np.inf
        for _ in range(rounds):
            trial = self._moved(state, linear, radius)
            there = self.linearized(trial, begin, precision)
            if there.cost > linear.cost + SETTLED:
                far = np.linalg.norm(trial.position - state.position, axis=1).max()
                radius = _SMALLER * min(radius, float(far))
                if radius < _LEAST_RADIUS:
                    break
                continue
            gain = linear.cost - there.cost
            state, linear, radius = trial, there, radius / _SMALLER
            if gain < SETTLED:
                break
        return state, linear

    def linearized(self, state: State, begin: State, precision: Reals) -> "Linear":
        """Linearize at a state; priors of that precision (7 N,) are around the start."""
        robots, size = self.rows.robots, len(self.rows)
        rows, arm = self._turned(state)
        final, noise = csc_array((size, 3 * robots)), csc_array((size, 3 * self.is_earlier.sum()))
        yaws = csc_array((size, robots))
        if self.turns.any():
            direction = rows.directions(state.position)[self.row]
            across = np.cross(direction, np.where(self.is_own[:, None], arm, -arm))
            final, noise = (
                _by_group((across * self.sd)[part], self.row[part], group, (size, groups))
                for part, group, groups in (
                    (self.of_final, self.owner[self.of_final], robots),
                    (self.of_earlier, self.earlier, int(self.is_earlier.sum())),
                )
            )
            yaws = _by_group(-across[:, 2:], self.row, self.owner, (size, robots))
        shifts = rows.jacobian(state.position)[:, : 3 * robots]
        residual = rows.residual(state.position) - noise @ state.turn[self.is_earlier].ravel()
        own_variance, excess = self._robust(residual)
        further = [self._overlaps(state)]
        if self.links is not None:
            further.append(self._links_of(state, self.links))
        off = [state.position - begin.position, state.turn[self.walks.final], state.yaw]
        return Linear(
            residual=residual,
            jacobian=csr_array(hstack([shifts, final, yaws])),
            noise=noise,
            own_variance=own_variance,
            robot=rows.robot,
            further=further,
            precision=precision,
            off=np.concatenate([part.ravel() for part in off]),
            excess=excess,
        )

    def _turned(self, state: State) -> tuple[Measurements, Reals]:
        """Turn the arms of all measurements as a state says; also the parts of these arms."""
        if not self.turns.any():
            return self.rows, self.arm
        yaw = np.array([0.0, 0.0, 1.0]) * state.yaw[self.owner, None]
        arm = self.arm
        if state.yaw.any():
            arm = Rotation.from_rotvec(yaw).apply(arm)
        if state.turn.any():
            arm = Rotation.from_rotvec(-state.turn[self.stance] * self.sd).apply(arm)
        offsets, size = self.rows.offsets, len(self.rows)
        axis = turned(offsets.axis, state.yaw[self.walks.owner[offsets.stance]])
        rows = replace(
            self.rows,
            offsets=offsets._replace(axis=axis),
            arm=self._summed(arm, self.is_own, size),
            other_arm=self._summed(arm, ~self.is_own, len(self.rows.other)),
        )
        return rows, arm

    def _summed(self, arm: Reals, chosen: Bools, size: int) -> Reals:
        """Sum the parts of each arm, shape (size, 3)."""
        return np.column_stack([np.bincount(self.row[chosen], a, size) for a in arm[chosen].T])

    def _robust(self, residual: Reals) -> tuple[Reals, Reals]:
        """Widen what is missed by far, so that squares have the slope of Cauchy's loss.

        With t = e^2 / (c^2 v), that loss is c^2 log(1 + t), and has the slope of e^2 / v (1 + t).

        Returns:
            Own variance of each measurement [R^2], and the loss beyond these squares, (E,) both.
        """
        if self.robust_sd is None:
            return self.own_variance, np.zeros(len(residual))
        square = self.robust_sd**2
        missed = residual**2 / (square * self.variance)
        offset = slice(len(self.rows.distances.stance), len(self.rows.other))
        together = missed[offset].reshape(-1, 3).sum(axis=1)
        missed[offset] = np.repeat(together, 3)
        excess = square * (np.log1p(missed) - missed / (1.0 + missed))
        excess[offset] /= 3.0
        return self.own_variance + self.variance * missed, excess

    def _docks_at(self, yaw: Reals) -> Reals:
        """Arms of all docks at the end [R], shape (N, docks, 3)."""
        arm = self.walks.arm[self.walks.final]
        return turned(arm.reshape(-1, 3), np.repeat(yaw, arm.shape[1])).reshape(arm.shape)

    def _overlaps(self, state: State) -> "_Further":
        """Compute the overlaps of docks that do not touch, and their derivatives by shifts."""
        later, own, earlier, its = self.docks.T
        arm = self._docks_at(state.yaw)
        apart = state.position[later] + arm[later, own]
        apart -= state.position[earlier] + arm[earlier, its]
        length = np.linalg.norm(apart, axis=1)
        chosen = np.flatnonzero((length < SPACING) & (length > 0.0))
        way = apart[chosen] / length[chosen, None]
        rows, shape = np.arange(len(chosen)), (len(chosen), len(state.position))
        toward = _by_group(way, rows, later[chosen], shape)
        back = _by_group(way, rows, earlier[chosen], shape)
        return _Further(length[chosen] - SPACING, csc_array(toward - back), 0, OVERLAP_SD)

    def _links_of(self, state: State, links: Connections) -> "_Further":
        """Compute residuals of connections [rad], and their derivatives by turns."""
        sd = self.walks.turn_sd[self.walks.final][:, [0, 0, 1]]
        turn = state.turn[self.walks.final] * sd
        left = links.residual - turn[links.robot] + turn[links.other]
        axis, count = np.arange(3), 3 * len(links.robot)
        row = np.tile(np.arange(count), 2)
        ends = np.concatenate([links.robot, links.other])
        sign = np.repeat([-1.0, 1.0], count)
        column = (3 * ends[:, None] + axis).ravel()
        by_turn = csc_array((sign * sd[ends].ravel(), (row, column)), shape=(count, sd.size))
        return _Further(left.ravel(), by_turn, sd.size, links.sd)

    def _moved(self, state: State, linear: "Linear", radius: float) -> State:
        """Go from a state to where the sum of squares, linearized there, is least."""
        step, earlier = linear.step(radius)
        turn = state.turn.copy()
        turn[self.is_earlier] = earlier.reshape(-1, 3)
        shift, final, yaw = np.split(step, [state.position.size, 2 * state.position.size])
        turn[self.walks.final] += final.reshape(-1, 3)
        shift = shift.reshape(-1, 3)
        far = np.linalg.norm(shift, axis=1, keepdims=True)
        shift *= np.minimum(1.0, _LONGEST_STEP / np.maximum(far, _LONGEST_STEP))
        return State(state.position + shift, state.yaw + yaw, turn)


class _Further(NamedTuple):
    """Rows beside the measurements, each with noise of its own."""

    residual: Reals
    """Residuals, shape (n,)."""

    jacobian: csc_array
    """Derivatives by some unknowns in a row, shape (n, k)."""

    first: int
    """First of these unknowns."""

    sd: float
    """Standard deviation of each residual."""


class Linear:
    """Residuals e + J d + B w + n with unknowns d, turns w of earlier stances, and own noise n."""

    def __init__(
        self,
        *,
        residual: Reals,
        jacobian: csr_array,
        noise: csc_array,
        own_variance: Reals,
        robot: Ints,
        further: list[_Further],
        precision: Reals,
        off: Reals,
        excess: Reals,
    ) -> None:
        """Compute the cost and its derivatives.

        Args:
            residual: e, shape (E,).
            jacobian: J, by shifts (3 N), turns of final stances (3 N) and yaw (N), (E, 7 N).
            noise: B, shape (E, M).
            own_variance: Of n, shape (E,).
            robot: Robot that sensed each row, whose noise all of its rows share, shape (E,).
            further: Rows beside these.
            precision: One over the variance of the prior of each unknown, shape (7 N,).
            off: How far unknowns are from where their priors put them, shape (7 N,).
            excess: Loss of each row beyond its square, shape (E,).
        """
        self.residual, self.jacobian, self.noise = residual, jacobian, noise
        self.own_variance, self.further = own_variance, further
        self.precision, self.off = precision, off
        self._undamped: tuple[SuperLU, Ints] | None = None
        self.inverse = _inverse(noise, own_variance, robot)
        pull = self.inverse @ residual
        self.square = residual * pull + excess
        """Part of the cost that each measurement carries [1], shape (E,)."""
        of_priors = precision * off**2
        self.chi_square = float(self.square.sum() + of_priors[3 * (len(off) // 7) :].sum())
        """Cost without the prior of positions [1]."""
        self.cost = self.chi_square + float(of_priors[: 3 * (len(off) // 7)].sum())
        self.slope = jacobian.T @ pull + precision * off
        for each in further:
            missed = float((each.residual**2).sum() / each.sd**2)
            self.cost, self.chi_square = self.cost + missed, self.chi_square + missed
            part = slice(each.first, each.first + each.jacobian.shape[1])
            self.slope[part] += each.jacobian.T @ each.residual / each.sd**2

    def information(self) -> csc_array:
        """Compute J^T C^-1 J of all rows, with the precision of the priors, shape (7 N, 7 N)."""
        total = self.jacobian.T @ (self.inverse @ self.jacobian) + diags_array(self.precision)
        for each in self.further:
            first, size = each.first, len(self.precision)
            by_all = csc_array(each.jacobian)
            by_all = csc_array(
                (by_all.data, by_all.indices + 0, by_all.indptr), shape=by_all.shape
            )
            pads = [csc_array((len(each.residual), k)) for k in (first, size - first - by_all.shape[1])]
            row = csc_array(hstack([pads[0], by_all, pads[1]]))
            total = total + (row.T @ row) * each.sd**-2.0
        return csc_array(total)

    @property
    def log_volume(self) -> float:
        """Logarithm of the width of the minimum, the square root of its determinant, up to a sum
        that is the same for all minima of a cost."""
        pivots = self._factor()[0].U.diagonal()
        return -0.5 * float(np.log(np.abs(pivots)).sum())

    def _factor(self, radius: float = np.inf) -> tuple[SuperLU, Ints]:
        """Factor the information of free unknowns; steps beyond a radius [R] are damped."""
        if np.isinf(radius) and self._undamped is not None:
            return self._undamped
        found = self._factor_anew(radius)
        if np.isinf(radius):
            self._undamped = found
        return found

    def _factor_anew(self, radius: float) -> tuple[SuperLU, Ints]:
        information = self.information()
        robots = len(self.precision) // 7
        is_free = self.precision > 0.0
        is_free[3 : 3 * robots] = True
        is_free[:3] = False  # the anchor stays
        free = np.flatnonzero(is_free)
        damping = np.full(len(free), _LEAST_DAMPING * information.diagonal().max(initial=1.0))
        damping[: 3 * robots - 3] += radius**-2.0
        return _factored(information[free][:, free] + diags_array(damping)), free

    def step(self, radius: float) -> tuple[Reals, Reals]:
        """Solve for the steps of the unknowns, (7 N,), and the turns of earlier stances, (M,)."""
        factor, free = self._factor(radius)
        step = np.zeros(len(self.slope))
        step[free] = -factor.solve(self.slope[free])
        left = self.residual + self.jacobian @ step
        return step, -(self.noise.T @ (self.inverse @ left))

    def freedom(self) -> int:
        """Count rows and priors beyond the unknowns that they determine.

        By Sylvester's law, a shifted matrix has as many negative pivots as eigenvalues below it.
        """
        information = self.information()
        robots = len(self.precision) // 7
        free = np.flatnonzero(np.r_[np.arange(3 * robots) > 2, self.precision[3 * robots :] > 0.0])
        known = information[free][:, free] - diags_array(
            np.r_[self.precision[3 : 3 * robots], np.zeros(len(free) - 3 * robots + 3)]
        )
        floor = _FLOPPY * known.diagonal().max(initial=1.0)
        pivots = _factored(known - diags_array(np.full(len(free), floor))).U.diagonal()
        rows = len(self.residual) + int((self.precision[3 * robots :] > 0.0).sum())
        rows += sum(len(each.residual) for each in self.further[1:])
        return rows - int((pivots > 0.0).sum())

    def variance(self) -> Reals:
        """Compute the mean square error of positions from draws of all errors [R^2], shape (N,)."""
        sizes = np.cumsum([*self.noise.shape, len(self.precision)])
        draw = normal(0, "errors", np.arange(sizes[-1])[:, None], np.arange(_DRAWS))
        own, turn, prior = np.split(draw, sizes[:-1])
        error = self.noise @ turn + np.sqrt(self.own_variance)[:, None] * own
        pull = self.jacobian.T @ (self.inverse @ error) + np.sqrt(self.precision)[:, None] * prior
        start = sizes[-1]
        for each in self.further:
            count = len(each.residual)
            more = normal(0, "further", np.arange(start, start + count)[:, None], np.arange(_DRAWS))
            start += count
            part = slice(each.first, each.first + each.jacobian.shape[1])
            pull[part] += each.jacobian.T @ more / each.sd
        factor, free = self._factor()
        step = np.zeros_like(pull)
        step[free] = factor.solve(pull[free])
        shift = step[: 3 * (len(step) // 7)].reshape(-1, 3, _DRAWS)
        square: Reals = (shift**2).sum(axis=1).mean(axis=1)
        return square


def _factored(matrix: csc_array) -> SuperLU:
    """Factor a symmetric matrix by pivots on its diagonal."""
    return splu(
        csc_array(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def _inverse(noise: csc_array, own_variance: Reals, robot: Ints) -> csr_array:
    """Invert B B^T + diag(own variance), whose blocks are the rows of a robot, shape (E, E)."""
    is_shared = np.zeros(len(robot), np.bool_)
    is_shared[noise.indices] = True
    inverse = diags_array(np.where(is_shared, 0.0, 1.0 / own_variance)).tocsr()
    rows = np.flatnonzero(is_shared)
    if not len(rows):
        return inverse
    rows = rows[np.argsort(robot[rows], kind="stable")]
    _, first, count = np.unique(robot[rows], return_index=True, return_counts=True)
    shared = noise.tocsr()[rows]
    covariance = (shared @ shared.T).tocoo()
    block = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(rows)) - first[block]
    most = int(count.max())
    dense = np.zeros((len(count), most, most))
    dense[:, np.arange(most), np.arange(most)] = 1.0
    i, j = covariance.coords
    dense[block[i], place[i], place[j]] = covariance.data
    every = np.arange(len(rows))
    dense[block, place, place] = covariance.diagonal() + own_variance[rows]
    dense = np.linalg.inv(dense)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(most), np.arange(most), indexing="ij"))
    of, which = np.nonzero((i < count[:, None]) & (j < count[:, None]))
    entries = dense[of, i[which], j[which]]
    row, column = rows[first[of] + i[which]], rows[first[of] + j[which]]
    return inverse + csr_array((entries, (row, column)), shape=inverse.shape)


def _by_group(value: Reals, row: Ints, group: Ints, shape: tuple[int, int]) -> csc_array:
    """Assemble a sparse matrix; values at the same place add up.

    Args:
        value: Values in the columns of a group, shape (n, k).
        row: Row of each, shape (n,).
        group: Group of columns of each, shape (n,).
        shape: Rows and groups.
    """
    columns = value.shape[1]
    rows = np.repeat(row, columns)
    column = (columns * group[:, None] + np.arange(columns)).ravel()
    return csc_array((value.ravel(), (rows, column)), shape=(shape[0], columns * shape[1]))
