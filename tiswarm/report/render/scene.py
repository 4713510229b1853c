"""Scenes in plain arrays: capsules and ground, their light, and the camera that sees them.

Everything but the ground is a capsule: all points within a radius of a segment. A sphere is a
capsule whose two ends coincide. A scene stores the light that each capsule and the ground receive,
and one set of formulas turns it into color, so that all renderers draw the same picture.
"""

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.records.terrain import EDGE_RADIUS, Terrain
from tiswarm.report.ground import shown_slabs
from tiswarm.report.render.lit_ground import Ground, lay_ground
from tiswarm.report.render.shade import Array32, blocked_light, dot, unit
from tiswarm.report.swarm_view import DrawnRobots, Look

_ROD_RADIUS = 0.16  # [R]
_ROD_GRAY = (0.45, 0.45, 0.47)

# --- camera ---

_ELEVATION = math.radians(14.0)  # angle of the view above the horizontal
_OBLIQUE = math.radians(20.0)  # angle between the view and the normal of the long side
_LENS = math.tan(math.radians(12.0))  # half of the longer side of the picture at distance 1
_ASPECTS = (0.45, 2.4)  # least and greatest width over height
_MARGIN = 1.06  # size of the picture over the size of what it shows
_PIXELS = 570_000  # of a picture, approximately: two in a row for each of the page's

# --- light ---

_BLOCKER_RADIUS = 1.45  # sphere that blocks as much light as a robot [dock radii]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera."""

    eye: Reals  # position of the eye [R], shape (3,)
    axes: Reals  # right, up and forward, unit vectors in rows, shape (3, 3)
    half_height: float  # half height of the picture at distance 1
    width: int  # width of the picture [pixels]
    height: int  # height of the picture [pixels]

    @property
    def sun(self) -> Array32:
        """Direction to the sun, above the viewer's left shoulder, shape (3,)."""
        toward = (np.array([[-0.5, 0.75, -0.6]]) @ self.axes).astype(np.float32)
        sun: Array32 = unit(toward)[0]
        return sun

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

    def frame(self, points: Reals) -> Reals:
        """Find the least and greatest column and row of points in the picture, shape (2, 2)."""
        right, up, forward = self.project(points).T
        if forward.min() <= 0.0:  # they surround the eye
            return np.array([[0.0, 0.0], [self.width, self.height]])
        slopes = np.column_stack([right, -up]) / forward[:, None] * self.pixels_per_slope
        seen = slopes + np.array([self.width, self.height]) / 2.0
        return np.array([seen.min(axis=0), seen.max(axis=0)])


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
    ghost: "Scene | None" = None  # translucent capsules before the same camera

    def within(self, width: int, height: int) -> "Scene":
        """Return the same scene before a camera that fills so many columns or rows [pixels]."""
        share = min(width / self.camera.width, height / self.camera.height)
        columns, rows = round(share * self.camera.width), round(share * self.camera.height)
        return self.seen_by(replace(self.camera, width=columns, height=rows))

    def painted(self, robots: DrawnRobots) -> "Scene":
        """Return a scene of robots alone in their present colors."""
        parts = _capsules(robots)
        return replace(self, color=np.concatenate([part[3] for part in parts]).astype(np.float32))

    def looks_like(self, other: "Scene") -> bool:
        """Whether both have the very same parts, up to colors."""
        names = {field.name for field in fields(self)} - {"color"}
        return all(getattr(self, name) is getattr(other, name) for name in names)

    def seen_by(self, camera: Camera) -> "Scene":
        """Return the same scene before another camera."""
        ghost = None if self.ghost is None else replace(self.ghost, camera=camera)
        return replace(self, camera=camera, ghost=ghost)


TRUE_SIZE = Look(0.45, 0.3, 1.0)
"""Radii in which touching docks touch."""


def build_scene(
    robots: DrawnRobots,
    terrain: Terrain | None,
    *,
    ghosts: DrawnRobots | None = None,
    rods: Reals | None = None,
    around: Reals | None = None,
) -> Scene:
    """Turn robots into lit capsules in front of a camera.

    Args:
        robots: Robots to draw.
        terrain: The ground; None for no ground.
        ghosts: Translucent robots.
        rods: Both ends of gray rods that cast no shade [R], shape (n, 2, 3).
        around: Docks that are on the ground, and fit into the picture with all robots [R], shape
            (n, 3); those of the robots if None.
    """
    if around is None:
        around = robots.dock.reshape(-1, 3)
    seen = [around] + [group.dock.reshape(-1, 3) for group in (robots, ghosts) if group]
    slabs = [] if terrain is None else shown_slabs(terrain, around)
    for slab in slabs:
        x, z = [0.5 * (slab.rear + slab.edge), slab.edge], slab.top - EDGE_RADIUS
        seen.append(np.array([[end, y, z] for end in x for y in (slab.low_y, slab.high_y)]))
    dock = max(group.look.dock for group in (robots, ghosts) if group)
    camera = fit_camera(np.concatenate(seen), dock, along_x=bool(slabs))
    ground = None if terrain is None else lay_ground(terrain, around, _blockers(robots))
    ghost = _light(_capsules(ghosts), ghosts, camera) if ghosts else None
    parts = _capsules(robots)
    if rods is not None:
        look = (np.full(len(rods), _ROD_RADIUS), np.tile(_ROD_GRAY, (len(rods), 1)))
        parts.append((rods[:, 0], rods[:, 1], *look))
    return replace(_light(parts, robots, camera), ground=ground, ghost=ghost)


def _light(parts: list[tuple[Reals, ...]], robots: DrawnRobots, camera: Camera) -> Scene:
    """Put capsules, shaded by robots, in front of a camera."""
    start, end, radius, color = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Scene(
        start=start.astype(np.float32),
        end=end.astype(np.float32),
        radius=radius.astype(np.float32),
        color=color.astype(np.float32),
        shade=blocked_light((start + end) / 2.0, _blockers(robots)),
        camera=camera,
        ground=None,
    )


def _blockers(robots: DrawnRobots) -> Reals:
    """Stand in for each robot, as to light, with a sphere: center and radius, shape (N, 4)."""
    radius = np.full(len(robots.center), _BLOCKER_RADIUS * robots.look.dock)
    return np.column_stack([robots.center, radius])


def _capsules(robots: DrawnRobots) -> list[tuple[Reals, ...]]:
    """Make start, end, radius and color of hubs, arms and docks."""
    docks, look = robots.dock.shape[1], robots.look
    hub, dock = robots.center, robots.dock.reshape(-1, 3)
    color = robots.color.repeat(docks, axis=0)
    return [
        (hub, hub, np.full(len(hub), look.hub), 0.7 * robots.color),
        (hub.repeat(docks, axis=0), dock, np.full(len(dock), look.arm), 0.7 * color),
        (dock, dock, np.full(len(dock), look.dock), color),
    ]


def fit_camera(points: Reals, radius: float, *, along_x: bool = False) -> Camera:
    """Place a camera so that balls of one radius [R] around all points [R] fill the picture.

    It looks onto the long side of the points, or onto the x axis.
    """
    back = _view_direction(points[:, :2] * [1.0, not along_x])
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
    """Point from the structure to the eye: from the -y side, a little above, onto the long side.

    Points are seen from above, shape (n, 2).
    """
    flat = points - points.mean(axis=0)
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
    length = np.maximum(dot(span, span), np.float32(1e-12))
    along = np.clip(dot(points - start, span) / length, 0.0, 1.0)
    return unit(points - start - along[:, None] * span)


def color_of_capsules(scene: Scene, which: Ints, points: Array32, colors: Array32) -> Array32:
    """Color points on the surfaces [R] of given capsules, shape (K, n, 3).

    `colors` are K times red, green, blue of each capsule, shape (K, P, 3).
    """
    normal = capsule_normals(scene, which, points)
    sun = scene.camera.sun
    to_eye = unit(scene.camera.eye.astype(np.float32) - points)
    shade = scene.shade[which]
    open_sky = np.exp(-0.9 * np.maximum(shade[:, 0] + dot(shade[:, 1:], normal), 0.0))
    open_sun = np.exp(-1.5 * np.maximum(shade[:, 0] + shade[:, 1:] @ sun, 0.0))
    facing = np.clip(dot(normal, to_eye), 0.0, 1.0)
    shine = np.clip(dot(normal, unit(to_eye + sun)), 0.0, 1.0) ** 40
    light = open_sky * (0.62 + 0.16 * normal[:, 2])
    light += open_sun * 0.55 * np.maximum(normal @ sun, 0.0)
    light *= 0.62 + 0.38 * np.minimum(facing / 0.45, 1.0)  # dark rims separate spheres
    color: Array32 = colors[:, which] * light[:, None]
    color += (0.16 * open_sun * shine)[:, None]
    return np.asarray(np.clip(color, 0.0, 1.0))


def relative_light(scene: Scene, normal: Array32) -> Array32:
    """Light on open ground with normals (n, 3), over that on level ground."""
    sun = scene.camera.sun
    light: Array32 = 0.62 + 0.16 * normal[:, 2] + 0.55 * np.maximum(normal @ sun, 0.0)
    return light / np.float32(0.78 + 0.55 * sun[2])
