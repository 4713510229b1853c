"""Rotations and random numbers of whole arrays.

A random number is a hash of (seed, stream, robot, draw). It depends on nothing else: not on
threads, not on the order of the robots, not on how many other numbers were drawn. The mixing
function is that of SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number
generators", OOPSLA 2014).
"""

import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Reals


def dock_offsets(orientation_wxyz: Reals, dock_offset_body: Reals) -> Reals:
    """Turn each robot's docks into the world frame.

    Args:
        orientation_wxyz: Body to world, shape (N, 4).
        dock_offset_body: Center to dock, body frame, shape (docks, 3).

    Returns:
        Center to dock, world frame, shape (N, docks, 3).
    """
    matrix = Rotation.from_quat(orientation_wxyz, scalar_first=True).as_matrix()
    offsets: Reals = np.ascontiguousarray(dock_offset_body) @ matrix.swapaxes(1, 2)
    return offsets


def uniform(seed: ArrayLike, stream: str, robot: ArrayLike, draw: ArrayLike) -> Reals:
    """Draw numbers in [0, 1); `seed`, `robot` and `draw` broadcast against each other.

    Args:
        seed: Seed of the study, 0 or more.
        stream: Purpose, for example "spawn"; streams are independent of each other.
        robot: Index of each robot.
        draw: Which of the robot's draws.

    >>> bool(uniform(1, "spawn", 7, 0) == uniform(1, "spawn", [6, 7, 8], 0)[1])
    True
    """
    key = _mix(np.atleast_1d(np.asarray(seed, dtype=np.uint64)))
    key = _mix(key ^ np.uint64(zlib.crc32(stream.encode())))
    bits = _mix(_mix(key ^ np.asarray(robot, dtype=np.uint64)) ^ np.asarray(draw, dtype=np.uint64))
    shape = np.broadcast_shapes(np.shape(seed), np.shape(robot), np.shape(draw))
    return ((bits >> np.uint64(11)).astype(np.float64) * 2.0**-53).reshape(shape)


def normal(seed: int, stream: str, robot: ArrayLike, draw: ArrayLike) -> Reals:
    """Draw standard normal numbers (Box and Muller); arguments as for `uniform`."""
    pair = 2 * np.asarray(draw, dtype=np.uint64)
    radius = np.sqrt(-2.0 * np.log1p(-uniform(seed, stream, robot, pair)))
    turn = np.cos(2.0 * np.pi * uniform(seed, stream, robot, pair + np.uint64(1)))
    numbers: Reals = radius * turn
    return numbers


def _mix(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Scatter 64 bits; multiplication wraps on purpose."""
    mixed = value + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))
