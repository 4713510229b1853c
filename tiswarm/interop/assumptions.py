"""What a table of poses does not state, and an import has to assume."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiswarm.base.aliases import Reals

TOLERANCE = 0.02
"""Largest gap and overlap of a contact unless stated otherwise [dock radii]."""


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Facts that a table of poses does not state; lengths in its own unit."""

    dock_radius: float = 1.0
    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None for the three docks in a plane at which
    most docks touch. A table of spheres needs none."""

    gap: float | None = None
    """Largest gap of two docks in contact; if None, 2 % of the dock radius, or more where errors
    of the poses make docks overlap by more."""

    overlap: float | None = None
    """Largest overlap of two docks in contact; as for `gap` if None."""

    contacts: Path | None = None
    """Table `robot,dock,other,other_dock` of all contacts; found from the gaps if None."""

    anchors: tuple[int, ...] = ()
    """Names of robots at known positions, the anchor first; the first robot to join, or of the
    file, if there are none."""

    up: str = "z"
    """Axis of the poses that is up: x, y, z, -x, -y or -z; it becomes z."""

    conjugate: bool = False
    """Whether quaternions turn the world frame to the body's, instead of body to world."""

    ground_z: float | None = None
    """Height of flat ground; None where there is none."""

    heights: bool = False
    """Whether the robots know the heights of their centers."""

    drop_disconnected: bool = False
    """Whether to drop the robots that contacts do not connect to an anchor."""

    drop_incomplete: bool = False
    """Whether to drop rows that lack a number, instead of refusing them."""

    glitch_frames: int = 10
    """Most poses in a row that are left out as one error of tracking; 0 keeps all."""

    tilt_deg: float | None = None
    """Standard deviation of orientations about horizontal axes [deg]; stated if not None."""

    yaw_deg: float | None = None
    """Standard deviation of orientations about the vertical [deg]; stated if not None."""

    length_unit: str = "unit"
    """Unit of lengths where the columns do not name it."""

    @property
    def largest_gap(self) -> float:
        """Largest gap of two docks in contact."""
        return TOLERANCE * self.dock_radius if self.gap is None else self.gap

    @property
    def largest_overlap(self) -> float:
        """Largest overlap of two docks in contact."""
        return TOLERANCE * self.dock_radius if self.overlap is None else self.overlap

    @property
    def spacing(self) -> Reals:
        """Least and greatest distance of the centers of two docks in contact, shape (2,)."""
        return 2.0 * self.dock_radius + np.array([-self.largest_overlap, self.largest_gap])

    @property
    def level(self) -> Reals:
        """Least and greatest height of the center of a dock on the ground; NaN without, (2,)."""
        ground = math.nan if self.ground_z is None else self.ground_z
        return ground + self.dock_radius + np.array([-self.largest_overlap, self.largest_gap])
