"""A pinhole camera, and where to put it so that a structure fills the picture."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

ELEVATION = math.radians(14.0)
OBLIQUE = math.radians(20.0)
"""How far the view is turned away from facing the long side."""

LENS = math.tan(math.radians(12.0))
"""Half of the longer side of the picture at distance 1."""

ASPECTS = (0.45, 2.4)
"""Least and greatest width over height."""

MARGIN = 1.06
PIXELS = 1_100_000


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Where the eye is, which way it looks, and how large the picture is."""

    eye: Array
    """Position of the eye [R], shape (3,)."""

    axes: Array
    """Right, up and forward, unit vectors in rows, shape (3, 3)."""

    half_height: float
    """Half height of the picture at distance 1."""

    width: int
    height: int
    """Size of the picture [pixels]."""

    @property
    def pixels_per_slope(self) -> float:
        """Pixels between directions whose right or up parts differ by 1 at distance 1."""
        return 0.5 * self.height / self.half_height

    def directions(self, pixels: Array32) -> Array32:
        """Aim a ray through each pixel, forward part 1, shape (n, 3).

        Args:
            pixels: Column and row from the top left corner, fractions allowed, shape (n, 2).
        """
        middle = np.array([self.width, self.height], dtype=np.float32) / 2
        slope = (pixels - middle) / np.float32(self.pixels_per_slope)
        right, up, forward = (self.axes * [[1.0], [-1.0], [1.0]]).astype(np.float32)
        rays: Array32 = slope[:, :1] * right + slope[:, 1:] * up + forward
        return rays

    def project(self, points: Array) -> Array:
        """Turn world points to right, up and forward parts as the eye sees them, shape (n, 3)."""
        return (points - self.eye) @ self.axes.T


def frame(points: Array, radius: float) -> Camera:
    """Place a camera that sees balls of one radius around every point, and little else.

    Args:
        points: Centers [R], shape (n, 3).
        radius: Radius of each ball [R].
    """
    back = _view_direction(points)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(back, right), -back])
    seen = points @ axes.T
    wide, tall, _ = np.ptp(seen, axis=0) + 2.0 * radius
    aspect = float(np.clip(wide / tall, *ASPECTS))
    height = round(math.sqrt(PIXELS / aspect) / 2.0) * 2
    width = round(aspect * height / 2.0) * 2
    half_height = LENS / max(aspect, 1.0)
    right_at, right_distance = _stand_back(seen[:, 0], seen[:, 2], radius, aspect * half_height)
    up_at, up_distance = _stand_back(seen[:, 1], seen[:, 2], radius, half_height)
    place = np.array([right_at, up_at, -max(right_distance, up_distance)])
    return Camera(eye=place @ axes, axes=axes, half_height=half_height, width=width, height=height)


def _view_direction(points: Array) -> Array:
    """Point from the structure to the eye: from the -y side, a little above, onto the long side."""
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    spread, direction = np.linalg.eigh(flat.T @ flat)
    along = direction[:, 1] if spread[1] > 2.0 * spread[0] else np.array([1.0, 0.0])
    facing = math.atan2(-abs(along[0]), along[1] * np.sign(along[0] or 1.0))
    azimuth = facing + OBLIQUE
    flat_part = math.cos(ELEVATION)
    return np.array(
        [flat_part * math.cos(azimuth), flat_part * math.sin(azimuth), math.sin(ELEVATION)]
    )


def _stand_back(across: Array, depth: Array, radius: float, slope: float) -> tuple[float, float]:
    """Find where the eye must be for every ball to lie between two planes through it.

    Returns:
        Its place across the view, and how far in front of depth 0 it must stay.
    """
    slope /= MARGIN
    reach = radius * math.hypot(1.0, slope)
    above = float(np.max(across - slope * depth)) + reach
    below = float(np.max(-across - slope * depth)) + reach
    return (above - below) / 2.0, (above + below) / (2.0 * slope)
