"""Weighted residuals of what a log says, with their derivatives by positions and yaw."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tiswarm.compute.math import dock_offsets
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.measurements.odometry import displacements, owners
from tiswarm.records.sensing_log import SensingLog

MARGIN = 1.0
"""Docks this much farther apart than D may come to overlap within a round [dock radius]."""

Integers = NDArray[np.integer]
Reals = NDArray[np.float64]


class Pairs(NamedTuple):
    """Residuals of two docks each: (|p_j + T_j b - p_i - T_i a| - D) / width.

    T turns about the vertical by a robot's yaw, as far as that is solved for.
    """

    i: Integers
    j: Integers
    a: Reals
    """From the center of i to its dock, shape (pairs, 3)."""

    b: Reals
    """From the center of j to its dock, shape (pairs, 3)."""

    width: Reals
    hinge: NDArray[np.bool_]
    """Whether only overlap counts."""


class Places(NamedTuple):
    """Residuals of one coordinate each: (coordinate of p_j + T_j walk - value) / width."""

    j: Integers
    axis: Integers
    walk: Reals
    """From where the robot is to where it knows that it was, shape (places, 3)."""

    value: Reals
    width: Reals


class Problem:
    """Residuals of all positions but the anchor's and of all yaws, and their derivatives."""

    def __init__(
        self,
        log: SensingLog,
        pairs: Sequence[Pairs],
        places: Sequence[Places],
        yaw_sd: float = 0.0,
    ) -> None:
        """Gather what is to be made small.

        Args:
            log: What was sensed.
            pairs: Residuals of docks.
            places: Residuals of coordinates.
            yaw_sd: Standard deviation of a bias of yaw [rad]; solved for unless 0.
        """
        self.anchor = log.anchor_position
        self.spacing = log.spacing
        self.robots = log.robot_count
        self.yaw_sd = yaw_sd
        self.unit = log.dock_radius
        nobody, none = np.empty(0, np.int64), np.empty((0, 3))
        pairs = [_pairs(nobody, nobody, none, none, 1.0), *pairs]
        places = [Places(nobody, nobody, none, none[:, 0], none[:, 0]), *places]
        self.pairs = Pairs(*map(np.concatenate, zip(*pairs, strict=True)))
        self.places = Places(*map(np.concatenate, zip(*places, strict=True)))
        of_pair = np.arange(len(self.pairs.i))
        of_place = len(of_pair) + np.arange(len(self.places.j))
        thrice, way = np.repeat(of_pair, 3), np.arange(3)
        row, column = (
            [thrice, thrice, of_place],
            [
                (3 * self.pairs.j[:, None] - 3 + way).ravel(),
                (3 * self.pairs.i[:, None] - 3 + way).ravel(),
                3 * self.places.j - 3 + self.places.axis,
            ],
        )
        residuals, unknowns = len(of_pair) + len(of_place), 3 * self.robots - 3
        if yaw_sd:
            robot = np.arange(self.robots)
            row += [of_pair, of_pair, of_place, residuals + robot]
            turned = [self.pairs.j, self.pairs.i, self.places.j, robot]
            column += [unknowns + of_robot for of_robot in turned]
            residuals, unknowns = residuals + self.robots, unknowns + self.robots
        self.row, self.column = np.concatenate(row), np.concatenate(column)
        self.shape = (residuals, unknowns)

    def unknowns(self, position: Reals, yaw: Reals) -> Reals:
        """What is solved for: coordinates, then turns as lengths of arc at one dock radius."""
        turns = self.unit * yaw if self.yaw_sd else yaw[:0]
        return np.concatenate([position[1:].ravel(), turns])

    def poses(self, unknowns: Reals) -> tuple[Reals, Reals]:
        """All positions, the anchor's included, shape (N, 3), and yaws [rad], shape (N,)."""
        places, turns = np.split(unknowns, [3 * self.robots - 3])
        yaw = turns / self.unit if self.yaw_sd else np.zeros(self.robots)
        return np.concatenate([self.anchor[None], places.reshape(-1, 3)]), yaw

    def residuals(self, unknowns: Reals) -> Reals:
        """Everything sensed less what the poses imply, in widths."""
        position, yaw = self.poses(unknowns)
        gap = np.linalg.norm(self._apart(position, yaw), axis=1) - self.spacing
        gap = np.where(self.pairs.hinge, np.minimum(gap, 0.0), gap)
        told, robot = self.places, np.arange(len(self.places.j))
        there = position[told.j] + _turned(told.walk, yaw[told.j])
        off = there[robot, told.axis] - told.value
        prior = yaw / self.yaw_sd if self.yaw_sd else yaw[:0]
        return np.concatenate([gap / self.pairs.width, off / told.width, prior])

    def jacobian(self, unknowns: Reals) -> csr_array:
        """Derivatives of the residuals, shape (residuals, unknowns)."""
        position, yaw = self.poses(unknowns)
        apart = self._apart(position, yaw)
        distance = np.linalg.norm(apart, axis=1)
        counts = (distance > 0.0) & ~(self.pairs.hinge & (distance >= self.spacing))
        slope = np.divide(counts, distance * self.pairs.width, out=0.0 * distance, where=counts)
        by_j = slope[:, None] * apart
        data = [by_j.ravel(), -by_j.ravel(), 1.0 / self.places.width]
        if self.yaw_sd:
            i, j, told = self.pairs.i, self.pairs.j, self.places
            of_walk = _swept(told.walk, yaw[told.j])[np.arange(len(told.j)), told.axis]
            by_turn = [
                (by_j * _swept(self.pairs.b, yaw[j])).sum(axis=1),
                -(by_j * _swept(self.pairs.a, yaw[i])).sum(axis=1),
                of_walk / told.width,
                np.full(self.robots, 1.0 / self.yaw_sd),
            ]
            data += [derivative / self.unit for derivative in by_turn]
        free = self.column >= 0
        entries = (np.concatenate(data)[free], (self.row[free], self.column[free]))
        return csr_array(entries, shape=self.shape)

    def _apart(self, position: Reals, yaw: Reals) -> Reals:
        """From dock to dock of each pair, shape (pairs, 3)."""
        i, j, a, b = self.pairs[:4]
        apart: Reals = position[j] + _turned(b, yaw[j]) - position[i] - _turned(a, yaw[i])
        return apart


def _turned(arm: Reals, yaw: Reals) -> Reals:
    """Turn arms (n, 3) about the vertical by angles of shape (n,)."""
    (x, y, z), cos, sin = arm.T, np.cos(yaw), np.sin(yaw)
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def _swept(arm: Reals, yaw: Reals) -> Reals:
    """Derivative of `_turned` by the angle, shape (n, 3)."""
    x, y, z = _turned(arm, yaw).T
    return np.column_stack([-y, x, 0.0 * z])


def touching(log: SensingLog, params: LeastSquaresParams) -> Iterator[Pairs]:
    """Docks that touch, or touched at an earlier stance."""
    offset = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    width = params.contact_width * log.dock_radius
    if "contacts" in params.cues:
        i, a, j, b = log.contacts.T
        yield _pairs(i, j, offset[i, a], offset[j, b], width)
    if "walk_contacts" in params.cues and log.stances is not None:
        stance, b, i, a = log.stances.contacts.T
        then = dock_offsets(log.stances.orientation_wxyz, log.dock_offset_body)[stance, b]
        there = displacements(log, log.stances)[stance] + then
        yield _pairs(i, owners(log.stances)[stance], offset[i, a], there, width)


def close(
    log: SensingLog, params: LeastSquaresParams, position: Reals, yaw: Reals
) -> Iterator[Pairs]:
    """Docks that do not touch, of different robots, close enough to overlap soon."""
    if "non_overlap" not in params.cues:
        return
    offset = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    docks = offset.shape[1]
    reach = log.spacing + MARGIN * log.dock_radius
    points = docks_at(position, offset, yaw).reshape(-1, 3)
    pair = cKDTree(points).query_pairs(reach, output_type="ndarray").astype(np.int64)
    pair = pair[pair[:, 0] // docks != pair[:, 1] // docks]
    pair = pair[np.lexsort(pair.T)]  # in an order that does not depend on the tree
    touching = log.contacts[:, 0] * docks + log.contacts[:, 1], log.contacts[:, 2] * docks
    known = touching[0].astype(np.int64) * len(points) + touching[1] + log.contacts[:, 3]
    pair = pair[~np.isin(pair[:, 0] * len(points) + pair[:, 1], known)]
    (i, a), (j, b) = np.divmod(pair[:, 0], docks), np.divmod(pair[:, 1], docks)
    width = params.overlap_width * log.dock_radius
    yield _pairs(i, j, offset[i, a], offset[j, b], width, hinge=True)


def places_known(log: SensingLog, params: LeastSquaresParams) -> Iterator[Places]:
    """Coordinates that are known by the ground, by heights or by a whole walk."""
    height_width = params.height_width * log.dock_radius
    if "ground" in params.cues and log.ground_z is not None:
        j, dock = log.ground_docks.T
        hanging = dock_offsets(log.orientation_wxyz, log.dock_offset_body)[j, dock, 2]
        height = log.ground_z + log.dock_radius - hanging
        yield _heights(j, height, height_width)
    if "height" in params.cues:
        j = np.flatnonzero(np.isfinite(log.flip_height))
        yield _heights(j, log.flip_height[j], height_width)
    if "odometry" in params.cues and log.stances is not None:
        back = np.zeros((log.robot_count, 3))
        walked = np.flatnonzero(np.diff(log.stances.start))
        back[walked] = displacements(log, log.stances)[log.stances.start[walked]]
        j, axis = np.nonzero(np.isfinite(log.spawn_position))
        width = np.full(len(j), params.odometry_width * log.dock_radius)
        yield Places(j, axis, back[j], log.spawn_position[j, axis], width)


def _pairs(
    i: Integers, j: Integers, a: Reals, b: Reals, width: float, *, hinge: bool = False
) -> Pairs:
    """Pairs of one sort."""
    return Pairs(i, j, a, b, np.full(len(i), width), np.full(len(i), hinge))


def _heights(j: Integers, height: Reals, width: float) -> Places:
    """Heights of centers, which no turn about the vertical changes."""
    return Places(j, np.full(len(j), 2), np.zeros((len(j), 3)), height, np.full(len(j), width))


def docks_at(position: Reals, offset: Reals, yaw: Reals) -> Reals:
    """All docks, shape (N, docks, 3)."""
    turned = _turned(offset.reshape(-1, 3), np.repeat(yaw, offset.shape[1]))
    docks: Reals = position[:, None] + turned.reshape(offset.shape)
    return docks
