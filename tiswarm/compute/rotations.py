"""Rotations as unit quaternions, wxyz, body to world: for kernels and for whole arrays."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiswarm.compute.lang import ti


def dock_offsets(
    orientation_wxyz: NDArray[np.float64], dock_offset_body: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn each robot's docks into the world frame.

    Args:
        orientation_wxyz: Body to world, shape (N, 4).
        dock_offset_body: Center to dock, body frame, shape (docks, 3).

    Returns:
        Center to dock, world frame, shape (N, docks, 3).
    """
    matrix = Rotation.from_quat(orientation_wxyz, scalar_first=True).as_matrix()
    return np.ascontiguousarray(dock_offset_body) @ matrix.swapaxes(1, 2)


@ti.func
def quaternion_product(p, q):
    """Compose rotations: first `q`, then `p`."""
    return ti.Vector(
        [
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        ]
    )


@ti.func
def rotate(q, v):
    """Turn the vector `v` by the unit quaternion `q`."""
    axis = ti.Vector([q[1], q[2], q[3]])
    half = 2.0 * axis.cross(v)
    return v + q[0] * half + axis.cross(half)


@ti.func
def axis_rotation(axis, angle):
    """Rotation by `angle` [rad] about the unit vector `axis`."""
    s = ti.sin(0.5 * angle)
    return ti.Vector([ti.cos(0.5 * angle), s * axis[0], s * axis[1], s * axis[2]])
