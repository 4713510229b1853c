"""Annealing: every robot at once, of every structure, in several chains, ever less tolerant."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend, random
from tiswarm.compute.memory import Memory
from tiswarm.compute.neighbors import NeighborList
from tiswarm.compute.rotations import dock_offsets
from tiswarm.localization.joint.equations import Equations
from tiswarm.localization.joint.kernels import SPACING, sort_rows, take_step
from tiswarm.localization.params import JointParams
from tiswarm.records.sensing_log import SensingLog

SKIN = 0.5
"""How much farther than D rows of neighbors reach [D]."""
LIST_REACH = 0.7
"""Rows are kept for this part of a dock radius over the tolerance, in steps: robots are the
faster the greater the tolerance."""
LIST_STEPS = 16
"""But for no more steps than this."""
SOLID_BELOW = 0.5
"""Docks pass through each other while the tolerance is greater [R]; they would jam."""
WIDTH = 3.0
"""Standard deviations at which a robust contact begins to give way."""
FRAMES = 24
"""Frames of the trace."""


@dataclass(frozen=True, kw_only=True)
class Annealed:
    """What the chains of one structure came to; lengths in dock radii."""

    mean: NDArray[np.float64]
    """Mean position over the end of each chain, shape (chains, N, 3)."""

    spread: NDArray[np.float64]
    """Mean square distance from it, shape (chains, N)."""

    last: NDArray[np.float64]
    """Where each chain stood at last, shape (chains, N, 3)."""

    iteration: NDArray[np.int64]
    """Steps at which the trace was recorded, shape (K,)."""

    trace: NDArray[np.float64]
    """Positions of the first chain then, shape (K, N, 3)."""


def anneal(
    logs: Sequence[SensingLog], params: Sequence[JointParams], known: Sequence[Equations]
) -> list[Annealed]:
    """Anneal structures side by side.

    Args:
        logs: One log a structure, all of one batch key with their settings.
        params: Settings for each.
        known: Equations of each.
    """
    return Swarm(logs, params, known).run()


class Swarm:
    """All chains of all structures on the device."""

    def __init__(
        self, logs: Sequence[SensingLog], params: Sequence[JointParams], known: Sequence[Equations]
    ) -> None:
        memory = Memory(backend.current(), on_host=False)
        self.chains = params[0].chains
        self.schedule = params[0]
        self.size = [log.robot_count for log in logs]
        self.start = np.cumsum([0, *self.size])
        robots, docks = self.start[-1], len(logs[0].dock_offset_body)
        copies = self.chains * robots
        arm = np.concatenate(
            [dock_offsets(g.orientation_wxyz, g.dock_offset_body / g.dock_radius) for g in logs]
        )
        first = np.concatenate(
            [_first_guess(g, e, params[0]) for g, e in zip(logs, known, strict=True)], axis=1
        )
        structure = np.repeat(np.arange(len(logs)), self.size)
        structure = (np.arange(self.chains)[:, None] * len(logs) + structure).ravel()
        dock = np.empty((1, copies, docks, 4))
        dock[0, ..., :3] = (first[:, :, None] + arm).reshape(copies, docks, 3)
        dock[0, ..., 3] = structure[:, None]
        self.neighbors = NeighborList(
            memory,
            first.reshape(-1, 3),
            self._touching(logs, robots),
            docks=docks,
            reach=float(np.linalg.norm(arm, axis=2).max()),
            cutoff=(1.0 + SKIN) * SPACING,
        )
        self.dock = memory.upload(dock.reshape(1, -1, 4))
        self.equations = [
            memory.upload(values)
            for values in (
                np.concatenate([np.arange(size) for size in self.size]),
                np.repeat([int(p.non_overlap) for p in params], self.size),
                np.repeat([WIDTH**-2 if p.robust else 0.0 for p in params], self.size),
                *_by_robot(known, self.start),
                np.concatenate([e.place for e in known]),
                np.concatenate([e.precision for e in known]),
                arm,
            )
        ]
        self.position = memory.upload(first.reshape(-1, 3))
        self.velocity, self.force, self.total = (memory.reals(copies, 3) for _ in range(3))
        self.mass, self.square_total = memory.reals(copies), memory.reals(copies)
        for array in (self.velocity, self.force, self.total, self.square_total):
            array.fill(0.0)
        self.mass.fill(1.0)
        self.neighbors.row_count.fill(0)
        self.stale = 0

    def run(self) -> list[Annealed]:
        """Take all steps."""
        annealing, holding = self.schedule.steps, self.schedule.hold_steps
        steps = annealing + holding
        frames = np.unique(np.linspace(0, steps, FRAMES).astype(np.int64))
        trace = []
        for t in range(steps + 1):
            if t in frames:
                trace.append(self.positions()[0])
            if t < steps:
                self.step(t, min(t / annealing, 1.0), is_held=t >= annealing)
        last = self.positions()
        if not np.isfinite(last).all() or np.array_equal(trace[0], trace[-1]):
            raise backend.faulty_driver()
        mean = self.total.to_numpy().reshape(self.chains, -1, 3).astype(np.float64) / holding
        square = self.square_total.to_numpy().reshape(self.chains, -1).astype(np.float64) / holding
        spread = np.maximum(square - (mean**2).sum(axis=2), 0.0)
        return [
            Annealed(
                mean=mean[:, a:b],
                spread=spread[:, a:b],
                last=last[:, a:b],
                iteration=frames,
                trace=np.array([frame[a:b] for frame in trace]),
            )
            for a, b in zip(self.start[:-1], self.start[1:], strict=True)
        ]

    def step(self, t: int, progress: float, *, is_held: bool) -> None:
        """Take one step, the first of an annealing at progress 0, the last at 1."""
        begin, end = self.schedule.start_tolerance, self.schedule.end_tolerance
        rows = self.neighbors
        tolerance = begin * (end / begin) ** progress
        if tolerance < SOLID_BELOW and t >= self.stale:
            rows.build(self.dock, 0)
            sort_rows(*rows.strides, rows.row, rows.row_count)
            self.stale = t + min(max(int(LIST_REACH / tolerance), 1), LIST_STEPS)
        take_step(
            rows.docks, rows.own_bits, *rows.strides, self.schedule.seed, t, tolerance,
            int(is_held), *self.equations, rows.row, rows.row_count, self.position, self.velocity,
            self.force, self.mass, self.dock, self.total, self.square_total,
        )  # fmt: skip

    def positions(self) -> NDArray[np.float64]:
        """Positions of every chain, shape (chains, N, 3)."""
        position: NDArray[np.float64] = self.position.to_numpy().astype(np.float64)
        return position.reshape(self.chains, -1, 3)

    def _touching(self, logs: Sequence[SensingLog], robots: int) -> NDArray[np.int64]:
        """Contacts of all chains, rows of (robot i, dock, robot j, dock)."""
        shifts = [np.array([a, 0, a, 0]) for a in self.start[:-1]]
        rows = [log.contacts + shift for log, shift in zip(logs, shifts, strict=True)]
        copies = np.arange(self.chains)[:, None, None] * np.array([robots, 0, robots, 0])
        return np.asarray((np.concatenate(rows)[None] + copies).reshape(-1, 4), np.int64)


def _by_robot(
    known: Sequence[Equations], start: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Every contact from both its sides, robot after robot: start, partner, shift, variance."""
    robot = np.concatenate([e.robot + a for e, a in zip(known, start[:-1], strict=True)])
    other = np.concatenate([e.other + a for e, a in zip(known, start[:-1], strict=True)])
    shift = np.concatenate([e.shift for e in known])
    variance = np.concatenate([e.variance for e in known])
    order = np.argsort(np.concatenate([robot, other]), kind="stable")
    count = np.bincount(np.concatenate([robot, other]), minlength=start[-1])
    partner = np.concatenate([other, robot])[order]
    room = 0 if len(order) else 1  # a kernel takes no empty array
    return (
        np.concatenate([[0], count.cumsum()]),
        np.pad(partner, (0, room)),
        np.pad(np.concatenate([shift, -shift])[order], ((0, room), (0, 0))),
        np.pad(np.tile(variance, 2)[order], (0, room), constant_values=1.0),
    )


def _first_guess(log: SensingLog, known: Equations, params: JointParams) -> NDArray[np.float64]:
    """Put each robot where its contacts with earlier ones meet, give or take a dock radius.

    Returns:
        Positions, another one for each chain, shape (chains, N, 3).
    """
    robot = np.arange(log.robot_count)
    draw = 3 * np.arange(params.chains)[:, None, None] + np.arange(3)
    guess = random.normal(params.seed, "first guess", robot[:, None], draw)
    order = np.argsort(known.robot, kind="stable")
    rows = np.split(order, np.searchsorted(known.robot[order], robot[1:]))
    anchor = log.anchor_position / log.dock_radius
    is_known = known.precision > 0.0
    guess[:, 0] = anchor
    for i in range(1, log.robot_count):
        mine = rows[i]
        met = guess[:, known.other[mine]] - known.shift[mine] if len(mine) else anchor[None, None]
        guess[:, i] += met.mean(axis=1)
        guess[:, i, is_known[i]] = known.place[i, is_known[i]]
    return guess
