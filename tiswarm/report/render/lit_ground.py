"""The ground of a scene: where rays meet it, and its brightness.

A plane is a patch that fades around the docks that stand on it. It is a backdrop: it hides nothing.
A slab is a solid piece that fades toward its rear.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Reals
from tiswarm.records.terrain import EDGE_RADIUS, Terrain
from tiswarm.report.ground import Slab, shown_slabs, standing_docks
from tiswarm.report.render.shade import Array32, blocked_light

_CELLS = 160
_FADE = (2.0, 9.0)  # distances from the nearest standing dock where a plane fades [R]
_REAR_FADE = 4.0  # length over which a slab fades at its rear [R]
_GRAY = 0.92


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Flat ground cut into cells; with slabs, only what lies on them is there."""

    corner: Reals  # center of the cell with the least x and y [R], shape (3,)
    cell: float  # distance between the centers of two neighboring cells [R]
    look: Array32  # brightness, and opacity from 0 to 1, by y and x cell, shape (cells, cells, 2)
    slabs: list[Slab]

    @property
    def corners(self) -> Reals:
        """Corners of a box that has all of it [R], shape (8, 3)."""
        x, y = (self.corner[:2] + self.cell * np.outer([0.0, len(self.look) - 1.0], [1.0, 1.0])).T
        z = self.corner[2] - np.array([0.0, 2.0 * EDGE_RADIUS * bool(self.slabs)])
        return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)

    def cast(self, eye: Array32, direction: Array32) -> tuple[Array32, Array32]:
        """Find depth, infinite if there is none, and normal where rays (n, 3) meet the ground."""
        depth = np.full(len(direction), np.inf, np.float32)
        normal = np.zeros_like(direction)
        normal[:, 2] = 1.0
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


def lay_ground(terrain: Terrain, dock: Reals, blockers: Reals) -> Ground | None:
    """Lay ground around docks (n, 3), darker beneath robots; None if no dock stands on a plane."""
    slabs = shown_slabs(terrain, dock)
    standing = standing_docks(terrain, dock)[:, :2]
    if slabs:
        ends = [x for s in slabs for x in (s.rear, s.edge + s.outward * EDGE_RADIUS)]
        low, high = np.array([[min(ends), slabs[0].low_y], [max(ends), slabs[0].high_y]])
    elif len(standing):
        low, high = standing.min(axis=0) - _FADE[1], standing.max(axis=0) + _FADE[1]
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
    share = np.clip(share, 0.0, 1.0)
    shade = blocked_light(points, blockers)
    gray = _GRAY * np.exp(-1.3 * np.maximum(shade[:, 0] + shade[:, 3], 0.0))
    look = np.column_stack([gray, share * share * (3.0 - 2.0 * share)])
    look = look.reshape(*x.shape, 2).astype(np.float32)
    return Ground(corner=corner, cell=cell, look=look, slabs=slabs)


def _cast_slab(
    slab: Slab, eye: Array32, direction: Array32, depth: Array32, normal: Array32
) -> None:
    """Write depth and normal of rays (n, 3) that meet a slab before their depth."""
    dx, dy, dz = np.where(direction == 0.0, np.float32(1e-9), direction).T
    left, right = sorted([slab.rear, slab.edge])
    x_in, x_out = _between(dx, left - eye[0], right - eye[0])
    y_in, y_out = _between(dy, slab.low_y - eye[1], slab.high_y - eye[1])
    z_in, z_out = _between(dz, slab.top - 2.0 * EDGE_RADIUS - eye[2], slab.top - eye[2])
    flat_in = np.maximum(np.maximum(x_in, y_in), z_in)
    flat = flat_in < np.minimum(np.minimum(x_out, y_out), z_out)

    axis_x, axis_z = slab.edge - eye[0], slab.top - EDGE_RADIUS - eye[2]  # of the rounded edge
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


def _between(across: Array32, low: float, high: float) -> tuple[Array32, Array32]:
    """Find the depths at which rays pass between two planes at these distances from the eye."""
    first, second = low / across, high / across
    return np.minimum(first, second), np.maximum(first, second)
