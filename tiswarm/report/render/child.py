"""Draws scenes with one renderer in a process of its own, which may die without harm.

python -m tiswarm.report.render.child SCENE OUT.png [SCENE OUT.png ...] --renderer NAME

A scene is a pickle of the process that starts this.
"""

import argparse
import contextlib
import ctypes
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.render.camera import Array32
from tiswarm.report.render.light import color_of_capsules, color_of_ground
from tiswarm.report.render.mesh import mesh_capsules
from tiswarm.report.render.raycast import Trace, draw
from tiswarm.report.render.scene import Ground, Scene
from tiswarm.report.render.tiles import tile_tracer

Picture = NDArray[np.uint8]

GROUND_PUSH = 3.0
"""The ground is moved away from the eye by this factor: it looks the same and hides nothing."""


def main(arguments: list[str] | None = None) -> None:
    """Draw each scene file into its picture file."""
    from PIL import Image  # noqa: PLC0415 - not needed before there is a picture

    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--renderer", choices=PAINTERS, required=True)
    options = parser.parse_args(arguments)
    scenes = [pickle.loads(path.read_bytes()) for path in options.files[::2]]  # noqa: S301
    pictures = PAINTERS[options.renderer](scenes)
    for picture, path in zip(pictures, options.files[1::2], strict=True):
        Image.fromarray(picture).save(path, compress_level=1)


def _open3d() -> Any:  # noqa: ANN401 - open3d has no types
    """Import open3d, helped by the PyPI package that brings libusb, where there is one."""
    with contextlib.suppress(ImportError, OSError):
        import libusb_package  # noqa: PLC0415 - optional

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    os.environ.setdefault("EGL_PLATFORM", "surfaceless")
    import open3d

    return open3d


def paint_open3d(scenes: list[Scene]) -> list[Picture]:
    """Draw by rasterizing merged meshes that carry their final color, twice as large."""
    o3d = _open3d()
    rendering = o3d.visualization.rendering
    wide = 2 * max(scene.camera.width for scene in scenes)
    tall = 2 * max(scene.camera.height for scene in scenes)
    renderer = rendering.OffscreenRenderer(wide, tall)
    _plain(rendering, renderer)
    pictures = []
    for scene in scenes:
        renderer.scene.clear_geometry()
        material = rendering.MaterialRecord()
        material.shader = "defaultUnlit"
        for name, mesh in _colored_meshes(o3d, scene).items():
            renderer.scene.add_geometry(name, mesh, material)
        _aim(renderer, scene, wide, tall)
        image = np.asarray(renderer.render_to_image())[:, :, :3]
        image = image[: 2 * scene.camera.height, : 2 * scene.camera.width].astype(np.uint16)
        quarters = image[::2, ::2] + image[::2, 1::2] + image[1::2, ::2] + image[1::2, 1::2]
        pictures.append(((quarters + 2) // 4).astype(np.uint8))
    return pictures


def _plain(rendering: Any, renderer: Any) -> None:  # noqa: ANN401 - untyped
    """Switch off what would change colors or cost time; keep no reference to the view."""
    off = False  # the functions take it by position only
    renderer.scene.set_background([1.0, 1.0, 1.0, 1.0])
    renderer.scene.view.set_post_processing(off)
    renderer.scene.view.set_antialiasing(off, off)
    renderer.scene.view.set_ambient_occlusion(off, off)
    renderer.scene.view.set_shadowing(off, rendering.View.ShadowType.PCF)


def _aim(renderer: Any, scene: Scene, wide: int, tall: int) -> None:  # noqa: ANN401 - untyped
    """Point the renderer's camera so that the picture fills its top left corner."""
    camera = scene.camera
    focal = 2.0 * camera.pixels_per_slope
    lens = np.array([[focal, 0.0, camera.width], [0.0, focal, camera.height], [0.0, 0.0, 1.0]])
    depth = camera.project(scene.start.astype(np.float64))[:, 2]
    near, far = max(depth.min() - 2.0, 0.1), GROUND_PUSH * 2.0 * (depth.max() + 2.0)
    renderer.scene.camera.set_projection(lens, near, far, wide, tall)
    renderer.scene.camera.look_at(camera.eye + camera.axes[2], camera.eye, camera.axes[1])


def _colored_meshes(o3d: Any, scene: Scene) -> dict[str, Any]:  # noqa: ANN401 - untyped
    mesh = mesh_capsules(scene)
    color = color_of_capsules(scene, mesh.point_capsule, mesh.point)
    meshes = {"capsules": _tensor_mesh(o3d, mesh.point, mesh.triangle, color)}
    if scene.ground is not None:
        point, triangle = _ground_grid(scene.ground)
        color, _ = color_of_ground(scene.ground, point)
        eye = scene.camera.eye.astype(np.float32)
        point = eye + np.float32(GROUND_PUSH) * (point - eye)
        meshes["ground"] = _tensor_mesh(o3d, point, triangle, color)
    return meshes


def _ground_grid(ground: Ground) -> tuple[Array32, NDArray[np.int32]]:
    """Make two triangles of each cell where there is ground."""
    cells = len(ground.gray) - 1
    row, column = np.indices((cells + 1, cells + 1)).reshape(2, -1)
    flat = ground.corner[:2] + ground.cell * np.column_stack([column, row])
    point = np.column_stack([flat, np.full(len(flat), ground.corner[2])]).astype(np.float32)
    row, column = np.nonzero(ground.opacity[:-1, :-1] > 0.0)
    a = row * (cells + 1) + column
    up = a + cells + 1
    triangle = np.concatenate(
        [np.column_stack([a, a + 1, up + 1]), np.column_stack([a, up + 1, up])]
    )
    return point, triangle.astype(np.int32)


def _tensor_mesh(
    o3d: Any,  # noqa: ANN401 - untyped
    point: Array32,
    triangle: NDArray[np.int32],
    color: Array32,
) -> Any:  # noqa: ANN401 - untyped
    mesh = o3d.t.geometry.TriangleMesh(o3d.core.Tensor(point), o3d.core.Tensor(triangle))
    mesh.vertex.colors = o3d.core.Tensor(np.ascontiguousarray(color, dtype=np.float32))
    mesh.vertex.normals = o3d.core.Tensor(np.ones_like(point))  # not used, but missed
    return mesh


def paint_open3d_raycast(scenes: list[Scene]) -> list[Picture]:
    """Draw by casting rays at meshes with Embree."""
    o3d = _open3d()
    return [draw(scene, _embree_tracer(o3d, scene)) for scene in scenes]


def _embree_tracer(o3d: Any, scene: Scene) -> Trace:  # noqa: ANN401 - untyped
    mesh = mesh_capsules(scene)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(
        o3d.core.Tensor(mesh.point), o3d.core.Tensor(mesh.triangle.astype(np.uint32))
    )
    eye = scene.camera.eye.astype(np.float32)
    nothing = o3d.t.geometry.RaycastingScene.INVALID_ID

    def trace(pixels: Array32) -> tuple[Array32, NDArray[np.int64]]:
        direction = scene.camera.directions(pixels)
        rays = np.column_stack([np.broadcast_to(eye, direction.shape), direction])
        answer = caster.cast_rays(o3d.core.Tensor(rays))
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        missed = triangle == nothing
        triangle[missed] = 0
        return answer["t_hit"].numpy(), np.where(missed, -1, mesh.triangle_capsule[triangle])

    return trace


def paint_taichi(scenes: list[Scene]) -> list[Picture]:
    """Draw by casting rays in a kernel of our own."""
    return [draw(scene, tile_tracer(scene)) for scene in scenes]


PAINTERS: dict[str, Callable[[list[Scene]], list[Picture]]] = {
    "open3d": paint_open3d,
    "open3d-raycast": paint_open3d_raycast,
    "taichi": paint_taichi,
}
"""The renderers, best first."""


if __name__ == "__main__":
    main()
