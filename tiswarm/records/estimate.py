"""The estimate that a localizer returns, with its convergence and observability."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.records.error_law import ERRORS, SURE, sure_ratio
from tiswarm.records.messages import counted, decimals_for, two_digits, with_sd

if TYPE_CHECKING:
    import pandas as pd

HALF_WITHIN = 0.85
MOST_WITHIN = 1.6
"""Distances from the estimate, in standard deviations, that should contain 50 % and 90 % of the
robots. They are fitted on training structures: robots of an arm share their error, so distances
are not normally distributed."""


WITHIN = "within_"
"""Begin of the names of columns of probabilities, a distance being the rest."""

_PROBABILITY_DIGITS = 4

MOST_MISFIT_SD = 5.0
"""Misfit, above or below what noise explains, from which on measurements are not consistent."""


@dataclass(frozen=True, kw_only=True)
class Solution:
    """One of several distinct configurations that the measurements allow."""

    weight: float
    """Share of the solution in the mixture that the estimate is the mean of [1]."""

    chains: int
    """Number of chains, or starts, that ended in this configuration; 0 if only mirroring a part of
    another one leads there."""

    chi_square: float
    """Least cost: squared residuals of all measurements in variances, under the robust loss, and
    overlaps [1]."""

    residual: float
    """Residual of its contacts and ranges [log unit]."""

    residual_sd: float
    """The same in standard deviations."""

    position: Reals = field(repr=False)
    """Centers [log unit], shape (N, 3)."""

    sd: Reals | None = field(default=None, repr=False)
    """Standard deviation of each position within this solution [log unit], shape (N,); None where
    the method has none."""


@dataclass(frozen=True, kw_only=True)
class OpenTurn:
    """Robots that measurements leave free to turn about others."""

    robots: Ints
    """Robots that turn, each alone or with others, shape (k,)."""

    about: Ints
    """Robots about which they turn: one, or several in a line, shape (n,)."""

    axis: Reals | None
    """Unit vector of the axis, shape (3,); None where they turn about every axis through a
    robot."""

    place: Reals
    """Centers of the former in one configuration, and of the latter, in a line [log unit], shape
    (k + n, 3)."""


class CommonCause(NamedTuple):
    """A parameter that all robots share, whose stated value is wrong if this explains a misfit."""

    parameter: str
    """Name in words, such as "dock offset"."""

    key: str
    """Key of the log that states it."""

    stated: float
    """Value that the log states, 0 of a shift or a turn [`unit`]."""

    value: float
    """Value with which all measurements agree [`unit`]."""

    sd: float
    """Standard deviation of that value [`unit`]."""

    unit: str
    """Unit: that of the log's lengths, "deg", or "1"."""

    axis: tuple[float, ...] | None = None
    """Unit vector about which a turn is, 3 components; None of other parameters."""

    is_height: bool = False
    """Whether it is a height, and no difference of heights."""

    def __str__(self) -> str:
        """Write the value with its uncertainty, and what the log states."""
        number = with_sd(self.value, self.sd)
        if self.axis is not None:
            axis = ", ".join(f"{component:.2f}" for component in self.axis)
            return f"a {self.parameter} by {number} {self.unit} about [{axis}]"
        unit = "" if self.unit == "1" else f" {self.unit}"
        stated = f"{self.stated:.{decimals_for(self.sd)}f}{unit}"
        text = f"{self.parameter} of {number}{unit} instead of {stated}"
        return f"an {text}" if text[0] in "aeio" else f"a {text}"

    def lifted(self, by: float) -> "CommonCause":
        """Count a height from a point that is lower by a length [`unit`]."""
        if not self.is_height:
            return self
        return self._replace(stated=self.stated + by, value=self.value + by)


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """Two verdicts on an estimate: on the search, and on the measurements."""

    converged: bool
    """Whether the search found one least cost from several starts, with no robot out of reach of
    its measurements."""

    consistent: bool | None
    """Whether noise as stated explains the least cost, outliers left out. None where nothing was
    tested: unless `testable`, and where the search did not find one least cost, which says nothing
    about the measurements."""

    testable: bool = True
    """Whether the log could be found not consistent: it was, or it has spare measurements."""

    spare: int | None = None
    """Spare measurements: those beyond the unknowns that they determine, the degrees of freedom of
    the chi-square. None where they were not counted."""

    misfit_sd: float
    """Excess of the least chi-square over its expectation, in standard deviations of a chi-square;
    outliers are left out."""

    sd_factor: float = 1.0
    """Factor that `sd` was multiplied by, up to the size of the swarm: the Birge ratio
    sqrt(chi-square / degrees of freedom) of measurements that are not consistent, else 1."""

    reason: str = ""
    """Why the estimate did not converge, or is not consistent; empty if neither."""

    chains: int
    """Number of chains, or starts, that enter the estimate."""

    restarted: int
    """Number of annealings that were repeated with smaller steps, because a robot was beyond the
    reach of its contacts or the chain's temperature diverged."""

    @property
    def trusted(self) -> bool:
        """Whether the search converged, and no test contradicts the measurements."""
        return self.converged and self.consistent is not False


@dataclass(frozen=True, kw_only=True)
class Observability:
    """What some cues determine of N robots."""

    cues: tuple[str, ...]
    yaw_unknown: bool
    """Whether each robot's yaw is unknown."""

    unknowns: int
    """Unknown coordinates: those of all robots but the anchor, and where yaw is unknown the turn of
    each robot relative to the mean of all."""

    gauge_yaw_sd: float | None
    """Standard deviation of a turn of the whole swarm about the anchor [rad], where yaw is unknown
    and only the mean of all compasses fixes it; else None."""

    floppy_modes: int | None
    """Independent motions of the swarm that change no measurement, or None where there are too many
    robots to count them."""

    floppy: Bools | None = field(repr=False)
    """Whether such motions shift each robot, shape (N,), or None where `floppy_modes` is."""

    disconnected: Bools = field(repr=False)
    """Whether nothing but a height ties each robot to the anchor, shape (N,)."""

    @property
    def known(self) -> list[str]:
        """Whether each robot's position is determined: "yes", "floppy" or "disconnected".

        Empty where there are too many robots to find out.
        """
        tied = "" if self.floppy is None else np.where(self.floppy, "floppy", "yes")
        words = np.where(self.disconnected, "disconnected", tied)
        return [str(word) for word in words]


@dataclass(frozen=True, kw_only=True, repr=False)
class Estimate:
    """Estimated positions of N robots in join order, with the trace of the iterations."""

    robot_id: Ints
    """Name of each robot, shape (N,)."""

    position: Reals
    """Estimated centers [log unit], shape (N, 3)."""

    disconnected: Bools
    """Whether nothing that was used, outliers left out, ties the robot to the anchor, so that its
    position is a guess, shape (N,)."""

    sd: Reals | None = None
    """Standard deviation of each position [log unit], shape (N,); None where the method has none.

    It is the root of the mean square distance to the true position, over all three axes.
    Half of the robots should be within `HALF_WITHIN` sd, nine of ten within `MOST_WITHIN` sd."""

    undetermined: Bools | None = None
    """Coordinates that measurements of the world and of located robots leave open, shape (N, 3); a
    robot with none is located. None where the method does not place robots one by one."""

    yaw: Reals | None = None
    """Correction of each robot's sensed yaw [rad], shape (N,); None where the method solves for
    none."""

    convergence: Convergence | None = None
    """Convergence; None where the method does not assess it."""

    outlier_contacts: Ints | None = None
    """Outliers among the contacts, rows as `Measurements.sensed_contacts`, shape (K, 5); None where
    the method does not look for them, did not converge, or found `common_causes`."""

    outlier_places: Ints | None = None
    """Outliers among ground contacts, heights, fixes and spawn positions: rows of (robot, its
    stance from the spawn on, dock, or -1 for the center), shape (K, 3); None where the former
    is."""

    outlier_robots: Ints | None = None
    """Robots whose measurements all disagree with their neighbors', so that their orientations and
    what they sensed on their walks do not count, shape (K,); None where there are none, or the
    method does not look for them."""

    common_causes: tuple[CommonCause, ...] = ()
    """Parameters, the likeliest first, that would explain all measurements if one of them had
    another value; empty where the estimate is trusted, or no parameter explains them."""

    misfit: Reals | None = None
    """Part of the chi-square that each robot's measurements carry, half of that of a pair for each
    of its two robots, shape (N,); None where the method does not compute it."""

    mirrored: Bools | None = None
    """Whether solutions put the robot farther apart than its sd within one of them, shape (N,);
    None where the method does not look for several."""

    gone: Bools | None = None
    """Whether each robot has left, so that its position is where it last stood, shape (N,); None
    where none has."""

    free_frame: tuple[str, ...] = ()
    """Rigid motions of all robots that change no measurement: "rotation" about every axis through
    the anchor, "axis" about one axis, and "hand", a mirror image. `sd` is that of the shape
    then."""

    turns: tuple[OpenTurn, ...] = ()
    """Robots that are free to turn about others, which changes no measurement, or less than noise
    does. Their `sd` includes that; in solutions they stand at one of all places."""

    solutions: tuple[Solution, ...] = ()
    """Distinct configurations that the measurements allow, the likeliest first. `position` is the
    mean of their mixture. Empty where the method looks for one only."""

    observability: Observability | None = None
    """What the cues in use determine; filled in after the method has run."""

    iteration: Ints
    """Iterations of the trace, ascending, shape (K,)."""

    trace: Reals
    """Estimated centers at each iteration of the trace [log unit], shape (K, N, 3)."""

    at_join: Reals | None = None
    """Estimated center of each robot as it joined [log unit], shape (N, 3); None where the method
    localizes whole logs."""

    residual_sd: float | None = None
    """RMS residual of the estimate's contacts in standard deviations; None where the method has
    none."""

    traffic: Mapping[str, Reals] | None = None
    """What it cost each robot to localize itself, shape (N,) each: bytes `sent`, passed on ones
    included, and `heard`; `messages`; `memory` at most [B]; `operations`, additions and
    multiplications, about; `rounds` with messages, which all share; `joins` that it solves, if any
    does. None where one program has the whole log."""

    doubtful: Bools | None = None
    """Robots that do not trust their own positions, by what each holds, shape (N,); None where
    robots do not judge for themselves."""

    steps: Ints | None = None
    """Steps of each robot, those in rounds of back-propagation too, shape (N,); None where the
    method has none."""

    residual: Reals
    """Quantity that the method minimizes, at each iteration of the trace, shape (K,).

    For virtual-force: RMS step of the robots [log unit per iteration]. For all other methods: RMS
    deviation from D of the distance between docks in contact [log unit].
    """

    length_unit: str = "R"
    """Name of the log's unit of length."""

    dock_radius: float = 1.0
    """R, the radius of a dock [log unit]."""

    tolerance: float | None = None
    """Distance from the estimated position whose probability is stated for each robot [log unit];
    that of R alone if None."""

    @property
    def configuration(self) -> Reals:
        """Centers of one configuration, not halfway between several [log unit], shape (N, 3)."""
        likeliest = self.solutions[0].position if self.solutions else self.position
        center = likeliest.copy()
        for turn in self.turns:
            center[np.concatenate([turn.robots, turn.about])] = turn.place
        return center

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.robot_id)

    @property
    def known(self) -> list[str]:
        """Whether each position is determined: "yes", "mirrored", "floppy" or "disconnected".

        Empty where there are too many robots to find out.
        """
        words = [] if self.observability is None else self.observability.known
        words = [
            "disconnected" if is_lost else word
            for word, is_lost in zip(words, self.disconnected.tolist(), strict=False)
        ]
        if self.mirrored is None:
            return words
        pairs = zip(words, self.mirrored.tolist(), strict=False)
        return [
            "mirrored" if is_mirrored and word == "yes" else word for word, is_mirrored in pairs
        ]

    @property
    def is_open(self) -> Bools | None:
        """Whether measurements tie each robot to the anchor, but not its position, shape (N,).

        Free motions beside `turns` move it. None where that was not found out.
        """
        observability = self.observability
        if observability is None or observability.floppy is None:
            return None
        is_open: Bools = observability.floppy & ~observability.disconnected
        for turn in self.turns:
            is_open[turn.robots] = False
        return is_open

    @property
    def located(self) -> Bools | None:
        """Whether each robot is located, shape (N,); None where `undetermined` is."""
        return None if self.undetermined is None else np.logical_not(self.undetermined.any(axis=1))

    @property
    def is_guess(self) -> Bools:
        """Whether each robot's position is a guess, shape (N,).

        Then no measurement ties the robot to the anchor, or to robots that were located.
        """
        located = self.located
        return self.disconnected if located is None else self.disconnected | ~located

    def with_common_causes(self, causes: tuple[CommonCause, ...]) -> "Estimate":
        """Return the estimate of a log that is not consistent, since one of some causes holds.

        Outliers are not listed: all measurements agree where the cause is corrected.
        """
        verdict = self.convergence
        if verdict is not None:
            explained = ", and so would ".join(
                [f"{causes[0]} would explain all measurements", *map(str, causes[1:])]
            )
            verdict = replace(verdict, consistent=False, testable=True, reason=explained)
        return replace(
            self,
            convergence=verdict,
            common_causes=causes,
            outlier_contacts=None,
            outlier_places=None,
        )

    def within(self, distance: float) -> Reals | None:
        """Compute the probability that each robot is within a distance of its estimated position.

        Only robots with a probability of `SURE` or more should be relied on. It follows from `sd`
        by the law `error_law.ERRORS` of error / sd, which `python -m benchmarks.within fit` fitted
        on training logs of all methods; `docs/accuracy.md` shows how often it is right on others.

        Args:
            distance: Distance [log unit].

        Returns:
            Probabilities [1], shape (N,); NaN where the position is a guess, or `sd` is unknown.
            None where the method states no `sd`.

        Raises:
            InputError: the distance is not a positive number.
        """
        refuse_distance(distance)
        if self.sd is None:
            return None
        with np.errstate(divide="ignore"):  # the anchor has no error
            probability = ERRORS.probability(distance / self.sd)
        return np.where(self.is_guess | ~np.isfinite(self.sd), np.nan, probability)

    def expected_rmse(self, robots: Bools | None = None) -> float:
        """Compute the RMSE that the estimate expects: the root mean square of `sd`.

        Args:
            robots: Robots to count, shape (N,); all if None. Guesses do not count.

        Returns:
            Expected RMSE [log unit]; NaN without a robot whose error is stated.
        """
        if self.sd is None:
            return math.nan
        counts = ~self.is_guess & np.isfinite(self.sd)
        if robots is not None:
            counts &= robots
        return float(np.sqrt(np.mean(self.sd[counts] ** 2))) if counts.any() else math.nan

    @property
    def near_distance(self) -> float:
        """Distance that counts as near in words: `tolerance`, or R [log unit]."""
        return self.dock_radius if self.tolerance is None else self.tolerance

    @property
    def near(self) -> str:
        """That distance with its unit; R also in that of the log."""
        text = f"{two_digits(self.near_distance)} {self.length_unit}"
        is_radius = self.tolerance is None and self.length_unit != "R"
        return f"{text} (1 R)" if is_radius else text

    @property
    def statement(self) -> str:
        """State in a sentence how many robots are near where they are shown.

        Near is within `near_distance`. Robots that have left do not count.
        """
        stays = np.ones(self.robot_count, np.bool_) if self.gone is None else ~self.gone
        robots = int(stays.sum())
        probability = self.within(self.near_distance)
        if self.sd is None or probability is None:
            return f"the method states no error of the positions of {counted(robots, 'robot')}"
        is_sure = probability >= SURE
        sure = int((stays & is_sure).sum())
        is_one = sure <= 1
        who = f"{sure} of {counted(robots, 'robot')} {'is' if is_one else 'are'}"
        if sure == 0:
            who = f"none of {counted(robots, 'robot')} is known to be"
        elif sure == robots > 1:
            who = f"all {robots} robots are"
        near = f"within {self.near} of where {'it is' if is_one else 'they are'} shown"
        if self.free_frame:
            near += ", up to a motion of all,"
        clauses = [f"{who} {near} ({100.0 * SURE:g} %)"]
        unsure = stays & (probability < SURE)
        guesses = int((stays & np.isnan(probability)).sum())
        if unsure.any():
            farthest = two_digits(sure_ratio() * float(self.sd[unsure].max()))
            clauses.append(f"{unsure.sum()} may be anywhere within {farthest} {self.length_unit}")
        if guesses:
            of_one = "the position of 1 is a guess"
            clauses.append(of_one if guesses == 1 else f"the positions of {guesses} are guesses")
        expected = self.expected_rmse(stays)
        if expected > 0.0:
            clauses.append(f"expected RMSE {two_digits(expected)} {self.length_unit}")
        return "; ".join(clauses)

    def __repr__(self) -> str:
        """Describe the estimate in a line."""
        parts = [self.statement]
        if self.convergence is not None and not self.convergence.trusted:
            words = {
                "converged": self.convergence.converged,
                "consistent": self.convergence.consistent,
            }
            parts += [f"not {word}" for word, is_good in words.items() if is_good is False]
        return f"Estimate({'; '.join(parts)})"

    def columns(self) -> dict[str, Sequence[object]]:
        """List the columns of `estimate.csv` by name."""
        unit = self.length_unit
        columns = position_columns(self.robot_id, self.position, unit)
        if self.sd is not None:
            columns[f"sd_{unit}"] = self.sd.tolist()
        columns |= self._within_columns()
        if self.observability is not None:
            columns["known"] = self.known
        if self.gone is not None:
            columns["gone"] = np.where(self.gone, "yes", "no").tolist()
        if self.yaw is not None:
            columns["yaw_deg"] = np.degrees(self.yaw).tolist()
        if self.undetermined is not None:
            axes = np.where(self.undetermined, [*"xyz"], "")
            columns["undetermined"] = ["".join(row) for row in axes.tolist()]
        return columns

    def _within_columns(self) -> dict[str, Sequence[object]]:
        """List the probabilities of distances by name: of R, and of `tolerance`."""
        distances = {"1R": self.dock_radius}
        if self.tolerance is not None:
            distances[f"{self.tolerance:g}{self.length_unit}"] = self.tolerance
        columns: dict[str, Sequence[object]] = {}
        for name, distance in distances.items():
            probability = self.within(distance)
            if probability is None:
                probability = np.full(self.robot_count, np.nan)
            columns[f"{WITHIN}{name}"] = probability.round(_PROBABILITY_DIGITS).tolist()
        return columns

    def to_frame(self) -> "pd.DataFrame":
        """Make a data frame with the columns of `estimate.csv`."""
        import pandas as pd  # noqa: PLC0415 - slow to import

        return pd.DataFrame(self.columns())

    def with_solution(self, number: int) -> "Estimate":
        """Return the positions and sd of one solution, counted from 1, without the mean's yaw.

        Raises:
            InputError: there is no such solution.
        """
        if not 1 <= number <= len(self.solutions):
            what = f"found {counted(len(self.solutions), 'solution')}"
            remedy = f"choose 1 to {len(self.solutions)}" if self.solutions else "leave it out"
            raise InputError(f"{number}: the method {what}; {remedy}", argument="solution")
        chosen = self.solutions[number - 1]
        return replace(
            self,
            position=chosen.position,
            sd=chosen.sd,
            yaw=None,
            mirrored=None,
            trace=np.concatenate([self.trace[:-1], chosen.position[None]]),
            residual=np.append(self.residual[:-1], chosen.residual),
            residual_sd=chosen.residual_sd,
        )


def refuse_distance(distance: float) -> None:
    """Refuse a distance that no robot can be within.

    Raises:
        InputError: the distance is not a positive number.
    """
    if not 0.0 < distance < np.inf:
        raise InputError(f"{distance:g} should be above 0; give a length", argument="within")


def position_columns(
    robot_id: Ints, position: Reals, length_unit: str
) -> dict[str, Sequence[object]]:
    """List the columns of a table of positions (N, 3) by name."""
    columns: dict[str, Sequence[object]] = {"robot": robot_id.tolist()}
    for axis, coordinates in zip("xyz", position.T.tolist(), strict=True):
        columns[f"{axis}_{length_unit}"] = coordinates
    return columns
