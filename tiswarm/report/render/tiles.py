"""The `taichi` renderer: exact capsules, sorted into tiles of the picture."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.report.render.camera import Array, Array32
from tiswarm.report.render.raycast import Trace
from tiswarm.report.render.scene import Scene

TILE = 12
"""Edge of a tile [pixels]."""


def tile_tracer(scene: Scene) -> Trace:
    """Prepare a kernel that looks only at the capsules near each ray."""
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import
    from tiswarm.report.render.kernels import FAR, trace_capsules  # noqa: PLC0415 - likewise

    backend.current()
    camera = scene.camera
    start = camera.project(scene.start.astype(np.float64))
    end = camera.project(scene.end.astype(np.float64))
    nearest: Array = np.minimum(start[:, 2], end[:, 2]) - scene.radius
    tile_start, tile_item = _sort_into_tiles(scene, start, end, nearest)
    lens = np.array(
        [
            [camera.pixels_per_slope, camera.width / 2.0, camera.height / 2.0],
            [TILE, -(-camera.width // TILE), 0.0],
        ],
        dtype=np.float32,
    )
    capsules = [part.astype(np.float32) for part in (start, end, scene.radius, nearest)]

    def trace(pixels: Array32) -> tuple[Array32, NDArray[np.int64]]:
        depth, seen = np.empty(len(pixels), np.float32), np.empty(len(pixels), np.int32)
        trace_capsules(
            np.ascontiguousarray(pixels), lens, tile_start, tile_item, *capsules, depth, seen
        )
        return np.where(depth < FAR / 2.0, depth, np.float32(np.inf)), seen.astype(np.int64)

    return trace


def _sort_into_tiles(
    scene: Scene, start: Array, end: Array, nearest: Array
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """List, for each tile, the capsules whose outline may reach it, nearest first.

    Returns:
        First item of each tile, shape (tiles + 1,), and the capsules, shape (items,).
    """
    camera = scene.camera
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    order = np.argsort(nearest, kind="stable")
    reach = scene.radius[:, None].astype(np.float64)
    slopes = [
        (point[:, :2] + side * reach) / (point[:, 2:] + away * reach)
        for point in (start, end)
        for side in (-1.0, 1.0)
        for away in (-1.0, 1.0)
    ]
    middle = np.array([camera.width, camera.height]) / 2.0
    flip = np.array([1.0, -1.0])
    places = [middle + flip * camera.pixels_per_slope * slope for slope in slopes]
    limit = np.array([columns - 1, rows - 1])
    first = np.clip(np.min(places, axis=0) // TILE, 0, limit).astype(np.int64)[order]
    last = np.clip(np.max(places, axis=0) // TILE, 0, limit).astype(np.int64)[order]
    wide, tall = (last - first + 1).T
    count = wide * tall
    item = np.repeat(np.arange(len(order)), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    tile = (first[item, 1] + within // wide[item]) * columns + first[item, 0] + within % wide[item]
    by_tile = np.argsort(tile, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=columns * rows))])
    return starts.astype(np.int32), order[item[by_tile]].astype(np.int32)
