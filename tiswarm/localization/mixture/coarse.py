"""Coarse starts: centers of robots and directions of contacts, solved for in turn.

Orientations are sensed, so a contact of robots i and j says p_i - p_j + s = D u, with a known
vector s and an unknown unit vector u. Given all u, all centers p follow from one sparse linear
problem; given all p, each u is a projection. In turn they lower one sum of squares, as local and
global steps do for shapes that are as rigid as possible (Sorkine and Alexa, Symposium on Geometry
Processing 2007). All robots move at once, so that errors do not travel along chains of contacts.
Measurements may be missed by a standard deviation that falls. Lengths in R.
"""

from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import normal
from tiswarm.compute.normal_equations import SparseFactors
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.cost import EXTENSION
from tiswarm.measurements.equations import AXES

_MISSES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.06)
"""Standard deviations by which measurements may be missed, one after the other [R]."""

_ROUNDS = 12
"""Rounds at each of them [1]."""

_AHEAD = 0.7
"""Share of the last change of centers by which directions are ahead of them [1]."""

_ROBUST_SD = 3.0
"""Width of Cauchy's loss of a link in standard deviations [1]."""

_AXIS = np.arange(AXES)
_LEAST = 1e-6
"""Precision of each coordinate beside its measurements [R^-2]."""

_TINY = 1e-9
"""Length of a vector without a direction [R]."""


class _Sum:
    """The sum of squares of C links and P planes of N robots, for K starts."""

    def __init__(self, problem: Problem, anchor: Reals) -> None:
        """Gather derivatives, and what residuals are at the origin.

        Args:
            problem: Measurements.
            anchor: Center of the anchor [R], shape (3,).
        """
        links = len(problem.link)
        planes = problem.planes
        point = planes.point.copy()
        point[:, :2] -= planes.walk
        row = np.arange(AXES * links)
        of_planes = AXES * links + np.repeat(np.arange(len(planes.robot)), AXES)
        column = [problem.robot, problem.neighbor, planes.robot]
        jacobian: Any = csr_array(  # its stubs know no columns of an array
            (
                np.concatenate([np.ones(len(row)), -np.ones(len(row)), planes.direction.ravel()]),
                (
                    np.concatenate([row, row, of_planes]),
                    np.concatenate([(AXES * k[:, None] + _AXIS).ravel() for k in column]),
                ),
            ),
            shape=(len(row) + len(planes.robot), AXES * len(problem.part)),
        )
        self.shift = problem.shift[:, :, None]
        """s, shape (C, 3, 1)."""
        at_origin = -(planes.direction * point).sum(axis=1)
        self.constant = np.concatenate([self.shift.ravel(), at_origin])
        self.constant += jacobian[:, :AXES] @ anchor
        self.jacobian = csr_array(jacobian[:, AXES:])
        """Derivatives by centers but the anchor's, shape (3 C + P, 3 (N - 1))."""
        self.of_links = csr_array(jacobian[: len(row), AXES:])
        self.length = problem.length[:, None, None]
        self.variance = problem.variance[problem.link]
        self.plane_variance = 1.0 / planes.precision
        is_extending = problem.is_final & ~problem.is_offset
        # As for chains: robots in contact rather extend than fold.
        self.extension = (EXTENSION * is_extending / problem.fewest)[:, None, None]

    def vectors(self, center: Reals) -> Reals:
        """Compute p_i - p_j + s of centers (3 (N - 1), K), shape (C, 3, K)."""
        vector = self.of_links @ center + self.constant[: self.of_links.shape[0], None]
        return np.asarray(vector.reshape(len(self.length), AXES, center.shape[1]))

    def lowered(self, center: Reals, direction: Reals, miss: float, missed: Reals) -> Reals:
        """Solve for centers and for directions in turn, for some rounds.

        Args:
            center: Centers where rounds begin [R], shape (3 (N - 1), K).
            direction: u of each link there, shape (C, 3, K).
            miss: Standard deviation by which measurements may be missed [R].
            missed: Square by which each link is missed [R^2], shape (C,).

        Returns:
            Centers where they end.
        """
        weight = 1.0 / (self.variance + miss**2)
        weight /= 1.0 + weight * missed / _ROBUST_SD**2
        of_planes = 1.0 / (self.plane_variance + miss**2)
        precision = np.concatenate([np.repeat(weight, AXES), of_planes])
        information = self.jacobian.T @ diags_array(precision) @ self.jacobian
        information += diags_array(np.full(len(center), _LEAST))
        factors = SparseFactors(csc_array(information))
        weighted: Any = csr_array(self.jacobian.T @ diags_array(precision))
        of_links = weighted[:, : self.of_links.shape[0]]
        pull = -(weighted @ self.constant)[:, None]
        for _ in range(_ROUNDS):
            between = self.vectors(center) - self.shift
            goal = self.length * direction + self.extension * _unit(between) / weight[:, None, None]
            last = center
            center = factors.solve(pull + of_links @ goal.reshape(-1, center.shape[1]))
            direction = _unit(self.vectors(center + _AHEAD * (center - last)))
        return center


def coarse_starts(problem: Problem, anchor: Reals, seed: int, starts: int) -> Reals:
    """Place all robots by directions drawn at random about where docks point.

    Docks that overlap do not push each other, and yaw is taken as sensed.

    Args:
        problem: Measurements of N robots.
        anchor: Center of the anchor [R], shape (3,).
        seed: Seed of the directions.
        starts: K.

    Returns:
        Centers [R], shape (K, N, 3).
    """
    robots = len(problem.part)
    if robots == 1:
        return np.tile(anchor, (starts, 1, 1))
    squares = _Sum(problem, anchor)
    index = np.arange(squares.of_links.shape[0]).reshape(-1, AXES, 1)
    drawn = normal(seed, "directions", index, np.arange(starts))
    direction = _unit(_unit(drawn) - _unit(squares.shift))
    center = np.repeat(np.tile(anchor, robots - 1)[:, None], starts, axis=1)
    missed = np.zeros(len(squares.variance))
    for miss in _MISSES:
        center = squares.lowered(center, direction, miss, missed)
        vector = squares.vectors(center)
        direction = _unit(vector)
        gap = np.linalg.norm(vector, axis=1) - squares.length[:, 0]
        missed = np.median(gap**2, axis=1)
    place = np.concatenate([np.repeat(anchor[:, None], starts, axis=1), center])
    return np.asarray(place.T.reshape(starts, robots, AXES))


def _unit(vector: Reals) -> Reals:
    """Divide vectors (C, 3, K) by their lengths."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.asarray(vector / np.maximum(length, _TINY))
