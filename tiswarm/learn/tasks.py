"""The tasks: what grows, and what an episode is worth.

The return of an episode is the measure of its finished structure: rewards are changes of it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError, did_you_mean


class Structures(NamedTuple):
    """Structures as a measure sees them: n of them, with room for N robots."""

    position: Reals
    """Centers of robots [R], shape (n, N, 3)."""

    present: Bools
    """Whether each robot has joined and not left again, shape (n, N)."""

    joined: Ints
    """Robots that have joined, those that left again included, shape (n,)."""

    crossed: Bools
    """Whether robots join both sides of a gap, shape (n,)."""

    gap: Reals
    """Distance of the edges of a gap [R]; NaN without one, shape (n,)."""


def height(structures: Structures) -> Reals:
    """Height of the highest robot above the ground [R], shape (n,)."""
    z = structures.position[..., 2]
    highest: Reals = np.max(z, axis=1, where=structures.present, initial=0.0)
    return highest


def reach(structures: Structures) -> Reals:
    """Distance of the farthest robot beyond the edge [R], 0 if none is, shape (n,)."""
    x = structures.position[..., 0]
    farthest: Reals = np.max(x, axis=1, where=structures.present, initial=0.0)
    return farthest


def closure(structures: Structures) -> Reals:
    """Share of a gap that robots cover; once it is closed, 1 and the share of robots not needed.

    Covered is all but the widest stretch along x between neighbors, or the edges. Shape (n,).
    """
    robots = structures.present.shape[1]
    gap = structures.gap[:, None]
    x = np.where(structures.present, structures.position[..., 0], 0.0)
    stops = np.sort(np.hstack([np.clip(x, 0.0, gap), np.zeros_like(gap), gap]), axis=1)
    covered = 1.0 - np.diff(stops, axis=1).max(axis=1) / structures.gap
    return np.where(structures.crossed, 2.0 - structures.joined / robots, covered)


@dataclass(frozen=True, kw_only=True)
class GrowthTask:
    """What grows, and what it is worth."""

    aim: str
    """What the robots are to build."""

    structure: Mapping[str, Any]
    """Settings of the structure, as `tiswarm.grow` takes them."""

    measure: Callable[[Structures], Reals]
    """What an episode is worth, from structures as they are."""

    unit: str
    """Unit of the measure."""

    navigation: Mapping[str, Any] = field(default_factory=dict)
    """What robots build by, as `tiswarm.grow` takes it; the truth if empty."""

    robots: int = 60
    """Robots in a structure."""

    most_steps: int = 4000
    """Steps after which an episode is cut off."""


_RUBBLE = [{"kind": "plane"}, {"kind": "mesh", "file": "terrain/rubble.stl", "resolution": 0.5}]
_BY_ESTIMATE = {
    "navigate_by": "estimate",
    "believe": "online",
    "sensing": {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0},
}
_PAYLOAD = {"payload": {"weight": 5.0}}  # of robots; the highest one carries it


def _bridge(gap: float, **settings: object) -> GrowthTask:
    return GrowthTask(
        aim=f"close a gap of {gap:g} R with few robots",
        structure={"kind": "bridge", "gap": gap, **settings},
        measure=closure,
        unit="1",
    )


TASKS: Mapping[str, GrowthTask] = {
    "Tower": GrowthTask(aim="build high", structure={"kind": "tower"}, measure=height, unit="R"),
    "Cantilever": GrowthTask(
        aim="build far out over an edge",
        structure={"kind": "cantilever"},
        measure=reach,
        unit="R",
    ),
    "Bridge": _bridge(20.0),
    "Bridge30": _bridge(30.0),
    # Half bridges of 60 robots end before they meet, and at a threshold of 10 so do those of 120.
    "Bridge40": replace(_bridge(40.0, force_threshold=25.0), robots=120),
    "BreakingBridge": replace(
        _bridge(20.0, strength={"limit": 500.0}), aim="close a gap of 20 R with docks that break"
    ),
    "BelievedBridge": replace(
        _bridge(20.0),
        aim="close a gap of 20 R by own estimates of places",
        navigation=_BY_ESTIMATE,
    ),
    "RubbleTower": GrowthTask(
        aim="carry a payload high on rubble",
        structure={"kind": "tower", "terrain": _RUBBLE, "mechanics": _PAYLOAD},
        measure=height,
        unit="R",
        most_steps=8000,  # robots climb stones, too, and most start several times
    ),
}
"""Tasks by name."""


def task_of(name: str) -> GrowthTask:
    """Return a task.

    Raises:
        InputError: there is none of this name.
    """
    if name not in TASKS:
        raise InputError(f"{name}: no such task{did_you_mean(name, TASKS)}", argument="task")
    return TASKS[name]
