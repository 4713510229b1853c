"""What is to be seen, in plain arrays that every renderer understands.

Everything but the ground is a capsule: the points within a radius of a segment. A sphere is a
capsule whose two ends coincide. A scene carries the light that each capsule and the ground
receive, so that all renderers show the same picture.
"""

from dataclasses import dataclass

from tiswarm.report.render.camera import Array, Array32, Camera


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A square patch of flat ground, cut into cells."""

    corner: Array
    """Center of the cell with the least x and y [R], shape (3,)."""

    cell: float
    """Distance between the centers of two cells [R]."""

    gray: Array32
    """Brightness, by y and x cell, shape (cells, cells)."""

    opacity: Array32
    """From 0 (not there) to 1, by y and x cell, shape (cells, cells)."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """P capsules, perhaps a ground, and a camera, against white."""

    start: Array32
    """One end of each segment [R], shape (P, 3)."""

    end: Array32
    """Other end of each segment [R], shape (P, 3)."""

    radius: Array32
    """Radius of each [R], shape (P,)."""

    color: Array32
    """Red, green, blue of each, 0 to 1, shape (P, 3)."""

    shade: Array32
    """Light blocked: on average, and toward x, y and z, shape (P, 4)."""

    camera: Camera
    ground: Ground | None
