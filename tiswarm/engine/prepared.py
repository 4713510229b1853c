"""A swarm on the device, and the steps it takes there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import psutil
from numpy.typing import NDArray

from tiswarm.compute.arrays import Allocator
from tiswarm.compute.backend import Backend, loose_arithmetic
from tiswarm.compute.neighbor_list import NeighborList, morton_order
from tiswarm.engine.relax_kernels import (
    STALE,
    STEPS_A_LAUNCH,
    TAKEN,
    UNKNOWN,
    place_docks,
    relax_structures,
    start_interval,
    take_steps,
    turn_docks,
)
from tiswarm.engine.swarm import Swarm, resolved
from tiswarm.errors import EnvironmentTroubleError, InputError

SKIN = 0.25
"""How much farther than D rows of neighbors reach [D]."""
SMALL = 2_000
"""Structures of at most so many robots are relaxed by one thread each, without a pause."""
LAUNCHES = 2
"""How often steps are sent to the device before it is asked whether rows are stale."""
NO_LIMIT = 1e30
LARGEST_GAIN = 1e12


@dataclass(frozen=True, kw_only=True)
class RelaxResult:
    """Where the robots came to rest, or are on the way."""

    position: NDArray[np.float64]
    """Centers, in the caller's order, shape (N, 3)."""

    largest_move: NDArray[np.float64]
    """Largest step of any robot, by step, shape (steps,)."""

    list_builds: int
    """How often rows of neighbors were made, of the structure that needed it most."""


class Law(NamedTuple):
    """What a step takes beside the robots, in the order of the kernels' arguments."""

    attraction_gain: float
    repulsion_gain: float
    height_gain: float
    spacing: float
    max_step: float

    def check(self) -> None:
        """Refuse gains that are negative, not a number, or beyond all reason."""
        gains = (self.attraction_gain, self.repulsion_gain, self.height_gain)
        if not (all(0.0 <= gain <= LARGEST_GAIN for gain in gains) and self.max_step >= 0.0):
            msg = (
                f"gains must be 0 to {LARGEST_GAIN:g}, and the largest step 0 or more, "
                f"not {tuple(self)}"
            )
            raise InputError(msg)


class PreparedSwarm:
    """A swarm on the device, renumbered so that neighbors are near in memory; see `prepare`."""

    def __init__(self, running: Backend, swarm: Swarm) -> None:
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
        self.memory = memory = Allocator(running, on_host=self.by_structure)
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
        self.dock = memory.reals(2 * robots * docks * 4)
        self.position, self.reference = memory.reals(robots, 3), memory.reals(robots, 3)
        self.control, self.moves = memory.ints(2), memory.reals(1)
        self.ramp = memory.reals(1)
        seldom = memory.for_seldom_used()
        self.structure = seldom.upload(swarm.structure[self.order])
        orientation = seldom.upload(swarm.orientation_wxyz[self.order])
        turn_docks(orientation, seldom.upload(swarm.dock_offset_body), self.arm)
        height = np.zeros(1) if swarm.height is None else swarm.height[self.order]
        self.height = memory.upload(np.nan_to_num(height, nan=UNKNOWN))

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
        law = Law(attraction_gain, repulsion_gain, height_gain, self.swarm.spacing, limit)
        law.check()
        if steps == 0 or len(self.swarm.position) == 0:
            still = self.swarm.position.copy()
            return RelaxResult(position=still, largest_move=np.zeros(steps), list_builds=0)
        relax = self._by_structure if self.by_structure else self._all_at_once
        self._go_to_start()
        moves, builds = relax(law, np.broadcast_to(ramps, steps))
        position = np.empty_like(self.first_position)
        position[self.order] = self.memory.download(self.position)
        if not resolved(position, self.running, self.swarm.spacing):
            msg = "the forces diverged; lower the gains or give max_step"
            raise InputError(msg)
        return RelaxResult(position=position, largest_move=moves, list_builds=builds)

    def _go_to_start(self) -> None:
        self.memory.refill(self.position, self.first_position)
        place_docks(self.structure, self.position, self.arm, self.dock)

    def _all_at_once(self, law: Law, ramp: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
        """Step by step, each with all threads, rows made anew where they have gone stale."""
        rows, control, steps = self.neighbors, self.control, len(ramp)
        if self.moves.shape[0] != steps:
            self.moves, self.ramp = self.memory.reals(steps), self.memory.reals(steps)
        self.memory.refill(self.ramp, ramp)
        taken, builds_before, half = 0, rows.builds, self.dock.shape[0] // 2
        control[TAKEN] = 0
        while taken < steps:
            rows.build(self.dock, taken % 2 * half)
            start_interval(self.position, self.reference, control)
            while not control[STALE]:
                taken = int(control[TAKEN])
                with loose_arithmetic():
                    for t in range(taken, taken + LAUNCHES * STEPS_A_LAUNCH, STEPS_A_LAUNCH):
                        take_steps(
                            rows.docks, rows.own_bits, rows.entry_stride, *law,
                            0.5 * SKIN * law.spacing, t, self.ramp, self.dock, *rows.rows,
                            self.arm, self.height,
                            self.reference, self.position, control, self.moves,
                        )  # fmt: skip
            taken = int(control[TAKEN])
        moves = self.memory.download(self.moves).astype(np.float64)
        return moves, rows.builds - builds_before

    def _by_structure(self, law: Law, ramp: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
        """All steps of a structure on one thread; again from the start if a row was too short."""
        rows, structures = self.neighbors, len(self.start) - 1
        start, ramps = self.memory.upload(self.start), self.memory.upload(ramp)
        moves = self.memory.reals(structures, len(ramp))
        builds = self.memory.ints(structures)
        while True:
            with loose_arithmetic():
                relax_structures(
                    rows.docks, rows.own_bits, rows.cutoff, rows.capacity, *law, start,
                    ramps, self.dock, rows.table, *rows.cells, *rows.connections, *rows.rows,
                    self.arm, self.height, self.reference, self.position, builds,
                    rows.longest, moves,
                )  # fmt: skip
            if (entries := rows.fullest()) <= rows.capacity:
                break
            rows.make_room(entries)
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
