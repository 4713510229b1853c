"""Constants of the joint method, each with its unit, its reason and where its value is from.

"Fitted" values were found on training structures, of seeds that no result is reported on; see
`docs/notes/`. Lengths in R.
"""


class AnnealSchedule:
    """How chains are annealed, beside what `JointParams` sets. Chosen on training structures."""

    coldest: float = 0.01
    """Square root of the end temperature where measurements are sharp and sufficient [R]. A lower
    end temperature separates solutions that miss measurements by little."""

    warmest: float = 0.025
    """The same where they are not [R]: colder chains sample less of what is not measured."""

    underdetermined: float = 0.05
    """Underdetermination from which on to end at `warmest` [1]."""

    ranged: float = 2.0
    """Least square root of the start temperature where ranges alone tie robots to each other [R].
    Chosen on training structures, see `docs/notes/ranges.md`."""

    outlier_sd: float = 3.0
    """Width of the robust loss, in standard deviations: where a contact begins to give way."""

    growing: float = 0.1
    """Share of the steps in which docks grow to their full size [1]."""

    reinitialize_from: float = 0.4
    """Share of the steps after which lost robots are initialized anew [1]."""

    lost: float = 4.0
    """A contact whose docks are farther than D + this apart is lost [R]: docks that far apart no
    longer find each other."""

    lost_sd: float = 3.0
    """A contact is lost only if it is missed by this many standard deviations, too."""

    frames: int = 24
    """Frames of the trace."""

    launch: int = 3000
    """Kernel-launch overhead, in robot steps; measured."""

    restarts: int = 2
    """How often a chain that failed is annealed again, each time in steps half as long."""

    join_memory: float = 5.0
    """Decay length of the join-location prior [joins]: robots join near the last ones that did."""

    trilateration: int = 30
    """Steps in which the first guess of a robot meets its ranges."""

    join_window: int = 200
    """Joins that the prior looks back on; the rest has no weight left."""

    join_variance: float = 3.0
    """Mean square error of a robot placed by this prior, in variances of the prior. Fitted."""


class ConvergenceTest:
    """Which chains count and whether they meet the measurements. Chosen on generated structures."""

    chance_sd: float = 5.0
    """Standard deviations of a chi-square that chance explains. A chain whose chi-square exceeds
    the best one's by more is trapped."""

    outlier_sd: float = 5.0
    """Standard deviations beyond which a measurement is an outlier, if every converged chain misses
    it by as much."""

    jury: int = 3
    """Chains at least that must agree on an outlier, where there are so many: a single chain tears
    contacts that are right."""

    most_torn: float = 0.005
    """Share of contacts, beside outliers, that may be missed by `outlier_sd` [1]."""

    torn_anyway: int = 2
    """Such contacts that any structure may have."""

    most_outliers: float = 0.2
    """Share of contacts that can be outliers [1]; where more are, the chains failed."""

    most_chains: float = 0.5
    """Share of the chains that must miss a contact before it bounds no distance [1]."""

    runaway: float = 2.0
    """Kinetic temperature, relative to its target, from which on a chain failed [1]."""


class MixtureSettings:
    """How ends of chains are ranked and mixed. Chosen on training structures."""

    tempered: float = 2.0
    """Standard deviation by which measurements may be missed as chains are ranked, in that of their
    end temperature [1]."""

    tepid: float = 0.5
    """The same as solutions are refined: less than the search leaves as strain."""

    rounds: int = 3
    """Rounds in which the end of a chain is moved to a minimum."""

    unfolding: float = 0.1
    """Standard deviation by which measurements may be missed at first where a start is not the end
    of a chain, in the median of measured distances [1]."""

    warm_rounds: int = 15
    """Rounds at that temperature."""

    fewest: float = 6.0
    """Effective number of ends that the mixture is to have, if their costs are alike."""

    chance: float = 4.0
    """Width of a chi-square, in the largest divisor of costs [1]."""

    heats: int = 6
    """Divisors that are tried."""

    alike: float = 2.0
    """Excess of a cost over the least one up to which both count as the same, in widths of a
    chi-square [1]."""

    spare: float = 0.25
    """Least degrees of freedom of a chi-square, in unknown coordinates [1]: where measurements are
    hardly more than these, the search leaves as much."""

    least_weight: float = 1e-3
    """Weight below which an end does not count [1]."""


class SdCalibration:
    """From the variance of chains to `sd`.

    Fitted on training structures of ReactiveBuild's rules (seeds 1000 to 1059) and generated ones.
    """

    thermal_variance: float = 40.0
    """Within-chain variance due to temperature alone, in units of T."""

    sharp: float = 0.61
    """Standard deviations of an error per one of a chain, without noise [1]."""

    sharp_power: float = 0.15
    """Power of sigma / `AnnealSchedule.warmest` that these go with."""

    shared_noise_power: float = 0.193
    shared_noise_at: float = 11.4
    """Power by which deviations below so many sigma are raised, and larger ones lowered, where
    measurements are nothing but noise: noise of a walk's early stances is in many of them at once,
    which chains do not know."""

    underdetermined: float = 1.0
    """Relative increase of errors where nothing is measured: chains sample less of it than there
    is."""

    shared: float = 4.0
    """Weight of the displacement that a robot shares with all others, beside its own. Few contacts,
    those of the anchor, decide where the whole structure is, and chains agree on that more often
    than they are right."""

    hinged: float = 0.3
    """Share of the variance if contacts were hinges, beside that of the chains [1]."""


class RefineSettings:
    """Generalized least squares from where the chains ended. Chosen on training structures."""

    rounds: int = 4
    """Linear problems solved at most, each at where the last one led."""

    prior_sd: float = 1.2
    """Prior width around the chain mean, in chain sd; multiplied by sqrt(N), since all robots may
    share an error and move together."""

    least_prior: float = 0.05
    """Least prior width [R]."""

    sd_scale: float = 0.97
    """Standard deviations of an error per one of the draws. Fitted."""

    most_yaw_bias: float = 0.2
    """Largest standard deviation of a yaw bias [rad] with which measurements hold robots: chains
    that are farther off end in different minima."""

    open_sd: float = 2.0
    """A robot that the linear problem leaves more uncertain than so many chain sd stays where its
    chains put it: overlaps and the extension prior hold it, which chains know and the linear
    problem does not."""

    linear_sd: float = 0.3
    """The same holds only for robots that it leaves more uncertain than this [R]: in motions that
    small, neither matters, and chains agree more often than they are right."""
