"""The surface of uneven ground around a structure, for pictures and physics engines."""

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.records.surface import GroundSurface
from tiswarm.records.terrain import Terrain
from tiswarm.world.ground.solid import SolidGround
from tiswarm.world.history import History

_AROUND = 8.0
"""Ground beside the docks [R]."""

_FINEST = 0.25
"""Least distance between heights [R]."""

_MOST = 160
"""Most heights along x or y."""

_DEEPEST = 30.0
"""How far below the lowest dock ground is looked for [R]."""

_BELOW = 3.0
"""How far below all ground and docks a height is that stands for no ground [R]."""


def ground_surface(history: History) -> GroundSurface | None:
    """Measure the ground around a structure from above; None for a plane and slabs."""
    if isinstance(history.terrain, Terrain):
        return None
    return _measured(history, history.terrain)


def _measured(history: History, ground: SolidGround) -> GroundSurface:
    turned = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
    dock = history.position[:, None] + turned
    stays = ~history.is_gone
    flat = dock[stays].reshape(-1, 3)
    low, high = flat.min(axis=0) - _AROUND, flat.max(axis=0) + _AROUND
    extent = (high - low)[:2]
    cell = max(_FINEST, float(extent.max()) / (_MOST - 2))
    count = np.ceil(extent / cell).astype(int) + 1
    x, y = np.meshgrid(*(low[c] + cell * np.arange(count[c]) for c in range(2)), indexing="ij")
    above = min(ground.top, high[2] + 100.0) + 1.0
    start = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, above)])
    way = np.zeros_like(start)
    way[:, 2] = low[2] - _DEEPEST - above
    height = above - ground.ways(start, way)
    floor = min(low[2] + _AROUND, float(np.min(height, initial=np.inf, where=height > -np.inf)))
    height[~np.isfinite(height)] = floor - _BELOW
    standing = history.edge_docks.astype(np.int64)
    foot: Reals = np.empty((0, 3))
    if len(standing):
        foot = ground.foot(dock[standing[:, 0], standing[:, 1]])
    return GroundSurface(
        corner=low[:2], cell=cell, height=height.reshape(x.shape), foot_dock=standing, foot=foot
    )


def shown_ground(history: History) -> Terrain | GroundSurface:
    """Return the ground of a structure as pictures need it."""
    if isinstance(history.terrain, Terrain):
        return history.terrain
    return _measured(history, history.terrain)
