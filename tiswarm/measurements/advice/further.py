"""Which further contact, height, known position or anchor would constrain a swarm most.

A candidate removes as many floppy modes as its rows have rank on the floppy motions; what error it
leaves, `expected_error` computes. Several together are chosen one by one, each with what those
before it leave. Lengths in R.
"""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np
from scipy.sparse import csc_array, vstack
from scipy.spatial.distance import cdist

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import normal
from tiswarm.measurements.advice.expected_error import (
    MOST_ROBOTS,
    Images,
    Posterior,
    odometry_without_bias,
)
from tiswarm.measurements.contacts import close_docks
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING, Coordinates, Distances, Measurements
from tiswarm.measurements.odometry import CENTER, Odometry
from tiswarm.measurements.rigidity import Bodies, FloppyMotions, floppy_motions, further_rows, weld
from tiswarm.measurements.turns import Turns
from tiswarm.measurements.verdicts import IMAGES_APART, named
from tiswarm.records.estimate import Estimate, Solution
from tiswarm.records.messages import MISSING, counted
from tiswarm.records.sensing_log import KNOWN_SD, SensingLog

if TYPE_CHECKING:
    import pandas as pd

_EACH = 3
"""Candidates of each kind that are worth showing."""

_GAIN = 0.01
"""Reduction of the expected error from which on a candidate is worth showing [1]."""

_GAP = 1.0
"""Greatest gap between docks, at the estimate, that may touch in truth [R]."""

_SEEN = 1e-3
"""A floppy motion counts as measured if this part of it changes a measurement."""

_DECISIVE = 5.0
"""Difference between two solutions from which on a measurement excludes one of them [sd]."""

_NO_WEIGHT = 1e-12
"""Weight of a solution that only shows what a measurement would change [1]."""

Kind = Literal["contact", "height", "position", "range", "anchor"]

_ON_REQUEST = "anchor"
"""Kind that counts only where it is asked for: positions of fewer robots, but more precise."""


class Advice(NamedTuple):
    """A further measurement, and what it would gain."""

    kind: Kind

    robot: int
    """Robot to measure, by join order."""

    contact: list[int]
    """Own dock, other robot and its dock, CENTER for docks of a range; empty for other kinds."""

    floppy_modes: int
    """Floppy modes that it removes."""

    determined: Ints
    """Robots that are floppy without it and not with it."""

    rmse_before: float
    """Expected error without it [log unit]; NaN for more than `MOST_ROBOTS` robots."""

    rmse_after: float
    """Expected error with it [log unit]; NaN for more than `MOST_ROBOTS` robots."""

    images_apart_sd: float
    """Difference that it would have between the two likeliest solutions, in standard deviations of
    what is expected; NaN without them."""


class _Candidates(NamedTuple):
    """Further measurements of one kind, n in all."""

    kind: Kind

    rows: Measurements
    """Rows of the first, then of the second and so on, shape (n size,)."""

    size: int
    """Rows of each."""

    def one(self, chosen: int) -> Measurements:
        """Take the rows of one of them."""
        return self.rows.select(np.arange(len(self.rows)) // self.size == chosen)


class _Question(NamedTuple):
    """A log and its robots at the estimate, ready to judge candidates."""

    odometry: Odometry
    center: Reals  # centers [R], shape (N, 3)
    bodies: Bodies
    motions: FloppyMotions
    posterior: Posterior | None  # None for more than `MOST_ROBOTS` robots
    images: Images | None  # None where no robot is mirrored
    candidates: list[_Candidates]
    is_gone: Bools  # whether each robot has left, shape (N,)

    @classmethod
    def of(
        cls, log: SensingLog, cues: Collection[str], position: Reals, images: Sequence[Solution]
    ) -> "_Question | None":
        """Measure a log, whose arguments `advise` explains; None for too many robots or loops."""
        odometry = odometry_without_bias(log)
        pair = Images.of(images, log.dock_radius) if len(images) > 1 else None
        center = position / log.dock_radius if pair is None else pair.first
        rows = measure(log, cues, odometry=odometry).associated(center)
        bodies = weld(rows, center, yaw_unknown=log.yaw_bias > 0.0)
        motions = floppy_motions(bodies)
        if motions is None:
            return None
        if len(center) == 1:
            return cls(odometry, center, bodies, motions, None, pair, [], log.is_gone)
        is_small = len(center) <= MOST_ROBOTS
        candidates = [*_candidates(log, odometry, center)]
        if pair is not None and len(log.ranges) and is_small:
            candidates.append(_ranges(log, odometry, pair))
        posterior = None
        if is_small:
            is_turn = pair is not None and images[1].weight <= _NO_WEIGHT
            turning = images[1].sd if is_turn else None
            posterior = Posterior(rows.averaged(), center, log.yaw_bias, turning)
        return cls(odometry, center, bodies, motions, posterior, pair, candidates, log.is_gone)

    @property
    def fixes_gauge(self) -> Bools:
        """Whether each robot's position fixes the global yaw, which is no mode, shape (N,)."""
        off_axis: Bools = (self.center[:, :2] != self.center[0, :2]).any(axis=1)
        return off_axis & self.bodies.has_gauge_yaw

    def change(self, rows: Measurements) -> Reals:
        """Compute by how much each row differs between two images [R]; 0 without them."""
        return np.zeros(len(rows)) if self.images is None else self.images.change(rows)

    @property
    def mean_square(self) -> float:
        """Expected mean square error of the positions without further rows [R^2]."""
        of_images = 0.0 if self.images is None else self.images.mean_square
        return self._posterior.mean_square + of_images

    def best(self, taken: Collection[tuple[int, int]]) -> tuple[int, int, float, float]:
        """Find the candidate that leaves the least expected error, beside those taken so far.

        Args:
            taken: Kind and place of candidates that cannot be chosen.

        Returns:
            Its kind and place, the mean square error [R^2], and how far images are apart [sd].
        """
        ranked = []
        for kind, (_, rows, size) in enumerate(self.candidates):
            jacobian = rows.jacobian(self.center)
            variance = rows.variance()
            after, apart = self._posterior.with_rows(jacobian, variance, self.change(rows), size)
            after += 0.0 if self.images is None else self.images.remaining(apart)
            after[[place for of_kind, place in taken if of_kind == kind]] = np.inf
            first = after.argsort(kind="stable")[:1].tolist()
            ranked += [(float(after[place]), kind, place, float(apart[place])) for place in first]
        after_best, kind, place, apart_best = min(ranked)
        return kind, place, after_best, apart_best

    def measure(self, rows: Measurements) -> None:
        """Take the rows of a candidate as measured."""
        self._posterior.add(rows.jacobian(self.center), rows.variance(), self.change(rows))

    @property
    def _posterior(self) -> Posterior:
        """Expected errors.

        Raises:
            ValueError: they are not computed of so many robots.
        """
        if self.posterior is None:
            raise ValueError("expected errors of so many robots are not computed")
        return self.posterior

    def modes(self, further: Sequence[Measurements]) -> int:
        """Count the floppy modes that some further rows remove together."""
        jacobian = csc_array(vstack([rows.jacobian(self.center) for rows in further]))
        modes = int(_rank(jacobian, self.motions.of_robots(), jacobian.shape[0])[0])
        fixed = [self.fixes_gauge[rows.robot[0]] for rows in further if len(rows) == AXES]
        return modes - any(fixed)

    def determined(self, further: Sequence[Measurements]) -> Ints:
        """List the robots that stay, floppy without some further rows and not with them."""
        every = Measurements.gather(
            self.odometry,
            [rows.distances for rows in further],
            [rows.places for rows in further],
        )
        still_floppy = self.motions.robots(further_rows(self.bodies, every, self.center))
        return np.flatnonzero(self.motions.robots() & ~still_floppy & ~self.is_gone)


def advise(
    log: SensingLog, cues: Collection[str], position: Reals, images: Sequence[Solution] = ()
) -> list[Advice] | None:
    """Find the few further contacts, heights and known positions that are worth most.

    Contacts are between docks that are close to each other in the estimate. They are as precise as
    `Precision.contact`, heights and positions as `Precision.height`. Where there are images and the
    log has ranges, further ranges of their median precision are candidates, too.

    Args:
        log: What was sensed.
        cues: Cues in use.
        position: Estimated centers, in the log's unit, shape (N, 3).
        images: Solutions between which robots are mirrored, the likeliest first; the first two
            count. Positions are then those of the first.

    Returns:
        Advice by expected error, or by floppy modes for more than `MOST_ROBOTS` robots; the best
        comes first. None if there are too many robots or loops to find them.
    """
    question = _Question.of(log, cues, position, images)
    if question is None:
        return None
    pair = question.images
    posterior = question.posterior
    center = question.center
    advice = []
    for candidates in _of_kinds(question, ()):
        kind, further, size = candidates
        jacobian = further.jacobian(center)
        variance = further.variance()
        change = question.change(further)
        modes = _rank(jacobian, question.motions.of_robots(), size)
        if size == AXES:
            modes -= question.fixes_gauge[further.robot[::size]]
        before = np.nan
        after = modes * np.nan
        apart = np.sqrt((change**2 / variance).reshape(-1, size).sum(axis=1))
        if posterior is not None:
            before = posterior.mean_square
            after, apart = posterior.with_rows(jacobian, variance, change, size)
        if pair is not None:
            before = before + pair.mean_square
            after = after + pair.remaining(apart)
        helps = (modes > 0) | (after < (1.0 - _GAIN) ** 2 * before) | (apart > _DECISIVE)
        best = np.lexsort((-modes, -apart, after, ~helps))[: min(_EACH, helps.sum())]
        for chosen in best.tolist():
            one = candidates.one(chosen)
            rmse = log.dock_radius * np.sqrt([before, after[chosen]])
            advice.append(
                Advice(
                    kind=kind,
                    robot=int(one.robot[0]),
                    contact=one.sensed_contacts[0, 2:].tolist() if len(one.neighbor) else [],
                    floppy_modes=int(modes[chosen]),
                    determined=question.determined([one]),
                    rmse_before=float(rmse[0]),
                    rmse_after=float(rmse[1]),
                    images_apart_sd=np.nan if pair is None else float(apart[chosen]),
                )
            )
    keys = [[-a.floppy_modes, -a.images_apart_sd, a.rmse_after] for a in advice]
    order = np.lexsort(np.reshape(keys, (-1, 3)).T)
    return [advice[place] for place in order.tolist()]


def advise_together(
    log: SensingLog,
    cues: Collection[str],
    position: Reals,
    images: Sequence[Solution] = (),
    *,
    budget: int,
    kinds: Collection[Kind] = (),
) -> list[Advice] | None:
    """Find a few further measurements that are worth most together.

    Each is the one that leaves the least expected error, with those before it. Errors, floppy modes
    and determined robots of each are those beyond the ones before it; `images_apart_sd` is that of
    all so far.

    Args:
        log: What was sensed.
        cues: Cues in use.
        position: Estimated centers, as for `advise`.
        images: Solutions between which robots are mirrored, as for `advise`.
        budget: Largest number of measurements.
        kinds: Kinds of measurements to choose from; all but anchors if there are none. Anchors are
            robots on the ground, with positions as precise as those of anchors.

    Returns:
        Advice in the order in which it was chosen. None for more than `MOST_ROBOTS` robots, or too
        many loops.
    """
    question = _Question.of(log, cues, position, images)
    if question is None or (question.posterior is None and question.candidates):
        return None
    question = question._replace(candidates=_of_kinds(question, kinds))
    taken: list[tuple[int, int]] = []
    rows: list[Measurements] = []
    advice: list[Advice] = []
    before = 0.0 if not question.candidates else question.mean_square
    modes = 0
    already_determined = np.array([], int)
    while len(advice) < min(
        budget, sum(len(candidate.rows) // candidate.size for candidate in question.candidates)
    ):
        kind, chosen, after, apart = question.best(taken)
        one = question.candidates[kind].one(chosen)
        question.measure(one)
        taken.append((kind, chosen))
        rows.append(one)
        removed = question.modes(rows)
        determined = question.determined(rows)
        rmse = log.dock_radius * np.sqrt([before, after])
        advice.append(
            Advice(
                kind=question.candidates[kind].kind,
                robot=int(one.robot[0]),
                contact=one.sensed_contacts[0, 2:].tolist() if len(one.neighbor) else [],
                floppy_modes=removed - modes,
                determined=np.setdiff1d(determined, already_determined),
                rmse_before=float(rmse[0]),
                rmse_after=float(rmse[1]),
                images_apart_sd=np.nan if question.images is None else apart,
            )
        )
        before = after
        modes = removed
        already_determined = determined
    return advice


def _of_kinds(question: _Question, kinds: Collection[Kind]) -> list[_Candidates]:
    """Select candidates of some kinds, or of those that need no request if there are none."""
    return [
        candidate
        for candidate in question.candidates
        if candidate.kind in kinds or (not kinds and candidate.kind != _ON_REQUEST)
    ]


def _candidates(log: SensingLog, odometry: Odometry, center: Reals) -> Iterator[_Candidates]:
    """List contacts of close docks, heights and positions of all but the anchor, further anchors.

    Nobody can measure robots that have left.
    """
    final = odometry.final
    precision = Precision()
    docks = center[:, None] + odometry.arm[final]
    later, later_dock, earlier, earlier_dock = close_docks(log, docks, SPACING + _GAP).T
    contacts = Distances.of(
        final[later], later_dock, final[earlier], earlier_dock, length=SPACING, sd=precision.contact
    )
    yield _Candidates("contact", Measurements.gather(odometry, [contacts]), 1)
    present = np.flatnonzero(~log.is_gone[1:]) + 1
    standing = np.isin(present, log.ground_docks[:, 0])
    standing &= np.isnan(log.known_position[present, 0])
    kinds: list[tuple[Kind, Reals, float, Ints]] = [
        ("height", np.eye(3)[2:], precision.height, present),
        ("position", np.eye(3), precision.height, present),
        ("anchor", np.eye(3), KNOWN_SD, present[standing]),
    ]
    for kind, axes, sd, robots in kinds:
        stance = np.repeat(final[robots], len(axes))
        places = Coordinates.of(
            stance,
            np.full_like(stance, CENTER),
            np.tile(axes, (len(robots), 1)),
            (center[robots] @ axes.T).ravel(),
            variance=sd**2,
        )
        yield _Candidates(kind, Measurements.gather(odometry, places=[places]), len(axes))


def _ranges(log: SensingLog, odometry: Odometry, pair: Images) -> _Candidates:
    """List one range of each robot: the new one within reach that differs most between images."""
    first, second = (cdist(image, image) for image in (pair.first, pair.second))
    change = np.abs(second - first)
    (i, j) = log.ranges[:, :2].astype(np.int64).T
    change[first > log.ranges[:, 2].max() / log.dock_radius] = 0.0
    change[i, j] = 0.0
    change[j, i] = 0.0
    change[log.gone] = 0.0
    change[:, log.gone] = 0.0
    robot = np.arange(len(change))
    partner = change.argmax(axis=1)
    later = np.maximum(robot, partner)
    earlier = np.minimum(robot, partner)
    chosen = np.unique(np.column_stack([later, earlier])[later > earlier], axis=0)
    chosen = chosen[~log.is_gone[chosen].any(axis=1)]
    sd = float(np.median(log.ranges[:, 3])) / log.dock_radius
    later, earlier = chosen.T[:, change[tuple(chosen.T)] > sd]
    center = np.full(len(later), CENTER)
    ranges = Distances.of(
        odometry.final[later], center, odometry.final[earlier], center,
        length=first[later, earlier], sd=sd,
    )  # fmt: skip
    return _Candidates("range", Measurements.gather(odometry, [ranges]), 1)


def _rank(jacobian: csc_array, motions: Reals, size: int) -> Ints:
    """Compute the rank of each candidate's rows on the floppy motions, shape (n,)."""
    robots, dof, probes = motions.shape
    moved = np.zeros((4, robots, probes))
    moved[:dof] = motions.swapaxes(0, 1)
    moved = np.concatenate([moved[:3].swapaxes(0, 1).reshape(-1, probes), moved[3]])
    change = (jacobian @ moved).reshape(-1, size, probes)
    rank: Ints = (np.linalg.svd(change, compute_uv=False) > _SEEN * probes**0.5).sum(axis=1)
    return rank


class AdviceTable(tuple[Mapping[str, str], ...]):  # noqa: SLOT001 - it has attributes
    """Further measurements that would help, the best first, as rows of cells by heading."""

    together: "AdviceTable | None" = None
    """The set of measurements that helps most together; None where none was asked for."""

    title: str = ""
    """What the table is, in a line above it; nothing if empty."""

    def __str__(self) -> str:
        """Give the title, the aligned columns, and the set of measurements, in lines."""
        parts = [self.title, self._table(), "" if self.together is None else f"\n{self.together}"]
        return "\n".join(filter(None, parts))

    def _table(self) -> str:
        if not self:
            nothing = "no further contact, height or position would help"
            return f"{nothing}, or there are too many robots or loops"
        headings = dict.fromkeys(heading for row in self for heading in row)
        columns = [[heading, *(row.get(heading, MISSING) for row in self)] for heading in headings]
        widths = [max(map(len, column)) for column in columns]
        lines = zip(*columns, strict=True)
        return "\n".join("  ".join(map(str.ljust, cells, widths)).rstrip() for cells in lines)

    def to_frame(self) -> "pd.DataFrame":
        """Make a data frame with numbers where cells have numbers."""
        import pandas as pd  # noqa: PLC0415 - slow to import

        rows = pd.DataFrame(self)
        for name in rows.columns.drop(
            ["further measurement", "robots determined"], errors="ignore"
        ):
            rows[name] = pd.to_numeric(rows[name])
        return rows

    def _repr_html_(self) -> str:
        return str(self.to_frame().to_html(index=False))


def tabulate(
    log: SensingLog,
    cues: Collection[str],
    estimate: Estimate,
    budget: int | None = None,
    kinds: Sequence[Kind] = (),
) -> AdviceTable:
    """Tabulate which further measurements would constrain robots most: cells by heading.

    Where robots are mirrored, the two likeliest solutions of the estimate count; a table that was
    read from a file has none. No row if nothing helps, or if there are too many robots or loops.

    Args:
        log: What was sensed.
        cues: Cues that the estimate used.
        estimate: Estimate of its robots.
        budget: Largest number of measurements in the set that helps most together; no set if None.
        kinds: Kinds of measurements in the set; all but anchor if there are none.

    Raises:
        InputError: the budget is not positive, a kind is unknown, or there are too many robots.
    """
    require_set(budget, kinds)
    together = None if budget is None else _together(log, cues, estimate, budget, kinds)
    advice = advise(log, cues, *_images(log, cues, estimate))
    table = AdviceTable(_advice_rows(log, advice or [], "with it"))
    table.together = together
    return table


def require_set(budget: int | None, kinds: Sequence[str]) -> None:
    """Raise InputError if a set is to have no measurement, or an unknown kind of these."""
    if budget is not None and budget < 1:
        raise InputError(f"{budget} should be at least 1; correct it", argument="budget")
    allowed = get_args(Kind)
    unknown = [kind for kind in kinds if kind not in allowed]
    if unknown:
        raise InputError(f"{unknown[0]!r} should be one of {', '.join(allowed)}", argument="kinds")


def _together(
    log: SensingLog, cues: Collection[str], estimate: Estimate, budget: int, kinds: Sequence[Kind]
) -> AdviceTable:
    at, images = _images(log, cues, estimate)
    advice = advise_together(log, cues, at, images, budget=budget, kinds=kinds)
    if advice is None:
        problem = f"is for up to {MOST_ROBOTS:,} robots without too many loops; leave it out"
        raise InputError(problem, argument="budget")
    table = AdviceTable(_advice_rows(log, advice, "with it and those above"))
    if advice:
        number = Counter(one.kind for one in advice)
        what = " and ".join(counted(count, kind) for kind, count in number.items())
        error = f"{advice[0].rmse_before:.3g} -> {advice[-1].rmse_after:.3g} {log.length_unit}"
        table.title = f"together, {what}: expected RMSE {error}"
    return table


def _images(
    log: SensingLog, cues: Collection[str], estimate: Estimate
) -> tuple[Reals, Sequence[Solution]]:
    """Return positions [log unit], and the solutions between which robots are mirrored, if any.

    Where robots are free to turn, the two are opposite places. The second one has no weight: each
    turn is a motion of its own, whose error `Posterior` takes from `sd` [R].
    """
    if estimate.mirrored is not None and (estimate.mirrored & ~log.is_gone).any():
        return estimate.position, estimate.solutions
    unit = log.dock_radius
    center = estimate.configuration / log.dock_radius
    rows = measure(log, cues).associated(center)
    if not estimate.solutions and not estimate.turns and estimate.sd is not None:
        # A table of positions may have means of circles, where robots fit no range.
        way = normal(0, "aside", np.arange(len(center))[:, None], np.arange(AXES))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        center += way * (estimate.sd / unit)[:, None]
    turns = Turns.of(rows, center)
    mean, square = turns.swept(center)
    if not square.any():
        return estimate.position, ()
    first = replace(estimate, **turns.stated(center, unit), solutions=()).configuration
    opposite = np.where((square > 0.0)[:, None], 2.0 * unit * mean - first, first)
    # Robots that turn together share one error, not one each.
    together = np.sqrt(square)
    for turn in turns:
        together[turn.moves] *= np.sqrt(turn.moves.sum())
    pair = [
        Solution(
            weight=weight, chains=0, chi_square=math.nan, residual=math.nan, residual_sd=math.nan,
            position=position, sd=together,
        )
        for weight, position in ((1.0, first), (_NO_WEIGHT, opposite))
    ]  # fmt: skip
    return first, pair


def _advice_rows(log: SensingLog, advice: Sequence[Advice], after: str) -> list[dict[str, str]]:
    """Write advice as cells by heading; `after` is the heading of the error that it leaves."""
    name = log.robot_id.tolist()
    unit = log.length_unit
    rows = []
    for rank, item in enumerate(advice, start=1):
        what = f"{item.kind} of robot {name[item.robot]}"
        if item.kind == "anchor":
            what = f"robot {name[item.robot]} as an anchor"
        elif item.kind == "range":
            what = f"{what} to robot {name[item.contact[1]]}"
        elif item.contact:
            own_dock, partner, dock = item.contact
            what = f"{what}'s dock {own_dock} with robot {name[partner]}'s dock {dock}"
        gains = {
            IMAGES_APART: item.images_apart_sd,
            f"expected RMSE [{unit}]": item.rmse_before,
            f"{after} [{unit}]": item.rmse_after,
        }
        rows.append(
            {
                "rank": str(rank),
                "further measurement": what,
                "floppy modes removed": str(item.floppy_modes),
                "robots determined": named(log, item.determined, most=3),
            }
            | {key: f"{value:.3g}" for key, value in gains.items() if not math.isnan(value)}
        )
    return rows
