"""Geometry of robots and ground from recorded poses, with error bars.

One factor scales the distances of all docks from the center. Each flip states it: the pivot, a
dock, stays where it is, at the rests before and after and at all samples between. Each contact
states it, too, if the radius of docks is right: docks touch. Where both agree, they count together;
where they do not, the radius is wrong. We average the rows of flips and contacts by least squares.
Rows that are far off, such as that of a flip about another dock, do not count (Tukey, "A survey of
sampling from contaminated distributions", 1960). Uncertainties follow from noise, or from the
scatter of the rows where it is larger.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.motion import Rests
from tiswarm.formats.poses import SD_PER_MEDIAN_DEVIATION, Assumptions, Poses
from tiswarm.measurements.contacts import dock_pairs
from tiswarm.records.messages import with_sd

_FAR = 4.0
"""Standard deviations from which on a row does not count."""

_DISAGREE = 4.0
"""Standard deviations by which two values are not the same."""

_CLOSE = 0.25
"""Largest gap or overlap of docks that may touch, and height of docks that may stand [radii]."""

_FEWEST = 3
"""Fewest rows that state a value."""

_ROUNDS = 10
"""Times that rows are chosen by the value that the last ones state."""

_LEAST_TURN = 0.05
"""Least motion of a dock about another one that states a factor, per distance of the dock."""

_LEAST = 1e-4
"""Relative uncertainty below this counts as this much."""


class Value(NamedTuple):
    """An estimated number."""

    value: float
    sd: float
    rows: int  # number of flips, contacts or docks that state it

    def disagrees(self, stated: float, least: float) -> bool:
        """Whether another value is neither within the uncertainty nor within a tolerance."""
        return abs(self.value - stated) > max(_DISAGREE * self.sd, least)

    def scaled(self, factor: float) -> "Value":
        """Return the estimate of a multiple."""
        return Value(factor * self.value, abs(factor) * self.sd, self.rows)

    def __str__(self) -> str:
        return with_sd(self.value, self.sd)


class DockGeometry(NamedTuple):
    """Distances of docks from the center, per assumed ones, and radius of docks."""

    factor: Value | None  # by flips and contacts, or by one of these; None where too few state it
    flips: int  # flips that count
    contacts: int  # contacts that count; 0 where they disagree with flips
    radius: Value | None  # of docks in contact, at the distance by flips; None without contacts


def fit_scale(poses: Poses, rests: Rests | None, assumed: Assumptions) -> DockGeometry:
    """Estimate by which factor docks are farther from the center than assumed.

    Args:
        poses: Robots at rest, whose docks are assumed.
        rests: Where they rested; None without poses over time.
        assumed: Radius of docks.
    """
    by_flips = None
    if rests is not None:
        by_flips = _combined(*_rows_of_flips(poses, rests))
        if by_flips is not None:  # a flip may have two rows: its samples, and the rests beside it
            flips_recorded = int((rests.pivot >= 0).sum())
            by_flips = by_flips._replace(rows=min(by_flips.rows, flips_recorded))
    gap, lever, variance = _touching(poses, rests, assumed)
    usable = np.abs(lever) > _LEAST_TURN * assumed.dock_radius
    by_contacts = _combined(
        1.0 - gap[usable] / lever[usable], variance[usable] / lever[usable] ** 2
    )
    radius = None
    if by_flips is not None:
        at_flips = assumed.dock_radius + 0.5 * (gap + (by_flips.value - 1.0) * lever)
        radius = _combined(at_flips, 0.25 * variance)
        if radius is not None:
            slope = 0.5 * float(np.abs(lever.mean())) if len(lever) else 0.0
            radius = radius._replace(sd=float(np.hypot(radius.sd, slope * by_flips.sd)))
    if by_flips is None or by_contacts is None:
        factor = by_flips or by_contacts
        flips = 0 if by_flips is None else by_flips.rows
        contacts = 0 if by_contacts is None else by_contacts.rows
        return DockGeometry(factor, flips, contacts, radius)
    apart = abs(by_flips.value - by_contacts.value)
    if apart > _DISAGREE * np.hypot(by_flips.sd, by_contacts.sd):
        return DockGeometry(by_flips, by_flips.rows, 0, radius)
    weight = np.array([by_flips.sd, by_contacts.sd]) ** -2.0
    value = float(weight @ [by_flips.value, by_contacts.value] / weight.sum())
    both = Value(value, float(weight.sum() ** -0.5), by_flips.rows + by_contacts.rows)
    return DockGeometry(both, by_flips.rows, by_contacts.rows, radius)


def _combined(value: Reals, variance: Reals) -> Value | None:
    """Average values, those that are far off left out; None if fewer than three remain."""
    if len(value) < _FEWEST:
        return None
    middle = float(np.median(value))
    scale = SD_PER_MEDIAN_DEVIATION * np.median(np.abs(value - middle) / np.sqrt(variance))
    sd = np.sqrt(variance) * max(float(scale), 1.0)
    mean = middle
    for _ in range(_ROUNDS):
        near = np.abs(value - mean) <= _FAR * sd
        if near.sum() < _FEWEST:
            return None
        weight = 1.0 / variance[near]
        mean = float(weight @ value[near] / weight.sum())
    square = float(weight @ (value[near] - mean) ** 2 / (near.sum() - 1))
    spread = np.sqrt(max(1.0, square) / weight.sum())
    return Value(mean, float(spread), int(near.sum()))


def _rows_of_flips(poses: Poses, rests: Rests) -> tuple[Reals, Reals]:
    """Return the factor that each flip states, and its variance up to a common factor.

    The place of a pivot, p + s R o, is one for all poses of a flip: of least squares about its
    mean, s is a ratio of two sums. Noise of orientations adds to the lower one by a known amount.
    """
    samples = poses.samples
    factors: list[float] = []
    variances: list[float] = []
    if samples is None:
        return np.array(factors), np.array(variances)
    offset = poses.dock_offset_body
    turn = 0.0
    variance = (_LEAST * float(np.linalg.norm(offset, axis=1).max(initial=0.0))) ** 2
    if rests.noise is not None:
        turn = rests.noise.turn
        variance += rests.noise.of_docks(offset) ** 2

    def add(center: Reals, wxyz: Reals, dock: int, weight: Reals) -> None:
        arm = Rotation.from_quat(wxyz, scalar_first=True).apply(offset[dock])
        share = weight / weight.sum()
        arm = arm - share @ arm
        center = center - share @ center
        reach = float((offset[dock] ** 2).sum())
        square = float(weight @ (arm**2).sum(axis=1)) - 2.0 * turn**2 * reach * (len(arm) - 1)
        if square > _LEAST_TURN**2 * reach * weight.sum():
            factors.append(-float(weight @ (arm * center).sum(axis=1)) / square)
            variances.append(variance / square)

    for _, first, after, dock in rests.flips.tolist():
        rows = slice(first, after)
        add(samples.position[rows], samples.orientation_wxyz[rows], dock, np.ones(after - first))
    is_shown = rests.number > 0
    for row in np.flatnonzero(rests.pivot >= 0).tolist():
        pair = [row, row + 1]
        if is_shown[pair].all():
            wxyz = rests.orientation_wxyz[pair]
            add(rests.position[pair], wxyz, int(rests.pivot[row]), rests.number[pair].astype(float))
    return np.array(factors), np.array(variances)


def _touching(
    poses: Poses, rests: Rests | None, assumed: Assumptions
) -> tuple[Reals, Reals, Reals]:
    """Return gaps of docks that may touch, their change with the factor, and their variance."""
    radius = assumed.dock_radius
    docks = poses.docks
    pair = dock_pairs(docks, (2.0 + _CLOSE) * radius)
    i, a, j, b = pair.T
    between = docks[j, b] - docks[i, a]
    distance = np.linalg.norm(between, axis=1)
    gap = distance - 2.0 * radius
    close = gap >= -_CLOSE * radius
    along = between / np.maximum(distance, np.finfo(float).tiny)[:, None]
    arm = dock_offsets(poses.orientation_wxyz, poses.dock_offset_body)
    lever = (along * (arm[j, b] - arm[i, a])).sum(axis=1)
    variance = np.full(len(gap), (_LEAST * radius) ** 2)
    if rests is not None and rests.noise is not None:
        share = 1.0 / np.maximum(rests.number[rests.last], 1)
        variance += rests.noise.of_docks(poses.dock_offset_body) ** 2 * (share[i] + share[j])
    return gap[close], lever[close], variance[close]


class FittedGround(NamedTuple):
    """Plane on which docks stand."""

    height: Value
    tilt_deg: Value | None  # against the horizontal; None where docks do not span a plane


def fit_ground(docks: Reals, ground_z: float, dock_radius: float) -> FittedGround | None:
    """Fit a plane below the docks that may stand; None if there are too few.

    Args:
        docks: Centers of docks, shape (n, 3).
        ground_z: Height of the ground as stated.
        dock_radius: Radius of a dock sphere.
    """
    height = docks[:, 2] - dock_radius
    low = docks[np.abs(height - ground_z) <= _CLOSE * dock_radius]
    if len(low) < _FEWEST:
        return None
    level = low[:, 2] - dock_radius
    value = _combined(level, np.full(len(level), (_LEAST * dock_radius) ** 2))
    if value is None:
        return None
    tilt = None
    place = low[:, :2] - low[:, :2].mean(axis=0)
    spread = np.linalg.svd(place, compute_uv=False)
    if len(low) > 2 * _FEWEST and len(spread) > 1 and spread[1] > dock_radius * np.sqrt(len(low)):
        columns = np.column_stack([np.ones(len(low)), place])
        slope, *_ = np.linalg.lstsq(columns, level, rcond=None)
        misfit = level - columns @ slope
        variance = float((misfit**2).sum() / (len(low) - 3))
        covariance = variance * np.linalg.inv(columns.T @ columns)
        size = float(np.hypot(*slope[1:]))
        sd = float(np.sqrt(np.trace(covariance[1:, 1:])))
        tilt = Value(float(np.degrees(size)), float(np.degrees(sd)), len(low))
    return FittedGround(value, tilt)


def standing_docks(poses: Poses, rests: Rests | None) -> Reals:
    """Return the centers of the docks of all robots at rest, final poses too, shape (n, 3)."""
    docks = poses.docks.reshape(-1, 3)
    if rests is None:
        return docks
    of_rests = rests.position[:, None] + dock_offsets(
        rests.orientation_wxyz, poses.dock_offset_body
    )
    return np.concatenate([docks, of_rests.reshape(-1, 3)])
