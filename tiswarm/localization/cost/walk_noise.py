"""Errors of a walk's orientations: what rows of earlier stances have in common, in linear time.

A robot that was turned wrongly at a stance believes all earlier stances to be shifted: what it
sensed at these has the same error. With shifts x and turns w, stance after stance back from the
final one,

    x_s = sum of M_k w_k over all later stances k but the final one,
    error of a row at stance s = d . x_s + t . w_s + n,

where d is the row's derivative by the center, t that by the turn of its own stance, and n noise of
its own. Turns are standard normal, so that two rows, the later one e at stance s, have covariance

    d_f . u_e,  u_e = V_s d_e + M_s t_e,  V_s = sum of M_k M_k^T = covariance of x_s,

and, of the same stance, d_f . V_s d_e + t_f . t_e. Beside its diagonal blocks this matrix has rank
3: all that rows of later stances say of rows of earlier ones passes through three numbers. Its
Cholesky factor is like that (Vandebril, Van Barel and Mastronardi 2008, on semiseparable matrices).
We compute it block by block along each walk, all robots at once, and store no entry between blocks.
Lengths in R.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.normal_equations import inverted
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.odometry import Odometry

_BLOCK = 32
"""Rows of a block at most, where no stance has more: of 8 to 128 the quickest."""

_MOST_VALUES = 4_000_000
"""Entries of information that are summed at once, 32 MB."""


class WalkRows:
    """Rows that share noise of earlier stances of their robot, at all states."""

    def __init__(self, rows: Ints, robot: Ints, stance: Ints, odometry: Odometry) -> None:
        """Lay out blocks of rows.

        Args:
            rows: Rows of earlier stances with such noise, shape (n,).
            robot: Robot that sensed each measurement, shape (E,).
            stance: Stance at which it did, shape (E,).
            odometry: All S stances.
        """
        self.odometry = odometry
        order = np.lexsort((rows, -stance[rows], robot[rows]))
        self.rows = rows[order]
        """The rows, robot after robot, the latest stance of each first, shape (n,)."""
        self.stance = stance[self.rows]
        """Their stances, shape (n,)."""
        self._blocks(robot[self.rows])

    def _blocks(self, robot: Ints) -> None:
        """Cut the rows of each robot into blocks of whole stances."""
        rows = len(robot)
        is_new = np.ones(rows, np.bool_)
        is_new[1:] = self.stance[1:] != self.stance[:-1]
        of_stance = np.flatnonzero(is_new)
        count = np.diff(np.append(of_stance, rows))
        self.room = max(_BLOCK, int(count.max(initial=0)))
        """Rows that a block has room for."""
        is_first = np.zeros(rows, np.bool_)
        filled = 0
        before = -1
        for row, more, owner in zip(
            of_stance.tolist(), count.tolist(), robot[of_stance].tolist(), strict=True
        ):
            if owner != before or filled + more > self.room:
                is_first[row] = True
                filled = 0
            filled += more
            before = owner
        start = np.flatnonzero(is_first)
        block = np.cumsum(is_first) - 1
        is_first_of_robot = np.ones(len(start), np.bool_)
        is_first_of_robot[1:] = robot[start[1:]] != robot[start[:-1]]
        first_block = np.flatnonzero(is_first_of_robot)
        blocks_of_robot = np.diff(np.append(first_block, len(start)))
        depth = np.arange(len(start)) - np.repeat(first_block, blocks_of_robot)
        # The robots with most blocks first: at each depth those that have one are the first ones.
        rank = np.empty(len(first_block), np.int64)
        rank[np.argsort(-blocks_of_robot, kind="stable")] = np.arange(len(first_block))
        rank_of_block = np.repeat(rank, blocks_of_robot)
        number = np.empty(len(start), np.int64)
        number[np.lexsort((rank_of_block, depth))] = np.arange(len(start))
        active = np.bincount(depth)
        end = np.cumsum(active)
        self.levels = [slice(a, b) for a, b in zip(end - active, end, strict=True)]
        """Blocks at each depth, the first one of each robot at depth 0."""
        self.place = (number[block], np.arange(rows) - start[block])
        """Block of each row, and its place there."""
        self.blocks = len(start)
        bound = np.append(start, rows)
        self.of_robot = [
            (number[k : k + count].tolist(), bound[k : k + count + 1].tolist())
            for k, count in zip(first_block.tolist(), blocks_of_robot.tolist(), strict=True)
        ]
        """Blocks of each robot in order, and where each begins among the rows and the last ends."""

    def spread(self, value: Reals) -> Reals:
        """Write values of rows (n, k) into blocks, 0 beyond these, (blocks, room, k)."""
        every = np.zeros((self.blocks, self.room, *value.shape[1:]))
        every[self.place] = value
        return every

    @cached_property
    def is_same_stance(self) -> Bools:
        """Whether two rows of a block are of the same stance, shape (blocks, room, room)."""
        stance = np.full((self.blocks, self.room), -1)
        stance[self.place] = self.stance
        return np.asarray(stance[:, :, None] == stance[:, None, :])


class WalkNoise:
    """Derivatives of rows by turns of earlier stances, and the covariance of rows."""

    def __init__(self, rows: WalkRows, center: Reals, turn: Reals, shift: Reals) -> None:
        """Take the derivatives at a state.

        Args:
            rows: Which rows.
            center: d of each, derivative by the center, shape (n, 3).
            turn: t of each, derivative by the turn of its own stance [R], shape (n, 3).
            shift: M of each stance, how its turn shifts the center at earlier ones [R],
                0 of a final stance, shape (S, 3, 3).
        """
        self.of = rows
        self.center = center
        self.turn = turn
        self.shift = shift

    @classmethod
    def none(cls, rows: WalkRows) -> "WalkNoise":
        """Take all derivatives to be 0."""
        zero = np.zeros((len(rows.rows), AXES))
        return cls(rows, zero, zero, np.zeros((len(rows.odometry.owner), AXES, AXES)))

    @property
    def earlier(self) -> int:
        """Number of earlier stances, M."""
        odometry = self.of.odometry
        return len(odometry.owner) - len(odometry.final)

    def errors(self, turns: Reals) -> Reals:
        """Multiply turns of all stances by these derivatives.

        Args:
            turns: Turns of the M earlier stances in standard deviations, shape (M, 3, k).

        Returns:
            Errors of the rows [R], shape (n, k).
        """
        odometry = self.of.odometry
        of_stance = np.zeros((len(self.shift), *turns.shape[1:]))
        of_stance[odometry.is_earlier] = turns
        shifted = odometry.sums_of_later(self.shift @ of_stance)
        stance = self.of.stance
        by_shift = np.einsum("ni,nik->nk", self.center, shifted[stance])
        return np.asarray(by_shift + np.einsum("ni,nik->nk", self.turn, of_stance[stance]))

    def by_turns(self, value: Reals) -> Reals:
        """Multiply values of rows (n,) by the transposed derivatives, shape (M, 3)."""
        if not len(value):
            return np.zeros((self.earlier, AXES))
        by_row = csr_array(
            (value, (self.of.stance, np.arange(len(value)))), (len(self.shift), len(value))
        )
        of_center = np.asarray(by_row @ self.center)
        of_turn = np.asarray(by_row @ self.turn)
        of_earlier = self.of.odometry.sums_of_earlier(of_center)
        every = of_turn + (of_earlier[:, None] @ self.shift)[:, 0]
        return np.asarray(every[self.of.odometry.is_earlier])


class WalkCovariance:
    """Factor L of the covariance of rows, L L^T = C."""

    def __init__(self, noise: WalkNoise, own_variance: Reals) -> None:
        """Factor it block by block.

        Args:
            noise: Derivatives of n rows by turns.
            own_variance: Variance of each row that no other row shares [R^2], shape (n,).
        """
        rows = noise.of
        self.of = rows
        walked = rows.odometry.sums_of_later(noise.shift @ noise.shift.swapaxes(1, 2))
        by_shift = (walked[rows.stance] @ noise.center[:, :, None])[:, :, 0]
        by_turn = (noise.shift[rows.stance] @ noise.turn[:, :, None])[:, :, 0]
        self.center = rows.spread(noise.center)
        """d, 0 beyond the rows of a block, shape (blocks, room, 3)."""
        turn = rows.spread(noise.turn)
        within = self.center @ rows.spread(by_shift).swapaxes(1, 2) + turn @ turn.swapaxes(1, 2)
        with_earlier = rows.spread(by_shift + by_turn)
        # Only the lower triangle counts, where the row of the matrix is of an earlier stance.
        covariance = np.where(
            rows.is_same_stance, within, self.center @ with_earlier.swapaxes(1, 2)
        )
        diagonal = np.ones((rows.blocks, rows.room))
        diagonal[rows.place] = own_variance
        place = np.arange(rows.room)
        covariance[:, place, place] += diagonal
        self.inverse = np.empty_like(covariance)
        """Inverse of each diagonal block of L, shape (blocks, room, room)."""
        self.passed_on = np.empty_like(with_earlier)
        """u without what blocks before explain, whitened, shape (blocks, room, 3): the entries of
        L in rows of blocks behind are d times its transpose."""
        robots = rows.levels[0].stop if rows.levels else 0
        explained = np.zeros((robots, AXES, AXES))
        for level in rows.levels:
            of_level = explained[: level.stop - level.start]
            center = self.center[level]
            unexplained = covariance[level] - center @ of_level @ center.swapaxes(1, 2)
            factor = np.linalg.cholesky(unexplained)
            self.inverse[level] = np.tril(inverted(np.asarray(factor, np.float64)))
            self.passed_on[level] = self.inverse[level] @ (with_earlier[level] - center @ of_level)
            of_level += self.passed_on[level].swapaxes(1, 2) @ self.passed_on[level]

    @property
    def size(self) -> int:
        """Count the numbers that the factor takes."""
        return self.inverse.size + self.passed_on.size + self.center.size

    def whitened(self, value: Reals) -> Reals:
        """Multiply values of rows (n, k) by L^-1, shape (blocks, room, k)."""
        white = self.of.spread(value)
        robots = self.of.levels[0].stop
        state = np.zeros((robots, AXES, value.shape[1]))
        for level in self.of.levels:
            of_level = state[: level.stop - level.start]
            white[level] = self.inverse[level] @ (white[level] - self.center[level] @ of_level)
            of_level += self.passed_on[level].swapaxes(1, 2) @ white[level]
        return white

    def weighted(self, value: Reals) -> Reals:
        """Multiply values of rows (n, k) by C^-1, shape (n, k)."""
        white = self.whitened(value)
        robots = self.of.levels[0].stop
        state = np.zeros((robots, AXES, value.shape[1]))
        for level in reversed(self.of.levels):
            of_level = state[: level.stop - level.start]
            remaining = white[level] - self.passed_on[level] @ of_level
            white[level] = self.inverse[level].swapaxes(1, 2) @ remaining
            of_level += self.center[level].swapaxes(1, 2) @ white[level]
        return np.asarray(white[self.of.place])

    def _whitened_of_robot(self, robot: int, value: Reals) -> Reals:
        """Multiply values of all rows of one robot (m, k) by L^-1, shape (m, k)."""
        block, start = self.of.of_robot[robot]
        white = np.empty_like(value)
        state = np.zeros((AXES, value.shape[1]))
        for number, a, b in zip(block, start, start[1:], strict=False):
            count = b - a
            rows = slice(a - start[0], b - start[0])
            remaining = value[rows] - self.center[number, :count] @ state
            white[rows] = self.inverse[number, :count, :count] @ remaining
            state += self.passed_on[number, :count].T @ white[rows]
        return white

    def information(self, jacobian: csr_array) -> Iterator[csc_array]:
        """Compute J^T C^-1 J as a sum of matrices.

        Args:
            jacobian: J, derivatives of the rows by F unknowns, shape (n, F).

        Yields:
            Parts, shape (F, F).
        """
        unknowns = jacobian.shape[-1]
        start = jacobian.indptr.tolist()
        values: list[Reals] = []
        columns: list[Ints] = []
        size = 0
        for robot, (_, first) in enumerate(self.of.of_robot):
            of_rows = slice(start[first[0]], start[first[-1]])
            column, place = np.unique(jacobian.indices[of_rows], return_inverse=True)
            count = np.diff(jacobian.indptr[first[0] : first[-1] + 1])
            dense = np.zeros((len(count), len(column)))
            dense[np.repeat(np.arange(len(count)), count), place] = jacobian.data[of_rows]
            white = self._whitened_of_robot(robot, dense)
            values.append(white.T @ white)
            columns.append(np.asarray(column, np.int64))
            size += values[-1].size
            if size > _MOST_VALUES:
                yield _scattered(values, columns, unknowns)
                values = []
                columns = []
                size = 0
        yield _scattered(values, columns, unknowns)

    def inverse_among(self, chosen: Ints) -> Reals:
        """Compute C^-1 among some of the rows, given by their places 0 to n - 1, shape (k, k)."""
        among = np.zeros((len(chosen), len(chosen)))
        for robot, (_, start) in enumerate(self.of.of_robot):
            of_robot = np.flatnonzero((chosen >= start[0]) & (chosen < start[-1]))
            if not len(of_robot):
                continue
            unit = np.zeros((start[-1] - start[0], len(of_robot)))
            unit[chosen[of_robot] - start[0], np.arange(len(of_robot))] = 1.0
            white = self._whitened_of_robot(robot, unit)
            among[np.ix_(of_robot, of_robot)] = white.T @ white
        return among


def _scattered(values: list[Reals], columns: list[Ints], unknowns: int) -> csc_array:
    """Add up dense matrices, each of some unknowns, to a sparse one of all."""
    if not values:
        return csc_array((unknowns, unknowns))
    column = np.concatenate(columns)
    size = [len(part) for part in columns]
    start = np.cumsum([0, *np.repeat(size, size)])
    column_of_value = np.concatenate([np.tile(part, len(part)) for part in columns])
    value = np.concatenate([part.ravel() for part in values])
    wide = csr_array((value, column_of_value, start), shape=(len(column), unknowns))
    # Which rows of these matrices are of each unknown.
    first = np.cumsum([0, *np.bincount(column, minlength=unknowns)])
    one = np.ones(len(column))
    order = np.argsort(column, kind="stable")
    total = csr_array((one, order, first), shape=(unknowns, len(column))) @ wide
    # All are symmetric, so that rows are columns: nothing has to be transposed.
    return csc_array((total.data, total.indices, total.indptr), shape=total.shape)
