"""Gaps between docks of different robots: at which dock offset most docks touch, and a histogram.

A gap is the distance between the surfaces of two docks; overlaps are negative gaps.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.robot import TANGENT_RHO, docks_in_plane
from tiswarm.compute.math import dock_offsets

FARTHEST_SHOWN = 0.5
"""Gaps and overlaps up to this many dock radii are in the histogram."""

_EDGES = np.array([-0.5, -0.2, -0.1, -0.05, -0.02, -0.01, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5])
"""Edges of its bins [dock radii]."""

_LONGEST_BAR = 40
_LONGEST_OFFSET = 10.0
"""Dock offsets up to this many dock radii are guessed."""

_NEAREST = 12
"""Nearest robots whose docks may touch a robot's docks when the offset is guessed."""

_STANDS_OUT = 2.0
"""A guess has at least this many times the contacts of any other offset."""


_WIDEST = 0.25
"""Largest limit of gaps and overlaps that is found [dock radii]."""

_STEP = 1.1
"""Ratio of limits that are tried."""

_FEWEST_OVERLAPS = 10
"""Overlaps in the peak from which on there is a limit to find."""

_MARGIN = 1.3
"""Largest error of a gap, per largest error that was seen as an overlap."""

_RARE = 0.02
"""Share of overlaps in the valley, up to twice the limit, beside those within it."""


def surface_gaps(docks: Reals, pair: Ints, radius: float) -> Reals:
    """Measure gaps from surface to surface, shape (n,).

    Args:
        docks: Centers of the docks, shape (N, D, 3).
        pair: Rows of (robot, its dock, other robot, its dock), shape (n, 4).
        radius: Radius of a dock sphere.
    """
    i, a, j, b = pair.T
    gap: Reals = np.linalg.norm(docks[i, a] - docks[j, b], axis=1) - 2.0 * radius
    return gap


def guess_dock_offset(
    position: Reals, orientation_wxyz: Reals, radius: float, width: float
) -> float | None:
    """Guess how far three docks in a plane are from the center: where most docks touch.

    Docks p + rho u of two robots touch at the roots rho of |p' - p + rho (u' - u)| = 2 radius. We
    return the median of the densest window of roots, if there are enough: one for every second
    robot, and twice as many as in any other window.

    Args:
        position: Centers, shape (N, 3).
        orientation_wxyz: Body to world, unit quaternions, shape (N, 4).
        radius: Radius of a dock sphere.
        width: Sum of the largest gap and the largest overlap of a contact.
    """
    count = len(position)
    _, near = cKDTree(position).query(position, k=min(count, _NEAREST + 1))
    first = np.repeat(np.arange(count), near.size // count)
    i, j = np.unique(np.sort(np.stack([first, near.ravel()]), axis=0), axis=1)
    i, j = i[i != j], j[i != j]
    arm = dock_offsets(orientation_wxyz, docks_in_plane(1.0))
    between = (position[j] - position[i])[:, None, None]
    spread = arm[j][:, None] - arm[i][:, :, None]
    a, b = (spread**2).sum(axis=-1), (between * spread).sum(axis=-1)
    square = b**2 - a * ((between**2).sum(axis=-1) - 4.0 * radius**2)
    crossing = (a > 1e-9) & (square >= 0.0)  # noqa: PLR2004 - parallel arms have no root
    a, b, half = a[crossing], b[crossing], np.sqrt(square[crossing])
    roots = np.sort(np.concatenate([-b - half, -b + half]) / np.tile(a, 2))
    roots = roots[(roots > (TANGENT_RHO - 1e-3) * radius) & (roots < _LONGEST_OFFSET * radius)]
    if not roots.size:
        return None
    inside = np.searchsorted(roots, roots + width, side="right") - np.arange(roots.size)
    best = inside.argmax()
    offset = float(np.median(roots[best : best + inside[best]]))
    others = inside[np.abs(roots - offset) > 2.0 * width]
    if inside[best] < max(0.5 * count, _STANDS_OUT * others.max(initial=0)):
        return None
    return float(f"{offset:.4g}")


def contact_limit(gap: Reals, radius: float, least: float) -> float | None:
    """Find the limit of the gaps and overlaps of contacts in the valley beyond their peak.

    Rigid docks do not overlap: overlaps are errors, as of rounded poses, and gaps of contacts have
    errors of the same size. The valley is where hardly any larger overlaps follow.

    Args:
        gap: Gaps of close docks.
        radius: Radius of a dock sphere.
        least: Least limit.

    Returns:
        The limit; None if there are too few overlaps or no valley, as for a wrong robot geometry.
    """
    overlap = -gap[gap < 0.0]
    limit = least
    while limit <= _WIDEST * radius:
        inside = (overlap <= limit).sum()
        beyond = overlap[(overlap > limit) & (overlap <= 2.0 * limit)]
        if inside >= _FEWEST_OVERLAPS and len(beyond) <= _RARE * inside:
            return limit if limit == least else float(f"{_MARGIN * max([limit, *beyond]):.2g}")
        limit *= _STEP
    return None


def histogram(
    gap: Reals, radius: float, *, largest_gap: float, largest_overlap: float, unit: str
) -> Iterator[str]:
    """Draw how many docks have which gap, in lines; contacts have bars of `#`, other gaps of `.`.

    Args:
        gap: Gaps of close docks.
        radius: Radius of a dock sphere.
        largest_gap: Largest gap of a contact; a further edge of the bins.
        largest_overlap: Largest overlap of a contact; a further edge of the bins.
        unit: Name of the unit of all lengths.
    """
    edges = np.unique(
        np.concatenate([_EDGES * radius, [0.0 - largest_overlap, largest_gap]]).round(12)
    )
    number, _ = np.histogram(gap, edges)
    filled = np.flatnonzero(number)
    if not filled.size:
        return
    yield f"gaps between docks [{unit}], contacts marked #:"
    for k in range(filled[0], filled[-1] + 1):
        touches = edges[k] >= -largest_overlap and edges[k + 1] <= largest_gap
        bar = "#."[not touches] * int(np.ceil(_LONGEST_BAR * number[k] / number.max()))
        yield f"{edges[k]:>9.3g} to {edges[k + 1]:<8.3g}{number[k]:>6} {bar}".rstrip()
