"""Expected error of positions, with measurements so far and with further ones.

It follows from the covariance of all unknowns at the estimate, to first order,

    C = (J^T V^-1 J + P)^-1,

with J the Jacobian of the measurements and V their variances. P is what is known besides: the
vector between two docks in contact has the length D and any direction, so that each of its
coordinates has the variance D^2 / 3. The same holds for ranges. Robots are within the swarm's
extent, and yaw biases have the variance that the log states. Robots that are free to turn about
others have the variance of all turns instead, shared by all that turn together. Rows R of variance
W reduce C by C R^T (W + R C R^T)^-1 R C.

Where robots are mirrored, the two likeliest solutions add the variance w w' d^2, with w and w'
their weights and d the distance of a robot between them. If they predict measurements that differ
by s standard deviations of W + R C R^T, the candidate leaves the share exp(-s^2 / 8) / 2 (w w')^1/2
of that variance, or less (the Bhattacharyya bound).
Lengths in R.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, coo_array, csc_array, diags_array, eye_array, kron

from tiswarm.base.aliases import Reals
from tiswarm.compute.normal_equations import inverted
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.measurements.odometry import ASSUMED, Odometry
from tiswarm.records.estimate import Solution
from tiswarm.records.sensing_log import SensingLog

MOST_ROBOTS = 1000
"""Expected errors of larger swarms are not computed: time grows as the cube of their size."""

_AT_ONCE = 256
"""Candidates that are judged at a time: memory."""


def odometry_without_bias(log: SensingLog) -> Odometry:
    """Follow the stances of a log; yaw biases are unknowns, and no noise of the arms."""
    noise = log.noise or ASSUMED
    if log.yaw_bias > 0.0:
        noise = replace(noise, yaw_bias_deg=0.0)
    return Odometry(log, noise)


class Images(NamedTuple):
    """The two likeliest solutions."""

    first: Reals
    """Centers in the likelier one [R], shape (N, 3)."""

    second: Reals
    """Centers in the other one [R], shape (N, 3)."""

    odds: float
    """Product of their weights, which add up to 1."""

    @classmethod
    def of(cls, images: Sequence[Solution], unit: float) -> "Images":
        """Take the first two solutions, in a log whose dock radius is `unit`."""
        first, second = images[:2]
        share = first.weight / (first.weight + second.weight)
        return cls(first.position / unit, second.position / unit, share * (1.0 - share))

    @property
    def mean_square(self) -> float:
        """Mean square error of the positions, since both may be true [R^2]."""
        return self.odds * float(((self.first - self.second) ** 2).sum(axis=1).mean())

    def change(self, rows: Measurements) -> Reals:
        """Compute by how much the measurement of each row differs between both [R], shape (E,)."""
        return rows.residual(self.second) - rows.residual(self.first)

    def remaining(self, apart: Reals) -> Reals:
        """Bound the mean square error with measurements that differ by some sd [R^2]."""
        doubt = 0.5 * np.exp(-(apart**2) / 8.0) / np.sqrt(self.odds)
        mean_square: Reals = self.mean_square * np.minimum(doubt, 1.0)
        return mean_square


class Posterior:
    """Covariance C of the centers of all but the anchor, and of the yaws where they are biased."""

    def __init__(
        self, rows: Measurements, center: Reals, yaw_bias: float, turning: Reals | None = None
    ) -> None:
        """Sum what is known.

        Args:
            rows: Measurements.
            center: Centers [R], shape (N, 3).
            yaw_bias: Standard deviation of yaws [rad].
            turning: Root mean square distance by free turns, 0 of robots that do not turn [R],
                shape (N,); none turns if None.
        """
        self.robots = rows.robots
        self.coordinates = 3 * (self.robots - 1)
        self.free = slice(3, (4 if yaw_bias > 0.0 else 3) * self.robots)
        jacobian = rows.jacobian(center)
        measured = jacobian.T @ diags_array(1.0 / rows.variance()) @ jacobian
        distances = len(rows.distances.length)
        i = rows.robot[:distances]
        j = rows.neighbor[:distances]
        ends = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
        weight = np.tile(3.0 / np.maximum(rows.distances.length, SPACING) ** 2, 4)
        turns = np.zeros(self.robots) if turning is None else turning
        weight[np.tile((turns[i] > 0.0) | (turns[j] > 0.0), 4)] = 0.0
        # As in a Laplacian: a bond holds the difference of its two ends.
        weight[2 * len(i) :] *= -1.0
        extent = (center - center.mean(axis=0)).var(axis=0).sum()
        # Of robots that are very far apart, rounding would leave nothing but a singular matrix.
        resolved = self.free.stop * np.finfo(float).eps * measured.diagonal().max(initial=0.0)
        within = max(1.0 / max(extent, SPACING**2), resolved)
        bonds = coo_array((weight, ends), shape=(self.robots, self.robots))
        own_precision = np.full(self.robots, within)
        own_precision[turns > 0.0] = turns[turns > 0.0] ** -2.0
        loose = bonds + diags_array(own_precision)
        # Without a bias yaws are no unknowns, and `free` leaves this block out.
        yaws = eye_array(self.robots) / (yaw_bias**2 or 1.0)
        precision = csc_array(measured + block_diag([kron(loose, eye_array(3)), yaws]))
        self.covariance = inverted(precision[self.free, self.free].toarray())
        square = np.trace(self.covariance[: self.coordinates, : self.coordinates])
        self.mean_square = float(square) / self.robots
        """Expected mean square error of the positions [R^2]."""

        self.difference: Reals = np.zeros(len(self.covariance))
        """How far two solutions are apart, as far as rows that were added show it [R, rad]."""

        self.apart_square = 0.0
        """Square of the difference between both solutions in the rows that were added [sd]."""

    def with_rows(
        self, jacobian: csc_array, variance: Reals, change: Reals, size: int
    ) -> tuple[Reals, Reals]:
        """Compute the expected mean square error with each of n candidates of some rows.

        Returns:
            Mean square errors [R^2], and how far a change of the measurements is beyond what is
            expected of them [sd], those that were added included, both of shape (n,).
        """
        gone = [np.empty(0)]
        apart = [np.empty(0)]
        step = size * _AT_ONCE
        for begin in range(0, len(variance), step):
            part = slice(begin, begin + step)
            rows = jacobian[part, self.free]
            spread = (rows @ self.covariance).reshape(-1, size, rows.shape[1])
            covariance = rows.toarray().reshape(spread.shape) @ spread.swapaxes(1, 2)
            covariance += variance[part].reshape(-1, size, 1) * np.eye(size)
            shift = spread[:, :, : self.coordinates]
            # The trace of S^T W^-1 S is that of W^-1 S S^T, a matrix as small as a candidate.
            drop = np.linalg.solve(covariance, shift @ shift.swapaxes(1, 2))
            gone.append(np.trace(drop, axis1=1, axis2=2))
            off = (change[part] - rows @ self.difference).reshape(-1, size, 1)
            square = (off * np.linalg.solve(covariance, off)).sum(axis=(1, 2))
            apart.append(np.sqrt(square + self.apart_square))
        return self.mean_square - np.concatenate(gone) / self.robots, np.concatenate(apart)

    def add(self, jacobian: csc_array, variance: Reals, change: Reals) -> None:
        """Take further rows as measured.

        Args:
            jacobian: Derivatives of the rows by all centers and yaws.
            variance: Variances of the rows [R^2], shape (E,).
            change: By how much two solutions differ in each row [R], shape (E,).
        """
        rows = jacobian[:, self.free]
        spread = rows @ self.covariance
        covariance = rows @ spread.T + np.diag(variance)
        off = change - rows @ self.difference
        self.apart_square += float(off @ np.linalg.solve(covariance, off))
        self.difference = self.difference + spread.T @ np.linalg.solve(covariance, off)
        # Woodbury's formula, by which only a matrix of the few new rows is solved for.
        self.covariance -= spread.T @ np.linalg.solve(covariance, spread)
        square = np.trace(self.covariance[: self.coordinates, : self.coordinates])
        self.mean_square = float(square) / self.robots
