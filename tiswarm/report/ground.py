"""The part of the ground that pictures show, around the docks of a structure."""

from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.records.terrain import EDGE_RADIUS, NO_EDGE, Terrain

_STANDING = 0.1  # gap to the ground below which a dock stands on it [R]
_AROUND = 3.0  # ground shown beside the docks [R]
_BEHIND = 7.0  # ground shown behind an edge where no dock stands [R]
_ARC = 8  # faces of a rounded edge


class Slab(NamedTuple):
    """A piece of a slab: flat from x = `rear` to x = `edge`, and rounded beyond the edge [R]."""

    rear: float
    edge: float
    low_y: float
    high_y: float
    top: float  # height of its flat top; it is 2 `EDGE_RADIUS` thick

    @property
    def outward(self) -> float:
        """1 if the edge is at the right of the piece, -1 if it is at the left."""
        return 1.0 if self.edge > self.rear else -1.0


def standing_docks(terrain: Terrain, dock: Reals) -> Reals:
    """Choose the docks, shape (n, 3), that stand on flat ground."""
    beyond = (dock[:, 0] > terrain.left_edge) & (dock[:, 0] < terrain.right_edge)
    height = dock[:, 2] - 1.0 - terrain.ground_z
    standing: Reals = dock[(np.abs(height) < _STANDING) & ~beyond]
    return standing


def shown_slabs(terrain: Terrain, dock: Reals) -> list[Slab]:
    """Cut a piece off each slab that reaches around the docks, shape (n, 3); none off a plane."""
    if terrain.is_plane:
        return []
    standing = standing_docks(terrain, dock)[:, 0]
    low_y, high_y = dock[:, 1].min() - _AROUND, dock[:, 1].max() + _AROUND
    slabs = []
    for edge, outward in ((terrain.left_edge, 1.0), (terrain.right_edge, -1.0)):
        if edge < NO_EDGE:
            behind = float(np.max(outward * (edge - standing), initial=_BEHIND - _AROUND))
            rear = edge - outward * (behind + _AROUND)
            slabs.append(Slab(rear, edge, float(low_y), float(high_y), terrain.ground_z))
    return slabs


def ground_pieces(terrain: Terrain, dock: Reals) -> list[Reals]:
    """Cover each piece of ground around docks, shape (n, 3), with faces of four corners [R].

    Returns:
        Corners, counterclockwise as seen from above the ground, each of shape (faces, 4, 3). A
        plane has one face if a dock stands on it, and no piece otherwise.
    """
    slabs = shown_slabs(terrain, dock)
    if slabs:
        return [_faces(slab) for slab in slabs]
    standing = standing_docks(terrain, dock)[:, :2]
    if not len(standing):
        return []
    (left, front), (right, back) = standing.min(axis=0) - _AROUND, standing.max(axis=0) + _AROUND
    z = terrain.ground_z
    return [np.array([[[left, front, z], [right, front, z], [right, back, z], [left, back, z]]])]


def _faces(slab: Slab) -> Reals:
    """Cover a piece of a slab with faces; it is open at its rear."""
    angle = np.linspace(0.5 * np.pi, -0.5 * np.pi, _ARC + 1)
    x = np.array([slab.rear, *(slab.edge + slab.outward * EDGE_RADIUS * np.cos(angle)), slab.rear])
    z = slab.top - EDGE_RADIUS + EDGE_RADIUS * np.array([1.0, *np.sin(angle), -1.0])
    front, back = (np.column_stack([x, np.full(len(x), y), z]) for y in (slab.low_y, slab.high_y))
    outline = np.stack([front[:-1], front[1:], back[1:], back[:-1]], axis=1)
    half = len(x) // 2  # a side is cut into faces from the top to the underside
    sides = [
        np.stack([below[:half], below[1 : half + 1], above[1 : half + 1], above[:half]], axis=1)
        for below, above in ((front[::-1], front), (back, back[::-1]))
    ]
    faces: Reals = np.concatenate([outline, *sides])
    return faces if slab.outward > 0.0 else faces[:, ::-1]
