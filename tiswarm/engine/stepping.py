"""The arrays of a swarm on the device, and its steps there."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute import backend
from tiswarm.compute.backend import Allocator, Backend
from tiswarm.compute.lang import DeviceArray
from tiswarm.compute.neighbor_kernels import BUILDS
from tiswarm.compute.neighbor_list import NeighborList, morton_order
from tiswarm.engine import kernels
from tiswarm.engine.kernels import Gains, SwarmState
from tiswarm.engine.places import Places
from tiswarm.engine.structure_kernels import relax_structures
from tiswarm.engine.swarm import Swarm

_SKIN = 0.25
"""Reach of rows of neighbors beyond D [D]."""
_STEPS, _STEPS_ON_CARD = 4, 16
"""Most steps of a call. On a card Python needs longer for a call than the card for its steps; rows
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
    """Last step of each robot of a guided swarm, zero of others, shape (N, 3)."""

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

    structure: DeviceArray
    """Number of each robot's structure, shape (N,)."""

    neighbors: NeighborList
    """Rows of neighbors."""

    control: DeviceArray
    """Columns as `kernels.TAKEN` and others name them."""

    moves: DeviceArray
    """Longest step of any robot in each step, kept for calls of as many, shape (T,)."""

    share: DeviceArray
    """Shares of attraction and repulsion in each step, kept for calls of as many, shape (T, 2)."""

    spacing: float
    """D."""

    is_guided: bool
    """Whether robots have a mobility and inertia."""

    def __init__(
        self, swarm: Swarm, running: Backend, places: Places, *, by_structure: bool
    ) -> None:
        """Renumber the robots and reserve their arrays.

        Raises:
            InputError: there are more docks than can be numbered.
            EnvironmentTroubleError: they do not fit into memory.
        """
        robots, docks = len(swarm.position), len(swarm.dock_offset_body)
        self.spacing, self.is_guided = swarm.spacing, swarm.mobility is not None
        self.by_structure, self.places = by_structure, places
        self.order = order = morton_order(swarm.position, swarm.structure)
        self.start = np.concatenate([[0], np.bincount(swarm.structure).cumsum()])
        self.target = swarm.height[order] if len(swarm.height) == robots else swarm.height
        per_robot = _bytes_of_robot(running.dtype, docks, guided=self.is_guided)
        running.require_memory(robots * per_robot, robots)
        contacts = swarm.contacts.copy()
        # The inverse of the order: from the caller's numbers to those on the device.
        contacts[:, [0, 2]] = np.argsort(order)[contacts[:, [0, 2]]]
        self.memory = memory = Allocator(running, on_host=by_structure)
        self.neighbors = NeighborList(
            memory, swarm.position[order], contacts,
            docks=docks, reach=swarm.reach, cutoff=(1.0 + _SKIN) * self.spacing,
            start=self.start if by_structure else None, unit=places.unit,
        )  # fmt: skip
        numbers = memory.reals if places.unit is None else memory.ints
        share = np.ones((1, 1)) if swarm.mobility is None else swarm.mobility[order]
        self.robots = SwarmState(
            position=numbers(robots, 3),
            reference=numbers(robots, 3),
            height=numbers(len(self.target)),
            arm=memory.reals(robots * docks, 3),
            dock=numbers(2 * robots * docks * 4),
            mobility=memory.upload(share),
            last_step=memory.reals(*share.shape),
        )
        self.control, self.moves, self.share = memory.ints(4), memory.reals(1), memory.reals(1, 2)
        seldom = memory.for_few_launches()
        self.structure = seldom.upload(swarm.structure[order])
        turns, body = swarm.orientation_wxyz[order], swarm.dock_offset_body
        kernels.turn_docks(seldom.upload(turns), seldom.upload(body), self.robots.arm)

    def take_steps(self, state: RelaxState, gains: Gains, ramp: Reals) -> tuple[Reals, int]:
        """Take a step for each entry of the ramp.

        Args:
            state: Where the robots start.
            gains: Strength of the forces.
            ramp: Share of attraction in each step, shape (T,).

        Returns:
            Longest step of any robot, shape (T,), and how often rows were made.
        """
        self.places = places = state.places
        # Rows are searched in numbers, not in lengths.
        self.neighbors.cutoff = (1.0 + _SKIN) * self.spacing / places.scale
        robots, refill = self.robots, self.memory.refill
        start = state.position[self.order]
        share = np.column_stack([ramp, 1.0 - ramp])
        take = self._by_structure if self.by_structure else self._all_at_once
        while True:
            refill(robots.position, places.to_numbers(start, places.origin))
            refill(robots.height, places.to_numbers(self.target, places.origin[2]))
            if self.is_guided:
                refill(robots.last_step, state.last_step[self.order])
            kernels.place_docks(
                places.scale, self.structure, robots.position, robots.arm, robots.dock
            )
            if found := take(gains, share):
                return found

    def state(self) -> RelaxState:
        """Read where the robots are after the steps that were taken last."""
        center = self.places.to_lengths(self.memory.download(self.robots.position))
        step: Reals = np.zeros((len(self.order), 3))
        if self.is_guided:
            step = self.memory.download(self.robots.last_step)
        return RelaxState(
            places=self.places,
            position=self._by_caller(center),
            last_step=self._by_caller(step),
        )

    def _by_caller(self, array: Reals) -> Reals:
        """Put robots into the caller's order."""
        ordered = np.empty_like(array)
        ordered[self.order] = array
        return ordered

    def _all_at_once(self, gains: Gains, share: Reals) -> tuple[Reals, int]:
        """Step by step, each with all threads; make rows anew where they are stale."""
        neighbors, robots, control, steps = self.neighbors, self.robots, self.control, len(share)
        if self.moves.shape[0] != steps:
            self.moves, self.share = self.memory.reals(steps), self.memory.reals(steps, 2)
        self.memory.refill(self.share, share)
        # Docks are held twice: a step reads one half and writes the other.
        taken, builds_before, half = 0, neighbors.builds, robots.dock.shape[0] // 2
        most, calls = (_STEPS_ON_CARD, 1) if neighbors.on_card else (_STEPS, _CALLS)
        control.fill(0)
        while taken < steps:
            neighbors.build(robots.dock, taken % 2 * half)
            kernels.start_interval(robots.position, robots.reference, control)
            while not control[kernels.STALE]:
                with backend.fast_arithmetic():
                    for t in range(taken, taken + calls * most, most):
                        kernels.step_robots(
                            neighbors.on_card, most, self.is_guided, neighbors.docks,
                            neighbors.own_bits, neighbors.entry_stride, *gains,
                            0.5 * _SKIN * self.spacing, self.places.scale, t, self.share,
                            *neighbors.rows, *robots, control, self.moves,
                        )  # fmt: skip
                before, taken = taken, int(control[kernels.TAKEN])
                # Fresh rows always allow a step, unless the device did not run the kernel.
                if taken == before:
                    raise backend.faulty_driver()
        moves = self.memory.download(self.moves).astype(np.float64)
        return moves, neighbors.builds - builds_before

    def _by_structure(self, gains: Gains, share: Reals) -> tuple[Reals, int] | None:
        """All steps of a structure on one thread; None if a row was too short, which is now not."""
        neighbors, structures = self.neighbors, len(self.start) - 1
        shares, moves = self.memory.upload(share), self.memory.reals(structures, len(share))
        # Two robots that approach each other share the skin.
        stray_limit = 0.5 * ((1.0 + _SKIN) * self.spacing - self.spacing)
        with backend.fast_arithmetic():
            relax_structures(
                self.is_guided, neighbors.own_bits, neighbors.cutoff, stray_limit,
                self.places.scale, *gains, shares, neighbors.structure, *neighbors.cells,
                *neighbors.connections, *neighbors.rows, *self.robots, moves,
            )  # fmt: skip
        if (entries := neighbors.fullest()) > neighbors.capacity:
            neighbors.make_room(entries)
            return None
        builds = int(neighbors.structure[:, BUILDS].max())
        return moves.max(axis=0).astype(np.float64), builds


def _bytes_of_robot(dtype: type[np.floating[Any]], docks: int, *, guided: bool) -> int:
    """Count the memory of a robot in arrays of numbers and of integers [B]."""
    numbers, integers = (
        (5 if guided else 3) * 3 + docks * (3 + 2 * 4 + 4),
        docks * (1 + 16 + 16) + 12,
    )
    return numbers * np.dtype(dtype).itemsize + 4 * integers
