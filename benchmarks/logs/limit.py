"""The least error that a log allows: that of the least cost nearest to the truth."""

from typing import Literal, NamedTuple

import numpy as np

from benchmarks.logs.grade import error
from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.cost import Cost
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.observability import observability
from tiswarm.records.sensing_log import SensingLog

ROUNDS = 30
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


def limit(log: SensingLog, truth: Reals, frame: Literal["known", "free"]) -> Limit:
    """Minimize the cost of `joint` from the truth.

    The cost is the chi-square of all measurements under Cauchy's loss, squared overlaps of docks,
    and priors.

    Args:
        log: What was sensed.
        truth: True centers [log unit], shape (N, 3).
        frame: As for `grade.error`.
    """
    unit, robots = log.dock_radius, len(truth)
    problem = pose_problem(log, PARAMS)
    start = truth / unit, np.zeros(robots)
    cost = Cost(
        log,
        problem.rows.associated(*start),
        yaw_precision=problem.yaw_precision,
        links=problem.connections,
        robust_sd=ROBUST_SD,
    )
    state, _ = cost.refine(start, ROUNDS)
    seen = observability(log, PARAMS.cues, truth, yaw_unknown=log.yaw_bias > 0.0)
    tied = ~seen.disconnected
    optimum = error(state.position[tied] * unit, truth[tied], frame)
    whole = _TURNS if frame == "free" else 0
    return Limit(tied, (seen.floppy_modes or 0) - whole, optimum)
