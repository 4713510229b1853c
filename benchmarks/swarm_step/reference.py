"""The reference: the step in float64, as its equations state it."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.swarm_step.scenes import Scene, StepParams


def near_docks(
    scene: Scene, params: StepParams, position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return all docks, shape (3 N, 3), and the pairs of different robots closer than D."""
    dock = (position + scene.separation)[:, None] + scene.dock_offset
    dock = dock.reshape(-1, 3)
    pair = cKDTree(dock).query_pairs(params.spacing, output_type="ndarray")
    return dock, pair[pair[:, 0] // 3 != pair[:, 1] // 3]


def force(scene: Scene, params: StepParams, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum the forces of all other robots' docks on each robot [R], shape (N, 3).

    Docks closer than D repel each other, connected or not, by B (1 - a) (d - D)^4. Connected
    docks farther apart than D attract each other by A a (d - D).
    """
    dock, near = near_docks(scene, params, position)
    connected = 3 * scene.contacts[:, 0::2] + scene.contacts[:, 1::2]
    total = np.zeros_like(position)
    for pairs, pushes in ((near, True), (connected, False)):
        offset = dock[pairs[:, 1]] - dock[pairs[:, 0]]
        distance = np.linalg.norm(offset, axis=1)
        gap = distance - params.spacing
        if pushes:
            magnitude = -params.repulsion_gain * (1.0 - params.ramp) * gap**4
        else:
            magnitude = np.where(gap > 0.0, params.attraction_gain * params.ramp * gap, 0.0)
        pull = (magnitude / distance)[:, None] * offset
        np.add.at(total, pairs[:, 0] // 3, pull)
        np.add.at(total, pairs[:, 1] // 3, -pull)
    return total


def run(scene: Scene, params: StepParams, steps: int) -> NDArray[np.float64]:
    """Return the positions after some steps [R], shape (N, 3)."""
    position = scene.position.copy()
    for _ in range(steps):
        step = force(scene, params, position)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        position += step * np.minimum(1.0, params.max_step / np.maximum(length, 1e-300))
    return position


def pair_energy(scene: Scene, params: StepParams) -> float:
    """Sum B (D - d)^2 over pairs of docks of different robots closer than D."""
    dock, near = near_docks(scene, params, scene.position)
    gap = np.linalg.norm(dock[near[:, 0]] - dock[near[:, 1]], axis=1) - params.spacing
    return float(params.repulsion_gain * np.square(gap).sum())
