"""Scenes in plain arrays: capsules and ground, their light, and the camera that sees them.

Everything but the ground is a capsule: all points within a radius of a segment. A sphere is a
capsule whose two ends coincide. A scene stores the light that each capsule and the ground receive,
and one set of formulas turns it into color, so that all renderers draw the same picture.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.aliases import Bools, Ints, Reals

Array32 = NDArray[np.float32]

_ROD_RADIUS = 0.16  # [R]
_ROD_GRAY = (0.45, 0.45, 0.47)

# --- camera ---

_ELEVATION = math.radians(14.0)  # angle of the view above the horizontal
_OBLIQUE = math.radians(20.0)  # angle between the view and the normal of the long side
_LENS = math.tan(math.radians(12.0))  # half of the longer side of the picture at distance 1
_ASPECTS = (0.45, 2.4)  # least and greatest width over height
_MARGIN = 1.06  # size of the picture over the size of what it shows
_PIXELS = 1_100_000  # pixels of a picture, approximately

# --- light ---

_BLOCKER_RADIUS = 1.45  # sphere that blocks as much light as a robot [dock radii]
_SHADE_RANGE = 8.0  # beyond it robots cast no shade [R]; half of it in a crowd, to save time
_CROWD = 2_000  # robots of a crowd
_SAME_PLACE = 1e-6  # distance from its center within which a robot casts no shade: its hub [R]
_STANDING = 0.1  # gap to the ground below which a dock stands on it [R]
_GROUND_CELLS = 160
_GROUND_FADE = (2.0, 9.0)  # distances from the nearest standing dock where the ground fades [R]
_GROUND_GRAY = 0.92


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera."""

    eye: Reals  # position of the eye [R], shape (3,)
    axes: Reals  # right, up and forward, unit vectors in rows, shape (3, 3)
    half_height: float  # half height of the picture at distance 1
    width: int  # width of the picture [pixels]
    height: int  # height of the picture [pixels]

    @property
    def pixels_per_slope(self) -> float:
        """Pixels between two rays whose right or up parts differ by 1 at distance 1."""
        return 0.5 * self.height / self.half_height

    def directions(self, pixels: Array32) -> Array32:
        """Aim a ray, of forward part 1, through each pixel (column and row from the top left)."""
        middle = np.array([self.width, self.height], dtype=np.float32) / 2
        slope = (pixels - middle) / np.float32(self.pixels_per_slope)
        right, up, forward = (self.axes * [[1.0], [-1.0], [1.0]]).astype(np.float32)
        rays: Array32 = slope[:, :1] * right + slope[:, 1:] * up + forward
        return rays

    def project(self, points: Reals) -> Reals:
        """Split the way from the eye to points into right, up and forward parts, shape (n, 3)."""
        return (points - self.eye) @ self.axes.T


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A square patch of flat ground, cut into cells."""

    corner: Reals  # center of the cell with the least x and y [R], shape (3,)
    cell: float  # distance between the centers of two neighboring cells [R]
    gray: Array32  # brightness, by y and x cell, shape (cells, cells)
    opacity: Array32  # opacity from 0 (no ground) to 1, by y and x cell, shape (cells, cells)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """P capsules, a ground if any, and a camera, against white."""

    start: Array32  # one end of each segment [R], shape (P, 3)
    end: Array32  # other end of each segment [R], shape (P, 3)
    radius: Array32  # radius of each capsule [R], shape (P,)
    color: Array32  # red, green, blue of each capsule, 0 to 1, shape (P, 3)
    shade: Array32  # light blocked: on average, and toward x, y and z, shape (P, 4)
    camera: Camera
    ground: Ground | None

    def shrunk(self, times: int) -> "Scene":
        """Return the same scene before a camera with so many times fewer pixels a side."""
        width, height = self.camera.width // times, self.camera.height // times
        return replace(self, camera=replace(self.camera, width=width, height=height))


@dataclass(frozen=True)
class Look:
    """Radii of a robot's parts [R]."""

    hub: float
    arm: float
    dock: float


@dataclass(frozen=True, kw_only=True)
class Robots:
    """N robots to draw."""

    center: Reals  # centers [R], shape (N, 3)
    dock: Reals  # dock centers [R], shape (N, docks, 3)
    color: Reals  # red, green, blue of each robot, 0 to 1, shape (N, 3)
    look: Look


def build_scene(
    groups: list[Robots],
    ground_z: float | None,
    *,
    rods: Reals | None = None,
    around: Reals | None = None,
) -> Scene:
    """Turn robots into lit capsules in front of a camera.

    Args:
        groups: Robots to draw.
        ground_z: Height of the ground [R]; None for no ground.
        rods: Both ends of gray rods that cast no shade [R], shape (n, 2, 3).
        around: Docks that fit into the picture and onto the ground [R], shape (n, 3); those of the
            groups if None.
    """
    parts = [part for robots in groups for part in _capsules(robots)]
    if rods is not None:
        look = (np.full(len(rods), _ROD_RADIUS), np.tile(_ROD_GRAY, (len(rods), 1)))
        parts.append((rods[:, 0], rods[:, 1], *look))
    start, end, radius, color = (np.concatenate(column) for column in zip(*parts, strict=True))
    center = np.concatenate([robots.center for robots in groups])
    reach = np.concatenate([np.full(len(r.center), _BLOCKER_RADIUS * r.look.dock) for r in groups])
    blockers = np.column_stack([center, reach])
    if around is None:
        around = np.concatenate([robots.dock.reshape(-1, 3) for robots in groups])
    return Scene(
        start=start.astype(np.float32),
        end=end.astype(np.float32),
        radius=radius.astype(np.float32),
        color=color.astype(np.float32),
        shade=_shade((start + end) / 2.0, blockers),
        camera=fit_camera(around, max(robots.look.dock for robots in groups)),
        ground=None if ground_z is None else _ground(around, blockers, ground_z),
    )


def _capsules(robots: Robots) -> list[tuple[Reals, ...]]:
    """Make start, end, radius and color of hubs, arms and docks."""
    docks, look = robots.dock.shape[1], robots.look
    hub, dock = robots.center, robots.dock.reshape(-1, 3)
    color = robots.color.repeat(docks, axis=0)
    return [
        (hub, hub, np.full(len(hub), look.hub), 0.7 * robots.color),
        (hub.repeat(docks, axis=0), dock, np.full(len(dock), look.arm), 0.7 * color),
        (dock, dock, np.full(len(dock), look.dock), color),
    ]


def _shade(points: Reals, blockers: Reals) -> Array32:
    """Sum the light that robots block from points, in terms that are linear in the normal.

    A sphere of radius r at distance d in direction u blocks (r/d)^2 max(0, n.u) of the light
    on a surface with normal n; 1/4 + n.u / 2 approximates max(0, n.u). Rows of `blockers` are
    center and radius of the spheres [R].
    """
    center = blockers[:, :3]
    reach = _SHADE_RANGE if len(center) <= _CROWD else _SHADE_RANGE / 2.0
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(center), reach, output_type="ndarray")
    i, j = pairs["i"], pairs["j"]
    away = center[j] - points[i]
    distance = np.maximum(pairs["v"], 1e-9)
    blocked = np.minimum((blockers[j, 3] / distance) ** 2, 0.5) * (1.0 - distance / reach)
    blocked *= _SHADE_RANGE / reach  # makes up for the shorter range in a crowd
    blocked[pairs["v"] < _SAME_PLACE] = 0.0
    terms = np.column_stack([blocked / 4.0, away * (blocked / distance / 2.0)[:, None]])
    sums = [np.bincount(i, weights=term, minlength=len(points)) for term in terms.T]
    return np.column_stack(sums).astype(np.float32)


def _ground(dock: Reals, blockers: Reals, height: float) -> Ground | None:
    """Lay ground around the docks that stand on it, darker beneath robots."""
    standing = dock[np.abs(dock[:, 2] - 1.0 - height) < _STANDING, :2]
    if not len(standing):
        return None
    low = standing.min(axis=0) - _GROUND_FADE[1]
    side = float(np.max(standing.max(axis=0) + _GROUND_FADE[1] - low))
    cell = side / (_GROUND_CELLS - 1)
    x, y = np.meshgrid(*(low[:, None] + cell * np.arange(_GROUND_CELLS)), indexing="xy")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    distance, _ = cKDTree(standing).query(points[:, :2])
    near, far = _GROUND_FADE
    fade = np.clip((far - distance) / (far - near), 0.0, 1.0)
    opacity = fade * fade * (3.0 - 2.0 * fade)
    shade = _shade(points, blockers)
    gray = _GROUND_GRAY * np.exp(-1.3 * np.maximum(shade[:, 0] + shade[:, 3], 0.0))
    gray, opacity = (part.reshape(x.shape).astype(np.float32) for part in (gray, opacity))
    return Ground(corner=np.array([*low, height]), cell=cell, gray=gray, opacity=opacity)


def fit_camera(points: Reals, radius: float) -> Camera:
    """Place a camera so that balls of one radius [R] around all points [R] fill the picture."""
    back = _view_direction(points)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(back, right), -back])
    seen = points @ axes.T
    wide, tall, _ = np.ptp(seen, axis=0) + 2.0 * radius
    aspect = float(np.clip(wide / tall, *_ASPECTS))
    height = round(math.sqrt(_PIXELS / aspect) / 2.0) * 2
    width = round(aspect * height / 2.0) * 2
    half_height = _LENS / max(aspect, 1.0)
    right_at, right_distance = _stand_back(seen[:, 0], seen[:, 2], radius, aspect * half_height)
    up_at, up_distance = _stand_back(seen[:, 1], seen[:, 2], radius, half_height)
    place = np.array([right_at, up_at, -max(right_distance, up_distance)])
    return Camera(eye=place @ axes, axes=axes, half_height=half_height, width=width, height=height)


def _view_direction(points: Reals) -> Reals:
    """Point from the structure to the eye: from the -y side, a little above, onto the long side."""
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    variance, direction = np.linalg.eigh(flat.T @ flat)
    along = direction[:, 1] if variance[1] > 2.0 * variance[0] else np.array([1.0, 0.0])
    azimuth = math.atan2(-abs(along[0]), along[1] * np.sign(along[0] or 1.0)) + _OBLIQUE
    level, up = math.cos(_ELEVATION), math.sin(_ELEVATION)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), up])


def _stand_back(across: Reals, depth: Reals, radius: float, slope: float) -> tuple[float, float]:
    """Place the eye, across the view and before depth 0, so that it sees every ball whole."""
    slope /= _MARGIN
    reach = radius * math.hypot(1.0, slope)
    above = float(np.max(across - slope * depth)) + reach
    below = float(np.max(-across - slope * depth)) + reach
    return (above - below) / 2.0, (above + below) / (2.0 * slope)


def capsule_normals(scene: Scene, which: Ints, points: Array32) -> Array32:
    """Point away from the axes of given capsules at points on their surfaces [R], shape (n, 3)."""
    start, span = scene.start[which], scene.end[which] - scene.start[which]
    length = np.maximum(_dot(span, span), np.float32(1e-12))
    along = np.clip(_dot(points - start, span) / length, 0.0, 1.0)
    return _unit(points - start - along[:, None] * span)


def color_of_capsules(scene: Scene, which: Ints, points: Array32) -> Array32:
    """Color points on the surfaces [R] of given capsules, shape (n, 3)."""
    normal = capsule_normals(scene, which, points)
    # The sun stands above the viewer's left shoulder.
    sun = _unit((np.array([[-0.5, 0.75, -0.6]]) @ scene.camera.axes).astype(np.float32))[0]
    to_eye = _unit(scene.camera.eye.astype(np.float32) - points)
    shade = scene.shade[which]
    open_sky = np.exp(-0.9 * np.maximum(shade[:, 0] + _dot(shade[:, 1:], normal), 0.0))
    open_sun = np.exp(-1.5 * np.maximum(shade[:, 0] + shade[:, 1:] @ sun, 0.0))
    facing = np.clip(_dot(normal, to_eye), 0.0, 1.0)
    shine = np.clip(_dot(normal, _unit(to_eye + sun)), 0.0, 1.0) ** 40
    light = open_sky * (0.62 + 0.16 * normal[:, 2])
    light += open_sun * 0.55 * np.maximum(normal @ sun, 0.0)
    light *= 0.62 + 0.38 * np.minimum(facing / 0.45, 1.0)  # dark rims separate spheres
    color: Array32 = scene.color[which] * light[:, None]
    color += (0.16 * open_sun * shine)[:, None]
    return np.asarray(np.clip(color, 0.0, 1.0))


def color_of_ground(ground: Ground, points: Array32) -> tuple[Array32, Bools]:
    """Color points of the ground's plane over white, and mark those where there is ground."""
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
