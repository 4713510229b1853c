"""Slabs with rounded edges, written out case by case."""

import numpy as np

from tests import oracle


def _side_depth(terrain, beyond, z):
    """Depth of docks `beyond` an edge, negative inland, at heights `z`, in that slab alone."""
    above, below = terrain.ground_z + 1.0 - z, z - (terrain.ground_z - 3.0)
    curved = 2.0 - np.sqrt(beyond**2 + (z - terrain.ground_z + 1.0) ** 2)
    return np.where(beyond > 0.0, curved, np.minimum(above, below))


def depth(terrain, places):
    """How deep docks at `places`, shape (n, 3), reach into the ground, negative for a gap [R]."""
    x, _, z = np.transpose(places)
    if terrain.is_plane:
        return terrain.ground_z + 1.0 - z
    depths = [_side_depth(terrain, x - terrain.left_edge, z)]
    if terrain.right_edge < 1e9:
        depths.append(_side_depth(terrain, terrain.right_edge - x, z))
    return np.max(depths, axis=0)


def is_flat_at(terrain, place):
    """Whether a place is above the flat top of a slab, or above its upper half."""
    x, _, z = place
    return (x <= terrain.left_edge or x >= terrain.right_edge) and z > terrain.ground_z - 1.0


def first_meeting(terrain, pivot, arm, axis):
    """Angle in steps of a fine circle at which a turning dock first enters the ground.

    Returns:
        The angle, and the least gap on the whole circle but its start.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, oracle.FINE, endpoint=False)
    path = pivot + oracle.turned(arm, axis, angles)
    gap = -depth(terrain, path)
    inside = np.flatnonzero(gap[1:] < -1e-9) + 1
    first = angles[inside[0]] if len(inside) else np.inf
    return first, gap[1:].min()


def docks(history):
    """Docks of all robots where they stay, shape (3 N, 3)."""
    body = history.robot.dock_offset_body
    return np.concatenate(
        [
            center + body @ oracle.matrix(q).T
            for center, q in zip(history.position, history.orientation_wxyz, strict=True)
        ]
    )
