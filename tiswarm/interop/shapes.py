"""A case as shapes in space that files for 3D programs can hold."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.render.build import Robots, build_scene
from tiswarm.report.render.legend import ERROR_COLORS, colors_along
from tiswarm.report.render.mesh import mesh_capsules
from tiswarm.report.render.subjects import TRUE_SIZE, Subject

SIDES = 10
"""Sides of a dock sphere's equator: round enough, and files stay small."""

EDGE_GRAY = 0.2


@dataclass(frozen=True, kw_only=True)
class Shape:
    """V points, joined to triangles or to lines."""

    name: str
    """What it is."""

    point: NDArray[np.float32]
    """Places [R], shape (V, 3)."""

    normal: NDArray[np.float32] | None
    """Which way is out at each point, of triangles alone, shape (V, 3)."""

    color: NDArray[np.float32]
    """Red, green, blue (sRGB) of each point, 0 to 1, shape (V, 3)."""

    index: NDArray[np.uint32]
    """Points of each triangle, shape (T, 3), or of each line, shape (L, 2)."""


def shapes_of(subject: Subject) -> list[Shape]:
    """The structure, its estimate colored by error, and its contacts between true centers."""
    worst = max(np.nanmax(subject.error, initial=0.0), 1e-9)
    by_error = colors_along(np.nan_to_num(subject.error) / worst, ERROR_COLORS)
    pairs = subject.log.contacts[:, [0, 2]].astype(np.uint32)
    center = subject.pose[:, :3].astype(np.float32)
    return [
        _solid("structure", subject.robots(subject.pose, subject.by_join, TRUE_SIZE)),
        _solid("estimate", subject.robots(subject.estimated_pose, by_error, TRUE_SIZE)),
        Shape(
            name="contacts",
            point=center,
            normal=None,
            color=np.full((len(center), 3), EDGE_GRAY, np.float32),
            index=pairs,
        ),
    ]


def _solid(name: str, robots: Robots) -> Shape:
    """Mesh robots; a point's normal leads away from the axis of its capsule."""
    scene = build_scene([robots], None)
    mesh = mesh_capsules(scene, sides=SIDES)
    start, end = scene.start[mesh.point_capsule], scene.end[mesh.point_capsule]
    span = end - start
    length = np.maximum(np.sum(span**2, axis=1), 1e-12)
    along = np.clip(np.sum((mesh.point - start) * span, axis=1) / length, 0.0, 1.0)
    away = mesh.point - start - along[:, None] * span
    return Shape(
        name=name,
        point=mesh.point,
        normal=(away / np.linalg.norm(away, axis=1, keepdims=True)).astype(np.float32),
        color=scene.color[mesh.point_capsule],
        index=mesh.triangle.astype(np.uint32),
    )
