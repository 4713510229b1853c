"""Where a log contradicts itself, in lengths of another unit or contacts that cannot be.

Two robots are at most as far apart as a chain of contacts between them is long. A length that is
longer many times over is no noise, but a slip of the unit or of the decimal point. Lengths in R.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import combinations
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tiswarm.base.aliases import Ints, Reals
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import ALLOWED_SD, SPACING, Measurements
from tiswarm.measurements.odometry import UNKNOWN, Odometry
from tiswarm.measurements.verdicts import MOST_SHOWN
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import KEYS, LISTS, NUMBERS, SensingLog

_ALLOWED_GAP = 0.05
"""Docks may sense each other though this much lies between them [R]."""

_SLIP = 4.0
"""Factor by which a length exceeds its bound, from which on it is no noise."""

_SCALED = 1.5
"""Factor for more than half of a column's lengths."""

_FEWEST = 3
"""Lengths from which on more than half of them speak for a column, if each breaks its bound as a
single length must, by `_SLIP`."""

_MANY = 10
"""Lengths from which on `_SCALED` is enough: false contacts break a few bounds."""

_SD = 5.0
"""Standard deviations that noise may explain."""

_LONGEST_ARM = 100.0
"""Dock offset from which on it is unlikely [R]."""

_MOST_STARTS = 500
"""Robots from which chains of contacts are followed; of more, a sample."""

_MARGIN = 20
"""Robots in a row that a spawn position may be beyond all others."""

_SPARSE = 1000
"""Robots in a row that a range, or a coordinate of a robot without contacts, may be long."""


_USUAL = (10.0, 25.4, 100.0, 1000.0)
"""Factors between units of length."""

_NEAR = (0.9, 3.5)
"""The true factor is as many times the one found, which follows from bounds, about."""

HEADER = -1
"""In place of a robot: the header's line."""


class Slip(NamedTuple):
    """A length, or a column of lengths, that seems to be in another unit."""

    robot: int
    """Robot whose line has the length, or the first one of the column, by join order; or HEADER."""

    key: str
    """Key of the log."""

    what: str
    """The length in words; of a column, how many lengths."""

    factor: float
    """How many times it is too long, at least; below 1, the inverse of how much too short."""

    against: str
    """What it contradicts."""


class Lengths(NamedTuple):
    """Lengths of one key, of final stances."""

    robot: Ints
    """Robot whose line has each, shape (n,)."""

    origin: Ints
    """The other robot, or the anchor, from which coordinates are counted, shape (n,)."""

    size: Reals
    """The length [R], shape (n,)."""

    sd: Reals
    """Standard deviation that the log states beside it [R], shape (n,)."""

    is_of_pair: bool
    """Whether the log names the other robot."""

    def described(self, log: SensingLog, row: int) -> str:
        """Write a length in the log's unit, and where it leads."""
        where = (
            f"to robot {log.robot_id[self.origin[row]]}" if self.is_of_pair else "from the anchor"
        )
        return f"{self.size[row] * log.dock_radius:.4g} {log.length_unit} {where}"


def lengths(log: SensingLog) -> Iterator[tuple[str, Lengths]]:
    """Yield the keys that measure lengths, with the lengths of a log."""
    anchor = log.anchor_position
    for name, key in KEYS.items():
        rows = getattr(log, name)
        if "distance" in key.columns or "vector" in key.columns:
            away = np.hypot.reduce(key.part(rows, "distance", "vector"), axis=1)
        elif "value" in key.columns:
            away = key.part(rows, "value")[:, 0] - key.part(rows, "normal") @ anchor
        elif "height" in key.columns:
            away = rows - anchor[2]
        elif "coordinate" in key.columns:
            away = np.abs(rows - anchor).max(axis=1)
        else:
            continue
        robot = rows[:, 0].astype(np.int64) if name in LISTS else np.arange(len(rows))
        partner = key.part(rows, "robot").sum(axis=1).astype(np.int64)  # 0, the anchor, without one
        sd = key.part(rows, "sd").sum(axis=1)
        is_measured = np.isfinite(away)
        scale = 1.0 / log.dock_radius
        size = scale * np.abs(away[is_measured])
        of_pair = key.robot is not None
        yield (
            name,
            Lengths(
                robot[is_measured], partner[is_measured], size, scale * sd[is_measured], of_pair
            ),
        )


def doubts(log: SensingLog, path: Path) -> Iterator[str]:
    """Describe in lines the lengths of a log, or of its file, that are probably wrong."""
    suspects = slips(log)
    yield from _slips(log, path, suspects)
    yield from _unlikely(log, path, suspects)


def _slips(log: SensingLog, path: Path, suspects: Sequence[Slip]) -> Iterator[str]:
    """Describe in lines lengths that seem to be in another unit than the rest."""
    for slip in suspects[:MOST_SHOWN]:
        times = slip.factor if slip.factor > 1.0 else 1.0 / slip.factor
        near = [usual for usual in _USUAL if _NEAR[0] * times <= usual <= _NEAR[1] * times]
        many = f"about {near[0]:g}" if near else f"at least {float(f'{times:.2g}'):g}"
        size = f"{many} times too {'long' if slip.factor > 1.0 else 'short'}"
        problem = f"{slip.what}: {size} beside {slip.against}"
        remedy = "correct the unit, or leave it out"
        yield f"{path}:{log.line_of(slip.robot)}: {slip.key}: {problem}; {remedy}"
    if len(suspects) > MOST_SHOWN:
        yield f"{path}: {counted(len(suspects) - MOST_SHOWN, 'more such length')}"


def _unlikely(log: SensingLog, path: Path, suspects: Sequence[Slip]) -> Iterator[str]:
    """Describe in lines lengths beyond any likely size of the swarm, of keys without slips."""
    size = 2.0 * np.linalg.norm(log.dock_offset_body, axis=1).max() / log.dock_radius + 2.0
    in_a_row = (log.robot_count + _MARGIN) * size
    apart = max(log.robot_count, _SPARSE) * size
    named = {slip.key for slip in suspects}
    for key, column in lengths(log):
        farthest = in_a_row if key in NUMBERS else apart
        wrong = np.flatnonzero((column.size > farthest) & (key not in named))
        for row in wrong[:MOST_SHOWN].tolist():
            place = f"{path}:{log.line_of(int(column.robot[row]))}: {key}"
            yield f"{place}: {column.described(log, row)} is unlikely; correct it or leave it out"


def slips(log: SensingLog) -> list[Slip]:
    """Find lengths that seem to be in another unit than the rest of the log, columns first."""
    walks = Odometry(log)
    suspects = [*_header(log, walks), *_heights(log, walks)]
    columns = {
        name: column for name, column in lengths(log) if name not in {s.key for s in suspects}
    }
    bound = _bounds(log, walks, columns)
    singles: list[Slip] = []
    for key, column in columns.items():
        ratio = np.maximum(column.size - _SD * column.sd, 0.0) / bound[key]
        count = int((bound[key] < inf).sum())
        broken = ratio > (_SCALED if count >= _MANY else _SLIP)
        if count >= _FEWEST and 2 * broken.sum() > count:
            what = f"{broken.sum()} of {count} lengths"
            factor = float(np.median(ratio[broken]))
            suspects.append(Slip(int(column.robot[broken].min()), key, what, factor, "contacts"))
            continue
        worst = {int(column.robot[row]): row for row in np.argsort(ratio) if ratio[row] > _SLIP}
        for robot, row in worst.items():
            what = column.described(log, row)
            singles.append(Slip(robot, key, what, float(ratio[row]), "contacts"))
    return suspects + sorted(singles)


def _bounds(log: SensingLog, walks: Odometry, columns: dict[str, Lengths]) -> dict[str, Reals]:
    """Bound lengths by chains of contacts; infinite where none leads from one robot to the other.

    Returns:
        By key, the greatest distance of the two robots of each length [R], shape (n,).
    """
    rows = measure(log, ["contacts", "walk_contacts", "touches", "directions"], odometry=walks)
    arms = np.linalg.norm(rows.arm[: len(rows.neighbor)], axis=1)
    arms += np.linalg.norm(rows.neighbor_arm, axis=1)
    offset = np.linalg.norm(log.dock_offset_body, axis=1).max() / log.dock_radius
    unknown = (rows.sensed_contacts[:, [2, 4]] == UNKNOWN).sum(axis=1)
    longest = SPACING + arms + offset * unknown
    pair = np.sort(np.column_stack([rows.robot[: len(rows.neighbor)], rows.neighbor]), axis=1)
    order = np.argsort(longest, kind="stable")
    pair, first = np.unique(pair[order], axis=0, return_index=True)
    graph = coo_array((longest[order][first], tuple(pair.T)), shape=(log.robot_count,) * 2)
    starts = np.unique(np.concatenate([column.origin for column in columns.values()]))
    starts = starts[:: len(starts) // _MOST_STARTS + 1]
    away = dijkstra(graph, directed=False, indices=starts)
    away[away == 0.0] = inf  # of the robot itself
    bounds = {}
    for key, column in columns.items():
        place = np.minimum(np.searchsorted(starts, column.origin), len(starts) - 1)
        is_start = starts[place] == column.origin
        bounds[key] = np.where(is_start, away[place, column.robot], inf)
    return bounds


def _header(log: SensingLog, walks: Odometry) -> Iterator[Slip]:
    """Compare the lengths of the header with each other."""
    scale = log.dock_radius
    unit = log.length_unit
    arm = float(np.linalg.norm(log.dock_offset_body, axis=1).max()) / scale
    if arm > _LONGEST_ARM or 0.0 < arm < 1.0 / _LONGEST_ARM:
        what = f"the dock offset of {arm * scale:.4g} {unit}"
        yield Slip(HEADER, "dock_offsets", what, arm, f"dock_radius, {scale:.4g} {unit}")
    height = _heights_by(measure(log, ["ground"], odometry=walks)).get(0)
    if height is not None and log.ground_z is not None:
        stated = log.anchor_position[2] / scale
        ground = log.ground_z / scale
        if abs(stated - height[0]) > _SLIP:
            what = f"the anchor's height of {stated * scale:.4g} {unit}"
            factor = abs(stated - ground) / max(abs(height[0] - ground), 1.0)
            yield Slip(HEADER, "anchor_position", what, factor, "ground_z and its ground_docks")


def _heights_by(rows: Measurements) -> dict[int, tuple[float, float]]:
    """Compute the height of each robot's center and its variance, from vertical places [R]."""
    value = rows.places.value - rows.arm[len(rows.neighbor) :, 2]
    measured = zip(rows.robot.tolist(), value.tolist(), rows.variance().tolist(), strict=True)
    return {robot: (z, variance) for robot, z, variance in measured}


def _heights(log: SensingLog, walks: Odometry) -> Iterator[Slip]:
    """Compare the heights of robots on the ground with those that their ground docks imply."""
    by_flips, by_ground = (
        _heights_by(measure(log, [cue], odometry=walks)) for cue in ("height", "ground")
    )
    both = [robot for robot in by_flips if robot in by_ground]
    wrong = []
    factor = []
    for robot in both:
        (z, variance) = by_flips[robot]
        (stands, more) = by_ground[robot]
        if abs(z - stands) > max(0.5, _SD * (variance + more) ** 0.5) and stands:
            wrong.append(robot)
            factor.append(abs(z / stands))
    if len(both) >= _FEWEST and 2 * len(wrong) > len(both):
        times = float(np.median(factor))
        if not 1.0 / _SCALED < times < _SCALED:
            what = f"{len(wrong)} of {len(both)} heights"
            yield Slip(wrong[0], "flip_height", what, max(times, 1e-9), "ground_docks")


def impossible(log: SensingLog, path: Path) -> Iterator[str]:
    """Describe in lines the contacts of a log that contradict each other."""
    conflicts = contradictions(log)
    for line, problem in conflicts[:MOST_SHOWN]:
        yield f"{path}:{line}: contacts: {problem}"
    if len(conflicts) > MOST_SHOWN:
        more = counted(len(conflicts) - MOST_SHOWN, "more such contradiction")
        yield f"{path}: contacts: {more}"


class Contradiction(NamedTuple):
    """Contacts that cannot all be true."""

    line: int
    """Line of the log with the robot that joined last of those concerned."""

    problem: str
    """Which contacts they are, and what to do."""


def contradictions(log: SensingLog) -> list[Contradiction]:
    """Find contacts of a log that are inconsistent wherever the robots are, in join order.

    With orientations known, a contact says that the later robot's center lies on a sphere of radius
    D about a point fixed to the earlier one. Around a closed chain of n contacts the n vectors of
    length D must make up for the sum of the fixed ones, which is therefore no longer than n D.
    Chains of two and three contacts, and heights, are checked. Noise explains the rest.
    """
    conflicts = [*_by_height(log), *_by_chain(log, measure(log, ["contacts"]))]
    return [
        Contradiction(log.line_of(joiner), problem) for joiner, problem in sorted(set(conflicts))
    ]


def _by_height(log: SensingLog) -> Iterator[tuple[int, str]]:
    """Contacts of robots whose flips took them to heights too different."""
    rows = measure(log, ["contacts", "height"])
    contacts = len(rows.neighbor)
    variance = rows.variance()
    height = np.full(log.robot_count, np.nan)
    spread = np.zeros(log.robot_count)
    measured = rows.robot[contacts:]
    height[measured] = rows.places.value - rows.arm[contacts:, 2]
    spread[measured] = variance[contacts:]
    height[0] = log.anchor_position[2] / log.dock_radius
    spread[0] = 0.0
    robot = rows.robot[:contacts]
    partner = rows.neighbor
    slack = (
        ALLOWED_SD * np.sqrt(spread[robot] + spread[partner] + variance[:contacts]) + _ALLOWED_GAP
    )
    apart = np.abs(height[robot] - height[partner] + _fixed_part(rows)[:, 2])
    for row in np.flatnonzero(apart > SPACING + slack).tolist():
        text = f"{_names(log, rows, [row])} is inconsistent: by their flips the docks are"
        unit = log.length_unit
        length = apart[row] * log.dock_radius
        text = f"{text} {length:.3g} {unit} apart in height, not {log.spacing:g} {unit}; look at it"
        yield int(robot[row]), text


def _by_chain(log: SensingLog, rows: Measurements) -> Iterator[tuple[int, str]]:
    """Two contacts with one robot, or with two that touch each other, that cannot both be."""
    fixed = _fixed_part(rows)
    # The variance is a mean over directions; along the worst one it is at most thrice that.
    unsure = ALLOWED_SD * np.sqrt(3.0 * rows.variance().max(initial=0.0))
    between = defaultdict(list)
    of_joiner = defaultdict(list)
    for row, (joiner, earlier) in enumerate(
        zip(rows.robot.tolist(), rows.neighbor.tolist(), strict=True)
    ):
        between[earlier, joiner].append(row)
        of_joiner[joiner].append(row)
    for joiner, contact_rows in of_joiner.items():
        for one, two in combinations(
            sorted(contact_rows, key=lambda row: int(rows.neighbor[row])), 2
        ):
            first, second = rows.neighbor[[one, two]].tolist()
            closing = [[]] if first == second else [[row] for row in between[first, second]]
            for third in closing:
                gap = np.linalg.norm(fixed[one] - fixed[two] - fixed[third].sum(axis=0))
                count = 2 + len(third)
                if gap > count * (SPACING + _ALLOWED_GAP) + unsure * math.sqrt(count):
                    names = _names(log, rows, [one, two, *third])
                    yield joiner, f"{names} are inconsistent; look at each"


def _fixed_part(rows: Measurements) -> Reals:
    """Arm of the robot's dock less that of the other's, shape (C, 3)."""
    fixed: Reals = rows.arm[: len(rows.neighbor)] - rows.neighbor_arm
    return fixed


def _names(log: SensingLog, rows: Measurements, chosen: list[int]) -> str:
    """Write contacts as the log's lines do: robot, then (own dock, other robot, its dock)."""
    name = log.robot_id
    d = rows.distances
    return " and ".join(
        f"robot {name[rows.robot[row]]}'s contact "
        f"[{d.dock[row]}, {name[rows.neighbor[row]]}, {d.other_dock[row]}]"
        for row in chosen
    )
