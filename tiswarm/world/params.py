"""Kinds of structures and their settings: terrain, spawns, goals, climbing, recruitment."""

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field
from pydantic.dataclasses import dataclass

from tiswarm.aliases import Reals
from tiswarm.params import STRICT
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.terrain import EDGE_RADIUS, Terrain


def _share(value: object) -> object:
    """Accept what `settle` was before it was a share."""
    return float(value) if isinstance(value, bool) else value


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ClimbParams:
    """How a robot walks over the structure until it stops for good."""

    twists: Annotated[int, Field(ge=1, le=64)] = 6
    """Flip axes tried through each attached dock, evenly spread over 180 degrees; each is
    tried in both directions."""

    min_flip_deg: Annotated[float, Field(gt=0.0, lt=180.0)] = math.degrees(0.05)
    """Smallest flip that counts as a step [deg]."""

    max_flip_deg: Annotated[float, Field(gt=0.0, le=360.0)] = 350.0
    """A flip that meets nothing within this angle is not taken [deg]."""

    contact_gap: Annotated[float, Field(gt=0.0, le=0.5)] = 0.02
    """Docks closer than this are in contact [R]; the pair that ends a flip touches exactly."""

    revisit_distance: Annotated[float, Field(ge=0.0)] = 0.05
    """A stance whose center is this close to an earlier one of the walk is not taken [R]."""

    patience: Annotated[int, Field(ge=1)] = 3
    """Steps in a row without a new best distance to the goal with which the robot gives up,
    walks back to its best stance and stays."""

    settle: Annotated[float, Field(ge=0.0, le=1.0), BeforeValidator(_share)] = 0.0
    """Share of the robots that settle: one that stays with two docks touching turns about these
    until the third touches too. Drawn for each robot; true and false stand for 1 and 0."""

    max_flips: Annotated[int, Field(ge=1)] = 400
    """A walk is cut off after this many flips."""

    max_spawns: Annotated[int, Field(ge=1)] = 100
    """Growth ends when a robot has been spawned this often without joining."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RecruitParams:
    """When robots call for help, and how far the call carries."""

    force_threshold: Annotated[
        float,
        Field(gt=0.0, description="F: sensed load from which a robot calls [weight of a dock]."),
    ] = 10.0

    recruit_base: Annotated[
        float, Field(gt=1.0, description="B: how fast the call grows with what is sensed [1].")
    ] = 3.0

    recruit_limit: Annotated[
        int, Field(ge=0, le=1_000_000, description="J: greatest call; 0 switches recruitment off.")
    ] = 5


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GrowthParams(RecruitParams):
    """What all kinds of structures have in common.

    Fields that are inherited carry their text as a description, for the JSON Schema does not
    find the docstrings of a base class.
    """

    movers: Annotated[
        int,
        Field(
            ge=1, description="Robots that climb at the same time; keep it below 5 % of the robots."
        ),
    ] = 1

    solve_every: Annotated[
        int, Field(ge=1, description="Joins between two solves of the structure's mechanics.")
    ] = 1

    anchor: Annotated[
        float | None,
        Field(
            ge=0.0,
            description="Distance behind the edge, or from a tower's axis, at which the anchor is "
            "put, and stays [R]; null for an anchor that starts and climbs like the others.",
        ),
    ] = None

    founders: Annotated[
        int,
        Field(
            ge=1,
            description="Robots of each side, the anchor included, that may stay on the ground "
            "without touching another.",
        ),
    ] = 1

    spawn_behind: Annotated[
        Literal["rear", "placed", "leading"],
        Field(
            description="Dock behind which robots start: the one farthest behind the edge or from "
            "a tower's axis (rear), the same without the anchor's (placed), or the one that is "
            "farthest ahead (leading), as far as there is ground."
        ),
    ] = "rear"

    spawn_min: Annotated[
        float, Field(ge=0.0, description="Robots start at least this far behind that dock [R].")
    ] = 3.0

    spawn_max: Annotated[
        float, Field(gt=0.0, description="Robots start at most this far behind that dock [R].")
    ] = 10.0

    climb: Annotated[ClimbParams, Field(description="How robots walk.")] = ClimbParams()

    mechanics: Annotated[
        MechanicsParams, Field(description="How stiff robots and contacts are.")
    ] = MechanicsParams()


@dataclass(frozen=True, kw_only=True, config=STRICT)
class EdgeParams(GrowthParams):
    """What structures at the edge of a slab have in common."""

    spawn_width: Annotated[
        float, Field(ge=0.0, description="Robots start at most this far from the plane y = 0 [R].")
    ] = 3.0


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TowerParams(GrowthParams):
    """A tower on flat ground: robots climb toward a point above the origin."""

    kind: Literal["tower"] = "tower"
    """Kind of structure."""

    goal_height: Annotated[float, Field(gt=0.0)] = 65.0
    """Height of the goal above the ground [R]."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CantileverParams(EdgeParams):
    """A cantilever from the edge of a slab toward a point out in the air."""

    kind: Literal["cantilever"] = "cantilever"
    """Kind of structure."""

    goal_reach: Annotated[float, Field(gt=0.0)] = 45.0
    """Distance of the goal from the edge [R]."""

    goal_height: float = 10.0
    """Height of the goal above the ground [R]."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BridgeParams(EdgeParams):
    """A bridge over a gap between two slabs; robots come from both sides in turn."""

    kind: Literal["bridge"] = "bridge"
    """Kind of structure."""

    gap: Annotated[float, Field(gt=4.0)] = 20.0
    """Distance between the two edges [R]."""

    goal_beyond: Annotated[float, Field(ge=0.0)] = 10.0
    """Distance of each side's goal past the far edge [R]."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ChainParams(EdgeParams):
    """A chain that hangs from the edge of a slab toward a point far below."""

    kind: Literal["chain"] = "chain"
    """Kind of structure."""

    goal_depth: Annotated[float, Field(gt=0.0)] = 600.0
    """Depth of the goal below the edge [R]."""

    climb: ClimbParams = ClimbParams(patience=6)
    """How robots walk; they need several steps that bring them no nearer to get over the edge."""


StructureParams = Annotated[
    TowerParams | CantileverParams | BridgeParams | ChainParams, Field(discriminator="kind")
]
"""Any kind of structure."""


class Kind(NamedTuple):
    """Terrain, spawns and goals of a kind of structure; functions take the kind's own settings."""

    terrain: Callable[[Any], Terrain]
    goal: Callable[[Any, int], Reals]
    """Goal of robots that come from a side [R], shape (3,)."""

    behind: Callable[[Any, int, Reals], Reals]
    """Distance of docks, shape (n, 3), behind the edge of a side, or from a tower's axis [R],
    shape (n,)."""

    start: Callable[[Any, int, float, Reals], Reals]
    """Spawn of a robot from a side, on the ground [R], shape (2,), given the distance behind the
    edge or from the axis that its own is counted from and two random numbers in [0, 1)."""

    sides: int = 1
    """Sides that robots come from, in turn; the first robot of each founds the structure there."""


def _around(params: TowerParams, _side: int, rim: float, draw: Reals) -> Reals:
    """Anywhere around the disc of radius `rim`."""
    angle = 2.0 * np.pi * draw[0]
    distance = rim + params.spawn_min + draw[1] * (params.spawn_max - params.spawn_min)
    place: Reals = distance * np.array([np.cos(angle), np.sin(angle)])
    return place


def _back(params: BridgeParams, side: int, docks: Reals) -> Reals:
    """Distance behind the edge; only a bridge has a side 1, beyond its gap."""
    back: Reals = docks[:, 0] - params.gap if side else -docks[:, 0]
    return back


def _behind(params: BridgeParams, side: int, rim: float, draw: Reals) -> Reals:
    """At least `rim` behind the edge; side 1 of a bridge mirrors side 0."""
    y = params.spawn_width * (2.0 * draw[0] - 1.0)
    back = rim + (params.spawn_min + draw[1] * (params.spawn_max - params.spawn_min))
    return np.array([params.gap + back if side else -back, y])


KINDS = {
    "tower": Kind(
        terrain=lambda _params: Terrain(),
        goal=lambda params, _side: np.array([0.0, 0.0, params.goal_height]),
        behind=lambda _params, _side, docks: np.hypot(docks[:, 0], docks[:, 1]),
        start=_around,
    ),
    "cantilever": Kind(
        terrain=lambda _params: Terrain(left_edge=0.0),
        goal=lambda params, _side: np.array([params.goal_reach, 0.0, params.goal_height]),
        behind=_back,
        start=_behind,
    ),
    "bridge": Kind(
        terrain=lambda params: Terrain(left_edge=0.0, right_edge=params.gap),
        goal=lambda params, side: np.array(
            [-params.goal_beyond if side else params.gap + params.goal_beyond, 0.0, EDGE_RADIUS]
        ),
        behind=_back,
        start=_behind,
        sides=2,
    ),
    "chain": Kind(
        terrain=lambda _params: Terrain(left_edge=0.0),
        goal=lambda params, _side: np.array([EDGE_RADIUS, 0.0, -params.goal_depth]),
        behind=_back,
        start=_behind,
    ),
}
"""Every kind, by name."""
