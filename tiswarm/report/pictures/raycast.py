"""Draws scenes by casting a ray through each pixel.

A renderer finds the first capsule along each ray: `open3d` with Embree on a mesh, `taichi` with a
kernel of our own on exact capsules. Rays, ground, color and soft edges are shared. Pixels on an
edge are averaged over several rays. Importing open3d ends the process on some machines, so a child
tries it first.
"""

import contextlib
import ctypes
import importlib
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.process import child_command
from tiswarm.base.progress import Advance, ignore
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import kernel_cache, machine
from tiswarm.records.terrain import Terrain
from tiswarm.report.pictures.scene import (
    FLOOR_GRAY,
    Array32,
    Scene,
    build_scene,
    color_of_capsules,
    mesh_capsules,
    relative_light,
)
from tiswarm.report.swarm_view import DrawnRobots, Look

_LONGEST_S = 120.0
"""Time that the import may take, on a slow disk that has not read it before."""

_WEB = "open3d.visualization.draw_plotly"
_DATA_SETS = "open3d._ml3d.datasets"

_TRIAL = f"""
import resource
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
from {__name__} import load_open3d
load_open3d()
"""


def import_open3d() -> Any:  # noqa: ANN401 - open3d has no types
    """Import open3d, if it does not end a child of this process that tries to.

    A file beside the compiled kernels notes that it does not: each installation is tried once.

    Raises:
        ImportError: open3d is not installed, lacks a library, or would end this process.
    """
    if "open3d" not in sys.modules:
        try_in_child()
    return load_open3d()


def load_open3d() -> Any:  # noqa: ANN401 - open3d has no types
    """Import open3d, after the library that `libusb_package` brings, where it is installed.

    Its module of web servers imports dash, plotly and IPython, and its data sets import
    scikit-learn, which take most of the time: here both wait for their first use.
    """
    if sys.modules.get("open3d") is not None:
        return sys.modules["open3d"]
    with contextlib.suppress(ImportError, OSError):
        import libusb_package  # noqa: PLC0415 - optional

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    stand_ins = {name: ModuleType(name) for name in (_WEB, _DATA_SETS)}
    stand_ins[_WEB].__getattr__ = _on_call  # type: ignore[method-assign]
    sys.modules |= stand_ins
    try:
        import open3d
    finally:
        for name in stand_ins:
            del sys.modules[name]
    if data_sets := sys.modules.get("open3d.ml.datasets"):
        data_sets.__getattr__ = _of_data_sets  # type: ignore[method-assign]
    return open3d


def _of_data_sets(name: str) -> Any:  # noqa: ANN401 - of open3d
    """Import the module of data sets, and return what it calls so."""
    return getattr(importlib.import_module(_DATA_SETS), name)


def _on_call(name: str) -> Callable[..., Any]:
    """Return a function that imports the module of web servers, and calls its function."""

    def call(*args: Any, **named: Any) -> Any:  # noqa: ANN401 - of open3d
        web = importlib.import_module(_WEB)
        package = sys.modules[_WEB.rpartition(".")[0]]
        for shared_name in vars(package).keys() & vars(web).keys():
            # One function has the name of the module, too.
            setattr(package, shared_name, getattr(web, shared_name))
        return getattr(web, name)(*args, **named)

    return call


@cache
def try_in_child() -> None:
    """Import open3d in a child, unless one has done it before.

    An import that fails there without a crash may be tried here.

    Raises:
        ImportError: the child crashed, or did not end.
    """
    spec = find_spec("open3d")
    if spec is None or spec.origin is None:
        return
    changed = Path(spec.origin).stat().st_mtime_ns
    key = repr(
        (spec.origin, changed, sys.version, platform.release(), machine.machine()["processor"])
    )
    mark = kernel_cache.find_folder("open3d") / sha256(key.encode()).hexdigest()[:16]
    if mark.exists():
        return
    try:
        status = subprocess.run(  # noqa: S603 - our own interpreter and code
            child_command(_TRIAL), capture_output=True, timeout=_LONGEST_S, check=False
        ).returncode
    except subprocess.TimeoutExpired as error:
        problem = f"its import takes longer than {_LONGEST_S:g} s"
        raise ImportError(problem) from error
    if status < 0:
        raise ImportError(f"its import crashes with {signal.Signals(-status).name}")
    if status == 0:
        with contextlib.suppress(OSError):
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()


Pixels = NDArray[np.uint8]  # of red, green, blue and, where what is behind shows, opacity
Trace = Callable[[Array32, Array32], tuple[Array32, Ints]]
"""From pixels (column, row), shape (n, 2), and the directions of their rays, shape (n, 3), to the
depth of the first capsule, infinite if there is none, and its index or -1, each of shape (n,)."""

_SUBPIXELS = np.array([[x + 0.5, (5 * x + 2) % 8 + 0.5] for x in range(8)], np.float32) / 8.0
"""Eight places in an edge pixel, no two of them in one row or column."""

_MANY_EDGES = 0.3  # share of edge pixels above which four rays are cast in each instead of eight
_FACES = np.array([-2, -3, -4])  # of the ground, by direction of the normal; -1 is nothing
_FAINT = 0.5  # opacity below which ground hides nothing
_OTHERS = 5  # more than the objects that are no capsules
_GHOST_GAP = 0.3  # ghosts less far before robots than this coincide with them [R]
_GHOST_OPACITY = 0.5  # of ghosts before the background
_GHOST_VEIL = 0.25  # opacity of ghosts before robots
_SURROUNDINGS = 5.0  # around the center of a new robot, what is drawn again [R]
_LEAST_CHANGE = 0.002  # of the brightness of ground that is drawn again, 0 to 1
_CHUNK = 400_000  # rays cast at a time, to bound memory
_TILE = 12  # edge of a tile in which the `taichi` renderer sorts capsules [pixels]


def draw_scenes(
    scenes: list[Scene], renderer: str | None = None, advance: Advance = ignore
) -> tuple[list[Pixels], str, str]:
    """Draw scenes with one renderer, or with the first of `TRACERS` that works.

    Args:
        scenes: What to draw.
        renderer: Name of the renderer; the first that works if None.
        advance: Called with the number of pictures drawn since, less than 0 if a renderer fails.

    Returns:
        The pictures, of shape (height, width, 4), the name of their renderer, and why a better
        renderer failed, if one did.

    Raises:
        InputError: the renderer is unknown.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """

    def draw(tracer: Callable[[Scene], Trace], advance: Advance) -> list[Pixels]:
        pictures: dict[int, Pixels] = {}
        for group in _groups_of_one_shape(scenes):
            drawn = _draw([scenes[number] for number in group], tracer)
            pictures |= zip(group, drawn, strict=True)
            advance(len(group))
        return [pictures[number] for number in range(len(scenes))]

    return _drawn_by_first(renderer, draw, advance)


def draw_growth(
    scenes: Sequence[Scene],
    added: Sequence[Reals],
    renderer: str | None = None,
    advance: Advance = ignore,
) -> tuple[list[Pixels], str, str]:
    """Draw scenes before one camera, each with a few robots more than the one before.

    Only the surroundings of new robots, and ground that they darken, are cast again.

    Args:
        scenes: What to draw.
        added: Centers of the new robots of each scene [R], each of shape (n, 3).
        renderer: Name of the renderer; the first that works if None.
        advance: Called with the number of pictures drawn since, less than 0 if a renderer fails.

    Returns:
        The pictures, of shape (height, width, 4), the name of their renderer, and why a better
        renderer failed, if one did.

    Raises:
        InputError: the renderer is unknown.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """

    def draw(tracer: Callable[[Scene], Trace], advance: Advance) -> list[Pixels]:
        pictures: list[Pixels] = []
        cells = _ground_cells(scenes[0])
        for number, (scene, centers) in enumerate(zip(scenes, added, strict=True)):
            if pictures:
                darker = _changed_ground(scenes[number - 1], scene)[cells]
                new = np.flatnonzero(_surroundings(scene, centers) | darker)
                picture = pictures[-1].copy()
                picture.reshape(-1, 4)[new] = _draw([scene], tracer, new)[0]
            else:
                picture = _draw([scene], tracer)[0]
            pictures.append(picture)
            advance(1)
        return pictures

    return _drawn_by_first(renderer, draw, advance)


def _drawn_by_first(
    renderer: str | None,
    draw: Callable[[Callable[[Scene], Trace], Advance], list[Pixels]],
    advance: Advance,
) -> tuple[list[Pixels], str, str]:
    """Draw with a renderer, or with the first that works; returns its name, and why not a better.

    Raises:
        InputError: the renderer is unknown.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """
    check_renderer(renderer)
    reason = ""
    for name in TRACERS if renderer is None else (renderer,):
        done = 0.0

        def count(more: float) -> None:
            nonlocal done
            done += more
            advance(more)

        try:
            return draw(TRACERS[name], count), name, reason
        except (ImportError, OSError, RuntimeError) as error:
            advance(-done)
            reason = _explain(name, error)
    raise EnvironmentTroubleError(f"cannot draw with {reason}")


def _explain(renderer: str, error: Exception) -> str:
    """Say why a renderer failed, and what helps."""
    if isinstance(error, ModuleNotFoundError) and error.name == renderer:
        return f"{renderer}: not installed; pip install 'tiswarm[{renderer}]' adds it"
    return f"{renderer}: {error}; `tiswarm doctor` names what to install"


def check_renderer(renderer: str | None) -> None:
    """Refuse the name of a renderer that there is not.

    Raises:
        InputError: the renderer is unknown.
    """
    if renderer is not None and renderer not in TRACERS:
        gone = "open3d casts rays now; " if renderer == "open3d-raycast" else ""
        problem = f"unknown renderer: {renderer}; {gone}use one of {', '.join(TRACERS)}"
        raise InputError(problem, argument="renderer")


def _groups_of_one_shape(scenes: list[Scene]) -> list[list[int]]:
    """Group the numbers of scenes that differ by colors alone."""
    groups: list[list[int]] = []
    for number, scene in enumerate(scenes):
        group = next((group for group in groups if scenes[group[0]].looks_like(scene)), None)
        if group is None:
            groups.append([number])
        else:
            group.append(number)
    return groups


def _ground_cells(scene: Scene) -> Ints:
    """Find the cell of flat ground in each pixel, shape (height * width,); the last if none is."""
    camera = scene.camera
    ground = scene.ground
    cells = np.full(camera.height * camera.width, -1)
    if ground is None:
        return cells
    row, column = np.indices((camera.height, camera.width), dtype=np.float32).reshape(2, -1)
    direction = camera.directions(np.column_stack([column, row]))
    depth, _ = ground.cast(camera.eye.astype(np.float32), direction)
    met = np.flatnonzero(np.isfinite(depth))
    points = camera.eye[:2] + depth[met, None] * direction[met, :2]
    column_and_row = np.round((points - ground.corner[:2]) / ground.cell).astype(np.int64)
    count = len(ground.look)
    inside = ((column_and_row >= 0) & (column_and_row < count)).all(axis=1)
    cells[met[inside]] = column_and_row[inside, 1] * count + column_and_row[inside, 0]
    return cells


def _changed_ground(before: Scene, after: Scene) -> Bools:
    """Mark cells of the ground that look different, and their neighbors; the last is none."""
    if before.ground is None or after.ground is None:
        return np.zeros(1, dtype=bool)
    change = np.abs(after.ground.look - before.ground.look).max(axis=2) > _LEAST_CHANGE
    return np.append(binary_dilation(change), False)


def _surroundings(scene: Scene, centers: Reals) -> Bools:
    """Mark the pixels near robots, of shape (height * width,)."""
    camera = scene.camera
    row, column = np.indices((camera.height, camera.width), dtype=np.float32).reshape(2, -1)
    near = np.zeros(len(row), dtype=bool)
    for right, up, forward in camera.project(centers):
        scale = camera.pixels_per_slope / forward
        x = camera.width / 2.0 + scale * right
        y = camera.height / 2.0 - scale * up
        near |= (column - x) ** 2 + (row - y) ** 2 < (scale * _SURROUNDINGS) ** 2
    return near


def _draw(
    scenes: list[Scene], tracer: Callable[[Scene], Trace], chosen: Ints | None = None
) -> list[Pixels]:
    """Draw scenes that differ by colors alone, each of shape (height, width, 4).

    Of `chosen` pixels, by index, colors have the shape (n, 4).
    """
    scene = scenes[0]
    colors = np.array([scene.color for scene in scenes])
    layers = [(layer, tracer(layer)) for layer in (scene, scene.ghost) if layer]
    width = scene.camera.width
    height = scene.camera.height
    row, column = np.indices((height, width), dtype=np.float32).reshape(2, -1)
    corner = np.column_stack([column, row])
    drawn = np.arange(len(corner)) if chosen is None else chosen
    color, seen = _cast(layers, colors, corner[drawn] + np.float32(0.5))
    whole = np.full(len(corner), _FACES.min() - 1)
    whole[drawn] = seen
    edge = np.flatnonzero(_edges(whole.reshape(height, width)).ravel()[drawn])
    offsets = _SUBPIXELS if len(edge) < _MANY_EDGES * len(seen) else _SUBPIXELS[::2]
    finer = [_cast(layers, colors, corner[drawn[edge]] + offset)[0] for offset in offsets]
    color[:, edge] = np.mean(finer, axis=0)
    color[..., :3] /= np.maximum(color[..., 3:], np.float32(1e-6))
    pictures = [np.round(255.0 * np.minimum(shades, 1.0)).astype(np.uint8) for shades in color]
    if chosen is None:
        return [picture.reshape(height, width, 4) for picture in pictures]
    return pictures


def on_white(picture: Pixels) -> Pixels:
    """Lay a picture on white: its opacity, the last of four numbers, goes."""
    color = picture[..., :3].astype(np.float32)
    opacity = picture[..., 3:] / np.float32(255.0)
    laid: Pixels = np.round(255.0 + opacity * (color - 255.0)).astype(np.uint8)
    return laid


def _cast(
    layers: list[tuple[Scene, Trace]], colors: Array32, pixels: Array32
) -> tuple[Array32, Ints]:
    """Find K colors, shape (K, n, 4), and one object at each pixel.

    Colors are red, green and blue times opacity, and opacity. Different numbers are different
    objects.
    """
    chunks = [
        _cast_chunk(layers, colors, pixels[first : first + _CHUNK])
        for first in range(0, max(len(pixels), 1), _CHUNK)
    ]
    color, seen = zip(*chunks, strict=True)
    return np.concatenate(color, axis=1), np.concatenate(seen)


def _cast_chunk(
    layers: list[tuple[Scene, Trace]], colors: Array32, pixels: Array32
) -> tuple[Array32, Ints]:
    (scene, trace), *ghosts = layers
    eye = scene.camera.eye.astype(np.float32)
    direction = scene.camera.directions(pixels)
    depth, seen = trace(pixels, direction)
    color = np.zeros((len(colors), len(pixels), 4), np.float32)
    hit = np.flatnonzero(seen >= 0)
    points = eye + depth[hit, None] * direction[hit]
    color[:, hit] = _opaque(color_of_capsules(scene, seen[hit], points, colors))
    ground = scene.ground
    if ground is not None:
        first, last = scene.camera.frame(ground.corners)
        within = (pixels >= first) & (pixels <= last)
        near = within[:, 0] & within[:, 1]
        # Only uneven ground may be seen from below the horizontal.
        near &= (direction[:, 2] < 0.0) | (ground.surface is not None)
        low = np.flatnonzero(near & (ground.is_solid | (seen < 0)))
        ground_depth, normal = ground.cast(eye, direction[low])
        nearer = ground_depth < depth[low]
        low = low[nearer]
        ground_depth = ground_depth[nearer]
        normal = normal[nearer]
        light = relative_light(scene, normal)
        gray, opacity = ground.paint(eye + ground_depth[:, None] * direction[low], light)
        veil, floor = _floor(gray, solid=ground.is_solid)
        color[:, low] += opacity * (floor - veil * color[:, low])
        hiding = np.flatnonzero(opacity > _FAINT)
        depth[low[hiding]] = ground_depth[hiding]
        face = np.abs(normal[hiding]).argmax(axis=1)
        if ground.surface is not None:
            face[:] = 2  # what slopes has no faces that an outline would separate
        seen[low[hiding]] = _FACES[face]
    for ghost, ghost_trace in ghosts:
        ghost_depth, capsule = ghost_trace(pixels, direction)
        hit = np.flatnonzero(ghost_depth < depth - _GHOST_GAP)
        points = eye + ghost_depth[hit, None] * direction[hit]
        tint = color_of_capsules(ghost, capsule[hit], points, ghost.color[None])
        opacity = np.where(seen[hit] >= 0, np.float32(_GHOST_VEIL), np.float32(_GHOST_OPACITY))
        color[:, hit] += opacity[:, None] * (_opaque(tint) - color[:, hit])
        seen[hit] += (capsule[hit] + 1) * (len(scene.radius) + _OTHERS)
    return color, seen


def _opaque(color: Array32) -> Array32:
    """Append the opacity 1 to colors, shape (..., 3)."""
    return np.concatenate([color, np.ones_like(color[..., :1])], axis=-1)


def _floor(gray: Array32, *, solid: bool) -> tuple[Array32, Array32]:
    """Return the opacity, and the colors of shape (n, 4), of ground that is gray before white.

    A slab hides what is behind. A plane is a gray film under black shade, so that it suits dark
    pages, too.
    """
    film = np.float32(0.0 if solid else 2.0 * FLOOR_GRAY - 1.0)  # of white that passes it
    opacity = np.clip(1.0 - gray * film / np.float32(FLOOR_GRAY), 0.0, 1.0).astype(np.float32)
    shown = gray - (1.0 - opacity)
    return opacity, np.concatenate([shown, shown, shown, opacity], axis=1)


def _edges(seen: Ints) -> Bools:
    """Mark pairs of neighboring pixels that show different objects."""
    edge = np.zeros(seen.shape, dtype=bool)
    beside = seen[:, 1:] != seen[:, :-1]
    below = seen[1:] != seen[:-1]
    edge[:, 1:] |= beside
    edge[:, :-1] |= beside
    edge[1:] |= below
    edge[:-1] |= below
    return edge


# --- open3d ---


def _open3d_tracer(scene: Scene) -> Trace:
    """Prepare Embree to cast rays at a mesh of the scene."""
    o3d = import_open3d()
    mesh = mesh_capsules(scene)
    caster = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor
    caster.add_triangles(tensor(mesh.point), tensor(mesh.triangle.astype(np.uint32)))
    eye = scene.camera.eye.astype(np.float32)

    def trace(_pixels: Array32, direction: Array32) -> tuple[Array32, Ints]:
        rays = np.column_stack([np.broadcast_to(eye, direction.shape), direction])
        answer = caster.cast_rays(tensor(rays))
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        missed = triangle == o3d.t.geometry.RaycastingScene.INVALID_ID
        triangle[missed] = 0
        return answer["t_hit"].numpy(), np.where(missed, -1, mesh.triangle_capsule[triangle])

    return trace


# --- taichi ---


def taichi_tracer(scene: Scene) -> Trace:
    """Prepare a kernel that intersects each ray with the capsules of its tile."""
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import
    from tiswarm.report.pictures.kernels import FAR, trace_capsules  # noqa: PLC0415 - slow to import

    camera = scene.camera
    start = camera.project(scene.start.astype(np.float64))
    end = camera.project(scene.end.astype(np.float64))
    nearest: Reals = np.minimum(start[:, 2], end[:, 2]) - scene.radius
    tile_start, tile_item = _sort_into_tiles(scene, start, end, nearest)
    middle = (camera.width / 2.0, camera.height / 2.0)
    tiles = (_TILE, -(-camera.width // _TILE), 0.0)
    lens = np.array([[camera.pixels_per_slope, *middle], tiles], np.float32)
    capsules = [values.astype(np.float32) for values in (start, end, scene.radius, nearest)]

    def trace(pixels: Array32, _direction: Array32) -> tuple[Array32, Ints]:
        depth = np.empty(len(pixels), np.float32)
        seen = np.empty(len(pixels), np.int32)
        with backend.exclusive():
            backend.processor()
            trace_capsules(
                np.ascontiguousarray(pixels), lens, tile_start, tile_item, *capsules, depth, seen
            )
        return np.where(depth < FAR / 2.0, depth, np.float32(np.inf)), seen.astype(np.int64)

    return trace


def _sort_into_tiles(
    scene: Scene, start: Reals, end: Reals, nearest: Reals
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """List the first item of each tile, and the capsules that may reach it, nearest first."""
    camera = scene.camera
    columns = -(-camera.width // _TILE)
    rows = -(-camera.height // _TILE)
    order = np.argsort(nearest, kind="stable")
    radius = scene.radius[:, None].astype(np.float64)
    slopes = [
        (point[:, :2] + side * radius) / (point[:, 2:] + away * radius)
        for point in (start, end)
        for side in (-1.0, 1.0)
        for away in (-1.0, 1.0)
    ]
    middle = np.array([camera.width, camera.height]) / 2.0
    down = np.array([1.0, -1.0]) * camera.pixels_per_slope
    pixels = np.array([middle + down * slope for slope in slopes])[:, order]
    corners = np.array([pixels.min(axis=0), pixels.max(axis=0)]) // _TILE
    first, last = np.clip(corners, 0, [columns - 1, rows - 1]).astype(np.int64)
    wide, tall = (last - first + 1).T
    count = wide * tall
    item = np.repeat(np.arange(len(order)), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    tile = (first[item, 1] + within // wide[item]) * columns + first[item, 0] + within % wide[item]
    by_tile = np.argsort(tile, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=columns * rows))])
    return starts.astype(np.int32), order[item[by_tile]].astype(np.int32)


TRACERS: dict[str, Callable[[Scene], Trace]] = {"open3d": _open3d_tracer, "taichi": taichi_tracer}
"""The renderers by name, best first; `taichi` needs no library beyond the engine's."""


def draw_test_picture(renderer: str) -> str:
    """Draw one robot in a small picture; return the time it took in words."""
    begin = time.perf_counter()
    center = np.array([[0.0, 0.0, 1.0]])
    dock = center + RobotGeometry().dock_offset_body[None]
    robots = DrawnRobots(center=center, dock=dock, color=np.ones((1, 3)), look=Look(0.45, 0.3, 1.0))
    draw_scenes([build_scene(robots, Terrain()).within(100, 100)], renderer)
    return f"drew a test picture in {time.perf_counter() - begin:.1f} s"
