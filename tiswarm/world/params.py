"""What a structure to be grown is described by: its kind, its goal, how robots climb."""

import math
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.params import STRICT


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
    """A stance whose centre is this close to an earlier one of the walk is not taken [R]."""

    patience: Annotated[int, Field(ge=1)] = 2
    """Steps without a new best distance to the goal after which the robot walks back to its
    best stance and stays."""

    max_flips: Annotated[int, Field(ge=1)] = 400
    """A walk is cut off after this many flips."""

    max_spawns: Annotated[int, Field(ge=1)] = 100
    """Growth ends when a robot has been spawned this often without joining."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TowerParams:
    """A tower on flat ground: robots climb toward a point above the origin."""

    kind: Literal["tower"] = "tower"
    """Kind of structure."""

    goal_height: Annotated[float, Field(gt=0.0)] = 65.0
    """Height of the goal above the ground [R]."""

    spawn_min: Annotated[float, Field(ge=0.0)] = 3.0
    """Robots start at least this far outside the base [R]."""

    spawn_max: Annotated[float, Field(gt=0.0)] = 10.0
    """Robots start at most this far outside the base [R]."""

    climb: ClimbParams = ClimbParams()
    """How robots walk."""


StructureParams = Annotated[
    TowerParams,  # | each further kind
    Field(discriminator="kind"),
]
"""Any kind of structure."""
