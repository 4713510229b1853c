"""A swarm on the device: its robots, checked; their arrays there; and steps of all.

Robots stay on the device between calls. A `RelaxState` has them as they were after some steps, and
copies them to the host once somebody asks.

Centers on the device are real in f64, whole numbers of a unit in f32. A real number in f32 is the
coarser the farther a robot is from the origin. A whole number is as fine everywhere, and the
difference of two is exact. The unit is a power of two, such that the swarm may grow to half as
large again at least.
"""

import weakref
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiswarm.base.aliases import AnyInts, AnyReals, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.robot import Robot
from tiswarm.compute import backend, numerics
from tiswarm.compute.backend import Allocator, Backend
from tiswarm.compute.dlpack import ExportedArray
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
        """Convert coordinates."""
        return length if self.unit is None else np.rint((length - origin) / self.unit)

    def to_lengths(self, number: AnyReals | AnyInts) -> Reals:
        """Convert centers back."""
        length = number if self.unit is None else self.origin + number * self.unit
        return np.asarray(length, np.float64)

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
_PARTS = 2_048
"""Most parts of a swarm, the bounds of each found by one thread of a card."""


class Exported(Protocol):
    """An array that other libraries take by DLPack."""

    def __dlpack__(self) -> object:
        """Return a capsule."""

    def __dlpack_device__(self) -> tuple[int, int]:
        """Return type and number of the device."""


class RelaxState:
    """Where robots are and how they move after some steps, copied from the device when read.

    Later steps do not change it.
    """

    places: Places
    """Numbers that centers have on the device; coarser ones if the swarm outgrew the first."""

    taken: int
    """Steps taken."""

    arrays: "StateArrays | None"
    """Centers and last steps on the device; None if they are on the host alone."""

    bound: float
    """No coordinate of a center is larger than this."""

    def __init__(
        self,
        places: Places,
        taken: int,
        *,
        arrays: "StateArrays | None" = None,
        position: Reals | None = None,
        last_step: Reals | None = None,
        bound: float | None = None,
    ) -> None:
        """Take robots that are on the device, the host or both; the caller numbers these."""
        self.places = places
        self.taken = taken
        self.arrays = arrays
        self._position = position
        self._last_step = last_step
        self.bound = self.farthest if bound is None else bound
        if arrays is not None and not arrays.stepper.by_structure:
            backend.rescue(self)

    @property
    def position(self) -> Reals:
        """Centers, as the caller numbers robots, shape (N, 3)."""
        if self._position is None:
            arrays = self._on_device()
            self._position = self.places.to_lengths(arrays.stepper.by_caller(arrays.position))
        return self._position

    @property
    def last_step(self) -> Reals:
        """Last step of each robot if its dynamics ask for it, else zero, shape (N, 3)."""
        if self._last_step is None:
            arrays = self.arrays
            if arrays is None or not arrays.stepper.has_last_step:
                self._last_step = np.zeros(self.position.shape)
            else:
                steps = arrays.stepper.by_caller(arrays.last_step)
                self._last_step = np.asarray(steps, np.float64)
        return self._last_step

    @property
    def farthest(self) -> float:
        """Largest coordinate of a center."""
        if self._position is not None:
            return float(np.abs(self._position).max(initial=0.0))
        arrays = self._on_device()
        bounds = arrays.stepper.bounds(arrays.position)
        return float(np.abs(self.places.to_lengths(bounds)).max())

    def _on_device(self) -> "StateArrays":
        if self.arrays is None:
            raise RuntimeError("robots are neither on the host nor on a device")
        return self.arrays

    def export(self) -> Exported:
        """Copy centers into an array, shape (N, 3), that other libraries take where it is.

        Raises:
            InputError: the device has no memory that they could read.
        """
        arrays = self.arrays
        if arrays is None or not arrays.stepper.memory.running.on_card:
            return self.position.copy()
        return arrays.stepper.export(arrays.position, self.places)

    def read(self) -> None:
        """Copy the robots to the host, and leave the device."""
        if self.arrays is not None:
            _ = self.position, self.last_step
        self.arrays = None

    def numbered(self, taken: int) -> "RelaxState":
        """Return the same robots as if another number of steps had been taken."""
        return RelaxState(
            self.places, taken, arrays=self.arrays, position=self._position,
            last_step=self._last_step, bound=self.bound,
        )  # fmt: skip

    def coarser(self) -> "RelaxState":
        """Return the same robots in places with a larger unit."""
        return RelaxState(
            self.places.coarser(), self.taken, position=self.position, last_step=self.last_step
        )

    def __getstate__(self) -> dict[str, Any]:
        """Copy the robots to another process or object without their device."""
        _ = self.position, self.last_step
        return {**vars(self), "arrays": None}


class StateArrays:
    """Centers and last steps on the device of one state, or of several that differ in numbers."""

    stepper: "Stepper"
    """What numbers robots there."""

    position: DeviceArray
    """Centers, as `SwarmState` describes them."""

    last_step: DeviceArray
    """Last steps, as `SwarmState` describes them."""

    def __init__(self, stepper: "Stepper") -> None:
        """Take arrays that no other state needs; a state that ends leaves them to the next one."""
        self.stepper = stepper
        self.position, self.last_step = pair = stepper.unused_pair()
        # Reserving arrays takes a millisecond.
        weakref.finalize(self, stepper.unused.append, pair).atexit = False


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

    order_there: DeviceArray
    """The order on the device, shape (N,)."""

    start: Ints
    """First robot of each structure, and N, shape (S + 1,)."""

    target: Reals
    """Height that each robot is pulled toward, as `Swarm` has it."""

    places: Places | None
    """Numbers that heights and docks have on the device; None before the first step."""

    robots: SwarmState
    """State of the robots; centers and last steps are those of `current`."""

    current: StateArrays | None
    """Where the last call ended; None before the first one, or if that failed."""

    unused: list[tuple[DeviceArray, DeviceArray]]
    """Centers and last steps of states that ended."""

    structure: DeviceArray
    """Number of each robot's structure, shape (N,)."""

    neighbors: NeighborList
    """Rows of neighbors."""

    control: DeviceArray
    """Columns of `Control`."""

    moves: DeviceArray
    """As `step_robots` writes them, kept for calls of as many steps, shape (T,)."""

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
        self.dynamics = dynamics
        self.ignores_nan = not (dynamics.has_force or dynamics.has_integrator)
        skin = dynamics.skin * (swarm.spacing / cutoff) ** 0.5
        self.reach = (1.0 + skin) * cutoff
        # Two robots that approach each other share the skin.
        self.stray_limit = 0.5 * skin * cutoff
        self.by_structure = by_structure
        self.has_unit = places.unit is not None
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
        self.robots = self._reserve(robots, docks, None if swarm.mobility is None
                                    else swarm.mobility[order])  # fmt: skip
        self.order_there = memory.upload(order)
        self.places = None
        self.current = None
        self.unused = []
        self.control = memory.ints(Control.TOTAL)
        self.moves = self._moves(1)
        self.numbers = memory.reals(1, Numbers.TOTAL + len(dynamics.names))
        seldom = memory.for_few_launches()
        self.structure = seldom.upload(swarm.structure[order])
        turns = seldom.upload(swarm.orientation_wxyz[order])
        kernels.turn_docks(turns, seldom.upload(swarm.dock_offset_body), self.robots.arm)

    def _reserve(self, robots: int, docks: int, mobility: Reals | None) -> SwarmState:
        """Reserve the arrays of robots but centers and last steps, which states have."""
        memory = self.memory
        share = np.ones((robots, 3)) if mobility is None else mobility
        asks = self.dynamics.asks
        numbers = np.append([0, 0], self.order if "number" in asks else [])
        running = memory.running
        by_processor = Allocator(running, on_host=not running.on_card)
        dock = self._places(2 * robots * docks * 4, memory=by_processor)
        return SwarmState(
            position=None,
            reference=self._places(robots, 3),
            height=self._places(len(self.target)),
            arm=memory.reals(robots * docks, 3),
            dock=dock,
            dock_y=dock if running.on_card else dock[1:],
            dock_z=dock if running.on_card else dock[2:],
            mobility=memory.upload(share if "mobility" in asks else np.ones((1, 1))),
            last_step=None,
            number=memory.upload(numbers.astype(np.int64)),
        )

    def _moves(self, steps: int) -> DeviceArray:
        """Reserve the longest step of any robot in each step; on cards the bits of its square."""
        return self.memory.ints(steps) if self.neighbors.on_card else self.memory.reals(steps)

    def _places(self, *shape: int, memory: Allocator | None = None) -> DeviceArray:
        """Reserve an array of numbers of `places`, in memory of robots if not in another."""
        memory = memory or self.memory
        return memory.ints(*shape) if self.has_unit else memory.reals(*shape)

    @property
    def has_last_step(self) -> bool:
        """Whether robots have a last step."""
        return "last_step" in self.dynamics.asks

    def unused_pair(self) -> tuple[DeviceArray, DeviceArray]:
        """Return arrays of centers and last steps that no state needs."""
        if self.unused:
            return self.unused.pop()
        robots = len(self.order)
        last_step = self.memory.reals(*((robots, 3) if self.has_last_step else (1, 1)))
        return self._places(robots, 3), last_step

    def take_steps(
        self, state: RelaxState, numbers: Reals, seed: int, *, goes_on: bool
    ) -> tuple[StateArrays, Reals, int]:
        """Take a step for each row of numbers.

        Nothing of the size of the swarm is copied to or from the host, unless the state is there
        alone.

        Args:
            state: Where the robots start.
            numbers: Columns of `Numbers` but ORIGIN, and those of the dynamics, shape (T, columns).
            seed: Seed of noise.
            goes_on: Whether rows of the call before serve until they are stale. Steps are then the
                same to the bit, however they are shared out among calls.

        Returns:
            Where the robots end, the longest step of any robot, shape (T,), and how often rows were
            made.
        """
        start = self._arrays_of(state)
        serves = goes_on and start is self.current
        serves = serves and self.control[Control.STALE_FROM] == kernels.NEVER
        self.current = None
        self._measure_in(state.places)
        numbers[:, Numbers.ORIGIN : Numbers.ORIGIN + 3] = state.places.origin
        if "number" in self.dynamics.asks:
            self.robots.number[0] = seed
            self.robots.number[1] = state.taken
        end = StateArrays(self)
        self.robots = self.robots._replace(position=end.position, last_step=end.last_step)
        while True:
            self._start_from(start)
            if not self.by_structure:
                moves, builds = self._all_at_once(numbers, serves=serves)
                break
            moves_and_builds = self._by_structure(numbers)
            if moves_and_builds is not None:
                moves, builds = moves_and_builds
                break
        self.current = end
        return end, moves, builds

    def _start_from(self, start: StateArrays) -> None:
        """Put robots and their docks where they start."""
        robots = self.robots
        self.memory.copy(start.position, robots.position)
        if self.has_last_step:
            self.memory.copy(start.last_step, robots.last_step)
        kernels.place_docks(self.scale, self.structure, robots.position, robots.arm, robots.dock)

    @property
    def scale(self) -> float:
        """The unit, or 1."""
        return 1.0 if self.places is None else self.places.scale

    def _measure_in(self, places: Places) -> None:
        """Convert heights and reach to the numbers of places."""
        if self.places is places:
            return
        self.places = places
        # Rows are searched in numbers, not in lengths.
        self.neighbors.cutoff = self.reach / places.scale
        height = np.nan_to_num(places.to_numbers(self.target, places.origin[2]), nan=UNKNOWN)
        self.memory.refill(self.robots.height, height)

    def _arrays_of(self, state: RelaxState) -> StateArrays:
        """Return the arrays of a state, which are copied to the device if they are not there."""
        if state.arrays is None or state.arrays.stepper is not self:
            arrays = StateArrays(self)
            places = state.places
            self._from_caller(places.to_numbers(state.position, places.origin), arrays.position)
            if self.has_last_step:
                self._from_caller(state.last_step, arrays.last_step)
            state.arrays = arrays
        return state.arrays

    def _from_caller(self, values: Reals, array: DeviceArray) -> None:
        """Copy numbers of robots in the caller's order, shape (N, 3), to the device."""
        if self.by_structure:
            array[...] = values[self.order]
        else:
            dtype = self.memory.dtype_of(array)
            kernels.to_device(self.order_there, np.ascontiguousarray(values, dtype), array)

    def by_caller(self, array: DeviceArray) -> AnyReals | AnyInts:
        """Copy numbers of robots, shape (N, 3), to the host, in the caller's order."""
        ordered = np.empty(array.shape, self.memory.dtype_of(array))
        if self.by_structure:
            ordered[self.order] = array
        else:
            with backend.exclusive():
                self.refuse_other_device()
                kernels.to_caller(self.order_there, array, 1.0, 0.0, 0.0, 0.0, ordered)
        return ordered

    def export(self, array: DeviceArray, places: Places) -> ExportedArray:
        """Copy centers, in the caller's order, into memory of the card that others may read.

        Raises:
            InputError: the card has no such memory.
        """
        arch = self.memory.running.arch
        if arch != "cuda":
            raise InputError(
                f"no library can take positions where {arch} has them; read `position`, a copy on "
                "the host, or compute on cuda or cpu"
            )
        with backend.exclusive():
            self.refuse_other_device()
            centers = self.memory.reals(*array.shape)
            kernels.to_caller(self.order_there, array, places.scale, *places.origin, centers)
            return self.memory.export(centers)

    def bounds(self, array: DeviceArray) -> AnyReals | AnyInts:
        """Find the least and the greatest numbers along each axis, shape (2, 3)."""
        if self.by_structure:
            return np.stack([array.min(axis=0), array.max(axis=0)])
        parts = min(_PARTS, len(self.order))
        bounds = np.empty((parts, 2, 3), self.memory.dtype_of(array))
        with backend.exclusive():
            self.refuse_other_device()
            kernels.find_bounds(array, bounds)
        return np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])

    @property
    def is_there(self) -> bool:
        """Whether the device has the arrays; those of a single thread, on the host, outlast it."""
        running, ours = backend.current(), self.memory.running
        alike = (running.arch, running.precision) == (ours.arch, ours.precision)
        return running is ours or (self.by_structure and alike)

    def refuse_other_device(self) -> None:
        """Refuse to go on where another device started meanwhile."""
        if not self.is_there:
            raise InputError("another device started, which freed the swarm; prepare it again")

    def _all_at_once(self, numbers: Reals, *, serves: bool) -> tuple[Reals, int]:
        """Step by step, each with all threads; make rows anew where they are stale.

        Args:
            numbers: As for `take_steps`.
            serves: Whether rows serve until they are stale.
        """
        neighbors = self.neighbors
        robots = self.robots
        control = self.control
        on_card = neighbors.on_card
        steps = len(numbers)
        if self.moves.shape[0] != steps:
            self.moves = self._moves(steps)
            self.numbers = self.memory.reals(*numbers.shape)
        self.moves.fill(0)
        self.memory.refill(self.numbers, numbers)
        # Docks are held twice: a step reads one half and writes the other.
        half = robots.dock.shape[0] // 2
        most, calls = (_STEPS_ON_CARD, 1) if on_card else (_STEPS, _CALLS)
        builds = 0
        taken = 0
        control[Control.TAKEN] = 0
        while taken < steps:
            if not serves:
                neighbors.write(robots.dock, taken % 2 * half)
                kernels.start_interval(
                    taken, neighbors.room, neighbors.longest, robots.position, robots.reference,
                    control,
                )  # fmt: skip
            past = taken + calls * most
            with numerics.fast_arithmetic(ignores_nan=self.ignores_nan):
                for t in range(taken, past, most):
                    kernels.step_robots(
                        on_card, most, self.dynamics, neighbors.docks, neighbors.own_bits,
                        neighbors.entry_stride, self.stray_limit, self.scale, t, self.numbers,
                        *neighbors.rows, *robots, control, self.moves,
                    )  # fmt: skip
            # The only wait for the device.
            before, taken = taken, int(control[Control.TAKEN])
            if not serves and taken > before:
                builds += 1
            elif not serves and not neighbors.lack_room():
                # Fresh rows allow a step, unless the device did not run the kernel.
                raise backend.faulty_driver()
            serves = taken == past
        neighbors.builds += builds
        moves = self.memory.download(self.moves)
        if on_card:
            moves = np.sqrt(moves.view(np.float32).astype(np.float64))
        return moves.astype(np.float64), builds

    def _by_structure(self, numbers: Reals) -> tuple[Reals, int] | None:
        """All steps of a structure on one thread; None if a row was too short, which is now not."""
        neighbors = self.neighbors
        structures = len(self.start) - 1
        moves = self.memory.reals(structures, len(numbers))
        with numerics.fast_arithmetic(ignores_nan=self.ignores_nan):
            kernels.relax_structures(
                self.dynamics, neighbors.own_bits, neighbors.cutoff, self.stray_limit,
                self.scale, self.memory.upload(numbers),
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
    # Centers and last steps as robots are, as they were before the last call, and at first.
    numbers = (8 if guided else 4) * 3 + docks * (3 + 2 * 4)
    integers = docks * (2 + 16 + 16) + 13
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
