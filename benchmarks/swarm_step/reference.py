"""The step written out literally in float64, for the engines to be held against."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.swarm_step.scenes import Law, Scene


def near_docks(
    scene: Scene, law: Law, position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """All docks, shape (3 N, 3), and the pairs of different robots nearer than D."""
    dock = (position + scene.separation)[:, None] + scene.dock_offset
    dock = dock.reshape(-1, 3)
    pair = cKDTree(dock).query_pairs(law.spacing, output_type="ndarray")
    return dock, pair[pair[:, 0] // 3 != pair[:, 1] // 3]


def force(scene: Scene, law: Law, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum over each robot's docks of what every other robot's docks do to it [R], shape (N, 3).

    Docks nearer than D push each other apart, connected or not, by B (1 - a) (d - D)^4;
    connected ones farther than D pull by A a (d - D).
    """
    dock, near = near_docks(scene, law, position)
    connected = 3 * scene.contacts[:, 0::2] + scene.contacts[:, 1::2]
    total = np.zeros_like(position)
    for pairs, pushes in ((near, True), (connected, False)):
        offset = dock[pairs[:, 1]] - dock[pairs[:, 0]]
        distance = np.linalg.norm(offset, axis=1)
        gap = distance - law.spacing
        if pushes:
            magnitude = -law.repulsion_gain * (1.0 - law.ramp) * gap**4
        else:
            magnitude = np.where(gap > 0.0, law.attraction_gain * law.ramp * gap, 0.0)
        pull = (magnitude / distance)[:, None] * offset
        np.add.at(total, pairs[:, 0] // 3, pull)
        np.add.at(total, pairs[:, 1] // 3, -pull)
    return total


def run(scene: Scene, law: Law, steps: int) -> NDArray[np.float64]:
    """Positions after that many steps [R], shape (N, 3)."""
    position = scene.position.copy()
    for _ in range(steps):
        step = force(scene, law, position)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        position += step * np.minimum(1.0, law.max_step / np.maximum(length, 1e-300))
    return position


def pair_energy(scene: Scene, law: Law) -> float:
    """Sum of B (D - d)^2 over pairs of docks of different robots nearer than D."""
    dock, near = near_docks(scene, law, scene.position)
    gap = np.linalg.norm(dock[near[:, 0]] - dock[near[:, 1]], axis=1) - law.spacing
    return float(law.repulsion_gain * np.square(gap).sum())
