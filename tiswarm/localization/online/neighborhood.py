"""Generalized least squares over the robots near one that joined, all others as they are.

The cost is that of `joint`'s refinement: rows in their covariance, turns of final orientations as
unknowns, and overlaps of docks that do not touch. Each block of rows has a covariance of its own,
by the noise of earlier stances. Lengths in R.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.joint.settings import AnnealSchedule
from tiswarm.localization.online.blocks import Block, gather
from tiswarm.localization.online.settings import NeighborhoodSettings
from tiswarm.localization.refinement import OVERLAP_SD
from tiswarm.measurements.rows import SPACING

_AXES = 3

class Placed(NamedTuple):
    """Where N robots are, and by how much their final orientations are off."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    turn: Reals
    """Error of each final orientation as a rotation vector in standard deviations, shape (N, 3)."""


class Shapes(NamedTuple):
    """What no estimate changes of N robots."""

    arm: Reals
    """Center to dock at the final stance, as sensed [R], shape (N, docks, 3)."""

    turn_sd: Reals
    """Standard deviation of each final orientation about each axis [rad], shape (N, 3)."""

    touching: Mapping[int, Set[tuple[int, int, int]]]
    """By robot, its docks in contact: its own, an earlier robot, and the dock of that one."""


@dataclass(frozen=True, kw_only=True)
class Linearized:
    """The cost of K robots near a state; n rows are in standard deviations and independent."""

    residual: Reals
    """Residuals of rows, block after block, and of overlaps, shape (n,)."""

    jacobian: Reals
    """Derivatives by all shifts [R^-1] and then all turns [1], shape (n, 6 K)."""

    off: Reals
    """Turns, which have priors, shape (3 K,)."""

    excess: float
    """Loss of rows beyond their squares [1]."""

    fixed: Reals
    """Derivatives by a common shift of all other robots, weighed by their sd [1], shape (n, 3)."""

    @property
    def cost(self) -> float:
        """Squares of rows and overlaps, priors, and the loss of rows beyond that [1]."""
        return float(self.residual @ self.residual + self.off @ self.off) + self.excess

    @cached_property
    def information(self) -> Reals:
        """Half the second derivative of the cost, priors included, shape (6 K, 6 K)."""
        known: Reals = self.jacobian.T @ self.jacobian
        turns = np.arange(len(self.off), len(known))
        known[turns, turns] += 1.0
        return known

    @property
    def slope(self) -> Reals:
        """Half the derivative of the cost, shape (6 K,)."""
        slope: Reals = self.jacobian.T @ self.residual
        slope[len(self.off) :] += self.off
        return slope


class Neighborhood:
    """The cost of K robots that may move, and of the B blocks of rows that are about them."""

    def __init__(
        self,
        moving: Ints,
        blocks: list[Block],
        shapes: Shapes,
        *,
        robust: bool = False,
        non_overlap: bool = True,
        sd: Reals | None = None,
    ) -> None:
        """Gather what does not change with the state.

        Args:
            moving: Robots that may move, ascending, shape (K,); the anchor only turns.
            blocks: Blocks with rows about them; none is empty.
            shapes: All N robots.
            robust: Whether rows that disagree with all others give way.
            non_overlap: Whether docks that do not touch must not overlap.
            sd: Standard deviation of the positions of robots that stay [R], shape (N,); 0 if None.
        """
        self.moving, self.shapes = moving, shapes
        self.robust, self.non_overlap = robust, non_overlap
        self.gathered = gather(blocks)
        self.blocks = len(blocks)
        self.number = {int(block.members[-1]): k for k, block in enumerate(blocks)}
        rows, robots = self.gathered.rows, len(shapes.arm)
        self._column = np.full(robots, -1)
        self._column[moving] = np.arange(len(moving))
        stays = np.zeros(robots) if sd is None else sd / np.sqrt(_AXES)
        self._stays = np.where(self._column < 0, stays, 0.0)
        self._reach = 2.0 * float(np.linalg.norm(shapes.arm, axis=2).max()) + SPACING

    def linearized(self, state: Placed) -> Linearized:
        """Linearize the cost at a state."""
        found, rows, sd = self.gathered, self.gathered.rows, self.shapes.turn_sd
        pairs = len(rows.other)
        tail = turned_arms(found.tail, state.turn[rows.robot], sd[rows.robot])
        its = turned_arms(rows.other_arm, state.turn[rows.other], sd[rows.other])
        turned = replace(rows, arm=rows.arm + (tail - found.tail), other_arm=its)
        residual, direction = turned.residual(state.position), turned.directions(state.position)
        own_variance, excess = self._robust(residual)
        own, other = self._column[rows.robot], self._column[rows.other]
        places = self.blocks * found.noise.shape[1]
        shift, turn = np.zeros((2, places, len(self.moving) + 1, _AXES))  # the last is of others
        shift[found.slot, own] = direction
        shift[found.slot[:pairs], other] = -direction[:pairs]
        turn[found.slot, own] = np.cross(direction, tail) * sd[rows.robot]
        turn[found.slot[:pairs], other] = np.cross(its, direction[:pairs]) * sd[rows.other]
        every = np.zeros((places, 6 * len(self.moving) + 1 + _AXES))
        every[:, : 3 * len(self.moving)] = shift[:, :-1].reshape(places, -1)
        every[:, 3 * len(self.moving) : -4] = turn[:, :-1].reshape(places, -1)
        every[found.slot, -1] = residual
        stays = self._stays[rows.robot][:, None] * direction
        stays[:pairs] -= self._stays[rows.other][:, None] * direction[:pairs]
        every[found.slot, -4:-1] = stays
        white = self._whitened(every, direction, own_variance)
        above = self._overlaps(state)
        return Linearized(
            residual=np.concatenate([white[:, -1], above[:, -1]]),
            jacobian=np.concatenate([white[:, :-4], above[:, :-4]]),
            off=state.turn[self.moving].ravel(),
            excess=excess,
            fixed=np.concatenate([white[:, -4:-1], above[:, -4:-1]]),
        )

    def _whitened(self, values: Reals, direction: Reals, own_variance: Reals) -> Reals:
        """Multiply values, a row for each place, by the inverse root of each block's covariance."""
        noise, slot = self.gathered.noise, self.gathered.slot
        blocks, most = noise.shape[:2]
        way = np.zeros((blocks * most, _AXES))
        way[slot] = direction
        way = way.reshape(blocks, most, _AXES)
        covariance = np.matmul(noise, way[:, None, :, :, None])[..., 0]
        covariance = (covariance * way[:, :, None]).sum(axis=3)
        own = np.ones(blocks * most)
        own[slot] = own_variance
        place = np.arange(most)
        covariance[:, place, place] += own.reshape(blocks, most)
        root = np.linalg.cholesky(covariance)
        white = np.linalg.solve(root, values.reshape(blocks, most, -1))
        return white.reshape(blocks * most, -1)

    def _robust(self, residual: Reals) -> tuple[Reals, float]:
        """Widen what is missed by far, as `Cost` does: own variances (E,), and the loss beyond."""
        rows, variance = self.gathered.rows, self.gathered.variance
        if not self.robust:
            return rows.own_variance, 0.0
        square = AnnealSchedule.outlier_sd**2
        missed = residual**2 / (square * variance)
        offset = slice(len(rows.distances.stance), len(rows.other))
        missed[offset] = np.repeat(missed[offset].reshape(-1, _AXES).sum(axis=1), _AXES)
        excess = square * (np.log1p(missed) - missed / (1.0 + missed))
        excess[offset] /= _AXES
        return rows.own_variance + variance * missed, float(excess.sum())

    def _overlaps(self, state: Placed) -> Reals:
        """Compute derivatives and overlaps of docks that do not touch, a row each."""
        count = len(self.moving)
        if not self.non_overlap:
            return np.zeros((0, 6 * count + 4))
        later, earlier = self._near(state.position)
        robot = np.unique(np.concatenate([later, earlier]))
        arm = np.zeros_like(self.shapes.arm)
        arm[robot] = turned_docks(state, self.shapes, robot)
        point = state.position[:, None] + arm
        apart = point[later][:, :, None] - point[earlier][:, None]
        length = np.linalg.norm(apart, axis=3)
        pair, own, its = np.nonzero((length < SPACING) & (length > 0.0))
        docks = np.column_stack([later[pair], own, earlier[pair], its])
        touching = self.shapes.touching
        is_apart = [tuple(row[1:]) not in touching[row[0]] for row in docks.tolist()]
        i, own, j, its = docks[np.array(is_apart, np.bool_)].T
        apart = point[i, own] - point[j, its]
        length = np.linalg.norm(apart, axis=1)
        way = apart / length[:, None] / OVERLAP_SD
        row = np.arange(len(i))
        rows = np.zeros((len(i), 2, count + 1, _AXES))
        sd = self.shapes.turn_sd
        for robots, dock, pull in ((i, own, way), (j, its, -way)):
            rows[row, 0, self._column[robots]] = pull
            rows[row, 1, self._column[robots]] = np.cross(pull, arm[robots, dock]) * sd[robots]
        stays = (self._stays[i] - self._stays[j])[:, None] * way
        missed = (length - SPACING) / OVERLAP_SD
        flat = rows[:, :, :-1].reshape(len(i), 6 * count)
        return np.concatenate([flat, stays, missed[:, None]], axis=1)

    def _near(self, position: Reals) -> tuple[Ints, Ints]:
        """List pairs of robots whose docks may overlap, at least one of which may move."""
        away = position[self.moving, None] - position
        row, other = np.nonzero((away**2).sum(axis=2) < self._reach**2)
        robot = self.moving[row]
        is_first = (robot > other) | ((robot < other) & (self._column[other] < 0))
        pair = np.column_stack([robot, other])[is_first]
        return pair.max(axis=1), pair.min(axis=1)

    def solved(self, state: Placed, rounds: int = NeighborhoodSettings.rounds) -> tuple[Placed, Linearized]:
        """Take steps toward the minimum; return the best state on the way, and the cost there."""
        best = here = state, self.linearized(state)
        for _ in range(rounds):
            state, linear = here
            step = self._step(linear)
            position, turn = state.position.copy(), state.turn.copy()
            position[self.moving] += step[0]
            turn[self.moving] += step[1]
            state = Placed(position, turn)
            here = state, self.linearized(state)
            if here[1].cost < best[1].cost:
                best = here
        return best

    def _factored(self, linear: Linearized, damping: float) -> Reals:
        """Damp shifts, and hold the anchor, shape (6 K, 6 K)."""
        known = linear.information.copy()
        shifts = np.arange(3 * len(self.moving))
        known[shifts, shifts] += damping
        if self.moving[0] == 0:
            known[:_AXES] = known[:, :_AXES] = 0.0
            known[range(_AXES), range(_AXES)] = 1.0
        return known

    def _step(self, linear: Linearized) -> tuple[Reals, Reals]:
        """Solve for the shifts and the turns of all robots that may move, (K, 3) both."""
        slope = linear.slope
        if self.moving[0] == 0:
            slope[:_AXES] = 0.0
        step = -np.linalg.solve(self._factored(linear, NeighborhoodSettings.damping), slope)
        shift, turn = step.reshape(2, -1, _AXES)
        far, most = np.linalg.norm(shift, axis=1), NeighborhoodSettings.longest_step
        return shift * np.minimum(1.0, most / np.maximum(far, most))[:, None], turn

    def missed(self, linear: Linearized, robot: int) -> tuple[float, float]:
        """Compute how a robot misses what it senses.

        Returns:
            Chi-square of its rows, and its greatest overlap in standard deviations [1].
        """
        most = self.gathered.noise.shape[1]
        first, column = most * self.number[robot], self._column[robot]
        square = float((linear.residual[first : first + most] ** 2).sum())
        above = linear.jacobian[self.blocks * most :, 3 * column : 3 * column + 3]
        is_own = above.any(axis=1)
        overlap = np.abs(linear.residual[self.blocks * most :][is_own]).max(initial=0.0)
        return square, float(overlap)

    def sd(self, linear: Linearized) -> Reals:
        """Compute the standard deviation of each robot that may move [R], shape (K,).

        Errors of the robots that stay count as a shift that they share.
        """
        count = 3 * len(self.moving)
        inverse = np.linalg.inv(self._factored(linear, NeighborhoodSettings.open_precision))
        own = np.diagonal(inverse)[:count].reshape(-1, _AXES).sum(axis=1)
        shared = inverse[:count] @ (linear.jacobian.T @ linear.fixed)
        if self.moving[0] == 0:
            own, shared = own.copy(), shared.copy()
            own[0], shared[:_AXES] = 0.0, 0.0
        square = own + (shared**2).sum(axis=1).reshape(-1, _AXES).sum(axis=1)
        return np.sqrt(square)


def turned_arms(arm: Reals, turn: Reals, sd: Reals) -> Reals:
    """Undo errors of orientations, in standard deviations, of arms; all are of shape (n, 3)."""
    return Rotation.from_rotvec(-turn * sd).apply(arm)


def turned_docks(state: Placed, shapes: Shapes, robot: Ints) -> Reals:
    """Arms of all docks of some robots at a state [R], shape (n, docks, 3)."""
    arm = shapes.arm[robot]
    docks = arm.shape[1]
    turn, sd = (np.repeat(each[robot], docks, axis=0) for each in (state.turn, shapes.turn_sd))
    return turned_arms(arm.reshape(-1, _AXES), turn, sd).reshape(arm.shape)
