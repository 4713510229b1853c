"""Annealing: every robot at once, of every structure, in several chains, ever less tolerant."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend
from tiswarm.compute.arrays import Allocator
from tiswarm.compute.lang import GRAIN, DeviceArray
from tiswarm.compute.math import dock_offsets
from tiswarm.compute.neighbor_list import NeighborList
from tiswarm.localization.joint.branches import branches, tables
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.force_kernels import SPACING, TOTAL, YAW
from tiswarm.localization.joint.kernels import SKIN, STALE, THIN_SKIN, note_places, take_steps
from tiswarm.localization.joint.schedule import cooled, end_tolerance, thermostat
from tiswarm.localization.joint.seats import first_guess, reseat
from tiswarm.localization.params import JointParams
from tiswarm.records.sensing_log import SensingLog

WIDTH = 3.0
"""Standard deviations at which a robust contact begins to give way."""
PUT_BACK_FROM = 0.4
"""Part of the steps after which robots that got lost are put back."""
LAUNCH = 3000
"""Robots of which a step takes as long as does a launch from Python."""
GROWING = 0.1
"""Part of the steps in which docks grow to their full size."""
FRAMES = 24
"""Frames of the trace."""
AS_SENSED = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""A row of the kernel's headings to begin with."""


@dataclass(frozen=True, kw_only=True)
class Annealed:
    """What the chains of one structure came to; lengths in dock radii."""

    mean: NDArray[np.float64]
    """Mean position over the end of each chain, shape (chains, N, 3)."""

    spread: NDArray[np.float64]
    """Mean square distance from it, shape (chains, N)."""

    last: NDArray[np.float64]
    """Where each chain stood at last, shape (chains, N, 3)."""

    mean_yaw: NDArray[np.float64]
    """Mean turn over the end of each chain [rad], shape (chains, N)."""

    last_yaw: NDArray[np.float64]
    """How far robots were turned at last [rad], shape (chains, N)."""

    tolerance: float
    """How far equations could be missed at last, as a standard deviation."""

    temperature: NDArray[np.float64]
    """Mean kinetic temperature of each chain once docks are grown, relative to its target,
    shape (chains,)."""

    iteration: NDArray[np.int64]
    """Steps at which the trace was recorded, shape (K,)."""

    trace: NDArray[np.float64]
    """Positions of the first chain then, shape (K, N, 3)."""

    def with_chains(self, chosen: NDArray[np.bool_], other: "Annealed") -> "Annealed":
        """Replace some chains, chosen by an array of shape (chains,), by those of `other`."""
        arrays: dict[str, Any] = {
            name: np.where(
                chosen.reshape(-1, *[1] * (getattr(self, name).ndim - 1)),
                getattr(other, name),
                getattr(self, name),
            )
            for name in ("mean", "spread", "last", "mean_yaw", "last_yaw", "temperature")
        }
        return replace(self, **arrays, trace=other.trace if chosen[0] else self.trace)


def anneal(
    logs: Sequence[SensingLog],
    params: Sequence[JointParams],
    known: Sequence[Equations],
    *,
    halvings: int = 0,
) -> list[Annealed]:
    """Anneal structures side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.
        known: Equations of each.
        halvings: How often to halve the length of a step.
    """
    return Swarm(logs, params, known, inertia_factor=4.0**halvings).run()


class Swarm:
    """All chains of all structures on the device."""

    def __init__(
        self,
        logs: Sequence[SensingLog],
        params: Sequence[JointParams],
        known: Sequence[Equations],
        *,
        by_block: bool | None = None,
        inertia_factor: float = 1.0,
    ) -> None:
        """Put every chain where it begins.

        Args: as `anneal` has them.
            by_block: Whether one thread takes all steps of a structure in one chain; else all
                take each step together. By what is quicker if None; no bit depends on it.
            inertia_factor: Factor of every mass; 4 halves the steps.
        """
        self.inertia_factor = inertia_factor
        running = backend.current()
        self.memory = memory = Allocator(running, on_host=False)
        self.chains = params[0].chains_for(logs[0].robot_count)
        self.steps = params[0].steps_for(logs[0].robot_count)
        self.schedule = params[0]
        seed = self.schedule.seed
        self.known = known
        self.robust = [p.robust for p in params]
        self.size = [log.robot_count for log in logs]
        self.start = np.cumsum([0, *self.size])
        trees = [branches(np.column_stack([e.robot, e.other]), len(e.place)) for e in known]
        copies, blocks = self.chains * self.start[-1], self.chains * len(logs)
        if by_block is None:
            # The fewer copies the busiest thread has, the better.
            shared = LAUNCH + GRAIN * -(-copies // (GRAIN * running.threads))
            busiest = copies / blocks * -(-blocks // running.threads)
            by_block = running.arch == "cpu" and bool(busiest <= shared)
        self.by_block = by_block
        self.order = np.concatenate(
            [a + t.order for t, a in zip(trees, self.start[:-1], strict=True)]
        )
        self.turning = any(e.yaw_precision for e in known)
        first_of_block = np.cumsum([0, *self.size * self.chains])
        arm = np.concatenate(
            [dock_offsets(g.orientation_wxyz, g.dock_offset_body / g.dock_radius) for g in logs]
        )[self.order]
        first = np.concatenate(
            [first_guess(g, e, seed, self.chains) for g, e in zip(logs, known, strict=True)], axis=1
        )[:, self.order]
        listed = np.zeros((copies, 4))
        listed[:, 3] = np.repeat(np.arange(blocks), np.diff(first_of_block))
        self.docks = arm.shape[1]
        self.near = 2.0 * float(np.linalg.norm(arm, axis=2).max()) + SPACING
        self.neighbors = NeighborList(
            memory,
            first.reshape(-1, 3),
            np.empty((0, 4), np.int64),
            docks=1,
            reach=0.0,
            cutoff=self.near + THIN_SKIN,
            start=first_of_block if by_block else None,
        )
        self.listed = memory.upload(listed.ravel())
        self.tolerance = self._tolerances(params)
        self.target = thermostat(self.tolerance)
        self.equations = [
            memory.upload(values)
            for values in (
                self.tolerance,
                np.repeat(np.arange(len(logs)), self.size),
                np.concatenate([np.arange(size) for size in self.size])[self.order],
                np.repeat([int(p.non_overlap) for p in params], self.size),
                np.repeat([WIDTH**-2 if p.robust else 0.0 for p in params], self.size),
                *_by_robot(known, params, self.start, np.argsort(self.order)),
                np.concatenate([e.place for e in known])[self.order],
                np.concatenate([e.precision for e in known])[self.order],
                np.concatenate([e.walk for e in known])[self.order],
                np.repeat([e.yaw_precision for e in known], self.size),
            )
        ]
        branch_tables = tables(known, trees, self.chains)
        branches_in_all = self.chains * len(branch_tables[1])
        shifts = [memory.reals(branches_in_all, columns) for columns in (4, 3, 3)]
        self.branches = [*(memory.upload(table) for table in branch_tables), *shifts]
        self.position = memory.upload(first.reshape(-1, 3))
        self.velocity, self.force, self.total = (memory.reals(copies, 3) for _ in range(3))
        self.mass, self.square_total = memory.reals(copies), memory.reals(copies)
        for array in (self.velocity, self.force, self.total, self.square_total, *shifts):
            array.fill(0.0)
        self.mass.fill(inertia_factor)
        self.arm = memory.upload(np.tile(arm, (self.chains, 1, 1)))
        self.heading = memory.upload(
            np.tile(AS_SENSED, (copies, 1)) * [*[1.0] * 5, inertia_factor, 1.0]
        )
        self.first_of_block = memory.upload(first_of_block)
        self.taken, self.age = memory.ints(blocks), memory.ints(blocks)
        self.skin = memory.reals(blocks)
        self.taken.fill(0)
        self.age.fill(STALE)
        self.skin.fill(SKIN)

    def run(self) -> list[Annealed]:
        """Take all steps."""
        holding = self.schedule.hold_steps
        frames = np.linspace(0, self.steps + holding, FRAMES).astype(np.int64)
        frames = np.union1d(frames, self.steps)
        trace, heat = [], []
        for frame in frames.tolist():
            self.advance(frame)
            if PUT_BACK_FROM * self.steps <= frame < self.steps:
                self.put_back()
            trace.append(self.by_robot(self.position)[0])
            if frame > GROWING * self.steps:
                heat.append(self.temperatures(frame - 1))
        last = self.by_robot(self.position)
        moves = last.shape[1] > len(self.size)  # anchors do not
        if not np.isfinite(last).all() or (moves and np.array_equal(trace[0], trace[-1])):
            raise backend.faulty_driver()
        mean = self.by_robot(self.total) / holding
        square = self.by_robot(self.square_total) / holding
        spread = np.maximum(square - (mean**2).sum(axis=2), 0.0)
        heading = self.by_robot(self.heading)
        temperature = np.mean(heat, axis=0)
        return [
            Annealed(
                mean=mean[:, a:b],
                mean_yaw=heading[:, a:b, TOTAL] / holding,
                last_yaw=heading[:, a:b, YAW],
                tolerance=tolerance,
                temperature=temperature[:, n],
                spread=spread[:, a:b],
                last=last[:, a:b],
                iteration=frames,
                trace=np.array([frame[a:b] for frame in trace]),
            )
            for n, (a, b, tolerance) in enumerate(
                zip(self.start[:-1], self.start[1:], self.tolerance[:, -1].tolist(), strict=True)
            )
        ]

    def advance(self, until: int) -> None:
        """Take steps until so many have been taken."""
        rows = self.neighbors
        while (self.taken.to_numpy().min() if self.by_block else self.taken[0]) < until:
            if not self.by_block and self.age[0] == STALE:
                note_places(self.position, self.listed)
                rows.cutoff = self.near + self.skin[0]
                rows.build(self.listed, 0)
                self.age.fill(0)
            take_steps(
                self.by_block, self.docks, self.turning, rows.own_bits, rows.entry_stride,
                rows.capacity, self.near, self.schedule.seed, until, self.steps,
                max(GROWING * self.steps, 1.0), self.inertia_factor, *self.equations,
                *self.branches, rows.table, rows.begin, rows.sorted_dock, rows.sorted_at,
                rows.contact_start, rows.contact, rows.row, rows.row_first, rows.row_count,
                rows.longest, self.arm, self.first_of_block, self.taken, self.age, self.skin,
                self.listed, self.position, self.velocity, self.force, self.mass, self.heading,
                self.total, self.square_total,
            )  # fmt: skip
            if self.by_block and (entries := rows.fullest()) > rows.capacity:
                rows.make_room(entries)
                self.age.fill(STALE)

    def temperatures(self, step: int) -> NDArray[np.float64]:
        """Kinetic temperature of each chain of each structure, relative to its target at a step.

        Each degree of freedom has m v^2 = s^2 in the mean, s^2 being the thermostat's mean over the
        time that friction takes; anchors, which do not move, have none.

        Returns:
            Temperatures, shape (chains, S); 1 where nobody moves.
        """
        moving = np.concatenate([np.arange(size) > 0 for size in self.size])
        energy = self.by_robot(self.mass) * (self.by_robot(self.velocity) ** 2).sum(axis=2)
        total = np.add.reduceat(energy * moving, self.start[:-1], axis=1)
        freedom = 3.0 * (np.array(self.size) - 1.0) * self.target[:, step]
        return np.where(freedom > 0.0, total / np.where(freedom > 0.0, freedom, 1.0), 1.0)

    def put_back(self) -> None:
        """Put robots back that lost most of those they touch, where the loss lets go of these."""
        position, heading = self.by_robot(self.position), self.by_robot(self.heading)
        moved = 0
        start = zip(self.start[:-1], self.start[1:], strict=True)
        for known, gives_up, (a, b) in zip(self.known, self.robust, start, strict=True):
            if gives_up:
                moved += reseat(known, position[:, a:b], heading[:, a:b, YAW])
        if moved:
            self.memory.refill(self.position, position[:, self.order].reshape(-1, 3))
            self.age.fill(STALE)

    def _tolerances(self, params: Sequence[JointParams]) -> NDArray[np.float64]:
        """Tolerance of each structure at each step, shape (S, steps)."""
        holding = self.schedule.hold_steps
        return np.array(
            [
                cooled(p.start_tolerance, end_tolerance(e, p), self.steps, holding)
                for e, p in zip(self.known, params, strict=True)
            ]
        )

    def by_robot(self, array: DeviceArray) -> NDArray[np.float64]:
        """Read an array of every copy as logs number robots, shape (chains, N, ...)."""
        value: NDArray[np.float64] = array.to_numpy().astype(np.float64)
        return value.reshape(self.chains, -1, *value.shape[1:])[:, np.argsort(self.order)]


def _by_robot(
    known: Sequence[Equations],
    params: Sequence[JointParams],
    start: NDArray[np.int64],
    number: NDArray[np.intp],
) -> tuple[NDArray[Any], ...]:
    """Every contact from both its sides, robot after robot, `number` of these in memory.

    Returns:
        Start of each robot's, partner, whether it is final, stretch, shift, lever and variance.
    """
    robot = number[np.concatenate([e.robot + a for e, a in zip(known, start[:-1], strict=True)])]
    other = number[np.concatenate([e.other + a for e, a in zip(known, start[:-1], strict=True)])]
    is_final = np.concatenate([e.is_final for e in known]).astype(np.int64)
    stretch = np.concatenate(
        [p.stretch * e.is_final / e.fewest for e, p in zip(known, params, strict=True)]
    )
    shift = np.concatenate([e.shift for e in known])
    lever = np.concatenate([e.lever for e in known])
    variance = np.concatenate([e.variance for e in known])
    order = np.argsort(np.concatenate([robot, other]), kind="stable")
    count = np.bincount(np.concatenate([robot, other]), minlength=start[-1])
    partner = np.concatenate([other, robot])[order]
    room = 0 if len(order) else 1  # a kernel takes no empty array
    return (
        np.concatenate([[0], count.cumsum()]),
        np.pad(partner, (0, room)),
        np.pad(np.tile(is_final, 2)[order], (0, room)),
        np.pad(np.tile(stretch, 2)[order], (0, room)),
        np.pad(np.concatenate([shift, -shift])[order], ((0, room), (0, 0))),
        np.pad(np.concatenate([lever, lever[:, [2, 3, 0, 1]]])[order], ((0, room), (0, 0))),
        np.pad(np.tile(variance, 2)[order], (0, room), constant_values=1.0),
    )
