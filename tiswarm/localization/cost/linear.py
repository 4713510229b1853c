"""One linear problem: residuals with their covariance, priors, steps and uncertainty."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.compute.normal_equations import (
    DenseFactors,
    Factors,
    Nearby,
    SparseFactors,
    inverted,
)
from tiswarm.localization.cost.walk_noise import WalkCovariance, WalkNoise, summed

DRAWS = 64
"""Draws of all errors from which the variance of the result is computed, of few robots."""

FEW_DRAWS = 16
"""Draws of all errors from which the variance of the result is computed, of many robots."""

_BLOCK = 1024
"""Rows whose draws are kept together, 0.5 MB: many problems take the same ones."""

_MOST_DRAWN = 2_000_000
"""Errors that are drawn at once, 16 MB; several arrays are that large."""

_DENSE = 0.4
"""Pairs of unknowns that rows relate, those of two rows twice, relative to all pairs [1], from
which on information is dense: elimination would fill most of a sparse matrix."""

_FLOPPY = 1e-9
"""Information, relative to the largest one, below which nothing determines a motion."""

NOMINAL = 1e-6
"""Precision of an unknown that only other rows constrain, for which a prior is a formality."""

_CHECKED = 1e-3
"""Share of a row's variance that other rows must leave open, for the row to be checked by them."""

_LEAST_DAMPING = 1e-12
"""Precision, relative to the largest one, that stops motions that no measurement resists."""


class LinearRows(NamedTuple):
    """Rows of a linear problem, n of them."""

    residual: Reals
    """Residuals, shape (n,)."""

    row: Ints
    """Row of each derivative, shape (m,)."""

    column: Ints
    """Free unknown of each derivative, shape (m,)."""

    value: Reals
    """Derivatives, shape (m,); those at the same place add up."""

    variance: Reals
    """Variance of each row, independent of others, shape (n,)."""


@dataclass(kw_only=True)
class Linear:
    """Residuals e + J d + B w + n with unknowns d, turns w of earlier stances, and own noise n."""

    tables: list[LinearRows]
    """Measurements, overlaps, and connections."""

    noise: WalkNoise
    """B, derivatives of measurements by M turns of earlier stances."""

    column: Ints
    """Column of each unknown, -1 of those that stay, shape (U,)."""

    precision: Reals
    """One over the variance of the prior of each free unknown, shape (F,)."""

    off: Reals
    """How far unknowns are from where their priors put them, shape (F,)."""

    excess: Reals
    """Loss of each measurement beyond its square [1], shape (E,)."""

    moves: Bools
    """Robots whose shifts are free; these come first, shape (N,)."""

    nearby: Nearby = field(default_factory=Nearby)
    """Factors of problems of the same cost, by which this one is solved."""

    def __post_init__(self) -> None:
        """Compute the cost and its slope."""
        self.shifts = 3 * int(self.moves.sum())
        self.residual = np.concatenate([table.residual for table in self.tables])
        self.own_variance = np.concatenate([table.variance for table in self.tables])
        first = np.cumsum([0, *(len(table.residual) for table in self.tables)])
        row: Ints = np.concatenate([t.row + a for t, a in zip(self.tables, first, strict=False)])
        column: Ints = np.concatenate([table.column for table in self.tables])
        value: Reals = np.concatenate([table.value for table in self.tables])
        size = len(self.residual), len(self.precision)
        self.jacobian = csr_array((value, (row, column)), shape=size)
        """J of all rows, shape (n, F)."""
        measured = len(self.tables[0].residual)
        self.walked = self.noise.of.rows
        """Rows that B relates; all others are independent, shape (m,)."""
        pull = self.weighted(self.residual)
        square = self.residual * pull
        self.square = square[:measured] + self.excess
        """Part of the cost that each measurement carries [1], shape (E,)."""
        prior = self.precision * self.off**2
        # Overlaps cost, but nothing measured them: they are in no chi-square.
        self._overlapping = slice(measured, measured + len(self.tables[1].residual))
        self.overlap = float(square[self._overlapping].sum())
        """Cost of overlaps [1]."""
        of_rows = float(square.sum() + self.excess.sum()) - self.overlap
        self.chi_square = of_rows + float(prior.sum())
        """Cost of measurements and connections, and of what their noise is taken to be [1]."""
        self.cost = self.chi_square + self.overlap
        self.slope = self.jacobian.T @ pull + self.precision * self.off

    @cached_property
    def covariance(self) -> WalkCovariance:
        """B B^T and the variance of each of these rows."""
        return WalkCovariance(self.noise, self.own_variance[self.walked])

    def weighted(self, values: Reals) -> Reals:
        """Multiply values of all rows, (n,) or (n, k), by the inverse covariance."""
        weighted = ((1.0 / self.own_variance) * values.T).T
        if len(self.walked):
            columns = values[self.walked].reshape(len(self.walked), -1)
            of_walked = self.covariance.weighted(columns)
            weighted[self.walked] = of_walked.reshape(-1, *values.shape[1:])
        return np.asarray(weighted)

    def _of_rows(self, rows: Ints) -> csr_array:
        """J of some rows, shape (k, F)."""
        jacobian: Any = self.jacobian  # its stubs know no rows of an array
        return csr_array(jacobian[rows, :])

    @cached_property
    def _walked_jacobian(self) -> csr_array:
        """J of the rows that B relates, shape (m, F)."""
        return self._of_rows(self.walked)

    @cached_property
    def is_dense(self) -> bool:
        """Whether information is computed and factored as a dense matrix.

        Each row, or each walk, relates all its unknowns with each other.
        """
        count = np.diff(self.jacobian.indptr).astype(np.int64)
        count[self.walked] = 0
        related = int((count**2).sum())
        if len(self.walked):
            for batch in self.noise.of.batches(self._walked_jacobian):
                related += sum(len(columns) ** 2 for columns in batch.columns)
        return related > _DENSE * len(self.precision) ** 2

    @cached_property
    def information(self) -> csc_array | Reals:
        """J^T C^-1 J of all rows, shape (F, F)."""
        # Half of C^-1 on each side keeps the product symmetric, bit by bit.
        scale = 1.0 / np.sqrt(self.own_variance)
        scale[self.walked] = 0.0
        scaled = self.jacobian.copy()
        scaled.data *= np.repeat(scale, np.diff(scaled.indptr))
        information = csc_array(scaled.T @ scaled)
        parts = self.covariance.information(self._walked_jacobian) if len(self.walked) else ()
        if self.is_dense:
            total = information.toarray()
            for column, part in parts:
                total[column[:, None], column] += part
            return total
        if len(self.walked):
            information = information + summed(parts, len(self.precision))
        information.eliminate_zeros()
        information.sort_indices()
        return information

    def _factored(self, further: Reals, information: csc_array | Reals | None = None) -> Factors:
        """Factor information with further precision of each free unknown, shape (F,)."""
        undamped = self.information if information is None else information
        if isinstance(undamped, np.ndarray):
            dense = undamped.copy()
            dense[np.diag_indices(len(further))] += further
            return DenseFactors(dense)
        column = np.repeat(np.arange(len(further)), np.diff(undamped.indptr))
        diagonal = np.flatnonzero(undamped.indices == column)
        if len(diagonal) == len(further):
            total = undamped.copy()
            total.data[diagonal] += further
        else:  # nothing measures some unknowns
            total = csc_array(undamped + diags_array(further))
        return SparseFactors(total)

    @cached_property
    def undamped(self) -> Factors:
        """Factors of the information, priors included; problems nearby are solved by them, too.

        Not where motions are open: solutions nearby would go far along these.
        """
        damping = self._largest * _LEAST_DAMPING
        factors = self._factored(self.precision + damping)
        if factors.pivots.min(initial=np.inf) > _FLOPPY * self._largest:
            self.nearby.factors = factors
            self.nearby.unknowns = len(self.precision)
            self.nearby.damping = damping
        return factors

    @property
    def _largest(self) -> float:
        """Largest information of a single unknown, at least 1."""
        return float(self.information.diagonal().max(initial=1.0))

    def step(self, radius: float) -> tuple[Reals, Reals]:
        """Solve for the steps of free unknowns, (F,), and the turns of earlier stances, (M,).

        Steps of robots much beyond a radius [R] are damped.
        """
        precision = self.precision.copy()
        precision[: self.shifts] += radius**-2.0

        def product(step: Reals) -> Reals:
            pull = self.weighted(np.asarray(self.jacobian @ step))
            return np.asarray(self.jacobian.T @ pull) + precision * step

        solution = self.nearby.solve(product, self.slope)
        if solution is None:
            is_damped = np.isfinite(radius)
            damping = self._largest * _LEAST_DAMPING
            factors = self._factored(precision + damping) if is_damped else self.undamped
            solution = factors.solve(self.slope)
        step = -solution
        # Turns of earlier stances are in the covariance, not among the unknowns: their likeliest
        # values follow from the residuals that are left.
        weighted_residual = self.weighted(self.residual + self.jacobian @ step)
        return step, -self.noise.by_turns(weighted_residual[self.walked]).ravel()

    @property
    def log_volume(self) -> float:
        """Logarithm of the width of the minimum, the inverse square root of its determinant.

        It is up to a sum that is the same for all minima of a cost.
        """
        return -0.5 * float(np.log(np.abs(self.undamped.pivots)).sum())

    def freedom(self) -> int:
        """Count rows and priors beyond the unknowns that they determine; overlaps do not count.

        By Sylvester's law, a shifted matrix has as many negative pivots as eigenvalues below it.
        """
        says = self.precision > NOMINAL
        # Priors of shifts bound steps; they know nothing of the swarm.
        says[: self.shifts] = False
        overlap = np.zeros(len(self.residual))
        overlap[self._overlapping] = 1.0 / self.own_variance[self._overlapping]
        held = csc_array(self.jacobian.T @ diags_array(overlap) @ self.jacobian)
        shifted = np.where(says, self.precision, 0.0) - _FLOPPY * self._largest
        if isinstance(self.information, np.ndarray):
            factors = self._factored(shifted, self.information - held.toarray())
        else:
            factors = self._factored(shifted, csc_array(self.information - held))
        determined = int((factors.pivots > 0.0).sum())
        return int((overlap == 0.0).sum()) + int(says.sum()) - determined

    def gain_without(self, rows: Ints, columns: Ints) -> tuple[float, int]:
        """Predict by how much the cost falls without some rows and the priors of some unknowns.

        Without rows D it is lower by e^T (C - J P J^T)^-1 e, with their residuals e, covariance C
        and derivatives J, and the covariance P of all unknowns. A prior counts as such a row.

        Args:
            rows: Measurements, shape (k,).
            columns: Free unknowns, shape (l,).

        Returns:
            The gain [1], and how many of these k + l rows others check.
        """
        first = len(rows)
        size = len(rows) + len(columns)
        if not size:
            return 0.0, 0
        prior = first + np.arange(len(columns))
        derivative = np.zeros((size, len(self.precision)))
        covariance = np.zeros((size, size))
        derivative[:first] = self._of_rows(rows).toarray()
        derivative[prior, columns] = 1.0
        covariance[:first, :first] = inverted(self._inverse_among(rows))
        covariance[prior, prior] = 1.0 / self.precision[columns]
        # C - J P J^T is what other rows leave open of these. Rows are in R, precise beside rough
        # ones, and priors in standard deviations: in units of their own sd, eigenvalues are shares
        # of a variance. What rounding leaves of a full cancellation is far below `_CHECKED`.
        scale = 1.0 / np.sqrt(covariance.diagonal())
        open_covariance = covariance - derivative @ self.undamped.solve(derivative.T)
        value, vector = np.linalg.eigh(open_covariance * scale[:, None] * scale)
        residual = np.concatenate([self.residual[rows], self.off[columns]])
        part = vector.T @ (residual * scale)
        # A row that nothing else checks fits anything: leaving it out gains nothing.
        is_checked = value > _CHECKED
        return float((part[is_checked] ** 2 / value[is_checked]).sum()), int(is_checked.sum())

    def _inverse_among(self, rows: Ints) -> Reals:
        """Compute the inverse covariance among some rows, shape (k, k)."""
        among = np.diag(1.0 / self.own_variance[rows])
        is_walked = np.isin(rows, self.walked)
        if is_walked.any():
            order = np.argsort(self.walked)
            place = order[np.searchsorted(self.walked, rows[is_walked], sorter=order)]
            among[np.ix_(is_walked, is_walked)] = self.covariance.inverse_among(place)
        return among

    def variance(self, free: Reals | None = None, draws: int = DRAWS) -> Reals:
        """Compute the mean square error of positions from draws of all errors [R^2], shape (N,).

        Args:
            free: Orthonormal motions of all robots that do not count as errors, shape (3 N, k).
            draws: How many of them.
        """
        squares = [np.empty((self.shifts // 3, 0))]
        for _, off, _ in self._drawn(draws):
            shift = off[: self.shifts]
            if free is not None:
                moved = free[np.repeat(self.moves, 3)]
                # A motion that nothing measures is no error of the shape.
                shift -= moved @ (moved.T @ shift)
            squares.append((shift.reshape(len(squares[0]), 3, shift.shape[-1]) ** 2).sum(axis=1))
        square = np.zeros(len(self.moves))  # of those that stay
        square[self.moves] = np.concatenate(squares, axis=1).mean(axis=1)
        return square

    def shifts_by(self, error: Reals) -> Reals:
        """Compute how far errors of the last rows, (k,), shift robots [R], shape (N, 3)."""
        every = np.zeros(len(self.residual))
        shift = np.zeros((len(self.moves), 3))
        every[len(every) - len(error) :] = error
        step = self.undamped.solve(np.asarray(self.jacobian.T @ self.weighted(every)))
        shift[self.moves] = step[: self.shifts].reshape(-1, 3)
        return shift

    def residuals_of_draws(self) -> Iterator[tuple[Reals, Reals, Reals]]:
        """Draw all errors as stated, some draws at a time, and fit them.

        Yields:
            Residuals after the fit, and `square`, (E, k) both; and the chi-square, (k,), of
            k draws. There are `DRAWS` in all.
        """
        for error, off, prior_draw in self._drawn(DRAWS):
            residual = error - self.jacobian @ off
            square = residual * self.weighted(residual)
            of_rows = square.sum(axis=0) - square[self._overlapping].sum(axis=0)
            prior = (prior_draw - np.sqrt(self.precision)[:, None] * off) ** 2
            # Priors of shifts bound steps, and nominal ones say nothing.
            says = self.precision > NOMINAL
            says[: self.shifts] = False
            count = len(self.tables[0].residual)
            yield residual[:count], square[:count], of_rows + prior[says].sum(axis=0)

    def _drawn(self, draws: int) -> Iterator[tuple[Reals, Reals, Reals]]:
        """Draw errors of all rows, (n, k), and solve for those of unknowns, (F, k).

        The inverse of a sparse matrix is dense; draws of all errors take one solve. Large logs do a
        few draws at a time: only results of all are held.

        Yields:
            Both, and k draws of priors in their standard deviations, (F, k).
        """
        turns = 3 * self.noise.earlier
        rows = len(self.residual)
        every = rows + turns + len(self.precision)
        # Turns count as noise of each row, and are not drawn, where no row is of an earlier stance.
        drawn = every if len(self.walked) else every - turns
        count = max(1, min(draws, _MOST_DRAWN // max(drawn, 1)))
        for first in range(0, draws, count):
            draw = range(first, min(first + count, draws))
            error = np.sqrt(self.own_variance)[:, None] * _drawn_errors(0, rows, draw)
            if len(self.walked):
                turn_draw = _drawn_errors(rows, rows + turns, draw)
                error[self.walked] += self.noise.errors(turn_draw.reshape(-1, 3, len(draw)))
            prior_draw = _drawn_errors(rows + turns, every, draw)
            pull = self.jacobian.T @ self.weighted(error)
            pull += np.sqrt(self.precision)[:, None] * prior_draw
            yield error, self.undamped.solve(pull), prior_draw


def _drawn_errors(first: int, end: int, draws: range) -> Reals:
    """Draw standard normal errors of the rows from first to end, shape (rows, draws)."""
    blocks = range(first // _BLOCK, -(-end // _BLOCK))
    if not blocks:
        return np.empty((0, len(draws)))
    drawn = np.concatenate([_standard_errors(k, draws) for k in blocks])
    return drawn[first - _BLOCK * blocks.start : end - _BLOCK * blocks.start]


@lru_cache(maxsize=32)
def _standard_errors(block: int, draws: range) -> Reals:
    """Draw standard normal errors of the rows of a block."""
    return normal(0, "errors", np.arange(_BLOCK)[:, None] + _BLOCK * block, np.array(draws))
