"""Line of sight, which docks of other robots and the ground block, and who looks from where."""

from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.sensing.params import SensingParams
from tiswarm.world.history import History

_EDGE = 2.5
"""Edge of a cell [dock radii]."""

_ROUNDING = 1e-3
"""Part of a radius by which cells and boxes are larger than they must be."""


class Views(NamedTuple):
    """K segments that robots look along, and who may block them."""

    start: Reals
    """Where each begins [R], shape (K, 3)."""

    end: Reals
    """Where each ends [R], shape (K, 3)."""

    joined: Ints
    """Robots that are part of the structure by then, and block; later ones do not, shape (K,)."""

    robot: Ints
    """Robot that looks, and does not block, shape (K,)."""

    target: Ints
    """Robot at the end, which does not block either; -1 for none, shape (K,)."""


class Lookouts(NamedTuple):
    """V stances at which robots look around."""

    robot: Ints
    """Robot, shape (V,)."""

    stance: Ints
    """Its stance, counted from its spawn, shape (V,)."""

    center: Reals
    """Its center there [R], shape (V, 3)."""

    joined: Ints
    """Robots that are part of the structure by then, shape (V,)."""

    def select(self, chosen: Bools) -> "Lookouts":
        """Return those where `chosen`, shape (V,), is true."""
        robot, stance, center, joined = self
        return Lookouts(robot[chosen], stance[chosen], center[chosen], joined[chosen])

    def toward(self, point: Reals) -> Views:
        """Look from each toward one point, shape (3,)."""
        nobody = np.full(len(self.robot), -1)
        return Views(self.center, np.tile(point, (len(nobody), 1)), self.joined, self.robot, nobody)


def find_lookouts(history: History, params: SensingParams) -> Lookouts:
    """List the stances at which robots have fixes and ranges."""
    length = np.array([walk.stance_count for walk in history.walks])
    robot = np.repeat(np.arange(history.robot_count), length)
    stance = np.concatenate([np.arange(count) for count in length])
    center = np.concatenate([walk.center for walk in history.walks])
    is_last = stance == length[robot] - 1
    if params.sight_at == "end":
        complete = np.full(len(robot), history.robot_count)
        return Lookouts(robot, stance, center, complete).select(is_last)
    is_kept = is_last | params.senses("stances")
    return Lookouts(robot, stance, center, robot).select(is_kept)


def in_sight(history: History, views: Views) -> Bools:
    """Find which segments neither meet docks of robots, where these end up, nor the ground.

    A segment that only touches a dock is free.

    Returns:
        Whether each is free, shape (K,).
    """
    if not len(views.robot):
        return np.empty(0, np.bool_)
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import
    from tiswarm.compute.neighbor_kernels import CellList  # noqa: PLC0415
    from tiswarm.sensing.sight_kernels import Segments, SightLimits, find_blocked  # noqa: PLC0415

    radius = history.robot.dock_radius
    turned = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
    dock = (history.position[:, None, :] + turned).reshape(-1, 3)
    limits = SightLimits(
        radius=radius,
        edge=_EDGE * radius,
        stride=2.0 * (np.sqrt(_EDGE**2 - 1.0) - _ROUNDING) * radius,
        docks=turned.shape[1],
    )
    reach = (1.0 + _ROUNDING) * radius
    near = _near_part(views, dock.min(axis=0) - reach, dock.max(axis=0) + reach)
    robots = np.column_stack([views.joined, views.robot, views.target]).astype(np.int32)
    blocked = np.empty(len(robots), np.int32)
    with backend.exclusive():
        backend.processor()
        segments = Segments(views.start, views.end, near, robots)
        cells = CellList.allocate(1, len(dock))
        find_blocked(limits, dock, *segments, *cells, blocked)
    is_free: Bools = (blocked == 0) & ~history.terrain.hides(views.start, views.end)
    return is_free


def _near_part(views: Views, low: Reals, high: Reals) -> Reals:
    """Clip segments to a box; from and to as parts of each segment, shape (K, 2)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.stack([low, high])[:, None] - views.start) / (views.end - views.start)
    enter = np.fmin(*sides)  # NaN: within a side, so beyond all docks
    leave = np.fmax(*sides)
    first = np.fmax.reduce(enter, axis=1, initial=0.0)
    last = np.fmin.reduce(leave, axis=1, initial=1.0)
    return np.column_stack([first, last])
