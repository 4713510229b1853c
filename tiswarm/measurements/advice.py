"""Which further contact, height or known position would constrain a swarm most.

A candidate removes as many floppy modes as its rows have rank on the floppy motions. The expected
error follows from the covariance of all unknowns at the estimate, to first order,

    C = (J^T V^-1 J + P)^-1,

with J the Jacobian of the measurements and V their variances. P is what is known besides: the
vector between two docks in contact has the length D and any direction, so that each of its
coordinates has the variance D^2 / 3. The same holds for ranges. Robots are within the swarm's
extent, and yaw biases have the variance that the log states. Rows R of variance W reduce C by
C R^T (W + R C R^T)^-1 R C.

Where robots are mirrored, the two likeliest solutions add the variance w w' d^2, with w and w'
their weights and d the distance of a robot between them. If they predict measurements that differ
by s standard deviations of W + R C R^T, the candidate leaves the share exp(-s^2 / 8) / 2 (w w')^1/2
of that variance, or less (the Bhattacharyya bound).
Lengths in R.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import block_diag, coo_array, csc_array, diags_array, eye_array, kron
from scipy.spatial.distance import cdist

from tiswarm.base.aliases import Ints, Reals
from tiswarm.measurements.contacts import close_docks
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import CENTER, Odometry
from tiswarm.measurements.orientations import ASSUMED
from tiswarm.measurements.rigidity import floppy_motions, further_rows, weld
from tiswarm.measurements.rows import SPACING, Coordinates, Distances
from tiswarm.records.estimate import Solution
from tiswarm.records.sensing_log import SensingLog

MOST_ROBOTS = 1000
"""Expected errors of larger swarms are not computed: time grows as the cube of their size."""

_EACH = 3
"""Candidates of each kind that are worth showing."""

_GAIN = 0.01
"""Reduction of the expected error from which on a candidate is worth showing [1]."""

_GAP = 1.0
"""Greatest gap between docks, at the estimate, that may touch in truth [R]."""

_SEEN = 1e-3
"""A floppy motion counts as measured if this part of it changes a measurement."""

_AT_ONCE = 256
"""Candidates that are judged at a time: memory."""

_DECISIVE = 5.0
"""Difference between two solutions from which on a measurement excludes one of them [sd]."""

Kind = Literal["contact", "height", "position", "range"]


class Advice(NamedTuple):
    """A further measurement, and what it would gain."""

    kind: Kind

    robot: int
    """Robot to measure, by join order."""

    contact: list[int]
    """Own dock, other robot and its dock, CENTER for docks of a range; empty for other kinds."""

    floppy_modes: int
    """Floppy modes that it removes."""

    determined: Ints
    """Robots that are floppy without it and not with it."""

    rmse_before: float
    """Expected error without it [log unit]; NaN for more than `MOST_ROBOTS` robots."""

    rmse_after: float
    """Expected error with it [log unit]; NaN for more than `MOST_ROBOTS` robots."""

    images_apart_sd: float
    """Difference that it would have between the two likeliest solutions, in standard deviations of
    what is expected; NaN without them."""


class _Candidates(NamedTuple):
    """Further measurements of one kind, n in all."""

    kind: Kind

    rows: Measurements
    """Rows of the first, then of the second and so on, shape (n size,)."""

    size: int
    """Rows of each."""


def advise(
    log: SensingLog, cues: Collection[str], position: Reals, images: Sequence[Solution] = ()
) -> list[Advice] | None:
    """Find the few further contacts, heights and known positions that are worth most.

    Contacts are between docks that are close to each other in the estimate. They are as precise as
    `Precision.contact`, heights and positions as `Precision.height`. Where there are images and the
    log has ranges, further ranges of their median precision are candidates, too.

    Args:
        log: What was sensed.
        cues: Cues in use.
        position: Estimated centers, in the log's unit, shape (N, 3).
        images: Solutions between which robots are mirrored, the likeliest first; the first two
            count. Positions are then those of the first.

    Returns:
        Advice by expected error, or by floppy modes for more than `MOST_ROBOTS` robots; the best
        comes first. None if there are too many robots or loops to find them.
    """
    noise = log.noise or ASSUMED
    yaw_unknown = log.yaw_bias > 0.0  # then it is an unknown, and no noise of the arms
    odometry = Odometry(log, replace(noise, yaw_bias_deg=0.0) if yaw_unknown else noise)
    pair = _Images.of(images, log.dock_radius) if len(images) > 1 else None
    center = position / log.dock_radius if pair is None else pair.first
    rows = measure(log, cues, odometry=odometry).associated(center)
    bodies = weld(rows, center, yaw_unknown=yaw_unknown)
    motions = floppy_motions(bodies)
    if motions is None:
        return None
    if len(center) == 1:
        return []
    floppy, moved = motions.robots(), motions.of_robots()
    is_small = len(center) <= MOST_ROBOTS
    posterior = _Posterior(rows.averaged(), center, log.yaw_bias) if is_small else None
    advice = []
    candidates = [*_candidates(log, odometry, center)]
    if pair is not None and len(log.ranges) and len(center) <= MOST_ROBOTS:
        candidates.append(_ranges(log, odometry, pair))
    for kind, further, size in candidates:
        jacobian, variance = further.jacobian(center), further.variance()
        change = np.zeros(len(further)) if pair is None else pair.change(further)
        modes = _rank(jacobian, moved, size)
        if bodies.has_gauge_yaw and kind == "position":  # it fixes the gauge, which is no mode
            modes -= (center[1:, :2] != center[0, :2]).any(axis=1)
        before, after = np.nan, modes * np.nan
        apart = np.sqrt((change**2 / variance).reshape(-1, size).sum(axis=1))
        if posterior is not None:
            before = posterior.mean_square
            after, apart = posterior.with_rows(jacobian, variance, change, size)
        if pair is not None:
            before, after = before + pair.mean_square, after + pair.left(apart)
        helps = (modes > 0) | (after < (1.0 - _GAIN) ** 2 * before) | (apart > _DECISIVE)
        best = np.lexsort((-modes, -apart, after, ~helps))[: min(_EACH, helps.sum())]
        for chosen in best.tolist():
            one = further.select(np.arange(len(further)) // size == chosen)
            left = motions.robots(further_rows(bodies, one, center))
            rmse = log.dock_radius * np.sqrt([before, after[chosen]])
            advice.append(
                Advice(
                    kind=kind,
                    robot=int(one.robot[0]),
                    contact=one.sensed_contacts[0, 2:].tolist() if len(one.other) else [],
                    floppy_modes=int(modes[chosen]),
                    determined=np.flatnonzero(floppy & ~left),
                    rmse_before=float(rmse[0]),
                    rmse_after=float(rmse[1]),
                    images_apart_sd=np.nan if pair is None else float(apart[chosen]),
                )
            )
    keys = [[-a.floppy_modes, -a.images_apart_sd, a.rmse_after] for a in advice]
    order = np.lexsort(np.reshape(keys, (-1, 3)).T)
    return [advice[place] for place in order.tolist()]


class _Images(NamedTuple):
    """The two likeliest solutions."""

    first: Reals
    """Centers in the likelier one [R], shape (N, 3)."""

    second: Reals
    """Centers in the other one [R], shape (N, 3)."""

    odds: float
    """Product of their weights, which add up to 1."""

    @classmethod
    def of(cls, images: Sequence[Solution], unit: float) -> "_Images":
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

    def left(self, apart: Reals) -> Reals:
        """Bound the mean square error with measurements that differ by some sd [R^2]."""
        doubt = 0.5 * np.exp(-(apart**2) / 8.0) / np.sqrt(self.odds)
        left: Reals = self.mean_square * np.minimum(doubt, 1.0)
        return left


def _candidates(log: SensingLog, odometry: Odometry, center: Reals) -> Iterator[_Candidates]:
    """List contacts of close docks, and the height and the position of each but the anchor."""
    final, precision = odometry.final, Precision()
    docks = center[:, None] + odometry.arm[final]
    later, own, earlier, its = close_docks(log, docks, SPACING + _GAP).T
    contacts = Distances.of(
        final[later], own, final[earlier], its, length=SPACING, sd=precision.contact
    )
    yield _Candidates("contact", Measurements.gather(odometry, [contacts]), 1)
    kinds: list[tuple[Kind, Reals]] = [("height", np.eye(3)[2:]), ("position", np.eye(3))]
    for kind, axes in kinds:
        stance = np.repeat(final[1:], len(axes))
        places = Coordinates.of(
            stance,
            np.full_like(stance, CENTER),
            np.tile(axes, (len(final) - 1, 1)),
            (center[1:] @ axes.T).ravel(),
            variance=precision.height**2,
        )
        yield _Candidates(kind, Measurements.gather(odometry, places=[places]), len(axes))


def _ranges(log: SensingLog, odometry: Odometry, pair: _Images) -> _Candidates:
    """List one range of each robot: the new one within reach that differs most between images."""
    first, second = (cdist(image, image) for image in (pair.first, pair.second))
    change, (i, j) = np.abs(second - first), log.ranges[:, :2].astype(np.int64).T
    change[first > log.ranges[:, 2].max() / log.dock_radius] = 0.0
    change[i, j] = change[j, i] = 0.0
    robot, other = np.arange(len(change)), change.argmax(axis=1)
    later, earlier = np.maximum(robot, other), np.minimum(robot, other)
    chosen = np.unique(np.column_stack([later, earlier])[later > earlier], axis=0)
    later, earlier = chosen.T
    center = np.full(len(chosen), CENTER)
    sd = float(np.median(log.ranges[:, 3])) / log.dock_radius
    ranges = Distances.of(
        odometry.final[later], center, odometry.final[earlier], center,
        length=first[later, earlier], sd=sd,
    )  # fmt: skip
    return _Candidates("range", Measurements.gather(odometry, [ranges]), 1)


def _rank(jacobian: csc_array, motions: Reals, size: int) -> Ints:
    """Compute the rank of each candidate's rows on the floppy motions, shape (n,)."""
    robots, dof, probes = motions.shape
    moved = np.zeros((4, robots, probes))
    moved[:dof] = motions.swapaxes(0, 1)
    moved = np.concatenate([moved[:3].swapaxes(0, 1).reshape(-1, probes), moved[3]])
    change = (jacobian @ moved).reshape(-1, size, probes)
    rank: Ints = (np.linalg.svd(change, compute_uv=False) > _SEEN * probes**0.5).sum(axis=1)
    return rank


class _Posterior:
    """Covariance C of the centers of all but the anchor, and of the yaws where they are biased."""

    def __init__(self, rows: Measurements, center: Reals, yaw_bias: float) -> None:
        self.robots = rows.robots
        self.coordinates = 3 * (self.robots - 1)
        self.free = slice(3, (4 if yaw_bias > 0.0 else 3) * self.robots)
        jacobian = rows.jacobian(center)
        measured = jacobian.T @ diags_array(1.0 / rows.variance()) @ jacobian
        distances = len(rows.distances.length)
        i, j = rows.robot[:distances], rows.other[:distances]
        ends = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
        weight = np.tile(3.0 / np.maximum(rows.distances.length, SPACING) ** 2, 4)
        weight[2 * len(i) :] *= -1.0
        extent = (center - center.mean(axis=0)).var(axis=0).sum()
        # Of robots that are very far apart, rounding would leave nothing but a singular matrix.
        resolved = self.free.stop * np.finfo(float).eps * measured.diagonal().max(initial=0.0)
        within = max(1.0 / max(extent, SPACING**2), resolved)
        bonds = coo_array((weight, ends), shape=(self.robots, self.robots))
        loose = bonds + within * eye_array(self.robots)
        yaws = eye_array(self.robots) / (yaw_bias**2 or 1.0)
        precision = csc_array(measured + block_diag([kron(loose, eye_array(3)), yaws]))
        self.covariance = np.linalg.inv(precision[self.free, self.free].toarray())
        square = np.trace(self.covariance[: self.coordinates, : self.coordinates])
        self.mean_square = float(square) / self.robots
        """Expected mean square error of the positions [R^2]."""

    def with_rows(
        self, jacobian: csc_array, variance: Reals, change: Reals, size: int
    ) -> tuple[Reals, Reals]:
        """Compute the expected mean square error with each of n candidates of some rows.

        Returns:
            Mean square errors [R^2], and how far a change of the measurements is beyond what is
            expected of them [sd], both of shape (n,).
        """
        gone, apart = [np.empty(0)], [np.empty(0)]
        step = size * _AT_ONCE
        for begin in range(0, len(variance), step):
            part = slice(begin, begin + step)
            rows = jacobian[part, self.free]
            spread = (rows @ self.covariance).reshape(-1, size, rows.shape[1])
            own = rows.toarray().reshape(spread.shape) @ spread.swapaxes(1, 2)
            own += variance[part].reshape(-1, size, 1) * np.eye(size)
            shift = spread[:, :, : self.coordinates]
            drop = np.linalg.solve(own, shift @ shift.swapaxes(1, 2))
            gone.append(np.trace(drop, axis1=1, axis2=2))
            off = change[part].reshape(-1, size, 1)
            apart.append(np.sqrt((off * np.linalg.solve(own, off)).sum(axis=(1, 2))))
        return self.mean_square - np.concatenate(gone) / self.robots, np.concatenate(apart)
