"""What a robot infers from its own flips: its height, and where it spawned."""

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets, normal
from tiswarm.sensing.params import SensingParams
from tiswarm.world.history import History


def flip_height(history: History, sensed: Reals, end: Ints) -> Reals:
    """Return the height of each robot's center that its own flips imply, shape (N,).

    A robot starts on the ground, with its center above the docks that stand there. A flip about the
    dock at b moves its center by (R - R') b, where R and R' are the orientations sensed before and
    after. NaN for a robot that starts without a dock on flat ground. Where ground is uneven, robots
    know how high it is where they start.
    """
    dock_height = dock_offsets(sensed, history.robot.dock_offset_body)[:, :, 2]
    height = np.full(len(end), history.ground_z + history.robot.dock_radius)
    for j, walk in enumerate(history.walks):
        rows = dock_height[end[j] - walk.stance_count : end[j]]
        standing = walk.ground_docks[walk.ground_docks[:, 0] == 0, 1]
        if history.terrain.form is not None:
            standing = walk.edge_docks[walk.edge_docks[:, 0] == 0, 1]
            arm = dock_offsets(walk.orientation_wxyz[:1], history.robot.dock_offset_body)[0, :, 2]
            height[j] = walk.center[0, 2] + (arm[standing].mean() if len(standing) else np.nan)
        height[j] -= rows[0, standing].mean() if len(standing) else np.nan
        step = np.arange(walk.stance_count - 1)
        height[j] += np.sum(rows[step, walk.pivot_dock] - rows[step + 1, walk.pivot_dock])
    return height


def spawn_position(history: History, params: SensingParams) -> Reals:
    """Return each robot's sensed spawn position [R], shape (N, 3); NaN without `spawn_noise`."""
    true = np.array([walk.center[0] for walk in history.walks])
    if params.spawn_noise is None:
        return np.full_like(true, np.nan)
    robot = np.arange(history.robot_count)[:, None]
    return true + params.spawn_noise * normal(history.seed, "spawn position", robot, np.arange(3))
