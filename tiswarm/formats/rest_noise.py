"""Noise of the poses at rest, which are means of many samples.

Independent noise leaves 1 / n of its variance in the mean of n samples. Noise that lasts, such as a
bias that differs from place to place, leaves more. What must coincide shows how much: the pivot of
a flip stays where it is from the rest before to the one after, and docks in contact are two radii
apart. An error of a position moves a dock in all directions alike, one of an orientation at right
angles to its arm. So squares of differences state two components of variance, those of positions
and orientations, by the method of moments (Searle, Casella and McCulloch, "Variance Components",
1992).
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.motion import Rests
from tiswarm.formats.poses import SD_PER_MEDIAN_DEVIATION, Poses
from tiswarm.formats.segments import Noise

_FEWEST = 10
"""Fewest differences that state components; the pivot of a flip gives three."""

_FAR = 4.0
"""Distance from which on a difference is none of noise, as of a pivot that slipped [sd]."""

_ROUNDS = 10
"""Times that differences are weighted by the components that the last ones state."""


class _Differences(NamedTuple):
    """Differences of two places that must coincide, each along a unit vector."""

    apart: Reals  # (n,)
    rest: Ints  # rests that have the two places, (n, 2)
    lever_square: Reals  # square of the lever of each rest's orientation, (n, 2)


def noise_of_rests(poses: Poses, rests: Rests, contacts: Ints, factor: float) -> Noise | None:
    """Estimate the noise of the poses at rest, in the root of the mean square of all.

    Args:
        poses: Robots at their final rests, whose docks are assumed.
        rests: Where they rested.
        contacts: Final contacts, rows of (robot, dock, other robot, its dock), shape (n, 4).
        factor: Distance of docks from the center by flips and contacts, per assumed one, so that
            no wrong distance counts as noise.

    Returns:
        The noise; None if that of samples is unknown.
    """
    noise = rests.noise
    if noise is None:
        return None
    share = 1.0 / np.maximum(rests.number, 1)  # a pose that flips beside a gap imply is no mean
    offset = factor * poses.dock_offset_body
    parts = [_of_pivots(rests, offset), _of_contacts(rests, contacts, offset)]
    differences = _Differences(*map(np.concatenate, zip(*parts, strict=True)))
    lasting = _lasting(differences, share, noise)
    variance = share.mean() * np.square([noise.position, noise.tilt, noise.yaw])
    variance += lasting[[0, 1, 1]]
    return Noise(*np.sqrt(variance).tolist())


def _of_pivots(rests: Rests, offset: Reals) -> _Differences:
    """Compare the pivots of flips before and after, along three axes each."""
    before = np.flatnonzero(rests.pivot >= 0)
    rest = np.column_stack([before, before + 1])
    rest = rest[(rests.number[rest] > 0).all(axis=1)]
    pivot = rests.pivot[rest[:, :1]]
    arm = dock_offsets(rests.orientation_wxyz, offset)[rest, pivot]
    apart = np.diff(rests.position[rest] + arm, axis=1)[:, 0]
    # Axes along which the levers of the two orientations differ most.
    _, axes = np.linalg.eigh(np.einsum("npi,npj->nij", arm, arm))
    along = np.einsum("npi,nik->nkp", arm, axes)
    square = (arm**2).sum(axis=2)[:, None] - along**2
    return _Differences(
        np.einsum("ni,nik->nk", apart, axes).ravel(), rest.repeat(3, axis=0), square.reshape(-1, 2)
    )


def _of_contacts(rests: Rests, contacts: Ints, offset: Reals) -> _Differences:
    """Compare docks in contact along the line between them, as far apart as in the mean."""
    rest = rests.last[contacts[:, [0, 2]]]
    arm = dock_offsets(rests.orientation_wxyz, offset)[rest, contacts[:, [1, 3]]]
    between = np.diff(rests.position[rest] + arm, axis=1)[:, 0]
    distance = np.linalg.norm(between, axis=1)
    along = (arm * (between / distance[:, None])[:, None]).sum(axis=2)
    # The mean is that of the true radius.
    apart = distance - distance.mean() if len(distance) else distance
    return _Differences(apart, rest, (arm**2).sum(axis=2) - along**2)


def _lasting(differences: _Differences, share: Reals, noise: Noise) -> Reals:
    """Estimate the variance that means of samples have beyond that of independent samples.

    Args:
        differences: Differences of places that must coincide.
        share: Part of the variance of a sample that independent noise leaves, shape (rests,).
        noise: Noise of samples.

    Returns:
        Variance of positions, and of orientations [rad^2], along each axis, shape (2,).
    """
    apart, rest, lever_square = differences
    if len(apart) < _FEWEST:
        return np.zeros(2)
    square = apart**2
    of_sample = noise.position**2 + noise.turn**2 * lever_square
    independent = (share[rest] * of_sample).sum(axis=1)
    columns = np.column_stack([np.full(len(apart), 2.0), lever_square.sum(axis=1)])
    excess = SD_PER_MEDIAN_DEVIATION**2 * float(np.median(square / independent))
    expected = max(excess, 1.0) * independent
    component: Reals = np.zeros(2)
    for _ in range(_ROUNDS):
        weight = (square <= _FAR**2 * expected) / expected
        scale = columns.mean(axis=0)
        component, _ = nnls(weight[:, None] * columns / scale, weight * (square - independent))
        component = component / scale
        expected = independent + columns @ component
    return component
