"""All robots at once by a general optimiser: the reference that other methods are held against.

The sum of squares has many minima. From a poor start least squares ends in a poor one: robots
on the wrong side of their contacts, held there by docks that may not overlap.
"""

from collections.abc import Hashable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tiswarm.compute.rotations import dock_offsets
from tiswarm.localization import virtual_force
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.records.contact_graph import located
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.walks import displacements, owners

MARGIN = 1.0
"""Docks this much farther apart than D may come to overlap within a round [dock radius]."""

SETTLED = 1e-6
"""The rounds end when one lowers the cost by less than this part."""

Integers = NDArray[np.integer]
Reals = NDArray[np.float64]


class Pairs(NamedTuple):
    """Residuals of two docks each: (|p_j - p_i + shift| - D) / width."""

    i: Integers
    j: Integers
    shift: Reals
    """From the dock of i to that of j, both seen from their centers, shape (pairs, 3)."""

    width: Reals
    hinge: NDArray[np.bool_]
    """Whether only overlap counts."""


class Places(NamedTuple):
    """Residuals of one coordinate each: (coordinate of p_j - value) / width."""

    j: Integers
    axis: Integers
    value: Reals
    width: Reals


def batch_key(log: SensingLog, params: LeastSquaresParams) -> Hashable:
    """Name what logs must share to be started in one launch."""
    return virtual_force.batch_key(log, params.start)


def localize_batch(
    logs: Sequence[SensingLog], params: Sequence[LeastSquaresParams]
) -> list[Estimate]:
    """Localize structures one after the other, started side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.

    Returns:
        One estimate a log. The residual is the root mean square of distance less D of the
        docks in contact, in the log's unit.
    """
    starts = virtual_force.localize_batch(logs, [p.start for p in params])
    return [
        improve(log, p, start.position) for log, p, start in zip(logs, params, starts, strict=True)
    ]


def improve(log: SensingLog, params: LeastSquaresParams, start: Reals) -> Estimate:
    """Move robots from given positions until the weighted residuals are as small as they get.

    Args:
        log: What the swarm sensed.
        params: Settings.
        start: Positions to start from, in the log's unit, shape (N, 3).
    """
    position = np.concatenate([log.anchor_position[None], start[1:]])
    trace, iteration, cost = [position], [0], np.inf
    touching, places = list(_touching(log, params)), list(_places(log, params))
    for _ in range(params.rounds if log.robot_count > 1 else 0):
        problem = Problem(log, [*touching, *_close(log, params, position)], places)
        found = least_squares(  # type: ignore[operator]  # the stubs take it for a module
            problem.residuals,
            position[1:].ravel(),
            jac=problem.jacobian,
            method="trf",
            tr_solver="lsmr",
            loss=params.loss,
            max_nfev=params.evaluations,
        )
        position = problem.positions(found.x)
        trace.append(position)
        iteration.append(iteration[-1] + found.nfev)
        if found.status > 0 and found.cost >= (1.0 - SETTLED) * cost:
            break
        cost = found.cost
    return Estimate(
        robot_id=log.robot_id,
        position=position,
        located=located(log),
        iteration=np.array(iteration),
        trace=np.array(trace),
        residual=np.array([_stretch(log, frame) for frame in trace]),
    )


class Problem:
    """Residuals of all but the anchor's positions, and their derivatives."""

    def __init__(self, log: SensingLog, pairs: Sequence[Pairs], places: Sequence[Places]) -> None:
        """Gather what is to be made small."""
        self.anchor = log.anchor_position
        self.spacing = log.spacing
        nobody = np.empty(0, np.int64)
        none = np.empty(0)
        pairs = [_pairs(nobody, nobody, np.empty((0, 3)), 1.0), *pairs]
        places = [Places(nobody, nobody, none, none), *places]
        self.pairs = Pairs(*map(np.concatenate, zip(*pairs, strict=True)))
        self.places = Places(*map(np.concatenate, zip(*places, strict=True)))
        of_pair = np.repeat(np.arange(len(self.pairs.i)), 3)
        of_place = len(self.pairs.i) + np.arange(len(self.places.j))
        self.row = np.concatenate([of_pair, of_pair, of_place])
        way = np.arange(3)
        self.column = np.concatenate(
            [
                (3 * self.pairs.j[:, None] - 3 + way).ravel(),
                (3 * self.pairs.i[:, None] - 3 + way).ravel(),
                3 * self.places.j - 3 + self.places.axis,
            ]
        )
        self.shape = (len(of_pair) // 3 + len(of_place), 3 * log.robot_count - 3)

    def positions(self, unknowns: Reals) -> Reals:
        """All positions, the anchor's included, shape (N, 3)."""
        return np.concatenate([self.anchor[None], unknowns.reshape(-1, 3)])

    def residuals(self, unknowns: Reals) -> Reals:
        """Everything sensed less what the positions imply, in widths."""
        position = self.positions(unknowns)
        gap = np.linalg.norm(self._apart(position), axis=1) - self.spacing
        gap = np.where(self.pairs.hinge, np.minimum(gap, 0.0), gap)
        off = position[self.places.j, self.places.axis] - self.places.value
        return np.concatenate([gap / self.pairs.width, off / self.places.width])

    def jacobian(self, unknowns: Reals) -> csr_array:
        """Derivatives of the residuals, shape (residuals, unknowns)."""
        apart = self._apart(self.positions(unknowns))
        distance = np.linalg.norm(apart, axis=1)
        counts = (distance > 0.0) & ~(self.pairs.hinge & (distance >= self.spacing))
        slope = np.divide(counts, distance * self.pairs.width, out=0.0 * distance, where=counts)
        by_j = (slope[:, None] * apart).ravel()
        data = np.concatenate([by_j, -by_j, 1.0 / self.places.width])
        free = self.column >= 0
        entries = (data[free], (self.row[free], self.column[free]))
        return csr_array(entries, shape=self.shape)

    def _apart(self, position: Reals) -> Reals:
        """From dock to dock of each pair, shape (pairs, 3)."""
        apart: Reals = position[self.pairs.j] - position[self.pairs.i] + self.pairs.shift
        return apart


def _touching(log: SensingLog, params: LeastSquaresParams) -> Iterator[Pairs]:
    """Docks that touch, or touched at an earlier stance."""
    offset = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    width = params.contact_width * log.dock_radius
    if "contacts" in params.cues:
        i, a, j, b = log.contacts.T
        yield _pairs(i, j, offset[j, b] - offset[i, a], width)
    if "walk_contacts" in params.cues and log.stances is not None:
        stance, b, i, a = log.stances.contacts.T
        then = dock_offsets(log.stances.orientation_wxyz, log.dock_offset_body)[stance, b]
        shift = displacements(log, log.stances)[stance] + then - offset[i, a]
        yield _pairs(i, owners(log.stances)[stance], shift, width)


def _close(log: SensingLog, params: LeastSquaresParams, position: Reals) -> Iterator[Pairs]:
    """Docks that do not touch, of different robots, close enough to overlap soon."""
    if "non_overlap" not in params.cues:
        return
    offset = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    docks = offset.shape[1]
    reach = log.spacing + MARGIN * log.dock_radius
    points = (position[:, None] + offset).reshape(-1, 3)
    pair = cKDTree(points).query_pairs(reach, output_type="ndarray").astype(np.int64)
    pair = pair[pair[:, 0] // docks != pair[:, 1] // docks]
    pair = pair[np.lexsort(pair.T)]  # in an order that does not depend on the tree
    touching = log.contacts[:, 0] * docks + log.contacts[:, 1], log.contacts[:, 2] * docks
    known = touching[0].astype(np.int64) * len(points) + touching[1] + log.contacts[:, 3]
    pair = pair[~np.isin(pair[:, 0] * len(points) + pair[:, 1], known)]
    (i, a), (j, b) = np.divmod(pair[:, 0], docks), np.divmod(pair[:, 1], docks)
    width = params.overlap_width * log.dock_radius
    yield _pairs(i, j, offset[j, b] - offset[i, a], width, hinge=True)


def _places(log: SensingLog, params: LeastSquaresParams) -> Iterator[Places]:
    """Coordinates that are known by the ground, by heights or by a whole walk."""
    height_width = params.height_width * log.dock_radius
    if "ground" in params.cues and log.ground_z is not None:
        j, dock = log.ground_docks.T
        hanging = dock_offsets(log.orientation_wxyz, log.dock_offset_body)[j, dock, 2]
        height = log.ground_z + log.dock_radius - hanging
        yield Places(j, np.full(len(j), 2), height, np.full(len(j), height_width))
    if "height" in params.cues:
        j = np.flatnonzero(np.isfinite(log.flip_height))
        yield Places(j, np.full(len(j), 2), log.flip_height[j], np.full(len(j), height_width))
    if "odometry" in params.cues and log.stances is not None:
        back = np.zeros((log.robot_count, 3))
        walked = np.flatnonzero(np.diff(log.stances.start))
        back[walked] = displacements(log, log.stances)[log.stances.start[walked]]
        j, axis = np.nonzero(np.isfinite(log.spawn_position))
        width = np.full(len(j), params.odometry_width * log.dock_radius)
        yield Places(j, axis, (log.spawn_position - back)[j, axis], width)


def _pairs(i: Integers, j: Integers, shift: Reals, width: float, *, hinge: bool = False) -> Pairs:
    """Pairs of one sort."""
    return Pairs(i, j, shift, np.full(len(i), width), np.full(len(i), hinge))


def _stretch(log: SensingLog, position: Reals) -> float:
    """Root mean square of distance less D of the docks in contact, in the log's unit."""
    i, a, j, b = log.contacts.T
    dock = position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    gap = np.linalg.norm(dock[j, b] - dock[i, a], axis=1) - log.spacing
    return float(np.sqrt(np.mean(gap**2))) if len(gap) else 0.0
