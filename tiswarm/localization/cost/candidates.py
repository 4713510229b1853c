"""Where a robot that joins may be: minima of its own rows, all other robots as they are.

Two distances leave a circle and three leave two mirror images, so that rows of one robot often fit
at several places. Steps begin at points all over the sphere of its sharpest distance. Turns of the
robot's final orientation are noise here, which is in several of its rows. Lengths in R.
"""

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.localization.cost.kernels import OFFSET, RobotState, RowLabel, RowValue, descend
from tiswarm.localization.cost.neighborhood import (
    Block,
    Configuration,
    Shapes,
    robots_at,
    scratch_for,
    table_of,
)
from tiswarm.localization.cost.settings import CANDIDATES, EXTENSION
from tiswarm.measurements.model import SPACING

_AXES = 3
_GOLDEN = np.pi * (1.0 + 5.0**0.5)


def candidates(
    block: Block, state: Configuration, shapes: Shapes, *, non_overlap: bool
) -> tuple[Reals, Reals]:
    """Find the places of the robot of a block, the most likely one first.

    Args:
        block: Its rows, at least one of them about another robot.
        state: Where all others are.
        shapes: All robots.
        non_overlap: Whether docks that do not touch must not overlap.

    Returns:
        Centers [R], shape (k, 3), and their costs less what extension gains [1], shape (k,).
    """
    robots = robots_at(state, shapes)
    # Its own turn is noise of its rows.
    robots.state[block.members[-1], RobotState.TURN : RobotState.TURN_SD] = 0.0
    table = table_of([block])._replace(noise=block.with_final_noise().ravel())
    place = _starts(block, state)
    cost, count = np.empty(len(place)), np.empty(1, np.int32)
    descend(
        int(non_overlap), shapes.reach, *table, *robots, *scratch_for([block]),
        np.empty((_AXES + 1, _AXES + 1)), place, cost, count,
    )  # fmt: skip
    ends, square = place[: count[0]], cost[: count[0]]
    return _distinct(ends, square - extension(block, state, ends))


def extension(block: Block, state: Configuration, place: Reals) -> Reals:
    """Compute what a robot at some places (n, 3) gains by its extension [1], shape (n,)."""
    touched = state.position[block.partners]
    apart = np.linalg.norm(place[:, None] - touched, axis=2).mean(axis=1)
    gain: Reals = 2.0 * EXTENSION * apart
    return gain


def _sphere(count: int) -> Reals:
    """Spread points evenly over the unit sphere, along a golden spiral, shape (count, 3)."""
    number = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * number / count, _GOLDEN * number
    level = np.sqrt(1.0 - z**2)
    return np.column_stack([level * np.cos(angle), level * np.sin(angle), z])


SPHERE = _sphere(CANDIDATES.starts)
"""Where steps begin, on the unit sphere, shape (starts, 3)."""


def _starts(block: Block, state: Configuration) -> Reals:
    """Spread starts over the sphere that the sharpest distance leaves, shape (starts, 3).

    Where only vectors are measured, the sphere is that of the sharpest of them.
    """
    pairs = len(block.rows.other)
    sharpest = int(block.real[:pairs, RowValue.VARIANCE].argmin())
    row = block.real[sharpest]
    at = state.position[block.members[block.rows.other[sharpest]]]
    center = at + row[RowValue.OTHER_ARM : RowValue.VALUE] - row[RowValue.ARM : RowValue.TAIL]
    # A vector has the distance, too: that of two docks in contact.
    radius = row[RowValue.VALUE] if block.number[sharpest, RowLabel.KIND] < OFFSET else SPACING
    start: Reals = center + radius * SPHERE
    return start


def _distinct(place: Reals, cost: Reals) -> tuple[Reals, Reals]:
    """Keep the best of ends that are close, as far as their costs let them be candidates."""
    kept: list[int] = []
    for n in np.argsort(cost, kind="stable").tolist():
        # Ends come by ascending cost: all others are worse.
        if kept and cost[n] > cost[kept[0]] + CANDIDATES.worst:
            break
        apart = np.linalg.norm(place[kept] - place[n], axis=1)
        if (apart > CANDIDATES.distinct).all():
            kept.append(n)
        if len(kept) == CANDIDATES.most:
            break
    return place[kept], cost[kept]
