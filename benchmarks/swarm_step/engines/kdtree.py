"""SciPy and NumPy: pairs from a cKDTree, forces by array operations."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.swarm_step.scenes import Scene, StepParams


class KdTree:
    """Pairs within D + skin, searched again when a robot has moved half the skin."""

    def __init__(self, scene: Scene, params: StepParams, *, precision: str, threads: int) -> None:
        del precision, threads
        self.params, self.separation = params, scene.separation
        self.start_position = scene.position + scene.separation
        self.dock_offset = scene.dock_offset
        self.connected = 3 * scene.contacts[:, 0::2] + scene.contacts[:, 1::2]
        self.builds = 0

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the final positions."""
        params, here = self.params, self.start_position.copy()
        self.builds = 0
        origin = np.full_like(here, np.inf)
        for _ in range(steps):
            dock = (here[:, None] + self.dock_offset).reshape(-1, 3)
            if not np.square(here - origin).sum(axis=1).max() <= (0.5 * params.skin) ** 2:
                near = cKDTree(dock).query_pairs(
                    params.spacing + params.skin, output_type="ndarray"
                )
                near = near[near[:, 0] // 3 != near[:, 1] // 3]
                origin = here.copy()
                self.builds += 1
            step = self._force(dock, near, -params.repulsion_gain * (1.0 - params.ramp), 4)
            step += self._force(dock, self.connected, params.attraction_gain * params.ramp, 1)
            length = np.sqrt(np.square(step).sum(axis=1, keepdims=True))
            here += step * np.minimum(1.0, max_step / np.maximum(length, np.finfo(float).tiny))
        return here - self.separation

    def _force(
        self, dock: NDArray[np.float64], pair: NDArray[np.intp], gain: float, power: int
    ) -> NDArray[np.float64]:
        """Sum forces gain * gap^power of pairs closer (even power) or farther (odd) than D."""
        offset = dock[pair[:, 1]] - dock[pair[:, 0]]
        gap = np.sqrt(np.einsum("ij,ij->i", offset, offset)) - self.params.spacing
        acts = gap > 0.0 if power % 2 else gap < 0.0
        pair, offset, gap = pair[acts], offset[acts], gap[acts]
        squared = gap * gap
        pull = gain * (gap if power % 2 else squared * squared) / (gap + self.params.spacing)
        robot, robots = pair // 3, len(self.start_position)
        forces = []
        for axis in range(3):
            weight = pull * offset[:, axis]
            forward = np.bincount(robot[:, 0], weight, robots)
            forces.append(forward - np.bincount(robot[:, 1], weight, robots))
        return np.stack(forces, axis=1)
