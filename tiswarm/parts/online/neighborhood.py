"""Generalized least squares over the robots near one that joined, all others as they are.

The cost is that of `joint`'s refinement: rows in their covariance, turns of final orientations as
unknowns, and overlaps of docks that do not touch. Each block of rows has a covariance of its own,
by the noise of earlier stances. Lengths in R.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.joint.settings import ANNEALING
from tiswarm.parts.online.blocks import Block, scratch_for, table_of
from tiswarm.parts.online.configuration import Configuration, Shapes, robots_at
from tiswarm.parts.online.neighborhood_kernels import sum_equations
from tiswarm.parts.online.settings import NEIGHBORS

_AXES = 3
_LAPACK: Any = scipy.linalg.lapack
"""Its functions have no types, and cost less to call than those above them."""


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
    """Chi-square of the rows of each block, by their robust loss where they give way, (B,)."""

    overlap: Reals
    """Greatest overlap of each robot [standard deviations], shape (K,)."""


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
        self.number = {int(block.members[-1]): k for k, block in enumerate(blocks)}
        self.table, self._scratch = table_of(blocks), scratch_for(blocks)
        robots = len(shapes.arm)
        self._column = np.full(robots, -1, np.int32)
        self._column[moving] = np.arange(len(moving))
        # Three axes share the variance.
        stays = np.zeros(robots) if sd is None else sd / np.sqrt(_AXES)
        self._stays = np.where(self._column < 0, stays, 0.0)

    def linearized(self, state: Configuration) -> Linearized:
        """Linearize the cost at a state."""
        moving, count = self.moving.astype(np.int32), 6 * len(self.moving)
        total = np.zeros((count + _AXES + 1, count + _AXES + 1))
        square, overlap = np.empty(len(self.number) + 1), np.zeros(len(moving))
        sum_equations(
            ANNEALING.outlier_sd**2 * self.robust, int(self.non_overlap), self.shapes.reach,
            *self.table, *robots_at(state, self.shapes, self._stays), *self._scratch,
            moving, self._column, total, square, overlap,
        )  # fmt: skip
        off = state.turn[self.moving].ravel()
        # A turn is in standard deviations, so that its prior has precision 1.
        of_turns = np.arange(len(off), count)
        slope = total[-1, :count].copy()
        slope[of_turns] += off
        lower = total[:count, :count]
        information = lower + np.tril(lower, -1).T
        information[of_turns, of_turns] += 1.0
        return Linearized(
            cost=float(total[-1, -1] + off @ off + square[-1]),
            information=information,
            slope=slope,
            of_others=total[count:-1, :count].T,
            square=square[:-1],
            overlap=overlap,
        )

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

    def _factor(self, linear: Linearized, damping: float) -> Reals:
        """Damp shifts, hold the anchor, and factor what is known: all turns, then all shifts.

        Returns:
            The lower Cholesky factor, shape (6 K, 6 K).
        """
        count = 3 * len(self.moving)
        known = np.roll(linear.information, count, axis=(0, 1))
        shifts = np.arange(count, 2 * count)
        known[shifts, shifts] += damping
        if self.moving[0] == 0:
            # The anchor stays where it is, but its orientation is as noisy as any.
            anchor = shifts[:_AXES]
            known[anchor] = known[:, anchor] = 0.0
            known[anchor, anchor] = 1.0
        # Symmetric: its transpose is the same matrix in the order that needs no copy.
        factor: Reals
        factor, trouble = _LAPACK.dpotrf(known.T, lower=1, overwrite_a=1)
        if trouble:
            raise np.linalg.LinAlgError("the information of a neighborhood is not positive")
        return factor

    def _step(self, linear: Linearized) -> tuple[Reals, Reals]:
        """Solve for the shifts and the turns of all robots that may move, (K, 3) both."""
        slope = linear.slope.copy()
        if self.moving[0] == 0:
            slope[:_AXES] = 0.0
        count = len(slope) // 2
        # A robot with a free direction takes no step along it.
        factor = self._factor(linear, NEIGHBORS.damping)
        step, _ = _LAPACK.dpotrs(factor, -np.roll(slope, count), lower=1)
        steps = np.roll(step, count).reshape(2, -1, _AXES)
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
        factor = self._factor(linear, NEIGHBORS.open_precision)
        others = np.roll(linear.of_others, count, axis=0)
        if self.moving[0] == 0:
            others[count : count + _AXES] = 0.0
        # Turns come first: the last rows of the factor are that of what is known of the shifts
        # alone, and the variance is the square of its inverse.
        half, _ = _LAPACK.dtrtrs(factor, others, lower=1)
        inverse, _ = _LAPACK.dtrtri(factor[count:, count:], lower=1)
        inverse = np.tril(inverse)
        own = (inverse**2).sum(axis=0)
        # A neighborhood hangs on robots that are wrong themselves, and by much the same.
        shared = inverse.T @ half[count:]
        square = own + (shared**2).sum(axis=1)
        if self.moving[0] == 0:
            square[:_AXES] = 0.0
        sd: Reals = np.sqrt(square.reshape(-1, _AXES).sum(axis=1))
        return sd
