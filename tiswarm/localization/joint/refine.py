"""Generalized least squares from where the chains ended.

The annealer takes errors of measurements to be independent. They are not: noise of one orientation
is in everything a robot sensed there and before. Here residuals are functions of positions p, yaw
biases b and turns w, by which each sensed orientation is wrong. Gauss-Newton on all of them is
generalized least squares: turns of final stances, which are in what other robots sensed too, are
unknowns beside p and b; all others make the covariance of what one robot sensed. Where orientations
were chained, their turns have no prior of their own: connections are rows, too. Lengths in R.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_array, csc_array, diags_array, hstack, vstack
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

from tiswarm.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.settings import RefineSettings
from tiswarm.measurements.model import Measurements, turned
from tiswarm.measurements.orientations import Connections

_UNKNOWN = 1e-6
"""Precision of a turn that connections alone constrain, in its own standard deviations."""

_UNKNOWNS = 7
"""Unknowns of a robot: its shift, the turn of its final stance, and its yaw."""


class Refined(NamedTuple):
    """Where the measurements of one structure are met best."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (N,)."""

    sd: Reals
    """Standard deviation of each position [R], shape (N,)."""


class _State(NamedTuple):
    """Everything that residuals depend on."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    yaw: Reals
    """Yaw corrections [rad], shape (N,)."""

    turn: Reals
    """Error of each sensed orientation beside that, as a rotation vector in standard deviations,
    shape (S, 3)."""


def is_of_use(problem: Problem) -> bool:
    """Whether chains leave something to gain, and are near enough to the truth.

    Errors are correlated where walks are noisy. Components of an offset differ much in precision,
    and the temperature hides it.
    """
    walks, distances = problem.rows.odometry, problem.rows.distances
    is_noisy = max(walks.tilt, walks.yaw) > 0.0
    is_earlier = distances.stance != walks.final[walks.owner[distances.stance]]
    is_biased = 0.0 < problem.yaw_precision < RefineSettings.most_yaw_bias**-2
    gains = (is_noisy and bool(is_earlier.any())) or bool(problem.is_offset.any())
    return gains and not is_biased and walks.bias == 0.0


def refine(
    problem: Problem,
    position: Reals,
    yaw: Reals,
    sd: Reals,
    rows: Measurements,
    curved: Reals,
) -> Refined:
    """Move the robots of one structure to where their measurements are met best.

    Args:
        problem: Measurements that its chains were annealed by.
        position: Where they ended [R], shape (N, 3).
        yaw: Yaw corrections there [rad], shape (N,).
        sd: Standard deviation of these positions [R], shape (N,).
        rows: Measurements that count, P of them of links.
        curved: Variance of links because distances are no linear functions [R^2], shape (P,).
    """
    least_squares = _LeastSquares(rows, curved, problem.yaw_precision, problem.connections)
    prior = np.maximum(RefineSettings.prior_sd * np.sqrt(len(sd)) * sd, RefineSettings.least_prior)
    begin = state = _State(position, yaw, np.zeros((len(problem.rows.odometry.owner), 3)))
    for _ in range(RefineSettings.rounds):
        linear = least_squares.linearized(state, prior)
        state = least_squares.solved(state, begin, linear)
    left = RefineSettings.sd_scale * np.sqrt(linear.variance())
    is_held = (left <= RefineSettings.open_sd * sd) & ~problem.untied
    return Refined(
        position=np.where(is_held[:, None], state.position, position),
        yaw=np.where(is_held, state.yaw, yaw),
        sd=np.where(is_held, left, sd),
    )


class _LeastSquares:
    """Residuals of E measurements, P of them of links, with arms split by stances."""

    def __init__(
        self,
        rows: Measurements,
        curved: Reals,
        yaw_precision: float,
        links: Connections | None = None,
    ) -> None:
        self.rows, self.walks, self.yaw_precision = rows, rows.odometry, yaw_precision
        self.links = links
        self.own_variance = rows.own_variance + rows.shared_variance
        self.own_variance[: len(curved)] += curved
        own, its = self.rows.noisy_arms()
        self.is_own = np.repeat([True, False], [len(own[0]), len(its[0])])
        self.row, self.stance = (np.concatenate([own[k], its[k]]) for k in (0, 1))
        self.arm = np.concatenate([own[2], its[2]])
        self.owner = self.walks.owner[self.stance]
        turns = np.arange(3 * len(self.walks.owner))
        self.final = (3 * self.walks.final[:, None] + np.arange(3)).ravel()
        self.earlier = np.setdiff1d(turns, self.final)

    def linearized(self, state: _State, prior: Reals) -> "_Linear":
        """Linearize at a state, with a prior of that width [R] around the start, shape (N,)."""
        robots = len(state.yaw)
        sd = self.walks.turn_sd[:, [0, 0, 1]][self.stance]
        yaw = np.array([0.0, 0.0, 1.0]) * state.yaw[self.owner, None]
        arm = Rotation.from_rotvec(yaw).apply(self.arm)
        arm = Rotation.from_rotvec(-state.turn[self.stance] * sd).apply(arm)
        offsets = self.rows.offsets
        axis = turned(offsets.axis, state.yaw[self.walks.owner[offsets.stance]])
        rows = replace(
            self.rows,
            offsets=offsets._replace(axis=axis),
            arm=self._summed(arm, self.is_own, len(self.rows)),
            other_arm=self._summed(arm, ~self.is_own, len(self.rows.other)),
        )
        direction = rows.directions(state.position)
        across = np.cross(np.where(self.is_own[:, None], arm, -arm), direction[self.row])
        size = len(rows)
        turns = _by_group(-across * sd, self.row, self.stance, (size, len(state.turn)))
        yaws = _by_group(across[:, 2:], self.row, self.owner, (size, robots))
        shifts = rows.jacobian(state.position)[:, : 3 * robots]
        of_turns = np.ones(3 * robots)
        residual, own_variance = rows.residual(state.position), self.own_variance
        jacobian = hstack([shifts, turns[:, self.final], yaws])
        noise = turns[:, self.earlier]
        if self.links is not None:
            of_turns[np.repeat(self.links.is_chained, 3)] = _UNKNOWN
            left, by_turn = self._links_of(state, self.links)
            residual = np.concatenate([residual, left])
            own_variance = np.concatenate([own_variance, np.full(len(left), self.links.sd**2)])
            none = csc_array((len(left), 3 * robots)), csc_array((len(left), robots))
            jacobian = vstack([jacobian, hstack([none[0], by_turn, none[1]])])
            noise = csc_array(vstack([noise, csc_array((len(left), noise.shape[1]))]))
        weight = [np.repeat(prior**-2, 3), of_turns, np.full(robots, self.yaw_precision)]
        return _Linear(
            residual=residual,
            jacobian=csc_array(jacobian),
            noise=noise,
            own_variance=own_variance,
            precision=np.concatenate(weight),
        )

    def solved(self, state: _State, begin: _State, linear: "_Linear") -> _State:
        """Go from a state to where the sum of squares, linearized there, is least."""
        turn = state.turn.flatten()  # a copy: the state stays as it is
        off = np.concatenate(
            [(state.position - begin.position).ravel(), turn[self.final], state.yaw]
        )
        step, earlier = linear.least(off, turn[self.earlier])
        turn[self.earlier] = earlier
        shift, final, yaw = np.split(step, np.cumsum([state.position.size, len(self.final)]))
        turn[self.final] += final
        shift = shift.reshape(-1, 3)
        longest = RefineSettings.longest_step
        far = np.linalg.norm(shift, axis=1, keepdims=True)
        return _State(
            position=state.position + shift * np.minimum(1.0, longest / np.maximum(far, longest)),
            yaw=state.yaw + yaw,
            turn=turn.reshape(-1, 3),
        )

    def _links_of(self, state: _State, links: Connections) -> tuple[Reals, csc_array]:
        """Compute residuals of connections [rad], and their derivatives by turns of final stances.

        Args:
            state: Where to linearize.
            links: Connections, Q of them.

        Returns:
            Residuals, shape (3 Q,), and derivatives, shape (3 Q, 3 N).
        """
        sd = self.walks.turn_sd[self.walks.final][:, [0, 0, 1]]
        turned = state.turn[self.walks.final] * sd
        left = links.residual - turned[links.robot] + turned[links.other]
        axis, count = np.arange(3), 3 * len(links.robot)
        row = np.tile(np.arange(count), 2)
        ends = np.concatenate([links.robot, links.other])
        sign = np.repeat([-1.0, 1.0], count)
        column = (3 * ends[:, None] + axis).ravel()
        by_turn = csc_array((sign * sd[ends].ravel(), (row, column)), shape=(count, sd.size))
        return left.ravel(), by_turn

    def _summed(self, arm: Reals, chosen: Bools, size: int) -> Reals:
        """Sum the parts of each arm, shape (size, 3)."""
        return np.column_stack([np.bincount(self.row[chosen], a, size) for a in arm[chosen].T])


class _Linear:
    """Residuals e + J d + B w + n with unknowns d, turns w of earlier stances, and own noise n.

    Args:
        residual: e, shape (E,).
        jacobian: J, by shifts (3 N), turns of final stances (3 N) and yaw (N), shape (E, 7 N).
        noise: B, shape (E, M).
        own_variance: Of n, shape (E,).
        precision: One over the variance of each unknown, shape (7 N,).
    """

    def __init__(
        self,
        *,
        residual: Reals,
        jacobian: csc_array,
        noise: csc_array,
        own_variance: Reals,
        precision: Reals,
    ) -> None:
        self.residual, self.noise, self.own_variance = residual, noise, own_variance
        self.precision = precision
        is_free = precision > 0.0  # robots turn only if their yaw is biased
        is_free[:3] = False  # the anchor stays
        self.free = np.flatnonzero(is_free)
        self.jacobian = jacobian[:, self.free]
        covariance = noise @ noise.T + diags_array(own_variance)
        prior = diags_array(precision[self.free])
        saddle = block_array([[covariance, self.jacobian], [self.jacobian.T, -prior]])
        # Such a matrix has pivots whatever the order, so the sparsest will do.
        self.factor: SuperLU = splu(
            csc_array(saddle),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def least(self, off: Reals, turn: Reals) -> tuple[Reals, Reals]:
        """Solve for the steps of the unknowns and the turns of earlier stances.

        Args:
            off: How far unknowns are from where they are by themselves, shape (7 N,).
            turn: Turns of earlier stances that residuals are with, shape (M,).
        """
        residual = self.residual - self.noise @ turn
        pull, step = self._solve(-residual, (self.precision * off)[self.free])
        return step, self.noise.T @ pull

    def variance(self) -> Reals:
        """Compute the mean square error of positions from draws of all errors [R^2], shape (N,)."""
        sizes = np.cumsum([*self.noise.shape, len(self.free)])
        draw = normal(0, "errors", np.arange(sizes[-1])[:, None], np.arange(RefineSettings.draws))
        own, turn, free = np.split(draw, sizes[:-1])
        error = self.noise @ turn + np.sqrt(self.own_variance)[:, None] * own
        _, step = self._solve(error, np.sqrt(self.precision[self.free])[:, None] * free)
        shift = step[: 3 * (len(step) // _UNKNOWNS)].reshape(-1, 3, RefineSettings.draws)
        square: Reals = (shift**2).sum(axis=1).mean(axis=1)
        return square

    def _solve(self, residual: Reals, pull: Reals) -> tuple[Reals, Reals]:
        """Solve for multipliers of the rows and steps of all unknowns."""
        found = self.factor.solve(np.concatenate([residual, pull]))
        step = np.zeros((len(self.precision), *found.shape[1:]))
        step[self.free] = found[len(residual) :]
        return found[: len(residual)], step


def _by_group(
    value: Reals,
    row: Ints,
    group: Ints,
    shape: tuple[int, int],
) -> csc_array:
    """Assemble a sparse matrix; values at the same place add up.

    Args:
        value: Values in the columns of a group, shape (n, k).
        row: Row of each, shape (n,).
        group: Group of columns of each, shape (n,).
        shape: Problem and groups.
    """
    columns = value.shape[1]
    rows = np.repeat(row, columns)
    column = (columns * group[:, None] + np.arange(columns)).ravel()
    return csc_array((value.ravel(), (rows, column)), shape=(shape[0], columns * shape[1]))
