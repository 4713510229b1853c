"""The robot: spherical docks at fixed places around a center.

Lengths are in R, the radius of a dock sphere. FireAntV3 carries three docks in one plane,
120 degrees apart; the distance from its center to a dock, rho, is 1.506 R by the FireAnt3D
design files, or 2 / sqrt(3) R if a robot's own docks are taken to touch.
"""

import math
from typing import Annotated, Protocol

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.aliases import Reals
from tiswarm.params import STRICT

DOCK_COUNT = 3
FIREANT_RHO = 1.506
TANGENT_RHO = 2.0 / math.sqrt(3.0)


class Robot(Protocol):
    """Anything with spherical docks of one size at fixed places, in a unit of its own."""

    @property
    def spacing(self) -> float:
        """D: distance between the centers of two docks that touch."""

    @property
    def dock_offset_body(self) -> Reals:
        """Center to dock in the body frame, shape (docks, 3)."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RobotGeometry:
    """Three docks in the x-y plane of the body, at 0, 120 and 240 degrees."""

    rho: Annotated[float, Field(ge=TANGENT_RHO - 1e-12, le=10.0)] = FIREANT_RHO
    """Distance from the robot's center to each dock center [R]."""

    @property
    def dock_radius(self) -> float:
        """Radius of a dock sphere [R]."""
        return 1.0

    @property
    def spacing(self) -> float:
        """D: distance between the centers of two docks that touch [R]."""
        return 2.0 * self.dock_radius

    @property
    def dock_offset_body(self) -> Reals:
        """Center to dock in the body frame [R], shape (3, 3)."""
        return docks_in_plane(self.rho)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlanarRobot(RobotGeometry):
    """A robot that moves in a vertical plane, as FireAnt2D does, with three docks in that plane.

    The docks are in the x-z plane of the body. A turn about y describes every pose in the plane
    y = 0, and keeps y at exactly 0.
    """

    @property
    def dock_offset_body(self) -> Reals:
        """Center to dock in the body frame [R], shape (3, 3)."""
        return docks_in_plane(self.rho)[:, [0, 2, 1]]


def docks_in_plane(distance: float) -> Reals:
    """Center to dock of three docks in the x-y plane so far from the center, shape (3, 3)."""
    angle = np.arange(DOCK_COUNT) * (2.0 * np.pi / DOCK_COUNT)
    return distance * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(DOCK_COUNT)])
