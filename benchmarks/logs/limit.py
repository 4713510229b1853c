"""The least error that a log allows: that of the least cost nearest to the truth."""

from typing import Literal, NamedTuple

import numpy as np

from benchmarks.logs.grade import error
from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.cost import SETTLED, Cost
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.observability import observability
from tiswarm.records.sensing_log import SensingLog

ROUNDS, MOST_CALLS = 30, 40
"""Rounds of the optimizer in a call, and calls until it must have converged."""

PARAMS = JointParams()

_TURNS = 3
"""Motions of a structure in a free frame, about its anchor."""


class Limit(NamedTuple):
    """What can be known from one log."""

    tied: Bools
    """Robots that measurements tie to the anchor, shape (N,)."""

    floppy: int
    """Motions within the structure that no measurement resists, but that docks must not overlap."""

    optimum: float
    """RMSE of tied robots at the least cost nearest to the truth [log unit]."""


def tied_robots(log: SensingLog) -> Bools:
    """Find the robots that measurements tie to the anchor, shape (N,)."""
    return ~observability(log, PARAMS.cues).disconnected


def optimum(log: SensingLog, truth: Reals) -> Reals:
    """Minimize the cost of `joint` from the truth, until it no longer falls.

    The cost is the chi-square of all measurements under Cauchy's loss, squared overlaps of docks,
    and priors.

    Returns:
        Centers at the minimum [log unit], shape (N, 3).
    """
    problem = pose_problem(log, PARAMS)
    start = truth / log.dock_radius, np.zeros(len(truth))
    cost = Cost(
        log,
        problem.rows.associated(*start),
        yaw_precision=problem.yaw_precision,
        links=problem.connections,
        robust_sd=ROBUST_SD,
    )
    least, turn = np.inf, None
    for _ in range(MOST_CALLS):
        state, linear = cost.refine(start, ROUNDS, turn=turn)
        if linear.cost > least - SETTLED:
            break
        start, turn, least = (state.position, state.yaw), state.turn, linear.cost
    return start[0] * log.dock_radius


def limit(log: SensingLog, truth: Reals, frame: Literal["known", "free"]) -> Limit:
    """Find what can be known from a log.

    Args:
        log: What was sensed.
        truth: True centers [log unit], shape (N, 3).
        frame: As for `grade.error`.
    """
    seen = observability(log, PARAMS.cues, truth, yaw_unknown=log.yaw_bias > 0.0)
    tied = ~seen.disconnected
    least = error(optimum(log, truth)[tied], truth[tied], frame)
    whole = _TURNS if frame == "free" else 0
    return Limit(tied, (seen.floppy_modes or 0) - whole, least)
