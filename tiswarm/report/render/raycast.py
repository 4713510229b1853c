"""Draws a scene by asking, for each pixel, which capsule is seen there.

Who answers is the renderer's choice; everything else (rays, ground, color, soft edges) is
shared. Pixels on an edge are asked for several more times and averaged.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.render.camera import Array32
from tiswarm.report.render.light import color_of_capsules, color_of_ground
from tiswarm.report.render.scene import Scene

Trace = Callable[[Array32], tuple[Array32, NDArray[np.int64]]]
"""From pixels (column, row), shape (n, 2), to the depth of what is seen there, infinite for
nothing, and which capsule it is, or -1; each of shape (n,)."""

SUBPIXELS = np.array(
    [[x + 0.5, (5 * x + 2) % 8 + 0.5] for x in range(8)], dtype=np.float32
) / 8.0  # fmt: skip
"""Where in an edge pixel to look: eight places, no two in one row or column."""

CROWDED = 0.3
"""Share of edge pixels above which half of these places must do."""

GROUND, NOTHING = -1, -2
CHUNK = 400_000
"""Rays at a time, to bound memory."""


def draw(scene: Scene, trace: Trace) -> NDArray[np.uint8]:
    """Draw a scene, shape (height, width, 3)."""
    width, height = scene.camera.width, scene.camera.height
    row, column = np.indices((height, width), dtype=np.float32).reshape(2, -1)
    corner = np.column_stack([column, row])
    color, seen = _look(scene, trace, corner + np.float32(0.5))
    edge = np.flatnonzero(_edges(seen.reshape(height, width)))
    places = SUBPIXELS if len(edge) < CROWDED * len(seen) else SUBPIXELS[::2]
    finer = [_look(scene, trace, corner[edge] + place)[0] for place in places]
    color[edge] = np.mean(finer, axis=0)
    return np.round(255.0 * color).astype(np.uint8).reshape(height, width, 3)


def _look(scene: Scene, trace: Trace, pixels: Array32) -> tuple[Array32, NDArray[np.int64]]:
    """Find color and object (capsule, ground or nothing) at pixels."""
    parts = [
        _look_at_once(scene, trace, pixels[first : first + CHUNK])
        for first in range(0, max(len(pixels), 1), CHUNK)
    ]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _look_at_once(scene: Scene, trace: Trace, pixels: Array32) -> tuple[Array32, NDArray[np.int64]]:
    depth, capsule = trace(pixels)
    eye = scene.camera.eye.astype(np.float32)
    direction = scene.camera.directions(pixels)
    color = np.ones((len(pixels), 3), np.float32)
    seen = np.where(capsule >= 0, capsule, NOTHING)
    if scene.ground is not None:  # a backdrop: it never hides a robot
        low = np.flatnonzero((capsule < 0) & (direction[:, 2] < 0.0))
        fall = (np.float32(scene.ground.corner[2]) - eye[2]) / direction[low, 2]
        gray, there = color_of_ground(scene.ground, eye + fall[:, None] * direction[low])
        there &= fall > 0.0
        color[low[there]] = gray[there]
        seen[low[there]] = GROUND
    hit = np.flatnonzero(seen >= 0)
    points = eye + depth[hit, None] * direction[hit]
    color[hit] = color_of_capsules(scene, seen[hit], points)
    return color, seen


def _edges(seen: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark pixels that see something else than the pixel beside or below, and those pixels."""
    edge = np.zeros(seen.shape, dtype=bool)
    beside, below = seen[:, 1:] != seen[:, :-1], seen[1:] != seen[:-1]
    edge[:, 1:] |= beside
    edge[:, :-1] |= beside
    edge[1:] |= below
    edge[:-1] |= below
    return edge
