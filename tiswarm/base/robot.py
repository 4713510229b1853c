"""The robot: spherical docks at fixed places around a center.

Lengths are in R, the radius of a dock sphere. FireAntV3 carries three docks in one plane,
120 degrees apart; the distance from its center to a dock, rho, is 1.506 R by the FireAnt3D
design files, or 2 / sqrt(3) R if a robot's own docks are taken to touch.
"""

import math
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import Field, ValidationInfo, field_validator
from pydantic.dataclasses import dataclass
from scipy.spatial.distance import pdist

from tiswarm.base.aliases import Reals
from tiswarm.base.params import STRICT

FIREANT_RHO = 1.506
TANGENT_RHO = 2.0 / math.sqrt(3.0)

_SPACING = 2.0
_MAX_OVERLAP = 1e-9
"""Overlap of docks that rounding may leave [R]."""

_FEWEST = 2
"""Least number of docks of a robot."""

_MOST = 8
"""Greatest number of docks of a robot."""

_NEAREST = 0.1
"""Least distance of a dock from the center [R]."""

_FARTHEST = 10.0
"""Greatest distance of a dock from the center [R]."""

Shape = Literal["line", "triangle", "square", "tetrahedron", "octahedron", "cube"]


def _layer(count: int, height: float = 0.0, turn: float = 0.0) -> Reals:
    """Docks at one height of a unit sphere, evenly around the z axis, shape (count, 3)."""
    angle = turn + np.arange(count) * (2.0 * np.pi / count)
    width = math.sqrt(1.0 - height**2)
    return np.column_stack([width * np.cos(angle), width * np.sin(angle), np.full(count, height)])


_HALF = math.sqrt(1.0 / 3.0)
SHAPES: dict[Shape, Reals] = {
    "line": _layer(2),
    "triangle": _layer(3),
    "square": _layer(4),
    "tetrahedron": np.concatenate([_layer(3, -1.0 / 3.0), _layer(1, 1.0)]),
    "octahedron": np.concatenate([_layer(3, -_HALF), _layer(3, _HALF, np.pi / 3.0)]),
    "cube": np.concatenate([_layer(4, -_HALF), _layer(4, _HALF)]),
}
"""Directions from the center to the docks of each shape, lying on a side, shape (docks, 3)."""


class Robot(Protocol):
    """Anything with spherical docks of one size at fixed places, in a unit of its own."""

    @property
    def spacing(self) -> float:
        """D: distance between the centers of two docks that touch."""

    @property
    def dock_offset_body(self) -> Reals:
        """Center to dock in the body frame, shape (docks, 3)."""


_Coordinate = Annotated[float, Field(ge=-_FARTHEST, le=_FARTHEST)]
_Offset = tuple[_Coordinate, _Coordinate, _Coordinate]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RobotGeometry:
    """Two to eight docks around a center: at the corners of a shape, or anywhere.

    A robot starts with the z axis of its body upward, its lowest docks on the ground.
    """

    shape: Shape = "triangle"
    """Shape with a dock at each corner."""

    rho: Annotated[float, Field(ge=1.0, le=_FARTHEST, validate_default=True)] = FIREANT_RHO
    """Distance from the robot's center to each dock center [R]."""

    docks: tuple[_Offset, ...] | None = None
    """Vectors [x, y, z] from the center to each dock in the body frame [R]; they take the place
    of `shape` and `rho`."""

    @field_validator("rho")
    @classmethod
    def _keep_corners_apart(cls, rho: float, info: ValidationInfo) -> float:
        shape = info.data.get("shape")
        if shape:
            closest = float(pdist(SHAPES[shape]).min())
            if rho * closest < _SPACING - _MAX_OVERLAP:
                least = math.ceil(1e4 * (_SPACING - _MAX_OVERLAP) / closest) / 1e4
                problem = f"at {rho:g} the docks of a {shape} overlap; use {least:g} or more"
                raise ValueError(problem)
        return rho

    @field_validator("docks")
    @classmethod
    def _check_docks(
        cls, docks: tuple[_Offset, ...] | None, info: ValidationInfo
    ) -> tuple[_Offset, ...] | None:
        if docks is None:
            return docks
        if info.data != {"shape": "triangle", "rho": FIREANT_RHO}:
            raise ValueError("these docks take the place of shape and rho; remove those")
        if not _FEWEST <= len(docks) <= _MOST:
            raise ValueError(f"a robot has {_FEWEST} to {_MOST} docks, not {len(docks)}")
        distance = np.linalg.norm(docks, axis=1)
        for k in np.flatnonzero((distance < _NEAREST) | (distance > _FARTHEST)):
            raise ValueError(
                f"dock {k} is {distance[k]:.4g} R from the center; "
                f"place it {_NEAREST:g} to {_FARTHEST:g} R away"
            )
        apart = np.linalg.norm(np.subtract(docks, np.expand_dims(docks, 1)), axis=2)
        for i, j in np.argwhere(np.triu(apart < _SPACING - _MAX_OVERLAP, 1)):
            raise ValueError(
                f"docks {i} and {j} are {apart[i, j]:.4g} R apart and overlap; "
                f"place them {_SPACING:g} R apart or more"
            )
        return docks

    @property
    def dock_radius(self) -> float:
        """Radius of a dock sphere [R]."""
        return 1.0

    @property
    def spacing(self) -> float:
        """D: distance between the centers of two docks that touch [R]."""
        return _SPACING

    @property
    def dock_offset_body(self) -> Reals:
        """Center to dock in the body frame [R], shape (docks, 3)."""
        return self.rho * SHAPES[self.shape] if self.docks is None else np.array(self.docks)

    @property
    def dock_count(self) -> int:
        """Number of docks."""
        return len(self.dock_offset_body)

    @property
    def dock_distance(self) -> float:
        """Distance from the center to a dock, the mean one where docks differ [R]."""
        if self.docks is None:
            return self.rho
        return float(np.linalg.norm(self.docks, axis=1).mean())

    @property
    def is_flat(self) -> bool:
        """Whether all docks are in the x-y plane of the body."""
        return not self.dock_offset_body[:, 2].any()

    @property
    def extent(self) -> float:
        """Distance from the center to the farthest dock [R]."""
        return float(np.linalg.norm(self.dock_offset_body, axis=1).max())


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlanarRobot(RobotGeometry):
    """A flat robot that moves in a vertical plane, as FireAnt2D does, with its docks in that plane.

    The docks are in the x-z plane of the body. A turn about y describes every pose in the plane
    y = 0, and keeps y at exactly 0.
    """

    @property
    def dock_offset_body(self) -> Reals:
        """Center to dock in the body frame [R], shape (docks, 3)."""
        return super().dock_offset_body[:, [0, 2, 1]]


def docks_in_plane(distance: float) -> Reals:
    """Center to dock of three docks in the x-y plane so far from the center, shape (3, 3)."""
    return distance * SHAPES["triangle"]
