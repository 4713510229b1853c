"""The paper's method, Algorithm 1: robots in join order, each refined by virtual forces.

Where the paper leaves a choice open, ours is a parameter or is stated here: the ramp rises
linearly, alpha_t = t / T, so repulsion acts first and attraction last; a step is capped; the error
that the paper's loop tests is what a robot misses its measurements by, since its true error is
unknown to it; a robot that touches no earlier one starts from the first anchor; planar robots, see
`tiswarm.measurements.cues.in_plane`, stay at its y; further anchors are where they are
known to be. The paper says only that
back-propagation would revisit recent robots every ten joins. Its virtual torque gained nothing in
our trials, and is left out.

`localize_batch` places the robots of whole logs, `Localizer` each robot as it joins.

Under the schedule `together` all robots step at once, see `tiswarm.engine.relax`. Every robot
starts where the chains of contacts with the fewest links lead from the anchor. Contacts attract,
all other docks repel where they overlap, heights pull. Inertia carries robots over obstacles and
spreads what one contact says to robots many contacts away. Repulsion acts first and ends at 0. The
anchor is fixed. Robots step on the device that a user chooses. On a processor in f64, structures
that one thread steps through by itself share a batch. All others step one after the other, each by
all threads of the device.
"""

from collections.abc import Callable, Hashable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets
from tiswarm.compute.neighbor_kernels import CellList
from tiswarm.localization.mixture.assessment import assess
from tiswarm.localization.settings import BackPropagation, MethodParams, VirtualForceParams
from tiswarm.localization.virtual_force import kernels
from tiswarm.measurements.contacts import (
    connected_parts,
    contact_count,
    disconnected,
    reach,
    stand_across,
)
from tiswarm.measurements.cues import in_plane, measure
from tiswarm.measurements.model import SPACING
from tiswarm.records import sensing_format
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import SensedStance, SensingLogBuilder
from tiswarm.records.sensing_log import LISTS, NUMBERS, SensingLog, moved

_NO_SWEEPS = BackPropagation(sweeps=0)

_FRAMES = 30
"""Frames of the trace after the first; rows of neighbors are made anew at each."""

_TINY = 1e-9
_UP = np.array([0.0, 0.0, 1.0])


def batch_key(log: SensingLog, params: VirtualForceParams) -> Hashable:
    """Name what logs must share to be localized in one launch."""
    if params.schedule == "together":
        return _swarm_key(log, params)
    rounds = params.back_propagation or _NO_SWEEPS
    schedule = (params.iterations, params.trace_every, rounds.every, rounds.sweeps, rounds.recent)
    return (len(log.dock_offset_body), *schedule)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[VirtualForceParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures side by side, in one launch.

    Returns:
        One estimate a log. The residual is the root mean square step of the robots. Verdicts are on
        robots that contacts tie to the anchor.
    """
    if params[0].schedule == "together":
        return _localize_together(logs, params[0], on_progress)
    iterations = params[0].iterations
    every = params[0].trace_every
    rounds = params[0].back_propagation or _NO_SWEEPS
    swept = [*range(every, rounds.sweeps, every), rounds.sweeps] if rounds.sweeps else []
    frames = np.array([*range(0, iterations, every), iterations, *(iterations + k for k in swept)])
    start = np.cumsum([0, *(log.robot_count for log in logs)]).astype(np.int32)
    both = list(zip(logs, params, strict=True))
    direction = np.concatenate([_directions(log.orientation_wxyz, p) for log, p in both])
    height = np.concatenate([_heights(log, p) for log, p in both])
    planar = np.concatenate([_planar(log) for log in logs]).astype(np.int32)
    gone = np.concatenate([log.is_gone for log in logs]).astype(np.int32)
    anchor_center = np.concatenate([log.known_position / log.dock_radius for log in logs])
    is_anchor = np.isfinite(anchor_center[:, 0]).astype(np.int32)
    measured = kernels.LogArrays(
        *_contacts_by_robot(logs), direction, height, planar, gone, is_anchor
    )
    # Anchors are known; all others are NaN until the kernel places them.
    placed = kernels.PlacedRobots(np.concatenate([_offsets(log) for log in logs]), anchor_center)
    trace = kernels.Trace.allocate(len(frames), len(placed.position), np.float64)
    recent = rounds.recent or len(placed.position)
    docks = max(log.robot_count for log in logs) * len(logs[0].dock_offset_body)
    kernels.localize_in_join_order(
        iterations, rounds.every, rounds.sweeps, recent, every,
        np.array(list(map(_gains, params))), start,
        np.zeros(len(logs), np.int32), *measured, *CellList.allocate(len(logs), docks), *placed,
        *trace,
    )  # fmt: skip
    on_progress(1.0)
    # The kernel places every robot: one that it did not says that it never ran.
    if np.isnan(placed.position).any():
        raise backend.faulty_driver()
    estimates = []
    for (log, p), a, b in zip(both, start[:-1], start[1:], strict=True):
        older = slice(a, max(a, b - recent))  # robots that the last round left where they were
        trace.position[frames > iterations, older] = placed.position[older]
        trace.step_length[frames > iterations, older] = 0.0
        scaled = trace.position[:, a:b] * log.dock_radius
        steps = trace.step_length[:, a:b] * log.dock_radius
        untied = disconnected(measure(log, ["contacts", "anchors"]))
        assessment = assess(log, p.used_cues, trace.position[-1, a:b], is_guess=untied)
        estimates.append(
            Estimate(
                robot_id=log.robot_id,
                position=scaled[-1],
                **assessment.fields(untied, log.dock_radius),
                iteration=frames,
                trace=scaled,
                residual=np.sqrt(np.mean(steps**2, axis=1)),
                steps=trace.steps[a:b],
            )
        )
    return estimates


class Localizer:
    """Places robots one by one as they join, each at once and for good.

    The kernel is the one that localizes whole logs, so the positions are the same, bit for bit.

    >>> header = {
    ...     "format": "tiswarm-sensing",
    ...     "version": 1,
    ...     "dock_radius": 1.0,
    ...     "length_unit": "R",
    ...     "dock_offsets": [[1.5, 0, 0], [-0.75, 1.3, 0], [-0.75, -1.3, 0]],
    ...     "anchor_position": [0, 0, 1],
    ...     "ground_z": 0.0,
    ... }
    >>> level = [1, 0, 0, 0]
    >>> swarm = Localizer(header)
    >>> swarm.join({"robot": 0, "orientation_wxyz": level, "contacts": []}).tolist()
    [0.0, 0.0, 1.0]
    >>> place = swarm.join({"robot": 1, "orientation_wxyz": level, "contacts": [[0, 0, 1]]})
    >>> len(swarm.positions)
    2
    """

    def __init__(
        self,
        header: sensing_format.Line | sensing_format.HeaderLine,
        params: MethodParams | None = None,
        *,
        capacity: int = 10_000,
    ) -> None:
        """Prepare for robots to join.

        Args:
            header: First line of a sensing file.
            params: Settings of `virtual-force`; its defaults if None.
            capacity: Robots that there is room for.

        Raises:
            InputError: the header is malformed, or robots cannot be placed one by one this way.
        """
        chosen = VirtualForceParams() if params is None else params
        if not isinstance(chosen, VirtualForceParams):
            raise InputError(
                f"{chosen.method} needs the log of all robots; localize it once they have joined"
            )
        if chosen.schedule == "together":
            problem = "schedule together moves all robots at once; set it to join-order to join"
            raise InputError(problem)
        if chosen.back_propagation is not None:
            problem = "back_propagation moves robots that have been placed; switch it off to join"
            raise InputError(problem)
        head = sensing_format.parse_header(header)
        self._params = chosen
        self._unit = head.dock_radius
        self._builder = SensingLogBuilder(head)
        self._head = head
        self._dock_body = np.array(head.dock_offsets, np.float64) / self._unit
        docks = len(self._dock_body)
        self._count = 0
        self._cells = CellList.allocate(1, capacity * docks)
        self._contact_start = np.zeros(capacity + 1, np.int32)
        self._direction = np.zeros((capacity, 3))
        self._height = np.full(capacity, np.nan)
        self._is_planar = np.zeros(capacity, np.int32)
        self._is_anchor = np.zeros(capacity, np.int32)
        self._robots = kernels.PlacedRobots(
            np.zeros((capacity, docks, 3)), np.full((capacity, 3), np.nan)
        )
        self._anchor = np.array(head.anchor_position)

    @property
    def log(self) -> SensingLog:
        """The sensing log of the robots so far."""
        return self._builder.log()

    @property
    def positions(self) -> Reals:
        """Estimated centers in the log's unit, in join order, shape (n, 3)."""
        center: Reals = self._robots.position[: self._count] * self._unit + self._anchor
        return center

    def join(self, robot: sensing_format.Line | sensing_format.RobotLine) -> Reals:
        """Place the next robot; the first one is the anchor.

        Args:
            robot: Its line of a sensing file.

        Returns:
            Its estimated center, in the log's unit, shape (3,).

        Raises:
            InputError: the line is malformed, or there is no more room.
        """
        if self._count == len(self._height):
            problem = f"capacity is {counted(self._count, 'robot')}; make a Localizer with more"
            raise InputError(problem)
        line = sensing_format.parse_robot(robot)
        if line.orientation_wxyz is None:
            problem = "null follows from the lines of later robots, too; localize the whole log"
            raise InputError(problem, key="orientation_wxyz")
        stance = self._builder.add(line)
        n = self._count
        alone = self._alone(line, stance)
        self._robots.dock_offset[n] = dock_offsets(alone.orientation_wxyz, self._dock_body)[0]
        self._direction[n] = _directions(alone.orientation_wxyz, self._params)[0]
        self._height[n] = _heights(alone, self._params)[0]
        self._is_planar[n] = _planar(alone)[0] and self._is_planar[:n].all()
        # The first anchor is at the origin: far from it, numbers lose digits.
        fixed = alone.fixed_position[0] / self._unit if n else np.zeros(3)
        self._is_anchor[n] = np.isfinite(fixed[0])
        self._robots.position[n] = fixed
        self._place(np.array(stance.lists["contacts"], np.int32).reshape(-1, 3))
        self._count += 1
        placed: Reals = self.positions[n]
        return placed

    def _alone(self, line: sensing_format.RobotLine, stance: SensedStance) -> SensingLog:
        """Make a log of one robot, without contacts, relative to the anchor."""
        sensed: dict[str, Any] = {
            name: key.rows([(0, *item) for item in stance.lists[name]])
            for name, key in LISTS.items()
            if key.robot is None
        }
        sensed |= {name: key.numbers([getattr(line, name)]) for name, key in NUMBERS.items()}
        alone = SensingLog(
            robot_id=np.zeros(1, np.int64),
            dock_radius=self._unit,
            dock_offset_body=np.array(self._head.dock_offsets),
            anchor_position=np.array(self._head.anchor_position),
            orientation_wxyz=np.array([stance.orientation_wxyz]),
            contacts=np.empty((0, 4), np.int32),
            ground_z=self._head.ground_z,
            **sensed,
            **self._head.source_arrays(),
        )
        return moved(alone, -self._anchor)

    @backend.exclusive()
    def _place(self, contact: NDArray[np.int32]) -> None:
        """Launch Algorithm 1 for the last robot alone."""
        count = self._count
        iterations = self._params.iterations
        self._contact_start[count : count + 2] = 0, len(contact)
        measured = kernels.LogArrays(
            self._contact_start, contact, self._direction, self._height, self._is_planar,
            np.zeros_like(self._is_planar), self._is_anchor,
        )  # fmt: skip
        capacity = len(self._height)
        trace = kernels.Trace.allocate(2, capacity, np.float64)
        backend.processor()
        kernels.localize_in_join_order(
            iterations, 1, 0, capacity, iterations, np.array([_gains(self._params)]),
            np.array([0, count + 1], np.int32), np.array([count], np.int32), *measured,
            *self._cells, *self._robots, *trace,
        )  # fmt: skip
        if np.isnan(self._robots.position[: count + 1]).any():
            raise backend.faulty_driver()


def _offsets(log: SensingLog) -> Reals:
    """Center to dock of each robot, world frame [R], shape (N, docks, 3)."""
    return dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)


def _gains(params: VirtualForceParams) -> kernels.VirtualForceGains:
    rounds = params.back_propagation or _NO_SWEEPS
    undocked = kernels.DOCKS_OF_NEIGHBORS if params.neighbor_repulsion else kernels.NO_DOCKS
    return kernels.VirtualForceGains(
        attraction_gain=params.attraction_gain,
        repulsion_gain=params.repulsion_gain,
        height_gain=params.height_gain,
        initial_offset=params.initial_offset,
        max_step=params.max_step,
        sweep_gain=rounds.gain,
        sweep_repulsion=rounds.repulsion_share,
        spacing=2.0,
        undocked=float(kernels.ALL_DOCKS if params.undocked_repulsion else undocked),
        height_last=float(params.height_order == "after-docks"),
        stop_error=params.stop_error,
    )


def _heights(log: SensingLog, params: VirtualForceParams) -> Reals:
    """Heights of centers by contact with the ground, else by flips [R], NaN if unknown, (N,)."""
    flips: Reals = log.flip_height / log.dock_radius
    height = flips if params.z_correction else np.full_like(flips, np.nan)
    rows = measure(log, ["ground"] if params.ground else [])
    # Several docks of a robot may stand on the ground: its height is their mean.
    count = np.bincount(rows.robot, minlength=log.robot_count)
    total = np.bincount(rows.robot, rows.places.value - rows.arm[:, 2], log.robot_count)
    return np.where(count > 0, total / np.maximum(count, 1), height)


def _planar(log: SensingLog) -> Bools:
    """Find the planar robots, shape (N,)."""
    planar: Bools = np.isin(np.arange(log.robot_count), log.fixes[in_plane(log), 0])
    return planar


def _directions(orientation_wxyz: Reals, params: VirtualForceParams) -> Reals:
    """Direction of each robot's initial offset, shape (N, 3)."""
    if params.initial_offset_axis == "world":
        return np.tile(_UP, (len(orientation_wxyz), 1))
    return dock_offsets(orientation_wxyz, _UP[None])[:, 0]


def _contacts_by_robot(logs: Sequence[SensingLog]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """First row of each robot, shape (N + 1,), and rows (own dock, robot, dock), shape (2 C, 3)."""
    seen = [np.concatenate([log.contacts[:, [2, 3, 0, 1]], log.contacts]) for log in logs]
    # Earlier robots come first, in the order in which the joiner sensed them.
    seen = [rows[np.argsort(rows[:, 0], kind="stable")] for rows in seen]
    both = zip(logs, seen, strict=True)
    count = [np.bincount(rows[:, 0], minlength=log.robot_count) for log, rows in both]
    start = np.cumsum(np.concatenate([[0], *count])).astype(np.int32)
    return start, np.ascontiguousarray(np.concatenate(seen)[:, 1:], np.int32)


class _Body(NamedTuple):
    """Docks of a robot, in R."""

    dock_offset_body: Reals
    spacing: float = SPACING


def _swarm_key(log: SensingLog, params: VirtualForceParams) -> Hashable:
    """Name what logs must share to step in one swarm: gains, docks, and that one thread does it."""
    from tiswarm.engine import relax  # noqa: PLC0415 - slow to import

    docks = log.dock_offset_body / log.dock_radius
    alone = None if log.robot_count <= relax.SMALL else log.robot_count
    pace = params.together.pace(log.robot_count)
    return (params, pace, docks.shape, docks.tobytes(), alone)


def _localize_together(
    logs: Sequence[SensingLog],
    params: VirtualForceParams,
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures of the same `_swarm_key`.

    Args:
        logs: What each swarm sensed.
        params: Settings of all.
        on_progress: Called with the share of the work that is done [1].

    Returns:
        One estimate a log. The residual is the root mean square step of the robots.
    """
    from tiswarm.engine import relax  # noqa: PLC0415 - slow to import

    running = backend.device()
    # In f32 the unit of places, and on a card the age of rows, would depend on the company.
    is_shared = not running.on_card and running.precision == "f64"
    share = 1 if is_shared and logs[0].robot_count <= relax.SMALL else len(logs)
    estimates: list[Estimate] = []
    for group in np.array_split(np.arange(len(logs)), share):
        done = len(estimates)

        def report(part: float, done: int = done, size: int = len(group)) -> None:
            on_progress((done + part * size) / len(logs))

        estimates += _stepped([logs[n] for n in group], params, report)
    return estimates


def _stepped(
    logs: Sequence[SensingLog],
    params: VirtualForceParams,
    on_progress: Callable[[float], None],
) -> list[Estimate]:
    """Localize structures in one swarm."""
    from tiswarm.engine.relax import PreparedSwarm  # noqa: PLC0415 - slow to import

    chosen = params.together
    steps, momentum = chosen.pace(logs[0].robot_count)
    planar = [_planar(log) for log in logs]
    start = np.cumsum([0, *(log.robot_count for log in logs)])
    first = np.concatenate([_chained(log, flat) for log, flat in zip(logs, planar, strict=True)])
    # A robot of many contacts is pulled by all of them: shorter steps keep it from overshooting.
    mobility = chosen.gain / np.maximum(np.concatenate([contact_count(log) for log in logs]), 1)
    along = np.repeat(mobility[:, None], 3, axis=1)
    is_anchor = np.concatenate([np.isfinite(log.known_position[:, 0]) for log in logs])
    # Anchors stay, and planar robots keep the anchor's y.
    along[is_anchor] = 0.0
    along[np.concatenate(planar), 1] = 0.0
    swarm = PreparedSwarm(
        first,
        np.concatenate([log.orientation_wxyz for log in logs]),
        np.concatenate([log.contacts + base * np.array([1, 0, 1, 0])
                        for log, base in zip(logs, start[:-1], strict=True)]),
        robot=_Body(logs[0].dock_offset_body / logs[0].dock_radius),
        height=np.concatenate([_heights(log, params) for log in logs]),
        mobility=along,
        structure=np.repeat(np.arange(len(logs)), np.diff(start)),
        running=backend.device(),
    )  # fmt: skip
    frames = np.array([*range(0, steps, -(-steps // _FRAMES)), steps])
    ramp: Reals = np.linspace(1.0 - chosen.repulsion_share, 1.0, steps, dtype=np.float64)
    trace = [first]
    moved = [np.zeros(len(first))]
    for before, after in pairwise(frames.tolist()):
        now = swarm.relax(
            attraction_gain=params.attraction_gain,
            parting_gain=params.attraction_gain,
            repulsion_gain=params.repulsion_gain if params.undocked_repulsion else 0.0,
            height_gain=params.height_gain,
            max_step=chosen.max_step,
            momentum=momentum,
            ramp=ramp[before:after],
            steps=after - before,
            resume=before > 0,
        )
        trace.append(now.position)
        moved.append(np.linalg.norm(swarm.state.last_step, axis=1))
        on_progress(after / steps)
    centers = np.array(trace)
    lengths = np.array(moved)
    step_count = np.where(is_anchor, 0, steps)
    return [
        _estimate_of(log, params, frames, centers[:, a:b], lengths[:, a:b], step_count[a:b])
        for log, (a, b) in zip(logs, pairwise(start.tolist()), strict=True)
    ]


def _estimate_of(
    log: SensingLog,
    params: VirtualForceParams,
    frames: Ints,
    center: Reals,
    step_length: Reals,
    steps: Ints,
) -> Estimate:
    """Assess where the robots of a structure ended, and describe the way.

    Args:
        log: What they sensed.
        params: Settings of the method.
        frames: Step of each frame, shape (F,).
        center: Centers in each frame [R], shape (F, N, 3).
        step_length: Length of the last step in each frame [R], shape (F, N).
        steps: Steps of each robot, shape (N,).
    """
    untied = disconnected(measure(log, ["contacts", "anchors"]))
    assessment = assess(log, params.used_cues, center[-1], is_guess=untied)
    moves = np.array([np.sqrt(np.mean(lengths**2)) for lengths in step_length])
    return Estimate(
        robot_id=log.robot_id,
        position=center[-1] * log.dock_radius,
        **assessment.fields(untied, log.dock_radius),
        iteration=frames,
        trace=center * log.dock_radius,
        residual=moves * log.dock_radius,
        steps=steps,
    )


def _chained(log: SensingLog, is_planar: Bools) -> Reals:
    """Place each robot across from those in contact that are one contact nearer to an anchor.

    Such robots stand on a line with the docks that touch, but at the anchor's y if planar; a robot
    that touches several starts at the mean of where they say. A part without an anchor starts
    above the robot that joined before the part's first one.

    Returns:
        Centers [R], shape (N, 3).
    """
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    part = connected_parts(measure(log, ["contacts"]))
    contact = np.concatenate([log.contacts, log.contacts[:, [2, 3, 0, 1]]])
    position = log.known_position / log.dock_radius
    is_anchor = np.isfinite(position[:, 0])
    position[~is_anchor] = position[0]
    untied = np.flatnonzero(~np.isin(part, part[is_anchor]))
    firsts = untied[np.unique(part[untied], return_index=True)[1]]
    start = np.concatenate([np.flatnonzero(is_anchor), firsts])
    pair = log.contacts[:, [0, 2]].astype(np.int64)
    hop = reach(pair, np.ones(len(pair)), part, start)
    # Only contacts that lead away from anchors: each robot follows those nearer to one.
    contact = contact[hop[contact[:, 2]] > hop[contact[:, 0]]]
    by_hop = np.lexsort((contact[:, 2], hop[contact[:, 2]]))
    nearer, nearer_dock, robot, dock = contact[by_hop].T
    shift = arm[nearer, nearer_dock] - arm[robot, dock]
    across = stand_across(shift)
    # Docks in one place would have no direction to part in.
    across[np.linalg.norm(shift, axis=1) < _TINY] = SPACING * _UP
    levels = np.flatnonzero(np.diff(hop[robot], prepend=0.0, append=np.inf))
    for begin, end in pairwise(levels.tolist()):
        met = position[nearer[begin:end]] + across[begin:end]
        first_rows = np.flatnonzero(np.diff(robot[begin:end], prepend=-1))
        count = np.diff(first_rows, append=end - begin)
        total = np.add.reduceat(met, first_rows)
        position[robot[begin + first_rows]] = total / count[:, None]
    by_part = untied[np.argsort(part[untied], kind="stable")]
    members = np.split(by_part, np.flatnonzero(np.diff(part[by_part])) + 1) if untied.size else []
    # In join order: the robot that a part starts above may be of another such part.
    for robots in sorted(members, key=lambda robots: int(robots[0])):
        place = position[robots[0] - 1] + SPACING * _UP
        position[robots] += place - position[robots[0]]
    position[is_planar, 1] = position[0, 1]
    return position
