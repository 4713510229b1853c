"""Whether to trust an estimate: was a minimum found, and does noise explain what it misses?"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.chi_square import (
    binomial_chance,
    chi_square_chance,
    chi_square_excess,
    chi_square_limit,
)
from tiswarm.localization.cost.cost import State, WholeCost
from tiswarm.localization.cost.linear import DRAWS, Linear
from tiswarm.localization.mixture import CONVERGENCE, OUTLIER_ROBOTS
from tiswarm.localization.settings import LARGE
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import stuck_robots
from tiswarm.records.estimate import MOST_MISFIT_SD, Convergence
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import SensingLog

_GROUP_CHANCE = 1e-4
"""Chance that a right log has a group of measurements that noise does not explain [1]."""

_SUM_CHANCE = 2e-3
"""Chance that noise does not explain the sum over all measurements of a right log [1]: it is one
test, and where few are spare, even twice the stated noise is hardly rarer."""

_SIMULATIONS = 19
"""Simulated logs that a suspicious one is compared with at most [1]: it looks worse than all of
them by chance once in 20."""

_FEWEST_SIMULATIONS = 4
"""Simulated logs that it is compared with at least, if none looks as wrong [1]."""

_CLEAR = 1e-6
"""Chance, times the square of the least one among simulated logs, below which no further ones are
needed [1]."""

_TRIED = 16
"""Robots whose orientations are tested, those that carry most misfit [1]: each takes a solve."""

_KINDS = ("contacts", "contacts of walks", "ranges and displacements", "coordinates")


class InlierFit(NamedTuple):
    """A minimum of the cost of measurements without outliers."""

    inlier: Bools
    """These measurements, shape (E,)."""

    cost: WholeCost
    """Their cost."""

    state: State
    """The minimum."""

    linear: Linear
    """The cost linearized there."""

    def at_rest(self) -> "InlierFit":
        """Go on to where the cost is at rest, without priors of positions."""
        open_prior = np.full(len(self.state.position), np.inf)
        cost = self.cost.held(open_prior)
        return InlierFit(self.inlier, cost, *cost.refine(self.state))

    def simulated(self, number: int) -> "InlierFit":
        """Fit measurements drawn as if the minimum were true; numbers as for `WholeCost`."""
        cost = self.cost.simulated(self.state, number)
        return InlierFit(self.inlier, cost, *cost.refine(self.state))


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What a method knows of an estimate of N robots by E measurements.

    What it does not know speaks for the estimate.
    """

    log: SensingLog

    rows: Measurements
    """Measurements that count."""

    outlier: Bools
    """Which of them are outliers, shape (E,)."""

    is_guess: Bools
    """Robots whose positions the method only guesses, shape (N,)."""

    torn: int = 0
    """How many of these robots outliers tie to the world."""

    chi_square: float
    """Squared residuals of all others in variances, and priors [1]."""

    inlier_fit: "InlierFit | None" = None
    """Minimum of the cost of measurements without outliers."""

    unknowns: int
    """Unknown coordinates."""

    freedom: int
    """Measurements beyond the unknowns that they determine."""

    is_counted: bool = True
    """Whether these were counted; else all coordinates count as determined."""

    has_sd: bool = True
    """Whether the method states standard deviations."""

    chains: int = 1
    """Chains, or other starts, whose ends count."""

    all_failed: bool = False
    """Whether no chain ended where its measurements can be met."""

    is_alone: bool = False
    """Whether there are several chains, and no two ended at the same least cost."""

    is_single: bool = False
    """Whether there are several chains, and all but one end at a much higher cost."""

    overlap: float = 0.0
    """Squared overlaps of docks at the minimum, in variances [1]."""

    missed: int = 0
    """Contacts and ranges that the best end misses though they are no outliers."""

    excess: float = 0.0
    """Chi-square of the estimate beyond that of the nearest minimum [1]."""

    is_within: bool = True
    """Whether the stated sd explains how far the estimate is from that minimum."""

    is_unsearched: bool = False
    """Whether the robots are too many to search for that minimum."""

    @property
    def hangs_on_outliers(self) -> bool:
        """Whether outliers alone tie most robots to the anchor."""
        return 2 * self.torn > len(self.is_guess)

    @property
    def is_off_minimum(self) -> bool:
        """Whether positions nearby fit better by more than noise, or the stated sd, explains."""
        return self.excess > self.chance and not self.is_within

    @property
    def chance(self) -> float:
        """Excess of a chi-square that noise explains [1]."""
        return float(chi_square_limit(self.unknowns, CONVERGENCE.chance_sd))


def judge(evidence: Evidence) -> Convergence:
    """Give the verdicts on an estimate, by all rules, and the first reason for a bad one."""
    test = _Test.of(evidence)
    trapped = [*_trapped(evidence)]
    if not trapped and test.is_suspicious and evidence.inlier_fit is not None:
        test = _calibrated(evidence, evidence.inlier_fit)
    misfits = [*test.misfits()]
    if evidence.is_single and misfits:
        trapped.append(f"only one chain leads to the least cost found, where {misfits[0]}")
    failures = [*trapped, *_failures(evidence, is_explained=test.is_explained)]
    # What a search that failed misses says nothing about the measurements.
    wrong = [*([] if trapped else misfits), *_wrong_sensors(evidence)]
    is_lost = bool(trapped) or evidence.hangs_on_outliers or evidence.is_off_minimum
    if not is_lost:
        wrong += _unlikely_outliers(evidence)
    # Without spare measurements no sum is tested, but a failed search may miss what it can meet.
    is_missed = bool(trapped) and test.chi_square > evidence.chance
    factor = 1.0
    if (is_missed or not test.is_explained) and evidence.has_sd:
        factor = max(1.0, float(np.sqrt(test.chi_square / max(test.freedom, 1))))
    is_testable = bool(wrong) or not evidence.is_counted or test.freedom > 0
    is_tested = is_testable and not (is_lost and not wrong)
    return Convergence(
        converged=not failures,
        consistent=not wrong if is_tested else None,
        testable=is_testable,
        spare=test.freedom if evidence.is_counted else None,
        misfit_sd=chi_square_excess(test.chi_square, test.freedom),
        sd_factor=factor,
        reason=next(iter([*failures, *wrong]), ""),
        chains=evidence.chains,
        restarted=0,
    )


@dataclass(frozen=True, kw_only=True)
class _Test:
    """How well noise explains a least chi-square: its sum, and that of groups of measurements."""

    chi_square: float
    """Chi-square of the means of repeated readings, and of all other measurements [1]."""

    freedom: int
    """Measurements beyond the unknowns that they determine, repeated readings as one."""

    sum_chance: float
    """Chance of a sum that is at least as large [1]."""

    group_chance: float = 1.0
    """Least chance of a group's sum [1], times the number of tests."""

    group: str = ""
    """Name of that group."""

    scatter_chance: float = 1.0
    """Chance that repeated readings scatter as much about their means [1]."""

    repeats: int = 0
    """Readings beyond the first of each quantity."""

    @classmethod
    def of(cls, evidence: Evidence) -> "_Test":
        """Test the minimum that a method knows."""
        fit = evidence.inlier_fit
        if fit is not None and fit.inlier.any():
            readings = _Readings.of(evidence.rows.select(fit.inlier), fit.linear)
            return cls.of_readings(evidence, readings, evidence.chi_square)
        chance = _sum_chance(evidence.chi_square, evidence.freedom)
        if not evidence.is_counted:
            # What the search of so many robots leaves is in the chi-square, too.
            excess = chi_square_excess(evidence.chi_square, evidence.freedom)
            chance = float(excess <= MOST_MISFIT_SD)
        return cls(chi_square=evidence.chi_square, freedom=evidence.freedom, sum_chance=chance)

    @classmethod
    def of_readings(cls, evidence: Evidence, readings: "_Readings", chi_square: float) -> "_Test":
        """Test a minimum of the cost of measurements without outliers.

        Args:
            evidence: What a method knows of the estimate.
            readings: These measurements at the minimum.
            chi_square: Chi-square there [1].
        """
        chance, group, tests = _worst_group(readings, evidence.log)
        chi_square -= readings.scatter
        freedom = evidence.freedom - readings.repeats
        return cls(
            chi_square=chi_square,
            freedom=freedom,
            sum_chance=_sum_chance(chi_square, max(freedom, readings.freedom))
            if freedom > 0
            else 1.0,
            group_chance=min(1.0, tests * chance),
            group=group,
            scatter_chance=_sum_chance(readings.scatter, readings.repeats),
            repeats=readings.repeats,
        )

    @property
    def rarity(self) -> float:
        """Least chance of the sum and of groups, relative to what is too rare [1]."""
        return min(self.sum_chance / _SUM_CHANCE, self.group_chance / _GROUP_CHANCE)

    @property
    def is_suspicious(self) -> bool:
        """Whether noise does not explain the sum, or a group, if the linear problem is right."""
        return self.rarity < 1.0

    @property
    def is_explained(self) -> bool:
        """Whether noise explains the sum of all."""
        return self.sum_chance >= _SUM_CHANCE

    def misfits(self) -> Iterator[str]:
        """Say which measurements noise does not explain: all, or those of a group."""
        is_steady = self.scatter_chance >= _GROUP_CHANCE
        if self.is_suspicious:
            what = self.group if self.is_explained else "all rows"
            problem = f"noise as stated does not explain {what}"
            if self.repeats and is_steady:
                problem += (
                    "; readings of one pair share an error: state it as a source with shared_sd"
                )
            yield problem
        elif not is_steady:
            yield "readings of one quantity scatter more than their stated noise"


def _sum_chance(chi_square: float, freedom: int) -> float:
    """Chance of a chi-square that is at least as large; 1 without degrees of freedom."""
    if freedom <= 0:
        return 1.0
    return float(chi_square_chance(np.array([chi_square]), np.array([freedom]))[0])


def _calibrated(evidence: Evidence, first: InlierFit) -> _Test:
    """Test again where the cost is at rest; then compare with simulated measurements.

    Chances of groups hold for a linear problem at its minimum. Where docks may touch or not, where
    floppy motions bend the structure, or where the search left strain, good measurements look
    wrong. So measurements are drawn with the errors that the log states, as if the estimate were
    true, and tested in the same way: as wrong as these look, right ones may look, too.
    """
    fit = first.at_rest()
    readings = _Readings.of(evidence.rows.select(fit.inlier), fit.linear)
    test = _Test.of_readings(evidence, readings, fit.linear.chi_square)
    if not test.is_suspicious:
        return test
    least = 1.0
    for number in range(_SIMULATIONS):
        drawn = fit.simulated(number).linear
        again = _Test.of_readings(evidence, readings.at(drawn), drawn.chi_square)
        least = min(least, again.rarity)
        if least <= test.rarity:
            return replace(test, sum_chance=1.0, group_chance=1.0)
        if number + 1 >= _FEWEST_SIMULATIONS and test.rarity < _CLEAR * least**2:
            break
    return test


class _Readings(NamedTuple):
    """The chi-square of E measurements: misfit of their means, and scatter about these."""

    rows: Measurements
    linear: Linear

    square: Reals
    """Part of each measurement in the chi-square of means [1], shape (E,)."""

    expected: Reals
    """Expectation of that [1], shape (E,)."""

    scatter: float
    """Squares of readings about the means of their quantities, in variances [1]."""

    repeats: int
    """Readings beyond the first of each quantity: the expectation of the scatter."""

    freedom: int
    """Expectation of the chi-square of means, priors included: docks that must not overlap hold
    robots, and leave more of it than measurements alone."""

    @classmethod
    def of(cls, rows: Measurements, linear: Linear) -> "_Readings":
        """Split a chi-square: an error that all readings of a quantity share is in no scatter."""
        expected = np.zeros(len(rows))
        of_draws = []
        for open_residual, square, chi_square in linear.residuals_of_draws():
            expected += (square - _scatter(rows, linear, open_residual)).sum(axis=1)
            of_draws.append(chi_square)
        repeats = len(rows) - len(np.unique(rows.quantity))
        freedom = round(float(np.concatenate(of_draws).mean())) - repeats
        every = cls(rows, linear, linear.square, expected / DRAWS, 0.0, repeats, freedom)
        return every.at(linear)

    def at(self, linear: Linear) -> "_Readings":
        """Split the chi-square of a minimum nearby, whose expectation is the same."""
        scatter = _scatter(self.rows, linear, linear.residual[: len(self.rows), None])[:, 0]
        square = linear.square - scatter
        return self._replace(linear=linear, square=square, scatter=float(scatter.sum()))


def _scatter(rows: Measurements, linear: Linear, residual: Reals) -> Reals:
    """Square how far residuals (E, k) are from the means of their quantities [variances]."""
    _, quantity = np.unique(rows.quantity, return_inverse=True)
    weight = 1.0 / linear.own_variance[: len(rows), None]
    size = quantity.max(initial=-1) + 1
    total = np.zeros((size, 1))
    np.add.at(total, quantity, weight)
    mean = np.zeros((size, residual.shape[1]))
    np.add.at(mean, quantity, weight / total[quantity] * residual)
    return np.asarray(weight * (residual - mean[quantity]) ** 2)


def _worst_group(read: _Readings, log: SensingLog) -> tuple[float, str, int]:
    """Find the robot, pair, source or kind of measurements that chance explains least.

    A sum over a large log hides a few wrong measurements. The sum over a group has a chi-square of
    at most as many degrees of freedom as its expectation says, as no part of it is more than one.

    Returns:
        The chance [1], the name of the group, and how many groups were tested.
    """
    rows = read.rows
    pairs = len(read.rows.neighbor)
    name = log.robot_id
    kind = np.full(len(rows), 3)
    kind[:pairs] = np.where(rows.is_contact, rows.is_walked[:pairs], 2)
    both = np.column_stack([rows.robot[:pairs], rows.neighbor])
    pair, of_pair = np.unique(both, axis=0, return_inverse=True)
    every = np.arange(len(rows))
    sensed = np.flatnonzero(rows.source >= 0)
    families: list[tuple[Ints, Ints, Callable[[int], str]]] = [
        (np.append(every, every[:pairs]), np.append(rows.robot, rows.neighbor),
         lambda k: f"the measurements of robot {name[k]}"),
        (every[:pairs], of_pair.ravel(),
         lambda k: "the measurements between robots {} and {}".format(*name[pair[k]])),
        (sensed, rows.source[sensed], lambda k: f"source {log.source_name[k]}"),
        (every, kind, lambda k: _KINDS[k]),
    ]  # fmt: skip
    tests = rows.robots
    least = 1.0
    worst = ""
    suspects: Ints = np.empty(0, np.int64)
    for row, group, text in families:
        square, expected = (np.bincount(group, part[row]) for part in (read.square, read.expected))
        chance = chi_square_chance(square, expected)
        tests += len(np.unique(group))
        if len(chance) and chance.min() < least:
            least = float(chance.min())
            worst = text(int(chance.argmin()))
        if not len(suspects):  # the first family is that of robots
            suspects = np.argsort(chance, kind="stable").astype(np.int64)[:_TRIED]
    gain, freed = gains_without(rows, read.linear, suspects)
    # One or two rows that others hardly check are off by what the linear problem leaves out.
    chance = np.where(freed > 2, chi_square_chance(gain, freed), 1.0)  # noqa: PLR2004
    if len(chance) and chance.min() < least:
        robot = suspects[chance.argmin()]
        least = float(chance.min())
        worst = f"the orientations of robot {name[robot]}"
    return least, worst, tests


def gains_without(rows: Measurements, linear: Linear, robots: Ints) -> tuple[Reals, Ints]:
    """Predict by how much the cost falls without the orientations of each of K robots.

    The prior of a final orientation counts as three rows.

    Returns:
        Gains [1], and how many rows others check, (K,) both.
    """
    gain = np.zeros(len(robots))
    freed = np.zeros(len(robots), np.int64)
    walked = np.flatnonzero(rows.is_walked)
    for k, robot in enumerate(robots.tolist()):
        robot_rows = walked[rows.robot[walked] == robot]
        turn = linear.column[3 * (rows.robots + robot) + np.arange(3)]
        gain[k], freed[k] = linear.gain_without(robot_rows, turn[turn >= 0])
    return gain, freed


def _trapped(evidence: Evidence) -> Iterator[str]:
    """Say why the least cost was hardly found: robots are never inside each other."""
    if evidence.all_failed:
        yield "all chains ended out of reach of their contacts, or ran hot"
    if evidence.is_alone:
        yield "no two chains ended at the same least cost"
    # Of many robots a few may be in the way of others, as a few may miss contacts.
    robots = len(evidence.is_guess)
    room = CONVERGENCE.most_torn * robots if robots > LARGE else 1.0
    if evidence.overlap > room * CONVERGENCE.outlier_sd**2:
        yield "docks overlap at the least cost found, which no measurement error explains"


def _failures(evidence: Evidence, *, is_explained: bool) -> Iterator[str]:
    """Say why no minimum was found, or not the right one."""
    links = len(evidence.rows.neighbor)
    outliers = int(evidence.outlier[:links].sum())
    if evidence.is_guess[1:].all() and len(evidence.is_guess) > 1:
        yield "all positions are guesses"
    if evidence.hangs_on_outliers:
        yield f"outliers alone tie {evidence.torn} of {len(evidence.is_guess)} robots to the anchor"
    if evidence.missed > CONVERGENCE.torn_anyway + CONVERGENCE.most_torn * links:
        yield f"the best chain misses {evidence.missed} contacts or ranges"
    if outliers > CONVERGENCE.most_outliers * links:
        yield f"{outliers} of {links} contacts and ranges are outliers"
    if evidence.is_off_minimum:
        yield (
            "positions nearby fit the measurements better: their chi-square is "
            f"{evidence.excess:.3g} less, and noise explains {evidence.chance:.3g}"
        )
    if evidence.is_unsearched and not is_explained:
        yield (
            f"of more than {LARGE} robots only the estimate itself is judged, and noise does not "
            "explain its chi-square"
        )


def _wrong_sensors(evidence: Evidence) -> Iterator[str]:
    """Say which sensors are wrong, or mute, in too many robots.

    Of a mute robot neither the orientation nor anything that chains it is known. Others lose their
    contacts with it, and the sd of those that are left has been too small.
    """
    log = evidence.log
    stuck = len(stuck_robots(evidence.log))
    unsensed = False if log.orientation_sd is None else ~np.isnan(log.orientation_sd[:, 0])
    mute = int((evidence.is_guess & unsensed).sum())
    if stuck:
        yield f"orientation sensors of {counted(stuck, 'robot')} are stuck"
    if mute > OUTLIER_ROBOTS.most_mute * log.robot_count:
        yield f"{counted(mute, 'robot')} sensed nothing that shows their orientation"


def _unlikely_outliers(evidence: Evidence) -> Iterator[str]:
    """Say which outliers are no chance: those of anchors, and more than the log states."""
    log = evidence.log
    rows = evidence.rows
    links = rows.link
    outlier = evidence.outlier[links]
    pair = np.column_stack([rows.robot[links], rows.neighbor[links]])
    wrong, right = (
        np.bincount(pair[chosen].ravel(), minlength=rows.robots) for chosen in (outlier, ~outlier)
    )
    is_anchor = np.isfinite(log.known_position[:, 0])
    is_doubtful = is_anchor & (wrong > 0) & (wrong >= right)
    if is_anchor.sum() > 1:  # one alone contradicts nothing
        for robot in np.flatnonzero(is_doubtful).tolist():
            yield contradiction(log, np.array([robot]))
    count = int(outlier.sum())
    rate = outlier_rate(log)
    if count and binomial_chance(count, len(links), rate) < _GROUP_CHANCE:
        yield (
            f"{count} of {len(links)} contacts and ranges are outliers, which a rate of {rate:.3g} "
            "does not explain"
        )


def contradiction(log: SensingLog, robots: Ints) -> str:
    """Say that positions of anchors and their contacts or ranges contradict each other."""
    names = ", ".join(str(name) for name in log.robot_id[robots].tolist())
    which = "the known position of robot" if len(robots) == 1 else "the known positions of robots"
    return f"{which} {names} and contacts or ranges contradict each other: either may be wrong"


def outlier_rate(log: SensingLog) -> float:
    """Return the share of contacts and ranges that are wrong, as stated or as assumed [1]."""
    stated = [log.stated(key) for key in ("wrong_docks", "false_contacts")]
    return max(CONVERGENCE.outlier_rate, sum(rate or 0.0 for rate in stated))


def outlier_cost(log: SensingLog) -> float:
    """Return what a contact or range that is an outlier costs [1], -2 log of their rate."""
    return -2.0 * float(np.log(outlier_rate(log)))


def widened(sd: Reals, factor: float, position: Reals) -> Reals:
    """Multiply standard deviations [R], shape (N,), up to the size of the swarm.

    A larger number would be a factor, and no error that a robot can have.
    """
    bound = np.maximum(sd, extent(position))
    return np.asarray(np.minimum(factor * sd, bound))


def extent(position: Reals) -> Reals:
    """Compute the root mean square distance of each robot from all robots [R], shape (N,)."""
    off = ((position - position.mean(axis=0)) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(off + off.mean()))


def misfit_by_robot(rows: Measurements, square: Reals) -> Reals:
    """Sum parts of a chi-square (E,) by robot, half of those of a pair for each, shape (N,)."""
    pair = 0.5 * square[: len(rows.neighbor)]
    misfit = np.zeros(rows.robots)
    np.add.at(misfit, rows.robot, np.concatenate([pair, square[len(pair) :]]))
    np.add.at(misfit, rows.neighbor, pair)
    return misfit


def rms(values: Reals) -> Reals:
    """Root mean square along the last axis, 0 where there are no values."""
    mean: Reals = np.sqrt((values**2).sum(axis=-1) / max(values.shape[-1], 1))
    return mean
