"""Kinds of structures, their settings: terrain, spawns, anchors, goals, climbing, recruitment."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    Strict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
)
from pydantic.dataclasses import dataclass
from scipy.spatial.distance import pdist, squareform

from tiswarm.base.aliases import AnyInts, Reals
from tiswarm.base.params import STRICT, UNLESS_SET
from tiswarm.base.robot import PlanarRobot, RobotGeometry
from tiswarm.base.sections import Section
from tiswarm.compute.math import uniform
from tiswarm.records.messages import shown
from tiswarm.records.terrain import EDGE_RADIUS, Terrain
from tiswarm.world.ground.solid import SolidGround, Zones
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.strength import StrengthParams

if TYPE_CHECKING:
    from tiswarm.world.ground.bodies import BodyParams

ANCHORS_APART = 10.0
"""Distance of neighbors where anchors are given by their number [R]."""

_MOST_ANCHORS = 1000


def _one_mistake(anchors: object, check: ValidatorFunctionWrapHandler) -> object:
    """Make one mistake of those that a value has as a number and as a list."""
    try:
        return check(anchors)
    except ValidationError as invalid:
        ways = f"a number from 1 to {_MOST_ANCHORS:,}, or that many places like [[0, 0], [12, 0]]"
        raise ValueError(f"{shown(anchors)} should be {ways} within 1e4 R") from invalid


# A wrapped value passes through Python, where strict checks accept no list for a tuple.
_Coordinate = Annotated[float, Strict(), Field(ge=-1e4, le=1e4)]
_Place = Annotated[tuple[_Coordinate, _Coordinate], Strict(strict=False)]
_Places = Annotated[tuple[_Place, ...], Strict(strict=False)]
_Anchors = Annotated[
    Annotated[int, Strict(), Field(ge=1, le=_MOST_ANCHORS)]
    | Annotated[_Places, Field(min_length=1, max_length=_MOST_ANCHORS)]
    | None,
    WrapValidator(_one_mistake),
]


def _as_list(bodies: object) -> object:
    """Let one body stand for a list of it."""
    return [bodies] if isinstance(bodies, Mapping) else bodies


def _be_zones(zones: "tuple[BodyParams, ...]") -> "tuple[BodyParams, ...]":
    """Refuse bodies whose distance costs too much for zones, or has no end."""
    for zone in zones:
        kind = getattr(zone, "kind", "")
        if kind not in ZONE_KINDS:
            raise ValueError(f"{kind} is no region; use {', '.join(ZONE_KINDS)}")
    return zones


ZONE_KINDS = ("box", "cylinder", "sphere")
"""Kinds of bodies that regions which robots may not enter can have."""

# Bodies are imported where a scenario has some. A wrapped value passes through Python, where strict
# checks accept no list for a tuple.
_Body = Annotated[Any, Section("terrain")]
_Listed = Annotated[tuple[_Body, ...], Strict(strict=False), Field(min_length=1, max_length=1000)]
_Bodies = Annotated[_Listed, BeforeValidator(_as_list, json_schema_input_type=_Body | _Listed)]
_Zones = Annotated[_Bodies, AfterValidator(_be_zones)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ReactiveBuild:
    """Robots climb toward the goal, and stay where they are called or came nearest to it."""

    name: Literal["reactive-build"] = "reactive-build"
    """Name of the rule."""


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

    settle: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of the robots that settle: one that stays with two docks touching turns about these
    until a third touches too. Drawn for each robot."""

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
class DepartureParams:
    """Robots that leave or die while the structure grows, one at a time."""

    rate: Annotated[float, Field(ge=0.0, le=1.0)]
    """Chance that a robot leaves or dies after a join. Which one is drawn at random from those that
    joined; founders, which include anchors, stay."""

    kind: Literal["leave", "die"] = "leave"
    """A robot that leaves is gone, with all that reach the ground by its contacts alone. One that
    dies stays: it bears load and is climbed, but senses nothing, calls nobody and passes no call
    on."""

    def drawn(self, seed: int, joiner: int, able: AnyInts) -> int | None:
        """Draw who leaves or dies after the join of robot `joiner`; None for nobody.

        Args:
            seed: Seed of the structure.
            joiner: Number of the robot that joined, on which draws depend besides the seed.
            able: Robots that may be drawn, shape (n,).
        """
        chance, which = uniform(seed, "departure", joiner, np.arange(2))
        if chance >= self.rate or not len(able):
            return None
        return int(able[int(which * len(able))])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BeliefErrorParams:
    """Error of the places that robots believe, in place of that of an estimate."""

    kind: Literal["independent", "shift", "turn", "adding-up"]
    """independent: a draw for each robot. shift: one draw of direction for all but the anchors.
    turn: each side of a gap is turned about the vertical through its anchor. adding-up: the error
    of the robot that it touched first, and a draw of its own. Anchors have none."""

    size: Annotated[float, Field(ge=0.0, le=1e4)]
    """Root mean square of a draw, or length of the shift, in R; angle of the turn, in rad."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GrowthParams(RecruitParams):
    """What all kinds of structures have in common.

    Each kind has a `default_terrain`. For the robots of each side it says what they climb toward
    (`goal`), how far docks are `behind` its edge, or from a tower's axis, and where robots `start`.
    Where anchors are given by their number, it spreads them (`spread`).

    Fields that are inherited carry their text as a description, for the JSON Schema does not
    find the docstrings of a base class.
    """

    sides: ClassVar[int] = 1
    """Sides that robots come from, in turn; the first robot of each founds the structure there."""

    plane: Annotated[
        bool,
        Field(
            description="Whether robots stand and flip in the vertical plane y = 0, as FireAnt2D "
            "does. The only flip axis is its normal; climb.twists, climb.settle and spawn_width "
            "have no effect. A robot starts on its lowest dock; distances of spawns and the anchor "
            "are those of that dock."
        ),
    ] = False

    movers: Annotated[
        int,
        Field(
            ge=1, description="Robots that climb at the same time; keep it below 5 % of the robots."
        ),
    ] = 1

    solve_every: Annotated[
        int, Field(ge=1, description="Joins between two solves of the structure's mechanics.")
    ] = 1

    departures: Annotated[
        DepartureParams | None,
        UNLESS_SET,
        Field(
            description="Robots that leave or die while the structure grows; null for none. Those "
            "that left count among `robots`, and their numbers are not used again.",
        ),
    ] = None

    strength: Annotated[
        StrengthParams | None,
        UNLESS_SET,
        Field(
            description="Load from which contacts break while the structure grows; robots that "
            "nothing ties to the ground then fall. Null for docks that hold any load."
        ),
    ] = None

    belief_error: Annotated[
        BeliefErrorParams | None,
        UNLESS_SET,
        Field(
            description="Error of the places that robots believe, with `navigate_by: error`.",
        ),
    ] = None

    navigate_by: Annotated[
        Literal["truth", "estimate", "error"],
        Field(
            validate_default=True,  # an error of beliefs goes with it
            description="By which places of themselves and of the docks near them robots choose "
            "flips and stops: the true ones, those that the localization method of the case "
            "estimates from what robots have sensed so far, or the true ones with `belief_error`.",
        ),
    ] = "truth"

    anchor: Annotated[
        float | None,
        Field(
            ge=0.0,
            description="Distance behind the edge, or from a tower's axis, at which the anchor is "
            "put, and stays [R]; null for an anchor that starts and climbs like the others.",
        ),
    ] = None

    anchors: Annotated[
        _Anchors,
        UNLESS_SET,
        Field(
            description="Robots at known positions, which are put on the ground before all others "
            "and stay: a list of places [x, y] [R], or their number, 10 R apart around a tower's "
            "axis, or along the edge, as near as all docks are on flat ground, of a bridge along "
            "both edges in turn. In a plane rows are along x. Null for one anchor, as anchor says.",
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
            "a tower's axis (rear), the same without those of anchors (placed), or the one that is "
            "farthest ahead (leading), as far as there is ground."
        ),
    ] = "rear"

    spawn_min: Annotated[
        float, Field(ge=0.0, description="Robots start at least this far behind that dock [R].")
    ] = 3.0

    spawn_max: Annotated[
        float, Field(gt=0.0, description="Robots start at most this far behind that dock [R].")
    ] = 10.0

    rule: Annotated[
        Any,
        Section("rule", by_name=True),
        Field(
            # Runs without the key keep their hashes, which name folders.
            exclude_if=lambda rule: isinstance(rule, ReactiveBuild),
            description="Which flip a climber takes, where it stays and whom it calls: "
            "reactive-build, or the name of a rule of a plug-in, or {name: ...} with its settings.",
        ),
    ] = ReactiveBuild()

    terrain: Annotated[
        _Bodies | None,
        UNLESS_SET,
        Field(
            description="Bodies whose union is the ground; null for the ground of the kind of "
            "structure. One body need not be in a list. A body of a function is a `tiswarm.terrain`"
            " of a plug-in."
        ),
    ] = None

    no_entry: Annotated[
        _Zones | None,
        UNLESS_SET,
        Field(
            description="Regions that no dock of a robot may reach into where a flip ends or a "
            "robot starts: boxes, cylinders and spheres."
        ),
    ] = None

    climb: Annotated[ClimbParams, Field(description="How robots walk.")] = ClimbParams()

    mechanics: Annotated[
        MechanicsParams,
        Field(
            description="How stiff robots and contacts are, where gravity points, what a robot "
            "carries, and whether docks rest on the ground."
        ),
    ] = MechanicsParams()

    @field_validator("anchors")
    @classmethod
    def _place_each_once(cls, anchors: _Anchors, info: ValidationInfo) -> _Anchors:
        if anchors is not None and info.data.get("anchor") is not None:
            raise ValueError("anchor places the first of them; leave out one of the two keys")
        return anchors

    @field_validator("terrain")
    @classmethod
    def _make_ground(
        cls, terrain: "tuple[BodyParams, ...] | None"
    ) -> "tuple[BodyParams, ...] | None":
        if terrain is not None and all(body.is_here for body in terrain):
            _united(terrain)
        return terrain

    @field_validator("mechanics")
    @classmethod
    def _agree_with(cls, mechanics: MechanicsParams, info: ValidationInfo) -> MechanicsParams:
        if mechanics.ground == "rests" and info.data.get("plane"):
            raise ValueError(
                "robots in a plane stand on a line and tip out of it; leave out ground: rests"
            )
        strength = info.data.get("strength")
        masses = {
            part.robot_mass_kg
            for part in (strength, mechanics.payload)
            if part is not None and part.robot_mass_kg is not None
        }
        if len(masses) > 1:
            raise ValueError("payload and strength have robots of different mass; give one mass")
        return mechanics

    @field_validator("navigate_by")
    @classmethod
    def _keep_the_mapped(cls, by: str, info: ValidationInfo) -> str:
        for losing in ("departures", "strength"):
            if by != "truth" and info.data.get(losing) is not None:
                raise ValueError(
                    f"robots that estimate must stay; leave out {losing}, or set truth"
                )
        if by == "error" and info.data.get("belief_error") is None:
            raise ValueError("error needs belief_error, as {kind: independent, size: 0.5}; add it")
        if by != "error" and info.data.get("belief_error") is not None:
            raise ValueError(f"{by} does not go with belief_error; set error, or leave that out")
        return by

    @property
    def anchor_count(self) -> int:
        """Robots at known positions, the first to join."""
        if self.anchors is None:
            return 1
        return self.anchors if isinstance(self.anchors, int) else len(self.anchors)

    @property
    def may_lose(self) -> bool:
        """Whether robots may leave, fall or die while the structure grows."""
        loses = self.departures is not None or self.strength is not None
        return loses or hasattr(self.rule, "act")

    @property
    def founder_count(self) -> int:
        """Robots that may stay without touching another, the first to join."""
        return max(self.founders * self.sides, self.anchor_count)

    def robot(self, shape: RobotGeometry) -> RobotGeometry:
        """Return the robot of this shape that builds the structure, upright in a plane."""
        return PlanarRobot(**vars(shape)) if self.plane else shape

    if TYPE_CHECKING:  # each kind has a name and what `structure` lists

        def __getattr__(self, name: str) -> Any: ...  # noqa: ANN401


@dataclass(frozen=True, kw_only=True, config=STRICT)
class EdgeParams(GrowthParams):
    """What structures at the edge of a slab have in common."""

    spawn_width: Annotated[
        float,
        Field(
            ge=0.0,
            description="Robots start at most this far from the plane y = 0, or beyond the "
            "outermost anchors [R].",
        ),
    ] = 3.0

    @property
    def default_terrain(self) -> Terrain:
        """A slab that ends at x = 0."""
        return Terrain(left_edge=0.0)

    def spread(self, count: int, behind: float) -> Reals:
        """In a row behind the edge [R], shape (count, 2)."""
        row = ANCHORS_APART * np.arange(count)
        if self.plane:
            return np.column_stack([-behind - row, np.zeros(count)])
        along = row - 0.5 * ANCHORS_APART * (count - 1)
        return np.column_stack([np.full(count, -behind), along])

    def behind(self, _side: int, docks: Reals) -> Reals:
        """Distance of docks, shape (n, 3), behind the edge [R], shape (n,)."""
        return np.asarray(-docks[:, 0])

    def start(self, _side: int, rim: float, draw: Reals) -> Reals:
        """At least `rim` behind the edge [R], by two random numbers in [0, 1), shape (2,)."""
        # Robots reach all anchors, however far apart these are along the edge.
        places = np.array(self.anchors or [[0.0, 0.0]])
        if isinstance(self.anchors, int):
            places = self.spread(self.anchors, 0.0)
        low = min(0.0, *places[:, 1].tolist())
        high = max(0.0, *places[:, 1].tolist())
        y = 0.0
        if not self.plane:
            along = (self.spawn_width + 0.5 * (high - low)) * (2.0 * draw[0] - 1.0)
            y = along + 0.5 * (low + high)
        back = rim + (self.spawn_min + draw[1] * (self.spawn_max - self.spawn_min))
        return np.array([-back, y])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TowerParams(GrowthParams):
    """A tower on flat ground: robots climb toward a point above the origin."""

    kind: Literal["tower"] = "tower"
    """Kind of structure."""

    goal_height: Annotated[float, Field(gt=0.0)] = 65.0
    """Height of the goal above the ground [R]."""

    @property
    def default_terrain(self) -> Terrain:
        """A plane."""
        return Terrain()

    def goal(self, _side: int) -> Reals:
        """Above the origin [R], shape (3,)."""
        return np.array([0.0, 0.0, self.goal_height])

    def spread(self, count: int, _behind: float) -> Reals:
        """On a circle about the axis, or a row through it in a plane [R], shape (count, 2)."""
        if self.plane:
            row = ANCHORS_APART * (np.arange(count) - 0.5 * (count - 1))
            return np.column_stack([row, np.zeros(count)])
        radius = 0.0
        if count > 1:
            radius = 0.5 * ANCHORS_APART / np.sin(np.pi / count)
        angle = 2.0 * np.pi * np.arange(count) / count
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

    def behind(self, _side: int, docks: Reals) -> Reals:
        """Distance of docks, shape (n, 3), from the axis [R], shape (n,)."""
        return np.asarray(np.hypot(docks[:, 0], docks[:, 1]))

    def start(self, _side: int, rim: float, draw: Reals) -> Reals:
        """Outside the disc of radius `rim` [R], by two random numbers in [0, 1), shape (2,)."""
        angle = 2.0 * np.pi * draw[0]
        distance = rim + self.spawn_min + draw[1] * (self.spawn_max - self.spawn_min)
        if self.plane:
            return np.array([math.copysign(distance, draw[0] - 0.5), 0.0])
        place: Reals = distance * np.array([np.cos(angle), np.sin(angle)])
        return place


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CantileverParams(EdgeParams):
    """A cantilever from the edge of a slab toward a point out in the air."""

    kind: Literal["cantilever"] = "cantilever"
    """Kind of structure."""

    goal_reach: Annotated[float, Field(gt=0.0)] = 45.0
    """Distance of the goal from the edge [R]."""

    goal_height: float = 10.0
    """Height of the goal above the ground [R]."""

    def goal(self, _side: int) -> Reals:
        """Out in the air [R], shape (3,)."""
        return np.array([self.goal_reach, 0.0, self.goal_height])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BridgeParams(EdgeParams):
    """A bridge over a gap between two slabs; robots come from both sides in turn.

    Side 1 mirrors side 0.
    """

    sides: ClassVar[int] = 2

    kind: Literal["bridge"] = "bridge"
    """Kind of structure."""

    gap: Annotated[float, Field(gt=4.0)] = 20.0
    """Distance between the two edges [R]."""

    goal_beyond: Annotated[float, Field(ge=0.0)] = 10.0
    """Distance of each side's goal past the far edge [R]."""

    @property
    def default_terrain(self) -> Terrain:
        """Two slabs."""
        return Terrain(left_edge=0.0, right_edge=self.gap)

    def goal(self, side: int) -> Reals:
        """Past the far edge, at its height [R], shape (3,)."""
        x = -self.goal_beyond if side else self.gap + self.goal_beyond
        return np.array([x, 0.0, EDGE_RADIUS])

    def spread(self, count: int, behind: float) -> Reals:
        """In rows behind both edges, on the left and on the right in turn [R], shape (count, 2)."""
        places = np.empty((count, 2))
        places[::2] = super().spread(-(-count // 2), behind)
        places[1::2] = super().spread(count // 2, behind)
        places[1::2, 0] = self.gap - places[1::2, 0]
        return places

    def behind(self, side: int, docks: Reals) -> Reals:
        """Distance of docks, shape (n, 3), behind the side's edge [R], shape (n,)."""
        return np.asarray(docks[:, 0] - self.gap if side else -docks[:, 0])

    def start(self, side: int, rim: float, draw: Reals) -> Reals:
        """At least `rim` behind the side's edge [R], shape (2,)."""
        x, y = super().start(side, rim, draw)
        return np.array([self.gap - x if side else x, y])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ChainParams(EdgeParams):
    """A chain that hangs from the edge of a slab toward a point far below."""

    kind: Literal["chain"] = "chain"
    """Kind of structure."""

    goal_depth: Annotated[float, Field(gt=0.0)] = 600.0
    """Depth of the goal below the edge [R]."""

    climb: ClimbParams = ClimbParams(patience=6)
    """How robots walk; they need several steps that bring them no nearer to get over the edge."""

    def goal(self, _side: int) -> Reals:
        """Below the edge [R], shape (3,)."""
        return np.array([EDGE_RADIUS, 0.0, -self.goal_depth])


StructureParams = Annotated[GrowthParams, Section("structure")]
"""Any kind of structure, those of plug-ins included."""


def structure_ground(params: StructureParams) -> Terrain | SolidGround:
    """Return the ground on which a structure grows."""
    default: Terrain = params.default_terrain
    if params.terrain is None:
        return default
    ground = _united(params.terrain)
    if isinstance(ground, SolidGround):
        # Heights and reaches of a kind are measured from the same places on any ground.
        return replace(ground, left_edge=default.left_edge, right_edge=default.right_edge)
    return ground


def _united(terrain: "tuple[BodyParams, ...]") -> Terrain | SolidGround:
    """Unite bodies to a ground."""
    from tiswarm.world.ground.bodies import ground_of  # noqa: PLC0415 - slow to import

    return ground_of(terrain)


def structure_zones(params: StructureParams) -> Zones | None:
    """Return the regions that robots may not enter; None without any."""
    if params.no_entry is None:
        return None
    from tiswarm.world.ground.bodies import zones_of  # noqa: PLC0415 - slow to import

    return zones_of(params.no_entry)


def sides_of_bodies(params: StructureParams, shape: RobotGeometry) -> dict[int, int]:
    """Return, by body of the ground on which robots of a side start, that side."""
    sides = {}
    for side in range(params.sides):
        for body in _bodies_at(params, shape, params.start(side, 0.0, np.array([0.5, 0.5]))[None]):
            sides[body] = side
    return sides


def _bodies_at(params: StructureParams, shape: RobotGeometry, places: Reals) -> list[int]:
    """Find the bodies below places, shape (n, 2); -1 where none is."""
    ground = structure_ground(params)
    if not isinstance(ground, SolidGround):
        return [0] * len(places)
    level = ground.levels(places, np.zeros((len(places), 1, 3)), shape.dock_radius)
    bodies = ground.body_at(np.column_stack([places, np.maximum(level, -1e6)]))
    return [int(body) for body in np.where(np.isfinite(level), bodies, -1)]


def ground_fault(params: StructureParams, shape: RobotGeometry) -> str:
    """Find why robots of a shape cannot start on this ground; empty if they can."""
    ground = structure_ground(params)
    if not isinstance(ground, SolidGround):
        return ""
    starts = [params.start(side, 0.0, np.array([0.5, 0.5])) for side in range(params.sides)]
    for body in params.terrain or ():
        fault: str = body.fault(np.array(starts))
        if fault:
            return fault
    bodies = _bodies_at(params, shape, np.array(starts))
    for (x, y), number in zip(starts, bodies, strict=True):
        if number < 0:
            return f"there is no ground at [{x:.4g}, {y:.4g}], where robots start; put some there"
    if len(set(bodies)) < params.sides:
        return (
            f"both sides start on body {bodies[0]}, so that nobody can say when the gap is "
            "bridged; give each bank a body of its own"
        )
    return ""


def anchor_places(params: StructureParams, shape: RobotGeometry) -> Reals:
    """Place robots of a shape as anchors on the ground [R], shape (k, 2); none for a climber."""
    if isinstance(params.anchors, int):
        spread: Reals = params.spread(params.anchors, _clearance(params, shape))
        return spread
    if params.anchors is not None:
        return np.array(params.anchors)
    if params.anchor is None:
        return np.empty((0, 2))
    return np.array([[0.0 - params.anchor, 0.0]])  # for no distance 0, not -0


def anchor_fault(params: StructureParams, robots: int, shape: RobotGeometry) -> str:
    """Find why so many robots of a shape cannot have these anchors; empty if they can."""
    if params.anchors is None:
        return ""
    return next(_faults(params, robots, shape), "")


def _faults(params: StructureParams, robots: int, shape: RobotGeometry) -> Iterator[str]:
    places = anchor_places(params, shape)
    terrain = structure_ground(params)
    is_solid = isinstance(terrain, SolidGround)
    bodies = _bodies_at(params, shape, places)
    sides = sides_of_bodies(params, shape)
    if len(places) > robots:
        yield f"{len(places)} anchors are more than {robots} robots; give fewer"
    clearance = _clearance(params, shape)
    for j, (x, y) in enumerate(places.tolist()):
        where = f"anchor {j} at [{x:g}, {y:g}]"
        if is_solid and bodies[j] < 0:
            yield f"{where} is off the ground; move it"
        if is_solid and params.sides > 1 and bodies[j] not in sides:
            yield f"{where} is on neither side; move it to where robots start"
        if not is_solid and terrain.left_edge - clearance < x < terrain.right_edge + clearance:
            yield f"{where} is off the ground; keep it {clearance:.4g} R behind the edge"
        if params.plane and y != 0.0:
            yield f"{where} is not in the plane; set its y to 0"
    distance = squareform(pdist(places))
    least = 2.0 * clearance + shape.spacing
    for i, j in np.argwhere(np.triu(distance < least, 1)):
        problem = f"anchors {i} and {j} are {distance[i, j]:.4g} R apart and may overlap"
        yield f"{problem}; place them {least:.4g} R apart or more"
    is_right = places[:, 0] > 0.0
    if is_solid:
        is_right = np.array([sides.get(body, 0) > 0 for body in bodies])
    if params.sides > 1 and (is_right.all() or not is_right.any()):
        yield "both sides need an anchor; add one"


def _clearance(params: StructureParams, shape: RobotGeometry) -> float:
    """Bound how far a robot's docks are from where it is put [R]."""
    # An upright robot is put down by its lowest dock: others are up to twice as far from that.
    if params.plane:
        return 2.0 * shape.extent
    return shape.extent
