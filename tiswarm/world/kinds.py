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

    rim: Callable[[Any, int, Array], float]
    """How far docks, shape (n, 3), reach out toward where robots from a side start [R], at
    least 0."""

    start: Callable[[Any, int, float, Array], Array]
    """Where on the ground a robot from a side starts [R], shape (2,), given how far the whole
    structure reaches out there and two random numbers in [0, 1)."""

    sides: int = 1
    """Sides that robots come from, in turn; the first from each founds the structure there."""


def _radius(_params: TowerParams, _side: int, docks: Array) -> float:
    """Radius of the disc about the z axis that holds all docks."""
    return _greatest(np.hypot(docks[:, 0], docks[:, 1]))


def _around(params: TowerParams, _side: int, rim: float, draw: Array) -> Array:
    """Anywhere around the disc that holds the whole structure."""
    angle = 2.0 * np.pi * draw[0]
    distance = rim + params.spawn_min + draw[1] * (params.spawn_max - params.spawn_min)
    place: Array = distance * np.array([np.cos(angle), np.sin(angle)])
    return place


def _back(_params: EdgeParams, _side: int, docks: Array) -> float:
    """Distance from the edge at x = 0 to the farthest dock."""
    return _greatest(-docks[:, 0])


def _behind(params: EdgeParams, _side: int, rim: float, draw: Array) -> Array:
    """Behind the dock that is farthest from the edge at x = 0."""
    y = params.spawn_width * (2.0 * draw[0] - 1.0)
    back = rim + (params.spawn_min + draw[1] * (params.spawn_max - params.spawn_min))
    return np.array([-back, y])


def _back_on_either(params: BridgeParams, side: int, docks: Array) -> float:
    """Distance from the edge on one side of the gap to the farthest dock there."""
    return _back(params, side, docks) if side == 0 else _greatest(docks[:, 0] - params.gap)


def _behind_either(params: BridgeParams, side: int, rim: float, draw: Array) -> Array:
    """Behind the farthest dock on one side of the gap, which is mirrored for the other."""
    x, y = _behind(params, side, rim, draw)
    return np.array([x if side == 0 else params.gap - x, y])


def _greatest(distance: Array) -> float:
    """Greatest distance to the rim of a dock [R], at least 0."""
    return float(distance.max(initial=-1.0)) + 1.0


KINDS = {
    "tower": Kind(
        terrain=lambda _params: Terrain(),
        goal=lambda params, _side: np.array([0.0, 0.0, params.goal_height]),
        rim=_radius,
        start=_around,
    ),
    "cantilever": Kind(
        terrain=lambda _params: Terrain(left_edge=0.0),
        goal=lambda params, _side: np.array([params.goal_reach, 0.0, params.goal_height]),
        rim=_back,
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
        rim=_back_on_either,
        start=_behind_either,
        sides=2,
    ),
    "chain": Kind(
        terrain=lambda _params: Terrain(left_edge=0.0),
        goal=lambda params, _side: np.array([EDGE_RADIUS, 0.0, -params.goal_depth]),
        rim=_back,
        start=_behind,
    ),
}
"""Every kind, by name."""
