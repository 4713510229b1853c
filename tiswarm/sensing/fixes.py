"""Coordinates of centers: those that beacons in sight measure, and those that are known.

The two planes of a lighthouse are sources: what one measures has an error in common.
"""

from collections.abc import Iterator

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import normal
from tiswarm.records.sensing_log import KNOWN_SD
from tiswarm.sensing.params import SensingParams
from tiswarm.sensing.sight import Lookouts, find_lookouts, in_sight
from tiswarm.world.history import History

NO_SOURCE = -1
"""Source of fixes and ranges whose errors have no part in common."""

_PLANE_SD = 0.01
"""Standard deviation of the plane that a planar robot is in [R]."""

_SLANT = np.radians(30.0)
"""Slant of both planes of a lighthouse to the vertical axis about which they sweep; that of
version 2 [rad]."""


def sense_fixes(history: History, params: SensingParams) -> Reals:
    """Measure coordinates of centers.

    Returns:
        Rows of (robot, stance, direction (3), value, standard deviation, source), shape (F, 8). The
        source is a place in `params.sources`, or -1.
    """
    rows = [_seeds(history, params)]
    lookouts = find_lookouts(history, params)
    views = [lookouts.toward(np.array(beacon)) for beacon in params.beacons]
    seen = [in_sight(history, view) for view in views]
    if params.beacon_kind == "sweep":
        for number, is_seen in enumerate(seen):
            rows += _sweep_planes(history.seed, lookouts.select(is_seen), number, params)
    elif seen:
        rows += _coordinates(history.seed, lookouts.select(np.any(seen, axis=0)), params)
    return np.concatenate(rows)


def _seeds(history: History, params: SensingParams) -> Reals:
    """Measure the final centers of the first robots but the anchor, which is known."""
    robot = np.repeat(np.arange(1, min(params.seed_robots, history.robot_count)), 3)
    axis = np.arange(len(robot)) % 3
    last = np.array([walk.stance_count for walk in history.walks])[robot] - 1
    error = params.fix_noise * normal(history.seed, "seed robot", robot, axis)
    sd_and_source = np.tile([params.fix_noise, NO_SOURCE], (len(robot), 1))
    return np.column_stack(
        [robot, last, np.eye(3)[axis], history.position[robot, axis] + error, sd_and_source]
    )


def _coordinates(seed: int, lookouts: Lookouts, params: SensingParams) -> Iterator[Reals]:
    """Measure x and y."""
    robot, stance, center, _ = lookouts
    sd_and_source = np.tile([params.fix_noise, NO_SOURCE], (len(robot), 1))
    for axis in (0, 1):
        error = params.fix_noise * normal(seed, "fix", robot, 2 * stance + axis)
        direction = np.tile(np.eye(3)[axis], (len(robot), 1))
        yield np.column_stack([robot, stance, direction, center[:, axis] + error, sd_and_source])


def _sweep_planes(
    seed: int, lookouts: Lookouts, number: int, params: SensingParams
) -> Iterator[Reals]:
    """Measure two planes through a lighthouse and the center, which sweep about a vertical axis.

    A plane whose normal is (cos t cos f, cos t sin f, +-sin t), with slant t, meets the center at
    the angle f where the normal is perpendicular to the way there. Centers steeper above or below
    the lighthouse than 90 deg - t are never met.
    """
    station = np.array(params.beacons[number])
    way = lookouts.center - station
    rise = np.tan(_SLANT) * way[:, 2]
    level = np.hypot(way[:, 0], way[:, 1])
    is_met = np.abs(rise) < level
    robot, stance, _, _ = lookouts.select(is_met)
    bearing = np.arctan2(way[:, 1], way[:, 0])[is_met]
    slope = rise[is_met] / level[is_met]
    for plane, sign in enumerate((1.0, -1.0)):
        angle = bearing + np.arccos(-sign * slope)
        part = np.column_stack([np.cos(angle), np.sin(angle), np.full(len(robot), sign)])
        direction = part * [np.cos(_SLANT), np.cos(_SLANT), np.sin(_SLANT)]
        draw = 2 * (64 * stance + number) + plane
        error = params.fix_noise * normal(seed, "sweep", robot, draw)
        error += params.fix_bias * normal(seed, "beacon", number, plane)
        source = 2 * number + plane if params.fix_bias else NO_SOURCE
        sd_and_source = np.tile([params.fix_noise, source], (len(robot), 1))
        yield np.column_stack(
            [robot, stance, direction, direction @ station + error, sd_and_source]
        )


def planar_fixes(history: History) -> Reals:
    """Return y = 0 at the final stance of each planar robot, as a fix, shape (F, 8)."""
    robot = np.arange(history.robot_count if history.is_planar else 0)
    last = np.array([walk.stance_count for walk in history.walks])[robot] - 1
    fix = np.tile([0.0, 1.0, 0.0, 0.0, _PLANE_SD, NO_SOURCE], (len(robot), 1))
    return np.column_stack([robot, last, fix])


def anchor_fixes(history: History) -> Reals:
    """Return the position of each anchor but the first as three fixes, shape (F, 8)."""
    robot = np.repeat(np.flatnonzero(history.is_anchor)[1:], 3)
    last = np.array([walk.stance_count for walk in history.walks])[robot] - 1
    axis = np.arange(len(robot)) % 3
    sd_and_source = np.tile([KNOWN_SD * history.robot.dock_radius, NO_SOURCE], (len(robot), 1))
    return np.column_stack(
        [robot, last, np.eye(3)[axis], history.position[robot, axis], sd_and_source]
    )
