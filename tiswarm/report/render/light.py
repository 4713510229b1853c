"""The color of a point: one set of formulas for every renderer."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.render.camera import Array32, Camera
from tiswarm.report.render.scene import Ground, Scene


def sun_direction(camera: Camera) -> Array32:
    """Point to the sun: above the viewer's left shoulder."""
    direction = np.array([-0.5, 0.75, -0.6]) @ camera.axes
    return (direction / np.linalg.norm(direction)).astype(np.float32)


def color_of_capsules(scene: Scene, which: NDArray[np.int64], points: Array32) -> Array32:
    """Color points on the surface of capsules, shape (n, 3).

    Args:
        scene: What is seen.
        which: Capsule of each point, shape (n,).
        points: Where it is touched [R], shape (n, 3).
    """
    start, span = scene.start[which], scene.end[which] - scene.start[which]
    length = np.maximum(_dot(span, span), np.float32(1e-12))
    along = np.clip(_dot(points - start, span) / length, 0.0, 1.0)
    normal = _unit(points - start - along[:, None] * span)
    sun = sun_direction(scene.camera)
    to_eye = _unit(scene.camera.eye.astype(np.float32) - points)
    shade = scene.shade[which]
    open_sky = np.exp(-0.9 * np.maximum(shade[:, 0] + _dot(shade[:, 1:], normal), 0.0))
    open_sun = np.exp(-1.5 * np.maximum(shade[:, 0] + shade[:, 1:] @ sun, 0.0))
    facing = np.clip(_dot(normal, to_eye), 0.0, 1.0)
    shine = np.clip(_dot(normal, _unit(to_eye + sun)), 0.0, 1.0) ** 40
    light = open_sky * (0.62 + 0.16 * normal[:, 2])
    light += open_sun * 0.55 * np.maximum(normal @ sun, 0.0)
    light *= 0.62 + 0.38 * np.minimum(facing / 0.45, 1.0)  # dark rims tell spheres apart
    color: Array32 = scene.color[which] * light[:, None]
    color += (0.16 * open_sun * shine)[:, None]
    return np.asarray(np.clip(color, 0.0, 1.0))


def color_of_ground(ground: Ground, points: Array32) -> tuple[Array32, NDArray[np.bool_]]:
    """Color points of the ground's plane.

    Returns:
        Red, green, blue over white, shape (n, 3), and whether there is ground at all, (n,).
    """
    cells = len(ground.gray)
    place = (points[:, :2] - ground.corner[:2]) / ground.cell
    inside = ((place >= 0.0) & (place < cells - 1)).all(axis=1)
    place = np.clip(place, 0.0, cells - 1.001)
    column, row = place.astype(np.int64).T
    right, down = (place - np.floor(place)).T
    paint = 1.0 - ground.opacity * (1.0 - ground.gray)
    upper = paint[row, column] * (1.0 - right) + paint[row, column + 1] * right
    lower = paint[row + 1, column] * (1.0 - right) + paint[row + 1, column + 1] * right
    value = (upper * (1.0 - down) + lower * down).astype(np.float32)
    inside &= ground.opacity[row, column] > 0.0
    return np.repeat(value[:, None], 3, axis=1), inside


def _dot(a: Array32, b: Array32) -> Array32:
    products: Array32 = np.einsum("ij,ij->i", a, b)
    return products


def _unit(vectors: Array32) -> Array32:
    length = np.sqrt(np.maximum(_dot(vectors, vectors), np.float32(1e-12)))
    units: Array32 = (vectors / length[:, None]).astype(np.float32)
    return units
