"""Constants of chains near one robot, each with its unit and its reason. Lengths in R.

Chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is reported on.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ChainSettings:
    """How robots near one are annealed."""

    end_sigma: float = 0.01
    """Square root of the temperature at which annealing ends [R]."""

    tempered: float = 4.0
    """Divisor of costs by which ends of chains weigh in standard deviations [1]: few chains meet
    few of the likely minima."""

    extension: float = 1.5
    """Gain in log-likelihood for each R more between robots that share a row [R^-1], shared among
    the rows of a robot, as in `joint`."""


CHAINS = ChainSettings()
