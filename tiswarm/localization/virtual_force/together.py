"""The paper's virtual forces on all robots at once, instead of one after the other.

Every robot starts where the chains of contacts with the fewest links lead from the anchor. Then the
whole swarm steps, see `tiswarm.engine.relax`: contacts attract, all other docks repel where they
overlap, heights pull. Inertia carries robots over obstacles and spreads what one contact says to
robots many contacts away. Repulsion acts first and ends at 0, as in Algorithm 1. The anchor
is fixed, planar robots stay at its y.

Robots step on the device that a user chooses. On a processor in f64, structures that one thread
steps through by itself share a batch. All others step one after the other, each by all threads of
the device.
"""

from collections.abc import Callable, Hashable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.base.progress import ignore
from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets
from tiswarm.engine.relax import SMALL, PreparedSwarm
from tiswarm.localization.mixture.verdict import assess
from tiswarm.localization.settings import VirtualForceParams
from tiswarm.measurements.contacts import contact_count, disconnected, parts, reach, stand_across
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import SPACING
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_FRAMES = 30
"""Frames of the trace after the first; rows of neighbors are made anew at each."""

_TINY = 1e-9
_UP = np.array([0.0, 0.0, 1.0])


class _Body(NamedTuple):
    """Docks of a robot, in R."""

    dock_offset_body: Reals
    spacing: float = SPACING


def batch_key(log: SensingLog, params: VirtualForceParams) -> Hashable:
    """Name what logs must share to step in one swarm: gains, docks, and that one thread does it."""
    docks = log.dock_offset_body / log.dock_radius
    alone = None if log.robot_count <= SMALL else log.robot_count
    return (params, docks.shape, docks.tobytes(), alone)


def localize_batch(
    logs: Sequence[SensingLog],
    params: VirtualForceParams,
    heights: Sequence[Reals],
    planar: Sequence[Bools],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Localize structures of the same `batch_key`.

    Args:
        logs: What each swarm sensed.
        params: Settings of all.
        heights: Heights of centers [R], NaN where unknown, shape (N,) for each log.
        planar: Whether robots stay at the anchor's y, shape (N,) for each log.
        on_progress: Called with the share of the work that is done.

    Returns:
        One estimate a log. The residual is the root mean square step of the robots.
    """
    running = backend.device()
    # In f32 the unit of places, and on a card the age of rows, would depend on the company.
    is_shared = not running.on_card and running.precision == "f64"
    share = 1 if is_shared and logs[0].robot_count <= SMALL else len(logs)
    estimates: list[Estimate] = []
    for group in np.array_split(np.arange(len(logs)), share):
        done = len(estimates)

        def report(part: float, done: int = done, size: int = len(group)) -> None:
            on_progress((done + part * size) / len(logs))

        estimates += _step(
            [logs[n] for n in group], params, [heights[n] for n in group],
            [planar[n] for n in group], report,
        )  # fmt: skip
    return estimates


def _step(
    logs: Sequence[SensingLog],
    params: VirtualForceParams,
    heights: Sequence[Reals],
    planar: Sequence[Bools],
    on_progress: Callable[[float], None],
) -> list[Estimate]:
    """Localize structures in one swarm."""
    chosen = params.together
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
        height=np.concatenate(heights),
        mobility=along,
        structure=np.repeat(np.arange(len(logs)), np.diff(start)),
        running=backend.device(),
    )  # fmt: skip
    every = -(-chosen.steps // _FRAMES)
    frames = np.array([*range(0, chosen.steps, every), chosen.steps])
    ramp: Reals = np.linspace(1.0 - chosen.repulsion_share, 1.0, chosen.steps, dtype=np.float64)
    trace, moved = [first], [np.zeros(len(first))]
    for before, after in pairwise(frames.tolist()):
        now = swarm.relax(
            attraction_gain=params.attraction_gain,
            parting_gain=params.attraction_gain,
            repulsion_gain=params.repulsion_gain if params.undocked_repulsion else 0.0,
            height_gain=params.height_gain,
            max_step=params.max_step,
            momentum=chosen.momentum,
            ramp=ramp[before:after],
            steps=after - before,
            resume=before > 0,
        )
        trace.append(now.position)
        moved.append(np.linalg.norm(swarm.state.last_step, axis=1))
        on_progress(after / chosen.steps)
    estimates = []
    for log, (a, b) in zip(logs, pairwise(start.tolist()), strict=True):
        untied = disconnected(measure(log, ["contacts", "anchors"]))
        found = assess(log, params.cues, trace[-1][a:b], is_guess=untied)
        moves = np.array([np.sqrt(np.mean(step[a:b] ** 2)) for step in moved])
        estimates.append(
            Estimate(
                robot_id=log.robot_id,
                position=trace[-1][a:b] * log.dock_radius,
                disconnected=untied,
                **found._asdict(),
                iteration=frames,
                trace=np.array([frame[a:b] for frame in trace]) * log.dock_radius,
                residual=moves * log.dock_radius,
                steps=np.where(is_anchor[a:b], 0, chosen.steps),
            )
        )
    return estimates


def _chained(log: SensingLog, is_planar: Bools) -> Reals:
    """Place each robot across from those in contact that are one contact nearer to an anchor.

    Such robots stand on a line with the docks that touch, but at the anchor's y if planar; a robot
    that touches several starts at the mean of where they say. A part without an anchor starts
    above the robot that joined before the part's first one.

    Returns:
        Centers [R], shape (N, 3).
    """
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    part = parts(measure(log, ["contacts"]))
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
    nearer, dock, robot, own = contact[np.lexsort((contact[:, 2], hop[contact[:, 2]]))].T
    shift = arm[nearer, dock] - arm[robot, own]
    across = stand_across(shift)
    # Docks in one place would have no direction to part in.
    across[np.linalg.norm(shift, axis=1) < _TINY] = SPACING * _UP
    levels = np.flatnonzero(np.diff(hop[robot], prepend=0.0, append=np.inf))
    for begin, end in pairwise(levels.tolist()):
        met = position[nearer[begin:end]] + across[begin:end]
        each = np.flatnonzero(np.diff(robot[begin:end], prepend=-1))
        count = np.diff(each, append=end - begin)
        position[robot[begin + each]] = np.add.reduceat(met, each) / count[:, None]
    by_part = untied[np.argsort(part[untied], kind="stable")]
    members = np.split(by_part, np.flatnonzero(np.diff(part[by_part])) + 1) if untied.size else []
    # In join order: the robot that a part starts above may be of another such part.
    for robots in sorted(members, key=lambda robots: int(robots[0])):
        place = position[robots[0] - 1] + SPACING * _UP
        position[robots] += place - position[robots[0]]
    position[is_planar, 1] = position[0, 1]
    return position
