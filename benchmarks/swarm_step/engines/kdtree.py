"""SciPy's cKDTree for the pairs, NumPy for the forces."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.swarm_step.scenes import Law, Scene


class KdTree:
    """Pairs within D + skin, found anew once a robot moved half the skin."""

    def __init__(self, scene: Scene, law: Law, *, precision: str, threads: int) -> None:
        del precision, threads
        self.law, self.separation = law, scene.separation
        self.start_position = scene.position + scene.separation
        self.dock_offset = scene.dock_offset
        self.connected = 3 * scene.contacts[:, 0::2] + scene.contacts[:, 1::2]
        self.builds = 0

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the scene's start."""
        law, here = self.law, self.start_position.copy()
        self.builds = 0
        origin = np.full_like(here, np.inf)
        for _ in range(steps):
            dock = (here[:, None] + self.dock_offset).reshape(-1, 3)
            if not np.square(here - origin).sum(axis=1).max() <= (0.5 * law.skin) ** 2:
                near = cKDTree(dock).query_pairs(law.spacing + law.skin, output_type="ndarray")
                near = near[near[:, 0] // 3 != near[:, 1] // 3]
                origin = here.copy()
                self.builds += 1
            step = self._force(dock, near, -law.repulsion_gain * (1.0 - law.ramp), 4)
            step += self._force(dock, self.connected, law.attraction_gain * law.ramp, 1)
            length = np.sqrt(np.square(step).sum(axis=1, keepdims=True))
            here += step * np.minimum(1.0, max_step / np.maximum(length, np.finfo(float).tiny))
        return here - self.separation

    def _force(
        self, dock: NDArray[np.float64], pair: NDArray[np.intp], gain: float, power: int
    ) -> NDArray[np.float64]:
        """Forces gain * gap^power of pairs below D (even powers) or above it (odd ones)."""
        offset = dock[pair[:, 1]] - dock[pair[:, 0]]
        gap = np.sqrt(np.einsum("ij,ij->i", offset, offset)) - self.law.spacing
        felt = gap > 0.0 if power % 2 else gap < 0.0
        pair, offset, gap = pair[felt], offset[felt], gap[felt]
        squared = gap * gap
        pull = gain * (gap if power % 2 else squared * squared) / (gap + self.law.spacing)
        robot, robots = pair // 3, len(self.start_position)
        forces = []
        for axis in range(3):
            weight = pull * offset[:, axis]
            forward = np.bincount(robot[:, 0], weight, robots)
            forces.append(forward - np.bincount(robot[:, 1], weight, robots))
        return np.stack(forces, axis=1)
