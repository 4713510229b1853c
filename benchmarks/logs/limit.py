"""The least error that a log allows: that of the least cost nearest to the truth."""

from typing import Literal, NamedTuple

import numpy as np

from benchmarks.logs.grade import Known, error
from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import WholeCost
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.observability import observability
from tiswarm.records.sensing_log import SensingLog

ROUNDS, MOST_CALLS = 30, 500
"""Rounds of the optimizer in a call, and calls."""

SETTLED = 1e-5
"""Longest step of a robot in a call at the optimum [dock radii]."""

PARAMS = JointParams()

_TURNS = 3
"""Motions of a structure in a free frame, about its anchor."""


class Limit(NamedTuple):
    """What can be known from one log."""

    known: Known

    floppy: int
    """Motions within the structure that no measurement resists, but that docks must not overlap."""

    optimum: float
    """RMSE of determined robots at the least cost nearest to the truth [log unit]."""


def known_robots(
    log: SensingLog, truth: Reals, frame: Literal["known", "free"]
) -> tuple[Known, int]:
    """Find the robots that measurements tie and determine, and count floppy motions.

    Args:
        log: What was sensed.
        truth: True centers [log unit], shape (N, 3).
        frame: As for `grade.error`; turns of the whole structure in a free one do not count.
    """
    seen = observability(log, PARAMS.used_cues, truth, yaw_unknown=log.yaw_bias > 0.0)
    tied, modes = ~seen.disconnected, (seen.floppy_modes or 0) - _TURNS * (frame == "free")
    floppy = np.zeros_like(tied) if seen.floppy is None or not modes else seen.floppy
    return Known(tied, tied & ~floppy), modes


def optimum(
    log: SensingLog,
    truth: Reals,
    counted: Bools,
    *,
    settled: float = SETTLED,
    calls: int = MOST_CALLS,
) -> Reals:
    """Minimize the cost of `joint` from the truth, until some robots no longer move.

    The cost is the chi-square of all measurements under Cauchy's loss, squared overlaps of docks,
    and priors. A call of the optimizer ends as the cost hardly falls, which along a shallow valley
    is far from the minimum.

    Args:
        log: What was sensed.
        truth: True centers [log unit], shape (N, 3).
        counted: Robots that have to come to rest, shape (N,); floppy ones may never.
        settled: Longest step of these in the last call [dock radii].
        calls: Calls of the optimizer at most.

    Returns:
        Centers at the minimum [log unit], shape (N, 3).
    """
    problem = pose_problem(log, PARAMS)
    start = truth / log.dock_radius, np.zeros(len(truth))
    cost = WholeCost(
        log,
        problem.rows.associated(*start),
        yaw_precision=problem.yaw_precision,
        links=problem.connections,
        robust_sd=ROBUST_SD,
    )
    state = cost.at(*start)
    for _ in range(calls):
        before = state.position
        state, _ = cost.refine(state, ROUNDS)
        step = np.linalg.norm(state.position - before, axis=1)[counted].max(initial=0.0)
        if step < settled:
            break
    return state.position * log.dock_radius


def limit(log: SensingLog, truth: Reals, frame: Literal["known", "free"]) -> Limit:
    """Find what can be known from a log.

    Args:
        log: What was sensed.
        truth: True centers [log unit], shape (N, 3).
        frame: As for `grade.error`.
    """
    known, floppy = known_robots(log, truth, frame)
    some = known.determined if known.determined.any() else known.tied
    return Limit(known, floppy, error(optimum(log, truth, some)[some], truth[some], frame))
