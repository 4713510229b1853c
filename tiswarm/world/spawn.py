"""Where a robot that wants to join starts from."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import random
from tiswarm.robot import RobotGeometry

MAX_TRIES = 64
"""Places drawn for one robot before its spawn counts as blocked."""


def spawn_outside(
    joined_docks: NDArray[np.float64],
    robot: RobotGeometry,
    *,
    distance: tuple[float, float],
    ground_z: float,
    seed: int,
    index: int,
    attempt: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Lay a robot flat on the ground, anywhere around the base, turned at random.

    The base is the disc about the z axis that holds the whole structure. Draws depend on
    the seed, the robot and the attempt alone.

    Args:
        joined_docks: Dock centres of the structure [R], shape (n, 3).
        robot: The robot's shape.
        distance: Least and greatest distance of its centre from the rim of the base [R].
        ground_z: Height of the ground [R].
        seed: Seed of the structure.
        index: Number the robot will have if it joins.
        attempt: Spawns tried for that number before.

    Returns:
        Centre [R], shape (3,), and orientation wxyz, shape (4,); None where every place
        drawn was taken.
    """
    rim = float(np.hypot(joined_docks[:, 0], joined_docks[:, 1]).max(initial=-robot.dock_radius))
    rim += robot.dock_radius
    for trial in range(MAX_TRIES):
        draw = 3 * (attempt * MAX_TRIES + trial) + np.arange(3)
        bearing, yaw, beyond = random.uniform(seed, "spawn", index, draw)
        out = rim + distance[0] + beyond * (distance[1] - distance[0])
        angle = 2.0 * np.pi * bearing
        center = np.array([out * np.cos(angle), out * np.sin(angle), ground_z + robot.dock_radius])
        half = np.pi * yaw
        orientation = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
        if _is_free(center, joined_docks, robot):
            return center, orientation
    return None


def _is_free(
    center: NDArray[np.float64], joined_docks: NDArray[np.float64], robot: RobotGeometry
) -> bool:
    """Whether a robot at `center` overlaps nothing, however it is turned."""
    if len(joined_docks) == 0:
        return True
    clearance = np.linalg.norm(joined_docks - center, axis=1).min()
    return bool(clearance > robot.rho + robot.spacing)
