"""Generalized least squares over the robots near one that joined, all others as they are.

The cost is that of `joint`'s refinement: rows in their covariance, turns of final orientations as
unknowns, and overlaps of docks that do not touch. Each block of rows has a covariance of its own,
by the noise of earlier stances. Lengths in R.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.joint.settings import ANNEALING
from tiswarm.localization.online.blocks import Block, gather
from tiswarm.localization.online.settings import NEIGHBORS
from tiswarm.localization.refinement import OVERLAP_SD
from tiswarm.measurements.rows import SPACING

_AXES = 3
_PARTS = 6
"""Columns of a robot: its shift and its turn."""


class Configuration(NamedTuple):
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

    touching: Mapping[int, AbstractSet[tuple[int, int, int]]]
    """By robot, its docks in contact: its own, an earlier robot, and the dock of that one."""

    gone: AbstractSet[int]
    """Robots that have left, whose docks are in nobody's way."""


class Linearized(NamedTuple):
    """The cost near a state: cost + 2 slope . step + step . information . step.

    Steps are those of K robots, all shifts [R] and then all turns [1].
    """

    cost: float
    """Squares of rows and overlaps, priors of turns, and the loss of robust rows beyond that."""

    information: Reals
    """Shape (6 K, 6 K)."""

    slope: Reals
    """Shape (6 K,)."""

    of_others: Reals
    """Change of the slope by a common shift of all other robots, weighed by their sd, (6 K, 3)."""

    square: Reals
    """Chi-square of the rows of each block [1], shape (B,)."""

    overlap: Reals
    """Greatest overlap of each robot [standard deviations], shape (K,)."""


class _Overlaps(NamedTuple):
    """Overlaps of n docks that do not touch, as `Neighborhood._summed` takes them."""

    values: Reals
    robots: Ints


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
        self.number = {int(block.members[-1]): k for k, block in enumerate(blocks)}
        robots = len(shapes.arm)
        self._column = np.full(robots, -1)
        self._column[moving] = np.arange(len(moving))
        # Three axes share the variance.
        stays = np.zeros(robots) if sd is None else sd / np.sqrt(_AXES)
        self._stays = np.where(self._column < 0, stays, 0.0)
        self._is_there = ~np.isin(np.arange(robots), [*shapes.gone])
        self._reach = 2.0 * float(np.linalg.norm(shapes.arm, axis=2).max()) + SPACING

    def linearized(self, state: Configuration) -> Linearized:
        """Linearize the cost at a state."""
        found, rows, sd = self.gathered, self.gathered.rows, self.shapes.turn_sd
        pairs = len(rows.other)
        tail = turned_arms(found.tail, state.turn[rows.robot], sd[rows.robot])
        its = turned_arms(rows.other_arm, state.turn[rows.other], sd[rows.other])
        turned = replace(rows, arm=rows.arm + (tail - found.tail), other_arm=its)
        residual, direction = turned.residual(state.position), turned.directions(state.position)
        own_variance, excess = self._robust(residual)
        blocks, most = found.noise.shape[:2]
        # The last robot of a group stands for a shift of all others, and holds the residual.
        values = np.zeros((blocks * most, found.members.shape[1] + 1, _PARTS))
        own = values[:, 0]
        own[found.slot, :3] = direction
        own[found.slot, 3:] = np.cross(direction, tail) * sd[rows.robot]
        values[found.slot[:pairs], found.member, :3] = -direction[:pairs]
        its_turns = np.cross(its, direction[:pairs]) * sd[rows.other]
        values[found.slot[:pairs], found.member, 3:] = its_turns
        stays = self._stays[rows.robot][:, None] * direction
        stays[:pairs] -= self._stays[rows.other][:, None] * direction[:pairs]
        values[found.slot, -1, :3] = stays
        values[found.slot, -1, 3] = residual
        values = values.reshape(blocks, most, -1)
        weighted = self._weighted(values, direction, own_variance)
        square = (values * weighted)[:, :, 3 - _PARTS].sum(axis=1)
        above = self._overlaps(state)
        total = self._summed(values.swapaxes(1, 2) @ weighted, found.members)
        total += self._summed(above.values.swapaxes(1, 2) @ above.values, above.robots)
        count = 6 * len(self.moving)
        off = state.turn[self.moving].ravel()
        # A turn is in standard deviations, so that its prior has precision 1.
        of_turns = np.arange(len(off), count)
        information, slope = total[:count, :count].copy(), total[:count, count + 3].copy()
        information[of_turns, of_turns] += 1.0
        slope[of_turns] += off
        overlap = np.zeros(len(self.moving) + 1)
        for robots in above.robots.T:
            np.maximum.at(overlap, self._column[robots], np.abs(above.values[:, 0, 3 - _PARTS]))
        return Linearized(
            cost=float(total[count + 3, count + 3] + off @ off) + excess,
            information=information,
            slope=slope,
            of_others=total[:count, count : count + 3],
            square=square,
            overlap=overlap[:-1],
        )

    def _summed(self, products: Reals, robots: Ints) -> Reals:
        """Sum the products of columns over groups of rows.

        Args:
            products: Of columns in pairs: shift and turn of each of the group's robots, a shift of
                the others, the residual, and nothing twice, shape (n, 6 k + 6, 6 k + 6).
            robots: The robots of each group, shape (n, k).

        Returns:
            By shifts and turns of the robots that may move, the shift of the others, and the
            residual, shape (6 K + 4, 6 K + 4).
        """
        count = len(self.moving)
        column = self._column[robots][:, :, None]
        every = np.concatenate([3 * column + range(3), 3 * (count + column) + range(3)], axis=2)
        trash = 6 * count + 4
        # What stays has no unknowns; all of it goes to one row that is cut off.
        known = np.where(column < 0, trash, every).reshape(len(robots), 6 * robots.shape[1])
        last = np.array([*range(trash - 4, trash), trash, trash])
        place: Ints = np.concatenate([known, np.tile(last, (len(robots), 1))], axis=1)
        flat = (trash + 1) * place[:, :, None] + place[:, None]
        total = np.bincount(flat.ravel(), products.ravel(), (trash + 1) ** 2)
        square = np.asarray(total, np.float64).reshape(trash + 1, trash + 1)
        return square[:trash, :trash]

    def _weighted(self, values: Reals, direction: Reals, own_variance: Reals) -> Reals:
        """Multiply values (B, m, n) by the inverse of each block's covariance."""
        noise, slot = self.gathered.noise, self.gathered.slot
        blocks, most = noise.shape[:2]
        placed = np.zeros((blocks * most, _AXES))
        placed[slot] = direction
        way = placed.reshape(blocks, most, _AXES)
        half = (way[:, :, None] @ noise).reshape(blocks, most, most, _AXES)
        covariance = products_along(half, way[:, None])
        own = np.ones(blocks * most)
        own[slot] = own_variance
        place = np.arange(most)
        # Places without a row have variance 1 and no derivatives.
        covariance[:, place, place] += own.reshape(blocks, most)
        weighted: Reals = np.linalg.inv(covariance) @ values
        return weighted

    def _robust(self, residual: Reals) -> tuple[Reals, float]:
        """Widen what is missed by far, as `Cost` does: own variances (E,), and the loss beyond."""
        rows, variance = self.gathered.rows, self.gathered.variance
        if not self.robust:
            return rows.own_variance, 0.0
        square = ANNEALING.outlier_sd**2
        missed = residual**2 / (square * variance)
        offset = slice(len(rows.distances.stance), len(rows.other))
        missed[offset] = np.repeat(missed[offset].reshape(-1, _AXES).sum(axis=1), _AXES)
        excess = square * (np.log1p(missed) - missed / (1.0 + missed))
        excess[offset] /= _AXES
        return rows.own_variance + variance * missed, float(excess.sum())

    def _overlaps(self, state: Configuration) -> "_Overlaps":
        """Compute the overlaps of docks that do not touch, and their derivatives."""
        if not self.non_overlap:
            return _Overlaps(np.zeros((0, 1, 3 * _PARTS)), np.zeros((0, 2), np.int64))
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
        # Docks in contact are nearer than D as often as farther.
        is_apart = [tuple(row[1:]) not in touching[row[0]] for row in docks.tolist()]
        i, own, j, its = docks[np.array(is_apart, np.bool_)].T
        apart = point[i, own] - point[j, its]
        length = np.linalg.norm(apart, axis=1)
        way = apart / length[:, None] / OVERLAP_SD
        sd = self.shapes.turn_sd
        values = np.zeros((len(i), 1, 3, _PARTS))
        values[:, 0, 0] = np.hstack([way, np.cross(way, arm[i, own]) * sd[i]])
        values[:, 0, 1] = np.hstack([-way, np.cross(arm[j, its], way) * sd[j]])
        values[:, 0, 2, :3] = (self._stays[i] - self._stays[j])[:, None] * way
        values[:, 0, 2, 3] = (length - SPACING) / OVERLAP_SD
        return _Overlaps(values.reshape(len(i), 1, 3 * _PARTS), np.column_stack([i, j]))

    def _near(self, position: Reals) -> tuple[Ints, Ints]:
        """List pairs of robots whose docks may overlap, if one of them may move."""
        away = position[self.moving, None] - position
        row, other = np.nonzero((away**2).sum(axis=2) < self._reach**2)
        robot = self.moving[row]
        # A pair that may both move is listed once.
        is_first = (robot > other) | ((robot < other) & (self._column[other] < 0))
        is_there = self._is_there[robot] & self._is_there[other]
        pair = np.column_stack([robot, other])[is_first & is_there]
        return pair.max(axis=1), pair.min(axis=1)

    def solved(self, state: Configuration) -> tuple[Configuration, Linearized]:
        """Take steps toward the minimum; return the best state on the way, and the cost there."""
        best = here = state, self.linearized(state)
        for _ in range(NEIGHBORS.rounds):
            state, linear = here
            shift, turn = self._step(linear)
            gain = -linear.slope @ np.concatenate([shift.ravel(), turn.ravel()])
            # Most joins need one step; each costs as much as the first.
            if gain < NEIGHBORS.settled:
                break
            position, turned = state.position.copy(), state.turn.copy()
            position[self.moving] += shift
            turned[self.moving] += turn
            state = Configuration(position, turned)
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
            # The anchor stays where it is, but its orientation is as noisy as any.
            known[:_AXES] = known[:, :_AXES] = 0.0
            known[range(_AXES), range(_AXES)] = 1.0
        return known

    def _step(self, linear: Linearized) -> tuple[Reals, Reals]:
        """Solve for the shifts and the turns of all robots that may move, (K, 3) both."""
        slope = linear.slope.copy()
        if self.moving[0] == 0:
            slope[:_AXES] = 0.0
        step = -np.linalg.solve(self._factored(linear, NEIGHBORS.damping), slope)
        steps = np.asarray(step, np.float64).reshape(2, -1, _AXES)
        far, most = np.linalg.norm(steps[0], axis=1), NEIGHBORS.longest_step
        steps[0] *= np.minimum(1.0, most / np.maximum(far, most))[:, None]
        return steps[0], steps[1]

    def missed(self, linear: Linearized, robot: int) -> tuple[float, float]:
        """Chi-square of the rows of a robot, and its greatest overlap in standard deviations."""
        return float(linear.square[self.number[robot]]), float(linear.overlap[self._column[robot]])

    def sd(self, linear: Linearized) -> Reals:
        """Compute the standard deviation of each robot that may move [R], shape (K,).

        Errors of the robots that stay count as a shift that they share.
        """
        count = 3 * len(self.moving)
        inverse = np.linalg.inv(self._factored(linear, NEIGHBORS.open_precision))
        own = np.diagonal(inverse)[:count].reshape(-1, _AXES).sum(axis=1)
        # A neighborhood hangs on robots that are wrong themselves, and by much the same.
        shared = inverse[:count] @ linear.of_others
        if self.moving[0] == 0:
            own, shared = own.copy(), shared.copy()
            own[0], shared[:_AXES] = 0.0, 0.0
        square = own + (shared**2).sum(axis=1).reshape(-1, _AXES).sum(axis=1)
        sd: Reals = np.sqrt(square)
        return sd


def products_along(half: Reals, way: Reals) -> Reals:
    """Multiply vectors, shape (..., 3), and add up: what einsum takes ten times as long for."""
    total: Reals = half[..., 0] * way[..., 0]
    for axis in range(1, _AXES):
        total += half[..., axis] * way[..., axis]
    return total


def turned_arms(arm: Reals, turn: Reals, sd: Reals) -> Reals:
    """Undo errors of orientations, in standard deviations, of arms; all are of shape (n, 3)."""
    return Rotation.from_rotvec(-turn * sd).apply(arm)


def turned_docks(state: Configuration, shapes: Shapes, robot: Ints) -> Reals:
    """Arms of all docks of some robots at a state [R], shape (n, docks, 3)."""
    arm = shapes.arm[robot]
    docks = arm.shape[1]
    turn, sd = (np.repeat(each[robot], docks, axis=0) for each in (state.turn, shapes.turn_sd))
    return turned_arms(arm.reshape(-1, _AXES), turn, sd).reshape(arm.shape)
