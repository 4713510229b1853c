"""Make hills.csv: heights of rolling hills, for ground of kind heightfield.

    python scenarios/terrain/make_hills.py hills.csv

Hills are waves of random directions and phases; shorter ones are lower. The middle is level.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SEED = 11
SIDE = 241
"""Heights along x and along y."""
SPACING = 2.0
"""Distance between neighbors, the `cell` of the body [R]."""
LENGTHS = (160.0, 90.0, 50.0, 28.0)
"""Lengths of the waves [R]."""
STEEPNESS = 0.12
"""Slope of each wave where it is greatest [1]."""
LEVEL = 15.0
"""Distance from the middle below which hills fade out [R]."""


def hills() -> NDArray[np.float64]:
    """Return heights [R], shape (SIDE, SIDE)."""
    rng = np.random.default_rng(SEED)
    along = SPACING * (np.arange(SIDE) - 0.5 * (SIDE - 1))
    x, y = np.meshgrid(along, along)
    height = np.zeros((SIDE, SIDE))
    for length in LENGTHS:
        for _ in range(3):
            angle, phase = 2.0 * np.pi * rng.uniform(size=2)
            wave = 2.0 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + phase
            height += STEEPNESS * length / (2.0 * np.pi) * np.sin(wave)
    height -= height[SIDE // 2, SIDE // 2]
    height *= np.clip(np.hypot(x, y) / LEVEL, 0.0, 1.0)
    return height


if __name__ == "__main__":
    np.savetxt(Path(sys.argv[1]), hills(), fmt="%.4f", delimiter=",")
