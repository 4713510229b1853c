"""Where a robot that joins may be: minima of its own rows, all other robots as they are.

Two distances leave a circle and three leave two mirror images, so that rows of one robot often fit
at several places. Steps begin at points all over the sphere of its sharpest distance. Turns of the
robot's final orientation are noise here, which is in several of its rows. Lengths in R.
"""

from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.localization.online.blocks import Block
from tiswarm.localization.online.neighborhood import (
    Configuration,
    Shapes,
    products_along,
    turned_arms,
    turned_docks,
)
from tiswarm.localization.online.settings import CANDIDATES
from tiswarm.localization.refinement import OVERLAP_SD
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.rows import SPACING

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
    rows, members = block.rows, block.members
    other = members[rows.other]
    its = turned_arms(rows.other_arm, state.turn[other], shapes.turn_sd[other])
    rows = replace(rows, other_arm=its)
    noise = block.with_final_noise()
    at = state.position[members]
    place = _starts(block, rows, at)
    for count in range(CANDIDATES.rounds):
        position = _with_last(at, place)
        residual, direction = rows.residual(position), rows.directions(position)
        inverse = np.linalg.inv(_covariance(noise, direction, rows.own_variance))
        weighted = inverse @ direction
        known = direction.swapaxes(1, 2) @ weighted
        slope = (weighted * residual[:, :, None]).sum(axis=1)
        damped = known + CANDIDATES.damping * np.eye(_AXES)
        step = -np.linalg.solve(damped, slope[:, :, None])[:, :, 0]
        far, most = np.linalg.norm(step, axis=1), CANDIDATES.longest_step
        place = place + step * np.minimum(1.0, most / np.maximum(far, most))[:, None]
        if far.max() < CANDIDATES.settled:
            break
        # Most starts fall into the same few minima within three steps.
        if count % CANDIDATES.merge_every == CANDIDATES.merge_every - 1:
            place = _merged(place)
    # The covariance depends on where the robot is, so that chi-squares need it at the ends.
    position = _with_last(at, place)
    residual, direction = rows.residual(position), rows.directions(position)
    covariance = _covariance(noise, direction, rows.own_variance)
    square = (residual * np.linalg.solve(covariance, residual[:, :, None])[:, :, 0]).sum(axis=1)
    cost = square - extension(block, state, place)
    if non_overlap:
        cost += _overlap(block, place, state, shapes)
    return _distinct(place, cost)


def extension(block: Block, state: Configuration, place: Reals) -> Reals:
    """Compute what a robot at some places (n, 3) gains by its extension [1], shape (n,)."""
    touched = state.position[block.partners]
    apart = np.linalg.norm(place[:, None] - touched, axis=2).mean(axis=1)
    gain: Reals = CANDIDATES.extension * apart
    return gain


def _with_last(at: Reals, place: Reals) -> Reals:
    """Put the last of some robots (M, 3) at places (n, 3), the others where they are, (n, M, 3)."""
    position = np.tile(at, (len(place), 1, 1))
    position[:, -1] = place
    return position


def _merged(place: Reals) -> Reals:
    """Keep the first of places that are close to each other."""
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    is_close = np.tril(apart < CANDIDATES.alike, -1)
    return place[~is_close.any(axis=1)]


def _starts(block: Block, rows: Measurements, at: Reals) -> Reals:
    """Spread starts over the sphere that the sharpest distance leaves, shape (starts, 3).

    Where only vectors are measured, the sphere is that of the sharpest of them.
    """
    pairs = len(rows.other)
    sharpest = int(block.variance[:pairs].argmin())
    center = at[rows.other[sharpest]] + rows.other_arm[sharpest] - rows.arm[sharpest]
    # A vector has the distance, too: that of two docks in contact.
    is_distance = sharpest < len(rows.distances.length)
    radius = rows.distances.length[sharpest] if is_distance else SPACING
    number = np.arange(CANDIDATES.starts) + 0.5
    z, angle = 1.0 - 2.0 * number / CANDIDATES.starts, _GOLDEN * number
    # Points of a golden spiral, which are evenly spread.
    level = np.sqrt(1.0 - z**2)
    sphere = np.column_stack([level * np.cos(angle), level * np.sin(angle), z])
    start: Reals = center + radius * sphere
    return start


def _covariance(noise: Reals, direction: Reals, own_variance: Reals) -> Reals:
    """Covariance of the rows of a block at some states, (n, m, m), by derivatives (n, m, 3)."""
    rows = len(noise)
    # By rows first, so that each row is one matrix product.
    way = direction.swapaxes(0, 1)
    half = (way @ noise.reshape(rows, _AXES, rows * _AXES)).reshape(rows, -1, rows, _AXES)
    total = products_along(half, direction)
    covariance: Reals = np.moveaxis(total, 0, 2) + np.diag(own_variance)
    return covariance


def _overlap(block: Block, place: Reals, state: Configuration, shapes: Shapes) -> Reals:
    """Compute the cost of overlaps with robots that the robot does not touch there, (n,)."""
    own = int(block.members[-1])
    reach = 2.0 * float(np.linalg.norm(shapes.arm, axis=2).max()) + SPACING
    center = place.mean(axis=0)
    spread = float(np.linalg.norm(place - center, axis=1).max())
    away = np.linalg.norm(state.position - center, axis=1)
    # It does not overlap with itself, nor with robots that have left.
    away[[own, *shapes.gone]] = np.inf
    near = np.flatnonzero(away < reach + spread)
    point = state.position[near, None] + turned_docks(state, shapes, near)
    mine = place[:, None] + shapes.arm[own]
    gap = np.linalg.norm(mine[:, :, None, None] - point, axis=4) - SPACING
    for dock, robot, its in shapes.touching[own]:
        gap[:, dock, near == robot, its] = 0.0
    cost: Reals = (np.minimum(gap, 0.0) ** 2).sum(axis=(1, 2, 3)) / OVERLAP_SD**2
    return cost


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
