"""The surface of uneven ground around a structure, as pictures and physics engines need it.

The surface is a grid of heights, seen from above: what is below an overhang is not in it. Runs keep
it beside a case, as `ground.npz`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.records.io import DAMAGED, damaged, replacing, run_file
from tiswarm.records.terrain import NO_EDGE

SURFACE_FILE = "ground.npz"
"""File of a case that has it."""

_MOST = 1024
"""Most heights along x or y that are read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundSurface:
    """Heights of the ground around a structure, and where docks touch it."""

    corner: Reals
    """Least x and y [R], shape (2,)."""

    cell: float
    """Distance between neighbors [R]."""

    height: Reals
    """Heights [R], shape (nx, ny); where there is no ground, a little below all that is shown."""

    foot_dock: Ints
    """Docks that stand on the ground, rows of (robot in join order, dock), shape (F, 2)."""

    foot: Reals
    """Where they touch it [R], shape (F, 3)."""

    @property
    def is_plane(self) -> bool:
        """Whether it is a plane: never."""
        return False

    @property
    def end(self) -> Reals:
        """Greatest x and y [R], shape (2,)."""
        end: Reals = self.corner + self.cell * (np.array(self.height.shape) - 1)
        return end

    def moved(self, by: Reals) -> "GroundSurface":
        """Return the same surface, shifted by a vector [R], shape (3,)."""
        return GroundSurface(
            corner=self.corner + by[:2],
            cell=self.cell,
            height=self.height + by[2],
            foot_dock=self.foot_dock,
            foot=self.foot + by,
        )

    def height_at(self, places: Reals) -> Reals:
        """Interpolate heights at places seen from above, shape (n, 2); NaN outside."""
        place = (places - self.corner) / self.cell
        last = np.array(self.height.shape) - 1
        is_inside: Bools = np.all((place >= 0.0) & (place <= last), axis=1)
        low = np.clip(place.astype(np.int64), 0, last - 1)
        i, j = low.T
        u, v = np.clip(place - low, 0.0, 1.0).T
        height = (1.0 - v) * self.height[i, j] + v * self.height[i, j + 1]
        beside = (1.0 - v) * self.height[i + 1, j] + v * self.height[i + 1, j + 1]
        between: Reals = np.where(is_inside, (1.0 - u) * height + u * beside, np.nan)
        return between

    def thinned(self, most: int) -> "GroundSurface":
        """Return the surface with at most so many heights along x and y."""
        count = max(self.height.shape)
        if count <= most:
            return self
        cell = self.cell * (count - 1) / (most - 1)
        columns = [
            np.minimum(low + cell * np.arange(int(np.ceil((end - low) / cell)) + 1), end)
            for low, end in zip(self.corner, self.end, strict=True)
        ]
        x, y = np.meshgrid(*columns, indexing="ij")
        height = self.height_at(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
        return GroundSurface(
            corner=self.corner, cell=cell, height=height, foot_dock=self.foot_dock, foot=self.foot
        )

    def faces(self) -> Reals:
        """Cover the surface with faces of four corners, counterclockwise from above, (n, 4, 3)."""
        x, y = np.meshgrid(*(
            low + self.cell * np.arange(count)
            for low, count in zip(self.corner, self.height.shape, strict=True)
        ), indexing="ij")  # fmt: skip
        corner = np.stack([x, y, self.height], axis=-1)
        around = [corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]]
        return np.stack(around, axis=2).reshape(-1, 4, 3)


def write_surface(path: Path, surface: GroundSurface) -> None:
    """Write a surface as `.npz`.

    Raises:
        EnvironmentTroubleError: it cannot be written.
    """
    with replacing(path) as file:
        np.savez_compressed(
            file,
            corner=surface.corner,
            cell=np.array(surface.cell),
            height=surface.height,
            foot_dock=surface.foot_dock,
            foot=surface.foot,
        )


def read_surface(path: Path) -> GroundSurface:
    """Read a surface that was written beside a case.

    Raises:
        InputError: it is damaged.
    """
    try:
        with run_file(path).open("rb") as file, np.load(file, allow_pickle=False) as entries:
            surface = GroundSurface(
                corner=np.asarray(entries["corner"], np.float64).reshape(2),
                cell=float(entries["cell"]),
                height=np.asarray(entries["height"], np.float64),
                foot_dock=np.asarray(entries["foot_dock"], np.int64).reshape(-1, 2),
                foot=np.asarray(entries["foot"], np.float64).reshape(-1, 3),
            )
    except DAMAGED as error:
        raise damaged(path, "it is damaged") from error
    numbers = np.concatenate([surface.corner, [surface.cell], surface.height.ravel()])
    is_whole = (
        surface.height.ndim == 2  # noqa: PLR2004
        and min(surface.height.shape) > 1
        and max(surface.height.shape) <= _MOST
        and (np.abs(numbers) < NO_EDGE).all()
        and surface.cell > 0.0
        and len(surface.foot) == len(surface.foot_dock)
        and (surface.foot_dock >= 0).all()
        and np.isfinite(surface.foot).all()
    )
    if not is_whole:
        raise damaged(path, "it is damaged")
    return surface
