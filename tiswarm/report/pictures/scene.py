"""Scenes in plain arrays: capsules and ground, light and camera; robots as solids, glTF and PLY.

Everything but the ground is a capsule: all points within a radius of a segment. A sphere is a
capsule whose two ends coincide. A scene stores the light that each capsule and the ground receive,
and one set of formulas turns it into color, so that all renderers draw the same picture. The ground
hides nothing: a plane fades around the docks that stand on it, and a slab toward its rear.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Ints, Reals
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.surface import GroundSurface
from tiswarm.records.terrain import EDGE_RADIUS
from tiswarm.report import swarm_view
from tiswarm.report.figure_style import SCALES, UNKNOWN_GRAY, colors_along, rgb

Array32 = NDArray[np.float32]

_SHADE_RANGE = 8.0  # beyond it robots cast no shade [R]; half of it in a crowd, to save time
_CROWD = 2_000  # robots of a crowd
_SAME_PLACE = 1e-6  # distance from its center within which a robot casts no shade: its hub [R]


def blocked_light(points: Reals, blockers: Reals) -> Array32:
    """Sum the light that robots block from points, in terms that are linear in the normal.

    A sphere of radius r at distance d in direction u blocks (r/d)^2 max(0, n.u) of the light
    on a surface with normal n; 1/4 + n.u / 2 approximates max(0, n.u). Rows of `blockers` are
    center and radius of the spheres [R].
    """
    center = blockers[:, :3]
    shade_range = _SHADE_RANGE if len(center) <= _CROWD else _SHADE_RANGE / 2.0
    pairs = cKDTree(points).sparse_distance_matrix(
        cKDTree(center), shade_range, output_type="ndarray"
    )
    i = pairs["i"]
    j = pairs["j"]
    away = center[j] - points[i]
    distance = np.maximum(pairs["v"], 1e-9)
    blocked = np.minimum((blockers[j, 3] / distance) ** 2, 0.5) * (1.0 - distance / shade_range)
    blocked *= _SHADE_RANGE / shade_range  # makes up for the shorter range in a crowd
    blocked[pairs["v"] < _SAME_PLACE] = 0.0
    terms = np.column_stack([blocked / 4.0, away * (blocked / distance / 2.0)[:, None]])
    sums = [np.bincount(i, weights=term, minlength=len(points)) for term in terms.T]
    return np.column_stack(sums).astype(np.float32)


def dot(a: Array32, b: Array32) -> Array32:
    """Multiply rows, shape (n,)."""
    products: Array32 = np.einsum("ij,ij->i", a, b)
    return products


def unit(vectors: Array32) -> Array32:
    """Scale rows to length 1."""
    length = np.sqrt(np.maximum(dot(vectors, vectors), np.float32(1e-12)))
    units: Array32 = (vectors / length[:, None]).astype(np.float32)
    return units


_CELLS = 160
_FADE = (2.0, 9.0)  # distances from the nearest standing dock where a plane fades [R]
_REAR_FADE = 4.0  # length over which a slab fades at its rear [R]
FLOOR_GRAY = 0.92
"""Brightness of ground in full light, before white, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Ground cut into cells; with slabs, only what lies on them is there."""

    corner: Reals  # center of the cell with the least x and y [R], shape (3,)
    cell: float  # distance between the centers of two neighboring cells [R]
    look: Array32  # brightness, and opacity from 0 to 1, by y and x cell, shape (cells, cells, 2)
    slabs: list[swarm_view.Slab]
    surface: GroundSurface | None = None  # heights; None for flat ground

    @property
    def is_solid(self) -> bool:
        """Whether it hides what is behind; a plane is a film."""
        return bool(self.slabs) or self.surface is not None

    @property
    def corners(self) -> Reals:
        """Corners of a box that has all of it [R], shape (8, 3)."""
        x, y = (self.corner[:2] + self.cell * np.outer([0.0, len(self.look) - 1.0], [1.0, 1.0])).T
        z = self.corner[2] - np.array([0.0, 2.0 * EDGE_RADIUS * bool(self.slabs)])
        if self.surface is not None:
            z = np.array([self.surface.height.min(), self.surface.height.max()])
        return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)

    def cast(self, eye: Array32, direction: Array32) -> tuple[Array32, Array32]:
        """Find depth, infinite if there is none, and normal where rays (n, 3) meet the ground."""
        depth = np.full(len(direction), np.inf, np.float32)
        normal = np.zeros_like(direction)
        normal[:, 2] = 1.0
        if self.surface is not None:
            _cast_surface(self.surface, eye, direction, depth, normal)
            return depth, normal
        if not self.slabs:
            fall = np.minimum(direction[:, 2], np.float32(-1e-9))
            depth = (np.float32(self.corner[2]) - eye[2]) / fall
            return np.where(depth > 0.0, depth, np.inf), normal
        for slab in self.slabs:
            _cast_slab(slab, eye, direction, depth, normal)
        return depth, normal

    def paint(self, points: Array32, light: Array32) -> tuple[Array32, Array32]:
        """Return brightness and opacity of points in a relative light, shapes (n, 1)."""
        last = len(self.look) - 1
        place = (points[:, :2] - self.corner[:2]) / self.cell
        inside = ((place >= 0.0) & (place < last)).all(axis=1, keepdims=True)
        place = np.clip(place, 0.0, last - 0.001)
        column, row = place.astype(np.int64).T
        right, down = (place - np.floor(place)).T[:, :, None]
        upper = self.look[row, column] * (1.0 - right) + self.look[row, column + 1] * right
        lower = self.look[row + 1, column] * (1.0 - right) + self.look[row + 1, column + 1] * right
        look = (upper * (1.0 - down) + lower * down).astype(np.float32)
        return light[:, None] * look[:, :1], inside * look[:, 1:]


def lay_ground(terrain: swarm_view.Ground, dock: Reals, blockers: Reals) -> Ground | None:
    """Lay ground around docks (n, 3), darker beneath robots; None if no dock stands on a plane."""
    if isinstance(terrain, GroundSurface):
        return _lay_surface(terrain, blockers)
    slabs = swarm_view.shown_slabs(terrain, dock)
    standing = swarm_view.standing_docks(terrain, dock)[:, :2]
    if slabs:
        ends = [x for s in slabs for x in (s.rear, s.edge + s.outward * EDGE_RADIUS)]
        low, high = np.array([[min(ends), slabs[0].low_y], [max(ends), slabs[0].high_y]])
    elif len(standing):
        low = standing.min(axis=0) - _FADE[1]
        high = standing.max(axis=0) + _FADE[1]
    else:
        return None
    cell = float(np.max(high - low)) / (_CELLS - 3)
    corner = np.array([*(low - cell), terrain.ground_z])
    x, y = np.meshgrid(*(corner[:2, None] + cell * np.arange(_CELLS)), indexing="xy")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, terrain.ground_z)])
    if slabs:
        ahead = [slab.outward * (points[:, 0] - slab.rear) for slab in slabs]
        share = np.min(ahead, axis=0) / _REAR_FADE
    else:
        distance, _ = cKDTree(standing).query(points[:, :2])
        share = (_FADE[1] - distance) / (_FADE[1] - _FADE[0])
    look = _look(points, share, blockers).reshape(*x.shape, 2)
    return Ground(corner=corner, cell=cell, look=look, slabs=slabs)


def _look(points: Reals, share: Reals, blockers: Reals) -> Array32:
    """Return brightness and opacity of points of the ground (n, 3), that fade as `share` falls."""
    share = np.clip(share, 0.0, 1.0)
    shade = blocked_light(points, blockers)
    gray = FLOOR_GRAY * np.exp(-1.3 * np.maximum(shade[:, 0] + shade[:, 3], 0.0))
    look = np.column_stack([gray, share * share * (3.0 - 2.0 * share)])
    return look.astype(np.float32)


def _lay_surface(surface: GroundSurface, blockers: Reals) -> Ground:
    """Lay uneven ground, which fades toward its border."""
    cell = float((surface.end - surface.corner).max()) / (_CELLS - 3)
    corner = np.array([*(surface.corner - cell), surface.height.max()])
    x, y = np.meshgrid(*(corner[:2, None] + cell * np.arange(_CELLS)), indexing="xy")
    places = np.column_stack([x.ravel(), y.ravel()])
    height = surface.height_at(np.clip(places, surface.corner, surface.end))
    inland = np.minimum(places - surface.corner, surface.end - places).min(axis=1)
    look = _look(np.column_stack([places, height]), inland / _REAR_FADE, blockers)
    return Ground(
        corner=corner, cell=cell, look=look.reshape(*x.shape, 2), slabs=[], surface=surface
    )


_STRIDE = 0.7
"""Steps of rays along uneven ground, of its cells."""
_HALVINGS = 12
"""Halvings of the step in which a ray met it."""


def _cast_surface(
    surface: GroundSurface, eye: Array32, direction: Array32, depth: Array32, normal: Array32
) -> None:
    """Write depth and normal of rays (n, 3) that meet uneven ground from above."""
    low = np.array([*surface.corner, surface.height.min() - 1e-3])
    high = np.array([*surface.end, surface.height.max() + 1e-3])
    ways = np.where(direction == 0.0, np.float32(1e-9), direction).astype(np.float64)
    sides = [_between(ways[:, c], low[c] - eye[c], high[c] - eye[c]) for c in range(3)]
    first = np.maximum.reduce([side[0] for side in sides] + [np.zeros(len(ways))])
    last = np.minimum.reduce([side[1] for side in sides])
    step = _STRIDE * surface.cell / np.linalg.norm(ways, axis=1)
    ray = np.flatnonzero(first < last)
    at = first[ray]

    def above(which: Ints, depths: Reals) -> Reals:
        points = eye + depths[:, None] * ways[which]
        height = surface.height_at(np.clip(points[:, :2], surface.corner, surface.end))
        return np.asarray(points[:, 2] - height)

    is_above = above(ray, at) >= 0.0
    ray, at = ray[is_above], at[is_above]  # others come from the side, where it has faded
    while len(ray):
        further = np.minimum(at + step[ray], last[ray])
        met = above(ray, further) < 0.0
        near, far = at[met], further[met]
        for _ in range(_HALVINGS):
            half = 0.5 * (near + far)
            is_below = above(ray[met], half) < 0.0
            near, far = np.where(is_below, near, half), np.where(is_below, half, far)
        depth[ray[met]] = far
        goes_on = ~met & (further < last[ray])
        ray, at = ray[goes_on], further[goes_on]
    hit = np.flatnonzero(np.isfinite(depth))
    places = eye[:2] + depth[hit, None] * ways[hit, :2]
    bump = surface.cell * np.eye(2)
    slopes = [
        surface.height_at(np.clip(places + b, surface.corner, surface.end))
        - surface.height_at(np.clip(places - b, surface.corner, surface.end))
        for b in bump
    ]
    slope = np.column_stack([*slopes, np.full(len(hit), -2.0 * surface.cell)])
    normal[hit] = unit(-slope.astype(np.float32))


def _cast_slab(
    slab: swarm_view.Slab, eye: Array32, direction: Array32, depth: Array32, normal: Array32
) -> None:
    """Write depth and normal of rays (n, 3) that meet a slab before their depth."""
    dx, dy, dz = np.where(direction == 0.0, np.float32(1e-9), direction).T
    x_low, x_high = sorted([slab.rear, slab.edge])
    x_in, x_out = _between(dx, x_low - eye[0], x_high - eye[0])
    y_in, y_out = _between(dy, slab.low_y - eye[1], slab.high_y - eye[1])
    z_in, z_out = _between(dz, slab.top - 2.0 * EDGE_RADIUS - eye[2], slab.top - eye[2])
    flat_in = np.maximum(np.maximum(x_in, y_in), z_in)
    flat = flat_in < np.minimum(np.minimum(x_out, y_out), z_out)

    axis_x = slab.edge - eye[0]  # of the rounded edge
    axis_z = slab.top - EDGE_RADIUS - eye[2]
    length2 = dx * dx + dz * dz
    middle = (dx * axis_x + dz * axis_z) / length2
    off2 = (axis_x - middle * dx) ** 2 + (axis_z - middle * dz) ** 2
    half = np.sqrt(np.maximum(EDGE_RADIUS**2 - off2, 0.0) / length2)
    edge_in = np.maximum(middle - half, y_in)
    edge = edge_in < np.minimum(middle + half, y_out)

    met = np.minimum(np.where(flat, flat_in, np.inf), np.where(edge, edge_in, np.inf))
    ray = np.flatnonzero((met > 0.0) & (met < depth))
    met = met[ray]
    depth[ray] = met
    out = -np.sign(direction[ray])
    normal[ray] = np.eye(3, dtype=np.float32)[2] * out
    for axis, begin in enumerate((x_in, y_in)):
        side = met == begin[ray]
        normal[ray[side]] = np.eye(3, dtype=np.float32)[axis] * out[side]
    bent = met == (middle - half)[ray]
    where = ray[bent]
    normal[where, 0] = met[bent] * dx[where] - axis_x
    normal[where, 1] = 0.0
    normal[where, 2] = met[bent] * dz[where] - axis_z


def _between(across: NDArray[Any], low: float, high: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Find the depths at which rays pass between two planes at these distances from the eye."""
    low_depth = low / across
    high_depth = high / across
    return np.minimum(low_depth, high_depth), np.maximum(low_depth, high_depth)


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
    """P capsules, a ground if any, and a camera; nothing is behind them."""

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
        columns = round(share * self.camera.width)
        rows = round(share * self.camera.height)
        return self.seen_by(replace(self.camera, width=columns, height=rows))

    def painted(self, robots: swarm_view.DrawnRobots) -> "Scene":
        """Return a scene of robots alone in their present colors."""
        capsules = _capsules(robots)
        return replace(
            self, color=np.concatenate([group[3] for group in capsules]).astype(np.float32)
        )

    def looks_like(self, scene: "Scene") -> bool:
        """Whether both have the very same arrays, up to colors."""
        names = {field.name for field in fields(self)} - {"color"}
        return all(getattr(self, name) is getattr(scene, name) for name in names)

    def seen_by(self, camera: Camera) -> "Scene":
        """Return the same scene before another camera."""
        ghost = None if self.ghost is None else replace(self.ghost, camera=camera)
        return replace(self, camera=camera, ghost=ghost)


TRUE_SIZE = swarm_view.Look(0.45, 0.3, 1.0)
"""Radii in which touching docks touch."""


def build_scene(
    robots: swarm_view.DrawnRobots,
    terrain: swarm_view.Ground | None,
    *,
    ghosts: swarm_view.DrawnRobots | None = None,
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
    slabs = [] if terrain is None else swarm_view.shown_slabs(terrain, around)
    for slab in slabs:
        z = slab.top - EDGE_RADIUS
        ends = [0.5 * (slab.rear + slab.edge), slab.edge]
        seen.append(np.array([[x, y, z] for x in ends for y in (slab.low_y, slab.high_y)]))
    dock = max(group.look.dock for group in (robots, ghosts) if group)
    camera = fit_camera(np.concatenate(seen), dock, along_x=bool(slabs))
    ground = None if terrain is None else lay_ground(terrain, around, _blockers(robots))
    ghost = _light(_capsules(ghosts), ghosts, camera) if ghosts else None
    capsules = _capsules(robots)
    if rods is not None:
        look = (np.full(len(rods), _ROD_RADIUS), np.tile(_ROD_GRAY, (len(rods), 1)))
        capsules.append((rods[:, 0], rods[:, 1], *look))
    return replace(_light(capsules, robots, camera), ground=ground, ghost=ghost)


def _light(
    capsules: list[tuple[Reals, ...]], robots: swarm_view.DrawnRobots, camera: Camera
) -> Scene:
    """Put capsules, shaded by robots, in front of a camera."""
    start, end, radius, color = (np.concatenate(column) for column in zip(*capsules, strict=True))
    return Scene(
        start=start.astype(np.float32),
        end=end.astype(np.float32),
        radius=radius.astype(np.float32),
        color=color.astype(np.float32),
        shade=blocked_light((start + end) / 2.0, _blockers(robots)),
        camera=camera,
        ground=None,
    )


def _blockers(robots: swarm_view.DrawnRobots) -> Reals:
    """Stand in for each robot, as to light, with a sphere: center and radius, shape (N, 4)."""
    radius = np.full(len(robots.center), _BLOCKER_RADIUS * robots.look.dock)
    return np.column_stack([robots.center, radius])


def _capsules(robots: swarm_view.DrawnRobots) -> list[tuple[Reals, ...]]:
    """Make start, end, radius and color of hubs, arms and docks."""
    docks = robots.dock.shape[1]
    look = robots.look
    hub = robots.center
    dock = robots.dock.reshape(-1, 3)
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
    from_above = points[:, :2].astype(float)
    if along_x:
        from_above[:, 1] = 0.0
    back = _view_direction(from_above)
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
    eye = np.array([right_at, up_at, -max(right_distance, up_distance)]) @ axes
    return Camera(eye=eye, axes=axes, half_height=half_height, width=width, height=height)


def _view_direction(points: Reals) -> Reals:
    """Point from the structure to the eye: from the -y side, a little above, onto the long side.

    Points are seen from above, shape (n, 2).
    """
    flat = points - points.mean(axis=0)
    variance, direction = np.linalg.eigh(flat.T @ flat)
    along = direction[:, 1] if variance[1] > 2.0 * variance[0] else np.array([1.0, 0.0])
    azimuth = math.atan2(-abs(along[0]), along[1] * np.sign(along[0] or 1.0)) + _OBLIQUE
    level = math.cos(_ELEVATION)
    up = math.sin(_ELEVATION)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), up])


def _stand_back(across: Reals, depth: Reals, radius: float, slope: float) -> tuple[float, float]:
    """Place the eye, across the view and before depth 0, so that it sees every ball whole."""
    slope /= _MARGIN
    margin = radius * math.hypot(1.0, slope)
    above = float(np.max(across - slope * depth)) + margin
    below = float(np.max(-across - slope * depth)) + margin
    return (above - below) / 2.0, (above + below) / (2.0 * slope)


def capsule_normals(scene: Scene, which: Ints, points: Array32) -> Array32:
    """Point away from the axes of given capsules at points on their surfaces [R], shape (n, 3)."""
    start = scene.start[which]
    span = scene.end[which] - start
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
    points = []
    triangles = []
    order = []
    counts = []
    first = 0
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
    capsule = np.concatenate(order)
    count = np.concatenate(counts)
    return Mesh(
        point=np.concatenate(points),
        triangle=np.concatenate(triangles).astype(np.int32),
        point_capsule=capsule.repeat(count[:, 0]),
        triangle_capsule=capsule.repeat(count[:, 1]),
    )


def _unit_sphere(sides: int) -> tuple[Array32, NDArray[np.int32]]:
    """Wrap a grid around the z axis; its rings are odd in number, so none is the equator."""
    rings = sides // 2 | 1
    polar = np.pi * np.arange(rings + 1) / rings
    around = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(around), np.sin(around)])
    flat = (np.sin(polar)[:, None, None] * circle).reshape(-1, 2)
    point = np.column_stack([flat, -np.cos(polar).repeat(sides)]).astype(np.float32)
    ring, side = np.indices((rings, sides)).reshape(2, -1)
    a = ring * sides + side
    b = ring * sides + (side + 1) % sides
    lower = np.column_stack([a, b, b + sides])
    upper = np.column_stack([a, b + sides, a + sides])
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


_SOLID_SIDES = 10  # of a dock sphere's equator: a compromise of roundness and file size
_EDGE_GRAY = (51, 51, 51, 255)  # color of contacts: red, green, blue, opacity
_MATTE = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns our z axis into the y axis, which is up in glTF."""


def encode_gltf(view: swarm_view.SwarmView) -> dict[str, bytes]:
    """Encode structure, estimate and contacts as one file."""
    return {"case.glb": _gltf(_shapes(view, gamma=2.2), view.log)}


def encode_ply(view: swarm_view.SwarmView) -> dict[str, bytes]:
    """Encode structure, estimate and contacts, each as a file."""
    return {f"{name}.ply": _ply(shape, view.log) for name, shape in _shapes(view).items()}


def paint(by: swarm_view.Coloring) -> Reals:
    """Color robots by values, gray where unknown, shape (N, 3)."""
    colors = SCALES[by.scale]
    share = by.value / (len(colors) - 1.0) if by.words else by.share
    color = colors_along(np.nan_to_num(share), colors)
    color[np.isnan(share)] = rgb(UNKNOWN_GRAY)
    return color


def _shapes(view: swarm_view.SwarmView, *, gamma: float = 1.0) -> dict[str, Any]:
    """Build trimesh solids of structure and estimate, and a path of the contacts if there are any.

    Robots of the structure are colored by join, those of the estimate by error or, where the truth
    is unknown, by standard deviation; all by values of the user if there are any. Contacts connect
    the centers of robots. The exponent `gamma` = 2.2 turns sRGB into linear colors for glTF.
    Lengths are in the unit of the log, from the anchor.
    """
    from trimesh.path import Path3D, entities  # noqa: PLC0415 - slow to import

    by = next(iter(view.colorings), None)
    color = view.color_by_join if by is None else paint(by)
    colors = {"structure": color if view.user_colorings else view.color_by_join, "estimate": color}
    shapes = {
        name: _solid(view.robots(view.from_origin(pose), colors[name], TRUE_SIZE), gamma)
        for name, pose in view.poses.items()
    }
    center = view.from_origin(view.best_pose)[:, :3]
    pairs = view.log.contacts[:, [0, 2]]
    line: Any = entities.Line
    lines = [line(pair) for pair in pairs[np.isfinite(center[pairs]).all(axis=(1, 2))]]
    gray = np.tile(np.array(_EDGE_GRAY, np.uint8), (len(lines), 1))
    if lines:
        ends = np.nan_to_num(center)  # no line ends where the place is unknown
        shapes["contacts"] = Path3D(lines, ends, colors=gray, process=False)
    for shape in shapes.values():
        shape.apply_scale(view.log.dock_radius)
    return shapes


def _solid(robots: swarm_view.DrawnRobots, gamma: float) -> Any:  # noqa: ANN401 - Trimesh, imported late
    """Mesh robots with colors and normals."""
    import trimesh  # noqa: PLC0415 - slow to import

    scene = build_scene(robots, None)
    mesh = mesh_capsules(scene, sides=_SOLID_SIDES)
    return trimesh.Trimesh(
        mesh.point,
        mesh.triangle,
        vertex_normals=capsule_normals(scene, mesh.point_capsule, mesh.point),
        vertex_colors=np.round(255.0 * scene.color[mesh.point_capsule] ** gamma).astype(np.uint8),
        process=False,
    )


def _ply(shape: Any, log: SensingLog) -> bytes:  # noqa: ANN401 - of trimesh, imported late
    """Encode a shape as PLY, whose comments state the unit and where the log has its origin."""
    normals = {"vertex_normal": True} if hasattr(shape, "vertex_normals") else {}
    kind, encoding, rest = shape.export(file_type="ply", **normals).split(b"\n", 2)
    origin = " ".join(map(repr, log.anchor_position.tolist()))
    comments = f"comment length_unit {log.length_unit}\ncomment origin {origin}"
    return b"\n".join([kind, encoding, comments.encode(), rest])


def _gltf(shapes: dict[str, Any], log: SensingLog) -> bytes:
    """Encode shapes as the nodes of one binary glTF file, y up, moved to the anchor."""
    import trimesh  # noqa: PLC0415 - slow to import

    scene = trimesh.Scene(metadata={"length_unit": log.length_unit})
    transform = _Y_UP.astype(np.float64)
    transform[:3, 3] = transform[:3, :3] @ log.anchor_position
    for name, shape in shapes.items():
        scene.add_geometry(shape, node_name=name, geom_name=name, transform=transform)

    def add_matte(tree: dict[str, Any]) -> None:
        tree["materials"] = [_MATTE]  # the default of glTF is metal
        for mesh in tree["meshes"]:
            mesh["primitives"][0]["material"] = 0

    export: Any = scene.export
    data: bytes = export(file_type="glb", include_normals=True, tree_postprocessor=add_matte)
    return data
