"""The kinds of structures: their ground, where robots start, where they want to be."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.world.params import BridgeParams, EdgeParams, TowerParams
from tiswarm.world.terrain import EDGE_RADIUS, Terrain

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What growth must know of a kind of structure; functions take the kind's own settings."""

    terrain: Callable[[Any], Terrain]
    goal: Callable[[Any, int], Array]
    """Where robots that come from a side want to be [R], shape (3,)."""

    start: Callable[[Any, int, Array, Array], Array]
    """Where on the ground a robot from a side starts [R], shape (2,), given the structure's
    docks, shape (n, 3), and two random numbers in [0, 1)."""

    sides: int = 1
    """Sides that robots come from, in turn; the first from each founds the structure there."""


def _around(params: TowerParams, _side: int, docks: Array, draw: Array) -> Array:
    """Anywhere around the disc about the z axis that holds the whole structure."""
    rim = _greatest(np.hypot(docks[:, 0], docks[:, 1]))
    angle = 2.0 * np.pi * draw[0]
    distance = rim + params.spawn_min + draw[1] * (params.spawn_max - params.spawn_min)
    return distance * np.array([np.cos(angle), np.sin(angle)])


def _behind(params: EdgeParams, _side: int, docks: Array, draw: Array) -> Array:
    """Behind the dock that is farthest from the edge at x = 0."""
    back = _greatest(-docks[:, 0])
    y = params.spawn_width * (2.0 * draw[0] - 1.0)
    back += params.spawn_min + draw[1] * (params.spawn_max - params.spawn_min)
    return np.array([-back, y])


def _behind_either(params: BridgeParams, side: int, docks: Array, draw: Array) -> Array:
    """Behind the farthest dock on one side of the gap, which is mirrored for the other."""
    if side == 0:
        return _behind(params, side, docks, draw)
    mirrored = np.array([params.gap, 0.0, 0.0]) - docks * [1.0, -1.0, -1.0]
    x, y = _behind(params, side, mirrored, draw)
    return np.array([params.gap - x, y])


def _greatest(distance: Array) -> float:
    """Greatest distance to the rim of a dock [R], at least 0."""
    return float(distance.max(initial=-1.0)) + 1.0


KINDS = {
    "tower": Kind(
        terrain=lambda _params: Terrain(),
        goal=lambda params, _side: np.array([0.0, 0.0, params.goal_height]),
        start=_around,
    ),
    "cantilever": Kind(
        terrain=lambda _params: Terrain(left_edge=0.0),
        goal=lambda params, _side: np.array([params.goal_reach, 0.0, params.goal_height]),
        start=_behind,
    ),
    "bridge": Kind(
        terrain=lambda params: Terrain(left_edge=0.0, right_edge=params.gap),
        goal=lambda params, side: np.array(
            [
                params.gap + params.goal_beyond if side == 0 else -params.goal_beyond,
                0.0,
                EDGE_RADIUS,
            ]
        ),
        start=_behind_either,
        sides=2,
    ),
    "chain": Kind(
        terrain=lambda _params: Terrain(left_edge=0.0),
        goal=lambda params, _side: np.array([EDGE_RADIUS, 0.0, -params.goal_depth]),
        start=_behind,
    ),
}
"""Every kind, by name."""
