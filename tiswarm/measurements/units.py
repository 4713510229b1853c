"""Lengths of a log that seem to be in another unit than the rest: one of them, or a whole column.

Two robots are at most as far apart as a chain of contacts between them is long, and three distances
satisfy the triangle inequality. So measured lengths bound each other, wherever the robots are. A
length that breaks bounds many times over is no noise, but a slip of the unit or of the decimal
point. The one that breaks most bounds is to blame. Lengths in R.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import combinations, permutations, product
from math import inf, isqrt, log10
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tiswarm.base.aliases import Ints, Reals
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.measurements.odometry import UNKNOWN, Odometry
from tiswarm.records.sensing_log import SensingLog

_SLIP = 4.0
"""Factor by which a length breaks a bound, from which on it is no noise."""

_SCALED = 1.5
"""The same for more than half of a column's lengths."""

_FEWEST = 3
"""Bounds from which on more than half of them speak for a column, if each is broken as a single
length would break it."""

_MANY = 10
"""Bounds from which on `_SCALED` is enough: false contacts break a few."""

_SD = 5.0
"""Standard deviations that noise may explain."""

_LONGEST_ARM = 100.0
"""Dock offset from which on it is unlikely [R]."""

_MOST_STARTS = 500
"""Robots from which chains of contacts are followed; of more, a sample."""

_MOST_PLACED = 40
"""Robots of known places whose distances are compared; of more, a sample."""

_MOST_READINGS = 5
"""Ranges of a pair of robots that are compared; of more, a sample."""

_MOST_TRIANGLES = 60_000
"""Triangles that are compared, about; of more, a sample of each robot's."""

COLUMNS = ("ranges", "fixes", "flip_height", "spawn_position")
"""Keys of robots with lengths."""

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


class _Length(NamedTuple):
    """A measured length."""

    key: str
    robot: int
    what: str

    size: float
    """The length itself, or the distance of a coordinate from the anchor's [R]."""

    readings: int = 1
    """Readings that it stands for [1]."""


class _Bond(NamedTuple):
    """Bounds of the distance of two robots."""

    pair: tuple[int, int]
    """Robots, the earlier one first."""

    low: float
    """Least distance [R]."""

    high: float
    """Greatest distance [R]; infinite where it is unknown."""

    lengths: frozenset[int]
    """Measured lengths that the bounds follow from; none where they follow from contacts."""


class _Conflict(NamedTuple):
    """Distances that cannot all be true: most likely one is too long, or one too short."""

    long: _Bond
    short: _Bond

    lengths: frozenset[int]
    """Lengths that all of them follow from."""

    too_long: float
    """Factor by which the long one exceeds what the others allow."""

    too_short: float
    """Factor by which the short one falls below what the others allow."""


def slips(log: SensingLog) -> list[Slip]:
    """Find lengths that seem to be in another unit than the rest of the log, columns first."""
    walks = Odometry(log)
    lengths, bonds = _measured(log, walks)
    chains = _chains(log, walks, bonds)
    found = [*_header(log, walks), *_heights(log, walks)]
    for column in (_by_contacts, _ranges_by_fixes):
        bonds = _without(bonds, lengths, {slip.key for slip in found})
        found += column(lengths, bonds, chains)
    bonds = _without(bonds, lengths, {slip.key for slip in found})
    return [*found, *_singles(lengths, _conflicts([*bonds, *chains]))]


def _measured(log: SensingLog, walks: Odometry) -> tuple[list[_Length], list[_Bond]]:
    """List the lengths of a log, and the bounds of distances that follow from them."""
    lengths: list[_Length] = []
    bonds: list[_Bond] = []

    def add(length: _Length, other: int, low: float, high: float) -> None:
        pair = (min(length.robot, other), max(length.robot, other))
        bonds.append(_Bond(pair, low, high, frozenset({len(lengths)})))
        lengths.append(length)

    name, unit, scale = log.robot_id.tolist(), log.length_unit, log.dock_radius
    rows = measure(log, ["ranges"], odometry=walks)
    slack = _SD * np.sqrt(rows.variance()) + np.linalg.norm(rows.arm, axis=1)
    columns = (rows.robot, rows.other, rows.distances.length, slack)
    readings = _readings(*columns[:3])
    for row in np.flatnonzero(readings).tolist():
        robot, other, size, s = (column[row].item() for column in columns)
        what = f"the range of {size * scale:.4g} {unit} to robot {name[other]}"
        length = _Length("ranges", robot, what, size, int(readings[row]))
        add(length, other, size - s, size + s)
    for key, cue in (("flip_height", "height"), ("spawn_position", "odometry"), ("fixes", "fixes")):
        rows = measure(log, [cue], odometry=walks)
        away = np.abs(rows.residual(np.tile(log.anchor_position / scale, (len(name), 1))))
        for row in _farthest(rows.robot, away):
            what = f"the coordinate {rows.places.value[row] * scale:.4g} {unit}"
            size, s = float(away[row]), _SD * float(rows.variance()[row]) ** 0.5
            add(_Length(key, int(rows.robot[row]), what, size), 0, size - s, inf)
    number = {each.robot: n for n, each in enumerate(lengths) if each.key == "fixes"}
    return lengths, [*bonds, *_between_placed(rows, number, log.anchor_position / scale)]


def _readings(robot: Ints, other: Ints, size: Reals) -> Ints:
    """Count the readings that each stands for, 0 if another one stands for it, shape (n,).

    Of many readings of a pair, the least, the greatest and some between them stand for all.
    """
    pair = np.sort(np.column_stack([robot, other]), axis=1)
    order = np.lexsort((size, *pair.T))
    ends = np.flatnonzero(np.diff(pair[order], axis=0).any(axis=1)) + 1
    count = np.zeros(len(robot), np.int64)
    for of_pair in np.split(order, ends) if len(order) else ():
        parts = np.array_split(of_pair, min(len(of_pair), _MOST_READINGS))
        for n, part in enumerate(parts):
            count[part[n * (len(part) - 1) // max(len(parts) - 1, 1)]] = len(part)
    return count


def _farthest(robot: Ints, away: Reals) -> list[int]:
    """Choose the row of each robot that is farthest away."""
    order = np.lexsort((away, robot))
    last = np.flatnonzero(np.diff(robot[order], append=-1))
    chosen: list[int] = order[last].tolist()
    return chosen


def _between_placed(
    rows: Measurements, number: Mapping[int, int], anchor: Reals
) -> Iterator[_Bond]:
    """Bound the distances between robots whose fixes span space, and the anchor."""
    placed = {0: (anchor, 0.0)}
    sd = np.sqrt(rows.variance())
    value = rows.places.value - (rows.places.direction * rows.arm).sum(axis=1)
    robots = [robot for robot in number if robot]
    for robot in robots[:: len(robots) // _MOST_PLACED + 1]:
        mine = np.flatnonzero(rows.robot == robot)
        planes = rows.places.direction[mine] / sd[mine, None]
        center, _, rank, _ = np.linalg.lstsq(planes, value[mine] / sd[mine], rcond=1e-9)
        if rank == len(anchor):
            spread = np.trace(np.linalg.inv(planes.T @ planes))
            placed[robot] = (center, _SD * float(spread) ** 0.5)
    for i, j in combinations(placed, 2):
        apart = float(np.linalg.norm(placed[i][0] - placed[j][0]))
        slack = placed[i][1] + placed[j][1]
        lengths = frozenset(number[robot] for robot in (i, j) if robot)
        yield _Bond((min(i, j), max(i, j)), apart - slack, apart + slack, lengths)


def _chains(log: SensingLog, walks: Odometry, bonds: Sequence[_Bond]) -> list[_Bond]:
    """Bound the distances of measured pairs by chains of contacts."""
    rows = measure(log, ["contacts", "walk_contacts", "touches", "directions"], odometry=walks)
    arms = np.linalg.norm(rows.arm[: len(rows.other)], axis=1)
    arms += np.linalg.norm(rows.other_arm, axis=1)
    offset = np.linalg.norm(log.dock_offset_body, axis=1).max() / log.dock_radius
    unknown = (rows.sensed_contacts[:, [2, 4]] == UNKNOWN).sum(axis=1)
    longest = SPACING + arms + offset * unknown
    pair = np.sort(np.column_stack([rows.robot[: len(rows.other)], rows.other]), axis=1)
    order = np.argsort(longest, kind="stable")
    pair, first = np.unique(pair[order], axis=0, return_index=True)
    graph = coo_array((longest[order][first], tuple(pair.T)), shape=(log.robot_count,) * 2)
    wanted = sorted({bond.pair for bond in bonds})
    starts = sorted({i for i, _ in wanted})
    starts = starts[:: len(starts) // _MOST_STARTS + 1]
    if not starts:
        return []
    bound = dict(zip(starts, dijkstra(graph, directed=False, indices=starts), strict=True))
    found = ((pair, float(bound[pair[0]][pair[1]])) for pair in wanted if pair[0] in bound)
    return [_Bond(pair, 0.0, high, frozenset()) for pair, high in found if 0.0 < high < inf]


def _without(
    bonds: Iterable[_Bond], lengths: Sequence[_Length], keys: Collection[str]
) -> list[_Bond]:
    """Leave out bonds that follow from lengths of some keys."""
    return [b for b in bonds if not any(lengths[n].key in keys for n in b.lengths)]


def _header(log: SensingLog, walks: Odometry) -> Iterator[Slip]:
    """Compare the lengths of the header with each other."""
    scale, unit = log.dock_radius, log.length_unit
    arm = float(np.linalg.norm(log.dock_offset_body, axis=1).max()) / scale
    if arm > _LONGEST_ARM or 0.0 < arm < 1.0 / _LONGEST_ARM:
        what = f"the dock offset of {arm * scale:.4g} {unit}"
        yield Slip(HEADER, "dock_offsets", what, arm, f"dock_radius, {scale:.4g} {unit}")
    height = _heights_by(measure(log, ["ground"], odometry=walks)).get(0)
    if height is not None and log.ground_z is not None:
        stated, ground = log.anchor_position[2] / scale, log.ground_z / scale
        if abs(stated - height[0]) > _SLIP:
            what = f"the anchor's height of {stated * scale:.4g} {unit}"
            factor = abs(stated - ground) / max(abs(height[0] - ground), 1.0)
            yield Slip(HEADER, "anchor_position", what, factor, "ground_z and its ground_docks")


def _heights_by(rows: Measurements) -> dict[int, tuple[float, float]]:
    """Compute the height of each robot's center and its variance, from vertical places [R]."""
    value = rows.places.value - rows.arm[len(rows.other) :, 2]
    found = zip(rows.robot.tolist(), value.tolist(), rows.variance().tolist(), strict=True)
    return {robot: (z, variance) for robot, z, variance in found}


def _heights(log: SensingLog, walks: Odometry) -> Iterator[Slip]:
    """Compare the heights of robots on the ground with those that their ground docks imply."""
    by_flips, by_ground = (
        _heights_by(measure(log, [cue], odometry=walks)) for cue in ("height", "ground")
    )
    both = [robot for robot in by_flips if robot in by_ground]
    wrong, factor = [], []
    for robot in both:
        (z, variance), (stands, more) = by_flips[robot], by_ground[robot]
        if abs(z - stands) > max(0.5, _SD * (variance + more) ** 0.5) and stands:
            wrong.append(robot)
            factor.append(abs(z / stands))
    if len(both) >= _FEWEST and 2 * len(wrong) > len(both):
        times = float(np.median(factor))
        if not 1.0 / _SCALED < times < _SCALED:
            what = f"{len(wrong)} of {len(both)} heights"
            yield Slip(wrong[0], "flip_height", what, max(times, 1e-9), "ground_docks")


def _by_contacts(
    lengths: Sequence[_Length], bonds: Sequence[_Bond], chains: Sequence[_Bond]
) -> Iterator[Slip]:
    """Find columns most of whose lengths are longer than chains of contacts."""
    bound = {chain.pair: chain.high for chain in chains}
    ratios: dict[str, dict[int, float]] = defaultdict(dict)
    for bond in bonds:
        if len(bond.lengths) == 1 and bond.pair in bound:
            (number,) = bond.lengths
            ratios[lengths[number].key][number] = bond.low / bound[bond.pair]
    for key, of_key in ratios.items():
        limit = _SCALED if len(of_key) >= _MANY else _SLIP
        broken = {number: ratio for number, ratio in of_key.items() if ratio > limit}
        if len(of_key) >= _FEWEST and 2 * len(broken) > len(of_key):
            first = min(lengths[number].robot for number in broken)
            wrong, every = (sum(lengths[n].readings for n in each) for each in (broken, of_key))
            factor = float(np.median([*broken.values()]))
            yield Slip(first, key, f"{wrong} of {every} lengths", factor, "contacts")


def _ranges_by_fixes(
    lengths: Sequence[_Length],
    bonds: Sequence[_Bond],
    chains: Sequence[_Bond],  # noqa: ARG001 - contacts say nothing of this
) -> Iterator[Slip]:
    """Compare ranges to robots of known places with the distances between these."""
    long, short, triangles = [], [], 0
    for sides in _triangles(bonds):
        keys = Counter({lengths[n].key for n in side.lengths} == {"ranges"} for side in sides)
        known = [side for side in sides if {lengths[n].key for n in side.lengths} == {"fixes"}]
        if keys[True] != 2 or len(known) != 1 or not known[0].high < inf:  # noqa: PLR2004
            continue
        triangles += 1
        one, two = (side for side in sides if side is not known[0])
        apart = abs(one.low - two.low) - (one.high - one.low)
        if apart > _SCALED * known[0].high:
            long.append(apart / known[0].high)
        elif _SCALED * (one.high + two.high) < known[0].low:
            short.append((one.high + two.high) / known[0].low)
    for broken in (long, short):
        if triangles >= _FEWEST and 2 * len(broken) > triangles:
            count = sum(each.readings for each in lengths if each.key == "ranges")
            first = min(each.robot for each in lengths if each.key == "ranges")
            yield Slip(first, "ranges", f"{count} ranges", float(np.median(broken)), "fixes")


def _triangles(bonds: Sequence[_Bond]) -> Iterator[tuple[_Bond, _Bond, _Bond]]:
    """List triangles of bonds, those of each robot with earlier ones."""
    between: dict[tuple[int, int], list[_Bond]] = defaultdict(list)
    earlier: dict[int, list[int]] = defaultdict(list)
    for bond in bonds:
        if bond.pair not in between:
            earlier[bond.pair[1]].append(bond.pair[0])
        between[bond.pair].append(bond)
    of_three = max(1.0, len(bonds) / max(len(between), 1)) ** 3  # triangles of three pairs
    most = max(4, isqrt(int(2 * _MOST_TRIANGLES / of_three) // max(len(earlier), 1)))
    for robot, others in earlier.items():
        by_length = sorted(others, key=lambda other: between[other, robot][0].low)
        sampled = np.linspace(0, len(others) - 1, min(most, len(others))).round().astype(int)
        for i, j in combinations(sorted(by_length[k] for k in sampled.tolist()), 2):
            if (i, j) in between:
                yield from product(between[i, robot], between[j, robot], between[i, j])


def _conflicts(bonds: Sequence[_Bond]) -> list[_Conflict]:
    """List distances that break a bound many times over."""
    found = []
    of_pair: dict[tuple[int, int], list[_Bond]] = defaultdict(list)
    for bond in bonds:
        of_pair[bond.pair].append(bond)
    for same in of_pair.values():
        for long, short in permutations(same, 2):
            if long.low > _SLIP * short.high:
                ratio = long.low / short.high
                every = long.lengths | short.lengths
                found.append(_Conflict(long, short, every, ratio, ratio))
    for sides in _triangles([bond for bond in bonds if bond.lengths]):
        for long, further, short in permutations(sides):
            if long.low - further.high > _SLIP * short.high:
                too_long = long.low / (further.high + short.high)
                too_short = (long.low - further.high) / short.high
                every = long.lengths | further.lengths | short.lengths
                found.append(_Conflict(long, short, every, too_long, too_short))
    return found


def _singles(lengths: Sequence[_Length], conflicts: list[_Conflict]) -> Iterator[Slip]:
    """Blame the length in most conflicts, leave these out, and go on with the rest."""
    typical = {
        key: float(np.median([each.size for each in lengths if each.key == key]))
        for key in {each.key for each in lengths}
    }

    def strangeness(number: int) -> float:
        size, usual = lengths[number].size, typical[lengths[number].key]
        return abs(log10(max(size, 1e-12) / max(usual, 1e-12)))

    while conflicts:
        count = Counter(n for c in conflicts for n in c.long.lengths | c.short.lengths)
        worst = max(count, key=lambda number: (count[number], strangeness(number)))
        as_long = [c.too_long for c in conflicts if worst in c.long.lengths]
        as_short = [c.too_short for c in conflicts if worst in c.short.lengths]
        is_long = len(as_long) >= len(as_short)
        factor = float(np.median(as_long)) if is_long else 1.0 / float(np.median(as_short))
        others = frozenset().union(*(c.lengths for c in conflicts if worst in c.lengths)) - {worst}
        against = "other measurements" if others else "contacts"
        each = lengths[worst]
        yield Slip(each.robot, each.key, each.what, factor, against)
        conflicts = [c for c in conflicts if worst not in c.lengths]
