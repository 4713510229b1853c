"""Reads tables of ranges between tags and beacons, as radios measure them, as a sensing log.

A table has a range a row, `tag,beacon,range`, or the ranges of a tag to all beacons, whose names
the columns have. Tags have no docks and need no compass: one dock at the center, of a radius that
does not matter, and orientations that no measurement uses. Ranges of two tags count, too.

Without a stated standard deviation, repeated readings state it: the median of a pair enters once,
with the scatter of a reading, since readings of a pair share the errors of their line of sight.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.formats.columns import (
    LENGTHS,
    plain_sheet,
    refuse_other_files,
    report_incomplete,
    robot_numbers,
    split_unit,
)
from tiswarm.formats.poses import SD_PER_MEDIAN_DEVIATION, first_names
from tiswarm.records.io import CsvFile
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import KNOWN_SD, SensingLog, SensingNoise

_NAMES: Mapping[str, Sequence[str]] = {
    "tag": ("tag", "tag_id", "robot", "robot_id", "node", "from", "initiator", "mobile", "id"),
    "beacon": ("beacon", "beacon_id", "anchor", "anchor_id", "other", "to", "responder", "peer"),
    "range": ("range", "distance", "dist", "d", "tof_range"),
    "sd": ("sd", "std", "stdev", "sigma"),
    "bias": ("bias", "offset"),
    "bias_sd": ("bias_sd", "bias_std", "shared_sd"),
    **{axis: (axis, f"pos_{axis}", f"position.{axis}") for axis in "xyz"},
}
"""Names of columns by their meaning, in lower case and without a unit."""

_FEWEST = 3
"""Readings of a pair from which on they state a scatter."""

_MOVED = 5.0
"""Scatter of a pair, in that of most pairs, from which on its robots moved or paths changed."""

_DRIFT = 2.0
"""Scatter of readings of a pair, in that of one from the next, from which on its robots moved."""

_FEWEST_IN_ORDER = 8
"""Readings of a pair from which on their order shows that."""

_SCALES = {"mm": 1e-3, "cm": 1e-2, "dm": 0.1, "ft": 0.3048, "in": 0.0254}
"""Units that are taken for m, with their lengths [m]; a range may be in either."""

_SLACK = 5.0
"""Standard deviations by which lengths of a triangle may miss each other."""

_FEW = 0.1
"""Share of triangles that may be impossible, by outliers."""

_MOST = 1 / 3
"""Share of them from which on another unit is looked for."""

_MOST_OF_A_TAG = 30
"""Ranges of a tag whose triangles are looked at."""

_RADIUS = 0.01
"""Radius of the dock at the center of a tag, in the median of ranges."""


class Beacons(NamedTuple):
    """N beacons at known places, by name."""

    name: list[str]
    place: Reals  # (N, 3)
    sd: Reals  # of each coordinate; 0 where none is stated, (N,)
    bias: Reals  # what its ranges are too long by, (N,)
    bias_sd: Reals  # of what all its ranges are too long by beside it; 0 where none is, (N,)
    unit: str


class _Ranges(NamedTuple):
    """Ranges, a row each."""

    ends: list[tuple[str, str]]
    length: Reals
    sd: Reals  # NaN where none is stated
    unit: str


class _Range(NamedTuple):
    """A range between two robots, with its standard deviation."""

    tag: str
    partner: str  # beacon or further tag
    length: float
    sd: float  # NaN where none is stated


def read_beacons(path: Path, columns: Mapping[str, str]) -> Beacons:
    """Read a table `beacon,x,y,z`, with `sd`, `bias` and `bias_sd` where these are known.

    Args:
        path: The table.
        columns: Names of its columns, by their meaning, where others are not the usual ones.

    Raises:
        InputError: the table is malformed, or names a beacon twice.
    """
    refuse_other_files(path)
    table = CsvFile(path, plain_sheet(path).text)
    column_of = _columns(table, {**_NAMES, "beacon": (*_NAMES["beacon"], "name", "id")}, columns)
    lacking = [name for name in ("beacon", *"xyz") if name not in column_of]
    if lacking:
        problem = f"the columns are {','.join(table.columns)[:200]}, not beacon,x,y,z; add "
        problem += f"{','.join(lacking)}, or name columns as by --column {lacking[0]}=NAME"
        raise InputError(problem, path=path, line=1)
    names = [name.strip() for name in table.words(column_of["beacon"]).tolist()]
    for row, name in enumerate(names):
        if name in names[:row]:
            problem = f"beacon {name[:40]} has a row already; keep one"
            raise InputError(problem, path=path, line=table.line(row), key=column_of["beacon"])
    units = {split_unit(column_of[axis], LENGTHS)[1] for axis in "xyz"}
    if len(units) > 1:
        problem = f"the axes have different units: {', '.join(sorted(units))}; convert them to one"
        raise InputError(problem, path=path, line=1)
    _refuse_other_units(path, column_of, ("bias", "sd", "bias_sd"), next(iter(units)))

    def numbers(name: str) -> Reals:
        return (
            table.numbers(column_of[name], empty=0.0) if name in column_of else np.zeros(len(names))
        )

    place = np.column_stack([table.numbers(column_of[axis]) for axis in "xyz"])
    return Beacons(names, place, numbers("sd"), numbers("bias"), numbers("bias_sd"), units.pop())


def read_ranges(
    path: Path,
    beacons: Path,
    *,
    columns: Mapping[str, str],
    sd: float | None,
    radius: float | None,
    drop_incomplete: bool,
) -> tuple[SensingLog, list[str], list[str]]:
    """Turn a table of ranges and one of beacons into a sensing log, with notes and warnings.

    The first robot is the beacon whose place is known best.

    Args:
        path: Table of ranges.
        beacons: Table of beacons.
        columns: Names of columns of both tables, by their meaning, that are not the usual ones.
        sd: Standard deviation of a range where the table has no column of it; None if unknown.
        radius: Radius of the dock of a tag; 1 % of the median range if None.
        drop_incomplete: Whether to drop rows without a range, instead of refusing them.

    Raises:
        InputError: a table is malformed, units differ, or nothing states how exact ranges are.
    """
    unknown = [name for name in columns if name not in _NAMES]
    if unknown:
        problem = f"{unknown[0]!r} is no quantity of ranges; use {', '.join(_NAMES)}"
        raise InputError(problem, argument="column")
    notes: list[str] = []
    anchors = read_beacons(beacons, columns)
    ranges = _read(path, anchors.name, columns, notes, drop=drop_incomplete)
    if ranges.unit != anchors.unit and "" not in {ranges.unit, anchors.unit}:
        problem = (
            f"ranges are in {ranges.unit}, beacons in {anchors.unit}; convert them to one unit"
        )
        raise InputError(problem, path=path, line=1)
    bias = dict(zip(anchors.name, anchors.bias.tolist(), strict=True))
    length = ranges.length - [bias.get(a, 0.0) + bias.get(b, 0.0) for a, b in ranges.ends]
    stated_sd = ranges.sd if sd is None else np.where(np.isnan(ranges.sd), sd, ranges.sd)
    rows = [
        _Range(a, b, float(row_length), float(row_sd))
        for (a, b), row_length, row_sd in zip(ranges.ends, length, stated_sd, strict=True)
        if row_length > 0.0 and not (a in bias and b in bias)
    ]
    left_out = len(length) - len(rows)
    if left_out:
        notes.append(f"{counted(left_out, 'range')} left out: empty, 0, or between two beacons")
    if not rows:
        raise InputError("there are no ranges of tags; add some", path=path, line=2)
    warnings = _strangers(path, anchors.name, rows)
    if np.isnan([row.sd for row in rows]).any():
        rows = _pooled(path, rows, notes, warnings)
    warnings += _impossible(anchors, rows)
    if not radius:
        radius = float(f"{_RADIUS * np.median([row.length for row in rows]):.1g}")
    return _log(anchors, rows, radius, ranges.unit or anchors.unit, notes), notes, warnings


def _log(
    beacons: Beacons, rows: Sequence[_Range], radius: float, unit: str, notes: list[str]
) -> SensingLog:
    """Log beacons, the best known first, then tags; note who has which number."""
    beacon_row = {name: row for row, name in enumerate(beacons.name)}
    robots = {name for row in rows for name in (row.tag, row.partner)}
    tags = sorted(robots - {*beacon_row}, key=_natural)
    best = int(beacons.sd.argmin())
    further = [name for row, name in enumerate(beacons.name) if row != best]
    names = [beacons.name[best], *further, *tags]
    numbers, renamed = _numbers(names, len(beacon_row))
    notes += renamed
    notes.append(
        f"{len(beacon_row)} beacons, {counted(len(tags), 'tag')}, {counted(len(rows), 'range')}"
    )
    robot_row = {name: row for row, name in enumerate(names)}
    sources = [
        name for name in names if name in beacon_row and beacons.bias_sd[beacon_row[name]] > 0
    ]
    entries = []
    for a, b, length, sd in rows:
        earlier, later = sorted((robot_row[a], robot_row[b]))
        source = sources.index(names[earlier]) if names[earlier] in sources else -1
        entries.append((later, earlier, length, sd, source))
    fixes = [
        (robot_row[name], *axis, coordinate, beacons.sd[k] or KNOWN_SD * radius, -1)
        for name, k in beacon_row.items()
        if k != best
        for axis, coordinate in zip(np.eye(3), beacons.place[k], strict=True)
    ]
    count = len(names)
    return SensingLog(
        robot_id=np.array(numbers, np.int64),
        dock_radius=radius,
        dock_offset_body=np.zeros((1, 3)),
        anchor_position=beacons.place[best],
        orientation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        contacts=np.empty((0, 4), np.int32),
        fixes=np.array(sorted(fixes)).reshape(-1, 7),
        ranges=np.array(sorted(entries), np.float64).reshape(-1, 5),
        flip_height=np.full(count, np.nan),
        spawn_position=np.full((count, 3), np.nan),
        noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0),
        source_name=tuple(f"beacon {name}"[:40] for name in sources),
        source_sd=np.array([beacons.bias_sd[beacon_row[name]] for name in sources], np.float64),
        length_unit=unit or "unit",
    )


def _strangers(path: Path, beacons: Sequence[str], rows: Sequence[_Range]) -> list[str]:
    """Warn of beacons without ranges beside names that no table has as beacons or tags.

    Raises:
        InputError: no range is to a beacon.
    """
    tags = {row.tag for row in rows}
    partners = {row.partner for row in rows}
    strangers = sorted(partners - tags - {*beacons}, key=_natural)
    if not (tags | partners) & {*beacons}:
        names = first_names(strangers or sorted(tags | partners))
        problem = (
            f"no range is to a beacon: ranges have {names}, beacons are {first_names(beacons)}; "
        )
        raise InputError(f"{problem}write them alike", path=path)
    if not strangers:
        return []
    names = first_names(strangers)
    problem = f"ranges are to names without a place, which are located as tags: {names}; "
    return [f"{problem}add their places if they are beacons"]


class _Triangles(NamedTuple):
    """Triangles of a tag and two beacons, by their sides."""

    base: Reals  # between the beacons, (K,)
    ranges: Reals  # from the tag to both beacons, (K, 2)
    slack: Reals  # by which the sides may miss each other, (K,)

    def impossible(self, scale: float) -> int:
        """Count triangles that cannot be, with ranges in another unit."""
        to_first, to_second = scale * self.ranges.T
        miss = np.maximum(
            np.abs(to_first - to_second) - self.base, self.base - to_first - to_second
        )
        return int((miss > scale * self.slack).sum())


def _triangles(beacons: Beacons, rows: Sequence[_Range]) -> _Triangles:
    """List the triangles of tags, the first ranges of each, with two beacons."""
    place = dict(zip(beacons.name, beacons.place, strict=True))
    by_tag: dict[str, list[tuple[Reals, float, float]]] = {}
    for a, b, length, sd in rows:
        for tag, beacon in ((a, b), (b, a)):
            if beacon in place and tag not in place:
                by_tag.setdefault(tag, []).append((place[beacon], length, sd))
    base = []
    ranges = []
    slack = []
    for measured in by_tag.values():
        pairs = combinations(measured[:_MOST_OF_A_TAG], 2)
        for (place_a, length_a, sd_a), (place_b, length_b, sd_b) in pairs:
            base.append(float(np.linalg.norm(place_a - place_b)))
            ranges.append((length_a, length_b))
            slack.append(_SLACK * float(np.hypot(sd_a, sd_b)))
    return _Triangles(np.array(base), np.array(ranges).reshape(-1, 2), np.array(slack))


def _impossible(beacons: Beacons, rows: Sequence[_Range]) -> list[str]:
    """Warn where ranges of a tag to two beacons are no triangle with the distance of these."""
    triangles = _triangles(beacons, rows)
    count = len(triangles.base)
    number = triangles.impossible(1.0)
    if number <= _FEW * count:
        return []
    problem = f"{number} of {count} triangles of a tag and two beacons cannot be"
    if number > _MOST * count:
        for unit, meters in _SCALES.items():
            for scale, fit in (
                (meters, f"{unit} and beacons in m"),
                (1 / meters, f"m and beacons in {unit}"),
            ):
                if triangles.impossible(scale) <= _FEW * count:
                    return [f"{problem}; with ranges in {fit} they can: convert them to one unit"]
    return [f"{problem}: correct places or names of beacons, or give their bias"]


def _refuse_other_units(
    path: Path, column_of: Mapping[str, str], names: Sequence[str], unit: str
) -> None:
    """Refuse columns of lengths in another unit than those beside them; some may have none."""
    for name in names:
        column = column_of.get(name, "")
        _, column_unit = split_unit(column, LENGTHS)
        if column_unit and column_unit.lower() != unit.lower():
            problem = f"this column is in {column_unit}, others in {unit or 'none'}; "
            raise InputError(f"{problem}convert them to one unit", path=path, line=1, key=column)


def _columns(
    table: CsvFile, names: Mapping[str, Sequence[str]], stated: Mapping[str, str]
) -> dict[str, str]:
    """Find columns by their meaning, those first whose names are given."""
    bare = {column: split_unit(column, LENGTHS)[0].lower() for column in table.columns}
    column_of = {meaning: column for meaning, column in stated.items() if column in bare}
    for meaning, usual in names.items():
        if meaning in column_of:
            continue
        columns = [column for name in usual for column in table.columns if bare[column] == name]
        if columns:
            column_of[meaning] = columns[0]
    return column_of


def _read(
    path: Path,
    beacons: Sequence[str],
    columns: Mapping[str, str],
    notes: list[str],
    *,
    drop: bool,
) -> _Ranges:
    """Read a range a row, or those of a tag to all beacons; gaps of the latter are left out.

    Ranges to all beacons are of one tag if no column names tags.
    """
    refuse_other_files(path)
    table = CsvFile(path, plain_sheet(path).text)
    column_of = _columns(table, _NAMES, columns)
    beacon_of = {} if "beacon" in column_of else _by_beacon(table.columns, beacons)
    wanted = [] if beacon_of else ["tag", "beacon", "range"]
    lacking = [name for name in wanted if name not in column_of]
    if lacking:
        problem = f"the columns are {','.join(table.columns)[:200]}, neither tag,beacon,range nor "
        problem += f"tag and names of beacons; rename or add {','.join(lacking)}, or name columns "
        raise InputError(f"{problem}as by --column {lacking[0]}=NAME", path=path, line=1)
    values = [*beacon_of] or [column_of["range"]]
    units = {split_unit(column, LENGTHS)[1] for column in values}
    if len(units) > 1:
        problem = f"ranges have different units: {', '.join(sorted(units))}; convert them to one"
        raise InputError(problem, path=path, line=1)
    if not beacon_of:
        lines = table.incomplete([column_of[name] for name in wanted])
        notes += report_incomplete(path, lines, drop=drop)
        table.drop(lines)
    _refuse_other_units(path, column_of, ("sd",), next(iter(units)))
    tags = ["tag"] * len(table.rows)
    if "tag" in column_of:
        tags = [name.strip() for name in table.words(column_of["tag"]).tolist()]
    ends: list[tuple[str, str]] = []
    lengths: list[float] = []
    sd: list[float] = []
    for column in values:
        for line in table.incomplete([column]):
            table.rows[line][table.columns.index(column)] = ""
        if beacon_of:
            partners = [beacon_of[column]] * len(tags)
        else:
            partners = table.words(column_of["beacon"]).tolist()
        ends += [(tag, partner.strip()) for tag, partner in zip(tags, partners, strict=True)]
        lengths += table.numbers(column, empty=0.0).tolist()
        sd += _deviations(table, column_of.get("sd"))
    for row, (tag, partner) in enumerate(ends):
        if tag == partner:
            problem = f"{tag[:40]!r} has a range to itself; name another robot, or give tags and "
            problem += "beacons different names, such as T1 and A1"
            raise InputError(problem, path=path, line=table.line(row % len(tags)))
    return _Ranges(ends, np.array(lengths), np.array(sd), units.pop())


def _deviations(table: CsvFile, column: str | None) -> list[float]:
    """Read positive standard deviations; NaN without a column."""
    if column is None:
        return [np.nan] * len(table.rows)
    widths: list[float] = table.numbers(column).tolist()
    for row, width in enumerate(widths):
        if width <= 0.0:
            problem = f"{width:g} is no standard deviation; write a positive one"
            raise InputError(problem, path=table.path, line=table.line(row), key=column)
    return widths


def _by_beacon(columns: Sequence[str], beacons: Sequence[str]) -> dict[str, str]:
    """Find columns that are named after beacons, such as `range_A1 [m]`."""
    beacon_of = {}
    words = r"^(?:range|distance|dist|d)[\W_]*|[\W_]{0,8}(?:range|distance|dist)$"
    for column in columns:
        name, _ = split_unit(column, LENGTHS)
        name = re.sub(words, "", name, flags=re.IGNORECASE)
        if name in beacons:
            beacon_of[column] = name
    return beacon_of


def _pooled(
    path: Path, rows: Sequence[_Range], notes: list[str], warnings: list[str]
) -> list[_Range]:
    """Replace readings without a standard deviation by the median of each pair, with a scatter."""
    pairs: dict[tuple[str, str], list[float]] = {}
    with_sd = [row for row in rows if not np.isnan(row.sd)]
    for a, b, reading, sd in rows:
        if np.isnan(sd):
            pair = (a, b) if _natural(a) < _natural(b) else (b, a)
            pairs.setdefault(pair, []).append(reading)
    scatter = {
        pair: SD_PER_MEDIAN_DEVIATION
        * float(np.median(np.abs(np.array(readings) - np.median(readings))))
        for pair, readings in pairs.items()
        if len(readings) >= _FEWEST
    }
    sd = float(np.median([*scatter.values()])) if scatter else 0.0
    if not sd:
        shown = "repeated readings are equal" if scatter else "no repeated readings show it"
        problem = f"nothing states how exact ranges are, and {shown}; add a "
        raise InputError(f"{problem}column sd, or give --range-sd", path=path, line=1)
    notes.append(
        f"ranges scatter by {sd:.2g} (1 sd), in {counted(len(scatter), 'pair')} with repeated "
        "readings: the median of each pair counts once, with that sd"
    )
    far_wider = [f"{a} to {b}" for (a, b), pair_sd in scatter.items() if pair_sd > _MOVED * sd]
    if far_wider:
        problem = f"readings scatter far more than others: {first_names(far_wider)}; "
        remedy = "robots moved, or paths changed: cut the table to a time of rest"
        warnings.append(problem + remedy)
    if _drift(pairs) > _DRIFT:
        problem = "readings of a pair follow each other closely, and drift: robots moved; "
        warnings.append(f"{problem}cut the table to a time of rest")
    medians = [
        _Range(*pair, float(np.median(readings)), max(sd, scatter.get(pair, 0.0)))
        for pair, readings in pairs.items()
    ]
    return with_sd + medians


def _drift(pairs: Mapping[tuple[str, str], Sequence[float]]) -> float:
    """Compare the scatter of readings with that of each from the next; the median of pairs.

    It is 1 for readings with errors of their own; 0 where there are too few, or equal ones.
    """
    ratios = []
    for readings in pairs.values():
        if len(readings) < _FEWEST_IN_ORDER:
            continue
        step = float(np.median(np.abs(np.diff(readings))))
        if step > 0.0:
            deviation = np.abs(np.array(readings) - np.median(readings))
            ratios.append(float(np.median(deviation)) * np.sqrt(2.0) / step)
    return float(np.median(ratios or [0.0]))


def _natural(name: str) -> tuple[int, str]:
    """Sort names by the first number in them."""
    number = re.search(r"\d+", name)
    return int(number[0]) if number else 0, name


def _numbers(names: Sequence[str], beacons: int) -> tuple[list[int], list[str]]:
    """Give each robot a number: that in its name, where no other robot has the same."""
    numbers, _ = robot_numbers(names)
    if all(str(number) in name for number, name in zip(numbers, names, strict=True)):
        return numbers, []
    tags, _ = robot_numbers(names[beacons:])
    numbers_of_beacons = [max(tags, default=-1) + 1 + k for k in range(beacons)]
    numbers = [*numbers_of_beacons, *tags]
    listed = [f"{name} is {number}" for name, number in zip(names, numbers, strict=True)]
    return numbers, [f"robots are numbered: {first_names(listed)}"]
