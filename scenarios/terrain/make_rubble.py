"""Make rubble.stl: a heap of stones, for the scenario terrain.

    python scenarios/terrain/make_rubble.py

Each stone is a random polyhedron, flattened and turned. Stones overlap.
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

SEED = 7
STONES = 60
FARTHEST = 30.0
"""Greatest distance of a stone from the axis [R]."""
SIZES = (2.0, 5.5)
"""Least and greatest radius of a stone [R]."""
CORNERS = 16


def main() -> None:
    """Write the file beside this one."""
    rng = np.random.default_rng(SEED)
    stones = []
    for _ in range(STONES):
        corner = rng.normal(size=(CORNERS, 3))
        corner *= rng.uniform(*SIZES) / np.linalg.norm(corner, axis=1, keepdims=True)
        corner *= rng.uniform(0.6, 1.0, 3)
        corner -= corner.mean(axis=0)  # inside, so that faces have an outer side
        corner = Rotation.from_quat(rng.normal(size=4)).apply(corner)
        angle, share = rng.uniform(0.0, 2.0 * np.pi), rng.uniform()
        distance = FARTHEST * np.sqrt(share)
        place = [distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-1.0, 1.0)]
        face = ConvexHull(corner).simplices
        a, b, c = corner[face].transpose(1, 0, 2)
        is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
        face[is_inward] = face[is_inward][:, ::-1]
        stones.append(trimesh.Trimesh(corner + place, face))
    rubble: Any = trimesh.util.concatenate(stones)
    rubble.export(Path(__file__).with_name("rubble.stl"))


if __name__ == "__main__":
    main()
