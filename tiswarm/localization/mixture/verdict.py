"""Whether to trust an estimate: was a minimum found, and does noise explain what it misses?"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.chi_square import chi_square_chance, chi_square_excess, chi_square_limit
from tiswarm.localization.cost.linear import Linear
from tiswarm.localization.mixture import CONVERGENCE, MIXTURE, OUTLIER_ROBOTS
from tiswarm.localization.settings import LARGE
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import stuck_robots
from tiswarm.records.estimate import MOST_MISFIT_SD, Convergence
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import SensingLog

_CHANCE = 1e-4
"""Chance that a right log has a group of measurements that noise does not explain [1]."""

_TRIED = 16
"""Robots whose orientations are tested, those that carry most misfit [1]: each takes a solve."""

_KINDS = ("contacts", "contacts of walks", "ranges and displacements", "coordinates")


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

    inlier_fit: tuple[Bools, Linear] | None = None
    """Measurements without outliers, shape (E,), and their cost linearized at its minimum."""

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
    def chance(self) -> float:
        """Excess of a chi-square that noise explains [1]."""
        return float(chi_square_limit(self.unknowns, CONVERGENCE.chance_sd))


def judge(evidence: Evidence) -> Convergence:
    """Give the verdicts on an estimate, by all rules, and the first reason for a bad one.

    Near 0 degrees of freedom, what a search leaves would look like a misfit: they count as at least
    `MIXTURE.spare` of the unknown coordinates.
    """
    readings = None
    if evidence.inlier_fit is not None:
        inlier, linear = evidence.inlier_fit
        if inlier.any():
            readings = _Readings.of(evidence.rows.select(inlier), linear)
    spare = evidence.freedom - (0 if readings is None else readings.repeats)
    chi_square = evidence.chi_square - (0.0 if readings is None else readings.scatter)
    freedom = max(spare, int(MIXTURE.spare * evidence.unknowns))
    misfit_sd = chi_square_excess(chi_square, freedom)
    is_explained = misfit_sd <= MOST_MISFIT_SD
    misfits = [*_misfits(readings, evidence.log, is_explained=is_explained)]
    trapped = [*_trapped(evidence, misfits)]
    failures = [*trapped, *_failures(evidence, is_explained=is_explained)]
    # What a search that failed misses says nothing about the measurements.
    wrong = [*([] if trapped else misfits), *_wrong_sensors(evidence)]
    factor = 1.0
    if not is_explained and evidence.has_sd:
        factor = float(np.sqrt(chi_square / max(freedom, 1)))
    return Convergence(
        converged=not failures,
        consistent=not wrong,
        testable=bool(wrong) or not evidence.is_counted or spare == freedom > 0,
        spare=spare if evidence.is_counted else None,
        misfit_sd=misfit_sd,
        sd_factor=factor,
        reason=next(iter([*failures, *wrong]), ""),
        chains=evidence.chains,
        restarted=0,
    )


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

    @classmethod
    def of(cls, rows: Measurements, linear: Linear) -> "_Readings":
        """Split a chi-square: an error that all readings of a quantity share is in no scatter."""
        _, first, quantity = np.unique(rows.quantity, return_index=True, return_inverse=True)
        weight = 1.0 / linear.own_variance[: len(rows), None]
        total = np.zeros((len(first), 1))
        np.add.at(total, quantity, weight)

        def scatter(residual: Reals) -> Reals:
            mean = np.zeros((len(first), residual.shape[1]))
            np.add.at(mean, quantity, weight / total[quantity] * residual)
            return np.asarray(weight * (residual - mean[quantity]) ** 2)

        open_residual, square = linear.residual_of_draws()
        scatter_of_rows = scatter(linear.residual[: len(rows), None])[:, 0]
        expected = (square - scatter(open_residual)).mean(axis=1)
        repeats = len(rows) - len(first)
        return cls(
            rows,
            linear,
            linear.square - scatter_of_rows,
            expected,
            float(scatter_of_rows.sum()),
            repeats,
        )


def _misfits(read: _Readings | None, log: SensingLog, *, is_explained: bool) -> Iterator[str]:
    """Say which measurements noise does not explain: all, or those of a group."""
    group = "" if read is None else _worst_group(read, log)
    is_steady = read is None or chi_square_excess(read.scatter, read.repeats) <= MOST_MISFIT_SD
    is_shared = read is not None and read.repeats > 0 and is_steady
    if group or not is_explained:
        what = group if is_explained else "all rows"
        problem = f"noise as stated does not explain {what}"
        if is_shared:
            problem += "; readings of one pair share an error: state it as a source with shared_sd"
        yield problem
    elif not is_steady:
        yield "readings of one quantity scatter more than their stated noise"


def _worst_group(read: _Readings, log: SensingLog) -> str:
    """Name the robot, pair, source or kind of measurements that chance explains least, if any.

    A sum over a large log hides a few wrong measurements. The sum over a group has a chi-square of
    at most as many degrees of freedom as its expectation says, as no part of it is more than one.
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
    return worst if least * tests < _CHANCE else ""


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


def _trapped(evidence: Evidence, misfits: list[str]) -> Iterator[str]:
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
    if evidence.is_single and misfits:
        yield f"only one chain leads to the least cost found, where {misfits[0]}"


def _failures(evidence: Evidence, *, is_explained: bool) -> Iterator[str]:
    """Say why no minimum was found, or not the right one."""
    links = len(evidence.rows.neighbor)
    outliers = int(evidence.outlier[:links].sum())
    if evidence.is_guess[1:].all() and len(evidence.is_guess) > 1:
        yield "all positions are guesses"
    if 2 * evidence.torn > len(evidence.is_guess):
        yield f"outliers alone tie {evidence.torn} of {len(evidence.is_guess)} robots to the anchor"
    if evidence.missed > CONVERGENCE.torn_anyway + CONVERGENCE.most_torn * links:
        yield f"the best chain misses {evidence.missed} contacts or ranges"
    if outliers > CONVERGENCE.most_outliers * links:
        yield f"{outliers} of {links} contacts and ranges are outliers"
    if evidence.excess > evidence.chance and not evidence.is_within:
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
