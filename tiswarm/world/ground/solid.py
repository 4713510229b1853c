"""Ground of bodies, as all rooms but the kernels see it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute import backend
from tiswarm.compute.user_functions import is_of_library, mistake_of_user
from tiswarm.records.terrain import NO_EDGE
from tiswarm.world.ground import kernels
from tiswarm.world.ground.grids import DistanceGrid

DEEPEST = 1e4
"""How far robots are dropped, at most, to be put on the ground [R]."""


class Body(NamedTuple):
    """A body of the ground, or a zone."""

    kind: int
    """Kind, one of those of `kernels`."""

    position: Reals
    """Origin of its frame [R], shape (3,)."""

    turn: Rotation
    """Rotation of its frame into that of the world."""

    size: Reals = np.zeros(3)
    """As in `kernels.BodyNumbers`, shape (3,)."""

    edge: float = 0.0
    """Radius of its edges [R]."""

    top: float = math.inf
    """Height below which all of it is [R]; infinite where unknown."""

    grid: DistanceGrid | None = None
    """Distances, of a body that is a grid."""

    user: Any = None
    """Function of the kernel language from a point in its frame to the distance, of a user."""

    lipschitz: float = 1.0
    """Largest change of its distance over that of the point [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolidGround:
    """The union of bodies."""

    array: Reals
    """Numbers of the bodies; see `kernels.GroundArray`."""

    users: tuple[Any, ...]
    """Functions of users, of the last bodies."""

    lipschitz: float
    """Largest change of the distance over that of the point [1]."""

    top: float
    """Height below which all of the ground is [R]."""

    left_edge: float = NO_EDGE
    """Where the kind of structure has its left edge, from which reaches are measured [R]."""

    right_edge: float = NO_EDGE
    """Where it has its right edge [R]."""

    is_plane: ClassVar[bool] = False
    """Whether it is a plane: never, for a plane alone is a `Terrain`."""

    form: ClassVar[Literal["uneven"]] = "uneven"
    """Form of the ground, for logs: no dock on it has a known height."""

    ground_z: ClassVar[float] = 0.0
    """Height that heights count from [R]."""

    @property
    def has_edge(self) -> bool:
        """Whether the kind of structure has an edge."""
        return self.left_edge < NO_EDGE

    def distance(self, point: Reals) -> Reals:
        """Compute the distance from points, shape (n, 3), to the ground [R], shape (n,)."""
        return self._measure(point)[0]

    def body_at(self, point: Reals) -> Ints:
        """Find the number of the body nearest to each point, shape (n, 3)."""
        return self._measure(point)[1]

    def depth(self, point: Reals, radius: float) -> Reals:
        """Compute how deep spheres around points reach into the ground, negative for a gap [R]."""
        depth: Reals = radius - self.distance(point)
        return depth

    def foot(self, point: Reals) -> Reals:
        """Find the nearest place on the ground's surface to each point near it [R], (n, 3)."""
        foot = np.empty((len(point), 3))
        _call(kernels.find_feet, _table(point), self.array, self.users, foot)
        return foot

    def hides(self, start: Reals, end: Reals) -> Bools:
        """Whether the ground is between two points, for n pairs of shape (n, 3), shape (n,)."""
        hidden: Bools = np.isfinite(self.ways(start, end - start))
        return hidden

    def ways(self, start: Reals, way: Reals, radius: float = 0.0) -> Reals:
        """Find how far spheres go straight before they meet the ground, or infinity [R], (n,)."""
        length = np.empty(len(way))
        _call(
            kernels.cast_rays, _table(start), _table(way), radius, self.lipschitz, self.array,
            self.users, length,
        )  # fmt: skip
        return length

    def levels(self, place: Reals, arm: Reals, radius: float) -> Reals:
        """Find how high centers of robots are that are put on the ground, one by one [R], (n,).

        Args:
            place: Places of their centers as seen from above [R], shape (n, 2).
            arm: Vectors from their centers to their docks [R], shape (n, docks, 3).
            radius: Radius of a dock [R].

        Returns:
            Heights; minus infinity where there is no ground.
        """
        above = min(self.top, DEEPEST) + radius - arm[:, :, 2].min(axis=1) + kernels.SLIDE
        fall = np.empty(len(place))
        _call(
            kernels.drop_robots, np.column_stack([place, above]), _table(arm), 2.0 * DEEPEST,
            radius, self.lipschitz, self.array, self.users, fall,
        )  # fmt: skip
        level: Reals = above - fall
        return level

    def _measure(self, point: Reals) -> tuple[Reals, Ints]:
        distance: Reals = np.empty(len(point))
        body = np.empty(len(point), np.int32)
        _call(kernels.measure, _table(point), self.array, self.users, distance, body)
        return distance, body.astype(np.int64)


class Zones(NamedTuple):
    """Regions that robots may not enter."""

    array: Reals
    """Their numbers; see `kernels.GroundArray`."""

    def depth(self, point: Reals, radius: float) -> Reals:
        """Compute how deep spheres around points reach into a zone, negative for a gap [R]."""
        distance: Reals = np.empty(len(point))
        _call(kernels.measure_zones, _table(point), self.array, distance)
        depth: Reals = radius - distance
        return depth


@backend.exclusive()
def _call(kernel: Any, *arguments: Any) -> None:  # noqa: ANN401 - as the kernel
    """Call a kernel; a mistake in a function of a user becomes a line with its file.

    Raises:
        InputError: a function of a user does not compile.
    """
    backend.processor()
    try:
        kernel(*arguments)
    except Exception as error:
        mistake = mistake_of_user(error) if is_of_library(error) else None
        if mistake is None:
            raise
        raise mistake from error


def _table(rows: Reals) -> Reals:
    return np.ascontiguousarray(rows, np.float64)


def pack(bodies: Sequence[Body], zones: Sequence[Body] = ()) -> Reals:
    """Pack the numbers of bodies, those of users last, and of zones, as kernels read them."""
    grids = [body.grid.value.ravel() for body in bodies if body.grid is not None]
    first = kernels.HEADER + (len(bodies) + len(zones)) * kernels.BodyNumbers.TOTAL
    rows = []
    for body in (*bodies, *zones):
        count: Reals = np.zeros(3)
        size, cell, start = body.size, 0.0, 0.0
        if body.grid is not None:
            count, size = np.array(body.grid.value.shape, np.float64), body.grid.corner
            cell, start = body.grid.cell, float(first)
            first += body.grid.value.size
        rows.append(np.concatenate([
            [body.kind], body.position, body.turn.inv().as_matrix().ravel(), size, [body.edge],
            [start], count, [cell],
        ]))  # fmt: skip
    lipschitz = max((body.lipschitz for body in bodies), default=1.0)
    header = np.array([len(bodies), len(zones), lipschitz])
    return np.concatenate([header, *rows, *grids])


def with_zones(array: Reals, zones: Zones) -> Reals:
    """Insert the numbers of zones behind those of the bodies of a ground."""
    end = kernels.HEADER + int(array[0]) * kernels.BodyNumbers.TOTAL
    added = zones.array[kernels.HEADER :]
    rows = array[kernels.HEADER : end].reshape(-1, kernels.BodyNumbers.TOTAL).copy()
    is_grid = rows[:, kernels.BodyNumbers.FIRST] > 0.0
    rows[is_grid, kernels.BodyNumbers.FIRST] += len(added)
    header = [array[0], zones.array[1], array[kernels.LIPSCHITZ]]
    return np.concatenate([header, rows.ravel(), added, array[end:]])


def solid_ground(bodies: Sequence[Body]) -> SolidGround:
    """Unite bodies to a ground."""
    ordered = sorted(bodies, key=lambda body: body.user is not None)
    return SolidGround(
        array=pack(ordered),
        users=tuple(body.user for body in ordered if body.user is not None),
        lipschitz=max(body.lipschitz for body in bodies),
        top=max(body.top for body in bodies),
    )
