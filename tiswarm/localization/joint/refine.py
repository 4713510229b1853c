"""From where chains ended to where equations are met best if what their errors share is known.

The annealer takes errors of equations to be independent. They are not: noise of one orientation is
in all that a robot felt there and before. Here residuals are functions of positions p, biases of
yaw b and turns w, by which each sensed orientation is wrong. Gauss-Newton on all of them is
generalized least squares: turns of final stances, which are in what other robots felt too, are
unknowns beside p and b; all others make the covariance of what one robot felt. Lengths in R.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csc_array, diags_array, hstack
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

from tiswarm.compute.math import normal
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.force_kernels import SPACING, TINY

ROUNDS = 2
"""Linear problems solved, each at where the last one led."""
STRAY = 1.2
"""How far from where chains ended robots may be by chance, in deviations told by these, times the
square root of the number of robots: so far that all may share an error and move together."""
LEAST_STRAY = 0.05
"""And no less than this [R]."""
STRIDE = 0.5
"""The farthest that a robot moves in a round [R]."""
UNKNOWNS = 7
"""Of each robot: its shift, the turn of its final stance, and its yaw."""
PROBES = 64
"""Draws of all errors by which is measured how far off the result may be."""
MEASURED = 0.97
"""Standard deviations of an error in what draws say; fitted on training structures."""
MOST_BIAS = 0.2
"""Where robots may be turned by more than that [rad], chains that got it wrong are too far from the
truth to be led there in a straight line."""
OPEN = 2.0
"""Robots that may be farther off, in deviations told by chains, are not held by equations: overlaps
and what robots are likely to build decide where they are, and chains know of these."""


class Refined(NamedTuple):
    """Where equations of one structure are met best."""

    position: NDArray[np.float64]
    """Centers [R], shape (N, 3)."""

    yaw: NDArray[np.float64]
    """How far robots are turned [rad], shape (N,)."""

    sd: NDArray[np.float64]
    """Standard deviation of each position [R], shape (N,)."""


class _State(NamedTuple):
    """Everything that errors depend on."""

    position: NDArray[np.float64]
    """Centers, shape (N, 3)."""

    yaw: NDArray[np.float64]
    """Turn that is to be added to each robot's orientations, shape (N,)."""

    turn: NDArray[np.float64]
    """By how much each sensed orientation is wrong beside that, as a rotation vector in standard
    deviations, shape (stances, 3)."""


def is_of_use(known: Equations) -> bool:
    """Whether errors of equations are related, as those of noisy walks are, and not too large."""
    path = known.path
    is_noisy = max(path.tilt, path.yaw) > 0.0 and path.bias == 0.0
    is_biased = 0.0 < known.yaw_precision < MOST_BIAS**-2
    return is_noisy and not is_biased and not bool(known.is_final.all())


def refine(
    known: Equations,
    position: NDArray[np.float64],
    yaw: NDArray[np.float64],
    sd: NDArray[np.float64],
    trusted: NDArray[np.bool_],
    curved: NDArray[np.float64],
) -> Refined:
    """Move the robots of one structure to where equations are met best.

    Args:
        known: What its chains were annealed by.
        position: Where they ended, shape (N, 3).
        yaw: How far robots are turned there [rad], shape (N,).
        sd: Standard deviation of these positions, shape (N,).
        trusted: Contacts that count, shape (C,).
        curved: Variance of contacts because distances are no linear functions, shape (C,).
    """
    problem = _Problem(known, trusted, curved)
    stray = np.maximum(STRAY * np.sqrt(len(sd)) * sd, LEAST_STRAY)
    begin = state = _State(position, yaw, np.zeros((len(known.path.owner), 3)))
    for _ in range(ROUNDS):
        linear = problem.linearized(state, stray)
        state = problem.solved(state, begin, linear)
    left = MEASURED * np.sqrt(linear.variance())
    is_held = (left <= OPEN * sd) & ~known.untied
    return Refined(
        position=np.where(is_held[:, None], state.position, position),
        yaw=np.where(is_held, state.yaw, yaw),
        sd=np.where(is_held, left, sd),
    )


class _Problem:
    """Residuals: of K contacts, then of all coordinates that anything tells, E in all."""

    def __init__(
        self, known: Equations, trusted: NDArray[np.bool_], curved: NDArray[np.float64]
    ) -> None:
        path, told = known.path, known.told
        self.path, self.yaw_precision = path, known.yaw_precision
        is_told = told.is_known & (np.arange(len(known.place)) > 0)[:, None]
        placed, self.axis = np.nonzero(is_told)
        felt = known.felt[trusted]
        first, self.other = known.robot[trusted], known.other[trusted]
        self.robot = np.concatenate([first, placed])
        self.own_variance = np.concatenate(
            [known.own_variance + curved[trusted], told.variance[is_told]]
        )
        row = np.concatenate([path.first[first] + felt[:, 1], told.row[is_told]])
        dock = np.concatenate([felt[:, 2], told.dock[is_told]])
        equation, stance, arm = path.noisy_arms(row, dock)
        final = path.final[self.other]
        # A contact is as far as from the one robot's dock to the other's.
        self.equation = np.concatenate([equation, np.arange(len(final))])
        self.stance = np.concatenate([stance, final])
        self.arm = np.concatenate([arm, -path.arm[final, felt[:, 4]]])
        self.owner = path.owner[self.stance]
        turns = np.arange(3 * len(path.owner))
        self.final = (3 * path.final[:, None] + np.arange(3)).ravel()
        self.earlier = np.setdiff1d(turns, self.final)
        at = self._summed(self.arm)[len(first) :]
        self.level = known.sensed_place[is_told] + at[np.arange(len(at)), self.axis]
        """What is told: coordinates of docks, or of centers where walks began."""

    def linearized(self, state: _State, stray: NDArray[np.float64]) -> "_Linear":
        """Linearize at a state, from which robots may have strayed so far, shape (N,)."""
        contacts, robots = len(self.other), len(state.yaw)
        sd = np.array([self.path.tilt, self.path.tilt, self.path.yaw])
        yaw = np.array([0.0, 0.0, 1.0]) * state.yaw[self.owner, None]
        arm = Rotation.from_rotvec(yaw).apply(self.arm)
        arm = Rotation.from_rotvec(-state.turn[self.stance] * sd).apply(arm)
        at = self._summed(arm) + state.position[self.robot]
        apart = at[:contacts] - state.position[self.other]
        length = np.maximum(np.linalg.norm(apart, axis=1), TINY)
        away = at[contacts:][np.arange(len(self.axis)), self.axis] - self.level
        direction = np.concatenate([apart / length[:, None], np.eye(3)[self.axis]])
        across = np.cross(arm, direction[self.equation])
        size = len(direction)
        every = np.arange(size)
        shifts = _by_group(direction, every, self.robot, (size, robots)) - _by_group(
            direction[:contacts], every[:contacts], self.other, (size, robots)
        )
        turns = _by_group(-across * sd, self.equation, self.stance, (size, len(state.turn)))
        yaws = _by_group(across[:, 2:], self.equation, self.owner, (size, robots))
        prior = [np.repeat(stray**-2, 3), np.ones(3 * robots), np.full(robots, self.yaw_precision)]
        return _Linear(
            residual=np.concatenate([length - SPACING, away]),
            jacobian=csc_array(hstack([shifts, turns[:, self.final], yaws])),
            noise=turns[:, self.earlier],
            own_variance=self.own_variance,
            precision=np.concatenate(prior),
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
        far = np.linalg.norm(shift, axis=1, keepdims=True)
        return _State(
            position=state.position + shift * np.minimum(1.0, STRIDE / np.maximum(far, STRIDE)),
            yaw=state.yaw + yaw,
            turn=turn.reshape(-1, 3),
        )

    def _summed(self, arm: NDArray[np.float64]) -> NDArray[np.float64]:
        """From centers to docks: the sum of the arms of each equation, shape (E, 3)."""
        size = len(self.own_variance)
        return np.column_stack([np.bincount(self.equation, a, size) for a in arm.T])


class _Linear:
    """Residuals e + J d + B w + n of unknowns d, turns w of earlier stances, noise n of their own.

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
        residual: NDArray[np.float64],
        jacobian: csc_array,
        noise: csc_array,
        own_variance: NDArray[np.float64],
        precision: NDArray[np.float64],
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

    def least(
        self, off: NDArray[np.float64], turn: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Steps of the unknowns, and turns of earlier stances, of the least sum of squares.

        Args:
            off: How far unknowns are from where they are by themselves, shape (7 N,).
            turn: Turns of earlier stances that residuals are with, shape (M,).
        """
        residual = self.residual - self.noise @ turn
        pull, step = self._solve(-residual, (self.precision * off)[self.free])
        return step, self.noise.T @ pull

    def variance(self) -> NDArray[np.float64]:
        """Mean square by which positions may be off, from draws of all errors, shape (N,)."""
        sizes = np.cumsum([*self.noise.shape, len(self.free)])
        draw = normal(0, "errors", np.arange(sizes[-1])[:, None], np.arange(PROBES))
        own, turn, free = np.split(draw, sizes[:-1])
        error = self.noise @ turn + np.sqrt(self.own_variance)[:, None] * own
        _, step = self._solve(error, np.sqrt(self.precision[self.free])[:, None] * free)
        shift = step[: 3 * (len(step) // UNKNOWNS)].reshape(-1, 3, PROBES)
        square: NDArray[np.float64] = (shift**2).sum(axis=1).mean(axis=1)
        return square

    def _solve(
        self, residual: NDArray[np.float64], pull: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Multipliers of the equations and steps of all unknowns."""
        found = self.factor.solve(np.concatenate([residual, pull]))
        step = np.zeros((len(self.precision), *found.shape[1:]))
        step[self.free] = found[len(residual) :]
        return found[: len(residual)], step


def _by_group(
    value: NDArray[np.float64],
    equation: NDArray[np.int64],
    group: NDArray[np.int64],
    shape: tuple[int, int],
) -> csc_array:
    """Put rows of values where an equation's row meets a group's columns; they add up.

    Args:
        value: As many a row as a group has columns, shape (n, k).
        equation: Row of each, shape (n,).
        group: Of columns, shape (n,).
        shape: Equations and groups.
    """
    columns = value.shape[1]
    row = np.repeat(equation, columns)
    column = (columns * group[:, None] + np.arange(columns)).ravel()
    return csc_array((value.ravel(), (row, column)), shape=(shape[0], columns * shape[1]))
