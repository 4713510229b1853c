"""Builds scenes: spheres and arms of robots, lit, on their ground, before a camera."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.report.render.camera import Array, Array32, frame
from tiswarm.report.render.scene import Ground, Scene

GIRTH = 1.45
"""Radius of the sphere that blocks as much light as a robot [dock radii]."""

REACH = 8.0
"""Robots further away than this cast no shade [R]; half of it in a crowd, to save time."""

CROWD = 2_000
SAME_PLACE = 1e-6
"""A robot casts no shade on its own hub, this near to its center [R]."""

STANDING = 0.1
"""Docks within this height of the ground stand on it [R]."""

GROUND_CELLS = 160
GROUND_FADE = (2.0, 9.0)
"""Distances from the nearest standing dock where the ground starts and ends to fade [R]."""

GROUND_GRAY = 0.92


@dataclass(frozen=True)
class Look:
    """Radii of a robot's parts [R]."""

    hub: float
    arm: float
    dock: float


@dataclass(frozen=True, kw_only=True)
class Robots:
    """N robots to be drawn."""

    center: Array
    """Centers [R], shape (N, 3)."""

    dock: Array
    """Dock centers [R], shape (N, docks, 3)."""

    color: Array
    """Red, green, blue of each, 0 to 1, shape (N, 3)."""

    look: Look


@dataclass(frozen=True, kw_only=True)
class Rods:
    """Straight rods of one thickness and color."""

    start: Array
    """One end of each [R], shape (n, 3)."""

    end: Array
    """Other end of each [R], shape (n, 3)."""

    radius: float
    color: tuple[float, float, float]


def build_scene(
    groups: list[Robots],
    ground_z: float | None,
    *,
    rods: Rods | None = None,
    around: Array | None = None,
) -> Scene:
    """Make spheres and arms of robots, light them and put a camera before them.

    Args:
        groups: What is to be seen.
        ground_z: Height of the ground [R]; None for no ground.
        rods: What is to be seen besides; it casts no shade.
        around: Docks that camera and ground must have room for [R], shape (n, 3); those of the
            groups if None.
    """
    parts = [part for robots in groups for part in _capsules(robots)]
    if rods is not None:
        parts.append(_rods(rods))
    start, end, radius, color = (np.concatenate(column) for column in zip(*parts, strict=True))
    center = np.concatenate([robots.center for robots in groups])
    girth = np.concatenate([np.full(len(r.center), GIRTH * r.look.dock) for r in groups])
    blockers = np.column_stack([center, girth])
    if around is None:
        around = np.concatenate([robots.dock.reshape(-1, 3) for robots in groups])
    return Scene(
        start=start.astype(np.float32),
        end=end.astype(np.float32),
        radius=radius.astype(np.float32),
        color=color.astype(np.float32),
        shade=_shade((start + end) / 2.0, blockers),
        camera=frame(around, max(robots.look.dock for robots in groups)),
        ground=None if ground_z is None else _ground(around, blockers, ground_z),
    )


def _capsules(robots: Robots) -> list[tuple[Array, ...]]:
    """Make start, end, radius and color of the hubs, the arms and the docks of robots."""
    docks, look = robots.dock.shape[1], robots.look
    hub, dock = robots.center, robots.dock.reshape(-1, 3)
    color = robots.color.repeat(docks, axis=0)
    return [
        (hub, hub, np.full(len(hub), look.hub), 0.7 * robots.color),
        (hub.repeat(docks, axis=0), dock, np.full(len(dock), look.arm), 0.7 * color),
        (dock, dock, np.full(len(dock), look.dock), color),
    ]


def _rods(rods: Rods) -> tuple[Array, ...]:
    """Make start, end, radius and color of rods."""
    count = len(rods.start)
    return rods.start, rods.end, np.full(count, rods.radius), np.tile(rods.color, (count, 1))


def _shade(points: Array, blockers: Array) -> Array32:
    """Add up the light that robots keep from points, in terms that are linear in the normal.

    A sphere of radius r at distance d in direction u keeps (r/d)^2 max(0, n.u) of the light
    from a surface with normal n; 1/4 + n.u / 2 stands in for max(0, n.u).

    Args:
        points: Where light is wanted [R], shape (n, 3).
        blockers: Center and radius of the spheres [R], shape (N, 4).
    """
    center = blockers[:, :3]
    reach = REACH if len(center) <= CROWD else REACH / 2.0
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(center), reach, output_type="ndarray")
    i, j = pairs["i"], pairs["j"]
    away = center[j] - points[i]
    distance = np.maximum(pairs["v"], 1e-9)
    blocked = np.minimum((blockers[j, 3] / distance) ** 2, 0.5) * (1.0 - distance / reach)
    blocked *= REACH / reach  # as much as the whole crowd would block
    blocked[pairs["v"] < SAME_PLACE] = 0.0
    terms = np.column_stack([blocked / 4.0, away * (blocked / distance / 2.0)[:, None]])
    sums = [np.bincount(i, weights=term, minlength=len(points)) for term in terms.T]
    return np.column_stack(sums).astype(np.float32)


def _ground(dock: Array, blockers: Array, height: float) -> Ground | None:
    """Lay ground around the docks that stand on it, darker beneath robots."""
    standing = dock[np.abs(dock[:, 2] - 1.0 - height) < STANDING, :2]
    if not len(standing):
        return None
    low = standing.min(axis=0) - GROUND_FADE[1]
    side = float(np.max(standing.max(axis=0) + GROUND_FADE[1] - low))
    cell = side / (GROUND_CELLS - 1)
    x, y = np.meshgrid(*(low[:, None] + cell * np.arange(GROUND_CELLS)), indexing="xy")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    distance, _ = cKDTree(standing).query(points[:, :2])
    near, far = GROUND_FADE
    fade = np.clip((far - distance) / (far - near), 0.0, 1.0)
    shade = _shade(points, blockers)
    gray = GROUND_GRAY * np.exp(-1.3 * np.maximum(shade[:, 0] + shade[:, 3], 0.0))
    shape = (GROUND_CELLS, GROUND_CELLS)
    return Ground(
        corner=np.array([*low, height]),
        cell=cell,
        gray=gray.reshape(shape).astype(np.float32),
        opacity=(fade * fade * (3.0 - 2.0 * fade)).reshape(shape).astype(np.float32),
    )
