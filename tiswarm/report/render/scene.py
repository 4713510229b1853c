"""What is to be seen, in plain arrays that every renderer understands.

Everything but the ground is a capsule: the points within a radius of a segment. A sphere is a
capsule whose two ends coincide. A scene carries the light that each capsule and the ground
receive, so that all renderers show the same picture.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.render.camera import Camera

PARTS = ("camera", "ground")
"""Fields of a scene that have fields of their own."""


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A square patch of flat ground, cut into cells."""

    corner: NDArray[np.float64]
    """Center of the cell with the least x and y [R], shape (3,)."""

    cell: float
    """Distance between the centers of two cells [R]."""

    gray: NDArray[np.float32]
    """Brightness, by y and x cell, shape (cells, cells)."""

    opacity: NDArray[np.float32]
    """From 0 (not there) to 1, by y and x cell, shape (cells, cells)."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """P capsules, perhaps a ground, and a camera, against white."""

    start: NDArray[np.float32]
    """One end of each segment [R], shape (P, 3)."""

    end: NDArray[np.float32]
    """Other end of each segment [R], shape (P, 3)."""

    radius: NDArray[np.float32]
    """Radius of each [R], shape (P,)."""

    color: NDArray[np.float32]
    """Red, green, blue of each, 0 to 1, shape (P, 3)."""

    shade: NDArray[np.float32]
    """Light blocked: on average, and toward x, y and z, shape (P, 4)."""

    camera: Camera
    ground: Ground | None

    def save(self, path: Path) -> None:
        """Write the scene to one file, for `load`."""
        arrays = {key: value for key, value in vars(self).items() if key not in PARTS}
        for name in PARTS:
            part = getattr(self, name)
            arrays |= {f"{name}.{key}": value for key, value in vars(part).items()} if part else {}
        np.savez(path, **arrays)

    @classmethod
    def load(cls, path: Path) -> "Scene":
        """Read what `save` wrote."""
        with np.load(path) as file:
            arrays = {key: value if value.ndim else value.item() for key, value in file.items()}
        parts = {
            name: {
                key.partition(".")[2]: arrays.pop(key)
                for key in [*arrays]
                if key.startswith(f"{name}.")
            }
            for name in PARTS
        }
        ground = Ground(**parts["ground"]) if parts["ground"] else None
        return cls(**arrays, camera=Camera(**parts["camera"]), ground=ground)
