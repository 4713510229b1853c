"""The swarm step: every robot at once, moved by what its docks feel.

    F_i = sum over connected docks of Eq. (1)
        + sum over other docks of other robots nearer than D of Eq. (2)
        + k_z (h_i - z_i) along z, Eq. (3)
    p_i <- p_i + F_i, no farther than the largest step

Equations as in `tiswarm.engine.force_kernels`. Lengths in the unit of the robot's spacing D.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import psutil
from numpy.typing import ArrayLike, NDArray

from tiswarm.compute import backend
from tiswarm.compute.backend import Backend, loose_arithmetic
from tiswarm.compute.choices import Arch, Precision
from tiswarm.compute.memory import Memory
from tiswarm.compute.neighbors import NeighborList, morton_order
from tiswarm.engine.relax_kernels import (
    STALE,
    TAKEN,
    UNKNOWN,
    place_docks,
    relax_structures,
    start_interval,
    take_step,
)
from tiswarm.errors import EnvironmentTroubleError, InputError
from tiswarm.robot import Robot

SKIN = 0.25
"""How much farther than D rows of neighbors reach [D]."""
SMALL = 2_000
"""Structures of at most so many robots are relaxed by one thread each, without a pause."""
LAUNCHES = 8
"""Steps that are sent to the device before it is asked whether rows are stale."""
NORM_SLACK = 1e-6
"""A quaternion whose norm is this near to 1 is a rotation."""
NO_LIMIT = 1e30
LARGEST_GAIN = 1e12
FINEST = 0.01
"""A coordinate must be resolved this finely [D]."""


@dataclass(frozen=True, kw_only=True)
class RelaxResult:
    """Where the robots came to rest, or are on the way."""

    position: NDArray[np.float64]
    """Centers, in the caller's order, shape (N, 3)."""

    largest_move: NDArray[np.float64]
    """Largest step of any robot, by step, shape (steps,)."""

    list_builds: int
    """How often rows of neighbors were made, of the structure that needed it most."""


def relax(
    position: ArrayLike,
    orientation_wxyz: ArrayLike,
    contacts: ArrayLike,
    *,
    robot: Robot,
    attraction_gain: float,
    repulsion_gain: float,
    ramp: float | Sequence[float] | NDArray[np.float64],
    steps: int,
    height: ArrayLike | None = None,
    height_gain: float = 0.0,
    max_step: float | None = None,
    structure: ArrayLike | None = None,
    precision: Precision = "f64",
    arch: Arch = "cpu",
    threads: int | None = None,
) -> RelaxResult:
    """Take steps of the whole swarm under Eqs. (1)-(3), all robots at once.

    The bytes of the result depend on the arguments alone, not on threads.

    Args:
        position: Centers, shape (N, 3).
        orientation_wxyz: Body to world, unit quaternions, kept throughout, shape (N, 4).
        contacts: Connected docks, rows of (robot i, dock, robot j, dock), shape (C, 4).
        robot: Where docks are on a robot, and D; its unit of length is that of all lengths here.
        attraction_gain: A of Eq. (1) [1].
        repulsion_gain: B of Eqs. (1) and (2) [length^-3].
        ramp: alpha, the share of attraction, 0 to 1: one number, or one a step.
        steps: T.
        height: Height that each robot is pulled toward, NaN for none, shape (N,).
        height_gain: k_z of Eq. (3) [1].
        max_step: A robot moves no farther than this in a step; None for no limit.
        structure: Number of each robot's structure, shape (N,); robots of different structures
            never feel each other. None for one structure.
        precision: f32 halves the memory and loses what is far from the origin.
        arch: Device; it computes there or an error is raised.
        threads: CPU threads; all that this process may use if None.

    Raises:
        InputError: where an argument makes no sense, or forces diverge.
        EnvironmentTroubleError: where the machine lacks the device or the memory.
    """
    return prepare(
        position, orientation_wxyz, contacts, robot=robot, height=height, structure=structure,
        precision=precision, arch=arch, threads=threads,
    ).relax(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, ramp=ramp, steps=steps,
        height_gain=height_gain, max_step=max_step,
    )  # fmt: skip


def prepare(
    position: ArrayLike,
    orientation_wxyz: ArrayLike,
    contacts: ArrayLike,
    *,
    robot: Robot,
    height: ArrayLike | None = None,
    structure: ArrayLike | None = None,
    precision: Precision = "f64",
    arch: Arch = "cpu",
    threads: int | None = None,
) -> "PreparedSwarm":
    """Put a swarm on the device, to be relaxed again and again, as when gains are fitted.

    Args: as `relax` has them, and so are the errors.
    """
    swarm = _Swarm.checked(
        position, orientation_wxyz, contacts, robot=robot, height=height, structure=structure
    )
    running = backend.start(arch, threads=threads, precision=precision)
    swarm.check_resolution(running)
    return PreparedSwarm(running, swarm)


@dataclass(frozen=True, kw_only=True)
class _Swarm:
    """Checked arguments, in the caller's order."""

    position: NDArray[np.float64]
    orientation_wxyz: NDArray[np.float64]
    contacts: NDArray[np.int64]
    height: NDArray[np.float64] | None
    structure: NDArray[np.int64]
    dock_offset_body: NDArray[np.float64]
    spacing: float

    @classmethod
    def checked(
        cls,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        robot: Robot,
        height: ArrayLike | None,
        structure: ArrayLike | None,
    ) -> "_Swarm":
        """Refuse what has the wrong shape, is not finite, or contradicts itself."""
        robots = len(np.asarray(position))
        center = _shaped("position", position, (robots, 3))
        orientation = _shaped("orientation_wxyz", orientation_wxyz, (robots, 4))
        norm = np.linalg.norm(orientation, axis=1)
        if not (np.isfinite(center).all() and (np.abs(norm - 1.0) < NORM_SLACK).all()):
            msg = "positions must be finite and orientations unit quaternions (w, x, y, z)"
            raise InputError(msg)
        ids: NDArray[np.int64] = np.zeros(robots, np.int64)
        if structure is not None:
            named = _shaped("structure", structure, (robots,))
            ids = np.unique(named, return_inverse=True)[1].astype(np.int64)
        docks = robot.dock_offset_body
        return cls(
            position=center,
            orientation_wxyz=orientation,
            contacts=_checked_contacts(contacts, len(docks), ids),
            height=None if height is None else _shaped("height", height, (robots,)),
            structure=ids,
            dock_offset_body=docks,
            spacing=robot.spacing,
        )

    def check_resolution(self, running: Backend) -> None:
        """Refuse places so far from the origin that forces would be noise."""
        if not _resolved(self.position, running, self.spacing):
            msg = (
                f"a robot {np.abs(self.position).max():.3g} from the origin is beyond what "
                f"{running.precision} resolves; move the swarm to the origin"
            )
            raise InputError(msg + (" or use precision f64" if running.precision == "f32" else ""))


def _resolved(position: NDArray[np.float64], running: Backend, spacing: float) -> bool:
    """Whether every coordinate is a number that the precision resolves finely enough."""
    farthest = np.abs(position).max(initial=0.0)
    return bool(farthest * np.finfo(running.dtype).eps <= FINEST * spacing)


def _shaped(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.array(values, np.float64)
    if array.size == 0:
        array = array.reshape(0, *shape[1:])
    if array.shape != shape:
        msg = f"{name} has shape {array.shape}; expected {shape}"
        raise InputError(msg)
    return array


def _checked_contacts(
    contacts: ArrayLike, docks: int, structure: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Contacts between docks that exist, of different robots of one structure, each once."""
    rows = np.asarray(contacts, np.int64).reshape(-1, 4)
    first, second = rows[:, [0, 2]].T
    beyond = (rows < 0) | (rows >= np.array([len(structure), docks] * 2))
    wrong = beyond.any(axis=1) | (first == second)
    if not wrong.any():
        wrong = structure[first] != structure[second]
    if wrong.any():
        msg = (
            f"contact {tuple(rows[wrong][0].tolist())} is not between docks 0 to {docks - 1} of "
            f"two of the {len(structure)} robots in one structure"
        )
        raise InputError(msg)
    # One number a pair sorts far faster than rows of four do.
    one, other = first * docks + rows[:, 1], second * docks + rows[:, 3]
    most = len(structure) * docks
    pair = np.unique(np.minimum(one, other) * most + np.maximum(one, other))
    one, other = np.divmod(pair, most)
    return np.column_stack([one // docks, one % docks, other // docks, other % docks])


class PreparedSwarm:
    """A swarm on the device, renumbered so that neighbors are near in memory; see `prepare`."""

    def __init__(self, running: Backend, swarm: _Swarm) -> None:
        """Renumber the robots and copy them to the device."""
        self.swarm = swarm
        robots, docks = len(swarm.position), len(swarm.dock_offset_body)
        if robots == 0:
            return
        size = np.bincount(swarm.structure)
        self.running = running
        self.by_structure = running.arch == "cpu" and size.max() <= SMALL
        self.order = morton_order(swarm.position, swarm.structure)
        self.start = np.concatenate([[0], size.cumsum()])
        _check_memory(running, robots, docks)
        self.first_position = swarm.position[self.order]
        self.memory = memory = Memory(running, on_host=self.by_structure)
        self.neighbors = NeighborList(
            memory,
            self.first_position,
            self._renumbered(swarm.contacts),
            docks=docks,
            reach=float(np.linalg.norm(swarm.dock_offset_body, axis=1).max()),
            cutoff=(1.0 + SKIN) * swarm.spacing,
            start=self.start if self.by_structure else None,
        )
        self.arm = memory.reals(robots * docks, 3)
        self.dock = memory.reals(2, robots * docks, 4)
        seldom = memory.for_seldom_used()
        self.body = (
            seldom.upload(swarm.orientation_wxyz[self.order]),
            seldom.upload(swarm.dock_offset_body),
            seldom.upload(swarm.structure[self.order]),
        )
        height = np.zeros(1) if swarm.height is None else swarm.height[self.order]
        self.height = memory.upload(np.nan_to_num(height, nan=UNKNOWN))
        self.reference = memory.reals(robots, 3)

    def relax(
        self,
        *,
        attraction_gain: float,
        repulsion_gain: float,
        ramp: float | Sequence[float] | NDArray[np.float64],
        steps: int,
        height_gain: float = 0.0,
        max_step: float | None = None,
    ) -> RelaxResult:
        """Take steps from where the robots were at first; arguments as `relax` has them."""
        ramps = np.asarray(ramp, np.float64)
        if steps < 0 or ramps.shape not in {(), (steps,)}:
            msg = f"ramp of shape {ramps.shape}; give one number, or one for each of {steps} steps"
            raise InputError(msg)
        limit = NO_LIMIT if max_step is None else max_step
        law = (attraction_gain, repulsion_gain, height_gain, self.swarm.spacing, limit)
        if not (all(0.0 <= gain <= LARGEST_GAIN for gain in law[:3]) and limit >= 0.0):
            msg = f"gains must be 0 to {LARGEST_GAIN:g}, and the largest step 0 or more, not {law}"
            raise InputError(msg)
        if steps == 0 or len(self.swarm.position) == 0:
            still = self.swarm.position.copy()
            return RelaxResult(position=still, largest_move=np.zeros(steps), list_builds=0)
        self.law, self.steps = law, steps
        self.ramp = self.memory.upload(np.broadcast_to(ramps, steps))
        self._go_to_start()
        moves, builds = self._by_structure() if self.by_structure else self._all_at_once()
        position = np.empty_like(self.first_position)
        position[self.order] = self.memory.download(self.position)
        if not _resolved(position, self.running, self.swarm.spacing):
            msg = "the forces diverged; lower the gains or give max_step"
            raise InputError(msg)
        return RelaxResult(position=position, largest_move=moves, list_builds=builds)

    def _go_to_start(self) -> None:
        self.position = self.memory.upload(self.first_position)
        place_docks(*self.body, self.position, self.arm, self.dock)

    def _all_at_once(self) -> tuple[NDArray[np.float64], int]:
        """Step by step, each with all threads, rows made anew where they have gone stale."""
        rows = self.neighbors
        control, moves = self.memory.ints(2), self.memory.reals(self.steps)
        taken, builds_before = 0, rows.builds
        while taken < self.steps:
            rows.build(self.dock, taken % 2)
            start_interval(self.position, self.reference, control)
            while taken < self.steps and not control[STALE]:
                with loose_arithmetic():
                    for t in range(taken, min(taken + LAUNCHES, self.steps)):
                        take_step(
                            rows.docks, rows.own_bits, *rows.strides, *self.law,
                            0.5 * SKIN * self.swarm.spacing, t, self.ramp, self.dock, rows.row,
                            rows.row_count, self.arm, self.height, self.reference, self.position,
                            control, moves,
                        )  # fmt: skip
                taken = int(control[TAKEN])
        return self.memory.download(moves).astype(np.float64), rows.builds - builds_before

    def _by_structure(self) -> tuple[NDArray[np.float64], int]:
        """All steps of a structure on one thread; again from the start if a row was too short."""
        rows, structures = self.neighbors, len(self.start) - 1
        start = self.memory.upload(self.start)
        moves = self.memory.reals(structures, self.steps)
        builds = self.memory.ints(structures)
        while True:
            with loose_arithmetic():
                relax_structures(
                    rows.docks, rows.own_bits, rows.cutoff, rows.capacity, *self.law, start,
                    self.ramp, self.dock, rows.table, rows.begin, rows.sorted_dock,
                    rows.sorted_at, rows.contact_start, rows.contact, rows.row, rows.row_count,
                    self.arm, self.height, self.reference, self.position, builds, rows.longest,
                    moves,
                )  # fmt: skip
            longest = int(rows.longest.max())
            if longest <= rows.capacity:
                break
            rows.lengthen(longest)
            self._go_to_start()
        return moves.max(axis=0).astype(np.float64), int(builds.max())

    def _renumbered(self, contacts: NDArray[np.int64]) -> NDArray[np.int64]:
        new = np.empty(len(self.order), np.int64)
        new[self.order] = np.arange(len(self.order))
        rows = contacts.copy()
        rows[:, [0, 2]] = new[contacts[:, [0, 2]]]
        return rows


def _check_memory(running: Backend, robots: int, docks: int) -> None:
    """Refuse a swarm that does not fit into the machine's memory, before any of it is reserved."""
    numbers = 3 * 3 + docks * (3 + 2 * 4 + 4)
    integers = docks * (1 + 16 + 16) + 12
    needed = robots * (numbers * np.dtype(running.dtype).itemsize + 4 * integers)
    free = psutil.virtual_memory().available
    if running.arch == "cpu" and needed > free:
        msg = (
            f"{robots} robots need about {needed / 1e9:.1f} GB of memory and {free / 1e9:.1f} GB "
            "are free; use precision f32, fewer robots or a larger machine"
        )
        raise EnvironmentTroubleError(msg)
