"""Estimates while robots join, by the class `Tracker` and the method `online`.

Here are the settings of `online` and constants of the tracker, each with its unit and its reason,
lengths in R. Constants were chosen on towers and cantilevers of the seeds 5000 to 5009, which no
result is reported on.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass

from tiswarm.base.params import STRICT
from tiswarm.localization.settings import ChiSquareParams, CuesOfNamedDocks, JointParams

_JOIN_S = 0.07
"""Processor time of a join [s]."""


@checked_dataclass(frozen=True, kw_only=True, config=STRICT)
class OnlineParams(ChiSquareParams):
    """What a tracker does at a join, beside solving for the robots near the one that joined."""

    module: ClassVar = "tiswarm.localization.online.tracker"
    calls: ClassVar = JointParams

    method: Literal["online"] = "online"
    """Name of the method."""

    cues: CuesOfNamedDocks = CuesOfNamedDocks()
    """Cues in use, each of them on or off; all contacts name their docks."""

    solve_yaw: Literal[False] = False
    """No bias of yaw is solved for."""

    flip_axes: None = None
    """Orientations stay as sensed: a tracker takes robots line by line."""

    anneal_growth: Annotated[float, Field(gt=0.0)] = 0.1
    """Growth of the structure after which it is annealed again, in its size at the last time
    [1]."""

    chains: Annotated[int, Field(ge=1, le=1000)] = 4
    """Annealings then, each from the present estimate."""

    steps: Annotated[int, Field(ge=1, le=10_000_000)] = 500
    """Steps of each annealing."""

    hold_steps: Annotated[int, Field(ge=1, le=10_000_000)] = 200
    """Steps at the end temperature, over which positions are averaged."""

    start_sigma: Annotated[float, Field(gt=0.0)] = 0.4
    """Square root of the temperature at which annealing begins [R]: warm enough for mirror images
    of single robots to be tried, and cold enough for the structure to keep its shape."""

    @property
    def joining(self) -> str:
        """Class that places robots as they join."""
        return "Tracker"

    def seconds(self, robots: int) -> float:
        """Estimate the processor time of so many joins [s]."""
        return _JOIN_S * robots


@dataclass(frozen=True, kw_only=True)
class AnnealSettings:
    """When the structure is annealed, and how much of it."""

    fewest: int = 4
    """Robots from which on there is something to anneal [1]."""

    surprised_growth: float = 0.03
    """Growth since the last time after which a surprise that is left is a reason [1]."""

    searched: int = 30
    """Robots up to which `joint` searches the structure anew where a surprise is left even then
    [1]: in more, false contacts would ask for it again and again."""

    draws: int = 16
    """Draws of all errors from which variances are computed then [1]: three coordinates of each
    make a standard deviation certain to a tenth."""

    rounds: int = 2
    """Steps toward the minimum from the best end [1]. Joins that follow go on from there."""

    whole: int = 100
    """Robots up to which all are annealed [1]: wrong images of the first ones shift all others."""


@dataclass(frozen=True, kw_only=True)
class CandidateSettings:
    """Where a robot that joins may be."""

    starts: int = 48
    """Starts on the sphere that the sharpest distance leaves [1]."""

    rounds: int = 10
    """Steps from each [1]."""

    settled: float = 1e-3
    """Longest step below which no more are taken [R]."""

    merge_every: int = 3
    """Steps after which starts that have come close go on as one [1]."""

    merge_distance: float = 0.1
    """Distance up to which they are close [R]."""

    damping: float = 1.0
    """Precision that stops motions which no row resists [R^-2]."""

    longest_step: float = 1.0
    """Longest step in a round [R]."""

    distinct: float = 0.25
    """Distance from which on two ends are two candidates [R]."""

    worst: float = 80.0
    """Cost beyond the best one's up to which a candidate is kept [1]."""

    most: int = 8
    """Candidates kept [1]."""

    likely: float = 8.0
    """Cost beyond the best one's up to which the robots nearby are solved for with a candidate, so
    that it enters the mean [1]."""

    rival: float = 0.1
    """Weight from which on solutions that put a robot elsewhere speak against where it is [1]: nine
    of ten estimates are to be right."""


@dataclass(frozen=True, kw_only=True)
class NeighborhoodSettings:
    """Robots that are solved for as another one joins."""

    most: int = 60
    """Robots solved for [1]."""

    rounds: int = 3
    """Linear problems solved [1], each at where the last one led."""

    radius: float = 3.2
    """Radius within which a step is trusted at first [R]: it stops motions that no row resists."""

    settled: float = 0.2
    """Gain of a step, as predicted, below which none is taken [1]."""

    open_precision: float = 0.25
    """Precision of positions that nothing determines, for their sd [R^-2]: a robot that turns about
    a contact is within about 2 R."""

    loose: float = 0.1
    """Standard deviation by the linear problem, in the root mean square distance from all robots,
    from which on a robot with ranges may turn freely [1]: on a circle the problem is not linear."""

    longest_step: float = 0.7
    """Longest step of a robot in a round [R]."""

    surprise_sd: float = 4.0
    """Excess of the chi-square of a robot's rows that chance explains [standard deviations]."""

    overlap_sd: float = 3.0
    """Overlap of its docks that chance explains [standard deviations]."""

    gain: float = 4.0
    """Cost by which an exchange of a robot with another of its candidates must pay [1]."""

    tried: int = 8
    """Candidates of robots nearby that are tried after a surprise [1]."""


TIMES = AnnealSettings()
CANDIDATES = CandidateSettings()
NEIGHBORS = NeighborhoodSettings()
