"""Bodies that ground is made of, as sections of a scenario: solids, heights, meshes.

The ground is the union of its bodies. Each has a frame of its own: `position` is its origin, which
is turned about x, y and z by `roll_deg`, `pitch_deg` and `yaw_deg`, in that order. Lengths in R.
"""

import csv
import math
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic.dataclasses import dataclass
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.params import STRICT
from tiswarm.base.sections import mistake_at
from tiswarm.compute.math import uniform
from tiswarm.records.terrain import Terrain
from tiswarm.world.ground import grids, kernels
from tiswarm.world.ground.grids import DistanceGrid
from tiswarm.world.ground.solid import Body, SolidGround, Zones, pack, solid_ground

_SHIPPED = Path(__file__).parents[2] / "scenario" / "files"
"""Folder of the scenarios of the package, whose files of ground are there, too."""

_MOST_BYTES = 256 * 2**20
_MOST_HEIGHTS = 4096
"""Most heights of a field along x or y."""

_Length = Annotated[float, Field(gt=0.0, le=1e4)]
_Coordinate = Annotated[float, Field(ge=-1e4, le=1e4)]
_Angle = Annotated[float, Field(ge=-360.0, le=360.0)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BodyParams:
    """What all bodies have in common: their place."""

    position: Annotated[
        tuple[_Coordinate, _Coordinate, _Coordinate],
        Field(description="Origin of the body's frame: x, y, z [R]."),
    ] = (0.0, 0.0, 0.0)

    roll_deg: Annotated[_Angle, Field(description="Turn about x [deg].")] = 0.0

    pitch_deg: Annotated[
        _Angle, Field(description="Turn about y, after that about x [deg]; x sinks if positive.")
    ] = 0.0

    yaw_deg: Annotated[_Angle, Field(description="Turn about z, after both [deg].")] = 0.0

    @property
    def turn(self) -> Rotation:
        """Rotation of its frame into that of the world."""
        return Rotation.from_euler(
            "xyz", [self.roll_deg, self.pitch_deg, self.yaw_deg], degrees=True
        )

    @property
    def is_here(self) -> bool:
        """Whether all that it is made of can be found."""
        return True

    def fault(self, start: Reals) -> str:  # noqa: ARG002 - of functions of users
        """Find what is wrong with its distance near where robots start, (n, 2); empty if nothing.

        Bodies of the package have none.
        """
        return ""

    def body(self) -> Body:
        """Return its numbers."""
        raise NotImplementedError

    def _placed(self, kind: int, reach: Reals | None = None, **more: Any) -> Body:  # noqa: ANN401 - fields of Body
        """Return a body at its place; `reach` are the half sizes of a box around it [R], (3,)."""
        top = math.inf
        if reach is not None:
            top = self.position[2] + float(np.abs(self.turn.as_matrix()[2]) @ reach)
        return Body(kind, np.array(self.position), self.turn, top=top, **more)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlaneParams(BodyParams):
    """All that is below a plane through `position`; turned, it is a slope."""

    kind: Literal["plane"] = "plane"
    """Kind of body."""

    def body(self) -> Body:
        """Return its numbers."""
        body = self._placed(kernels.PLANE)
        is_level = self.roll_deg == self.pitch_deg == 0.0
        return body._replace(top=self.position[2]) if is_level else body


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SlabParams(BodyParams):
    """A slab with a round edge: its top is at z = 0, and the edge begins at x = 0.

    It has no end to the left and along y.
    """

    kind: Literal["slab"] = "slab"
    """Kind of body."""

    edge_radius: _Length = 1.0
    """Radius of its edge, and half of its thickness [R]."""

    def body(self) -> Body:
        """Return its numbers."""
        body = self._placed(kernels.SLAB, edge=self.edge_radius)
        is_level = self.roll_deg == self.pitch_deg == 0.0
        return body._replace(top=self.position[2]) if is_level else body


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BoxParams(BodyParams):
    """A box about its `position`."""

    kind: Literal["box"] = "box"
    """Kind of body."""

    size: tuple[_Length, _Length, _Length]
    """Lengths along x, y and z [R]."""

    edge_radius: Annotated[float, Field(ge=0.0)] = 0.0
    """Radius of its edges, at most half of its least length [R]."""

    @field_validator("edge_radius")
    @classmethod
    def _fit(cls, radius: float, info: ValidationInfo) -> float:
        size = info.data.get("size", (math.inf,))
        if radius > 0.5 * min(size):
            raise ValueError(f"{radius:g} is more than half of {min(size):g}; give less")
        return radius

    def body(self) -> Body:
        """Return its numbers."""
        half = 0.5 * np.array(self.size)
        return self._placed(kernels.BOX, half, size=half, edge=self.edge_radius)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CylinderParams(BodyParams):
    """A cylinder about its `position`, along z."""

    kind: Literal["cylinder"] = "cylinder"
    """Kind of body."""

    radius: _Length
    """Radius [R]."""

    height: _Length
    """Length along z [R]."""

    edge_radius: Annotated[float, Field(ge=0.0)] = 0.0
    """Radius of its edges, at most its radius and half of its height [R]."""

    @field_validator("edge_radius")
    @classmethod
    def _fit(cls, radius: float, info: ValidationInfo) -> float:
        most = min(info.data.get("radius", math.inf), 0.5 * info.data.get("height", math.inf))
        if radius > most:
            raise ValueError(f"{radius:g} is more than the cylinder allows; give at most {most:g}")
        return radius

    def body(self) -> Body:
        """Return its numbers."""
        half = np.array([self.radius, self.radius, 0.5 * self.height])
        size = np.array([self.radius, 0.5 * self.height, 0.0])
        return self._placed(kernels.CYLINDER, half, size=size, edge=self.edge_radius)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SphereParams(BodyParams):
    """A sphere about its `position`."""

    kind: Literal["sphere"] = "sphere"
    """Kind of body."""

    radius: _Length
    """Radius [R]."""

    def body(self) -> Body:
        """Return its numbers."""
        size = np.array([self.radius, 0.0, 0.0])
        body = self._placed(kernels.SPHERE, size=size)
        return body._replace(top=self.position[2] + self.radius)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FileParams(BodyParams):
    """What bodies from a file have in common."""

    file: Annotated[
        str,
        Field(
            min_length=1,
            description="Path of the file, from the working folder or that of the scenarios of the "
            "package.",
        ),
    ]

    digest: Annotated[
        str,
        Field(
            validate_default=True,
            description="First twelve hex digits of the SHA-256 of the file; filled in, so that "
            "results state it. A file with another one is refused.",
        ),
    ] = ""

    resolution: Annotated[
        float,
        Field(
            gt=0.0,
            le=100.0,
            description="Distance between the points at which the distance to the surface is "
            "stored [R]. Sharper edges are rounded off.",
        ),
    ] = 0.5

    @field_validator("digest")
    @classmethod
    def _know_file(cls, digest: str, info: ValidationInfo) -> str:
        if "file" not in info.data:
            return digest
        path = _path(info.data["file"])
        if digest and not path.is_file():  # of a run that is shown elsewhere
            return digest
        try:
            content = _digest(_read(path))
        except ValueError:
            return digest  # `_read_file` says so, at the key of the file
        if digest not in {"", content}:
            raise ValueError(f"{path} has changed: it is {content} now; leave out digest")
        return content

    @model_validator(mode="after")
    def _read_file(self) -> "FileParams":
        if self.is_here or not self.digest:
            try:
                self.grid()
            except ValidationError:
                raise
            except ValueError as error:
                raise mistake_at(("file",), str(error)) from error
        return self

    @property
    def is_here(self) -> bool:
        """Whether the file can be found."""
        return _path(self.file).is_file()

    def grid(self) -> DistanceGrid:
        """Return the distances to its surface, in its frame."""
        return _grid_of(self)

    def build_grid(self) -> DistanceGrid:
        """Compute the distances to its surface, in its frame.

        Raises:
            ValueError: the file has no surface, or the grid would be too large.
        """
        raise NotImplementedError

    def _require_room(self, low: Reals, high: Reals) -> None:
        """Raise an error if the grid around a box is too large."""
        needed = grids.values_needed(low, high, self.resolution)
        if needed > grids.MOST_VALUES:
            problem = f"{self.file} would need {needed:,} distances, {grids.MOST_VALUES:,} at most"
            raise mistake_at(("resolution",), f"{problem}; give more R")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HeightsParams(FileParams):
    """A field of heights about `position`, bilinear between them.

    Beyond its border it goes on as it is there. The first row of the file has the greatest y.
    """

    kind: Literal["heightfield"] = "heightfield"
    """Kind of body."""

    cell: _Length
    """Distance between neighbors [R]."""

    heights: Annotated[
        tuple[_Coordinate, _Coordinate] | None,
        Field(
            validate_default=True,
            description="Heights of black and white of a PNG, or of the least and greatest number "
            "of a CSV file [R]. Null for a CSV file whose numbers are heights [R].",
        ),
    ] = None

    @field_validator("heights")
    @classmethod
    def _read_heights(
        cls, heights: tuple[float, float] | None, info: ValidationInfo
    ) -> tuple[float, float] | None:
        file = info.data.get("file", "")
        if file.lower().endswith(".png") and heights is None:
            raise ValueError("a PNG has no heights; give those of black and white, [low, high]")
        return heights

    def height(self) -> Reals:
        """Read the heights [R], shape (nx, ny).

        Raises:
            ValueError: the file has none.
        """
        path = _path(self.file)
        share = _read_png(path) if path.suffix.lower() == ".png" else _read_csv(path)
        if min(share.shape) < 2 or max(share.shape) > _MOST_HEIGHTS:  # noqa: PLR2004
            size = f"{share.shape[1]} x {share.shape[0]}"
            raise ValueError(f"{path}: {size} heights; give 2 to {_MOST_HEIGHTS} along x and y")
        if self.heights is not None:
            low, high = self.heights
            if path.suffix.lower() != ".png":
                share = (share - share.min()) / max(float(np.ptp(share)), 1e-300)
            share = low + (high - low) * share
        return np.ascontiguousarray(share[::-1].T)

    def build_grid(self) -> DistanceGrid:
        """Compute the distances to its surface, in its frame."""
        height = self.height()
        extent = self.cell * (np.array(height.shape) - 1)
        self._require_room(np.array([0, 0, height.min()]), np.array([*extent, height.max()]))
        grid = grids.grid_of_heights(height, self.cell, self.resolution)
        return grid._replace(corner=grid.corner - [*(0.5 * extent), 0.0])

    def body(self) -> Body:
        """Return its numbers."""
        grid = self.grid()
        top = float(np.max(self.height()))
        body = self._placed(kernels.HEIGHT_GRID, grid=grid, lipschitz=grids.LIPSCHITZ)
        is_level = self.roll_deg == self.pitch_deg == 0.0
        return body._replace(top=self.position[2] + top + self.resolution) if is_level else body


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MeshParams(FileParams):
    """A closed mesh of triangles, as STL, OBJ or PLY; its origin is at `position`."""

    kind: Literal["mesh"] = "mesh"
    """Kind of body."""

    scale: Annotated[float, Field(gt=0.0)] = 1.0
    """Length of the unit of the file [R]."""

    def triangles(self) -> tuple[Reals, Ints]:
        """Read its corners [R], shape (V, 3), and triangles, shape (M, 3).

        Raises:
            ValueError: the file has none.
        """
        return _read_mesh(_path(self.file), self.scale)

    def build_grid(self) -> DistanceGrid:
        """Compute the distances to its surface, in its frame."""
        vertex, face = self.triangles()
        self._require_room(vertex.min(axis=0), vertex.max(axis=0))
        return grids.grid_of_mesh(vertex, face, self.resolution)

    def body(self) -> Body:
        """Return its numbers."""
        grid = self.grid()
        end = grid.corner + grid.cell * (np.array(grid.value.shape) - 1)
        reach = np.maximum(np.abs(grid.corner), np.abs(end))
        return self._placed(kernels.CLOSED_GRID, reach, grid=grid, lipschitz=grids.LIPSCHITZ)


class UserParams(BodyParams):
    """Base of bodies that plug-ins register; see `tiswarm.terrain`."""

    lipschitz: ClassVar[float] = 1.0

    def function(self) -> Any:  # noqa: ANN401 - of the kernel language
        """Return the function of a point in the body's frame."""
        raise NotImplementedError

    def fault(self, start: Reals) -> str:
        """Find what is wrong with its distance near where robots start, (n, 2); empty if nothing.

        Points and ways between them are drawn, always the same ones.
        """
        kind = getattr(self, "kind", "")
        draw = uniform(0, "terrain", np.arange(_PAIRS)[:, None], np.arange(6))
        point = _FARTHEST * (2.0 * draw[:, :3] - 1.0)
        point[:, :2] += start[np.arange(_PAIRS) % len(start)]
        z = 2.0 * draw[:, 3] - 1.0
        around = 2.0 * np.pi * draw[:, 4]
        flat = np.sqrt(1.0 - z**2)
        length = _WAYS[0] * (_WAYS[1] / _WAYS[0]) ** draw[:, 5]
        way = length[:, None] * np.column_stack([flat * np.cos(around), flat * np.sin(around), z])
        ground = solid_ground([self.body()])
        distance = ground.distance(point)
        distance_ahead = ground.distance(point + way)
        # No number is less than the distance to no ground, which is returned in its place.
        is_wrong = ~(np.maximum(np.abs(distance), np.abs(distance_ahead)) < kernels.FAR)
        change = np.abs(distance_ahead - distance) / length
        if is_wrong.any():
            return f"{kind} is no number at {_shown(point[is_wrong][0])}; return one for all points"
        steepest = int(np.argmax(change))
        if change[steepest] > self.lipschitz * (1.0 + _ROUNDING):
            where = f"{change[steepest]:.3g} R a R at {_shown(point[steepest])}"
            limit = f"lipschitz={self.lipschitz:g}"
            return f"{kind} changes by {where}, more than its {limit}; divide it, or state another"
        if (distance < 0.0).all():
            return (
                f"{kind} is negative at all points near {_shown(point.mean(axis=0))}; return the "
                "distance, positive outside of the ground"
            )
        return ""

    def body(self) -> Body:
        """Return its numbers."""
        return self._placed(kernels.USER, user=self.function(), lipschitz=self.lipschitz)


_PAIRS = 4096
"""Pairs of points at which functions of users are compared."""

_FARTHEST = 20.0
"""How far these points are from where robots start, at most, along x, y and z [R]."""

_WAYS = (0.01, 3.0)
"""Least and greatest distance of the two points of a pair [R]."""

_ROUNDING = 1e-6
"""Share by which a distance may change more than it should: rounding may be behind it."""


def _shown(point: Reals) -> str:
    """Write a point for a message."""
    return "[" + ", ".join(f"{number:.3g}" for number in point) + "]"


@lru_cache(maxsize=8)
def ground_of(terrain: tuple[BodyParams, ...]) -> Terrain | SolidGround:
    """Unite bodies to a ground; a level plane alone has a closed form.

    Raises:
        ValueError: a file cannot be read, or has no surface.
        InputError: a function of a user cannot be compiled.
    """
    first = terrain[0]
    is_alone = len(terrain) == 1 and isinstance(first, PlaneParams)
    if is_alone and first.roll_deg == first.pitch_deg == 0.0:
        return Terrain(ground_z=first.position[2])
    return solid_ground([params.body() for params in terrain])


@lru_cache(maxsize=8)
def zones_of(no_entry: tuple[BodyParams, ...]) -> Zones:
    """Return the regions that robots may not enter."""
    return Zones(pack([], [params.body() for params in no_entry]))


@lru_cache(maxsize=8)
def _grid_of(params: "FileParams") -> DistanceGrid:
    return params.build_grid()


def _path(file: str) -> Path:
    path, shipped = Path(file), _SHIPPED / file
    return shipped if not path.is_file() and shipped.is_file() else path


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError(f"{path} is larger than {_MOST_BYTES // 2**20} MiB; make it coarser")
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}; correct the path") from error


def _digest(content: bytes) -> str:
    return sha256(content).hexdigest()[:12]


def _read_csv(path: Path) -> Reals:
    """Read rows of numbers."""
    rows: list[list[float]] = []
    text = _read(path).decode(errors="replace")
    for number, row in enumerate(csv.reader(text.splitlines()), start=1):
        if not any(cell.strip() for cell in row):
            continue
        try:
            heights = [float(cell) for cell in row]
        except ValueError as error:
            problem = str(error).rpartition(": ")[2]
            raise ValueError(f"{path}:{number}: {problem} is no number; correct it") from error
        if not np.isfinite(heights).all() or max(map(abs, heights)) > 1e4:  # noqa: PLR2004
            raise ValueError(f"{path}:{number}: heights are numbers within 1e4 R; correct them")
        if rows and len(heights) != len(rows[0]):
            raise ValueError(
                f"{path}:{number}: {len(heights)} heights, {len(rows[0])} in the first row; "
                "give as many in each"
            )
        rows.append(heights)
    if not rows:
        raise ValueError(f"{path} has no heights; give rows of numbers")
    return np.array(rows)


def _read_png(path: Path) -> Reals:
    """Read the brightness of a picture, 0 for black to 1 for white."""
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 - slow to import

    _read(path)
    try:
        with Image.open(path) as picture:
            is_deep = picture.mode.startswith("I")
            gray = np.asarray(picture if is_deep else picture.convert("L"), np.float64)
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise ValueError(f"{path} is no picture that can be read; save it as PNG") from error
    brightness: Reals = gray / (65535.0 if is_deep else 255.0)
    return brightness


def _read_mesh(path: Path, scale: float) -> tuple[Reals, Ints]:
    """Read a closed mesh of triangles."""
    import trimesh  # noqa: PLC0415 - slow to import

    _read(path)
    try:
        loaded: Any = trimesh.load(path, force="mesh", process=True)
        vertex, face = np.array(loaded.vertices, np.float64) * scale, np.array(loaded.faces)
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path} is no mesh that can be read: {reason}; save as STL") from error
    if not len(face) or not np.isfinite(vertex).all():
        raise ValueError(f"{path} has no triangles; save a mesh")
    if not loaded.is_watertight:
        raise ValueError(f"{path} is not closed: it has holes; close them")
    if not loaded.is_winding_consistent:
        raise ValueError(f"{path}: faces have their corners in both senses; orient them outward")
    return vertex, face
