"""Annealing: every robot at once, of every structure, in several chains, ever less tolerant."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend
from tiswarm.compute.arrays import Allocator
from tiswarm.compute.backend import Backend
from tiswarm.compute.lang import GRAIN, DeviceArray
from tiswarm.compute.math import dock_offsets
from tiswarm.compute.neighbor_list import NeighborList
from tiswarm.localization.joint.arrays import Blocks, Contacts, Priors, Robots, Swarm
from tiswarm.localization.joint.branches import branches, subtree_arrays
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.force_kernels import INERTIA, SPACING, TOTAL, YAW
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
    return Annealer(logs, params, known, inertia_factor=4.0**halvings).run()


class Annealer:
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

        Args:
            logs: One log a structure, all of one batch key with their settings.
            params: Settings for each.
            known: Equations of each.
            by_block: Whether one thread takes all steps of a structure in one chain; else all
                threads take each step together. By what is quicker if None; no bit depends on it.
            inertia_factor: Factor of every mass; 4 halves the steps.
        """
        running = backend.current()
        self.memory = memory = Allocator(running, on_host=False)
        self.schedule = params[0]
        self.known = known
        self.robust = [p.robust for p in params]
        self.inertia_factor = inertia_factor
        self.turning = any(e.yaw_precision for e in known)
        self.size = [log.robot_count for log in logs]
        self.start = np.cumsum([0, *self.size])
        self.chains = self.schedule.chains_for(self.size[0])
        self.steps = self.schedule.steps_for(self.size[0])
        self.by_block = self._is_quicker_by_block(running) if by_block is None else by_block
        self.sigma = np.array(
            [
                cooled(p.start_tolerance, end_tolerance(e, p), self.steps, self.schedule.hold_steps)
                for e, p in zip(known, params, strict=True)
            ]
        )
        self.target = thermostat(self.sigma)
        # Robots of a subtree stand in a row in memory.
        trees = [branches(np.column_stack([e.robot, e.other]), len(e.place)) for e in known]
        offsets = self.start[:-1]
        self.order = np.concatenate([a + t.order for t, a in zip(trees, offsets, strict=True)])
        guess = [
            first_guess(log, e, self.schedule.seed, self.chains)
            for log, e in zip(logs, known, strict=True)
        ]
        position = np.concatenate(guess, axis=1)[:, self.order].reshape(-1, 3)
        arm = np.concatenate(
            [dock_offsets(g.orientation_wxyz, g.dock_offset_body / g.dock_radius) for g in logs]
        )[self.order]
        self.docks = arm.shape[1]
        self.near = 2.0 * float(np.linalg.norm(arm, axis=2).max()) + SPACING
        first_of_block = np.cumsum([0, *self.size * self.chains])
        self.neighbors = NeighborList(
            memory,
            position,
            np.empty((0, 4), np.int64),
            docks=1,
            reach=0.0,
            cutoff=self.near + THIN_SKIN,
            start=first_of_block if self.by_block else None,
        )
        self.measured = [
            memory.upload(self.sigma),
            *self._robots(params),
            *contact_arrays(memory, known, params, self.start, np.argsort(self.order)),
            *self._priors(),
        ]
        self.trees = subtree_arrays(memory, known, trees, self.chains)
        self.swarm = self._swarm(arm, position)
        self.blocks = self._blocks(first_of_block)

    def _is_quicker_by_block(self, running: Backend) -> bool:
        """Whether the busiest thread has fewer copies to move; launches count as copies."""
        if running.arch != "cpu":
            return False
        copies, blocks = self.chains * int(self.start[-1]), self.chains * len(self.size)
        shared = LAUNCH + GRAIN * -(-copies // (GRAIN * running.threads))
        return copies / blocks * -(-blocks // running.threads) <= shared

    def _robots(self, params: Sequence[JointParams]) -> Robots:
        upload, size = self.memory.upload, self.size
        number = np.concatenate([np.arange(robots) for robots in size])[self.order]
        return Robots(
            structure=upload(np.repeat(np.arange(len(size)), size)),
            number=upload(number),
            non_overlap=upload(np.repeat([int(p.non_overlap) for p in params], size)),
            robust=upload(np.repeat([WIDTH**-2 if p.robust else 0.0 for p in params], size)),
        )

    def _priors(self) -> Priors:
        upload, known = self.memory.upload, self.known
        return Priors(
            place=upload(np.concatenate([e.place for e in known])[self.order]),
            precision=upload(np.concatenate([e.precision for e in known])[self.order]),
            walk=upload(np.concatenate([e.walk for e in known])[self.order]),
            yaw_precision=upload(np.repeat([e.yaw_precision for e in known], self.size)),
        )

    def _swarm(self, arm: NDArray[np.float64], position: NDArray[np.float64]) -> Swarm:
        upload, copies = self.memory.upload, len(position)
        heading = np.tile(AS_SENSED, (copies, 1))
        heading[:, INERTIA] = self.inertia_factor
        return Swarm(
            arm=upload(np.tile(arm, (self.chains, 1, 1))),
            position=upload(position),
            velocity=upload(np.zeros((copies, 3))),
            force=upload(np.zeros((copies, 3))),
            mass=upload(np.full(copies, self.inertia_factor)),
            heading=upload(heading),
            total=upload(np.zeros((copies, 3))),
            square_total=upload(np.zeros(copies)),
        )

    def _blocks(self, start: NDArray[np.int64]) -> Blocks:
        upload, blocks = self.memory.upload, len(start) - 1
        listed = np.zeros((start[-1], 4))
        listed[:, 3] = np.repeat(np.arange(blocks), np.diff(start))
        return Blocks(
            start=upload(start),
            taken=upload(np.zeros(blocks, np.int64)),
            age=upload(np.full(blocks, STALE)),
            skin=upload(np.full(blocks, SKIN)),
            listed=upload(listed.ravel()),
        )

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
            trace.append(self.by_robot(self.swarm.position)[0])
            if frame > GROWING * self.steps:
                heat.append(self.temperatures(frame - 1))
        last = self.by_robot(self.swarm.position)
        moves = last.shape[1] > len(self.size)  # anchors do not
        if not np.isfinite(last).all() or (moves and np.array_equal(trace[0], trace[-1])):
            raise backend.faulty_driver()
        mean = self.by_robot(self.swarm.total) / holding
        square = self.by_robot(self.swarm.square_total) / holding
        spread = np.maximum(square - (mean**2).sum(axis=2), 0.0)
        heading = self.by_robot(self.swarm.heading)
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
                zip(self.start[:-1], self.start[1:], self.sigma[:, -1].tolist(), strict=True)
            )
        ]

    def advance(self, until: int) -> None:
        """Take steps until so many have been taken."""
        rows = self.neighbors
        while (
            self.blocks.taken.to_numpy().min() if self.by_block else self.blocks.taken[0]
        ) < until:
            if not self.by_block and self.blocks.age[0] == STALE:
                note_places(self.swarm.position, self.blocks.listed)
                rows.cutoff = self.near + self.blocks.skin[0]
                rows.build(self.blocks.listed, 0)
                self.blocks.age.fill(0)
            take_steps(
                self.by_block, self.docks, self.turning, rows.own_bits, rows.entry_stride,
                rows.capacity, self.near, self.schedule.seed, until, self.steps,
                max(GROWING * self.steps, 1.0), self.inertia_factor, *self.measured, *self.trees,
                rows.table, *rows.cells, *rows.connections, rows.longest, *rows.rows,
                *self.swarm, *self.blocks,
            )  # fmt: skip
            if self.by_block and (entries := rows.fullest()) > rows.capacity:
                rows.make_room(entries)
                self.blocks.age.fill(STALE)

    def temperatures(self, step: int) -> NDArray[np.float64]:
        """Kinetic temperature of each chain of each structure, relative to its target at a step.

        Each degree of freedom has m v^2 = s^2 in the mean, s^2 being the thermostat's mean over the
        time that friction takes; anchors, which do not move, have none.

        Returns:
            Temperatures, shape (chains, S); 1 where nobody moves.
        """
        moving = np.concatenate([np.arange(size) > 0 for size in self.size])
        energy = self.by_robot(self.swarm.mass) * (self.by_robot(self.swarm.velocity) ** 2).sum(
            axis=2
        )
        total = np.add.reduceat(energy * moving, self.start[:-1], axis=1)
        freedom = 3.0 * (np.array(self.size) - 1.0) * self.target[:, step]
        return np.where(freedom > 0.0, total / np.where(freedom > 0.0, freedom, 1.0), 1.0)

    def put_back(self) -> None:
        """Put robots back that lost most of those they touch, where the loss lets go of these."""
        position, heading = self.by_robot(self.swarm.position), self.by_robot(self.swarm.heading)
        moved = 0
        start = zip(self.start[:-1], self.start[1:], strict=True)
        for known, gives_up, (a, b) in zip(self.known, self.robust, start, strict=True):
            if gives_up:
                moved += reseat(known, position[:, a:b], heading[:, a:b, YAW])
        if moved:
            self.memory.refill(self.swarm.position, position[:, self.order].reshape(-1, 3))
            self.blocks.age.fill(STALE)

    def by_robot(self, array: DeviceArray) -> NDArray[np.float64]:
        """Read an array of every copy as logs number robots, shape (chains, N, ...)."""
        value: NDArray[np.float64] = array.to_numpy().astype(np.float64)
        return value.reshape(self.chains, -1, *value.shape[1:])[:, np.argsort(self.order)]


def contact_arrays(
    memory: Allocator,
    known: Sequence[Equations],
    params: Sequence[JointParams],
    start: NDArray[np.int64],
    number: NDArray[np.intp],
) -> Contacts:
    """Put the contacts of all structures on the device, each at both its robots.

    Args:
        memory: Where arrays are allocated.
        known: Equations of each structure.
        params: Settings of each.
        start: First robot of each, shape (S + 1,).
        number: Where each robot is in memory, shape (N,).
    """
    robot = number[np.concatenate([e.robot + a for e, a in zip(known, start[:-1], strict=True)])]
    other = number[np.concatenate([e.other + a for e, a in zip(known, start[:-1], strict=True)])]
    is_final = np.concatenate([e.is_final for e in known]).astype(np.int64)
    extension = np.concatenate(
        [p.stretch * e.is_final / e.fewest for e, p in zip(known, params, strict=True)]
    )
    shift = np.concatenate([e.shift for e in known])
    lever = np.concatenate([e.lever for e in known])
    variance = np.concatenate([e.variance for e in known])
    both = np.concatenate([robot, other])
    order = np.argsort(both, kind="stable")

    def upload(values: NDArray[Any], padding: float = 0.0) -> DeviceArray:
        room = 0 if len(values) else 1  # a kernel takes no empty array
        width = [(0, room), *[(0, 0)] * (values.ndim - 1)]
        return memory.upload(np.pad(values, width, constant_values=padding))

    return Contacts(
        start=memory.upload(np.r_[0, np.bincount(both, minlength=start[-1]).cumsum()]),
        partner=upload(np.concatenate([other, robot])[order]),
        is_final=upload(np.tile(is_final, 2)[order]),
        extension=upload(np.tile(extension, 2)[order]),
        shift=upload(np.concatenate([shift, -shift])[order]),
        lever=upload(np.concatenate([lever, lever[:, [2, 3, 0, 1]]])[order]),
        variance=upload(np.tile(variance, 2)[order], 1.0),
    )
