"""From the ends of chains to an estimate: weights, solutions, outliers and verdicts.

Here are their constants, each with its unit and its reason. Lengths in R. A class says where
its values are from, as in `tiswarm.localization.chains.views`.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ConvergenceTest:
    """Which chains count and whether they meet the measurements. Chosen on generated structures."""

    chance_sd: float = 5.0
    """Excess of a chi-square that chance explains [standard deviations of a chi-square]. A
    solution whose chi-square exceeds the best one's by more has no weight."""

    outlier_sd: float = 5.0
    """Miss from which on a measurement is an outlier [standard deviations], if every converged
    chain misses it by as much."""

    outlier_rate: float = 0.01
    """Share of contacts and ranges that are wrong, if a log states no more [1]. Assumed."""

    jury: int = 3
    """Least chains that must agree on an outlier [1], where there are so many: a single chain tears
    contacts that are right."""

    most_torn: float = 0.005
    """Share of contacts, beside outliers, that may be missed by `outlier_sd` [1]."""

    torn_anyway: int = 2
    """Such contacts that a structure of any size may have [1]: a share of few contacts is none."""

    most_outliers: float = 0.2
    """Share of contacts that can be outliers [1]; where more are, the chains failed."""

    most_chains: float = 0.5
    """Share of the chains that must miss a contact before it bounds no distance [1]."""

    runaway: float = 2.0
    """Kinetic temperature, relative to its target, from which on a chain failed [1]: its steps
    diverge."""


@dataclass(frozen=True, kw_only=True)
class MixtureSettings:
    """How ends of chains are ranked and mixed. Chosen on training structures."""

    tempered: float = 2.0
    """Standard deviation by which measurements may be missed as chains are ranked, in that of their
    end temperature [1]: chains end in the heat, strained."""

    tepid: float = 0.5
    """Standard deviation by which they may be missed as solutions are refined, in the same unit
    [1]: less than the search leaves as strain."""

    rounds: int = 3
    """Rounds in which the end of a chain is moved to a minimum [1]."""

    unfolding: float = 0.1
    """Standard deviation by which measurements may be missed at first where a start is not the end
    of a chain, in the median of measured distances [1]: such starts are far from a minimum."""

    warm_rounds: int = 15
    """Rounds at the temperature of `unfolding` [1]."""

    fewest: float = 6.0
    """Effective number of ends that the mixture is to have, if their costs are alike [1]."""

    chance: float = 4.0
    """Width of a chi-square, in the largest divisor of costs [1]: that much is chance."""

    heats: int = 6
    """Divisors that are tried [1], from 1 to the largest one."""

    least_cost_sd: float = 2.0
    """Excess of a cost over the least one up to which both count as the same, in standard
    deviations of a chi-square [1]."""

    same: float = 0.1
    """Excess of a cost over that of a minimum, in the latter, up to which chains agree on a misfit
    [1]: wrong measurements are in all chains, and trapped chains differ by more."""

    least_weight: float = 1e-3
    """Weight below which an end does not count [1]."""

    image_fixed: float = 0.25
    """Standard deviation up to which a coordinate counts as known, as a part is mirrored [R]."""

    image_robots: int = 200
    """Robots up to which parts that hang on two are looked for [1]: that takes N^2 steps. Images of
    more robots are moved to a minimum of their own robots first."""

    image_nearest: float = 0.1
    """Distance up to which two minima count as one, where their sd is less [R]."""

    image_shift: float = 0.4
    """Shift from which on an image is refined [R]: uncertainty moves robots by less."""

    image_worst: float = 30.0
    """Cost beyond that of the first place up to which an image is refined [1]: others give way."""

    most_images: int = 16
    """Images that are refined [1]."""


@dataclass(frozen=True, kw_only=True)
class SdCalibration:
    """From the variance of chains to `sd`.

    Fitted on training structures of ReactiveBuild's rules (seeds 1000 to 1059) and generated ones.
    """

    thermal_variance: float = 40.0
    """Within-chain variance due to temperature alone [T], which is no error."""

    sharp: float = 0.61
    """Standard deviations of an error per one of a chain, without noise [1]."""

    sharp_power: float = 0.15
    """Power of sigma / `ANNEALING.warmest` by which `sharp` changes [1]."""

    shared_noise_power: float = 0.193
    """Power of the ratio by which deviations approach `shared_noise_at` sigma, where measurements
    are nothing but noise [1]: noise of a walk's early stances is in many of them at once, which
    chains do not know."""

    shared_noise_at: float = 11.4
    """Deviation below which deviations are raised by that power, and above which they are lowered
    [sigma]."""

    underdetermined: float = 1.0
    """Relative increase of errors where nothing is measured [1]: chains sample too little of it."""

    shared: float = 4.0
    """Weight of the displacement that a robot shares with all others, beside its own [1]. Few
    contacts, those of the anchor, decide where the whole structure is, and chains agree on that
    more often than they are right."""

    chains: float = 0.8
    """Share of the variance of the chains [1]. With 1, generated structures are nearer to their sd,
    and sd of ReactiveBuild's is too large."""

    hinged: float = 0.2
    """Share of the variance if contacts were hinges, beside that of the chains and of `STRAIN_SD`
    [1]: chains sample long arms of hinges too little."""


@dataclass(frozen=True, kw_only=True)
class RefineSettings:
    """Generalized least squares from where the chains ended. Chosen on training structures."""

    rounds: int = 4
    """Linear problems solved at most [1], each at where the last one led."""

    warm_rounds: int = 2
    """Linear problems solved before, where ways of stances are long [1]."""

    long_walk_sd: float = 0.6
    """Sd of the way from a stance to the final center from which on it is long [R], some 50 flips
    at 1 deg of tilt and 2 deg of yaw."""

    mostly_long: float = 0.25
    """Share of rows with a long way from which on a minimum that warm problems lead to is the only
    one, if noise explains it [1]: none of the others of training towers was lower."""

    prior_sd: float = 1.2
    """Width of the prior that bounds steps and variances of positions [chain sd]; multiplied by
    sqrt(N), since all robots may share an error and move together."""

    least_prior: float = 0.05
    """Least prior width [R]."""

    sd_scale: float = 0.97
    """Standard deviations of an error per one of the linear problem [1]. Fitted."""

    most_yaw_bias: float = 0.2
    """Largest standard deviation of a yaw bias with which measurements hold robots [rad]: chains
    that are farther off end in different minima."""

    open_sd: float = 2.0
    """Uncertainty by the linear problem above which a robot stays where its chains put it [chain
    sd]: overlaps and the extension prior hold it, which chains know and the linear problem does
    not."""

    linear_sd: float = 0.3
    """Uncertainty up to which that does not hold [R]: motions so small are linear, and chains
    agree about them more often than they are right. Training suites without compasses."""


@dataclass(frozen=True, kw_only=True)
class OutlierRobotSettings:
    """Robots whose orientations do not count. Chosen on training structures."""

    least: float = 6.0
    """-log10 of the chance that the orientations of a robot are right, from which on it is an
    outlier [1]. Of 100 robots without errors, one in 10,000 structures would have one."""

    promising: float = 2.5
    """-log10 of that chance by a linear prediction, from which on a robot is tried [1]."""

    tried: int = 5
    """Robots that are tried for each that is found, the most promising first [1]."""

    most: float = 0.2
    """Share of robots that can be outliers [1]; where more are, something else is wrong."""

    most_mute: float = 0.15
    """Share of robots of unknown orientation from which on an estimate is not trusted [1]: the sd
    of the others was right with 10 %, too small with 20 %."""

    most_left: float = 0.5
    """Part of the misfit that outlier robots may leave [1]."""

    rounds: int = 8
    """Steps toward each minimum [1]."""


@dataclass(frozen=True, kw_only=True)
class ExchangeSettings:
    """Outliers that are held while others give way. Chosen on training structures."""

    most_robots: int = 300
    """Robots up to which exchanges are tried [1]."""

    most_exchanges: int = 5
    """Measurements that may be exchanged one after another [1]."""

    most_in_cut: int = 2
    """Measurements that are left out at once [1]."""

    most_tried: int = 4000
    """Sets of measurements that are looked at for an exchange [1]."""

    most_cuts: int = 500
    """Sets among these, those that cut a part off, that are tried [1]."""

    refined: int = 6
    """Configurations among these that are moved to a minimum [1], those of least cost."""

    least_gain: float = 1.0
    """Cost by which an exchange must be cheaper [1]: minima are found to less."""

    least_spare: int = 2
    """Outlier ranges of a known position beyond the three that would replace it, from which on the
    position may be wrong instead [1]."""

    rounds: int = 15
    """Rounds toward a minimum, at each of two temperatures [1]."""

    turns: int = 30
    """Steps of a part toward the distances that it has to meet [1]."""


@dataclass(frozen=True, kw_only=True)
class AnchorSettings:
    """Known positions as outliers. Chosen on training structures."""

    most: float = 0.5
    """Share of the anchors, beside the first robot, up to which they are left out [1]."""

    promising: float = 15.0
    """Gain from which on an anchor is tried where the estimate is to be trusted [1]: anchors that
    are right gained up to 7."""

    compared: int = 8
    """Anchors without which costs are compared at the estimate, those with the most misfit [1]."""

    tried: int = 3
    """Anchors without which chains are annealed, those of the greatest gain first [1]."""

    rounds: int = 10
    """Steps toward a minimum [1]."""


@dataclass(frozen=True, kw_only=True)
class CommonCauseSettings:
    """Parameters that all robots share, as causes of a misfit. Chosen on training structures."""

    most_robots: int = 300
    """Robots up to which a common cause is looked for [1]."""

    chance: float = 1e-4
    """Chance of a right log, times the number of parameters, below which one is a candidate [1]."""

    most_fitted: int = 4
    """Parameters that are fitted, those that promise most [1]."""

    most_tested: int = 2
    """Logs with fitted values that are localized again, the most likely ones [1]."""

    confirmations: int = 3
    """Localizations with one parameter, each beginning where the last one led [1]."""

    rounds: int = 15
    """Rounds toward a minimum of all unknowns at one value of a parameter [1]."""

    steps: int = 8
    """Steps of a parameter [1]."""

    longest_step: float = 0.2
    """Longest step of a parameter [R, 1, rad]."""

    settled: float = 0.01
    """Gain of a step below which no further one is taken [1]."""

    least_share: float = 1e-3
    """Share of a parameter's information that unknowns must leave for it to be determined [1]."""

    as_likely: float = 6.0
    """Excess of a cost up to which another parameter may be the cause as well [1]: it is as rare as
    one in 20."""


CONVERGENCE = ConvergenceTest()
MIXTURE = MixtureSettings()
SD_CALIBRATION = SdCalibration()
REFINEMENT = RefineSettings()
OUTLIER_ROBOTS = OutlierRobotSettings()
ANCHORS = AnchorSettings()
EXCHANGE = ExchangeSettings()
COMMON_CAUSES = CommonCauseSettings()
