"""Constants of the tracker, each with its unit and its reason. Lengths in R.

Chosen on towers and cantilevers of the seeds 5000 to 5009, which no result is reported on.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AnnealSettings:
    """When the whole structure is annealed."""

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


TIMES = AnnealSettings()
