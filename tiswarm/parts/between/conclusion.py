"""What robots found out by themselves, as an estimate."""

from dataclasses import dataclass

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.mixture.verdict import assess, rms
from tiswarm.parts.between.settings import DistributedParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog


@dataclass(frozen=True, kw_only=True)
class Found:
    """What N robots know of themselves, and what that took. Lengths in R, from the anchor."""

    position: Reals
    """Where each robot takes itself to be; at the anchor if it does not know, shape (N, 3)."""

    at_join: Reals
    """Position that each robot took itself to have as it joined, shape (N, 3)."""

    sd: Reals
    """Standard deviation of each position, as its robot knows it, shape (N,)."""

    lost: Bools
    """Robots that do not know where they are, shape (N,)."""

    doubtful: Bools
    """Robots that doubt where they are, shape (N,)."""

    traffic: dict[str, Reals]
    """As in `Estimate.traffic`."""

    steps: int
    """Number of joins."""

    reason: str
    """Why the search is not to be relied on."""


def estimate_of(log: SensingLog, params: DistributedParams, found: Found) -> Estimate:
    """Make an estimate of what robots know, with the verdicts that their rows allow."""
    position, unit = found.position, log.dock_radius
    problem = pose_problem(log, params)
    sd = found.sd.copy()
    sd[found.lost] = np.linalg.norm(position, axis=1).max(initial=0.0)
    gap = problem.residual(position[None], np.zeros((1, len(position))))
    is_guess = problem.untied | found.lost
    verdicts = assess(log, params.cues, position, is_guess=is_guess, sd=sd)
    robots, doubtful = len(found.doubtful), int(found.doubtful.sum())
    if robots > 1:
        doubts = f"{doubtful} of {robots} robots doubt their positions"
        verdicts = verdicts.doubted(doubts if doubtful else found.reason)
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit,
        disconnected=is_guess,
        sd=sd * unit,
        **verdicts._asdict(),
        iteration=np.array([found.steps]),
        trace=position[None] * unit,
        at_join=found.at_join * unit,
        residual=rms(gap) * unit,
        doubtful=found.doubtful,
        traffic=found.traffic,
    )
