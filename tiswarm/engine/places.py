"""Centers as the device holds them: real in f64, whole numbers of a unit in f32.

A real number in f32 is the coarser the farther a robot is from the origin. A whole number is as
fine everywhere, and the difference of two is exact. The unit is a power of two, such that the swarm
may grow to half as large again at least.
"""

from dataclasses import dataclass, replace

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.engine.kernels import OUT_OF_REACH, UNKNOWN

_SMALLEST = 32.0
"""Half of the smallest box around a swarm that units are chosen for [D]; heaps expand in it."""
_LARGEST = 2.0**29
"""Half of a box around the swarm at first, in units; `WALL` is where robots stop."""
_FINEST = 0.01
"""Coarsest resolution of a coordinate [D]."""
_COARSER = 8.0


@dataclass(frozen=True, kw_only=True)
class Places:
    """Numbers of centers on the device."""

    origin: Reals
    """Center with the numbers 0, shape (3,)."""

    unit: float | None
    """Length of 1; None where numbers are lengths from the origin of the world."""

    spacing: float
    """D."""

    @classmethod
    def choose(cls, center: Reals, height: Reals, *, reach: float, spacing: float) -> "Places":
        """Choose the unit for centers, shape (N, 3), and heights that robots are pulled toward."""
        known = height[np.isfinite(height)]
        z = np.concatenate([center[:, 2], known])
        # Robots move to their heights: the box has to hold these, too.
        low, high = ([*edge(center[:, :2], axis=0), edge(z)] for edge in (np.min, np.max))
        half = np.subtract(high, low).max() / 2.0
        half = max(half + reach, 2.0 * reach, _SMALLEST * spacing)
        # A power of two: lengths that are multiples of it convert without rounding.
        unit = 2.0 ** np.ceil(np.log2(half / _LARGEST))
        origin = np.floor(np.add(low, high) / 2.0 / unit) * unit
        return cls(origin=origin, unit=float(unit), spacing=spacing)

    def coarser(self) -> "Places":
        """Return the same with a larger unit, for swarms that grew beyond what numbers hold."""
        return replace(self, unit=_COARSER * self.scale)

    @property
    def scale(self) -> float:
        """The unit, or 1."""
        return 1.0 if self.unit is None else self.unit

    def to_numbers(self, length: Reals, origin: Reals | float) -> Reals:
        """Convert coordinates; heights that are NaN become unknown."""
        number = length if self.unit is None else np.rint((length - origin) / self.unit)
        return np.nan_to_num(number, nan=UNKNOWN)

    def to_lengths(self, number: Reals) -> Reals:
        """Convert centers back."""
        return number if self.unit is None else self.origin + number * self.unit

    def is_resolved(self, coordinate: Reals | float) -> bool:
        """Whether every coordinate is a number, and the device resolves it finely enough."""
        coarsest = max(
            np.abs(coordinate).max(initial=0.0) * np.finfo(np.float64).eps, self.unit or 0.0
        )
        return bool(coarsest <= _FINEST * self.spacing)

    def were_left(self, moves: Reals) -> bool:
        """Whether a robot went farther than numbers reach; its longest step by step, shape (T,)."""
        return self.unit is not None and bool(moves.max() > 0.5 * np.sqrt(OUT_OF_REACH))
