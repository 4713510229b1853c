"""Langevin annealing of all robots at once, of every structure, in several chains.

A chain cools from `start_sigma` to its end temperature and is held there. sigma is the square root
of the temperature: the standard deviation by which measurements may be missed. Lengths in R.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.progress import ignore
from tiswarm.compute import backend
from tiswarm.compute.backend import Allocator, Backend
from tiswarm.compute.lang import GRAIN, DeviceArray
from tiswarm.compute.neighbor_list import NeighborList
from tiswarm.localization.chains.arrays import (
    STALE,
    BlockProgress,
    BodyMotion,
    Heading,
    Moments,
    block_arrays,
    measured_arrays,
    subtree_arrays,
    swarm_arrays,
    traits_of,
)
from tiswarm.localization.chains.kernels import MEMORY, SKIN, THIN_SKIN, note_places, take_steps
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.chains.views import ANNEALING, ChainView, view_of
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.model import SPACING
from tiswarm.records.sensing_log import SensingLog

_BYTES = 1_000
"""Memory of a robot in one chain on the device, in f64 [B]."""

_BY_CHAIN = ("mean", "within", "last", "mean_yaw", "last_yaw", "temperature")


@dataclass(frozen=True, kw_only=True)
class Annealed:
    """Result of the chains of one structure of N robots."""

    mean: Reals
    """Mean position over the hold of each chain [R], shape (chains, N, 3)."""

    within: Reals
    """Within-chain variance of each position, all axes together [R^2], shape (chains, N)."""

    last: Reals
    """Last position in each chain [R], shape (chains, N, 3)."""

    mean_yaw: Reals
    """Mean yaw correction over the hold of each chain [rad], shape (chains, N)."""

    last_yaw: Reals
    """Last yaw correction in each chain [rad], shape (chains, N)."""

    sigma: float
    """Square root of the end temperature [R]."""

    temperature: Reals
    """Mean kinetic temperature of each chain once docks are grown, relative to its target [1],
    shape (chains,)."""

    iteration: Ints
    """Steps at which the trace was recorded, shape (K,)."""

    trace: Reals
    """Positions of the first chain then [R], shape (K, N, 3)."""

    yaw_trace: Reals
    """Yaw corrections of the first chain then [rad], shape (K, N)."""

    def joined(self, further: "Annealed") -> "Annealed":
        """Add the chains of others that ended at the same temperature."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(further, name)])
            for name in _BY_CHAIN
        }
        return replace(self, **arrays)

    def still(self, position: Reals, yaw: Reals) -> "Annealed":
        """Put chains that do not move in place of these: (K, N, 3) and (K, N)."""
        return replace(
            self, mean=position, last=position, mean_yaw=yaw, last_yaw=yaw,
            within=np.zeros(yaw.shape), temperature=np.ones(len(yaw)),
        )  # fmt: skip

    def with_chains(self, chosen: Bools, replacement: "Annealed") -> "Annealed":
        """Replace some chains, chosen by an array of shape (chains,), by those of `replacement`."""
        arrays: dict[str, Any] = {
            name: np.where(
                chosen.reshape(-1, *[1] * (getattr(self, name).ndim - 1)),
                getattr(replacement, name),
                getattr(self, name),
            )
            for name in _BY_CHAIN
        }
        # Traces are those of the first chain.
        if chosen[0]:
            arrays |= {"trace": replacement.trace, "yaw_trace": replacement.yaw_trace}
        return replace(self, **arrays)


def anneal(
    logs: Sequence[SensingLog],
    params: Sequence[JointParams],
    problems: Sequence[Problem],
    *,
    halvings: int = 0,
    start: Sequence[Reals] | None = None,
    on_progress: Callable[[float], None] = ignore,
) -> list[Annealed]:
    """Anneal structures side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.
        problems: Measurements of each.
        halvings: How often steps are halved, from those that are usual.
        start: Where the chains of each structure begin, as for `view_of`.
        on_progress: Called with the share of the steps that is done [1].
    """
    annealer = annealer_of(logs, params, problems, inertia_factor=4.0**halvings, start=start)
    return annealer.run(on_progress)


def annealer_of(
    logs: Sequence[SensingLog],
    params: Sequence[JointParams],
    problems: Sequence[Problem],
    *,
    start: Sequence[Reals] | None = None,
    by_block: bool | None = None,
    inertia_factor: float = 1.0,
) -> "Annealer":
    """Put the chains of whole logs where they begin.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.
        problems: Measurements of each.
        start: Where the chains of each structure begin, as for `view_of`.
        by_block: Whether a thread takes all steps of a block of robots, as for `Annealer`.
        inertia_factor: Factor of every mass; 4 halves the steps.
    """
    begin: Sequence[Reals | None] = start or [None] * len(logs)
    means = [problem.averaged() for problem in problems]
    views = [view_of(*structure) for structure in zip(logs, params, means, begin, strict=True)]
    seed = params[0].seed
    hold = params[0].hold_steps
    return Annealer(views, seed=seed, hold=hold, by_block=by_block, inertia_factor=inertia_factor)


class Annealer:
    """All chains of all structures on the device."""

    def __init__(
        self,
        views: Sequence[ChainView],
        *,
        seed: int,
        hold: int,
        by_block: bool | None = None,
        is_short: bool = False,
        inertia_factor: float = 1.0,
    ) -> None:
        """Put every chain where it begins.

        Args:
            views: Robots and measurements of each structure, all with as many chains and steps.
            seed: Seed of the random numbers.
            hold: Steps at the end that are averaged.
            by_block: Whether one thread takes all steps of a structure in one chain; else all
                threads take each step together. By what is quicker if None; no bit depends on it.
            is_short: Whether all steps take few launches, so that arrays on the host are quicker.
            inertia_factor: Factor of every mass; 4 halves the steps.
        """
        running = backend.current()
        memory = Allocator(running, on_host=False)
        if is_short:
            memory = memory.for_few_launches()
        self.memory = memory
        self.on_card = running.on_card
        self.views = views
        self.seed = seed
        self.size = [len(v.moves) for v in views]
        self.start = np.cumsum([0, *self.size])
        self.chains = len(views[0].begin)
        self.sigma = np.array([v.sigma for v in views])
        self.hold = hold
        self.steps = self.sigma.shape[1] - hold
        self.by_block = self._is_quicker_by_block(running) if by_block is None else by_block
        self.traits = traits_of(views, by_block=self.by_block)
        self.target = thermostat(self.sigma)
        # Robots of a subtree stand in a row in memory.
        offsets = self.start[:-1]
        self.order = np.concatenate(
            [a + v.forest.order for v, a in zip(views, offsets, strict=True)]
        )
        self.place = np.argsort(self.order)
        self.taken = 0  # steps, by the slowest block
        position = np.concatenate([v.begin for v in views], axis=1)[:, self.order].reshape(-1, 3)
        running.require_memory(len(position) * _BYTES, len(self.order))
        arm = np.concatenate([v.arm for v in views])[self.order]
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
        self.schedule = memory.upload(np.vstack([self.sigma, grown(self.steps, self.sigma)]))
        self.measured = measured_arrays(memory, views, self.order, inertia_factor)
        self.trees = subtree_arrays(memory, views, self.chains)
        sums = 1
        if self.on_card:
            from tiswarm.localization.chains.card_kernels import sum_rows  # noqa: PLC0415 - slow

            sums = sum_rows(len(position))
        self.sums = memory.longs(sums, 4)
        self.swarm = swarm_arrays(memory, arm, position, inertia_factor)
        self.blocks = block_arrays(memory, first_of_block, views, self.chains, self.steps)

    def _is_quicker_by_block(self, running: Backend) -> bool:
        """Whether the busiest thread has fewer copies to move; launches count as copies."""
        if running.on_card:
            return False
        copies = self.chains * int(self.start[-1])
        blocks = self.chains * len(self.size)
        shared = ANNEALING.launch + GRAIN * -(-copies // (GRAIN * running.threads))
        return copies / blocks * -(-blocks // running.threads) <= shared

    def run(
        self, on_progress: Callable[[float], None] = ignore, *, frames: int = ANNEALING.frames
    ) -> list[Annealed]:
        """Take all steps, and report the share of them that is done.

        Args:
            on_progress: Called with that share after each frame.
            frames: Frames of the trace, at least 2; one more at the end of cooling.
        """
        holding = self.hold
        at = np.linspace(0, self.steps + holding, frames).astype(np.int64)
        at = np.union1d(at, self.steps)
        trace = []
        yaw_trace = []
        heat = []
        for frame in at.tolist():
            self.advance(frame)
            on_progress(frame / (self.steps + holding))
            if ANNEALING.reinitialize_from * self.steps <= frame < self.steps:
                self.relocate()
            trace.append(self.by_robot(self.swarm.position)[0])
            yaw_trace.append(self.by_robot(self.swarm.heading)[0, :, Heading.YAW])
            if frame > ANNEALING.growing * self.steps:
                heat.append(self.temperatures(frame - 1))
        last = self.by_robot(self.swarm.position)
        moves = any(v.moves.any() for v in self.views)
        # Drivers of some cards report success and compute nothing.
        if not np.isfinite(last).all() or (moves and np.array_equal(trace[0], trace[-1])):
            raise backend.faulty_driver()
        total = self.by_robot(self.swarm.total)
        mean = total[..., : Moments.SQUARE] / holding
        square = total[..., Moments.SQUARE] / holding
        # The difference of two sums may round to less than 0.
        within = np.maximum(square - (mean**2).sum(axis=2), 0.0)
        heading = self.by_robot(self.swarm.heading)
        temperature = np.mean(heat, axis=0)
        return [
            Annealed(
                mean=mean[:, a:b],
                mean_yaw=heading[:, a:b, Heading.SUM] / holding,
                last_yaw=heading[:, a:b, Heading.YAW],
                sigma=float(self.sigma[n, -1]),
                temperature=temperature[:, n],
                within=within[:, a:b],
                last=last[:, a:b],
                iteration=at,
                trace=np.array([frame[a:b] for frame in trace]),
                yaw_trace=np.array([frame[a:b] for frame in yaw_trace]),
            )
            for n, (a, b) in enumerate(pairwise(self.start))
        ]

    def advance(self, until: int) -> None:
        """Take steps until so many have been taken."""
        rows = self.neighbors
        while self.taken < until:
            if not self.by_block and self.blocks.progress[0, BlockProgress.AGE] == STALE:
                self._build_rows()
            self._take_steps(until)
            before = self.taken
            self.taken = self._taken()
            if not self.by_block and self.taken == before:
                raise backend.faulty_driver()
            # A kernel counts entries that found no room and takes no step with them.
            if self.by_block and self.taken < until:
                entries = rows.fullest()
                if entries > rows.capacity:
                    rows.make_room(entries)
                    self.forget_rows()

    def _taken(self) -> int:
        """Return how many steps the slowest block has taken."""
        progress = self.blocks.progress
        return int(
            self.memory.download(progress)[:, BlockProgress.TAKEN].min()
            if self.by_block
            else progress[0, BlockProgress.TAKEN]
        )

    def _build_rows(self) -> None:
        """Build the Verlet rows of the whole swarm."""
        listed = self.blocks.listed
        progress = self.blocks.progress
        note_places(self.swarm.position, listed)
        self.neighbors.cutoff = self.near + (
            THIN_SKIN if progress[0, BlockProgress.IS_THIN] else SKIN
        )
        self.neighbors.build(listed, 0)
        progress[0, BlockProgress.AGE] = 0

    def _take_steps(self, until: int) -> None:
        """Take steps, at most until so many have been taken."""
        rows, robots, contacts, plane = self.neighbors, *self.measured
        arguments = (
            self.docks, self.traits, self.near, self.seed, until, self.schedule, *robots, *contacts,
            plane, *self.trees,
        )  # fmt: skip
        if self.on_card:
            from tiswarm.localization.chains import card_kernels  # noqa: PLC0415 - slow to import

            card_kernels.take_steps_on_card(
                *arguments, self.sums, rows.entry_stride, *rows.rows, *self.swarm, *self.blocks
            )
        else:
            take_steps(
                *arguments, rows.structure, *rows.cells, rows.connections.start, *rows.rows,
                *self.swarm, *self.blocks,
            )  # fmt: skip

    def forget_rows(self) -> None:
        """Let the rows of every block be built anew."""
        progress = self.memory.download(self.blocks.progress)
        progress[:, BlockProgress.AGE] = STALE
        self.memory.refill(self.blocks.progress, progress)

    def temperatures(self, step: int) -> Reals:
        """Compute the kinetic temperature of each chain, relative to its target at a step.

        Each degree of freedom has m v^2 = T in the mean, with T that of `thermostat`; anchors,
        which do not move, have none.

        Returns:
            Temperatures, shape (chains, S); 1 where nobody moves.
        """
        moving = np.concatenate([v.moves for v in self.views])
        motion = self.by_robot(self.swarm.motion)
        energy = motion[..., BodyMotion.MASS] * (
            motion[..., BodyMotion.VELOCITY : BodyMotion.VELOCITY + 3] ** 2
        ).sum(axis=2)
        total = np.add.reduceat(energy * moving, self.start[:-1], axis=1)
        count = np.add.reduceat(moving, self.start[:-1], dtype=np.float64)
        freedom = 3.0 * count * self.target[:, step]
        return np.where(freedom > 0.0, total / np.where(freedom > 0.0, freedom, 1.0), 1.0)

    def relocate(self) -> None:
        """Place robots anew that chains have lost, in views that have a rule for it."""
        position = self.by_robot(self.swarm.position)
        heading = self.by_robot(self.swarm.heading)
        moved = 0
        for view, (a, b) in zip(self.views, pairwise(self.start), strict=True):
            if view.relocate is not None:
                moved += view.relocate(position[:, a:b], heading[:, a:b, Heading.YAW])
        if moved:
            self.memory.refill(self.swarm.position, position[:, self.order].reshape(-1, 3))
            self.forget_rows()

    def by_robot(self, array: DeviceArray) -> Reals:
        """Read an array of every copy as logs number robots, shape (chains, N, ...)."""
        value: Reals = self.memory.download(array).astype(np.float64)
        return value.reshape(self.chains, -1, *value.shape[1:])[:, self.place]


def grown(steps: int, sigma: Reals) -> Reals:
    """Grow docks to their full size as chains of so many steps cool; a part of it at each step."""
    growing = max(ANNEALING.growing * steps, 1.0)
    number = np.arange(sigma.shape[-1])
    return np.clip((number + 1.0) / growing, ANNEALING.smallest, 1.0)


def thermostat(sigma: Reals) -> Reals:
    """Compute the mean of m v^2 that friction and kicks give a free robot at each step.

    It lags behind sigma^2: a step keeps a part of the velocity.

    Args:
        sigma: Square root of the temperature at each step [R], shape (..., steps).

    Returns:
        The mean of m v^2 for each coordinate [R^2], shape (..., steps).
    """
    target = sigma**2
    for step in range(1, target.shape[-1]):
        target[..., step] *= 1.0 - MEMORY**2
        target[..., step] += MEMORY**2 * target[..., step - 1]
    return target
