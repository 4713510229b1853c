"""A swarm on the device: its robots, checked; their arrays there; and steps of all.

Centers on the device are real in f64, whole numbers of a unit in f32. A real number in f32 is the
coarser the farther a robot is from the origin. A whole number is as fine everywhere, and the
difference of two is exact. The unit is a power of two, such that the swarm may grow to half as
large again at least.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.robot import Robot
from tiswarm.compute import backend, numerics
from tiswarm.compute.backend import Allocator, Backend
from tiswarm.compute.lang import DeviceArray
from tiswarm.compute.neighbor_kernels import StructureTable
from tiswarm.compute.neighbor_list import MOST_ITEMS, NeighborList
from tiswarm.engine import kernels
from tiswarm.engine.kernels import OUT_OF_REACH, UNKNOWN, Control, Dynamics, Numbers, SwarmState

_NORM_SLACK = 1e-6
"""Largest deviation of a quaternion's norm from 1."""


@dataclass(frozen=True, kw_only=True)
class Swarm:
    """N robots as the caller numbers them; lengths in the unit of D."""

    position: Reals
    """Centers, shape (N, 3)."""

    orientation_wxyz: Reals
    """Body to world, shape (N, 4)."""

    contacts: Ints
    """Connected docks, each pair once: rows of (robot, dock, robot, dock), shape (C, 4)."""

    structure: Ints
    """Number of each robot's structure, from 0 on without a gap, shape (N,)."""

    height: Reals
    """Height that each robot is pulled toward, NaN for none, shape (N,), or (1,) if unused."""

    mobility: Reals | None
    """Step along each axis for a force of 1 [1], shape (N, 3); None if the swarm is not guided."""

    dock_offset_body: Reals
    """Center to dock, body frame, shape (docks, 3)."""

    spacing: float
    """D."""

    @property
    def reach(self) -> float:
        """How far docks are from the center."""
        return float(np.linalg.norm(self.dock_offset_body, axis=1).max())

    @classmethod
    def check(
        cls,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        robot: Robot,
        height: ArrayLike | None,
        mobility: ArrayLike | None,
        structure: ArrayLike | None,
    ) -> "Swarm":
        """Check robots; arguments as for `PreparedSwarm`.

        Raises:
            InputError: an argument makes no sense.
        """
        center = _shaped("position", position, ("N", 3))
        robots = len(center)
        orientation = _shaped("orientation_wxyz", orientation_wxyz, (robots, 4))
        norm = np.linalg.norm(orientation, axis=1)
        if not (np.isfinite(center).all() and (np.abs(norm - 1.0) < _NORM_SLACK).all()):
            problem = "positions must be finite and orientations unit quaternions (w, x, y, z)"
            raise InputError(problem)
        ids: Ints = np.zeros(robots, np.int64)
        if structure is not None:
            named = _shaped("structure", structure, (robots,))
            ids = np.unique(named, return_inverse=True)[1].astype(np.int64)
        return cls(
            position=center,
            orientation_wxyz=orientation,
            contacts=_checked_contacts(contacts, len(robot.dock_offset_body), ids),
            structure=ids,
            height=np.full(1, np.nan) if height is None else _shaped("height", height, (robots,)),
            mobility=None if mobility is None else _shaped("mobility", mobility, (robots, 3)),
            dock_offset_body=np.asarray(robot.dock_offset_body, np.float64),
            spacing=robot.spacing,
        )


def _shaped(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> Reals:
    """Copy an array of this shape; a length that is a letter may be any."""
    expected = str(shape).replace("'", "")
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        problem = f"{name} is no table of numbers; give an array of shape {expected}"
        raise InputError(problem) from error
    if array.size == 0:
        array = array.reshape(0, *(int(length) for length in shape[1:]))
    has_shape = array.ndim == len(shape) and all(
        isinstance(length, str) or array.shape[axis] == length for axis, length in enumerate(shape)
    )
    if not has_shape:
        raise InputError(f"{name} has shape {array.shape}; expected {expected}")
    return array


def _checked_contacts(contacts: ArrayLike, docks: int, structure: Ints) -> Ints:
    """Contacts between docks that exist, of different robots of one structure, each once."""
    table = _shaped("contacts", contacts, ("C", 4))
    odd = table[~(np.abs(table) < MOST_ITEMS) | (table != np.rint(table))]
    if odd.size:
        raise InputError(f"contacts holds {odd[0]:g}; give whole numbers: robot, dock, robot, dock")
    rows = table.astype(np.int64)
    first, second = rows[:, [0, 2]].T
    beyond = (rows < 0) | (rows >= np.array([len(structure), docks, len(structure), docks]))
    wrong = beyond.any(axis=1) | (first == second)
    if not wrong.any():
        wrong = structure[first] != structure[second]
    if wrong.any():
        raise InputError(
            f"contact {tuple(rows[wrong][0].tolist())} is not between docks 0 to {docks - 1} of "
            f"two of the {len(structure)} robots in one structure"
        )
    # One number a pair sorts far faster than rows of four do.
    first_dock = first * docks + rows[:, 1]
    second_dock = second * docks + rows[:, 3]
    most = len(structure) * docks
    pair = np.unique(
        np.minimum(first_dock, second_dock) * most + np.maximum(first_dock, second_dock)
    )
    low, high = np.divmod(pair, most)
    return np.column_stack([low // docks, low % docks, high // docks, high % docks])


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
        targets = height[np.isfinite(height)]
        z = np.concatenate([center[:, 2], targets])
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


_STEPS = 4
"""Most steps of a call on a processor."""
_STEPS_ON_CARD = 16
"""Most steps of a call on a card. Python needs longer for a call than the card for its steps; rows
serve some 13, and the card skips the rest."""
_CALLS = 2
"""Calls on a processor between two questions whether rows are stale."""


@dataclass(frozen=True, kw_only=True)
class RelaxState:
    """Where robots are and how they move, as the caller numbers them."""

    places: Places
    """Numbers that centers have on the device; coarser ones if the swarm outgrew the first."""

    position: Reals
    """Centers, shape (N, 3)."""

    last_step: Reals
    """Last step of each robot if its dynamics ask for it, else zero, shape (N, 3)."""

    taken: int = 0
    """Steps taken."""

    def coarser(self) -> "RelaxState":
        """Return the same robots in places with a larger unit."""
        return replace(self, places=self.places.coarser())


class Stepper:
    """Takes steps of a swarm of one robot or more.

    On the device robots are renumbered, so that neighbors are near in memory.
    """

    memory: Allocator
    """Where arrays are."""

    by_structure: bool
    """Whether one thread takes all steps of a structure; arrays are then on the host."""

    order: Ints
    """The caller's number of each robot, shape (N,)."""

    start: Ints
    """First robot of each structure, and N, shape (S + 1,)."""

    target: Reals
    """Height that each robot is pulled toward, as `Swarm` has it."""

    places: Places
    """Numbers that centers have on the device."""

    robots: SwarmState
    """RelaxState of the robots."""

    kept: tuple[DeviceArray, ...]
    """Centers and last steps as they were before the steps that `go_on` took; none before that."""

    structure: DeviceArray
    """Number of each robot's structure, shape (N,)."""

    neighbors: NeighborList
    """Rows of neighbors."""

    control: DeviceArray
    """Columns of `Control`."""

    moves: DeviceArray
    """Longest step of any robot in each step, kept for calls of as many, shape (T,)."""

    numbers: DeviceArray
    """Numbers in each step, kept for calls of as many, shape (T, columns)."""

    reach: float
    """Docks nearer than this are in rows."""

    stray_limit: float
    """Distance of a robot from where its row was made at which this is stale."""

    dynamics: Dynamics
    """How the robots move."""

    def __init__(
        self, swarm: Swarm, running: Backend, places: Places, dynamics: Dynamics, *, cutoff: float,
        by_structure: bool,
    ) -> None:  # fmt: skip
        """Renumber the robots and reserve their arrays.

        Raises:
            InputError: there are more docks than can be numbered.
            EnvironmentTroubleError: they do not fit into memory.
        """
        robots = len(swarm.position)
        docks = len(swarm.dock_offset_body)
        self.ignores_nan = not (dynamics.has_force or dynamics.has_integrator)
        self.dynamics = dynamics
        skin = dynamics.skin * (swarm.spacing / cutoff) ** 0.5
        self.reach = (1.0 + skin) * cutoff
        # Two robots that approach each other share the skin.
        self.stray_limit = 0.5 * skin * cutoff
        self.by_structure = by_structure
        self.places = places
        order = morton_order(swarm.position, swarm.structure)
        self.order = order
        self.start = np.concatenate([[0], np.bincount(swarm.structure).cumsum()])
        self.target = swarm.height[order] if len(swarm.height) == robots else swarm.height
        per_robot = _bytes_of_robot(running.dtype, docks, guided=bool(dynamics.asks))
        running.require_memory(robots * per_robot, robots)
        contacts = swarm.contacts.copy()
        # The inverse of the order: from the caller's numbers to those on the device.
        contacts[:, [0, 2]] = np.argsort(order)[contacts[:, [0, 2]]]
        memory = Allocator(running, on_host=by_structure)
        self.memory = memory
        self.neighbors = NeighborList(
            memory, swarm.position[order], contacts,
            docks=docks, reach=swarm.reach, cutoff=self.reach,
            start=self.start if by_structure else None, unit=places.unit,
        )  # fmt: skip
        numbers = memory.reals if places.unit is None else memory.ints
        share = np.ones((robots, 3)) if swarm.mobility is None else swarm.mobility[order]
        self.robots = SwarmState(
            position=numbers(robots, 3),
            reference=numbers(robots, 3),
            height=numbers(len(self.target)),
            arm=memory.reals(robots * docks, 3),
            dock=numbers(2 * robots * docks * 4),
            mobility=memory.upload(share if "mobility" in dynamics.asks else np.ones((1, 1))),
            last_step=memory.reals(*((robots, 3) if "last_step" in dynamics.asks else (1, 1))),
            number=memory.ints(robots + 2 if "number" in dynamics.asks else 1),
        )
        self.kept = ()
        self.control = memory.ints(Control.TOTAL)
        self.moves = memory.reals(1)
        self.numbers = memory.reals(1, Numbers.TOTAL + len(dynamics.names))
        seldom = memory.for_few_launches()
        self.structure = seldom.upload(swarm.structure[order])
        turns = seldom.upload(swarm.orientation_wxyz[order])
        kernels.turn_docks(turns, seldom.upload(swarm.dock_offset_body), self.robots.arm)

    def take_steps(self, state: RelaxState, numbers: Reals, seed: int) -> tuple[Reals, int]:
        """Take a step for each row of numbers.

        Args:
            state: Where the robots start.
            numbers: Columns of `Numbers` but ORIGIN, and those of the dynamics, shape (T, columns).
            seed: Seed of noise.

        Returns:
            Longest step of any robot, shape (T,), and how often rows were made.
        """
        places = state.places
        self.places = places
        # Rows are searched in numbers, not in lengths.
        self.neighbors.cutoff = self.reach / places.scale
        numbers[:, Numbers.ORIGIN : Numbers.ORIGIN + 3] = places.origin
        robots = self.robots
        refill = self.memory.refill
        start = state.position[self.order]
        take = self._by_structure if self.by_structure else self._all_at_once
        while True:
            refill(robots.position, places.to_numbers(start, places.origin))
            refill(robots.height, places.to_numbers(self.target, places.origin[2]))
            if "last_step" in self.dynamics.asks:
                refill(robots.last_step, state.last_step[self.order])
            if "number" in self.dynamics.asks:
                refill(robots.number, np.append([seed, state.taken], self.order))
            kernels.place_docks(
                places.scale, self.structure, robots.position, robots.arm, robots.dock
            )
            moves_and_builds = take(numbers)
            if moves_and_builds is not None:
                return moves_and_builds

    def go_on(self, numbers: Reals, taken: int, seed: int) -> tuple[Reals, int]:
        """Take further steps from where robots are on the device, after `taken` steps in all.

        Nothing is copied to or from the host, and rows serve on until they are stale: steps are the
        same to the bit, however they are shared out among calls. Arguments and values are those of
        `take_steps`.
        """
        numbers[:, Numbers.ORIGIN : Numbers.ORIGIN + 3] = self.places.origin
        robots = self.robots
        if "number" in self.dynamics.asks:
            robots.number[0] = seed
            robots.number[1] = taken
        if not self.kept:
            numbered = self.memory.reals if self.places.unit is None else self.memory.ints
            shape = robots.last_step.shape
            self.kept = numbered(*robots.position.shape), self.memory.reals(*shape)
        kernels.keep_state(robots.position, robots.last_step, *self.kept)
        # A call of an odd number of steps left the docks in the other half.
        kernels.place_docks(
            self.places.scale, self.structure, robots.position, robots.arm, robots.dock
        )
        return self._all_at_once(numbers, are_fresh=not self.control[Control.STRAYED])

    def state(self, taken: int, *, before: bool = False) -> RelaxState:
        """Read where the robots are, `taken` steps being taken in all, or `before` `go_on`."""
        position, last_step = self.robots.position, self.robots.last_step
        if before:
            position, last_step = self.kept
        center = self.places.to_lengths(self.memory.download(position))
        step: Reals = np.zeros((len(self.order), 3))
        if "last_step" in self.dynamics.asks:
            step = self._by_caller(self.memory.download(last_step))
        return RelaxState(
            places=self.places, position=self._by_caller(center), last_step=step, taken=taken
        )

    def _by_caller(self, array: Reals) -> Reals:
        """Put robots into the caller's order."""
        ordered = np.empty_like(array)
        ordered[self.order] = array
        return ordered

    def _all_at_once(self, numbers: Reals, *, are_fresh: bool = False) -> tuple[Reals, int]:
        """Step by step, each with all threads; make rows anew where they are stale.

        The first ones are stale unless they `are_fresh`.
        """
        neighbors = self.neighbors
        robots = self.robots
        control = self.control
        steps = len(numbers)
        if self.moves.shape[0] != steps:
            self.moves = self.memory.reals(steps)
            self.numbers = self.memory.reals(*numbers.shape)
        self.memory.refill(self.numbers, numbers)
        # Docks are held twice: a step reads one half and writes the other.
        half = robots.dock.shape[0] // 2
        most, calls = (_STEPS_ON_CARD, 1) if neighbors.on_card else (_STEPS, _CALLS)
        builds_before = neighbors.builds
        taken = 0
        control.fill(0)
        while taken < steps:
            if not (are_fresh and taken == 0):
                neighbors.build(robots.dock, taken % 2 * half)
                kernels.start_interval(robots.position, robots.reference, control)
            while not control[Control.STALE]:
                with numerics.fast_arithmetic(ignores_nan=self.ignores_nan):
                    for t in range(taken, taken + calls * most, most):
                        kernels.step_robots(
                            neighbors.on_card, most, self.dynamics, neighbors.docks,
                            neighbors.own_bits, neighbors.entry_stride,
                            self.stray_limit, self.places.scale, t, self.numbers,
                            *neighbors.rows, *robots, control, self.moves,
                        )  # fmt: skip
                before = taken
                taken = int(control[Control.TAKEN])
                # Fresh rows always allow a step, unless the device did not run the kernel.
                if taken == before:
                    raise backend.faulty_driver()
        moves = self.memory.download(self.moves).astype(np.float64)
        return moves, neighbors.builds - builds_before

    def _by_structure(self, numbers: Reals) -> tuple[Reals, int] | None:
        """All steps of a structure on one thread; None if a row was too short, which is now not."""
        neighbors = self.neighbors
        structures = len(self.start) - 1
        moves = self.memory.reals(structures, len(numbers))
        with numerics.fast_arithmetic(ignores_nan=self.ignores_nan):
            kernels.relax_structures(
                self.dynamics, neighbors.own_bits, neighbors.cutoff, self.stray_limit,
                self.places.scale, self.memory.upload(numbers),
                neighbors.structure, *neighbors.cells, *neighbors.connections, *neighbors.rows,
                *self.robots, moves,
            )  # fmt: skip
        entries = neighbors.fullest()
        if entries > neighbors.capacity:
            neighbors.make_room(entries)
            return None
        builds = int(neighbors.structure[:, StructureTable.BUILDS].max())
        return moves.max(axis=0).astype(np.float64), builds


def _bytes_of_robot(dtype: type[np.floating[Any]], docks: int, *, guided: bool) -> int:
    """Count the memory of a robot in arrays of numbers and of integers [B]."""
    numbers = (5 if guided else 3) * 3 + docks * (3 + 2 * 4)
    integers = docks * (2 + 16 + 16) + 12
    return numbers * np.dtype(dtype).itemsize + 4 * integers


def morton_order(point: Reals, structure: Ints) -> Ints:
    """Order points along a Morton curve, structure by structure.

    Points near each other in space come near each other in memory.

    Args:
        point: Shape (N, 3).
        structure: Number of each point's structure, 0 to S - 1, none empty, shape (N,).

    Returns:
        Points in the order of the curve, shape (N,).
    """
    by_structure = np.argsort(structure, kind="stable")
    first = np.searchsorted(structure[by_structure], np.arange(structure.max() + 1))
    low = np.minimum.reduceat(point[by_structure], first)
    extent = (np.maximum.reduceat(point[by_structure], first) - low).max(axis=1)
    scale = (2**20 - 1) / np.where(extent > 0.0, extent, 1.0)
    place = ((point - low[structure]) * scale[structure][:, None]).astype(np.uint64)
    x, y, z = (_spread(place[:, axis]) << np.uint64(axis) for axis in range(3))
    order: Ints = np.lexsort((x | y | z, structure))
    return order


def _spread(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zeros after each of the 21 low bits."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value
