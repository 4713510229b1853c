"""Constants of chains, each with its unit and its reason. Lengths in R.

A class says where its values are from, a field where its own is from elsewhere. "Chosen" values
gave the least error among a few tried, "fitted" ones minimize a misfit; both were found on training
structures, of seeds that no result is reported on; see `docs/notes/`.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AnnealSchedule:
    """How chains are annealed, beside what `JointParams` sets. Chosen on training structures."""

    coldest: float = 0.01
    """Square root of the end temperature where measurements are sharp and sufficient [R]. A lower
    end temperature separates solutions that miss measurements by little."""

    warmest: float = 0.025
    """Square root of the end temperature where measurements are neither [R]: colder chains sample
    less of what is not measured."""

    underdetermined: float = 0.05
    """Underdetermination from which on to end at `warmest` [1]: too little is measured to gain from
    colder chains."""

    ranged: float = 2.0
    """Least square root of the start temperature where ranges alone tie robots to each other [R]:
    they leave more minima to escape from. See `docs/notes/ranges.md`."""

    growing: float = 0.1
    """Share of the steps in which docks grow to their full size [1], so that robots pass through
    each other at first."""

    smallest: float = 0.1
    """Size of docks in the first step, as a part of their full size [1]. Docks that are solid at
    once push each other out of the initial heap faster than friction takes the heat away."""

    reinitialize_from: float = 0.4
    """Share of the steps after which lost robots are initialized anew [1]."""

    lost: float = 4.0
    """A contact whose docks are farther than D + this apart is lost [R]: docks that far apart no
    longer find each other."""

    lost_sd: float = 3.0
    """Least miss of a lost contact [standard deviations]: uncertain ones may be missed by more than
    `lost`."""

    frames: int = 24
    """Frames of the trace [1], between which lost robots are looked for."""

    launch: int = 3000
    """Kernel-launch overhead [robot steps], by which work is divided among threads. Measured."""

    restarts: int = 2
    """Times that a chain that failed is annealed again [1], each time in steps half as long."""

    join_memory: float = 5.0
    """Decay length of the join-location prior [joins]: robots join near the last ones that did."""

    trilateration: int = 30
    """Steps in which the initial guess of a robot meets its ranges [1]."""

    join_window: int = 200
    """Joins that the prior looks back on [joins]: 40 decay lengths. The rest has no weight."""

    join_variance: float = 3.0
    """Mean square error of a robot placed by this prior [variances of the prior]. Fitted."""


ANNEALING = AnnealSchedule()

DISREGARDED_SD = 1.0
"""Standard deviation of an orientation that does not count, about each axis [rad]: a drift of 3 deg
a stance over a walk of twenty stances."""
