"""The ground: a plane, or slabs that end in a rounded edge.

A slab is everything within 1 R of its spine, the half-plane at half its depth that ends at
x = edge; so its top is flat, its edge a cylinder of radius 1 R, and it is 2 R thick. A plane
is a slab whose edge is out of reach, and it has no underside.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tiswarm.base.aliases import Bools, Reals

EDGE_RADIUS = 1.0
"""Radius of a rounded edge, and half the thickness of a slab [R]."""

NO_EDGE = 1e9
"""Where an edge lies that does not exist: nobody reaches it [R]."""


@dataclass(frozen=True, kw_only=True)
class Terrain:
    """Flat ground at `ground_z`, left of `left_edge` and right of `right_edge`."""

    ground_z: float = 0.0
    """Height of the flat ground [R]."""

    left_edge: float = NO_EDGE
    """Where the slab that comes from the left begins to round off [R]."""

    right_edge: float = NO_EDGE
    """The same of the slab that comes from the right [R]; out of reach if there is none."""

    form: ClassVar[None] = None
    """Form of ground that is not flat, for logs: none."""

    @property
    def is_plane(self) -> bool:
        """Whether there is no edge to be reached."""
        return self.left_edge >= NO_EDGE

    @property
    def has_edge(self) -> bool:
        """Whether there is an edge."""
        return not self.is_plane

    def foot(self, point: Reals) -> Reals:
        """Find the nearest place on the ground's surface to each point outside [R], (n, 3)."""
        feet = self._feet(point)
        distance = np.linalg.norm(point - feet, axis=-1)
        return np.where((distance[0] <= distance[-1])[:, None], feet[0], feet[-1])

    def depth(self, point: Reals, radius: float) -> Reals:
        """Compute how deep spheres around points reach into the ground, negative for a gap [R]."""
        if self.is_plane:
            return self.ground_z + radius - point[:, 2]
        depths = [
            EDGE_RADIUS + radius - np.hypot(point[:, 0] - x, point[:, 2] - self._spine_z)
            for x in self._spine_x(point)
        ]
        depth: Reals = np.max(depths, axis=0)
        return depth

    def hides(self, start: Reals, end: Reals) -> Bools:
        """Whether the ground is between two points, for n pairs of shape (n, 3), shape (n,)."""
        if self.is_plane:
            return np.minimum(start[:, 2], end[:, 2]) < self.ground_z
        hidden = np.zeros(len(start), np.bool_)
        for edge, out in ((self.left_edge, 1.0), (self.right_edge, -1.0)):
            if abs(edge) < NO_EDGE:
                a, b = ((p[:, [0, 2]] - [edge, self._spine_z]) * [out, 1.0] for p in (start, end))
                hidden |= _distance_to_half_line(a, b) < EDGE_RADIUS
        return hidden

    @property
    def _spine_z(self) -> float:
        return self.ground_z - EDGE_RADIUS

    def _spine_x(self, point: Reals) -> list[Reals]:
        """Nearest x on the spine of each slab."""
        slabs = [np.minimum(point[:, 0], self.left_edge)]
        if self.right_edge < NO_EDGE:
            slabs.append(np.maximum(point[:, 0], self.right_edge))
        return slabs

    def _feet(self, point: Reals) -> Reals:
        """Find the nearest place of each slab, shape (slabs, n, 3)."""
        spine_x = self._spine_x(point)
        spine = np.empty((len(spine_x), *point.shape))
        spine[..., 0] = spine_x
        spine[..., 1] = point[:, 1]
        spine[..., 2] = self._spine_z
        out = point - spine
        nearest: Reals = spine + EDGE_RADIUS * out / np.linalg.norm(out, axis=-1, keepdims=True)
        return nearest


def _distance_to_half_line(a: Reals, b: Reals) -> Reals:
    """Distance from segments in a plane, ends of shape (n, 2), to the half-line x <= 0, z = 0."""
    way = b - a
    share = np.clip(-(a * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300), 0.0, 1.0)
    to_tip = np.linalg.norm(a + share[:, None] * way, axis=1)
    to_ends = [np.where(p[:, 0] <= 0.0, np.abs(p[:, 1]), np.inf) for p in (a, b)]
    # Where the segment goes from one side to the other: x at the crossing times the change of z.
    crosses = (a[:, 1] < 0.0) != (b[:, 1] < 0.0)
    is_behind = (a[:, 0] * way[:, 1] - a[:, 1] * way[:, 0]) * np.sign(way[:, 1]) <= 0.0
    distance: Reals = np.minimum.reduce([to_tip, *to_ends])
    return np.where(crosses & is_behind, 0.0, distance)
