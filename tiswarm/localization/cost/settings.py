"""Constants of the cost and of steps toward its minima, each with its unit and its reason.

Those of neighborhoods and candidates were chosen on towers and cantilevers of the seeds 5000 to
5009, which no result is reported on. Lengths in R.
"""

from dataclasses import dataclass

OVERLAP_SD = 0.05
"""Overlap of two docks that counts like a measurement missed by one standard deviation [R]."""

EXTENSION = 1.5
"""Gain in log-likelihood for each R more between robots in contact [R^-1]: robots climb as far as
they can, so that most configurations that fit are folded closer than what they build."""

ROBUST_SD = 3.0
"""Width of the robust loss [standard deviations]: where a measurement begins to give way."""


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

    alike: float = 0.1
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


CANDIDATES = CandidateSettings()
NEIGHBORS = NeighborhoodSettings()
