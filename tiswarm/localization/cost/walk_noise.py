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

from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.normal_equations import inverted
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.odometry import Odometry

_BLOCK = 32
"""Rows of a block at most, where no stance has more: of 8 to 128 the quickest."""

_MOST_VALUES = 2_000_000
"""Derivatives that are whitened, and entries that are summed, at once, 16 MB."""

_MOST_PADDING = 2.0
"""Size of an array of several robots, relative to that of what they fill of it [1]."""


class Batch(NamedTuple):
    """Derivatives of rows of k robots in one dense array, each robot with its own unknowns."""

    ranks: slice
    """The robots."""

    shape: tuple[int, int, int, int]
    """Shape of the array: robots, blocks of a robot, rows of a block, unknowns of a robot."""

    entry: Ints
    """Stored entries of the sparse derivatives that are in it, shape (m,)."""

    place: Ints
    """Place of each of these in the array, flattened, shape (m,)."""

    columns: list[Ints]
    """Unknowns of each robot, ascending, shape (C,)."""


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
        self._batches: list[Batch] | None = None

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
        order = np.argsort(-blocks_of_robot, kind="stable")
        rank[order] = np.arange(len(first_block))
        rank_of_block = np.repeat(rank, blocks_of_robot)
        number = np.empty(len(start), np.int64)
        number[np.lexsort((rank_of_block, depth))] = np.arange(len(start))
        active = np.bincount(depth)
        end = np.cumsum(active)
        self.levels = [slice(a, b) for a, b in zip(end - active, end, strict=True)]
        """Blocks at each depth, the first one of each robot at depth 0."""
        self.place = (number[block], np.arange(rows) - start[block])
        """Block of each row, and its place there."""
        self.depth = depth[block]
        """Depth of the block of each row, shape (n,)."""
        self.rank = rank_of_block[block]
        """Rank of the robot of each row, shape (n,)."""
        self.blocks = len(start)
        self.blocks_of_rank = blocks_of_robot[order]
        """Number of blocks of each robot, descending, shape (robots,)."""

    def spread(self, value: Reals) -> Reals:
        """Write values of rows (n, k) into blocks, 0 beyond these, (blocks, room, k)."""
        every = np.zeros((self.blocks, self.room, *value.shape[1:]))
        every[self.place] = value
        return every

    def blocks_at(self, depth: int, ranks: slice) -> slice:
        """Find the blocks at a depth of consecutive robots, those that have one."""
        level = self.levels[depth]
        return slice(level.start + ranks.start, min(level.start + ranks.stop, level.stop))

    def batches(self, jacobian: csr_array) -> list[Batch]:
        """Lay out derivatives of the rows, (n, F), which are at the same places at all states."""
        if self._batches is None:
            self._batches = self._batched(jacobian)
        return self._batches

    def _batched(self, jacobian: csr_array) -> list[Batch]:
        """Lay out derivatives of the rows, (n, F), those of robots of a similar size together."""
        unknowns = jacobian.shape[-1]
        row = np.repeat(np.arange(len(self.rows)), np.diff(jacobian.indptr))
        rank = self.rank[row]
        key, of_entry = np.unique(rank * unknowns + jacobian.indices, return_inverse=True)
        robots = len(self.blocks_of_rank)
        first = np.searchsorted(key, unknowns * np.arange(robots + 1))
        width = np.diff(first)
        order = np.argsort(rank, kind="stable")
        bound = np.searchsorted(rank[order], np.arange(robots + 1))
        batches = []
        for ranks in self._ranges(width):
            entry = order[bound[ranks.start] : bound[ranks.stop]]
            shape = (
                ranks.stop - ranks.start,
                int(self.blocks_of_rank[ranks.start]),
                self.room,
                int(width[ranks].max()),
            )
            at = (
                rank[entry] - ranks.start,
                self.depth[row[entry]],
                self.place[1][row[entry]],
                of_entry[entry] - first[rank[entry]],
            )
            columns = [
                key[first[number] : first[number + 1]] - unknowns * number
                for number in range(ranks.start, ranks.stop)
            ]
            place = np.ravel_multi_index(at, shape)
            batches.append(Batch(ranks, shape, entry, place, columns))
        return batches

    def _ranges(self, width: Ints) -> Iterator[slice]:
        """Cut the robots into ranges that leave little of an array empty.

        Args:
            width: Number of unknowns of each robot in order of rank, shape (robots,).
        """
        start = 0
        widest = 0
        filled = 0
        size = self.room * self.blocks_of_rank * width
        for rank in range(len(width)):
            widest = max(widest, int(width[rank]))
            filled += int(size[rank])
            count = rank + 1 - start
            whole = count * self.room * int(self.blocks_of_rank[start]) * widest
            if count > 1 and whole > min(_MOST_VALUES, _MOST_PADDING * filled):
                yield slice(start, rank)
                start = rank
                widest = int(width[rank])
                filled = int(size[rank])
        if start < len(width):
            yield slice(start, len(width))

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
        stance = self.of.stance
        stances = len(self.shift)

        def of_stances(slope: Reals) -> Reals:
            parts = [np.bincount(stance, value * part, stances) for part in slope.T]
            return np.stack(parts, axis=1)

        of_center = of_stances(self.center)
        of_turn = of_stances(self.turn)
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

    def information(self, jacobian: csr_array) -> Iterator[tuple[Ints, Reals]]:
        """Compute J^T C^-1 J as a sum of dense matrices, one of each robot.

        Args:
            jacobian: J, derivatives of the rows by F unknowns, shape (n, F).

        Yields:
            Unknowns of the matrix, shape (C,), and the matrix, shape (C, C).
        """
        for batch in self.of.batches(jacobian):
            white = np.zeros(batch.shape)
            white.reshape(-1)[batch.place] = jacobian.data[batch.entry]
            self._whiten(batch.ranks, white)
            robots, blocks, room, width = batch.shape
            rows = white.reshape(robots, blocks * room, width)
            for columns, product in zip(batch.columns, rows.swapaxes(1, 2) @ rows, strict=True):
                yield columns, product[: len(columns), : len(columns)]

    def _whiten(self, ranks: slice, value: Reals) -> None:
        """Multiply values of consecutive robots (robots, blocks, room, k) by L^-1."""
        state = np.zeros((len(value), AXES, value.shape[-1]))
        for depth in range(value.shape[1]):
            blocks = self.of.blocks_at(depth, ranks)
            at = slice(0, blocks.stop - blocks.start)
            remaining = value[at, depth] - self.center[blocks] @ state[at]
            value[at, depth] = self.inverse[blocks] @ remaining
            state[at] += self.passed_on[blocks].swapaxes(1, 2) @ value[at, depth]

    def inverse_among(self, chosen: Ints) -> Reals:
        """Compute C^-1 among some of the rows, given by their places 0 to n - 1, shape (k, k)."""
        among = np.zeros((len(chosen), len(chosen)))
        rank = self.of.rank[chosen]
        for robot in np.unique(rank).tolist():
            of_robot = np.flatnonzero(rank == robot)
            rows = chosen[of_robot]
            unit = np.zeros((1, int(self.of.blocks_of_rank[robot]), self.of.room, len(of_robot)))
            unit[0, self.of.depth[rows], self.of.place[1][rows], np.arange(len(rows))] = 1.0
            self._whiten(slice(robot, robot + 1), unit)
            white = unit.reshape(-1, len(rows))
            among[np.ix_(of_robot, of_robot)] = white.T @ white
        return among


def summed(parts: Iterable[tuple[Ints, Reals]], unknowns: int) -> csc_array:
    """Add up dense matrices, each of some unknowns, to a sparse one of all.

    Args:
        parts: Unknowns of each matrix, shape (C,), and the symmetric matrix, shape (C, C).
        unknowns: Number of all unknowns, F.

    Returns:
        The sum, shape (F, F).
    """
    # Sums of equally many parts are added, so that each entry is in few additions.
    sums: list[tuple[int, csc_array]] = []
    for columns, values in _chunks(parts):
        count = 1
        part = _scattered(columns, values, unknowns)
        while sums and sums[-1][0] == count:
            part = csc_array(sums.pop()[1] + part)
            count *= 2
        sums.append((count, part))
    if not sums:
        return csc_array((unknowns, unknowns))
    total = sums.pop()[1]
    for _, part in reversed(sums):
        total = csc_array(total + part)
    return total


def _chunks(parts: Iterable[tuple[Ints, Reals]]) -> Iterator[tuple[list[Ints], list[Reals]]]:
    """Gather matrices, each with its unknowns, as many as may be summed at once."""
    columns: list[Ints] = []
    values: list[Reals] = []
    size = 0
    for column, value in parts:
        columns.append(column)
        values.append(value)
        size += value.size
        if size > _MOST_VALUES:
            yield columns, values
            columns = []
            values = []
            size = 0
    if columns:
        yield columns, values


def _scattered(columns: list[Ints], values: list[Reals], unknowns: int) -> csc_array:
    """Add up some of such matrices."""
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
