"""Turns capsules into triangles."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints
from tiswarm.report.render.scene import Scene
from tiswarm.report.render.shade import Array32

_SIDES = (6, 48)  # least and most sides of a sphere's equator
_SLANT = 0.9  # upward part below which an axis may be crossed with the vertical


class Mesh(NamedTuple):
    """V points and T triangles of every capsule of a scene."""

    point: Array32  # positions [R], shape (V, 3)
    triangle: NDArray[np.int32]  # its points, counterclockwise from outside, shape (T, 3)
    point_capsule: Ints  # capsule of each point, shape (V,)
    triangle_capsule: Ints  # capsule of each triangle, shape (T,)


def mesh_capsules(scene: Scene, sides: int | None = None) -> Mesh:
    """Mesh the capsules of a scene; an equator has more sides if it looks larger, or `sides`."""
    depth = float(np.median(scene.camera.project(scene.start.astype(np.float64))[:, 2]))
    points, triangles, order, counts, first = [], [], [], [], 0
    for radius in np.unique(scene.radius):
        which = np.flatnonzero(scene.radius == radius)
        seen = float(radius) * scene.camera.pixels_per_slope / depth
        even = int(np.clip(3.2 * seen**0.58, *_SIDES)) // 2 * 2
        point, triangle = _unit_sphere(sides or even)
        points.append(_stretch(scene.start[which], scene.end[which], radius * point))
        firsts = first + np.arange(len(which)) * len(point)
        triangles.append((firsts[:, None, None] + triangle).reshape(-1, 3))
        order.append(which)
        counts.append(np.tile([len(point), len(triangle)], (len(which), 1)))
        first += len(which) * len(point)
    capsule, count = np.concatenate(order), np.concatenate(counts)
    return Mesh(
        point=np.concatenate(points),
        triangle=np.concatenate(triangles).astype(np.int32),
        point_capsule=capsule.repeat(count[:, 0]),
        triangle_capsule=capsule.repeat(count[:, 1]),
    )


def _unit_sphere(sides: int) -> tuple[Array32, NDArray[np.int32]]:
    """Wrap a grid around the z axis; its rings are odd in number, so none is the equator."""
    rings = sides // 2 | 1
    polar, around = np.pi * np.arange(rings + 1) / rings, 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(around), np.sin(around)])
    flat = (np.sin(polar)[:, None, None] * circle).reshape(-1, 2)
    point = np.column_stack([flat, -np.cos(polar).repeat(sides)]).astype(np.float32)
    ring, side = np.indices((rings, sides)).reshape(2, -1)
    a = ring * sides + side
    b = ring * sides + (side + 1) % sides
    lower, upper = np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])
    # the triangles that end in a pole have one point less
    return point, np.concatenate([lower[ring > 0], upper[ring < rings - 1]]).astype(np.int32)


def _stretch(start: Array32, end: Array32, ball: Array32) -> Array32:
    """Put the lower half of a ball around each start and the upper around the end, (n * V, 3)."""
    span = (end - start).astype(np.float64)
    span[:, 2] += 1e-9  # a sphere has no axis: take z
    axis = span / np.linalg.norm(span, axis=1, keepdims=True)
    helper = np.where(np.abs(axis[:, 2:]) < _SLANT, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(helper, axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    frames = np.stack([side, np.cross(axis, side), axis], axis=1).astype(np.float32)
    base = np.where(ball[:, 2:] > 0.0, end[:, None], start[:, None])
    point: Array32 = base + ball @ frames
    return point.reshape(-1, 3)
